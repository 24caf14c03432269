"""Largest speed, acceleration and jerk of a trajectory, exact and not sampled, against the limits of a vehicle; and the
smallest box about it.

The square of the speed is itself a polynomial. Its Bernstein coefficients bound it from above on a whole interval, its
values at the interval's ends from below; the interval with the largest upper bound is cut in two until both agree to
`TOLERANCE`. The upper bound is then raised by what rounding can have cost, so it holds in exact arithmetic.
"""

from __future__ import annotations

import heapq
import math
from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass, replace
from typing import NamedTuple

from skygcs.core.trajectory.piecewise import (
    UNIT_ROUNDOFF,
    Piece,
    Trajectory,
    Vector,
    derivative,
    error_bound,
    from_power,
    halves,
    product,
)
from skygcs.errors import TrajectoryError

TOLERANCE = 1e-6
"""Relative, between the largest value found and the bound that none exceeds."""

BOX_TOLERANCE_M = 1e-3
"""Largest distance from a side of the box to the point of the trajectory that is nearest to it."""

MAX_CUTS = 2000
"""Cuts of intervals for one peak. The bound holds whenever the search ends; with fewer cuts it is only less tight."""

MAX_SPEED_MPS = 100.0
MAX_ACCELERATION_MPS2 = 100.0
"""No multirotor does either; the same as for setpoints."""

SLACK = 1e-6
"""Relative, by which a limit may be exceeded: a profile made for the limit itself touches it."""


@dataclass(frozen=True, slots=True)
class MotionLimits:
    """Limits that a type of vehicle can follow. Raises TrajectoryError for an invalid limit."""

    speed_mps: float = 5.0
    """PX4's MPC_XY_CRUISE and ArduCopter's WPNAV_SPEED in their defaults, rounded down."""
    acceleration_mps2: float = 2.0
    """ArduCopter's WPNAV_ACCEL default is 2.5 m/s²; PX4's MPC_ACC_HOR is 3."""
    jerk_mps3: float = 4.0
    """PX4's MPC_JERK_AUTO default."""
    climb_mps: float = 2.0
    descent_mps: float = 1.5
    """ArduCopter's WPNAV_SPEED_DN and PX4's MPC_Z_V_AUTO_DN defaults."""

    def __post_init__(self) -> None:
        for name, largest in (
            ("speed_mps", MAX_SPEED_MPS),
            ("acceleration_mps2", MAX_ACCELERATION_MPS2),
            ("jerk_mps3", math.inf),
            ("climb_mps", MAX_SPEED_MPS),
            ("descent_mps", MAX_SPEED_MPS),
        ):
            value = getattr(self, name)
            if not 1e-3 <= value <= largest:  # also for NaN
                raise TrajectoryError(f"the limit {name} of {value:g} is not between 0.001 and {largest:g}")


def within_at_speed(limits: MotionLimits, speed_factor: float) -> MotionLimits:
    """Return limits for a trajectory that a faster clock flies ``speed_factor`` times as fast, within ``limits`` of
    acceleration and jerk as it is flown then: they grow with the square and the cube of the factor. A slower clock
    changes nothing."""
    f = max(1.0, speed_factor)
    return replace(limits, acceleration_mps2=limits.acceleration_mps2 / f**2, jerk_mps3=limits.jerk_mps3 / f**3)


def least_limits(limits: Iterable[MotionLimits]) -> MotionLimits:
    """Return what all of them can follow; the defaults of none."""
    given = [asdict(one) for one in limits]
    return MotionLimits(**{key: min(one[key] for one in given) for key in given[0]}) if given else MotionLimits()


class Peak(NamedTuple):
    """The largest value lies between the two; ``piece`` (from 1) and ``t_s`` say where ``at_least`` is reached."""

    at_least: float
    at_most: float
    piece: int
    t_s: float


class MotionPeaks(NamedTuple):
    """Largest values of a whole trajectory."""

    speed_mps: Peak
    acceleration_mps2: Peak
    jerk_mps3: Peak
    climb_mps: Peak
    descent_mps: Peak


def motion_peaks(trajectory: Trajectory) -> MotionPeaks:
    """The largest speed, acceleration, jerk, climb and descent rate. Jumps between pieces are no part of them."""
    return MotionPeaks(
        _largest_norm(trajectory, 1),
        _largest_norm(trajectory, 2),
        _largest_norm(trajectory, 3),
        _largest_rate(trajectory, 1.0),
        _largest_rate(trajectory, -1.0),
    )


def require_within(trajectory: Trajectory, limits: MotionLimits) -> MotionPeaks:
    """Return the peaks. Raises TrajectoryError where a limit is exceeded."""
    peaks = motion_peaks(trajectory)
    for what, unit, peak, limit, axis in (
        ("speed", "m/s", peaks.speed_mps, limits.speed_mps, None),
        ("climb rate", "m/s", peaks.climb_mps, limits.climb_mps, "up"),
        ("descent rate", "m/s", peaks.descent_mps, limits.descent_mps, "up"),
        ("acceleration", "m/s²", peaks.acceleration_mps2, limits.acceleration_mps2, None),
        ("jerk", "m/s³", peaks.jerk_mps3, limits.jerk_mps3, None),
    ):
        if not peak.at_most <= limit * (1.0 + SLACK):  # also for NaN
            raise TrajectoryError(
                f"{what} of {peak.at_most:.4g} {unit} at {peak.t_s:.4g} s; the limit is {limit:g} {unit}",
                piece=peak.piece,
                axis=axis,
            )
    return peaks


class Box(NamedTuple):
    """A box along the axes in which the trajectory is given."""

    least_m: Vector
    most_m: Vector

    def corners(self) -> list[Vector]:
        """All eight corners."""
        (x0, y0, z0), (x1, y1, z1) = self
        return [(x, y, z) for x in (x0, x1) for y in (y0, y1) for z in (z0, z1)]


def bounding_box(trajectory: Trajectory) -> Box:
    """The smallest box about all positions, from outside."""
    sides = [(-_farthest(trajectory, axis, -1.0), _farthest(trajectory, axis, 1.0)) for axis in range(3)]
    (x0, x1), (y0, y1), (z0, z1) = sides
    return Box((x0, y0, z0), (x1, y1, z1))


# --- search -----------------------------------------------------------------------------------------------------------


class _Interval(NamedTuple):
    """Sorted by bound, the largest first."""

    minus_bound: float
    piece: int
    begin: float
    """In the trajectory's seconds, as the length."""
    length_s: float
    bernstein: Sequence[float]


def _largest_norm(trajectory: Trajectory, order: int) -> Peak:
    """The largest norm of the ``order``-th derivative of the position."""
    intervals, norm_error, square_error = [], 0.0, 0.0
    for number, (piece, begin) in enumerate(zip(trajectory.pieces, trajectory.begins_s, strict=True), 1):
        square, of_norm, of_square = _square_of_derivative(piece, order)
        norm_error, square_error = max(norm_error, of_norm), max(square_error, of_square)
        intervals.append(_Interval(-max(square), number, begin, piece.duration_s, square))
    found = _maximum(intervals)
    at_most = math.sqrt(max(found.at_most, 0.0) + square_error) + norm_error
    return Peak(math.sqrt(max(found.at_least, 0.0)), at_most * (1.0 + 4.0 * UNIT_ROUNDOFF), found.piece, found.t_s)


def _square_of_derivative(piece: Piece, order: int) -> tuple[list[float], float, float]:
    """Bernstein coefficients of the squared norm, and by how much rounding can make norm and square too small.

    Each differencing multiplies the error of a coefficient by 2n/T. The product and the cuts work with weights that sum
    to 1 on squares of at most max|b|²; their rounding, at most 16 operations for the product and 28 for each of at most
    100 cuts in a row, is below 1e-12 of that.
    """
    n = max(len(c) for c in (piece.east, piece.north, piece.up)) - 1
    total = [0.0] * (2 * max(n - order, 0) + 1)
    squared_error = largest = 0.0
    for coefficients in (piece.east, piece.north, piece.up):
        padded = (*coefficients, *(0.0,) * (n + 1 - len(coefficients)))
        error = error_bound(padded, piece.duration_s)
        values = from_power(padded, piece.duration_s)
        for step in range(order):
            error *= 2.0 * max(n - step, 1) / piece.duration_s * (1.0 + 8.0 * UNIT_ROUNDOFF)
            values = derivative(values, piece.duration_s)
            error += 4.0 * UNIT_ROUNDOFF * max(map(abs, values))
        squared_error += error * error
        largest += max(map(abs, values)) ** 2
        total = [a + b for a, b in zip(total, product(values, values), strict=True)]
    return total, math.sqrt(squared_error), 1e-12 * largest


def _largest_rate(trajectory: Trajectory, sign: float) -> Peak:
    """The largest climb (sign 1) or descent rate (sign -1); 0 for a trajectory that never climbs or descends."""
    intervals, slack = [], 0.0
    for number, (piece, begin) in enumerate(zip(trajectory.pieces, trajectory.begins_s, strict=True), 1):
        n = max(len(piece.up) - 1, 1)
        slack = max(slack, 3.0 * n / piece.duration_s * error_bound(piece.up, piece.duration_s))
        rates = derivative(from_power(piece.up, piece.duration_s), piece.duration_s)
        rates = [sign * rate for rate in rates]
        intervals.append(_Interval(-max(rates), number, begin, piece.duration_s, rates))
    found = _maximum(intervals)
    at_most = max(found.at_most + slack + 1e-12 * abs(found.at_most), 0.0)
    return Peak(max(found.at_least, 0.0), at_most, found.piece, found.t_s)


def _farthest(trajectory: Trajectory, axis: int, sign: float) -> float:
    """A bound of ``sign`` times the coordinate, from above."""
    intervals, slack = [], 0.0
    for number, (piece, begin) in enumerate(zip(trajectory.pieces, trajectory.begins_s, strict=True), 1):
        coefficients = (piece.east, piece.north, piece.up)[axis]
        slack = max(slack, error_bound(coefficients, piece.duration_s))
        values = [sign * value for value in from_power(coefficients, piece.duration_s)]
        intervals.append(_Interval(-max(values), number, begin, piece.duration_s, values))
    return _maximum(intervals, BOX_TOLERANCE_M).at_most + 2.0 * slack


def _maximum(intervals: list[_Interval], tolerance: float = 0.0) -> Peak:
    """The largest value of polynomials in Bernstein form on their intervals, from below and from above: within
    `TOLERANCE` or the absolute ``tolerance``, if that is more."""
    heapq.heapify(intervals)
    best, piece, t_s = -math.inf, 0, 0.0
    for interval in intervals:
        best, piece, t_s = max((best, piece, t_s), _ends(interval))
    for _ in range(MAX_CUTS):
        top = intervals[0]
        if -top.minus_bound <= best + max(TOLERANCE * abs(best), tolerance):
            break
        half = top.length_s / 2.0
        for part, begin in zip(halves(top.bernstein), (top.begin, top.begin + half), strict=True):
            interval = _Interval(-max(part), top.piece, begin, half, part)
            best, piece, t_s = max((best, piece, t_s), _ends(interval))
            if begin == top.begin:
                heapq.heapreplace(intervals, interval)
            else:
                heapq.heappush(intervals, interval)
    return Peak(best, max(best, -intervals[0].minus_bound), piece, t_s)


def _ends(interval: _Interval) -> tuple[float, int, float]:
    """The larger of the values at the two ends, and where it is."""
    first, last = interval.bernstein[0], interval.bernstein[-1]
    if first >= last:
        return first, interval.piece, interval.begin
    return last, interval.piece, interval.begin + interval.length_s
