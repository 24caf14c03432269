"""A geofence of polygons and circles, and its form as mission items (MAV_CMD 5000 to 5004).

A polygon is one item per corner; param1 of each is the number of corners. Nothing else separates one polygon from the
next, so a wrong count would make another fence of the same items. It is refused here.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from skygcs.core.mavlink import mav_cmd
from skygcs.core.mission.item import (
    GLOBAL,
    RELATIVE_ALT,
    MissionItem,
    file_number,
    float32,
    wire_int,
)

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
