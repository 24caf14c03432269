"""A geofence of polygons and circles: its form as mission items (MAV_CMD 5000 to 5004), checks of its shapes, and which
positions they contain.

A polygon is one item per corner; param1 of each is the number of corners. Nothing else separates one polygon from the
next, so a wrong count would make another fence of the same items. It is refused here.

Shapes are checked by plane geometry in metres around a corner of the fence: over the kilometres of a flying site the
error is a millionth.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from skygcs.core.geo import EARTH_RADIUS_M
from skygcs.core.mavlink import mav_cmd
from skygcs.core.mission.item import GLOBAL, RELATIVE_ALT, MissionItem, file_number, float32, wire_int

# --- items ------------------------------------------------------------------------------------------------------------

Corner = tuple[float, float]
"""(lat_deg, lon_deg), rounded to the 1e-7 degrees of the wire."""


@dataclass(frozen=True, slots=True)
class FencePolygon:
    """The vehicle stays inside (``inclusion``) or outside. Closed automatically: the first corner is not repeated."""

    inclusion: bool
    corners: tuple[Corner, ...]

    def __post_init__(self) -> None:
        object.__setattr__(self, "corners", tuple(on_grid(lat, lon) for lat, lon in self.corners))


@dataclass(frozen=True, slots=True)
class FenceCircle:
    inclusion: bool
    center: Corner
    radius_m: float

    def __post_init__(self) -> None:
        object.__setattr__(self, "center", on_grid(*self.center))
        object.__setattr__(self, "radius_m", float32(self.radius_m, "radius") or 0.0)


@dataclass(frozen=True, slots=True)
class FencePlan:
    """``return_point``: (lat_deg, lon_deg, height above home in metres) to fly to after a breach, or None."""

    polygons: tuple[FencePolygon, ...] = ()
    circles: tuple[FenceCircle, ...] = ()
    return_point: tuple[float, float, float] | None = None

    def __bool__(self) -> bool:
        return bool(self.polygons or self.circles or self.return_point)


def on_grid(lat_deg: float, lon_deg: float) -> Corner:
    """The nearest position that the wire can carry. Raises ValueError for NaN and for positions not on earth."""
    for name, value, most in (("latitude", lat_deg, 90.0), ("longitude", lon_deg, 180.0)):
        if not -most <= value <= most:
            raise ValueError(f"{name} {value} is not between -{most:g} and {most:g}")
    return round(lat_deg * 1e7) / 1e7, round(lon_deg * 1e7) / 1e7


def fence_items(fence: FencePlan) -> tuple[MissionItem, ...]:
    """The items of the fence for the upload."""
    items = []
    for polygon in fence.polygons:
        command = (
            mav_cmd.NAV_FENCE_POLYGON_VERTEX_INCLUSION
            if polygon.inclusion
            else mav_cmd.NAV_FENCE_POLYGON_VERTEX_EXCLUSION
        )
        items += [_item(command, float(len(polygon.corners)), corner) for corner in polygon.corners]
    for circle in fence.circles:
        command = mav_cmd.NAV_FENCE_CIRCLE_INCLUSION if circle.inclusion else mav_cmd.NAV_FENCE_CIRCLE_EXCLUSION
        items.append(_item(command, circle.radius_m, circle.center))
    if fence.return_point is not None:
        lat, lon, height_m = fence.return_point
        items.append(_item(mav_cmd.NAV_FENCE_RETURN_POINT, 0.0, (lat, lon), RELATIVE_ALT, height_m))
    return tuple(items)


def fence_from_items(items: Sequence[MissionItem], first: int = 1) -> FencePlan:
    """The inverse of `fence_items`. Raises ValueError naming the item; the first item has the number ``first``."""
    polygons: list[FencePolygon] = []
    circles: list[FenceCircle] = []
    return_point: tuple[float, float, float] | None = None
    at = 0
    while at < len(items):
        item, number = items[at], first + at
        try:
            match item.command:
                case mav_cmd.NAV_FENCE_POLYGON_VERTEX_INCLUSION | mav_cmd.NAV_FENCE_POLYGON_VERTEX_EXCLUSION:
                    corners = _corners(items, at)
                    polygons.append(FencePolygon(item.command == mav_cmd.NAV_FENCE_POLYGON_VERTEX_INCLUSION, corners))
                    at += len(corners)
                    continue
                case mav_cmd.NAV_FENCE_CIRCLE_INCLUSION | mav_cmd.NAV_FENCE_CIRCLE_EXCLUSION:
                    inclusion = item.command == mav_cmd.NAV_FENCE_CIRCLE_INCLUSION
                    circles.append(FenceCircle(inclusion, _corner(item), item.params[0] or 0.0))
                case mav_cmd.NAV_FENCE_RETURN_POINT:
                    return_point = (*_corner(item), item.z or 0.0)
                case _:
                    raise ValueError(f"command {item.command} does not belong in a fence")
        except ValueError as error:
            raise ValueError(f"fence item {number}: {error}") from None
        at += 1
    return FencePlan(tuple(polygons), tuple(circles), return_point)


def _corners(items: Sequence[MissionItem], at: int) -> tuple[Corner, ...]:
    """The corners of the polygon that begins at this item."""
    begin = items[at]
    count = begin.params[0]
    if count is None or count < 1 or count != int(count):
        raise ValueError(f"param1 of a polygon's corner must be the number of corners, not {count}")
    members = items[at : at + int(count)]
    same = [m for m in members if m.command == begin.command and m.params[0] == count]
    if len(same) < count:
        raise ValueError(f"the fence is not closed: this polygon has {count:g} corners by param1, and {len(same)} came")
    return tuple(_corner(member) for member in members)


def _corner(item: MissionItem) -> Corner:
    lat, lon = file_number(GLOBAL, item.x), file_number(GLOBAL, item.y)
    if lat is None or lon is None:
        raise ValueError("has no latitude and longitude")
    return on_grid(lat, lon)


def _item(command: int, param1: float, corner: Corner, frame: int = GLOBAL, z: float = 0.0) -> MissionItem:
    x, y = wire_int(frame, corner[0], "latitude"), wire_int(frame, corner[1], "longitude")
    return MissionItem(command, frame, (param1, 0.0, 0.0, 0.0), x, y, z)


# --- checks -----------------------------------------------------------------------------------------------------------


Point = tuple[float, float]

MIN_AREA_M2 = 1.0
"""A polygon with a smaller area is a mistake."""

MAX_RADIUS_M = 100_000.0
"""No fence of a small vehicle is larger; a radius in millimetres or of 1e9 is a mistake."""

MAX_CORNERS = 1000
"""Corners of one polygon: the check for self-intersection compares every pair of edges. ArduPilot stores far fewer."""


def fence_problems(fence: FencePlan) -> Iterator[tuple[str, str, bool]]:
    """(shape, problem, True for an error); the name of a shape includes the items it is uploaded as."""
    item = 1
    for n, polygon in enumerate(fence.polygons, 1):
        count = len(polygon.corners)
        name = f"polygon {n} (item {item})" if count < 2 else f"polygon {n} (items {item} to {item + count - 1})"
        for is_error, text in _polygon_problems(polygon):
            yield name, text, is_error
        item += count
    for n, circle in enumerate(fence.circles, 1):
        if not 0 < circle.radius_m <= MAX_RADIUS_M:
            text = f"a radius of {circle.radius_m:g} m is not between 0 and {MAX_RADIUS_M:g} m"
            yield f"circle {n} (item {item})", text, True
        item += 1


def _polygon_problems(polygon: FencePolygon) -> Iterator[tuple[bool, str]]:
    corners = list(polygon.corners)
    if len(corners) > MAX_CORNERS:
        yield True, f"{len(corners)} corners are more than {MAX_CORNERS}"
        return
    distinct = len(set(corners))
    if distinct < 3:
        yield (
            True,
            f"is not closed: it has {distinct} different corner{'s' if distinct != 1 else ''}, not three or more",
        )
        return
    if corners[0] == corners[-1]:
        yield False, "the last corner repeats the first one; a polygon is closed automatically"
        corners.pop()
    repeated = next((n for n in range(1, len(corners)) if corners[n] == corners[n - 1]), None)
    if repeated is not None:
        yield False, f"corner {repeated + 1} is at the same place as corner {repeated}"
        corners = [c for n, c in enumerate(corners) if n == 0 or c != corners[n - 1]]
    plane = _Plane(corners[0])
    points = [plane.xy(corner) for corner in corners]
    if crossing := _self_crossing(points):
        a, b = crossing
        yield True, f"crosses itself: the edges from corner {a + 1} and from corner {b + 1} meet"
    elif abs(_area_m2(points)) < MIN_AREA_M2:
        yield True, f"encloses {abs(_area_m2(points)):.2g} m²: its corners lie in one line"


NEAR_STEP_M = 0.25
"""Distance between the places of a way that are compared with a fence that is near."""

MOST_DISTANCES = 300_000
"""From places of a way to sides of a fence: 0.2 s of work."""


class FenceArea:
    """The permitted area. ``any_inclusion``: a position inside one of several inclusion shapes is permitted, as for a
    PX4; else it must be inside all of them, as for an ArduPilot by default."""

    def __init__(self, fence: FencePlan, *, any_inclusion: bool) -> None:
        first = fence.polygons[0].corners[0] if fence.polygons else (0.0, 0.0)
        if not fence.polygons and fence.circles:
            first = fence.circles[0].center
        self._plane = _Plane(first)
        self._any = any_inclusion
        self._polygons = [
            (f"polygon {n}", p.inclusion, [self._plane.xy(c) for c in p.corners])
            for n, p in enumerate(fence.polygons, 1)
        ]
        self._circles = [
            (f"circle {n}", c.inclusion, self._plane.xy(c.center), c.radius_m) for n, c in enumerate(fence.circles, 1)
        ]

    def conflict(self, place: Corner) -> str | None:
        """Why a position is not permitted; None if it is."""
        point = self._plane.xy(place)
        held = [(name, inclusion, inside_polygon(point, corners)) for name, inclusion, corners in self._polygons]
        held += [(n, inclusion, math.dist(point, center) <= r) for n, inclusion, center, r in self._circles]
        for name, inclusion, inside in held:
            if not inclusion and inside:
                return f"is inside the exclusion {name}"
        inclusions = [(name, inside) for name, inclusion, inside in held if inclusion]
        outside = [name for name, inside in inclusions if not inside]
        if outside and not (self._any and len(outside) < len(inclusions)):
            return f"is outside the inclusion {', '.join(outside)}"
        return None

    @property
    def edges(self) -> int:
        """Sides of polygons, and circles."""
        return sum(len(corners) for _, _, corners in self._polygons) + len(self._circles)

    def room_m(self, place: Corner) -> tuple[float, str]:
        """Distance from a position to the nearest place that is not permitted, and the fence of that place; negative if
        the position itself is not permitted."""
        return self._room_m(self._plane.xy(place))

    def narrowest(self, path: Sequence[Corner], room_m: float) -> tuple[float, str] | None:
        """The narrowest place on the way along straight lines between these positions: its room, and beside which
        shape; None: there is ``room_m`` everywhere.

        Nothing between the places that are looked at is missed: the room changes by no more than the way, so the next
        one is as far on as there is room. Where there is hardly any, places are `NEAR_STEP_M` apart, or farther on a
        long way along a large fence, and half of that is asked for in addition.
        """
        points = [self._plane.xy(place) for place in path]
        length_m = math.fsum(map(math.dist, points, points[1:]))
        step_m = max(NEAR_STEP_M, length_m * self.edges / MOST_DISTANCES)
        skip_m, least_m, beside = 0.0, room_m + step_m / 2, ""
        for a, b in zip(points, points[1:] or points, strict=False):
            leg_m = math.dist(a, b)
            at_m = skip_m
            while at_m <= leg_m:
                part = at_m / leg_m if leg_m else 0.0
                here = (a[0] + part * (b[0] - a[0]), a[1] + part * (b[1] - a[1]))
                found_m, shape = self._room_m(here)
                if found_m < least_m:
                    least_m, beside = found_m, shape
                at_m += max(step_m, found_m - least_m)
            skip_m = at_m - leg_m
        return (least_m, beside) if beside else None

    def _room_m(self, point: Point) -> tuple[float, str]:
        inclusions: list[tuple[float, str]] = []
        exclusions: list[tuple[float, str]] = []
        for name, inclusion, corners in self._polygons:
            away_m = min(
                _distance_to_segment(point, a, b) for a, b in zip(corners, [*corners[1:], corners[0]], strict=True)
            )
            within_m = away_m if inside_polygon(point, corners) else -away_m
            (inclusions if inclusion else exclusions).append((within_m, name))
        for name, inclusion, center, radius_m in self._circles:
            (inclusions if inclusion else exclusions).append((radius_m - math.dist(point, center), name))
        rooms = [(-within_m, f"the exclusion {name}") for within_m, name in exclusions]
        if inclusions:
            within_m, name = (max if self._any else min)(inclusions)
            rooms.append((within_m, f"the inclusion {name}"))
        return min(rooms, default=(math.inf, ""))

    def crossed(self, a: Corner, b: Corner) -> str | None:
        """The shape that the straight path between two permitted positions crosses; None for none."""
        start, end = self._plane.xy(a), self._plane.xy(b)
        for name, inclusion, corners in self._polygons:
            if self._any and inclusion:
                continue
            edges = zip(corners, [*corners[1:], corners[0]], strict=True)
            if any(_segments_meet(start, end, p, q) for p, q in edges):
                return f"leaves the inclusion {name}" if inclusion else f"leads through the exclusion {name}"
        for name, inclusion, center, radius_m in self._circles:
            if not inclusion and _distance_to_segment(center, start, end) <= radius_m:
                return f"leads through the exclusion {name}"
        return None


class _Plane:
    """Metres east and north of a position."""

    def __init__(self, origin: Corner) -> None:
        self._lat, self._lon = origin
        self._per_deg = math.radians(EARTH_RADIUS_M)
        self._shrink = math.cos(math.radians(origin[0]))

    def xy(self, place: Corner) -> Point:
        east_deg = (place[1] - self._lon + 180.0) % 360.0 - 180.0  # a fence may cross the date line
        return east_deg * self._per_deg * self._shrink, (place[0] - self._lat) * self._per_deg


def _area_m2(points: Sequence[Point]) -> float:
    pairs = zip(points, [*points[1:], points[0]], strict=True)
    return sum(ax * by - bx * ay for (ax, ay), (bx, by) in pairs) / 2


def _self_crossing(points: Sequence[Point]) -> tuple[int, int] | None:
    """The numbers of two edges that meet without being neighbours."""
    count = len(points)
    for a in range(count):
        for b in range(a + 2, count):
            if a == 0 and b == count - 1:
                continue
            if _segments_meet(points[a], points[a + 1], points[b], points[(b + 1) % count]):
                return a, b
    return None


def _segments_meet(a: Point, b: Point, c: Point, d: Point) -> bool:
    """True if two segments have a point in common, ends included."""
    d1, d2, d3, d4 = _turn(c, d, a), _turn(c, d, b), _turn(a, b, c), _turn(a, b, d)
    if ((d1 > 0 > d2) or (d1 < 0 < d2)) and ((d3 > 0 > d4) or (d3 < 0 < d4)):
        return True
    ends = ((d1, c, d, a), (d2, c, d, b), (d3, a, b, c), (d4, a, b, d))
    return any(turn == 0 and _between(p, q, r) for turn, p, q, r in ends)


def _turn(a: Point, b: Point, c: Point) -> float:
    return (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])


def _between(a: Point, b: Point, c: Point) -> bool:
    return min(a[0], b[0]) <= c[0] <= max(a[0], b[0]) and min(a[1], b[1]) <= c[1] <= max(a[1], b[1])


def inside_polygon(point: Point, corners: Sequence[Point]) -> bool:
    """Even-odd rule."""
    x, y = point
    inside = False
    for (ax, ay), (bx, by) in zip(corners, [*corners[1:], corners[0]], strict=True):
        if (ay > y) != (by > y) and x < ax + (y - ay) * (bx - ax) / (by - ay):
            inside = not inside
    return inside


def _distance_to_segment(point: Point, a: Point, b: Point) -> float:
    dx, dy = b[0] - a[0], b[1] - a[1]
    length2 = dx * dx + dy * dy
    along = 0.0 if length2 == 0 else ((point[0] - a[0]) * dx + (point[1] - a[1]) * dy) / length2
    along = min(1.0, max(0.0, along))
    return math.hypot(point[0] - a[0] - along * dx, point[1] - a[1] - along * dy)
