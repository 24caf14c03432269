"""The space of a mission on board, to compare it with those of vehicles that fly at the same time. Pure.

    item                        leg
    -------------------------   ---------------------------------------------------------------------------------------
    NAV_TAKEOFF                 straight up where the vehicle is, then level to its place if it has one, and on from
                                there, or at once; one that is higher already does not sink
    an item with a place        from the place before to it; a loiter is as wide as its radius
    NAV_RETURN_TO_LAUNCH        as `core.monitor.departures` has it: up to the return height, level to home, and down; a
                                plane to and at that height, on its circle; a rover level and no further
    NAV_LAND                    level to its place if it has one, and down
    DO_JUMP, DO_JUMP_TAG        from the place before to that of its target, and on from there; and on as without it

Heights above terrain are taken as above home.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import replace
from functools import cached_property, reduce
from typing import NamedTuple

from skygcs.core.geo import EnuFrame, ecef
from skygcs.core.mavlink import mav_cmd
from skygcs.core.mavlink.vehicle_class import ReturnEnd
from skygcs.core.mission.item import FIRST_ITEM, GLOBAL, MissionItem
from skygcs.core.mission.plan import FLOWN_PLACE, RADIUS_PARAM, TAKEOFFS
from skygcs.core.monitor.approach import Vector
from skygcs.core.monitor.departures import UNKNOWN, ReturnHeight, Returning
from skygcs.core.monitor.tracks import Place
from skygcs.core.monitor.ways import Leg, Point, Way, along, are_apart, column, joined
from skygcs.core.separation import Footprint

JUMPS = frozenset({mav_cmd.DO_JUMP, mav_cmd.DO_JUMP_TAG})

LANDINGS = frozenset({mav_cmd.NAV_LAND, mav_cmd.NAV_VTOL_LAND})


PASSES = "; all that is left of its mission counts: order this when {name} is past, or pause it (mission pause {name})"
"""To a person, of a mission that is in the way."""

ON_GROUND_M = 1.0
"""A leg that is so near the lowest of its way ends on the ground: heights of landings are those of home."""


AT_HOME_M = 1.5
"""A landing so near home is one at home: the error of two positions of one receiver."""


class MissionRun(NamedTuple):
    """A mission that is flown from an item on, counted from 1. ``height``, ``return_end``: of its returns."""

    items: Sequence[MissionItem]
    first: int = 1
    height: ReturnHeight = UNKNOWN
    return_end: ReturnEnd = ReturnEnd.LANDS

    @property
    def returns(self) -> bool:
        """True if a return is part of it."""
        return any(item.command == mav_cmd.NAV_RETURN_TO_LAUNCH for item in self.items)


class MissionOf(NamedTuple):
    """Parts of which the way of a mission is made. Places are geodetic; the way is in ``frame``."""

    key: int
    name: str
    footprint: Footprint
    run: MissionRun
    home: Place
    frame: EnuFrame
    circle_m: float = 0.0
    """Radius of the circle of what cannot stop, which rounds each corner and ends with it; 0: it stops."""


class MissionSpace:
    """The way of a mission from where its vehicle is. What lies behind the next place is made once."""

    def __init__(self, of: MissionOf) -> None:
        self.of = of
        items, first = of.run.items, of.run.first
        item = items[first - 1] if 0 < first <= len(items) else None
        lands = item is not None and (item.command in LANDINGS or item.position is None)
        self._next = None if item is None or lands or item.command not in FLOWN_PLACE else item
        self._base = of.frame.from_geodetic(*of.home)
        self._rest: Way | None = None
        self._ends: tuple[Vector, ...] = ()
        if self._next is not None:
            self._ends = _fly([], self._next, self._base, self._base, of.home, of.frame)
            self._rest = self._way(self._ends[0], of.run._replace(first=first + 1), _radius_m(self._next))

    def _way(self, begin: Vector, run: MissionRun, least_m: float = 0.0) -> Way:
        legs, widest_m = _legs(run, begin, self._base, self.of.home, self.of.frame)
        ball_m = max(least_m, widest_m, self.of.circle_m)
        name, doing = self.of.name, "on its mission"
        return Way(self.of.key, name, self.of.footprint, tuple(legs), ball_m, doing, PASSES.format(name=name))

    def way(self, here: Place) -> Way:
        """Its way from here on; the second leg leads to the next place."""
        return self._way_from(self.of.frame.from_geodetic(*here))

    @cached_property
    def _behind(self) -> MissionSpace:
        """The mission from the item after the next one on."""
        run = self.of.run
        return MissionSpace(self.of._replace(run=run._replace(first=run.first + 1)))

    def _way_from(self, begin: Vector) -> Way:
        if self._next is None or self._rest is None:
            return self._way(begin, self.of.run)
        legs = list(along([begin]))
        ends = _fly(legs, self._next, begin, self._base, self.of.home, self.of.frame)
        if len(ends) > 1 or ends != self._ends:  # those of a take-off depend on where the vehicle is
            behind = self._behind._next
            if behind is not None and behind.command in TAKEOFFS:  # each of a row of them would double the ways
                return self._way(begin, self.of.run)
            ways = [self._behind._way_from(end) for end in ends]
            return reduce(joined, ways, replace(ways[0], legs=tuple(legs)))
        return joined(replace(self._rest, legs=tuple(legs)), self._rest)


def _legs(run: MissionRun, begin: Vector, base: Vector, home: Place, frame: EnuFrame) -> tuple[list[Leg], float]:
    """The legs along all items to which the run may come, and how wide its circles are."""
    items = run.items
    legs: list[Leg] = list(along([begin]))
    widest_m = 0.0
    targets = {index: jump_target(items, item) for index, item in enumerate(items) if item.command in JUMPS}
    to_visit: list[tuple[int, Vector]] = [(run.first - 1, begin)]
    visited = set(to_visit)
    while to_visit:
        index, at = to_visit.pop()
        if not 0 <= index < len(items):
            continue
        if items[index].command == mav_cmd.NAV_RETURN_TO_LAUNCH:
            ends: tuple[Vector, ...] = (_return(legs, run, at, base),)
        else:
            ends = _fly(legs, items[index], at, base, home, frame)
        widest_m = max(widest_m, _radius_m(items[index]))
        target = targets.get(index)
        for goes_on in itertools.product((index + 1, *(() if target is None else (target,))), ends):
            if goes_on not in visited:
                visited.add(goes_on)
                to_visit.append(goes_on)
    return legs, widest_m


class MissionBox(NamedTuple):
    """The places of a mission on board as a box, earth-centred: made once, to leave out what is far away."""

    items: Sequence[MissionItem]
    home: Place
    low: Vector
    high: Vector
    beside_m: float
    """How far from the box it leads, by heights and circles, but for returns."""

    def is_apart(self, ends: tuple[Vector, Vector], here: Vector, need_m: float, height: ReturnHeight) -> bool:
        """True if the way of a vehicle from ``here`` along the mission keeps clear of a straight line."""
        returns = MissionRun(self.items).returns
        away_m = need_m + self.beside_m + (height.most_m + height.climb_m if returns else 0.0)
        (a, b, c), (d, e, f), (x, y, z) = self.low, self.high, here
        box = (min(a, x), min(b, y), min(c, z)), (max(d, x), max(e, y), max(f, z))
        return are_apart(ends, box, (away_m, away_m, away_m))


def mission_box(items: Sequence[MissionItem], home: Place) -> MissionBox:
    """The box of a mission on board a vehicle with this home."""
    places = [home, *((*item.position, home[2]) for item in items if item.position is not None)]
    points = [ecef(*place) for place in places]
    heights = [abs((item.z or 0.0) - (home[2] if item.frame == GLOBAL else 0.0)) for item in items]
    beside_m = max(heights, default=0.0) + max(map(_radius_m, items), default=0.0)
    (a, b, c), (d, e, f) = ([pick(point[axis] for point in points) for axis in range(3)] for pick in (min, max))
    return MissionBox(items, home, (a, b, c), (d, e, f), beside_m)


def jump_target(items: Sequence[MissionItem], jump: MissionItem) -> int | None:
    """The index of the item to which a DO_JUMP or DO_JUMP_TAG leads; None: no such item."""
    number = jump.params[0]
    if jump.command == mav_cmd.DO_JUMP_TAG:
        tagged = (i for i, item in enumerate(items) if item.command == mav_cmd.JUMP_TAG and item.params[0] == number)
        return next(tagged, None)
    return None if number is None or not 1 <= number <= len(items) else int(number) - FIRST_ITEM


def _radius_m(item: MissionItem) -> float:
    """Radius of the circle that it makes the vehicle fly; 0: none."""
    index = RADIUS_PARAM.get(item.command)
    return 0.0 if index is None else abs(item.params[index] or 0.0)


def landing_distance_m(way: Way, place: Point, home: Point) -> float:
    """Least distance over the ground between a place and where the way comes down, but at home or where it begins: a
    vehicle that stood beside its neighbour may stand there again. Infinite if it comes down nowhere else."""
    own = (way.legs[0].begin, home)
    low_m = way.heights[0] + ON_GROUND_M
    down = [leg.begin for leg in way.legs if leg.begin == leg.end and leg.low_m <= low_m]
    elsewhere = [point for point in down if min(math.dist(point, one) for one in own) > AT_HOME_M]
    return min((math.dist(point, place) for point in elsewhere), default=math.inf)


def _return(legs: list[Leg], run: MissionRun, at: Vector, base: Vector) -> Vector:
    """Add the legs of a return from a place; returns where it ends."""
    if run.return_end in (ReturnEnd.STANDS, ReturnEnd.STANDS_DISARMED):
        at = _level(legs, at, base)
        legs.append(column(at, base[2]))
        return base
    home = Returning(0, "", Footprint(), at, (0.0, 0.0, 0.0), base, run.height)
    if run.return_end is ReturnEnd.LANDS:
        legs += home.way().legs
        return base
    # it also sinks to its return height on the way, and stays at it
    low_m, high_m = min(at[2], base[2] + run.height.least_m), home.highest_m
    legs += (column(at, high_m), Leg(at[:2], base[:2], low_m, high_m))
    if run.return_end in (ReturnEnd.HOLDS, ReturnEnd.LANDS_ON_ROTORS, ReturnEnd.LANDS_AS_PLANE, ReturnEnd.NOT_KNOWN):
        legs.append(column((base[0], base[1], high_m), base[2]))
        return base
    return (base[0], base[1], low_m)


def _fly(
    legs: list[Leg], item: MissionItem, at: Vector, base: Vector, home: Place, frame: EnuFrame
) -> tuple[Vector, ...]:
    """Add the legs of one item that is flown from a place; returns where it may end."""
    if item.command not in FLOWN_PLACE:
        return (at,)
    alt_amsl_m = (item.z or 0.0) + (0.0 if item.frame == GLOBAL else home[2])
    up_m = frame.from_geodetic(home[0], home[1], alt_amsl_m)[2]
    there = at if item.position is None else frame.from_geodetic(*item.position, alt_amsl_m)
    if item.command in LANDINGS:
        at = _level(legs, at, there)
        ground_m = min(base[2], at[2])
        legs.append(column(at, ground_m))
        return ((at[0], at[1], ground_m),)
    if item.command in TAKEOFFS:
        # PX4 asks a multicopter for the height only, and ArduCopter raises it to the present one: neither sinks
        up_m = max(at[2], up_m)
        legs.append(column(at, up_m))
        at = (at[0], at[1], up_m)
    end = (there[0], there[1], up_m)
    legs += along([at, end])
    goes_on_at_once = item.command in TAKEOFFS and math.dist(at, end) > AT_HOME_M
    return (end, at) if goes_on_at_once else (end,)


def _level(legs: list[Leg], at: Vector, to: Vector) -> Vector:
    """Add the leg to above a place, at the height it is at."""
    end = (to[0], to[1], at[2])
    legs += along([at, end])
    return end
