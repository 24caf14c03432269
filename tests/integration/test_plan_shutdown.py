"""A daemon that is stopped in the middle of a plan: nobody is left armed on the ground, and who flies holds."""

from __future__ import annotations

import asyncio
from pathlib import Path

import pytest

from support.flown import PAIRS, Flown, flown
from support.planned import MARGIN_M, UP_M, least_distance, plan_events, run, state, timed


async def begun(gcs: Flown) -> None:
    starts = {f"v{sim.sysid}": (*gcs.place_of_home(f"v{sim.sysid}")[:2], UP_M) for sim in gcs.sims}
    await run(gcs, timed(starts, {name: (x, y + 12.0, UP_M) for name, (x, y, _) in starts.items()}))


def clock_state(gcs: Flown) -> str:
    clock = gcs.daemon.fleet.plans.status()["clock"]
    return "none" if clock is None else str(clock["state"])


@PAIRS
async def test_while_they_arm_the_armed_are_disarmed_and_nobody_takes_off(tmp_path: Path, kind: dict[str, int]) -> None:
    async with flown(tmp_path, **kind, takeoff=False) as gcs:
        gcs.uplink_delay_s = 0.6
        await begun(gcs)
        await gcs.until(lambda: state(gcs) == "takeoff" or any(sim.armed for sim in gcs.sims), 20.0)
        await gcs.stopped(6.0)
        await asyncio.sleep(15.0)
        assert not any(sim.armed for sim in gcs.sims), [sim.motion.up_m for sim in gcs.sims]
        assert all(sim.motion.up_m < 0.5 for sim in gcs.sims)


@PAIRS
@pytest.mark.parametrize(
    "when", ["takeoff", "engaging", "to_starts", "flying", "stopping", "paused", "aborting", "landing"]
)
async def test_in_the_air_each_holds_or_goes_on_landing(tmp_path: Path, kind: dict[str, int], when: str) -> None:
    async with flown(tmp_path, **kind, takeoff=False) as gcs:
        await begun(gcs)
        if when == "takeoff":
            await gcs.until(lambda: all(sim.motion.up_m > 3.0 for sim in gcs.sims), 60.0)
        elif when in ("engaging", "to_starts"):
            await gcs.until(lambda: state(gcs) == when, 90.0)
        else:
            await gcs.until(lambda: state(gcs) == "flying", 90.0)
            await asyncio.sleep(5.0)
        if when in ("stopping", "paused"):
            await gcs("plan.pause")
            await asyncio.sleep(1.0)
            if when == "paused":
                await gcs.until(lambda: clock_state(gcs) == "paused", 30.0)
                await asyncio.sleep(3.0)
                assert state(gcs) == "paused"
        elif when == "aborting":
            await gcs("plan.abort")
        elif when == "landing":
            await gcs("plan.land")
            await gcs.until(lambda: any("land" in text for text in plan_events(gcs)), 10.0)
            await asyncio.sleep(6.0)
        since = gcs.now
        await gcs.stopped(6.0)
        for name in ("v1", "v2"):
            await gcs.ends_safe(name, within_m=13.0 if when in ("takeoff", "landing") else 5.0, since=since)
        assert least_distance(gcs, 0.0)[0] > MARGIN_M


async def test_a_shutdown_during_the_check_begins_nothing(tmp_path: Path) -> None:
    async with flown(tmp_path, px4=2, takeoff=False) as gcs:
        gcs.uplink_delay_s = 1.0
        task = asyncio.create_task(begun(gcs))
        await asyncio.sleep(1.5)
        await gcs.stopped(6.0)
        await asyncio.gather(task, return_exceptions=True)
        await asyncio.sleep(10.0)
        assert not any(sim.armed for sim in gcs.sims) and state(gcs) in ("loaded", "none")
