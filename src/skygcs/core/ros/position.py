"""local_position/…, global_position/…, home_position/home, altitude, and the autopilot's targets.

As MAVROS' plugins local_position, global_position, home_position, altitude and setpoint_raw. Heights of
global_position and home_position count from the ellipsoid: the message's height above mean sea level plus the geoid's,
which is the receiver's (GPS_RAW_INT.alt_ellipsoid), not that of EGM96 as MAVROS looks it up.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any

from skygcs.core.geo import EnuFrame, Origin, conjugate, quaternion_from_euler, rotated
from skygcs.core.ros.memory import (
    COVARIANCE_APPROXIMATED,
    COVARIANCE_DIAGONAL,
    COVARIANCE_UNKNOWN,
    SERVICE_GPS,
    STATUS_FIX,
    STATUS_NO_FIX,
    UNKNOWN_COVARIANCE,
    Sample,
    VehicleMemory,
)
from skygcs.core.ros.rotations import (
    enu_from_ned,
    enu_orientation,
    flu_from_frd,
    wxyz,
    xyz,
    yaw_of,
)
from skygcs.core.ros.stamps import header

U16_UNKNOWN = 0xFFFF

ROTATION_VARIANCE = 99999.0
"""MAVROS' parameter rot_covariance, as it ships."""


def local_position_ned(fields: dict[str, Any], arrival_ns: int, memory: VehicleMemory) -> Iterator[Sample]:
    """LOCAL_POSITION_NED."""
    memory.has_local = True
    odom = _local(fields, fields["time_boot_ms"] * 1000, arrival_ns, memory)
    if not memory.has_local_cov:
        yield Sample("local_position/odom", odom)
    yield Sample("local_position/pose", {"header": odom["header"], "pose": odom["pose"]["pose"]})
    body = header_like(odom, memory.frames.base_link)
    yield Sample("local_position/velocity_body", {"header": body, "twist": odom["twist"]["twist"]})
    velocity = enu_from_ned(fields["vx"], fields["vy"], fields["vz"])
    turning = rotated(memory.orientation, memory.angular_flu)
    twist = {"linear": xyz(velocity), "angular": xyz(turning)}
    yield Sample("local_position/velocity_local", {"header": body, "twist": twist})


def local_position_ned_cov(fields: dict[str, Any], arrival_ns: int, memory: VehicleMemory) -> Iterator[Sample]:
    """LOCAL_POSITION_NED_COV; its covariance is the upper right triangle of 9 by 9. Variances stay in the message's
    order (north, east, down) as in MAVROS, though the vectors beside them are turned."""
    memory.has_local_cov = True
    odom = _local(fields, fields["time_usec"], arrival_ns, memory)
    covariance = fields["covariance"]
    odom["pose"]["covariance"] = _diagonal6(covariance[0], covariance[9], covariance[17])
    odom["twist"]["covariance"] = _diagonal6(covariance[24], covariance[30], covariance[35])
    body = header_like(odom, memory.frames.base_link)
    yield Sample("local_position/odom", odom)
    yield Sample("local_position/pose_cov", {"header": odom["header"], "pose": odom["pose"]})
    yield Sample("local_position/velocity_body_cov", {"header": body, "twist": odom["twist"]})
    if not memory.has_local:
        yield Sample("local_position/pose", {"header": odom["header"], "pose": odom["pose"]["pose"]})
        yield Sample("local_position/velocity_body", {"header": body, "twist": odom["twist"]["twist"]})
    accel = {
        "accel": {"linear": xyz(enu_from_ned(fields["ax"], fields["ay"], fields["az"]))},
        "covariance": _diagonal6(covariance[39], covariance[42], covariance[44]),
    }
    yield Sample("local_position/accel", {"header": odom["header"], "accel": accel})


def _local(fields: dict[str, Any], boot_us: int, arrival_ns: int, memory: VehicleMemory) -> dict[str, Any]:
    """Odometry: the position in the local frame, the velocity in the body's."""
    velocity = enu_from_ned(fields["vx"], fields["vy"], fields["vz"])
    stamp_ns = memory.clock.stamp_ns(boot_us, arrival_ns)
    return {
        "header": header(stamp_ns, memory.frames.map),
        "child_frame_id": memory.frames.base_link,
        "pose": {
            "pose": {
                "position": xyz(enu_from_ned(fields["x"], fields["y"], fields["z"])),
                "orientation": wxyz(memory.orientation),
            }
        },
        "twist": {
            "twist": {
                "linear": xyz(rotated(conjugate(memory.orientation), velocity)),
                "angular": xyz(memory.angular_flu),
            }
        },
    }


def gps_raw_int(fields: dict[str, Any], arrival_ns: int, memory: VehicleMemory) -> Iterator[Sample]:
    """GPS_RAW_INT."""
    stamp_ns = memory.clock.stamp_ns(fields["time_usec"], arrival_ns)
    has_fix = fields["fix_type"] > 2
    ellipsoid_mm = fields.get("alt_ellipsoid") or 0
    if has_fix and ellipsoid_mm:
        memory.receiver_geoid_m = (ellipsoid_mm - fields["alt"]) / 1e3
    memory.fix_status = STATUS_FIX if has_fix else STATUS_NO_FIX
    memory.fix_service = SERVICE_GPS
    memory.fix_covariance, memory.fix_covariance_type = _fix_covariance(fields)
    yield Sample("global_position/raw/fix", _fix(fields, stamp_ns, memory))
    if fields["vel"] != U16_UNKNOWN and fields["cog"] != U16_UNKNOWN:
        speed, course = fields["vel"] / 1e2, math.radians(fields["cog"] / 1e2)
        twist = {"linear": xyz((speed * math.sin(course), speed * math.cos(course), 0.0))}
        yield Sample("global_position/raw/gps_vel", {"header": header(stamp_ns, memory.frames.map), "twist": twist})
    yield Sample("global_position/raw/satellites", {"data": fields["satellites_visible"]})


def _fix_covariance(fields: dict[str, Any]) -> tuple[tuple[float, ...], int]:
    h_acc, v_acc = fields.get("h_acc") or 0, fields.get("v_acc") or 0
    if h_acc > 0 and v_acc > 0:
        horizontal, vertical, kind = (h_acc / 1e3) ** 2, (v_acc / 1e3) ** 2, COVARIANCE_DIAGONAL
    elif fields["eph"] != U16_UNKNOWN and fields["epv"] != U16_UNKNOWN:
        horizontal, vertical, kind = (fields["eph"] / 1e2) ** 2, (fields["epv"] / 1e2) ** 2, COVARIANCE_APPROXIMATED
    else:
        return UNKNOWN_COVARIANCE, COVARIANCE_UNKNOWN
    return (horizontal, 0.0, 0.0, 0.0, horizontal, 0.0, 0.0, 0.0, vertical), kind


def _fix(fields: dict[str, Any], stamp_ns: int, memory: VehicleMemory) -> dict[str, Any]:
    return {
        "header": header(stamp_ns, memory.frames.base_link),
        "status": {"status": memory.fix_status, "service": memory.fix_service},
        "latitude": fields["lat"] / 1e7,
        "longitude": fields["lon"] / 1e7,
        "altitude": fields["alt"] / 1e3 + memory.undulation_m,
        "position_covariance": memory.fix_covariance,
        "position_covariance_type": memory.fix_covariance_type,
    }


def global_position_int(fields: dict[str, Any], arrival_ns: int, memory: VehicleMemory) -> Iterator[Sample]:
    """GLOBAL_POSITION_INT. The local position counts from home; before home is known from the first fix."""
    stamp_ns = memory.clock.stamp_ns(fields["time_boot_ms"] * 1000, arrival_ns)
    fix = _fix(fields, stamp_ns, memory)
    lat_deg, lon_deg, alt_m = fix["latitude"], fix["longitude"], fix["altitude"]
    if memory.map_frame is None and memory.fix_status >= STATUS_FIX:
        memory.map_frame = EnuFrame(Origin(lat_deg, lon_deg, alt_m))
    east, north = (
        (0.0, 0.0) if memory.map_frame is None else memory.map_frame.from_geodetic(lat_deg, lon_deg, alt_m)[:2]
    )
    rel_alt_m = fields["relative_alt"] / 1e3
    pose_covariance = [0.0] * 36
    for row in range(3):
        pose_covariance[6 * row : 6 * row + 3] = memory.fix_covariance[3 * row : 3 * row + 3]
        pose_covariance[7 * (row + 3)] = ROTATION_VARIANCE
    odom = {
        "header": header(stamp_ns, memory.frames.map),
        "child_frame_id": memory.frames.base_link,
        "pose": {
            "pose": {"position": xyz((east, north, rel_alt_m)), "orientation": wxyz(memory.orientation)},
            "covariance": pose_covariance,
        },
        "twist": {
            # down as in the message: MAVROS leaves the sign
            "twist": {"linear": xyz((fields["vy"] / 1e2, fields["vx"] / 1e2, fields["vz"] / 1e2))},
            "covariance": [-1.0, *[0.0] * 35],
        },
    }
    yield Sample("global_position/global", fix)
    yield Sample("global_position/local", odom)
    yield Sample("global_position/rel_alt", {"data": rel_alt_m})
    heading = fields["hdg"] / 1e2 if fields["hdg"] != U16_UNKNOWN else math.nan
    yield Sample("global_position/compass_hdg", {"data": heading})


def gps_global_origin(fields: dict[str, Any], arrival_ns: int, memory: VehicleMemory) -> Iterator[Sample]:
    """GPS_GLOBAL_ORIGIN."""
    stamp_ns = (
        memory.clock.stamp_ns(fields.get("time_usec") or 0, arrival_ns) if fields.get("time_usec") else arrival_ns
    )
    position = {
        "latitude": fields["latitude"] / 1e7,
        "longitude": fields["longitude"] / 1e7,
        "altitude": fields["altitude"] / 1e3 + memory.undulation_m,
    }
    yield Sample("global_position/gp_origin", {"header": header(stamp_ns, memory.frames.earth), "position": position})


def home_position(fields: dict[str, Any], arrival_ns: int, memory: VehicleMemory) -> Iterator[Sample]:
    """HOME_POSITION; the local position of global_position counts from it."""
    boot_us = fields.get("time_usec") or 0
    stamp_ns = memory.clock.stamp_ns(boot_us, arrival_ns) if boot_us else arrival_ns
    geo = {
        "latitude": fields["latitude"] / 1e7,
        "longitude": fields["longitude"] / 1e7,
        "altitude": fields["altitude"] / 1e3 + memory.undulation_m,
    }
    memory.map_frame = EnuFrame(Origin(geo["latitude"], geo["longitude"], geo["altitude"]))
    w, x, y, z = fields["q"]  # only turned about the diagonal, as MAVROS does: not the body's orientation
    turned = enu_orientation(flip_body((w, x, y, z)))
    yield Sample(
        "home_position/home",
        {
            "header": header(stamp_ns),
            "geo": geo,
            "position": xyz(enu_from_ned(fields["x"], fields["y"], fields["z"])),
            "orientation": wxyz(turned),
            "approach": xyz(enu_from_ned(fields["approach_x"], fields["approach_y"], fields["approach_z"])),
        },
    )


def flip_body(q: tuple[float, float, float, float]) -> tuple[float, float, float, float]:
    """An orientation whose body is turned half around its x axis (the inverse of what `enu_orientation` adds)."""
    w, x, y, z = q
    return x, -w, -z, y


def altitude(fields: dict[str, Any], arrival_ns: int, memory: VehicleMemory) -> Iterator[Sample]:
    """ALTITUDE."""
    stamp_ns = memory.clock.stamp_ns(fields["time_usec"], arrival_ns)
    yield Sample(
        "altitude",
        {
            "header": header(stamp_ns, memory.frames.map),
            "monotonic": fields["altitude_monotonic"],
            "amsl": fields["altitude_amsl"],
            "local": fields["altitude_local"],
            "relative": fields["altitude_relative"],
            "terrain": fields["altitude_terrain"],
            "bottom_clearance": fields["bottom_clearance"],
        },
    )


def position_target_local_ned(fields: dict[str, Any], arrival_ns: int, memory: VehicleMemory) -> Iterator[Sample]:
    """POSITION_TARGET_LOCAL_NED."""
    target = _target(fields, arrival_ns, memory)
    target["position"] = xyz(enu_from_ned(fields["x"], fields["y"], fields["z"]))
    yield Sample("setpoint_raw/target_local", target)


def position_target_global_int(fields: dict[str, Any], arrival_ns: int, memory: VehicleMemory) -> Iterator[Sample]:
    """POSITION_TARGET_GLOBAL_INT."""
    target = _target(fields, arrival_ns, memory)
    place = {"latitude": fields["lat_int"] / 1e7, "longitude": fields["lon_int"] / 1e7, "altitude": fields["alt"]}
    yield Sample("setpoint_raw/target_global", target | place)


def _target(fields: dict[str, Any], arrival_ns: int, memory: VehicleMemory) -> dict[str, Any]:
    return {
        "header": header(memory.clock.stamp_ns(fields["time_boot_ms"] * 1000, arrival_ns)),
        "coordinate_frame": fields["coordinate_frame"],
        "type_mask": fields["type_mask"],
        "velocity": xyz(enu_from_ned(fields["vx"], fields["vy"], fields["vz"])),
        "acceleration_or_force": xyz(enu_from_ned(fields["afx"], fields["afy"], fields["afz"])),
        "yaw": yaw_of(enu_orientation(quaternion_from_euler(0.0, 0.0, fields["yaw"]))),
        "yaw_rate": -fields["yaw_rate"],
    }


def attitude_target(fields: dict[str, Any], arrival_ns: int, memory: VehicleMemory) -> Iterator[Sample]:
    """ATTITUDE_TARGET."""
    rates = (fields["body_roll_rate"], fields["body_pitch_rate"], fields["body_yaw_rate"])
    yield Sample(
        "setpoint_raw/target_attitude",
        {
            "header": header(memory.clock.stamp_ns(fields["time_boot_ms"] * 1000, arrival_ns)),
            "type_mask": fields["type_mask"],
            "orientation": wxyz(enu_orientation(fields["q"])),
            "body_rate": xyz(flu_from_frd(*rates)),
            "thrust": fields["thrust"],
        },
    )


def header_like(message: dict[str, Any], frame_id: str) -> dict[str, Any]:
    """A header with the stamp of a message and another frame."""
    return {"stamp": message["header"]["stamp"], "frame_id": frame_id}


def _diagonal6(x: float, y: float, z: float) -> list[float]:
    covariance = [0.0] * 36
    covariance[0], covariance[7], covariance[14] = x, y, z
    return covariance
