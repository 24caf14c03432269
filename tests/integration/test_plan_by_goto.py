"""Phased plans by goto: one order for each leg, nothing streamed, and what a lost order, a lost ground station, a pilot
and a stop do to it."""

from __future__ import annotations

import asyncio
import math
from pathlib import Path
from typing import Any

import pytest

from support.flown import SETPOINTS, Flown, flown
from support.planned import MARGIN_M, above, least_distance, load, northwards, plan_events, run, state, swap

COPTER_LOITER = 5
"""ArduCopter's LOITER, which follows the sticks."""

OVER = ("finished", "stopped", "aborted")


async def crossing(gcs: Flown, **params: Any) -> float:
    """While both cross; when that was."""
    await run(gcs, swap(gcs), by="goto", **params)
    await gcs.until(lambda: gcs.daemon.fleet.plans.status()["phase"] == "cross" and state(gcs) == "flying", 120.0)
    await gcs.until(lambda: gcs.place("v1")[0] > 1.5, 30.0)
    return gcs.now


@pytest.mark.deep
async def test_the_ground_that_dies_in_a_leg_leaves_all_at_rest_at_its_ends(tmp_path: Path) -> None:
    async with flown(tmp_path, px4=1, ardupilot=1, takeoff=False) as gcs:
        plan = swap(gcs)
        await crossing(gcs)
        since = gcs.now
        gcs.cut = True
        await asyncio.sleep(40.0)
        for name, (_, goal) in plan.legs()[1][1].items():
            assert math.dist(gcs.place(name), goal) < 0.7 and gcs.is_safe(name)
        assert least_distance(gcs, since)[0] > MARGIN_M
        assert state(gcs) == "stopped", plan_events(gcs)
        # heard again, it goes on from there
        gcs.cut = False
        await asyncio.sleep(8.0)
        answer = await gcs("plan.resume")
        assert answer["ok"], answer
        await gcs.until(lambda: state(gcs) in OVER, 90.0)
        assert state(gcs) == "finished", plan_events(gcs)


async def test_one_that_its_pilot_takes_before_it_hears_its_first_order_is_not_ordered_again(tmp_path: Path) -> None:
    async with flown(tmp_path, px4=0, ardupilot=2, takeoff=False) as gcs:
        gcs.loses = frozenset({"COMMAND_INT"})
        await run(gcs, swap(gcs), by="goto")
        await gcs.until(lambda: state(gcs) == "engaging", 120.0)
        await asyncio.sleep(4.0)
        gcs.other_sets_mode(COPTER_LOITER, sysid=2)
        await gcs.until(lambda: gcs.actor("v2").vehicle.mode == "LOITER", 10.0)
        await asyncio.sleep(1.0)
        gcs.loses = frozenset()
        await gcs.until(lambda: state(gcs) == "stopped", 60.0)
        await asyncio.sleep(15.0)
        assert gcs.actor("v2").vehicle.mode == "LOITER"


async def test_another_order_to_one_vehicle_stops_all(tmp_path: Path) -> None:
    async with flown(tmp_path, px4=2, takeoff=False) as gcs:
        since = await crossing(gcs)
        x, y, _ = gcs.place("v2")
        await gcs("vehicles.goto", targets="v2", enu_m=[x, y, 25.0], force=True)
        await gcs.until(lambda: state(gcs) == "stopped", 5.0)
        assert "v2 left: it was ordered otherwise" in " ".join(plan_events(gcs, since))


async def test_pause_holds_all_on_their_legs_resume_flies_on_and_a_landing_is_certified(tmp_path: Path) -> None:
    async with flown(tmp_path, px4=1, ardupilot=1, takeoff=False) as gcs:
        began = await crossing(gcs)
        await gcs("plan.pause")
        await asyncio.sleep(12.0)
        assert state(gcs) == "paused" and gcs.is_safe("v1") and gcs.is_safe("v2")
        assert 1.0 < gcs.place("v1")[0] < 4.5, gcs.place("v1")
        with pytest.raises(Exception, match="own speed"):
            await gcs("plan.speed", speed=0.5)
        answer = await gcs("plan.resume")
        assert answer["ok"] and "at their places" in answer["message"], answer
        await gcs.until(lambda: state(gcs) in OVER, 90.0)
        assert state(gcs) == "finished", plan_events(gcs, began)
        assert least_distance(gcs, began)[0] > MARGIN_M and not [s for s in gcs.sent if s.name in SETPOINTS]
        await gcs("plan.land")
        await gcs.until(lambda: state(gcs) == "landed", 120.0)


async def test_one_that_is_carried_away_stops_all_and_flies_back_to_its_leg(tmp_path: Path) -> None:
    async with flown(tmp_path, px4=1, ardupilot=1, takeoff=False) as gcs:
        since = await crossing(gcs)
        gcs.sim("v2").motion.north_m -= 4.0
        await gcs.until(lambda: state(gcs) == "stopped", 5.0)
        assert "v2 is 4." in plan_events(gcs, since)[0] and "from its way" in plan_events(gcs, since)[0]
        await asyncio.sleep(8.0)
        answer = await gcs("plan.resume")
        assert answer["ok"] and "going back" in answer["message"], answer
        await gcs.until(lambda: state(gcs) in OVER, 120.0)
        assert state(gcs) == "finished", plan_events(gcs)
        assert least_distance(gcs, since)[0] > MARGIN_M


async def test_ways_that_cannot_be_flown_are_refused_with_the_command_that_helps(tmp_path: Path) -> None:
    async with flown(tmp_path, px4=2, takeoff=False) as gcs:
        await load(gcs, northwards(above(gcs)))
        with pytest.raises(Exception, match="skygcs-cli plan make FILE --fleet --kind phased"):
            await gcs("plan.check", by="goto")
        with pytest.raises(Exception, match=r"no vehicle has a companion.*skygcs-cli plan run FILE --by setpoints"):
            await gcs("plan.check", by="onboard")
        found = await gcs("plan.check", margin_m=MARGIN_M)
        assert (found["by"], found["why"]) == ("setpoints", "every link carries them")
