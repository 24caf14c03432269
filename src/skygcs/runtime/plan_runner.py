"""Carries out the plan of an order, step by step, and knows which order is the newest that moves the vehicle."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable
from dataclasses import replace

from skygcs.core.mavlink.dialect import Dialect
from skygcs.core.protocols.command import CommandSpec, Outcome
from skygcs.core.vehicle.autopilot import firmware_name
from skygcs.core.vehicle.order_plan import Plan, Step
from skygcs.core.vehicle.vehicle import Vehicle
from skygcs.runtime.command_client import SUPERSEDED, CommandClient

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


class _Run:
    """A plan under way: the steps to come, the one that is carried out, whether somebody ended it."""

    __slots__ = ("end_asked", "order", "plan", "queue", "step")

    def __init__(self, plan: Plan, order: int) -> None:
        self.plan = plan
        self.order = order
        self.queue = list(plan.steps)
        self.step: Step | None = None
        self.end_asked = False

    def ended(self) -> bool:
        return self.end_asked


class PlanRunner:
    """One per vehicle. ``order`` counts the orders that moved it; ``on_report(order, percent)`` is told of progress."""

    def __init__(
        self,
        vehicle: Vehicle,
        commands: CommandClient,
        dialect: Dialect,
        loop: asyncio.AbstractEventLoop,
        on_report: Callable[[str, int | None], None],
    ) -> None:
        self.order = 0
        self._vehicle = vehicle
        self._commands = commands
        self._dialect = dialect
        self._loop = loop
        self._report = on_report
        self._newest: Plan | None = None
        self._ending = False
        self._running: dict[asyncio.Task[Outcome], _Run] = {}
        """Plans that know how to be undone: tasks of their own, which go on with that when their callers are gone."""

    async def execute(self, plan: Plan) -> Outcome:
        """Carry out a plan; what was done is undone if a later step fails and knows how.

        One whose caller is cancelled, or that is under way when `wind_down` is called, while a step for the sake of
        later ones is (arming for a take-off), undoes that step. Once the last step has begun nothing is undone: the
        vehicle may be flying by it.
        """
        if plan.order in MOVING:
            self.order += 1
            self._newest = plan
            self._commands.supersede(_commands(plan))
        run = _Run(plan, self.order)
        if all(step.undo is None for step in plan.steps[:-1]):
            return await self._steps(run)
        if self._ending:
            return Outcome.refused("skygcs is shutting down")
        task = self._loop.create_task(self._steps(run), name=f"{self._vehicle.name} {plan.order}")
        self._running[task] = run
        task.add_done_callback(self._running.pop)
        try:
            return await asyncio.shield(task)
        except asyncio.CancelledError:
            if not self._end(run):
                task.cancel()
            raise

    def wind_down(self) -> None:
        """The daemon ends: steps that are there for the sake of later ones are ended and undone."""
        self._ending = True
        for run in list(self._running.values()):
            self._end(run)

    async def settled(self) -> None:
        """After `wind_down`: until what was ended is undone."""
        if undoing := {task for task, run in self._running.items() if run.ended()}:
            await asyncio.wait(undoing)

    def _end(self, run: _Run) -> bool:
        """End it before its last step; False if that has begun."""
        if not run.queue:
            return False
        run.end_asked = True
        if run.step is not None and run.step.command is not None:
            self._commands.stop(run.step.command.command, "cancelled", "cancelled")
        self._commands.wake()
        return True

    async def _steps(self, run: _Run) -> Outcome:
        plan, order, queue = run.plan, run.order, run.queue
        started = self._loop.time()
        attempts, texts = 0, []
        done: list[Step] = []
        while queue:
            if run.ended():
                return await self._ended(run, done, attempts, started)
            step = run.step = queue.pop(0)
            if step.skip_if_met and step.expect is not None and step.expect.met(self._vehicle, self._loop.time()):
                continue
            outcome = await self._given(step, plan, run)
            if run.ended() and order == self.order:
                done += [step] if outcome.attempts else []  # what was sent may have been taken
                return await self._ended(run, done, max(attempts, outcome.attempts), started)
            attempts = max(attempts, outcome.attempts)  # steps are no repeats of each other
            texts += [t for t in outcome.status_texts if t not in texts]
            if outcome.result == "unsupported" and step.instead:
                queue[:0] = step.instead
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

    async def _ended(self, run: _Run, done: list[Step], attempts: int, started: float) -> Outcome:
        """It was cancelled before its last step."""
        told = await self._undo(done, run.plan) if run.order == self.order else ""
        rest = run.queue[-1].name if run.queue else "the last step"
        return Outcome(False, "cancelled", f"cancelled before {rest}{told}", attempts, self._loop.time() - started)

    async def _given(self, step: Step, plan: Plan, run: _Run) -> Outcome:
        """One step, again and again if the plan persists: what is answered by silence may have been heard by nobody."""
        started, attempts = self._loop.time(), 0
        while True:
            outcome = await self._step(step, plan, run)
            attempts += outcome.attempts
            elapsed_s = self._loop.time() - started
            newer = run.order != self.order and not plan.final
            if outcome.ok or newer or elapsed_s >= plan.persist_s or outcome.result not in UNHEARD:
                return replace(outcome, attempts=attempts, elapsed_s=elapsed_s)
            self._report(plan.order, None)

    async def _step(self, step: Step, plan: Plan, run: _Run) -> Outcome:
        order = run.order
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

        outcome = await self._commands.run(
            spec,
            emergency=plan.emergency,
            satisfied=met,
            on_report=lambda percent: self._report(plan.order, percent),
            everywhere=plan.order in EVERYWHERE,
            wanted=wanted if plan.order in MOVING and not plan.final else None,
            with_repeats=step.with_repeats,
        )
        if not outcome.ok or met is None or expect is None or step.expect_s == 0:
            return outcome
        if await self._commands.until(lambda: met() or self.order != order or run.ended(), step.expect_s):
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
            if not self._commands.transmit(name, values):
                return Outcome(False, "lost", "could not be sent: no link leads to it", attempts)
            attempts += 1
            if step.expect is None or step.expect_s == 0:
                return Outcome(True, "accepted", "sent", attempts)
            left_s = started + step.expect_s - self._loop.time()
            await self._commands.until(lambda: self.order != order or answered(), min(RESEND_S, left_s))
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
            outcome = await self._step(step.undo, plan, _Run(plan, self.order))
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
