"""Orders of a plan and of a person: the one that was asked for later counts, whichever waited."""

from __future__ import annotations

import asyncio
from collections.abc import Sequence
from pathlib import Path
from unittest import mock

from skygcs.core.monitor.departures import Departures
from skygcs.runtime.returns import Returns
from skygcs.runtime.vehicle_actor import VehicleActor
from support.flown import aloft, flown
from support.planned import above, north, phased, plan_events, run, state


async def test_an_order_of_a_plan_that_was_not_heard_is_not_given_again_over_a_later_hold(tmp_path: Path) -> None:
    """It had no number among the orders, and took the vehicle out of a hold that a person had ordered since."""
    async with flown(tmp_path, px4=0, ardupilot=2, takeoff=False) as gcs:
        climbed = above(gcs)
        await run(gcs, phased(above(gcs, up_m=0.0), ("climb", climbed), ("go", north(climbed, 10.0))), by="goto")
        await gcs.until(lambda: state(gcs) == "takeoff", 120.0)
        gcs.loses = frozenset({"COMMAND_INT"})
        since = await gcs.until(lambda: state(gcs) == "engaging", 120.0)
        await gcs.until(lambda: any(text.startswith("goto: ") for text in gcs.texts(since, "command", "v2")), 60.0)
        await gcs.done("vehicles.hold", targets="v2")
        gcs.loses, held = frozenset(), gcs.now
        await asyncio.sleep(15.0)
        assert not gcs.commands(held, "v2"), plan_events(gcs)
        assert any("a newer order took its place" in text for text in plan_events(gcs, held)), plan_events(gcs)


async def test_an_order_that_waited_does_not_take_a_vehicle_from_a_later_plan(tmp_path: Path) -> None:
    async with aloft(tmp_path, px4=0, ardupilot=3) as gcs:
        await gcs.lands("v3")
        await gcs.done("vehicles.takeoff", targets="v3", height_m=25.0)
        (x, y, up), other = gcs.place("v1"), gcs.place("v2")
        goto = asyncio.create_task(gcs("vehicles.goto", targets="v1,v3", enu_m=[x, y - 40.0, up]))
        await asyncio.sleep(0.1)
        assert not goto.done()
        there = {"v1": (x, y + 20.0, up), "v2": (other[0], other[1] + 20.0, up)}
        await run(gcs, phased({"v1": (x, y, up), "v2": other}, ("go", there)), by="goto")
        outcome = (await goto)["outcomes"]["v1"]
        assert not outcome["ok"] and "a newer order" in outcome["message"], outcome
        await gcs.until(lambda: state(gcs) in ("finished", "stopped"), 90.0)
        assert state(gcs) == "finished", plan_events(gcs)


async def test_an_order_of_a_plan_does_not_make_a_later_one_of_a_person_void(tmp_path: Path) -> None:
    """Each order of a plan counted as asked for when the plan gave it: a leg that began while it was decided who
    returns first made the order to return void, and both flew on."""
    decide = Returns._decide

    async def slow(self: Returns, free: Sequence[VehicleActor], **how: bool) -> Departures:
        await asyncio.sleep(8.0)
        return await decide(self, free, **how)

    async with flown(tmp_path, px4=0, ardupilot=2, takeoff=False) as gcs:
        climbed = above(gcs)
        await run(gcs, phased(above(gcs, up_m=0.0), ("climb", climbed), ("go", north(climbed, 10.0))), by="goto")
        since = await gcs.until(lambda: state(gcs) == "engaging", 120.0)
        with mock.patch.object(Returns, "_decide", slow):
            outcomes = (await gcs("vehicles.rtl", targets="v1,v2"))["outcomes"]
        assert len([text for text in gcs.texts(since, "command", "v1") if text.startswith("goto: ")]) == 2
        assert all(outcome["ok"] for outcome in outcomes.values()), outcomes
        await gcs.until(lambda: not any(sim.armed for sim in gcs.sims), 120.0)


async def test_a_trajectory_that_was_asked_for_before_does_not_make_a_return_void(tmp_path: Path) -> None:
    """It is checked for seconds, and its order counted as asked for when it began."""
    decide, checked, decided = Returns._decide, asyncio.Event(), asyncio.Event()

    async def slow_check(*_: object) -> dict[VehicleActor, str]:
        await checked.wait()
        return {}

    async def slow(self: Returns, free: Sequence[VehicleActor], **how: bool) -> Departures:
        await decided.wait()
        return await decide(self, free, **how)

    async with aloft(tmp_path, px4=0, ardupilot=2) as gcs:
        x, y, up = gcs.place("v1")
        t, by_m = 20.0, 10.0
        north = [y, 0.0, 3 * by_m / t**2, -2 * by_m / t**3]
        piece = {"duration_s": t, "x": [x], "y": north, "up": [up], "yaw": [0.0]}
        await gcs("trajectory.load", target="v1", pieces=[piece], name="leg")
        await gcs.fly("position", "v1")
        separation = gcs.daemon.fleet.trajectories._separation
        with (
            mock.patch.object(separation, "trajectory_refusals", slow_check),
            mock.patch.object(Returns, "_decide", slow),
        ):
            starting = asyncio.create_task(gcs.outcome("trajectory.start", "v1"))
            await asyncio.sleep(1.0)
            rtl = asyncio.create_task(gcs("vehicles.rtl", targets="v1,v2"))
            await asyncio.sleep(1.0)
            checked.set()
            assert (await starting)["ok"]
            decided.set()
            outcomes = (await rtl)["outcomes"]
        assert all(outcome["ok"] for outcome in outcomes.values()), outcomes
        await gcs.until(lambda: not any(sim.armed for sim in gcs.sims), 120.0)
