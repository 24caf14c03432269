"""How far apart two vehicles have to be: the terms of their margin, and the metric in which it is measured. Pure.

One definition for the monitor and for whatever proves separation beforehand. The downwash of rotors
makes the space of a vehicle an ellipsoid: a vertical distance is divided by ``downwash_ratio`` before it is compared
with the margin, so two vehicles above each other need that many times the distance of two side by side.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

WINGSPAN_M = 0.7
"""Tip to tip of an F450 with ten-inch propellers: 0.45 m between motors and 0.25 m of propeller."""

POSITION_ERROR_M = 0.9
"""Horizontal error of one receiver without corrections against another beside it, 95 %: most of the error of some
metres that each has is common to both. Two of them and two wingspans make the 2.5 m that the benches use."""

DOWNWASH_RATIO = 2.0
"""Crazyswarm plans with ellipsoids of ratio 2.5 for vehicles of 0.1 m (Hönig et al., T-RO 2018); rotors larger against
the gap lose their wake sooner."""

ACCELERATION_MPS2 = 3.0
"""PX4's MPC_ACC_HOR and ArduCopter's WPNAV_ACCEL are 3 and 2.5 m/s²: what a vehicle may have done since its last
position, if it does what its autopilot does by default."""


@dataclass(frozen=True, slots=True)
class Footprint:
    """The space that one vehicle needs, and how far its position may be wrong."""

    wingspan_m: float = WINGSPAN_M
    position_error_m: float = POSITION_ERROR_M
    downwash_ratio: float = DOWNWASH_RATIO
    acceleration_mps2: float = ACCELERATION_MPS2
    """It grows the ball in which the vehicle may be with the age of its position; see `ball_m`."""

    def ball_m(self, age_s: float) -> float:
        """How far it may be from where its last position and velocity put it: ½·a·age²."""
        return 0.5 * self.acceleration_mps2 * age_s * age_s


@dataclass(frozen=True, slots=True)
class Margin:
    """The terms of the distance that two vehicles have to keep, in the metric of ``downwash_ratio``."""

    wingspans_m: float
    """Half of each: at this distance of their centres they touch."""
    position_errors_m: float
    """Those of both."""
    downwash_ratio: float
    """The larger of the two."""

    @property
    def total_m(self) -> float:
        return self.wingspans_m + self.position_errors_m


def pair_margin(a: Footprint, b: Footprint) -> Margin:
    """The margin of two vehicles; the same either way round."""
    return Margin(
        (a.wingspan_m + b.wingspan_m) / 2,
        a.position_error_m + b.position_error_m,
        max(a.downwash_ratio, b.downwash_ratio),
    )


def separation_m(east_m: float, north_m: float, up_m: float, downwash_ratio: float) -> float:
    """The length of an offset in the metric of the margin."""
    return math.hypot(east_m, north_m, up_m / downwash_ratio)
