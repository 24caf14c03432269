"""Runs one vehicle's orders: from the request to the one Outcome that is returned, and reported by `OrderOutcomes`.

An order is planned (`core.vehicle.orders`), then its plan is executed step by step. Refusals by the vehicle or by
skygcs are outcomes, not exceptions; so is a cancellation. Of the orders that move the vehicle a newer one replaces an
older one in progress (`OrderPrecedence`).
"""

from __future__ import annotations

import asyncio
import math
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from functools import partial
from typing import Any

from skygcs.core.mavlink.dialect import Dialect
from skygcs.core.protocols.command import CommandSpec, Outcome
from skygcs.core.vehicle.autopilot import arms, firmware_name
from skygcs.core.vehicle.flight_evidence import disarmed_since
from skygcs.core.vehicle.gate import Clearance, clear_plan, clear_undo
from skygcs.core.vehicle.order_ledger import REFUSALS
from skygcs.core.vehicle.order_plan import VERIFY_S, Expectation, GoesThere, ModeIn, Plan, Step, TargetProof
from skygcs.core.vehicle.orders import todo_for
from skygcs.core.vehicle.stick_modes import Hands
from skygcs.core.vehicle.vehicle import Vehicle
from skygcs.core.vehicle.vehicle_model import model_of
from skygcs.errors import NotReadyError, RefusedError
from skygcs.events import Event
from skygcs.runtime.command_client import LATE_ACK_S, SUPERSEDED, CommandClient, Moves
from skygcs.runtime.flight_elsewhere import FlownBySetpoints
from skygcs.runtime.order_precedence import ARMING, ENDING, MOVING, OrderPrecedence, arms_in, commands_of
from skygcs.runtime.task_set import ASKED_NOW, ORDER_SERIAL, OWN, numbered


class OrderOutcomes:
    """The outcomes of the orders to one vehicle: each that begins is reported once when it has ended."""

    def __init__(self, vehicle: Vehicle, loop: asyncio.AbstractEventLoop, on_event: Callable[[Event], None]) -> None:
        self._vehicle = vehicle
        self._loop = loop
        self._on_event = on_event
        self._under_way: Counter[str] = Counter()

    @contextmanager
    def tracked(self, order: str) -> Iterator[Callable[[Outcome], Outcome]]:
        """An order is under way in a block, which passes its outcome to the function that is yielded: that reports and
        returns it. If the block is cancelled, that is the outcome."""
        started = self._loop.time()
        self._under_way[order] += 1
        try:
            yield partial(self.finish, order)
        except asyncio.CancelledError:
            text = "cancelled: the client that gave it is gone; what was sent already cannot be undone"
            self.finish(order, Outcome(False, "cancelled", text, elapsed_s=self._loop.time() - started))
            raise
        finally:
            self._under_way[order] -= 1

    def cut_stops(self, why: str) -> None:
        """Report each stop that is under way as lost, which is an alarm: it will not be repeated any more."""
        for _ in range(self._under_way["stop"]):
            self.finish("stop", Outcome(False, "lost", f"{why}: the stop was not confirmed, order it again"))

    def finish(self, order: str, outcome: Outcome) -> Outcome:
        """Report the outcome of an order that has ended."""
        self._publish(f"{order}: {outcome.message}", {"order": order, **outcome.as_dict()})
        return outcome

    def report_progress(self, order: str, percent: int | None) -> None:
        """Report that an order is in progress."""
        progress = "" if percent is None else f" {percent} %"
        data = {"order": order, "result": "in_progress", "percent": percent}
        self._publish(f"{order}: in progress{progress}", data)

    def _publish(self, text: str, data: dict[str, Any]) -> None:
        self._on_event(Event("command", self._vehicle.name, self._vehicle.sysid, text, data))


RETRY_S = 1.0
"""ArduPilot's estimator converges some ten seconds after the start; one attempt a second costs 90 B/s of the link."""

RESEND_S = 0.5
"""Time before a message whose answer is awaited is sent again. Faster repeats would fill a busy radio, whose round trip
is about as long; slower ones would be too few, because the answer is awaited for a few seconds only."""

PROOF_S = 1.5
"""Time for a target that was requested, and acknowledged, to come: two rounds of a nine-node multipoint radio at 64
kbit/s. A vehicle that flies off at 2 m/s² has come 1 m nearer after 1 s."""

PROOF_REPEATS = 2
"""How often an accepted goto that the vehicle does not carry out is sent again. Each repeat costs 90 bytes, and it is
the same place: a vehicle that flies there goes on."""

FINAL = frozenset({"refused", "unsupported", "lost", "cancelled"})
"""Outcomes that an attempt a second later would repeat."""

ENDS_MOTION = frozenset({"hold", "stop", "release"})

UNSUPPORTED = 3
"""MAV_RESULT_UNSUPPORTED."""

UNHEARD = frozenset({"timeout", "lost"})
"""Outcomes of an order that did not reach the vehicle, or whose effect the vehicle does not show."""

Planner = Callable[[float], Plan]
"""Plans an order at this loop time. Raises RefusedError, and NotReadyError if the order may be possible soon."""


class _PlanInProgress:
    """A plan in execution: the remaining steps, the one in progress, and whether it is to end early."""

    __slots__ = ("asked_now", "clearance", "done", "end_requested", "number", "plan", "queue", "step", "were_in")

    def __init__(self, plan: Plan, number: int, clearance: Clearance, were_in: Hands) -> None:
        self.plan = plan
        self.clearance = clearance
        """The outgoing gate's leave for what it sends."""
        self.number = number
        """Number of the newest order at its start; if that has changed, a newer order moves the vehicle."""
        self.were_in = were_in
        """Whose hands the vehicle was in when the plan began: a pilot that takes it later keeps it."""
        self.asked_now = ASKED_NOW.get()
        """A person gives this order; noted here, as the conditions of its commands are looked at by timers, too."""
        self.queue = list(plan.steps)
        self.done: list[Step] = []
        """Steps that were really executed, and not undone."""
        self.step: Step | None = None
        self.end_requested = False

    def ended(self) -> bool:
        """A method, because the type checker assumes that an attribute does not change during an await."""
        return self.end_requested


class OrderRunner:
    """The orders of one vehicle; which of them counts is in its ``ledger``."""

    def __init__(
        self,
        vehicle: Vehicle,
        commands: CommandClient,
        dialect: Dialect,
        loop: asyncio.AbstractEventLoop,
        outcomes: OrderOutcomes,
        order_refusal: Callable[[Plan], str | None] = lambda plan: None,
        first_number: int = 0,
    ) -> None:
        """``order_refusal``: why a plan is not executed; None: it may be. ``first_number``: see `OrderLedger`."""
        # state that others read, and callbacks
        self.precedence = OrderPrecedence(vehicle, loop, first_number)
        self.ledger = self.precedence.ledger
        self.flown_by: FlownBySetpoints | None = None
        """Its flight by setpoints, from which a plan that moves the vehicle takes over."""
        self.on_carried_out: Callable[[Plan], None] = lambda plan: None
        """Called with each plan that moves the vehicle and that it has accepted. A change to the mode that it was in
        already is none."""
        self.sent_before_at = -math.inf
        """Time at which the last setpoint, or the last command of another order than a goto, went out: it may reach the
        vehicle after a goto that was sent later."""
        # collaborators
        self._vehicle = vehicle
        self._commands = commands
        self._dialect = dialect
        self._loop = loop
        self._outcomes = outcomes
        self._order_refusal = order_refusal
        # plans in progress
        self._newest: Plan | None = None
        self._waiting = 0
        """Orders that move the vehicle and are repeated until it accepts them (`retry`)."""
        self._ending = False
        self._undoable: dict[asyncio.Task[Outcome], _PlanInProgress] = {}
        """Plans that can be undone: each has a task of its own, which undoes it even if its caller is cancelled."""

    # -- whole orders

    async def run(self, order: str, planner: Planner) -> Outcome:
        """Run a simple order and report its outcome."""
        with self._outcomes.tracked(order) as ended:
            return ended(await self.attempt(planner))

    async def retry(self, order: str, planner: Planner, wait_s: float) -> Outcome:
        """`run`, repeated until the vehicle accepts, ``wait_s`` is over, a newer order came, or the vehicle gives a
        reason that does not pass with time; the outcome then states what to do."""
        moves, started, were_in, attempts = order in MOVING, self._loop.time(), self.precedence.hands(), 0
        self._waiting += moves
        try:
            with numbered(), self._outcomes.tracked(order) as ended:
                while True:
                    # one attempt
                    tried_at, before = self._loop.time(), self.ledger.number
                    outcome = await self.attempt(planner)
                    attempts += outcome.attempts
                    outcome = replace(outcome, attempts=attempts, elapsed_s=self._loop.time() - started)
                    # the last one: nothing that time mends, superseded, or out of time
                    superseded = self.ledger.number > before + moves
                    over = superseded or tried_at + RETRY_S > started + wait_s
                    if (todo := self._todo_after(outcome)) is not None or over or outcome.ok or outcome.result in FINAL:
                        return ended(outcome if todo is None else replace(outcome, message=todo))
                    # wait for the next attempt
                    before = self.ledger.number
                    await asyncio.sleep(max(0.0, tried_at + RETRY_S - self._loop.time()))
                    if (changed := self._changed_meanwhile(order, outcome, before, started, were_in)) is not None:
                        return ended(changed)
        finally:
            self._waiting -= moves
            self.precedence.note_end()

    def _todo_after(self, outcome: Outcome) -> str | None:
        """The message with what the operator has to do first; None: nothing that the vehicle has said needs that."""
        todo = (
            None
            if outcome.ok
            else todo_for(outcome.status_texts, self._vehicle.name, self._vehicle.abilities.stop_mode)
        )
        if todo is None or todo in outcome.message:  # said by the step
            return None if todo is None else outcome.message
        return f"{outcome.message}; {todo}"

    def _changed_meanwhile(
        self, order: str, outcome: Outcome, number: int, started: float, were_in: Hands
    ) -> Outcome | None:
        """The outcome of an order that is not tried again after this one: a newer order than ``number`` came since,
        or since it ``started`` the vehicle was armed or disarmed, or taken by its pilot. None: it is tried again."""
        if self.ledger.number != number:
            return replace(outcome, result="cancelled", message=SUPERSEDED)
        if order in ARMING and (why := disarmed_since(self._vehicle, started)) is not None:
            return replace(outcome, result="refused", message=f"refused: {why}")
        if order in ARMING and self._armed_since(started):
            return replace(outcome, ok=True, result="accepted", message="it was armed meanwhile")
        if (why := self.precedence.pilot_since(order, were_in)) is not None:
            return replace(outcome, result="refused", message=f"refused: {why}")
        return None

    async def unless_newer(self, number: int, order: str, planner: Planner) -> Outcome:
        """`run`, if order ``number`` is still the last one that moves the vehicle. An order in progress is newer: its
        end is awaited. This one is given only if the newer one was not sent, or the vehicle has refused it: one whose
        answers were lost, or whose client is gone, may have moved the vehicle."""
        if not self.ledger.knows(number):
            unknown = f"it has no order {number} of this run of skygcs; without a number hold ends whatever moves it"
            return self._outcomes.finish(order, Outcome.refused(unknown))
        while self.ledger.in_progress or self._waiting:
            await self.precedence.next_end()
        if self.ledger.effective > number:
            newer = f"a newer order moves it, or may move it (number {self.ledger.effective})"
            return self._outcomes.finish(order, Outcome.refused(newer))
        return await self.run(order, planner)

    # -- one attempt

    async def attempt(self, planner: Planner, *, reason: str | None = None) -> Outcome:
        """Plan and execute once, without a report. An order that moves the vehicle takes over from its flight by
        setpoints, which ends for this ``reason`` (None: the order's name) once the order has taken effect. This is the
        gate of orders: each has a serial from here on, and one that comes too late is refused."""
        with numbered():
            before = self.precedence.hands()
            try:
                plan = planner(self._loop.time())
                if not plan.emergency and self.ledger.is_behind(ORDER_SERIAL.get() or OWN):
                    late = await self.precedence.late(plan.order)
                    late = late or self.precedence.taken(plan, before, asked_now=ASKED_NOW.get())
                    if late is not None:
                        return Outcome.refused(late)
                    plan = planner(self._loop.time())
                if self._is_ambiguous(plan):
                    return duplicate_refusal(self._vehicle)
                clearance = self._clear(plan)
            except NotReadyError as error:
                return Outcome(False, "temporarily_rejected", f"not ready: {error}")
            except RefusedError as error:
                return Outcome.refused(str(error))
            if plan.order in MOVING and self.flown_by is not None:
                return await self._take_over(plan, clearance, self.flown_by, reason or f"{plan.order} was ordered")
            return await self._execute(plan, clearance)

    async def _take_over(self, plan: Plan, clearance: Clearance, flown_by: FlownBySetpoints, reason: str) -> Outcome:
        """Execute a plan while the flight by setpoints goes on, holding, until a step of it has taken effect; see
        `_took_effect`. If none has, it goes on holding: a vehicle that denies an order is still flown. A goto that is
        carried out in the present mode, as an ArduCopter's in GUIDED, takes over at once: a setpoint that came after it
        would take its place."""
        number = self.ledger.number + 1
        outcome: Outcome | None = None
        flown_by.hand_over(reason)
        if plan.order == "goto" and not self._changes_mode(plan):
            flown_by.taken_over()
        try:
            outcome = await self._execute(plan, clearance)
        finally:
            if self.ledger.number == number:  # else the newer order has it handed over
                if outcome is not None and outcome.ok:
                    flown_by.taken_over()
                else:
                    flown_by.keep("the order was cancelled" if outcome is None else outcome.message)
        return outcome

    def _changes_mode(self, plan: Plan) -> bool:
        """True if a step of it ends with a mode that the vehicle is not in now."""
        now = self._loop.time()
        return any(isinstance(s.expect, ModeIn) and not s.expect.met(self._vehicle, now) for s in plan.steps)

    async def attempt_in_control(self, planner: Planner) -> Outcome:
        """An attempt by flight control itself, which does not end control."""
        with numbered(lambda: OWN):
            try:
                plan = planner(self._loop.time())
                clearance = self._clear(plan)
            except RefusedError as error:
                return Outcome.refused(str(error))
            return await self._execute(plan, clearance)

    def _clear(self, plan: Plan) -> Clearance:
        """The leave of the outgoing gate for a plan now. Raises RefusedError, also where an extension objects."""
        if (why := self._order_refusal(plan)) is not None:
            raise RefusedError(why)
        return clear_plan(model_of(self._vehicle, self._loop.time()), plan)

    async def _execute(self, plan: Plan, clearance: Clearance) -> Outcome:
        """Execute a plan; what was done is undone if a later step fails and the done steps can be undone.

        If its caller is cancelled, or `wind_down` is called, during a step that only prepares later ones (arming for a
        take-off), that step is undone. Once the last step has begun nothing is undone: the vehicle may be flying by it.
        """
        carry_out = self._steps if all(step.undo is None for step in plan.steps[:-1]) else self._undoably
        if plan.order not in MOVING:
            return await carry_out(_PlanInProgress(plan, self.ledger.number, clearance, self.precedence.hands()))
        self._newest, mode, ends_flight = plan, self._vehicle.custom_mode, plan.order in ENDING
        self._commands.supersede(commands_of(plan), ends_flight=ends_flight)
        number = self.ledger.begins(plan.order, ORDER_SERIAL.get() or OWN, ends_flight=ends_flight)
        run, ended = _PlanInProgress(plan, number, clearance, self.precedence.hands()), None
        try:
            ended = await carry_out(run)
        finally:
            self.ledger.ended(number, ended, changed=any(map(_sets_mode, run.done)))
            self.precedence.note_end()
        outcome = replace(ended, order_number=number)
        if outcome.ok and self.ledger.number == number and (plan.order != "mode" or self._vehicle.custom_mode != mode):
            self.on_carried_out(plan)
        return outcome

    async def _undoably(self, run: _PlanInProgress) -> Outcome:
        """`_steps` in a task of its own, which outlives the caller and undoes them."""
        if self._ending:
            return Outcome.refused("skygcs is shutting down")
        task = self._loop.create_task(self._steps(run), name=f"{self._vehicle.name} {run.plan.order}")
        self._undoable[task] = run
        task.add_done_callback(self._undoable.pop)
        try:
            return await asyncio.shield(task)
        except asyncio.CancelledError:
            if not self._end(run):
                task.cancel()
            raise

    # -- shutdown

    def wind_down(self) -> None:
        """The daemon ends: end and undo steps that only prepare later ones."""
        self._ending = True
        for run in list(self._undoable.values()):
            self._end(run)

    async def settled(self) -> None:
        """Wait, after `wind_down`, until the plans that it ended are undone."""
        if undoing := {task for task, run in self._undoable.items() if run.ended()}:
            await asyncio.wait(undoing)

    # -- a plan in progress

    def _end(self, run: _PlanInProgress) -> bool:
        """End it before its last step; False if that has begun."""
        if not run.queue:
            return False
        run.end_requested = True
        if run.step is not None and run.step.command is not None:
            self._commands.stop(run.step.command.command, "cancelled", "cancelled")
        self._commands.wake()
        return True

    async def _steps(self, run: _PlanInProgress) -> Outcome:
        plan, number, queue = run.plan, run.number, run.queue
        started = self._loop.time()
        attempts, texts = 0, []
        while queue:
            # before a step: is the plan still wanted, is the step still needed?
            if run.ended():
                return await self._ended(run, attempts, started)
            step = run.step = queue.pop(0)
            if step.skip_if_met and step.expect is not None and step.expect.met(self._vehicle, self._loop.time()):
                continue
            if self._known_unsupported(step, plan):
                queue[:0] = step.instead
                continue
            began = self._loop.time()
            outcome = await self._persist(step, run, began, await self._step(step, run))
            # ended by its caller or by the shutdown meanwhile
            if run.ended() and number == self.ledger.number:
                run.done += [step] if outcome.attempts else []  # the vehicle may have accepted the transmission
                return await self._ended(run, max(attempts, outcome.attempts), started)
            if not outcome.ok and self._commands.closed:  # nobody waited for its effect, and nothing undoes it
                sent = "; it was sent, and the vehicle may follow it" if outcome.attempts else ""
                text = f"{step.name}: {self._commands.closed}{sent}"
                return replace(outcome, result="cancelled", message=text, elapsed_s=self._loop.time() - started)
            attempts = max(attempts, outcome.attempts)  # steps are not repeats of each other
            texts += [t for t in outcome.status_texts if t not in texts]
            # an alternative, or a step that may fail
            if outcome.result == "unsupported" and step.instead:
                queue[:0] = step.instead
                continue
            if not outcome.ok and step.optional and number == self.ledger.number:
                continue
            # failed: undo what was done, unless a newer order flies the vehicle now
            if not outcome.ok:
                outcome = self._explained(outcome, step)
                message = outcome.message if len(plan.steps) == 1 else f"{step.name}: {outcome.message}"
                why = disarmed_since(self._vehicle, run.were_in.at) if arms_in(plan) else None
                if why is not None and outcome.result != "refused":
                    outcome, message = replace(outcome, result="refused"), f"{message}; {why}"  # not tried again
                if number == self.ledger.number:
                    message += await self._undo(run)
                elapsed_s = self._loop.time() - started
                return replace(
                    outcome, message=message, attempts=attempts, elapsed_s=elapsed_s, status_texts=tuple(texts)
                )
            run.done.append(step)
            if number == self.ledger.number:
                self._took_effect(step, run)
            # superseded between two steps
            if queue and number != self.ledger.number:
                text = f"a newer order took its place after {step.name!r}"
                return Outcome(False, "cancelled", text, attempts, self._loop.time() - started, tuple(texts))
        newer = f"; {SUPERSEDED} since" if plan.order in MOVING and number != self.ledger.number else ""
        return Outcome(True, "accepted", plan.done + newer, attempts, self._loop.time() - started, tuple(texts))

    def _took_effect(self, step: Step, run: _PlanInProgress) -> None:
        """A step has succeeded. One that changes the mode, and the last one, take the vehicle over from its flight by
        setpoints; others, such as the choice of a mission item, prepare that."""
        takes_over = _sets_mode(step) or not run.queue
        if self.flown_by is not None and takes_over and run.plan.order in MOVING and run.plan.order != "control":
            self.flown_by.taken_over()

    async def _ended(self, run: _PlanInProgress, attempts: int, started: float) -> Outcome:
        """The outcome of a plan that was cancelled before its last step."""
        undone = await self._undo(run) if run.number == self.ledger.number else ""
        rest = run.queue[-1].name if run.queue else "the last step"
        return Outcome(False, "cancelled", f"cancelled before {rest}{undone}", attempts, self._loop.time() - started)

    def _known_unsupported(self, step: Step, plan: Plan) -> bool:
        """True if the vehicle has said since its start that it lacks this command, for which there is another way. An
        order that ends a motion asks again: its other way may be the weaker one."""
        if step.command is None or not step.instead or plan.order in ENDS_MOTION:
            return False
        answers = model_of(self._vehicle, self._loop.time()).answers
        return answers.get(step.command.command) == UNSUPPORTED

    async def _persist(self, step: Step, run: _PlanInProgress, began: float, outcome: Outcome) -> Outcome:
        """See that the vehicle does what a step, which ``began`` then, asked of it; if the plan persists, repeat it
        while no answer comes, as it may not have been received."""
        plan, attempts = run.plan, 0
        while True:
            if plan.order in MOVING and plan.order != "goto":
                self.sent_before_at = self._loop.time()
            if outcome.ok and step.proof is not None:
                outcome = await self._proved(step, step.proof, run, outcome)
            attempts += outcome.attempts
            elapsed_s = self._loop.time() - began
            newer = run.number != self.ledger.number and not plan.final
            if outcome.ok or newer or elapsed_s >= plan.persist_s or outcome.result not in UNHEARD:
                return replace(outcome, attempts=attempts, elapsed_s=elapsed_s)
            self._outcomes.report_progress(plan.order, None)
            outcome = await self._step(step, run)

    async def _step(self, step: Step, run: _PlanInProgress) -> Outcome:
        """Send the command of a step, or its message, and wait until the vehicle shows the result."""
        # why it is not sent
        plan, number, expect = run.plan, run.number, step.expect
        if self._is_ambiguous(plan):
            return duplicate_refusal(self._vehicle)
        if (why := self._order_refusal(plan)) is not None:
            return Outcome.refused(why)
        if (why := self._taken_in(run)) is not None:
            return Outcome.refused(why)
        if step.message is not None:
            return await self._message_step(step, run)
        # the command, with what a late step knows only now
        met = None if expect is None else lambda: expect.met(self._vehicle, self._loop.time())
        try:
            spec = step.command if step.late is None else step.late.command(self._vehicle, self._loop.time())
        except RefusedError as error:
            return Outcome.refused(str(error))
        assert spec is not None

        with self._arming(spec) as answered:
            outcome = await self._commands.run(
                spec,
                emergency=plan.emergency,
                satisfied=met,
                on_report=lambda percent: self._outcomes.report_progress(plan.order, percent),
                moves=self._moves(spec, run, expect),
                with_repeats=step.with_repeats,
                clearance=run.clearance,
            )
            answered(outcome)
        # acknowledged: wait until the state shows it
        if not outcome.ok or met is None or expect is None or step.expect_s == 0:
            return outcome
        if await self._commands.until(lambda: met() or self.ledger.number != number or run.ended(), step.expect_s):
            return outcome
        unmet = expect.unmet(self._vehicle, self._loop.time())
        return replace(outcome, ok=False, result="timeout", message=f"timeout: accepted, but {unmet}")

    def _moves(self, spec: CommandSpec, run: _PlanInProgress, expect: Expectation | None) -> Moves | None:
        """Conditions for the command of a plan. An arming moves nothing yet: it stands beside newer orders, but for one
        that ends the flight."""
        plan, number, mode_changes = run.plan, run.number, self._vehicle.mode_changes

        def taken() -> str | None:
            return self._taken_in(run)

        def armed() -> bool:
            return arms(spec) and self._armed_since(run.were_in.at)

        if arms_in(plan) and plan.order not in MOVING:
            return Moves(lambda: not self.ledger.flight_ended_since(number), taken, ended_only=True, done=armed)
        if plan.order not in MOVING or plan.final:
            return None

        def wanted() -> bool:
            return self.ledger.number == number or (self._newest is not None and spec in commands_of(self._newest))

        def accepted() -> None:
            if isinstance(expect, ModeIn):
                self.ledger.mode_accepted(expect.custom_modes, mode_changes, self._loop.time() + VERIFY_S)

        return Moves(wanted, taken, done=armed, accepted=accepted)

    def _taken_in(self, run: _PlanInProgress) -> str | None:
        return self.precedence.taken(run.plan, run.were_in, asked_now=run.asked_now)

    def _armed_since(self, at: float) -> bool:
        return self._vehicle.armed and self._vehicle.armed_at > at

    @contextmanager
    def _arming(self, spec: CommandSpec) -> Iterator[Callable[[Outcome], None]]:
        """While the command is sent, and until heartbeats have followed, the vehicle counts as one that may be armed,
        if the command arms. The function that it yields gets the outcome; without one the command may have arrived."""
        outcomes: list[Outcome | None] = [None]
        if not arms(spec):
            yield outcomes.append
            return
        vehicle = self._vehicle
        self.ledger.arming_begins(self._loop.time())
        vehicle.arming_at, vehicle.arming_until = self.ledger.arming
        try:
            yield outcomes.append
        finally:
            self.ledger.arming_ended(self._loop.time(), outcomes[-1])
            vehicle.arming_at, vehicle.arming_until = self.ledger.arming

    async def _proved(self, step: Step, proof: TargetProof, run: _PlanInProgress, accepted: Outcome) -> Outcome:
        """See that the vehicle does what it accepted; the step is repeated while it does not. If a newer order comes
        meanwhile, or the daemon ends, the outcome stays that it was accepted. A vehicle that left the mode meanwhile
        is not sent there again."""
        attempts = accepted.attempts
        again = step if proof.again is None else replace(step, command=proof.again, instead=())

        def newer() -> bool:
            return self._ending or self.ledger.number != run.number

        for repeats_left in range(PROOF_REPEATS, -1, -1):
            # what was sent before may come after it
            quiet_s = self.sent_before_at + LATE_ACK_S - self._loop.time()
            if quiet_s > 0.0 and await self._commands.until(newer, quiet_s):
                break
            # request its target
            there = proof.begin(self._vehicle, self._loop.time())
            if await self._shown(there, proof.request, newer):
                break
            left_mode = self._vehicle.custom_mode != proof.custom_mode
            if left_mode or not repeats_left:
                why = there.unmet(self._vehicle, self._loop.time())
                text = f"timeout: accepted, but {f'it is in {self._vehicle.mode} now' if left_mode else why}"
                return replace(accepted, ok=False, result="timeout", message=text, attempts=attempts)
            # send it again
            self._outcomes.report_progress(run.plan.order, None)
            repeated = await self._step(again, run)
            attempts += repeated.attempts
            if not repeated.ok:
                return accepted if newer() else replace(repeated, attempts=attempts)
        return replace(accepted, attempts=attempts)

    async def _shown(self, there: GoesThere, request: CommandSpec, newer: Callable[[], bool]) -> bool:
        """Request a message; True once the vehicle shows that it flies there, or a newer order came."""

        def met() -> bool:
            return there.met(self._vehicle, self._loop.time())

        await self._commands.run(request, satisfied=met, moves=Moves(lambda: not newer()))
        return await self._commands.until(lambda: met() or newer(), PROOF_S)

    async def _message_step(self, step: Step, run: _PlanInProgress) -> Outcome:
        """Send a message, which has no acknowledgement, until its answer has come or the time is over."""
        assert step.message is not None
        number = run.number
        name, values = step.message
        if name not in self._dialect.by_name:
            return Outcome(False, "refused", f"dialect {self._dialect.name} has no {name}")
        started, attempts = self._loop.time(), 0

        def answered() -> bool:
            return step.expect is not None and step.expect.met(self._vehicle, self._loop.time())

        while True:
            # send
            if (why := self._taken_in(run)) is not None:
                return Outcome.refused(why)
            if not self._commands.transmit(name, values, clearance=run.clearance):
                return Outcome(False, "lost", "could not be sent: no link leads to it", attempts)
            attempts += 1
            if step.expect is None or step.expect_s == 0:
                return Outcome(True, "accepted", "sent", attempts)
            # wait for the answer
            left_s = started + step.expect_s - self._loop.time()
            await self._commands.until(lambda: self.ledger.number != number or answered(), min(RESEND_S, left_s))
            elapsed_s = self._loop.time() - started
            if answered():
                return Outcome(True, "accepted", "answered", attempts, elapsed_s)
            if self.ledger.number != number:
                return Outcome(False, "cancelled", SUPERSEDED, attempts, elapsed_s)
            if left_s <= RESEND_S:
                unmet = step.expect.unmet(self._vehicle, self._loop.time())
                return Outcome(False, "timeout", f"timeout: {unmet}", attempts, elapsed_s)

    async def _undo(self, run: _PlanInProgress) -> str:
        """Undo the steps that were done, last first; returns what to add to the message. A step that cannot be undone
        ends it: those before it were made for a vehicle that is in the state which they led to."""
        began, added = self._loop.time(), ""
        for step in reversed(run.done.copy()):
            if step.undo is None:
                continue
            outcome = await self._undo_step(step.undo, run, began)
            if not outcome.ok:
                return f"{added}; did not {step.undo.name}: {outcome.message}"
            run.done.remove(step)
            added += f"; {step.undo.name}"
        return added

    async def _undo_step(self, undo: Step, run: _PlanInProgress, began: float) -> Outcome:
        """Send one step of an undo that ``began`` then, if the outgoing gate lets it pass now. A mode waits for a
        heartbeat that came since and shows the vehicle disarmed: what armed unheard may be flying."""

        def shown() -> bool:
            now = self._loop.time()
            silence_s = self._vehicle.silence_s(now)
            heard = silence_s is not None and now - silence_s > began
            return heard and model_of(self._vehicle, now).not_disarmed is None

        def newer() -> bool:
            return self.ledger.number != run.number

        if isinstance(undo.expect, ModeIn) and not await self._commands.until(lambda: shown() or newer(), VERIFY_S):
            return Outcome.refused("no heartbeat has shown it disarmed since")
        if newer():
            return Outcome(False, "cancelled", SUPERSEDED)
        try:
            clearance = clear_undo(model_of(self._vehicle, self._loop.time()), run.plan.order, undo)
        except RefusedError as error:
            return Outcome.refused(str(error))
        return await self._step(undo, _PlanInProgress(run.plan, run.number, clearance, self.precedence.hands()))

    def _is_ambiguous(self, plan: Plan) -> bool:
        """True if two vehicles have the system id and the plan is not one that both may take."""
        return self._vehicle.duplicate and not (plan.emergency or plan.despite_duplicate)

    def _explained(self, outcome: Outcome, step: Step) -> Outcome:
        """A refusal with what its step says about it; one without any reason at least names the refused step."""
        if outcome.result not in REFUSALS or (outcome.status_texts and not step.refused):
            return outcome
        why = step.refused or f"{firmware_name(self._vehicle)} gave no reason ({step.name})"
        return replace(outcome, message=f"{outcome.message}{';' if outcome.status_texts else ':'} {why}")


def duplicate_refusal(vehicle: Vehicle) -> Outcome:
    """The refusal of an order that could reach either of two vehicles with one system id."""
    where = vehicle.duplicate_where
    there = "" if where is None else f" ({where})"
    text = f"two vehicles with system id {vehicle.sysid} are on the air{there}; give one of them another"
    return Outcome(False, "refused", f"refused: {text}")


def _sets_mode(step: Step) -> bool:
    return isinstance(step.expect, ModeIn)
