"""A simulated PX4 behaves as PX4 does where a ground station notices, judged by pymavlink."""

from __future__ import annotations

from math import cos, hypot, isnan, nan, sin

import pytest
from pymavlink import mavutil
from pymavlink.dialects.v20 import ardupilotmega as mav

from skygcs.sim.firmware_modes import Px4Mode
from skygcs.sim.px4 import wanted_mode
from support.sim_pilot import Pilot, int_param, px4, px4_mode
from support.table import each

REJECTED = mav.MAV_RESULT_TEMPORARILY_REJECTED
ACCEPTED = mav.MAV_RESULT_ACCEPTED
POSITION_ONLY = 0xDF8
VELOCITY_ONLY = 0xDC7


def set_mode(pilot: Pilot, mode: Px4Mode) -> int | None:
    return pilot.command(mav.MAV_CMD_DO_SET_MODE, 1, mode >> 16 & 0xFF, mode >> 24 & 0xFF)


def setpoint(mask: int = POSITION_ONLY, **fields: float) -> mav.MAVLink_message:
    keys = ("x", "y", "z", "vx", "vy", "vz", "afx", "afy", "afz", "yaw", "yaw_rate")
    values = [fields.get(key, 0.0) for key in keys]
    return mav.MAVLink_set_position_target_local_ned_message(0, 1, 1, mav.MAV_FRAME_LOCAL_NED, mask, *values)


def stream(pilot: Pilot, seconds: float, message: mav.MAVLink_message, rate_hz: float = 10.0) -> None:
    for _ in range(round(seconds * rate_hz)):
        pilot.send(message)
        pilot.run(1 / rate_hz)


@pytest.fixture
def pilot() -> Pilot:
    return Pilot(px4())


def test_its_heartbeat_is_that_of_a_captured_px4(pilot: Pilot) -> None:
    pilot.run(2)
    beat = pilot.last("HEARTBEAT")
    assert (beat.base_mode, beat.custom_mode, beat.system_status) == (29, 50593792, 3)
    assert mavutil.mode_string_v10(beat) == "LOITER"
    pilot.hovering()
    pilot.run(2)
    beat = pilot.last("HEARTBEAT")
    assert (beat.base_mode, beat.custom_mode, beat.system_status) == (157, 50593792, 4)


def test_take_off_is_to_an_amsl_altitude_and_ends_in_loiter(pilot: Pilot) -> None:
    pilot.get_ready()
    assert pilot.command(mav.MAV_CMD_NAV_TAKEOFF, 0, 0, 0, nan, nan, nan, 195.0) == ACCEPTED
    assert px4_mode(pilot) == Px4Mode.TAKEOFF
    assert pilot.command(mav.MAV_CMD_COMPONENT_ARM_DISARM, 1) == ACCEPTED
    pilot.run(5)
    assert pilot.last("EXTENDED_SYS_STATE").landed_state == mav.MAV_LANDED_STATE_TAKEOFF
    pilot.run(25)
    assert pilot.last("GLOBAL_POSITION_INT").relative_alt == pytest.approx(15_000, abs=300)
    assert px4_mode(pilot) == Px4Mode.LOITER
    assert pilot.texts()[-2:] == ["Armed by external command", "Takeoff detected"]


def test_a_relative_take_off_height_is_below_the_field_and_does_not_lift_it(pilot: Pilot) -> None:
    pilot.get_ready()
    assert pilot.command(mav.MAV_CMD_NAV_TAKEOFF, 0, 0, 0, nan, nan, nan, 10.0) == ACCEPTED
    pilot.command(mav.MAV_CMD_COMPONENT_ARM_DISARM, 1)
    pilot.run(15)
    assert pilot.vehicles[0].motion.up_m == 0
    assert "Already higher than takeoff altitude" in pilot.texts()
    assert not pilot.vehicles[0].armed, "and it disarms itself"


def test_take_off_without_an_altitude_and_by_mode_use_the_parameter() -> None:
    for order in ("command", "mode"):
        pilot = Pilot(px4())
        pilot.get_ready()
        if order == "command":
            pilot.command(mav.MAV_CMD_NAV_TAKEOFF, 0, 0, 0, nan, nan, nan, nan)
        else:
            assert set_mode(pilot, Px4Mode.TAKEOFF) == ACCEPTED
        pilot.command(mav.MAV_CMD_COMPONENT_ARM_DISARM, 1)
        pilot.run(15)
        assert pilot.last("GLOBAL_POSITION_INT").relative_alt == pytest.approx(2500, abs=300)


def test_a_take_off_with_zero_coordinates_flies_towards_zero_zero(pilot: Pilot) -> None:
    pilot.get_ready()
    pilot.command(mav.MAV_CMD_NAV_TAKEOFF, 0, 0, 0, 0, 0, 0, 190.0)
    pilot.command(mav.MAV_CMD_COMPONENT_ARM_DISARM, 1)
    pilot.run(60)
    motion = pilot.vehicles[0].motion
    assert motion.north_m < -50 and motion.east_m > 50


def test_reposition_flies_there_in_loiter_and_nan_keeps_what_it_has(pilot: Pilot) -> None:
    pilot.hovering()
    lat, lon = pilot.vehicles[0].where.to_geodetic(20.0, 30.0)
    assert (
        pilot.command_int(mav.MAV_CMD_DO_REPOSITION, -1, 1, 0, nan, x=round(lat * 1e7), y=round(lon * 1e7), z=195.0)
        == ACCEPTED
    )
    pilot.run(25)
    motion = pilot.vehicles[0].motion
    assert motion.distance_m(20, 30, 15) < 0.2
    assert pilot.command_int(mav.MAV_CMD_DO_REPOSITION, -1, 1, 0, 1.5, x=2**31 - 1, y=2**31 - 1, z=nan) == ACCEPTED
    pilot.run(10)
    assert motion.distance_m(20, 30, 15) < 0.2 and motion.yaw_rad == pytest.approx(1.5, abs=0.01)
    assert pilot.command(mav.MAV_CMD_DO_REPOSITION, 2.0, 1, 0, nan, lat - 0.0005, lon, nan) == ACCEPTED
    pilot.run(8)
    assert pilot.last("VFR_HUD").groundspeed == pytest.approx(2.0, abs=0.1), "at the speed asked for"


def test_reposition_changes_the_mode_only_with_the_flag(pilot: Pilot) -> None:
    pilot.hovering()
    set_mode(pilot, Px4Mode.LAND)
    answer = pilot.command(mav.MAV_CMD_DO_REPOSITION, -1, 0, 0, nan, nan, nan, 200.0)
    assert answer == mav.MAV_RESULT_UNSUPPORTED
    assert px4_mode(pilot) == Px4Mode.LAND
    assert pilot.command(mav.MAV_CMD_DO_REPOSITION, -1, 1, 0, nan, nan, nan, 200.0) == ACCEPTED
    assert px4_mode(pilot) == Px4Mode.LOITER
    pilot.run(15)
    assert pilot.vehicles[0].motion.up_m == pytest.approx(20, abs=0.3)


def test_landing_disarms_two_seconds_after_the_landing_is_detected(pilot: Pilot) -> None:
    pilot.hovering(5)
    assert pilot.command(mav.MAV_CMD_NAV_LAND) == ACCEPTED
    pilot.run(3)
    assert pilot.last("EXTENDED_SYS_STATE").landed_state == mav.MAV_LANDED_STATE_LANDING
    while pilot.vehicles[0].armed:
        assert pilot.now < 120
        pilot.run(0.1)
    landed, disarmed = (next(x for x in pilot.all("STATUSTEXT") if word in x.text) for word in ("Landing d", "Disarm"))
    assert landed.text == "Landing detected\t" and disarmed.text == "Disarmed by landing\t"
    assert pilot.now - pilot.vehicles[0].landed_at == pytest.approx(2.0, abs=0.15)
    pilot.run(2)
    assert pilot.last("HEARTBEAT").custom_mode == 50593792, "back in loiter, as in the capture"
    assert pilot.texts()[:1] == ["Landing at current position"]


def test_offboard_needs_a_fresh_setpoint_and_falls_back_when_they_end(pilot: Pilot) -> None:
    """offboardCheck.cpp: the newest setpoint is younger than COM_OF_LOSS_T, and no more."""
    pilot.hovering()
    pilot.vehicles[0].params.set("COM_OBL_RC_ACT", int_param(5))
    assert set_mode(pilot, Px4Mode.OFFBOARD) == REJECTED, "no setpoints"
    stream(pilot, 0.5, setpoint(z=-10))
    pilot.run(1.1)
    assert set_mode(pilot, Px4Mode.OFFBOARD) == REJECTED, "too old"
    stream(pilot, 0.1, setpoint(z=-10))
    assert set_mode(pilot, Px4Mode.OFFBOARD) == ACCEPTED
    stream(pilot, 20, setpoint(x=15, y=-5, z=-12))
    motion = pilot.vehicles[0].motion
    assert motion.distance_m(-5, 15, 12) < 0.2
    beat = pilot.last("HEARTBEAT")
    assert (beat.base_mode, beat.custom_mode) == (145, 393216), "as in the capture"
    pilot.run(0.8)
    assert px4_mode(pilot) == Px4Mode.OFFBOARD
    pilot.run(0.4)
    assert px4_mode(pilot) == Px4Mode.LOITER
    pilot.run(1.1)
    assert pilot.last("HEARTBEAT").system_status == mav.MAV_STATE_CRITICAL
    assert any("offboard" in text for text in pilot.texts())


def test_offboard_follows_velocity_yaw_and_global_setpoints(pilot: Pilot) -> None:
    pilot.hovering()
    stream(pilot, 1.5, setpoint(VELOCITY_ONLY, vx=1.0))
    set_mode(pilot, Px4Mode.OFFBOARD)
    stream(pilot, 5, setpoint(VELOCITY_ONLY & ~0x400, vx=2.0, vy=1.0, vz=-0.5, yaw=1.0))
    motion = pilot.vehicles[0].motion
    assert (motion.vel_n_mps, motion.vel_e_mps, motion.vel_u_mps) == pytest.approx((2, 1, 0.5), abs=0.05)
    assert motion.yaw_rad == pytest.approx(1.0)
    lat, lon = pilot.vehicles[0].where.to_geodetic(3.0, 4.0)
    frame, place = mav.MAV_FRAME_GLOBAL_RELATIVE_ALT_INT, (round(lat * 1e7), round(lon * 1e7), 14.0)
    goal = mav.MAVLink_set_position_target_global_int_message(0, 1, 1, frame, POSITION_ONLY, *place, *[0] * 8)
    stream(pilot, 25, goal)
    assert motion.distance_m(3, 4, 14) < 0.2


def test_offboard_takes_off_from_the_ground(pilot: Pilot) -> None:
    pilot.get_ready()
    stream(pilot, 1.5, setpoint(z=-3))
    assert set_mode(pilot, Px4Mode.OFFBOARD) == ACCEPTED
    assert pilot.command(mav.MAV_CMD_COMPONENT_ARM_DISARM, 1) == ACCEPTED
    stream(pilot, 12, setpoint(z=-3))
    assert pilot.vehicles[0].motion.up_m == pytest.approx(3, abs=0.2)


def test_a_mode_change_is_acknowledged_twice_as_px4_does(pilot: Pilot) -> None:
    set_mode(pilot, Px4Mode.POSCTL)
    assert [a.result for a in pilot.all("COMMAND_ACK")] == [ACCEPTED, ACCEPTED]


@each("mode", [Px4Mode.MANUAL, Px4Mode.ALTCTL, Px4Mode.POSCTL, Px4Mode.STABILIZED, Px4Mode.ACRO])
def test_without_a_transmitter_manual_modes_are_for_the_disarmed(mode: Px4Mode) -> None:
    pilot = Pilot(px4())
    pilot.get_ready()
    assert set_mode(pilot, mode) == ACCEPTED
    pilot.run(2)
    assert mavutil.mode_string_v10(pilot.last("HEARTBEAT")) == mode.name
    assert pilot.command(mav.MAV_CMD_COMPONENT_ARM_DISARM, 1) == REJECTED
    assert any("Resolve system health" in text for text in pilot.texts())
    set_mode(pilot, Px4Mode.LOITER)
    pilot.take_off()
    assert set_mode(pilot, mode) == REJECTED


def test_modes_it_cannot_fly_are_rejected_with_a_text(pilot: Pilot) -> None:
    pilot.get_ready()
    pilot.take_off()
    assert set_mode(pilot, Px4Mode.MISSION) == REJECTED
    assert pilot.command(mav.MAV_CMD_DO_SET_MODE, 1, 4, 42) == REJECTED, "no such mode of AUTO"
    assert pilot.command(mav.MAV_CMD_DO_SET_MODE, 1, 42, 0) == ACCEPTED, "Commander.cpp: names no mode, is not denied"
    assert pilot.command(mav.MAV_CMD_DO_SET_MODE, 0, 4, 3) == ACCEPTED, "no custom mode flag, and no base mode"
    assert pilot.command(mav.MAV_CMD_MISSION_START) == mav.MAV_RESULT_DENIED
    assert px4_mode(pilot) == Px4Mode.LOITER
    assert len([t for t in pilot.texts() if "not possible" in t]) == 1 and "Unsupported auto mode" in pilot.texts()
    assert "Mission start denied! No valid mission" in pilot.texts()


@each(
    ("base", "mode"),
    [(4, Px4Mode.MISSION), (64, Px4Mode.MANUAL), (64 | 16, Px4Mode.STABILIZED), (64 | 8, Px4Mode.POSCTL)],
)
def test_a_base_mode_names_a_mode_where_no_custom_one_is_given(base: int, mode: Px4Mode) -> None:
    """Commander.cpp, VEHICLE_CMD_DO_SET_MODE; DroneKit's PX4 guide starts missions so."""
    assert wanted_mode(base, 0, 0) == mode
    pilot = Pilot(px4())
    pilot.get_ready()
    assert pilot.command(mav.MAV_CMD_DO_SET_MODE, base, 0, 0) == ACCEPTED, "disarmed, without a mission as well"
    assert px4_mode(pilot) == mode


def test_auto_without_a_sub_mode_is_a_mission() -> None:
    assert wanted_mode(1, 4, 0) == Px4Mode.MISSION
    assert wanted_mode(1, 6, 9) == Px4Mode.OFFBOARD, "which has no sub modes"


def test_the_deprecated_set_mode_message_works(pilot: Pilot) -> None:
    answer = pilot.send(mav.MAVLink_set_mode_message(1, 1, int(Px4Mode.POSCTL)))
    assert [(a.command, a.result) for a in answer] == [(mav.MAV_CMD_DO_SET_MODE, ACCEPTED)]
    assert px4_mode(pilot) == Px4Mode.POSCTL


def test_data_stream_requests_change_nothing(pilot: Pilot) -> None:
    pilot.get_ready()
    before = pilot.rate_hz("ATTITUDE")
    pilot.send(mav.MAVLink_request_data_stream_message(1, 1, mav.MAV_DATA_STREAM_ALL, 20, 1))
    assert pilot.rate_hz("ATTITUDE") == pytest.approx(before, abs=0.1)


def test_parameters_change_how_it_flies(pilot: Pilot) -> None:
    pilot.hovering()
    pilot.send(mav.MAVLink_param_set_message(1, 1, b"MPC_XY_CRUISE", 2.0, mav.MAV_PARAM_TYPE_REAL32))
    lat, lon = pilot.vehicles[0].where.to_geodetic(60.0, 0.0)
    pilot.command(mav.MAV_CMD_DO_REPOSITION, -1, 1, 0, nan, lat, lon, nan)
    pilot.run(10)
    assert pilot.last("VFR_HUD").groundspeed == pytest.approx(2.0, abs=0.05)


def test_a_new_system_id_holds_from_the_next_boot() -> None:
    pilot = Pilot(px4(1))
    wire = 11 * 2.0**-149  # the integer 11 byte-wise
    pilot.send(mav.MAVLink_param_set_message(1, 1, b"MAV_SYS_ID", wire, mav.MAV_PARAM_TYPE_INT32))
    pilot.run(2)
    assert pilot.heard[-1].get_srcSystem() == 1
    pilot.command(mav.MAV_CMD_PREFLIGHT_REBOOT_SHUTDOWN, 1)
    pilot.forget()
    pilot.run(4)
    assert {x.get_srcSystem() for x in pilot.heard} == {11}


def test_its_default_streams_fit_a_telemetry_port(pilot: Pilot) -> None:
    pilot.get_ready()
    pilot.raw.clear()
    pilot.run(30)
    assert 300 < sum(map(len, pilot.raw)) / 30 < 800
    assert not isnan(pilot.last("ALTITUDE").altitude_relative)


def test_files_that_are_not_there_are_refused_and_not_met_with_silence(pilot: Pilot) -> None:
    """mavlink_ftp.cpp: ENOENT is answered as kErrFileNotFound."""
    path = b"/etc/extras/component_general.json.xz"
    for opcode, answer in ((4, 129), (3, 129), (15, 129), (2, 128), (1, 128), (99, 129)):
        data = bytes([7, 0, 0, opcode, len(path), 0, 0, 0, 0, 0, 0, 0]) + path
        (reply,) = [
            m
            for m in pilot.send(mav.MAVLink_file_transfer_protocol_message(0, 1, 1, list(data.ljust(251, b"\0"))))
            if m.get_type() == "FILE_TRANSFER_PROTOCOL"
        ]
        payload = bytes(reply.payload)
        assert (payload[0], payload[3], payload[5]) == (8, answer, opcode)
        if answer == 129:
            assert payload[12] == (7 if opcode == 99 else 10)
    nak = bytes([7, 0, 0, 129, 0, 4, 0, 0, 0, 0, 0, 0]).ljust(251, b"\0")
    assert not pilot.send(mav.MAVLink_file_transfer_protocol_message(0, 1, 1, list(nak)))


def test_odometry_agrees_with_the_other_messages(pilot: Pilot) -> None:
    pilot.hovering()
    stream(pilot, 0.2, setpoint(VELOCITY_ONLY & ~0x400, vx=2.0, vy=1.0, yaw=1.0))
    set_mode(pilot, Px4Mode.OFFBOARD)
    stream(pilot, 6, setpoint(VELOCITY_ONLY & ~0x400, vx=2.0, vy=1.0, yaw=1.0))
    assert pilot.command(mav.MAV_CMD_REQUEST_MESSAGE, mav.MAVLINK_MSG_ID_ODOMETRY) == 0
    assert pilot.command(mav.MAV_CMD_REQUEST_MESSAGE, mav.MAVLINK_MSG_ID_LOCAL_POSITION_NED) == 0
    pilot.run(0.1)
    reported, local = pilot.last("ODOMETRY"), pilot.last("LOCAL_POSITION_NED")
    assert (reported.frame_id, reported.child_frame_id) == (mav.MAV_FRAME_LOCAL_NED, mav.MAV_FRAME_BODY_FRD)
    assert (reported.x, reported.y, reported.z) == pytest.approx((local.x, local.y, local.z), abs=0.5)
    forward, right = 2 * cos(1.0) + 1 * sin(1.0), -2 * sin(1.0) + 1 * cos(1.0)
    assert (reported.vx, reported.vy) == pytest.approx((forward, right), abs=0.3)


def test_return_climbs_flies_home_and_lands_there(pilot: Pilot) -> None:
    pilot.hovering(8)
    lat, lon = pilot.vehicles[0].where.to_geodetic(40.0, 0.0)
    pilot.command(mav.MAV_CMD_DO_REPOSITION, -1, 1, 0, nan, lat, lon, nan)
    pilot.run(25)
    assert pilot.command(mav.MAV_CMD_NAV_RETURN_TO_LAUNCH) == ACCEPTED
    highest = 0.0
    for _ in range(120):
        pilot.run(1)
        highest = max(highest, pilot.vehicles[0].motion.up_m)
    assert highest == pytest.approx(30, abs=0.5)
    motion = pilot.vehicles[0].motion
    assert motion.on_ground and hypot(motion.east_m, motion.north_m) < 0.5
    assert not pilot.vehicles[0].armed
