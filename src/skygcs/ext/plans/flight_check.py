"""The check of a plan before it is flown: vehicles are measured and asked, the way to the starts is made, and all is
certified with what is measured now. Nothing moves; `write_heights` sets what the check has found necessary."""

from __future__ import annotations

import asyncio
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, NamedTuple, Protocol

from skygcs.core.geo import EnuFrame, Origin
from skygcs.core.plan.fleet_plan import FlightSpace, PhasedPlan, Plan, TimedPlan
from skygcs.core.plan.margins import MarginRule
from skygcs.core.preflight.report import ReturnSetting, offered_heights
from skygcs.core.vehicle.flight_lock import FlightLock
from skygcs.core.vehicle.trajectory_flight import LoadedTrajectory
from skygcs.errors import RefusedError, TargetError
from skygcs.ext.plans.flight import remedies
from skygcs.ext.plans.flight.execution import Execution
from skygcs.ext.plans.flight.flight_findings import (
    Finding,
    Level,
    refusals,
    refused,
    return_height_findings,
)
from skygcs.ext.plans.flight.flight_situation import Prepared, Situation
from skygcs.ext.plans.flight.flight_steps import FlightStep, renamed, starts_of
from skygcs.ext.plans.flight.guidance import AUTO, Choice, Guidance, choose
from skygcs.ext.plans.flight.plan_rehearsal import Stage
from skygcs.ext.plans.flight.sights import Tubes
from skygcs.ext.plans.flight_preparation import Rehearsed, Work, limits_of, prepared_and_loaded, stage_of
from skygcs.ext.plans.plan_checks import (
    Measured,
    armed_together,
    battery_findings,
    bounds_findings,
    certificate_findings,
    climb_s,
    fence_findings,
    grounds,
    link_findings,
    made_elsewhere,
    margin_rule,
    measure,
    mission_findings,
    not_streamed,
    preflight_findings,
    reach_findings,
    rehearsal_findings,
    return_heights,
    state_finding,
)
from skygcs.runtime.flight_notes import FlightNotes
from skygcs.runtime.separation_monitor import SeparationMonitor
from skygcs.runtime.task_set import TaskSet
from skygcs.runtime.vehicle_actor import VehicleActor
from skygcs.runtime.vehicle_services import VehicleLinks
from skygcs.spelling import rounded

MAX_STEPS_SHOWN = 50

NewLock = Callable[["KeptPlan", Sequence[VehicleActor], Origin], FlightLock]
"""Makes the lock of a flight of these vehicles about this origin."""


@dataclass(frozen=True, slots=True)
class KeptPlan:
    """A plan that was loaded."""

    number: str
    name: str
    plan: Plan
    space: FlightSpace

    def describe(self) -> dict[str, Any]:
        """Description for people and programs."""
        plan = self.plan
        timed = isinstance(plan, TimedPlan)
        return {
            "plan": self.number,
            "name": self.name,
            "kind": "timed" if timed else "phased",
            "vehicles": list(starts_of(plan)),
            "duration_s": round(max(t.duration_s for t in plan.trajectories.values()), 3)
            if isinstance(plan, TimedPlan)
            else None,
            "phases": [phase.name for phase in plan.phases] if isinstance(plan, PhasedPlan) else [],
        }


@dataclass(frozen=True, slots=True)
class FlightRequest:
    """How a plan is to be flown. ``vehicles``: names in the plan → targets of the fleet; None: all, by their names."""

    plan: str | None = None
    vehicles: Mapping[str, str] | None = None
    control_mode: str = "position"
    speed_factor: float = 1.0
    margin_m: float | None = None
    force: bool = False
    by: str = AUTO
    """A `Guidance`, or the choice of one."""


@dataclass(slots=True)
class Checked:
    """Result of a check: what it has found, and what a flight of it takes."""

    kept: KeptPlan
    actors: list[VehicleActor]
    lock: FlightLock
    by: Choice
    rule: MarginRule | None = None
    """Margins of the plan, once they are known."""
    findings: list[Finding] = field(default_factory=list)
    steps: tuple[FlightStep, ...] = ()
    loaded: tuple[dict[str, LoadedTrajectory], ...] = ()
    execution: Execution | None = None
    certificate: Any = None
    way: Any = None
    sources: dict[str, dict[str, list[Any]]] | None = None
    heights: dict[str, ReturnSetting | None] | None = None
    apart_m: float = 0.0
    new_heights: dict[str, float] = field(default_factory=dict)
    """Return heights in metres that are to be set before the flight begins."""

    def passes(self, *, force: bool) -> bool:
        """True if nothing found keeps the plan on the ground."""
        return not refusals(self.findings, force=force)

    def report(self, *, force: bool) -> dict[str, Any]:
        """JSON-able."""
        findings = self.findings
        heights = self.heights or {}
        offered = offered_heights(heights, self.apart_m)
        return {
            "ok": not refusals(findings, force=force),
            "by": self.by.by.value,
            "why": self.by.reason,
            "findings": [finding.as_dict() for finding in findings],
            "certificate": None if self.certificate is None else self.certificate.as_dict(),
            "way_there": None if self.way is None else self.way.as_dict(),
            "margins": self.sources or {},
            "duration_s": round(math.fsum(step.duration_s for step in self.steps), 1),
            "steps": [
                {
                    "name": step.name,
                    "duration_s": round(step.duration_s, 1),
                    "goals": {name: [round(v, 2) for v in place] for name, place in step.places().items()},
                }
                for step in self.steps[:MAX_STEPS_SHOWN]
            ],
            "return_heights": {
                name: [h.height_m, offered[name], h.param] for name, h in heights.items() if h is not None
            },
        }


class ChosenWay(NamedTuple):
    """The way in which a plan is flown, and what was found of the links that it needs."""

    choice: Choice
    findings: list[Finding]


class Vehicles(Protocol):
    """The parts of the fleet that a check needs."""

    def resolve(self, expression: str) -> list[VehicleActor]: ...
    def everybody(self) -> list[VehicleActor]: ...
    @property
    def origin(self) -> Origin | None: ...
    @property
    def links(self) -> VehicleLinks: ...
    @property
    def monitor(self) -> SeparationMonitor: ...
    @property
    def notes(self) -> FlightNotes: ...


class FlightCheck:
    """Checks flights of plans of one fleet."""

    def __init__(self, fleet: Vehicles, work: Work, loop: asyncio.AbstractEventLoop) -> None:
        self._fleet = fleet
        self._work = work
        self._loop = loop
        self._links = fleet.links
        self._record = fleet.notes.charges.record

    def chosen_way(self, actors: Sequence[VehicleActor], control_mode: str, by: str, *, timed: bool) -> ChosenWay:
        """The way in which these vehicles fly a plan, and what was found of their links. Raises RefusedError."""
        narrow = not_streamed(actors, control_mode, self._links)
        own = {actor.name: made_elsewhere(actor) for actor in actors}
        choice = choose(by, timed=timed, own_companion=own, not_streamed=narrow)
        return ChosenWay(choice, link_findings(actors, choice, narrow, control_mode, self._loop.time(), timed=timed))

    async def check(
        self, kept: KeptPlan, request: FlightRequest, lock: NewLock, *, set_return_heights: bool = False
    ) -> Checked:
        """``lock`` makes what the flight is checked with. Raises RefusedError, TargetError."""
        names, actors = self._chosen(kept, request.vehicles)
        origin = self._fleet.origin
        if origin is None:
            raise RefusedError("the fleet has no origin yet: set [origin], or `skygcs-cli origin from`")
        timed = isinstance(kept.plan, TimedPlan)
        way = self.chosen_way(actors, request.control_mode, request.by, timed=timed)
        by = way.choice.by
        checked = Checked(kept, actors, lock(kept, actors, origin), way.choice)
        frame, now = EnuFrame(origin), self._loop.time()
        # each vehicle by itself
        await asyncio.gather(*(actor.read_loss() for actor in actors))
        findings = checked.findings
        findings += [state_finding(actor, [actor.name for actor in actors], now) for actor in actors]
        findings += way.findings
        if by is Guidance.MISSION:
            findings += await mission_findings(actors)
        if not refusals(findings, force=request.force):
            standing = measure(actors, [], frame, now).grounded
            findings += await preflight_findings(actors, standing)
            checked.heights = await return_heights(actors)
        # the places as they are now, after the questions
        measured = measure(
            actors, self._fleet.everybody(), frame, self._loop.time(), self._fleet.monitor.ways.why_leaving
        )
        findings += measured.findings
        rule, checked.sources = self.margins(actors, request, by)
        checked.rule = rule
        if len(measured.places) < len(actors):
            return checked
        _check_heights(checked, rule, set_return_heights=set_return_heights)
        # the way there, the plan, the certificates
        situation = Situation(
            renamed(kept.plan, names),
            space_with(kept.space, measured, {actor.name for actor in actors}),
            measured.places,
            measured.grounded,
            rule,
            limits_of(actors, request.speed_factor),
            request.speed_factor,
            by,
            grounds(actors, measured, frame),
        )
        stage = None if by.own_way else stage_of(checked.lock, actors, request.speed_factor)
        prepared, checked.loaded, stopped = await self.prepared(situation, None, stage)
        checked.steps, checked.certificate, checked.way = prepared.steps, prepared.certificate, prepared.way
        findings += certificate_findings(prepared)
        findings += bounds_findings(checked.steps, checked.loaded, checked.lock, request.speed_factor)
        findings += rehearsal_findings(stopped, timed=timed)
        if by.own_way:
            findings += reach_findings(checked.steps, actors)
        findings += await fence_findings(actors, prepared, frame, measured)
        flight_s = climb_s(prepared, measured) + prepared.duration_s / request.speed_factor
        findings += battery_findings(actors, flight_s, self._record)
        if prepared.tubes is not None and prepared.steps:
            checked.execution = self._execution(prepared, prepared.tubes, measured, actors, by)
        return checked

    def _execution(
        self, prepared: Prepared, tubes: Tubes, measured: Measured, actors: Sequence[VehicleActor], by: Guidance
    ) -> Execution:
        places, together = measured.places, armed_together(actors, self._links)
        return Execution(prepared.steps, measured.grounded, tubes, places, by=by, together=together)

    async def prepared(self, situation: Situation, rest: list[FlightStep] | None, stage: Stage | None) -> Rehearsed:
        """The steps and trajectories of a flight; ``rest``: after a stop. See `prepared_and_loaded`."""
        found: Rehearsed = await self._work(prepared_and_loaded, situation, rest, stage)
        return found

    def _chosen(self, kept: KeptPlan, vehicles: Mapping[str, str] | None) -> tuple[dict[str, str], list[VehicleActor]]:
        """The fleet's name of each vehicle of the plan, and the vehicles. Raises RefusedError, TargetError."""
        wanted = {name: name for name in starts_of(kept.plan)} if vehicles is None else dict(vehicles)
        if unknown := wanted.keys() - starts_of(kept.plan).keys():
            raise RefusedError(f"the plan has no {min(unknown)[:40]}")
        if not wanted:
            raise RefusedError("a flight has one vehicle at least")
        names, actors = dict[str, str](), list[VehicleActor]()
        for name, target in wanted.items():
            found = self._fleet.resolve(target)
            if len(found) != 1:
                raise TargetError(f"{target!r} names {len(found)} vehicles; one is wanted for {name} of the plan")
            if found[0] in actors:
                raise RefusedError(f"{found[0].name} is given twice")
            names[name] = found[0].name
            actors.append(found[0])
        return names, actors

    def margins(
        self, actors: Sequence[VehicleActor], request: FlightRequest, by: Guidance
    ) -> tuple[MarginRule, dict[str, dict[str, list[Any]]]]:
        """The margins of a flight, and the sources of their terms by vehicle."""
        others = [actor for actor in self._fleet.everybody() if actor not in actors]
        return margin_rule(actors, others, request.margin_m, by)


async def write_heights(checked: Checked, tasks: TaskSet, ending: Callable[[], bool]) -> None:
    """Set the return heights that the check has found necessary; all of them, or none if one cannot be set, the order
    is cancelled or the daemon is ``ending`` meanwhile."""
    before = dict(checked.heights or {})
    written: list[VehicleActor] = []
    done = False
    try:
        for actor in checked.actors:
            wanted, is_now = checked.new_heights.get(actor.name), before.get(actor.name)
            if wanted is None or is_now is None:
                continue
            written.append(actor)
            outcomes = await actor.params.set({is_now.param: wanted * is_now.per_metre}, own=checked.lock)
            failed = [f"{name}: {outcome.message}" for name, outcome in outcomes.items() if not outcome.ok]
            if failed:
                remedy = remedies.insist("check its link")
                checked.findings.append(refused(actor.name, "return height", failed[0], remedy))
                return
        done = not ending()
    finally:
        if not done:
            await asyncio.shield(tasks.start(_restore_heights(checked, written, before), "heights undone"))
    heights = {
        name: None if h is None else h._replace(height_m=checked.new_heights.get(name, h.height_m))
        for name, h in before.items()
    }
    checked.heights = heights


async def _restore_heights(
    checked: Checked, written: Sequence[VehicleActor], before: Mapping[str, ReturnSetting | None]
) -> None:
    """The return heights as they were, of those whose new one was sent."""
    for actor in written:
        height = before[actor.name]
        if height is None:
            continue
        outcomes = await actor.params.set({height.param: height.height_m * height.per_metre}, own=checked.lock)
        if not all(outcome.ok for outcome in outcomes.values()):
            text = f"{height.param} may not be {rounded(height.height_m)} m as before"
            remedy = remedies.set_parameter(actor.name, height.param, height.height_m * height.per_metre)
            checked.findings.append(refused(actor.name, "return height", text, remedy))


def _check_heights(checked: Checked, rule: MarginRule, *, set_return_heights: bool) -> None:
    """Find return heights that are too near each other; note those that are to be set if that is asked for."""
    if checked.heights is None or len(checked.actors) < 2:
        return
    half_m = max(rule.half_m(actor.name) for actor in checked.actors)
    checked.apart_m = 2.0 * half_m * rule.downwash_ratio
    found = return_height_findings(checked.heights, checked.apart_m)
    if set_return_heights and any(f.level is Level.REFUSED for f in found):
        offered = offered_heights(checked.heights, checked.apart_m)
        known = {name: height for name, height in checked.heights.items() if height is not None}
        checked.new_heights = {name: offered[name] for name, h in known.items() if offered[name] != h.height_m}
        wanted = {
            name: None if height is None else height._replace(height_m=offered[name])
            for name, height in checked.heights.items()
        }
        found = return_height_findings(wanted, checked.apart_m)
    checked.findings += found


def space_with(space: FlightSpace, measured: Measured, taking_part: set[str]) -> FlightSpace:
    """Return what the plan says stands somewhere, and what is measured: that counts."""
    standing = {name: place for name, place in space.standing.items() if name not in taking_part}
    return replace(space, standing={**standing, **measured.others})
