"""Where references try to go, so that they get around each other: heuristics, whose safety is the filter's.

A reference asks for the velocity straight to its place, unless that comes too near another within `LOOK_S`; then for
those turned aside as well, the best first: by how much they leave the straight way, and how soon they come near
(reciprocal velocity obstacles: van den Berg, Lin and Manocha, ICRA 2008). One that has not come on for `STUCK_S` flies
a detour for a few seconds. No way around is promised: where the place is taken, it waits.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

from skygcs.core.monitor.approach import closest_approach
from skygcs.ext.formation.separation_filter import REST, MotionBounds, Moving, Obstacle, SeparationFilter, Vector, minus

LOOK_S = 5.0
"""So far ahead a reference looks for another way: at 2 m/s it turns aside 10 m before another."""

TRIED = 8
"""Velocities that one reference asks for in one step: each takes the filter 0.1 ms among 20 (measured)."""

APPROACH_PER_S = 0.8
"""Speed towards a place per metre of distance, near it."""

BRAKE_SHARE = 0.7
"""A reference plans its arrival with this share of the deceleration that it may have: the rest corrects errors."""

HEADINGS_RAD = tuple(math.radians(a) for a in (-25.0, 25.0, -50.0, 50.0, -80.0, 80.0, -115.0))
"""Turned aside by so much; to the right first, as aircraft give way (ICAO Annex 2, 3.2.2.2)."""

HINDERED_S = 1.0
"""One that could not go straight looks for other ways for so long: else it would try in every second step only."""

LEFT_MPS = 0.3
"""A way to the left has to be better than one to the right by so much, so that two do not dodge to the same side."""

STUCK_S, CAME_ON_M = 3.0, 0.3
"""One that has come on by less than this for so long looks for a detour."""

LOST_GROUND_M = 3.0
"""After a detour, or when its place moves: from there on it is judged anew."""

DETOURS = (
    *((0.0, -1.0, 0.0), (0.0, 0.0, 1.0), (-0.7, -0.7, 0.0)),
    *((0.0, 0.0, -1.0), (0.0, 1.0, 0.0), (-0.5, 0.0, 1.0)),
)
"""Ahead, to the left, up; in shares of the largest speeds. Each vehicle begins with another one."""

DETOUR_S, LONGER_S = 2.5, 0.5
"""The first detour, and by how much the next one is longer (five times at most)."""


class Neighbour(NamedTuple):
    """Something that one may come near soon, in the metric of the filter."""

    offset_m: Vector
    velocity_mps: Vector
    kept_m: float
    share: float
    """How much of giving way is ours: half if it gives way, too."""


@dataclass(slots=True)
class Progress:
    """Progress of one reference towards its place."""

    nearest_m: float = math.inf
    since: float = -math.inf
    """When it last came on."""
    hindered_until: float = -math.inf
    """It could not go straight a moment ago."""
    detour: Vector | None = None
    detour_until: float = -math.inf
    detours: int = 0

    def hindered(self, now: float) -> bool:
        """True if another is in its way."""
        return now < self.hindered_until


@dataclass(slots=True)
class Evasion:
    """`asked` before each step of the filter, whose members it reads."""

    progress: dict[str, Progress] = field(default_factory=dict)

    def asked(
        self, filter_: SeparationFilter, wanted: Mapping[str, Moving], obstacles: Sequence[Obstacle], now: float
    ) -> dict[str, list[Vector]]:
        """The velocities that each member asks for. ``wanted``: where each is to be. The farthest from its place has
        the first choice, since the others have arrived or nearly so."""
        members, asks = filter_.members, dict[str, Vector]()
        for name, there in wanted.items():
            moving = members[name].moving
            straight = straight_to(moving, there, filter_.bounds)
            asks[name] = self._detour(name, straight, moving, there, filter_.bounds, now) or straight
        away_m = {name: math.dist(members[name].moving.pos_enu_m, there.pos_enu_m) for name, there in wanted.items()}
        names = sorted(wanted, key=lambda name: (-round(away_m[name]), name))
        return {name: self._velocities(filter_, name, asks, obstacles, now) for name in names}

    def _velocities(
        self,
        filter_: SeparationFilter,
        name: str,
        asks: Mapping[str, Vector],
        obstacles: Sequence[Obstacle],
        now: float,
    ) -> list[Vector]:
        """``asks``: the velocity that each member asks for first."""
        member, progress, straight = filter_.members[name], self.progress[name], asks[name]
        # all go straight, unless two of them would come too near each other
        free_s = _free_s(filter_.metric(straight), REST, _neighbours(filter_, name, obstacles, asks))
        if free_s < LOOK_S or member.taken is None:
            progress.hindered_until = now + HINDERED_S
        if not progress.hindered(now):
            return [straight]
        near = list(_neighbours(filter_, name, obstacles, {}))
        present = filter_.metric(member.moving.vel_enu_mps)
        rated = []
        for n, candidate in enumerate((straight, *_aside(straight, filter_.bounds))):
            free_s = _free_s(filter_.metric(candidate), present, near)
            rated.append((_cost(candidate, straight, free_s, filter_.bounds), n, candidate))
        return [velocity for _, _, velocity in sorted(rated)[:TRIED]]

    def _detour(
        self, name: str, straight: Vector, moving: Moving, wanted: Moving, bounds: MotionBounds, now: float
    ) -> Vector | None:
        """The velocity of its detour; None: it flies none."""
        progress = self.progress.setdefault(name, Progress())
        away_m = math.dist(moving.pos_enu_m, wanted.pos_enu_m)
        came_on = not progress.nearest_m - CAME_ON_M <= away_m <= progress.nearest_m + LOST_GROUND_M
        if came_on or away_m < CAME_ON_M:
            progress.nearest_m, progress.since = away_m, now
        if now < progress.detour_until:
            return progress.detour
        progress.detour = None
        if not progress.hindered(now) or now - progress.since < STUCK_S:
            return None
        # the next of the detours; the number of the first comes from its name, so that neighbours try others
        ahead, left, up = DETOURS[(progress.detours + sum(name.encode())) % len(DETOURS)]
        x, y, across = straight[0], straight[1], math.hypot(straight[0], straight[1])
        x, y = (1.0, 0.0) if across < 0.1 else (x / across, y / across)
        progress.detour = (
            (x * ahead - y * left) * bounds.speed_mps,
            (x * left + y * ahead) * bounds.speed_mps,
            up * bounds.climb_mps,
        )
        progress.detour_until = now + DETOUR_S + LONGER_S * (progress.detours % 5)
        progress.nearest_m, progress.since = math.inf, progress.detour_until
        progress.detours += 1
        return progress.detour


def straight_to(moving: Moving, wanted: Moving, bounds: MotionBounds) -> Vector:
    """The velocity towards a place, which moves itself, with which a reference can still stop there."""
    x, y, z = (q - p for p, q in zip(moving.pos_enu_m, wanted.pos_enu_m, strict=True))
    away_m = math.hypot(x, y, z)
    if away_m == 0.0:
        return bounds.limited_velocity(wanted.vel_enu_mps)
    brake = BRAKE_SHARE * bounds.brake_mps2((x, y, z))
    share = min(APPROACH_PER_S * away_m, math.sqrt(2.0 * brake * away_m)) / away_m
    u, v, w = wanted.vel_enu_mps
    return bounds.limited_velocity((u + x * share, v + y * share, w + z * share))


def _aside(straight: Vector, bounds: MotionBounds) -> Iterator[Vector]:
    x, y, z = straight
    across = math.hypot(x, y)
    if across < 0.5:  # over or under another, or nearly there
        x, y = (1.0, 0.0) if across == 0.0 else (x / across, y / across)
    for angle in HEADINGS_RAD:
        cos, sin = math.cos(angle), math.sin(angle)
        yield x * cos - y * sin, x * sin + y * cos, z
    yield 0.6 * x, 0.6 * y, bounds.climb_mps
    yield 0.6 * x, 0.6 * y, -bounds.climb_mps
    yield 0.4 * x, 0.4 * y, 0.4 * z
    yield REST


def _neighbours(
    filter_: SeparationFilter, name: str, obstacles: Sequence[Obstacle], asks: Mapping[str, Vector]
) -> Iterator[Neighbour]:
    """Everything that is near one. ``asks``: velocities that members go over to, without giving way; the others fly on
    as they do, and give way by half."""
    member = filter_.members[name]
    here, reach_m = filter_.metric(member.moving.pos_enu_m), 2.0 * filter_.bounds.speed_mps * LOOK_S
    for other, them in filter_.members.items():
        if other != name:
            there, kept_m = filter_.metric(them.moving.pos_enu_m), filter_.kept_m(name, other)
            if math.dist(here, there) < kept_m + reach_m:
                asked = asks.get(other)
                velocity = filter_.metric(them.moving.vel_enu_mps if asked is None else asked)
                yield Neighbour(minus(there, here), velocity, kept_m, 0.5 if asked is None else 1.0)
    for obstacle in obstacles:
        there, kept_m = filter_.metric(obstacle.pos_enu_m), member.radius_m + obstacle.radius_m
        if math.dist(here, there) < kept_m + reach_m:
            yield Neighbour(minus(there, here), filter_.metric(obstacle.vel_enu_mps), kept_m, 1.0)


def _free_s(velocity: Vector, present: Vector, near: Iterable[Neighbour]) -> float:
    """Until it comes too near another if it flies with this velocity, and each of the two gives way by its share."""
    free_s = LOOK_S
    for offset, theirs, kept_m, share in near:
        u, v, w = (q - (p + (c - p) / share) for p, c, q in zip(present, velocity, theirs, strict=True))
        found = closest_approach(offset, (u, v, w), kept_m, LOOK_S)
        if found.enters_s > 0.0 or found.at_s > 0.0:  # not nearer than it should be, and on its way out
            free_s = min(free_s, found.enters_s)
    return free_s


def _cost(velocity: Vector, straight: Vector, free_s: float, bounds: MotionBounds) -> float:
    """Metres per second by which it leaves the straight way, and the dearer the sooner it comes near another."""
    soon = 0.0 if free_s >= LOOK_S else 1.5 * bounds.speed_mps / max(free_s, 0.2)
    left = straight[0] * velocity[1] - straight[1] * velocity[0] > 1e-9
    return math.dist(velocity, straight) + soon + (LEFT_MPS if left else 0.0)
