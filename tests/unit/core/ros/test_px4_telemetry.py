"""Converters of PX4's own topics against the streams that a PX4 makes its messages by, and textbook formulas; the
definitions against their layout. Streams: src/modules/mavlink/streams of PX4 1.16, and `EKF2::Publish…` for what they
are made of."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from skygcs.core.ros.interfaces import PX4_RELEASES, Px4Release, ros2_interfaces
from skygcs.core.ros.px4_setpoints import ACK_TYPE, PX4_INPUTS
from skygcs.core.ros.px4_telemetry import PX4_SOURCES, PX4_TELEMETRY, Px4Memory, px4_samples, versioned
from skygcs.core.ros.stamps import EPOCH_US
from support.table import each
from unit.core.ros.mavros_oracle import of_angles

NOW = 1_700_000_000 * 10**9

LOCAL = {"time_boot_ms": 5000, "x": 1.0, "y": 2.0, "z": -3.0, "vx": 0.5, "vy": -0.25, "vz": 0.125}
RATES = {"rollspeed": 0.1, "pitchspeed": 0.2, "yawspeed": 0.3}
HEARTBEAT = {"autopilot": 12, "type": 2, "base_mode": 0x91, "custom_mode": 0x60000, "system_status": 4}
GLOBAL = {"time_boot_ms": 5000, "lat": 437806000, "lon": -794653000, "alt": 184500, "relative_alt": 4500}
BATTERY = {
    **{"id": 0, "voltages": [4100, 4000, 4050, *[0xFFFF] * 7], "current_battery": 1234, "current_consumed": 250},
    **{"battery_remaining": 87, "temperature": 2550, "charge_state": 2},
}
ODOMETRY = {
    **{"time_usec": 6_000_000, "frame_id": 1, "child_frame_id": 12, "reset_counter": 3, "quality": 90},
    **{"x": 1.0, "y": 2.0, "z": 3.0, "q": [0.5, 0.5, 0.5, 0.5], "vx": 4.0, "vy": 5.0, "vz": 6.0, **RATES},
    "pose_covariance": [float(n) for n in range(21)],
    "velocity_covariance": [float(100 + n) for n in range(21)],
}


def made(name: str, fields: dict[str, Any], memory: Px4Memory, now: int = NOW) -> dict[str, Any]:
    """What is published of a message, by topic, as a reader of release 1.16 decodes it."""
    known = ros2_interfaces()
    found = {}
    for sample in px4_samples(name, fields, now, memory):
        type_ = PX4_TELEMETRY[sample.topic]
        found[sample.topic] = known.decode(type_, known.encode(type_, known.only_known(type_, sample.fields)))
    return found


def matrix(q: Any) -> Any:
    w, x, y, z = q
    v = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.eye(3) + 2 * w * v + 2 * v @ v


ANGLE = st.floats(-math.pi, math.pi)


@given(ANGLE, st.floats(-1.5, 1.5), ANGLE)
def test_an_attitude_turns_frd_into_ned(roll: float, pitch: float, yaw: float) -> None:
    memory = Px4Memory(1)
    fields = {"time_boot_ms": 1234, "roll": roll, "pitch": pitch, "yaw": yaw, **RATES}
    attitude = made("ATTITUDE", fields, memory)["vehicle_attitude"]
    assert matrix(attitude["q"]) == pytest.approx(of_angles(roll, pitch, yaw), abs=1e-5)
    assert attitude["timestamp"] == attitude["timestamp_sample"] == 1_234_000
    heading = made("LOCAL_POSITION_NED", LOCAL, memory)["vehicle_local_position"]["heading"]
    assert math.cos(heading - yaw) == pytest.approx(1, abs=1e-6)


def test_quaternions_pass_in_their_order_and_take_the_place_of_angles() -> None:
    memory = Px4Memory(1)
    q = {"time_boot_ms": 1, "q1": 0.5, "q2": -0.5, "q3": 0.5, "q4": 0.5, **RATES}
    assert made("ATTITUDE_QUATERNION", q, memory)["vehicle_attitude"]["q"] == [0.5, -0.5, 0.5, 0.5]
    angles = {"time_boot_ms": 1, "roll": 0.0, "pitch": 0.0, "yaw": 0.0, **RATES}
    assert made("ATTITUDE", angles, memory) == {}
    assert made("ATTITUDE", angles, memory, NOW + 4 * 10**9)["vehicle_attitude"]["q"] == [1.0, 0.0, 0.0, 0.0]


def test_a_local_position_stays_ned_and_what_is_not_carried_is_unknown() -> None:
    memory = Px4Memory(1)
    first = made("LOCAL_POSITION_NED", LOCAL, memory)
    local, odometry = first["vehicle_local_position"], first["vehicle_odometry"]
    assert [local[name] for name in ("x", "y", "z", "vx", "vy", "vz")] == [1.0, 2.0, -3.0, 0.5, -0.25, 0.125]
    assert all(math.isnan(local[name]) for name in ("ax", "heading", "ref_lat", "ref_alt", "eph", "epv", "dist_bottom"))
    assert local["vxy_max"] == math.inf and not local["xy_global"] and not local["dist_bottom_valid"]
    assert all(map(math.isnan, odometry["q"] + odometry["position_variance"]))
    assert (odometry["pose_frame"], odometry["velocity_frame"]) == (1, 1)
    origin = {"latitude": 437806000, "longitude": -794653000, "altitude": 180000, "time_usec": 77}
    px4_samples("GPS_GLOBAL_ORIGIN", origin, NOW, memory)
    estimator = {"flags": 1 << 1, "pos_horiz_accuracy": 0.5, "pos_vert_accuracy": 0.75}
    px4_samples("ESTIMATOR_STATUS", estimator, NOW, memory)
    px4_samples("ALTITUDE", {"altitude_amsl": 183.0, "bottom_clearance": 2.5}, NOW, memory)
    local = made("LOCAL_POSITION_NED", LOCAL, memory)["vehicle_local_position"]
    assert (local["ref_lat"], local["ref_lon"], local["ref_alt"]) == pytest.approx((43.7806, -79.4653, 180.0))
    assert local["xy_global"] and local["z_global"] and local["ref_timestamp"] == 77
    assert local["xy_valid"] and local["v_xy_valid"] and not local["z_valid"] and not local["v_z_valid"]
    assert (local["eph"], local["epv"], local["dist_bottom"]) == (0.5, 0.75, 2.5) and local["dist_bottom_valid"]
    later = made("LOCAL_POSITION_NED", LOCAL | {"time_boot_ms": 10_000}, memory, NOW + 5 * 10**9)
    assert math.isnan(later["vehicle_local_position"]["eph"]) and later["vehicle_local_position"]["xy_global"]


def test_an_odometry_passes_with_its_frames_and_variances_and_takes_the_place_of_the_other() -> None:
    memory = Px4Memory(1)
    odometry = made("ODOMETRY", ODOMETRY, memory)["vehicle_odometry"]
    assert (odometry["position"], odometry["velocity"], odometry["q"]) == ([1, 2, 3], [4, 5, 6], [0.5] * 4)
    assert odometry["angular_velocity"] == pytest.approx([0.1, 0.2, 0.3])
    assert (odometry["pose_frame"], odometry["velocity_frame"]) == (1, 3)
    # the diagonal of a symmetric 6 by 6 matrix whose upper right triangle is written row by row
    upper = {pair: n for n, pair in enumerate((row, column) for row in range(6) for column in range(row, 6))}
    diagonal = [float(upper[n, n]) for n in range(6)]
    assert odometry["position_variance"] + odometry["orientation_variance"] == diagonal
    assert odometry["velocity_variance"] == [100 + value for value in diagonal[:3]]
    assert (odometry["reset_counter"], odometry["quality"], odometry["timestamp"]) == (3, 90, 6_000_000)
    assert "vehicle_odometry" not in made("LOCAL_POSITION_NED", LOCAL | {"time_boot_ms": 6000}, memory)
    unknown = ODOMETRY | {"pose_covariance": [None, *[0.0] * 20]}
    assert math.isnan(made("ODOMETRY", unknown, memory)["vehicle_odometry"]["position_variance"][0])


def altitude_of(z: float, ref_alt: float, dist_bottom: float | None) -> dict[str, float | None]:
    """ALTITUDE as its stream fills it of a vehicle_local_position."""
    bottom = {"bottom_clearance": dist_bottom, "altitude_terrain": None if dist_bottom is None else -z - dist_bottom}
    return {"altitude_amsl": -z + ref_alt, "altitude_local": -z, **bottom}


@each("flags", [0, *(1 << bit for bit in range(12)), 0x24, 0xFFF])
def test_what_is_valid_is_what_the_estimator_says(flags: int) -> None:
    """get_ekf_soln_status: bit 1 is isLocalHorizontalPositionValid, bit 2 is that of the vertical position or velocity,
    bit 4 isGlobalHorizontalPositionValid, bit 6 isTerrainEstimateValid; bit 5 isVerticalAidingActive, without which a
    vertical velocity alone would show an altitude as valid."""
    memory = Px4Memory(1)
    px4_samples("ESTIMATOR_STATUS", {"flags": flags, "pos_horiz_accuracy": 1, "pos_vert_accuracy": 1}, NOW, memory)
    px4_samples("ALTITUDE", altitude_of(-4.5, 180.0, 3.0), NOW, memory)
    local = made("LOCAL_POSITION_NED", LOCAL, memory)["vehicle_local_position"]
    assert local["xy_valid"] == local["v_xy_valid"] == bool(flags & 2)
    assert local["z_valid"] == local["v_z_valid"] == bool(flags & 4)
    place = made("GLOBAL_POSITION_INT", GLOBAL, memory)["vehicle_global_position"]
    assert (place["lat_lon_valid"], place["alt_valid"]) == (bool(flags & 16), flags & 0x24 == 0x24)
    assert place["terrain_alt_valid"] == bool(flags & 64)
    for later_s in (9, 11, 3600):  # silence makes nothing valid
        later = LOCAL | {"time_boot_ms": 5000 + 1000 * later_s}
        local = made("LOCAL_POSITION_NED", later, memory, NOW + later_s * 10**9)["vehicle_local_position"]
        assert local["xy_valid"] == bool(flags & 2)
    heard_again = memory.after_loss()
    assert heard_again.clock is memory.clock and heard_again.messages == {}
    local = made("LOCAL_POSITION_NED", LOCAL, heard_again)["vehicle_local_position"]
    assert (local["xy_valid"], local["z_valid"]) == (bool(flags & 2), bool(flags & 4))


def test_what_an_estimator_that_never_spoke_sends_is_taken_as_valid() -> None:
    local = made("LOCAL_POSITION_NED", LOCAL, Px4Memory(1).after_loss())["vehicle_local_position"]
    assert local["xy_valid"] and local["z_valid"]
    place = made("GLOBAL_POSITION_INT", GLOBAL, Px4Memory(1))["vehicle_global_position"]
    assert place["lat_lon_valid"] and place["alt_valid"]
    nowhere = made("GLOBAL_POSITION_INT", GLOBAL | {"lat": 40, "lon": -7}, Px4Memory(1))["vehicle_global_position"]
    assert not nowhere["lat_lon_valid"]


def test_a_global_position_has_the_geoid_of_the_receiver_and_the_terrain() -> None:
    memory = Px4Memory(1)
    place = made("GLOBAL_POSITION_INT", GLOBAL, memory)["vehicle_global_position"]
    assert (place["lat"], place["lon"], place["alt"]) == (43.7806, -79.4653, 184.5)
    assert place["lat_lon_valid"] and math.isnan(place["alt_ellipsoid"]) and not place["terrain_alt_valid"]
    px4_samples("GPS_RAW_INT", {"alt": 183000, "alt_ellipsoid": 146700}, NOW, memory)
    px4_samples("ALTITUDE", altitude_of(z=-4.5, ref_alt=180.0, dist_bottom=None), NOW, memory)
    place = made("GLOBAL_POSITION_INT", GLOBAL, memory)["vehicle_global_position"]
    assert place["alt_ellipsoid"] == pytest.approx(184.5 - 36.3, abs=1e-4)
    assert math.isnan(place["terrain_alt"]) and not place["terrain_alt_valid"]
    px4_samples("ALTITUDE", altitude_of(z=-4.5, ref_alt=180.0, dist_bottom=3.0), NOW, memory)
    place = made("GLOBAL_POSITION_INT", GLOBAL, memory)["vehicle_global_position"]
    # PublishGlobalPosition: the origin's altitude less the terrain's place below it
    assert place["terrain_alt"] == pytest.approx(180.0 - (-4.5 + 3.0)) and place["terrain_alt_valid"]
    assert not made("GLOBAL_POSITION_INT", GLOBAL | {"lat": 0, "lon": 0}, memory)["vehicle_global_position"][
        "alt_valid"
    ]


def test_a_battery_by_cells_by_the_whole_and_by_sys_status() -> None:
    memory = Px4Memory(1)
    system = {"voltage_battery": 12150, "current_battery": -1, "battery_remaining": -1}
    system["onboard_control_sensors_health"] = 0
    battery = made("SYS_STATUS", system, memory)["battery_status"]
    assert (battery["voltage_v"], battery["current_a"], battery["remaining"], battery["id"]) == (
        *(pytest.approx(12.15), -1.0, -1.0, 1),
    )
    battery = made("BATTERY_STATUS", BATTERY, memory)["battery_status"]
    assert battery["voltage_v"] == pytest.approx(12.15) and battery["cell_count"] == 3
    assert battery["voltage_cell_v"][:4] == pytest.approx([4.1, 4.0, 4.05, 0.0])
    assert battery["current_a"] == pytest.approx(12.34) and battery["remaining"] == pytest.approx(0.87)
    assert (battery["discharged_mah"], battery["temperature"], battery["warning"], battery["id"]) == (250, 25.5, 1, 1)
    assert math.isnan(battery["time_remaining_s"]) and battery["scale"] == -1
    assert made("SYS_STATUS", system, memory) == {}
    whole = BATTERY | {"voltages": [0xFFFE, 3000, *[0xFFFF] * 8], "temperature": 0x7FFF, "current_battery": -1}
    battery = made("BATTERY_STATUS", whole, memory)["battery_status"]
    assert battery["voltage_v"] == pytest.approx(68.534) and battery["cell_count"] == 0
    assert math.isnan(battery["temperature"]) and battery["current_a"] == -1


def test_a_battery_that_is_not_connected_is_not() -> None:
    """BATTERY_STATUS.hpp and SYS_STATUS.hpp: all that is known of it is that it is not."""
    none = {"voltages": [0xFFFF] * 10, "voltages_ext": [0] * 4, "current_battery": -1, "current_consumed": -1}
    none |= {"id": 255, "battery_remaining": -1, "temperature": 0x7FFF, "charge_state": 1}
    battery = made("BATTERY_STATUS", none, Px4Memory(1))["battery_status"]
    assert not battery["connected"] and battery["voltage_v"] == 0 and battery["id"] == 0  # the stream sends id - 1
    assert (battery["current_a"], battery["discharged_mah"], battery["remaining"]) == (-1, -1, -1)
    system = {"voltage_battery": 0xFFFF, "current_battery": -1, "battery_remaining": -1}
    assert not made("SYS_STATUS", system, Px4Memory(1))["battery_status"]["connected"]


@each(
    ("armed", "system_status", "health", "passed"),
    [
        *((False, 3, 0, True), (False, 0, 1 << 28, False), (False, 2, 1 << 28, True), (False, 2, 0, False)),
        *((True, 4, 1 << 28, True), (True, 4, 0, False)),
    ],
)
def test_the_checks_before_arming(armed: bool, system_status: int, health: int, passed: bool) -> None:
    """HEARTBEAT.hpp: a disarmed vehicle is STANDBY (3) once pre_flight_checks_pass, else UNINIT (0), or calibrating."""
    memory = Px4Memory(1)
    system = {"voltage_battery": 0, "current_battery": 0, "battery_remaining": 0}
    px4_samples("SYS_STATUS", system | {"onboard_control_sensors_health": health}, NOW, memory)
    heartbeat = HEARTBEAT | {"base_mode": 0x91 if armed else 0x11, "system_status": system_status}
    assert made("HEARTBEAT", heartbeat, memory)["vehicle_status"]["pre_flight_checks_pass"] is passed


@each(
    ("main", "sub", "nav_state"),
    [(1, 0, 0), (2, 0, 1), (3, 0, 2), (4, 3, 4), (4, 4, 3), (4, 5, 5), (4, 6, 18), (4, 11, 23), (6, 0, 14), (9, 9, 31)],
)
def test_a_status_has_the_mode(main: int, sub: int, nav_state: int) -> None:
    status = made("HEARTBEAT", HEARTBEAT | {"custom_mode": main << 16 | sub << 24}, Px4Memory(7))["vehicle_status"]
    assert (status["nav_state"], status["system_id"], status["component_id"]) == (nav_state, 7, 1)


def test_a_status_is_completed_by_other_messages() -> None:
    memory = Px4Memory(1)
    status = made("HEARTBEAT", HEARTBEAT, memory)["vehicle_status"]
    assert (status["arming_state"], status["vehicle_type"], status["failsafe"]) == (2, 1, False)
    assert status["timestamp"] == 0 and not status["pre_flight_checks_pass"]
    made("LOCAL_POSITION_NED", LOCAL, memory)
    px4_samples("EXTENDED_SYS_STATE", {"vtol_state": 1, "landed_state": 2}, NOW, memory)
    px4_samples(
        "SYS_STATUS",
        {"onboard_control_sensors_health": 1 << 28, "voltage_battery": 0, "current_battery": 0, "battery_remaining": 0},
        NOW,
        memory,
    )
    vtol = HEARTBEAT | {"type": 22, "system_status": 5, "base_mode": 0x91 | 0x20}
    status = made("HEARTBEAT", vtol, memory, NOW + 250_000_000)["vehicle_status"]
    assert status["is_vtol"] and status["in_transition_mode"] and status["in_transition_to_fw"]
    assert status["failsafe"] and status["pre_flight_checks_pass"] and status["hil_state"] == 1
    assert status["timestamp"] == 5_250_000  # 0.25 s after a message of 5 s since boot
    px4_samples("EXTENDED_SYS_STATE", {"vtol_state": 4, "landed_state": 2}, NOW, memory)
    assert made("HEARTBEAT", vtol, memory)["vehicle_status"]["vehicle_type"] == 2


def test_a_time_since_1970_becomes_one_since_boot() -> None:
    memory = Px4Memory(1)
    made("LOCAL_POSITION_NED", LOCAL, memory)
    fields = ODOMETRY | {"time_usec": NOW // 1000 + 1_000_000}
    assert fields["time_usec"] > EPOCH_US
    stamp = made("ODOMETRY", fields, memory, NOW + 10**9)["vehicle_odometry"]["timestamp"]
    assert stamp == 6_000_000


def test_names_have_the_versions_of_each_release() -> None:
    def names(release: Px4Release) -> set[str]:
        types = {**PX4_TELEMETRY, **PX4_INPUTS, "vehicle_command_ack": ACK_TYPE}
        known = ros2_interfaces(release)
        return {
            name for name in (versioned(known, topic, type_) for topic, type_ in types.items()) if "_v" in name[-4:]
        }

    assert names("1.14") == names("1.15") == set()
    assert names("1.16") == {"vehicle_status_v1"}
    assert names("1.17") == {"vehicle_status_v1", "vehicle_local_position_v1", "battery_status_v1"}
    expected = {"vehicle_status_v4", "vehicle_local_position_v1", "battery_status_v1", "vehicle_command_ack_v1"}
    assert names("1.18") == expected


@each("release", PX4_RELEASES)
def test_every_release_takes_every_message_and_no_field_is_of_none(release: Px4Release) -> None:
    known = ros2_interfaces(release)
    everywhere: dict[str, set[str]] = {}
    for type_ in PX4_TELEMETRY.values():
        everywhere[type_] = {name for each in PX4_RELEASES for name in ros2_interfaces(each).fields_of(type_)}
    messages: dict[str, dict[str, Any]] = {
        "LOCAL_POSITION_NED": LOCAL,
        "HEARTBEAT": HEARTBEAT,
        "GLOBAL_POSITION_INT": GLOBAL,
    }
    topics = set()
    for name, fields in {**messages, "BATTERY_STATUS": BATTERY, "ODOMETRY": ODOMETRY}.items():
        for sample in px4_samples(name, fields, NOW, Px4Memory(1)):
            type_ = PX4_TELEMETRY[sample.topic]
            assert sample.fields.keys() <= everywhere[type_]
            assert sample.topic in PX4_SOURCES[name].topics
            known.encode(type_, known.only_known(type_, sample.fields))
            topics.add(sample.topic)
    assert topics == PX4_TELEMETRY.keys() - {"vehicle_attitude"}


def test_encodings_have_the_layout_of_px4s_definitions() -> None:
    """Sizes by hand from the .msg files of release 1.16: 4 bytes of header, members on their own alignment."""
    known = ros2_interfaces()
    sizes = {
        "px4_msgs/msg/VehicleAttitude": 8 + 8 + 16 + 16 + 1,
        "px4_msgs/msg/VehicleOdometry": 8 + 8 + 1 + 3 + 12 + 16 + 1 + 3 + 12 + 12 + 12 + 12 + 12 + 1 + 1,
        "px4_msgs/msg/TrajectorySetpoint": 8 + 4 * 12 + 4 + 4,
        "px4_msgs/msg/OffboardControlMode": 8 + 7,
        "px4_msgs/msg/VehicleCommand": 8 + 16 + 16 + 4 + 4 + 3 + 1 + 2 + 1 + 1,
    }
    for type_, size in sizes.items():
        data = known.encode(type_, {})
        assert size <= len(data) - 4 <= size + 3, type_  # the end may be padded
    attitude = known.encode("px4_msgs/msg/VehicleAttitude", {"timestamp": 1, "q": (1.0, 0.0, 0.0, 0.0)})
    assert attitude[4:12] == b"\1" + b"\0" * 7 and attitude[20:24] == b"\0\0\x80\x3f"
