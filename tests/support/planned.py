"""Plans for the vehicles of `support.flown`, and what is asked of their flights."""

from __future__ import annotations

import asyncio
import json
import math
from collections.abc import Callable, Mapping
from typing import Any

from skygcs.core.plan.fleet_plan import FlightSpace, Phase, PhasedPlan, Plan, TimedPlan
from skygcs.core.plan.plan_json import write_plan_json
from skygcs.core.plan.straight_flight import straight_trajectories
from skygcs.core.trajectory import MotionLimits
from skygcs.daemon import Daemon
from skygcs.ext.plans.planning.planning_queue import PlanningQueue
from support.called import plans_of
from support.fake_daemon import compute_here
from support.flown import Flown

Vector = tuple[float, float, float]
Places = Mapping[str, Vector]

UP_M = 10.0
MARGIN_M = 2.5
"""As the benches have it: vehicles of `flown` stand 5 m apart."""

SLOW = MotionLimits(speed_mps=2.0, acceleration_mps2=1.0, climb_mps=1.5, descent_mps=1.0)


def timed(starts: Places, goals: Places, limits: MotionLimits = SLOW) -> TimedPlan:
    """All straight, by one time scaling."""
    ways = straight_trajectories(list(starts.values()), [goals[name] for name in starts], limits)
    return TimedPlan(dict(zip(starts, ways, strict=True)))


def phased(starts: Places, *phases: tuple[str, Places]) -> PhasedPlan:
    return PhasedPlan(dict(starts), tuple(Phase(name, dict(goals)) for name, goals in phases))


def above(gcs: Flown, *names: str, up_m: float = UP_M) -> dict[str, Vector]:
    """Places above the homes of these vehicles, or of all."""
    return {name: (*gcs.place_of_home(name)[:2], up_m) for name in names or [f"v{sim.sysid}" for sim in gcs.sims]}


def here(gcs: Flown) -> dict[str, Vector]:
    """Where v1 and v2 are."""
    return {name: gcs.place(name) for name in ("v1", "v2")}


def north(places: Places, by_m: float = 12.0) -> dict[str, Vector]:
    return {name: (x, y + by_m, up) for name, (x, y, up) in places.items()}


def northwards(starts: Places, by_m: float = 12.0) -> TimedPlan:
    """All straight to the north, one beside the other."""
    return timed(starts, north(starts, by_m))


def swap(gcs: Flown) -> PhasedPlan:
    """Two vehicles to each other's place, in layers: they need the barriers."""
    a, b = gcs.place_of_home("v1"), gcs.place_of_home("v2")
    low, high = UP_M, UP_M + 6.0
    return phased(
        {"v1": a, "v2": b},
        ("climb", {"v1": (*a[:2], low), "v2": (*b[:2], high)}),
        ("cross", {"v1": (*b[:2], low), "v2": (*a[:2], high)}),
        ("descend", {"v2": (*a[:2], low)}),
    )


def content(plan: Plan, space: FlightSpace | None = None) -> dict[str, Any]:
    """The plan as plan.load takes it."""
    found: dict[str, Any] = json.loads(write_plan_json(plan, space or FlightSpace()))
    return found


async def inline(work: Callable[..., Any], *arguments: Any) -> Any:
    """In place of a thread, which virtual time would not wait for."""
    return work(*arguments)


def instant_planning(daemon: Daemon) -> None:
    """Calls in place of the planning processes, for which virtual time does not wait."""
    plans_of(daemon).queue = PlanningQueue(asyncio.get_running_loop(), compute_here)
    plans_of(daemon).runner.work = inline


async def load(gcs: Flown, plan: Plan, space: FlightSpace | None = None) -> None:
    plans_of(gcs.daemon).runner.work = inline
    await gcs("plan.load", plan=content(plan, space), name="test")


async def run(gcs: Flown, plan: Plan, **params: Any) -> None:
    """Loaded and begun."""
    await load(gcs, plan)
    answer = await gcs("plan.run", **{"margin_m": MARGIN_M, "force": True, **params})
    assert answer["started"], refused(answer["report"])


def refused(report: Mapping[str, Any]) -> list[str]:
    return [f"{f['vehicle']} {f['check']}: {f['text']}" for f in report["findings"] if f["severity"] == "refused"]


def state(gcs: Flown) -> str:
    return str(gcs.daemon.fleet.plans.status()["state"])


async def reach(gcs: Flown, when: str) -> None:
    """A plan that has begun: in the air, in a state on the way to its starts, or after 4 s of flight paused, aborted or
    ordered to land."""
    if when == "takeoff":
        await gcs.until(lambda: all(sim.motion.up_m > 3.0 for sim in gcs.sims), 60.0)
    elif when in ("engaging", "to_starts"):
        await gcs.until(lambda: state(gcs) == when, 90.0)
    else:
        await gcs.until(lambda: state(gcs) == "flying", 90.0)
        await asyncio.sleep(4.0)
        if when != "flying":
            await gcs({"paused": "plan.pause", "aborting": "plan.abort", "landing": "plan.land"}[when])


def plan_events(gcs: Flown, since: float = 0.0) -> list[str]:
    return [f"{t.data.get('state')}: {t.text}" for t in gcs.told if t.kind == "plan" and t.at >= since]


def least_distance(gcs: Flown, since: float, ratio: float = 2.0, above_m: float = 0.5) -> tuple[float, str, float]:
    """In truth, in the downwash metric, of all pairs of which one at least flies: (distance, pair, when)."""
    least = (math.inf, "", 0.0)
    ids = sorted(gcs.truth)
    for i, one in enumerate(ids):
        for other in ids[i + 1 :]:
            for a, b in zip(gcs.truth[one], gcs.truth[other], strict=True):
                if a.at < since or (a.landed and b.landed) or max(a.pos_m[2], b.pos_m[2]) < above_m:
                    continue
                dx, dy, dz = (p - q for p, q in zip(a.pos_m, b.pos_m, strict=True))
                distance = math.hypot(dx, dy, dz / ratio)
                if distance < least[0]:
                    least = (distance, f"v{one} v{other}", a.at)
    return least
