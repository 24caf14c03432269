"""Formations: places of n vehicles about a middle, moved, turned and scaled.

    line     beside each other, across the heading         grid     rows and columns, the front row full
    column   behind each other, along the heading          circle   evenly around, the first ahead
    V        the first at the point, ahead                 points   given ones, of a file for example
                                                           current  where the vehicles are, each keeps its place in it

``spacing_m`` is the least distance between neighbours of a shape. The heading is ENU yaw: 0 looks along x, and leaves
points as they were given. The middle of the places is the middle of the formation, so turning and scaling keep it.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from skygcs.core.plan.file_reading import MAX_VEHICLES
from skygcs.core.trajectory.piecewise import MAX_POSITION_M, Vector
from skygcs.errors import RefusedError

SHAPES = ("line", "column", "v", "circle", "grid")

POINTS, CURRENT = "points", "current"

MAX_SPACING_M = 1000.0

V_ANGLE_RAD = math.radians(35.0)
"""Between an arm of the V and the line it flies along."""

Flat = tuple[float, float]


@dataclass(frozen=True, slots=True)
class WantedFormation:
    """A formation that vehicles are to take. ``shape``: one of `SHAPES`, `POINTS` or `CURRENT`."""

    shape: str
    middle_m: Vector | None = None
    """None: where the middle of the points, or of the vehicles, is."""
    yaw_rad: float = 0.0
    """Heading of a shape; by how much points are turned, counter-clockwise seen from above."""
    scale: float = 1.0
    spacing_m: float = 5.0
    """Least distance between neighbours of a shape."""
    points_m: tuple[Vector, ...] = ()
    """Places of `POINTS`: one for each vehicle."""

    @property
    def exchangeable(self) -> bool:
        """True if any vehicle may take any place; in the current formation each keeps its own."""
        return self.shape != CURRENT

    def places(self, names: Sequence[str], starts: Mapping[str, Vector]) -> dict[str, Vector]:
        """A place for each vehicle; ``starts`` is where they are. Raises RefusedError."""
        if self.points_m and self.shape != POINTS:
            raise RefusedError(f"points are for the formation {POINTS!r}, not for {self.shape[:40]!r}")
        if self.shape in SHAPES:
            if self.middle_m is None:
                raise RefusedError(f"a {self.shape} needs its middle")
            middle, spacing_m = self.middle_m, self.spacing_m * self.scale
            return dict(zip(names, formation(self.shape, len(names), spacing_m, middle, self.yaw_rad), strict=True))
        if self.shape == CURRENT:
            if unknown := [name for name in names if name not in starts]:
                raise RefusedError(f"{unknown[0]}: its place in the current formation is not known")
            points: Sequence[Vector] = [starts[name] for name in names]
        elif self.shape == POINTS:
            points = self.points_m
        else:
            known = ", ".join((*SHAPES, POINTS, CURRENT))
            raise RefusedError(f"no formation {self.shape[:40]!r}; there are {known}")
        if len(points) != len(names):
            raise RefusedError(f"{len(points)} points for {len(names)} vehicles; it takes one for each")
        middle = middle_of(points) if self.middle_m is None else self.middle_m
        return dict(zip(names, placed(points, middle, self.yaw_rad, self.scale), strict=True))


def formation(
    shape: str, count: int, spacing_m: float, middle_m: Vector = (0.0, 0.0, 0.0), yaw_rad: float = 0.0
) -> list[Vector]:
    """Places of ``count`` vehicles. Raises RefusedError."""
    if not 1 <= count <= MAX_VEHICLES:
        raise RefusedError(f"a formation of {count} vehicles; there are 1 to {MAX_VEHICLES}")
    if not 0.1 <= spacing_m <= MAX_SPACING_M:  # also for NaN
        raise RefusedError(f"a spacing of {spacing_m:g} m is not between 0.1 and {MAX_SPACING_M:g} m")
    flat = _shape(shape, count)
    return placed([(x * spacing_m, y * spacing_m, 0.0) for x, y in flat], middle_m, yaw_rad)


def placed(
    points_m: Sequence[Vector], middle_m: Vector = (0.0, 0.0, 0.0), yaw_rad: float = 0.0, scale: float = 1.0
) -> list[Vector]:
    """The points with their middle moved to ``middle_m``, turned by ``yaw_rad`` and scaled. Raises RefusedError."""
    if not (0.01 <= scale <= 100.0 and math.isfinite(yaw_rad)):  # also for NaN
        raise RefusedError(f"a scale of {scale:g} is not between 0.01 and 100, or a yaw of {yaw_rad:g} is not an angle")
    middle = middle_of(points_m)
    cos, sin = math.cos(yaw_rad) * scale, math.sin(yaw_rad) * scale
    found = []
    for point in points_m:
        x, y, z = (point[k] - middle[k] for k in range(3))
        place = (middle_m[0] + cos * x - sin * y, middle_m[1] + sin * x + cos * y, middle_m[2] + scale * z)
        if not all(abs(value) <= MAX_POSITION_M for value in place):  # also for NaN
            raise RefusedError(f"a place of the formation is not within ±{MAX_POSITION_M:g} m")
        found.append(place)
    return found


def middle_of(points_m: Sequence[Vector]) -> Vector:
    """The mean of one point or more. Raises RefusedError."""
    if not points_m:
        raise RefusedError("a formation has one point at least")
    x, y, z = (math.fsum(point[k] for point in points_m) / len(points_m) for k in range(3))
    return x, y, z


def _shape(shape: str, count: int) -> list[Flat]:
    """Places with neighbours 1 apart, x ahead and y to the left."""
    match shape.lower():
        case "line":
            return [(0.0, -float(i)) for i in range(count)]
        case "column":
            return [(-float(i), 0.0) for i in range(count)]
        case "v":
            return _wings(count)
        case "circle":
            radius = 0.0 if count == 1 else 0.5 / math.sin(math.pi / count)
            turns = [math.tau * i / count for i in range(count)]
            return [(radius * math.cos(turn), radius * math.sin(turn)) for turn in turns]
        case "grid":
            width = math.ceil(math.sqrt(count))
            return [(-float(i // width), -float(i % width)) for i in range(count)]
    raise RefusedError(f"no formation {shape[:40]!r}; there are {', '.join(SHAPES)}")


def _wings(count: int) -> list[Flat]:
    found = [(0.0, 0.0)]
    for i in range(1, count):
        step, side = (i + 1) // 2, 1.0 if i % 2 else -1.0
        found.append((-step * math.cos(V_ANGLE_RAD), side * step * math.sin(V_ANGLE_RAD)))
    return found
