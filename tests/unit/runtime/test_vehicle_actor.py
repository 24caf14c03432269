from __future__ import annotations

import asyncio
import math
from collections.abc import AsyncIterator, Callable, Coroutine
from typing import Any

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mav

from skygcs.core.mission.item import MissionType
from skygcs.core.protocols.command import RETRY_TIMERS_S, Outcome
from skygcs.core.radio_link.transmit_queue import Priority
from skygcs.core.vehicle.flight_evidence import RECENTLY_ARMED_S, is_being_armed
from skygcs.runtime import home_orders
from skygcs.runtime.task_set import ORDER_SERIAL, OWN, TaskSet, ask
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


@pytest.fixture
async def ground() -> AsyncIterator[Ground]:
    async with Ground() as made:
        yield made


async def test_arming_is_accepted_only_once_the_heartbeat_says_so(ground: Ground) -> None:
    vehicle, actor = await one(ground)
    outcome = await actor.arm()
    assert (outcome.ok, outcome.result, outcome.message, outcome.attempts) == (True, "accepted", "armed", 1)
    assert actor.vehicle.armed
    assert vehicle.commands() == [(ARM, (1.0, 0.0))]
    assert (vehicle.got[0].target_system, vehicle.got[0].target_component) == (1, 1)
    assert [e.data["order"] for e in ground.events if e.kind == "command"] == ["arm"]


async def test_what_is_not_done_says_why_and_ends_there() -> None:
    def accepting(v: ScriptedVehicle, sent: Sent) -> None:
        v.reply(sent)

    def denying(v: ScriptedVehicle, sent: Sent) -> None:
        v.reply(sent, 2)

    bad_throttle, low_battery = "Takeoff: bad throttle", "Preflight Fail: low battery"
    rows: list[tuple[int, Any, Any, str, list[int]]] = [
        (PX4, accepting, VehicleActor.arm, "timeout: accepted, but still disarmed", [ARM]),
        (
            ARDUPILOT,
            refusing(ARM, 4, "Arm: Throttle too high"),
            VehicleActor.arm,
            "failed: Arm: Throttle too high",
            [ARM],
        ),
        (ARDUPILOT, accepting, lambda a: a.set_mode("GUIDED"), "timeout: accepted, but it is in STABILIZE", [MODE]),
        (
            *(ARDUPILOT, refusing(TAKEOFF, 4, bad_throttle), lambda a: a.takeoff(10)),
            *(f"takeoff: failed: {bad_throttle}; disarm again", [MODE, ARM, TAKEOFF, ARM]),
        ),
        (
            PX4,
            refusing(ARM, 1, low_battery),
            lambda a: a.takeoff(10),
            f"arm: temporarily rejected: {low_battery}; ",
            [ARM],
        ),
        (
            *(PX4, denying, lambda a: a.set_message_interval("EKF_STATUS_REPORT", 1)),
            *("denied: PX4 does not stream EKF_STATUS_REPORT", [511]),
        ),
        (
            *(PX4, denying, lambda a: a.request_message("EKF_STATUS_REPORT")),
            *("denied: PX4 does not send EKF_STATUS_REPORT on request", [512]),
        ),
        (PX4, denying, home_orders.set_home, "denied: PX4 gave no reason (set home)", [179]),
        (PX4, denying, lambda a: a.takeoff(5), "arm: denied: PX4 gave no reason (arm)", [ARM]),
    ]
    for autopilot, script, order, said, commands in rows:
        async with Ground() as ground:
            vehicle, actor = await one(ground, autopilot)
            vehicle.script = script
            outcome = await order(actor)
            assert not outcome.ok and said in outcome.message, (said, outcome)
            assert [command for command, _ in vehicle.commands()] == commands, said
            assert not actor.vehicle.armed, said
            if "Arm:" in said:
                assert outcome.status_texts == ("Arm: Throttle too high",)


async def test_a_refused_arming_names_the_mode_that_a_px4_keeps_to_itself(ground: Ground) -> None:
    vehicle, actor = await one(ground)
    vehicle.mode, vehicle.script = 6 << 16, refusing(ARM, 1, "Arming denied: Resolve system health failures")
    await asyncio.sleep(2)
    said = "health failures; in OFFBOARD it arms only while setpoints come; set another mode first"
    assert said in (await actor.arm()).message
    vehicle.script = refusing(ARM, 1, "Arming denied! Switch to manual mode first")
    assert (await actor.arm()).message.count("set another mode first") == 1


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


async def test_arming_with_wait_is_tried_every_second_until_it_works(ground: Ground) -> None:
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


async def test_arming_with_wait_ends_in_time_with_the_last_refusal_or_at_once_where_time_does_not_cure() -> None:
    not_armable = "Arm: LAND mode not armable"
    for text, wait_s, most_s, said in (
        ("Arm: Need Position Estimate", 5, 6, "failed: Arm: Need Position Estimate"),
        (not_armable, 60, 2, f"failed: {not_armable}; set another mode first: skygcs-cli mode"),
    ):
        async with Ground() as ground:
            vehicle, actor = await one(ground, ARDUPILOT)
            estimates(vehicle, 60)
            await asyncio.sleep(0.5)
            vehicle.script = refusing(ARM, 4, text)
            outcome = await actor.arm(wait_s=wait_s)
            assert outcome.message.startswith(said) and outcome.elapsed_s <= most_s, outcome


async def test_a_lost_command_is_repeated_with_its_count_and_a_lost_ack_does_no_harm(ground: Ground) -> None:
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


async def test_an_order_that_worked_is_a_success_though_every_ack_is_lost(ground: Ground) -> None:
    vehicle, actor = await one(ground)

    def mute(v: ScriptedVehicle, sent: Sent) -> None:
        v.armed = True

    vehicle.script = mute
    outcome = await actor.arm()
    assert (outcome.ok, outcome.attempts) == (True, 1)
    assert outcome.elapsed_s < 2.1


async def test_a_takeoff_whose_acknowledgement_was_lost_is_not_sent_again(ground: Ground) -> None:
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


async def test_silence_is_a_timeout_after_all_repeats(ground: Ground) -> None:
    vehicle, actor = await one(ground)
    vehicle.script = lambda v, sent: None
    outcome = await actor.reboot()
    assert (outcome.result, outcome.attempts) == ("timeout", len(RETRY_TIMERS_S))
    longest_s = sum(RETRY_TIMERS_S) + len(RETRY_TIMERS_S)  # each waits for a heartbeat that shows it was not done
    assert sum(RETRY_TIMERS_S) <= outcome.elapsed_s <= longest_s


async def test_a_vehicle_lost_in_the_middle_ends_its_orders(ground: Ground) -> None:
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


async def test_no_link_is_told_from_no_answer(ground: Ground) -> None:
    _, actor = await one(ground)
    ground.links_up = False
    outcome = await actor.reboot()
    assert (outcome.result, outcome.attempts) == ("lost", 0)
    assert "no link" in outcome.message


async def test_a_mode_is_set_by_name_and_verified(ground: Ground) -> None:
    vehicle, actor = await one(ground)
    outcome = await actor.set_mode("posctl")
    assert (outcome.ok, outcome.message) == (True, "mode POSCTL")
    assert vehicle.commands() == [(MODE, (1.0, 3.0))]
    assert actor.vehicle.mode == "POSCTL"


async def test_what_cannot_be_meant_on_the_ground_is_refused_and_nothing_is_sent() -> None:
    far = {"lat_deg": HOME[0] + 0.1, "lon_deg": HOME[1]}
    async with Ground() as ground:
        vehicle, actor = await one(ground, ARDUPILOT)
        for order, said in (
            (actor.set_mode("GIUDED"), "did you mean GUIDED"),
            *((actor.takeoff(height_m), "") for height_m in (0.0, -1.0, 501.0, math.nan, math.inf)),
            (actor.takeoff(5, arm=False), "not armed"),
            (actor.set_message_interval("ATITUDE", 1), "no message 'ATITUDE'"),
            (actor.set_message_interval("ATTITUDE", -1), ""),
            (actor.set_message_interval("ATTITUDE", math.nan), ""),
            (actor.request_stream("POSISION", 1), "POSITION"),
            (actor.command("DO_SET_SERVOO", []), "did you mean"),
            (actor.command(183, [0.0] * 8), ""),
            (actor.command(183, [], x=1), ""),
            (actor.command(183, [1e300]), "param1"),
            (actor.command(183, [], int_frame=0, x=1 << 31), "32 bits"),
            (home_orders.set_home(actor, lat_deg=HOME[0]), ""),
            (home_orders.set_home(actor, lat_deg=0.0, lon_deg=0.0, alt_amsl_m=1.0), ""),
            (home_orders.set_home(actor, **far), "it would return there"),
            (home_orders.set_home(actor, **far), "--force"),
            (actor.goto(**NEAR), "disarmed"),
        ):
            outcome = await order
            assert outcome.result == "refused" and said in outcome.message, (said, outcome)
        vehicle.armed = True
        await asyncio.sleep(1.5)
        assert "on the ground" in (await actor.goto(**NEAR)).message
        assert vehicle.got == []
        assert (await home_orders.set_home(actor, **far, force=True)).ok


async def test_px4_takes_off_to_an_amsl_altitude_after_leaving_a_manual_mode_and_keeps_loiter() -> None:
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
    async with Ground() as ground:
        vehicle, actor = await one(ground, PX4)
        assert (await actor.takeoff(10)).ok
        assert [c for c, _ in vehicle.commands()] == [ARM, TAKEOFF]


async def test_px4_is_never_armed_in_an_auto_mode_that_flies_by_itself() -> None:
    """AUTO.TAKEOFF, MISSION, RTL, LAND: armed there, it would start off before it is told to."""
    for sub_mode in (2, 4, 5, 6):
        async with Ground() as ground:
            vehicle, actor = await one(ground, PX4, mode=4 << 16 | sub_mode << 24)
            armed_in: list[int] = []

            def watch(v: ScriptedVehicle, sent: Sent, armed_in: list[int] = armed_in) -> None:
                if sent.command == ARM:
                    armed_in.append(v.mode)
                accept_everything(v, sent)

            vehicle.script = watch
            assert (await actor.takeoff(10)).ok
            assert [c for c, _ in vehicle.commands()] == [MODE, ARM, TAKEOFF], sub_mode
            assert armed_in == [PX4_LOITER], sub_mode


async def test_repeats_and_orders_that_end_a_flight_go_over_every_link(ground: Ground) -> None:
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


async def test_arducopter_takes_off_from_guided_to_a_relative_height_by_default_that_of_the_fleet_file() -> None:
    config = {"vehicles": {"alpha": {"sysid": 1, "takeoff_height_m": 12.5}}}
    async with Ground(config) as ground:
        vehicle, actor = await one(ground, ARDUPILOT)
        assert (await actor.takeoff(None)).message == "taking off to 12.5 m"
        assert [c for c, _ in vehicle.commands()] == [MODE, ARM, TAKEOFF]
        assert vehicle.got[0].param2 == 4
        assert [getattr(vehicle.got[-1], f"param{n}") for n in range(1, 8)] == [0, 0, 0, 0, 0, 0, 12.5]


async def test_a_takeoff_refused_while_armed_before_leaves_it_armed(ground: Ground) -> None:
    vehicle, actor = await one(ground, ARDUPILOT, mode=4)
    vehicle.armed = True
    await asyncio.sleep(1.5)
    vehicle.script = refusing(TAKEOFF, 4)
    outcome = await actor.takeoff(10)
    assert not outcome.ok
    assert [c for c, _ in vehicle.commands()] == [TAKEOFF]


async def test_what_cannot_be_meant_in_the_air_is_refused_and_nothing_is_sent() -> None:
    far = {"lat_deg": HOME[0] + 0.1, "lon_deg": HOME[1]}
    places: list[tuple[dict[str, Any], str]] = [
        ({"lat_deg": 0.0, "lon_deg": 0.0, "height_m": 1}, "zero coordinate"),
        ({"lat_deg": HOME[0], "lon_deg": 0.0}, "zero coordinate"),
        ({"lat_deg": 0.0, "lon_deg": HOME[1]}, "zero coordinate"),
        ({"lat_deg": 1.8e-6, "lon_deg": 2.2e-5, "height_m": 1}, "beyond what any vehicle can reach"),
        ({**far, "height_m": 1}, "limit is 1000 m"),
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
        (far, "--force"),
        ({"lat_deg": HOME[0]}, "both latitude and longitude"),
        ({}, "give a place"),
        ({"enu_m": [1.0, 2.0, 3.0]}, "no origin"),
        ({"enu_m": [1.0, 2.0]}, "three numbers"),
        ({"enu_m": [1.0, 2.0, 3.0], "lat_deg": 1.0}, "either"),
        ({"lat_deg": 0.0, "lon_deg": HOME[1], "force": True}, ""),
        ({**NEAR, "height_m": 1e30, "force": True}, ""),
    ]
    async with Ground() as ground:
        vehicle, actor = await flying(ground, PX4)
        for order, said in (
            *((actor.goto(**place), said) for place, said in places),
            (actor.takeoff(5), "in the air already"),
            (actor.disarm(), "--force"),
            (actor.reboot(), "--force"),
            *((home_orders.set_home(actor, **place), "in the air") for place in ({}, far | {"lat_deg": HOME[0]})),
            (home_orders.set_home(actor), "--force"),
        ):
            outcome = await order
            assert outcome.result == "refused" and said in outcome.message, (said, outcome)
        assert vehicle.got == []
        assert (await home_orders.set_home(actor, force=True)).ok
        assert (await actor.goto(**far, force=True)).ok, "force overrides the distance"


async def test_a_forced_disarm_goes_out_as_an_emergency_to_a_vehicle_that_is_lost_or_will_be() -> None:
    for silent_s in (10, 3):
        async with Ground() as ground:
            vehicle, actor = await flying(ground)
            vehicle.silent = True
            await asyncio.sleep(silent_s)
            assert actor.vehicle.connected is (silent_s == 3)
            before = len(ground.sent)
            outcome = await actor.disarm(force=True)
            sent = ground.sent[before:]
            assert (outcome.result, outcome.attempts, len(sent)) == ("timeout", 7, 7)
            assert {(s.priority, s.param1, s.param2) for s in sent} == {(Priority.EMERGENCY, 0.0, 21196.0)}
            assert not actor.vehicle.connected


async def test_a_takeoff_that_fails_after_a_newer_order_does_not_disarm_under_it(ground: Ground) -> None:
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


async def test_a_vehicle_on_the_ground_need_not_enter_the_mode_it_accepted() -> None:
    for order in (VehicleActor.land, VehicleActor.rtl, VehicleActor.hold):
        async with Ground() as ground:
            vehicle, actor = await one(ground, ARDUPILOT)
            vehicle.script = lambda v, sent: v.reply(sent)
            assert (await order(actor)).ok, order
            vehicle.armed, vehicle.flying, vehicle.status = True, True, 4
            await asyncio.sleep(1.5)
            assert (await order(actor)).message.endswith("timeout: accepted, but it is in STABILIZE"), order


async def test_a_forced_disarm_takes_the_place_of_a_takeoff_in_the_making(ground: Ground) -> None:
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


async def test_a_landing_takes_the_place_of_a_takeoff_in_the_making(ground: Ground) -> None:
    vehicle, actor = await one(ground, ARDUPILOT)
    vehicle.delay_s = 0.3
    takeoff = asyncio.create_task(actor.takeoff(10))
    await asyncio.sleep(0.4)
    land = await actor.land()
    assert land.ok, land.message
    assert (await takeoff).result == "cancelled"
    assert TAKEOFF not in [c for c, _ in vehicle.commands()]


async def test_an_arming_that_is_denied_leaves_one_before_it_that_may_yet_show(ground: Ground) -> None:
    """A landing would have been answered "it is on the ground and disarmed already"."""
    vehicle, actor = await one(ground, ARDUPILOT)
    vehicle.script = lambda v, sent: None
    assert (await actor.arm()).result == "timeout"
    vehicle.script = refusing(ARM, 2)
    assert not (await actor.arm()).ok
    assert is_being_armed(actor.vehicle, ground.loop.time())
    await asyncio.sleep(RECENTLY_ARMED_S + 0.1)
    assert not is_being_armed(actor.vehicle, ground.loop.time())


@pytest.mark.parametrize("disarmed", [True, False])
async def test_a_repeated_arming_ends_once_somebody_has_armed_the_vehicle(ground: Ground, disarmed: bool) -> None:
    """It armed what its pilot had armed and disarmed between two attempts."""
    vehicle, actor = await one(ground, PX4)
    vehicle.script = refusing(ARM, 1)
    arm = asyncio.create_task(actor.arm(wait_s=10.0))
    await asyncio.sleep(0.7)
    for armed in (True, not disarmed):
        vehicle.armed = armed
        vehicle.pulse()
        await asyncio.sleep(0.1)
    assert actor.vehicle.armed is not disarmed
    vehicle.script = accept_everything
    outcome = await arm
    said = (
        "refused: it was armed since this was ordered, and is disarmed again" if disarmed else "it was armed meanwhile"
    )
    assert (outcome.ok, outcome.message) == (not disarmed, said)
    assert [c for c, _ in vehicle.commands()].count(ARM) == 1


async def test_a_take_off_is_not_tried_again_once_a_pilot_has_disarmed_what_it_armed(ground: Ground) -> None:
    """It armed again, a second later, and flew off."""
    vehicle, actor = await one(ground, ARDUPILOT)

    def script(v: ScriptedVehicle, sent: Sent) -> None:
        if sent.command == TAKEOFF:
            v.armed = False  # by its pilot; the take-off is refused for that
            v.pulse()
            v.reply(sent, 4)
        else:
            accept_everything(v, sent)

    vehicle.script = script
    outcome = await actor.takeoff(5.0, wait_s=10.0)
    assert outcome.result == "refused" and "is disarmed again" in outcome.message
    assert [p for c, p in vehicle.commands() if c == ARM and p[0] == 1.0] == [(1.0, 0.0)]


async def test_a_disarming_takes_the_place_of_an_arming_that_is_still_repeated(ground: Ground) -> None:
    """It waited for its turn behind the arming, which came through meanwhile."""
    vehicle, actor = await one(ground, ARDUPILOT)
    vehicle.script = lambda v, sent: accept_everything(v, sent) if sent.param1 == 0 else None  # it misses the arming
    arm = asyncio.create_task(actor.arm())
    await asyncio.sleep(0.3)
    beside = asyncio.create_task(actor.set_mode("ALT_HOLD"))
    await asyncio.sleep(0.3)
    assert not arm.done(), "any other order stands beside it"
    before = len(vehicle.commands())
    assert (await actor.disarm()).ok
    assert (await arm).result == "cancelled"
    await beside
    assert [c for c in vehicle.commands()[before:] if c[0] == ARM] == [(ARM, (0.0, 0.0))]


async def test_a_disarming_ends_an_arming_that_asks_for_a_position_yet(ground: Ground) -> None:
    vehicle, actor = await one(ground, ARDUPILOT)
    vehicle.script = lambda v, sent: accept_everything(v, sent) if sent.command == ARM else None
    arm = asyncio.create_task(actor.arm(wait_s=30.0))
    await asyncio.sleep(0.3)
    assert (await actor.disarm()).ok and arm.done() and arm.result().result == "cancelled"
    assert [p for c, p in vehicle.commands() if c == ARM] == [(0.0, 0.0)]


async def test_a_takeoff_that_a_stop_followed_at_once_does_not_end_with_taking_off(ground: Ground) -> None:
    """The PX4 had accepted it, and was stopped before it showed its mode: "ok, taking off" came after the stop."""
    vehicle, actor = await one(ground, PX4)

    def shows_no_mode(v: ScriptedVehicle, sent: Sent) -> None:
        if sent.command == TAKEOFF:
            heard.set()
            v.reply(sent)
        else:
            accept_everything(v, sent)

    heard = asyncio.Event()
    vehicle.script = shows_no_mode
    takeoff = asyncio.create_task(actor.takeoff(10))
    await heard.wait()
    await asyncio.sleep(0.3)
    assert (await actor.stop("hold")).ok
    assert (await takeoff).message == "taking off to 10 m; a newer order took its place since"


async def test_land_is_the_same_command_for_both() -> None:
    for autopilot, mode in ((PX4, "AUTO.LAND"), (ARDUPILOT, "LAND")):
        async with Ground() as ground:
            vehicle, actor = await flying(ground, autopilot)
            assert (await actor.land()).ok
            assert ([c for c, _ in vehicle.commands()], actor.vehicle.mode) == ([LAND], mode)


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


async def test_a_stop_that_a_standstill_ends_is_reported_as_lost() -> None:
    async with Ground() as ground:
        _, actor = await flying(ground, PX4)
        stopping = asyncio.create_task(actor.stop("land"))
        await asyncio.sleep(0)
        actor.outcomes.cut_stops("skygcs stood still for 10 s")
        (lost,) = (e for e in ground.events if e.data.get("result") == "lost")
        assert lost.data["order"] == "stop" and "order it again" in lost.text
        await stopping
        actor.outcomes.cut_stops("skygcs stood still for 10 s")  # none is under way
        assert sum(e.data.get("result") == "lost" for e in ground.events) == 1


async def test_a_hold_that_is_refused_says_what_it_does_instead_and_what_was_asked_for_before_does_not_end_that() -> (
    None
):
    for refused, said in ((17.0, "does nothing else instead"), (4.0, "it holds in BRAKE")):
        async with Ground() as ground:
            copter, actor = await flying(ground, ARDUPILOT)

            def script(v: ScriptedVehicle, sent: Sent, refused: float = refused) -> None:
                if sent.command == MODE and sent.param2 == refused:
                    v.reply(sent, 4)
                else:
                    accept_everything(v, sent)

            copter.script = script
            before, tasks = ask(), TaskSet(ground.loop, ground.events.append)
            number = actor.order_number
            outcome = await actor.hold()
            assert not outcome.ok and said in outcome.message, said
            assert (await tasks.start(actor.rtl(), "rtl", before)).ok is (refused == 17.0), said
            assert (await actor.hold(instead_of=number)).result == "refused", said


async def test_a_hold_in_place_of_one_order_waits_for_a_newer_one_and_is_refused_if_that_is_accepted(
    ground: Ground,
) -> None:
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


async def test_a_hold_in_place_of_one_order_is_sent_if_the_vehicle_refuses_the_newer_one(ground: Ground) -> None:
    copter, actor = await flying(ground, ARDUPILOT)
    went = await actor.goto(lat_deg=HOME[0] + 1e-4, lon_deg=HOME[1], height_m=10.0)
    copter.script = refusing(LAND, 4)
    landing = asyncio.create_task(actor.land())
    await asyncio.sleep(0)
    held = await actor.hold(instead_of=went.order_number)
    assert not (await landing).ok and held.ok and held.message == "holding in GUIDED"


async def test_a_hold_in_place_of_one_order_waits_while_a_newer_one_is_repeated(ground: Ground) -> None:
    """Between two of its attempts nothing is in progress."""
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
async def test_a_hold_in_place_of_one_order_is_refused_after_a_newer_one_that_may_move_the_vehicle(
    ground: Ground, how: str
) -> None:
    """The newer one was sent. It was counted only if it was accepted, and the landing was broken off by BRAKE."""
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


async def test_an_order_that_moves_nothing_has_no_number(ground: Ground) -> None:
    _, actor = await one(ground, ARDUPILOT)
    assert "order_number" not in (await actor.arm()).as_dict()


NEAR = {"lat_deg": HOME[0] + 1e-4, "lon_deg": HOME[1] - 1e-4}
TARGET = (512, 87.0)
"""REQUEST_MESSAGE of POSITION_TARGET_GLOBAL_INT."""


async def test_px4_goes_somewhere_by_one_reposition_to_an_amsl_altitude(ground: Ground) -> None:
    vehicle, actor = await flying(ground, PX4)
    assert (await actor.goto(**NEAR, height_m=25.0, yaw_deg=90.0)).ok
    (sent,) = vehicle.got
    assert (sent.name, sent.command, sent.frame) == ("COMMAND_INT", REPOSITION, 0)
    assert (sent.x, sent.y) == (round(NEAR["lat_deg"] * 1e7), round(NEAR["lon_deg"] * 1e7))
    assert sent.z == pytest.approx(HOME[2] + 25.0)
    assert (sent.param1, sent.param2) == (-1.0, 1.0)
    assert sent.param4 == pytest.approx(math.pi / 2)


async def test_arducopter_goes_somewhere_by_one_reposition_to_a_relative_height_and_turns_by_another_command(
    ground: Ground,
) -> None:
    vehicle, actor = await flying(ground, ARDUPILOT)
    assert (await actor.goto(**NEAR)).ok
    assert vehicle.got[0].z == pytest.approx(10.0), "it keeps the height it is at"
    vehicle.got.clear()
    assert (await actor.goto(**NEAR, height_m=25.0, yaw_deg=-90.0)).ok
    sent, asked, turned = vehicle.got
    assert (sent.name, sent.command, sent.frame, sent.z) == ("COMMAND_INT", REPOSITION, 3, 25.0)
    assert (asked.command, asked.param1) == TARGET
    assert (turned.command, turned.param1) == (115, 270.0)


async def test_a_goto_that_an_arducopter_accepted_and_does_not_fly_is_sent_again() -> None:
    def another_target(vehicle: ScriptedVehicle, sent: Sent) -> None:
        """A setpoint that was on its way took the place of each but the last goto: then it reports no target."""
        accept_everything(vehicle, sent)
        gotos = [s for s in vehicle.got if s.command == REPOSITION]
        if sent.command == REPOSITION and len(gotos) < 3:
            vehicle.target = None

    async with Ground() as ground:
        vehicle, actor = await flying(ground, ARDUPILOT)
        vehicle.script = another_target
        outcome = await actor.goto(**NEAR, height_m=25.0)
        assert (outcome.ok, outcome.attempts) == (True, 3), outcome.message
        assert [c for c, _ in vehicle.commands()] == [REPOSITION, TARGET[0]] * 3
        changes_mode = [s.param2 for s in vehicle.got if s.command == REPOSITION]
        assert changes_mode == [1.0, 0.0, 0.0], "denied by an ArduCopter that its pilot took out of GUIDED"


async def test_a_vehicle_that_its_pilot_took_over_is_not_sent_there_again(ground: Ground) -> None:
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


async def test_a_goto_that_an_arducopter_never_flies_has_failed_after_two_repeats(ground: Ground) -> None:
    vehicle, actor = await flying(ground, ARDUPILOT)

    def stays(v: ScriptedVehicle, sent: Sent) -> None:
        accept_everything(v, sent)
        v.target = (round(HOME[0] * 1e7), round(HOME[1] * 1e7), HOME[2] + 25.0)  # of another program

    vehicle.script = stays
    outcome = await actor.goto(**NEAR, height_m=25.0)
    assert (outcome.result, outcome.attempts) == ("timeout", 3)
    assert "accepted, but it does not report that it flies there" in outcome.message
    assert len([s for s in vehicle.got if s.command == REPOSITION]) == 3


async def test_a_goto_without_a_reported_target_is_believed_when_the_vehicle_comes_nearer(ground: Ground) -> None:
    vehicle, actor = await flying(ground, ARDUPILOT)

    def unreported(v: ScriptedVehicle, sent: Sent) -> None:
        accept_everything(v, sent)
        v.target = None
        if sent.command == REPOSITION:
            v.place = (HOME[0] + 2e-5, HOME[1])  # 2 m of the 11

    vehicle.script = unreported
    outcome = await actor.goto(lat_deg=HOME[0] + 1e-4, lon_deg=HOME[1], height_m=10.0)
    assert (outcome.ok, outcome.attempts) == (True, 1), outcome.message


async def test_after_a_hold_the_target_is_asked_for_when_its_repeats_can_come_no_more(ground: Ground) -> None:
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


async def test_a_newer_order_or_the_end_of_the_daemon_ends_the_proof_of_a_goto_that_was_accepted() -> None:
    for end in (VehicleActor.rtl, VehicleActor.wind_down):
        async with Ground() as ground:
            vehicle, actor = await flying(ground, ARDUPILOT)
            vehicle.script = lambda v, sent: None if sent.command == TARGET[0] else accept_everything(v, sent)
            goto = asyncio.create_task(actor.goto(**NEAR, height_m=25.0))
            await asyncio.sleep(0.5)
            await end(actor)
            outcome = await goto
            assert (outcome.ok, outcome.attempts) == (True, 1), (end, outcome.message)
            assert len([s for s in vehicle.got if s.command == REPOSITION]) == 1, end


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


async def test_a_forced_reboot_of_an_armed_arducopter_has_a_magic_number(ground: Ground) -> None:
    vehicle, actor = await flying(ground, ARDUPILOT)
    assert (await actor.reboot(force=True)).ok
    assert (vehicle.got[0].command, vehicle.got[0].param1, vehicle.got[0].param6) == (246, 1.0, 20190226.0)


async def test_a_reboot_whose_ack_was_lost_is_known_by_the_reboot_itself(ground: Ground) -> None:
    vehicle, actor = await one(ground)
    vehicle.script = lambda v, sent: v.restart(3.0) if not sent.confirmation else None
    outcome = await actor.reboot()
    assert outcome.ok, outcome.message
    await asyncio.sleep(10)
    outcome = await home_orders.set_home(actor)
    assert (outcome.result, outcome.message) == ("lost", "the vehicle rebooted")


async def test_home_is_set_here_or_at_a_place(ground: Ground) -> None:
    vehicle, actor = await one(ground)
    assert (await home_orders.set_home(actor)).ok
    assert (vehicle.got[0].name, vehicle.got[0].command, vehicle.got[0].param1) == ("COMMAND_LONG", 179, 1.0)
    assert (await home_orders.set_home(actor, lat_deg=HOME[0], lon_deg=HOME[1])).ok
    assert (vehicle.got[1].name, vehicle.got[1].x, vehicle.got[1].frame) == ("COMMAND_INT", 473977420, 0)
    assert vehicle.got[1].z == pytest.approx(HOME[2])


async def test_message_intervals_are_microseconds(ground: Ground) -> None:
    vehicle, actor = await one(ground)
    for rate_hz, interval_us, said in ((4.0, 250_000, "4 Hz"), (0.0, -1, "off"), (None, 0, "default rate")):
        outcome = await actor.set_message_interval("attitude", rate_hz)
        assert (outcome.ok, outcome.message) == (True, said)
        assert vehicle.commands()[-1] == (511, (30.0, interval_us))
    assert (await actor.set_message_interval("GPS_RAW_INT", -1.0)).result == "refused"
    assert [actor.streams.is_left(name) for name in ("ATTITUDE", "GPS_RAW_INT")] == [True, False]


async def test_a_stream_request_is_sent_once_without_acknowledgement(ground: Ground) -> None:
    vehicle, actor = await one(ground, ARDUPILOT)
    outcome = await actor.request_stream("position", 2)
    assert outcome.ok
    assert "no acknowledgement" in outcome.message
    await asyncio.sleep(1)
    (sent,) = vehicle.got
    assert (sent.req_stream_id, sent.req_message_rate, sent.start_stop) == (6, 2, 1)


async def test_a_requested_message_is_a_success_when_it_has_come(ground: Ground) -> None:
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


async def test_any_command_goes_by_name_or_number_with_unset_parameters(ground: Ground) -> None:
    vehicle, actor = await one(ground)
    assert (await actor.command("do_set_servo", [9, 1500])).message == "DO_SET_SERVO accepted"
    assert (await actor.command(31010, [None, 2.0])).ok
    assert (await actor.command("MAV_CMD_DO_SET_ROI_LOCATION", [], int_frame=6, x=473977420, y=85455940, z=5.0)).ok
    assert vehicle.commands()[0] == (183, (9.0, 1500.0))
    assert vehicle.got[1].command == 31010 and math.isnan(vehicle.got[1].param1)
    assert (vehicle.got[2].name, vehicle.got[2].frame, vehicle.got[2].x) == ("COMMAND_INT", 6, 473977420)


async def test_progress_is_reported_and_waited_for(ground: Ground) -> None:
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


async def test_one_command_of_an_id_is_in_flight_and_the_next_waits_its_turn(ground: Ground) -> None:
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


async def test_too_many_waiting_are_refused(ground: Ground) -> None:
    vehicle, actor = await one(ground)
    vehicle.script = lambda v, sent: None
    tasks = [asyncio.create_task(actor.set_message_interval(30, 1)) for _ in range(10)]
    await asyncio.sleep(0.1)
    assert [t.done() for t in tasks].count(True) == 1
    assert tasks[9].result().result == "refused"
    for task in tasks:
        task.cancel()
    await asyncio.gather(*tasks, return_exceptions=True)


async def test_a_late_ack_of_a_command_given_up_does_not_pass_for_the_next_ones(ground: Ground) -> None:
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


async def test_cancelling_an_order_leaves_nothing_behind(ground: Ground) -> None:
    vehicle, actor = await one(ground)
    vehicle.script = lambda v, sent: None
    task = asyncio.create_task(actor.takeoff(5))
    await asyncio.sleep(0.5)
    task.cancel()
    with pytest.raises(asyncio.CancelledError):
        await task
    assert not actor.commands._running
    assert not actor.commands.busy
    vehicle.script = accept_everything
    assert (await actor.takeoff(5)).ok


async def test_a_take_off_that_was_sent_is_watched_though_its_client_is_gone(ground: Ground) -> None:
    """No alarm came at a wrong height, and a goto went out while it climbed."""
    vehicle, actor = await one(ground, ARDUPILOT)
    for number, under_way in ((MODE, None), (TAKEOFF, "it is taking off (0.0 of 10.0 m)")):
        heard = asyncio.Event()

        def script(v: ScriptedVehicle, sent: Sent, number: int = number, heard: asyncio.Event = heard) -> None:
            accept_everything(v, sent)
            if sent.command == number:
                heard.set()

        vehicle.script = script
        task = asyncio.create_task(actor.takeoff(10))
        await heard.wait()
        task.cancel()
        await asyncio.gather(task, return_exceptions=True)
        assert actor.takeoffs.under_way() == under_way, number
        await asyncio.sleep(4)


async def test_an_ack_for_another_ground_station_is_not_taken_for_ours(ground: Ground) -> None:
    vehicle, actor = await one(ground)

    def to_another(v: ScriptedVehicle, sent: Sent) -> None:
        v.tell(v.ack(sent.command, 0, to=(255, 190)))

    vehicle.script = to_another
    assert (await actor.command(183, [1, 1500])).result == "timeout"


async def test_a_new_vehicle_is_asked_for_its_version_home_and_return_a_few_times_only(ground: Ground) -> None:
    _, actor = await one(ground)
    await asyncio.sleep(300)
    asked = [s for s in ground.sent if s.priority is Priority.PROTOCOL]
    params = [s.param_id for s in asked if s.name == "PARAM_REQUEST_READ"]
    assert sorted(params) == ["RTL_LAND_DELAY", "RTL_TYPE"]
    commands = [(s.command, s.param1) for s in asked if s.name != "PARAM_REQUEST_READ"]
    assert set(commands) == {(512, 148.0), (512, 242.0)} and len(commands) == 10
    assert actor.vehicle.connected


async def test_the_state_shows_the_channel_free_parts_and_is_the_callers_own(ground: Ground) -> None:
    _, actor = await one(ground)
    state = actor.state(ground.loop.time())
    state["position"]["lat_deg"] = 0
    assert actor.state(ground.loop.time())["position"]["lat_deg"] == pytest.approx(HOME[0])
    assert actor.channel == "test"


async def test_control_on_its_way_to_a_vehicle_that_was_dropped_does_not_begin(ground: Ground) -> None:
    vehicle, actor = await flying(ground)
    actor.close("it was forgotten")
    before = len(vehicle.got)
    outcome = await actor.control("position")
    assert not outcome.ok and "it was forgotten: nothing flies it any more" in outcome.message
    await asyncio.sleep(5)
    assert len(vehicle.got) == before


async def test_nothing_is_sent_to_a_vehicle_that_was_dropped_whatever_goes_on_and_each_says_why(ground: Ground) -> None:
    vehicle, actor = await flying(ground)
    vehicle.script = lambda vehicle, sent: None  # it answers nothing: all is under way still
    why = "this computer slept for 60 s"

    def asked() -> list[Any]:
        return [actor.hold(), actor.params.get("MPC_XY_CRUISE"), actor.missions.download(MissionType.MISSION)]

    under_way = [asyncio.create_task(work) for work in asked()]
    await asyncio.sleep(0.2)
    actor.close(why)
    before = len(ground.sent)
    later = asked()
    outcomes = await asyncio.gather(*under_way, *later)
    heartbeat = actor.services.dialect.by_name["HEARTBEAT"]
    assert not actor.services.send(
        heartbeat, dict.fromkeys((f.name for f in heartbeat.fields), 0), 1, 1, Priority.COMMAND
    )
    assert len(ground.sent) == before
    for outcome in outcomes:
        said = str(outcome)
        assert not outcome.ok and (why in said or "it is lost" in said), said


@pytest.mark.parametrize(("by", "ok"), [(0, True), (1, True), (2, False)], ids=["the daemon", "before", "since"])
async def test_a_mode_by_sticks_gives_way_to_a_newer_order_only(ground: Ground, by: int, ok: bool) -> None:
    """While it looked where the throttle is, a hold of the daemon's own, or a failsafe, had it refused. ``by``: serial
    of the order that comes meanwhile."""
    vehicle, actor = await flying(ground)
    receiver = mav.MAV_SYS_STATUS_SENSOR_RC_RECEIVER
    vehicle.tell(vehicle.say(mav.MAVLink_sys_status_message(*[receiver] * 3, *[0] * 10)))
    await asyncio.sleep(0.1)
    meanwhile: list[asyncio.Task[Outcome]] = []

    async def order(work: Coroutine[Any, Any, Outcome], serial: int) -> Outcome:
        ORDER_SERIAL.set(serial)
        return await work

    def script(v: ScriptedVehicle, sent: Sent) -> None:
        if sent.name == "COMMAND_LONG" and (sent.command, sent.param1) == (512, 65):  # its throttle
            if not meanwhile:
                meanwhile.append(asyncio.create_task(order(actor.land(), by)))
            v.tell(v.say(mav.MAVLink_rc_channels_message(1, 8, *[1500] * 18, 255)), 1.5)
            v.reply(sent, after_s=1.5)
        else:
            accept_everything(v, sent)

    vehicle.script = script
    outcome = await asyncio.create_task(order(actor.set_mode("POSCTL"), 1))
    assert (await meanwhile[0]).ok, "it was in AUTO.LAND meanwhile"
    assert outcome.ok is ok and ("a newer order" in outcome.message) is not ok, outcome


@pytest.mark.parametrize("failsafe", [False, True], ids=["a pilot", "a failsafe"])
async def test_a_mode_by_sticks_gives_way_to_a_pilot_and_to_no_failsafe(ground: Ground, failsafe: bool) -> None:
    """It went out over what the pilot switched while it looked where the throttle is."""
    vehicle, actor = await flying(ground)
    receiver = mav.MAV_SYS_STATUS_SENSOR_RC_RECEIVER
    vehicle.tell(vehicle.say(mav.MAVLink_sys_status_message(*[receiver] * 3, *[0] * 10)))
    await asyncio.sleep(0.1)

    def script(v: ScriptedVehicle, sent: Sent) -> None:
        if sent.name == "COMMAND_LONG" and (sent.command, sent.param1) == (512, 65):  # its throttle
            v.mode, v.status = (6 << 24 | 4 << 16), (5 if failsafe else 4)  # AUTO.LAND
            v.pulse()
            v.tell(v.say(mav.MAVLink_rc_channels_message(1, 8, *[1500] * 18, 255)), 0.5)
            v.reply(sent, after_s=0.5)
        else:
            accept_everything(v, sent)

    vehicle.script = script
    outcome = await actor.set_mode("POSCTL")
    assert outcome.ok is failsafe, outcome
    assert failsafe or "it was switched to AUTO.LAND while this order waited" in outcome.message, outcome


async def test_each_order_has_a_number_of_when_it_was_asked_for_and_a_hold_of_the_daemons_own_has_none(
    ground: Ground,
) -> None:
    vehicle, actor = await flying(ground)
    vehicle.script = accept_everything
    tasks = TaskSet(ground.loop, ground.events.append)
    before = ask()
    assert (await actor.land()).ok and actor.runner.ledger.effective_serial > before, "it gets one at the gate"
    assert ORDER_SERIAL.get() is None, "and its caller keeps none"
    newest = actor.runner.ledger.effective_serial
    assert (await tasks.start(actor.hold(), "hold", OWN)).ok and actor.runner.ledger.effective_serial == newest
    late = await tasks.start(actor.rtl(), "rtl", before)
    assert late.result == "refused" and "a newer order" in late.message, "what waited since then comes too late"
    assert (await tasks.start(actor.stop("hold"), "stop", before)).ok, "but a stop"
    assert (await tasks.start(actor.rtl(), "rtl", ask())).ok
