"""The autopilot's own fence against a plan: the cylinder of its parameters, and its polygons and circles. Pure.

The autopilot acts at its fence whatever we send: an ArduCopter returns in the middle of a plan, a PX4 may switch its
motors off. So every place of the plan, and the vehicle's tube around it, has to be inside.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

from skygcs.core.geo import distance_m
from skygcs.core.mission.fence import FenceArea, FencePlan
from skygcs.core.trajectory import Trajectory
from skygcs.core.trajectory.piecewise import Vector
from skygcs.core.vehicle.fence_params import FenceSettings
from skygcs.ext.plans.flight import remedies
from skygcs.ext.plans.flight.flight_findings import Finding, Level, refused

CHECK = "fence"

STEP_S = 0.2
"""Between two places of a trajectory that are compared: at 5 m/s and 3 m/s² the way between is 15 mm beside the
straight line."""

ROOM_M = 1.0
"""Beyond the places of a plan, in the fence that is proposed for it."""

MOST_PLACES = 3_000
"""Most places of one vehicle; a longer plan is sampled more coarsely: ten minutes at STEP_S, 10 ms of work."""

ONLY_REPORTS = frozenset({"none", "warn"})
"""Actions that move nothing."""

GeodeticPlace = tuple[float, float, float]


class Reach(NamedTuple):
    """All places that a plan leads one vehicle to, and the homes that its cylinder may stand about."""

    homes: tuple[GeodeticPlace, ...]
    places: tuple[GeodeticPlace, ...]
    tube_m: float


def sampled(ways: Sequence[Trajectory]) -> list[Vector]:
    """Places of these trajectories, their ends among them."""
    if not ways:
        return []
    step_s = max(STEP_S, math.fsum(way.duration_s for way in ways) / MOST_PLACES)
    found = []
    for way in ways:
        count = max(1, math.ceil(way.duration_s / step_s))
        found += [way.at(way.duration_s * k / count).pos_enu_m for k in range(count + 1)]
    return found


def fence_finding(vehicle: str, fence: FenceSettings, shapes: FencePlan | None, reach: Reach) -> Finding:
    """Judge whether the plan stays inside; ``shapes``: the polygons and circles that it has, None: not known."""
    if not fence.enabled:
        return Finding(vehicle, CHECK, Level.OK, "its own fence is off")
    found = [*_beyond_cylinder(fence, reach), *_beyond_shapes(fence, shapes, reach)]
    if not found and fence.follows_list and shapes is None:
        text = f"its own fence is {fence}, and its polygons and circles could not be read"
        if fence.action in ONLY_REPORTS:
            return Finding(vehicle, CHECK, Level.WARNING, text)
        return refused(vehicle, CHECK, text, remedies.insist("check its link"), insist=True)
    if not found:
        return Finding(vehicle, CHECK, Level.OK, f"the plan stays inside its own fence ({fence})")
    text = f"its own fence is {fence}, and {'; '.join(found)}"
    if fence.action in ONLY_REPORTS:
        return Finding(vehicle, CHECK, Level.WARNING, f"{text}: it will report that")
    away_m, high_m = _farthest_m(reach)
    wider_m = away_m + ROOM_M if fence.radius_m is not None and away_m > fence.radius_m else None
    higher_m = high_m + ROOM_M if fence.height_m is not None and high_m > fence.height_m else None
    return refused(vehicle, CHECK, text, remedies.widen_fence(vehicle, wider_m, higher_m))


def _beyond_cylinder(fence: FenceSettings, reach: Reach) -> list[str]:
    found = []
    away_m, high_m = _farthest_m(reach)
    tube = f"{reach.tube_m:.1f} m of tube included"
    if fence.radius_m is not None and away_m > fence.radius_m:
        found.append(f"the plan leads to {away_m:.1f} m from its home ({tube})")
    if fence.height_m is not None and high_m > fence.height_m:
        found.append(f"the plan leads to {high_m:.1f} m above its home ({tube})")
    return found


def _farthest_m(reach: Reach) -> tuple[float, float]:
    """The largest distance from a home and the largest height above one, with the tube."""
    away_m = high_m = 0.0
    for lat, lon, alt_m in reach.places:
        for home_lat, home_lon, home_alt_m in reach.homes:
            away_m = max(away_m, distance_m(home_lat, home_lon, lat, lon))
            high_m = max(high_m, alt_m - home_alt_m)
    return away_m + reach.tube_m, high_m + reach.tube_m


def _beyond_shapes(fence: FenceSettings, shapes: FencePlan | None, reach: Reach) -> list[str]:
    if not fence.follows_list or shapes is None or not (shapes.polygons or shapes.circles):
        return []
    area = FenceArea(shapes, any_inclusion=False)
    found = area.narrowest([(lat, lon) for lat, lon, _ in reach.places], reach.tube_m)
    if found is None:
        return []
    room_m, shape = found
    if room_m < 0.0:
        where = "outside" if "inclusion" in shape else "inside"
        return [f"a place of the plan is {where} {shape}"]
    return [f"the plan comes {room_m:.1f} m near the border of {shape}, and its tube is {reach.tube_m:.1f} m"]
