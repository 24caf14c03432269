from __future__ import annotations

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mav

from skygcs.core.mavlink.frame import Frame
from skygcs.core.mavlink.heartbeat import HeartbeatCheck, HeartbeatChecks, discovers, is_vehicle
from support.vehicles import Voice


def heartbeat(sysid: int, compid: int, kind: int, autopilot: int) -> Frame:
    return Voice(sysid, compid).say(mav.MAVLink_heartbeat_message(kind, autopilot, 1, 0, 3, 3))


@pytest.mark.parametrize(
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


@pytest.mark.parametrize(
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


def test_every_type_and_autopilot_is_decided() -> None:
    yes = [(t, a) for t in range(256) for a in range(256) if is_vehicle(t, a)]
    assert not [pair for pair in yes if pair[1] == mav.MAV_AUTOPILOT_INVALID or pair[0] == mav.MAV_TYPE_GCS]


ARMED, DISARMED = 0x81, 0x01
COPTER = mav.MAV_TYPE_QUADROTOR, mav.MAV_AUTOPILOT_ARDUPILOTMEGA


def test_mode_changes_and_a_single_way_back_are_its_own() -> None:
    check = HeartbeatCheck()
    modes = [0, 0, 4, 4, 17, 4, 4, 4, 4, 4, 4, 6, 6, 9, 9]
    assert [check.judge(*COPTER, ARMED, mode, float(n)) for n, mode in enumerate(modes)] == ["own"] * len(modes)


def test_arming_and_disarming_once_is_its_own() -> None:
    check = HeartbeatCheck()
    bases = [DISARMED, ARMED, DISARMED, DISARMED]
    assert [check.judge(*COPTER, base, 0, float(n)) for n, base in enumerate(bases)] == ["own"] * 4


def test_a_quick_series_of_changes_is_its_own() -> None:
    """As ArduCopter 4.6 shows five orders within two seconds: a heartbeat with each change, and once a second."""
    check = HeartbeatCheck()
    modes = [4, 4, 6, 4, 17, 4, 4, 17, 4, 4]
    times = [0.0, 1.0, 1.2, 1.5, 1.8, 2.1, 2.2, 2.6, 2.9, 3.2]
    assert [check.judge(*COPTER, ARMED, mode, at) for mode, at in zip(modes, times, strict=True)] == ["own"] * 10
    assert not check.alternating


@pytest.mark.parametrize("ack_after_s", [-0.05, 0.4])
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


def test_a_refused_order_and_one_for_something_else_explain_no_change() -> None:
    check = HeartbeatCheck()
    for n in range(12):
        check.expect_change(176, 4, n + 0.1)
        check.expect_change(511, 0, n + 0.1)
        check.judge(*COPTER, ARMED, 4, float(n))
        check.judge(*COPTER, DISARMED, 0, n + 0.5)
    assert check.alternating


@pytest.mark.parametrize("period_s", [0.02, 0.2, 0.5, 1.0])
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


def test_a_real_mode_change_shows_while_another_sender_alternates() -> None:
    check = HeartbeatCheck()
    now = 0.0
    for _ in range(10):
        check.judge(*COPTER, ARMED, 4, now)
        check.judge(*COPTER, DISARMED, 0, now + 0.5)
        now += 1.0
    assert check.alternating
    origins = []
    for _ in range(4):
        origins.append(check.judge(*COPTER, ARMED, 17, now))
        assert check.judge(*COPTER, DISARMED, 0, now + 0.5) == "contradicts"
        now += 1.0
    assert "own" in origins[:3] and origins[-1] == "own"


def test_the_only_one_left_is_believed() -> None:
    check = HeartbeatCheck()
    for n in range(10):
        check.judge(*COPTER, ARMED, 4, float(n))
        check.judge(*COPTER, DISARMED, 0, n + 0.5)
    origins = [check.judge(*COPTER, DISARMED, 0, n + 0.5) for n in range(10, 18)]
    assert origins[0] == "contradicts" and origins[-1] == "own"
    assert not check.alternating


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
