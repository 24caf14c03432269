"""Plans by goto behind one emulated RFD900x at 64 kbit/s with lost packets: crossing, V and circle of 4, 8 and 14
vehicles; what the air was used for; and, against it, the same by setpoints on a free link. In each phase the ground is
killed once: all come to rest at the ends of their legs.
"""

from __future__ import annotations

import asyncio
import math
import random
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from bench.plans.flights import FIELD, LOOK_S, OVER, OWED_M, UP_M, Air, Watched, above, in_the_air
from bench.results import in_virtual_time
from skygcs.core.plan.fleet_plan import PhasedPlan
from skygcs.core.plan.plan_json import plan_from_json
from support.planned import instant_planning

AIR_KBPS = 64
COUNTS = (4, 8, 14)
LOSSES = (0.02, 0.05)
PLANS = ("crossing", "v", "circle")
FENCE = {"x_m": [-120, 160], "y_m": [-140, 120], "up_m": [0, 140]}
SPACING_M = 8.0
RESTS_S = 60.0
"""From the death of the ground to rest: a leg of 60 m at 2 m/s, and what the autopilots do of their own afterwards."""


@dataclass(frozen=True, slots=True)
class Case:
    """One set-up: flights in it are flown one after the other."""

    vehicles: int
    loss: float
    by: str = "goto"

    def links(self) -> dict[str, dict[str, Any]]:
        radio = {"air_kbps": AIR_KBPS, "baud": 57600, "loss": self.loss}
        link = {
            "type": "simulated",
            "dynamics": "kinematic",
            "stream_profile": "nav",
            "px4": self.vehicles // 2,
            "ardupilot": self.vehicles - self.vehicles // 2,
            "first_sysid": 1,
            "lat_deg": FIELD["lat_deg"],
        }
        slow = {"role": "radio", "radio": radio, "air_speed_kbps": AIR_KBPS, "nodes": self.vehicles + 1}
        return {"air": link | (slow if self.by == "goto" else {"role": "vehicle"})}


def cases() -> list[Case]:
    """All set-ups."""
    slow = [Case(count, loss) for count in COUNTS for loss in LOSSES]
    return slow + [Case(count, 0.0, "setpoints") for count in COUNTS]


async def plan_of(air: Air, name: str) -> PhasedPlan:
    """The plan that `plan make` makes from where the vehicles are, for the way in which it is flown."""
    instant_planning(air.daemon)
    starts = above(air)
    task: dict[str, Any] = {
        "starts": {one: list(place) for one, place in starts.items()},
        "by": air.by,
        "kind": "phased",
    }
    if name == "crossing":
        goals = list(starts.values())
        random.Random(7).shuffle(goals)
        task["goals"] = {one: list(goal) for one, goal in zip(starts, goals, strict=True)}
    else:
        middle = [math.fsum(place[k] for place in starts.values()) / len(starts) for k in range(2)]
        middle_m = [middle[0], middle[1] + 20.0, UP_M]
        task["formation"] = {
            "vehicles": list(starts),
            "shape": name,
            "middle_m": middle_m,
            "spacing_m": SPACING_M,
            "yaw_deg": 60.0,
        }
    found = await air.call("plan.make", **task)
    if found["plan"] is None:
        raise RuntimeError(found["reasons"][:3])
    plan, _ = plan_from_json("plan.make", found["plan"])
    assert isinstance(plan, PhasedPlan)
    return plan


async def _flight(air: Air, name: str, case: Case) -> dict[str, Any]:
    plan = await plan_of(air, name)
    seen, began, before = Watched(), air.daemon.now(), _sent_bytes(air)
    report = await air.fly(plan, seen, until=lambda: air.state in OVER, lost=lambda: None)
    seconds = air.daemon.now() - began
    status = air.daemon.fleet.plans.status()
    closest = report["certificate"]["closest"]
    return {
        "flight": name,
        "vehicles": case.vehicles,
        "loss": case.loss,
        "by": case.by,
        "state": status["state"],
        "reason": status["reason"],
        "stops": seen.stops,
        "phases": len(plan.phases),
        "seconds": round(seconds, 1),
        "uplink_bytes_per_s": round((_sent_bytes(air) - before) / seconds, 1),
        "certified_margin_m": round(closest["margin_m"], 2),
        "certified_least_m": round(closest["distance_at_least_m"], 2),
        "measured_least_m": round(seen.least_m, 2),
        "pair": seen.pair,
        "met": status["state"] == "finished" and seen.least_m >= OWED_M,
    }


def _sent_bytes(air: Air) -> int:
    return sum(channel.tx_bytes for link in air.links for channel in link.channels)


async def _killed(case: Case, phase: int, folder: Path) -> dict[str, Any]:
    """The crossing, and the ground dies while all are in this phase of it."""
    async with in_the_air(folder, case.links(), by=case.by, fence=FENCE) as air:
        plan = await plan_of(air, "crossing")
        name, seen = plan.phases[phase].name, Watched()

        def there() -> bool:
            status = air.daemon.fleet.plans.status()
            return status["state"] == "flying" and status["phase"] == name

        await air.fly(plan, seen, until=lambda: there() or air.state in OVER, lost=lambda: None)
        met = air.state == "flying"
        await asyncio.sleep(2.0)
        _silence(air)
        goals = _ends(plan, phase)
        for _ in range(round(RESTS_S / LOOK_S)):
            air.look(seen, air.daemon.now(), None)
            await asyncio.sleep(LOOK_S)
        off_m = max(math.dist(air.places()[one], goal) for one, goal in goals.items())
        return {
            **{"flight": f"ground killed in {name}", "vehicles": case.vehicles, "loss": case.loss, "by": case.by},
            **{"off_end_m": round(off_m, 2), "measured_least_m": round(seen.least_m, 2)},
            "met": met and seen.least_m >= OWED_M and off_m < 1.5,
        }


def _ends(plan: PhasedPlan, phase: int) -> dict[str, Any]:
    """Where each is at the end of a phase."""
    found = dict(plan.starts)
    for one in plan.phases[: phase + 1]:
        found |= one.goals
    return found


def _silence(air: Air) -> None:
    """The ground is dead: nothing of its radio is heard any more, nor by it."""
    for link in air.links:
        assert link.radio is not None
        link.radio.cut_off = frozenset(range(1, len(link.vehicles) + 1))


async def _fly(case: Case, folder: Path) -> list[dict[str, Any]]:
    async with in_the_air(folder, case.links(), by=case.by, fence=FENCE) as air:
        return [await _flight(air, name, case) for name in PLANS]


def flown(case: Case) -> list[dict[str, Any]]:
    """All flights of a set-up, in virtual time; of four vehicles by goto also the ground's death in each phase."""
    rows = in_virtual_time(lambda folder: _fly(case, folder))
    if case.by == "goto" and case.vehicles == COUNTS[0]:
        for phase in range(3):  # climb, cross, descend
            rows.append(in_virtual_time(lambda folder, phase=phase: _killed(case, phase, folder)))
    return rows


def text(row: Mapping[str, Any]) -> str:
    """One flight for a person."""
    met = "met   " if row["met"] else "MISSED"
    head = f"{met} {row['flight']:24} {row['vehicles']:2} by {row['by']}, {row['loss']:.0%} lost"
    if "off_end_m" in row:
        return f"{head}: at rest {row['off_end_m']:.2f} m from the ends, measured {row['measured_least_m']:.2f} m"
    return (
        f"{head}: {row['state']} in {row['seconds']:.0f} s, {len(row['stops'])} stops, "
        f"{row['uplink_bytes_per_s']:.0f} B/s up; references {row['certified_least_m']:.2f} m apart, "
        f"margin {row['certified_margin_m']:.2f} m, measured {row['measured_least_m']:.2f} m"
    )
