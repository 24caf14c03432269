"""The wall clock is set while vehicles fly: by NTP after a start without a network, or by a person."""

from __future__ import annotations

import asyncio
import time
from pathlib import Path
from unittest import mock

from support.flown import aloft

DAY_S = 86_400.0


async def test_a_flight_depends_on_no_clock_that_somebody_sets(tmp_path: Path) -> None:
    async with aloft(tmp_path, px4=1, ardupilot=1) as gcs:
        await gcs.fly("attitude", "all")
        await asyncio.sleep(3)
        gcs.told = []
        right_s, right_ns = time.time, time.time_ns
        for off_s in (-365 * DAY_S, 3600.0, 365 * DAY_S, -0.5):
            with (
                mock.patch("time.time", lambda off_s=off_s: right_s() + off_s),
                mock.patch("time.time_ns", lambda off_s=off_s: right_ns() + round(off_s * 1e9)),
            ):
                await asyncio.sleep(5)
                for name in ("v1", "v2"):
                    actor = gcs.actor(name)
                    assert actor.vehicle.connected and actor.offboard.sends_setpoints, (off_s, name)
                    await gcs.step(0.5, 0.0, 0.0, name=name)
        assert [t.text for t in gcs.told if t.kind not in ("command", "statustext")] == []
