"""Check whether curves stay within fence, floor and ceiling and out of boxes, at all times and not at samples. numpy.

A piece lies within the box around its Bernstein coefficients (convex hull). With middle c and half diagonal r of that
box, every point of the piece is at least d(c) - r from a wall that is d(c) from c. Pieces for which that does not
decide are halved; a piece smaller than `SMALLEST_M` that is undecided counts as too near.

The fence is a polygon of any shape, the boxes are solid. The margin of a vehicle from walls is its own part of the
margin of a pair; from the floor it keeps no margin, as every flight begins and ends there.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from skygcs.core.plan.fleet_plan import FlightSpace
from skygcs.core.trajectory import Trajectory
from skygcs.ext.plans.certificates.bernstein_arrays import MAX_HALVINGS, Array, Indices, gathered, halved

SMALLEST_M = 1e-5
"""The half diagonal below which a part of a curve is a point."""

FLOOR_TOLERANCE_M = 1e-6

MAX_PARTS = 200_000
"""Parts of curves under examination; beyond it what is undecided counts as too near."""


class Breach(NamedTuple):
    """A vehicle that comes too near to a wall."""

    vehicle: int
    what: str
    distance_m: float
    """From the wall; below 0 beyond it."""
    place_m: tuple[float, float, float]
    t_s: float


class _Wall(NamedTuple):
    """``distance(points)`` is that of points (n, 3) from the wall, negative beyond it."""

    what: str
    margins: bool
    """True if a vehicle keeps its margin from it."""


def breaches(trajectories: Sequence[Trajectory], half_margins_m: Sequence[float], space: FlightSpace) -> list[Breach]:
    """The first breach of each wall by each vehicle. Empty: every vehicle stays within, all the time."""
    if not trajectories:
        return []
    pieces = gathered(trajectories)
    half = np.asarray(half_margins_m, dtype=np.float64)[pieces.vehicle]
    found: list[Breach] = []
    for wall in _walls(space):
        margin = half if wall.margins else np.full_like(half, -FLOOR_TOLERANCE_M)
        parts = _Parts(pieces.bernstein, pieces.vehicle, pieces.begin_s, pieces.end_s, margin + pieces.error_m)
        found += _first_of_each(wall, _too_near(parts, wall, space))
    return found


def _walls(space: FlightSpace) -> list[_Wall]:
    walls = []
    if space.fence:
        walls.append(_Wall("the fence", True))
    if space.ceiling_m is not None:
        walls.append(_Wall("the ceiling", True))
    if space.floor_m is not None:
        walls.append(_Wall("the floor", False))
    return walls + [_Wall(f"box {number}", True) for number in range(1, len(space.boxes) + 1)]


class _Parts(NamedTuple):
    bernstein: Array
    vehicle: Indices
    begin: Array
    end: Array
    margin: Array

    def selected(self, chosen: NDArray[np.bool_]) -> _Parts:
        return _Parts(
            self.bernstein[:, :, chosen],
            self.vehicle[chosen],
            self.begin[chosen],
            self.end[chosen],
            self.margin[chosen],
        )


def _too_near(parts: _Parts, wall: _Wall, space: FlightSpace) -> list[Breach]:
    found: list[Breach] = []
    for _ in range(MAX_HALVINGS):
        low, high = parts.bernstein.min(axis=0), parts.bernstein.max(axis=0)
        middle = 0.5 * (low + high).T
        half_sides = 0.5 * (high - low)
        radius = half_sides[2] if wall.what in ("the ceiling", "the floor") else np.sqrt((half_sides**2).sum(axis=0))
        distance = _distance(wall, space, middle)
        safe = distance - radius >= parts.margin
        # a point of the curve itself that is too near
        ends = parts.bernstein[0].T
        at_begin = _distance(wall, space, ends)
        beyond = (at_begin < parts.margin) | (~safe & (radius < SMALLEST_M))
        for index in np.nonzero(beyond)[0]:
            place = tuple(float(v) for v in ends[index])
            found.append(
                Breach(int(parts.vehicle[index]), wall.what, float(at_begin[index]), place, float(parts.begin[index]))  # type: ignore[arg-type]
            )
        open_ = ~safe & ~beyond
        if not open_.any():
            return found
        parts = _halves(parts.selected(open_))
        if len(parts.vehicle) > MAX_PARTS:
            break
    place = tuple(float(v) for v in parts.bernstein[0, :, 0])
    distance_m = float(_distance(wall, space, parts.bernstein[0].T)[0])
    found.append(Breach(int(parts.vehicle[0]), wall.what, distance_m, place, float(parts.begin[0])))  # type: ignore[arg-type]
    return found


def _halves(parts: _Parts) -> _Parts:
    left, right = halved(parts.bernstein)
    middle = 0.5 * (parts.begin + parts.end)
    return _Parts(
        np.concatenate([left, right], axis=2),
        np.concatenate([parts.vehicle, parts.vehicle]),
        np.concatenate([parts.begin, middle]),
        np.concatenate([middle, parts.end]),
        np.concatenate([parts.margin, parts.margin]),
    )


def _first_of_each(wall: _Wall, found: list[Breach]) -> list[Breach]:
    first: dict[int, Breach] = {}
    for breach in sorted(found, key=lambda breach: breach.t_s):
        first.setdefault(breach.vehicle, breach)
    return list(first.values())


def _distance(wall: _Wall, space: FlightSpace, points: Array) -> Array:
    """Distance of points (n, 3) from the wall, negative beyond it."""
    if wall.what == "the ceiling":
        return np.asarray((space.ceiling_m or 0.0) - points[:, 2])
    if wall.what == "the floor":
        return np.asarray(points[:, 2] - (space.floor_m or 0.0))
    if wall.what == "the fence":
        return _from_fence(np.asarray(space.fence, dtype=np.float64), points[:, :2])
    low, high = (np.asarray(corner) for corner in space.boxes[int(wall.what.removeprefix("box ")) - 1])
    outside = np.maximum(np.maximum(low - points, points - high), 0.0)
    inside = np.minimum(points - low, high - points).min(axis=1)
    return np.asarray(np.where(inside > 0.0, -inside, np.sqrt((outside**2).sum(axis=1))))


def _from_fence(corners: Array, points: Array) -> Array:
    """Distance from the polygon's border, negative outside."""
    nearest = np.full(len(points), np.inf)
    crossings = np.zeros(len(points), dtype=np.intp)
    for begin, end in zip(corners, np.roll(corners, -1, axis=0), strict=True):
        along = end - begin
        square = float(along @ along)
        part = np.clip(((points - begin) @ along) / square, 0.0, 1.0) if square else np.zeros(len(points))
        nearest = np.minimum(nearest, np.sqrt(((points - begin - part[:, None] * along) ** 2).sum(axis=1)))
        if begin[1] != end[1]:  # crossings of a ray to the east
            above = (begin[1] > points[:, 1]) != (end[1] > points[:, 1])
            # the side's part below the point, within [0, 1] where it counts: a slope would overflow on a flat side
            part = np.where(above, points[:, 1] - begin[1], 0.0) / along[1]
            crossings += above & (points[:, 0] < begin[0] + part * along[0])
    return np.where(crossings % 2 == 1, nearest, -nearest)
