"""Carries one vehicle's orders out: from what was asked to the one Outcome that is answered and told.

No order raises for what the vehicle or skygcs refuses. One that is cancelled tells of it, too.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Coroutine
from dataclasses import replace
from typing import Any

from skygcs.core.mavlink.dialect import Dialect
from skygcs.core.protocols.command import Outcome
from skygcs.core.vehicle.arming_refusals import todo_for
from skygcs.core.vehicle.vehicle import Vehicle
from skygcs.errors import NotReadyError, RefusedError
from skygcs.events import Event
from skygcs.runtime.command_client import SUPERSEDED, CommandClient
from skygcs.runtime.plan_runner import MOVING, Planner, PlanRunner, two_of_one_id

RETRY_S = 1.0
"""ArduPilot's estimator converges in some ten seconds after start; asking once a second costs 90 B/s of the link."""

NO_USE = frozenset({"refused", "unsupported", "lost", "cancelled"})
"""Outcomes that another try a second later would only repeat."""


class OrderRunner:
    """One per vehicle. ``release(reason)`` is called before a plan that moves the vehicle is carried out."""

    def __init__(
        self,
        vehicle: Vehicle,
        commands: CommandClient,
        dialect: Dialect,
        loop: asyncio.AbstractEventLoop,
        on_event: Callable[[Event], None],
        release: Callable[[str], None],
    ) -> None:
        self.plans = PlanRunner(vehicle, commands, dialect, loop, self.report)
        self._vehicle = vehicle
        self._loop = loop
        self._on_event = on_event
        self._release = release

    async def run(self, order: str, planner: Planner) -> Outcome:
        """The whole of a simple order."""
        return await self.carry(order, self.attempt(planner))

    async def retry(self, order: str, planner: Planner, wait_s: float) -> Outcome:
        """As `run`, again and again until the vehicle accepts, ``wait_s`` is over, a newer order came, or the vehicle
        names a reason that time does not cure; the outcome then says what does."""
        return await self.carry(order, self._tries(order, planner, wait_s))

    async def carry(self, order: str, work: Coroutine[Any, Any, Outcome]) -> Outcome:
        """The work of an order, and tell how it ended; one that is cancelled has an outcome to tell, too."""
        started = self._loop.time()
        try:
            outcome = await work
        except asyncio.CancelledError:
            text = "cancelled: whoever gave it is gone; what was sent already cannot be unsent"
            self.told(order, Outcome(False, "cancelled", text, elapsed_s=self._loop.time() - started))
            raise
        return self.told(order, outcome)

    async def attempt(self, planner: Planner) -> Outcome:
        """Plan it and carry it out, once, and tell nobody. Whatever moves the vehicle ends its flight by setpoints."""
        try:
            plan = planner(self._loop.time())
        except NotReadyError as error:
            return Outcome(False, "temporarily_rejected", f"not ready: {error}")
        except RefusedError as error:
            return Outcome.refused(str(error))
        if self._vehicle.duplicate and not (plan.emergency or plan.despite_duplicate):
            return two_of_one_id(self._vehicle)
        if plan.order in MOVING:
            self._release(f"{plan.order} was ordered")
        return await self.plans.execute(plan)

    async def attempt_kept(self, planner: Planner) -> Outcome:
        """An attempt of flight control's own: it ends no control."""
        try:
            plan = planner(self._loop.time())
        except RefusedError as error:
            return Outcome.refused(str(error))
        return await self.plans.execute(plan)

    def told(self, order: str, outcome: Outcome) -> Outcome:
        """An order has ended."""
        self._tell(f"{order}: {outcome.message}", {"order": order, **outcome.as_dict()})
        return outcome

    def report(self, order: str, percent: int | None) -> None:
        """An order is under way."""
        how_far = "" if percent is None else f" {percent} %"
        data = {"order": order, "result": "in_progress", "percent": percent}
        self._tell(f"{order}: in progress{how_far}", data)

    async def _tries(self, order: str, planner: Planner, wait_s: float) -> Outcome:
        started = self._loop.time()
        attempts = 0
        while True:
            tried_at, before = self._loop.time(), self.plans.order
            outcome = await self.attempt(planner)
            attempts += outcome.attempts
            outcome = replace(outcome, attempts=attempts, elapsed_s=self._loop.time() - started)
            todo = None if outcome.ok else todo_for(outcome.status_texts, self._vehicle.name)
            if todo is not None:
                return replace(outcome, message=f"{outcome.message}; {todo}")
            superseded = self.plans.order > before + (order in MOVING)
            over = superseded or tried_at + RETRY_S > started + wait_s
            if over or outcome.ok or outcome.result in NO_USE:
                return outcome
            before = self.plans.order
            await asyncio.sleep(max(0.0, tried_at + RETRY_S - self._loop.time()))
            if self.plans.order != before:
                return replace(outcome, result="cancelled", message=SUPERSEDED)

    def _tell(self, text: str, data: dict[str, Any]) -> None:
        self._on_event(Event("command", self._vehicle.name, self._vehicle.sysid, text, data))
