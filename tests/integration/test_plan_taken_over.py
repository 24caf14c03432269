"""A pilot takes one vehicle over in each phase of a plan: the others stop, and nobody takes it from him."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from pathlib import Path
from typing import Any
from unittest import mock

import pytest

from skygcs.sim.firmware_modes import CopterMode
from support.called import plans_of
from support.flown import Flown, flown
from support.planned import MARGIN_M, UP_M, above, here, least_distance, load, north, northwards, reach, run, state

LOITER = (4, 3)
"""PX4's AUTO.LOITER, as a pilot or another station sets it."""

COPTER_LOITER = 5
"""ArduCopter's LOITER."""


@pytest.mark.deep
@pytest.mark.parametrize("when", ["takeoff", "to_starts", "flying", "paused", "aborting", "landing"])
async def test_a_pilot_keeps_what_he_took_and_the_others_are_safe(tmp_path: Path, when: str) -> None:
    async with flown(tmp_path, px4=2, takeoff=False) as gcs:
        # the starts are away from where they take off, so that there is a way to them
        await run(gcs, northwards(north(above(gcs), 6.0)))
        await reach(gcs, when)
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


async def held_up(gcs: Flown, order: str, **params: Any) -> tuple[asyncio.Task[Any], asyncio.Event]:
    """An order to a plan whose certificate is being made, and what lets it be ready."""
    runner = plans_of(gcs.daemon).runner
    work, began, ready = runner.work, asyncio.Event(), asyncio.Event()

    async def slow(function: Callable[..., Any], *arguments: Any) -> Any:
        began.set()
        await ready.wait()
        return await work(function, *arguments)

    runner.work = slow
    asked = asyncio.create_task(gcs(order, **params))
    await began.wait()
    return asked, ready


async def left_to_pilot(gcs: Flown, since: float) -> None:
    """Nobody takes v2 from LOITER, and the plan does not go on."""
    await gcs.until(lambda: state(gcs) == "stopped", 20.0)
    await asyncio.sleep(5.0)
    assert gcs.actor("v2").vehicle.mode == "LOITER"
    assert not gcs.setpoints(since, "v2")


async def taken_by_pilot(gcs: Flown) -> float:
    """Switch v2 to LOITER, which follows the sticks; when that is seen."""
    gcs.other_sets_mode(COPTER_LOITER, sysid=2)
    await gcs.until(lambda: gcs.actor("v2").vehicle.mode == "LOITER", 10.0)
    await asyncio.sleep(1.0)
    return gcs.now


async def test_one_that_its_pilot_takes_while_a_plan_is_checked_is_left_to_him(tmp_path: Path) -> None:
    async with flown(tmp_path, px4=0, ardupilot=2) as gcs:
        await load(gcs, northwards(here(gcs), 6.0))
        asked, ready = await held_up(gcs, "plan.run", margin_m=MARGIN_M, force=True)
        since = await taken_by_pilot(gcs)
        ready.set()
        await asked
        await left_to_pilot(gcs, since)
        assert "switched to LOITER before it was under control" in gcs.daemon.fleet.plans.status()["reason"]


async def test_one_that_its_pilot_takes_while_a_plan_is_certified_anew_is_left_to_him(tmp_path: Path) -> None:
    async with flown(tmp_path, px4=0, ardupilot=2) as gcs:
        await run(gcs, northwards(here(gcs)))
        await gcs.until(lambda: state(gcs) == "flying", 90.0)
        await asyncio.sleep(3.0)
        gcs.sim("v2").motion.north_m -= 6.0  # a gust: there is a way back
        await gcs.until(lambda: state(gcs) == "stopped", 20.0)
        await asyncio.sleep(8.0)
        asked, ready = await held_up(gcs, "plan.resume")
        since = await taken_by_pilot(gcs)
        ready.set()
        answer = await asked
        assert not answer["ok"] and "v2 left while the certificate was made" in answer["message"]
        await left_to_pilot(gcs, since)


async def fly_to_the_end(gcs: Flown) -> None:
    """A plan of v1 and v2 has been flown, and they hold at its goals."""
    await run(gcs, northwards(here(gcs), 6.0))
    await gcs.until(lambda: state(gcs) == "finished", 120.0)


@pytest.mark.parametrize("kind", [{"px4": 0, "ardupilot": 2}])
async def test_a_landing_leaves_him_the_one_that_he_has_taken_since_the_end(
    tmp_path: Path, kind: dict[str, int]
) -> None:
    """The plan was over, so nobody looked: his vehicle was landed."""
    async with flown(tmp_path, **kind) as gcs:
        await fly_to_the_end(gcs)
        gcs.other_sets_mode(COPTER_LOITER, sysid=2)
        await gcs.until(lambda: gcs.actor("v2").vehicle.mode == "LOITER", 10.0)
        since = gcs.now
        await gcs("plan.land")
        await gcs.until(lambda: not gcs.actor("v1").vehicle.armed, 120.0)
        assert gcs.actor("v2").vehicle.mode == "LOITER" and gcs.place("v2")[2] > UP_M - 1.0
        assert any("v2: flown by a pilot or lost, and not landed" in text for text in gcs.texts(since, "plan", "v2"))


@pytest.mark.parametrize("kind", [{"px4": 2}, {"px4": 0, "ardupilot": 2}])
async def test_a_landing_that_is_aborted_holds(tmp_path: Path, kind: dict[str, int]) -> None:
    """LAND was taken for a mode that the plan had not set: it answered ok, and they went on down."""
    async with flown(tmp_path, **kind) as gcs:
        await fly_to_the_end(gcs)
        await gcs("plan.land", force=True)
        await gcs.until(lambda: all(sim.motion.up_m < UP_M - 2.0 for sim in gcs.sims), 60.0)
        assert (await gcs("plan.abort"))["ok"]
        await gcs.until(lambda: state(gcs) == "aborted", 20.0)
        await asyncio.sleep(10.0)
        assert all(gcs.actor(name).vehicle.armed and gcs.place(name)[2] > 3.0 for name in ("v1", "v2"))
        await gcs("plan.land", force=True)
        await gcs.until(lambda: state(gcs) == "landed", 120.0)


@pytest.mark.parametrize("kind", [{"px4": 0, "ardupilot": 2}])
async def test_one_that_he_takes_before_its_round_is_not_landed(tmp_path: Path, kind: dict[str, int]) -> None:
    async with flown(tmp_path, **kind) as gcs:
        await fly_to_the_end(gcs)
        flight = plans_of(gcs.daemon).runner.flight
        assert flight is not None
        real = flight.execution.landing
        flight.execution.landing = lambda rounds, others=(): real([["v1"], ["v2"]], others)
        await gcs("plan.land", force=True)
        await asyncio.sleep(3.0)
        gcs.other_sets_mode(COPTER_LOITER, sysid=2)
        await gcs.until(lambda: state(gcs) == "stopped", 120.0)
        await asyncio.sleep(10.0)
        assert not gcs.actor("v1").vehicle.armed
        assert gcs.actor("v2").vehicle.mode == "LOITER" and gcs.place("v2")[2] > UP_M - 1.0


@pytest.mark.parametrize("kind", [{"px4": 0, "ardupilot": 2}])
async def test_a_landing_takes_along_one_that_its_failsafe_switched_to_sticks_that_nobody_has(
    tmp_path: Path, kind: dict[str, int]
) -> None:
    async with flown(tmp_path, **kind) as gcs:
        await fly_to_the_end(gcs)
        await asyncio.sleep(5.0)
        gcs.sim("v2").mode = CopterMode.ALT_HOLD
        await gcs.until(lambda: gcs.actor("v2").vehicle.mode == "ALT_HOLD", 10.0)
        with mock.patch.object(type(gcs.actor("v2").vehicle), "failsafe", True):
            await gcs("plan.land", force=True)
            await gcs.until(lambda: state(gcs) == "landed", 120.0)
        assert not any(sim.armed and sim.motion.up_m > 1.0 for sim in gcs.sims)
