from __future__ import annotations

import asyncio
import math
from collections.abc import Callable

import pytest

from skygcs.core.protocols.command import RETRY_TIMERS_S
from skygcs.core.radio_link.transmit_queue import Priority
from skygcs.runtime import home_orders
from skygcs.runtime.vehicle_actor import VehicleActor
from support.vehicles import (
    ARDUPILOT,
    HOME,
    PX4,
    PX4_LOITER,
    PX4_POSCTL,
    Ground,
    ScriptedVehicle,
    Sent,
    accept_everything,
)

pytestmark = pytest.mark.looptime

ARM, MODE, TAKEOFF, LAND, RTL, REPOSITION = 400, 176, 22, 21, 20, 192


def refusing(command: int, result: int, text: str = "", severity: int = 2) -> Callable[[ScriptedVehicle, Sent], None]:
    """Does everything but one command."""

    def script(vehicle: ScriptedVehicle, sent: Sent) -> None:
        if sent.name.startswith("COMMAND_") and sent.command == command:
            vehicle.reply(sent, result)
            if text:
                vehicle.tell(vehicle.text(text, severity), 0.005)
        else:
            accept_everything(vehicle, sent)

    return script


async def one(ground: Ground, autopilot: int = PX4, **keywords: object) -> tuple[ScriptedVehicle, VehicleActor]:
    vehicle = ScriptedVehicle(ground, 1, autopilot, **keywords)  # type: ignore[arg-type]
    (actor,) = await ground.met(vehicle)
    return vehicle, actor


async def flying(ground: Ground, autopilot: int = PX4) -> tuple[ScriptedVehicle, VehicleActor]:
    vehicle, actor = await one(ground, autopilot)
    vehicle.armed, vehicle.flying, vehicle.status = True, True, 4
    vehicle.mode = PX4_LOITER if autopilot == PX4 else 4
    await asyncio.sleep(2)
    return vehicle, actor


async def test_arming_is_accepted_only_once_the_heartbeat_says_so() -> None:
    async with Ground() as ground:
        vehicle, actor = await one(ground)
        outcome = await actor.arm()
        assert (outcome.ok, outcome.result, outcome.message, outcome.attempts) == (True, "accepted", "armed", 1)
        assert actor.vehicle.armed
        assert vehicle.commands() == [(ARM, (1.0, 0.0))]
        assert (vehicle.got[0].target_system, vehicle.got[0].target_component) == (1, 1)
        assert [e.data["order"] for e in ground.events if e.kind == "command"] == ["arm"]


async def test_an_acknowledged_arming_that_does_not_happen_is_no_success() -> None:
    async with Ground() as ground:
        vehicle, actor = await one(ground)
        vehicle.script = lambda v, sent: v.reply(sent)
        outcome = await actor.arm()
        assert (outcome.ok, outcome.result) == (False, "timeout")
        assert outcome.message == "timeout: accepted, but still disarmed"


async def test_a_refused_arming_says_why() -> None:
    async with Ground() as ground:
        vehicle, actor = await one(ground, ARDUPILOT)
        vehicle.script = refusing(ARM, 4, "Arm: Throttle too high")
        outcome = await actor.arm()
        assert (outcome.result, outcome.message) == ("failed", "failed: Arm: Throttle too high")
        assert outcome.status_texts == ("Arm: Throttle too high",)


def estimates(vehicle: ScriptedVehicle, for_s: int, after_s: float = 0.0) -> None:
    """It knows where it is."""
    for second in range(for_s):
        vehicle.tell(vehicle.estimate(), after_s + second)


NO_POSITION = 167
"""Attitude, vertical position and the constant position mode: a copter without GPS."""


async def test_a_copter_is_armed_to_fly_when_it_knows_where_it_is_and_at_once_without_wait() -> None:
    async with Ground() as ground:
        vehicle, actor = await one(ground, ARDUPILOT)
        vehicle.tell(vehicle.estimate(NO_POSITION))
        for second in range(12):
            vehicle.tell(vehicle.estimate(NO_POSITION), second)
        estimates(vehicle, 30, after_s=12)
        outcome = await actor.arm(wait_s=30)
        assert outcome.ok and 11 <= outcome.elapsed_s <= 15, outcome
        assert [c for c, _ in vehicle.commands()].count(ARM) == 1
    async with Ground() as ground:
        vehicle, actor = await one(ground, ARDUPILOT)
        vehicle.tell(vehicle.estimate(NO_POSITION))
        outcome = await actor.arm(wait_s=4)
        assert not outcome.ok and "no position yet" in outcome.message and not vehicle.armed
        assert ARM not in [c for c, _ in vehicle.commands()]
        assert (await actor.arm()).ok and vehicle.armed


async def test_an_estimator_that_tells_nothing_is_asked() -> None:
    async with Ground() as ground:
        vehicle, actor = await one(ground, ARDUPILOT)

        def script(v: ScriptedVehicle, sent: Sent) -> None:
            accept_everything(v, sent)
            if sent.command == 512 and sent.param1 == 193:
                v.tell(v.estimate(), 0.01)

        vehicle.script = script
        assert (await actor.arm(wait_s=10)).ok
        assert [c for c, _ in vehicle.commands()] == [512, ARM]
    async with Ground() as ground:
        vehicle, actor = await one(ground, PX4)
        assert (await actor.arm(wait_s=10)).ok
        assert [c for c, _ in vehicle.commands()] == [ARM]


async def test_arming_with_wait_is_tried_every_second_until_it_works() -> None:
    async with Ground() as ground:
        vehicle, actor = await one(ground, ARDUPILOT)
        estimates(vehicle, 60)
        await asyncio.sleep(0.5)
        vehicle.script = refusing(ARM, 4, "Arm: Need Position Estimate")
        ready_at = ground.loop.time() + 12
        ground.loop.call_at(ready_at, setattr, vehicle, "script", accept_everything)
        outcome = await actor.arm(wait_s=30)
        assert outcome.ok
        assert 12 <= outcome.elapsed_s <= 15
        assert 11 <= outcome.attempts <= 14
        assert [e.kind for e in ground.events].count("command") == 1


async def test_arming_with_wait_gives_up_in_time_with_the_last_refusal() -> None:
    async with Ground() as ground:
        vehicle, actor = await one(ground, ARDUPILOT)
        estimates(vehicle, 60)
        await asyncio.sleep(0.5)
        vehicle.script = refusing(ARM, 4, "Arm: Need Position Estimate")
        outcome = await actor.arm(wait_s=5)
        assert outcome.message == "failed: Arm: Need Position Estimate"
        assert outcome.elapsed_s <= 6


async def test_arming_with_wait_ends_at_once_for_a_reason_that_time_does_not_cure() -> None:
    async with Ground() as ground:
        vehicle, actor = await one(ground, ARDUPILOT)
        estimates(vehicle, 60)
        await asyncio.sleep(0.5)
        vehicle.script = refusing(ARM, 4, "Arm: LAND mode not armable")
        outcome = await actor.arm(wait_s=60)
        assert outcome.elapsed_s < 2
        assert outcome.message.startswith("failed: Arm: LAND mode not armable; set another mode first: skygcs-cli mode")


async def test_a_lost_command_is_repeated_with_its_count_and_a_lost_ack_does_no_harm() -> None:
    async with Ground() as ground:
        vehicle, actor = await one(ground)
        heard: list[int] = []

        def deaf_twice(v: ScriptedVehicle, sent: Sent) -> None:
            heard.append(sent.confirmation)
            if len(heard) == 3:
                accept_everything(v, sent)

        vehicle.script = deaf_twice
        outcome = await actor.arm()
        assert outcome.ok
        assert heard == [0, 1, 2]
        assert outcome.attempts == 3


async def test_an_order_that_worked_is_a_success_though_every_ack_is_lost() -> None:
    async with Ground() as ground:
        vehicle, actor = await one(ground)

        def mute(v: ScriptedVehicle, sent: Sent) -> None:
            v.armed = True

        vehicle.script = mute
        outcome = await actor.arm()
        assert (outcome.ok, outcome.attempts) == (True, 1)
        assert outcome.elapsed_s < 2.1


async def test_a_takeoff_whose_acknowledgement_was_lost_is_not_sent_again() -> None:
    async with Ground() as ground:
        vehicle, actor = await one(ground, ARDUPILOT, mode=4)
        vehicle.armed = True
        await asyncio.sleep(1.5)

        def first_ack_is_lost_and_the_repeat_refused(v: ScriptedVehicle, sent: Sent) -> None:
            if sent.confirmation == 0:
                ground.loop.call_later(1.3, lift_off, v)
            else:
                v.reply(sent, 4, after_s=0.5)

        def lift_off(v: ScriptedVehicle) -> None:
            v.flying, v.status = True, 4
            v.pulse()

        vehicle.script = first_ack_is_lost_and_the_repeat_refused
        outcome = await actor.takeoff(10)
        assert outcome.ok, outcome.message
        assert outcome.attempts == 1, "its state showed that it was done"


async def test_silence_is_a_timeout_after_all_repeats() -> None:
    async with Ground() as ground:
        vehicle, actor = await one(ground)
        vehicle.script = lambda v, sent: None
        outcome = await actor.reboot()
        assert (outcome.result, outcome.attempts) == ("timeout", len(RETRY_TIMERS_S))
        longest_s = sum(RETRY_TIMERS_S) + len(RETRY_TIMERS_S)  # each waits for a heartbeat that shows it was not done
        assert sum(RETRY_TIMERS_S) <= outcome.elapsed_s <= longest_s


async def test_a_vehicle_lost_in_the_middle_ends_its_orders() -> None:
    async with Ground() as ground:
        vehicle, actor = await flying(ground)
        vehicle.script = lambda v, sent: None
        vehicle.silent = True
        await asyncio.sleep(4)
        outcome = await actor.rtl()
        assert outcome.result == "lost"
        assert "no heartbeat" in outcome.message
        outcome = await actor.rtl()
        assert (outcome.result, outcome.attempts) == ("refused", 0)
        assert "lost" in outcome.message


async def test_no_link_is_told_from_no_answer() -> None:
    async with Ground() as ground:
        _, actor = await one(ground)
        ground.links_up = False
        outcome = await actor.reboot()
        assert (outcome.result, outcome.attempts) == ("lost", 0)
        assert "no link" in outcome.message


async def test_a_mode_is_set_by_name_and_verified() -> None:
    async with Ground() as ground:
        vehicle, actor = await one(ground)
        outcome = await actor.set_mode("posctl")
        assert (outcome.ok, outcome.message) == (True, "mode POSCTL")
        assert vehicle.commands() == [(MODE, (1.0, 3.0))]
        assert actor.vehicle.mode == "POSCTL"


async def test_a_mode_that_is_accepted_but_not_entered_is_told_with_the_one_it_is_in() -> None:
    async with Ground() as ground:
        vehicle, actor = await one(ground, ARDUPILOT)
        vehicle.script = lambda v, sent: v.reply(sent)
        outcome = await actor.set_mode("GUIDED")
        assert outcome.message.endswith("timeout: accepted, but still in STABILIZE")
        assert vehicle.got[0].param2 == 4


async def test_an_unknown_mode_is_refused_with_near_ones_and_nothing_is_sent() -> None:
    async with Ground() as ground:
        vehicle, actor = await one(ground, ARDUPILOT)
        outcome = await actor.set_mode("GIUDED")
        assert outcome.result == "refused"
        assert "did you mean GUIDED" in outcome.message
        assert vehicle.got == []


async def test_px4_takes_off_to_an_amsl_altitude_after_leaving_a_manual_mode() -> None:
    async with Ground() as ground:
        vehicle, actor = await one(ground, PX4, mode=PX4_POSCTL)
        outcome = await actor.takeoff(10)
        assert (outcome.ok, outcome.message) == (True, "taking off to 10 m")
        assert [c for c, _ in vehicle.commands()] == [MODE, ARM, TAKEOFF]
        assert outcome.attempts == 1  # three steps, none of them repeated
        assert (vehicle.got[0].param2, vehicle.got[0].param3) == (4, 3)
        takeoff = vehicle.got[-1]
        assert takeoff.param7 == pytest.approx(HOME[2] + 10)
        assert all(math.isnan(getattr(takeoff, f"param{n}")) for n in (4, 5, 6))


async def test_px4_in_loiter_keeps_it_until_takeoff() -> None:
    async with Ground() as ground:
        vehicle, actor = await one(ground, PX4)
        assert (await actor.takeoff(10)).ok
        assert [c for c, _ in vehicle.commands()] == [ARM, TAKEOFF]


@pytest.mark.parametrize("sub_mode", [2, 4, 5, 6])
async def test_px4_is_never_armed_in_an_auto_mode_that_flies_by_itself(sub_mode: int) -> None:
    """AUTO.TAKEOFF, MISSION, RTL, LAND: armed there, it would start off before it is told to."""
    async with Ground() as ground:
        vehicle, actor = await one(ground, PX4, mode=4 << 16 | sub_mode << 24)
        armed_in: list[int] = []

        def watch(v: ScriptedVehicle, sent: Sent) -> None:
            if sent.command == ARM:
                armed_in.append(v.mode)
            accept_everything(v, sent)

        vehicle.script = watch
        assert (await actor.takeoff(10)).ok
        assert [c for c, _ in vehicle.commands()] == [MODE, ARM, TAKEOFF]
        assert armed_in == [PX4_LOITER]


async def test_repeats_and_orders_that_end_a_flight_go_over_every_link() -> None:
    async with Ground() as ground:
        vehicle, actor = await flying(ground)
        vehicle.script = lambda v, sent: accept_everything(v, sent) if sent.confirmation == 1 else None
        assert (await actor.command("DO_SET_SERVO", [1.0], force=True)).ok
        assert [s.everywhere for s in vehicle.got] == [False, True]
        vehicle.script = accept_everything
        vehicle.got.clear()
        for order in (actor.land, actor.rtl, actor.hold):
            vehicle.mode = PX4_POSCTL
            assert (await order()).ok
        assert (await actor.disarm(force=True)).ok
        vehicle.flying = False
        vehicle.armed = True
        await asyncio.sleep(2)
        assert (await actor.disarm()).ok
        assert [s.everywhere for s in vehicle.got] == [True] * 5


async def test_arducopter_takes_off_from_guided_to_a_relative_height() -> None:
    async with Ground() as ground:
        vehicle, actor = await one(ground, ARDUPILOT)
        assert (await actor.takeoff(12)).ok
        assert [c for c, _ in vehicle.commands()] == [MODE, ARM, TAKEOFF]
        assert vehicle.got[0].param2 == 4
        assert [getattr(vehicle.got[-1], f"param{n}") for n in range(1, 8)] == [0, 0, 0, 0, 0, 0, 12]


async def test_the_fleet_files_height_is_the_default() -> None:
    config = {"vehicles": {"alpha": {"sysid": 1, "takeoff_height_m": 3.5}}}
    async with Ground(config) as ground:
        vehicle, actor = await one(ground, ARDUPILOT)
        assert (await actor.takeoff(None)).message == "taking off to 3.5 m"
        assert vehicle.got[-1].param7 == 3.5


async def test_a_takeoff_refused_after_arming_disarms_again() -> None:
    async with Ground() as ground:
        vehicle, actor = await one(ground, ARDUPILOT)
        vehicle.script = refusing(TAKEOFF, 4, "Takeoff: bad throttle")
        outcome = await actor.takeoff(10)
        assert outcome.message == "takeoff: failed: Takeoff: bad throttle; disarm again"
        assert vehicle.commands()[-1] == (ARM, (0.0, 0.0))
        assert not actor.vehicle.armed


async def test_a_takeoff_refused_while_armed_before_leaves_it_armed() -> None:
    async with Ground() as ground:
        vehicle, actor = await one(ground, ARDUPILOT, mode=4)
        vehicle.armed = True
        await asyncio.sleep(1.5)
        vehicle.script = refusing(TAKEOFF, 4)
        outcome = await actor.takeoff(10)
        assert not outcome.ok
        assert [c for c, _ in vehicle.commands()] == [TAKEOFF]


async def test_a_refused_arming_ends_a_takeoff_before_it_begins() -> None:
    async with Ground() as ground:
        vehicle, actor = await one(ground)
        vehicle.script = refusing(ARM, 1, "Preflight Fail: low battery")
        outcome = await actor.takeoff(10)
        assert outcome.message.startswith("arm: temporarily rejected: Preflight Fail: low battery; ")
        assert TAKEOFF not in [c for c, _ in vehicle.commands()]


@pytest.mark.parametrize("height", [0.0, -1.0, 501.0, math.nan, math.inf])
async def test_takeoff_heights_out_of_range_are_refused(height: float) -> None:
    async with Ground() as ground:
        vehicle, actor = await one(ground)
        assert (await actor.takeoff(height)).result == "refused"
        assert vehicle.got == []


async def test_takeoff_without_arming_needs_an_armed_vehicle() -> None:
    async with Ground() as ground:
        _, actor = await one(ground)
        outcome = await actor.takeoff(5, arm=False)
        assert outcome.result == "refused"
        assert "not armed" in outcome.message


async def test_takeoff_in_the_air_and_disarm_in_the_air_are_refused() -> None:
    async with Ground() as ground:
        vehicle, actor = await flying(ground)
        assert "in the air already" in (await actor.takeoff(5)).message
        outcome = await actor.disarm()
        assert outcome.result == "refused"
        assert "--force" in outcome.message
        assert vehicle.got == []


async def test_a_forced_disarm_goes_out_as_an_emergency_even_to_a_lost_vehicle() -> None:
    async with Ground() as ground:
        vehicle, actor = await flying(ground)
        vehicle.silent = True
        await asyncio.sleep(10)
        assert not actor.vehicle.connected
        before = len(ground.sent)
        outcome = await actor.disarm(force=True)
        sent = ground.sent[before:]
        assert outcome.result == "timeout"
        assert {s.priority for s in sent} == {Priority.EMERGENCY}
        assert {(s.param1, s.param2) for s in sent} == {(0.0, 21196.0)}
        assert len(sent) == 7


async def test_an_emergency_goes_on_when_the_vehicle_is_lost_meanwhile() -> None:
    async with Ground() as ground:
        vehicle, actor = await flying(ground)
        vehicle.silent = True
        await asyncio.sleep(3)
        assert actor.vehicle.connected
        outcome = await actor.disarm(force=True)
        assert not actor.vehicle.connected
        assert (outcome.result, outcome.attempts) == ("timeout", 7)


async def test_a_takeoff_that_fails_after_a_newer_order_does_not_disarm_under_it() -> None:
    async with Ground() as ground:
        vehicle, actor = await one(ground, ARDUPILOT, mode=4)

        def slow_refusal(v: ScriptedVehicle, sent: Sent) -> None:
            if sent.command == TAKEOFF:
                heard.set()
                v.reply(sent, 4, after_s=0.8)
            else:
                accept_everything(v, sent)

        heard = asyncio.Event()
        vehicle.script = slow_refusal
        takeoff = asyncio.create_task(actor.takeoff(10))
        await heard.wait()
        assert (await actor.set_mode("ALT_HOLD")).ok
        assert not (await takeoff).ok
        await asyncio.sleep(3)
        assert (ARM, (0.0, 0.0)) not in vehicle.commands()


@pytest.mark.parametrize("order", ["land", "rtl", "hold"])
async def test_a_vehicle_on_the_ground_need_not_enter_the_mode_it_accepted(order: str) -> None:
    async with Ground() as ground:
        vehicle, actor = await one(ground, ARDUPILOT)
        vehicle.script = lambda v, sent: v.reply(sent)
        assert (await getattr(actor, order)()).ok
        vehicle.armed, vehicle.flying, vehicle.status = True, True, 4
        await asyncio.sleep(1.5)
        outcome = await getattr(actor, order)()
        assert outcome.message.endswith("timeout: accepted, but still in STABILIZE")


async def test_a_forced_disarm_takes_the_place_of_a_takeoff_in_the_making() -> None:
    async with Ground() as ground:
        vehicle, actor = await one(ground, ARDUPILOT)
        vehicle.script = lambda v, sent: v.reply(sent) if sent.command == MODE else accept_everything(v, sent)
        takeoff = asyncio.create_task(actor.takeoff(10))
        await asyncio.sleep(0.5)
        assert (await actor.disarm(force=True)).ok
        vehicle.mode = 4
        outcome = await takeoff
        assert outcome.result == "cancelled"
        assert [c for c, p in vehicle.commands() if c == ARM and p[0] == 1.0] == []
        assert TAKEOFF not in [c for c, _ in vehicle.commands()]


async def test_a_landing_takes_the_place_of_a_takeoff_in_the_making() -> None:
    async with Ground() as ground:
        vehicle, actor = await one(ground, ARDUPILOT)
        vehicle.delay_s = 0.3
        takeoff = asyncio.create_task(actor.takeoff(10))
        await asyncio.sleep(0.4)
        land = await actor.land()
        assert land.ok, land.message
        assert (await takeoff).result == "cancelled"
        assert TAKEOFF not in [c for c, _ in vehicle.commands()]


@pytest.mark.parametrize(("autopilot", "mode"), [(PX4, "AUTO.LAND"), (ARDUPILOT, "LAND")])
async def test_land_is_the_same_command_for_both(autopilot: int, mode: str) -> None:
    async with Ground() as ground:
        vehicle, actor = await flying(ground, autopilot)
        assert (await actor.land()).ok
        assert [c for c, _ in vehicle.commands()] == [LAND]
        assert actor.vehicle.mode == mode


async def test_hold_is_brake_and_then_guided_on_arducopter_and_loiter_on_px4() -> None:
    async with Ground() as ground:
        copter, actor = await flying(ground, ARDUPILOT)
        outcome = await actor.hold()
        assert (outcome.ok, outcome.message) == (True, "holding in GUIDED")
        assert copter.commands() == [(MODE, (1.0, 17.0)), (MODE, (1.0, 4.0))]
        assert (await actor.stop("hold")).message == "holding in BRAKE"
    async with Ground() as ground:
        px4, actor = await flying(ground, PX4)
        px4.mode = PX4_POSCTL
        await asyncio.sleep(1.5)
        assert (await actor.hold()).ok
        assert px4.commands() == [(192, (-1.0, 1.0))]  # DO_REPOSITION to nowhere


@pytest.mark.parametrize(("refused", "said"), [(17.0, "does nothing else instead"), (4.0, "it holds in BRAKE")])
async def test_a_hold_that_is_refused_says_what_it_does_instead(refused: float, said: str) -> None:
    async with Ground() as ground:
        copter, actor = await flying(ground, ARDUPILOT)

        def script(v: ScriptedVehicle, sent: Sent) -> None:
            if sent.command == MODE and sent.param2 == refused:
                v.reply(sent, 4)
            else:
                accept_everything(v, sent)

        copter.script = script
        outcome = await actor.hold()
        assert not outcome.ok and said in outcome.message


async def test_a_hold_in_place_of_one_order_waits_for_a_newer_one_and_is_refused_if_that_is_accepted() -> None:
    async with Ground() as ground:
        copter, actor = await flying(ground, ARDUPILOT)
        went = await actor.goto(lat_deg=HOME[0] + 1e-4, lon_deg=HOME[1], height_m=10.0)
        assert went.order_number is not None and went.as_dict()["order_number"] == went.order_number
        landing = asyncio.create_task(actor.land())
        await asyncio.sleep(0)
        held = await actor.hold(instead_of=went.order_number)
        landed = await landing
        assert landed.ok and landed.order_number == went.order_number + 1
        assert held.result == "refused" and f"number {landed.order_number}" in held.message
        assert MODE not in [c for c, _ in copter.commands()]
        assert (await actor.hold(instead_of=landed.order_number)).ok, "that is the newest one"


async def test_a_hold_in_place_of_one_order_is_sent_if_the_vehicle_refuses_the_newer_one() -> None:
    async with Ground() as ground:
        copter, actor = await flying(ground, ARDUPILOT)
        went = await actor.goto(lat_deg=HOME[0] + 1e-4, lon_deg=HOME[1], height_m=10.0)
        copter.script = refusing(LAND, 4)
        landing = asyncio.create_task(actor.land())
        await asyncio.sleep(0)
        held = await actor.hold(instead_of=went.order_number)
        assert not (await landing).ok and held.ok and held.message == "holding in GUIDED"


async def test_a_hold_in_place_of_one_order_waits_while_a_newer_one_is_repeated() -> None:
    """Between two of its attempts nothing is in progress."""
    async with Ground() as ground:
        copter, actor = await one(ground, ARDUPILOT)
        before = actor.order_number
        copter.script = refusing(TAKEOFF, 4)
        taking_off = asyncio.create_task(actor.takeoff(5.0, wait_s=20.0))
        await asyncio.sleep(4.0)
        held = asyncio.create_task(actor.hold(instead_of=before))
        await asyncio.sleep(4.0)
        assert not held.done()
        copter.script = accept_everything
        assert (await taking_off).ok
        assert (await held).result == "refused"


@pytest.mark.parametrize("how", ["answers lost", "client gone", "mode not shown"])
async def test_a_hold_in_place_of_one_order_is_refused_after_a_newer_one_that_may_move_the_vehicle(how: str) -> None:
    """The newer one was sent. It was counted only if it was accepted, and the landing was broken off by BRAKE."""
    async with Ground() as ground:
        copter, actor = await flying(ground, ARDUPILOT)
        went = await actor.goto(lat_deg=HOME[0] + 1e-4, lon_deg=HOME[1], height_m=10.0)

        def script(v: ScriptedVehicle, sent: Sent) -> None:
            if sent.command == LAND and how == "mode not shown":
                v.reply(sent, 0)
            elif sent.command != LAND:
                accept_everything(v, sent)

        copter.script = script
        landing = asyncio.create_task(actor.land())
        await asyncio.sleep(0.1)
        if how == "client gone":
            landing.cancel()
        held = await actor.hold(instead_of=went.order_number)
        assert held.result == "refused" and "or may move it" in held.message
        if how != "client gone":
            assert not (await landing).ok
        assert MODE not in [c for c, _ in copter.commands()]
        assert (await actor.hold(instead_of=actor.order_number)).ok, "that is the newest one"


async def test_a_number_of_another_run_of_skygcs_names_no_order() -> None:
    async with Ground() as ground:
        _, actor = await flying(ground, ARDUPILOT)
        went = await actor.goto(lat_deg=HOME[0] + 1e-4, lon_deg=HOME[1], height_m=10.0)
        assert went.order_number is not None and went.order_number > 1_600_000_000_000, "ms since 1970"
    async with Ground() as ground:
        copter, actor = await flying(ground, ARDUPILOT)
        assert (await actor.goto(lat_deg=HOME[0] + 1e-4, lon_deg=HOME[1], height_m=10.0)).ok
        for number in (0, 1, went.order_number - 1, actor.order_number + 1):
            held = await actor.hold(instead_of=number)
            assert held.result == "refused" and f"no order {number}" in held.message
        assert MODE not in [c for c, _ in copter.commands()]


async def test_an_order_that_moves_nothing_has_no_number() -> None:
    async with Ground() as ground:
        _, actor = await one(ground, ARDUPILOT)
        assert "order_number" not in (await actor.arm()).as_dict()


NEAR = {"lat_deg": HOME[0] + 1e-4, "lon_deg": HOME[1] - 1e-4}
TARGET = (512, 87.0)
"""REQUEST_MESSAGE of POSITION_TARGET_GLOBAL_INT."""


async def test_px4_goes_somewhere_by_one_reposition_to_an_amsl_altitude() -> None:
    async with Ground() as ground:
        vehicle, actor = await flying(ground, PX4)
        assert (await actor.goto(**NEAR, height_m=25.0, yaw_deg=90.0)).ok
        (sent,) = vehicle.got
        assert (sent.name, sent.command, sent.frame) == ("COMMAND_INT", REPOSITION, 0)
        assert (sent.x, sent.y) == (round(NEAR["lat_deg"] * 1e7), round(NEAR["lon_deg"] * 1e7))
        assert sent.z == pytest.approx(HOME[2] + 25.0)
        assert (sent.param1, sent.param2) == (-1.0, 1.0)
        assert sent.param4 == pytest.approx(math.pi / 2)


async def test_arducopter_goes_somewhere_by_one_reposition_to_a_relative_height() -> None:
    async with Ground() as ground:
        vehicle, actor = await flying(ground, ARDUPILOT)
        assert (await actor.goto(**NEAR, height_m=25.0)).ok
        sent, asked = vehicle.got
        assert (sent.name, sent.command, sent.frame, sent.z) == ("COMMAND_INT", REPOSITION, 3, 25.0)
        assert (asked.command, asked.param1) == TARGET


def another_target(vehicle: ScriptedVehicle, sent: Sent) -> None:
    """A setpoint that was on its way took the place of each but the last goto: then it reports no target."""
    accept_everything(vehicle, sent)
    gotos = [s for s in vehicle.got if s.command == REPOSITION]
    if sent.command == REPOSITION and len(gotos) < 3:
        vehicle.target = None


async def test_a_goto_that_an_arducopter_accepted_and_does_not_fly_is_sent_again() -> None:
    async with Ground() as ground:
        vehicle, actor = await flying(ground, ARDUPILOT)
        vehicle.script = another_target
        outcome = await actor.goto(**NEAR, height_m=25.0)
        assert (outcome.ok, outcome.attempts) == (True, 3), outcome.message
        assert [c for c, _ in vehicle.commands()] == [REPOSITION, TARGET[0]] * 3


async def test_a_goto_sent_again_cannot_take_the_vehicle_from_its_pilot() -> None:
    async with Ground() as ground:
        vehicle, actor = await flying(ground, ARDUPILOT)
        vehicle.script = another_target
        assert (await actor.goto(**NEAR, height_m=25.0)).ok
        changes_mode = [s.param2 for s in vehicle.got if s.command == REPOSITION]
        assert changes_mode == [1.0, 0.0, 0.0], "denied by an ArduCopter that is not in GUIDED any more"


async def test_a_vehicle_that_its_pilot_took_over_is_not_sent_there_again() -> None:
    async with Ground() as ground:
        vehicle, actor = await flying(ground, ARDUPILOT)

        def taken_over(v: ScriptedVehicle, sent: Sent) -> None:
            if sent.command != TARGET[0]:
                accept_everything(v, sent)
            else:
                v.mode = 2  # ALT_HOLD

        vehicle.script = taken_over
        outcome = await actor.goto(**NEAR, height_m=25.0)
        assert (outcome.ok, outcome.attempts) == (False, 1)
        assert "it is in ALT_HOLD now" in outcome.message
        assert len([s for s in vehicle.got if s.command == REPOSITION]) == 1


async def test_a_goto_that_an_arducopter_never_flies_has_failed_after_two_repeats() -> None:
    async with Ground() as ground:
        vehicle, actor = await flying(ground, ARDUPILOT)

        def stays(v: ScriptedVehicle, sent: Sent) -> None:
            accept_everything(v, sent)
            v.target = (round(HOME[0] * 1e7), round(HOME[1] * 1e7), HOME[2] + 25.0)  # of another program

        vehicle.script = stays
        outcome = await actor.goto(**NEAR, height_m=25.0)
        assert (outcome.result, outcome.attempts) == ("timeout", 3)
        assert "accepted, but it does not report that it flies there" in outcome.message
        assert len([s for s in vehicle.got if s.command == REPOSITION]) == 3


async def test_a_goto_without_a_reported_target_is_believed_when_the_vehicle_comes_nearer() -> None:
    async with Ground() as ground:
        vehicle, actor = await flying(ground, ARDUPILOT)

        def unreported(v: ScriptedVehicle, sent: Sent) -> None:
            accept_everything(v, sent)
            v.target = None
            if sent.command == REPOSITION:
                v.place = (HOME[0] + 2e-5, HOME[1])  # 2 m of the 11

        vehicle.script = unreported
        outcome = await actor.goto(lat_deg=HOME[0] + 1e-4, lon_deg=HOME[1], height_m=10.0)
        assert (outcome.ok, outcome.attempts) == (True, 1), outcome.message


async def test_after_a_hold_the_target_is_asked_for_when_its_repeats_can_come_no_more() -> None:
    async with Ground() as ground:
        vehicle, actor = await flying(ground, ARDUPILOT)
        assert (await actor.hold()).ok
        vehicle.got.clear()
        held_at = asyncio.get_running_loop().time()
        asked_at = []

        def late(v: ScriptedVehicle, sent: Sent) -> None:
            accept_everything(v, sent)
            if sent.command == TARGET[0]:
                asked_at.append(asyncio.get_running_loop().time() - held_at)

        vehicle.script = late
        assert (await actor.goto(**NEAR, height_m=25.0)).ok
        assert asked_at == [pytest.approx(1.5, abs=0.3)]


async def test_a_newer_order_ends_the_proof_of_a_goto_that_was_accepted() -> None:
    async with Ground() as ground:
        vehicle, actor = await flying(ground, ARDUPILOT)

        def silent(v: ScriptedVehicle, sent: Sent) -> None:
            if sent.command != TARGET[0]:
                accept_everything(v, sent)

        vehicle.script = silent
        goto = asyncio.create_task(actor.goto(**NEAR, height_m=25.0))
        await asyncio.sleep(0.5)
        assert (await actor.rtl()).ok
        outcome = await goto
        assert (outcome.ok, outcome.attempts) == (True, 1), outcome.message
        assert len([s for s in vehicle.got if s.command == REPOSITION]) == 1


async def test_no_goto_is_sent_again_while_the_daemon_ends() -> None:
    async with Ground() as ground:
        vehicle, actor = await flying(ground, ARDUPILOT)
        vehicle.script = lambda v, sent: None if sent.command == TARGET[0] else accept_everything(v, sent)
        goto = asyncio.create_task(actor.goto(**NEAR, height_m=25.0))
        await asyncio.sleep(0.5)
        await actor.wind_down()
        outcome = await goto
        assert (outcome.ok, outcome.attempts) == (True, 1), outcome.message
        assert len([s for s in vehicle.got if s.command == REPOSITION]) == 1


async def test_arducopter_turns_by_a_command_of_its_own() -> None:
    async with Ground() as ground:
        vehicle, actor = await flying(ground, ARDUPILOT)
        assert (await actor.goto(**NEAR, height_m=25.0, yaw_deg=-90.0)).ok
        assert [c for c, _ in vehicle.commands()] == [REPOSITION, TARGET[0], 115]
        assert vehicle.got[2].param1 == 270.0


async def test_a_goto_keeps_the_height_it_is_at_unless_told() -> None:
    async with Ground() as ground:
        vehicle, actor = await flying(ground, ARDUPILOT)
        assert (await actor.goto(**NEAR)).ok
        assert vehicle.got[0].z == pytest.approx(10.0)


async def test_a_goto_in_enu_is_about_the_fleets_origin_for_vehicles_with_any_home() -> None:
    config = {"origin": {"lat_deg": HOME[0], "lon_deg": HOME[1], "alt_amsl_m": 400.0}}
    async with Ground(config) as ground:
        vehicle, actor = await flying(ground, PX4)
        assert (await actor.goto(enu_m=[30.0, 40.0, 120.0])).ok
        assert vehicle.got[0].z == pytest.approx(520.0, abs=0.01)
        assert vehicle.got[0].x == pytest.approx((HOME[0] + 40 / 111_180) * 1e7, abs=50)
        copter_config_height = 520.0 - HOME[2]
    async with Ground(config) as ground:
        copter, actor = await flying(ground, ARDUPILOT)
        assert (await actor.goto(enu_m=[30.0, 40.0, 120.0])).ok
        assert copter.got[0].z == pytest.approx(copter_config_height, abs=0.01)


async def test_old_arducopter_without_reposition_is_sent_one_guided_target_and_asked_for_it() -> None:
    from pymavlink.dialects.v20 import ardupilotmega as mav

    async with Ground() as ground:
        vehicle, actor = await flying(ground, ARDUPILOT)

        def old(v: ScriptedVehicle, sent: Sent) -> None:
            if sent.name == "SET_POSITION_TARGET_GLOBAL_INT":
                target = (sent.lat_int, sent.lon_int, sent.alt)
                there = mav.MAVLink_position_target_global_int_message(1, 6, sent.type_mask, *target, *[0.0] * 8)
                v.tell(v.say(there), 0.2)
            elif sent.command == REPOSITION:
                v.reply(sent, 3)
            else:
                accept_everything(v, sent)

        vehicle.script = old
        outcome = await actor.goto(**NEAR, height_m=25.0)
        assert outcome.ok, outcome.message
        (target,) = [s for s in vehicle.got if s.name == "SET_POSITION_TARGET_GLOBAL_INT"]
        assert (target.type_mask, target.coordinate_frame, target.alt) == (0xDF8, 6, 25.0)
        assert (target.lat_int, target.lon_int) == (round(NEAR["lat_deg"] * 1e7), round(NEAR["lon_deg"] * 1e7))
        # what it has said that it lacks is not tried a second time
        assert (await actor.goto(**NEAR, height_m=26.0)).ok
        assert [s.name for s in vehicle.got].count("COMMAND_INT") == 1


@pytest.mark.parametrize(
    ("place", "said"),
    [
        ({"lat_deg": 0.0, "lon_deg": 0.0, "height_m": 1}, "zero coordinate"),
        ({"lat_deg": HOME[0], "lon_deg": 0.0}, "zero coordinate"),
        ({"lat_deg": 0.0, "lon_deg": HOME[1]}, "zero coordinate"),
        ({"lat_deg": 1.8e-6, "lon_deg": 2.2e-5, "height_m": 1}, "beyond what any vehicle can reach"),
        ({"lat_deg": HOME[0] + 0.1, "lon_deg": HOME[1], "height_m": 1}, "limit is 1000 m"),
        ({"lat_deg": 91.0, "lon_deg": 8.0}, "not a position on earth"),
        ({"lat_deg": HOME[0], "lon_deg": 181.0}, "not a position on earth"),
        ({"lat_deg": math.nan, "lon_deg": HOME[1]}, "not a position on earth"),
        ({**NEAR, "height_m": math.nan}, "not between"),
        ({**NEAR, "yaw_deg": math.inf}, "not between"),
        ({**NEAR, "height_m": 1100.0}, "limit is 1000 m"),
        ({**NEAR, "height_m": -3.0}, "3.0 m below its home"),
        ({**NEAR, "height_m": 0.0}, "use land, or insist with force"),
        ({**NEAR, "height_m": 0.9}, "use land, or insist with force"),
        ({"height_m": 0}, "use land, or insist with force"),
        ({"lat_deg": HOME[0] + 0.1, "lon_deg": HOME[1]}, "--force"),
        ({"lat_deg": HOME[0]}, "both latitude and longitude"),
        ({}, "give a place"),
        ({"enu_m": [1.0, 2.0, 3.0]}, "no origin"),
        ({"enu_m": [1.0, 2.0]}, "three numbers"),
        ({"enu_m": [1.0, 2.0, 3.0], "lat_deg": 1.0}, "either"),
    ],
)
async def test_places_that_cannot_be_meant_are_refused_and_nothing_is_sent(place: dict, said: str) -> None:  # type: ignore[type-arg]
    async with Ground() as ground:
        vehicle, actor = await flying(ground, PX4)
        outcome = await actor.goto(**place)
        assert outcome.result == "refused"
        assert said in outcome.message
        assert vehicle.got == []


async def test_force_overrides_the_distance_but_never_a_zero_coordinate() -> None:
    async with Ground() as ground:
        vehicle, actor = await flying(ground, PX4)
        assert (await actor.goto(lat_deg=HOME[0] + 0.1, lon_deg=HOME[1], force=True)).ok
        assert (await actor.goto(lat_deg=0.0, lon_deg=HOME[1], force=True)).result == "refused"
        assert (await actor.goto(**NEAR, height_m=1e30, force=True)).result == "refused"
        assert len(vehicle.got) == 1


async def test_a_goto_needs_an_armed_flying_vehicle_with_a_fresh_position() -> None:
    async with Ground() as ground:
        vehicle, actor = await one(ground)
        assert "disarmed" in (await actor.goto(**NEAR)).message
        vehicle.armed = True
        await asyncio.sleep(1.5)
        assert "on the ground" in (await actor.goto(**NEAR)).message
        assert vehicle.got == []


async def test_reboot_of_an_armed_vehicle_needs_force_and_arducopter_a_magic_number() -> None:
    async with Ground() as ground:
        vehicle, actor = await flying(ground, ARDUPILOT)
        outcome = await actor.reboot()
        assert outcome.result == "refused"
        assert "--force" in outcome.message
        assert (await actor.reboot(force=True)).ok
        assert (vehicle.got[0].command, vehicle.got[0].param1, vehicle.got[0].param6) == (246, 1.0, 20190226.0)


async def test_a_reboot_whose_ack_was_lost_is_known_by_the_reboot_itself() -> None:
    async with Ground() as ground:
        vehicle, actor = await one(ground)
        vehicle.script = lambda v, sent: v.restart(3.0) if not sent.confirmation else None
        outcome = await actor.reboot()
        assert outcome.ok, outcome.message
        await asyncio.sleep(10)
        outcome = await home_orders.set_home(actor)
        assert (outcome.result, outcome.message) == ("lost", "the vehicle rebooted")


async def test_home_is_set_here_or_at_a_place() -> None:
    async with Ground() as ground:
        vehicle, actor = await one(ground)
        assert (await home_orders.set_home(actor)).ok
        assert (vehicle.got[0].name, vehicle.got[0].command, vehicle.got[0].param1) == ("COMMAND_LONG", 179, 1.0)
        assert (await home_orders.set_home(actor, lat_deg=HOME[0], lon_deg=HOME[1])).ok
        assert (vehicle.got[1].name, vehicle.got[1].x, vehicle.got[1].frame) == ("COMMAND_INT", 473977420, 0)
        assert vehicle.got[1].z == pytest.approx(HOME[2])
        assert (await home_orders.set_home(actor, lat_deg=HOME[0])).result == "refused"
        assert (await home_orders.set_home(actor, lat_deg=0.0, lon_deg=0.0, alt_amsl_m=1.0)).result == "refused"


async def test_a_home_farther_than_the_limit_is_refused_unless_insisted_on() -> None:
    """A return to launch would fly there."""
    async with Ground() as ground:
        vehicle, actor = await one(ground)
        far = {"lat_deg": HOME[0] + 0.1, "lon_deg": HOME[1]}
        outcome = await home_orders.set_home(actor, **far)
        assert outcome.result == "refused"
        assert "it would return there" in outcome.message and "--force" in outcome.message
        assert vehicle.got == []
        assert (await home_orders.set_home(actor, **far, force=True)).ok


async def test_home_is_not_moved_in_the_air_unless_insisted_on() -> None:
    async with Ground() as ground:
        vehicle, actor = await flying(ground)
        for place in ({}, {"lat_deg": HOME[0], "lon_deg": HOME[1]}):
            outcome = await home_orders.set_home(actor, **place)
            assert outcome.result == "refused"
            assert "in the air" in outcome.message and "--force" in outcome.message
        assert vehicle.got == []
        assert (await home_orders.set_home(actor, force=True)).ok


async def test_a_refusal_without_a_reason_says_what_was_refused() -> None:
    async with Ground() as ground:
        vehicle, actor = await one(ground)
        vehicle.script = lambda v, sent: v.reply(sent, 2)
        messages = [
            (await actor.set_message_interval("EKF_STATUS_REPORT", 1)).message,
            (await actor.request_message("EKF_STATUS_REPORT")).message,
            (await home_orders.set_home(actor)).message,
            (await actor.takeoff(5)).message,
        ]
        assert messages == [
            "denied: PX4 does not stream EKF_STATUS_REPORT",
            "denied: PX4 does not send EKF_STATUS_REPORT on request",
            "denied: PX4 gave no reason (set home)",
            "arm: denied: PX4 gave no reason (arm)",
        ]


@pytest.mark.parametrize(
    ("rate", "interval_us", "said"), [(4.0, 250_000, "4 Hz"), (0.0, -1, "off"), (None, 0, "default rate")]
)
async def test_message_intervals_are_microseconds(rate: float | None, interval_us: float, said: str) -> None:
    async with Ground() as ground:
        vehicle, actor = await one(ground)
        outcome = await actor.set_message_interval("attitude", rate)
        assert (outcome.ok, outcome.message) == (True, said)
        assert vehicle.commands() == [(511, (30.0, interval_us))]


async def test_rates_and_messages_that_do_not_exist_are_refused() -> None:
    async with Ground() as ground:
        vehicle, actor = await one(ground)
        assert "no message 'ATITUDE'" in (await actor.set_message_interval("ATITUDE", 1)).message
        assert (await actor.set_message_interval("ATTITUDE", -1)).result == "refused"
        assert (await actor.set_message_interval("ATTITUDE", math.nan)).result == "refused"
        assert "POSITION" in (await actor.request_stream("POSISION", 1)).message
        assert vehicle.got == []


async def test_a_stream_request_is_sent_once_without_acknowledgement() -> None:
    async with Ground() as ground:
        vehicle, actor = await one(ground, ARDUPILOT)
        outcome = await actor.request_stream("position", 2)
        assert outcome.ok
        assert "no acknowledgement" in outcome.message
        await asyncio.sleep(1)
        (sent,) = vehicle.got
        assert (sent.req_stream_id, sent.req_message_rate, sent.start_stop) == (6, 2, 1)


async def test_a_requested_message_is_a_success_when_it_has_come() -> None:
    async with Ground() as ground:
        vehicle, actor = await one(ground)

        def answer(v: ScriptedVehicle, sent: Sent) -> None:
            v.reply(sent)
            v.tell(v.system_time(1000), 0.4)

        vehicle.script = answer
        assert (await actor.request_message("SYSTEM_TIME")).message == "SYSTEM_TIME came"
        latest = actor.latest("SYSTEM_TIME")
        assert latest is not None
        assert (latest["fields"]["time_boot_ms"], latest["count"]) == (1000, 1)
        vehicle.script = accept_everything
        assert (await actor.request_message("ATTITUDE")).message == "timeout: accepted, but no ATTITUDE came"
        assert actor.latest("ATTITUDE") is None


async def test_any_command_goes_by_name_or_number_with_unset_parameters() -> None:
    async with Ground() as ground:
        vehicle, actor = await one(ground)
        assert (await actor.command("do_set_servo", [9, 1500])).message == "DO_SET_SERVO accepted"
        assert (await actor.command(31010, [None, 2.0])).ok
        assert (await actor.command("MAV_CMD_DO_SET_ROI_LOCATION", [], int_frame=6, x=473977420, y=85455940, z=5.0)).ok
        assert vehicle.commands()[0] == (183, (9.0, 1500.0))
        assert vehicle.got[1].command == 31010 and math.isnan(vehicle.got[1].param1)
        assert (vehicle.got[2].name, vehicle.got[2].frame, vehicle.got[2].x) == ("COMMAND_INT", 6, 473977420)
        assert "did you mean" in (await actor.command("DO_SET_SERVOO", [])).message
        assert (await actor.command(183, [0.0] * 8)).result == "refused"
        assert (await actor.command(183, [], x=1)).result == "refused"
        assert "param1" in (await actor.command(183, [1e300])).message
        assert "32 bits" in (await actor.command(183, [], int_frame=0, x=1 << 31)).message


async def test_progress_is_reported_and_waited_for() -> None:
    async with Ground() as ground:
        vehicle, actor = await one(ground)

        def slow(v: ScriptedVehicle, sent: Sent) -> None:
            for n in range(6):
                v.reply(sent, 5, after_s=2.0 * n, progress=20 * n)
            v.reply(sent, 0, after_s=12.0)

        vehicle.script = slow
        outcome = await actor.command("PREFLIGHT_CALIBRATION", [1])
        assert outcome.ok
        percents = [e.data["percent"] for e in ground.events if e.data.get("result") == "in_progress"]
        assert percents == [0, 20, 40, 60, 80, 100]
        assert len(vehicle.got) == 1


async def test_one_command_of_an_id_is_in_flight_and_the_next_waits_its_turn() -> None:
    async with Ground() as ground:
        vehicle, actor = await one(ground, delay_s=0.2)
        overlap: list[int] = []
        open_now = 0

        def watch(v: ScriptedVehicle, sent: Sent) -> None:
            nonlocal open_now
            open_now += 1
            overlap.append(open_now)
            ground.loop.call_later(0.3, done, v, sent)

        def done(v: ScriptedVehicle, sent: Sent) -> None:
            nonlocal open_now
            open_now -= 1
            v.reply(sent)

        vehicle.script = watch
        outcomes = await asyncio.gather(*(actor.set_message_interval(n, 1) for n in (30, 31, 32, 33)))
        assert all(o.ok for o in outcomes)
        assert overlap == [1, 1, 1, 1]
        assert [p[0] for _, p in vehicle.commands()] == [30, 31, 32, 33]


async def test_too_many_waiting_are_refused() -> None:
    async with Ground() as ground:
        vehicle, actor = await one(ground)
        vehicle.script = lambda v, sent: None
        tasks = [asyncio.create_task(actor.set_message_interval(30, 1)) for _ in range(10)]
        await asyncio.sleep(0.1)
        assert [t.done() for t in tasks].count(True) == 1
        assert tasks[9].result().result == "refused"
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)


async def test_a_late_ack_of_a_command_given_up_does_not_pass_for_the_next_ones() -> None:
    async with Ground() as ground:
        vehicle, actor = await one(ground)

        def late(v: ScriptedVehicle, sent: Sent) -> None:
            if sent.param1 == 30:
                v.reply(sent, 4, after_s=1.2)  # each answer comes after the next repeat
            else:
                v.reply(sent, 0, after_s=0.1)

        vehicle.script = late
        first = await actor.set_message_interval(30, 1)
        assert (first.result, first.attempts) == ("failed", 2)
        second = await actor.set_message_interval(31, 1)
        assert second.ok, second.message


async def test_cancelling_an_order_leaves_nothing_behind() -> None:
    async with Ground() as ground:
        vehicle, actor = await one(ground)
        vehicle.script = lambda v, sent: None
        task = asyncio.create_task(actor.takeoff(5))
        await asyncio.sleep(0.5)
        task.cancel()
        with pytest.raises(asyncio.CancelledError):
            await task
        assert not actor.commands.commanding
        assert not actor.commands.busy
        vehicle.script = accept_everything
        assert (await actor.takeoff(5)).ok


async def test_an_ack_for_another_ground_station_is_not_taken_for_ours() -> None:
    async with Ground() as ground:
        vehicle, actor = await one(ground)

        def to_another(v: ScriptedVehicle, sent: Sent) -> None:
            v.tell(v.ack(sent.command, 0, to=(255, 190)))

        vehicle.script = to_another
        assert (await actor.command(183, [1, 1500])).result == "timeout"


async def test_a_new_vehicle_is_asked_for_its_version_and_home_a_few_times_only() -> None:
    async with Ground() as ground:
        _, actor = await one(ground)
        await asyncio.sleep(300)
        asked = [s for s in ground.sent if s.priority is Priority.PROTOCOL]
        assert {(s.command, s.param1) for s in asked} == {(512, 148.0), (512, 242.0)}
        assert len(asked) == 10
        assert actor.vehicle.connected


async def test_the_state_shows_the_channel_free_parts_and_is_the_callers_own() -> None:
    async with Ground() as ground:
        _, actor = await one(ground)
        state = actor.state(ground.loop.time())
        state["position"]["lat_deg"] = 0
        assert actor.state(ground.loop.time())["position"]["lat_deg"] == pytest.approx(HOME[0])
        assert actor.channel == "test"


async def test_control_on_its_way_to_a_vehicle_that_was_dropped_does_not_begin() -> None:
    async with Ground() as ground:
        vehicle, actor = await flying(ground)
        actor.close()
        before = len(vehicle.got)
        outcome = await actor.control("position")
        assert not outcome.ok and "it was forgotten: nothing flies it any more" in outcome.message
        await asyncio.sleep(5)
        assert len(vehicle.got) == before
