"""What the link does not bear is not flown: it is told with the figures, and the fallback settles."""

from __future__ import annotations

import asyncio
from pathlib import Path

import pytest

from skygcs.runtime.link_view import LinkView
from support.flown import aloft


async def test_a_radio_that_gets_busy_in_flight(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    left = [1440.0]
    monkeypatch.setattr(LinkView, "setpoint_bytes_per_s", lambda view, vehicle, flown: left[0])
    async with aloft(tmp_path) as gcs:
        await gcs.fly("attitude")
        await gcs.step(3.0, 0.0, 0.0)
        await asyncio.sleep(5)
        rate_hz = len(gcs.setpoints(gcs.now - 2.0)) / 2.0
        assert rate_hz == pytest.approx((1440 - 140) / 51, abs=1.0), (
            "as many as the link bears, not the 50 that are configured"
        )
        start, busy = gcs.place(), gcs.now
        left[0] = 720.0
        await asyncio.sleep(10)
        assert "SET_ATTITUDE_TARGET" not in {s.name for s in gcs.setpoints(busy + 0.3)}
        (told,) = gcs.texts(busy)
        assert told.startswith("flown by velocity setpoints: the link leaves 14.1 setpoints per second")
        assert gcs.farthest_m(busy, of=start) < 1.0
