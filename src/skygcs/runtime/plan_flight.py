"""One flight of a plan: shows `core.plan.execution` the vehicles, and gives them the orders that it returns.

What is decided is decided there. Vehicles are seen in the frame of the plan, the fleet's as of the start: a change of
the fleet's origin moves no flight.
"""

from __future__ import annotations

import asyncio
import contextlib
import math
from collections.abc import Awaitable, Callable, Mapping, Sequence
from typing import Any, NamedTuple

from skygcs.core.geo import EnuFrame, Origin, world_from_enu
from skygcs.core.monitor.tracks import is_flying
from skygcs.core.plan.execution import (
    START_LEAD_S,
    Execution,
    Left,
    Order,
    OrderKind,
    PlanState,
    Sight,
    Why,
)
from skygcs.core.plan.flight_steps import FlightStep
from skygcs.core.protocols.command import Outcome
from skygcs.core.trajectory import ClockState
from skygcs.core.trajectory.piecewise import Vector
from skygcs.core.vehicle.geodetic_position import GeodeticPosition
from skygcs.core.vehicle.offboard_controller import OffboardState
from skygcs.core.vehicle.takeoff_watch import TakeoffWatch
from skygcs.core.vehicle.trajectory_flight import LoadedTrajectory
from skygcs.core.vehicle.vehicle import Vehicle
from skygcs.errors import RefusedError, SkygcsError
from skygcs.events import Event
from skygcs.runtime.task_set import TaskSet
from skygcs.runtime.trajectories import Trajectories, TrajectoryGroup
from skygcs.runtime.vehicle_actor import VehicleActor

KIND = "plan"
"""Of events."""

ARM_WAIT_S = 20.0
"""A vehicle that is not ready yet is tried again for so long."""

COPTER_TAKEOFF_MODE = "GUIDED"

HOLD_MODES = frozenset({"AUTO.LOITER", "BRAKE", "GUIDED"})
"""In which an autopilot holds its place by itself. Not ArduCopter's LOITER and POSHOLD, which follow the sticks."""

PLAN_MODES = HOLD_MODES | {"AUTO.TAKEOFF", "OFFBOARD"}
"""To which arming, take-off, control and hold of a plan lead. In any other one somebody else has the vehicle."""

LONGEST_AGE_S = 2.0
"""A position is carried on with its velocity for no longer."""

Loaded = Mapping[str, LoadedTrajectory]
LandingRounds = Callable[["PlanFlight"], Awaitable[None]]


class FlightSettings(NamedTuple):
    """As it was ordered."""

    plan: str
    """The plan's name."""
    control_mode: str
    speed_factor: float
    force: bool


class PlanFlight:
    """From arming to the end. ``on_change`` is called after every change of its state; ``certify_landing`` when it
    waits for that."""

    def __init__(
        self,
        settings: FlightSettings,
        execution: Execution,
        actors: Mapping[str, VehicleActor],
        loaded: Sequence[Loaded],
        origin: Origin,
        known: Callable[[VehicleActor], bool] = lambda actor: True,
    ) -> None:
        """``loaded``: the trajectories of each step, with their bounds; ``known``: whether the fleet still has a
        vehicle."""
        self.settings = settings
        self.execution = execution
        self.actors = dict(actors)
        self.origin = origin
        self.known = known
        self.frame = EnuFrame(origin)
        self.group: TrajectoryGroup | None = None
        """Of the step under way."""
        self.sights: dict[str, Sight] = {}
        """As of the last tick."""
        self.loaded = list(loaded)
        self.engaged: set[str] = set()
        """Vehicles that are under control for this flight."""
        self.takeoffs: dict[str, TakeoffWatch] = {}
        self.being_taken: set[str] = set()
        """Vehicles whose take-off or control is ordered and not answered: the mode that they last reported is old."""

    def place_of(self, vehicle: Vehicle, now: float, delay_s: float = 0.0) -> tuple[Vector | None, float, float]:
        """Where a vehicle is by now, the age of that, and its speed."""
        return measured_place(vehicle, self.frame, now, delay_s)

    def clock(self, now: float) -> tuple[ClockState | None, float]:
        """State and trajectory time of the step under way."""
        if self.group is None:
            return None, 0.0
        time = self.group.clock.at(now)
        return time.state, time.trajectory_s

    def look(self, now: float) -> dict[str, Sight]:
        """All its vehicles, as they are seen now."""
        self.sights = {name: self._sight(name, actor, now) for name, actor in self.actors.items()}
        return self.sights

    def _sight(self, name: str, actor: VehicleActor, now: float) -> Sight:
        vehicle = actor.vehicle
        delay_s = (actor.offboard.controller.delay.uplink_s or 0.0) if actor.offboard.flying else 0.0
        place, age_s, speed = self.place_of(vehicle, now, delay_s)
        takeoff = None
        if self.execution.state is PlanState.TAKEOFF and name in self.takeoffs:
            takeoff = self.takeoffs[name].look(now)
        on_ground = not is_flying(vehicle, now)
        reported, _, _ = measured_place(vehicle, self.frame, now, carried=False)
        return Sight(
            place,
            age_s,
            speed,
            vehicle.armed,
            on_ground,
            takeoff,
            self._left(name, actor, now),
            reported,
            age_s + delay_s,
            holds=vehicle.mode in HOLD_MODES,
            forgotten=not self.known(actor),
            unexpected_mode=self.unexpected_mode(name),
        )

    def unexpected_mode(self, name: str) -> str | None:
        """As `Sight` has it."""
        actor = self.actors[name]
        ours = name in self.engaged or name in self.being_taken or actor.offboard.flying
        if ours or not actor.vehicle.armed or actor.vehicle.mode in PLAN_MODES:
            return None
        return actor.vehicle.mode

    def _left(self, name: str, actor: VehicleActor, now: float) -> Left | None:
        """Why it does not follow; None: it does, or is not to yet."""
        if self.execution.over or self.execution.state in (PlanState.ABORTING, PlanState.LANDING):
            return None
        vehicle, controller = actor.vehicle, actor.offboard.controller
        if not self.known(actor):
            return Left(Why.LOST, "it was forgotten, and no order reaches it any more")
        if not vehicle.connected:
            return Left(Why.LOST, f"it is lost: no heartbeat for {vehicle.silence_s(now) or 0.0:.0f} s")
        if name not in self.engaged:
            return None
        why = "; ".join(controller.reasons)
        if controller.state is OffboardState.HELD:
            return Left(Why.GUARD, f"the guard holds it: {why}")
        if controller.state is not OffboardState.FLYING:
            return Left(_why(why), why or f"control is {controller.state.value}")
        if self.group is not None and name in self.group.left:
            return Left(
                Why.GUARD, why or "it does not follow its trajectory any more: its reference led out of the fence"
            )
        return None

    def status(self, now: float) -> list[dict[str, Any]]:
        """Each vehicle, for people and programs."""
        execution, found = self.execution, []
        _, trajectory_s = self.clock(now)
        goals = execution.step.places()
        for name in execution.names:
            sight = self.sights.get(name)
            place = None if sight is None else sight.place_m
            off_m = None
            if place is not None and self.group is not None and not execution.over:
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

    def _word(self, name: str, sight: Sight | None) -> str:
        if sight is None:
            return "unknown"
        if sight.on_ground:
            return "armed" if sight.armed else "on the ground"
        if name in self.execution.waits_for:
            return "waited for"
        return "under control" if name in self.engaged and not self.execution.over else "in the air"


class FlightOrders:
    """Gives the orders of a flight, and reports what changes."""

    def __init__(
        self,
        trajectories: Trajectories,
        loop: asyncio.AbstractEventLoop,
        on_event: Callable[[Event], None],
        on_change: Callable[[], None],
        certify_landing: LandingRounds,
    ) -> None:
        self._trajectories = trajectories
        self._loop = loop
        self._on_event = on_event
        self._on_change = on_change
        self._certify_landing = certify_landing
        self._tasks = TaskSet(loop, on_event)

    def tick(self, flight: PlanFlight) -> None:
        """Look at the vehicles, and do what follows."""
        now = self._loop.time()
        sights = flight.look(now)
        state, trajectory_s = flight.clock(now)
        self.carry_out(flight, flight.execution.tick(now, state, trajectory_s, sights))

    def carry_out(self, flight: PlanFlight, orders: Sequence[Order]) -> None:
        """Give these orders; their outcomes come back to the flight by themselves."""
        self._report(flight)
        for order in orders:
            self._give(flight, order)

    def close(self) -> None:
        """Cancel what is under way."""
        self._tasks.close()

    async def settled(self) -> None:
        """Wait until all orders that were given have ended."""
        await self._tasks.settled()

    def _give(self, flight: PlanFlight, order: Order) -> None:
        now, group = self._loop.time(), flight.group
        match order.kind:
            case OrderKind.FLY:
                self._fly(flight)
            case OrderKind.CERTIFY_LANDING:
                self._tasks.start(self._certified(flight), "certificate of a landing")
            case OrderKind.STOP_CLOCK | OrderKind.GO_ON | OrderKind.END_CLOCK if group is not None:
                clock = group.clock
                with contextlib.suppress(RefusedError):  # it stands already
                    match order.kind:
                        case OrderKind.STOP_CLOCK:
                            clock.pause(now)
                        case OrderKind.GO_ON:
                            clock.resume(now)
                        case _:
                            clock.abort(now)
            case _:
                for name in order.vehicles:
                    work = self._order(flight, order.kind, name)
                    self._tasks.start(work, f"{order.kind.value} {name} for the plan")

    async def _certified(self, flight: PlanFlight) -> None:
        try:
            await self._certify_landing(flight)
        except Exception as error:  # whatever kept it from being made: they must not wait for it for ever
            text = f"no certificate could be made ({error}); `plan land --force` lands all at once"
            self.carry_out(flight, flight.execution.landing_refused([text]))
            if not isinstance(error, SkygcsError):
                raise

    def _fly(self, flight: PlanFlight) -> None:
        """Start the step under way on one clock."""
        now, settings = self._loop.time(), flight.settings
        loaded = flight.loaded[flight.execution.index]
        chosen = {flight.actors[name]: one for name, one in loaded.items() if name in flight.actors}
        lead_s = max(START_LEAD_S, self._trajectories.lead_s(chosen))
        begun = self._trajectories.begin(chosen, now + lead_s, settings.speed_factor, plan=settings.plan)
        if isinstance(begun, TrajectoryGroup):
            flight.group = begun
            return
        flight.group = None
        why = "; ".join(f"{actor.name}: {text}" for actor, text in list(begun.items())[:3])
        self.carry_out(flight, flight.execution.start_failed(f"{flight.execution.step.name} does not start: {why}"))

    async def _order(self, flight: PlanFlight, kind: OrderKind, name: str) -> None:
        """One order to one vehicle, to its outcome."""
        actor = flight.actors[name]
        if kind in (OrderKind.TAKEOFF, OrderKind.ENGAGE):
            flight.being_taken.add(name)
        match kind:
            case OrderKind.ARM:
                outcome = await self._arm(actor)
            case OrderKind.DISARM:
                outcome = await actor.disarm()
            case OrderKind.TAKEOFF:
                outcome = await self._take_off(flight, name, actor)
            case OrderKind.ENGAGE:
                outcome = await self._engage(flight, name, actor)
            case OrderKind.HOLD:
                flight.engaged.discard(name)
                outcome = await actor.hold()
            case _:
                flight.engaged.discard(name)
                outcome = await actor.land()
        flight.being_taken.discard(name)
        mode = flight.unexpected_mode(name)
        self.carry_out(flight, flight.execution.outcome(kind, name, outcome.ok, outcome.message, mode))

    async def _arm(self, actor: VehicleActor) -> Outcome:
        """In the mode of the take-off that follows: after a landing an ArduCopter is in LAND, in which it does not
        arm."""
        vehicle = actor.vehicle
        if vehicle.family == "ardupilot" and not vehicle.armed and vehicle.mode != COPTER_TAKEOFF_MODE:
            outcome = await actor.set_mode(COPTER_TAKEOFF_MODE)
            if not outcome.ok:
                return outcome
        return await actor.arm(wait_s=ARM_WAIT_S)

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

    async def _engage(self, flight: PlanFlight, name: str, actor: VehicleActor) -> Outcome:
        """Under control, and to where its first step begins."""
        settings = flight.settings
        if not (actor.offboard.flying and actor.offboard.controller.wanted.value == settings.control_mode):
            outcome = await actor.control(settings.control_mode, force=settings.force)
            if not outcome.ok:
                return outcome
        lat_deg, lon_deg, alt_m = flight.frame.to_geodetic(*flight.execution.step.starts()[name])
        outcome = await actor.offboard.fly_to(GeodeticPosition(lat_deg, lon_deg, alt_m), None)
        if outcome.ok:
            flight.engaged.add(name)
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


def _why(text: str) -> Why:
    """Of the reason for which control ended."""
    return Why.ORDER if "was ordered" in text or "switched off" in text else Why.PILOT
