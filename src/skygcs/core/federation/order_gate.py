"""The home site's decision about an order that another station sends: each is carried out once, in time, by the site
that commands the vehicle. Pure; times are seconds of the home site's clock, which never goes back.

    the order that came                                 what is done                status of the answer
    -------------------------------------------------   -------------------------   --------------------------------
    its key is known, still being carried out           its outcome is awaited      running, or that outcome
    its key is known, ended                             nothing                     that outcome, again
    its key is known, asked for before it came          nothing                     refused
    new, of a station that gives no orders              nothing                     refused
    new, a method or parameter that does not travel     nothing                     refused
    new, its deadline is more than MAX_AHEAD_S ahead    nothing                     refused: the clocks disagree
    new, after its deadline (stop: STOP_LATE_S after)   nothing                     late
    new, while orders before this start may come        nothing (a stop is done)    refused
    new, while orders were refused without a record     nothing                     refused: too many
    new, a newer one of the same station came before    nothing (a stop is done)    refused
    new, another site commands the vehicle              nothing (a stop is done)    refused
    new, too many are being carried out                 nothing                     refused
    new                                                 it is carried out           running, then its outcome

    the question for an outcome                         what is done                status of the answer
    -------------------------------------------------   -------------------------   --------------------------------
    its key is known                                    nothing                     as above
    its key is not known                                the key is noted            never came

A refusal is final: its key is kept as well, so that a copy that comes later is not carried out after the sender was
told of the refusal. "never came" is final for the same reason.

A key is kept until it may be forgotten: at the earliest when its deadline is over, from when on a copy is late anyway.
With all places taken by keys that are younger, an order is refused without a record; then every unknown order with
a deadline up to that of the refused one is refused, too, since it may be its copy. Emergency stops have places of their
own beyond.
"""

from __future__ import annotations

import math
from collections import Counter, OrderedDict
from collections.abc import Iterable
from dataclasses import dataclass

from skygcs.core.federation.order_messages import (
    ENDS_FLIGHT,
    METHODS,
    STOP,
    OrderReply,
    OrderRequest,
    OutcomeQuestion,
    Status,
)

ORDERING_ROLES = frozenset({"site", "operator"})

MAX_AHEAD_S = 10.0
"""Stations give an order one second. A deadline further ahead comes from a clock that is wrong."""

STOP_LATE_S = 5.0
"""An emergency stop is carried out so long after its deadline: it is never too much, but an old one would stop a
vehicle that has been started again since."""

KEEP_S = 3600.0
"""Outcomes are kept for questions."""

MAX_KEYS = 4096
"""Some 4 MB. An order every ms for the 16 s in which a key may not be forgotten does not fill it."""

STOP_KEYS = 512
"""Further keys for emergency stops only."""

MAX_RUNNING = 60
"""Orders that are carried out at a time; a daemon takes 64 of one client."""

MAX_ENDING = 320
"""As MAX_RUNNING, of orders that end a flight: one for each vehicle that a daemon can have."""


@dataclass(frozen=True, slots=True)
class Begin:
    """The order is to be carried out now; `OrderGate.ended` is to be called with its outcome."""


@dataclass(frozen=True, slots=True)
class Refuse:
    """It is not carried out."""

    reply: OrderReply


@dataclass(frozen=True, slots=True)
class Repeated:
    """It came before; ``reply``: what is known of it."""

    reply: OrderReply


Decision = Begin | Refuse | Repeated


@dataclass(frozen=True, slots=True)
class Remembered:
    """What a record says of an order, for `OrderGate.restore`; see `OrderRequest`. ``noted_s``: when it was made."""

    reply: OrderReply
    deadline_s: float
    noted_s: float
    vehicle: str = ""
    run: str = ""
    seq: int = 0


@dataclass(slots=True)
class _Known:
    reply: OrderReply
    forget_after_s: float
    """The earliest time at which the key may be forgotten."""
    noted_s: float
    ends_flight: bool = False


class OrderGate:
    """The keys of one site. ``site``: its name, for texts."""

    def __init__(self, site: str, now_s: float, *, no_order_before_s: float = -math.inf) -> None:
        """``no_order_before_s``: orders with a deadline up to then are refused, since what was carried out before
        this start is not known."""
        self.counters: Counter[str] = Counter()
        """Orders by what was decided; questions; keys that were forgotten."""
        self._site = site
        self._known: OrderedDict[str, _Known] = OrderedDict()
        self._no_order_before_s = no_order_before_s
        self._unrecorded_until_s = {True: -math.inf, False: -math.inf}
        """The latest deadline of an order that was refused without a record: of stops, and of others."""
        self._remembers_since_s = now_s
        self._newest = _NewestOrders()
        self._running = {True: 0, False: 0}
        """Orders being carried out, by whether they end a flight."""

    def __len__(self) -> int:
        return len(self._known)

    def restore(self, records: Iterable[Remembered], *, complete: bool) -> None:
        """What was decided before this start, oldest first; a later record of an order replaces an earlier one. One
        without an outcome is "unknown" from now on. ``complete``: there were no older records."""
        if complete:
            self._remembers_since_s = -math.inf
        for record in records:
            reply = record.reply
            if reply.status == "running":
                text = f"{self._site} restarted while it was carried out; look at the vehicle"
                reply = OrderReply(reply.key, "unknown", text)
                self._newest.note(record.run, record.vehicle, record.seq)
            self._known.pop(reply.key, None)
            self._known[reply.key] = _Known(reply, record.deadline_s + STOP_LATE_S, record.noted_s)
            if len(self._known) > MAX_KEYS:
                self._forget(next(iter(self._known)))
        self.counters["restored"] = len(self._known)
        if not complete:
            oldest_s = min((known.noted_s for known in self._known.values()), default=math.inf)
            self._remembers_since_s = min(self._remembers_since_s, oldest_s)

    def admit(self, request: OrderRequest, now_s: float, *, not_held: str | None = None) -> Decision:
        """What becomes of an order. ``not_held``: why this site does not command the vehicle; None if it does."""
        known = self._known.get(request.key)
        if known is not None:
            self.counters["repeated"] += 1
            if known.reply.status == "never came":
                text = "its outcome was asked before it came; it is not carried out"
                return Repeated(OrderReply(request.key, "refused", text))
            return Repeated(known.reply)
        status, why = self._refusal(request, now_s, not_held) or self._full(request, now_s) or ("running", "")
        self.counters[status] += 1
        reply = OrderReply(request.key, status, why)
        is_stop, ends_flight = request.method == STOP, request.method in ENDS_FLIGHT
        deadline_s = min(request.deadline_s, now_s + MAX_AHEAD_S)
        if not self._has_room(now_s, stop=is_stop):
            self._unrecorded_until_s[is_stop] = max(self._unrecorded_until_s[is_stop], deadline_s)
            return Refuse(reply)
        self._known[request.key] = _Known(reply, deadline_s + STOP_LATE_S, now_s, ends_flight)
        if status != "running":
            return Refuse(reply)
        self._running[ends_flight] += 1
        self._newest.note(request.run, request.vehicle, request.seq)
        return Begin()

    def ended(self, reply: OrderReply, now_s: float) -> None:
        """An order that was to `Begin` has ended with this reply. Every `Begin` needs one."""
        known = self._known.get(reply.key)
        if known is None or known.reply.status != "running":
            return
        known.reply, known.noted_s = reply, now_s
        self._running[known.ends_flight] -= 1
        self.counters[reply.status] += 1

    def asked(self, question: OutcomeQuestion, now_s: float) -> OrderReply:
        """What became of an order. One that has not come is refused from now on."""
        self.counters["asked"] += 1
        key = question.key
        known = self._known.get(key)
        if known is not None:
            return known.reply
        if not self._has_room(now_s):
            return OrderReply(key, "unknown", f"{self._site} has too many orders to say; ask again")
        memory_s = now_s - self._remembers_since_s
        if question.deadline_s is not None and question.deadline_s - MAX_AHEAD_S <= self._remembers_since_s:
            return OrderReply(key, "unknown", f"{self._site} remembers orders of the last {memory_s:.0f} s only")
        reach = f" in the last {memory_s:.0f} s" if math.isfinite(memory_s) else ""
        text = f"no such order has come to {self._site}{reach}; it is refused if it comes now"
        reply = OrderReply(key, "never came", text)
        self._known[key] = _Known(reply, now_s + MAX_AHEAD_S + STOP_LATE_S, now_s)
        return reply

    def known(self, key: str) -> OrderReply | None:
        """What is known of an order; None if nothing is."""
        known = self._known.get(key)
        return None if known is None else known.reply

    # -- the inside

    def _refusal(self, request: OrderRequest, now_s: float, not_held: str | None) -> tuple[Status, str] | None:
        """Why an order with a new key is not carried out; None if nothing is against it but room."""
        is_stop = request.method == STOP
        late_s = now_s - request.deadline_s
        if request.role not in ORDERING_ROLES:
            return "refused", f"a station with the role {request.role!r} gives no orders"
        if request.method not in METHODS:
            return "refused", f"{request.method} is not taken from another station; give it at {self._site}"
        if (problem := _params_problem(request)) is not None:
            return "refused", f"{problem}; give it at {self._site}"
        if late_s < -MAX_AHEAD_S:
            return "refused", f"its deadline is {-late_s:.0f} s ahead, at most {MAX_AHEAD_S:g}: the clocks disagree"
        if late_s > (STOP_LATE_S if is_stop else 0.0):
            return "late", f"it came {late_s:.1f} s after its deadline; it was not carried out"
        if not is_stop and request.deadline_s <= self._no_order_before_s:
            return "refused", f"{self._site} has just started and could not read what it carried out before"
        if not is_stop and 0 < request.seq < self._newest.of(request.run, request.vehicle):
            return "refused", "a newer order of the same station came before it"
        if not_held is not None and not is_stop:
            return "refused", not_held
        return None

    def _full(self, request: OrderRequest, now_s: float) -> tuple[Status, str] | None:
        """Why there is no room for an order."""
        ends_flight = request.method in ENDS_FLIGHT
        most = MAX_ENDING if ends_flight else MAX_RUNNING
        if self._running[ends_flight] >= most:
            return "refused", f"{most} orders are being carried out at {self._site}"
        is_stop = request.method == STOP
        if not self._has_room(now_s, stop=is_stop) or request.deadline_s <= self._unrecorded_until_s[is_stop]:
            return "refused", f"{self._site} has had too many orders in the last seconds"
        return None

    def _has_room(self, now_s: float, *, stop: bool = False) -> bool:
        """Forget what may be forgotten; True if there is room for one more key."""
        while self._known:
            key, known = next(iter(self._known.items()))
            if known.reply.status == "running" or now_s - known.noted_s < KEEP_S:
                break
            self._forget(key)
        if len(self._known) < MAX_KEYS:
            return True
        # the oldest that may be forgotten; those before it are running or young, and running ones are few
        for key, known in self._known.items():
            if known.reply.status == "running":
                continue
            if now_s <= known.forget_after_s:
                break
            self._forget(key)
            return True
        return stop and len(self._known) < MAX_KEYS + STOP_KEYS

    def _forget(self, key: str) -> None:
        self._remembers_since_s = max(self._remembers_since_s, self._known.pop(key).noted_s)
        self.counters["forgotten"] += 1


class _NewestOrders:
    """The highest number of an order that was carried out, by the sender's run and the vehicle."""

    def __init__(self) -> None:
        self._numbers: OrderedDict[tuple[str, str], int] = OrderedDict()

    def of(self, run: str, vehicle: str) -> int:
        return self._numbers.get((run, vehicle), 0)

    def note(self, run: str, vehicle: str, seq: int) -> None:
        """The oldest makes room: an order is overtaken within a second or is late."""
        newest = max(seq, self._numbers.pop((run, vehicle), 0))
        self._numbers[run, vehicle] = newest
        if len(self._numbers) > MAX_KEYS:
            self._numbers.popitem(last=False)


def _params_problem(request: OrderRequest) -> str | None:
    """A parameter that has another meaning here than where it was typed."""
    params = request.params
    if "targets" in params:
        return "an order that travels names its vehicle in the subject"
    if params.get("together") is not None:
        return "together: the vehicles of one site are kept apart by that site"
    if params.get("enu_m") is not None:
        return "enu_m is in metres from this site's origin, which is not that of the sender: send lat_deg and lon_deg"
    if params.get("wait_s"):
        return "wait_s: an order would be carried out long after it was given"
    return None
