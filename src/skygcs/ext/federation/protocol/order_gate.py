"""The home site's decision about an order from another station: each order is carried out at most once, in time, and
only by the site that commands the vehicle. Pure; times are seconds of the home site's clock, which never goes back.

    the order                                           what is done                status of the answer
    -------------------------------------------------   -------------------------   --------------------------------
    its key is known, still being carried out           its outcome is awaited      running, or that outcome
    its key is known, ended                             nothing                     that outcome, again
    its key is known, asked for before it came          nothing                     refused
    new, of a station whose role permits no orders      nothing                     refused
    new, a method or parameter for own vehicles only    nothing                     refused
    new, its deadline is more than MAX_AHEAD_S ahead    nothing                     refused: the clocks disagree
    new, after its deadline (stop: STOP_LATE_S after)   nothing                     late
    new, may be a copy of one from before the start     nothing (a stop is done)    refused
    new, may be a copy of one refused without record    nothing                     refused: too many
    new, a newer one of the same station came before    nothing (a stop is done)    refused
    new, another site commands the vehicle              nothing (a stop is done)    refused
    new, too many of its kind are being carried out     nothing                     refused
    any other new order                                 it is carried out           running, then its outcome

    the question for an outcome                         what is done                status of the answer
    -------------------------------------------------   -------------------------   --------------------------------
    its key is known                                    nothing                     as above
    its key is not known                                the key is noted            never came

A refusal is final: the key of a refused order is kept as well, so that a copy that comes later is not carried out after
the sender has received the refusal. "never came" is final for the same reason.

A key is kept at least until its order's deadline is over; a copy that comes after the deadline is late anyway. If a
station's share of the places is taken by younger keys, an order of it is refused and its key is not kept. Then every
unknown order of that station whose deadline is not after that of the refused one is refused, too, since it may be a
copy. Emergency stops have places of their own. Places are shared among stations (`fair_share`): one that sends without
end keeps no other one's orders out.
"""

from __future__ import annotations

import math
from collections import Counter, OrderedDict
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Literal

from skygcs.ext.federation.protocol.fair_share import FairShare
from skygcs.ext.federation.protocol.order_messages import (
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
"""Largest time to a deadline. Stations set the deadline about one second ahead; one further ahead than this comes from
a wrong clock."""

STOP_LATE_S = 5.0
"""An emergency stop is carried out up to this time after its deadline: a delayed stop still helps, but an older
one would stop a vehicle that has been started again since."""

KEEP_S = 3600.0
"""How long the outcome of an order can be asked for."""

MAX_KEYS, KEYS_FACTOR = 5120, 4.0
"""Keys that are kept, some 5 MB, and how many times the free ones a station may have: 4,096 if it is alone. A key may
not be forgotten for 16 s (MAX_AHEAD_S + STOP_LATE_S and 1 s): 256 orders a second fill them."""

STOP_KEYS = 2048
"""Further keys, for emergency stops only; a station may have as many as are free: 1,024 if it is alone."""

RUNNING_FACTOR = 4.0
"""Factor on the free places for running orders that one station may have: four of five places, if it is alone."""

MAX_RUNNING = 60
"""Orders carried out at the same time, 48 of one station; a daemon takes 64 requests of one client."""

MAX_ENDING = 400
"""The same limit for orders that end a flight, 320 of one station: one for each vehicle that a daemon can have, and
some to spare."""

MAX_STOPS = 400
"""The same limit for emergency stops, which no other order may keep out."""

ASKED = "questions"
"""The sender of questions for orders that never came: they share one share."""

_Kind = Literal["stop", "ending", "other"]


@dataclass(frozen=True, slots=True)
class Begin:
    """Carry the order out now, and call `OrderGate.ended` with its outcome."""


@dataclass(frozen=True, slots=True)
class Refuse:
    """Do not carry the order out; ``reply`` says why."""

    reply: OrderReply


@dataclass(frozen=True, slots=True)
class Repeated:
    """The same order came before. ``reply``: its present status."""

    reply: OrderReply


Decision = Begin | Refuse | Repeated


@dataclass(frozen=True, slots=True)
class Remembered:
    """An order as the record has it, for `OrderGate.restore`. ``noted_s``: time of the record. The other fields are
    those of `OrderRequest`."""

    reply: OrderReply
    deadline_s: float
    noted_s: float
    vehicle: str = ""
    run: str = ""
    seq: int = 0
    sender: str = ""


@dataclass(slots=True)
class _Known:
    reply: OrderReply
    forget_after_s: float
    """The earliest time at which the key may be forgotten."""
    noted_s: float
    kind: _Kind = "other"
    sender: str = ""


class OrderGate:
    """The keys of the orders of one site, and the decision about each. ``site``: its name, for texts."""

    def __init__(self, site: str, now_s: float, *, no_order_before_s: float = -math.inf) -> None:
        """``no_order_before_s``: orders whose deadline is not after it are refused, because the orders carried out
        before this start are not known."""
        self.counters: Counter[str] = Counter()
        """Number of orders by decision, of questions, and of forgotten keys."""
        self._site = site
        self._known: OrderedDict[str, _Known] = OrderedDict()
        self._no_order_before_s = no_order_before_s
        self._unrecorded_until_s: OrderedDict[tuple[str, bool], float] = OrderedDict()
        """By sender, and True for stops: latest deadline of an order that was refused without keeping its key."""
        self._remembers_since_s = now_s
        self._newest = _NewestOrders()
        self._keys = {False: FairShare(MAX_KEYS, KEYS_FACTOR), True: FairShare(STOP_KEYS)}
        """The places of keys: True for stops, False for others."""
        self._running: dict[_Kind, FairShare] = {
            "stop": FairShare(MAX_STOPS, RUNNING_FACTOR),
            "ending": FairShare(MAX_ENDING, RUNNING_FACTOR),
            "other": FairShare(MAX_RUNNING, RUNNING_FACTOR),
        }
        """The places of orders that are carried out."""

    def __len__(self) -> int:
        return len(self._known)

    def restore(self, records: Iterable[Remembered], *, complete: bool) -> None:
        """Take over the decisions from before this start, oldest first; a later record of an order replaces an earlier
        one. An order without an outcome becomes "unknown". ``complete``: True if there were no older records."""
        if complete:
            self._remembers_since_s = -math.inf
        for record in records:
            reply = record.reply
            if reply.status == "running":
                text = f"{self._site} restarted while it was carried out; look at the vehicle"
                reply = OrderReply(reply.key, "unknown", text)
                self._newest.note((record.sender, record.run, record.vehicle), record.seq)
            self._pop(reply.key)
            self._keep(reply.key, _Known(reply, record.deadline_s + STOP_LATE_S, record.noted_s, sender=record.sender))
            if len(self._known) > MAX_KEYS:
                self._forget(next(iter(self._known)))
        self.counters["restored"] = len(self._known)
        if not complete:
            oldest_s = min((known.noted_s for known in self._known.values()), default=math.inf)
            self._remembers_since_s = min(self._remembers_since_s, oldest_s)

    def forget_before(self, now_s: float) -> None:
        """Note that what came before is not known in full: another bridge took orders of this site. No question for an
        order of that time is answered with "never came"."""
        self._remembers_since_s = max(self._remembers_since_s, now_s)

    def admit(self, request: OrderRequest, now_s: float, *, not_held: str | None = None) -> Decision:
        """Decide about an order. ``not_held``: why this site does not command the vehicle; None if it does."""
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
        is_stop, kind = request.method == STOP, _kind(request.method)
        deadline_s = min(request.deadline_s, now_s + MAX_AHEAD_S)
        if not self._has_room(now_s, request.sender, stop=is_stop):
            self._note_unrecorded(request.sender, is_stop, deadline_s)
            return Refuse(reply)
        self._keep(request.key, _Known(reply, deadline_s + STOP_LATE_S, now_s, kind, request.sender))
        if status != "running":
            return Refuse(reply)
        self._running[kind].take(request.sender)
        self._newest.note(_series(request), request.seq)
        return Begin()

    def ended(self, reply: OrderReply, now_s: float) -> None:
        """An order has ended with this reply. Call it once for every `Begin`."""
        known = self._known.get(reply.key)
        if known is None or known.reply.status != "running":
            return
        known.reply, known.noted_s = reply, now_s
        self._running[known.kind].give_back(known.sender)
        self.counters[reply.status] += 1

    def asked(self, question: OutcomeQuestion, now_s: float) -> OrderReply:
        """Answer a question for an outcome. An order that has not come is refused from now on."""
        self.counters["asked"] += 1
        key = question.key
        known = self._known.get(key)
        if known is not None:
            return known.reply
        if not self._has_room(now_s, ASKED):
            return OrderReply(key, "unknown", f"{self._site} has too many orders to say; ask again")
        memory_s = now_s - self._remembers_since_s
        if question.deadline_s is not None and question.deadline_s - MAX_AHEAD_S <= self._remembers_since_s:
            return OrderReply(key, "unknown", f"{self._site} remembers orders of the last {memory_s:.0f} s only")
        reach = f" in the last {memory_s:.0f} s" if math.isfinite(memory_s) else ""
        text = f"no such order has come to {self._site}{reach}; it is refused if it comes now"
        reply = OrderReply(key, "never came", text)
        self._keep(key, _Known(reply, now_s + MAX_AHEAD_S + STOP_LATE_S, now_s, sender=ASKED))
        return reply

    def known(self, key: str) -> OrderReply | None:
        """The present reply about an order; None if its key is not known."""
        known = self._known.get(key)
        return None if known is None else known.reply

    # -- private

    def _refusal(self, request: OrderRequest, now_s: float, not_held: str | None) -> tuple[Status, str] | None:
        """Why an order with a new key is not carried out, apart from limits; None if it may be."""
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
        if not is_stop and 0 < request.seq < self._newest.of(_series(request)):
            return "refused", "a newer order of the same station came before it"
        if not_held is not None and not is_stop:
            return "refused", not_held
        return None

    def _full(self, request: OrderRequest, now_s: float) -> tuple[Status, str] | None:
        """Why the limits do not permit a further order; None if they do."""
        kind = _kind(request.method)
        running, sender = self._running[kind], request.sender
        if not running.has_room(sender):
            own = running.of(sender)
            return "refused", f"{len(running)} orders are being carried out at {self._site}, {own} of this station"
        is_stop = request.method == STOP
        unrecorded_until_s = self._unrecorded_until_s.get((sender, is_stop), -math.inf)
        if not self._has_room(now_s, sender, stop=is_stop) or request.deadline_s <= unrecorded_until_s:
            return "refused", f"{self._site} has had too many orders of this station in the last seconds"
        return None

    def _note_unrecorded(self, sender: str, stop: bool, deadline_s: float) -> None:
        """Bounded: of more stations than there are keys the one noted first is forgotten, whose orders are late."""
        before_s = self._unrecorded_until_s.pop((sender, stop), -math.inf)
        self._unrecorded_until_s[sender, stop] = max(before_s, deadline_s)
        if len(self._unrecorded_until_s) > MAX_KEYS:
            self._unrecorded_until_s.popitem(last=False)

    def _keep(self, key: str, known: _Known) -> None:
        self._known[key] = known
        self._keys[known.kind == "stop"].take(known.sender)

    def _pop(self, key: str) -> _Known | None:
        known = self._known.pop(key, None)
        if known is not None:
            self._keys[known.kind == "stop"].give_back(known.sender)
        return known

    def _has_room(self, now_s: float, sender: str, *, stop: bool = False) -> bool:
        """Forget keys that are over; True if there is room for one more of this sender."""
        while self._known:
            key, known = next(iter(self._known.items()))
            if known.reply.status == "running" or now_s - known.noted_s < KEEP_S:
                break
            self._forget(key)
        places = self._keys[stop]
        if places.has_room(sender):
            return True
        # the oldest that may be forgotten; those before them are running or young, and running ones are few
        over: list[str] = []
        for key, known in self._known.items():
            if known.reply.status == "running" or (known.kind == "stop") is not stop:
                continue
            if now_s <= known.forget_after_s:
                break
            over.append(key)
        for key in over:
            self._forget(key)
            if places.has_room(sender):
                return True
        return False

    def _forget(self, key: str) -> None:
        known = self._pop(key)
        assert known is not None
        self._remembers_since_s = max(self._remembers_since_s, known.noted_s)
        self.counters["forgotten"] += 1


def _kind(method: str) -> _Kind:
    """Orders of one kind share their places among those that are carried out."""
    if method == STOP:
        return "stop"
    return "ending" if method in ENDS_FLIGHT else "other"


_Series = tuple[str, str, str]
"""Sender, its run, vehicle: orders that overtake each other."""


def _series(request: OrderRequest) -> _Series:
    return request.sender, request.run, request.vehicle


class _NewestOrders:
    """The highest number of an order that was carried out, for each station's key, run and vehicle. The run alone would
    not do: the record on the bus shows it to all stations, and another one could send it."""

    def __init__(self) -> None:
        self._numbers: OrderedDict[_Series, int] = OrderedDict()

    def of(self, series: _Series) -> int:
        return self._numbers.get(series, 0)

    def note(self, series: _Series, seq: int) -> None:
        """Note an order that is carried out. Beyond MAX_KEYS the oldest entry is dropped: an order that another one
        overtook comes within a second, or is late."""
        newest = max(seq, self._numbers.pop(series, 0))
        self._numbers[series] = newest
        if len(self._numbers) > MAX_KEYS:
            self._numbers.popitem(last=False)


def _params_problem(request: OrderRequest) -> str | None:
    """The problem with a parameter whose meaning differs between sites; None without one."""
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
