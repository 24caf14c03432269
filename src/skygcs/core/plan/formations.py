"""Formations: places of n vehicles about a middle, moved, turned and scaled.

    line     beside each other, across the heading         grid     rows and columns, the front row full
    column   behind each other, along the heading          circle   evenly around, the first ahead
    V        the first at the point, ahead                 points   from a file, as they are

``spacing_m`` is the least distance between neighbours. The heading is ENU yaw: 0 looks along x. The middle of the
places is the middle of the formation, so turning and scaling keep it. Pure geometry: no vehicle is assigned to a place.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

from skygcs.core.plan.file_reading import MAX_VEHICLES
from skygcs.core.trajectory.piecewise import MAX_POSITION_M, Vector
from skygcs.errors import RefusedError

SHAPES = ("line", "column", "v", "circle", "grid")

MAX_SPACING_M = 1000.0

V_ANGLE_RAD = math.radians(35.0)
"""Between an arm of the V and the line it flies along."""

Flat = tuple[float, float]


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
    if not points_m:
        raise RefusedError("a formation has one point at least")
    if not (0.01 <= scale <= 100.0 and math.isfinite(yaw_rad)):  # also for NaN
        raise RefusedError(f"a scale of {scale:g} is not between 0.01 and 100, or a yaw of {yaw_rad:g} is no angle")
    n = len(points_m)
    middle = [sum(point[k] for point in points_m) / n for k in range(3)]
    cos, sin = math.cos(yaw_rad) * scale, math.sin(yaw_rad) * scale
    found = []
    for point in points_m:
        x, y, z = (point[k] - middle[k] for k in range(3))
        place = (middle_m[0] + cos * x - sin * y, middle_m[1] + sin * x + cos * y, middle_m[2] + scale * z)
        if not all(abs(value) <= MAX_POSITION_M for value in place):  # also for NaN
            raise RefusedError(f"a place of the formation is not within ±{MAX_POSITION_M:g} m")
        found.append(place)
    return found


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
