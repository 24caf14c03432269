"""What waits to be sent on one link, and in which order: strict classes, every one with a bound and a policy.

Pure: the sender (shell) offers, asks what is next, and writes. Fitting the whole to a radio's budget builds on this.
"""

from __future__ import annotations

from collections.abc import Hashable
from dataclasses import dataclass, field
from enum import IntEnum
from typing import Generic, TypeVar

T = TypeVar("T")

HEARTBEAT_WAITS_S = 1.0
"""A heartbeat that waited so long goes before everything but an emergency. Without our heartbeats a vehicle's ground
station failsafe takes over (ArduPilot: after 5 s), and no flood of anything else may bring that about."""


class Priority(IntEnum):
    """Order of service on a link, most urgent first (docs/explanation/architecture.md, "uplink")."""

    EMERGENCY = 0
    COMMAND = 1
    SETPOINT = 2
    EXCHANGE = 3
    HEARTBEAT = 4
    CORRECTION = 5
    FORWARDED = 6


BOUND: dict[Priority, int] = {
    Priority.EMERGENCY: 256,  # never fewer than vehicles in a fleet: a stop for each of 250 fits
    Priority.COMMAND: 256,
    Priority.SETPOINT: 256,  # one per vehicle, the newest
    Priority.EXCHANGE: 256,
    Priority.HEARTBEAT: 4,
    Priority.CORRECTION: 16,  # 16 fragments of 180 B are three seconds of RTCM; older ones are worthless
    Priority.FORWARDED: 128,  # at 57600 baud some 5 kB: almost a second of air
}
"""Most entries waiting per class."""

DROPS_OLDEST = frozenset({Priority.HEARTBEAT, Priority.CORRECTION, Priority.FORWARDED})
"""Classes whose newest entry is worth more than their oldest; the others refuse when full, and the sender retries."""


@dataclass(slots=True)
class ClassCounters:
    """What became of the entries of one class."""

    sent: int = 0
    replaced: int = 0
    dropped: int = 0
    refused: int = 0


@dataclass(slots=True)
class TxQueue(Generic[T]):
    """Bounded, prioritised queue of one link. Entries with a ``key`` replace the waiting one of the same key."""

    counters: dict[Priority, ClassCounters] = field(default_factory=lambda: {p: ClassCounters() for p in Priority})
    _waiting: dict[Priority, dict[Hashable, T]] = field(default_factory=lambda: {p: {} for p in Priority})
    """In order of arrival; an entry without a key stands under a serial number, one with a key under (key,)."""
    _serial: int = 0
    _length: int = 0
    _heartbeat_since: float | None = None
    """Since when heartbeats wait and none was sent; None: none waits."""

    def __len__(self) -> int:
        return self._length

    def offer(self, entry: T, priority: Priority, now: float, key: Hashable | None = None) -> bool:
        """Queue it; False if its class is full and refuses. Never blocks, never raises.

        With a key the newest value takes the place of the waiting one (latest wins), keeping that one's turn.
        """
        counters = self.counters[priority]
        waiting = self._waiting[priority]
        if priority is Priority.HEARTBEAT and not waiting:
            self._heartbeat_since = now
        slot: Hashable
        if key is not None:
            slot = (key,)
            if slot in waiting:
                waiting[slot] = entry
                counters.replaced += 1
                return True
        else:
            slot = self._serial = self._serial + 1
        if len(waiting) >= BOUND[priority]:
            if priority not in DROPS_OLDEST:
                counters.refused += 1
                return False
            del waiting[next(iter(waiting))]
            self._length -= 1
            counters.dropped += 1
        waiting[slot] = entry
        self._length += 1
        return True

    def pop(self, now: float) -> tuple[T, Priority] | None:
        """The most urgent entry, oldest first within a class; None when nothing waits.

        A heartbeat that has waited for HEARTBEAT_WAITS_S is second to emergencies only.
        """
        if not self._length:
            return None
        since = self._heartbeat_since
        overdue = since is not None and now - since >= HEARTBEAT_WAITS_S
        for priority, waiting in self._waiting.items():
            if waiting:
                if overdue and priority is not Priority.EMERGENCY:
                    return self._taken(Priority.HEARTBEAT, now)
                return self._taken(priority, now)
        return None

    def _taken(self, priority: Priority, now: float) -> tuple[T, Priority]:
        waiting = self._waiting[priority]
        self._length -= 1
        self.counters[priority].sent += 1
        entry = waiting.pop(next(iter(waiting)))
        if priority is Priority.HEARTBEAT:
            self._heartbeat_since = now if waiting else None
        return entry, priority

    def clear(self) -> int:
        """Forget everything that waits (the link went down); how many that were. Counted as dropped."""
        gone = self._length
        for priority, waiting in self._waiting.items():
            self.counters[priority].dropped += len(waiting)
            waiting.clear()
        self._length = 0
        self._heartbeat_since = None
        return gone
