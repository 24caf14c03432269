"""Check whether a place is within a fence of polygons and circles, as a simulated vehicle keeps one."""

from __future__ import annotations

from math import hypot

from skygcs.core.mission.fence import FencePlan, inside_polygon
from skygcs.sim.kinematics import LocalFrame


def within(fence: FencePlan, where: LocalFrame, east_m: float, north_m: float, *, every: bool) -> bool:
    """Outside all exclusions, and inside the inclusions: ``every`` one (ArduPilot), or one of them (PX4)."""
    if not (fence.polygons or fence.circles):
        return True  # nearly always
    here = (east_m, north_m)
    inclusions: list[bool] = []
    for polygon in fence.polygons:
        inside = inside_polygon(here, [where.to_local(lat, lon) for lat, lon in polygon.corners])
        if not polygon.inclusion and inside:
            return False
        if polygon.inclusion:
            inclusions.append(inside)
    for circle in fence.circles:
        east, north = where.to_local(*circle.center)
        inside = hypot(east_m - east, north_m - north) <= circle.radius_m
        if not circle.inclusion and inside:
            return False
        if circle.inclusion:
            inclusions.append(inside)
    if not inclusions:
        return True
    return all(inclusions) if every else any(inclusions)
