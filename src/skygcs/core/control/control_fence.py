"""The control fence: a fixed box. No setpoint leads out of it, and outside of it no setpoint is sent.

    where                                         the vehicle             the place it is sent to
    ───────────────────────────────────────────────────────────────────────────────────────────────
    inside walls and ceiling, over margin_m       allowed                 allowed
    nearer than margin_m to a wall or the top     allowed                 refused: overshoot and GPS noise
    beyond a wall or the top, or NaN              hold                    refused
    up to margin_m below the floor                allowed: height noise   refused
    further below                                 hold                    refused

Outside the box the guard orders a hold, and no setpoint can lead the vehicle further away. Landing, returning and
descending are done by the autopilot and are not limited by this fence, which does not replace the autopilot's geofence.
The floor is soft for the vehicle because every flight ends on the ground, and GPS heights are inaccurate.

The box is fixed on earth, along the axes of the origin it was created with; a later change of the fleet's origin does
not move it.

Whether a velocity leads out of it is decided by how far a vehicle still goes before it stands, which is also the
distance to plan for when it is to stop:

    distance = |v| · delay + v² / (2 a)

``delay`` is how long it goes on unchanged: the age of the state that v was measured in, and the way of the order to
stop; for an autopilot that waits for the next setpoint as long as it goes on with its last. ``a`` is what the autopilot
brakes with.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import NamedTuple

from skygcs.core.geo import EnuFrame, Origin, Vector, world_from_enu
from skygcs.errors import ConfigError
from skygcs.spelling import rounded

Span = tuple[float, float]

LARGEST_M = 100_000.0
"""Largest size of a box. Farther away "up" of the origin is not a height any more (785 m too high at 100 km)."""


@dataclass(frozen=True, slots=True)
class Fence:
    """Box around ``origin`` along its axes; by default 100 m square and 20 m high.

    Raises ConfigError, with every problem at once.
    """

    origin: Origin
    x_m: Span = (-50.0, 50.0)
    y_m: Span = (-50.0, 50.0)
    up_m: Span = (0.0, 20.0)
    margin_m: float = 2.0
    """GPS noise of a metre or two; a 3 m step overshoots by 0.5 m (attitude lag 0.15 s, delay 0.1 s)."""
    _frame: EnuFrame = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        problems = []
        for name in ("x_m", "y_m", "up_m"):
            low, high = getattr(self, name)
            if not -LARGEST_M <= low < high <= LARGEST_M:
                problems.append(f"{name}: {low}..{high} does not rise within ±{LARGEST_M:g} m")
        narrowest = min(self.x_m[1] - self.x_m[0], self.y_m[1] - self.y_m[0])
        if not (self.margin_m >= 0.0 and 2 * self.margin_m < narrowest and self.margin_m < self.up_m[1] - self.up_m[0]):
            problems.append(f"margin_m: {self.margin_m} leaves nothing of the box to fly to")
        if problems:
            raise ConfigError("fence", problems)
        object.__setattr__(self, "_frame", EnuFrame(self.origin))  # frozen, and made of nothing but the origin

    def contains(self, lat_deg: float, lon_deg: float, alt_amsl_m: float, *, reference: bool = False) -> bool:
        """True if a vehicle may be there; with ``reference``: may be sent there."""
        return self.why_not(lat_deg, lon_deg, alt_amsl_m, reference=reference) is None

    def holds(self, point_m: Vector) -> bool:
        """`contains` for a position by its `geo.ecef`; `why_not` gives the reason."""
        x_m, y_m, up_m = self._frame.from_ecef(point_m)
        (x_low, x_high), (y_low, y_high), (low, high) = self.x_m, self.y_m, self.up_m
        return x_low <= x_m <= x_high and y_low <= y_m <= y_high and low - self.margin_m <= up_m <= high

    def why_not(
        self,
        lat_deg: float,
        lon_deg: float,
        alt_amsl_m: float,
        *,
        reference: bool = False,
        what: str | None = None,
        free_xy: bool = False,
        free_z: bool = False,
    ) -> str | None:
        """How far it is outside, and on which side; None if it is inside. Never raises.

        ``what``: its name in the text. A ``free`` axis follows a velocity, has no position and is not checked.
        """
        what = what or ("the target position" if reference else "the vehicle")
        if not (abs(lat_deg) <= 90.0 and abs(lon_deg) <= 360.0 and math.isfinite(alt_amsl_m)):
            return f"{what} ({lat_deg}, {lon_deg}, {alt_amsl_m} m) is not a position on earth"
        x_m, y_m, up_m = self._frame.from_geodetic(lat_deg, lon_deg, alt_amsl_m)
        if free_xy:
            x_m, y_m = sum(self.x_m) / 2, sum(self.y_m) / 2
        if free_z:
            up_m = sum(self.up_m) / 2
        inset = self.margin_m if reference else 0.0
        below = 0.0 if reference else self.margin_m
        x_low, x_high = self.x_m[0] + inset, self.x_m[1] - inset
        if not x_low <= x_m <= x_high:  # NaN too, here and below
            return self._text(what, "x", x_m, x_low, x_high, reference)
        y_low, y_high = self.y_m[0] + inset, self.y_m[1] - inset
        if not y_low <= y_m <= y_high:
            return self._text(what, "y", y_m, y_low, y_high, reference)
        low, high = self.up_m[0] - below, self.up_m[1] - inset
        if not low <= up_m <= high:
            return self._text(what, "up", up_m, low, high, reference)
        return None

    def leads_out(
        self, lat_deg: float, lon_deg: float, alt_amsl_m: float, offset_enu_m: Vector, *, margin: bool, what: str
    ) -> str | None:
        """Why a way from there by ``offset_enu_m`` ends beyond a wall, the top or the floor; None if it does not.

        Only what it goes towards counts: along a wall, or back inside, it may go. ``margin``: the walls and the top
        less the margin; the floor is the vehicle's own, the margin below.
        """
        if not (abs(lat_deg) <= 90.0 and abs(lon_deg) <= 360.0 and math.isfinite(alt_amsl_m)):
            return f"{what} ({lat_deg}, {lon_deg}, {alt_amsl_m} m) is not a place on earth"
        here = self._frame.from_geodetic(lat_deg, lon_deg, alt_amsl_m)
        inset = self.margin_m if margin else 0.0
        spans = (
            ("x", self.x_m[0] + inset, self.x_m[1] - inset),
            ("y", self.y_m[0] + inset, self.y_m[1] - inset),
            ("up", self.up_m[0] - self.margin_m, self.up_m[1] - inset),
        )
        offset_m = world_from_enu(offset_enu_m, self.origin)
        for (axis, low, high), start_m, way_m in zip(spans, here, offset_m, strict=True):
            end_m = start_m + way_m
            if (way_m > 0.0 and not end_m <= high) or (way_m < 0.0 and not end_m >= low) or way_m != way_m:
                return self._text(what, axis, end_m, low, high, margin)
        return None

    def _text(self, what: str, axis: str, value_m: float, low_m: float, high_m: float, reference: bool) -> str:
        less = f" less {self.margin_m:g} m of margin" if reference else ""
        shown_m = round(value_m, 1) + 0.0  # not -0.0
        return f"{what} is at {axis} {shown_m:.1f} m (limit {rounded(low_m)}..{rounded(high_m)} m, the fence{less})"


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
