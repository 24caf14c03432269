"""The smallest box about a trajectory, from outside: no point of it lies beyond, and each side is nearly touched.

As `motion_limits`: Bernstein coefficients bound each piece, and the interval with the largest bound is cut in two until
the bound is within `TOLERANCE_M` of a value that is reached. The bound holds whenever the search ends.
"""

from __future__ import annotations

import heapq
from collections.abc import Sequence
from typing import NamedTuple

from skygcs.core.trajectory.bernstein import error_bound, from_power, halves
from skygcs.core.trajectory.piecewise import Trajectory, Vector

TOLERANCE_M = 1e-3

MAX_CUTS = 1000
"""Cuts of intervals for one side."""


class Box(NamedTuple):
    """Along the axes in which the trajectory is given."""

    least_m: Vector
    most_m: Vector

    def corners(self) -> list[Vector]:
        """All eight."""
        (x0, y0, z0), (x1, y1, z1) = self
        return [(x, y, z) for x in (x0, x1) for y in (y0, y1) for z in (z0, z1)]


def bounding_box(trajectory: Trajectory) -> Box:
    """The box about all positions."""
    sides = [(-_most(trajectory, axis, -1.0), _most(trajectory, axis, 1.0)) for axis in range(3)]
    (x0, x1), (y0, y1), (z0, z1) = sides
    return Box((x0, y0, z0), (x1, y1, z1))


def _most(trajectory: Trajectory, axis: int, sign: float) -> float:
    """A bound of ``sign`` times the coordinate, from above."""
    slack, best = 0.0, float("-inf")
    intervals: list[tuple[float, int, Sequence[float]]] = []
    for number, piece in enumerate(trajectory.pieces):
        coefficients = (piece.east, piece.north, piece.up)[axis]
        slack = max(slack, error_bound(coefficients, piece.duration_s))
        values = [sign * value for value in from_power(coefficients, piece.duration_s)]
        best = max(best, values[0], values[-1])
        intervals.append((-max(values), number, values))
    heapq.heapify(intervals)
    number = len(intervals)
    for _ in range(MAX_CUTS):
        bound, _, widest = intervals[0]
        if -bound <= best + TOLERANCE_M:
            break
        first, second = halves(widest)
        best = max(best, first[-1])
        heapq.heapreplace(intervals, (-max(first), number, first))
        heapq.heappush(intervals, (-max(second), number + 1, second))
        number += 2
    return max(best, -intervals[0][0]) + 2.0 * slack
