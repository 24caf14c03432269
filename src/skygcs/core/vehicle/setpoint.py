"""Setpoints as messages: (name, field values), ready to pack; the sender fills in the target.

Rule: type masks and frames of setpoints are chosen here and nowhere else. Input is ENU (x east, y north, z up; yaw 0 is
east, counter-clockwise), output is in the autopilot's frames. How the firmwares read the messages, from their sources
(PX4 1.11 and 1.14 mavlink_receiver.cpp, ArduCopter 4.5 and 4.7 GCS_MAVLink_Copter.cpp):

    SET_ATTITUDE_TARGET
        PX4         thrust is thrust, for the rotorcraft types it lists; other types ignore it
        ArduCopter  thrust is a climb rate unless GUID_OPTIONS has bit 3; without thrust, with a quaternion whose norm
                    is not 1 +- 1e-3 or with some of the rates only it does not follow (4.7: it stops and holds)
    SET_POSITION_TARGET_LOCAL_NED
        PX4         each axis by a position, a velocity or an acceleration; x and y in pairs, z by itself
        ArduCopter  position, velocity and acceleration each with all axes: one ignored axis ignores the whole vector
    SET_POSITION_TARGET_GLOBAL_INT
        PX4         position with all axes or not at all; 1.14 refuses frame 0 (GLOBAL) and has the sign of frame 6
                    (GLOBAL_RELATIVE_ALT_INT) wrong
        ArduCopter  frames 0 and 5 both are AMSL; a velocity is used with the position, an acceleration is not

So an AMSL position is sent in frame 5, which both accept. time_boot_ms is ours and only for logs: neither checks it.
Values that are not finite, or are impossible, raise RefusedError, because a setpoint is flown as it is.

A type_mask says what the autopilot must *ignore*. One written by hand is one digit short sooner or later, and the field
that it forgets is then flown: latitude 0, or nine radians a second of yaw. Here a bit is cleared by nothing but a value
that is there. POSITION_TARGET_TYPEMASK and ATTITUDE_TARGET_TYPEMASK: https://mavlink.io/en/messages/common.html
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

from skygcs.core.mavlink.modes import Family
from skygcs.core.vehicle.frames import GeodeticPosition
from skygcs.errors import RefusedError

# --- type masks -------------------------------------------------------------------------------------------------------

Axes = tuple[bool, bool, bool]

ALL: Axes = (True, True, True)
NONE: Axes = (False, False, False)

YAW_IGNORE = 1 << 10
YAW_RATE_IGNORE = 1 << 11
"""Bit 9, FORCE_SET, turns accelerations into forces. No autopilot takes it, and it is never set here."""

ATTITUDE_AND_THRUST = 0b0000_0111
"""Attitude and thrust given, the three body rates ignored. ArduCopter wants all of the rates or none (it stops where it
is for a mask in between); PX4 takes roll and pitch rate, where they are not ignored, for another setpoint, of rates."""

BODY_RATES_AND_THRUST = 0b1000_0000
"""The three body rates and thrust given, the attitude ignored."""


def position_target_mask(
    *, pos: Axes = NONE, vel: Axes = NONE, acc: Axes = NONE, yaw: bool = False, yaw_rate: bool = False
) -> int:
    """type_mask of SET_POSITION_TARGET_LOCAL_NED and _GLOBAL_INT that give these fields, in the order of the wire.

    Raises ValueError for one that gives no field at all: autopilots take that for an order to stop, or for nothing.
    """
    given = (*pos, *vel, *acc)
    if not any(given):
        raise ValueError("a position target gives at least one of position, velocity and acceleration")
    mask = sum(1 << bit for bit, is_given in enumerate(given) if not is_given)
    return mask | (0 if yaw else YAW_IGNORE) | (0 if yaw_rate else YAW_RATE_IGNORE)


# --- messages ---------------------------------------------------------------------------------------------------------


Message = tuple[str, dict[str, Any]]
"""Name of the message and its fields, without target_system and target_component."""

Vector = tuple[float, float, float]
Partial = tuple[float | None, float | None, float | None]
"""East, north, up; None: another kind of value controls this axis."""

FRAME_LOCAL_NED = 1
FRAME_GLOBAL_INT = 5
"""MAV_FRAME: NED around the vehicle's own estimator origin, and WGS84 with AMSL altitude."""

UNIT_TOLERANCE = 1e-3
"""ArduCopter's tolerance of a quaternion's norm; beyond it ArduCopter stops and holds."""

MAX_SPEED_MPS = 100.0
MAX_ACCELERATION_MPS2 = 100.0
"""Beyond any multirotor; a larger value comes from a wrong unit or sign."""

MAX_BODY_RATE_RADPS = 35.0
"""2000 degrees/s, what the gyros of autopilots measure at most."""

MAX_YAW_RATE_RADPS = math.tau
"""A full turn per second. Neither autopilot turns faster than 3.5 rad/s by default (ArduCopter ATC_RATE_Y_MAX is free,
PX4 MC_YAWRATE_MAX 200 deg/s)."""

MAX_LOCAL_M = 100_000.0
"""Largest distance from the estimator's origin of a target in a flat frame."""

MAX_ALTITUDE_M = 20_000.0

LEAST_BOOST_COSINE = 0.1
"""Lower limit of the divisor in ArduCopter's angle boost (AC_AttitudeControl_Multi::get_throttle_boosted)."""

UINT32 = 0xFFFF_FFFF

NOTHING: Partial = (None, None, None)


def attitude_target(
    attitude_ned_frd: Sequence[float], thrust: float, boot_ms: int, *, angle_boost: bool = False
) -> Message:
    """SET_ATTITUDE_TARGET: attitude (w, x, y, z), FRD body in NED world, and collective thrust of 0 to 1.

    ``angle_boost``: the autopilot divides the thrust by the cosine of the tilt (ArduCopter with ATC_ANGLE_BOOST, its
    default). ``thrust`` is along the body's axis, so it is multiplied by the same cosine here to cancel that.
    The autopilot controls the body rates. Raises RefusedError.
    """
    if len(attitude_ned_frd) != 4:
        raise RefusedError(f"an attitude is a quaternion of 4 numbers (w, x, y, z), not {len(attitude_ned_frd)}")
    w, x, y, z = map(float, attitude_ned_frd)
    length = math.sqrt(w * w + x * x + y * y + z * z)
    if not abs(length - 1.0) <= UNIT_TOLERANCE:  # also false for NaN
        for value in (w, x, y, z):
            _finite("an attitude", value)
        raise RefusedError(f"attitude quaternion has norm {length:g}; it must be 1 within 0.001")
    if not 0.0 <= thrust <= 1.0:  # also false for NaN
        raise RefusedError(f"a thrust of {thrust:g} is not between 0 and 1")
    if angle_boost:
        thrust *= max(LEAST_BOOST_COSINE, 1.0 - 2.0 * (x * x + y * y))
    values = {
        "time_boot_ms": boot_ms & UINT32,
        "type_mask": ATTITUDE_AND_THRUST,
        "q": [w, x, y, z],
        "thrust": thrust,
    }
    return "SET_ATTITUDE_TARGET", values


def body_rate_target(
    rates_frd_radps: Sequence[float], thrust: float, boot_ms: int, *, boost_cosine: float | None = None
) -> Message:
    """SET_ATTITUDE_TARGET: body rates (FRD: roll, pitch, yaw) and collective thrust of 0 to 1, the attitude ignored.

    ``boost_cosine``: of the vehicle's tilt, where the autopilot divides the thrust by it (`attitude_target`).
    Raises RefusedError.
    """
    roll, pitch, yaw = _vector("body rates", rates_frd_radps, MAX_BODY_RATE_RADPS)
    if not 0.0 <= thrust <= 1.0:  # also false for NaN
        raise RefusedError(f"a thrust of {thrust:g} is not between 0 and 1")
    values = {
        "time_boot_ms": boot_ms & UINT32,
        "type_mask": BODY_RATES_AND_THRUST,
        "q": [1.0, 0.0, 0.0, 0.0],
        "body_roll_rate": roll,
        "body_pitch_rate": pitch,
        "body_yaw_rate": yaw,
        "thrust": thrust if boost_cosine is None else thrust * max(boost_cosine, LEAST_BOOST_COSINE),
    }
    return "SET_ATTITUDE_TARGET", values


def acceleration_target(acc_enu_mps2: Sequence[float], yaw_enu_rad: float | None, boot_ms: int) -> Message:
    """SET_POSITION_TARGET_LOCAL_NED with an acceleration alone. Raises RefusedError."""
    acc = _vector("an acceleration", acc_enu_mps2, MAX_ACCELERATION_MPS2)
    return _local(NOTHING, NOTHING, acc, (yaw_enu_rad, None), boot_ms)


def velocity_target(
    vel_enu_mps: Sequence[float],
    yaw_enu_rad: float | None,
    boot_ms: int,
    *,
    acc_enu_mps2: Sequence[float] | None = None,
    yaw_rate_enu_radps: float | None = None,
) -> Message:
    """SET_POSITION_TARGET_LOCAL_NED with a velocity over ground and, if given, an acceleration as feed-forward.

    Both autopilots accept it. Without a yaw PX4 keeps the heading and ArduCopter turns as WP_YAW_BEHAVIOR says (by
    default into the direction of flight). Raises RefusedError.
    """
    vel = _vector("a velocity", vel_enu_mps, MAX_SPEED_MPS)
    acc = None if acc_enu_mps2 is None else _vector("an acceleration", acc_enu_mps2, MAX_ACCELERATION_MPS2)
    return _local(NOTHING, vel, NOTHING if acc is None else acc, (yaw_enu_rad, yaw_rate_enu_radps), boot_ms)


def position_target(
    place: GeodeticPosition,
    yaw_enu_rad: float | None,
    boot_ms: int,
    family: Family,
    *,
    vel_enu_mps: Sequence[float] | None = None,
    acc_enu_mps2: Sequence[float] | None = None,
    yaw_rate_enu_radps: float | None = None,
) -> Message:
    """SET_POSITION_TARGET_GLOBAL_INT: a geodetic position and, if given, the velocity and acceleration to pass it with.

    Raises RefusedError, also for a coordinate of exactly 0, which most likely was never filled in.
    """
    _require_known(family)
    if family == "ardupilot" and acc_enu_mps2 is not None:
        raise RefusedError("ArduPilot ignores an acceleration beside a global position")
    # a place on earth
    lat_deg, lon_deg, alt_amsl_m = place.lat_deg, place.lon_deg, place.alt_amsl_m
    if not (abs(lat_deg) <= 90.0 and abs(lon_deg) <= 180.0):  # also false for NaN
        raise RefusedError(
            f"{lat_deg:g}, {lon_deg:g} is not a position on earth (latitude -90..90, longitude -180..180)"
        )
    lat_int, lon_int = round(lat_deg * 1e7), round(lon_deg * 1e7)
    if lat_int == 0 or lon_int == 0:
        raise RefusedError(f"{lat_deg:g}, {lon_deg:g} has a zero coordinate: most likely a value was never filled in")
    # bounds, then the message
    alt_m = _within("an altitude", alt_amsl_m, MAX_ALTITUDE_M)
    vel = None if vel_enu_mps is None else _vector("a velocity", vel_enu_mps, MAX_SPEED_MPS)
    acc = None if acc_enu_mps2 is None else _vector("an acceleration", acc_enu_mps2, MAX_ACCELERATION_MPS2)
    values = {
        "time_boot_ms": boot_ms & UINT32,
        "coordinate_frame": FRAME_GLOBAL_INT,
        "type_mask": position_target_mask(
            pos=ALL,
            vel=NONE if vel is None else ALL,
            acc=NONE if acc is None else ALL,
            yaw=yaw_enu_rad is not None,
            yaw_rate=yaw_rate_enu_radps is not None,
        ),
        "lat_int": lat_int,
        "lon_int": lon_int,
        "alt": alt_m,
        **({} if vel is None else _ned(("vx", "vy", "vz"), vel)),
        **({} if acc is None else _ned(("afx", "afy", "afz"), acc)),
        **_yaw(yaw_enu_rad, yaw_rate_enu_radps),
    }
    return "SET_POSITION_TARGET_GLOBAL_INT", values


def position_target_local(
    pos_local_enu_m: Sequence[float],
    yaw_enu_rad: float | None,
    boot_ms: int,
    family: Family,
    *,
    vel_enu_mps: Sequence[float] | None = None,
    acc_enu_mps2: Sequence[float] | None = None,
    yaw_rate_enu_radps: float | None = None,
) -> Message:
    """SET_POSITION_TARGET_LOCAL_NED: a point relative to the vehicle's *own* estimator origin, not the fleet's, and the
    velocity and acceleration to pass it with. Raises RefusedError."""
    pos = _vector("a local position", pos_local_enu_m, MAX_LOCAL_M)
    vel = NOTHING if vel_enu_mps is None else _vector("a velocity", vel_enu_mps, MAX_SPEED_MPS)
    acc = NOTHING if acc_enu_mps2 is None else _vector("an acceleration", acc_enu_mps2, MAX_ACCELERATION_MPS2)
    _require_known(family)
    if family == "ardupilot" and acc_enu_mps2 is not None and vel_enu_mps is None:
        raise RefusedError("ArduPilot takes an acceleration with a position only if a velocity comes with both")
    return _local(pos, vel, acc, (yaw_enu_rad, yaw_rate_enu_radps), boot_ms)


def yaw_ned_rad(yaw_enu_rad: float) -> float:
    """ENU yaw -> compass yaw (0 north, clockwise) in [-pi, pi), as setpoints carry it."""
    wrapped = math.fmod(math.pi / 2 - yaw_enu_rad, math.tau)
    if wrapped < -math.pi:
        wrapped += math.tau
    elif wrapped >= math.pi:
        wrapped -= math.tau
    return wrapped


def _local(
    pos: Partial, vel: Partial, acc: Partial, yaw_and_rate: tuple[float | None, float | None], boot_ms: int
) -> Message:
    yaw_enu_rad, yaw_rate_enu_radps = yaw_and_rate
    values = {
        "time_boot_ms": boot_ms & UINT32,
        "coordinate_frame": FRAME_LOCAL_NED,
        "type_mask": position_target_mask(
            pos=_given(pos),
            vel=_given(vel),
            acc=_given(acc),
            yaw=yaw_enu_rad is not None,
            yaw_rate=yaw_rate_enu_radps is not None,
        ),
        **_ned(("x", "y", "z"), pos),
        **_ned(("vx", "vy", "vz"), vel),
        **_ned(("afx", "afy", "afz"), acc),
        **_yaw(yaw_enu_rad, yaw_rate_enu_radps),
    }
    return "SET_POSITION_TARGET_LOCAL_NED", values


def _given(enu: Partial) -> Axes:
    """The axes given, of north, east, down."""
    return enu[1] is not None, enu[0] is not None, enu[2] is not None


def _ned(names: tuple[str, str, str], enu: Partial) -> dict[str, float]:
    east, north, up = enu
    ned = (north, east, None if up is None else -up)
    return {name: value for name, value in zip(names, ned, strict=True) if value is not None}


def _yaw(yaw_enu_rad: float | None, yaw_rate_enu_radps: float | None) -> dict[str, float]:
    yaw = {} if yaw_enu_rad is None else {"yaw": yaw_ned_rad(_finite("a yaw", yaw_enu_rad))}
    if yaw_rate_enu_radps is None:
        return yaw
    return {**yaw, "yaw_rate": -_within("a yaw rate", yaw_rate_enu_radps, MAX_YAW_RATE_RADPS)}


def _vector(what: str, values: Sequence[float], most: float) -> Vector:
    if len(values) != 3:
        raise RefusedError(f"{what} is east, north, up: three numbers, not {len(values)}")
    east, north, up = (_within(what, value, most) for value in values)
    return east, north, up


def _within(what: str, value: float, most: float) -> float:
    if not abs(value) <= most:  # also false for NaN
        raise RefusedError(f"{what} of {value:g} is not between {-most:g} and {most:g}")
    return float(value)


def _finite(what: str, value: float) -> float:
    if not math.isfinite(value):
        raise RefusedError(f"{what} of {value:g} is not a finite number")
    return float(value)


def _require_known(family: Family) -> None:
    if family == "generic":
        raise RefusedError("skygcs knows the setpoints of PX4 and ArduPilot only")
