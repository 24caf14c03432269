"""A simulated ArduCopter behaves as ArduCopter does where a ground station notices, judged by pymavlink."""

from __future__ import annotations

from math import hypot, nan

import pytest
from pymavlink import mavutil
from pymavlink.dialects.v20 import ardupilotmega as mav

from skygcs.sim.ardupilot import FORCE, CopterVehicle
from skygcs.sim.firmware_modes import CopterMode
from support.sim_pilot import COPTER_GUIDED, Pilot, copter
from support.table import each

ACCEPTED, DENIED, FAILED = mav.MAV_RESULT_ACCEPTED, mav.MAV_RESULT_DENIED, mav.MAV_RESULT_FAILED
RELATIVE = mav.MAV_FRAME_GLOBAL_RELATIVE_ALT
POSITION_ONLY = 0xDF8
VELOCITY_ONLY = 0xDC7


def set_mode(pilot: Pilot, mode: int) -> int | None:
    return pilot.command(mav.MAV_CMD_DO_SET_MODE, 1, mode)


def global_target(
    pilot: Pilot, east: float, north: float, alt: float, *, mask: int = POSITION_ONLY, frame: int = 6, **v: float
) -> mav.MAVLink_message:
    lat, lon = pilot.vehicles[0].where.to_geodetic(east, north)
    velocity = [v.get(k, 0.0) for k in ("vx", "vy", "vz")]
    rest = [0.0, 0.0, 0.0, v.get("yaw", 0.0), 0.0]
    return mav.MAVLink_set_position_target_global_int_message(
        0, 1, 1, frame, mask, round(lat * 1e7), round(lon * 1e7), alt, *velocity, *rest
    )


@pytest.fixture
def pilot() -> Pilot:
    return Pilot(copter())


def test_its_heartbeats_are_those_of_a_captured_copter(pilot: Pilot) -> None:
    pilot.run(2)
    beat = pilot.last("HEARTBEAT")
    assert (beat.base_mode, beat.custom_mode, beat.system_status) == (81, 0, 3)
    assert set_mode(pilot, COPTER_GUIDED) == ACCEPTED
    beat = pilot.last("HEARTBEAT")
    assert (beat.base_mode, beat.custom_mode) == (89, 4), "a mode change is told at once"
    assert mavutil.mode_string_v10(beat) == "GUIDED"
    pilot.hovering()
    pilot.run(2)
    beat = pilot.last("HEARTBEAT")
    assert (beat.base_mode, beat.custom_mode, beat.system_status) == (217, 4, 4)


def test_it_says_its_version_and_frame_at_boot_and_on_request(pilot: Pilot) -> None:
    pilot.run(3)
    assert pilot.texts()[0].startswith("ArduCopter V4.6.3") and "Frame: QUAD/X" in pilot.texts()
    pilot.forget()
    assert pilot.command(mav.MAV_CMD_DO_SEND_BANNER) == ACCEPTED
    pilot.run(3)
    assert pilot.texts()[0].startswith("ArduCopter V4.6.3")


def test_failing_checks_are_told_every_thirty_seconds_until_they_pass() -> None:
    vehicle = copter()
    vehicle.faults.gps_lost = True
    pilot = Pilot(vehicle)
    pilot.command(mav.MAV_CMD_DO_SET_MODE, 1, COPTER_GUIDED)
    pilot.run(100)
    assert pilot.texts().count("PreArm: Need Position Estimate") == 4
    vehicle.faults.gps_lost = False
    pilot.run(1)
    pilot.forget()
    pilot.run(60)
    assert not [t for t in pilot.texts() if t.startswith("PreArm")]
    vehicle.faults.refuse_arming = "Compass not calibrated"
    assert pilot.command(mav.MAV_CMD_RUN_PREARM_CHECKS) == ACCEPTED
    assert pilot.texts()[-1] == "PreArm: Compass not calibrated"


@each("mode", ["AUTO", "RTL", "LAND", "BRAKE", "CIRCLE", "SMART_RTL"])
def test_modes_that_are_not_for_arming_refuse_it(mode: str) -> None:
    pilot = Pilot(copter())
    pilot.get_ready()
    assert set_mode(pilot, CopterMode[mode]) == ACCEPTED
    assert pilot.command(mav.MAV_CMD_COMPONENT_ARM_DISARM, 1) == FAILED
    assert pilot.texts()[-1] == f"Arm: {mode} mode not armable"
    assert pilot.command(mav.MAV_CMD_COMPONENT_ARM_DISARM, 1, FORCE) == ACCEPTED, "allows_arming is not asked then"


def test_auto_arms_with_the_bit_of_auto_options() -> None:
    vehicle = copter()
    pilot = Pilot(vehicle)
    pilot.get_ready()
    vehicle.params.set("AUTO_OPTIONS", 1)
    assert set_mode(pilot, CopterMode.AUTO) == ACCEPTED
    assert pilot.command(mav.MAV_CMD_COMPONENT_ARM_DISARM, 1) == ACCEPTED


def test_take_off_is_relative_and_only_armed_in_guided_on_the_ground(pilot: Pilot) -> None:
    pilot.get_ready()

    def take_off(height: float) -> int | None:
        return pilot.command(mav.MAV_CMD_NAV_TAKEOFF, 0, 0, 0, 0, 0, 0, height)

    assert take_off(10) == FAILED, "neither armed nor guided"
    set_mode(pilot, COPTER_GUIDED)
    assert take_off(10) == FAILED, "not armed"
    set_mode(pilot, CopterMode.LOITER)
    pilot.command(mav.MAV_CMD_COMPONENT_ARM_DISARM, 1)
    assert take_off(10) == FAILED, "not guided"
    set_mode(pilot, COPTER_GUIDED)
    assert take_off(0) == FAILED, "no height"
    assert pilot.command_int(mav.MAV_CMD_NAV_TAKEOFF, z=190.0, frame=mav.MAV_FRAME_GLOBAL) == DENIED
    assert pilot.command_int(mav.MAV_CMD_NAV_TAKEOFF, z=10.0, frame=RELATIVE) == ACCEPTED
    pilot.run(4)
    assert pilot.last("EXTENDED_SYS_STATE").landed_state == mav.MAV_LANDED_STATE_TAKEOFF
    assert pilot.last("HEARTBEAT").custom_mode == COPTER_GUIDED
    pilot.run(16)
    assert pilot.last("GLOBAL_POSITION_INT").relative_alt == pytest.approx(10_000, abs=300)
    assert take_off(20) == FAILED, "already flying"


def test_guided_flies_to_position_targets_in_each_frame(pilot: Pilot) -> None:
    pilot.hovering()
    motion = pilot.vehicles[0].motion
    pilot.send(global_target(pilot, 20, -10, 14.0, frame=mav.MAV_FRAME_GLOBAL_RELATIVE_ALT_INT))
    pilot.run(20)
    assert motion.distance_m(20, -10, 14) < 0.2
    pilot.send(global_target(pilot, 0, 0, 192.0, frame=mav.MAV_FRAME_GLOBAL_INT))
    pilot.run(20)
    assert motion.distance_m(0, 0, 12) < 0.2
    message = mav.MAVLink_set_position_target_local_ned_message(
        0, 1, 1, mav.MAV_FRAME_LOCAL_OFFSET_NED, POSITION_ONLY, 5, 6, -1, *[0] * 8
    )
    pilot.send(message)
    pilot.run(20)
    assert motion.distance_m(6, 5, 13) < 0.2


def test_the_seeds_null_island_mask_flies_to_null_island(pilot: Pilot) -> None:
    pilot.hovering()
    # a mistake in the UTIAS scripts: velocity mask one bit short, which leaves position 0, 0, 0 active
    pilot.send(mav.MAVLink_set_position_target_global_int_message(0, 1, 1, 6, 0b010111000000, *[0] * 11))
    pilot.run(30)
    motion = pilot.vehicles[0].motion
    assert motion.north_m < -40, "towards the equator"


def test_a_velocity_target_lasts_three_seconds(pilot: Pilot) -> None:
    pilot.hovering()
    pilot.send(global_target(pilot, 0, 0, 0, mask=VELOCITY_ONLY, vx=2.0))
    pilot.run(2.5)
    assert pilot.vehicles[0].motion.vel_n_mps == pytest.approx(2.0, abs=0.15)
    pilot.run(4)
    assert pilot.vehicles[0].motion.groundspeed_mps < 0.1


def test_targets_outside_guided_or_on_the_ground_do_nothing(pilot: Pilot) -> None:
    pilot.get_ready()
    set_mode(pilot, COPTER_GUIDED)
    pilot.command(mav.MAV_CMD_COMPONENT_ARM_DISARM, 1)
    pilot.send(global_target(pilot, 20, 0, 10.0))
    pilot.run(5)
    assert pilot.vehicles[0].motion.on_ground
    pilot.command(mav.MAV_CMD_NAV_TAKEOFF, 0, 0, 0, 0, 0, 0, 10)
    pilot.run(20)
    set_mode(pilot, CopterMode.LOITER)
    pilot.send(global_target(pilot, 20, 0, 10.0))
    pilot.run(10)
    assert pilot.vehicles[0].motion.distance_m(0, 0, 10) < 0.3


def test_reposition_needs_guided_or_the_flag_and_a_place(pilot: Pilot) -> None:
    pilot.hovering()
    lat, lon = pilot.vehicles[0].where.to_geodetic(15.0, 15.0)
    x, y = round(lat * 1e7), round(lon * 1e7)
    set_mode(pilot, CopterMode.LOITER)
    assert pilot.command_int(mav.MAV_CMD_DO_REPOSITION, -1, 0, x=x, y=y, z=12, frame=RELATIVE) == DENIED
    assert pilot.command_int(mav.MAV_CMD_DO_REPOSITION, -1, 1, x=x, y=y, z=nan, frame=RELATIVE) == DENIED
    assert pilot.command_int(mav.MAV_CMD_DO_REPOSITION, -1, 1, x=2**31 - 1, y=y, z=12, frame=RELATIVE) == DENIED
    assert pilot.command_int(mav.MAV_CMD_DO_REPOSITION, -1, 1, x=x, y=y, z=12, frame=RELATIVE) == ACCEPTED
    assert pilot.vehicles[0].mode == CopterMode.GUIDED
    pilot.run(15)
    assert pilot.vehicles[0].motion.distance_m(15, 15, 12) < 0.2


def target_enu_m(pilot: Pilot) -> tuple[float, float, float] | None:
    """What it reports on request; None: nothing comes."""
    pilot.forget()
    assert pilot.command(mav.MAV_CMD_REQUEST_MESSAGE, mav.MAVLINK_MSG_ID_POSITION_TARGET_GLOBAL_INT) == ACCEPTED
    pilot.run(0.5)
    if not pilot.all("POSITION_TARGET_GLOBAL_INT"):
        return None
    target, where = pilot.last("POSITION_TARGET_GLOBAL_INT"), pilot.vehicles[0].where
    assert (target.coordinate_frame, target.type_mask) == (mav.MAV_FRAME_GLOBAL, 0xFFF8)
    east_m, north_m = where.to_local(target.lat_int / 1e7, target.lon_int / 1e7)
    return round(east_m, 1), round(north_m, 1), round(target.alt - where.alt_amsl_m, 1)


def test_a_place_is_reported_until_another_target_or_guided_anew_discards_it(pilot: Pilot) -> None:
    pilot.hovering()
    lat, lon = pilot.vehicles[0].where.to_geodetic(60.0, 15.0)
    place = {"x": round(lat * 1e7), "y": round(lon * 1e7), "z": 12, "frame": RELATIVE}
    set_mode(pilot, CopterMode.BRAKE)
    assert set_mode(pilot, COPTER_GUIDED) == ACCEPTED
    assert target_enu_m(pilot) is None, "GUIDED begins with no velocity, and with no place"
    for discards in (
        lambda: pilot.send(global_target(pilot, 0, 0, 0, mask=VELOCITY_ONLY)),
        lambda: pilot.send(global_target(pilot, 0, 0, 10, mask=VELOCITY_ONLY & POSITION_ONLY)),
        lambda: (set_mode(pilot, CopterMode.BRAKE), set_mode(pilot, COPTER_GUIDED)),
    ):
        assert pilot.command_int(mav.MAV_CMD_DO_REPOSITION, -1, 1, **place) == ACCEPTED
        assert target_enu_m(pilot) == (60.0, 15.0, 12.0)
        set_mode(pilot, COPTER_GUIDED)
        assert target_enu_m(pilot) == (60.0, 15.0, 12.0), "it is in GUIDED already"
        discards()
        assert target_enu_m(pilot) is None
    pilot.send(global_target(pilot, 5, 6, 14.0))
    assert target_enu_m(pilot) == (5.0, 6.0, 14.0)
    assert set_mode(pilot, CopterMode.RTL) == ACCEPTED
    assert target_enu_m(pilot) is not None
    assert set_mode(pilot, CopterMode.LAND) == ACCEPTED
    assert target_enu_m(pilot) is None


def test_condition_yaw_turns_it_in_guided(pilot: Pilot) -> None:
    pilot.hovering()
    assert pilot.command(mav.MAV_CMD_CONDITION_YAW, 90, 20, 1, 0) == ACCEPTED
    pilot.run(5)
    assert pilot.last("VFR_HUD").heading == pytest.approx(90, abs=1)
    assert pilot.command(mav.MAV_CMD_CONDITION_YAW, 45, 20, -1, 1) == ACCEPTED
    pilot.run(5)
    assert pilot.last("VFR_HUD").heading == pytest.approx(45, abs=1)
    assert pilot.command(mav.MAV_CMD_CONDITION_YAW, 400, 20, 1, 0) == FAILED


def test_land_disarms_on_the_ground_and_stays_in_land(pilot: Pilot) -> None:
    pilot.hovering(5)
    assert pilot.command(mav.MAV_CMD_NAV_LAND) == ACCEPTED
    pilot.run(2)
    assert pilot.last("EXTENDED_SYS_STATE").landed_state == mav.MAV_LANDED_STATE_LANDING
    pilot.run(20)
    assert pilot.texts()[-1] == "Disarming motors"
    beat = pilot.last("HEARTBEAT")
    assert (beat.base_mode, beat.custom_mode, beat.system_status) == (89, 9, 3), "as in the capture"


def test_return_climbs_to_rtl_alt_waits_over_home_and_lands(pilot: Pilot) -> None:
    pilot.hovering(8)
    pilot.send(global_target(pilot, 60, 0, 8.0))
    pilot.run(20)
    assert pilot.command(mav.MAV_CMD_NAV_RETURN_TO_LAUNCH) == ACCEPTED
    heights = []
    for _ in range(100):
        pilot.run(1)
        heights.append(pilot.vehicles[0].motion.up_m)
    assert max(heights) == pytest.approx(15, abs=0.3)
    motion = pilot.vehicles[0].motion
    assert motion.on_ground and hypot(motion.east_m, motion.north_m) < 0.5 and not pilot.vehicles[0].armed
    assert pilot.last("HEARTBEAT").custom_mode == CopterMode.RTL


def test_mode_changes_in_flight_can_fail_and_say_why(pilot: Pilot) -> None:
    assert set_mode(pilot, CopterMode.AUTO) == ACCEPTED, "disarmed it takes any mode"
    assert set_mode(pilot, 99) == FAILED
    assert set_mode(pilot, CopterMode.STABILIZE) == ACCEPTED
    pilot.hovering()
    assert set_mode(pilot, CopterMode.AUTO) == FAILED
    assert pilot.texts()[-1] == "Mode change to AUTO failed: no mission"
    pilot.vehicles[0].faults.gps_lost = True
    assert set_mode(pilot, CopterMode.LOITER) == FAILED
    assert pilot.texts()[-1] == "Mode change to LOITER failed: requires position"
    assert pilot.vehicles[0].mode == CopterMode.GUIDED
    assert pilot.command(mav.MAV_CMD_MISSION_START) == FAILED


def test_the_deprecated_set_mode_message_works_and_is_not_acknowledged(pilot: Pilot) -> None:
    answer = pilot.send(mav.MAVLink_set_mode_message(1, 1, COPTER_GUIDED))
    assert [a.get_type() for a in answer] == ["HEARTBEAT"] and answer[0].custom_mode == COPTER_GUIDED
    pilot.send(mav.MAVLink_set_mode_message(1, 81, 0))
    assert pilot.vehicles[0].mode == CopterMode.STABILIZE


def test_data_streams_set_their_group_and_are_gone_after_a_reboot(pilot: Pilot) -> None:
    pilot.get_ready()
    before = {name: pilot.rate_hz(name) for name in ("ATTITUDE", "GLOBAL_POSITION_INT", "VFR_HUD")}
    assert before == pytest.approx({"ATTITUDE": 2, "GLOBAL_POSITION_INT": 2, "VFR_HUD": 1}, abs=0.1)
    pilot.send(mav.MAVLink_request_data_stream_message(1, 1, mav.MAV_DATA_STREAM_POSITION, 8, 1))
    assert pilot.rate_hz("GLOBAL_POSITION_INT") == pytest.approx(8, abs=0.1)
    assert pilot.rate_hz("LOCAL_POSITION_NED") == pytest.approx(8, abs=0.1)
    assert pilot.rate_hz("ATTITUDE") == pytest.approx(2, abs=0.1)
    pilot.send(mav.MAVLink_request_data_stream_message(1, 1, mav.MAV_DATA_STREAM_ALL, 0, 0))
    names = {x.get_type() for x in pilot.run(20)}
    assert names == {"HEARTBEAT"}
    pilot.command(mav.MAV_CMD_PREFLIGHT_REBOOT_SHUTDOWN, 1)
    pilot.run(12)
    assert pilot.rate_hz("GLOBAL_POSITION_INT") == pytest.approx(2, abs=0.1)


def test_stream_parameters_take_effect_at_once(pilot: Pilot) -> None:
    pilot.get_ready()
    pilot.send(mav.MAVLink_param_set_message(1, 1, b"SR1_EXTRA1", 5, mav.MAV_PARAM_TYPE_INT16))
    assert pilot.rate_hz("ATTITUDE") == pytest.approx(5, abs=0.1)
    pilot.send(mav.MAVLink_param_set_message(1, 1, b"SR1_RAW_SENS", 2, mav.MAV_PARAM_TYPE_INT16))
    assert pilot.rate_hz("RAW_IMU") == pytest.approx(2, abs=0.1)
    assert pilot.last("RAW_IMU").zacc == pytest.approx(-1000, abs=5)


@each("at_once", [False, True])
def test_a_new_system_id_holds_from_the_next_start_on_or_at_once(
    monkeypatch: pytest.MonkeyPatch, at_once: bool
) -> None:
    monkeypatch.setattr(CopterVehicle, "renumbers_at_once", at_once)
    pilot = Pilot(copter(1))
    pilot.send(mav.MAVLink_param_set_message(1, 1, b"SYSID_THISMAV", 12, mav.MAV_PARAM_TYPE_INT16))
    pilot.forget()
    pilot.run(3)
    assert {x.get_srcSystem() for x in pilot.heard} == {12 if at_once else 1}
    if not at_once:
        assert pilot.command(mav.MAV_CMD_PREFLIGHT_REBOOT_SHUTDOWN, 1) == ACCEPTED
        pilot.forget()
        pilot.run(5)
        assert {x.get_srcSystem() for x in pilot.heard} == {12}
    assert pilot.command(mav.MAV_CMD_REQUEST_MESSAGE, 148, to=12) == ACCEPTED


def test_speed_changes_last_until_reset(pilot: Pilot) -> None:
    pilot.hovering()
    assert pilot.command(mav.MAV_CMD_DO_CHANGE_SPEED, 1, 3.0) == ACCEPTED
    pilot.send(global_target(pilot, 100, 0, 10.0))
    pilot.run(12)
    assert pilot.last("VFR_HUD").groundspeed == pytest.approx(3, abs=0.05)
