"""Which of several vehicles that are to return may leave now, so that none comes too near another on its way. Pure.

A vehicle returns as both firmwares do: it climbs to its return height, flies home level, and lands there. Vehicles that
have changed places would descend through each other, whatever their heights.

    the way home of one that waits is                              then it
    ------------------------------------------------------------   --------------------------------------------------
    clear of those under way, and of the places of those that      leaves
    wait
    clear of those under way, and not of some that wait            leaves later: those in its way climb where they
                                                                   stand, above its whole way, one group at a time
    not clear of one that is under way, or that is there           waits until that one is out of its way
    not clear of one that stays: it holds at the end of its        climbs where it stands, if its way is clear above
    return, or where it is, and was not ordered to return          that one; else it is stuck
    not clear, and somebody else's way leads through its place     climbs where it stands above that way

Nobody climbs above the ceiling of its own fence, where the autopilot would act, nor above `ASIDE_M`. What stands below
one that waits, nearer than they need, does not keep it there: it climbs away from that. It is asked again a few times a
second with the vehicles where they are then, so one leaves as soon as the part of another's way that is still to come
is clear of its own.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Collection, Generator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import NamedTuple

from skygcs.core.mavlink.vehicle_class import HeightParam
from skygcs.core.monitor.approach import Vector
from skygcs.core.monitor.conflict_levels import COMING_HOME
from skygcs.core.monitor.tracks import USUAL_BRAKE_MPS2, is_flying, leads, overshoot_m, why_unplaced
from skygcs.core.monitor.ways import (
    Leg,
    Way,
    beginning,
    column,
    leads_on,
    needed_m,
    standing,
    too_near,
    turning_lines,
)
from skygcs.core.separation import Footprint, pair_margin
from skygcs.core.vehicle.vehicle import Vehicle

AT_HOME_M = 1.5
"""A vehicle that returns, is so near its home over the ground and sinks, lands."""

SINKS_MPS = 0.2

ABOVE_M = 1.0
"""A vehicle that climbs out of another's way goes so much higher than it needs to: it holds its height within that."""

AT_A_TURN = 32
"""Ways that are made or compared before others have their turn: a millisecond, of a control period of 20."""

STUCK_S = 45.0
"""While none of them has moved by `MOVED_M` or landed for so long, those that wait are given up. ArduCopter waits for
RTL_LOIT_TIME above its home, 5 s by default, and a landing moves all the while."""

OTHERS_S = 300.0
"""Those that wait hover meanwhile: a fifth of what a small copter's battery holds, half of what it has left then."""

MOVED_M = 1.0
"""Farther than one that hovers wanders by noise and gusts."""

ASIDE_M = 120.0
"""Nobody climbs higher above its home only to let others by, or to get by: what may be flown without a permit. It waits
where it is, for its turn, and is given up as what is stuck is."""

SILENT_S = 1.0
"""The space of one whose position is older grows no more: it hovers, or flies its way home."""

STANDS_MPS = 1.0
"""Faster than by wind and GPS noise: it still brakes, and whether it gets by is judged where it stands then."""


class ReturnHeight(NamedTuple):
    """Between which heights above its home a vehicle flies home, if it is not higher already.

    PX4: RTL_RETURN_ALT, and near its home less (RTL::calculate_return_alt_from_cone_half_angle). ArduCopter: RTL_ALT,
    near its home less (RTL_CONE_SLOPE), and at least RTL_CLIMB_MIN above where it is (ModeRTL::compute_return_target).
    """

    least_m: float
    most_m: float
    climb_m: float = 0.0
    """It climbs by so much at least."""


UNKNOWN = ReturnHeight(0.0, math.inf)


def known_return_height(vehicle: Vehicle) -> ReturnHeight:
    """The return height by parameters that have been read before; `UNKNOWN` without them."""
    able = vehicle.abilities
    climb_m = _known(vehicle, able.return_climb) if able.return_climb else 0.0
    if climb_m is None:
        return UNKNOWN
    return return_height([_known(vehicle, height) for height in able.return_heights], climb_m)


def return_height(heights_m: Sequence[float | None], climb_m: float | None) -> ReturnHeight:
    """The highest of its heights; `UNKNOWN` if one of them is not known. Below 0: as high as it is (ArduPlane)."""
    known = [max(height_m, 0.0) for height_m in heights_m if height_m is not None and math.isfinite(height_m)]
    if not known or len(known) < len(heights_m):
        return UNKNOWN
    climb_m = climb_m if climb_m is not None and math.isfinite(climb_m) else 0.0
    return ReturnHeight(0.0, max(known), max(climb_m, 0.0))


def _known(vehicle: Vehicle, param: HeightParam) -> float | None:
    return next((value / per_metre for name, per_metre in param if (value := vehicle.param(name)) is not None), None)


def is_placed(vehicle: Vehicle, now: float) -> bool:
    """True if its way home is known: it flies, is heard, and reports where it and its home are."""
    position, home = vehicle.telemetry("position"), vehicle.telemetry("home")
    placed = home is not None and why_unplaced(position) is None
    stays = vehicle.abilities_now(now).hovers and not vehicle.abilities_now(now).circles
    return placed and stays and vehicle.connected and not vehicle.replayed and is_flying(vehicle, now)


def why_not_held(vehicle: Vehicle) -> str | None:
    """Why it must not be held: its own failsafe, or its return or landing. None: nothing."""
    if vehicle.mode in COMING_HOME:
        return f"it is in {vehicle.mode}"
    return "its own failsafe acts" if vehicle.failsafe else None


@dataclass(frozen=True, slots=True)
class Returning:
    """A vehicle that is to return, or does. Places: east, north, up in a frame common to all, m."""

    key: int
    name: str
    footprint: Footprint
    here: Vector
    velocity_mps: Vector
    home: Vector
    height: ReturnHeight = UNKNOWN
    age_s: float = 0.0
    """Age of its position."""
    goal_m: float | None = None
    """The height to which it climbs where it stands."""
    lands: bool = False
    """It comes down where it is, not at its home."""
    ceiling_m: float = math.inf
    """It is sent no higher than this, in the common frame: its own fence acts there."""

    @property
    def highest_m(self) -> float:
        """The top of its way home."""
        return max(self.here[2] + self.height.climb_m, self.home[2] + self.height.most_m)

    @property
    def near_m(self) -> float:
        """How far it may be from its place, or from its way."""
        return self.footprint.ball_m(min(self.age_s, SILENT_S))

    def as_seen(self) -> Returning:
        """Itself without what is not known of its way: where it is since its last position, and, if that was not read,
        how high it climbs."""
        return replace(self, age_s=0.0, height=ReturnHeight(0.0, 0.0) if self.height is UNKNOWN else self.height)

    def _brakes_m(self, velocity_mps: Vector) -> Vector:
        """How far from here it comes to rest, if it is ordered to hold or to return while it flies so."""
        speed_mps = math.hypot(*velocity_mps)
        on_s = overshoot_m(velocity_mps, USUAL_BRAKE_MPS2) / speed_mps if speed_mps > 0.0 else 0.0
        return velocity_mps[0] * on_s, velocity_mps[1] * on_s, velocity_mps[2] * on_s

    def place(self) -> Way:
        """Its space while it waits, or climbs where it stands; one that moves brakes first."""
        return self.up_to(self.here[2] + self._brakes_m(self.velocity_mps)[2] if self.goal_m is None else self.goal_m)

    def up_to(self, goal_m: float) -> Way:
        """Its space while it climbs to this height where it stands."""
        (x, y, z), (u, v, w) = self.here, self._brakes_m(self.velocity_mps)
        leg = Leg((x, y), (x + u, y + v), min(z, z + w), max(z, goal_m))
        return Way(self.key, self.name, self.footprint, (leg,), self.near_m, "waits")

    def way(self, *, under_way: bool = False) -> Way:
        """Its space from here to the ground at its home, or where it lands. What does not fly there yet brakes first,
        and turns."""
        (x, y, z), home_xy, level = self.here, self.home[:2], (*self.velocity_mps[:2], 0.0)
        to_home = (home_xy[0] - x, home_xy[1] - y, 0.0)
        u, v, w = self._brakes_m(level if under_way else self.velocity_mps)
        if under_way and self.lands:
            legs: tuple[Leg, ...] = (Leg((x, y), (x + u, y + v), self.home[2], z),)
        elif under_way and math.hypot(*to_home) <= AT_HOME_M and self.velocity_mps[2] < -SINKS_MPS:
            legs = (column((*home_xy, z), self.home[2]),)
        else:
            turns = () if under_way and leads(level, to_home) else self._turns(level)
            low_m, top_m = min(z, z + w), max(self.highest_m, z + w)
            level_m = max(low_m, self.home[2] + self.height.least_m)
            up = Leg((x, y), (x + u, y + v) if turns else (x, y), low_m, top_m)
            lines = ((self.here, self.home), *turns)
            legs = (up, *(Leg(a[:2], b[:2], level_m, top_m) for a, b in lines), column(self.home, top_m))
        return Way(self.key, self.name, self.footprint, legs, self.near_m, "returns" if under_way else "waits")

    def _turns(self, level: Vector) -> tuple[tuple[Vector, Vector], ...]:
        """The lines over the ground between where it brakes and its way home; none if it stands."""
        on_m = overshoot_m(level, USUAL_BRAKE_MPS2)
        lines = turning_lines((*self.here[:2], 0.0), level, on_m, (*self.home[:2], 0.0))
        return tuple(pair for line in lines for pair in itertools.pairwise(line[1:]))


@dataclass(frozen=True, slots=True)
class Departures:
    """``leave``: keys. ``climb``: by key, the height in the common frame to climb to in place. ``waits_for``: by key of
    those that wait, the names of what is in their way. ``stuck``: those of them whose way does not become clear unless
    somebody moves what is in it: by key, the names."""

    leave: tuple[int, ...] = ()
    climb: Mapping[int, float] = field(default_factory=dict)
    waits_for: Mapping[int, tuple[str, ...]] = field(default_factory=dict)
    stuck: Mapping[int, tuple[str, ...]] = field(default_factory=dict)
    fenced: frozenset[int] = frozenset()
    """Those that would have to climb above their ceilings, or `ASIDE_M`."""


class Progress:
    """When one of those that return, or of those in their way, has last moved or landed. ``begun_at``: the beginning,
    which counts as such."""

    def __init__(self, begun_at: float = -math.inf) -> None:
        self.moved_at = self._ours_moved_at = begun_at
        self._places: dict[int, Vector] = {}
        """Where each was when it last had moved."""

    def note(self, key: int, here: Vector | None, now: float, *, ours: bool) -> None:
        """Note where one is; None: not in the air, or not known. ``ours``: it waits, or comes home."""
        last = self._places.get(key)
        if (here is None) == (last is None) and not (here and last and math.dist(here, last) > MOVED_M):
            return
        self.moved_at = now
        if ours or here is None:
            self._ours_moved_at = now
        if here is None:
            del self._places[key]
        else:
            self._places[key] = here

    def goes_on(self, now: float) -> bool:
        """True if one has moved in the last `STUCK_S`; if only those did that others fly, for `OTHERS_S` at most."""
        return now - self.moved_at < STUCK_S and now - self._ours_moved_at < OTHERS_S


def departing(
    waiting: Sequence[Returning],
    under_way: Sequence[Returning],
    fixed: Sequence[Way] = (),
    stays: Collection[int] = (),
) -> Generator[None, None, Departures]:
    """Decide which of ``waiting`` leave or climb now; yields after each of them. ``fixed``: what does not move now, or
    is not known to go home. ``stays``: keys of those of them that do not move without an order."""
    moving = [other.way(under_way=True) for other in under_way]
    leaving: dict[int, Way] = {}
    blocked: dict[int, tuple[list[Way], list[Returning]]] = {}
    ordered = sorted(waiting, key=lambda one: (one.highest_m, math.dist(one.here[:2], one.home[:2]), one.name))
    places = {one.key: one.place() for one in ordered}
    for one in ordered:
        way = one.way()
        taken = [other for other in (*moving, *leaving.values()) if too_near(way, other)]
        yield
        for first in range(0, len(fixed), AT_A_TURN):
            taken += [other for other in fixed[first : first + AT_A_TURN] if _blocks(one, way, other)]
            yield
        standing_there = [
            other
            for other in ordered
            if other.key != one.key and other.key not in leaving and too_near(way, places[other.key])
        ]
        if taken or standing_there:
            blocked[one.key] = taken, standing_there
        else:
            leaving[one.key] = way
        yield
    space = [*moving, *leaving.values(), *fixed]
    fenced = set[int]()
    aside = yield from _out_of_ways(ordered, blocked, space, stays, fenced)
    climb = aside or (yield from _climbs(ordered, blocked, space, fenced))
    over, stuck = yield from _over_those_that_stay(ordered, blocked, space, stays, fenced)
    waits_for = {
        key: tuple(dict.fromkeys((*(way.name for way in taken), *(other.name for other in there))))
        for key, (taken, there) in blocked.items()
    }
    return Departures(tuple(leaving), climb or over, waits_for, stuck, frozenset(fenced))


def one_at_a_time(waiting: Mapping[int, str], ahead: Collection[str]) -> Departures:
    """Decide without any place: one of ``waiting`` (names by key) leaves once nobody is ``ahead``."""
    keys = sorted(waiting, key=waiting.__getitem__)
    leave = () if ahead else tuple(keys[:1])
    names = (*ahead, *(waiting[key] for key in leave))
    return Departures(leave, waits_for={key: names for key in keys if key not in leave})


def _blocks(one: Returning, way: Way, other: Way) -> bool:
    """True if its way home comes too near what does not leave. It may climb away from what is below it already."""
    if not too_near(way, other):
        return False
    away = other.heights[1] < one.here[2] and too_near(replace(way, legs=standing(one.here)), other)
    return not away or too_near(replace(way, legs=way.legs[1:]), other)


def _climbs(
    ordered: Sequence[Returning],
    blocked: Mapping[int, tuple[list[Way], list[Returning]]],
    taken: Sequence[Way],
    fenced: set[int],
) -> Generator[None, None, dict[int, float]]:
    """Return which vehicles climb, and to where, so that one of those leaves that only wait for others that wait: the
    one with the fewest in its way, and rather one that was not sent up out of another's way itself. ``fenced`` gets
    those whose ceilings are lower."""
    only_wait = [one for one in ordered if one.key in blocked and not blocked[one.key][0]]
    for one in sorted(only_wait, key=lambda one: (one.goal_m is not None, len(blocked[one.key][1]))):
        if math.isinf(one.highest_m):
            continue
        goals = _above(one, blocked[one.key][1])
        found: dict[int, float] = {}
        for other in blocked[one.key][1]:
            yield
            up = other.up_to(goals[other.key])
            rest = [*taken, *(third.place() for third in ordered if third.key != other.key)]
            if _is_too_high(other, goals[other.key]):
                fenced.add(other.key)
            elif goals[other.key] > other.here[2] + ABOVE_M / 2 and not any(too_near(up, way) for way in rest):
                found[other.key] = goals[other.key]
        if found:
            return found
    return {}


def _out_of_ways(
    ordered: Sequence[Returning],
    blocked: Mapping[int, tuple[list[Way], list[Returning]]],
    taken: Sequence[Way],
    stays: Collection[int],
    fenced: set[int],
) -> Generator[None, None, dict[int, float]]:
    """Return the key of a waiting vehicle whose place others' ways lead through, with the height that clears those ways
    there, at most `ASIDE_M`; empty if there is none. It climbs only while no other vehicle is near its column."""
    for one in ordered:
        if one.key not in blocked:
            continue
        yield
        through = [way for way in taken if way.key not in stays and too_near(one.place(), way) and leads_on(way)]
        goals = [_height_above(one, _over(one, way)) if way.is_known else math.inf for way in through]
        if not goals or math.isinf(goal_m := max(goals)):
            continue
        if _is_too_high(one, goal_m):
            fenced.add(one.key)
            continue
        up = one.up_to(goal_m)
        rest = [beginning(way) if way in through else way for way in taken]
        rest += [other.place() for other in ordered if other.key != one.key]
        if not any(too_near(up, way) for way in rest):
            return {one.key: goal_m}
    return {}


def _is_too_high(one: Returning, goal_m: float) -> bool:
    """True if it is not sent up to there: its own fence acts at its return, or it is above `ASIDE_M`."""
    return goal_m + one.height.climb_m > one.ceiling_m or goal_m > one.home[2] + ASIDE_M


def _over(one: Returning, way: Way) -> Way:
    """The legs of a way that comes too near one where it stands, or that would if it climbed there."""
    up = one.up_to(math.inf)
    return replace(way, legs=tuple(leg for leg in way.legs if too_near(up, replace(way, legs=(leg,)))))


def _height_above(one: Returning, way: Way) -> float:
    """The height at which one that returns is above the whole of a way."""
    ratio = pair_margin(one.footprint, way.footprint).downwash_ratio
    return way.heights[1] + ratio * needed_m(one.way(), way) + ABOVE_M


def _over_those_that_stay(
    ordered: Sequence[Returning],
    blocked: Mapping[int, tuple[list[Way], list[Returning]]],
    taken: Sequence[Way],
    stays: Collection[int],
    fenced: set[int],
) -> Generator[None, None, tuple[dict[int, float], dict[int, tuple[str, ...]]]]:
    """One that may climb now above those that stay in its way home, with the height; and those that cannot get by."""
    climb: dict[int, float] = {}
    stuck: dict[int, tuple[str, ...]] = {}
    for one in ordered:
        staying = [way for way in blocked[one.key][0] if way.key in stays] if one.key in blocked else []
        if not staying or math.isinf(one.highest_m) or math.hypot(*one.velocity_mps[:2]) > STANDS_MPS:
            continue
        yield
        goal_m = max(one.here[2], *(_height_above(one, way) for way in staying))
        raised = replace(one, here=(*one.here[:2], goal_m))
        if too_high := _is_too_high(one, goal_m):
            fenced.add(one.key)
        if too_high or any(too_near(raised.way(), way) for way in staying):
            stuck[one.key] = tuple(way.name for way in staying)
            continue
        up = one.up_to(goal_m)
        rest = [*taken, *(other.place() for other in ordered if other.key != one.key)]
        if not climb and not any(too_near(up, way) for way in rest):
            climb[one.key] = goal_m
    return climb, stuck


def _above(one: Returning, others: Sequence[Returning]) -> dict[int, float]:
    """The heights at which those that wait are above the whole way of one, and above each other as they are now."""
    goals: dict[int, float] = {}
    placed: list[Returning] = []
    for other in sorted(others, key=lambda other: other.here[2]):
        ratio = pair_margin(one.footprint, other.footprint).downwash_ratio
        goal_m = max(other.here[2], one.highest_m + ratio * needed_m(one.way(), other.place()) + ABOVE_M)
        for below in placed:
            need_m = needed_m(below.place(), other.place())
            if math.dist(below.here[:2], other.here[:2]) < need_m:
                ratio = pair_margin(below.footprint, other.footprint).downwash_ratio
                goal_m = max(goal_m, goals[below.key] + ratio * need_m + ABOVE_M)
        goals[other.key] = goal_m
        placed.append(other)
    return goals
