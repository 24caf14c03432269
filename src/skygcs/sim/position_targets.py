"""SET_POSITION_TARGET_* as each firmware takes it, and altitudes of the frames it comes in.

PX4: mavlink/mavlink_receiver.cpp, handle_message_set_position_target_local_ned and _global_int; each axis for itself.
ArduCopter: ArduCopter/GCS_Mavlink.cpp, the functions of the same names; one ignore bit drops its whole group.
"""

from __future__ import annotations

from math import cos, isfinite, sin
from typing import Any, Protocol

from skygcs.sim import protocol as m
from skygcs.sim.attitude_targets import Refusal
from skygcs.sim.body import Body, Vector, wrap_pi
from skygcs.sim.kinematics import Home, LocalFrame
from skygcs.sim.position_control import NO_AXES, Axes, PositionTarget

POSITION_IGNORE = (
    m.POSITION_TARGET_TYPEMASK_X_IGNORE | m.POSITION_TARGET_TYPEMASK_Y_IGNORE | m.POSITION_TARGET_TYPEMASK_Z_IGNORE
)
VELOCITY_IGNORE = (
    m.POSITION_TARGET_TYPEMASK_VX_IGNORE | m.POSITION_TARGET_TYPEMASK_VY_IGNORE | m.POSITION_TARGET_TYPEMASK_VZ_IGNORE
)
ACCELERATION_IGNORE = (
    m.POSITION_TARGET_TYPEMASK_AX_IGNORE | m.POSITION_TARGET_TYPEMASK_AY_IGNORE | m.POSITION_TARGET_TYPEMASK_AZ_IGNORE
)
AMSL_FRAMES = frozenset({m.MAV_FRAME_GLOBAL, m.MAV_FRAME_GLOBAL_INT})
HOME_FRAMES = frozenset({m.MAV_FRAME_GLOBAL_RELATIVE_ALT, m.MAV_FRAME_GLOBAL_RELATIVE_ALT_INT})
TERRAIN_FRAMES = frozenset({m.MAV_FRAME_GLOBAL_TERRAIN_ALT, m.MAV_FRAME_GLOBAL_TERRAIN_ALT_INT})
HIGHEST_M = 20_000.0
"""Altitudes beyond are taken for mistakes, as the firmwares do at their own limits."""

MAX_COPTER_VELOCITY = 1000.0
"""GCS_MAVLINK_Copter::sane_vel_or_acc_vector: m/s; beyond, the vehicle stops."""

BODY_FRAMES = frozenset({m.MAV_FRAME_BODY_NED, m.MAV_FRAME_BODY_OFFSET_NED})
LOCAL_FRAMES = BODY_FRAMES | {m.MAV_FRAME_LOCAL_NED, m.MAV_FRAME_LOCAL_OFFSET_NED}


class Located(Protocol):
    """Parts of a vehicle that say where a position of a message is."""

    where: LocalFrame
    home: Home | None

    @property
    def estimated(self) -> Body: ...

    @property
    def local_origin(self) -> Home: ...

    @property
    def position_ok(self) -> bool: ...


def is_altitude(alt_m: float) -> bool:
    return isfinite(alt_m) and abs(alt_m) <= HIGHEST_M


def up_of(v: Located, frame: int, alt_m: float) -> float | None:
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


def px4_target(v: Located, name: str, fields: dict[str, Any]) -> PositionTarget | Refusal | str:
    """Return what PX4 makes of it; a text: it refuses the message with it, and it counts as none."""
    mask, frame = int(fields["type_mask"]), int(fields["coordinate_frame"])
    position = NO_AXES
    velocity = _axes(_ned_to_enu(fields["vx"], fields["vy"], fields["vz"]), mask, VELOCITY_IGNORE)
    acceleration = _axes(_ned_to_enu(fields["afx"], fields["afy"], fields["afz"]), mask, ACCELERATION_IGNORE)
    if name.endswith("GLOBAL_INT"):
        if not mask & POSITION_IGNORE:
            place = _px4_place(v, fields, frame)
            if isinstance(place, Refusal | str):
                return place
            position = place
    elif frame == m.MAV_FRAME_LOCAL_NED:
        position = _axes(_local_place(v, fields), mask, POSITION_IGNORE)
    elif frame == m.MAV_FRAME_BODY_NED:
        # the firmware turns an acceleration with the whole attitude, here it turns with the yaw as the velocity does
        velocity = NO_AXES if mask & VELOCITY_IGNORE else _turned(v, velocity)
        acceleration = NO_AXES if mask & ACCELERATION_IGNORE else _turned(v, acceleration)
    else:
        return f"{name} coordinate frame {frame} unsupported"
    if acceleration != NO_AXES and mask & m.POSITION_TARGET_TYPEMASK_FORCE_SET:
        return f"{name} force not supported"
    if position == velocity == acceleration == NO_AXES:
        return Refusal.NOTHING if name.endswith("GLOBAL_INT") else f"{name} invalid"
    return PositionTarget(position, velocity, acceleration, *_yaw(fields, mask))


def copter_target(v: Located, name: str, fields: dict[str, Any]) -> PositionTarget | Refusal | None:
    """Return what ArduCopter makes of it in GUIDED; None: it takes no notice."""
    mask, frame = int(fields["type_mask"]), int(fields["coordinate_frame"])
    global_frame = name.endswith("GLOBAL_INT")
    if not global_frame and frame not in LOCAL_FRAMES:
        return Refusal.STOP
    if mask & m.POSITION_TARGET_TYPEMASK_FORCE_SET and not mask & ACCELERATION_IGNORE:
        return None
    position, velocity, acceleration = NO_AXES, NO_AXES, NO_AXES
    if not mask & POSITION_IGNORE:
        place = _copter_global(v, fields, frame) if global_frame else _copter_local(v, fields, frame)
        if place is None:
            return Refusal.STOP
        position = place
    turned = not global_frame and frame in BODY_FRAMES
    if not mask & VELOCITY_IGNORE:
        speeds = fields["vx"], fields["vy"], fields["vz"]
        if any(speed != speed or abs(speed) > MAX_COPTER_VELOCITY for speed in speeds):
            return Refusal.STOP
        velocity = _turned(v, _ned_to_enu(*speeds)) if turned else _ned_to_enu(*speeds)
    if not mask & ACCELERATION_IGNORE:
        pushes = fields["afx"], fields["afy"], fields["afz"]
        if not all(map(isfinite, pushes)):
            return None  # the firmware does not look, and would fly with NaN
        acceleration = _turned(v, _ned_to_enu(*pushes)) if turned else _ned_to_enu(*pushes)
    yaw, rate = _yaw(fields, mask)
    if yaw is not None and turned:
        yaw = wrap_pi(yaw + v.estimated.yaw_rad)
    if position != NO_AXES:
        if velocity == NO_AXES:
            return (
                PositionTarget(position, yaw_rad=yaw, yaw_rate_radps=rate) if acceleration == NO_AXES else Refusal.STOP
            )
        if global_frame and frame in TERRAIN_FRAMES:
            return Refusal.STOP
        if global_frame:
            acceleration = NO_AXES  # set_destination_posvel
    elif velocity == acceleration == NO_AXES:
        return Refusal.STOP
    return PositionTarget(position, velocity, acceleration, yaw, rate)


def _axes(values: Vector, mask: int, group: int) -> Axes:
    """East, north, up of a group whose bits are in NED order; an ignored axis, or NaN, is None."""
    lowest = group & -group
    ignored = (mask & lowest << 1, mask & lowest, mask & lowest << 2)
    e, n, u = (None if skip or not isfinite(value) else value for value, skip in zip(values, ignored, strict=True))
    return e, n, u


def _yaw(fields: dict[str, Any], mask: int) -> tuple[float | None, float | None]:
    yaw, rate = float(fields["yaw"]), float(fields["yaw_rate"])
    return (
        yaw if isfinite(yaw) and not mask & m.POSITION_TARGET_TYPEMASK_YAW_IGNORE else None,
        rate if isfinite(rate) and not mask & m.POSITION_TARGET_TYPEMASK_YAW_RATE_IGNORE else None,
    )


def _ned_to_enu(north: float, east: float, down: float) -> Vector:
    return east, north, -down


def _local_place(v: Located, fields: dict[str, Any]) -> Vector:
    zero = v.local_origin
    return zero.east_m + fields["y"], zero.north_m + fields["x"], zero.up_m - fields["z"]


def _px4_place(v: Located, fields: dict[str, Any], frame: int) -> Axes | Refusal | str:
    """East, north, up. A height above home has the sign of home's own height wrong in 1.16 (home.alt - alt - ref_alt);
    one above the terrain needs a rangefinder."""
    lat, lon, alt_m = fields["lat_int"] / 1e7, fields["lon_int"] / 1e7, fields["alt"]
    if not v.position_ok or not is_position(lat, lon) or not is_altitude(alt_m):
        return Refusal.NOTHING
    if frame == m.MAV_FRAME_GLOBAL_INT:
        up = alt_m - v.where.alt_amsl_m
    elif frame == m.MAV_FRAME_GLOBAL_RELATIVE_ALT_INT:
        if v.home is None:
            return Refusal.NOTHING
        up = alt_m + 2.0 * v.local_origin.up_m - v.home.up_m
    elif frame == m.MAV_FRAME_GLOBAL_TERRAIN_ALT_INT:
        return Refusal.NOTHING
    else:
        return f"SET_POSITION_TARGET_GLOBAL_INT invalid coordinate frame {frame}"
    return (*v.where.to_local(lat, lon), up)


def _copter_global(v: Located, fields: dict[str, Any], frame: int) -> Vector | None:
    up = up_of(v, frame, fields["alt"])
    lat, lon = fields["lat_int"] / 1e7, fields["lon_int"] / 1e7
    if up is None or not is_position(lat, lon):
        return None
    return (*v.where.to_local(lat, lon), up)


def _copter_local(v: Located, fields: dict[str, Any], frame: int) -> Vector | None:
    if not all(isfinite(fields[axis]) for axis in "xyz"):
        return None  # the firmware does not look, and would fly with NaN
    if frame == m.MAV_FRAME_LOCAL_NED:
        return _local_place(v, fields)
    motion = v.estimated
    offset = _ned_to_enu(fields["x"], fields["y"], fields["z"])
    if frame in BODY_FRAMES:
        offset = _turned(v, offset)
    return motion.east_m + offset[0], motion.north_m + offset[1], motion.up_m + offset[2]


def _turned(v: Located, axes: Any) -> Any:
    """Right, forward, up of the vehicle as east, north, up; axes that are not given stay so."""
    right, forward, up = axes
    if right is None or forward is None:
        return axes
    yaw = v.estimated.yaw_rad
    return forward * sin(yaw) + right * cos(yaw), forward * cos(yaw) - right * sin(yaw), up
