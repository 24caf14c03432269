"""Names, types, qualities of service and flight modes against what MAVROS 2.12.0's source declares."""

from __future__ import annotations

from typing import Any

from skygcs.core.ros.condition import LOG_LEVELS, log_entry, ros_mode
from skygcs.core.ros.setpoints import SETPOINTS
from skygcs.core.ros.topics import DEPTHS, LATCHED, TELEMETRY, Topic
from support.table import each

SENSOR, PLAIN, STATE, LAST = (False, False, 5), (True, False, 10), (True, True, 10), (True, True, 1)
"""(reliable, transient local, depth): rclcpp's SensorDataQoS, QoS(10), QoS(10).transient_local(), and LatchedStateQoS
of mavros/include/mavros/qos.hpp."""

PUBLISHED: dict[str, dict[tuple[bool, bool, int], str]] = {
    "sys_status": {
        STATE: "state:State extended_state:ExtendedState sys_status:SysStatus estimator_status:EstimatorStatus",
        SENSOR: "battery:sensor_msgs/BatteryState statustext/recv:StatusText status_event:StatusEvent",
    },
    "imu": {
        SENSOR: "imu/data:sensor_msgs/Imu imu/data_raw:sensor_msgs/Imu imu/mag:sensor_msgs/MagneticField "
        "imu/temperature_imu:sensor_msgs/Temperature imu/temperature_baro:sensor_msgs/Temperature "
        "imu/static_pressure:sensor_msgs/FluidPressure imu/diff_pressure:sensor_msgs/FluidPressure"
    },
    "global_position": {
        SENSOR: "global_position/raw/fix:sensor_msgs/NavSatFix global_position/raw/gps_vel:geometry_msgs/TwistStamped "
        "global_position/raw/satellites:std_msgs/UInt32 global_position/global:sensor_msgs/NavSatFix "
        "global_position/local:nav_msgs/Odometry global_position/rel_alt:std_msgs/Float64 "
        "global_position/compass_hdg:std_msgs/Float64",
        LAST: "global_position/gp_origin:geographic_msgs/GeoPointStamped",
    },
    "local_position": {
        SENSOR: "local_position/pose:geometry_msgs/PoseStamped "
        "local_position/pose_cov:geometry_msgs/PoseWithCovarianceStamped "
        "local_position/velocity_local:geometry_msgs/TwistStamped "
        "local_position/velocity_body:geometry_msgs/TwistStamped "
        "local_position/velocity_body_cov:geometry_msgs/TwistWithCovarianceStamped "
        "local_position/accel:geometry_msgs/AccelWithCovarianceStamped local_position/odom:nav_msgs/Odometry"
    },
    "altitude": {SENSOR: "altitude:Altitude"},
    "home_position": {STATE: "home_position/home:HomePosition"},
    "rc_io": {PLAIN: "rc/in:RCIn rc/out:RCOut"},
    "3dr_radio": {SENSOR: "radio_status:RadioStatus"},
    "sys_time": {SENSOR: "time_reference:sensor_msgs/TimeReference"},
    "vfr_hud": {PLAIN: "vfr_hud:VfrHud"},
    "waypoint": {LAST: "mission/reached:WaypointReached"},
    "setpoint_raw": {
        SENSOR: "setpoint_raw/target_local:PositionTarget setpoint_raw/target_global:GlobalPositionTarget "
        "setpoint_raw/target_attitude:AttitudeTarget"
    },
}
"""Publishers of each plugin's constructor; types without a package are mavros_msgs'."""

SUBSCRIBED = {
    SENSOR: "setpoint_position/local:geometry_msgs/PoseStamped setpoint_position/global:geographic_msgs/GeoPoseStamped "
    "setpoint_velocity/cmd_vel:geometry_msgs/TwistStamped setpoint_velocity/cmd_vel_unstamped:geometry_msgs/Twist "
    "setpoint_accel/accel:geometry_msgs/Vector3Stamped setpoint_raw/local:PositionTarget "
    "setpoint_raw/global:GlobalPositionTarget setpoint_raw/attitude:AttitudeTarget"
}
"""Of setpoint_position, setpoint_velocity, setpoint_accel and setpoint_raw."""


def declared(table: dict[tuple[bool, bool, int], str]) -> dict[str, tuple[str, tuple[bool, bool, int]]]:
    found = {}
    for quality, text in table.items():
        for name, _, type_ in (entry.partition(":") for entry in text.split()):
            package, _, plain = type_.rpartition("/")
            found[name] = f"{package or 'mavros_msgs'}/msg/{plain}", quality
    return found


def ours(topic: Topic) -> tuple[str, tuple[bool, bool, int]]:
    quality = topic.quality
    return topic.type, (quality != "sensor", quality in LATCHED, DEPTHS[quality])


def test_every_topic_is_as_mavros_declares_it() -> None:
    expected: dict[str, Any] = {}
    for table in PUBLISHED.values():
        expected |= declared(table)
    assert {name: ours(topic) for name, topic in TELEMETRY.items()} == expected
    assert {name: ours(topic) for name, (topic, _) in SETPOINTS.items()} == declared(SUBSCRIBED)


COPTER, PLANE, ROVER, SUB, BOAT = 2, 1, 10, 12, 11
APM, PX4 = 3, 12

MODES: dict[tuple[int, int], dict[int, str]] = {
    (APM, COPTER): {
        **{0: "STABILIZE", 1: "ACRO", 2: "ALT_HOLD", 3: "AUTO", 4: "GUIDED", 5: "LOITER", 6: "RTL", 7: "CIRCLE"},
        **{8: "POSITION", 9: "LAND", 10: "OF_LOITER", 11: "DRIFT", 13: "SPORT", 14: "FLIP", 15: "AUTOTUNE"},
        **{16: "POSHOLD", 17: "BRAKE", 18: "THROW", 19: "AVOID_ADSB", 20: "GUIDED_NOGPS"},
    },
    (APM, PLANE): {
        **{0: "MANUAL", 1: "CIRCLE", 2: "STABILIZE", 3: "TRAINING", 4: "ACRO", 5: "FBWA", 6: "FBWB", 7: "CRUISE"},
        **{8: "AUTOTUNE", 10: "AUTO", 11: "RTL", 12: "LOITER", 14: "AVOID_ADSB", 15: "GUIDED", 16: "INITIALISING"},
        **{17: "QSTABILIZE", 18: "QHOVER", 19: "QLOITER", 20: "QLAND", 21: "QRTL"},
    },
    (APM, ROVER): {0: "MANUAL", 1: "ACRO", 3: "STEERING", 4: "HOLD", 5: "LOITER", 6: "FOLLOW", 7: "SIMPLE", 10: "AUTO"}
    | {11: "RTL", 12: "SMART_RTL", 15: "GUIDED", 16: "INITIALISING"},
    (APM, SUB): {0: "STABILIZE", 1: "ACRO", 2: "ALT_HOLD", 3: "AUTO", 4: "GUIDED", 7: "CIRCLE", 9: "SURFACE"}
    | {16: "POSHOLD", 19: "MANUAL"},
    (PX4, COPTER): {
        **{1 << 16: "MANUAL", 2 << 16: "ALTCTL", 3 << 16: "POSCTL", 5 << 16: "ACRO", 6 << 16: "OFFBOARD"},
        **{7 << 16: "STABILIZED", 8 << 16: "RATTITUDE", 3 << 16 | 1 << 24: "POSCTL", 3 << 16 | 2 << 24: "POSCTL"},
        **{4 << 16 | 5 << 24: "AUTO.RTL", 4 << 16 | 6 << 24: "AUTO.LAND", 4 << 16 | 9 << 24: "AUTO.PRECLAND"},
        **{4 << 16 | 8 << 24: "AUTO.FOLLOW_TARGET", 5 << 16 | 1 << 24 | 77: "ACRO", 60 << 16: f"CMODE({60 << 16})"},
    },
    (0, COPTER): {4: "CMODE(4)"},
}
"""lib/uas_stringify.cpp; of ArduSub without the modes that it has not."""


def test_modes_have_mavros_names() -> None:
    for (autopilot, mav_type), names in MODES.items():
        for number, name in names.items():
            fields = {"autopilot": autopilot, "type": mav_type, "base_mode": 0x81, "custom_mode": number}
            assert ros_mode(fields) == name, (autopilot, mav_type, number)
    assert ros_mode({"autopilot": APM, "type": BOAT, "base_mode": 1, "custom_mode": 4}) == "HOLD"


@each("base_mode", [0x00, 0x04, 0xC0])
def test_a_mode_without_a_custom_one_is_its_base_mode(base_mode: int) -> None:
    fields = {"autopilot": PX4, "type": COPTER, "base_mode": base_mode, "custom_mode": 6 << 16}
    assert ros_mode(fields) == {0: "MODE(0x 0)", 4: "MODE(0x 4)", 0xC0: "MODE(0xC0)"}[base_mode]


def test_texts_are_logged_in_mavros_classes() -> None:
    """sys_status: process_statustext_normal."""
    error, warn, info, debug = 40, 30, 20, 10
    assert list(LOG_LEVELS.values()) == [error] * 4 + [warn] * 2 + [info, debug]
    assert log_entry("a", 200, "text", 0)["level"] == warn
