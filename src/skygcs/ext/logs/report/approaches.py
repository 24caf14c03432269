"""How near vehicles came to each other, from the positions that they reported. Pure."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

from skygcs.core.separation import Footprint, pair_margin, separation_m
from skygcs.ext.logs.report.day_figures import ApproachFigures
from skygcs.ext.logs.tables import VehicleKey

Vector = tuple[float, float, float]

FRESH_S = 1.5
"""An older position of the other vehicle is not compared; a slow radio brings one a second."""


@dataclass(slots=True)
class _Placed:
    at_s: float
    pos_enu_m: Vector
    vel_enu_mps: Vector


class Approaches:
    """`placed` for every position of a vehicle in the air, `left` when it has landed or is no longer recorded."""

    def __init__(self, footprint: Callable[[VehicleKey], Footprint]) -> None:
        self._footprint = footprint
        self._placed: dict[VehicleKey, _Placed] = {}
        self._nearest: dict[tuple[VehicleKey, VehicleKey], _Nearest] = {}

    def placed(self, key: VehicleKey, now: float, pos_enu_m: Vector, vel_enu_mps: Vector) -> None:
        """Compare it with all others, each carried on by its velocity from its last position to this time."""
        self._placed[key] = _Placed(now, pos_enu_m, vel_enu_mps)
        for other, there in self._placed.items():
            age_s = now - there.at_s
            if other == key or age_s > FRESH_S:
                continue
            x, y, z = (there.pos_enu_m[axis] + age_s * there.vel_enu_mps[axis] - pos_enu_m[axis] for axis in range(3))
            pair = (key, other) if key < other else (other, key)
            nearest = self._nearest.get(pair)
            if nearest is None:
                margin = pair_margin(*map(self._footprint, pair))
                nearest = self._nearest[pair] = _Nearest(margin.total_m, margin.downwash_ratio)
            nearest.take(now, x, y, z)

    def left(self, key: VehicleKey) -> None:
        """It flies no longer."""
        self._placed.pop(key, None)

    def leave_all(self) -> None:
        """The recording ends here."""
        self._placed.clear()

    def figures(self) -> list[ApproachFigures]:
        """Every pair that was in the air together; what is left of the margin least, first."""
        found = [nearest.figures(*pair) for pair, nearest in self._nearest.items()]
        return sorted(found, key=lambda a: (a.used, a.first, a.second))


class _Nearest:
    """The least distances of one pair so far."""

    __slots__ = ("_at_s", "_distance_m", "_level_m", "_margin_m", "_ratio", "_separation_m", "_vertical_m")

    def __init__(self, margin_m: float, downwash_ratio: float) -> None:
        self._margin_m, self._ratio = margin_m, downwash_ratio
        self._distance_m = self._separation_m = math.inf
        self._at_s = self._level_m = self._vertical_m = math.nan

    def take(self, now: float, x_m: float, y_m: float, z_m: float) -> None:
        distance_m = math.hypot(x_m, y_m, z_m)
        if distance_m < self._distance_m:
            self._distance_m, self._at_s = distance_m, now
            self._level_m, self._vertical_m = math.hypot(x_m, y_m), abs(z_m)
        self._separation_m = min(self._separation_m, separation_m(x_m, y_m, z_m, self._ratio))

    def figures(self, first: VehicleKey, second: VehicleKey) -> ApproachFigures:
        return ApproachFigures(
            first,
            second,
            at_s=self._at_s,
            distance_m=self._distance_m,
            level_m=self._level_m,
            vertical_m=self._vertical_m,
            separation_m=self._separation_m,
            margin_m=self._margin_m,
        )
