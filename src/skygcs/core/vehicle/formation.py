"""Several vehicles that are sent to one place, or fly one mission: where each of them goes. Pure.

To one place they keep their positions relative to each other. Of one mission each gets one of its own (`for_several`):

    kind      the mission of each vehicle
    -------   ---------------------------------------------------------------------------------------------------------
    heights   the same places, each next vehicle higher by a step
    present   the path moved by where the vehicle is now, seen from the first one, which flies it as it is
    line      the path moved to the right of its course, each next vehicle by a spacing: abreast
    column    the path moved against its course, each next vehicle by a spacing: behind each other

Heights are those that are flown: not that of a landing, and none of a camera's target. What a file holds beside the
mission (fence, rally points, home) is the same for all. Nothing here knows margins beyond the one that it is given:
whether the ways keep their distance is for the monitor (`core.monitor.mission_ways`).
"""

from __future__ import annotations

import itertools
import math
from collections import Counter
from collections.abc import Generator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Literal, TypeVar

from skygcs.core.geo import Origin, Vector, distance_m, enu_from_geodetic, geodetic_from_enu, wrap_deg_360
from skygcs.core.mission.item import FIRST_ITEM, LOCAL_FRAMES, MissionItem
from skygcs.core.mission.plan import ENDS_ON_GROUND, FLOWN_OTHERWISE, FLOWN_PLACE, MissionPlan
from skygcs.core.separation import Footprint, pair_margin

K = TypeVar("K")

APART_M = 3.0
"""Two vehicles closer than this, horizontally and in height, may collide by a GPS error."""


def offsets_en_m(places: Mapping[K, tuple[float, float]]) -> dict[K, tuple[float, float]]:
    """East and north offset of each (lat_deg, lon_deg) from their mean, in metres; the offsets sum to zero."""
    if not places:
        return {}
    local_origin = next(iter(places.values()))
    origin = Origin(local_origin[0], local_origin[1], 0.0)
    flat = {key: enu_from_geodetic(lat, lon, 0.0, origin)[:2] for key, (lat, lon) in places.items()}
    east = sum(e for e, _ in flat.values()) / len(flat)
    north = sum(n for _, n in flat.values()) / len(flat)
    return {key: (e - east, n - north) for key, (e, n) in flat.items()}


def moved(lat_deg: float, lon_deg: float, offset_en_m: tuple[float, float]) -> tuple[float, float]:
    """(lat_deg, lon_deg) of a point that many metres east and north of another."""
    lat, lon, _ = geodetic_from_enu(*offset_en_m, 0.0, Origin(lat_deg, lon_deg, 0.0))
    return lat, lon


def too_close(places: Mapping[K, tuple[float, float, float]]) -> tuple[K, K, float] | None:
    """The first two of (lat_deg, lon_deg, alt_amsl_m) that are too close, and how many metres apart across."""
    for (a, here), (b, there) in itertools.combinations(places.items(), 2):
        if abs(here[2] - there[2]) < APART_M and (across_m := distance_m(*here[:2], *there[:2])) < APART_M:
            return a, b, across_m
    return None


# --- one mission for several ----------------------------------------------------------------------------------------

ArrangementKind = Literal["heights", "present", "line", "column"]

LEAST_STEP_M = 3.0
"""Least height from one vehicle to the next where the margins need less."""

STEP_GRID_M = 0.5
SLACK_M = 0.05
"""A step that is worked out is a multiple of the one, and the other above what is needed: a straight line over the
ground is 1 mm higher at its end, 100 m away, than where it is level."""

SPACING_M = 5.0
MAX_STEP_M, MAX_SPACING_M = 100.0, 1000.0

ITEMS_A_TURN = 32
"""Items that are moved at a stretch: half a millisecond."""

MAX_ARRANGED_ITEMS = 200_000
"""Items of all vehicles' missions together, all of which are kept until the last upload has ended: 70 MB, and 800 items
for each of 250 vehicles. MAVLink's own bound is 65535 items for each."""

LatLon = tuple[float, float]


@dataclass(frozen=True, slots=True)
class Arrangement:
    """How the missions differ. ``step_m``: of kind heights; None: `least_step_m`. ``spacing_m`` and ``heading_deg``
    (compass; None: the course of the first leg): of kinds line and column."""

    kind: ArrangementKind
    step_m: float | None = None
    spacing_m: float = SPACING_M
    heading_deg: float | None = None


def for_several(
    plan: MissionPlan, arrangement: Arrangement, places: Sequence[LatLon | None], footprints: Sequence[Footprint]
) -> tuple[MissionPlan, ...]:
    """`arranging` without a break."""
    work = arranging(plan, arrangement, places, footprints)
    while True:
        try:
            next(work)
        except StopIteration as end:
            plans: tuple[MissionPlan, ...] = end.value
            return plans


def arranging(
    plan: MissionPlan, arrangement: Arrangement, places: Sequence[LatLon | None], footprints: Sequence[Footprint]
) -> Generator[None, None, tuple[MissionPlan, ...]]:
    """The plan of each vehicle, in their order; yields after every `ITEMS_A_TURN` items.
    ``places``: where they are now; None: not known.

    Raises ValueError, in words for a person, for what cannot be arranged: a vehicle of kind present whose place is not
    known, a line without a course, an item that has no height or no place on earth, one that sets a height or a place
    in a way that cannot be moved (`FLOWN_OTHERWISE`), heights of two references without a step, and more than
    `MAX_ARRANGED_ITEMS` together.
    """
    if not plan.mission:
        raise ValueError("it holds no mission to arrange")
    if (together := len(plan.mission) * len(places)) > MAX_ARRANGED_ITEMS:
        raise ValueError(
            f"{len(plan.mission)} items for each of {len(places)} vehicles are {together} together, and "
            f"{MAX_ARRANGED_ITEMS} can be arranged: shorten it to {MAX_ARRANGED_ITEMS // len(places)} items, or upload "
            "a mission of its own to each vehicle"
        )
    offsets = offsets_enu_m(plan.mission, arrangement, places, footprints)
    plans = []
    for offset in offsets:
        items: list[MissionItem] = []
        for at in range(0, len(plan.mission), ITEMS_A_TURN):
            part = plan.mission[at : at + ITEMS_A_TURN]
            items += (_moved(n, item, offset) for n, item in enumerate(part, FIRST_ITEM + at))
            yield
        plans.append(replace(plan, mission=tuple(items)))
    return tuple(plans)


def offsets_enu_m(
    items: Sequence[MissionItem],
    arrangement: Arrangement,
    places: Sequence[LatLon | None],
    footprints: Sequence[Footprint],
) -> tuple[Vector, ...]:
    """East, north, up by which the mission of each vehicle is moved; the first one's is (0, 0, 0). Raises ValueError
    as `for_several`."""
    count = len(places)
    match arrangement.kind:
        case "heights":
            step_m = least_step_m(items, footprints) if arrangement.step_m is None else arrangement.step_m
            return tuple((0.0, 0.0, n * step_m) for n in range(count))
        case "present":
            return _from_first(places)
        case "line" | "column":
            heading_deg = course_deg(items) if arrangement.heading_deg is None else arrangement.heading_deg
            if heading_deg is None and count > 1:
                raise ValueError("its mission has no leg over the ground, so no course: give a heading")
            course = math.radians(heading_deg or 0.0)
            east, north = math.sin(course), math.cos(course)
            way = (north, -east) if arrangement.kind == "line" else (-east, -north)
            apart_m = [n * arrangement.spacing_m for n in range(count)]
            return tuple((m * way[0], m * way[1], 0.0) for m in apart_m)


def least_step_m(items: Sequence[MissionItem], footprints: Sequence[Footprint]) -> float:
    """The step of heights with which vehicles above each other keep their margins, at least `LEAST_STEP_M`.

    What a leg climbs is added: when each of them climbs on it is its own, so it may be at either end of it (see
    `core.monitor.ways`), and the same holds at the corner with the next leg. Raises ValueError for heights above
    different references, which cannot be compared.
    """
    kinds = Counter(footprints)
    pairs = [*itertools.combinations(kinds, 2), *((kind, kind) for kind, count in kinds.items() if count > 1)]
    margins = [(margin := pair_margin(a, b)).total_m * margin.downwash_ratio for a, b in pairs]
    measured = [(n, item) for n, item in enumerate(items, FIRST_ITEM) if _has_height(item) and item.z is not None]
    other = next(((n, item) for n, item in measured if item.frame != measured[0][1].frame), None)
    if other is not None:
        raise ValueError(
            f"the heights of items {measured[0][0]} and {other[0]} are above different references (sea level, home, "
            "terrain): give the step, or bring them to one"
        )
    heights = [item.z for _, item in measured if item.z is not None]
    climbs = [max(some) - min(some) for n in range(len(heights)) if (some := heights[n : n + 3])]
    needed_m = max(margins, default=0.0) + max(climbs, default=0.0) + SLACK_M
    return max(LEAST_STEP_M, math.ceil(needed_m / STEP_GRID_M) * STEP_GRID_M)


def course_deg(items: Sequence[MissionItem]) -> float | None:
    """The compass course of the first leg between two places; None: it has none."""
    places = [item.position for item in items if item.command in FLOWN_PLACE and item.position is not None]
    for a, b in itertools.pairwise(places):
        east_m, north_m, _ = enu_from_geodetic(*b, 0.0, Origin(*a, 0.0))
        if math.hypot(east_m, north_m) > 1.0:
            return wrap_deg_360(math.degrees(math.atan2(east_m, north_m)))
    return None


def _from_first(places: Sequence[LatLon | None]) -> tuple[Vector, ...]:
    known = [place for place in places if place is not None]
    if len(known) < len(places):
        raise ValueError("the place of each vehicle has to be known for their present formation")
    found = (enu_from_geodetic(*place, 0.0, Origin(*known[0], 0.0)) for place in known)
    return tuple((east_m, north_m, 0.0) for east_m, north_m, _ in found)


def _has_height(item: MissionItem) -> bool:
    return item.command in FLOWN_PLACE and item.command not in ENDS_ON_GROUND


def _moved(number: int, item: MissionItem, offset_enu_m: Vector) -> MissionItem:
    if item.command in FLOWN_OTHERWISE and offset_enu_m != (0.0, 0.0, 0.0):
        raise ValueError(
            f"item {number} (command {item.command}) sets a height or a place that cannot be moved: each vehicle would "
            "fly there; leave it out, or upload a mission of its own to each"
        )
    if item.command not in FLOWN_PLACE or offset_enu_m == (0.0, 0.0, 0.0):
        return item
    east_m, north_m, up_m = offset_enu_m
    if item.frame in LOCAL_FRAMES:
        raise ValueError(f"item {number} has a place of a local frame, which cannot be moved")
    z = item.z
    if up_m and _has_height(item):
        if z is None:
            raise ValueError(f"item {number} has no height to add to")
        z = z + up_m
    place = item.position
    if place is None or not (east_m or north_m):
        return replace(item, z=z)
    lat_deg, lon_deg, _ = geodetic_from_enu(east_m, north_m, 0.0, Origin(*place, 0.0))
    return replace(item, x=round(lat_deg * 1e7), y=round(lon_deg * 1e7), z=z)
