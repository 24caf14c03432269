"""A velocity that leads out of the control fence: an autopilot goes on with its last setpoint for as long as it waits
for the next one, and then needs its braking distance. Pure."""

from __future__ import annotations

from typing import NamedTuple

from skygcs.core.control.braking import BrakingLimits
from skygcs.core.control.control_fence import Fence
from skygcs.core.geo import EnuFrame, Origin, Vector


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
