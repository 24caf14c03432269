"""The topics of one vehicle below the namespace of MAVROS: interface, quality of service, sources.

sensor      best effort, the last 5          as rclcpp's SensorDataQoS
default     reliable, the last 10
latched     reliable, the last 10, and what was sent before for a reader that comes later (transient local)
newest      the same with the last one only: the states of an action's goals, and what MAVROS keeps the last one of
events      the same with the last 100
px4         best effort, the last one, which a later reader gets: what PX4's uxrce_dds_client writes by
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from typing import Any, Literal, NamedTuple

from skygcs.core.ros import condition, inertial, position
from skygcs.core.ros.memory import Sample, VehicleMemory, number

Quality = Literal["sensor", "default", "latched", "newest", "events", "px4"]

DEPTHS: dict[Quality, int] = {"sensor": 5, "default": 10, "latched": 10, "newest": 1, "events": 100, "px4": 1}
"""How many samples are kept."""

LATCHED: frozenset[Quality] = frozenset({"latched", "newest", "events"})
"""Qualities whose samples a reader gets that comes later."""


class Topic(NamedTuple):
    """A topic's interface and quality of service."""

    type: str
    quality: Quality = "sensor"


TELEMETRY: dict[str, Topic] = {
    "state": Topic("mavros_msgs/msg/State", "latched"),
    "extended_state": Topic("mavros_msgs/msg/ExtendedState", "latched"),
    "sys_status": Topic("mavros_msgs/msg/SysStatus", "latched"),
    "estimator_status": Topic("mavros_msgs/msg/EstimatorStatus", "latched"),
    "battery": Topic("sensor_msgs/msg/BatteryState"),
    "statustext/recv": Topic("mavros_msgs/msg/StatusText"),
    "status_event": Topic("mavros_msgs/msg/StatusEvent"),
    "imu/data": Topic("sensor_msgs/msg/Imu"),
    "imu/data_raw": Topic("sensor_msgs/msg/Imu"),
    "imu/mag": Topic("sensor_msgs/msg/MagneticField"),
    "imu/temperature_imu": Topic("sensor_msgs/msg/Temperature"),
    "imu/temperature_baro": Topic("sensor_msgs/msg/Temperature"),
    "imu/static_pressure": Topic("sensor_msgs/msg/FluidPressure"),
    "imu/diff_pressure": Topic("sensor_msgs/msg/FluidPressure"),
    "global_position/raw/fix": Topic("sensor_msgs/msg/NavSatFix"),
    "global_position/raw/gps_vel": Topic("geometry_msgs/msg/TwistStamped"),
    "global_position/raw/satellites": Topic("std_msgs/msg/UInt32"),
    "global_position/global": Topic("sensor_msgs/msg/NavSatFix"),
    "global_position/local": Topic("nav_msgs/msg/Odometry"),
    "global_position/rel_alt": Topic("std_msgs/msg/Float64"),
    "global_position/compass_hdg": Topic("std_msgs/msg/Float64"),
    "global_position/gp_origin": Topic("geographic_msgs/msg/GeoPointStamped", "newest"),
    "local_position/pose": Topic("geometry_msgs/msg/PoseStamped"),
    "local_position/pose_cov": Topic("geometry_msgs/msg/PoseWithCovarianceStamped"),
    "local_position/velocity_local": Topic("geometry_msgs/msg/TwistStamped"),
    "local_position/velocity_body": Topic("geometry_msgs/msg/TwistStamped"),
    "local_position/velocity_body_cov": Topic("geometry_msgs/msg/TwistWithCovarianceStamped"),
    "local_position/accel": Topic("geometry_msgs/msg/AccelWithCovarianceStamped"),
    "local_position/odom": Topic("nav_msgs/msg/Odometry"),
    "altitude": Topic("mavros_msgs/msg/Altitude"),
    "home_position/home": Topic("mavros_msgs/msg/HomePosition", "latched"),
    "rc/in": Topic("mavros_msgs/msg/RCIn", "default"),
    "rc/out": Topic("mavros_msgs/msg/RCOut", "default"),
    "radio_status": Topic("mavros_msgs/msg/RadioStatus"),
    "time_reference": Topic("sensor_msgs/msg/TimeReference"),
    "vfr_hud": Topic("mavros_msgs/msg/VfrHud", "default"),
    "mission/reached": Topic("mavros_msgs/msg/WaypointReached", "newest"),
    "setpoint_raw/target_local": Topic("mavros_msgs/msg/PositionTarget"),
    "setpoint_raw/target_global": Topic("mavros_msgs/msg/GlobalPositionTarget"),
    "setpoint_raw/target_attitude": Topic("mavros_msgs/msg/AttitudeTarget"),
}

Converter = Callable[[dict[str, Any], int, VehicleMemory], Iterator[Sample]]
"""``(fields of a MAVLink message, its arrival in nanoseconds since 1970, memory)``: what is published of it."""


class Source(NamedTuple):
    """How a MAVLink message is published: its converter, and all topics that it may return."""

    convert: Converter
    topics: tuple[str, ...]


_PRESSURES = ("imu/static_pressure", "imu/diff_pressure")
_LOCAL = tuple(f"local_position/{name}" for name in ("odom", "pose", "velocity_body"))

SOURCES: Mapping[str, Source] = {
    "HEARTBEAT": Source(condition.heartbeat, ("state",)),
    "EXTENDED_SYS_STATE": Source(condition.extended_sys_state, ("extended_state",)),
    "SYS_STATUS": Source(condition.sys_status, ("sys_status", "battery")),
    "BATTERY_STATUS": Source(condition.battery_status, ("battery",)),
    "ESTIMATOR_STATUS": Source(condition.estimator_status, ("estimator_status",)),
    "STATUSTEXT": Source(condition.statustext, ("statustext/recv",)),
    "EVENT": Source(condition.event, ("status_event",)),
    "RC_CHANNELS": Source(condition.rc_channels, ("rc/in",)),
    "RC_CHANNELS_RAW": Source(condition.rc_channels_raw, ("rc/in",)),
    "SERVO_OUTPUT_RAW": Source(condition.servo_output_raw, ("rc/out",)),
    "RADIO_STATUS": Source(condition.radio_status, ("radio_status",)),
    "SYSTEM_TIME": Source(condition.system_time, ("time_reference",)),
    "MISSION_ITEM_REACHED": Source(condition.mission_item_reached, ("mission/reached",)),
    "VFR_HUD": Source(condition.vfr_hud, ("vfr_hud",)),
    "ATTITUDE": Source(inertial.attitude, ("imu/data",)),
    "ATTITUDE_QUATERNION": Source(inertial.attitude_quaternion, ("imu/data",)),
    "HIGHRES_IMU": Source(inertial.highres_imu, ("imu/data_raw", "imu/mag", *_PRESSURES, "imu/temperature_imu")),
    "RAW_IMU": Source(inertial.raw_imu, ("imu/data_raw", "imu/mag")),
    "SCALED_IMU": Source(inertial.scaled_imu, ("imu/data_raw", "imu/mag")),
    "SCALED_PRESSURE": Source(inertial.scaled_pressure, ("imu/temperature_baro", *_PRESSURES)),
    "LOCAL_POSITION_NED": Source(position.local_position_ned, (*_LOCAL, "local_position/velocity_local")),
    "LOCAL_POSITION_NED_COV": Source(
        position.local_position_ned_cov,
        (*_LOCAL, "local_position/pose_cov", "local_position/velocity_body_cov", "local_position/accel"),
    ),
    "GPS_RAW_INT": Source(
        position.gps_raw_int, tuple(f"global_position/raw/{name}" for name in ("fix", "gps_vel", "satellites"))
    ),
    "GLOBAL_POSITION_INT": Source(
        position.global_position_int,
        tuple(f"global_position/{name}" for name in ("global", "local", "rel_alt", "compass_hdg")),
    ),
    "GPS_GLOBAL_ORIGIN": Source(position.gps_global_origin, ("global_position/gp_origin",)),
    "HOME_POSITION": Source(position.home_position, ("home_position/home",)),
    "ALTITUDE": Source(position.altitude, ("altitude",)),
    "POSITION_TARGET_LOCAL_NED": Source(position.position_target_local_ned, ("setpoint_raw/target_local",)),
    "POSITION_TARGET_GLOBAL_INT": Source(position.position_target_global_int, ("setpoint_raw/target_global",)),
    "ATTITUDE_TARGET": Source(position.attitude_target, ("setpoint_raw/target_attitude",)),
}
"""By the name of the MAVLink message."""


def samples(name: str, fields: Mapping[str, Any], arrival_ns: int, memory: VehicleMemory) -> list[Sample]:
    """Return what is published of one MAVLink message of an autopilot, or of a radio; nothing of most messages.

    ``fields``: as the dialect decodes them; None, which is NaN in JSON, is taken as NaN."""
    source = SOURCES.get(name)
    if source is None:
        return []
    return list(source.convert({k: number(v) for k, v in fields.items()}, arrival_ns, memory))
