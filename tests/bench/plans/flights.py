"""Plans flown in simulation by twenty vehicles behind emulated multipoint radios, with lost packets and gaps: how far
apart the vehicles truly were, against what was certified.

    flight            plan
    ---------------   -------------------------------------------------------------------------------------------
    crossing          phased: a random permutation of the places of a grid, in layers
    formation         timed: from the grid to a circle, goals exchanged
    show              timed: the circle turns, while every vehicle rises and sinks
    lost link         the crossing; one vehicle is cut off while it crosses, and nobody else comes near it

Certified is a margin: references are at least so far apart. Vehicles may use up its terms for tracking and delay; the
rest, wingspans and position errors, is `owed_m`. The bench asks for the whole margin, by the true positions.
"""

from __future__ import annotations

import asyncio
import contextlib
import itertools
import math
import random
from collections.abc import AsyncIterator, Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from bench.results import in_virtual_time
from skygcs.core.plan.fleet_plan import FlightSpace, Phase, PhasedPlan, Plan, TimedPlan
from skygcs.core.plan.margins import MarginRule, Uncertainty
from skygcs.core.separation import separation_m
from skygcs.core.trajectory import MotionLimits, Piece, Trajectory
from skygcs.daemon import Daemon
from skygcs.errors import RefusedError
from skygcs.ext.plans.certificates.certificate import Certificate
from skygcs.ext.plans.certificates.certify import certify
from skygcs.ext.plans.certificates.plan_search import Task, make_plan
from skygcs.links.simulated import SimulatedVehiclesLink
from skygcs.sim.kinematics import LocalFrame
from skygcs.sim.vehicle import SimVehicle
from support.called import call, plans_of
from support.daemons import made_daemon, started
from support.on_air import FIELD
from support.planned import content, inline
from support.sim_pilot import int_param

VEHICLES = 20
UP_M = 10.0
PARAMS = {"COM_OF_LOSS_T": 4.0, "COM_OBL_RC_ACT": int_param(5), "GUID_TIMEOUT": 4.0}
"""Gaps of a second are longer than a PX4 waits for setpoints by default (1 s, then it holds); an ArduCopter waits
3 s."""

RADIOS = ("air1", "air2", "air3", "air4")
"""Five vehicles on each. With twenty on one, the ground has one slot of 21: at 500 kbit/s that leaves 29 B/s for each
vehicle's setpoints, and with ten 108 B/s; position takes 325 at 5 Hz."""

NORTH_DEG = -5.0 / 111_132.0
"""From the vehicles of one radio to those of the next: a row of five each."""

RADIO = {"air_kbps": 500, "baud": 230400, "loss": 0.05}
"""5 % of all packets by chance; besides, each vehicle is out for `GAP_S` every `GAP_EVERY_S` on average."""

GAP_S = 1.0
GAP_EVERY_S = 40.0
BEGINS = 4
ABORTS_S = 60.0
RESUME_S = 5.0
"""After a stop the operator of the bench looks for so long, then resumes."""

FENCE = {"x_m": [-80, 80], "y_m": [-80, 80], "up_m": [0, 120]}

LIMITS = MotionLimits(speed_mps=1.2, acceleration_mps2=0.8, climb_mps=1.0, descent_mps=1.0)
RULE = MarginRule()
OWED_M = 2 * (Uncertainty().wingspan_m / 2 + Uncertainty().position_error_m)
LOOK_S = 0.1
SETTLES_S = 90.0
"""Until the rates of all vehicles are set: fourteen behind 64 kbit/s take 50 s (measured)."""

LONGEST_S = 900.0

Vector = tuple[float, float, float]
Places = Mapping[str, Vector]


@dataclass(slots=True)
class Watched:
    """What was measured of one flight."""

    least_m: float = math.inf
    pair: str = ""
    at_s: float = 0.0
    others_m: float = math.inf
    """Of the pairs with a vehicle that is cut off."""
    states: list[str] = field(default_factory=list)
    stops: list[str] = field(default_factory=list)
    """What stopped the flight before the operator resumed it."""


class Air:
    """Vehicles behind their radios, on the ground. ``by``: how plans are flown; None: as it is chosen."""

    def __init__(self, daemon: Daemon, radios: Sequence[str] = RADIOS, by: str | None = None) -> None:
        self.daemon = daemon
        self.radios = radios
        self.by = by
        self.frame = LocalFrame(FIELD["lat_deg"], FIELD["lon_deg"], FIELD["alt_amsl_m"])
        self.links = [link for link in map(daemon.links.link, radios) if isinstance(link, SimulatedVehiclesLink)]
        self.names: dict[int, str] = {}
        self._lost: str | None = None
        self._gaps: set[int] = set()
        """System ids that are out for a moment."""

    @property
    def sims(self) -> list[SimVehicle]:
        return [sim for link in self.links for sim in link.vehicles]

    def cut(self, name: str | None) -> None:
        """Nothing of this vehicle's radio is heard any more, nor by it; None: all are heard again."""
        self._lost = name
        self._cut_off()

    def _cut_off(self) -> None:
        for link in self.links:
            assert link.radio is not None
            link.radio.cut_off = frozenset(
                node
                for node, sim in enumerate(link.vehicles, 1)
                if self.names[sim.sysid] == self._lost or sim.sysid in self._gaps
            )

    async def gaps(self) -> None:
        """For ever, by chance."""
        rng = random.Random(3)
        out: list[tuple[float, int]] = []
        while True:
            now = self.daemon.now()
            for sim in self.sims:
                if sim.sysid not in self._gaps and rng.random() < LOOK_S / GAP_EVERY_S:
                    out.append((now + GAP_S, sim.sysid))
            out = [gap for gap in out if gap[0] > now]
            self._gaps = {sysid for _, sysid in out}
            self._cut_off()
            await asyncio.sleep(LOOK_S)

    async def heard(self) -> None:
        """Until every vehicle is there, and planned on its radio."""
        end = self.daemon.now() + 240.0
        while len(self.daemon.fleet.vehicles) < len(self.sims) or not self._settled():
            if self.daemon.now() > end:
                raise RuntimeError("the radios never settled")
            await asyncio.sleep(0.5)
        self.names = {sim.sysid: self.daemon.fleet.vehicles[sim.sysid << 8 | 1].name for sim in self.sims}

    def _settled(self) -> bool:
        radios = self.daemon.air.status(self.daemon.now())
        if all(link.radio is None for link in self.links):
            return True
        return len(radios) == len(self.radios) and all(v["settled"] for radio in radios for v in radio["vehicles"])

    async def call(self, method_name: str, **params: Any) -> Any:
        self.daemon.operator_watchdog.on_client()
        return await call(self.daemon, method_name, **params)

    def places(self) -> dict[str, Vector]:
        """In truth."""
        found = {}
        for sim in self.sims:
            east, north = self.frame.to_local(*sim.where.to_geodetic(sim.motion.east_m, sim.motion.north_m))
            found[self.names[sim.sysid]] = (east, north, sim.motion.up_m)
        return found

    def flying(self) -> set[str]:
        return {self.names[sim.sysid] for sim in self.sims if not sim.motion.on_ground}

    @property
    def state(self) -> str:
        return str(self.daemon.fleet.plans.status()["state"])

    async def fly(self, plan: Plan, seen: Watched, *, until: Callable[[], bool], lost: Callable[[], str | None]) -> Any:
        """Run it and look until then; resume it where it was stopped. ``lost``: the vehicle that is cut off."""
        plans_of(self.daemon).runner.work = inline
        await self.call("plan.load", plan=content(plan), name="bench")
        report = await self._begin()
        began, stopped_s = self.daemon.now(), 0.0
        while not until():
            if self.daemon.now() - began > LONGEST_S:
                raise RuntimeError(f"the plan is {self.state}: {seen.stops}")
            if not seen.states or seen.states[-1] != self.state:
                seen.states.append(self.state)
            gone = lost()
            self.look(seen, self.daemon.now() - began, gone)
            stopped_s = stopped_s + LOOK_S if self.state == "stopped" and gone is None else 0.0
            if stopped_s > RESUME_S:
                stopped_s = 0.0
                seen.stops.append(self.daemon.fleet.plans.status()["reason"][:120])
                await self._go_on(seen)
            await asyncio.sleep(LOOK_S)
        return report

    async def _begin(self) -> Any:
        """Run it; what was refused for a lost frame (a parameter that was not read, an old position) is tried again."""
        how = {} if self.by is None else {"by": self.by}
        for tries in range(BEGINS):
            if tries:
                await asyncio.sleep(RESUME_S)
            answer = await self.call("plan.run", mode="position", set_return_heights=True, force=True, **how)
            if answer["started"]:
                return answer["report"]
        # force is for the clocks only, which virtual time sets apart
        findings = answer["report"]["findings"]
        raise RuntimeError([f["text"] for f in findings if f["severity"] == "refused"][:5])

    async def _go_on(self, seen: Watched) -> None:
        """Resume; where it had not flown yet, abort it and run it from where they are."""
        try:
            answer = await self.call("plan.resume")
            if not answer["ok"]:
                seen.stops.append(answer["message"][:120])
        except RefusedError as error:
            seen.stops.append(str(error)[:120])
            await self.call("plan.abort")
            for _ in range(round(ABORTS_S / RESUME_S)):
                await asyncio.sleep(RESUME_S)
                if self.state != "aborting":
                    break
            await self._begin()

    def look(self, seen: Watched, at_s: float, lost: str | None) -> None:
        """Keep the least distance of two of which one flies, in truth."""
        places, flying = self.places(), self.flying()
        for (one, a), (other, b) in itertools.combinations(places.items(), 2):
            if one not in flying and other not in flying:
                continue
            apart_m = separation_m(a[0] - b[0], a[1] - b[1], a[2] - b[2], RULE.downwash_ratio)
            if lost in (one, other):
                seen.others_m = min(seen.others_m, apart_m)
            if apart_m < seen.least_m:
                seen.least_m, seen.pair, seen.at_s = apart_m, f"{one} {other}", at_s


# --- plans ------------------------------------------------------------------------------------------------------------


def above(air: Air) -> dict[str, Vector]:
    return {name: (x, y, UP_M) for name, (x, y, _) in air.places().items()}


def crossing(air: Air) -> Plan:
    starts = above(air)
    goals = list(starts.values())
    random.Random(7).shuffle(goals)
    return _made(Task(starts, dict(zip(starts, goals, strict=True)), kind="phased"), FlightSpace(ceiling_m=90.0))


def _made(task: Task, space: FlightSpace) -> Plan:
    found = make_plan(task, RULE, LIMITS, space)
    if found.plan is None:
        raise RuntimeError(found.reasons()[:3])
    return found.plan


def circle(count: int, radius_m: float) -> list[Vector]:
    turn = math.tau / count
    return [(10.0 + radius_m * math.cos(turn * i), -8.0 + radius_m * math.sin(turn * i), UP_M) for i in range(count)]


RADIUS_M = 20.0


def formation(air: Air) -> Plan:
    starts = above(air)
    goals = dict(zip(starts, circle(len(starts), RADIUS_M), strict=True))
    return _made(Task(starts, goals, exchangeable=True, kind="timed"), FlightSpace())


SHOW_S = 90.0
STEP_S = 1.5
TURN_RAD = math.pi


def show(air: Air) -> Plan:
    """Half a turn of the circle in which they stand, each with a wave of its own in height, from rest to rest."""
    trajectories = {}
    for name, (x, y, _) in above(air).items():
        phase = math.atan2(y + 8.0, x - 10.0)

        def at(t: float, phase: float = phase) -> Vector:
            u = min(1.0, max(0.0, t / SHOW_S))
            eased = u**3 * (10.0 - 15.0 * u + 6.0 * u * u)
            angle = phase + TURN_RAD * eased
            wave = 3.0 * math.sin(math.pi * eased) * math.sin(4.0 * math.pi * eased + 2.0 * phase)
            return 10.0 + RADIUS_M * math.cos(angle), -8.0 + RADIUS_M * math.sin(angle), UP_M + 2.0 + wave - 2.0

        trajectories[name] = _through(at)
    return TimedPlan(trajectories)


def _through(at: Callable[[float], Vector]) -> Trajectory:
    """Cubic pieces through the places, with the velocities there by central differences."""
    h, pieces = STEP_S, []
    steps = round(SHOW_S / h)
    velocity = [
        [(q - p) / 0.02 for p, q in zip(at(h * k - 0.01), at(h * k + 0.01), strict=True)] for k in range(steps + 1)
    ]
    velocity[0] = velocity[-1] = [0.0, 0.0, 0.0]
    for k in range(steps):
        axes = []
        for p, q, v, w in zip(at(h * k), at(h * (k + 1)), velocity[k], velocity[k + 1], strict=True):
            axes.append((p, v, 3 * (q - p) / h**2 - (2 * v + w) / h, 2 * (p - q) / h**3 + (v + w) / h**2))
        pieces.append(Piece(h, axes[0], axes[1], axes[2]))
    return Trajectory(pieces)


# --- flights ----------------------------------------------------------------------------------------------------------


OVER = ("finished", "aborted", "landed")


@contextlib.asynccontextmanager
async def in_the_air(
    folder: Path, links: Mapping[str, Mapping[str, Any]], *, by: str | None = None, fence: Mapping[str, Any] = FENCE
) -> AsyncIterator[Air]:
    """A daemon with these simulated radios, once it has heard and planned all their vehicles."""
    daemon = made_daemon(folder, origin=FIELD, links=links, defaults={"control": {"fence": fence}})
    async with started(daemon):
        await asyncio.sleep(1.0)
        air = Air(daemon, list(links), by)
        for sim in air.sims:
            for param, value in PARAMS.items():
                sim.params.set(param, value)
        await air.heard()
        await asyncio.sleep(SETTLES_S)
        yield air


async def fly_all(folder: Path, names: list[str]) -> list[dict[str, Any]]:
    """The flights of these names, one after the other in one air; a lost link comes last."""
    half = VEHICLES // len(RADIOS)
    common = {"type": "simulated", "role": "radio", "dynamics": "kinematic", "radio": RADIO, "stream_profile": "nav"}
    links = {
        name: {
            **common,
            "air_speed_kbps": RADIO["air_kbps"],
            "nodes": half + 1,
            "px4": half // 2,
            "ardupilot": half - half // 2,
            "first_sysid": 1 + half * i,
            "lat_deg": FIELD["lat_deg"] + i * NORTH_DEG,
        }
        for i, name in enumerate(RADIOS)
    }
    async with in_the_air(folder, links) as air:
        gaps = asyncio.create_task(air.gaps(), name="gaps")
        try:
            return [await (_lost_link(air) if name == "lost link" else _flight(air, name)) for name in names]
        finally:
            gaps.cancel()


async def _flight(air: Air, name: str) -> dict[str, Any]:
    plan = {"crossing": crossing, "formation": formation, "show": show}[name](air)
    certificate = certify(plan, RULE, FlightSpace())
    seen = Watched()
    report = await air.fly(plan, seen, until=lambda: air.state in OVER, lost=lambda: None)
    return _row(air, name, certificate, seen, report)


async def _lost_link(air: Air) -> dict[str, Any]:
    """The crossing from where they are; one is cut off on its way, and all are looked at for a minute."""
    plan = crossing(air)
    assert isinstance(plan, PhasedPlan)
    phase = plan.phases[1]
    victim = _longest(plan.phases[0], phase, list(air.names.values()))
    cut_at: list[float] = []

    def lost() -> str | None:
        status = air.daemon.fleet.plans.status()
        clock = status["clock"]
        if not cut_at and status["phase"] == phase.name and clock and clock["trajectory_s"] > 0.4 * clock["duration_s"]:
            cut_at.append(air.daemon.now())
            air.cut(victim)
        return victim if cut_at else None

    seen = Watched()
    report = await air.fly(
        plan,
        seen,
        until=lambda: (bool(cut_at) and air.daemon.now() - cut_at[0] > 60.0) or (not cut_at and air.state in OVER),
        lost=lost,
    )
    row = _row(air, "lost link", certify(plan, RULE, FlightSpace()), seen, report)
    air.cut(None)
    return row | {"victim": victim, "near_the_lost_m": round(seen.others_m, 2), "cut": bool(cut_at)}


def _longest(climb: Phase, cross: Phase, names: list[str]) -> str:
    """The vehicle with the longest way."""
    ways = {n: math.dist(climb.goals[n], cross.goals[n]) for n in names if n in climb.goals and n in cross.goals}
    return max(ways, key=lambda name: ways[name])


def _row(air: Air, name: str, certificate: Certificate, seen: Watched, report: Mapping[str, Any]) -> dict[str, Any]:
    status = air.daemon.fleet.plans.status()
    closest = certificate.closest
    assert closest is not None
    margins = report["certificate"]["closest"]
    wanted = "stopped" if name == "lost link" else "finished"
    return {
        "flight": name,
        "vehicles": len(air.sims),
        "state": status["state"],
        "reason": status["reason"],
        "states": seen.states,
        "stops": seen.stops,
        "certified_margin_m": round(margins["margin_m"], 2),
        "certified_least_m": round(margins["distance_at_least_m"], 2),
        "owed_m": OWED_M,
        "measured_least_m": round(seen.least_m, 2),
        "pair": seen.pair,
        "at_s": round(seen.at_s, 1),
        "met": status["state"] == wanted and min(seen.least_m, seen.others_m) >= margins["margin_m"],
    }


SHARES = (["crossing"], ["formation", "show"], ["lost link"])
"""Flown with a daemon each."""


def text(row: Mapping[str, Any]) -> str:
    lost = f"; {row['victim']} cut off, others {row['near_the_lost_m']:.2f} m from it" if "victim" in row else ""
    return (
        f"{'met   ' if row['met'] else 'MISSED'} {row['flight']:10} {row['state']}, {len(row['stops'])} stops; "
        f"certified margin {row['certified_margin_m']:.2f} m, references {row['certified_least_m']:.2f} m, measured "
        f"{row['measured_least_m']:.2f} m ({row['pair']}){lost}"
    )


def flights(names: list[str]) -> list[dict[str, Any]]:
    """In virtual time."""
    return in_virtual_time(lambda folder: fly_all(folder, names))
