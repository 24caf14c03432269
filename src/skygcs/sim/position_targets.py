"""SET_POSITION_TARGET_* messages as setpoints, and altitudes of the frames they come in.

Masks that ignore force bits are taken as the firmwares take them; accelerations are not followed.
"""

from __future__ import annotations

from math import cos, isfinite, sin
from typing import TYPE_CHECKING, Any

from skygcs.sim import protocol as m
from skygcs.sim.kinematics import Setpoint

if TYPE_CHECKING:
    from skygcs.sim.vehicle import SimVehicle

POSITION_IGNORE = (
    m.POSITION_TARGET_TYPEMASK_X_IGNORE | m.POSITION_TARGET_TYPEMASK_Y_IGNORE | m.POSITION_TARGET_TYPEMASK_Z_IGNORE
)
VELOCITY_IGNORE = (
    m.POSITION_TARGET_TYPEMASK_VX_IGNORE | m.POSITION_TARGET_TYPEMASK_VY_IGNORE | m.POSITION_TARGET_TYPEMASK_VZ_IGNORE
)
AMSL_FRAMES = frozenset({m.MAV_FRAME_GLOBAL, m.MAV_FRAME_GLOBAL_INT})
HOME_FRAMES = frozenset({m.MAV_FRAME_GLOBAL_RELATIVE_ALT, m.MAV_FRAME_GLOBAL_RELATIVE_ALT_INT})
TERRAIN_FRAMES = frozenset({m.MAV_FRAME_GLOBAL_TERRAIN_ALT, m.MAV_FRAME_GLOBAL_TERRAIN_ALT_INT})
HIGHEST_M = 20_000.0
"""Altitudes beyond are taken for mistakes, as the firmwares do at their own limits."""

BODY_FRAMES = frozenset({m.MAV_FRAME_BODY_NED, m.MAV_FRAME_BODY_OFFSET_NED})


def is_altitude(alt_m: float) -> bool:
    return isfinite(alt_m) and abs(alt_m) <= HIGHEST_M


def up_of(v: SimVehicle, frame: int, alt_m: float) -> float | None:
    """An altitude of a global frame as metres above the local origin; None for a frame that is not global."""
    if not is_altitude(alt_m):
        return None
    if frame in AMSL_FRAMES:
        return alt_m - v.where.alt_amsl_m
    if frame in HOME_FRAMES:
        return alt_m + (v.home.up_m if v.home else 0.0)
    return alt_m if frame in TERRAIN_FRAMES else None


def is_position(lat_deg: float, lon_deg: float) -> bool:
    """Within WGS84's range; 0/0 is, and both firmwares would fly there."""
    return isfinite(lat_deg) and isfinite(lon_deg) and abs(lat_deg) <= 90 and abs(lon_deg) <= 180


def setpoint_of(v: SimVehicle, name: str, fields: dict[str, Any], *, any_bit: bool) -> Setpoint | None:
    """The setpoint of a SET_POSITION_TARGET_GLOBAL_INT or _LOCAL_NED; None if it holds nothing to follow.

    ``any_bit``: one ignore bit of a group drops the whole group (ArduPilot); otherwise each axis for itself (PX4).
    """
    mask, frame = int(fields["type_mask"]), int(fields["coordinate_frame"])
    global_frame = name.endswith("GLOBAL_INT")
    position = _global_position(v, fields, frame) if global_frame else _local_position(v, fields, frame)
    if position is None:
        return None
    ignored_xy = mask & (m.POSITION_TARGET_TYPEMASK_X_IGNORE | m.POSITION_TARGET_TYPEMASK_Y_IGNORE)
    ignored_z = mask & m.POSITION_TARGET_TYPEMASK_Z_IGNORE
    if any_bit:
        ignored_xy = ignored_z = mask & POSITION_IGNORE
    east, north, up = position
    velocity = _velocity(v, fields, -1 if global_frame else frame, mask, any_bit)
    if ignored_xy and ignored_z and velocity == (None, None, None):
        return None
    yaw = None if mask & m.POSITION_TARGET_TYPEMASK_YAW_IGNORE else float(fields["yaw"])
    if yaw is not None and frame in BODY_FRAMES:
        yaw += v.estimated.yaw_rad
    turn = 0.0 if mask & m.POSITION_TARGET_TYPEMASK_YAW_RATE_IGNORE else float(fields["yaw_rate"])
    return Setpoint(
        (None if ignored_xy else east, None if ignored_xy else north, None if ignored_z else up),
        velocity,
        yaw_rad=yaw if yaw is not None and isfinite(yaw) else None,
        yaw_rate_radps=turn if isfinite(turn) else 0.0,
    )


def _global_position(v: SimVehicle, fields: dict[str, Any], frame: int) -> tuple[float, float, float] | None:
    up = up_of(v, frame, fields["alt"])
    lat, lon = fields["lat_int"] / 1e7, fields["lon_int"] / 1e7
    if up is None or not is_position(lat, lon):
        return None
    east, north = v.where.to_local(lat, lon)
    return east, north, up


def _local_position(v: SimVehicle, fields: dict[str, Any], frame: int) -> tuple[float, float, float] | None:
    x, y, z = fields["x"], fields["y"], fields["z"]
    if not (isfinite(x) and isfinite(y) and isfinite(z)):
        x = y = z = 0.0
    if frame == m.MAV_FRAME_LOCAL_NED:
        zero = v.local_origin
        return zero.east_m + y, zero.north_m + x, zero.up_m - z
    motion = v.estimated
    if frame in BODY_FRAMES:
        x, y = _to_north_east(v, x, y)
    elif frame != m.MAV_FRAME_LOCAL_OFFSET_NED:
        return None
    return motion.east_m + y, motion.north_m + x, motion.up_m - z


def _velocity(
    v: SimVehicle, fields: dict[str, Any], frame: int, mask: int, any_bit: bool
) -> tuple[float | None, float | None, float | None]:
    vx, vy, vz = fields["vx"], fields["vy"], fields["vz"]
    if mask & VELOCITY_IGNORE == VELOCITY_IGNORE or (any_bit and mask & VELOCITY_IGNORE):
        return None, None, None
    if not (isfinite(vx) and isfinite(vy) and isfinite(vz)):
        return None, None, None
    if frame in BODY_FRAMES:
        vx, vy = _to_north_east(v, vx, vy)
    north = None if mask & m.POSITION_TARGET_TYPEMASK_VX_IGNORE else vx
    east = None if mask & m.POSITION_TARGET_TYPEMASK_VY_IGNORE else vy
    up = None if mask & m.POSITION_TARGET_TYPEMASK_VZ_IGNORE else -vz
    return east, north, up


def _to_north_east(v: SimVehicle, forward: float, right: float) -> tuple[float, float]:
    yaw = v.estimated.yaw_rad
    return forward * cos(yaw) - right * sin(yaw), forward * sin(yaw) + right * cos(yaw)
