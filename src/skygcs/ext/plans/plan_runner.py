"""The plan of a fleet: kept, checked, flown. One plan at a time.

    load     it is kept in memory; nothing moves
    check    vehicles are measured and asked, the way to the starts is made, all is certified with what is measured now
    run      the check, and if it passes (or somebody insists) the flight; it goes on without its client
    resume   where everybody is at its place the clock goes on; else with a way back and a new certificate

Certificates take numpy and up to seconds, so they are made by a process of their own (`work`).
"""

from __future__ import annotations

import asyncio
import functools
import itertools
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Protocol

from skygcs.core.geo import Origin
from skygcs.core.plan.fleet_plan import FlightSpace
from skygcs.core.plan.margins import MarginRule
from skygcs.core.plan.plan_json import plan_from_json, read_plan_json
from skygcs.core.trajectory import ClockState
from skygcs.core.vehicle.flight_lock import FlightLock, Holder
from skygcs.core.vehicle.trajectory_flight import LoadedTrajectory
from skygcs.errors import RefusedError, SkygcsError
from skygcs.events import Event
from skygcs.ext.plans.flight.execution import POSITION_SILENT_S, SLOW_MPS, Execution
from skygcs.ext.plans.flight.flight_findings import refusals
from skygcs.ext.plans.flight.flight_situation import Situation
from skygcs.ext.plans.flight.flight_steps import FlightStep, from_where, plan_of, rest_of
from skygcs.ext.plans.flight.guidance import Guidance
from skygcs.ext.plans.flight.plan_states import PlanState
from skygcs.ext.plans.flight.sights import Measurement
from skygcs.ext.plans.flight_check import (
    Checked,
    ChosenWay,
    FlightCheck,
    FlightRequest,
    KeptPlan,
    Vehicles,
    space_with,
    write_heights,
)
from skygcs.ext.plans.flight_preparation import Work, limits_of, stage_of, way_down
from skygcs.ext.plans.plan_by_goto import GotoGuidance, MissionGuidance
from skygcs.ext.plans.plan_by_setpoints import SetpointGuidance
from skygcs.ext.plans.plan_checks import (
    Measured,
    home_of,
    measure,
    stopped_text,
)
from skygcs.ext.plans.plan_flight import KIND, FlightGuidance, FlightOrders, FlightSettings, Loaded, PlanFlight
from skygcs.ext.plans.plan_uploads import PlanUploads
from skygcs.runtime.flight_locks import FlightLocks
from skygcs.runtime.plan_place import PlanPlace
from skygcs.runtime.task_set import TaskSet, ask
from skygcs.runtime.trajectories import Trajectories
from skygcs.runtime.vehicle_actor import VehicleActor

BELOW_GROUND_M = 2.0
"""A landing is certified down to so far below the lowest known ground: the field may slope."""

LAST_ENDS_S = 15.0
"""An order to hold is repeated for some 10 s at most."""

MISSION_LEFT = (
    "they are not on their missions' ways any more: `skygcs-cli plan abort`, then `skygcs-cli plan run FILE` from "
    "where they are"
)
"""A mission is certified from where it began."""


class PlanFleet(Vehicles, Protocol):
    """The parts of the fleet that a plan needs."""

    @property
    def vehicles(self) -> Mapping[int, VehicleActor]: ...
    @property
    def locks(self) -> FlightLocks: ...
    @property
    def trajectories(self) -> Trajectories: ...
    @property
    def plans(self) -> PlanPlace: ...


class PlanRunner:
    """Runner of the plans of one fleet, whose `PlanPlace` is notified of each change of `status`."""

    def __init__(
        self,
        fleet: PlanFleet,
        work: Work,
        loop: asyncio.AbstractEventLoop,
        on_event: Callable[[Event], None],
    ) -> None:
        self.kept: KeptPlan | None = None
        self.flight: PlanFlight | None = None
        self.uploads = PlanUploads()
        self.work = work
        """Runs what is heavy: a function and its arguments."""
        self._changed = fleet.plans.changed
        self._fleet = fleet
        self._flight_check = FlightCheck(fleet, self._in_process, loop)
        self._loop = loop
        self._on_event = on_event
        self._trajectories = fleet.trajectories
        self._orders = FlightOrders(loop, on_event, fleet.plans.changed, self._certify_landing)
        self._numbers = itertools.count(1)
        self._busy: str | None = None
        """Work under way that must not run twice: a check before a flight, or a new certificate."""
        self._by = Guidance.SETPOINTS
        self._request = FlightRequest()
        self._force_landing = False
        self._tasks = TaskSet(loop, on_event)
        self._checking: FlightLock | None = None
        """Flight lock of the flight that is being checked before it begins."""
        self._ending = False

    # -- what is kept

    async def load(self, content: Mapping[str, Any] | int, name: str) -> dict[str, Any]:
        """Keep a plan in our JSON format, in place of the one before; ``content``: of its file, or the number of an
        upload. Raises RefusedError, PlanFileError."""
        self._require_idle("another plan cannot be loaded")
        if isinstance(content, int):
            data = self.uploads.take(content, self._loop.time())
            plan, space = await self.work(read_plan_json, name, data)
        else:
            plan, space = await self.work(plan_from_json, name, content)
        self._require_idle("another plan cannot be loaded")
        self.kept, self.flight = KeptPlan(str(next(self._numbers)), name, plan, space), None
        self._changed()
        return self.kept.describe()

    def unload(self) -> str:
        """Forget the plan. Raises RefusedError."""
        self._require_idle("it cannot be unloaded")
        if self.kept is None:
            raise RefusedError("no plan is loaded")
        name, self.kept, self.flight = self.kept.name, None, None
        self._changed()
        return f"{name} is unloaded"

    def _require_idle(self, what: str) -> None:
        if self._busy is not None:
            raise RefusedError(f"{what}: {self._busy} is under way")
        if self.flight is not None and not self.flight.execution.over:
            state = self.flight.execution.state
            raise RefusedError(f"{what}: {self.flight.settings.plan} is {state}; `skygcs-cli plan abort` first")

    # -- checks

    async def check(self, request: FlightRequest) -> dict[str, Any]:
        """The report; nothing moves. Raises RefusedError, TargetError."""
        return (await self._check(request)).report(force=request.force)

    async def _check(self, request: FlightRequest, *, set_return_heights: bool = False, held: bool = False) -> Checked:
        """``held``: nobody may change what it is checked with from here on."""
        lock = functools.partial(self._locked, held=held)
        return await self._flight_check.check(
            self._kept(request.plan), request, lock, set_return_heights=set_return_heights
        )

    def chosen_way(self, actors: Sequence[VehicleActor], control_mode: str, by: str, *, timed: bool) -> ChosenWay:
        """See `FlightCheck.chosen_way`."""
        return self._flight_check.chosen_way(actors, control_mode, by, timed=timed)

    async def _in_process(self, function: Callable[..., Any], *arguments: Any) -> Any:
        return await self.work(function, *arguments)

    async def run(self, request: FlightRequest, *, set_return_heights: bool = False) -> tuple[bool, dict[str, Any]]:
        """Return whether the flight has begun, and the report. Raises RefusedError, TargetError."""
        self._require_idle("it cannot be flown")
        if self._ending:
            raise RefusedError("skygcs is shutting down")
        self._busy = "the check before a flight"
        self._orders.serial = ask()  # here: what is ordered during the check is the later order
        try:
            await self._last_ended()
            checked = await self._check(request, set_return_heights=set_return_heights, held=True)
            if not checked.passes(force=request.force) or checked.execution is None or checked.rule is None:
                return False, checked.report(force=request.force)
            if (lacking := await self._relayed(checked.actors, checked.loaded)) is not None:
                raise RefusedError(lacking)
            if self._ending:
                raise RefusedError("skygcs is shutting down")
            if checked.new_heights:  # last: a flight that is refused has changed nothing
                await write_heights(checked, self._tasks, lambda: self._ending)
            report = checked.report(force=request.force)
            if report["ok"]:
                self._begin(request, checked, checked.execution, checked.rule)
            return bool(report["ok"]), report
        finally:
            self._busy = self._checking = None

    async def _last_ended(self) -> None:
        """Wait for the orders to hold at the end of the last flight: one that comes later than an engagement of this
        one would take its place. Raises RefusedError."""
        try:
            async with asyncio.timeout(LAST_ENDS_S):
                await self._orders.settled()
        except TimeoutError:
            raise RefusedError("orders of the last flight are still under way: `skygcs-cli plan status`") from None

    def _begin(self, request: FlightRequest, checked: Checked, execution: Execution, rule: MarginRule) -> None:
        """Let a checked flight begin."""
        settings = FlightSettings(checked.kept.name, request.control_mode, request.speed_factor, request.force)
        actors = {actor.name: actor for actor in checked.actors}
        self._request, self._by = request, checked.by.by
        guidance = self._guidance(checked.by.by)
        self.flight = PlanFlight(settings, execution, actors, checked.loaded, checked.lock, rule, guidance, self._knows)
        self.flight.look(self._loop.time())
        self._orders.carry_out(self.flight, execution.begin())

    def _guidance(self, by: Guidance) -> FlightGuidance:
        if by.own_way:
            make = GotoGuidance if by is Guidance.GOTO else MissionGuidance
            return make(self._fleet.monitor, self._loop, self._orders.start)
        return SetpointGuidance(self._trajectories, self._loop, by)

    def _locked(self, kept: KeptPlan, actors: Sequence[VehicleActor], origin: Origin, *, held: bool) -> FlightLock:
        """Return what the flight is checked with; ``held`` from here to the end of the flight."""
        flown = [(actor.vehicle, actor.config.control) for actor in actors]
        lock = self._fleet.locks.make(Holder.PLAN, kept.name, origin, flown)
        if held:
            self._checking = lock
            self._hold(lock)
        return lock

    def _hold(self, lock: FlightLock) -> None:
        """Hold a lock as long as its flight is checked or under way."""

        def under_way() -> bool:
            return self._checking is lock or (self.moving and self.flight is not None and self.flight.lock is lock)

        self._fleet.locks.take(lock, under_way)

    def _kept(self, number: str | None) -> KeptPlan:
        if self.kept is None:
            raise RefusedError("no plan is loaded: plan.load first")
        if number is not None and number != self.kept.number:
            raise RefusedError(f"plan {number} is not loaded any more; plan {self.kept.number} ({self.kept.name}) is")
        return self.kept

    # -- orders of people

    def pause(self) -> str:
        """Stop on the way. Raises RefusedError."""
        flight = self._flying()
        orders = flight.execution.pause()
        self._orders.serial = ask()
        self._orders.carry_out(flight, orders)
        return "stopping on the way"

    def abort(self) -> str:
        """Stop for good, then hold. Raises RefusedError."""
        flight = self._flying()
        orders = flight.execution.abort()
        self._orders.serial = ask()
        self._orders.carry_out(flight, orders)
        return "stopping for good, then holding"

    def land(self, *, force: bool = False) -> str:
        """Stop, and land where a certificate allows it; with ``force`` without one. Raises RefusedError."""
        flight = self._flying()
        orders = flight.execution.land()
        self._force_landing = force
        self._orders.serial = ask()
        self._orders.carry_out(flight, orders)
        return "stopping, then landing"

    def set_speed(self, speed_factor: float) -> str:
        """Fly at this multiple of the planned speed, no faster than was certified. Raises RefusedError."""
        flight = self._flying()
        certified = self._request.speed_factor
        if speed_factor > certified * (1.0 + 1e-9):
            raise RefusedError(
                f"it was certified for {certified:g} times the planned speed: run it with --speed for more"
            )
        if flight.guidance.by is Guidance.GOTO:
            raise RefusedError("by goto autopilots fly at their own speed: `skygcs-cli param set` changes it")
        if flight.execution.over or not flight.guidance.set_speed(speed_factor):
            raise RefusedError(f"the plan is {flight.execution.state}: its speed cannot be changed now")
        flight.settings = flight.settings._replace(speed_factor=speed_factor)
        self._changed()
        return f"flying at {speed_factor:g} times the planned speed"

    async def resume(self, *, force: bool = False) -> tuple[bool, str, list[str]]:
        """Go on with a new certificate: (whether, a line, reasons). Raises RefusedError."""
        flight = self._flying()
        execution = flight.execution
        execution.require_resumable()
        if self._busy is not None:
            raise RefusedError(f"{self._busy} is under way")
        self._busy = "a new certificate"
        try:
            return await self._resume(flight, force=force)
        finally:
            self._busy = None

    async def _resume(self, flight: PlanFlight, *, force: bool) -> tuple[bool, str, list[str]]:
        execution, now, serial = flight.execution, self._loop.time(), ask()
        sights = flight.look(now)
        state, trajectory_s = flight.clock(now)
        in_place = not execution.left and not execution.away(trajectory_s, sights)
        staying, out, reasons = _returning(execution, sights, force=force)
        if reasons or not staying:
            reasons = reasons or ["nobody is left to fly it"]
            return False, f"refused: {reasons[0]}", reasons
        if not in_place and state in (ClockState.RUNNING, ClockState.PAUSING, ClockState.ABORTING):
            raise RefusedError("they are still stopping: wait a moment")
        # the rest of the plan, and the way back to it
        actors = [flight.actors[name] for name in staying]
        departed, modes = _departed(execution, sights), {actor.name: actor.vehicle.mode for actor in actors}
        measured = measure(actors, self._fleet.everybody(), flight.frame, now, self._fleet.monitor.ways.why_leaving)
        lacking = [f"{f.vehicle}: {f.text}" for f in refusals(measured.findings, force=force)]
        if lacking or len(measured.places) < len(actors):
            return False, f"refused: {lacking[0] if lacking else 'a position is not known'}", lacking
        if flight.guidance.by is Guidance.MISSION:
            if not in_place or execution.left:
                return False, f"refused: {MISSION_LEFT}", [MISSION_LEFT]
            self._orders.serial = serial
            self._orders.carry_out(flight, execution.go_on())
            return True, "going on with their missions", []
        rest = rest_of(execution.steps[execution.index :], trajectory_s, frozenset(staying))
        by = flight.guidance.by
        if by is Guidance.GOTO and not in_place:  # from where they are on their legs, and not from the begin of these
            limits = limits_of(actors, self._request.speed_factor)
            rest[0] = from_where(rest[0], measured.places, execution.tubes.downwash_ratio, limits)
        situation = self._situation_of_rest(actors, measured, rest, in_place=in_place)
        stage = None
        if by is not Guidance.GOTO:
            stage = stage_of(flight.lock, actors, self._request.speed_factor)
        prepared, loaded, stopped = await self._flight_check.prepared(situation, rest, stage)
        if stopped is not None:
            return False, f"refused: {stopped_text(stopped[0])}", [stopped_text(stopped[0])]
        if prepared.problems or prepared.tubes is None:
            return False, f"refused: {prepared.problems[0]}", list(prepared.problems)
        if not in_place and (why := await self._relayed(actors, loaded)) is not None:
            return False, f"refused: {why}", [why]
        # seconds have passed
        if self.flight is not flight or execution.state not in (PlanState.PAUSED, PlanState.STOPPED) or self._ending:
            raise RefusedError(f"the plan is {execution.state} by now")
        if gone := sorted(_departed(execution, flight.look(self._loop.time())) - departed):
            why = f"{', '.join(gone)} left while the certificate was made: resume it again from where they are"
            return False, f"refused: {why}", [why]
        if in_place and not execution.left:
            flight.rule = situation.rule
            self._orders.serial = serial
            self._orders.carry_out(flight, execution.go_on())
            return True, "going on: all are at their places", []
        # a new flight from here
        lock = flight.lock.of(frozenset(staying)).in_modes(modes)
        again = Execution(prepared.steps, (), prepared.tubes, prepared.steps[0].starts(), by=by)
        self._orders.serial = serial
        self._begin_again(flight, again, loaded, lock, situation.rule)
        without = f", without {', '.join(out)}" if out else ""
        return True, f"going back to their ways, then on{without}", []

    def _begin_again(
        self, flight: PlanFlight, execution: Execution, loaded: Sequence[Loaded], lock: FlightLock, rule: MarginRule
    ) -> None:
        """Let a flight begin that goes on with the rest of this one."""
        flight.guidance.end(flight)
        actors = {name: flight.actors[name] for name in execution.names}
        guidance = self._guidance(flight.guidance.by)
        self.flight = PlanFlight(flight.settings, execution, actors, loaded, lock, rule, guidance, self._knows)
        self._hold(lock)
        self.flight.look(self._loop.time())
        self._orders.carry_out(self.flight, execution.begin())

    def _situation_of_rest(
        self, actors: Sequence[VehicleActor], measured: Measured, rest: Sequence[FlightStep], *, in_place: bool
    ) -> Situation:
        """``in_place``: they are where they have to be, so there is no way back."""
        rule, _ = self._flight_check.margins(actors, self._request, self._by)
        kept_space = FlightSpace() if self.kept is None else self.kept.space
        return Situation(
            plan_of(rest[0]),
            space_with(kept_space, measured, {actor.name for actor in actors}),
            rest[0].starts() if in_place else measured.places,
            frozenset(),
            rule,
            limits_of(actors, self._request.speed_factor),
            self._request.speed_factor,
            self._by,
        )

    async def _certify_landing(self, flight: PlanFlight) -> None:
        """Find the rounds of a landing from where they are measured."""
        execution, now = flight.execution, self._loop.time()
        sights = flight.look(now)
        others = [
            name
            for name, sight in sights.items()
            if not sight.on_ground
            and (sight.piloted(execution.left.get(name)) or (name in execution.left and _out_of_reach(sight)))
        ]
        # nobody flies, or a person insists: without a certificate
        flying = [name for name in execution.names if not sights[name].on_ground and name not in others]
        if not flying:
            self._orders.carry_out(flight, execution.landing([], others))
            return
        if self._force_landing:
            self._orders.carry_out(flight, execution.landing([flying], others))
            return
        # where everything is: places of what flies and stands, and the ground below
        actors = [flight.actors[name] for name in flying]
        measured = measure(actors, self._fleet.everybody(), flight.frame, now)
        unplaced = [name for name in flying if name not in measured.places]
        if unplaced:
            text = f"the position of {', '.join(unplaced)} is not known; `plan land --force` lands all at once"
            self._orders.carry_out(flight, execution.landing_refused([text]))
            return
        known = [place[2] for place in measured.others.values()] + [
            flight.frame.from_geodetic(*home)[2] for a in actors if (home := home_of(a)) is not None
        ]
        ground_m = min([*known, *(place[2] for place in measured.places.values())]) - BELOW_GROUND_M
        space = FlightSpace(standing=measured.others)
        try:
            # rounds that keep apart, from a process beside the loop
            rounds, certificate = await self.work(way_down, measured.places, ground_m, flight.rule, space)
        except SkygcsError as error:  # no process, or it took too long
            todo = "`plan land --force` lands all at once"
            self._orders.carry_out(flight, execution.landing_refused([str(error), todo]))
            return
        if certificate.certified:
            self._orders.carry_out(flight, execution.landing(rounds, others))
        else:
            reasons = [*certificate.reasons(), "move them apart, or `plan land --force` lands all at once"]
            self._orders.carry_out(flight, execution.landing_refused(reasons))

    async def _relayed(
        self, actors: Sequence[VehicleActor], steps: Sequence[Mapping[str, LoadedTrajectory]]
    ) -> str | None:
        """Bring the trajectories of all steps to the companions that fly them; why that is not possible."""
        for loaded in steps:
            for actor in actors:
                if actor.name in loaded and (why := await actor.offboard.prepare(loaded[actor.name])) is not None:
                    return f"{actor.name}: {why}"
        return None

    def _knows(self, actor: VehicleActor) -> bool:
        return self._fleet.vehicles.get(actor.vehicle.key) is actor

    def _flying(self) -> PlanFlight:
        if self.flight is None:
            raise RefusedError("no plan is flown")
        return self.flight

    # -- time

    def tick(self) -> None:
        """Watch the flight; called five times a second."""
        if self.flight is not None and not self.flight.execution.over:
            self._orders.tick(self.flight)

    def end(self) -> None:
        """No further flight begins."""
        self._ending = True

    async def wind_down(self) -> None:
        """See `PlanKeeper.wind_down`."""
        self.end()
        flight = self.flight
        if flight is None or flight.execution.over:
            return
        before = flight.execution.state
        flight.look(self._loop.time())
        if before in (PlanState.ARMING, PlanState.TAKEOFF):
            self._orders.carry_out(flight, flight.execution.abort("skygcs is shutting down"))
            await self._orders.settled()
            return
        flight.guidance.end(flight)
        then = ": each flies its leg to the end and holds there" if flight.guidance.by is Guidance.GOTO else ""
        self._on_event(Event(KIND, None, None, f"{flight.settings.plan}: ended by the shutdown of skygcs{then}", {}))

    def close(self) -> None:
        self._orders.close()
        self._tasks.close()

    # -- what is shown

    def status(self) -> dict[str, Any]:
        """See `PlanKeeper.status`."""
        now, kept, flight = self._loop.time(), self.kept, self.flight
        answer: dict[str, Any] = {"busy": self._busy}
        if kept is not None:
            answer |= {"plan": kept.number, "name": kept.name, "kind": kept.describe()["kind"], "state": "loaded"}
        if flight is None:
            return answer
        execution, settings = flight.execution, flight.settings
        return answer | {
            "state": execution.state.value,
            "phase": execution.step.name,
            "step": execution.index + 1,
            "steps": len(execution.steps),
            "reason": execution.reason,
            "by": flight.guidance.by.value,
            "mode": None if flight.guidance.by is Guidance.GOTO else settings.control_mode,
            "speed": settings.speed_factor,
            "clock": flight.guidance.status(now),
            "waits_for": list(execution.waits_for),
            "pairs": [pair._asdict() for pair in execution.pairs],
            "vehicles": flight.status(now),
        }

    @property
    def moving(self) -> bool:
        """True if a flight is under way."""
        return self.flight is not None and not self.flight.execution.over


def _out_of_reach(sight: Measurement) -> bool:
    """True for one that no order reaches, as far as it is known: it was forgotten, or is silent."""
    return sight.forgotten or sight.place_m is None or sight.age_s > POSITION_SILENT_S


def _departed(execution: Execution, sights: Mapping[str, Measurement]) -> frozenset[str]:
    """Names of the vehicles that do not follow."""
    return frozenset(name for name in execution.names if sights[name].left is not None or name in execution.left)


def _returning(
    execution: Execution, sights: Mapping[str, Measurement], *, force: bool
) -> tuple[list[str], list[str], list[str]]:
    """Names of the vehicles that fly on, names of those that are out of the plan, and reasons why it cannot go on."""
    staying, out, reasons = [], [], []
    for name in execution.names:
        sight, left = sights[name], sights[name].left or execution.left.get(name)
        if sight.forgotten and not sight.on_ground:
            out.append(name)
            reasons.append(f"{name} was forgotten: abort, and run it again from where they are, or insist with force")
        elif _out_of_reach(sight):
            out.append(name)
            reasons.append(f"{name} is silent: it may be anywhere; wait for it, or insist with force")
        elif left is None:
            staying.append(name)
        elif sight.on_ground:
            out.append(name)
        elif sight.taken(left):
            out.append(name)
            reasons.append(f"{name} is flown by its pilot: have it land or hold, or insist with force")
        elif sight.speed_mps > SLOW_MPS:
            staying.append(name)
            reasons.append(f"{name} still moves: order it to hold, or insist with force")
        else:
            staying.append(name)
    return staying, out, [] if force else reasons
