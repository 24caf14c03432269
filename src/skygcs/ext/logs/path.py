"""The path a vehicle has flown, in a bounded number of points."""

from __future__ import annotations

import math

MOST_POINTS = 500
"""A path is shown as a line: 500 points over a flight of 20 minutes are one every 2.4 s."""

FIRST_SPACING_M = 0.2

Point = tuple[tuple[float, float, float], str]
"""Its place (ENU, metres), and its pose as JSON: the whole path is written again and again."""


class FlownPath:
    """Points at least a spacing apart; whenever there are too many, every other one goes and the spacing doubles."""

    def __init__(self) -> None:
        self.points: list[Point] = []
        self._spacing_m = FIRST_SPACING_M

    def add(self, pos_enu_m: tuple[float, float, float], pose: str) -> None:
        if self.points and math.dist(self.points[-1][0], pos_enu_m) < self._spacing_m:
            return
        self.points.append((pos_enu_m, pose))
        if len(self.points) > MOST_POINTS:
            del self.points[1::2]
            self._spacing_m *= 2
