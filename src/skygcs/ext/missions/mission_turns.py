"""Starts the missions of several vehicles one after another: the next when the one before is done, or has landed.

Who may start is decided by `core.vehicle.mission_orders.next_turn`. Each start is an order as a person's: preflight,
the monitor's check and every other check refuse it as they refuse that, and the turns end. Whatever is ordered to one
of them, STOP included, ends the turns too, and so does any mode that is not its mission's, by whatever station or
pilot: nothing starts by itself after a person has taken over.
"""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable, Collection, Sequence
from typing import Any, Literal

from skygcs.core.mission.item import MissionItem
from skygcs.core.monitor.tracks import is_flying
from skygcs.core.protocols.command import Outcome
from skygcs.core.vehicle.flight_evidence import LandingWatch
from skygcs.core.vehicle.mission_orders import (
    HomeWatch,
    Turn,
    ends_on_ground,
    ends_with_return,
    is_at_home,
    last_moving,
    next_turn,
)
from skygcs.core.vehicle.stick_modes import Hands, hands, taken_since
from skygcs.errors import RefusedError
from skygcs.events import Event
from skygcs.runtime.task_set import TaskSet
from skygcs.runtime.vehicle_actor import VehicleActor
from skygcs.runtime.vehicle_services import MAX_VEHICLES, OnEvent

PERIOD_S = 0.5

TurnState = Literal["flies", "waits", "done"]

StartOne = Callable[[VehicleActor], Awaitable[Outcome]]
"""Gives one vehicle the order to start its mission."""


class MissionTurns:
    """The turns under way of one fleet; there is one round at a time."""

    def __init__(self, loop: asyncio.AbstractEventLoop, on_event: OnEvent) -> None:
        self._loop = loop
        self._on_event = on_event
        self._tasks = TaskSet(loop, on_event)
        self._round: list[VehicleActor] = []
        self._at = 0
        """Index of the one whose turn it is."""
        self._numbers: dict[int, int] = {}
        """By key, the number of the last order to each that moves it, or may, when that was last known to be ours."""
        self._were_in: dict[int, Hands] = {}
        """By key, whose hands each was in when the round began."""
        self._running: asyncio.Task[None] | None = None

    @property
    def under_way(self) -> bool:
        return self._running is not None and not self._running.done()

    async def begin(self, actors: Sequence[VehicleActor], start: StartOne) -> dict[str, Outcome]:
        """Start the first one's mission; the others wait for their turn. Returns the outcomes by name: those of all are
        refused if the first does not start. Raises RefusedError while a round is under way."""
        if self.under_way:
            left = ", ".join(actor.name for actor in self._round[self._at :])
            raise RefusedError(f"{left} fly their missions one after another; end that first (missions.end_turns)")
        if not 1 <= len(actors) <= MAX_VEHICLES:
            raise RefusedError(f"one after another: 1 to {MAX_VEHICLES} vehicles, not {len(actors)}")
        self._round, self._at = list(actors), 0
        self._numbers = {actor.vehicle.key: actor.runner.ledger.effective for actor in actors}
        self._were_in = {actor.vehicle.key: hands(actor.vehicle, self._loop.time()) for actor in actors}
        first, *others = self._round
        begun: asyncio.Future[Outcome] = self._loop.create_future()
        self._running = self._tasks.start(self._fly(start, begun), "missions one after another")
        try:
            outcome = await asyncio.shield(begun)
        except asyncio.CancelledError:
            self.end("its client is gone before the first one has started")
            raise
        if not outcome.ok:
            refused = Outcome.refused(f"{first.name}, which is to fly before it, did not start")
            return {first.name: outcome} | dict.fromkeys((other.name for other in others), refused)
        outcomes = {first.name: outcome}
        for before, other in zip(self._round, others, strict=False):
            outcomes[other.name] = Outcome(True, "accepted", f"starts when {before.name} is done or has landed")
        return outcomes

    def end(self, why: str) -> bool:
        """End the turns: who flies goes on, who waits does not start. False: none were under way."""
        if not self.under_way or self._running is None:
            return False
        self._running.cancel()
        self._report_end(why)
        return True

    def taken(self, vehicles: Collection[object], order: str) -> None:
        """An order that ends a flight is given to these: the turns end if one of them flies now or waits."""
        if self.under_way and any(actor in vehicles for actor in self._round[self._at :]):
            self.end(f"{order} was ordered")

    def close(self) -> None:
        """The daemon ends: nobody else starts."""
        self.end("skygcs ends")
        self._tasks.close()

    def of(self, actor: VehicleActor) -> dict[str, Any] | None:
        """The turn of a vehicle, for its mission's status; None: it is in no round."""
        if not self.under_way or actor not in self._round:
            return None
        place = self._round.index(actor)
        state: TurnState = "flies" if place == self._at else "waits" if place > self._at else "done"
        return {"turn": place + 1, "of": len(self._round), "state": state}

    # -- internal

    async def _fly(self, start: StartOne, begun: asyncio.Future[Outcome]) -> None:
        try:
            await self._fly_all(start, begun)
        finally:
            if not begun.done():
                begun.set_result(Outcome(False, "cancelled", "ended before it has started"))

    async def _fly_all(self, start: StartOne, begun: asyncio.Future[Outcome]) -> None:
        for at, actor in enumerate(self._round):
            self._at = at
            try:
                outcome = await start(actor)
            except RefusedError as error:
                outcome = Outcome.refused(str(error))
            if not begun.done():
                begun.set_result(outcome)
            if not outcome.ok:
                self._report_end(f"{actor.name} did not start: {outcome.message}")
                return
            effective, number = actor.runner.ledger.effective, outcome.order_number
            self._numbers[actor.vehicle.key] = effective if number is None else number  # a newer one is not ours
            if actor is self._round[-1]:
                return
            items = await actor.missions.known_items()
            if not await self._is_over(actor, items or ()):
                return

    async def _is_over(self, actor: VehicleActor, items: Sequence[MissionItem]) -> bool:
        """Wait until its turn is over; False: the turns have ended."""
        mode, landing, home = actor.vehicle.mode, LandingWatch(self._loop.time()), HomeWatch()
        phase, since = None, self._loop.time()
        while True:
            await asyncio.sleep(PERIOD_S)
            now = self._loop.time()
            landing.look(actor.vehicle, now)
            if actor.vehicle.armed is not False:
                mode = actor.vehicle.mode
            left = self._round[self._at :]
            taken = [text for a in left[1:] if (text := self._taken(a, now)) is not None]
            flown = self._look(actor, items, mode, landing, home)
            if flown.phase != phase:
                phase, since = flown.phase, now
            decision = next_turn(flown._replace(waited_s=now - since))
            if taken and decision.next != "end":
                self._report_end("; ".join(taken))
                return False
            if decision.next == "start" and any(a.runner.ledger.in_progress for a in left):
                continue  # what is being sent to one of them may be refused
            match decision.next:
                case "start":
                    self._report(actor, f"{decision.why}: {self._round[self._at + 1].name} is next")
                    return True
                case "end":
                    self._report_end(decision.why)
                    return False
                case "wait":
                    continue

    def _taken(self, actor: VehicleActor, now: float) -> str | None:
        """Why a vehicle that waits for its turn loses it: another order, or its pilot; None: it keeps it."""
        key = actor.vehicle.key
        if actor.runner.ledger.effective > self._numbers[key]:
            return f"{actor.name} was ordered something else"
        why = taken_since(actor.vehicle, now, self._were_in[key])
        return None if why is None else f"{actor.name}: {why}"

    def _look(
        self, actor: VehicleActor, items: Sequence[MissionItem], mode: str, landing: LandingWatch, home: HomeWatch
    ) -> Turn:
        vehicle, now = actor.vehicle, self._loop.time()
        flying = is_flying(vehicle, now)
        return Turn(
            actor.name,
            heard=vehicle.connected,
            flying=flying,
            armed=vehicle.armed is not False,
            complete=actor.missions.complete,
            failsafe=vehicle.failsafe,
            ordered=actor.runner.ledger.effective > self._numbers[vehicle.key],
            lands=ends_on_ground(items, vehicle.mission_return_rule.with_mission({item.command for item in items})),
            mode=mode,
            ending=actor.missions.begun(last_moving(items)),
            returns=ends_with_return(items),
            at_home=is_at_home(vehicle, flying=flying),
            home_s=home.stays_s(vehicle, now, flying=flying),
            landed=landing.verdict(vehicle, now),
            furthest=actor.missions.furthest,
        )

    def _report(self, actor: VehicleActor, text: str) -> None:
        self._on_event(Event("mission", actor.name, actor.sysid, f"one after another: {text}", {}))

    def _report_end(self, why: str) -> None:
        waiting = [actor.name for actor in self._round[self._at + 1 :]]
        does = (
            f"{', '.join(waiting)} {'does' if len(waiting) == 1 else 'do'} not start" if waiting else "it was the last"
        )
        text = f"one after another: {why}; {does}"
        actor = self._round[self._at]
        self._on_event(Event("mission", actor.name, actor.sysid, text, {"ended": why, "waiting": waiting}))
