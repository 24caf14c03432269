"""Times for paths: straight lines between timed points, and times for points that have none.

A path without times is flown from rest to rest along each straight leg; at a corner the vehicle stops, because no
motion of bounded acceleration passes a corner without leaving the path. Legs in one line are one leg.

The profile along a leg has a continuous acceleration, zero at both ends of each ramp:

    speed    0 ─ ramp ─ v ─── cruise ─── v ─ ramp ─ 0        ramp: v (3u² - 2u³), u = t/T
    largest acceleration 1.5 v/T, largest jerk 6 v/T², length of a ramp v T/2
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable, Sequence
from typing import NamedTuple

from skygcs.core.trajectory.motion_limits import MotionLimits
from skygcs.core.trajectory.piecewise import MAX_DURATION_S, MIN_PIECE_S, Coefficients, Piece, Trajectory, Vector
from skygcs.errors import TrajectoryError

SAME_PLACE_M = 1e-6
"""Points closer than this are one point."""

SAME_DIRECTION = 1e-6
"""Sine of the angle below which two legs are one: 0.1 mm beside the path in 100 m."""

STANDING_S = 1.0
"""Duration of a path that consists of one place."""


class TimedPoint(NamedTuple):
    """A place and when to be there; ``yaw_rad`` is ENU, None leaves the heading to the autopilot."""

    t_s: float
    pos_enu_m: Vector
    yaw_rad: float | None = None


def hover(pos_enu_m: Vector, duration_s: float, yaw_rad: float | None = None) -> Trajectory:
    """Stand at a place."""
    east, north, up = ((value,) for value in pos_enu_m)
    return Trajectory((Piece(duration_s, east, north, up, None if yaw_rad is None else (yaw_rad,)),))


def straight_lines(points: Sequence[TimedPoint]) -> Trajectory:
    """Join timed points by straight lines at constant speed, and yaws by the shorter turn.

    The vehicle stands at the first point until its time. Raises TrajectoryError; piece n is the line to point n + 1.
    """
    if not points:
        raise TrajectoryError("the path has no points")
    first = points[0]
    if not first.t_s >= 0.0:  # also for NaN
        raise TrajectoryError(f"the first time is {first.t_s:g} s; times begin at 0 or later")
    if len(points) == 1:
        return hover(first.pos_enu_m, max(first.t_s, STANDING_S), first.yaw_rad)
    pieces: list[Piece] = []
    if first.t_s >= MIN_PIECE_S:
        pieces += hover(first.pos_enu_m, first.t_s, first.yaw_rad).pieces
    yaw = first.yaw_rad
    for number, (one, other) in enumerate(itertools.pairwise(points), 1):
        duration = other.t_s - (one.t_s if pieces else 0.0)
        if not duration >= MIN_PIECE_S:  # also for NaN
            raise TrajectoryError(
                f"from {one.t_s:g} s to {other.t_s:g} s; times ascend by at least {MIN_PIECE_S:g} s", piece=number
            )
        east, north, up = ((a, (b - a) / duration) for a, b in zip(one.pos_enu_m, other.pos_enu_m, strict=True))
        turning: Coefficients | None = None
        if (yaw is None) != (other.yaw_rad is None):
            raise TrajectoryError("either every point has a yaw or none", piece=number, axis="yaw")
        if yaw is not None and other.yaw_rad is not None:
            turn = _shorter_turn(yaw, other.yaw_rad, number)
            turning = (yaw, turn / duration)
            yaw += turn
        pieces.append(Piece(duration, east, north, up, turning))
    return Trajectory(pieces)


def _shorter_turn(from_rad: float, to_rad: float, number: int) -> float:
    if not (math.isfinite(from_rad) and math.isfinite(to_rad)):
        raise TrajectoryError(f"a yaw of {to_rad:g}", piece=number, axis="yaw")
    return math.remainder(to_rad - from_rad, math.tau)


# --- paths without times ----------------------------------------------------------------------------------------------


def rest_to_rest(
    distance_m: float, speed_mps: float, acceleration_mps2: float, jerk_mps3: float = math.inf
) -> list[tuple[float, Coefficients]]:
    """(duration, ascending coefficients of the distance flown) of each part of the fastest such profile."""
    v = min(
        speed_mps,
        math.sqrt(distance_m * acceleration_mps2 / 1.5),
        math.cbrt(distance_m * distance_m * jerk_mps3 / 6.0),
    )
    ramp = max(1.5 * v / acceleration_mps2, math.sqrt(6.0 * v / jerk_mps3), MIN_PIECE_S)
    v = min(v, distance_m / ramp)
    cruise = distance_m / v - ramp
    if cruise < MIN_PIECE_S:
        ramp, cruise = distance_m / v, 0.0
    up = v * ramp
    profile: list[tuple[float, Coefficients]] = [(ramp, (0.0, 0.0, 0.0, up / ramp**3, -0.5 * up / ramp**4))]
    flown = 0.5 * up
    if cruise:
        profile.append((cruise, (flown, v)))
        flown += v * cruise
    profile.append((ramp, (flown, v, 0.0, -up / ramp**3, 0.5 * up / ramp**4)))
    return profile


def path_within(points: Sequence[Vector], limits: MotionLimits, yaws_rad: Sequence[float] | None = None) -> Trajectory:
    """Fly straight from point to point within the limits, stopping at corners; yaw turns evenly along each leg.

    Raises TrajectoryError; piece n of its text is the leg to point n + 1.
    """
    if not points:
        raise TrajectoryError("the path has no points")
    if yaws_rad is not None and len(yaws_rad) != len(points):
        raise TrajectoryError(f"{len(yaws_rad)} yaws for {len(points)} points", axis="yaw")
    for number, (point, yaw) in enumerate(zip(points, yaws_rad or (0.0,) * len(points), strict=True)):
        if not all(map(math.isfinite, (*point, yaw))):
            raise TrajectoryError("a coordinate that is not a finite number", piece=max(number, 1))
    pieces: list[Piece] = []
    yaw_now = None if yaws_rad is None else yaws_rad[0]
    for begin, end in _legs(points, split_at_yaw=yaws_rad is not None):
        turn = 0.0 if yaws_rad is None else math.remainder(yaws_rad[end] - (yaw_now or 0.0), math.tau)
        pieces += _leg(points[begin], points[end], limits, None if yaw_now is None else (yaw_now, turn))
        yaw_now = None if yaw_now is None else yaw_now + turn
    if not pieces:
        return hover(points[0], STANDING_S, yaw_now)
    return Trajectory(pieces)


def _legs(points: Sequence[Vector], *, split_at_yaw: bool) -> Iterable[tuple[int, int]]:
    """Indices of the ends of each straight leg."""
    begin, direction, last = 0, None, 0
    for index in range(1, len(points)):
        if math.dist(points[last], points[index]) < SAME_PLACE_M:
            continue
        new = _direction(points[last], points[index])
        if direction is not None and (split_at_yaw or not _same(direction, new)):
            yield begin, last
            begin, direction = last, None
        if direction is None:
            direction = new
        last = index
    if direction is not None:
        yield begin, last


def _direction(p: Vector, q: Vector) -> Vector:
    length = math.dist(p, q)
    east, north, up = ((b - a) / length for a, b in zip(p, q, strict=True))
    return east, north, up


def _same(p: Vector, q: Vector) -> bool:
    """True if two unit vectors point the same way."""
    cross = (p[1] * q[2] - p[2] * q[1], p[2] * q[0] - p[0] * q[2], p[0] * q[1] - p[1] * q[0])
    return math.hypot(*cross) <= SAME_DIRECTION and sum(a * b for a, b in zip(p, q, strict=True)) > 0.0


def _leg(p: Vector, q: Vector, limits: MotionLimits, yaw: tuple[float, float] | None) -> Iterable[Piece]:
    """The pieces of one straight leg; ``yaw`` is the first yaw and the turn."""
    length = math.dist(p, q)
    direction = _direction(p, q)
    speed = limits.speed_mps
    if direction[2]:
        vertical = limits.climb_mps if direction[2] > 0.0 else limits.descent_mps
        speed = min(speed, vertical / abs(direction[2]))
    if length / speed > MAX_DURATION_S:
        raise TrajectoryError(f"a leg of {length:g} m takes longer than {MAX_DURATION_S:g} s")
    for duration, flown in rest_to_rest(length, speed, limits.acceleration_mps2, limits.jerk_mps3):
        axes = [_along(start, factor, flown) for start, factor in zip(p, direction, strict=True)]
        turning = None if yaw is None else _along(yaw[0], yaw[1] / length, flown)
        yield Piece(duration, axes[0], axes[1], axes[2], turning)


def _along(start: float, factor: float, flown: Coefficients) -> Coefficients:
    return (start + factor * flown[0], *(factor * c for c in flown[1:]))
