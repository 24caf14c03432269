"""One flight of a plan: shows `flight.execution` the vehicles, and gives them the orders that it returns.

What is decided is decided there. Vehicles are seen in the frame of the plan, that of the flight's lock.
"""

from __future__ import annotations

import asyncio
import math
from collections.abc import Awaitable, Callable, Coroutine, Mapping, Sequence
from typing import Any, NamedTuple, Protocol

from skygcs.core.geo import EnuFrame, world_from_enu
from skygcs.core.monitor.tracks import is_flying
from skygcs.core.plan.margins import MarginRule
from skygcs.core.protocols.command import Outcome
from skygcs.core.trajectory import ClockState
from skygcs.core.trajectory.piecewise import Vector
from skygcs.core.vehicle.autopilot import TAKEOFF_MODES
from skygcs.core.vehicle.flight_lock import FlightLock
from skygcs.core.vehicle.stick_modes import failsafe_without_sticks
from skygcs.core.vehicle.takeoff_watch import TakeoffWatch
from skygcs.core.vehicle.trajectory_flight import LoadedTrajectory
from skygcs.core.vehicle.vehicle import Vehicle
from skygcs.errors import SkygcsError
from skygcs.events import Event
from skygcs.ext.plans.flight.execution import Execution
from skygcs.ext.plans.flight.flight_steps import FlightStep
from skygcs.ext.plans.flight.guidance import Guidance
from skygcs.ext.plans.flight.plan_states import Order, OrderKind, PlanState
from skygcs.ext.plans.flight.sights import Departure, DepartureCause, Measurement
from skygcs.runtime.task_set import OWN, TaskSet, carrying_out
from skygcs.runtime.vehicle_actor import VehicleActor

KIND = "plan"
"""Kind of the events."""

ARM_WAIT_S = 20.0
"""A vehicle that is not ready yet is tried again for so long."""

HOLD_MODES = frozenset({"AUTO.LOITER", "BRAKE", "GUIDED"})
"""In which an autopilot holds its place by itself. Not ArduCopter's LOITER and POSHOLD, which follow the sticks."""

PLAN_MODES = HOLD_MODES | {"AUTO.TAKEOFF", "OFFBOARD"}
"""To which arming, take-off, control and hold of a plan lead. In any other one somebody else has the vehicle."""

LANDING_MODES = frozenset({"AUTO.LAND", "LAND"})
"""The same of a vehicle that a plan lands."""

LONGEST_AGE_S = 2.0
"""A position is carried on with its velocity for no longer."""

Loaded = Mapping[str, LoadedTrajectory]
LandingRounds = Callable[["PlanFlight"], Awaitable[None]]


class FlightSettings(NamedTuple):
    """Settings as they were ordered."""

    plan: str
    """The plan's name."""
    control_mode: str
    speed_factor: float
    force: bool


class FlightGuidance(Protocol):
    """The way in which the vehicles of one flight are guided (`flight.guidance`)."""

    by: Guidance

    def clock(self, now: float) -> tuple[ClockState | None, float]:
        """State and trajectory time of the step under way; None: none is."""
        ...

    def status(self, now: float) -> dict[str, Any] | None:
        """The clock of the step, for people and programs; None: there is none."""
        ...

    def left(self, flight: PlanFlight, name: str, actor: VehicleActor) -> Departure | None:
        """Why a vehicle that is engaged does not follow any more."""
        ...

    async def engage(self, flight: PlanFlight, name: str, actor: VehicleActor) -> Outcome:
        """Take a vehicle that is in the air, and send it to where its first step begins."""
        ...

    def fly(self, flight: PlanFlight) -> str | None:
        """Begin the step under way; why that is not possible."""
        ...

    def look(self, flight: PlanFlight, now: float) -> None:
        """Called with each look at the vehicles."""
        ...

    def set_speed(self, speed_factor: float) -> bool:
        """Fly the step under way at this multiple of its speed; False: it has none."""
        ...

    def stop(self, flight: PlanFlight) -> None:
        """Stop all on their ways."""
        ...

    def go_on(self, flight: PlanFlight) -> None:
        """Go on after a stop."""
        ...

    def end(self, flight: PlanFlight) -> None:
        """Stop all for good."""
        ...


FORGOTTEN = "it was forgotten, and no order reaches it any more"


class PlanFlight:
    """From arming to the end. ``on_change`` is called after every change of its state; ``certify_landing`` when it
    waits for that."""

    def __init__(
        self,
        settings: FlightSettings,
        execution: Execution,
        actors: Mapping[str, VehicleActor],
        loaded: Sequence[Loaded],
        lock: FlightLock,
        rule: MarginRule,
        guidance: FlightGuidance,
        known: Callable[[VehicleActor], bool] = lambda actor: True,
    ) -> None:
        """``loaded``: the trajectories of each step, with their bounds; ``lock``: what they were certified with;
        ``rule``: the margins of their certificate, and of that of their landing; ``known``: whether the fleet still has
        a vehicle."""
        self.settings = settings
        self.guidance = guidance
        self.execution = execution
        self.actors = dict(actors)
        self.lock = lock
        self.rule = rule
        self.known = known
        self.frame = EnuFrame(lock.origin)
        self.sights: dict[str, Measurement] = {}
        """Observations of the vehicles at the last tick, by name."""
        self.loaded = list(loaded)
        self.engaged: set[str] = set()
        """Vehicles that follow this flight: under control, or with the first goto accepted."""
        self.landing: set[str] = set()
        """Those that it has ordered to land."""
        self.takeoffs: dict[str, TakeoffWatch] = {}
        self.being_taken: set[str] = set()
        """Vehicles whose take-off or control is ordered and not answered: the mode that they last reported is old."""

    def place_of(self, vehicle: Vehicle, now: float, delay_s: float = 0.0) -> tuple[Vector | None, float, float]:
        """Where a vehicle is by now, the age of that, and its speed."""
        return measured_place(vehicle, self.frame, now, delay_s)

    def clock(self, now: float) -> tuple[ClockState | None, float]:
        """State and trajectory time of the step under way."""
        return self.guidance.clock(now)

    def why_displaced(self, name: str, now: float) -> str | None:
        """See `Execution.why_displaced`, of where a vehicle is now."""
        return self.execution.why_displaced(name, self.place_of(self.actors[name].vehicle, now)[0])

    def look(self, now: float) -> dict[str, Measurement]:
        """All its vehicles, as they are seen now."""
        self.sights = {name: self._sight(name, actor, now) for name, actor in self.actors.items()}
        return self.sights

    def _sight(self, name: str, actor: VehicleActor, now: float) -> Measurement:
        vehicle = actor.vehicle
        delay_s = (actor.offboard.controller.delay.uplink_s or 0.0) if actor.offboard.flying else 0.0
        place, age_s, speed = self.place_of(vehicle, now, delay_s)
        takeoff = None
        if self.execution.state is PlanState.TAKEOFF and name in self.takeoffs:
            takeoff = str(self.takeoffs[name].look(now))
        on_ground = not is_flying(vehicle, now)
        reported, _, _ = measured_place(vehicle, self.frame, now, carried=False)
        return Measurement(
            place,
            age_s,
            speed,
            vehicle.armed,
            on_ground,
            takeoff,
            self.left_of(name, now),
            reported,
            age_s + delay_s,
            holds=vehicle.mode in HOLD_MODES,
            forgotten=not self.known(actor),
            unexpected_mode=self.unexpected_mode(name),
            by_failsafe=failsafe_without_sticks(vehicle, now),
        )

    def unexpected_mode(self, name: str) -> str | None:
        """Mode as `Measurement` has it."""
        actor = self.actors[name]
        ours = name in self.engaged or name in self.being_taken or actor.offboard.flying
        modes = PLAN_MODES | LANDING_MODES if name in self.landing else PLAN_MODES
        if ours or not actor.vehicle.armed or actor.vehicle.mode in modes:
            return None
        return actor.vehicle.mode

    def left_of(self, name: str, now: float) -> Departure | None:
        """Why a vehicle does not follow; None: it does, or is not to yet."""
        if self.execution.over or self.execution.state in (PlanState.ABORTING, PlanState.LANDING):
            return None
        actor = self.actors[name]
        vehicle = actor.vehicle
        if not self.known(actor):
            return Departure(DepartureCause.LOST, FORGOTTEN)
        if not vehicle.connected and not (self.guidance.by is Guidance.MISSION and name in self.engaged):
            return Departure(DepartureCause.LOST, f"it is lost: no heartbeat for {vehicle.silence_s(now) or 0.0:.0f} s")
        if name not in self.engaged:
            return self._taken_before(name, actor, now)
        return self.guidance.left(self, name, actor)

    def _taken_before(self, name: str, actor: VehicleActor, now: float) -> Departure | None:
        """Why a vehicle that flies and waits to be taken under control is not ours to take: its mode has changed."""
        mode = self.unexpected_mode(name)
        if mode is None or actor.vehicle.in_air(now) is False:
            return None
        # it may be flown by its pilot until it is taken; one that took off for this plan has left his mode before
        if name not in self.execution.grounded and mode == self.lock.member(name).mode:
            return None
        return Departure(DepartureCause.PILOT, f"it was switched to {mode} before it was under control")

    def status(self, now: float) -> list[dict[str, Any]]:
        """Each vehicle, for people and programs."""
        execution, found = self.execution, []
        _, trajectory_s = self.clock(now)
        goals = execution.step.places()
        for name in execution.names:
            sight = self.sights.get(name)
            place = None if sight is None else sight.place_m
            off_m = None
            if place is not None and self.clock(now)[0] is not None and not execution.over:
                off_m = execution.off_m(name, place, trajectory_s)
            left = execution.left.get(name)
            found.append(
                {
                    "vehicle": name,
                    "state": "left" if left is not None else self._word(name, sight),
                    "error_m": None if off_m is None else round(off_m, 3),
                    "tube_m": round(execution.tube_m(name), 3),
                    "pos_enu_m": None if place is None else [round(v, 3) for v in place],
                    "goal_enu_m": [round(v, 3) for v in goals[name]],
                    "position_age_s": None if sight is None or place is None else round(sight.age_s, 2),
                    "left": None if left is None else left.text,
                }
            )
        return found

    def _word(self, name: str, sight: Measurement | None) -> str:
        if sight is None:
            return "unknown"
        if sight.on_ground:
            return "armed" if sight.armed else "on the ground"
        if name in self.execution.waits_for:
            return "waited for"
        return "under control" if name in self.engaged and not self.execution.over else "in the air"


class FlightOrders:
    """Gives the orders of a flight, and reports what changes. ``serial``: of the last order of a person to the plan,
    which its own orders carry out: an order of a person since then makes them void, and never the other way round."""

    def __init__(
        self,
        loop: asyncio.AbstractEventLoop,
        on_event: Callable[[Event], None],
        on_change: Callable[[], None],
        certify_landing: LandingRounds,
    ) -> None:
        self._loop = loop
        self._on_event = on_event
        self._on_change = on_change
        self._certify_landing = certify_landing
        self._tasks = TaskSet(loop, on_event)
        self.serial = OWN

    def tick(self, flight: PlanFlight) -> None:
        """Look at the vehicles, and do what follows."""
        now = self._loop.time()
        sights = flight.look(now)
        flight.guidance.look(flight, now)
        state, trajectory_s = flight.clock(now)
        self.carry_out(flight, flight.execution.tick(now, state, trajectory_s, sights))

    def carry_out(self, flight: PlanFlight, orders: Sequence[Order]) -> None:
        """Give these orders; their outcomes come back to the flight by themselves."""
        self._report(flight)
        for order in orders:
            self._give(flight, order)

    def start(self, work: Coroutine[Any, Any, None], name: str) -> None:
        """Begin an order as a task of its own."""
        self._tasks.start(work, name, self.serial)

    def close(self) -> None:
        """Cancel what is under way."""
        self._tasks.close()

    async def settled(self) -> None:
        """Wait until all orders that were given have ended."""
        await self._tasks.settled()

    def _give(self, flight: PlanFlight, order: Order) -> None:
        match order.kind:
            case OrderKind.FLY:
                with carrying_out(self.serial):
                    why = flight.guidance.fly(flight)
                if why is not None:
                    self.carry_out(flight, flight.execution.start_failed(why))
            case OrderKind.CERTIFY_LANDING:
                self.start(self._certified(flight), "certificate of a landing")
            case OrderKind.STOP_CLOCK:
                flight.guidance.stop(flight)
            case OrderKind.GO_ON:
                flight.guidance.go_on(flight)
            case OrderKind.END_CLOCK:
                flight.guidance.end(flight)
            case _:
                for name in order.vehicles:
                    work = self._order(flight, order.kind, name)
                    self.start(work, f"{order.kind.value} {name} for the plan")

    async def _certified(self, flight: PlanFlight) -> None:
        try:
            await self._certify_landing(flight)
        except Exception as error:  # whatever kept it from being made: they must not wait for it for ever
            text = f"no certificate could be made ({error}); `plan land --force` lands all at once"
            self.carry_out(flight, flight.execution.landing_refused([text]))
            if not isinstance(error, SkygcsError):
                raise

    async def _order(self, flight: PlanFlight, kind: OrderKind, name: str) -> None:
        """One order to one vehicle, to its outcome. One that is to be taken is asked once more whose it is: its pilot
        may have taken it since the last look, or in the seconds of a check."""
        taken = kind in (OrderKind.TAKEOFF, OrderKind.ENGAGE)
        if taken and (left := flight.left_of(name, self._loop.time())) is not None:
            outcome = Outcome.refused(left.text)
        else:
            if taken:
                flight.being_taken.add(name)
            outcome = await self._ordered(flight, kind, name)
            flight.being_taken.discard(name)
        mode = flight.unexpected_mode(name)
        message = outcome.message if flight.known(flight.actors[name]) else FORGOTTEN  # which ended what it was doing
        self.carry_out(flight, flight.execution.outcome(kind, name, outcome.ok, message, mode))

    async def _ordered(self, flight: PlanFlight, kind: OrderKind, name: str) -> Outcome:
        actor = flight.actors[name]
        match kind:
            case OrderKind.MODE:
                return await self._to_takeoff_mode(actor)
            case OrderKind.ARM:
                return await actor.arm(wait_s=ARM_WAIT_S)
            case OrderKind.DISARM:
                return await actor.disarm()
            case OrderKind.TAKEOFF:
                return await self._take_off(flight, name, actor)
            case OrderKind.ENGAGE:
                outcome = await flight.guidance.engage(flight, name, actor)
                if outcome.ok:
                    flight.engaged.add(name)
                return outcome
        flight.engaged.discard(name)
        if kind is OrderKind.LAND:
            flight.landing.add(name)
        return await (actor.hold() if kind is OrderKind.HOLD else actor.land())

    async def _to_takeoff_mode(self, actor: VehicleActor) -> Outcome:
        """In which it arms: after a landing an ArduCopter is in LAND and a PX4 in AUTO.LAND, in which they do not."""
        vehicle = actor.vehicle
        mode = TAKEOFF_MODES.get(vehicle.family)
        if mode is None or vehicle.armed or vehicle.mode == mode:
            return Outcome(True, "accepted", f"it is in {vehicle.mode}")
        return await actor.set_mode(mode)

    async def _take_off(self, flight: PlanFlight, name: str, actor: VehicleActor) -> Outcome:
        """To where the first step has it."""
        now = self._loop.time()
        place, _, _ = flight.place_of(actor.vehicle, now)
        position = actor.vehicle.telemetry("position")
        if place is None or position is None:
            return Outcome.refused("its position is not known any more")
        height_m = takeoff_height_m(flight.execution.step, name) - place[2]
        outcome = await actor.takeoff(height_m, force=flight.settings.force, engage=False)
        if outcome.ok:  # it has left the ground: from here on it is watched
            flight.takeoffs[name] = TakeoffWatch(actor.vehicle, position["alt_amsl_m"], height_m, self._loop.time())
        return outcome

    def _report(self, flight: PlanFlight) -> None:
        changes, flight.execution.changes = flight.execution.changes, []
        for change in changes:
            actor = flight.actors.get(change.vehicle or "")
            data = {
                "plan": flight.settings.plan,
                "state": change.state.value,
                "phase": flight.execution.step.name,
                "pairs": [pair._asdict() for pair in change.pairs],
            }
            text = f"{flight.settings.plan}: {change.text}"
            self._on_event(Event(KIND, change.vehicle, None if actor is None else actor.sysid, text, data))
        if changes:
            self._on_change()


def takeoff_height_m(step: FlightStep, name: str) -> float:
    """The height, in the frame of the plan, to which the take-off for this first step leads."""
    return step.starts()[name][2]


def measured_place(
    vehicle: Vehicle, frame: EnuFrame, now: float, delay_s: float = 0.0, *, carried: bool = True
) -> tuple[Vector | None, float, float]:
    """Where a vehicle is by now in this frame, the age of that, and its speed. Not ``carried``: where it was
    at its last report."""
    position, at = vehicle.telemetry("position"), vehicle.telemetry_at("position")
    if position is None or at is None or position["lat_deg"] is None or vehicle.replayed:
        return None, math.inf, 0.0
    lat_deg, lon_deg, alt_m = position["lat_deg"], position["lon_deg"], position["alt_amsl_m"]
    if not (abs(lat_deg) <= 90.0 and abs(lon_deg) <= 180.0 and math.isfinite(alt_m)):
        return None, math.inf, 0.0
    east, north, up = position["vel_enu_mps"]
    age_s = max(0.0, now - at)
    ahead_s = min(age_s + delay_s, LONGEST_AGE_S) if carried else 0.0
    vx, vy, vz = world_from_enu((east, north, up), frame.origin)
    x, y, z = frame.from_geodetic(lat_deg, lon_deg, alt_m)
    return (x + vx * ahead_s, y + vy * ahead_s, z + vz * ahead_s), age_s, math.hypot(east, north, up)
