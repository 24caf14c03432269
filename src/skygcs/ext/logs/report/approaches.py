"""How near vehicles came to each other, from the positions that they reported. Pure.

Between two positions a vehicle is taken to have flown straight on at one speed, so the nearest place of two is found in
closed form and not only where a position happened to come.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Iterator
from typing import NamedTuple

from skygcs.core.monitor.approach import closest_approach
from skygcs.core.separation import Footprint, pair_margin, separation_m
from skygcs.ext.logs.report.day_figures import ApproachFigures
from skygcs.ext.logs.tables import VehicleKey

Vector = tuple[float, float, float]

LONGEST_LEG_S = 2.5
"""In a longer time between two positions it is not known what a vehicle did; a slow radio brings one a second."""

LEGS = 64
"""The newest of each vehicle that are kept: 2.5 s at 25 Hz."""


class _Leg(NamedTuple):
    """From one position to the next."""

    begin_s: float
    end_s: float
    begin_m: Vector
    vel_mps: Vector

    def at(self, at_s: float) -> Vector:
        past_s = at_s - self.begin_s
        (x, y, z), (u, v, w) = self.begin_m, self.vel_mps
        return x + past_s * u, y + past_s * v, z + past_s * w


class Approaches:
    """`placed` for every position of a vehicle in the air, `left` when it has landed or is no longer recorded."""

    def __init__(self, footprint: Callable[[VehicleKey], Footprint]) -> None:
        self._footprint = footprint
        self._newest: dict[VehicleKey, tuple[float, Vector]] = {}
        self._legs: dict[VehicleKey, deque[_Leg]] = {}
        self._nearest: dict[tuple[VehicleKey, VehicleKey], _Nearest] = {}

    def placed(self, key: VehicleKey, now: float, pos_enu_m: Vector) -> None:
        """It is here at ``now``, which never decreases: compare its leg with those of all others at that time."""
        before = self._newest.get(key)
        self._newest[key] = now, pos_enu_m
        if before is None or not 0.0 < now - before[0] <= LONGEST_LEG_S:
            return
        took_s = now - before[0]
        x, y, z = ((there - here) / took_s for here, there in zip(before[1], pos_enu_m, strict=True))
        leg = _Leg(before[0], now, before[1], (x, y, z))
        for other, legs in self._legs.items():
            if other != key:
                self._compare(key, leg, other, legs)
        self._legs.setdefault(key, deque(maxlen=LEGS)).append(leg)

    def left(self, key: VehicleKey) -> None:
        """Forget a vehicle that flies no longer."""
        self._newest.pop(key, None)
        self._legs.pop(key, None)

    def leave_all(self) -> None:
        """The recording ends here."""
        self._newest.clear()
        self._legs.clear()

    def figures(self) -> list[ApproachFigures]:
        """Every pair that was in the air together; what is left of the margin least, first."""
        found = [nearest.figures(*pair) for pair, nearest in self._nearest.items()]
        return sorted(found, key=lambda a: (a.used, a.first, a.second))

    def _compare(self, key: VehicleKey, leg: _Leg, other: VehicleKey, legs: deque[_Leg]) -> None:
        pair = (key, other) if key < other else (other, key)
        nearest = self._nearest.get(pair)
        for there in _overlapping(leg, legs):
            if nearest is None:
                margin = pair_margin(*map(self._footprint, pair))
                nearest = self._nearest[pair] = _Nearest(margin.total_m, margin.downwash_ratio)
            nearest.take(leg, there)


def _overlapping(leg: _Leg, legs: deque[_Leg]) -> Iterator[_Leg]:
    """Those of another vehicle, which have all ended by now, that share some time with this one."""
    for there in reversed(legs):
        if there.end_s <= leg.begin_s:
            return
        yield there


class _Nearest:
    """The least distances of one pair so far."""

    __slots__ = ("_at_s", "_distance_m", "_level_m", "_margin_m", "_ratio", "_separation_m", "_vertical_m")

    def __init__(self, margin_m: float, downwash_ratio: float) -> None:
        self._margin_m, self._ratio = margin_m, downwash_ratio
        self._distance_m = self._separation_m = math.inf
        self._at_s = self._level_m = self._vertical_m = math.nan

    def take(self, first: _Leg, second: _Leg) -> None:
        """Two legs that share some time; ``first`` ends last."""
        begin_s = max(first.begin_s, second.begin_s)
        took_s = second.end_s - begin_s
        (x, y, z), (a, b, c) = second.at(begin_s), first.at(begin_s)
        x, y, z = x - a, y - b, z - c
        (u, v, w), (a, b, c) = second.vel_mps, first.vel_mps
        u, v, w = u - a, v - b, w - c
        # most legs are too far apart to matter
        reach_m = math.hypot(u, v, w) * took_s
        if math.hypot(x, y, z) - reach_m < self._distance_m:
            least = closest_approach((x, y, z), (u, v, w), 0.0, took_s)
            if least.separation_m < self._distance_m:
                at_s = least.at_s
                self._distance_m, self._at_s = least.separation_m, begin_s + at_s
                self._level_m = math.hypot(x + at_s * u, y + at_s * v)
                self._vertical_m = abs(z + at_s * w)
        ratio = self._ratio
        if separation_m(x, y, z, ratio) - reach_m < self._separation_m:
            scaled = closest_approach((x, y, z / ratio), (u, v, w / ratio), 0.0, took_s)
            self._separation_m = min(self._separation_m, scaled.separation_m)

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
