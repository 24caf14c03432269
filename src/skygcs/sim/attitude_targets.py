"""SET_ATTITUDE_TARGET as each firmware takes it.

ArduCopter: ArduCopter/GCS_MAVLink_Copter.cpp and mode_guided.cpp (angle_control_run); PX4: mavlink_receiver.cpp.
Body rates without an attitude are not flown here.
"""

from __future__ import annotations

from enum import Enum
from math import isfinite, sqrt
from typing import Any

from skygcs.sim import protocol as m
from skygcs.sim.body import AttitudeSetpoint, Quaternion

RATES_IGNORE = (
    m.ATTITUDE_TARGET_TYPEMASK_BODY_ROLL_RATE_IGNORE
    | m.ATTITUDE_TARGET_TYPEMASK_BODY_PITCH_RATE_IGNORE
    | m.ATTITUDE_TARGET_TYPEMASK_BODY_YAW_RATE_IGNORE
)

UNIT_TOLERANCE = 1e-3
"""ArduPilot's Quaternion::is_unit_length: how far the squared length may be from 1."""


LEAST_BOOST_COSINE = 0.1
"""AC_AttitudeControl_Multi::get_throttle_boosted divides by no less."""


class Refusal(Enum):
    """A message that is no target."""

    STOP = "stop"
    """ArduCopter: ill-defined, the vehicle stops and holds."""
    NOTHING = "nothing"
    """PX4: thrown away, and does not count as a setpoint either."""


def px4_attitude(fields: dict[str, Any], last_thrust: float) -> AttitudeSetpoint | Refusal | None:
    """What PX4 makes of it; None: a setpoint of a kind that is not flown here (it keeps OFFBOARD alive).

    A message that ignores the thrust leaves ``last_thrust``.
    """
    numbers = (*fields["q"], fields["thrust"], *_rates(fields))
    if not all(isfinite(number) for number in numbers):
        return Refusal.NOTHING
    mask = int(fields["type_mask"])
    if mask & m.ATTITUDE_TARGET_TYPEMASK_ATTITUDE_IGNORE:
        return None
    attitude = _unit(fields["q"])
    if attitude is None:
        return Refusal.NOTHING
    if mask & m.ATTITUDE_TARGET_TYPEMASK_THROTTLE_IGNORE:
        return AttitudeSetpoint(attitude, last_thrust)
    return AttitudeSetpoint(attitude, min(1.0, max(0.0, fields["thrust"])))


def copter_attitude(
    fields: dict[str, Any], *, thrust_as_thrust: bool, climb_mps: float, descent_mps: float, angle_boost: bool = False
) -> AttitudeSetpoint | Refusal | None:
    """What ArduCopter makes of it in GUIDED; None: a kind that is not flown here.

    Without GUID_OPTIONS bit 3 (``thrust_as_thrust``) the thrust is a climb rate: 0.5 holds the height, 1 climbs with
    WPNAV_SPEED_UP (``climb_mps``), 0 descends with WPNAV_SPEED_DN (``descent_mps``). With ``angle_boost`` a thrust is
    divided by the cosine of the tilt asked for, as set_throttle_out does.
    """
    mask = int(fields["type_mask"])
    if mask & m.ATTITUDE_TARGET_TYPEMASK_THROTTLE_IGNORE:
        return Refusal.STOP
    if mask & RATES_IGNORE not in (0, RATES_IGNORE):
        return Refusal.STOP
    thrust = float(fields["thrust"])
    if mask & m.ATTITUDE_TARGET_TYPEMASK_ATTITUDE_IGNORE:
        return None
    attitude = _unit(fields["q"], UNIT_TOLERANCE)
    if attitude is None or not isfinite(thrust):
        return Refusal.STOP
    if thrust_as_thrust:
        if angle_boost:
            thrust /= max(1.0 - 2.0 * (attitude[1] ** 2 + attitude[2] ** 2), LEAST_BOOST_COSINE)
        return AttitudeSetpoint(attitude, min(1.0, max(-1.0, thrust)))
    deflection = 2.0 * min(1.0, max(0.0, thrust)) - 1.0
    return AttitudeSetpoint(attitude, climb_mps=deflection * (climb_mps if deflection > 0.0 else descent_mps))


def _rates(fields: dict[str, Any]) -> tuple[float, float, float]:
    return fields["body_roll_rate"], fields["body_pitch_rate"], fields["body_yaw_rate"]


def _unit(q: list[float], tolerance: float = 0.5) -> Quaternion | None:
    """The quaternion at unit length; None if its squared length is farther than ``tolerance`` from 1, or NaN."""
    w, x, y, z = q
    squared = w * w + x * x + y * y + z * z
    if not abs(squared - 1.0) < tolerance:
        return None
    length = sqrt(squared)
    return w / length, x / length, y / length, z / length
