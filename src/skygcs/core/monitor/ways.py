"""The space of the ways that vehicles fly by themselves: home, or along a mission. Pure.

When such a vehicle is where is not known: speeds, waits and wind are its own. So two ways are compared as space, as if
each vehicle were everywhere on its own at the same time. A way is made of legs; a leg is a straight line over the
ground, and the heights between which it is flown.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Generator, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

from skygcs.core.monitor.approach import Vector
from skygcs.core.separation import Footprint, pair_margin

Point = tuple[float, float]
"""East, north in the common frame, m."""


STEP_M, MOST_STEPS = 2.0, 16
"""A sloped way is made of legs that climb by so much each; a long one of so many, to bound the work."""

FAN_M = 2.0
"""Less than the least of two margins (2.5 m with the defaults): nothing stands unseen between the lines of a turn."""

LEGS_A_PART = 8
"""Legs of which one box is looked at first: all pairs of two parts take a fraction of a millisecond."""


class Leg(NamedTuple):
    """From one point over the ground to another (or the same), somewhere between two heights (m, common frame)."""

    begin: Point
    end: Point
    low_m: float
    high_m: float


@dataclass(frozen=True)
class Way:
    """The space of one vehicle's way."""

    key: int
    name: str
    footprint: Footprint
    legs: tuple[Leg, ...]
    ball_m: float = 0.0
    """How far it may be from its way, because its last position is old, or because it brakes first."""
    doing: str = "in the air"
    hint: str = ""
    """Added to what is said of a conflict with it: what would help."""

    @cached_property
    def box(self) -> tuple[float, float, float, float]:
        """West, east, south and north end of its legs."""
        east = [x for leg in self.legs for x in (leg.begin[0], leg.end[0])]
        north = [y for leg in self.legs for y in (leg.begin[1], leg.end[1])]
        return min(east), max(east), min(north), max(north)

    @cached_property
    def is_known(self) -> bool:
        """False if one of its numbers is NaN: the vehicle may be anywhere."""
        numbers = (x for leg in self.legs for x in (*leg.begin, *leg.end, leg.low_m, leg.high_m))
        return not any(map(math.isnan, (self.ball_m, *numbers)))

    @cached_property
    def heights(self) -> tuple[float, float]:
        """The lowest and highest of its legs."""
        return min(leg.low_m for leg in self.legs), max(leg.high_m for leg in self.legs)

    @cached_property
    def parts(self) -> tuple[Way, ...]:
        """The way in pieces of `LEGS_A_PART` legs."""
        if len(self.legs) <= LEGS_A_PART:
            return (self,)
        starts = range(0, len(self.legs), LEGS_A_PART)
        return tuple(replace(self, legs=self.legs[at : at + LEGS_A_PART]) for at in starts)


def joined(first: Way, rest: Way) -> Way:
    """``first``, and then ``rest``, of which the parts are kept: a long one is measured once."""
    way = replace(first, legs=(*first.legs, *rest.legs))
    (a, b, c, d), (e, f, g, h) = first.box, rest.box
    low_m, high_m = min(first.heights[0], rest.heights[0]), max(first.heights[1], rest.heights[1])
    kept = {"parts": (*first.parts, *rest.parts), "box": (min(a, e), max(b, f), min(c, g), max(d, h))}
    known = first.is_known and all(part.is_known for part in rest.parts)
    way.__dict__.update(kept, heights=(low_m, high_m), is_known=known)  # as cached_property would
    return way


def standing(place: Vector) -> tuple[Leg, ...]:
    """The way of a vehicle that stays where it is."""
    return (Leg(place[:2], place[:2], place[2], place[2]),)


def column(place: Vector, to_m: float) -> Leg:
    """Straight up or down at a place."""
    return _leg(place, (*place[:2], to_m))


def along(points: Sequence[Vector]) -> tuple[Leg, ...]:
    """Through these points. A leg that climbs is taken to be anywhere between its two heights."""
    legs = tuple(_leg(a, b) for a, b in itertools.pairwise(points))
    return legs or tuple(leg for point in points for leg in standing(point))


def _leg(a: Vector, b: Vector) -> Leg:
    """From one point to another. A height that is NaN stays one, which ``min`` and ``max`` may lose."""
    return Leg(a[:2], b[:2], a[2], b[2]) if a[2] <= b[2] else Leg(a[:2], b[:2], b[2], a[2])


def sloped(points: Sequence[Vector]) -> tuple[Leg, ...]:
    """Straight through these points, as exactly as legs of `STEP_M` are; a single one: it stays there."""
    between: list[Vector] = list(points[:1])
    for a, b in itertools.pairwise(points):
        # a leg that climbs is off by its climb, and by its length over the ground: a column is exact as it is
        off_m = min(abs(b[2] - a[2]), math.dist(a[:2], b[:2]), STEP_M * MOST_STEPS)
        steps = math.ceil(off_m / STEP_M) if off_m > STEP_M else 1
        for n in range(1, steps):
            x, y, z = (p + (q - p) * n / steps for p, q in zip(a, b, strict=True))
            between.append((x, y, z))
        between.append(b)
    return along(between)


def turning_points(here: Vector, velocity_mps: Vector, on_m: float, to: Vector) -> tuple[Vector, ...]:
    """The outermost way from here to a place, on which it first flies on by so much (`overshoot_m`) and then turns;
    only here if it stands.

    It flies between that way and the straight one. Both firmwares accelerate to the new place while they brake, which
    bows the way out by as much as it flies on (never beyond the place, nor farther ahead than it flies on or the place
    is): the third of the points.
    """
    if on_m == 0.0:
        return (here,)
    speed_mps = math.hypot(*velocity_mps)
    stops = _on(here, velocity_mps, on_m / speed_mps)
    way = to[0] - here[0], to[1] - here[1], to[2] - here[2]
    away_m = math.hypot(*way)
    share = min(1.0, on_m / away_m) if away_m > 0.0 else 0.0
    ahead_m = sum(p * v for p, v in zip(way, velocity_mps, strict=True)) / speed_mps
    too_far_m = max(0.0, on_m + share * ahead_m - max(on_m, ahead_m))
    return here, stops, _on(_on(stops, way, share), velocity_mps, -too_far_m / speed_mps), to


def turning_lines(here: Vector, velocity_mps: Vector, on_m: float, to: Vector) -> tuple[tuple[Vector, ...], ...]:
    """`turning_points`, and such ways on which it flies on by less: no place between those and the straight way is
    farther than `FAN_M` from all. None if it stands."""
    fans = math.ceil(on_m / (2.0 * FAN_M))
    return tuple(turning_points(here, velocity_mps, on_m * n / fans, to) for n in range(fans, 0, -1))


def turning(here: Vector, velocity_mps: Vector, on_m: float, to: Vector) -> tuple[Leg, ...]:
    """The space in which a vehicle turns to a place, to be added to a straight way; nothing if it stands."""
    lines = turning_lines(here, velocity_mps, on_m, to)
    return tuple(leg for n, line in enumerate(lines) for leg in sloped(line[n > 0 :]))


def _on(place: Vector, along: Vector, times: float) -> Vector:
    return place[0] + along[0] * times, place[1] + along[1] * times, place[2] + along[2] * times


def are_apart(a: tuple[Vector, Vector], b: tuple[Vector, Vector], need: Vector) -> bool:
    """True if two straight lines are farther apart than ``need`` along one axis: most of a fleet. False with a NaN."""
    for axis, need_m in enumerate(need):
        p, q = (a[0][axis], a[1][axis]), (b[0][axis], b[1][axis])
        if all(x + need_m < y for x in p for y in q) or all(y + need_m < x for x in p for y in q):
            return True
    return False


def beginning(way: Way) -> Way:
    """Where the vehicle of a way is now."""
    first = way.legs[0]
    return replace(way, legs=(first._replace(end=first.begin),))


def leads_on(way: Way) -> bool:
    """True unless its vehicle only stands, climbs or sinks where it is."""
    return any(leg.begin != way.legs[0].begin or leg.end != leg.begin for leg in way.legs)


def needed_m(a: Way, b: Way) -> float:
    """How far apart two ways have to be, in the metric of their margin."""
    return pair_margin(a.footprint, b.footprint).total_m + a.ball_m + b.ball_m


def distance_m(a: Way, b: Way) -> float:
    """The least distance of two ways in the metric of their margin; 0 if one of them is not known."""
    if not (a.is_known and b.is_known):
        return 0.0
    ratio, least_m = pair_margin(a.footprint, b.footprint).downwash_ratio, math.inf
    for p in a.legs:
        for q in b.legs:
            if _apart_by_axis_m(p, q) < least_m:
                least_m = min(least_m, _legs_distance_m(p, q, ratio))
    return least_m


def too_near(a: Way, b: Way) -> bool:
    """True if two vehicles on these ways could come nearer than they need."""
    return nearest_m(a, b, needed_m(a, b)) < math.inf


def nearest_m(a: Way, b: Way, below_m: float) -> float:
    """`distance_m` if it is below this, else infinity: only the legs of parts whose boxes are so near are compared."""
    if not (a.is_known and b.is_known):
        return 0.0
    ratio, least_m = pair_margin(a.footprint, b.footprint).downwash_ratio, below_m
    if not _are_near(a, b, least_m, ratio):
        return math.inf
    for q in b.parts:
        if not _are_near(a, q, least_m, ratio):
            continue
        for p in a.parts:
            if not _are_near(p, q, least_m, ratio):
                continue
            for leg, other in itertools.product(p.legs, q.legs):
                if _apart_by_axis_m(leg, other) < least_m:
                    least_m = min(least_m, _legs_distance_m(leg, other, ratio))
            if least_m == 0.0:
                return 0.0
    return least_m if least_m < below_m else math.inf


def _boxes_meet(a: Way, b: Way, need_m: float) -> bool:
    """False if they are farther apart than that over the ground, or in height: most pairs of a fleet."""
    known = a.is_known and b.is_known
    return not known or _are_near(a, b, need_m, pair_margin(a.footprint, b.footprint).downwash_ratio)


def _are_near(a: Way, b: Way, need_m: float, ratio: float) -> bool:
    """`_boxes_meet` for two ways that are known."""
    p, q = a.box, b.box
    if p[0] - need_m > q[1] or q[0] - need_m > p[1] or p[2] - need_m > q[3] or q[2] - need_m > p[3]:
        return False
    (low_m, high_m), (other_low_m, other_high_m) = a.heights, b.heights
    return low_m - other_high_m < need_m * ratio and other_low_m - high_m < need_m * ratio


def find_way_conflicts(starting: Sequence[Way], others: Sequence[Way], found: dict[int, str]) -> Iterator[None]:
    """Compare each of ``starting`` with each other one and with ``others``, each pair once; yields after each piece of
    work. ``found`` gets, by key, the first other way with which one of ``starting`` conflicts, in words."""
    for n, way in enumerate(starting):
        for m, other in enumerate((*starting[n + 1 :], *others)):
            starts_too = n + 1 + m < len(starting)
            if way.key in found and (not starts_too or other.key in found):
                continue
            near_m = yield from _nearest_m(way, other)
            if other.key == way.key or near_m >= needed_m(way, other):
                continue
            found.setdefault(way.key, conflict_text(way, other, near_m))
            if starts_too:
                found.setdefault(other.key, conflict_text(other, way, near_m))


def _nearest_m(a: Way, b: Way) -> Generator[None, None, float]:
    """The least distance of two ways as far as it is less than they need, else infinity."""
    yield
    need_m, nearest_m = needed_m(a, b), math.inf
    if not _boxes_meet(a, b, need_m):
        return nearest_m
    for p in a.parts:
        if not _boxes_meet(p, b, need_m):
            continue
        for q in b.parts:
            if _boxes_meet(p, q, need_m):
                nearest_m = min(nearest_m, distance_m(p, q))
                yield
        yield
    return nearest_m


def conflict_text(way: Way, other: Way, near_m: float) -> str:
    """That one would come so near another, for people; or that nobody knows."""
    if not (way.is_known and other.is_known):
        whose = way.name if other.is_known else f"{other.name} ({other.doing})"
        return f"{way.name} may come too near {other.name}: the way of {whose} is not known"
    ratio = pair_margin(way.footprint, other.footprint).downwash_ratio
    near, needed = shown_m(near_m, needed_m(way, other))
    return (
        f"{way.name} would come {near} m near {other.name} ({other.doing}); they need {needed} m, "
        f"heights divided by {ratio:g}{other.hint}"
    )


def shown_m(near_m: float, needed_m: float) -> tuple[str, str]:
    """A distance that is too small, and what is needed, with as many decimals as tell them apart (2 at most)."""
    decimals = 1 if f"{near_m:.1f}" != f"{needed_m:.1f}" else 2
    return f"{near_m:.{decimals}f}", f"{needed_m:.{decimals}f}"


def _legs_distance_m(p: Leg, q: Leg, ratio: float) -> float:
    gap_m = max(0.0, p.low_m - q.high_m, q.low_m - p.high_m)
    return math.hypot(_ground_distance_m(p, q), gap_m / ratio)


def _apart_by_axis_m(p: Leg, q: Leg) -> float:
    """How far apart two legs are at least, over the ground: a third of what their distance costs."""
    (a, b), (c, d), (e, f), (g, h) = p.begin, p.end, q.begin, q.end
    east_m = max((a if a < c else c) - (e if e > g else g), (e if e < g else g) - (a if a > c else c))
    north_m = max((b if b < d else d) - (f if f > h else h), (f if f < h else h) - (b if b > d else d))
    return east_m if east_m > north_m else north_m


def _ground_distance_m(p: Leg, q: Leg) -> float:
    """Distance of two straight lines over the ground: 0 where they cross, else from an end of one of them."""
    if _cross(p, q):
        return 0.0
    return min(
        _from_line_m(p.begin, q.begin, q.end),
        _from_line_m(p.end, q.begin, q.end),
        _from_line_m(q.begin, p.begin, p.end),
        _from_line_m(q.end, p.begin, p.end),
    )


def _cross(p: Leg, q: Leg) -> bool:
    def side(a: Point, b: Point, c: Point) -> float:
        return (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])

    return (
        side(p.begin, p.end, q.begin) * side(p.begin, p.end, q.end) < 0.0
        and side(q.begin, q.end, p.begin) * side(q.begin, q.end, p.end) < 0.0
    )


def _from_line_m(point: Point, begin: Point, end: Point) -> float:
    u, v = end[0] - begin[0], end[1] - begin[1]
    square = u * u + v * v
    x, y = point[0] - begin[0], point[1] - begin[1]
    part = 0.0 if square == 0.0 else min(1.0, max(0.0, (x * u + y * v) / square))
    return math.hypot(x - part * u, y - part * v)
