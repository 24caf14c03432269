"""Telemetry of a simulated vehicle, message by message: state in, wire fields out.

A builder returns None while there is nothing to report (no home yet, no position estimate yet). The fields of
`BOOT_CLOCKS` are added where the message is sent.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from math import atan2, cos, degrees, nan, sin
from typing import Any

from skygcs.core.geo import quaternion_from_euler
from skygcs.sim import protocol as m
from skygcs.sim.body import GRAVITY_MPS2, Body, Vector
from skygcs.sim.quad import Quad
from skygcs.sim.vehicle_state import VehicleState

Fields = dict[str, Any]
Builder = Callable[[VehicleState, float], Fields | None]

BOOT_CLOCKS: Mapping[str, int] = {"time_boot_ms": 1, "time_usec": 1000}
"""Fields with the time since boot, and their units in a millisecond."""

UNKNOWN_U16 = 65535
UNKNOWN_TEMPERATURE = 32767
HOVER_THROTTLE_PERCENT = 42
"""Throttle of a flying vehicle that has no model of thrust (kinematic)."""

MAV_FRAME_LOCAL_NED, MAV_FRAME_BODY_FRD = 1, 12
MAV_ESTIMATOR_TYPE_AUTOPILOT = 8
ONLY_THE_PLACE = 0xFFF8
"""send_position_target_global_int: all of the type mask, also its unused bits, but for the place."""

_HEALTHY_SENSORS = (
    m.MAV_SYS_STATUS_SENSOR_3D_GYRO
    | m.MAV_SYS_STATUS_SENSOR_3D_ACCEL
    | m.MAV_SYS_STATUS_SENSOR_3D_MAG
    | m.MAV_SYS_STATUS_SENSOR_ABSOLUTE_PRESSURE
    | m.MAV_SYS_STATUS_SENSOR_MOTOR_OUTPUTS
    | m.MAV_SYS_STATUS_LOGGING
    | m.MAV_SYS_STATUS_SENSOR_BATTERY
)
_ALL_SENSORS = _HEALTHY_SENSORS | m.MAV_SYS_STATUS_SENSOR_GPS | m.MAV_SYS_STATUS_AHRS | m.MAV_SYS_STATUS_PREARM_CHECK
_ESTIMATOR_GOOD = (
    m.ESTIMATOR_ATTITUDE
    | m.ESTIMATOR_VELOCITY_HORIZ
    | m.ESTIMATOR_VELOCITY_VERT
    | m.ESTIMATOR_POS_HORIZ_REL
    | m.ESTIMATOR_POS_HORIZ_ABS
    | m.ESTIMATOR_POS_VERT_ABS
    | m.ESTIMATOR_PRED_POS_HORIZ_REL
    | m.ESTIMATOR_PRED_POS_HORIZ_ABS
)
_ESTIMATOR_WITHOUT_POSITION = (
    m.ESTIMATOR_ATTITUDE | m.ESTIMATOR_VELOCITY_VERT | m.ESTIMATOR_POS_VERT_ABS | m.ESTIMATOR_CONST_POS_MODE
)


def heartbeat(v: VehicleState, now: float) -> Fields:
    return {
        "type": v.mav_type,
        "autopilot": v.autopilot,
        "base_mode": v.base_mode,
        "custom_mode": v.mode,
        "system_status": v.system_status,
        "mavlink_version": 3,
    }


def sys_status(v: VehicleState, now: float) -> Fields:
    health = _HEALTHY_SENSORS
    if v.gps_ok:
        health |= m.MAV_SYS_STATUS_SENSOR_GPS
    if v.position_ok:
        health |= m.MAV_SYS_STATUS_AHRS
    if v.arming_refusal() is None:
        health |= m.MAV_SYS_STATUS_PREARM_CHECK
    present, enabled, healthy = (m.MAV_SYS_STATUS_GEOFENCE if flag else 0 for flag in v.fence_flags)
    health |= healthy
    sensors = _ALL_SENSORS & ~m.MAV_SYS_STATUS_SENSOR_GPS if v.by_vision else _ALL_SENSORS
    if v.faults.throttle_down:
        sensors |= m.MAV_SYS_STATUS_SENSOR_RC_RECEIVER
        health |= m.MAV_SYS_STATUS_SENSOR_RC_RECEIVER
    return {
        "onboard_control_sensors_present": sensors | present,
        "onboard_control_sensors_enabled": sensors | enabled,
        "onboard_control_sensors_health": health & ~v.faults.unhealthy_sensors,
        "load": 350 if v.armed else 280,
        "voltage_battery": round(v.battery.volts * 1000),
        "current_battery": round(v.battery.amps * 100),
        "battery_remaining": v.battery.percent,
    }


def system_time(v: VehicleState, now: float) -> Fields:
    # an autopilot knows the date from GPS only
    unix_us = max(0, v.unix_us + round(v.faults.clock_error_s * 1e6)) if v.gps_ok else 0
    return {"time_unix_usec": unix_us}


def gps_raw_int(v: VehicleState, now: float) -> Fields:
    if not v.gps_ok:
        unknown = {"eph": UNKNOWN_U16, "epv": UNKNOWN_U16, "vel": UNKNOWN_U16, "cog": UNKNOWN_U16}
        return {"fix_type": m.GPS_FIX_TYPE_NO_FIX, **unknown}
    motion = v.reported
    fix_type = v.rtk.fix_type(now)
    fixed = fix_type == m.GPS_FIX_TYPE_RTK_FIXED
    error_m = 0.02 if fixed else 0.4
    lat, lon = v.where.to_geodetic(motion.east_m + v.rng.spread(error_m), motion.north_m + v.rng.spread(error_m))
    alt_mm = round((v.where.alt_amsl_m + motion.up_m + v.rng.spread(1.25 * error_m)) * 1000)
    return {
        "fix_type": fix_type,
        "lat": round(lat * 1e7),
        "lon": round(lon * 1e7),
        "alt": alt_mm,
        "alt_ellipsoid": alt_mm,
        "eph": round(v.faults.hdop * 100),
        "epv": 120,
        "vel": round(motion.groundspeed_mps * 100),
        "cog": round(degrees(atan2(motion.vel_e_mps, motion.vel_n_mps)) % 360 * 100) % 36000,
        "satellites_visible": v.faults.satellites,
        "h_acc": 14 if fixed else 800,
        "v_acc": 20 if fixed else 1300,
        "vel_acc": 200,
    }


def global_position_int(v: VehicleState, now: float) -> Fields | None:
    motion = v.reported
    if v.home is None:  # never had a position: PX4 sends nothing, ArduPilot zeros
        if v.autopilot == m.MAV_AUTOPILOT_PX4:
            return None
        return {"hdg": round(motion.heading_deg * 100) % 36000}
    lat, lon = v.where.to_geodetic(motion.east_m, motion.north_m)
    return {
        "lat": round(lat * 1e7),
        "lon": round(lon * 1e7),
        "alt": round((v.where.alt_amsl_m + motion.up_m) * 1000),
        "relative_alt": round(v.height_m() * 1000),
        "vx": round(motion.vel_n_mps * 100),
        "vy": round(motion.vel_e_mps * 100),
        "vz": round(-motion.vel_u_mps * 100),  # positive down
        "hdg": round(motion.heading_deg * 100) % 36000,
    }


def local_position_ned(v: VehicleState, now: float) -> Fields | None:
    if v.home is None:
        return None
    motion, zero = v.reported, v.local_origin
    return {
        "x": motion.north_m - zero.north_m,
        "y": motion.east_m - zero.east_m,
        "z": zero.up_m - motion.up_m,
        "vx": motion.vel_n_mps,
        "vy": motion.vel_e_mps,
        "vz": -motion.vel_u_mps,
    }


def attitude(v: VehicleState, now: float) -> Fields:
    motion = v.reported
    if v.faults.nan_attitude:
        return {"roll": nan, "pitch": nan, "yaw": nan}
    return {
        "roll": motion.roll_rad,
        "pitch": motion.pitch_rad,
        "yaw": motion.yaw_rad,
        **_rates(motion),
    }


def _rates(motion: Body) -> Fields:
    return {
        "rollspeed": motion.roll_rate_radps,
        "pitchspeed": motion.pitch_rate_radps,
        "yawspeed": motion.yaw_rate_radps,
    }


def attitude_quaternion(v: VehicleState, now: float) -> Fields:
    motion = v.reported
    if v.faults.nan_attitude:
        return {"q1": nan, "q2": nan, "q3": nan, "q4": nan}
    w, x, y, z = quaternion_from_euler(motion.roll_rad, motion.pitch_rad, motion.yaw_rad)
    return {"q1": w, "q2": x, "q3": y, "q4": z, **_rates(motion)}


def _throttle_percent(v: VehicleState) -> int:
    if isinstance(v.motion, Quad):
        return round(100 * v.motion.thrust) if v.armed else 0
    return 0 if v.landed else HOVER_THROTTLE_PERCENT


def vfr_hud(v: VehicleState, now: float) -> Fields:
    motion = v.reported
    return {
        "airspeed": motion.groundspeed_mps,
        "groundspeed": motion.groundspeed_mps,
        "heading": int(motion.heading_deg),
        "throttle": _throttle_percent(v),
        "alt": v.where.alt_amsl_m + motion.up_m,
        "climb": motion.vel_u_mps,
    }


def battery_status(v: VehicleState, now: float) -> Fields:
    battery = v.battery
    low = battery.percent <= v.low_battery_percent
    return {
        "battery_function": m.MAV_BATTERY_FUNCTION_ALL,
        "type": m.MAV_BATTERY_TYPE_LIPO,
        "temperature": UNKNOWN_TEMPERATURE,
        "voltages": [round(battery.volts * 1000)] + [UNKNOWN_U16] * 9,
        "current_battery": round(battery.amps * 100),
        "current_consumed": round(battery.used_mah),
        "energy_consumed": -1,
        "battery_remaining": battery.percent,
        "charge_state": m.MAV_BATTERY_CHARGE_STATE_LOW if low else m.MAV_BATTERY_CHARGE_STATE_OK,
    }


def home_position(v: VehicleState, now: float) -> Fields | None:
    home = v.home
    if home is None:
        return None
    lat, lon = v.where.to_geodetic(home.east_m, home.north_m)
    return {
        "latitude": round(lat * 1e7),
        "longitude": round(lon * 1e7),
        "altitude": round((v.where.alt_amsl_m + home.up_m) * 1000),
        "x": home.north_m,
        "y": home.east_m,
        "z": -home.up_m,
        "q": [1.0, 0.0, 0.0, 0.0] if v.autopilot == m.MAV_AUTOPILOT_PX4 else [nan] * 4,
    }


def position_target_global_int(v: VehicleState, now: float) -> Fields | None:
    target = v.reported_target_enu_m()
    if target is None:
        return None
    east_m, north_m, up_m = target
    lat, lon = v.where.to_geodetic(east_m, north_m)
    return {
        "coordinate_frame": m.MAV_FRAME_GLOBAL,
        "type_mask": ONLY_THE_PLACE,
        "lat_int": round(lat * 1e7),
        "lon_int": round(lon * 1e7),
        "alt": v.where.alt_amsl_m + up_m,
    }


def gps_global_origin(v: VehicleState, now: float) -> Fields | None:
    if v.home is None and v.local_zero is None:
        return None
    zero = v.local_origin
    lat, lon = v.where.to_geodetic(zero.east_m, zero.north_m)
    return {
        "latitude": round(lat * 1e7),
        "longitude": round(lon * 1e7),
        "altitude": round((v.where.alt_amsl_m + zero.up_m) * 1000),
    }


def extended_sys_state(v: VehicleState, now: float) -> Fields:
    return {"vtol_state": v.vtol_state, "landed_state": v.landed_state}


def mission_current(v: VehicleState, now: float) -> Fields:
    return v.run.facts(v)


def fence_status(v: VehicleState, now: float) -> Fields:
    alarm = v.failsafes.fence
    return {
        "breach_status": int(v.fence_breach != m.FENCE_BREACH_NONE),
        "breach_count": v.fence_breaches,
        "breach_type": v.fence_breach,
        "breach_time": 0 if alarm.raised_at is None else max(0, round((alarm.raised_at - v.boot_at) * 1000)),
    }


def rc_channels(v: VehicleState, now: float) -> Fields:
    return {"chancount": 0, "rssi": 255}  # no receiver: 255 = unknown


def _body_accel(v: VehicleState) -> Vector:
    """Return what the accelerometer feels (FRD, m/s²): everything but gravity, turned into the body."""
    motion = v.reported
    east, north, up = motion.accel_enu_mps2
    forward = north * cos(motion.yaw_rad) + east * sin(motion.yaw_rad)
    right = -north * sin(motion.yaw_rad) + east * cos(motion.yaw_rad)
    down = -(up + GRAVITY_MPS2)
    sin_p, cos_p = sin(motion.pitch_rad), cos(motion.pitch_rad)
    sin_r, cos_r = sin(motion.roll_rad), cos(motion.roll_rad)
    forward, down = forward * cos_p - down * sin_p, forward * sin_p + down * cos_p
    return forward, right * cos_r + down * sin_r, down * cos_r - right * sin_r


def raw_imu(v: VehicleState, now: float) -> Fields:
    accel = _body_accel(v)
    milli_g = [round(a / GRAVITY_MPS2 * 1000) for a in accel]
    return {
        **dict(zip(("xacc", "yacc", "zacc"), milli_g, strict=True)),
        "zgyro": round(v.reported.yaw_rate_radps * 1000),
        "xmag": round(200 * cos(v.reported.yaw_rad)),
        "ymag": round(-200 * sin(v.reported.yaw_rad)),
        "zmag": 450,
        "temperature": 4000,
    }


def highres_imu(v: VehicleState, now: float) -> Fields:
    accel = _body_accel(v)
    pressure = (
        1013.25 * (1 - 2.25577e-5 * (v.where.alt_amsl_m + v.reported.up_m)) ** 5.25588
    )  # ICAO standard atmosphere
    return {
        **dict(zip(("xacc", "yacc", "zacc"), accel, strict=True)),
        "zgyro": v.reported.yaw_rate_radps,
        "xmag": 0.2 * cos(v.reported.yaw_rad),
        "ymag": -0.2 * sin(v.reported.yaw_rad),
        "zmag": 0.45,
        "abs_pressure": pressure,
        "pressure_alt": v.where.alt_amsl_m + v.reported.up_m,
        "temperature": 40.0,
        "fields_updated": 0x1FFF,
    }


def odometry(v: VehicleState, now: float) -> Fields | None:
    """Fields as in PX4's streams/ODOMETRY.hpp: position in the local NED frame, velocity along the body's axes
    (FRD)."""
    local = local_position_ned(v, now)
    if local is None:
        return None
    motion = v.reported
    q = quaternion_from_euler(motion.roll_rad, motion.pitch_rad, motion.yaw_rad)
    vx, vy, vz = _to_body(q, (local["vx"], local["vy"], local["vz"]))
    unknown = [nan] + [0.0] * 20
    return {
        "frame_id": MAV_FRAME_LOCAL_NED,
        "child_frame_id": MAV_FRAME_BODY_FRD,
        **{axis: local[axis] for axis in "xyz"},
        "q": list(q),
        "vx": vx,
        "vy": vy,
        "vz": vz,
        **_rates(motion),
        "pose_covariance": unknown,
        "velocity_covariance": unknown,
        "estimator_type": MAV_ESTIMATOR_TYPE_AUTOPILOT,
    }


def _to_body(q: tuple[float, float, float, float], vector: Vector) -> Vector:
    """A NED vector along the axes of a body whose attitude (body to NED) is ``q`` = (w, x, y, z)."""
    w, x, y, z = q
    n, e, d = vector
    return (
        (1 - 2 * (y * y + z * z)) * n + 2 * (x * y + w * z) * e + 2 * (x * z - w * y) * d,
        2 * (x * y - w * z) * n + (1 - 2 * (x * x + z * z)) * e + 2 * (y * z + w * x) * d,
        2 * (x * z + w * y) * n + 2 * (y * z - w * x) * e + (1 - 2 * (x * x + y * y)) * d,
    )


def altitude(v: VehicleState, now: float) -> Fields:
    up = v.reported.up_m
    amsl = v.where.alt_amsl_m + up
    return {
        "altitude_monotonic": amsl,
        "altitude_amsl": amsl,
        "altitude_local": up,
        "altitude_relative": v.height_m(),
        "altitude_terrain": nan,
        "bottom_clearance": nan,
    }


def ekf_status_report(v: VehicleState, now: float) -> Fields:
    flags = _ESTIMATOR_GOOD if v.position_ok else _ESTIMATOR_WITHOUT_POSITION
    ok = v.position_ok
    variances = {"velocity_variance": 0.02, "pos_horiz_variance": 0.03 if ok else 1.0, "pos_vert_variance": 0.01}
    return {"flags": flags, **variances, "compass_variance": 0.01}


def estimator_status(v: VehicleState, now: float) -> Fields:
    ok = v.position_ok
    return {
        "flags": _ESTIMATOR_GOOD if ok else _ESTIMATOR_WITHOUT_POSITION,
        "vel_ratio": 0.03,
        "pos_horiz_ratio": 0.02 if ok else 1.5,
        "pos_vert_ratio": 0.02,
        "mag_ratio": 0.02,
        "pos_horiz_accuracy": 0.4 if ok else 50.0,
        "pos_vert_accuracy": 0.5,
    }


def autopilot_version(v: VehicleState, now: float) -> Fields:
    return v.version


def protocol_version(v: VehicleState, now: float) -> Fields:
    return {"version": 200, "min_version": 100, "max_version": 200}


COMMON: Mapping[str, Builder] = {
    "HEARTBEAT": heartbeat,
    "SYS_STATUS": sys_status,
    "SYSTEM_TIME": system_time,
    "GPS_RAW_INT": gps_raw_int,
    "GLOBAL_POSITION_INT": global_position_int,
    "LOCAL_POSITION_NED": local_position_ned,
    "ATTITUDE": attitude,
    "ATTITUDE_QUATERNION": attitude_quaternion,
    "VFR_HUD": vfr_hud,
    "BATTERY_STATUS": battery_status,
    "HOME_POSITION": home_position,
    "GPS_GLOBAL_ORIGIN": gps_global_origin,
    "EXTENDED_SYS_STATE": extended_sys_state,
    "MISSION_CURRENT": mission_current,
    "RC_CHANNELS": rc_channels,
    "AUTOPILOT_VERSION": autopilot_version,
    "PROTOCOL_VERSION": protocol_version,
}


_PX4: Mapping[str, Builder] = {
    **COMMON,
    "HIGHRES_IMU": highres_imu,
    "ALTITUDE": altitude,
    "ODOMETRY": odometry,
    "ESTIMATOR_STATUS": estimator_status,
}
_COPTER: Mapping[str, Builder] = {
    **COMMON,
    "RAW_IMU": raw_imu,
    "EKF_STATUS_REPORT": ekf_status_report,
    "FENCE_STATUS": fence_status,
    "POSITION_TARGET_GLOBAL_INT": position_target_global_int,
}


def builders_of(autopilot: int) -> Mapping[str, Builder]:
    """The messages this firmware has, by name."""
    return _PX4 if autopilot == m.MAV_AUTOPILOT_PX4 else _COPTER
