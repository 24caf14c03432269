"""A plan's flight guided by the autopilots themselves: nothing is streamed. By goto each leg is one order; by missions
the whole way of a vehicle is one leg, which it has on board. What is decided is decided in `flight.goto_legs`."""

from __future__ import annotations

import asyncio
import math
from collections.abc import Awaitable, Callable, Coroutine
from typing import TYPE_CHECKING, Any

from skygcs.core.mission.item import MissionType
from skygcs.core.protocols.command import Outcome
from skygcs.core.trajectory import ClockState
from skygcs.core.trajectory.piecewise import Vector
from skygcs.core.vehicle.mission_orders import MISSION_MODES, mission_along
from skygcs.ext.plans.flight.execution import LEG_S
from skygcs.ext.plans.flight.goto_legs import AGAIN_S, GotoLegs
from skygcs.ext.plans.flight.guidance import Guidance
from skygcs.ext.plans.flight.plan_states import PlanState
from skygcs.ext.plans.flight.sights import Departure, DepartureCause
from skygcs.runtime import onboard_orders
from skygcs.runtime.order_runner import UNHEARD
from skygcs.runtime.separation_monitor import SeparationMonitor
from skygcs.runtime.vehicle_actor import VehicleActor

if TYPE_CHECKING:
    from skygcs.ext.plans.plan_flight import PlanFlight

FLIES_IN = frozenset({"AUTO.LOITER", "GUIDED"})
"""The mode to which a goto leads, of a PX4 and of an ArduCopter."""

STANDS_IN = FLIES_IN | {"BRAKE"}
"""While it is stopped: an ArduCopter brakes first."""

LEAST_LEG_M = 0.1
"""A shorter leg is less than a vehicle wanders in hover: it needs no order."""

FRESH_S = 3.0
"""A place that is older says nothing about where a leg has led."""

Start = Callable[[Coroutine[Any, Any, None], str], object]


class GotoGuidance:
    """See `plan_flight.FlightGuidance`. Of one flight; ``start`` makes a task of an order, under a name."""

    by = Guidance.GOTO

    def __init__(self, monitor: SeparationMonitor | None, loop: asyncio.AbstractEventLoop, start: Start) -> None:
        self._monitor = monitor
        self._loop = loop
        self._start = start
        self._legs: GotoLegs | None = None
        self._numbers: dict[str, int] = {}
        """By vehicle, `order_number` after our last order to it."""
        self._under_way: dict[str, int] = {}
        """Orders of ours to a vehicle that have not ended: meanwhile its number changes by them."""
        self._refused: dict[str, str] = {}

    def clock(self, now: float) -> tuple[ClockState | None, float]:
        return (None if self._legs is None else self._legs.state), 0.0

    def status(self, now: float) -> dict[str, Any] | None:
        return None

    def left(self, flight: PlanFlight, name: str, actor: VehicleActor) -> Departure | None:
        vehicle, state = actor.vehicle, None if self._legs is None else self._legs.state
        if name in self._under_way:
            return None
        # one that it refuses, too: a part of it may have been done, and who gave it wants something else than the plan
        if actor.order_number != self._numbers.get(name, actor.order_number):
            return Departure(DepartureCause.ORDER, "it was ordered otherwise")
        if name in self._refused:
            return Departure(DepartureCause.GUARD, f"it does not fly its leg: {self._refused[name]}")
        if not vehicle.armed:
            return Departure(DepartureCause.PILOT, "it is disarmed")
        still = state in (ClockState.PAUSING, ClockState.PAUSED)
        if vehicle.mode not in (STANDS_IN if still else self._modes(flight, name)):
            return Departure(DepartureCause.PILOT, f"it was switched to {vehicle.mode}")
        return None

    async def engage(self, flight: PlanFlight, name: str, actor: VehicleActor) -> Outcome:
        """To where its first step begins: the end of its take-off, or where it holds."""

        async def sent() -> Outcome:
            if (why := flight.why_displaced(name, self._loop.time())) is not None:
                return Outcome.refused(f"{why}: it is not sent to its start")
            return await self._goto(flight, name, flight.execution.step.starts()[name])

        return await self._until_heard(flight, name, sent)

    async def _until_heard(self, flight: PlanFlight, name: str, order: Callable[[], Awaitable[Outcome]]) -> Outcome:
        """The outcome of an order of the engagement; one that was not heard is given again, as that of a leg is, unless
        somebody has switched the vehicle meanwhile."""
        vehicle, until = flight.actors[name].vehicle, self._loop.time() + LEG_S
        expected = {vehicle.mode} | self._modes(flight, name)
        while True:
            outcome = await order()
            if outcome.ok or not _unheard(outcome):
                return outcome
            await asyncio.sleep(AGAIN_S)
            if vehicle.mode not in expected:
                return Outcome.refused(f"it was switched to {vehicle.mode} before it was sent anywhere")
            if flight.execution.state is not PlanState.ENGAGING or self._loop.time() >= until:
                return outcome

    def fly(self, flight: PlanFlight) -> str | None:
        """Order the first legs."""
        tubes = flight.execution.tubes
        self._refused.clear()
        self._legs = GotoLegs(self._goals(flight), tubes.free_m, tubes.downwash_ratio)
        self._order_due(flight, self._legs)
        return None

    def _goals(self, flight: PlanFlight) -> dict[str, Vector]:
        """The vehicles that move in the step under way, and where they go."""
        starts, goals = flight.execution.step.starts(), flight.execution.step.places()
        return {name: goal for name, goal in goals.items() if math.dist(goal, starts[name]) > LEAST_LEG_M}

    def _modes(self, flight: PlanFlight, name: str) -> frozenset[str]:
        """Modes in which it flies its leg."""
        return FLIES_IN

    def look(self, flight: PlanFlight, now: float) -> None:
        """Order again what was not heard or has not worked."""
        if (legs := self._legs) is None:
            return
        fresh = {name: s.place_m if s.age_s <= FRESH_S else None for name, s in flight.sights.items()}
        legs.look(now, {name: (fresh[name], flight.sights[name].speed_mps) for name in legs.moving})
        self._order_due(flight, legs)

    def set_speed(self, speed_factor: float) -> bool:
        """Autopilots have their own."""
        return False

    def stop(self, flight: PlanFlight) -> None:
        """Hold each that still flies with us, on its leg."""
        if (legs := self._legs) is not None:
            for name in legs.stop(n for n in legs.moving if n not in flight.execution.left):
                self._start(self._hold(flight, legs, name), f"hold {name} on its leg")

    def go_on(self, flight: PlanFlight) -> None:
        if (legs := self._legs) is not None:
            legs.go_on(flight.execution.left)
            self._order_due(flight, legs)

    def end(self, flight: PlanFlight) -> None:
        if self._legs is not None:
            self._legs.end()

    # -- orders

    def _order_due(self, flight: PlanFlight, legs: GotoLegs) -> None:
        for name in legs.due():
            self._start(self._leg(flight, legs, name), f"leg of {name} for the plan")

    async def _leg(self, flight: PlanFlight, legs: GotoLegs, name: str) -> None:
        actor = flight.actors[name]
        stopped = legs is not self._legs or legs.state not in (ClockState.RUNNING, ClockState.FINISHED)
        if stopped or flight.left_of(name, self._loop.time()) is not None:  # its pilot's: the next look says so
            return
        outcome = await self._order(flight, name, legs.goal_m(name))
        unheard = _unheard(outcome)
        if not outcome.ok and not unheard and outcome.result != "cancelled":
            self._refused[name] = outcome.message
        legs.ended(name, ok=outcome.ok, unheard=unheard, now=self._loop.time())
        if not outcome.ok and actor.order_number != self._numbers.get(name):
            self._refused.pop(name, None)  # a newer order took its place: that is why

    async def _order(self, flight: PlanFlight, name: str, place_m: Vector) -> Outcome:
        """Order its leg, to its outcome."""
        return await self._goto(flight, name, place_m)

    async def _goto(self, flight: PlanFlight, name: str, place_m: Vector) -> Outcome:
        """One order to fly to a place, to its outcome; the monitor knows of it."""
        actor = flight.actors[name]
        place = flight.frame.to_geodetic(*place_m)
        sent = None if self._monitor is None else self._monitor.ways.sent_to(actor, place)
        ok = False
        try:
            outcome = await self._ours(name, actor, actor.goto(enu_m=place_m))
            ok = outcome.ok
        finally:
            if self._monitor is not None and sent is not None:
                self._monitor.ways.arriving(actor, sent, ok=ok)
        return outcome

    async def _hold(self, flight: PlanFlight, legs: GotoLegs, name: str) -> None:
        try:
            await self._ours(name, flight.actors[name], flight.actors[name].hold())
        finally:
            legs.held(name)

    async def _ours(self, name: str, actor: VehicleActor, order: Coroutine[Any, Any, Outcome]) -> Outcome:
        """An order of this flight: afterwards the vehicle's number is ours, unless a newer one took its place."""
        self._under_way[name] = self._under_way.get(name, 0) + 1
        expected = actor.order_number + 1
        try:
            return await order
        finally:
            self._under_way[name] -= 1
            if not self._under_way[name]:
                del self._under_way[name]
            self._numbers[name] = max(self._numbers.get(name, 0), min(actor.order_number, expected))


def _unheard(outcome: Outcome) -> bool:
    """True of an order that may have been received or not, or that is not taken just now."""
    return outcome.result in UNHEARD or outcome.result == "temporarily_rejected"


class MissionGuidance(GotoGuidance):
    """See `plan_flight.FlightGuidance`. Of one flight. An order begins a mission, or goes on with it."""

    by = Guidance.MISSION

    def __init__(self, monitor: SeparationMonitor | None, loop: asyncio.AbstractEventLoop, start: Start) -> None:
        super().__init__(monitor, loop, start)
        self._begun: set[str] = set()
        """Vehicles that fly their mission, or have."""

    async def engage(self, flight: PlanFlight, name: str, actor: VehicleActor) -> Outcome:
        """To where its way begins; there it gets its mission."""
        outcome = await super().engage(flight, name, actor)
        if not outcome.ok:
            return outcome
        step = flight.execution.step
        places = step.corners.get(name) or (step.starts()[name],)
        mission = mission_along([flight.frame.to_geodetic(*place) for place in places])

        async def sent() -> Outcome:
            return await self._ours(
                name, actor, onboard_orders.upload_plan(actor, plan=mission, kinds=(MissionType.MISSION,))
            )

        return await self._until_heard(flight, name, sent)

    def _goals(self, flight: PlanFlight) -> dict[str, Vector]:
        """Also of those that stay where they are: on a mission their firmware takes no notice of a lost ground."""
        return flight.execution.step.places()

    def _modes(self, flight: PlanFlight, name: str) -> frozenset[str]:
        """Until it has accepted, it holds as it was left; at the end of its mission a PX4 changes to AUTO.LOITER."""
        legs, sight = self._legs, flight.sights.get(name)
        if legs is None or not legs.flies(name) or sight is None or sight.place_m is None or sight.age_s > FRESH_S:
            return MISSION_MODES | STANDS_IN
        return MISSION_MODES | STANDS_IN if legs.there(name, sight.place_m) else MISSION_MODES

    async def _order(self, flight: PlanFlight, name: str, place_m: Vector) -> Outcome:
        """From the first item on. What has begun goes on where it is, and what has ended is left alone: both firmwares
        would fly an ended mission again, from its begin."""
        actor = flight.actors[name]
        if name in self._begun:
            if actor.missions.complete or actor.vehicle.mode in MISSION_MODES:
                return Outcome(True, "accepted", "it flies its mission, or has")
            return await self._ours(name, actor, onboard_orders.resume_mission(actor))
        order = onboard_orders.start_mission(actor, arm=False, force=flight.settings.force)
        outcome = await self._ours(name, actor, order)
        if outcome.ok or actor.vehicle.mode in MISSION_MODES:
            self._begun.add(name)
        return outcome
