"""How far a vehicle still goes before it stands: the distance to plan for when it is to stop. Pure.

    distance = |v| · delay + v² / (2 a)

``delay`` is how long it goes on unchanged: the age of the state that v was measured in, and the way of the order to
stop. ``a`` is what the autopilot brakes with.

The same decides whether a velocity leads out of the control fence: an autopilot goes on with its last setpoint for as
long as it waits for the next one, and then brakes.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

from skygcs.core.control.control_fence import Fence
from skygcs.core.geo import EnuFrame, Origin, Vector


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


class LossReach(NamedTuple):
    """How far a vehicle goes when its setpoints cease: GUID_TIMEOUT of an ArduCopter, COM_OF_LOSS_T of a PX4, and what
    it brakes with."""

    timeout_s: float
    braking: BrakingLimits

    def offset_m(self, vel_enu_mps: Vector) -> Vector:
        """From its last setpoint to where it stands."""
        return self.braking.offset(vel_enu_mps, self.timeout_s)

    @property
    def what(self) -> str:
        """The subject of a refusal."""
        return f"with this velocity, {self.timeout_s:g} s after its last setpoint, the vehicle"


def fence_ahead(
    fence: Fence, origin: Origin, place_m: Vector, vel_enu_mps: Vector, reach: LossReach, *, less_m: float
) -> str | None:
    """Why a reference in the frame of ``origin`` leads out of the fence, as the control loop would find it; None if it
    does not. ``less_m``: asked so much before the walls."""
    way_m = reach.offset_m(vel_enu_mps)
    if fence.origin == origin:  # in its own axes: no need of the earth for what is clearly inside
        spans = (fence.x_m, fence.y_m, fence.up_m)
        inside = (
            low + less_m <= p + w <= high - less_m for p, w, (low, high) in zip(place_m, way_m, spans, strict=True)
        )
        if all(inside):
            return None
    longer = (_more(way_m[0], less_m), _more(way_m[1], less_m), _more(way_m[2], less_m))
    return fence.leads_out(*EnuFrame(origin).to_geodetic(*place_m), longer, margin=False, what=reach.what)


def _more(way_m: float, less_m: float) -> float:
    return way_m if way_m == 0.0 else way_m + less_m * (1.0 if way_m > 0.0 else -1.0)
