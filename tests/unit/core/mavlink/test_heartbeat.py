from __future__ import annotations

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
    ("sysid", "compid", "kind", "autopilot"),
    [
        (1, 1, mav.MAV_TYPE_QUADROTOR, mav.MAV_AUTOPILOT_PX4),
        (1, 1, mav.MAV_TYPE_HEXAROTOR, mav.MAV_AUTOPILOT_ARDUPILOTMEGA),
        (7, 3, mav.MAV_TYPE_FIXED_WING, mav.MAV_AUTOPILOT_ARDUPILOTMEGA),
        (1, 1, mav.MAV_TYPE_SUBMARINE, mav.MAV_AUTOPILOT_ARDUPILOTMEGA),
        (1, 1, mav.MAV_TYPE_GENERIC, mav.MAV_AUTOPILOT_PX4),
        (1, 1, mav.MAV_TYPE_GROUND_ROVER, mav.MAV_AUTOPILOT_GENERIC),
        (1, 1, mav.MAV_TYPE_QUADROTOR, mav.MAV_AUTOPILOT_PPZ),
    ],
)
def test_an_autopilot_is_a_vehicle(sysid: int, compid: int, kind: int, autopilot: int) -> None:
    assert discovers(heartbeat(sysid, compid, kind, autopilot))


@each(
    ("sysid", "compid", "kind", "autopilot"),
    [
        (255, 190, mav.MAV_TYPE_GCS, mav.MAV_AUTOPILOT_INVALID),
        (255, 190, mav.MAV_TYPE_GCS, mav.MAV_AUTOPILOT_ARDUPILOTMEGA),
        (2, 2, mav.MAV_TYPE_GENERIC, mav.MAV_AUTOPILOT_INVALID),
        (1, 0, mav.MAV_TYPE_QUADROTOR, mav.MAV_AUTOPILOT_INVALID),
        (1, 0, mav.MAV_TYPE_ADSB, mav.MAV_AUTOPILOT_INVALID),
        (1, 100, mav.MAV_TYPE_CAMERA, mav.MAV_AUTOPILOT_INVALID),
        (1, 154, mav.MAV_TYPE_GIMBAL, mav.MAV_AUTOPILOT_GENERIC),
        (1, 194, mav.MAV_TYPE_ONBOARD_CONTROLLER, mav.MAV_AUTOPILOT_GENERIC),
        (1, 1, mav.MAV_TYPE_GENERIC, mav.MAV_AUTOPILOT_GENERIC),
        (0, 1, mav.MAV_TYPE_QUADROTOR, mav.MAV_AUTOPILOT_PX4),
        (81, 50, mav.MAV_TYPE_GENERIC, mav.MAV_AUTOPILOT_PX4),  # a PX4Flow
    ],
)
def test_what_is_no_autopilot_is_no_vehicle(sysid: int, compid: int, kind: int, autopilot: int) -> None:
    assert not discovers(heartbeat(sysid, compid, kind, autopilot))


def test_no_message_but_a_verified_heartbeat_makes_a_vehicle() -> None:
    voice = Voice()
    assert not discovers(voice.text("hello"))
    assert not discovers(voice.say(mav.MAVLink_radio_status_message(1, 1, 100, 1, 1, 0, 0)))
    beat = voice.beat()
    assert not discovers(Frame(beat.raw, 0, 1, 1, 0, None))


def test_fields_of_a_heartbeat_whose_zeros_are_not_sent() -> None:
    fields = {"custom_mode": 0x01020304, "type": 2, "autopilot": 12, "base_mode": 0x81, "system_status": 4}
    info = dialect().find("HEARTBEAT")
    whole = Frame(frame("HEARTBEAT", fields), 0, 1, 1, 0, info)
    assert heartbeat_fields(whole) == (0x01020304, 2, 12, 0x81)
    assert shown_by(whole) == bytes((4, 3, 2, 1, 2, 12, 0x81))
    trimmed = Frame(frame("HEARTBEAT", {"custom_mode": 7, "type": 2}), 0, 1, 1, 0, info)
    assert trimmed.raw[1] == 5
    assert heartbeat_fields(trimmed) == (7, 2, 0, 0)


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
    happened = [(float(n), None) for n in range(20)]
    happened += [(n + 0.5 + ack_after_s, 176) for n in range(20)]
    mode = 4
    for at, command in sorted(happened, key=lambda item: item[0]):
        if command is not None:
            check.expect_change(command, 0, at)
        else:
            mode = 4 if mode != 4 else 5
            assert check.judge(*COPTER, ARMED, mode, at) == "own"
            assert check.judge(*COPTER, ARMED, mode, at + 0.45) == "own"
    assert not check.alternating


@each("period_s", [0.02, 0.2, 0.5, 1.0])
def test_of_two_that_alternate_the_first_stays(period_s: float) -> None:
    """The second one begins at any time and sends at any rate."""
    check = HeartbeatCheck()
    heartbeats = [(float(n), ARMED, 4) for n in range(20)]
    heartbeats += [(3.3 + n * period_s, DISARMED, 0) for n in range(round(15 / period_s))]
    shown = []
    for now, base, mode in sorted(heartbeats):
        if check.judge(*COPTER, base, mode, now) == "own":
            shown.append((now, base))
    late = [base for now, base in shown if now > 6.5]
    assert late and set(late) == {ARMED}
    assert check.alternating


def test_a_px4_that_gets_its_airframe_is_believed_at_once_and_a_new_type_after_a_while() -> None:
    check = HeartbeatCheck()
    assert check.judge(0, 12, 1, 0, 0.0) == "own"
    assert check.judge(2, 12, 1, 0, 1.0) == "own"
    origins = [check.judge(13, 12, 1, 0, 2.0 + n) for n in range(6)]
    assert origins == ["contradicts"] * 4 + ["own"] * 2


def test_sources_of_a_log_are_bounded() -> None:
    checks = HeartbeatChecks()
    owned = 0
    for sysid in range(1, 256):
        for compid in range(1, 8):
            owned += checks.own(heartbeat(sysid, compid, 2, 12), 0.0)
    assert owned == 1024


Step = tuple[float, tuple[int, int], int, int, str]
PX4_QUAD, PX4_VTOL, PX4_BARE = (2, 12), (22, 12), (0, 12)


def follow(check: HeartbeatCheck, steps: list[Step]) -> None:
    """Each step: time, (type, autopilot), base mode, custom mode, and the origin that it must have."""
    for now, (kind, autopilot), base, mode, origin in steps:
        assert check.judge(kind, autopilot, base, mode, now) == origin, f"at {now} s"
        if origin == "contradicts":
            assert check.contradicted_at == now


def armed(times: list[float], mode: int = 4, origin: str = "own") -> list[Step]:
    return [(at, COPTER, ARMED, mode, origin) for at in times]


def disarmed(times: list[float], origin: str = "own") -> list[Step]:
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
    both = sorted(armed([0.0, 1.0, 2.0]) + disarmed([0.5, 1.5, 2.5]))
    follow(check, both)
    assert not check.alternating
    follow(check, armed([3.0]))
    assert check.alternating and check.contradicted_at == 3.0
    follow(check, disarmed([3.5], "contradicts") + armed([4.0]) + disarmed([4.5], "contradicts"))

    for last, alternating in ((1.99, False), (2.0, True)):  # 1.9 s after 0.1, exactly
        check = HeartbeatCheck()
        follow(check, sorted(armed([-1.0, 0.1, 1.0, last]) + disarmed([-0.5, 0.5, 1.5])))
        assert check.alternating is alternating, last


def test_of_two_that_differ_by_their_mode_alone_the_first_stays() -> None:
    check = HeartbeatCheck()
    follow(check, sorted(armed([0.0, 1.0, 2.0, 3.0]) + armed([0.5, 1.5, 2.5], 6)))
    follow(check, armed([3.5], 6, "contradicts") + armed([4.0]))


def test_a_return_counts_for_six_seconds() -> None:
    """Slow alternation is no evidence: a state that was left for longer has not returned, and returns are forgotten."""
    for last, alternating in ((7.0, True), (7.1, False)):  # the first of its returns was at 1.0
        check = HeartbeatCheck(lost_s=60.0)
        follow(check, sorted(armed([0.0, 1.0, 2.0]) + disarmed([0.5, 1.5, 2.5])))
        check.judge(*COPTER, ARMED, 4, last)
        assert check.alternating is alternating, last


def test_an_acknowledged_order_explains_changes_up_to_3_s_later_and_those_of_the_last_second() -> None:
    def found_at(ack_at: float | None, command: int = 400, result: int = 0) -> float | None:
        check = HeartbeatCheck()
        for now, kind, base, mode, _ in sorted(
            armed([float(n) for n in range(9)]) + disarmed([n + 0.5 for n in range(9)])
        ):
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
    follow(check, sorted(armed([0.0, 1.0]) + armed([2.0, 3.0], 6) + disarmed([0.5, 1.5, 2.5])))
    follow(check, disarmed([3.5], "contradicts") + armed([4.0], 6) + disarmed([4.5], "contradicts"))

    # What a state shown for 2.5 s says about arming counts from then on
    for settled_s, last in ((2.5, "contradicts"), (2.4, "own")):
        check = HeartbeatCheck()
        begun = 1.0 + settled_s
        follow(check, disarmed([0.0]) + armed([1.0]) + disarmed([begun]))
        follow(check, armed([begun + 0.5]) + disarmed([begun + 1.0]) + armed([begun + 1.5], 6))
        follow(check, disarmed([begun + 2.0], last))
        assert check.alternating


def two_senders() -> HeartbeatCheck:
    """Armed at each full second until 3.0, disarmed at each half."""
    check = HeartbeatCheck()
    follow(check, sorted(armed([0.0, 1.0, 2.0, 3.0]) + disarmed([0.5, 1.5, 2.5])))
    assert check.alternating
    return check


def test_when_one_sender_is_left_there_is_one_again() -> None:
    """The vehicle after 4 s without the other; the other one after 4 s without the vehicle, which it then is."""
    check = two_senders()
    follow(check, armed([4.0, 7.0]))
    assert check.alternating
    follow(check, armed([7.1]))
    assert not check.alternating
    follow(check, disarmed([7.5]))

    check = two_senders()
    follow(check, disarmed([3.5, 5.0, 7.0], "contradicts"))
    assert check.alternating
    follow(check, disarmed([7.1]))
    assert not check.alternating
    follow(check, armed([7.5]))


def test_a_state_that_neither_showed_is_the_vehicles_when_it_was_silent_for_1_5_s() -> None:
    check = two_senders()
    follow(check, armed([4.5], 6, "contradicts") + armed([4.6, 5.0], 6))
    assert check.alternating
    follow(check, armed([5.5], 4, "contradicts") + armed([6.0], 6))
    follow(check, armed([7.6], 4))  # the vehicle's state of before is not the other one's


def test_a_vehicle_that_was_lost_is_alone_again() -> None:
    check = two_senders()
    follow(check, armed([8.1]))
    assert not check.alternating
    follow(check, disarmed([8.2]))


def test_a_vehicle_that_is_forgotten_begins_anew() -> None:
    check = two_senders()
    check.forget()
    assert not check.alternating and check.identity is None
    follow(check, [(3.2, PX4_QUAD, DISARMED, 1, "own"), (3.4, COPTER, ARMED, 4, "contradicts")])
    check.forget()
    follow(check, sorted(armed([4.0, 5.0, 6.0]) + disarmed([3.5, 4.5, 5.5])))
    assert not check.alternating, "returns of before count no more"


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
    assert checks.judge(heartbeat(1, 1, 6, 8), 0.0) is None
    assert checks.judge(heartbeat(1, 1, 2, 12), 0.0) == "own"
    assert checks.judge(heartbeat(1, 1, 2, 3), 1.0) == "contradicts"
    assert checks.judge(heartbeat(1, 1, 6, 8), 1.0) == "other"
    assert checks.judge(heartbeat(2, 1, 2, 3), 1.0) == "own"
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
