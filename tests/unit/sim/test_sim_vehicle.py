"""What both simulated firmwares have in common, with pymavlink as the ground station."""

from __future__ import annotations

from dataclasses import replace
from math import degrees, hypot, isnan, nan

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mav

from skygcs.core.mavlink.parser import FrameParser
from skygcs.sim.px4 import Px4Vehicle
from skygcs.sim.rng import Rng
from skygcs.sim.vehicle import SimVehicle
from support.sim_pilot import FIELD, UNIX_US, Pilot, copter, px4, sim_dialect

BOTH = pytest.mark.parametrize("make", [px4, copter])
FORCE = 21196


@BOTH
def test_every_frame_is_one_pymavlink_decodes_and_re_encodes_to_the_byte(make: type[SimVehicle]) -> None:
    pilot = Pilot(make(7))
    names = set(pilot.vehicles[0].builders) - {"PROTOCOL_VERSION"}  # pymavlink lacks it
    for name in names:
        pilot.command(mav.MAV_CMD_SET_MESSAGE_INTERVAL, sim_dialect().by_name[name].msgid, 500_000, to=7)
    pilot.get_ready()
    # an ArduCopter without a target reports none
    assert {x.get_type() for x in pilot.heard} >= names - {"POSITION_TARGET_GLOBAL_INT"}
    for raw, message in zip(pilot.raw, pilot.heard, strict=True):
        assert (message.get_srcSystem(), message.get_srcComponent()) == (7, 1)
        packer = mav.MAVLink(None, 7, 1)
        packer.seq = message.get_seq()
        if not any(isinstance(v, float) and isnan(v) for v in message.to_dict().values()):
            assert message.pack(packer) == raw


@BOTH
def test_sequence_numbers_have_no_gap(make: type[SimVehicle]) -> None:
    pilot = Pilot(make())
    pilot.run(60)
    assert [x.get_seq() for x in pilot.heard] == [i & 0xFF for i in range(len(pilot.heard))]


@BOTH
def test_the_same_seed_gives_the_same_bytes_however_often_it_is_stepped(make: type[SimVehicle]) -> None:
    flights = []
    for step_s in (0.02, 0.5, 7.0):
        pilot = Pilot(make())
        pilot.run(21, step_s)
        flights.append(b"".join(pilot.raw))
    assert flights[0] == flights[1] == flights[2]
    other = Pilot(make(seed=2))  # type: ignore[call-arg]
    other.run(21)
    assert b"".join(other.raw) != flights[0]


@BOTH
def test_a_heartbeat_comes_every_second(make: type[SimVehicle]) -> None:
    pilot = Pilot(make())
    assert pilot.rate_hz("HEARTBEAT", 60) == pytest.approx(1.0, abs=0.02)
    beat = pilot.last("HEARTBEAT")
    assert (beat.type, beat.system_status, beat.mavlink_version) == (mav.MAV_TYPE_QUADROTOR, mav.MAV_STATE_STANDBY, 3)
    assert beat.autopilot == (mav.MAV_AUTOPILOT_PX4 if make is px4 else mav.MAV_AUTOPILOT_ARDUPILOTMEGA)


@BOTH
def test_telemetry_tells_the_vehicles_state_in_flight(make: type[SimVehicle]) -> None:
    vehicle = make()
    pilot = Pilot(vehicle)
    pilot.hovering(12)
    pilot.command(mav.MAV_CMD_SET_MESSAGE_INTERVAL, mav.MAVLINK_MSG_ID_ATTITUDE_QUATERNION, 200_000)
    pilot.run(5)
    motion = vehicle.motion
    position = pilot.last("GLOBAL_POSITION_INT")
    assert position.lat / 1e7 == pytest.approx(FIELD.lat_deg, abs=1e-6)
    assert position.lon / 1e7 == pytest.approx(FIELD.lon_deg, abs=1e-6)
    assert position.alt / 1000 == pytest.approx(192, abs=0.3)
    assert position.relative_alt / 1000 == pytest.approx(12, abs=0.3)
    local = pilot.last("LOCAL_POSITION_NED")
    assert (local.x, local.y, local.z) == pytest.approx((motion.north_m, motion.east_m, -motion.up_m), abs=0.05)
    attitude, q = pilot.last("ATTITUDE"), pilot.last("ATTITUDE_QUATERNION")
    assert degrees(attitude.yaw) % 360 == pytest.approx(motion.heading_deg, abs=0.5)
    assert hypot(q.q1, q.q2, q.q3, q.q4) == pytest.approx(1)
    gps = pilot.last("GPS_RAW_INT")
    assert gps.fix_type == mav.GPS_FIX_TYPE_3D_FIX and gps.satellites_visible > 8
    assert gps.alt / 1000 == pytest.approx(192, abs=1)
    hud = pilot.last("VFR_HUD")
    assert hud.alt == pytest.approx(192, abs=0.3) and hud.throttle > 0
    assert pilot.last("EXTENDED_SYS_STATE").landed_state == mav.MAV_LANDED_STATE_IN_AIR
    battery, status = pilot.last("BATTERY_STATUS"), pilot.last("SYS_STATUS")
    assert battery.voltages[0] == pytest.approx(status.voltage_battery, abs=30)
    assert battery.voltages[1] == 65535
    assert 90 < status.battery_remaining < 100
    clock = pilot.last("SYSTEM_TIME")
    assert clock.time_unix_usec == pytest.approx(UNIX_US + clock.time_boot_ms * 1000, abs=1000)


@BOTH
def test_climbing_is_negative_down_speed(make: type[SimVehicle]) -> None:
    pilot = Pilot(make())
    pilot.get_ready()
    pilot.take_off(20)
    climbing = [x for x in pilot.all("GLOBAL_POSITION_INT") if 3000 < x.relative_alt < 15000]
    assert climbing and all(x.vz < -50 for x in climbing)
    assert all(x.climb > 0.5 for x in pilot.all("VFR_HUD") if 184 < x.alt < 194)


@BOTH
def test_what_is_for_another_vehicle_or_component_is_ignored(make: type[SimVehicle]) -> None:
    pilot = Pilot(make(3))
    pilot.get_ready()
    assert pilot.command(mav.MAV_CMD_COMPONENT_ARM_DISARM, 1, to=4) is None
    assert pilot.command(mav.MAV_CMD_COMPONENT_ARM_DISARM, 1, to=3, comp=100) is None
    assert pilot.command(mav.MAV_CMD_REQUEST_MESSAGE, 148, to=3, comp=0) == mav.MAV_RESULT_ACCEPTED
    assert not pilot.vehicles[0].armed


def test_a_broadcast_command_is_answered_by_every_ardupilot_and_by_no_px4() -> None:
    pilot = Pilot(px4(1), copter(2), copter(3))
    pilot.get_ready()
    pilot.forget()
    pilot.command(mav.MAV_CMD_COMPONENT_ARM_DISARM, 1, to=0, comp=0)
    assert sorted(x.get_srcSystem() for x in pilot.heard if x.get_type() == "COMMAND_ACK") == [2, 3]
    assert [v.armed for v in pilot.vehicles] == [False, True, True]


@BOTH
def test_an_acknowledgement_is_addressed_to_who_asked(make: type[SimVehicle]) -> None:
    pilot = Pilot(make(), sysid=252, compid=25)
    pilot.command(mav.MAV_CMD_REQUEST_MESSAGE, 148)
    ack = pilot.last("COMMAND_ACK")
    assert (ack.target_system, ack.target_component) == (252, 25)


@BOTH
def test_an_unknown_command_is_unsupported(make: type[SimVehicle]) -> None:
    pilot = Pilot(make())
    assert pilot.command(mav.MAV_CMD_DO_DIGICAM_CONTROL) == mav.MAV_RESULT_UNSUPPORTED
    assert pilot.command_int(mav.MAV_CMD_DO_DIGICAM_CONTROL) == mav.MAV_RESULT_UNSUPPORTED
    assert pilot.command(mav.MAV_CMD_REQUEST_PROTOCOL_VERSION, 1) == mav.MAV_RESULT_UNSUPPORTED


@BOTH
def test_message_intervals_are_set_told_stopped_and_reset(make: type[SimVehicle]) -> None:
    pilot = Pilot(make())
    pilot.get_ready()
    default = pilot.rate_hz("ATTITUDE")
    ask = mav.MAVLINK_MSG_ID_ATTITUDE

    def reported() -> int:
        assert pilot.command(mav.MAV_CMD_GET_MESSAGE_INTERVAL, ask) == mav.MAV_RESULT_ACCEPTED
        return int(pilot.last("MESSAGE_INTERVAL").interval_us)

    assert reported() == round(1e6 / default)
    assert pilot.command(mav.MAV_CMD_SET_MESSAGE_INTERVAL, ask, 100_000) == mav.MAV_RESULT_ACCEPTED
    assert pilot.rate_hz("ATTITUDE") == pytest.approx(10, abs=0.1) and reported() == 100_000
    assert pilot.command(mav.MAV_CMD_SET_MESSAGE_INTERVAL, ask, -1) == mav.MAV_RESULT_ACCEPTED
    assert pilot.rate_hz("ATTITUDE") == 0 and reported() == -1
    assert pilot.command(mav.MAV_CMD_SET_MESSAGE_INTERVAL, ask, 0) == mav.MAV_RESULT_ACCEPTED
    assert pilot.rate_hz("ATTITUDE") == pytest.approx(default, abs=0.1)
    unknown = mav.MAV_RESULT_FAILED if make is px4 else mav.MAV_RESULT_DENIED
    assert pilot.command(mav.MAV_CMD_SET_MESSAGE_INTERVAL, 60000, 100_000) == unknown


@BOTH
def test_the_version_is_told_in_three_ways_of_asking(make: type[SimVehicle]) -> None:
    pilot = Pilot(make())
    assert pilot.command(mav.MAV_CMD_REQUEST_MESSAGE, mav.MAVLINK_MSG_ID_AUTOPILOT_VERSION) == 0
    assert pilot.command(mav.MAV_CMD_REQUEST_AUTOPILOT_CAPABILITIES, 1) == 0
    assert pilot.command_int(mav.MAV_CMD_REQUEST_MESSAGE, mav.MAVLINK_MSG_ID_AUTOPILOT_VERSION) == 0
    versions = pilot.all("AUTOPILOT_VERSION")
    assert len(versions) == 3
    version = versions[0].flight_sw_version
    assert (version >> 24, version >> 16 & 255) == ((1, 16) if make is px4 else (4, 6))
    assert versions[0].capabilities & mav.MAV_PROTOCOL_CAPABILITY_COMMAND_INT
    bytewise = bool(versions[0].capabilities & 0x10)
    assert bytewise == (make is px4)


@BOTH
def test_parameters_are_listed_read_and_set(make: type[SimVehicle]) -> None:
    pilot = Pilot(make(9))
    pilot.send(mav.MAVLink_param_request_list_message(9, 1))
    pilot.run(5)
    values = pilot.all("PARAM_VALUE", 9)
    if make is px4:
        assert (values[0].param_id, values.pop(0).param_index) == ("_HASH_CHECK", 65535)
    assert [x.param_index for x in values] == list(range(values[0].param_count))
    names = [x.param_id for x in values]
    assert names == sorted(names) and len(names) == len(set(names)) > 20
    name = "MPC_XY_CRUISE" if make is px4 else "WPNAV_SPEED"
    answer = pilot.send(mav.MAVLink_param_set_message(9, 1, name.encode(), 7.5, mav.MAV_PARAM_TYPE_REAL32))
    assert [x.param_value for x in answer] == [7.5]
    answer = pilot.send(mav.MAVLink_param_request_read_message(9, 1, name.encode(), -1))
    assert [(x.param_id, x.param_value) for x in answer] == [(name, 7.5)]
    index = names.index(name)
    assert [x.param_id for x in pilot.send(mav.MAVLink_param_request_read_message(9, 1, b"", index))] == [name]
    assert pilot.send(mav.MAVLink_param_request_read_message(9, 1, b"NO_SUCH", -1)) == []


def test_the_sysid_parameter_is_encoded_as_each_firmware_does() -> None:
    pilot = Pilot(px4(5), copter(6))
    pilot.send(mav.MAVLink_param_request_read_message(5, 1, b"MAV_SYS_ID", -1))
    pilot.send(mav.MAVLink_param_request_read_message(6, 1, b"SYSID_THISMAV", -1))
    assert pilot.last("PARAM_VALUE", 5).param_value == 7.006492321624085e-45  # int 5, as in a capture of PX4 1.16
    assert pilot.last("PARAM_VALUE", 5).param_type == mav.MAV_PARAM_TYPE_INT32
    assert pilot.last("PARAM_VALUE", 6).param_value == 6.0
    assert pilot.last("PARAM_VALUE", 6).param_type == mav.MAV_PARAM_TYPE_INT16


@BOTH
def test_there_is_no_mission_fence_or_rally_on_board(make: type[SimVehicle]) -> None:
    pilot = Pilot(make())
    for kind in (0, 1, 2):
        count = pilot.send(mav.MAVLink_mission_request_list_message(1, 1, kind))[0]
        assert (count.get_type(), count.count, count.mission_type) == ("MISSION_COUNT", 0, kind)
        assert (count.target_system, count.target_component) == (255, 190)


@BOTH
def test_pings_and_time_syncs_are_answered_and_answers_are_not(make: type[SimVehicle]) -> None:
    pilot = Pilot(make())
    pilot.run(5)
    pong = pilot.send(mav.MAVLink_ping_message(123456, 9, 0, 0))
    assert [(x.time_usec, x.seq, x.target_system) for x in pong] == [(123456, 9, 255)]
    assert pilot.send(mav.MAVLink_ping_message(123456, 9, 1, 1)) == []
    sync = pilot.send(mav.MAVLink_timesync_message(0, 987654321))
    assert [x.ts1 for x in sync] == [987654321]
    assert sync[0].tc1 == pytest.approx(5e9, abs=1e8)
    assert pilot.send(mav.MAVLink_timesync_message(5, 6)) == []


@BOTH
def test_a_gyro_calibration_is_answered_as_the_firmware_does(make: type[SimVehicle]) -> None:
    """PX4 accepts at once and reports by texts; ArduCopter answers at the end."""
    vehicle = make()
    pilot = Pilot(vehicle)
    pilot.get_ready()
    px4 = vehicle.autopilot == mav.MAV_AUTOPILOT_PX4
    assert pilot.command(mav.MAV_CMD_PREFLIGHT_CALIBRATION, 1) == (mav.MAV_RESULT_ACCEPTED if px4 else None)
    pilot.forget()
    pilot.run(5)
    if px4:
        texts = [text for text in pilot.texts() if text.startswith("[cal]")]
        assert texts[0] == "[cal] calibration started: 2 gyro" and texts[-1] == "[cal] calibration done: gyro"
    else:
        assert [ack.result for ack in pilot.all("COMMAND_ACK")] == [mav.MAV_RESULT_ACCEPTED]


@BOTH
def test_a_reboot_is_silent_for_two_seconds_and_starts_from_zero(make: type[SimVehicle]) -> None:
    pilot = Pilot(make())
    pilot.command(mav.MAV_CMD_SET_MESSAGE_INTERVAL, mav.MAVLINK_MSG_ID_ATTITUDE, 50_000)
    pilot.run(30)
    before = pilot.last("ATTITUDE").time_boot_ms
    assert pilot.command(mav.MAV_CMD_PREFLIGHT_REBOOT_SHUTDOWN, 1) == mav.MAV_RESULT_ACCEPTED
    pilot.forget()
    pilot.run(1.9)
    assert pilot.command(mav.MAV_CMD_REQUEST_MESSAGE, 148) is None, "it does not hear while it boots"
    assert pilot.heard == []
    pilot.run(3)
    assert pilot.heard[0].get_seq() == 0
    assert pilot.last("ATTITUDE").time_boot_ms < 3500 < before
    assert pilot.rate_hz("ATTITUDE") < 5, "rates are the defaults again"
    pilot.run(10)
    assert pilot.last("HOME_POSITION") is not None


@BOTH
def test_in_flight_it_neither_reboots_nor_disarms_unless_forced(make: type[SimVehicle]) -> None:
    """What force does: test_crash."""
    pilot = Pilot(make())
    pilot.hovering()
    denied, refused = (
        (mav.MAV_RESULT_DENIED, mav.MAV_RESULT_TEMPORARILY_REJECTED)
        if make is px4
        else (mav.MAV_RESULT_FAILED, mav.MAV_RESULT_FAILED)
    )
    assert pilot.command(mav.MAV_CMD_PREFLIGHT_REBOOT_SHUTDOWN, 1) == denied
    assert pilot.command(mav.MAV_CMD_COMPONENT_ARM_DISARM, 0) == refused
    assert pilot.vehicles[0].armed and pilot.run(3)


@BOTH
def test_arming_before_the_estimator_has_converged_is_refused_and_says_why(make: type[SimVehicle]) -> None:
    pilot = Pilot(make())
    pilot.run(1)
    if make is copter:
        pilot.command(mav.MAV_CMD_DO_SET_MODE, 1, 4)
    refused = mav.MAV_RESULT_TEMPORARILY_REJECTED if make is px4 else mav.MAV_RESULT_FAILED
    answer = pilot.send(mav.MAVLink_command_long_message(1, 1, 400, 0, 1, 0, 0, 0, 0, 0, 0))
    assert answer[0].get_type() == "COMMAND_ACK" and answer[0].result == refused
    texts = [x.text for x in answer if x.get_type() == "STATUSTEXT"]
    assert texts and all(x.severity <= 3 for x in answer if x.get_type() == "STATUSTEXT")
    assert ("position estimate" in texts[-1]) if make is px4 else (texts[-1] == "Arm: Need Position Estimate")
    pilot.get_ready()
    assert pilot.command(mav.MAV_CMD_COMPONENT_ARM_DISARM, 1) == mav.MAV_RESULT_ACCEPTED


@BOTH
def test_a_refusal_can_be_injected_and_force_overrides_it_on_arducopter(make: type[SimVehicle]) -> None:
    vehicle = make()
    pilot = Pilot(vehicle)
    pilot.get_ready()
    vehicle.faults.refuse_arming = "Throttle too high"
    assert pilot.command(mav.MAV_CMD_COMPONENT_ARM_DISARM, 1) not in (None, mav.MAV_RESULT_ACCEPTED)
    assert any("Throttle too high" in text for text in pilot.texts())
    pilot.run(2)
    assert not pilot.last("SYS_STATUS").onboard_control_sensors_health & mav.MAV_SYS_STATUS_PREARM_CHECK
    # Commander.cpp: arm(reason, cmd.from_external || !forced)
    forced = mav.MAV_RESULT_TEMPORARILY_REJECTED if make is px4 else mav.MAV_RESULT_ACCEPTED
    assert pilot.command(mav.MAV_CMD_COMPONENT_ARM_DISARM, 1, FORCE) == forced


@BOTH
def test_an_armed_vehicle_that_does_not_take_off_disarms_itself_after_ten_seconds(make: type[SimVehicle]) -> None:
    pilot = Pilot(make())
    pilot.get_ready()
    pilot.command(mav.MAV_CMD_COMPONENT_ARM_DISARM, 1)
    pilot.run(10.5 if make is px4 else 9.5)  # PX4 adds COM_SPOOLUP_TIME
    assert pilot.vehicles[0].armed
    pilot.run(1)
    assert not pilot.vehicles[0].armed


@BOTH
def test_home_is_set_here_or_there_and_told(make: type[SimVehicle]) -> None:
    pilot = Pilot(make())
    pilot.get_ready()
    assert pilot.command_int(mav.MAV_CMD_DO_SET_HOME, 0, x=437810000, y=-794660000, z=190.0) == 0
    home = pilot.last("HOME_POSITION")
    assert (home.latitude, home.longitude) == pytest.approx((437810000, -794660000), abs=2)
    assert home.altitude == 190_000
    pilot.run(2)
    assert pilot.last("GLOBAL_POSITION_INT").relative_alt == -10_000
    assert pilot.command(mav.MAV_CMD_DO_SET_HOME, 1) == 0
    home = pilot.last("HOME_POSITION")
    assert (home.latitude, home.longitude, home.altitude) == pytest.approx((437806000, -794653000, 180_000), abs=2)
    assert pilot.command(mav.MAV_CMD_GET_HOME_POSITION) == 0
    nowhere = mav.MAV_RESULT_DENIED if make is px4 else mav.MAV_RESULT_ACCEPTED  # ArduCopter: where it is
    assert pilot.command(mav.MAV_CMD_DO_SET_HOME, 0, 0, 0, 0, nan, nan, nan) == nowhere


@BOTH
def test_a_disarmed_px4_moves_home_to_where_it_is_and_an_arducopter_keeps_it(make: type[SimVehicle]) -> None:
    """HomePosition::update; ArduCopter's update_home_from_EKF only sets one that is not set."""
    pilot = Pilot(make())
    pilot.get_ready()
    vehicle = pilot.vehicles[0]
    assert vehicle.home is not None
    vehicle.set_home(replace(vehicle.home, up_m=-1.4))
    pilot.run(1)
    assert vehicle.home.up_m == -1.4, "PX4: kMinHomePositionChangeEPV is 1.5 m"
    vehicle.set_home(replace(vehicle.home, up_m=-6.0))
    pilot.run(1)
    assert vehicle.home.up_m == pytest.approx(0.0 if make is px4 else -6.0, abs=0.5)


@BOTH
def test_a_home_that_was_set_outlives_the_next_arming(make: type[SimVehicle]) -> None:
    pilot = Pilot(make())
    pilot.get_ready()
    if make is copter:
        pilot.command(mav.MAV_CMD_DO_SET_MODE, 1, 4)
    assert pilot.command_int(mav.MAV_CMD_DO_SET_HOME, 0, x=437810000, y=-794660000, z=190.0) == 0
    assert pilot.command(mav.MAV_CMD_COMPONENT_ARM_DISARM, 1) == mav.MAV_RESULT_ACCEPTED
    pilot.command(mav.MAV_CMD_GET_HOME_POSITION)
    assert pilot.last("HOME_POSITION").altitude == 190_000


@BOTH
def test_without_a_position_there_is_no_home_and_the_estimator_says_so(make: type[SimVehicle]) -> None:
    vehicle = make()
    vehicle.faults.gps_lost = True
    pilot = Pilot(vehicle)
    pilot.run(30)
    assert pilot.all("HOME_POSITION") == [] and pilot.all("LOCAL_POSITION_NED") == []
    assert pilot.last("GPS_RAW_INT").fix_type <= 1
    flags = pilot.last("ESTIMATOR_STATUS" if make is px4 else "EKF_STATUS_REPORT").flags
    assert not flags & mav.ESTIMATOR_POS_HORIZ_ABS
    assert pilot.last("SYSTEM_TIME").time_unix_usec == 0
    vehicle.faults.gps_lost = False
    pilot.run(5)
    flags = pilot.last("ESTIMATOR_STATUS" if make is px4 else "EKF_STATUS_REPORT").flags
    assert flags == 831, "what both firmwares report in healthy flight"
    assert pilot.all("HOME_POSITION")


@BOTH
def test_losing_gps_in_the_air_lands_it_with_a_failsafe(make: type[SimVehicle]) -> None:
    vehicle = make()
    pilot = Pilot(vehicle)
    pilot.hovering(8)
    vehicle.faults.gps_lost = True
    pilot.run(vehicle.firmware.position_lost_s.simulated + 1.5)
    assert pilot.last("HEARTBEAT").system_status == mav.MAV_STATE_CRITICAL
    assert pilot.last("EXTENDED_SYS_STATE").landed_state == mav.MAV_LANDED_STATE_LANDING
    pilot.run(25)
    assert not vehicle.armed and vehicle.motion.on_ground


@BOTH
def test_a_low_battery_is_told_once_and_reported(make: type[SimVehicle]) -> None:
    vehicle = make()
    pilot = Pilot(vehicle)
    pilot.get_ready()
    vehicle.battery.set_percent(10)
    pilot.run(10)
    assert sum("attery" in text for text in pilot.texts()) == 1
    assert pilot.last("SYS_STATUS").battery_remaining == 10
    assert pilot.last("BATTERY_STATUS").charge_state == mav.MAV_BATTERY_CHARGE_STATE_LOW
    vehicle.battery.set_percent(100)
    pilot.run(1)
    vehicle.battery.set_percent(10)
    pilot.run(1)
    assert sum("attery" in text for text in pilot.texts()) == 2


@BOTH
def test_a_fraction_of_acknowledgements_can_be_lost(make: type[SimVehicle]) -> None:
    vehicle = make()
    pilot = Pilot(vehicle)
    vehicle.faults.ack_loss = 0.5
    answered = [pilot.command(mav.MAV_CMD_REQUEST_MESSAGE, 148) for _ in range(200)]
    assert 70 < answered.count(None) < 130


@BOTH
def test_a_mute_vehicle_still_hears(make: type[SimVehicle]) -> None:
    vehicle = make()
    pilot = Pilot(vehicle)
    pilot.get_ready()
    vehicle.faults.mute = True
    assert pilot.command(mav.MAV_CMD_COMPONENT_ARM_DISARM, 1) is None
    assert pilot.run(3) == [] and vehicle.armed
    vehicle.faults.mute = False
    pilot.forget()
    pilot.run(3)
    assert pilot.last("HEARTBEAT").base_mode & mav.MAV_MODE_FLAG_SAFETY_ARMED


def test_after_a_long_pause_only_the_last_minute_is_lived_through() -> None:
    pilot = Pilot(px4())
    pilot.run(1)
    pilot.now += 3600
    pilot.forget()
    pilot.collect()
    assert len(pilot.all("HEARTBEAT")) in (60, 61)


def test_a_long_text_is_sent_in_chunks_that_pymavlink_puts_together() -> None:
    vehicle = px4()
    vehicle.faults.refuse_arming = "x" * 120
    pilot = Pilot(vehicle)
    pilot.get_ready()
    pilot.forget()
    pilot.command(mav.MAV_CMD_COMPONENT_ARM_DISARM, 1)
    chunks = [x for x in pilot.all("STATUSTEXT") if x.id]
    assert [x.chunk_seq for x in chunks] == [0, 1, 2] and len({x.id for x in chunks}) == 1
    assert "".join(x.text for x in chunks).rstrip("\t") == "x" * 120


def test_a_dialect_without_a_message_leaves_it_out() -> None:
    from skygcs.core.mavlink.dialect import Dialect

    full = sim_dialect()
    small = Dialect("small", [x for x in full.messages.values() if x.name != "ESTIMATOR_STATUS"], full.enums)
    vehicle = Px4Vehicle(small, 1, FIELD, rng=Rng(1))
    frames = FrameParser(full).feed(b"".join(vehicle.step(20.0)))
    names = {f.name for f in frames}
    assert "HEARTBEAT" in names and "ESTIMATOR_STATUS" not in names
