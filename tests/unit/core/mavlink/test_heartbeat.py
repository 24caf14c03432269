from __future__ import annotations

from itertools import chain

from pymavlink.dialects.v20 import ardupilotmega as mav

from skygcs.core.mavlink.frame import Frame
from skygcs.core.mavlink.heartbeat import (
    MAX_STATES,
    HeartbeatCheck,
    HeartbeatChecks,
    discovers,
    heartbeat_fields,
    is_vehicle,
    shown_by,
)
from support.frames import dialect, frame
from support.table import each
from support.vehicles import Voice


def heartbeat(sysid: int, compid: int, kind: int, autopilot: int) -> Frame:
    return Voice(sysid, compid).say(mav.MAVLink_heartbeat_message(kind, autopilot, 1, 0, 3, 3))


@each(
    ("vehicle", "sysid", "compid", "kind", "autopilot"),
    [
        (True, 1, 1, mav.MAV_TYPE_QUADROTOR, mav.MAV_AUTOPILOT_PX4),
        (True, 1, 1, mav.MAV_TYPE_HEXAROTOR, mav.MAV_AUTOPILOT_ARDUPILOTMEGA),
        (True, 7, 3, mav.MAV_TYPE_FIXED_WING, mav.MAV_AUTOPILOT_ARDUPILOTMEGA),
        (True, 1, 1, mav.MAV_TYPE_SUBMARINE, mav.MAV_AUTOPILOT_ARDUPILOTMEGA),
        (True, 1, 1, mav.MAV_TYPE_GENERIC, mav.MAV_AUTOPILOT_PX4),
        (True, 1, 1, mav.MAV_TYPE_GROUND_ROVER, mav.MAV_AUTOPILOT_GENERIC),
        (True, 1, 1, mav.MAV_TYPE_QUADROTOR, mav.MAV_AUTOPILOT_PPZ),
        (False, 255, 190, mav.MAV_TYPE_GCS, mav.MAV_AUTOPILOT_INVALID),
        (False, 255, 190, mav.MAV_TYPE_GCS, mav.MAV_AUTOPILOT_ARDUPILOTMEGA),
        (False, 2, 2, mav.MAV_TYPE_GENERIC, mav.MAV_AUTOPILOT_INVALID),
        (False, 1, 0, mav.MAV_TYPE_QUADROTOR, mav.MAV_AUTOPILOT_INVALID),
        (False, 1, 0, mav.MAV_TYPE_ADSB, mav.MAV_AUTOPILOT_INVALID),
        (False, 1, 100, mav.MAV_TYPE_CAMERA, mav.MAV_AUTOPILOT_INVALID),
        (False, 1, 154, mav.MAV_TYPE_GIMBAL, mav.MAV_AUTOPILOT_GENERIC),
        (False, 1, 194, mav.MAV_TYPE_ONBOARD_CONTROLLER, mav.MAV_AUTOPILOT_GENERIC),
        (False, 1, 1, mav.MAV_TYPE_GENERIC, mav.MAV_AUTOPILOT_GENERIC),
        (False, 0, 1, mav.MAV_TYPE_QUADROTOR, mav.MAV_AUTOPILOT_PX4),
        (False, 81, 50, mav.MAV_TYPE_GENERIC, mav.MAV_AUTOPILOT_PX4),  # a PX4Flow
    ],
)
def test_only_an_autopilot_is_a_vehicle(vehicle: bool, sysid: int, compid: int, kind: int, autopilot: int) -> None:
    assert discovers(heartbeat(sysid, compid, kind, autopilot)) is vehicle


def test_no_message_but_a_verified_heartbeat_makes_a_vehicle() -> None:
    voice = Voice()
    radio_status = voice.say(mav.MAVLink_radio_status_message(1, 1, 100, 1, 1, 0, 0))
    for heard in (voice.text("hello"), radio_status, Frame(voice.beat().raw, 0, 1, 1, 0, None)):
        assert not discovers(heard)


def test_fields_of_a_heartbeat_whose_zeros_are_not_sent() -> None:
    fields = {"custom_mode": 0x01020304, "type": 2, "autopilot": 12, "base_mode": 0x81, "system_status": 4}
    info = dialect().find("HEARTBEAT")
    whole = Frame(frame("HEARTBEAT", fields), 0, 1, 1, 0, info)
    assert heartbeat_fields(whole) == (0x01020304, 2, 12, 0x81)
    assert shown_by(whole) == bytes((4, 3, 2, 1, 2, 12, 0x81))
    trimmed = Frame(frame("HEARTBEAT", {"custom_mode": 7, "type": 2}), 0, 1, 1, 0, info)
    assert trimmed.raw[1] == 5 and heartbeat_fields(trimmed) == (7, 2, 0, 0)


def test_every_type_and_autopilot_is_decided() -> None:
    yes = [(t, a) for t in range(256) for a in range(256) if is_vehicle(t, a)]
    assert not [pair for pair in yes if pair[1] == mav.MAV_AUTOPILOT_INVALID or pair[0] == mav.MAV_TYPE_GCS]


ARMED, DISARMED = 0x81, 0x01
COPTER = mav.MAV_TYPE_QUADROTOR, mav.MAV_AUTOPILOT_ARDUPILOTMEGA


@each(
    "shown",
    [
        # one mode after another, and a single way back
        [(float(n), ARMED, mode) for n, mode in enumerate([0, 0, 4, 4, 17, 4, 4, 4, 4, 4, 4, 6, 6, 9, 9])],
        [(float(n), base, 0) for n, base in enumerate([DISARMED, ARMED, DISARMED, DISARMED])],
        # as ArduCopter 4.6 shows five orders within two seconds: a heartbeat with each change, and once a second
        [
            *((0.0, ARMED, 4), (1.0, ARMED, 4), (1.2, ARMED, 6), (1.5, ARMED, 4), (1.8, ARMED, 17), (2.1, ARMED, 4)),
            *((2.2, ARMED, 4), (2.6, ARMED, 17), (2.9, ARMED, 4), (3.2, ARMED, 4)),
        ],
    ],
)
def test_changes_of_mode_and_of_arming_are_its_own(shown: list[tuple[float, int, int]]) -> None:
    check = HeartbeatCheck()
    assert [check.judge(*COPTER, base, mode, at) for at, base, mode in shown] == ["own"] * len(shown)
    assert not check.alternating


@each("ack_after_s", [-0.05, 0.4])
def test_changes_that_the_vehicle_acknowledged_are_its_own_however_long_they_go_on(ack_after_s: float) -> None:
    check = HeartbeatCheck()
    happened = [(float(n), "beat", 4 + n % 2) for n in range(20)]
    for at, what, mode in sorted(happened + [(n + 0.5 + ack_after_s, "ack", 0) for n in range(20)]):
        if what == "ack":
            check.expect_change(176, 0, at)
        else:
            assert [check.judge(*COPTER, ARMED, mode, at + later_s) for later_s in (0.0, 0.45)] == ["own"] * 2
    assert not check.alternating


@each("period_s", [0.02, 0.2, 0.5, 1.0])
def test_of_two_that_alternate_the_first_stays(period_s: float) -> None:
    """The second one begins at any time and sends at any rate."""
    check = HeartbeatCheck()
    beats = [(float(n), ARMED, 4) for n in range(20)]
    beats += [(3.3 + n * period_s, DISARMED, 0) for n in range(round(15 / period_s))]
    shown = [(now, base) for now, base, mode in sorted(beats) if check.judge(*COPTER, base, mode, now) == "own"]
    assert {base for now, base in shown if now > 6.5} == {ARMED}
    assert check.alternating


def test_a_px4_that_gets_its_airframe_is_believed_at_once_and_a_new_type_after_a_while() -> None:
    check = HeartbeatCheck()
    assert check.judge(0, 12, 1, 0, 0.0) == "own"
    assert check.judge(2, 12, 1, 0, 1.0) == "own"
    origins = [check.judge(13, 12, 1, 0, 2.0 + n) for n in range(6)]
    assert origins == ["contradicts"] * 4 + ["own"] * 2


def test_sources_of_a_log_are_bounded() -> None:
    checks = HeartbeatChecks()
    sources = [(sysid, compid) for sysid in range(1, 256) for compid in range(1, 8)]
    assert sum(checks.own(heartbeat(*source, 2, 12), 0.0) for source in sources) == 1024


Step = tuple[float, tuple[int, int], int, int, str]
PX4_QUAD, PX4_VTOL, PX4_BARE = (2, 12), (22, 12), (0, 12)


def follow(check: HeartbeatCheck, *steps: list[Step], alternating: bool | None = None) -> None:
    """Each step, by its time: (type, autopilot), base mode, custom mode, and the origin that it must have."""
    for now, (kind, autopilot), base, mode, origin in sorted(chain(*steps)):
        assert check.judge(kind, autopilot, base, mode, now) == origin, f"at {now} s"
        if origin == "contradicts":
            assert check.contradicted_at == now
    assert alternating is None or check.alternating is alternating


def armed(*times: float, mode: int = 4, origin: str = "own") -> list[Step]:
    return [(at, COPTER, ARMED, mode, origin) for at in times]


def disarmed(*times: float, origin: str = "own") -> list[Step]:
    return [(at, COPTER, DISARMED, 0, origin) for at in times]


def test_another_autopilot_is_the_vehicle_only_after_the_known_one_is_lost() -> None:
    """Another type of the same autopilot already after 4 s of silence; never a type that says nothing."""
    check = HeartbeatCheck()
    follow(check, [(0.0, COPTER, ARMED, 4, "own")])
    follow(check, [(at, PX4_QUAD, ARMED, 4, "contradicts") for at in (0.5, 4.5, 5.0)])
    assert check.identity == COPTER
    follow(check, [(5.1, PX4_QUAD, ARMED, 4, "own"), (5.2, COPTER, ARMED, 4, "contradicts")])
    follow(check, [(9.1, PX4_VTOL, ARMED, 4, "contradicts"), (9.2, PX4_BARE, ARMED, 4, "contradicts")])
    assert check.identity == PX4_QUAD
    follow(check, [(9.3, PX4_VTOL, ARMED, 4, "own"), (9.4, PX4_QUAD, ARMED, 4, "contradicts")])
    assert check.identity == PX4_VTOL


def test_how_long_a_vehicle_may_be_silent_is_a_setting_and_any_of_its_messages_counts() -> None:
    check = HeartbeatCheck(lost_s=20.0)
    follow(check, [(0.0, COPTER, ARMED, 4, "own"), (20.0, PX4_QUAD, ARMED, 4, "contradicts")])
    check.heard(19.0)
    follow(check, [(39.0, PX4_QUAD, ARMED, 4, "contradicts"), (39.1, PX4_QUAD, ARMED, 4, "own")])


def test_another_component_is_noted_and_changes_nothing() -> None:
    check = HeartbeatCheck()
    assert check.other_at == check.contradicted_at == float("-inf")
    follow(check, [(0.0, COPTER, ARMED, 4, "own"), (1.0, (6, 8), DISARMED, 0, "other")])
    assert check.other_at == 1.0 and check.identity == COPTER
    camera = HeartbeatCheck(compid=100)
    follow(camera, [(0.0, PX4_BARE, DISARMED, 0, "other")])
    assert camera.identity is None


def test_two_senders_are_told_apart_at_the_third_return() -> None:
    """A state returns three times, 1.9 s between the first and the last: not a moment earlier, nor with less."""
    check = HeartbeatCheck()
    follow(check, armed(0.0, 1.0, 2.0), disarmed(0.5, 1.5, 2.5), alternating=False)
    follow(check, armed(3.0), alternating=True)
    assert check.contradicted_at == 3.0
    follow(check, disarmed(3.5, 4.5, origin="contradicts"), armed(4.0))
    for last, alternating in ((1.99, False), (2.0, True)):  # 1.9 s after 0.1, exactly
        follow(HeartbeatCheck(), armed(-1.0, 0.1, 1.0, last), disarmed(-0.5, 0.5, 1.5), alternating=alternating)


def test_of_two_that_differ_by_their_mode_alone_the_first_stays() -> None:
    check = HeartbeatCheck()
    follow(check, armed(0.0, 1.0, 2.0, 3.0), armed(0.5, 1.5, 2.5, mode=6))
    follow(check, armed(3.5, mode=6, origin="contradicts"), armed(4.0))


def test_a_return_counts_for_six_seconds() -> None:
    """Slow alternation is no evidence: a state that was left for longer has not returned, and returns are forgotten."""
    for last, alternating in ((7.0, True), (7.1, False)):  # the first of its returns was at 1.0
        check = HeartbeatCheck(lost_s=60.0)
        follow(check, armed(0.0, 1.0, 2.0), disarmed(0.5, 1.5, 2.5))
        check.judge(*COPTER, ARMED, 4, last)
        assert check.alternating is alternating, last


def test_an_acknowledged_order_explains_changes_up_to_3_s_later_and_those_of_the_last_second() -> None:
    def found_at(ack_at: float | None, command: int = 400, result: int = 0) -> float | None:
        check = HeartbeatCheck()
        for now, kind, base, mode, _ in sorted(armed(*range(9)) + disarmed(*(n + 0.5 for n in range(9)))):
            check.judge(*kind, base, mode, now)
            if now == ack_at:
                check.expect_change(command, result, now)
            if check.alternating:
                return now
        return None

    assert found_at(None) == 3.0
    assert found_at(0.0, command=511) == found_at(0.0, result=4) == 3.0, "another command, or refused"
    assert found_at(0.0) == 5.5, "of the disarmed one the returns of 3.5, 4.5 and 5.5 count, and 3.0 does not"
    assert found_at(2.0) == 7.5, "it explains the returns of 1.0, 1.5 and 2.0, and what comes until 5.0"
    assert found_at(2.5) == 7.0, "the armed one's first return, of 1.0, is too long ago to be explained"


def test_the_first_sender_stays_although_it_changed_its_mode_meanwhile() -> None:
    """The other one's state is the first to return three times; arming tells which of both it is."""
    check = HeartbeatCheck()
    follow(check, armed(0.0, 1.0), armed(2.0, 3.0, mode=6), disarmed(0.5, 1.5, 2.5))
    follow(check, disarmed(3.5, 4.5, origin="contradicts"), armed(4.0, mode=6))

    # What a state shown for 2.5 s says about arming counts from then on
    for settled_s, last in ((2.5, "contradicts"), (2.4, "own")):
        check, begun = HeartbeatCheck(), 1.0 + settled_s
        follow(check, disarmed(0.0, begun, begun + 1.0), armed(1.0, begun + 0.5), armed(begun + 1.5, mode=6))
        follow(check, disarmed(begun + 2.0, origin=last), alternating=True)


def two_senders() -> HeartbeatCheck:
    """Armed at each full second until 3.0, disarmed at each half."""
    check = HeartbeatCheck()
    follow(check, armed(0.0, 1.0, 2.0, 3.0), disarmed(0.5, 1.5, 2.5), alternating=True)
    return check


def test_when_one_sender_is_left_there_is_one_again() -> None:
    """The vehicle after 4 s without the other; the other one after 4 s without the vehicle, which it then is."""
    for kept, seen, origin, other in (
        (armed, (4.0, 7.0), "own", disarmed),
        (disarmed, (3.5, 5.0, 7.0), "contradicts", armed),
    ):
        check = two_senders()
        follow(check, kept(*seen, origin=origin), alternating=True)
        follow(check, kept(7.1), alternating=False)
        follow(check, other(7.5))


def test_a_state_that_neither_showed_is_the_vehicles_when_it_was_silent_for_1_5_s() -> None:
    check = two_senders()
    follow(check, armed(4.5, mode=6, origin="contradicts"), armed(4.6, 5.0, mode=6), alternating=True)
    follow(check, armed(5.5, origin="contradicts"), armed(6.0, mode=6))
    follow(check, armed(7.6))  # the vehicle's state of before is not the other one's


def test_a_vehicle_that_was_lost_is_alone_again_and_one_that_is_forgotten_begins_anew() -> None:
    check = two_senders()
    follow(check, armed(8.1), alternating=False)
    follow(check, disarmed(8.2))
    check = two_senders()
    check.forget()
    assert not check.alternating and check.identity is None
    follow(check, [(3.2, PX4_QUAD, DISARMED, 1, "own"), (3.4, COPTER, ARMED, 4, "contradicts")])
    check.forget()
    follow(check, armed(4.0, 5.0, 6.0), disarmed(3.5, 4.5, 5.5), alternating=False)  # returns of before count no more


def test_eight_states_are_remembered_as_left() -> None:
    """The oldest goes when another comes: a sender of many states is known by the last eight."""
    for others, alternating in ((7, True), (8, False)):
        check = HeartbeatCheck()
        now = 0.0
        for _ in range(4):
            check.judge(*COPTER, ARMED, 99, now)
            for mode in range(others):
                now += 1.2 / others
                check.judge(*COPTER, ARMED, mode, now)
        assert check.alternating is alternating, others
    for mode in range(1000):
        check.judge(*COPTER, ARMED, mode, 10.0 + mode / 100)
    assert len(check._left) == MAX_STATES


def test_a_logs_sources_are_judged_each_by_itself() -> None:
    checks = HeartbeatChecks()
    ack = mav.MAVLink_command_ack_message(176, 0)
    assert checks.judge(Voice(1, 1).say(ack), 0.0) is None, "no vehicle is known yet"
    for sysid, kind, autopilot, at, origin in (
        *((1, 6, 8, 0.0, None), (1, 2, 12, 0.0, "own"), (1, 2, 3, 1.0, "contradicts")),
        *((1, 6, 8, 1.0, "other"), (2, 2, 3, 1.0, "own")),
    ):
        assert checks.judge(heartbeat(sysid, 1, kind, autopilot), at) == origin
    assert not checks.own(heartbeat(1, 1, 2, 3), 1.0) and checks.own(heartbeat(1, 1, 2, 12), 2.0)
    assert checks.judge(Voice(1, 1).text("hello"), 2.0) is None


def test_acknowledged_orders_explain_changes_in_a_log_too() -> None:
    def contradictions(acknowledged: bool) -> int:
        checks, voice, found = HeartbeatChecks(), Voice(1, 1), 0
        for n in range(12):
            if acknowledged:
                assert checks.judge(voice.say(mav.MAVLink_command_ack_message(176, 0)), n / 2) is None
            beat = mav.MAVLink_heartbeat_message(2, 3, ARMED if n % 2 else DISARMED, n % 2, 4, 3)
            found += checks.judge(voice.say(beat), n / 2) == "contradicts"
        return found

    assert contradictions(acknowledged=True) == 0
    assert contradictions(acknowledged=False) > 0
