"""Random encounters of references in the separation filter, and of modelled vehicles that follow them in wind.

A vehicle follows the setpoint that was sent its delay ago by PX4's loops (MPC_XY_P 0.95, MPC_XY_VEL_P_ACC 1.8,
MPC_XY_VEL_I_ACC 0.4), with an attitude lag of 0.15 s, in a mean wind of 6 m/s with gusts. Strangers fly straight on and
obey nobody; what is known of them is 0.1 to 1 s old.
"""

from __future__ import annotations

import itertools
import math
import random
from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass, field

from skygcs.core.plan.margins import MarginRule, Motion
from skygcs.core.separation import ACCELERATION_MPS2, POSITION_ERROR_M, WINGSPAN_M, separation_m
from skygcs.ext.formation.evasion import Evasion
from skygcs.ext.formation.separation_filter import (
    SLACK_M,
    Member,
    MotionBounds,
    Moving,
    Obstacle,
    SeparationFilter,
    Vector,
)

DT_S = 0.1
SUBSTEPS = 4
RULE = MarginRule()
RATIO = RULE.downwash_ratio
FOOTPRINT_M = WINGSPAN_M / 2 + POSITION_ERROR_M
"""One vehicle's part of the distance that may never be lost."""

ARRIVED_M = 0.3
WIND_MPS = 6.0
DRAG_PER_S = 0.25
"""Acceleration per m/s of wind: 1.5 m/s² at 6 m/s, a lean of 9 degrees (PX4 SIH, measured)."""

GUST_MPS, GUST_S = 1.5, 2.0
"""Standard deviation and correlation time."""


@dataclass(slots=True)
class ModelVehicle:
    """One vehicle in the wind, and the setpoints that are on their way to it."""

    pos: list[float]
    delay_s: float
    wind: Vector
    rng: random.Random
    vel: list[float] = field(default_factory=lambda: [0.0, 0.0, 0.0])
    acc: list[float] = field(default_factory=lambda: [0.0, 0.0, 0.0])
    gust: list[float] = field(default_factory=lambda: [0.0, 0.0, 0.0])
    integral: list[float] = field(default_factory=lambda: [0.0, 0.0, 0.0])
    sent: deque[tuple[float, Moving]] = field(default_factory=deque)
    follows: tuple[float, Moving] | None = None

    def __post_init__(self) -> None:
        self.integral = [-DRAG_PER_S * wind for wind in self.wind]  # it hovers in the mean wind

    def step(self, now: float, reference: Moving) -> None:
        """Fly for ``DT_S``; the reference is sent now."""
        self.sent.append((now, reference))
        while self.sent and self.sent[0][0] + self.delay_s <= now + 1e-9:
            self.follows = self.sent.popleft()
        h = DT_S / SUBSTEPS
        for axis in range(3):
            fade = math.exp(-DT_S / GUST_S)
            self.gust[axis] = fade * self.gust[axis] + GUST_MPS * math.sqrt(1 - fade * fade) * self.rng.gauss(0.0, 1.0)
        for _ in range(SUBSTEPS):
            for axis in range(3):
                place, velocity = self.pos[axis], 0.0
                if self.follows is not None:
                    place, velocity = self.follows[1].pos_enu_m[axis], self.follows[1].vel_enu_mps[axis]
                error = 0.95 * (place - self.pos[axis]) + velocity - self.vel[axis]
                self.integral[axis] += 0.4 * error * h
                wanted = max(-5.0, min(5.0, 1.8 * error + self.integral[axis]))
                self.acc[axis] += (wanted - self.acc[axis]) * h / 0.15
                blown = DRAG_PER_S * (self.wind[axis] + self.gust[axis])
                self.vel[axis] += (self.acc[axis] + blown) * h
                self.pos[axis] += self.vel[axis] * h


@dataclass(frozen=True, slots=True)
class Outcome:
    """One encounter. Distances are what is left over the promised ones; negative: lost."""

    seed: int
    vehicles: int
    strangers: int
    references_m: float
    """Of references, over the sum of their radii."""
    vehicles_m: float
    """Of vehicles, over their footprints."""
    strangers_m: float
    """Of vehicles from strangers, over their footprints; infinite without one."""
    off_m: float
    """The farthest that a vehicle was from its reference."""
    arrived: int
    arrived_s: float | None
    """When all had arrived."""


def places(rng: random.Random, count: int, side_m: float, apart_m: float) -> list[Vector]:
    """Random places that are so far apart; fewer where no more fit."""
    found: list[Vector] = []
    for _ in range(3000):
        if len(found) == count:
            break
        place = (rng.uniform(0.0, side_m), rng.uniform(0.0, side_m), rng.uniform(8.0, 25.0))
        if all(apart(place, other) >= apart_m for other in found):
            found.append(place)
    return found


def apart(a: Vector, b: Vector) -> float:
    """Their distance in the metric of the filter."""
    return separation_m(a[0] - b[0], a[1] - b[1], a[2] - b[2], RATIO)


def encounter(seed: int, *, seconds: float, strangers: bool = True) -> Outcome:
    """Fly one: 2 to 20 references from random places to others, and a vehicle behind each."""
    rng = random.Random(seed)
    bounds = MotionBounds()
    count, radius_m = rng.randint(2, 20), RULE.half_m("any", Motion(speed_mps=bounds.speed_mps))
    side_m = rng.uniform(2.0, 4.0) * 2 * radius_m * math.sqrt(count)
    starts = places(rng, count, side_m, 2 * radius_m + 2 * SLACK_M)
    goals = places(rng, len(starts), side_m, 2 * radius_m + 2 * SLACK_M)
    starts = starts[: len(goals)]
    names = [f"v{i}" for i in range(len(starts))]
    filter_ = SeparationFilter(
        {name: Member(radius_m, Moving(start)) for name, start in zip(names, starts, strict=True)}, bounds, RATIO
    )
    heading = rng.uniform(0.0, math.tau)
    wind = (WIND_MPS * math.cos(heading), WIND_MPS * math.sin(heading), 0.0)
    flown = {
        name: ModelVehicle(list(start), rng.uniform(0.05, 0.3), wind, rng)
        for name, start in zip(names, starts, strict=True)
    }
    others = list(_strangers(rng, side_m, starts, radius_m)) if strangers else []
    wanted = {name: Moving(goal) for name, goal in zip(names, goals, strict=True)}
    evasion, age_s = Evasion(), rng.uniform(0.1, 1.0)
    least_references = least_vehicles = least_strangers = math.inf
    off_m, arrived_s = 0.0, None
    for step in range(round(seconds / DT_S)):
        now = step * DT_S
        seen = [_seen(name, moving, now, age_s) for name, moving in others]
        filter_.step(evasion.asked(filter_, wanted, seen, now), seen, DT_S)
        for name, vehicle in flown.items():
            vehicle.step(now, filter_.members[name].moving)
            off_m = max(off_m, math.dist(vehicle.pos, filter_.members[name].moving.pos_enu_m))
        for a, b in itertools.combinations(names, 2):
            least_references = min(least_references, filter_.distance_m(a, b) - 2 * radius_m)
            between_m = apart(_vector(flown[a].pos), _vector(flown[b].pos))
            least_vehicles = min(least_vehicles, between_m - 2 * FOOTPRINT_M)
        for (_, moving), name in itertools.product(others, names):
            there = _moved(moving, now + DT_S)
            least_strangers = min(least_strangers, apart(there, _vector(flown[name].pos)) - 2 * FOOTPRINT_M)
        if arrived_s is None and all(
            math.dist(filter_.members[name].moving.pos_enu_m, wanted[name].pos_enu_m) < ARRIVED_M for name in names
        ):
            arrived_s = now
            if not others:
                break
    arrived = sum(
        math.dist(filter_.members[name].moving.pos_enu_m, wanted[name].pos_enu_m) < ARRIVED_M for name in names
    )
    return Outcome(
        seed, len(names), len(others), least_references, least_vehicles, least_strangers, off_m, arrived, arrived_s
    )


def _strangers(
    rng: random.Random, side_m: float, starts: list[Vector], radius_m: float
) -> Iterator[tuple[str, Moving]]:
    for n in range(rng.randint(0, 2)):
        heading, speed = rng.uniform(0.0, math.tau), rng.uniform(0.0, 1.5)
        place = (rng.uniform(0.0, side_m), rng.uniform(0.0, side_m), rng.uniform(8.0, 25.0))
        if all(apart(place, start) > 2 * radius_m + 4.0 for start in starts):
            yield f"stranger{n}", Moving(place, (speed * math.cos(heading), speed * math.sin(heading), 0.0))


def _seen(name: str, moving: Moving, now: float, age_s: float) -> Obstacle:
    """A stranger by a report of some age, carried on with its velocity."""
    ball_m = 0.5 * ACCELERATION_MPS2 * age_s * age_s
    return Obstacle(name, _moved(moving, now), moving.vel_enu_mps, FOOTPRINT_M + ball_m)


def _moved(moving: Moving, seconds: float) -> Vector:
    return _vector([p + v * seconds for p, v in zip(moving.pos_enu_m, moving.vel_enu_mps, strict=True)])


def _vector(values: list[float]) -> Vector:
    x, y, z = values
    return x, y, z
