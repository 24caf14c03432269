"""Queue of what waits to be sent on one link, in which order and how fast: strict classes, vehicles share a class
equally, every class with a bound and a policy, all of it within a budget of bytes. What
waits is received bytes (`Outgoing`), or a message of our own (`OwnMessage`).

Pure: the sender (shell) offers, asks when the next may go and what it is, and writes. How large the budget is decides
`core.radio_link.pacing`.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Hashable
from dataclasses import dataclass, field
from enum import IntEnum
from typing import Any, Generic, TypeVar

from skygcs.core.mavlink.dialect import MessageInfo
from skygcs.core.mavlink.frame import Frame, encode_payload
from skygcs.core.mavlink.msgids import SETUP_SIGNING
from skygcs.core.token_bucket import TokenBucket


class OwnMessage:
    """A message of our own for one or more channels. It gets its sequence number when it is written, so that one that
    was dropped or replaced while it waited does not look like a loss to the vehicle."""

    __slots__ = ("compid", "exempt", "info", "payload", "recorded", "sysid", "to_system")

    def __init__(self, info: MessageInfo, payload: bytes, sysid: int, compid: int) -> None:
        self.info = info
        self.payload = payload
        self.sysid = sysid
        self.compid = compid
        self.to_system = 0
        """The system it was sent to, also if the message has no target field; 0: not known, or all."""
        self.exempt = False
        """It is of vehicles.stop, which is sent without authority over the vehicle, too."""
        self.recorded = info.msgid == SETUP_SIGNING
        """It must not be recorded (any more): it was, or it holds a key."""

    def encode(self, seq: int, version: int) -> bytes:
        """The frame for one channel. An id above 255 is sent as MAVLink 2 whatever the channel prefers."""
        if self.info.msgid > 255:
            version = 2
        return encode_payload(self.info, self.payload, sysid=self.sysid, compid=self.compid, seq=seq, version=version)


Outgoing = bytes | Frame | OwnMessage
"""Received bytes forwarded as they are (into a radio the frame, which admission looks into), or our own message."""

T = TypeVar("T")

HEARTBEAT_WAITS_S = 1.0
"""A heartbeat that waited so long goes before everything but an emergency. Without our heartbeats a vehicle's ground
station failsafe takes over (ArduPilot: after 5 s), and no flood of anything else may bring that about."""

WAITS_KEPT = 256
"""Waits per class of which the percentiles are taken: the last ones."""


MAX_LEFT = 512
"""Flows without anything waiting that a class remembers: more than there are system ids."""


class Priority(IntEnum):
    """Order of service on a link, most urgent first (docs/explanation/airtime.md)."""

    EMERGENCY = 0
    COMMAND = 1
    POSE = 2
    SETPOINT = 3
    PROTOCOL = 4
    HEARTBEAT = 5
    CORRECTION = 6
    FORWARDED = 7


BOUND: dict[Priority, int] = {
    Priority.EMERGENCY: 256,  # never fewer than vehicles in a fleet: a stop for each of 250 fits
    Priority.COMMAND: 256,
    Priority.POSE: 256,  # one per vehicle, the newest
    Priority.SETPOINT: 256,  # one per vehicle, the newest
    Priority.PROTOCOL: 256,
    Priority.HEARTBEAT: 4,
    Priority.CORRECTION: 16,  # 16 fragments of 180 B are three seconds of RTCM; older ones are worthless
    Priority.FORWARDED: 128,  # at 57600 baud some 5 kB: almost a second of air
}
"""Most entries waiting per class."""

DROPS_OLDEST = frozenset({Priority.HEARTBEAT, Priority.CORRECTION, Priority.FORWARDED})
"""Classes whose newest entry is worth more than their oldest; the others refuse when full, and the sender retries."""

RESERVED_SHARE = 0.5
"""Part of the burst kept for emergencies, commands and an overdue heartbeat: they find it filled on a busy link,
and so leave at once. Everything else is sent from the other half."""


class Waits:
    """How long the last entries of a class waited."""

    __slots__ = ("_last",)

    def __init__(self) -> None:
        self._last: deque[float] = deque(maxlen=WAITS_KEPT)

    def add(self, wait_s: float) -> None:
        self._last.append(wait_s)

    def percentile(self, share: float) -> float | None:
        """Seconds that this share of them waited at most; None if nothing was sent yet."""
        if not self._last:
            return None
        ordered = sorted(self._last)
        return ordered[min(len(ordered) - 1, int(share * len(ordered)))]


@dataclass(slots=True)
class ClassCounters:
    """Counts of what became of the entries of one class."""

    sent: int = 0
    sent_bytes: int = 0
    replaced: int = 0
    dropped: int = 0
    refused: int = 0
    waits: Waits = field(default_factory=Waits)

    def as_dict(self) -> dict[str, Any]:
        p50, p95 = self.waits.percentile(0.5), self.waits.percentile(0.95)
        return {
            "sent": self.sent,
            "sent_bytes": self.sent_bytes,
            "replaced": self.replaced,
            "dropped": self.dropped,
            "refused": self.refused,
            "wait_p50_s": None if p50 is None else round(p50, 4),
            "wait_p95_s": None if p95 is None else round(p95, 4),
        }


Waiting = tuple[T, int, float, int]
"""An entry, its bytes, since when it waits, and the bytes of its answer."""


class _Class(Generic[T]):
    """The entries of one class: a line per flow, first in first out; the flow that was sent fewest bytes goes next."""

    __slots__ = ("_clock", "_left", "_used", "length", "lines")

    def __init__(self) -> None:
        self.lines: dict[Hashable, dict[Hashable, Waiting[T]]] = {}
        """In order of arrival. An entry without a key stands under a serial number, one with a key under (key,)."""
        self._used: dict[Hashable, float] = {}
        """Bytes sent of each flow with entries, on a clock at which later flows begin: one that was silent for an hour
        has not saved up an hour."""
        self._left: dict[Hashable, float] = {}
        """The same of flows that have nothing waiting any more."""
        self._clock = 0.0
        self.length = 0

    def add(self, flow: Hashable, slot: Hashable, entry: Waiting[T]) -> None:
        line = self.lines.get(flow)
        if line is None:
            line = self.lines[flow] = {}
            self._used[flow] = max(self._clock, self._left.pop(flow, 0.0))
        line[slot] = entry
        self.length += 1

    def next_flow(self) -> Hashable:
        if len(self.lines) == 1:
            (flow,) = self.lines
            return flow
        return min(self._used, key=self._used.__getitem__)  # of equals the one that waits longest

    def head(self) -> Waiting[T]:
        """Return what goes next. Only where something waits."""
        return next(iter(self.lines[self.next_flow()].values()))

    def take(self) -> Waiting[T]:
        flow = self.next_flow()
        line = self.lines[flow]
        entry = line.pop(next(iter(line)))
        self.length -= 1
        used = self._used.pop(flow)
        self._clock = used  # that of the flow in service: a flow that comes now begins here
        if line:
            self._used[flow] = used + entry[1]  # at the end: of equals it is the last
        else:
            del self.lines[flow]
            self._leave(flow, used + entry[1])
        return entry

    def drop_oldest(self) -> None:
        """Drop from the flow with most waiting: a flood loses its own entries."""
        lines = self.lines
        flow = next(iter(lines)) if len(lines) == 1 else max(lines, key=lambda f: len(lines[f]))
        line = lines[flow]
        del line[next(iter(line))]
        self.length -= 1
        if not line:
            del lines[flow]
            self._leave(flow, self._used.pop(flow))

    def drop(self, unwanted: Callable[[T], bool]) -> int:
        """How many of them waited."""
        before = self.length
        for flow, line in list(self.lines.items()):
            for slot in [slot for slot, (entry, *_) in line.items() if unwanted(entry)]:
                del line[slot]
                self.length -= 1
            if not line:
                del self.lines[flow]
                self._leave(flow, self._used.pop(flow))
        return before - self.length

    def clear(self) -> int:
        gone, self.length = self.length, 0
        self.lines.clear()
        self._used.clear()
        self._left.clear()
        self._clock = 0.0
        return gone

    def _leave(self, flow: Hashable, used: float) -> None:
        """The flow has nothing more for now; what it was sent is remembered while others wait, so that one which comes
        again after each entry has no advantage."""
        if not self.lines:
            self._left.clear()
            self._clock = 0.0
            return
        self._left[flow] = used
        if len(self._left) > MAX_LEFT:
            self._left = {f: u for f, u in self._left.items() if u > self._clock}


class TxQueue(Generic[T]):
    """Bounded, prioritised queue of one link. Entries with a ``key`` replace the waiting one of the same key.

    ``budget``: what may be sent; None: as much as the writer takes. ``forwarded``: what the last class may have of it;
    None: what the others leave. ``counters`` by class.
    """

    __slots__ = ("_classes", "_heartbeat_since", "_length", "_serial", "budget", "counters", "forwarded")

    def __init__(self, budget: TokenBucket | None = None) -> None:
        self.budget = budget
        self.forwarded: TokenBucket | None = None
        self.counters: dict[Priority, ClassCounters] = {p: ClassCounters() for p in Priority}
        self._classes: dict[Priority, _Class[T]] = {p: _Class() for p in Priority}
        self._serial = 0
        self._length = 0
        self._heartbeat_since: float | None = None
        """Since when heartbeats wait and none was sent; None: none waits."""

    def __len__(self) -> int:
        return self._length

    def waiting(self, priority: Priority) -> int:
        """Entries of a class that wait now."""
        return self._classes[priority].length

    def holds(self, priority: Priority, flow: Hashable, key: Hashable) -> bool:
        """True if an entry of this class, flow and key waits: one that is offered now would take its place."""
        line = self._classes[priority].lines.get(flow)
        return line is not None and (key,) in line

    def offer(
        self,
        entry: T,
        priority: Priority,
        now: float,
        key: Hashable | None = None,
        *,
        size: int = 0,
        flow: Hashable = None,
        answer_bytes: int = 0,
    ) -> bool:
        """Queue it; False if its class is full and refuses. Never blocks, never raises.

        With a key the newest value takes the place of the waiting one (latest wins), keeping that one's turn. ``size``
        is what it takes of the budget. ``flow`` is its receiver: flows of a class share bandwidth equally.
        ``answer_bytes`` is what it brings down; the budget of the last class is charged for it as well.
        """
        counters = self.counters[priority]
        of_class = self._classes[priority]
        if priority is Priority.HEARTBEAT and not of_class.length:
            self._heartbeat_since = now
        # the newest takes the place of a waiting one with its key
        slot: Hashable
        if key is not None:
            slot = (key,)
            line = of_class.lines.get(flow)
            if line is not None and slot in line:
                line[slot] = (entry, size, now, answer_bytes)
                counters.replaced += 1
                return True
        else:
            slot = self._serial = self._serial + 1
        # a full class drops its oldest, or refuses
        if of_class.length >= BOUND[priority]:
            if priority not in DROPS_OLDEST:
                counters.refused += 1
                return False
            of_class.drop_oldest()
            self._length -= 1
            counters.dropped += 1
        of_class.add(flow, slot, (entry, size, now, answer_bytes))
        self._length += 1
        return True

    def pop(self, now: float) -> tuple[T, Priority] | None:
        """The most urgent entry, oldest first within a class and flow; None when nothing waits or the budget is spent.

        A heartbeat that has waited for HEARTBEAT_WAITS_S is second to emergencies only. Nothing overtakes an entry
        that waits for the budget, but what is more urgent.
        """
        priority = self._next_class(now)
        if priority is None:
            return None
        of_class = self._classes[priority]
        if self.budget is not None:
            size = of_class.head()[1]
            if self.budget.ready_at(size, now, reserve=self._reserve(priority, now)) > now:
                return None
            self.budget.spend(size, now)
        if priority is Priority.FORWARDED and self.forwarded is not None:
            self.forwarded.spend(_charge(of_class.head()), now)
        entry, size, since, _ = of_class.take()
        self._length -= 1
        counters = self.counters[priority]
        counters.sent += 1
        counters.sent_bytes += size
        counters.waits.add(now - since)
        if priority is Priority.HEARTBEAT:
            self._heartbeat_since = now if of_class.length else None
        return entry, priority

    def next_send_time(self, now: float) -> float | None:
        """From when `pop` gives something, if nothing more is offered: ``now`` if at once, None if nothing waits."""
        priority = self._next_class(now)
        if priority is None:
            last = self._classes[Priority.FORWARDED]
            return self.forwarded.ready_at(_charge(last.head()), now) if last.length and self.forwarded else None
        if self.budget is None:
            return now
        size = self._classes[priority].head()[1]
        at = self.budget.ready_at(size, now, reserve=self._reserve(priority, now))
        since = self._heartbeat_since
        if since is not None and priority is not Priority.EMERGENCY and at >= since + HEARTBEAT_WAITS_S > now:
            heartbeat = self._classes[Priority.HEARTBEAT].head()[1]  # is overdue by then, and next
            return max(since + HEARTBEAT_WAITS_S, self.budget.ready_at(heartbeat, now))
        return at

    def drop(self, priority: Priority, unwanted: Callable[[T], bool]) -> int:
        """Forget what waits of one class and is no longer wanted; how many that were. Counted as dropped."""
        gone = self._classes[priority].drop(unwanted)
        self._length -= gone
        self.counters[priority].dropped += gone
        if priority is Priority.HEARTBEAT and not self._classes[priority].length:
            self._heartbeat_since = None
        return gone

    def clear(self) -> int:
        """Forget everything that waits (the link went down); how many that were. Counted as dropped."""
        gone = self._length
        for priority, of_class in self._classes.items():
            self.counters[priority].dropped += of_class.clear()
        self._length = 0
        self._heartbeat_since = None
        return gone

    def status(self) -> dict[str, dict[str, Any]]:
        """Counters of every class by its name, and what waits."""
        return {p.name.lower(): {"waiting": self._classes[p].length, **self.counters[p].as_dict()} for p in Priority}

    def _next_class(self, now: float) -> Priority | None:
        if not self._length:
            return None
        for priority, of_class in self._classes.items():
            if of_class.length:
                if self._heartbeat_since is not None and priority is not Priority.EMERGENCY and self._overdue(now):
                    return Priority.HEARTBEAT
                if priority is Priority.FORWARDED and self.forwarded is not None:
                    return priority if self.forwarded.ready_at(_charge(of_class.head()), now) <= now else None
                return priority
        return None

    def _overdue(self, now: float) -> bool:
        since = self._heartbeat_since
        return since is not None and now >= since + HEARTBEAT_WAITS_S

    def _reserve(self, priority: Priority, now: float) -> float:
        """Bytes of the budget that an entry of this class has to leave."""
        if priority <= Priority.COMMAND or (priority is Priority.HEARTBEAT and self._overdue(now)):
            return 0.0
        return RESERVED_SHARE * self.budget.burst if self.budget is not None else 0.0


def _charge(entry: Waiting[Any]) -> int:
    """Return what the budget of the last class is charged for an entry: its bytes, and those of its answer."""
    return entry[1] + entry[3]
