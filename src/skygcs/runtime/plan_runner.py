"""Carries out the plan of an order, step by step, and knows which order is the newest that moves the vehicle."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable
from dataclasses import replace

from skygcs.core.exchange.command import CommandSpec, Outcome
from skygcs.core.mavlink.dialect import Dialect
from skygcs.core.vehicle.autopilot import firmware_name
from skygcs.core.vehicle.plan import Plan, Step
from skygcs.core.vehicle.vehicle import Vehicle
from skygcs.runtime.commander import SUPERSEDED, Commander

MOVING = frozenset(
    {"mode", "disarm", "takeoff", "land", "rtl", "hold", "goto", "reboot", "stop", "control", "release", "mission"}
)
"""Orders that take the place of what is still going on."""

EVERYWHERE = frozenset({"land", "rtl", "hold", "disarm"})
"""Orders that end a flight: they go out over every link to the vehicle from the first transmission on."""

RESEND_S = 0.5
"""A message whose answer is waited for is sent again after this long: more than a round trip of a busy radio would take
all its capacity for repeats, and the answer is waited for a few seconds only."""

REFUSALS = frozenset({"temporarily_rejected", "denied", "unsupported", "failed"})
"""What a vehicle answers that does not do it."""

UNHEARD = frozenset({"timeout", "lost"})
"""Outcomes of an order that did not reach the vehicle, or that it took and does not show."""

Planner = Callable[[float], Plan]
"""What an order means now (the loop's time). Raises RefusedError, and NotReadyError if it may be possible soon."""

Attempt = Callable[[Planner], Awaitable[Outcome]]
"""Plans and carries out."""

Execute = Callable[[Plan], Awaitable[Outcome]]


class PlanRunner:
    """One per vehicle. ``order`` counts the orders that moved it; ``on_report(order, percent)`` is told of progress."""

    def __init__(
        self,
        vehicle: Vehicle,
        commander: Commander,
        dialect: Dialect,
        loop: asyncio.AbstractEventLoop,
        on_report: Callable[[str, int | None], None],
    ) -> None:
        self.order = 0
        self._vehicle = vehicle
        self._commander = commander
        self._dialect = dialect
        self._loop = loop
        self._report = on_report
        self._newest: Plan | None = None

    async def execute(self, plan: Plan) -> Outcome:
        """Carry out a plan; what was done is undone if a later step fails and knows how."""
        if plan.order in MOVING:
            self.order += 1
            self._newest = plan
            self._commander.supersede(_commands(plan))
        order, started = self.order, self._loop.time()
        attempts, texts = 0, []
        done: list[Step] = []
        queue = list(plan.steps)
        while queue:
            step = queue.pop(0)
            if step.skip_if_met and step.expect is not None and step.expect.met(self._vehicle, self._loop.time()):
                continue
            outcome = await self._given(step, plan, order)
            attempts = max(attempts, outcome.attempts)  # steps are no repeats of each other
            texts += [t for t in outcome.status_texts if t not in texts]
            if outcome.result == "unsupported" and step.instead:
                queue = list(step.instead) + queue
                continue
            if not outcome.ok and step.optional and order == self.order:
                continue
            if not outcome.ok:
                outcome = self._explained(outcome, step)
                message = outcome.message if len(plan.steps) == 1 else f"{step.name}: {outcome.message}"
                if order == self.order:
                    message += await self._undo(done, plan)
                return replace(
                    outcome,
                    message=message,
                    attempts=attempts,
                    elapsed_s=self._loop.time() - started,
                    status_texts=tuple(texts),
                )
            done.append(step)
            if queue and order != self.order:
                return Outcome(
                    False,
                    "cancelled",
                    f"a newer order took its place after {step.name!r}",
                    attempts,
                    self._loop.time() - started,
                    tuple(texts),
                )
        return Outcome(True, "accepted", plan.done, attempts, self._loop.time() - started, tuple(texts))

    async def _given(self, step: Step, plan: Plan, order: int) -> Outcome:
        """One step, again and again if the plan persists: what is answered by silence may have been heard by nobody."""
        started, attempts = self._loop.time(), 0
        while True:
            outcome = await self._step(step, plan, order)
            attempts += outcome.attempts
            elapsed_s = self._loop.time() - started
            newer = order != self.order and not plan.final
            if outcome.ok or newer or elapsed_s >= plan.persist_s or outcome.result not in UNHEARD:
                return replace(outcome, attempts=attempts, elapsed_s=elapsed_s)
            self._report(plan.order, None)

    async def _step(self, step: Step, plan: Plan, order: int) -> Outcome:
        if self._vehicle.duplicate and not (plan.emergency or plan.despite_duplicate):
            return two_of_one_id(self._vehicle)
        expect = step.expect
        if step.message is not None:
            return await self._message_step(step, order)
        met = None if expect is None else lambda: expect.met(self._vehicle, self._loop.time())
        spec = step.command
        assert spec is not None

        def wanted() -> bool:
            return self.order == order or (self._newest is not None and spec in _commands(self._newest))

        outcome = await self._commander.run(
            spec,
            emergency=plan.emergency,
            satisfied=met,
            on_report=lambda percent: self._report(plan.order, percent),
            everywhere=plan.order in EVERYWHERE,
            wanted=wanted if plan.order in MOVING and not plan.final else None,
        )
        if not outcome.ok or met is None or expect is None or step.expect_s == 0:
            return outcome
        if await self._commander.until(lambda: met() or self.order != order, step.expect_s):
            return outcome
        unmet = expect.unmet(self._vehicle, self._loop.time())
        return replace(outcome, ok=False, result="timeout", message=f"timeout: accepted, but {unmet}")

    async def _message_step(self, step: Step, order: int) -> Outcome:
        """Nothing acknowledges a message: it is sent again until what it is sent for has come, or the time is over."""
        assert step.message is not None
        name, values = step.message
        if name not in self._dialect.by_name:
            return Outcome(False, "refused", f"dialect {self._dialect.name} has no {name}")
        started, attempts = self._loop.time(), 0

        def answered() -> bool:
            return step.expect is not None and step.expect.met(self._vehicle, self._loop.time())

        while True:
            if not self._commander.transmit(name, values):
                return Outcome(False, "lost", "could not be sent: no link leads to it", attempts)
            attempts += 1
            if step.expect is None or step.expect_s == 0:
                return Outcome(True, "accepted", "sent", attempts)
            left_s = started + step.expect_s - self._loop.time()
            await self._commander.until(lambda: self.order != order or answered(), min(RESEND_S, left_s))
            elapsed_s = self._loop.time() - started
            if answered():
                return Outcome(True, "accepted", "answered", attempts, elapsed_s)
            if self.order != order:
                return Outcome(False, "cancelled", SUPERSEDED, attempts, elapsed_s)
            if left_s <= RESEND_S:
                unmet = step.expect.unmet(self._vehicle, self._loop.time())
                return Outcome(False, "timeout", f"timeout: {unmet}", attempts, elapsed_s)

    def _explained(self, outcome: Outcome, step: Step) -> Outcome:
        """A refusal without a word of why says at least what was asked."""
        if outcome.result not in REFUSALS or outcome.status_texts:
            return outcome
        why = step.refused or f"{firmware_name(self._vehicle)} gave no reason ({step.name})"
        return replace(outcome, message=f"{outcome.message}: {why}")

    async def _undo(self, done: list[Step], plan: Plan) -> str:
        """Undo the steps that were really carried out, last first; what to add to the message."""
        told = ""
        for step in reversed(done):
            if step.undo is None:
                continue
            outcome = await self._step(step.undo, plan, self.order)
            told += f"; {step.undo.name}" if outcome.ok else f"; could not {step.undo.name}: {outcome.message}"
        return told


def two_of_one_id(vehicle: Vehicle) -> Outcome:
    """The refusal of an order that nobody can say whom it would reach."""
    where = vehicle.duplicate_where
    there = "" if where is None else f" ({where})"
    text = f"two vehicles with system id {vehicle.sysid} are on the air{there}; give one of them another"
    return Outcome(False, "refused", f"refused: {text}")


def _commands(plan: Plan) -> list[CommandSpec]:
    return [step.command for step in plan.steps if step.command is not None]
