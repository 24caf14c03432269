"""The emergency stop on its way: through losses, refusals, and other orders."""

from __future__ import annotations

import asyncio
from collections.abc import Callable

import pytest

from skygcs.core.radio_link.transmit_queue import Priority
from skygcs.core.vehicle import offboard_entry
from skygcs.errors import RefusedError
from skygcs.runtime.vehicle_actor import VehicleActor
from support.vehicles import (
    ARDUPILOT,
    PX4,
    PX4_LAND,
    PX4_LOITER,
    PX4_POSCTL,
    Ground,
    ScriptedVehicle,
    Sent,
    accept_everything,
)

pytestmark = pytest.mark.looptime

MODE, LAND, DISARM, PAUSE = 176, 21, 400, 192
BRAKE, GUIDED = 17, 4

Script = Callable[[ScriptedVehicle, Sent], None]


async def flying(ground: Ground, sysid: int = 1, autopilot: int = PX4) -> tuple[ScriptedVehicle, VehicleActor]:
    vehicle = ScriptedVehicle(ground, sysid, autopilot, GUIDED if autopilot == ARDUPILOT else 6 << 16)
    vehicle.armed, vehicle.flying, vehicle.status = True, True, 4
    (actor,) = await ground.met(vehicle)
    await asyncio.sleep(2)
    return vehicle, actor


def deaf(commands: int) -> Script:
    """Hears nothing of so many commands, and does what the next ones say."""
    left = [commands]

    def script(vehicle: ScriptedVehicle, sent: Sent) -> None:
        if sent.name.startswith("COMMAND_") and left[0] > 0:
            left[0] -= 1
        else:
            accept_everything(vehicle, sent)

    return script


@pytest.mark.parametrize(
    ("autopilot", "action", "mode"),
    [(PX4, "hold", PX4_LOITER), (PX4, "land", PX4_LAND), (ARDUPILOT, "hold", BRAKE), (ARDUPILOT, "land", 9)],
)
async def test_a_stop_whose_first_dozen_transmissions_are_lost_is_carried_out_all_the_same(
    autopilot: int, action: str, mode: int
) -> None:
    async with Ground() as ground:
        vehicle, actor = await flying(ground, autopilot=autopilot)
        vehicle.script = deaf(12)
        outcome = await actor.stop(action)  # type: ignore[arg-type]
        assert outcome.ok and outcome.attempts == 13
        assert vehicle.mode == mode
        stops = [s for s in ground.sent if s.name == "COMMAND_LONG" and s.command in (MODE, PAUSE, LAND)]
        assert all(s.priority is Priority.EMERGENCY and s.everywhere for s in stops)


async def test_an_accepted_stop_that_the_heartbeat_does_not_show_is_given_again() -> None:
    def accepts_without_doing(vehicle: ScriptedVehicle, sent: Sent) -> None:
        if sent.name == "COMMAND_LONG" and sent.command == PAUSE:
            vehicle.reply(sent)
            if len(vehicle.commands()) == 2:
                accept_everything(vehicle, sent)

    async with Ground() as ground:
        vehicle, actor = await flying(ground)
        vehicle.script = accepts_without_doing
        outcome = await actor.stop("hold")
        assert outcome.ok and outcome.attempts == 2
        assert [c for c, _ in vehicle.commands()] == [PAUSE, PAUSE]


async def test_a_stop_nobody_hears_is_given_up_in_the_end_and_says_so() -> None:
    async with Ground() as ground:
        vehicle, actor = await flying(ground)
        vehicle.silent = True
        began = ground.loop.time()
        outcome = await actor.stop("land")
        assert (outcome.ok, outcome.result) == (False, "timeout")
        assert 30 <= ground.loop.time() - began < 40
        assert outcome.attempts > 40
        assert [e.text for e in ground.events if e.kind == "command" and e.data["result"] == "in_progress"]


async def test_a_refused_stop_is_told_at_once_and_not_repeated() -> None:
    def refuses(vehicle: ScriptedVehicle, sent: Sent) -> None:
        vehicle.reply(sent, 4)

    async with Ground() as ground:
        vehicle, actor = await flying(ground, autopilot=ARDUPILOT)
        vehicle.script = refuses
        outcome = await actor.stop("hold")
        assert (outcome.result, len(vehicle.commands())) == ("failed", 1)
        assert "stop it with land" in outcome.message


async def test_a_newer_order_takes_the_place_of_a_stop_to_land_but_not_of_a_kill() -> None:
    async with Ground() as ground:
        vehicle, actor = await flying(ground)
        vehicle.script = deaf(1000)
        landing = asyncio.create_task(actor.stop("land"))
        await asyncio.sleep(1)
        vehicle.script = accept_everything
        assert (await actor.stop("hold")).ok
        assert (await landing).result == "cancelled"
        await asyncio.sleep(5)
        assert vehicle.mode == PX4_LOITER, "no repeat of the landing came behind it"
        vehicle.script = deaf(1000)
        kill = asyncio.create_task(actor.stop("kill"))
        await asyncio.sleep(1)
        hold = asyncio.create_task(actor.hold())
        await asyncio.sleep(7)
        vehicle.script = accept_everything
        assert (await kill).ok and not vehicle.armed
        await hold


async def test_another_mode_takes_the_place_of_a_stop_that_nobody_heard_yet() -> None:
    async with Ground() as ground:
        vehicle, actor = await flying(ground)
        vehicle.script = deaf(1000)
        stop = asyncio.create_task(actor.stop("hold"))
        await asyncio.sleep(0.6)
        vehicle.script = accept_everything
        assert (await actor.set_mode("POSCTL", force=True)).ok
        assert (await stop).result == "cancelled"
        await asyncio.sleep(5)
        assert vehicle.mode == PX4_POSCTL


async def test_a_stop_takes_the_place_of_entering_control() -> None:
    async with Ground() as ground:
        vehicle, actor = await flying(ground)
        vehicle.mode = PX4_LOITER
        await asyncio.sleep(2)
        vehicle.script = deaf(1000)
        entering = asyncio.create_task(actor.runner.attempt_in_control(lambda now: offboard_entry.enter(actor.vehicle)))
        await asyncio.sleep(0.2)
        vehicle.script = accept_everything
        assert (await actor.stop("hold")).ok
        assert (await entering).result == "cancelled"
        await asyncio.sleep(8)
        assert vehicle.mode == PX4_LOITER


async def test_a_stop_goes_on_after_its_client_and_to_a_vehicle_that_is_lost_meanwhile() -> None:
    async with Ground() as ground:
        vehicle, actor = await flying(ground)
        vehicle.silent = True
        order = asyncio.create_task(ground.fleet.orders.command_all("1", VehicleActor.stop, action="land"))
        await asyncio.sleep(1)
        order.cancel()
        await asyncio.sleep(10)
        assert not actor.vehicle.connected
        vehicle.silent = False
        await asyncio.sleep(8)
        assert vehicle.mode == PX4_LAND
        reported = [e for e in ground.events if e.kind == "command" and e.data["order"] == "stop"]
        assert reported[-1].data["ok"]


async def test_a_kill_of_the_fleet_wants_the_word_for_all_of_it_and_sends_nothing_without() -> None:
    async with Ground() as ground:
        one, _ = await flying(ground, 1)
        two, _ = await flying(ground, 2, ARDUPILOT)
        for word in (None, "kill-1"):
            with pytest.raises(RefusedError, match="'kill-2'"):
                await ground.fleet.orders.command_all("all", VehicleActor.stop, action="kill", confirm=word)
        assert one.commands() == two.commands() == []
        outcomes = await ground.fleet.orders.command_all("all", VehicleActor.stop, action="kill", confirm="kill-2")
        assert [o.ok for o in outcomes.values()] == [True, True]
        assert one.commands() == two.commands() == [(DISARM, (0.0, 21196.0))]


async def test_each_vehicle_of_a_stop_has_an_outcome_of_its_own() -> None:
    async with Ground() as ground:
        await flying(ground, 1)
        two, _ = await flying(ground, 2)
        two.silent = True
        outcomes = await ground.fleet.orders.command_all("all", VehicleActor.stop, action="hold")
        assert {name: o.result for name, o in outcomes.items()} == {"v1": "accepted", "v2": "timeout"}


async def test_a_parameter_is_asked_for_again_until_it_is_told() -> None:
    def tells_the_third_time(vehicle: ScriptedVehicle, sent: Sent) -> None:
        asked = [s for s in vehicle.got if s.name == "PARAM_REQUEST_READ"]
        if len(asked) == 3:
            assert (sent.param_id, sent.param_index, sent.target_system) == ("GUID_OPTIONS", -1, 1)
            vehicle.tell(vehicle.say(vehicle.mav.param_value_encode(b"GUID_OPTIONS", 8, 6, 1, 0)))

    async with Ground() as ground:
        vehicle, actor = await flying(ground, autopilot=ARDUPILOT)
        vehicle.script = tells_the_third_time
        began = ground.loop.time()
        outcome = await actor.runner.attempt_in_control(lambda now: offboard_entry.ask_parameters(actor.vehicle, now))
        assert outcome.ok, "what it does not tell is optional"
        assert offboard_entry.attitude_refusal(actor.vehicle) is None
        assert actor.vehicle.parameters.reported_at("GUID_OPTIONS") == pytest.approx(began + 1.1)


async def test_a_parameter_that_is_never_told_fails_the_plan_within_its_time() -> None:
    async with Ground() as ground:
        vehicle, actor = await flying(ground, autopilot=ARDUPILOT)
        vehicle.script = lambda *_: None
        outcome = await actor.runner.attempt_in_control(lambda now: offboard_entry.ask_parameters(actor.vehicle, now))
        assert (outcome.ok, outcome.result) == (False, "timeout")
        assert "does not report its parameter GUID_OPTIONS" in outcome.message
        assert len([s for s in vehicle.got if s.name == "PARAM_REQUEST_READ"]) == 6
