"""Commands in flight to one vehicle: the asyncio side of `CommandProtocol`, with one timer for all of them.

At most one command of an id is in flight per vehicle, because a COMMAND_ACK contains only the id; the next one with the
same id waits. If the previous one has acks outstanding (repeats, or a timeout), the next waits until they have come or
for `LATE_ACK_S` after the last transmission (and always for `ECHO_ACK_S`), so that a late ack is not taken for the new
command's. An emergency does not wait; its outcome is decided by the vehicle's state, not by an ack.

What is repeated, and over which link, is in `core.protocols.command`.
"""

from __future__ import annotations

import asyncio
import contextlib
import math
from collections.abc import Callable, Collection, Hashable, Mapping
from dataclasses import dataclass, replace
from typing import Any, Protocol

from skygcs.core.mavlink import mav_cmd
from skygcs.core.mavlink.dialect import Dialect, MessageInfo
from skygcs.core.protocols.base import Effect, ProgressReport, Transmit
from skygcs.core.protocols.command import (
    EMERGENCY_TIMERS_S,
    RETRY_TIMERS_S,
    Ack,
    CommandProtocol,
    CommandSpec,
    Outcome,
    Repeat,
    repeat_rule,
)
from skygcs.core.radio_link.transmit_queue import Priority
from skygcs.core.vehicle.gate import Clearance, is_exempt
from skygcs.runtime.loop_clock import DeadlineTimer


class SendFn(Protocol):
    """Sends a message of ours: over the best link to the target, or with ``everywhere`` over each that leads to it."""

    def __call__(
        self,
        info: MessageInfo,
        values: Mapping[str, Any],
        sysid: int,
        compid: int,
        priority: Priority,
        /,
        *,
        everywhere: bool = False,
        key: Hashable | None = None,
        clearance: Clearance | None = None,
    ) -> bool:
        """True if a link took it. Sysid 0 is every vehicle. With a ``key`` it replaces a message waiting under that
        key. ``clearance``: of the outgoing gate; without one only what is harmless to its target is sent. That of
        vehicles.stop is sent without authority, too."""
        ...


def _refuse(*_: object, **__: object) -> bool:
    """The `SendFn` of a client that was closed."""
    return False


LATE_ACK_S = 1.5
"""Two rounds of a nine-node multipoint radio at 64 kbit/s; no ack is expected after that."""

ECHO_ACK_S = 0.05
"""PX4 acknowledges DO_SET_MODE twice, 8 to 15 ms apart (own capture): the second must not be taken for the next
command's. If a radio delays it more, the mode in the heartbeat decides, as for every change of mode."""

EVERYWHERE = frozenset({"land", "rtl", "hold", "disarm"})
"""Orders that end a flight: already the first transmission goes over every link to the vehicle."""

SUPERSEDED = "a newer order took its place"

MAX_WAITING = 8
"""Most commands of one id that wait; further ones are refused."""

Check = Callable[[], bool]
_Watch = tuple[Check, asyncio.Future[bool], float]
"""The awaited condition, the future that is resolved then, and the deadline."""
Follower = tuple[str, Mapping[str, Any]]
"""A message and its fields, without its target."""


class BroadcastCommand:
    """A broadcast frame that carries one command to many vehicles: each vehicle's client starts without sending."""

    def __init__(self, spec: CommandSpec) -> None:
        self.spec = spec
        self.sent = False


class _Line:
    """One command id: the command in flight, those that wait, and the acks that may still come late."""

    __slots__ = ("accepted", "ended_at", "late", "lock", "quiet_until", "quieted", "waiting")

    def __init__(self) -> None:
        self.lock = asyncio.Lock()
        self.waiting = 0
        self.late = 0
        self.quiet_until = 0.0
        self.ended_at = -ECHO_ACK_S
        self.quieted = asyncio.Event()
        self.accepted: Callable[[], None] = lambda: None
        """`Moves.accepted` of the last one."""

    def is_idle(self, now: float) -> bool:
        """True if no command is in flight or waits, and a next one would not have to wait either."""
        if self.waiting or self.lock.locked():
            return False
        return now >= self.ended_at + ECHO_ACK_S and (not self.late or now >= self.quiet_until)


@dataclass(frozen=True, slots=True)
class Moves:
    """Conditions for sending a command that moves the vehicle, or arms it."""

    wanted: Check
    """False once a newer order has taken its place; called when its turn has come."""
    taken: Callable[[], str | None] = lambda: None
    """Why it is left to a pilot now, None: it is sent; called then, too, and before each repeat."""
    ended_only: bool = False
    """No newer order but one that ends the flight takes its place."""
    done: Check = lambda: False
    """Another order has done it meanwhile, and it is not sent; called when its turn has come."""
    accepted: Callable[[], None] = lambda: None
    """Called when the vehicle has accepted it, also after a newer order has taken its place."""

    def outcome_unsent(self) -> Outcome | None:
        """The outcome of a command that must not be sent now that its turn has come; None: it may be sent."""
        if not self.wanted():
            return Outcome(False, "cancelled", SUPERSEDED)
        if (why := self.taken()) is not None:
            return Outcome.refused(why)
        return Outcome(True, "accepted", "another order has done it meanwhile") if self.done() else None


@dataclass(frozen=True, slots=True)
class _Request:
    """One call of `CommandClient.run`; see its parameters."""

    spec: CommandSpec
    satisfied: Check | None
    on_report: Callable[[int | None], None] | None
    everywhere: bool
    moves: Moves | None
    with_repeats: Follower | None
    clearance: Clearance | None = None


class _Running:
    """A request in flight."""

    __slots__ = ("done", "not_taken", "priority", "protocol", "request", "rule", "satisfied", "shown", "via")

    def __init__(
        self, request: _Request, protocol: CommandProtocol, done: asyncio.Future[Outcome], priority: Priority
    ) -> None:
        self.request = request
        self.protocol = protocol
        self.done = done
        self.priority = priority
        # a state that is present already proves nothing about this command
        self.satisfied = None if request.satisfied is not None and request.satisfied() else request.satisfied
        self.not_taken = 0
        self.rule = repeat_rule(request.spec)
        self.shown = False
        """The state has shown the effect, if only for a moment."""
        self.via: tuple[int, ...] = ()
        """The channels of the first transmission."""


@dataclass(frozen=True, slots=True)
class StateEvidence:
    """Evidence of the vehicle's state about its commands, and the channels that they take."""

    why_silent: Callable[[], str] = lambda: ""
    """Another reason than the link for missing answers: the end of a sentence, or nothing."""
    heard_at: Callable[[], float] = lambda: math.inf
    """When its newest heartbeat came."""
    round_trip_s: Callable[[], float] = lambda: 0.0
    """How long a message there and its answer take; 0: not known."""
    channels: Callable[[], tuple[int, ...]] = lambda: ()
    """The channels on which it is sent a command now."""


class CommandClient:
    """Runs commands for one (sysid, compid). `on_ack`, `on_text` and `wake` are called by the actor as frames come."""

    def __init__(
        self,
        target: tuple[int, int],
        own: tuple[int, int],
        dialect: Dialect,
        send: SendFn,
        loop: asyncio.AbstractEventLoop,
        evidence: StateEvidence = StateEvidence(),
    ) -> None:
        self.target = target
        self.own = own
        self._broadcast: BroadcastCommand | None = None
        self._min_retry_s = 0.0
        self._evidence = evidence
        self._dialect = dialect
        self._send = send
        self._loop = loop
        self._lines: dict[int, _Line] = {}
        self._running: dict[int, _Running] = {}
        self._watches: list[_Watch] = []
        self._addresses: dict[int, dict[str, int]] = {}
        self._timer = DeadlineTimer(loop, self._on_timer)
        self.closed = ""
        """Why it was closed (`close`); empty while it is open."""

    @property
    def why_silent(self) -> Callable[[], str]:
        """See `StateEvidence`."""
        return self._evidence.why_silent

    @property
    def busy(self) -> bool:
        """True if frames have to be shown to `wake`."""
        return bool(self._watches)

    @property
    def watches(self) -> list[Any]:
        """The commands that `busy` refers to; always the same list."""
        return self._watches

    def in_flight(self, command: int) -> bool:
        return command in self._running

    async def run(
        self,
        spec: CommandSpec,
        *,
        emergency: bool = False,
        satisfied: Check | None = None,
        on_report: Callable[[int | None], None] | None = None,
        moves: Moves | None = None,
        with_repeats: Follower | None = None,
        timers_s: tuple[float, ...] = RETRY_TIMERS_S,
        clearance: Clearance | None = None,
    ) -> Outcome:
        """Send a command and wait for its outcome. ``satisfied``: True once the state shows the effect, so that a lost
        ack does not matter. Cancelling drops the command; transmissions cannot be undone.

        The first transmission uses the best link. Repeats, where they are harmless, use every link that leads to the
        vehicle: the best may be the one that loses them. Of the orders `EVERYWHERE` the first one does, too.
        ``moves``: given for a command that moves or arms the vehicle, which a newer order may replace (`supersede`), or
        a pilot. An emergency is sent at once. ``with_repeats``: a message sent right after each repeat, over the same
        links (`Step.with_repeats`). ``timers_s``: the waits after each transmission. ``clearance``: see `SendFn`.
        """
        # refuse what cannot be packed
        if spec.message not in self._dialect.by_name or "COMMAND_ACK" not in self._dialect.by_name:
            return Outcome(False, "refused", f"dialect {self._dialect.name} has no {spec.message} or no COMMAND_ACK")
        try:
            self._dialect.by_name[spec.message].pack(spec.values(*self.target, 0))
        except ValueError as error:
            return Outcome(False, "refused", f"refused: {error}")
        everywhere = emergency or (clearance is not None and clearance.order in EVERYWHERE)
        request = _Request(spec, satisfied, on_report, everywhere, moves, with_repeats, clearance)
        line = self._line(spec.command)
        # an emergency replaces a command of its kind
        if emergency:
            self.stop(spec.command, "cancelled", "an emergency order took its place")
            return await self._protocol(line, request, Priority.EMERGENCY, EMERGENCY_TIMERS_S)
        # any other command waits for its turn
        if line.waiting >= MAX_WAITING:
            return Outcome(False, "refused", f"{line.waiting} commands of the same kind are waiting already")
        line.waiting += 1
        try:
            await line.lock.acquire()
        finally:
            line.waiting -= 1
        try:
            ending = self._running.get(spec.command)
            if ending is not None and ending.done.done():
                await asyncio.sleep(0)  # let a superseded emergency end: its outstanding acks have to be counted
            await self._quiet(line)
            if spec.command in self._running:
                return Outcome(False, "refused", "an emergency order of the same kind is under way")
            if moves is not None and (outcome := moves.outcome_unsent()) is not None:
                return outcome
            waits_s = tuple(max(wait_s, self._min_retry_s) for wait_s in timers_s)
            if repeat_rule(spec).repeat is Repeat.NEVER:
                waits_s = (sum(waits_s),)
            return await self._protocol(line, request, Priority.COMMAND, waits_s)
        finally:
            line.lock.release()

    def set_min_retry(self, min_retry_s: float) -> None:
        """Shortest retry interval, except of an emergency: on a radio with long rounds an answer takes that long."""
        self._min_retry_s = min_retry_s

    def expect_broadcast(self, broadcast: BroadcastCommand) -> None:
        """Until `end_broadcast`, this broadcast replaces the first transmission of the next command of its kind."""
        self._broadcast = broadcast

    def end_broadcast(self, broadcast: BroadcastCommand | None) -> None:
        """Send commands to the vehicle itself again, unless a later broadcast is expected."""
        if self._broadcast is broadcast:
            self._broadcast = None

    async def until(self, met: Check, timeout_s: float) -> bool:
        """Wait for a state; True if it was seen within the time."""
        if met():
            return True
        future: asyncio.Future[bool] = self._loop.create_future()
        watch = (met, future, self._loop.time() + timeout_s)
        self._watches.append(watch)
        self._set_timer()
        try:
            return await future
        finally:
            self._watches.remove(watch)

    def transmit(
        self,
        message: str,
        values: Mapping[str, Any],
        priority: Priority = Priority.COMMAND,
        key: Hashable | None = None,
        clearance: Clearance | None = None,
    ) -> bool:
        """Send a message without acknowledgement to the vehicle. Raises KeyError if the dialect lacks it."""
        sysid, compid = self.target
        info = self._dialect.by_name[message]
        addressed = {**values, **self._address(info)}
        more: dict[str, Any] = {} if key is None else {"key": key}
        if clearance is not None:
            more["clearance"] = clearance
        return self._send(info, addressed, sysid, compid, priority, **more)

    def send(self, *message: Any, **how: Any) -> bool:
        """Send a message as `SendFn`; False once this client is closed: whatever goes on then by what it decided before
        has no other way to the vehicle."""
        return self._send(*message, **how)

    def _address(self, info: MessageInfo) -> dict[str, int]:
        """The target fields that a message has; cached, because every setpoint needs them (0.4 us instead of 0.9 for
        all of `transmit`)."""
        address = self._addresses.get(info.msgid)
        if address is None:
            target = dict(zip(("target_system", "target_component"), self.target, strict=True))
            address = {f.name: target[f.name] for f in info.fields if f.name in target}
            self._addresses[info.msgid] = address
        return address

    def expect_stray_ack(self, command: int, now: float) -> None:
        """Note a command that is sent without waiting for its ack, which must not be taken for another's."""
        line = self._line(command)
        line.late += 1
        line.quiet_until = now + LATE_ACK_S

    def on_ack(self, ack: Ack, now: float) -> None:
        """A COMMAND_ACK of this vehicle, to any station."""
        if not ack.is_for(*self.own):
            return
        running = self._running.get(ack.command)
        if running is not None:
            self._apply(running, running.protocol.on_ack(ack, now))
            self._set_timer()
            return
        line = self._lines.get(ack.command)
        if line is not None and line.late:
            line.late -= 1
            if ack.result == 0:
                line.accepted()
            if not line.late:
                line.quieted.set()

    def on_text(self, text: str) -> None:
        for running in self._running.values():
            running.protocol.on_text(text)

    def wake(self) -> None:
        """Look again, as the vehicle's state may have changed."""
        for met, future, _ in self._watches:
            if not future.done() and met():
                future.set_result(True)

    def stop_all(self, result: str, message: str) -> None:
        """The vehicle is lost or rebooted: nothing in flight will be answered. Emergencies go on."""
        for command in [c for c, r in self._running.items() if r.priority is not Priority.EMERGENCY]:
            self.stop(command, result, message)

    def stop_unauthorised(self, message: str) -> None:
        """End everything but vehicles.stop: another site may command the vehicle now."""
        for command in [c for c, r in self._running.items() if not is_exempt(r.request.clearance)]:
            self.stop(command, "refused", message)

    def supersede(self, specs: Collection[CommandSpec], *, ends_flight: bool) -> None:
        """A newer order moves the vehicle, or ends its flight: older commands are not repeated any more. One with equal
        fields goes on, and so does one that was run without ``moves``."""
        for command, running in list(self._running.items()):
            moves = running.request.moves
            if moves is None or running.protocol.spec in specs or (moves.ended_only and not ends_flight):
                continue
            self.stop(command, "cancelled", SUPERSEDED)

    def close(self, reason: str) -> None:
        """End all commands, and send nothing any more: the daemon ends, or the vehicle was dropped."""
        self.closed = reason
        self._send = _refuse
        for command in list(self._running):
            self.stop(command, "cancelled", reason)
        for _, future, _ in self._watches:
            if not future.done():
                future.set_result(False)  # the timer that would end it is cancelled below
        self._timer.set(None)

    def _line(self, command: int) -> _Line:
        """The line of a command id. A new one drops those that are idle: there are 65,536 ids."""
        line = self._lines.get(command)
        if line is None:
            now = self._loop.time()
            kept = {c: old for c, old in self._lines.items() if c in self._running or not old.is_idle(now)}
            line = kept[command] = _Line()
            self._lines = kept
        return line

    async def _quiet(self, line: _Line) -> None:
        wait_s = line.quiet_until - self._loop.time()
        if line.late and wait_s > 0:
            line.quieted.clear()
            with contextlib.suppress(TimeoutError):
                async with asyncio.timeout(wait_s):
                    await line.quieted.wait()
        line.late = 0
        if (echo_s := line.ended_at + ECHO_ACK_S - self._loop.time()) > 0:
            await asyncio.sleep(echo_s)

    async def _protocol(
        self, line: _Line, request: _Request, priority: Priority, timers_s: tuple[float, ...]
    ) -> Outcome:
        """Run the command protocol to its outcome, and note how many acks may still come late."""
        if self.closed:
            return Outcome(False, "cancelled", self.closed)
        # register the exchange
        spec = request.spec
        protocol = CommandProtocol(spec, timers_s)
        running = _Running(request, protocol, self._loop.create_future(), priority)
        self._running[spec.command] = running
        now = self._loop.time()
        running.via = self._evidence.channels()
        # send it, unless the broadcast carries it
        watch = self._watch_effect(running, now + sum(timers_s))
        carried = self._broadcast is not None and not self._broadcast.sent and self._broadcast.spec == spec
        self._apply(running, protocol.start(now, transmitted=carried))
        self._set_timer()
        # wait for the outcome
        try:
            outcome = await running.done
        finally:
            if self._running.get(spec.command) is running:
                del self._running[spec.command]
            if watch is not None:
                self._watches.remove(watch)
            # late answers do not count for the next command
            line.late = protocol.outstanding
            line.ended_at = self._loop.time()
            line.quiet_until = protocol.last_sent + LATE_ACK_S
            line.accepted = (lambda: None) if request.moves is None else request.moves.accepted
        if outcome.ok and protocol.acks:
            line.accepted()
        # explain a timeout
        if outcome.result == "timeout" and running.not_taken >= protocol.attempts:
            return Outcome(False, "lost", "could not be sent: no link leads to it", 0, outcome.elapsed_s)
        if outcome.result == "timeout":
            why = self._evidence.why_silent()
            if running.rule.repeat is Repeat.NEVER and protocol.attempts:
                why += f"; it may have been done and is not sent again, because {running.rule.reason}"
            return replace(outcome, message=outcome.message + why)
        return outcome

    def _watch_effect(self, running: _Running, until: float) -> _Watch | None:
        """Note the effect of a command that must not be done twice as soon as the state shows it."""
        satisfied = running.satisfied
        if satisfied is None or running.rule.repeat is not Repeat.IF_NOT_DONE:
            return None
        future: asyncio.Future[bool] = self._loop.create_future()

        def met() -> bool:
            running.shown = running.shown or satisfied()
            return running.shown

        watch = (met, future, until)
        self._watches.append(watch)
        return watch

    def _may_be_undone(self, running: _Running) -> bool:
        """True if the state would show that this command was done, and does not. A reboot shows in any frame."""
        if running.protocol.spec.command == mav_cmd.PREFLIGHT_REBOOT_SHUTDOWN:
            return True
        return running.request.satisfied is not None and not running.request.satisfied()

    def _why_not_repeat(self, running: _Running, now: float) -> str | None:
        """Why a command is not sent again now; None if it is."""
        rule = running.rule
        if running.priority is Priority.EMERGENCY:
            return None
        moves = running.request.moves
        if moves is not None and (why := moves.taken()) is not None:
            return f"because {why}"
        if rule.repeat is Repeat.SAME_LINK and self._evidence.channels() != running.via:
            return "because it went over another link than the one that is used now"
        if rule.repeat is Repeat.IF_NOT_DONE and not self._may_be_undone(running):
            return f"because {rule.reason}, and nothing shows that it was not done"
        evidence_s = rule.shows_after_s + max(self._min_retry_s, self._evidence.round_trip_s())
        if rule.repeat is Repeat.IF_NOT_DONE and self._evidence.heard_at() < running.protocol.last_sent + evidence_s:
            return f"because {rule.reason}, and no newer state of the vehicle shows that it was not done"
        return None

    def _apply(self, running: _Running, effects: tuple[Effect, ...]) -> None:
        for effect in effects:
            if isinstance(effect, Transmit):
                spec = running.protocol.spec
                values = spec.values(*self.target, effect.attempt)
                info = self._dialect.by_name[spec.message]
                again = bool(effect.attempt) and running.rule.repeat is not Repeat.SAME_LINK
                everywhere: dict[str, Any] = {"everywhere": True} if running.request.everywhere or again else {}
                clearance = running.request.clearance
                cleared: dict[str, Any] = {} if clearance is None else {"clearance": clearance}
                if not self._send(info, values, *self.target, running.priority, **everywhere, **cleared):
                    running.not_taken += 1
                if effect.attempt and running.request.with_repeats is not None:
                    name, fields = running.request.with_repeats
                    if (follower := self._dialect.by_name.get(name)) is not None:
                        addressed = {**fields, **self._address(follower)}
                        self._send(follower, addressed, *self.target, running.priority, everywhere=True, **cleared)
            elif isinstance(effect, ProgressReport):
                if running.request.on_report is not None:
                    running.request.on_report(effect.percent)
            elif not running.done.done():
                assert running.protocol.outcome is not None
                running.done.set_result(running.protocol.outcome)

    def stop(self, command: int, result: str, message: str) -> None:
        """End a command in flight with this outcome, if there is one of that id."""
        running = self._running.get(command)
        if running is not None:
            self._apply(running, running.protocol.stop(self._loop.time(), result, message))

    def _set_timer(self) -> None:
        deadlines = [r.protocol.deadline for r in self._running.values() if r.protocol.deadline is not None]
        deadlines += [deadline for _, future, deadline in self._watches if not future.done()]
        self._timer.set(min(deadlines, default=None))

    def _on_timer(self) -> None:
        now = self._loop.time()
        for _, future, deadline in self._watches:
            if now >= deadline and not future.done():
                future.set_result(False)
        for running in list(self._running.values()):
            protocol = running.protocol
            if protocol.deadline is None or now < protocol.deadline:
                continue
            if running.shown or (running.satisfied is not None and running.satisfied()):
                # its ack was lost, or a repeat was refused because the first transmission had been carried out
                self._apply(running, protocol.stop(now, "accepted", "done, though no acknowledgement came"))
            elif protocol.may_transmit(now) and (why := self._why_not_repeat(running, now)) is not None:
                self._apply(running, protocol.postpone(now, why))
            else:
                self._apply(running, protocol.on_timer(now))
        self._set_timer()
