"""SET_ATTITUDE_TARGET as each firmware takes it.

ArduCopter: ArduCopter/GCS_Mavlink.cpp (handle_message_set_attitude_target) and mode_guided.cpp (angle_control_run);
PX4: mavlink/mavlink_receiver.cpp (handle_message_set_attitude_target).
"""

from __future__ import annotations

from enum import Enum
from math import isfinite, sqrt
from typing import Any

from skygcs.sim import protocol as m
from skygcs.sim.body import AttitudeSetpoint, Quaternion, Vector

RATES_IGNORE = (
    m.ATTITUDE_TARGET_TYPEMASK_BODY_ROLL_RATE_IGNORE
    | m.ATTITUDE_TARGET_TYPEMASK_BODY_PITCH_RATE_IGNORE
    | m.ATTITUDE_TARGET_TYPEMASK_BODY_YAW_RATE_IGNORE
)
TILT_RATES_IGNORE = m.ATTITUDE_TARGET_TYPEMASK_BODY_ROLL_RATE_IGNORE | m.ATTITUDE_TARGET_TYPEMASK_BODY_PITCH_RATE_IGNORE

UNCONTROLLED = (None, None, None)

THRUST_BODY_SET = 32
"""ATTITUDE_TARGET_TYPEMASK_THRUST_BODY_SET, which ArduPilot's dialect does not have."""

UNIT_TOLERANCE = 1e-3
"""ArduPilot's Quaternion::is_unit_length: how far the squared length may be from 1."""


LEAST_BOOST_COSINE = 0.1
"""AC_AttitudeControl_Multi::get_throttle_boosted divides by no less."""


class Refusal(Enum):
    """Reaction to a message that does not define a target."""

    STOP = "stop"
    """ArduCopter: ill-defined, the vehicle stops and holds."""
    NOTHING = "nothing"
    """The message is ignored, and does not count as a setpoint."""


def px4_attitude(fields: dict[str, Any]) -> AttitudeSetpoint | Refusal:
    """Return PX4's setpoint for a SET_ATTITUDE_TARGET.

    With an attitude only the yaw rate counts of the rates, as feed-forward. Without one, roll and pitch rates are
    required; a yaw rate that is masked out or NaN leaves the present rate of turn. A thrust that is masked out or NaN
    is zero: the motors idle. The firmware does not validate the numbers: with a quaternion of length 0 nothing controls
    the attitude. The message counts as a setpoint in each of these cases.
    """
    mask = int(fields["type_mask"])
    thrust = float(fields["thrust"])
    if mask & THRUST_BODY_SET:
        thrust = -float((fields.get("thrust_body") or (0.0, 0.0, 0.0))[2])
    elif mask & m.ATTITUDE_TARGET_TYPEMASK_THROTTLE_IGNORE:
        thrust = 0.0
    thrust = min(1.0, max(0.0, thrust)) if isfinite(thrust) else 0.0
    roll, pitch, yaw = (rate if isfinite(rate) else None for rate in _rates(fields))
    if mask & m.ATTITUDE_TARGET_TYPEMASK_BODY_YAW_RATE_IGNORE:
        yaw = None
    if not mask & m.ATTITUDE_TARGET_TYPEMASK_ATTITUDE_IGNORE:
        attitude = _unit(fields["q"])
        if attitude is None:
            return AttitudeSetpoint(None, thrust, rates_frd_radps=UNCONTROLLED)
        return AttitudeSetpoint(attitude, thrust, rates_frd_radps=(0.0, 0.0, yaw) if yaw else None)
    if mask & TILT_RATES_IGNORE:
        return Refusal.NOTHING
    return AttitudeSetpoint(None, thrust, rates_frd_radps=(roll, pitch, yaw))


def copter_attitude(
    fields: dict[str, Any],
    *,
    thrust_as_thrust: bool,
    climb_mps: float,
    descent_mps: float,
    angle_boost: bool = False,
    upright: float = 1.0,
) -> AttitudeSetpoint | Refusal:
    """Return what ArduCopter makes of it in GUIDED.

    Without an attitude it flies the rates (none: 0), with both the attitude turns on with the rates. Without
    GUID_OPTIONS bit 3 (``thrust_as_thrust``) the thrust is a climb rate: 0.5 holds the height, 1 climbs with
    WPNAV_SPEED_UP (``climb_mps``), 0 descends with WPNAV_SPEED_DN (``descent_mps``). With ``angle_boost`` a thrust is
    divided by the cosine of the tilt asked for, as set_throttle_out does; for rates by that of the tilt there is
    (``upright``).
    """
    mask = int(fields["type_mask"])
    if mask & m.ATTITUDE_TARGET_TYPEMASK_THROTTLE_IGNORE:
        return Refusal.NOTHING
    attitude = None
    if not mask & m.ATTITUDE_TARGET_TYPEMASK_ATTITUDE_IGNORE:
        attitude = _unit(fields["q"], UNIT_TOLERANCE)
        if attitude is None:
            return Refusal.NOTHING
    if mask & RATES_IGNORE not in (0, RATES_IGNORE):
        return Refusal.STOP
    rates = (0.0, 0.0, 0.0) if mask & RATES_IGNORE else _rates(fields)
    if not all(map(isfinite, rates)):
        return Refusal.NOTHING  # the firmware does not look, and would fly with NaN
    thrust = float(fields["thrust"])
    turning = rates if attitude is None or rates != (0.0, 0.0, 0.0) else None
    if thrust_as_thrust:
        thrust = 0.0 if thrust != thrust else min(1.0, max(-1.0, thrust))  # constrain_float of NaN: the middle
        if angle_boost:
            tilt = upright if attitude is None else 1.0 - 2.0 * (attitude[1] ** 2 + attitude[2] ** 2)
            thrust /= max(tilt, LEAST_BOOST_COSINE)
        return AttitudeSetpoint(attitude, min(1.0, max(-1.0, thrust)), rates_frd_radps=turning, turns_on=True)
    thrust = 0.5 if thrust != thrust else min(1.0, max(0.0, thrust))
    deflection = 2.0 * thrust - 1.0
    climb = deflection * (climb_mps if deflection > 0.0 else descent_mps)
    return AttitudeSetpoint(attitude, climb_mps=climb, rates_frd_radps=turning, turns_on=True)


def _rates(fields: dict[str, Any]) -> Vector:
    return fields["body_roll_rate"], fields["body_pitch_rate"], fields["body_yaw_rate"]


def _unit(q: list[float], tolerance: float = 0.5) -> Quaternion | None:
    """The quaternion at unit length; None if its squared length is farther than ``tolerance`` from 1, or NaN."""
    w, x, y, z = q
    squared = w * w + x * x + y * y + z * z
    if not abs(squared - 1.0) < tolerance:
        return None
    length = sqrt(squared)
    return w / length, x / length, y / length, z / length
