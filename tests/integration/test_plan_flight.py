"""Plans in a whole daemon, from the ground to their end, and each way in which a flight is stopped."""

from __future__ import annotations

import asyncio
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from skygcs.core.plan.margins import MarginRule
from skygcs.errors import RefusedError
from skygcs.ext.plans.flight_preparation import way_down
from skygcs.sim.conditions import Conditions
from support.called import plans_of
from support.flown import PAIRS, Flown, aloft, flown
from support.planned import MARGIN_M, UP_M, above, least_distance, north, northwards, plan_events, run, state

COSTS = "it flies a dozen plans of several vehicles from the ground to their ends"


@pytest.mark.deep
@PAIRS
async def test_a_timed_plan_is_flown_from_the_ground_to_its_end(tmp_path: Path, kind: dict[str, int]) -> None:
    async with flown(tmp_path, **kind, takeoff=False) as gcs:
        starts, began = above(gcs), gcs.now
        await run(gcs, northwards(starts))
        await gcs.until(lambda: state(gcs) in ("finished", "stopped", "aborted"), 180.0)
        assert state(gcs) == "finished"
        await asyncio.sleep(8.0)
        for name, goal in north(starts).items():
            assert math.dist(gcs.place(name), goal) < 0.7
            assert gcs.is_safe(name)
        assert least_distance(gcs, began)[0] > MARGIN_M


def take_away_v2(gcs: Flown, kind: dict[str, int]) -> None:
    """Into AUTO.LOITER, as by a failsafe or a pilot; an ArduCopter into LOITER, which follows the sticks."""
    gcs.other_sets_mode(*((4, 3) if kind["px4"] else (5,)), sysid=2)


async def midway(gcs: Flown, **params: Any) -> float:
    """In the middle of the plan itself; when that was."""
    await run(gcs, northwards(above(gcs)), **params)
    await gcs.until(lambda: state(gcs) == "flying", 120.0)
    await gcs.until(lambda: gcs.place("v1")[1] > 3.0, 30.0)
    return gcs.now


async def test_an_order_to_one_vehicle_stops_all_and_is_named(tmp_path: Path) -> None:
    async with flown(tmp_path, px4=2, takeoff=False) as gcs:
        since = await midway(gcs)
        x_m, y_m, _ = gcs.place("v2")
        await gcs.done("vehicles.goto", targets="v2", enu_m=[x_m, y_m, UP_M + 5.0], force=True)
        await gcs.until(lambda: state(gcs) == "stopped", 5.0)
        (event,) = [t for t in gcs.told if t.kind == "plan" and t.at >= since]
        assert event.vehicle == "v2" and "it was ordered otherwise" in event.text
        await gcs.until(lambda: gcs.place("v2")[2] > UP_M + 4.0, 15.0)


@pytest.mark.deep
@PAIRS
async def test_a_late_vehicle_stops_all_and_the_pair_is_named(tmp_path: Path, kind: dict[str, int]) -> None:
    async with flown(tmp_path, **kind, takeoff=False) as gcs:
        since = await midway(gcs)
        sim = gcs.sim("v2")
        sim.motion.north_m -= 4.0  # a gust carries it back
        await gcs.until(lambda: state(gcs) == "stopped", 5.0)
        (event,) = [t for t in gcs.told if t.kind == "plan" and t.at >= since]
        assert event.vehicle == "v2" and "from its reference" in event.text
        assert [sorted(p["vehicles"]) for p in event.data["pairs"]] == [["v1", "v2"]]
        await gcs.until(lambda: gcs.daemon.fleet.plans.status()["clock"]["state"] == "paused", 5.0)
        await asyncio.sleep(15.0)
        assert state(gcs) == "stopped", "never by itself"
        y_m = gcs.place("v1")[1]
        # it has caught up by now: the clock goes on
        answer = await gcs("plan.resume")
        assert answer["ok"] and "at their places" in answer["message"]
        await gcs.until(lambda: state(gcs) == "finished", 60.0)
        assert gcs.place("v1")[1] > y_m + 2.0


@PAIRS
async def test_a_lost_vehicle_stops_all_and_is_flown_on_with_when_it_is_heard_again(
    tmp_path: Path, kind: dict[str, int]
) -> None:
    async with flown(tmp_path, **kind, takeoff=False) as gcs:
        since = await midway(gcs)
        gcs.muted.add(2)
        await gcs.until(lambda: state(gcs) == "stopped", 8.0)
        assert "v2" in plan_events(gcs, since)[0]
        await asyncio.sleep(4.0)
        refused_ = await gcs("plan.resume")
        assert not refused_["ok"] and any("v2 is silent" in why for why in refused_["reasons"]), refused_
        await asyncio.sleep(10.0)
        gcs.muted.clear()
        await asyncio.sleep(6.0)
        answer = await gcs("plan.resume")
        assert answer["ok"], answer
        await gcs.until(lambda: state(gcs) in ("finished", "stopped"), 90.0)
        assert state(gcs) == "finished", plan_events(gcs)
        assert least_distance(gcs, since)[0] > MARGIN_M


@pytest.mark.deep
async def test_a_resume_that_cannot_be_certified_names_the_pair(tmp_path: Path) -> None:
    async with flown(tmp_path, px4=3, takeoff=False) as gcs:
        starts = above(gcs, "v1", "v2")
        await run(gcs, northwards(starts))
        await gcs.until(lambda: state(gcs) == "flying", 120.0)
        await gcs("plan.pause")
        # one that takes no part flies into the way meanwhile, and stays
        await gcs.done("vehicles.takeoff", targets="v3", height_m=UP_M)
        await gcs.until(lambda: gcs.place("v3")[2] > UP_M - 0.5, 60.0)
        x_m, y_m, _ = north(starts)["v2"]
        await gcs.done("vehicles.goto", targets="v3", enu_m=[x_m, y_m - 3.0, UP_M], force=True)
        await gcs.until(lambda: math.dist(gcs.place("v3"), (x_m, y_m - 3.0, UP_M)) < 0.5, 60.0)
        await asyncio.sleep(3.0)
        answer = await gcs("plan.resume")
        assert not answer["ok"] and any("v2 and v3 come within" in why for why in answer["reasons"]), answer
        assert state(gcs) == "paused"
        await gcs.done("vehicles.land", targets="v3")


@PAIRS
async def test_pause_speed_resume_abort_and_then_land(tmp_path: Path, kind: dict[str, int]) -> None:
    async with flown(tmp_path, **kind, takeoff=False) as gcs:
        await midway(gcs)
        assert (await gcs("plan.pause"))["ok"]
        await gcs.until(lambda: gcs.daemon.fleet.plans.status()["clock"]["state"] == "paused", 5.0)
        await asyncio.sleep(3.0)
        here = gcs.place("v1")
        await asyncio.sleep(5.0)
        assert math.dist(here, gcs.place("v1")) < 0.3 and state(gcs) == "paused"
        with pytest.raises(Exception, match="certified for 1 times"):
            await gcs("plan.speed", speed=1.5)
        await gcs("plan.speed", speed=0.5)
        assert (await gcs("plan.resume"))["ok"]
        await asyncio.sleep(3.0)
        assert gcs.daemon.fleet.plans.status()["clock"]["rate"] == pytest.approx(0.5)
        with pytest.raises(Exception, match="cannot be flown"):
            await gcs("plan.run")
        since = gcs.now
        assert (await gcs("plan.abort"))["ok"]
        await gcs.until(lambda: state(gcs) == "aborted", 15.0)
        for name in ("v1", "v2"):
            await gcs.ends_safe(name, within_m=4.0, since=since)
        with pytest.raises(Exception, match="aborted already"):
            await gcs("plan.abort")
        await gcs("plan.land")
        await gcs.until(lambda: state(gcs) == "landed", 120.0)
        await gcs.until(lambda: not any(sim.armed for sim in gcs.sims), 10.0)


async def test_the_tracking_error_of_the_fleet_file_widens_the_tube(tmp_path: Path) -> None:
    tables = {"vehicles": {"v1": {"sysid": 1, "separation": {"tracking_error_m": 1.3}}}}
    async with aloft(tmp_path, px4=2, tables=tables) as gcs:
        await run(gcs, northwards(above(gcs)))
        report = (await gcs("plan.status"))["vehicles"]
        tubes = {vehicle["vehicle"]: vehicle["tube_m"] for vehicle in report}
        assert tubes["v1"] == pytest.approx(tubes["v2"] + 0.9)


async def test_a_barrier_that_was_passed_is_enough_for_the_next_step(tmp_path: Path) -> None:
    """Within its tube, but farther from its place than a trajectory of its own might begin."""
    control = {"trajectory": {"start_within_m": 0.1}}
    async with flown(tmp_path, px4=2, control=control, conditions=Conditions(gps_noise_m=0.25)) as gcs:
        await run(gcs, northwards(above(gcs)))
        await gcs.until(lambda: state(gcs) in ("finished", "stopped", "aborted"), 180.0)
        assert state(gcs) == "finished", (await gcs("plan.status"))["reason"]


@PAIRS
async def test_a_landing_takes_along_one_that_left_and_holds_but_not_one_that_a_pilot_flies(
    tmp_path: Path, kind: dict[str, int]
) -> None:
    async with flown(tmp_path, **kind, takeoff=False) as gcs:
        since = await midway(gcs)
        take_away_v2(gcs, kind)
        await gcs.until(lambda: state(gcs) == "stopped", 5.0)
        await asyncio.sleep(5.0)
        await gcs("plan.land")
        await gcs.until(lambda: state(gcs) in ("landed", "stopped"), 120.0)
        assert state(gcs) == "landed"
        landed = ["v1", "v2"] if kind["px4"] else ["v1"]
        await gcs.until(lambda: not any(gcs.sim(name).armed for name in landed), 10.0)
        if "v2" not in landed:
            assert gcs.sim("v2").armed
            assert any("v2: flown by a pilot" in text for text in plan_events(gcs, since))


async def test_a_landing_whose_certificate_cannot_be_made_leaves_them_and_force_lands_them(tmp_path: Path) -> None:
    async with flown(tmp_path, px4=2, takeoff=False) as gcs:
        await midway(gcs)

        async def broken(*_: Any) -> Any:
            raise RefusedError("the planning process is busy")

        plans = gcs.daemon.fleet.plans
        plans_of(gcs.daemon).runner.work = broken
        await gcs("plan.land")
        await gcs.until(lambda: state(gcs) == "stopped", 15.0)
        assert "the planning process is busy" in plans.status()["reason"]
        await asyncio.sleep(3.0)
        await gcs("plan.land", force=True)
        await gcs.until(lambda: state(gcs) == "landed", 120.0)


@pytest.mark.deep
async def test_a_check_meanwhile_does_not_change_the_margins_by_which_a_flight_is_landed(tmp_path: Path) -> None:
    async with flown(tmp_path, px4=2, takeoff=False) as gcs:
        await midway(gcs)
        runner = plans_of(gcs.daemon).runner
        work, landed_by = runner.work, list[MarginRule]()

        async def noted(function: Callable[..., Any], *arguments: Any) -> Any:
            if function is way_down:
                landed_by.append(arguments[2])
            return await work(function, *arguments)

        await gcs("plan.check", margin_m=MARGIN_M + 10.0)
        runner.work = noted
        await gcs("plan.land")
        await gcs.until(lambda: state(gcs) == "landed", 120.0)
        assert [rule.fixed_m for rule in landed_by] == [MARGIN_M]


async def test_a_fault_of_what_checks_a_plan_stops_it_on_its_way(tmp_path: Path) -> None:
    async with flown(tmp_path, px4=2, takeoff=False) as gcs:
        await midway(gcs)

        def fails() -> None:
            raise KeyError("v7")

        plans_of(gcs.daemon).runner.tick = fails  # type: ignore[method-assign]
        await asyncio.sleep(3.0)
        here = gcs.place("v1")
        await asyncio.sleep(5.0)
        assert math.dist(here, gcs.place("v1")) < 0.3 and here[1] < 11.0
        faults = [told for told in gcs.told if told.kind == "fault"]
        assert len(faults) == 1 and "v7" in faults[0].text
        gcs.told.remove(faults[0])
