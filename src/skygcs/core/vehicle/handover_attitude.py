"""The attitude in which an ArduCopter is handed over from attitude setpoints to its own position control. Pure.

Its position controller takes the lean it finds for the one that holds it against the wind, and begins its integral with
it (AC_PosControl::init_xy_controller, 4.6.3). With PSC_VELXY_P 2 and PSC_VELXY_I 1 a wrong lean of a decays as
dv = a t exp(-t): a vehicle that leans into a step by 2 m/s² gets 0.7 m/s faster and 2 m farther before it begins to
stop, one at 35 degrees 2.5 m/s and 7 m. So for HANDOVER_S it is given the lean that its law had found against the wind,
and against its motion what brakes it: the integral then begins with braking.

Nothing is closed over the link meanwhile: the attitude is worked out once. If nothing reaches the vehicle after it, it
keeps that lean for GUID_TIMEOUT and levels; the lean brakes to a standstill in that time at most.
"""

from __future__ import annotations

import math

from skygcs.core.control.cascade import Quaternion, Vector, attitude_from_thrust, ned_frd_from_enu_flu
from skygcs.core.control.gains import GRAVITY_MPS2, ControlConfig
from skygcs.core.control.velocity_loop import within

HANDOVER_S = 0.3
"""The attitude follows with 0.15 s: 86 % of the way."""

BRAKING_MPS2 = 2.5
"""Deceleration, the same with which ArduCopter itself brakes (WPNAV_ACCEL): a lean of 14 degrees."""

LEAST_TIME_S = 0.5
"""In which a lean may brake to a standstill, if GUID_TIMEOUT is shorter."""


def handover_attitude(
    law: ControlConfig, integral_enu: Vector, vel_enu_mps: Vector, yaw_enu_rad: float, loss_timeout_s: float
) -> tuple[Quaternion, float]:
    """Attitude (FRD body in NED world) and collective thrust: the steady ones of the law's integral, and a lean against
    the horizontal velocity."""
    vx, vy, _ = vel_enu_mps
    weight = law.hover_thrust / GRAVITY_MPS2
    # per m/s of velocity
    braking = weight * min(1.0 / max(loss_timeout_s, LEAST_TIME_S), BRAKING_MPS2 / max(math.hypot(vx, vy), 1e-9))
    up = within(law.hover_thrust + integral_enu[2], law.thrust_min, law.thrust_max)
    east, north = integral_enu[0] - braking * vx, integral_enu[1] - braking * vy
    most, size = up * law.tilt_max_tan, math.hypot(east, north)
    if size > most:
        east, north = east * most / size, north * most / size
    thrust = (east, north, up)
    attitude, _, _ = attitude_from_thrust(thrust, yaw_enu_rad)
    return ned_frd_from_enu_flu(attitude), min(math.hypot(*thrust), law.thrust_max)
