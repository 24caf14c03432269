"""The waypoints of QGroundControl's structure scan.

For surveys and corridors a plan stores the waypoints; for a structure scan it stores the outline, the distance from it
and the layers, from which the waypoints are computed. The pattern is that of QGroundControl (StructureScanComplexItem,
file version 3): fly to the entrance, turn the camera towards the structure, fly along the outline once per layer with
the camera triggering, turn the camera back, leave.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from skygcs.core.geo import EARTH_RADIUS_M
from skygcs.core.mavlink import mav_cmd
from skygcs.core.mission.item import MISSION_FRAME, RELATIVE_ALT, MissionItem

Point = tuple[float, float]

YAW_TO_STRUCTURE_DEG = 90.0
"""The outline is flown clockwise, with the structure to the right."""

MAX_LAYERS = 1000
"""More than any structure needs; a bound for files with values such as 1e9."""

PARALLEL = 1e-9
"""Sine of the angle below which two edges count as one line."""


@dataclass(frozen=True, slots=True)
class StructureScan:
    """Lengths in metres, heights above home, angles in degrees. ``outline``: (lat_deg, lon_deg) of its corners."""

    outline: tuple[Point, ...]
    distance_m: float
    layers: int
    layer_height_m: float
    trigger_distance_m: float
    entrance_height_m: float
    bottom_height_m: float
    top_height_m: float
    from_top: bool
    gimbal_pitch_deg: float = 0.0


def structure_items(scan: StructureScan) -> tuple[MissionItem, ...]:
    """The scan's items. Raises ValueError for an impossible outline and for more than MAX_LAYERS."""
    if not 0 < scan.layers <= MAX_LAYERS:
        raise ValueError(f"{scan.layers} layers are not between 1 and {MAX_LAYERS}")
    path = offset_outline(scan.outline, scan.distance_m)
    entrance = _waypoint(path[0], scan.entrance_height_m)
    items = [
        entrance,
        _action(mav_cmd.DO_SET_ROI_WPNEXT_OFFSET, 0.0, 0.0, scan.gimbal_pitch_deg, YAW_TO_STRUCTURE_DEG),
    ]
    step_m = -scan.layer_height_m if scan.from_top else scan.layer_height_m
    height_m = (scan.top_height_m if scan.from_top else scan.bottom_height_m) + step_m / 2
    for _ in range(scan.layers):
        first, *rest = (_waypoint(corner, height_m) for corner in (*path, path[0]))
        items += [
            first,
            _action(mav_cmd.DO_SET_CAM_TRIGG_DIST, scan.trigger_distance_m, 1.0),
            *rest,
            _action(mav_cmd.DO_SET_CAM_TRIGG_DIST),
        ]
        height_m += step_m
    return (*items, _action(mav_cmd.DO_SET_ROI_NONE), entrance)


def offset_outline(outline: Sequence[Point], distance_m: float) -> tuple[Point, ...]:
    """The polygon moved outwards by a distance, clockwise, beginning with the outline's first corner.

    Plane geometry around that corner. Raises ValueError for fewer than three corners, or corners without an area.
    """
    if len(outline) < 3:
        raise ValueError(f"the outline has {len(outline)} corners, not three or more")
    lat0, lon0 = outline[0]
    per_deg = math.radians(EARTH_RADIUS_M)
    shrink = math.cos(math.radians(lat0))
    corners = [((lon - lon0) * per_deg * shrink, (lat - lat0) * per_deg) for lat, lon in outline]
    twice_area = sum(ax * by - bx * ay for (ax, ay), (bx, by) in zip(corners, [*corners[1:], corners[0]], strict=True))
    if abs(twice_area) < 1e-3:
        raise ValueError("the outline's corners lie in one line")
    if twice_area > 0:  # counter-clockwise: reversed, or outwards would be inwards
        corners = [corners[0], *corners[:0:-1]]
    moved = [
        _moved(corners[n - 1], corners[n], corners[(n + 1) % len(corners)], distance_m) for n in range(len(corners))
    ]
    return tuple((lat0 + y / per_deg, lon0 + x / (per_deg * shrink)) for x, y in moved)


def _moved(before: Point, corner: Point, after: Point, distance_m: float) -> Point:
    """The intersection of the two edges at a corner after both are moved to the left of their (clockwise) direction."""
    ux, uy = _unit(before, corner)
    vx, vy = _unit(corner, after)
    cross = ux * vy - uy * vx
    px, py = corner[0] - uy * distance_m, corner[1] + ux * distance_m
    if abs(cross) < PARALLEL:
        return px, py
    qx, qy = corner[0] - vy * distance_m, corner[1] + vx * distance_m
    along = ((qx - px) * vy - (qy - py) * vx) / cross
    return px + along * ux, py + along * uy


def _unit(a: Point, b: Point) -> Point:
    dx, dy = b[0] - a[0], b[1] - a[1]
    length = math.hypot(dx, dy)
    if length == 0.0:
        raise ValueError("the outline has the same corner twice in a row")
    return dx / length, dy / length


def _waypoint(place: Point, height_m: float) -> MissionItem:
    return MissionItem.from_params(mav_cmd.NAV_WAYPOINT, RELATIVE_ALT, (0.0, 0.0, 0.0, None, *place, height_m), True)


def _action(command: int, p1: float = 0.0, p3: float = 0.0, p5: float = 0.0, p7: float = 0.0) -> MissionItem:
    return MissionItem.from_params(command, MISSION_FRAME, (p1, 0.0, p3, 0.0, p5, 0.0, p7), True)
