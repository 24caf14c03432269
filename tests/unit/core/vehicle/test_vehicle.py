from __future__ import annotations

import json
import math
import random
import typing
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydantic import TypeAdapter
from pymavlink.dialects.v20 import ardupilotmega as mav

from skygcs.core.geo import Origin
from skygcs.core.mavlink.frame import Frame
from skygcs.core.vehicle.decoding import ARRAYS, FIELDS, GROUPS, Decoder
from skygcs.core.vehicle.snapshot import take_snapshot
from skygcs.core.vehicle.state import VehicleState
from skygcs.core.vehicle.vehicle import MAX_STATUS_TEXTS, Vehicle
from skygcs.events import Event
from support.table import each
from support.vehicles import ARDUPILOT, HOME, PX4, PX4_LAND, PX4_POSCTL, PX4_TAKEOFF, Voice, flight_dialect

DECODER = Decoder(flight_dialect())
NAN = math.nan
DESCRIBED = TypeAdapter(VehicleState)


def new() -> tuple[Vehicle, Voice]:
    return Vehicle(1, 1, flight_dialect(), name="alpha", groups=("red",), decoder=DECODER), Voice(1)


def reported(vehicle: Vehicle, *frames: Frame, now: float = 10.0) -> Any:
    """The state after these frames, and proof that it is JSON and what is described."""
    for frame in frames:
        vehicle.on_frame(frame, now)
    state = take_snapshot(vehicle, now)
    json.dumps(state, allow_nan=False)
    DESCRIBED.validate_python(state)
    return state


def kinds(events: tuple[Event, ...]) -> list[str]:
    return [e.kind for e in events]


def test_an_unheard_vehicle_knows_nothing_and_says_so() -> None:
    vehicle, _ = new()
    state = reported(vehicle)
    assert state["connected"] is False
    assert state["last_heartbeat_age_s"] is None
    assert all(state[section.name] is None for section in GROUPS)


@pytest.fixture
def vehicle() -> Vehicle:
    return new()[0]


@pytest.fixture
def voice() -> Voice:
    return Voice(1)


def test_the_state_has_exactly_the_keys_it_promises(vehicle: Vehicle, voice: Voice) -> None:
    assert set(reported(vehicle, voice.beat())) == set(typing.get_type_hints(VehicleState))


def test_some_keys_of_the_state_are_as_in_the_whole_of_it(vehicle: Vehicle, voice: Voice) -> None:
    whole = reported(vehicle, voice.beat(), voice.position())
    for key, value in whole.items():
        assert take_snapshot(vehicle, 10.0, names=frozenset({key, "no such key"})) == {key: value}
    assert take_snapshot(vehicle, 10.0, 1.7e9, frozenset({"name", "position"})).keys() == {"name", "position"}


def test_a_heartbeat_tells_identity_mode_and_arming(vehicle: Vehicle, voice: Voice) -> None:
    state = reported(vehicle, voice.beat(PX4, PX4_TAKEOFF, armed=True, status=4))
    assert (state["autopilot"], state["type"], state["mode"]) == ("px4", "QUADROTOR", "AUTO.TAKEOFF")
    assert state["armed"] is True
    assert state["system_status"] == "active"
    assert (state["name"], state["groups"], state["connected"]) == ("alpha", ["red"], True)


def test_a_change_is_told_once_and_the_first_heartbeat_is_none(vehicle: Vehicle, voice: Voice) -> None:
    assert vehicle.on_frame(voice.beat(PX4, PX4_POSCTL, armed=True, status=4), 1.0) == ()
    assert kinds(vehicle.on_frame(voice.beat(PX4, PX4_LAND, armed=True, status=4), 2.0)) == ["mode"]
    assert vehicle.on_frame(voice.beat(PX4, PX4_LAND, armed=True, status=4), 3.0) == ()
    (event,) = vehicle.on_frame(voice.beat(PX4, PX4_LAND, armed=False, status=3), 4.0)
    assert (event.kind, event.vehicle, event.sysid) == ("disarmed", "alpha", 1)
    (event,) = vehicle.on_frame(voice.beat(PX4, PX4_LAND, armed=True, status=3), 5.0)
    assert event.kind == "armed"


def test_lost_and_back_are_told_once_each_with_the_time(vehicle: Vehicle, voice: Voice) -> None:
    vehicle.on_frame(voice.beat(), 100.0)
    assert vehicle.tick(105.0) == ()
    (lost,) = vehicle.tick(105.1)
    assert (lost.kind, lost.data["age_s"]) == ("vehicle_lost", 5.1)
    assert vehicle.tick(106.0) == ()
    vehicle.on_frame(voice.position(), 107.0)
    assert not vehicle.connected
    (back,) = vehicle.on_frame(voice.beat(), 110.0)
    assert (back.kind, back.data["gone_s"]) == ("vehicle_back", 10.0)
    assert vehicle.tick(111.0) == ()


def test_what_changed_while_it_was_lost_is_told_when_it_is_back(vehicle: Vehicle, voice: Voice) -> None:
    vehicle.on_frame(voice.beat(PX4, PX4_POSCTL, armed=True), 100.0)
    vehicle.tick(110.0)
    events = vehicle.on_frame(voice.beat(PX4, PX4_LAND, armed=False), 111.0)
    assert kinds(events) == ["vehicle_back", "disarmed", "mode"]


def test_failsafe_is_told_with_the_last_warning(vehicle: Vehicle, voice: Voice) -> None:
    vehicle.on_frame(voice.beat(ARDUPILOT, 4, armed=True, status=4), 1.0)
    vehicle.on_frame(voice.text("Battery Failsafe", severity=4), 1.1)
    (event,) = vehicle.on_frame(voice.beat(ARDUPILOT, 4, armed=True, status=5), 2.0)
    assert event.kind == "failsafe"
    assert event.data == {"failsafe": True, "system_status": "critical", "last_warning": "Battery Failsafe"}
    assert vehicle.failsafe
    (event,) = vehicle.on_frame(voice.beat(ARDUPILOT, 4, armed=True, status=4), 3.0)
    assert event.data == {"failsafe": False}


def test_global_position_is_scaled_and_down_becomes_up_once(vehicle: Vehicle, voice: Voice) -> None:
    frame = voice.position(rel_m=9.9, velocity=(120, -50, 30), heading=4210)
    position = reported(vehicle, frame)["position"]
    assert position["lat_deg"] == pytest.approx(HOME[0], abs=1e-7)
    assert position["lon_deg"] == pytest.approx(HOME[1], abs=1e-7)
    assert (position["alt_amsl_m"], position["alt_rel_m"], position["heading_deg"]) == (488.1, 9.9, 42.1)
    assert position["vel_enu_mps"] == [-0.5, 1.2, -0.3]
    assert position["enu_m"] is None


@pytest.mark.parametrize(("lat_deg", "lon_deg"), [(0.0, 0.0), (0.0003961, -0.0000684), (214.7483647, 8.5)])
def test_unknown_position_and_heading_are_none(vehicle: Vehicle, voice: Voice, lat_deg: float, lon_deg: float) -> None:
    # the second: an ArduPlane before its first fix, 10 s after its start
    position = reported(vehicle, voice.position(lat_deg, lon_deg, heading=65535))["position"]
    assert (position["lat_deg"], position["lon_deg"], position["heading_deg"]) == (None, None, None)
    vehicle.origin = Origin(*HOME)
    assert reported(vehicle)["position"]["enu_m"] is None


def test_enu_follows_the_origin_at_once(vehicle: Vehicle, voice: Voice) -> None:
    vehicle.on_frame(voice.position(HOME[0] + 1e-4, HOME[1], HOME[2] + 5), 1.0)
    vehicle.origin = Origin(*HOME)
    assert reported(vehicle)["position"]["enu_m"] == pytest.approx([0, 11.12, 5], abs=0.02)
    vehicle.origin = Origin(HOME[0] + 1e-4, HOME[1], HOME[2])
    assert reported(vehicle)["position"]["enu_m"] == pytest.approx([0, 0, 5], abs=0.02)
    vehicle.origin = None
    assert reported(vehicle)["position"]["enu_m"] is None


def test_gps_markers_for_unknown_are_none(vehicle: Vehicle, voice: Voice) -> None:
    good = mav.MAVLink_gps_raw_int_message(5, 3, 473977420, 85455940, 488100, 121, 200, 0, 0, 12)
    gps = reported(vehicle, voice.say(good))["gps"]
    assert (gps["fix"], gps["fix_type"], gps["satellites"], gps["hdop"], gps["vdop"]) == ("3d", 3, 12, 1.21, 2.0)
    assert (gps["lat_deg"], gps["alt_amsl_m"]) == (47.397742, 488.1)
    none = mav.MAVLink_gps_raw_int_message(5, 0, 0, 0, 0, 65535, 65535, 65535, 65535, 255)
    gps = reported(vehicle, voice.say(none))["gps"]
    assert gps["fix"] == "no_gps"
    assert [gps[k] for k in ("satellites", "hdop", "vdop", "lat_deg", "alt_amsl_m")] == [None] * 5


def test_local_position_and_attitude_come_out_in_enu_and_degrees(vehicle: Vehicle, voice: Voice) -> None:
    local = mav.MAVLink_local_position_ned_message(1000, 1.0, 2.0, -3.0, 0.1, 0.2, -0.3)
    attitude = mav.MAVLink_attitude_message(1000, 0.1, -0.2, 3.0, 0.01, 0.02, 0.03)
    state = reported(vehicle, voice.say(local), voice.say(attitude))
    assert state["local"]["pos_enu_m"] == [2.0, 1.0, 3.0]
    assert state["local"]["vel_enu_mps"] == [0.2, 0.1, 0.3]
    assert state["attitude"]["roll_deg"] == pytest.approx(5.73)
    assert state["attitude"]["pitch_deg"] == pytest.approx(-11.46)
    assert state["attitude"]["yaw_deg"] == pytest.approx(171.89)
    assert state["attitude"]["rates_dps"] == pytest.approx([0.57, 1.15, 1.72])


angles = st.tuples(st.floats(-3.1, 3.1), st.floats(-1.5, 1.5), st.floats(-3.1, 3.1))


@given(angles)
def test_quaternion_and_euler_messages_say_the_same_attitude(rpy: tuple[float, float, float]) -> None:
    from pymavlink.quaternion import QuaternionBase

    w, x, y, z = QuaternionBase(list(rpy)).q
    by_quaternion, voice = new()
    a = reported(by_quaternion, voice.say(mav.MAVLink_attitude_quaternion_message(1, w, x, y, z, 0, 0, 0)))["attitude"]
    by_euler, voice = new()
    b = reported(by_euler, voice.say(mav.MAVLink_attitude_message(1, *rpy, 0, 0, 0)))["attitude"]
    assert b["quaternion"] == pytest.approx([w, x, y, z], abs=1e-4)
    for key in ("roll_deg", "pitch_deg", "yaw_deg"):
        assert math.radians(a[key]) == pytest.approx(math.radians(b[key]), abs=0.002)


def test_a_stale_alternative_gives_way_to_the_fresh_one(vehicle: Vehicle, voice: Voice) -> None:
    vehicle.on_frame(voice.say(mav.MAVLink_attitude_message(1, 0.5, 0, 0, 0, 0, 0)), 1.0)
    vehicle.on_frame(voice.say(mav.MAVLink_attitude_quaternion_message(1, 1, 0, 0, 0, 0, 0, 0)), 1.5)
    assert reported(vehicle, now=2.0)["attitude"]["roll_deg"] == pytest.approx(28.65)
    vehicle.on_frame(voice.say(mav.MAVLink_attitude_quaternion_message(1, 1, 0, 0, 0, 0, 0, 0)), 9.0)
    state = reported(vehicle, now=9.5)
    assert (state["attitude"]["roll_deg"], state["attitude"]["age_s"]) == (0.0, 0.5)


def sys_status(voltage: int, current: int, left: int, present: int = 0, enabled: int = 0, health: int = 0) -> Any:
    return mav.MAVLink_sys_status_message(present, enabled, health, 500, voltage, current, left, 0, 0, 0, 0, 0, 0)


def test_battery_unknowns_are_filled_from_battery_status(vehicle: Vehicle, voice: Voice) -> None:
    battery = reported(vehicle, voice.say(sys_status(12600, 1530, 88)))["battery"]
    assert (battery["volts"], battery["amps"], battery["percent"]) == (12.6, 15.3, 88)
    cells = [4100, 4100, 4000] + [65535] * 7
    detail = mav.MAVLink_battery_status_message(0, 0, 0, 32767, cells, -1, 378, -1, 42, 0)
    battery = reported(vehicle, voice.say(sys_status(65535, -1, -1)), voice.say(detail))["battery"]
    assert (battery["volts"], battery["amps"], battery["percent"]) == (12.2, None, 42)
    assert (battery["consumed_mah"], battery["temperature_degc"]) == (378, None)


@pytest.mark.parametrize(("current", "left", "volts"), [(-1, -1, None), (-1, 0, 0.0), (0, -1, 0.0)])
def test_no_battery_monitor_is_no_battery_of_0_v(
    vehicle: Vehicle, voice: Voice, current: int, left: int, volts: float | None
) -> None:
    assert reported(vehicle, voice.say(sys_status(0, current, left)))["battery"]["volts"] == volts


def test_a_second_battery_does_not_pass_for_the_first(vehicle: Vehicle, voice: Voice) -> None:
    other = mav.MAVLink_battery_status_message(1, 0, 0, 32767, [3000] + [65535] * 9, 5, 1, 1, 7, 0)
    battery = reported(vehicle, voice.say(other))["battery"]
    assert (battery["volts"], battery["percent"]) == (None, None)


def test_sensors_are_listed_by_name_and_the_bad_ones_apart(vehicle: Vehicle, voice: Voice) -> None:
    gyro, accel, gps = 1, 2, 32
    sensors = reported(vehicle, voice.say(sys_status(0, 0, 0, gyro | accel | gps, gyro | gps, gyro)))["sensors"]
    assert sensors["present"] == ["3d_gyro", "3d_accel", "gps"]
    assert sensors["enabled"] == ["3d_gyro", "gps"]
    assert sensors["unhealthy"] == ["gps"]
    assert sensors["load_percent"] == 50.0


def test_both_estimators_say_whether_they_can_navigate(vehicle: Vehicle, voice: Voice) -> None:
    good = mav.MAVLink_ekf_status_report_message(0x33F, 0.1, 0.1, 0.1, 0.1, 0.0)
    assert reported(vehicle, voice.say(good))["estimator"]["ok"] is True
    assert "pos_horiz_abs" in reported(vehicle)["estimator"]["names"]
    const_position = mav.MAVLink_ekf_status_report_message(0x33F | 0x80, 0.1, 0.1, 0.1, 0.1, 0.0)
    assert reported(vehicle, voice.say(const_position))["estimator"]["ok"] is False
    large = mav.MAVLink_ekf_status_report_message(0x33F, 0.1, 0.9, 0.1, 0.1, 0.0)
    assert reported(vehicle, voice.say(large))["estimator"]["ok"] is False
    px4, voice = new()
    fine = mav.MAVLink_estimator_status_message(1, 0x33F, 0.1, 0.1, 0.1, 0.1, 0, 0, 0.4, 0.6)
    estimator = reported(px4, voice.say(fine))["estimator"]
    assert (estimator["ok"], estimator["accuracy_m"]) == (True, [0.4, 0.6])
    at_rest = mav.MAVLink_estimator_status_message(1, 1023, 0.1, 0.1, 0.1, 0.1, 0, 0, 0.4, 0.6)
    assert reported(px4, voice.say(at_rest))["estimator"]["ok"] is True
    unaided = mav.MAVLink_estimator_status_message(1, 0x2F | 128, 0.1, 0.1, 0.1, 0.1, 0, 0, 0.4, 0.6)
    assert reported(px4, voice.say(unaided))["estimator"]["ok"] is False
    glitch = mav.MAVLink_estimator_status_message(1, 0x33F | 1024, 0.1, 0.1, 0.1, 0.1, 0, 0, 0.4, 0.6)
    assert reported(px4, voice.say(glitch))["estimator"]["ok"] is False


def test_a_mission_has_a_count_and_the_last_word_on_its_transfer(vehicle: Vehicle, voice: Voice) -> None:
    mission = reported(vehicle, voice.say(mav.MAVLink_mission_count_message(255, 25, 7)))["mission"]
    assert (mission["seq"], mission["count"], mission["last_ack"]) == (None, 7, None)
    frames = (mav.MAVLink_mission_current_message(3, 9), mav.MAVLink_mission_ack_message(255, 25, 13))
    mission = reported(vehicle, *map(voice.say, frames))["mission"]
    assert (mission["seq"], mission["count"], mission["last_ack"]) == (3, 9, "invalid_sequence")
    for total, count in ((0, 7), (65535, 0)):
        state = reported(vehicle, voice.say(mav.MAVLink_mission_current_message(0, total)))
        assert state["mission"]["count"] == count


@each("name", [b"SYSID_MYGCS", b"MAV_GCS_SYSID"])
def test_whose_heartbeats_the_failsafe_watches_is_known_from_its_parameter(name: bytes) -> None:
    vehicle, voice = new()
    assert (
        reported(vehicle, voice.say(mav.MAVLink_param_value_message(b"SYSID_THISMAV", 3.0, 9, 1, 1)))["gcs_sysid"]
        is None
    )
    assert reported(vehicle, voice.say(mav.MAVLink_param_value_message(name, 255.0, 9, 1, 1)))["gcs_sysid"] == 255
    odd = voice.say(mav.MAVLink_param_value_message(name, NAN, 9, 1, 1))
    assert reported(vehicle, odd)["gcs_sysid"] == 255


def test_rc_imu_servos_mission_and_vfr_have_their_place(vehicle: Vehicle, voice: Voice) -> None:
    rc = mav.MAVLink_rc_channels_message(1, 4, 1500, 1100, 0, 65535, *[1] * 14, 255)
    imu = mav.MAVLink_scaled_imu_message(1, 0, 0, -1000, 100, 0, 0, 200, 0, 0)
    servo = mav.MAVLink_servo_output_raw_message(1, 0, *range(1000, 1008))
    vfr = mav.MAVLink_vfr_hud_message(1.0, 2.0, 90, 55, 488.0, -0.5)
    state = reported(vehicle, *map(voice.say, (rc, imu, servo, vfr, mav.MAVLink_mission_current_message(3))))
    assert (state["rc"]["channels"], state["rc"]["rssi"]) == ([1500, 1100, None, None], None)
    assert state["imu"]["accel_mps2"] == pytest.approx([0, 0, -9.80665], abs=1e-3)
    assert state["imu"]["gyro_radps"] == [0.1, 0.0, 0.0]
    assert state["servos"]["pwm_us"][:8] == list(range(1000, 1008))
    assert (state["vfr"]["groundspeed_mps"], state["vfr"]["climb_mps"]) == (2.0, -0.5)
    assert state["mission"]["seq"] == 3


def test_targets_of_the_autopilot_hide_what_their_mask_ignores(vehicle: Vehicle, voice: Voice) -> None:
    there = mav.MAVLink_position_target_global_int_message(1, 6, 0xDF8, 473977420, 85455940, 12.0, *[9.0] * 8)
    local = mav.MAVLink_position_target_local_ned_message(1, 1, 0xDC7, 9, 9, 9, 1.0, 2.0, -3.0, 0, 0, 0, 0, 0)
    turn = mav.MAVLink_attitude_target_message(1, 0, [1, 0, 0, 0], 0, 0, 0, 0.45)
    state = reported(vehicle, *map(voice.say, (there, local, turn)))
    assert (state["target_global"]["lat_deg"], state["target_global"]["alt_m"]) == (47.397742, 12.0)
    assert (state["target_global"]["vel_enu_mps"], state["target_global"]["yaw_deg"]) == (None, None)
    assert (state["target_local"]["pos_enu_m"], state["target_local"]["vel_enu_mps"]) == (None, [2.0, 1.0, 3.0])
    assert state["target_attitude"]["thrust"] == 0.45


def test_home_and_the_altitude_heights_are_counted_from(vehicle: Vehicle, voice: Voice) -> None:
    assert vehicle.home_alt_amsl_m() is None
    home = mav.MAVLink_home_position_message(473977420, 85455940, 488100, 0, 0, 0, [NAN] * 4, 0, 0, 0)
    assert reported(vehicle, voice.say(home))["home"]["alt_amsl_m"] == 488.1
    assert vehicle.home_alt_amsl_m() == 488.1
    reported(vehicle, voice.position(alt_amsl_m=500.0, rel_m=10.0))
    assert vehicle.home_alt_amsl_m() == pytest.approx(490.0)
    unset = mav.MAVLink_home_position_message(0, 0, 0, 0, 0, 0, [NAN] * 4, 0, 0, 0)
    assert reported(vehicle, voice.say(unset))["home"] is None


def test_system_time_gives_uptime_and_clock_offset(vehicle: Vehicle, voice: Voice) -> None:
    vehicle.on_frame(voice.system_time(120_000, 1_700_000_010_000_000), 50.0)
    state = take_snapshot(vehicle, 60.0, unix_now=1_700_000_018.0)
    assert state["uptime_s"] == 130.0
    assert state["clock_offset_s"] == pytest.approx(2.0)
    assert take_snapshot(vehicle, 60.0)["clock_offset_s"] is None


def test_a_reboot_is_told_once_and_forgets_the_life_before(vehicle: Vehicle, voice: Voice) -> None:
    reported(vehicle, voice.beat(ARDUPILOT, 4), voice.position(), voice.landed(2), voice.system_time(500_000), now=1.0)
    (event,) = vehicle.on_frame(voice.system_time(8_000), 40.0)
    assert event.kind == "reboot"
    state = reported(vehicle, now=40.0)
    assert state["position"] is None
    assert state["time"]["boot_s"] == 8.0
    assert state["mode"] == "GUIDED"
    assert state["uptime_s"] == 8.0
    assert kinds(vehicle.on_frame(voice.text("ArduPilot Ready"), 41.0)) == ["statustext"]
    assert vehicle.on_frame(voice.system_time(9_000), 41.0) == ()


def test_a_boot_text_tells_a_reboot_where_no_clock_is_streamed(vehicle: Vehicle, voice: Voice) -> None:
    vehicle.on_frame(voice.beat(ARDUPILOT, 0), 1.0)
    assert kinds(vehicle.on_frame(voice.text("ArduPilot Ready"), 10.0)) == ["statustext"]
    assert kinds(vehicle.on_frame(voice.text("ArduPilot Ready"), 60.0)) == ["statustext", "reboot"]
    assert kinds(vehicle.on_frame(voice.text("ArduPilot Ready"), 61.0)) == ["statustext"]
    assert kinds(vehicle.on_frame(voice.text("ArduCopter V4.5.1 (abc)"), 200.0)) == ["statustext"]
    assert vehicle.firmware == "4.5.1"


def test_a_boot_text_before_the_clock_goes_back_is_one_reboot(vehicle: Vehicle, voice: Voice) -> None:
    reported(vehicle, voice.beat(ARDUPILOT, 0), voice.system_time(500_000), now=1.0)
    assert kinds(vehicle.on_frame(voice.text("ArduPilot Ready"), 60.0)) == ["statustext", "reboot"]
    assert vehicle.on_frame(voice.system_time(12_000), 61.0) == ()


def test_other_messages_clocks_tell_a_reboot_too(vehicle: Vehicle, voice: Voice) -> None:
    vehicle.on_frame(voice.beat(), 1.0)
    vehicle.on_frame(voice.position(boot_ms=500_000), 1.0)
    vehicle.tick(1.0)
    vehicle.tick(2.1)
    vehicle.on_frame(voice.position(boot_ms=4_000), 30.0)
    vehicle.on_frame(voice.beat(), 30.0)
    assert kinds(vehicle.tick(30.1)) == ["reboot"]
    assert vehicle.tick(31.2) == ()


def test_two_vehicles_with_one_id_on_one_link_are_told_once_and_are_no_reboots(vehicle: Vehicle, voice: Voice) -> None:
    events: list[Event] = []
    for n in range(10):
        events += vehicle.on_frame(voice.system_time(500_000 + 1000 * n), 1.0 * n)
        events += vehicle.on_frame(voice.system_time(20_000 + 1000 * n), 1.0 * n + 0.5)
        events += vehicle.tick(n + 0.6)
    assert kinds(tuple(events)) == ["duplicate"]
    assert "two vehicles with system id 1" in events[-1].text
    assert vehicle.duplicate
    events.clear()
    for n in range(10, 30):
        events += vehicle.on_frame(voice.system_time(500_000 + 1000 * n), 1.0 * n)
        events += vehicle.tick(n + 0.6)
    assert [e.data["change"] for e in events] == ["duplicate_over"]
    assert not vehicle.duplicate


def test_the_clocks_of_two_vehicles_on_one_link_are_seen_in_whatever_message_tells_them() -> None:
    """No false reboots: what was read of the clocks once a second could be of one vehicle many times in a row."""
    vehicle, voice = new()
    rng = random.Random(7)
    events: list[Event] = []
    for n in range(1, 600):
        now = n * 0.1
        boot_ms = rng.choice((500_000, 20_000)) + round(now * 1000)
        events += vehicle.on_frame(voice.position(boot_ms=boot_ms), now)
        if n % 2 == 0:
            events += vehicle.tick(now)
    assert kinds(tuple(events)) == ["duplicate"]


OTHER_HEARTBEATS = [
    ({"kind": 2, "autopilot": mav.MAV_AUTOPILOT_INVALID}, "conflict"),
    ({"kind": 0, "autopilot": mav.MAV_AUTOPILOT_INVALID}, "conflict"),
    ({"kind": 0, "autopilot": 0}, "conflict"),
    ({"kind": 18, "autopilot": ARDUPILOT}, "conflict"),
    ({"kind": 6, "autopilot": ARDUPILOT}, "conflict"),
    ({"kind": 2, "autopilot": PX4}, "duplicate"),
    ({"kind": 0, "autopilot": ARDUPILOT}, "duplicate"),
    ({"kind": 1, "autopilot": ARDUPILOT}, "duplicate"),
]


@each(("other", "kind"), OTHER_HEARTBEATS)
def test_a_heartbeat_that_is_not_its_own_changes_nothing_and_is_told_once(other: dict[str, int], kind: str) -> None:
    vehicle, voice = new()
    own = voice.beat(ARDUPILOT, 4, armed=True, status=4)
    vehicle.on_frame(own, 0.0)
    events: list[Event] = []
    for n in range(1, 500):  # 50 a second beside its own one
        now = n * 0.02
        events += vehicle.on_frame(voice.beat(mode=0, armed=False, **other), now)
        if n % 50 == 0:
            events += vehicle.on_frame(own, now)
        assert (vehicle.family, vehicle.type, vehicle.mode, vehicle.armed) == ("ardupilot", 2, "GUIDED", True)
    assert kinds(tuple(events)) == [kind]
    assert vehicle.duplicate is (kind == "duplicate")
    assert vehicle.count("HEARTBEAT") == 10
    vehicle.on_frame(own, 60.0)
    assert not vehicle.tick(40.0) or not vehicle.duplicate


def test_another_firmware_is_believed_once_the_vehicle_was_lost(vehicle: Vehicle, voice: Voice) -> None:
    vehicle.on_frame(voice.beat(ARDUPILOT, 4, armed=True, status=4), 0.0)
    for n in range(1, 6):
        vehicle.on_frame(voice.beat(PX4), float(n))
        assert vehicle.family == "ardupilot"
    assert "vehicle_lost" in kinds(vehicle.tick(5.5))
    events = vehicle.on_frame(voice.beat(PX4), 6.0)
    assert "vehicle_back" in kinds(events)
    assert vehicle.family == "px4" and not vehicle.armed


def test_two_senders_of_one_firmware_on_one_link_leave_the_first_state(vehicle: Vehicle, voice: Voice) -> None:
    events: list[Event] = []
    for n in range(10):
        events += vehicle.on_frame(voice.beat(ARDUPILOT, 4, armed=True, status=4), 1.0 * n)
        events += vehicle.on_frame(voice.beat(ARDUPILOT, 0, armed=False), n + 0.5)
        events += vehicle.tick(n + 0.6)
        if n >= 3:
            assert (vehicle.mode, vehicle.armed) == ("GUIDED", True)
    assert vehicle.duplicate
    assert kinds(tuple(events)).count("duplicate") == 1
    assert kinds(tuple(events)).count("armed") <= 3
    for n in range(10, 20):
        events += vehicle.on_frame(voice.beat(ARDUPILOT, 4, armed=True, status=4), 1.0 * n)
        events += vehicle.tick(n + 0.6)
    assert events[-1].data["change"] == "duplicate_over"
    assert not vehicle.duplicate


def test_landed_is_told_by_its_message_and_inferred_without_it(vehicle: Vehicle, voice: Voice) -> None:
    vehicle.on_frame(voice.beat(ARDUPILOT, 4), 1.0)
    assert vehicle.landed(1.0) == "on_ground"
    vehicle.on_frame(voice.beat(ARDUPILOT, 4, armed=True, status=3), 2.0)
    assert vehicle.in_air(2.0) is False
    vehicle.on_frame(voice.beat(ARDUPILOT, 4, armed=True, status=4), 3.0)
    assert vehicle.in_air(3.0) is True
    assert vehicle.on_frame(voice.landed(1), 3.1) == ()
    assert vehicle.in_air(3.2) is False
    (event,) = vehicle.on_frame(voice.landed(3), 4.0)
    assert (event.kind, event.data) == ("landed", {"landed": "takeoff", "was": "on_ground"})
    assert vehicle.in_air(4.0) is True
    assert vehicle.landed(100.0) == "in_air"  # too old: the heartbeat's word is taken again


def test_an_armed_px4_without_landed_state_is_not_guessed(vehicle: Vehicle, voice: Voice) -> None:
    vehicle.on_frame(voice.beat(PX4, PX4_POSCTL, armed=True, status=4), 1.0)
    assert vehicle.in_air(1.0) is None
    assert reported(vehicle)["landed"] == "undefined"


def test_high_latency_keeps_it_connected_and_tells_failures(vehicle: Vehicle, voice: Voice) -> None:
    vehicle.on_frame(voice.beat(PX4, PX4_LAND), 1.0)
    message = mav.MAVLink_high_latency2_message(
        1,
        2,
        12,
        4 | 3 << 8,
        473977420,
        85455940,
        490,
        0,
        45,
        0,
        0,
        55,
        0,
        0,
        25,
        0,
        0,
        0,
        0,
        0,
        0,
        77,
        3,
        1 | 128,
        0,
        0,
        0,
    )
    events = vehicle.on_frame(voice.say(message), 6.0)
    assert kinds(events) == ["mode", "failsafe"]
    assert vehicle.mode == "AUTO.LOITER"
    assert vehicle.tick(20.0) == ()
    section = reported(vehicle)["high_latency"]
    assert section["failures"] == ["gps", "battery"]
    assert (section["heading_deg"], section["groundspeed_mps"], section["battery_percent"]) == (90, 5.0, 77)
    assert kinds(vehicle.tick(30.0)) == ["vehicle_lost"]


def test_status_texts_are_kept_newest_last_and_bounded(vehicle: Vehicle, voice: Voice) -> None:
    for n in range(MAX_STATUS_TEXTS + 5):
        (event,) = vehicle.on_frame(voice.text(f"text {n}", severity=3), float(n))
        assert event.data == {"severity": "error", "level": 3, "text": f"text {n}"}
    texts = reported(vehicle, now=100.0)["status_texts"]
    assert len(texts) == MAX_STATUS_TEXTS
    assert texts[-1] == {
        "severity": "error",
        "level": 3,
        "text": f"text {MAX_STATUS_TEXTS + 4}",
        "compid": 1,
        "age_s": 64.0,
    }


def test_a_text_that_is_never_completed_comes_with_a_tick(vehicle: Vehicle, voice: Voice) -> None:
    half = mav.MAVLink_statustext_message(4, b"x" * 50, id=7, chunk_seq=0)
    assert vehicle.on_frame(voice.say(half), 1.0) == ()
    assert vehicle.tick(2.0) == ()
    assert [e.text for e in vehicle.tick(3.1)] == ["x" * 50]


def test_rates_and_counts_per_message(vehicle: Vehicle, voice: Voice) -> None:
    frame, beat = voice.position(), voice.beat()
    for n in range(100):
        now = n / 10
        vehicle.on_frame(frame, now)
        if n % 10 == 0:
            vehicle.on_frame(beat, now)
        vehicle.tick(now)
    rates = reported(vehicle, now=10.0)["messages"]
    assert rates["GLOBAL_POSITION_INT"]["rate_hz"] == pytest.approx(10.0, abs=0.5)
    assert rates["HEARTBEAT"]["rate_hz"] == pytest.approx(1.0, abs=0.3)
    assert rates["GLOBAL_POSITION_INT"]["count"] == 100
    for n in range(100, 300):
        vehicle.tick(n / 10)
    assert reported(vehicle, now=30.0)["messages"]["GLOBAL_POSITION_INT"]["rate_hz"] == 0.0


def test_a_section_is_unpacked_once_per_frame(vehicle: Vehicle, voice: Voice) -> None:
    reported(vehicle, voice.position())
    first = vehicle.telemetry("position")
    reported(vehicle, now=12.0)
    assert vehicle.telemetry("position") is first
    reported(vehicle, voice.position(rel_m=1.0))
    assert vehicle.telemetry("position") is not first


def test_a_frame_is_unpacked_once_for_all_that_is_made_of_it(monkeypatch: pytest.MonkeyPatch) -> None:
    vehicle, voice = new()
    unpacked: list[str] = []
    values = Decoder.values

    def noted(decoder: Decoder, name: str, payload: bytes) -> Any:
        unpacked.append(name)
        return values(decoder, name, payload)

    monkeypatch.setattr(Decoder, "values", noted)
    detail = mav.MAVLink_battery_status_message(0, 0, 0, 32767, [3000] * 10, -1, 378, -1, 42, 0)
    reported(vehicle, voice.say(sys_status(12600, 1530, 88)))  # battery and sensors
    reported(vehicle, voice.say(detail), voice.position())  # completes the battery
    vehicle.tick(11.0)
    vehicle.tick(12.0)
    reported(vehicle, now=12.0)
    assert sorted(unpacked) == ["BATTERY_STATUS", "GLOBAL_POSITION_INT", "SYS_STATUS"]


@given(st.sampled_from(sorted(ARRAYS)), st.binary(max_size=255))
def test_arrays_are_read_as_the_dialect_unpacks_them(name: str, payload: bytes) -> None:
    whole = flight_dialect().by_name[name].unpack(payload)
    wanted = [whole[field] for field in (*FIELDS.get(name, ()), *ARRAYS[name])]
    read = [list(v) if isinstance(v, tuple) else v for v in DECODER.values(name, payload)]
    assert repr(read) == repr(wanted)  # NaN is not itself


def test_a_frame_of_unknown_id_leaves_no_trace(vehicle: Vehicle, voice: Voice) -> None:
    beat = voice.beat()
    assert vehicle.on_frame(Frame(beat.raw, 0, 1, 1, 60000, None), 1.0) == ()
    assert vehicle.slots == {}


def test_the_last_acknowledgement_is_shown_in_words(vehicle: Vehicle, voice: Voice) -> None:
    state = reported(vehicle, voice.ack(22, 4))
    assert state["last_ack"] == {"command": "NAV_TAKEOFF", "result": "failed", "age_s": 0.0}


def test_firmware_comes_from_autopilot_version(vehicle: Vehicle, voice: Voice) -> None:
    version = mav.MAVLink_autopilot_version_message(0, 0x040501FF, 0, 0, 0, [0] * 8, [0] * 8, [0] * 8, 0, 0, 0)
    assert reported(vehicle, voice.say(version))["firmware"] == "4.5.1"


DECODED = sorted({name for section in GROUPS for name in section.messages} | set(DECODER.read))


@given(st.lists(st.tuples(st.sampled_from(DECODED), st.binary(max_size=255)), max_size=12))
def test_no_payload_whatever_makes_it_raise_or_say_what_is_no_json(story: list[tuple[str, bytes]]) -> None:
    vehicle, _ = new()
    vehicle.origin = Origin(*HOME)
    now = 0.0
    for name, payload in story:
        info = flight_dialect().by_name[name]
        raw = bytes((0xFD, len(payload), 0, 0, 0, 1, 1, info.msgid & 255, info.msgid >> 8, 0)) + payload + b"\0\0"
        now += 0.7
        vehicle.on_frame(Frame(raw, 0, 1, 1, info.msgid, info), now)
        vehicle.tick(now)
        json.dumps(take_snapshot(vehicle, now, 1.7e9), allow_nan=False)


def test_a_dialect_with_next_to_nothing_still_makes_a_vehicle() -> None:
    from skygcs.core.mavlink.dialect import Dialect

    heartbeat = flight_dialect().by_name["HEARTBEAT"]
    tiny = Dialect("tiny", [heartbeat], {})
    vehicle = Vehicle(1, 1, tiny)
    vehicle.on_frame(Voice(1).beat(), 1.0)
    state = take_snapshot(vehicle, 1.0)
    assert (state["mode"], state["type"], state["gps"]) == ("AUTO.LOITER", "2", None)
    assert vehicle.name == "v1"
