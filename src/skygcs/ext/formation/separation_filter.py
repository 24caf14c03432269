"""A filter that keeps the references of several vehicles apart: of what each is asked to do, it lets pass only what
leaves all of them room to stop.

A reference is a point with a velocity that a vehicle is sent to. Each has a backup: it brakes straight on, as hard as
its `MotionBounds` allow, and stands. `SeparationFilter.step` looks at every pair over the step and both backups after
it, and takes an acceleration only if no pair comes nearer than its distance on all that way; a reference for which none
is found goes on along its backup.

What is promised, by induction over the steps: at the start all stand, and a step along the backups of the step before
is the rest of a way that was looked at, so there is always a way that keeps every distance, whatever is asked for. It
is a safety filter with backup trajectories (Wabersich and Zeilinger, "Linear model predictive safety certification for
learning-based control", CDC 2018; Gurriet et al., "A scalable safety critical control framework for nonlinear systems",
IEEE Access 2020).

What is not promised: that a reference arrives, as several may block each other (`ext.formation.evasion` looks for ways
around), and anything of an obstacle that does not fly straight on: near it no acceleration is taken that is worse than
to brake. The references are the ground's own, so their age is zero; how far each vehicle may be from its reference is
part of its distance (`core.plan.margins`).

Between the points of a way: a curve whose acceleration is at most a lies within a·h²/8 of its chord of h.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

from skygcs.core.monitor.approach import closest_approach

Vector = tuple[float, float, float]

REST: Vector = (0.0, 0.0, 0.0)

GRID_S = 0.2
"""Between two points of a way: two references that brake with 2 m/s² each bow by 2 cm."""

LONGEST_STEP_S = 0.3
"""A later step goes on from where the references are; three periods."""

FLIES_ON_S = 3.0
"""An obstacle is looked at for so long after a reference could stand: time to get out of its way."""

SLACK_M = 0.05
"""Two that keep exactly their distance could not move beside each other: bows and roundings are taken off it."""

RESPONSE_S = 0.5
"""In which a reference takes up the velocity it is asked for, as far as its acceleration allows."""


@dataclass(frozen=True, slots=True)
class MotionBounds:
    """The limits of a reference's motion, across and up or down."""

    speed_mps: float = 2.0
    climb_mps: float = 1.0
    acc_xy_mps2: float = 1.5
    acc_z_mps2: float = 0.8

    @property
    def acceleration_mps2(self) -> float:
        """Both together."""
        return math.hypot(self.acc_xy_mps2, self.acc_z_mps2)

    def limited_velocity(self, vel: Vector) -> Vector:
        """The velocity, within its limits."""
        return _limited(vel, self.speed_mps, self.climb_mps)

    def limited_acceleration(self, acc: Vector) -> Vector:
        """The acceleration, within its limits."""
        return _limited(acc, self.acc_xy_mps2, self.acc_z_mps2)

    def brake_mps2(self, vel: Vector) -> float:
        """The deceleration straight against a velocity that both limits allow."""
        speed, across, up = math.hypot(*vel), math.hypot(vel[0], vel[1]), abs(vel[2])
        by_xy = self.acc_xy_mps2 * speed / across if across > 0.0 else math.inf
        by_z = self.acc_z_mps2 * speed / up if up > 0.0 else math.inf
        return min(by_xy, by_z)


def _limited(vector: Vector, across_limit: float, up_limit: float) -> Vector:
    across, up = math.hypot(vector[0], vector[1]), abs(vector[2])
    share = 1.0 if across <= across_limit else across_limit / across
    share_z = 1.0 if up <= up_limit else up_limit / up
    return vector[0] * share, vector[1] * share, vector[2] * share_z


class Moving(NamedTuple):
    """A point and its velocity: east, north, up of the fleet's frame."""

    pos_enu_m: Vector
    vel_enu_mps: Vector = REST


class Obstacle(NamedTuple):
    """Something that does not obey the filter, where it is now."""

    name: str
    pos_enu_m: Vector
    vel_enu_mps: Vector
    radius_m: float
    """Its part of the distance, the ball included in which it may be by now."""


class Way(NamedTuple):
    """The points of a step and the backup after it, every `GRID_S`; the last one is where it stands."""

    points: Sequence[Vector]
    """Heights divided by the downwash ratio."""
    reach_m: float
    """From the first point to the farthest, the bow included."""
    bow_m: float


class Try(NamedTuple):
    """One step that a reference could take."""

    acc_enu_mps2: Vector
    after: Moving
    way: Way


Allowed = Callable[[str, Moving, Vector], bool]
"""True if a vehicle may move so, and brake from there to this place."""


@dataclass(slots=True)
class Member:
    """One reference."""

    radius_m: float
    """Its part of the distance of each of its pairs."""
    moving: Moving
    acc_enu_mps2: Vector = REST
    """That of the last step, which led here."""
    taken: int | None = 0
    """Which of the velocities that it was asked for was taken in the last step, from 0; None: it braked."""


@dataclass(slots=True)
class SeparationFilter:
    """`step` once per period. All references stand at the beginning."""

    members: dict[str, Member]
    bounds: MotionBounds
    downwash_ratio: float
    allowed: Allowed = lambda name, moving, stands: True
    floors_m: dict[tuple[str, str], float] = field(default_factory=dict)
    """The distance of pairs that began nearer than they should; it only grows."""

    def __post_init__(self) -> None:
        names = sorted(self.members)
        for i, a in enumerate(names):
            for b in names[i + 1 :]:
                now_m = self.distance_m(a, b)
                if now_m < self.wanted_m(a, b) + SLACK_M:
                    self.floors_m[a, b] = now_m - SLACK_M

    def wanted_m(self, a: str, b: str) -> float:
        """The distance that two are to keep, in the metric of the downwash ratio."""
        return self.members[a].radius_m + self.members[b].radius_m

    def kept_m(self, a: str, b: str) -> float:
        """The distance that is promised for two: less than `wanted_m` while they have not been as far apart."""
        return self.floors_m.get((a, b) if a < b else (b, a), self.wanted_m(a, b))

    def distance_m(self, a: str, b: str) -> float:
        """Distance of two references now, in the metric of the downwash ratio."""
        return math.dist(self.metric(self.members[a].moving.pos_enu_m), self.metric(self.members[b].moving.pos_enu_m))

    def metric(self, point: Vector) -> Vector:
        """A point, offset or velocity with its vertical part divided by the downwash ratio."""
        return point[0], point[1], point[2] / self.downwash_ratio

    # -- one step

    def step(self, asked: Mapping[str, Sequence[Vector]], obstacles: Sequence[Obstacle], dt_s: float) -> None:
        """Advance every reference by ``dt_s``. ``asked``: of each the velocities to go over to, the best first. The
        member that comes first in it has the first choice; one that is left out brakes."""
        dt_s = min(dt_s, LONGEST_STEP_S)
        chosen = {name: self._braked(member.moving, dt_s) for name, member in self.members.items()}
        ways = {name: self._way(member.moving, REST, member.moving, 0.0) for name, member in self.members.items()}
        hazards = [self._hazard(obstacle) for obstacle in obstacles]
        for member in self.members.values():
            member.taken = None
        for name, velocities in asked.items():
            member = self.members[name]
            for n, (acc, after, way) in self._tries(name, velocities, ways[name], hazards, dt_s):
                if self._fits(name, way, ways, hazards) and self.allowed(name, after, self._end(way)):
                    chosen[name], ways[name], member.taken = (acc, after), way, n
                    break
        for a, b in list(self.floors_m):
            self._raise_floor(a, b, ways)
        for name, member in self.members.items():
            member.acc_enu_mps2, member.moving = chosen[name]

    def _tries(
        self, name: str, velocities: Sequence[Vector], braking: Way, hazards: Sequence[Obstacle], dt_s: float
    ) -> Iterable[tuple[int, Try]]:
        """Number and step of each velocity that is asked for. Where an obstacle comes near even if it brakes, the one
        that keeps away from it for longest comes first."""
        moving, radius_m = self.members[name].moving, self.members[name].radius_m

        def tries() -> Iterator[tuple[int, Try]]:
            for n, velocity in enumerate(velocities):
                if not all(map(math.isfinite, velocity)):  # no comparison would stop it
                    continue
                acc = self._towards(moving, velocity)
                after = _after(moving, acc, dt_s)
                yield n, Try(acc, after, self._way(moving, acc, after, dt_s))

        if not any(_risk(braking, hazard, radius_m)[0] < math.inf for hazard in hazards):
            return tries()
        return sorted(tries(), key=lambda one: min(_risk(one[1].way, h, radius_m) for h in hazards), reverse=True)

    def _raise_floor(self, a: str, b: str, ways: Mapping[str, Way]) -> None:
        """Keep what a pair has gained on its ways, less the slack that lets it move at all."""
        gained_m = _least_m(ways[a], ways[b]) - SLACK_M
        if gained_m >= self.wanted_m(a, b):
            del self.floors_m[a, b]
        else:
            self.floors_m[a, b] = max(gained_m, self.floors_m[a, b])

    def _towards(self, moving: Moving, velocity: Vector) -> Vector:
        x, y, z = (w - v for w, v in zip(velocity, moving.vel_enu_mps, strict=True))
        return self.bounds.limited_acceleration((x / RESPONSE_S, y / RESPONSE_S, z / RESPONSE_S))

    # -- ways

    def _braked(self, moving: Moving, dt_s: float) -> tuple[Vector, Moving]:
        """(acceleration, where it is after the step) of its backup."""
        speed = math.hypot(*moving.vel_enu_mps)
        if speed == 0.0:
            return REST, moving
        brake = self.bounds.brake_mps2(moving.vel_enu_mps)
        acc = _times(moving.vel_enu_mps, -brake / speed)
        if brake * dt_s < speed:
            return acc, _after(moving, acc, dt_s)
        return acc, Moving(_after(moving, acc, speed / brake).pos_enu_m, REST)  # it stands within the step

    def _way(self, begin: Moving, acc: Vector, after: Moving, dt_s: float) -> Way:
        """A step with this acceleration, and the backup from where it leads; with a step of 0 the backup alone."""
        ratio = self.downwash_ratio
        (x, y, z), (u, v, w), (a, b, c) = begin.pos_enu_m, begin.vel_enu_mps, acc
        points: list[Vector] = [(x, y, z / ratio)]
        t_s = GRID_S
        while t_s <= dt_s:
            half = 0.5 * t_s * t_s
            points.append((x + u * t_s + a * half, y + v * t_s + b * half, (z + w * t_s + c * half) / ratio))
            t_s += GRID_S
        (x, y, z), (u, v, w) = after
        speed = math.hypot(u, v, w)
        brake = self.bounds.brake_mps2(after.vel_enu_mps) if speed > 0.0 else 0.0
        stands_s = speed / brake if speed > 0.0 else 0.0
        t_s -= dt_s
        while t_s < stands_s:
            along_s = t_s - 0.5 * brake * t_s * t_s / speed
            points.append((x + u * along_s, y + v * along_s, (z + w * along_s) / ratio))
            t_s += GRID_S
        along_s = 0.5 * stands_s
        points.append((x + u * along_s, y + v * along_s, (z + w * along_s) / ratio))
        bow_m = self.bounds.acceleration_mps2 * GRID_S * GRID_S / 8.0
        return Way(points, max(math.dist(points[0], point) for point in points) + bow_m, bow_m)

    def backup(self, name: str, step_s: float, count: int) -> list[Vector]:
        """Where a reference is now and after each of ``count`` steps of ``step_s``, if it brakes now."""
        (x, y, z), vel = self.members[name].moving
        speed = math.hypot(*vel)
        brake = self.bounds.brake_mps2(vel) if speed > 0.0 else 0.0
        found: list[Vector] = []
        for k in range(count + 1):
            t_s = 0.0 if speed == 0.0 else min(k * step_s, speed / brake)
            along_s = 0.0 if speed == 0.0 else t_s - 0.5 * brake * t_s * t_s / speed
            found.append((x + vel[0] * along_s, y + vel[1] * along_s, z + vel[2] * along_s))
        return found

    def _end(self, way: Way) -> Vector:
        x, y, z = way.points[-1]
        return x, y, z * self.downwash_ratio

    def _hazard(self, obstacle: Obstacle) -> Obstacle:
        """It in the metric."""
        return obstacle._replace(
            pos_enu_m=self.metric(obstacle.pos_enu_m), vel_enu_mps=self.metric(obstacle.vel_enu_mps)
        )

    def _fits(self, name: str, way: Way, ways: Mapping[str, Way], hazards: Iterable[Obstacle]) -> bool:
        """True if a way of this one keeps its distance to all others along the ways that they have now."""
        here = way.points[0]
        for other, theirs in ways.items():
            if other == name:
                continue
            kept_m = self.kept_m(name, other)
            if math.dist(here, theirs.points[0]) - way.reach_m - theirs.reach_m >= kept_m:
                continue
            if _least_m(way, theirs) < kept_m:
                return False
        radius_m = self.members[name].radius_m
        for hazard in hazards:
            risk = _risk(way, hazard, radius_m)
            if risk[0] < math.inf and risk < _risk(ways[name], hazard, radius_m):
                return False
        return True


def _least_m(first: Way, second: Way) -> float:
    """Least distance of two that fly these ways at the same time; not more than the true one."""
    a, b = first.points, second.points
    last_a, last_b = len(a) - 1, len(b) - 1
    px, py, pz = minus(a[0], b[0])
    least = px * px + py * py + pz * pz
    for k in range(1, max(last_a, last_b) + 1):
        qx, qy, qz = minus(a[k if k < last_a else last_a], b[k if k < last_b else last_b])
        dx, dy, dz = qx - px, qy - py, qz - pz
        square = dx * dx + dy * dy + dz * dz
        if square > 0.0:
            part = -(px * dx + py * dy + pz * dz) / square
            part = 0.0 if part < 0.0 else 1.0 if part > 1.0 else part
            px, py, pz = px + part * dx, py + part * dy, pz + part * dz
            least = min(least, px * px + py * py + pz * pz)
        px, py, pz = qx, qy, qz
    return math.sqrt(least) - first.bow_m - second.bow_m


def _risk(way: Way, hazard: Obstacle, radius_m: float) -> tuple[float, float]:
    """(seconds until a way is nearer to an obstacle than it should be, by how much it then stays farther): infinite
    and positive if it never is. The larger, the better. The obstacle flies straight on, also for `FLIES_ON_S` after
    the reference stands."""
    (x, y, z), (u, v, w) = hazard.pos_enu_m, hazard.vel_enu_mps
    points, enters_s, least = way.points, math.inf, math.inf
    # between two points: half of what both fly in that time
    between_m = 0.5 * GRID_S * (math.hypot(u, v, w) + _fastest_mps(way))
    needed_m = radius_m + hazard.radius_m + between_m
    for k, point in enumerate(points):
        t_s = k * GRID_S
        away_m = math.dist(point, (x + u * t_s, y + v * t_s, z + w * t_s))
        least = min(least, away_m)
        if away_m < needed_m and enters_s == math.inf:
            enters_s = t_s
    stands_s = (len(points) - 1) * GRID_S
    offset = minus((x + u * stands_s, y + v * stands_s, z + w * stands_s), points[-1])
    after = closest_approach(offset, hazard.vel_enu_mps, needed_m, FLIES_ON_S)
    return min(enters_s, stands_s + after.enters_s), min(least, after.separation_m) - needed_m


def _fastest_mps(way: Way) -> float:
    return max((math.dist(a, b) for a, b in zip(way.points, way.points[1:], strict=False)), default=0.0) / GRID_S


def _after(moving: Moving, acc: Vector, dt_s: float) -> Moving:
    """Where it is after a step with this acceleration."""
    (x, y, z), (u, v, w), (a, b, c) = moving.pos_enu_m, moving.vel_enu_mps, acc
    half = 0.5 * dt_s * dt_s
    return Moving(
        (x + u * dt_s + a * half, y + v * dt_s + b * half, z + w * dt_s + c * half),
        (u + a * dt_s, v + b * dt_s, w + c * dt_s),
    )


def moved(moving: Moving, dt_s: float) -> Moving:
    """Where it is so much later, straight on."""
    return _after(moving, REST, dt_s)


def _times(vector: Vector, factor: float) -> Vector:
    return vector[0] * factor, vector[1] * factor, vector[2] * factor


def minus(a: Vector, b: Vector) -> Vector:
    """The offset of a from b."""
    return a[0] - b[0], a[1] - b[1], a[2] - b[2]
