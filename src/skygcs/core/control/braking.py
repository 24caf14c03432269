"""How far a vehicle still goes before it stands: the distance to plan for when it is to stop. Pure.

    distance = |v| · delay + v² / (2 a)

``delay`` is how long it goes on unchanged: the age of the state that v was measured in, and the way of the order to
stop. ``a`` is what the autopilot brakes with.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from skygcs.core.control.cascade import Vector


@dataclass(frozen=True, slots=True)
class BrakingLimits:
    """Accelerations with which an autopilot slows down towards a position, in m/s²."""

    xy_mps2: float
    z_mps2: float

    def offset(self, vel_enu_mps: Vector, delay_s: float) -> Vector:
        """From where the velocity was measured to where the vehicle stands, if it is ordered to stop now."""
        vx, vy, vz = vel_enu_mps
        along_s = delay_s + math.hypot(vx, vy) / (2.0 * self.xy_mps2)
        return vx * along_s, vy * along_s, vz * (delay_s + abs(vz) / (2.0 * self.z_mps2))


COPTER_BRAKING = BrakingLimits(2.5, 1.0)
"""ArduCopter 4.6: WPNAV_ACCEL and WPNAV_ACCEL_Z by default (AC_WPNav.cpp), which GUIDED gives its position controller
(mode_guided.cpp, pva_control_start). Its jerk adds v·a/(2·5 m/s³): 0.5 m at 2 m/s, which it flies back."""

PX4_BRAKING = BrakingLimits(3.0, 3.0)
"""PX4 1.16: MPC_ACC_HOR and MPC_ACC_DOWN_MAX by default. In OFFBOARD it brakes by its gains alone, MPC_XY_P 0.95 and
MPC_XY_VEL_P_ACC 1.8: from 2 m/s towards a place 0.7 m ahead with 2.4 m/s² at first, and passes it by 0.4 m."""
