"""A vehicle that is dropped in the middle of a plan: nothing waits for it for ever, and the others are safe."""

from __future__ import annotations

import asyncio
from pathlib import Path

import pytest

from support.flown import Flown, flown
from support.planned import MARGIN_M, UP_M, least_distance, run, state, timed


async def begun(gcs: Flown) -> None:
    starts = {f"v{sim.sysid}": (*gcs.place_of_home(f"v{sim.sysid}")[:2], UP_M) for sim in gcs.sims}
    await run(gcs, timed(starts, {name: (x, y + 12.0, UP_M) for name, (x, y, _) in starts.items()}))


async def forget(gcs: Flown, name: str) -> None:
    """As when only a recording holds it any more: nobody's order may do it while a plan is flown. The daemon hears it
    no more either: else its next heartbeat adds it again."""
    gcs.muted.add(gcs.sim(name).sysid)
    refused = (await gcs("vehicles.forget", targets=name, force=True))["outcomes"][name]
    assert not refused["ok"] and "`skygcs-cli plan abort` first" in refused["message"]
    gcs.daemon.fleet.source_changed(gcs.actor(name).vehicle.key)


@pytest.mark.deep
async def test_while_they_arm_nobody_takes_off_and_a_plan_can_be_loaded_again(tmp_path: Path) -> None:
    async with flown(tmp_path, px4=2, takeoff=False) as gcs:
        gcs.uplink_delay_s = 1.0  # longer than it takes to forget it
        await begun(gcs)
        assert state(gcs) == "arming"
        await forget(gcs, "v2")
        await gcs.until(lambda: state(gcs) == "aborted", 10.0)
        assert "v2" in (reason := gcs.daemon.fleet.plans.status()["reason"]) and "it was forgotten" in reason
        await asyncio.sleep(15.0)
        assert not gcs.sim("v1").armed
        assert all(sim.motion.up_m < 0.5 for sim in gcs.sims)
        assert (await gcs("plan.unload"))["ok"]


@pytest.mark.parametrize("when", ["takeoff", "engaging", "to_starts", "flying", "paused"])
async def test_in_the_air_the_others_stop_and_an_abort_ends_it(tmp_path: Path, when: str) -> None:
    async with flown(tmp_path, px4=2, takeoff=False) as gcs:
        await begun(gcs)
        if when == "takeoff":
            await gcs.until(lambda: all(sim.motion.up_m > 3.0 for sim in gcs.sims), 60.0)
        elif when == "paused":
            await gcs.until(lambda: state(gcs) == "flying", 90.0)
            await asyncio.sleep(4.0)
            await gcs("plan.pause")
        else:
            await gcs.until(lambda: state(gcs) == when, 90.0)
        await forget(gcs, "v2")
        await gcs.until(lambda: state(gcs) == "stopped", 5.0)
        assert "it was forgotten" in gcs.daemon.fleet.plans.status()["reason"]
        if when in ("flying", "paused"):
            answer = await gcs("plan.resume")
            assert not answer["ok"] and "v2 was forgotten" in answer["message"], answer
        since = gcs.now
        await gcs("plan.abort")
        await gcs.until(lambda: state(gcs) == "aborted", 15.0)
        await gcs.ends_safe("v1", within_m=13.0, since=since)
        assert least_distance(gcs, 0.0)[0] > MARGIN_M


async def test_an_abort_and_a_landing_end_without_the_one_that_is_forgotten(tmp_path: Path) -> None:
    async with flown(tmp_path, px4=2, takeoff=False) as gcs:
        await begun(gcs)
        await gcs.until(lambda: state(gcs) == "flying", 90.0)
        await gcs("plan.abort")
        await forget(gcs, "v2")
        await gcs.until(lambda: state(gcs) == "aborted", 15.0)
        await gcs("plan.land")
        await gcs.until(lambda: state(gcs) in ("landed", "stopped"), 90.0)
        await gcs.done("vehicles.land", targets="v1")
        await gcs.until(lambda: not gcs.sim("v1").armed, 60.0)
