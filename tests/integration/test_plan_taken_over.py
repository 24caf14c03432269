"""A pilot takes one vehicle over in each phase of a plan: the others stop, and nobody takes it from him."""

from __future__ import annotations

import asyncio
from pathlib import Path

import pytest

from support.flown import flown
from support.planned import MARGIN_M, UP_M, least_distance, run, state, timed

pytestmark = pytest.mark.looptime

LOITER = (4, 3)
"""PX4's AUTO.LOITER, as a pilot or another station sets it."""


@pytest.mark.parametrize("when", ["takeoff", "to_starts", "flying", "paused", "aborting", "landing"])
async def test_a_pilot_keeps_what_he_took_and_the_others_are_safe(tmp_path: Path, when: str) -> None:
    async with flown(tmp_path, px4=2, takeoff=False) as gcs:
        starts = {f"v{sim.sysid}": (*gcs.place_of_home(f"v{sim.sysid}")[:2], UP_M) for sim in gcs.sims}
        # the starts are away from where they take off, so that there is a way to them
        starts = {name: (x, y + 6.0, up) for name, (x, y, up) in starts.items()}
        await run(gcs, timed(starts, {name: (x, y + 12.0, UP_M) for name, (x, y, _) in starts.items()}))
        if when == "takeoff":
            await gcs.until(lambda: all(sim.motion.up_m > 3.0 for sim in gcs.sims), 60.0)
        elif when == "to_starts":
            await gcs.until(lambda: state(gcs) == when, 90.0)
        else:
            await gcs.until(lambda: state(gcs) == "flying", 90.0)
            await asyncio.sleep(4.0)
        if when in ("paused", "aborting", "landing"):
            await gcs({"paused": "plan.pause", "aborting": "plan.abort", "landing": "plan.land"}[when])
        if when == "paused":
            await asyncio.sleep(1.0)
        gcs.other_sets_mode(*LOITER, sysid=2)
        await gcs.until(lambda: gcs.actor("v2").vehicle.mode == "AUTO.LOITER", 10.0)
        since = gcs.now
        over = (
            ("aborted",)
            if when == "aborting"
            else ("stopped", "landing", "landed")
            if when == "landing"
            else ("stopped",)
        )
        await gcs.until(lambda: state(gcs) in over, 20.0)
        await asyncio.sleep(5.0)
        if when not in ("aborting", "landing"):  # those were ordered before he took it, and may arrive after
            assert gcs.actor("v2").vehicle.mode == "AUTO.LOITER", "nobody takes it from him"
            assert not gcs.setpoints(since + 2.0, "v2"), "nothing is sent to it any more"
        assert least_distance(gcs, 0.0)[0] > MARGIN_M
