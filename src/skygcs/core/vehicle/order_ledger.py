"""The ledger of the orders to one vehicle: which of them counts, whether one of them may have armed it, and which mode
is of ours although it shows late; and whose stream of setpoints it follows. Pure.

Orders are not sent in the sequence in which they are asked for, and a vehicle may refuse one. So each has two counts:

    serial    from where it is asked for, among the orders to all vehicles (`runtime.task_set`); 0: nobody asked for it
    number    from where its sending begins, among those that move this vehicle (`Outcome.order_number`)

An order is *in progress* until it has an outcome, and *effective* from then on if it may move the vehicle: one that is
refused, too, if the vehicle has changed its mode for it before.

A stream of setpoints has one owner (`StreamOwner`):

    the stream that is followed               a setpoint of                   is
    ---------------------------------------   -----------------------------   -----------------------------------------
    none; its deadline has passed; its        anybody                         followed: that client is the owner
    owner is gone
    alive                                     its owner                       followed
    alive                                     another                         refused
    alive                                     another, with ``take_over``     followed: the owner before has lost it
    ended by an order while it was alive      the owner                       refused: it has lost it; not by one that
                                                                              the vehicle refused and ends no flight
    any                                       a client that has lost it       refused until it has paused, or control is
                                                                              engaged again

A client that has lost its stream sends on until it notices, or for ever: neither a setpoint that comes late nor a
program that always insists takes the vehicle back unseen.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, NamedTuple

from skygcs.core.protocols.command import Outcome
from skygcs.core.vehicle.flight_evidence import RECENTLY_ARMED_S

REFUSALS = frozenset({"temporarily_rejected", "denied", "unsupported", "failed"})
"""Outcomes of a refusal by the vehicle."""


class _InProgress(NamedTuple):
    order: str
    serial: int


class _OwnMode(NamedTuple):
    custom_modes: frozenset[int]
    mode_changes: int
    until: float


class OrderLedger:
    """The orders that move one vehicle: `begins` and `ended` with each; and its armings, which move nothing."""

    def __init__(self, first_number: int = 0) -> None:
        """``first_number``: the numbers follow on this; above those of all ledgers of this vehicle before, so that a
        number of one of those names no order here."""
        self.number = self._first_number = first_number
        """That of the newest order, whatever became of it."""
        self.effective = first_number
        """That of the newest effective order."""
        self.effective_order = ""
        """Name of the order ``effective``."""
        self.effective_serial = 0
        """Latest serial of the effective orders."""
        self._in_progress: dict[int, _InProgress] = {}
        """By number."""
        self._ending_number = first_number
        """That of the newest order that ends a flight."""
        self._armings = 0
        """Commands in progress that arm."""
        self._arming_at = -math.inf
        """When the last one began."""
        self._armed_within = -math.inf, -math.inf
        """When the last one that may have had an effect was sent, and until when a heartbeat may yet show it."""
        self._own_mode = _OwnMode(frozenset(), 0, -math.inf)
        """That of the last command to a mode that the vehicle has accepted."""

    # -- orders that move the vehicle

    def begins(self, order: str, serial: int, *, ends_flight: bool) -> int:
        """Note an order whose sending begins now; returns its number. It is in progress until `ended`."""
        self.number += 1
        self._in_progress[self.number] = _InProgress(order, serial)
        if ends_flight:
            self._ending_number = self.number
        return self.number

    def ended(self, number: int, outcome: Outcome | None, *, changed: bool = False) -> None:
        """Note the outcome of an order in progress; None: its caller was cancelled. ``changed``: the vehicle has
        changed its mode for it, whatever came then."""
        order, serial = self._in_progress.pop(number)
        if not (changed or may_have_effect(outcome)):
            return
        if number > self.effective:
            self.effective, self.effective_order = number, order
        self.note_effect(serial)

    def note_effect(self, serial: int) -> None:
        """Note that an order without a number is effective: under control by setpoints."""
        self.effective_serial = max(self.effective_serial, serial)

    @property
    def in_progress(self) -> int:
        """Number of orders in progress."""
        return len(self._in_progress)

    @property
    def newest_in_progress(self) -> str:
        """Name of the newest order while it is in progress; empty: it is not."""
        newest = self._in_progress.get(self.number)
        return "" if newest is None else newest.order

    def knows(self, number: int) -> bool:
        """True if this is the number of an order, or the first number, after which none has begun."""
        return self._first_number <= number <= self.number

    def is_behind(self, serial: int) -> bool:
        """True if an order that was asked for later is effective, or in progress."""
        return any(later > serial for later in (self.effective_serial, *(o.serial for o in self._in_progress.values())))

    @property
    def led_by(self) -> int:
        """Number of the newest order that takes the place of what led the vehicle before: an effective one, or one that
        ends a flight, whatever becomes of it."""
        return max(self.effective, self._ending_number)

    def flight_ended_since(self, number: int) -> bool:
        """True if an order that ends a flight has begun after this one."""
        return self._ending_number > number

    # -- modes

    def mode_accepted(self, custom_modes: frozenset[int], mode_changes: int, until: float) -> None:
        """Note that the vehicle has accepted a command of ours to one of these modes. ``mode_changes``: what its
        heartbeats had shown before that was sent (`Vehicle.mode_changes`). ``until``: by then they show the mode."""
        self._own_mode = _OwnMode(custom_modes, mode_changes, until)

    def is_own_mode(self, custom_mode: int, mode_changes: int, mode_since: float) -> bool:
        """True if the present mode of the vehicle is one that it has accepted from us: the first other one that its
        heartbeats have shown since the command was sent, in time, and not left since."""
        own = self._own_mode
        return custom_mode in own.custom_modes and mode_changes == own.mode_changes + 1 and mode_since <= own.until

    # -- armings

    def arming_begins(self, now: float) -> None:
        """Note a command that arms, sent from ``now`` on. It is in progress until `arming_ended`."""
        self._armings += 1
        self._arming_at = now

    def arming_ended(self, now: float, outcome: Outcome | None) -> None:
        """Note the outcome of one; None: its caller was cancelled. One that had no effect leaves what others, before it
        or beside it, may have."""
        self._armings -= 1
        if may_have_effect(outcome):
            self._armed_within = self._arming_at, now + RECENTLY_ARMED_S

    @property
    def arming(self) -> tuple[float, float]:
        """When an arming that may have had an effect was last sent, and until when it may have armed the vehicle before
        a heartbeat shows it; -inf: never."""
        return (self._arming_at, math.inf) if self._armings else self._armed_within


def may_have_effect(outcome: Outcome | None) -> bool:
    """True unless an order was not sent, or the vehicle has refused it. None: its caller was cancelled."""
    if outcome is None or outcome.ok:
        return True
    return outcome.attempts > 0 and outcome.result not in REFUSALS | {"refused"}


# --- the owner of a stream of setpoints -------------------------------------------------------------------------------

PAUSE_S = 1.0, 5.0
"""A client that has lost its stream begins a new one after a pause as long as its deadline, within these: more than a
joystick, a planner or MAVROS' users leave between two setpoints of one stream (2 Hz)."""

ORDERED = "another order was given"
"""How a client lost its stream to an order."""

MOST_TOLD = 16
"""Clients of which it is reported that they are refused beside one owner; more are counted."""


class ClientIdentity:
    """One client for as long as it is there: a connection of the socket, a program of the daemon, a companion's ground.
    Compared by identity."""

    __slots__ = ("_describe", "_name", "gone")

    def __init__(self, describe: Callable[[], str]) -> None:
        """``describe``: its name for people; called once, where it is first needed."""
        self.gone = False
        """True once it is not there any more (`leave`)."""
        self._describe: Callable[[], str] | None = describe
        self._name = "a client that has left"

    @property
    def name(self) -> str:
        """Its name for people."""
        if self._describe is not None:
            self._name, self._describe = self._describe(), None
        return self._name

    def leave(self) -> None:
        """It is not there any more; nothing of it is kept but its name, where that was needed. Idempotent."""
        self.gone, self._describe = True, None


class StreamOwner:
    """The owner of one vehicle's stream of setpoints. `refusal` before each of them, `followed` after it."""

    def __init__(self, ledger: OrderLedger) -> None:
        """``ledger``: the orders that end the stream (`OrderLedger.led_by`)."""
        self.refused = 0
        """Setpoints that were refused for another owner."""
        self._ledger = ledger
        self._client: ClientIdentity | None = None
        self._until = -math.inf
        """Deadline of the owner's newest setpoint."""
        self._valid_s = 0.0
        self._order = 0
        """Number of the order by which the vehicle was led before that."""
        self._lost: dict[ClientIdentity, tuple[float, str]] = {}
        """Clients that have lost their stream and still send: until when each has to pause, and how."""
        self._told: set[ClientIdentity] = set()
        """Clients of which it was reported that they are refused beside the present owner."""

    def alive(self, now: float) -> ClientIdentity | None:
        """The owner of the stream that is alive; None: anybody may begin one."""
        client = self._client
        if client is None or client.gone or not now <= self._until or self._order != self._ledger.led_by:
            return None
        return client

    def refusal(self, client: ClientIdentity, valid_s: float, now: float, *, take_over: bool) -> str | None:
        """Why a setpoint of this client, good for ``valid_s``, is not followed; None: it may be. Counts a refusal."""
        if client is self._client:
            if self._order == self._ledger.led_by:
                return None
            self.ended(ORDERED, now)
        why = None
        if (lost := self._lost.get(client)) is not None:
            until, how = lost
            if now <= until:
                pause_s = _pause_s(valid_s)
                self._lost[client] = now + pause_s, how
                why = f"{how}: this client may begin again after a pause of {pause_s:g} s, or when control is set again"
            else:
                del self._lost[client]
        if why is None and not take_over and (owner := self.alive(now)) is not None:
            valid = f"each valid for {self._valid_s:g} s"
            why = f"it follows the setpoints of {owner.name}, {valid}; take_over: true (--take-over) takes it over"
        self.refused += why is not None
        return why

    def is_new(self, client: ClientIdentity) -> bool:
        """True if this client, which was refused, was not before beside the present owner."""
        if client in self._told or len(self._told) >= MOST_TOLD:
            return False
        self._told.add(client)
        return True

    def followed(self, client: ClientIdentity, valid_s: float, now: float) -> ClientIdentity | None:
        """Note a setpoint that is followed. The client from which it takes a stream that is alive; None: from none."""
        before = None
        if client is not self._client:
            before = self.alive(now)
            self.ended(ORDERED if before is None else f"{client.name} has taken it over", now)
            self._client = client
            self._told.clear()
        self._until, self._valid_s, self._order = now + valid_s, valid_s, self._ledger.led_by
        return before

    def ended(self, how: str, now: float, *, spares: ClientIdentity | None = None) -> Callable[[], None]:
        """The stream has ended; its owner, unless its deadline had passed or it is ``spares``, has lost it. Call what
        is returned if nothing has come of what ended it: the owner goes on, unless another has begun."""
        client, self._client = self._client, None
        self._lost = {c: lost for c, lost in self._lost.items() if now <= lost[0] and not c.gone}
        if client is not None and client is not spares and not client.gone and now <= self._until:
            self._lost[client] = now + _pause_s(self._valid_s), how

        def goes_on() -> None:
            if client is not None and self._lost.pop(client, None) is not None and self._client is None:
                self._client = client

        return goes_on

    def engaged(self, now: float, *, anew: bool) -> None:
        """Control was set: where none leads it, one that has lost a stream may begin one. ``anew``: it was off."""
        if anew:
            self._client = None
        if self.alive(now) is None:
            self._lost.clear()
            self._told.clear()

    def status(self, now: float) -> dict[str, Any]:
        """The owner and the count of refusals, as control.status shows them."""
        owner = self.alive(now)
        stream = None if owner is None else {"client": owner.name, "left_s": round(self._until - now, 3)}
        return {"stream": stream, "setpoints_refused": self.refused}


def _pause_s(valid_s: float) -> float:
    return min(max(PAUSE_S[0], valid_s), PAUSE_S[1])
