"""A vehicle that is dropped, and a daemon that is stopped, in each part of a plan.

Nothing waits for ever, nobody is left armed on the ground, and who flies is safe.
"""

from __future__ import annotations

import asyncio
from pathlib import Path

import pytest

from support.flown import PAIRS, Flown, flown
from support.planned import MARGIN_M, above, least_distance, northwards, plan_events, reach, run, state


async def begun(gcs: Flown) -> None:
    await run(gcs, northwards(above(gcs)))


async def forget(gcs: Flown, name: str) -> None:
    """As when only a recording holds it any more: nobody's order may do it while a plan is flown. The daemon hears it
    no more either: else its next heartbeat adds it again."""
    gcs.muted.add(gcs.sim(name).sysid)
    refused = (await gcs("vehicles.forget", targets=name, force=True))["outcomes"][name]
    assert not refused["ok"] and "`skygcs-cli plan abort` first" in refused["message"]
    gcs.daemon.fleet.source_changed(gcs.actor(name).vehicle.key)


@pytest.mark.deep
async def test_one_forgotten_while_they_arm_lets_nobody_take_off_and_a_plan_can_be_loaded_again(tmp_path: Path) -> None:
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
async def test_one_forgotten_in_the_air_stops_the_others_and_an_abort_ends_it(tmp_path: Path, when: str) -> None:
    async with flown(tmp_path, px4=2, takeoff=False) as gcs:
        await begun(gcs)
        await reach(gcs, when)
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


def clock_state(gcs: Flown) -> str:
    clock = gcs.daemon.fleet.plans.status()["clock"]
    return "none" if clock is None else str(clock["state"])


@PAIRS
async def test_a_shutdown_while_they_arm_disarms_them_and_nobody_takes_off(
    tmp_path: Path, kind: dict[str, int]
) -> None:
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
async def test_a_shutdown_in_the_air_lets_each_hold_or_go_on_landing(
    tmp_path: Path, kind: dict[str, int], when: str
) -> None:
    async with flown(tmp_path, **kind, takeoff=False) as gcs:
        await begun(gcs)
        await reach(gcs, "paused" if when == "stopping" else when)
        if when == "paused":
            await gcs.until(lambda: clock_state(gcs) == "paused", 30.0)
            await asyncio.sleep(3.0)
            assert state(gcs) == "paused"
        elif when == "landing":
            await gcs.until(lambda: any("land" in text for text in plan_events(gcs)), 10.0)
            await asyncio.sleep(6.0)
        elif when == "stopping":
            await asyncio.sleep(1.0)
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
