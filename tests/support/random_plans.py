"""Random flights of certified plans: a person, a pilot and the link interfere; no pair comes inside its margin."""

from __future__ import annotations

import asyncio
import math
import random
from collections.abc import Awaitable, Callable
from pathlib import Path
from typing import Any

from skygcs.sim.conditions import conditions_of
from support.called import plans_of
from support.flown import Flown, flown
from support.planned import MARGIN_M, UP_M, inline, least_distance, load, state, timed
from support.random_flights import KINDS, NAMES, Judged, RandomFlight, changes, denied, pilot, restart, watched

PLAN_S = 30.0


async def pause(f: RandomFlight) -> None:
    f.start(f.gcs("plan.pause"))
    await asyncio.sleep(f.rng.uniform(0.1, 4.0))
    f.start(f.gcs("plan.resume"))


async def speed(f: RandomFlight) -> None:
    f.start(f.gcs("plan.speed", speed=f.rng.choice([0.3, 0.7, 1.0])))


async def end(f: RandomFlight) -> None:
    f.start(f.gcs(f.rng.choice(["plan.abort", "plan.land"])))


async def one_of_them(f: RandomFlight) -> None:
    """A person takes one member out: the plan stops."""
    method, params = f.rng.choice([("vehicles.hold", {}), ("vehicles.stop", {"action": "hold"}), ("vehicles.land", {})])
    f.order(method, targets=f.vehicle(), **params)


async def switched_off(f: RandomFlight) -> None:
    f.order("control.set", targets=f.vehicle(), mode="off")


async def short_cut(f: RandomFlight) -> None:
    seconds, what = f.rng.choice([0.3, 0.8]), f.rng.choice(["cut", "deaf"])
    setattr(f.gcs, what, True)
    await asyncio.sleep(seconds)
    setattr(f.gcs, what, False)


DEEDS: tuple[tuple[Callable[[RandomFlight], Awaitable[None]], int], ...] = (
    (pause, 4),
    (speed, 2),
    (changes, 6),
    (denied, 2),
    (short_cut, 3),
    (pilot, 1),
    (one_of_them, 1),
    (switched_off, 1),
    (end, 1),
    (restart, 1),
)


async def fly_a_plan(tmp_path: Path, seed: int) -> Judged:
    """One flight of this seed: two vehicles, side by side or towards each other up to the margin."""
    rng = random.Random(seed)
    kind = rng.choice(KINDS)
    conditions = conditions_of(wind_mps=rng.uniform(0.0, 6.0), wind_from_deg=rng.uniform(0.0, 360.0))
    async with (
        flown(tmp_path, conditions=conditions, height_m=UP_M, in_air=True, setpoints_end=False, **kind) as gcs,
        watched(gcs) as monitor,
    ):
        flight = RandomFlight(seed, rng, gcs, monitor)
        await _begin(flight, gcs)
        began, judged_until = gcs.now, math.inf
        deeds, weights = zip(*DEEDS, strict=True)
        while gcs.now < began + PLAN_S:
            await asyncio.sleep(rng.choice([0.5, 1.0, 2.0, 3.0]))
            (deed,) = rng.choices(deeds, weights)
            flight.done.append(f"{gcs.now:.2f} {deed.__name__} ({state(gcs)})")
            if deed is restart:
                judged_until = min(judged_until, gcs.now)  # what they do without a daemon is not certified
            await deed(flight)
        await asyncio.sleep(4.0)
        for task in list(flight.under_way):
            task.cancel()
        await asyncio.sleep(2.0)
        monitor.look(gcs.now)
        flight.require_nothing_raised()
        return Judged(
            seed,
            tuple(monitor.breaches),
            _inside(gcs, began, judged_until),
            monitor.looked,
            monitor.attended_again,
            sum(t.kind == "unattended" for t in gcs.told),
            tuple(flight.done),
        )


async def _begin(flight: RandomFlight, gcs: Flown) -> None:
    """Load and run a plan that is certified; goals that are too near each other are drawn again."""
    starts = {name: gcs.place(name) for name in NAMES}
    for _ in range(20):
        goals: dict[str, tuple[float, float, float]] = {
            name: (x + flight.rng.uniform(-4, 4), y + flight.rng.uniform(8, 20), up + flight.rng.uniform(-2, 2))
            for name, (x, y, up) in starts.items()
        }
        plans_of(gcs.daemon).runner.work = inline
        await load(gcs, timed(starts, goals))
        answer: dict[str, Any] = await gcs("plan.run", margin_m=MARGIN_M, force=True)
        if answer["started"]:
            return
    raise AssertionError("no plan was certified")


def _inside(gcs: Flown, since: float, until: float) -> tuple[str, ...]:
    """The pair that came inside its margin, in truth."""
    kept = {sysid: [t for t in looks if t.at <= until] for sysid, looks in gcs.truth.items()}
    whole, gcs.truth = gcs.truth, kept
    distance_m, pair, at = least_distance(gcs, since)
    gcs.truth = whole
    return (f"{pair} {distance_m:.2f} m at {at:.2f}",) if distance_m < MARGIN_M else ()
