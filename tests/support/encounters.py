"""Seeded encounters of two simulated vehicles before a whole daemon: who flies where, what is measured.

Places are metres east, north, up of the field. Both vehicles hover at their starts, then each is ordered to its goal
over RPC with force, as an operator would who insists; the monitor alone is left to keep them apart. A separation is
measured on the simulator's truth.
"""

from __future__ import annotations

import asyncio
import contextlib
import math
import random
from collections.abc import AsyncIterator, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from skygcs.core.monitor.monitor import Monitor
from skygcs.core.separation import Footprint, pair_margin, separation_m
from skygcs.sim.conditions import Conditions, Dynamics
from support.flown import Flown, Vector, aloft

MARGIN = pair_margin(Footprint(), Footprint())

KINDS = ("head-on", "overtaking", "descending onto", "silent intruder", "two at one goal")

HEIGHT_M = 30.0

SPEED_MPS = 2.0

WATCHED_S = 32.0
"""From the orders to the end of an encounter."""

QUIET_S = 4.0
"""Between two encounters. The monitor is made anew as well: it would remember for a minute whom it held for whom."""


@dataclass(frozen=True, slots=True)
class Encounter:
    """Of v1 (a PX4) and v2 (an ArduCopter)."""

    kind: str
    seed: int
    starts: tuple[Vector, Vector]
    goals: tuple[Vector | None, Vector | None]
    speeds_mps: tuple[float, float]
    silent: str | None = None
    """Which of them is not heard any more from ``silent_s`` after the orders on."""
    silent_s: float = math.inf


@dataclass(slots=True)
class Met:
    """What came of an encounter. Times count from the orders."""

    least_m: float = math.inf
    """The smallest distance of the two centres, in the metric of the margin."""
    collided_s: float | None = None
    """When they touched: closer than half of both wingspans."""
    margin_lost_s: float | None = None
    warned_s: float | None = None
    """When the first warning (or action) was published."""
    held: tuple[str, ...] = ()
    """Vehicles that the monitor ordered to hold."""


def encounter(seed: int) -> Encounter:
    """One of the five kinds in turn; everything else by chance."""
    rng = random.Random(seed)
    kind = KINDS[seed % len(KINDS)]
    turn = rng.uniform(0.0, math.tau)
    make = _MAKERS[kind]
    starts, goals, speeds = make(rng)
    swapped = rng.random() < 0.5
    places = [None if p is None else _turned(p, turn) for p in (*starts, *goals)]
    first, second, goal1, goal2 = places
    assert first is not None and second is not None
    pairs = [(first, goal1, speeds[0]), (second, goal2, speeds[1])]
    if swapped:
        pairs.reverse()
    intruder = None
    if kind == "silent intruder":
        intruder = "v1" if swapped else "v2"
    return Encounter(
        kind,
        seed,
        (pairs[0][0], pairs[1][0]),
        (pairs[0][1], pairs[1][1]),
        (pairs[0][2], pairs[1][2]),
        intruder,
        rng.uniform(3.0, 8.0) if intruder else math.inf,
    )


Made = tuple[tuple[Vector, Vector], tuple[Vector | None, Vector | None], tuple[float, float]]


def _head_on(rng: random.Random) -> Made:
    far, side, up = rng.uniform(26.0, 34.0), rng.uniform(-0.5, 0.5), rng.uniform(-0.5, 0.5)
    a, b = (-far, 0.0, HEIGHT_M), (far, side, HEIGHT_M + up)
    return (a, b), ((far, 0.0, HEIGHT_M), (-far, side, HEIGHT_M + up)), (SPEED_MPS, SPEED_MPS)


def _overtaking(rng: random.Random) -> Made:
    gap, side = rng.uniform(13.0, 16.0), rng.uniform(-0.5, 0.5)
    a, b = (-30.0, 0.0, HEIGHT_M), (-30.0 + gap, side, HEIGHT_M)
    return (a, b), ((60.0, 0.0, HEIGHT_M), (60.0, side, HEIGHT_M)), (SPEED_MPS, rng.uniform(0.8, 1.0))


def _descending(rng: random.Random) -> Made:
    above, side = rng.uniform(20.0, 24.0), rng.uniform(-0.4, 0.4)
    a, b = (side, 0.0, HEIGHT_M + above), (0.0, 0.0, HEIGHT_M)
    return (a, b), ((side, 0.0, HEIGHT_M - 8.0), None), (SPEED_MPS, SPEED_MPS)


def _crossing(rng: random.Random, least_deg: float, most_deg: float) -> tuple[Vector, Vector, float]:
    """Two starts equally far (give or take a second) from the middle, at an angle."""
    angle, far = math.radians(rng.uniform(least_deg, most_deg)), rng.uniform(26.0, 32.0)
    late = far + rng.uniform(-0.7, 0.7)
    return (-far, 0.0, HEIGHT_M), (late * math.cos(angle), late * math.sin(angle), HEIGHT_M), far


def _silent(rng: random.Random) -> Made:
    a, b, far = _crossing(rng, 60.0, 120.0)
    beyond = (-b[0], -b[1], HEIGHT_M)
    return (a, b), ((far, 0.0, HEIGHT_M), beyond), (SPEED_MPS, SPEED_MPS)


def _one_goal(rng: random.Random) -> Made:
    a, b, _ = _crossing(rng, 40.0, 140.0)
    goal = (0.0, 0.0, HEIGHT_M)
    return (a, b), (goal, goal), (SPEED_MPS, rng.uniform(1.5, SPEED_MPS))


_MAKERS = {
    "head-on": _head_on,
    "overtaking": _overtaking,
    "descending onto": _descending,
    "silent intruder": _silent,
    "two at one goal": _one_goal,
}


def _turned(place: Vector, by_rad: float) -> Vector:
    c, s = math.cos(by_rad), math.sin(by_rad)
    return place[0] * c - place[1] * s, place[0] * s + place[1] * c, place[2]


class Arena:
    """Flies encounters one after the other with the two vehicles of a `Flown`."""

    def __init__(self, gcs: Flown) -> None:
        self.gcs = gcs

    async def meet(self, encounter: Encounter, *, hold_at_s: float | None = None) -> Met:
        """Fly it. ``hold_at_s``: what an operator does who holds all vehicles that may be held, so late."""
        gcs = self.gcs
        await self._prepare(encounter)
        begun, known = gcs.now, len(gcs.told)
        for name, goal in zip(("v1", "v2"), encounter.goals, strict=True):
            if goal is not None:
                await gcs.done("vehicles.goto", targets=name, enu_m=list(goal), force=True)
        met = Met()
        while (at := gcs.now - begun) < WATCHED_S:
            self._measure(met, at)
            if at >= encounter.silent_s and encounter.silent is not None:
                gcs.muted.add(int(encounter.silent[1:]))
            if hold_at_s is not None and at >= hold_at_s:
                hold_at_s = None
                able = [name for name in ("v1", "v2") if name != encounter.silent]
                await gcs("vehicles.hold", targets=able)
            await asyncio.sleep(0.05)
        gcs.muted.clear()
        events = [t for t in gcs.told[known:] if t.kind == "separation"]
        warned = [
            t.at - begun for t in events if t.data.get("level") in ("warning", "action") and "order" not in t.data
        ]
        met.warned_s = min(warned, default=None)
        met.held = tuple(t.vehicle or "" for t in events if t.data.get("order") == "hold" and "outcome" not in t.data)
        return met

    async def _prepare(self, encounter: Encounter) -> None:
        """Both hover at their starts, and what was before is forgotten."""
        gcs = self.gcs
        await asyncio.sleep(QUIET_S)
        await gcs("vehicles.hold", targets="all")
        watch = gcs.daemon.fleet.monitor
        watch.monitor = Monitor(acting=watch.mode == "acting")
        await asyncio.sleep(1.0)
        for name, start, speed in zip(("v1", "v2"), encounter.starts, encounter.speeds_mps, strict=True):
            sim = gcs.sim(name)
            sim.params.set("MPC_XY_CRUISE", speed)
            sim.params.set("WPNAV_SPEED", speed * 100)
            home = gcs.place_of_home(name)
            motion = sim.motion
            motion.east_m, motion.north_m, motion.up_m = (s - h for s, h in zip(start, home, strict=True))
            motion.vel_e_mps = motion.vel_n_mps = motion.vel_u_mps = 0.0
            sim.hold_here()
        await asyncio.sleep(6.0)
        await gcs("vehicles.hold", targets="all")
        await asyncio.sleep(6.0)

    def _measure(self, met: Met, at: float) -> None:
        a, b = self.gcs.place("v1"), self.gcs.place("v2")
        distance_m = separation_m(b[0] - a[0], b[1] - a[1], b[2] - a[2], MARGIN.downwash_ratio)
        met.least_m = min(met.least_m, distance_m)
        if distance_m < MARGIN.total_m and met.margin_lost_s is None:
            met.margin_lost_s = at
        if math.dist(a, b) < MARGIN.wingspans_m and met.collided_s is None:
            met.collided_s = at


@dataclass(slots=True)
class Judged:
    """An encounter flown with an advisory monitor, with one that acts, and, if they collided all the same, with the
    holds of an operator who knew it 6 s before."""

    encounter: Encounter
    advisory: Met
    acting: Met
    held_in_time: Met | None = None

    @property
    def warned_ahead_s(self) -> float:
        """From the first warning until the margin was lost, or until they were nearest if it never was."""
        lost_s = self.advisory.margin_lost_s
        if self.advisory.warned_s is None or lost_s is None:
            return -math.inf
        return lost_s - self.advisory.warned_s

    @property
    def preventable(self) -> bool:
        """They collided although the monitor acted, and a hold would have prevented it."""
        return self.acting.collided_s is not None and self.held_in_time is not None and not self.held_in_time.collided_s

    def as_dict(self) -> dict[str, Any]:
        lead_s = self.warned_ahead_s
        return {
            "kind": self.encounter.kind,
            "seed": self.encounter.seed,
            "warned_ahead_s": round(lead_s, 2) if math.isfinite(lead_s) else None,
            "advisory_least_m": round(self.advisory.least_m, 2),
            "advisory_collided": self.advisory.collided_s is not None,
            "acting_least_m": round(self.acting.least_m, 2),
            "acting_collided": self.acting.collided_s is not None,
            "held": list(self.acting.held),
            "preventable": self.preventable,
        }


HELD_BEFORE_S = 6.0
"""How long before the collision the operator of `Judged` holds everything: an early hold helps if any does."""


@contextlib.asynccontextmanager
async def arena(tmp_path: Path, mode: str) -> AsyncIterator[Arena]:
    """Two vehicles in the air before a daemon with a monitor of this mode."""
    exact = Conditions(dynamics=Dynamics.KINEMATIC)
    async with aloft(
        tmp_path, px4=1, ardupilot=1, height_m=HEIGHT_M, conditions=exact, tables={"monitor": {"mode": mode}}
    ) as gcs:
        yield Arena(gcs)


async def judge(seeds: Sequence[int], folder: Path) -> list[Judged]:
    """Fly all of them."""
    judged: list[Judged] = []
    async with arena(folder / "advisory", "advisory") as advisory:
        mets = [await advisory.meet(encounter(seed)) for seed in seeds]
        async with arena(folder / "acting", "acting") as acting:
            for seed, met in zip(seeds, mets, strict=True):
                judged.append(Judged(encounter(seed), met, await acting.meet(encounter(seed))))
        for one in judged:
            if one.acting.collided_s is not None:
                at_s = max(0.1, (one.advisory.collided_s or one.acting.collided_s) - HELD_BEFORE_S)
                one.held_in_time = await advisory.meet(one.encounter, hold_at_s=at_s)
    return judged


def rows(judged: Sequence[Judged]) -> Iterator[str]:
    """A line for each kind of encounter."""
    for kind in KINDS:
        of_kind = [one for one in judged if one.encounter.kind == kind]
        if of_kind:
            lead_s = min(one.warned_ahead_s for one in of_kind)
            advisory = sum(one.advisory.collided_s is not None for one in of_kind)
            acting = sum(one.acting.collided_s is not None for one in of_kind)
            yield (
                f"{kind:<16} {len(of_kind):>3} flown; collisions: {advisory} advisory, {acting} acting, "
                f"{sum(o.preventable for o in of_kind)} of these preventable by a hold; "
                f"warned {lead_s:.1f} s ahead or earlier"
            )
