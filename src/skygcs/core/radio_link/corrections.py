"""GPS_RTCM_DATA that wait for one radio: whole RTCM messages, the newest of each kind, within a share of its budget.

A base sends some hundred bytes to two kilobytes a second, whatever the radio bears. What does not fit has to go
unsent, and it has to be old messages as a whole: half a message is of no use, and neither is last second's once this
second's is there. So fragments are put together before they wait, a message that waits gives way to a newer one of
its kind, and one whose first fragment went is sent to its end.

Senders differ. Most send one RTCM message per sequence id; some send what their socket held, several messages at once
or pieces of a stream (docs/howto/corrections.md). Pieces are no use out of order: they go as they came.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field
from typing import Any, Generic, TypeVar

from skygcs.core.radio_link.rtcm import (
    FRAGMENT_BYTES,
    FRAGMENTED,
    MAX_FRAGMENTS,
    RtcmContent,
    contents_of,
    frame_length,
)
from skygcs.core.radio_link.transmit_queue import Waits
from skygcs.core.token_bucket import TokenBucket

T = TypeVar("T")

BURST_BYTES = 207.0
"""One full GPS_RTCM_DATA, signed: corrections go one by one, and what else waits finds the radio free in between."""

SOURCE_SILENT_S = 10.0
"""A base that was silent for so long may be followed by another. Two at once would have every receiver jump between two
positions of its base; and a base that fails costs its receivers no more than this."""

ASSEMBLY_S = 2.0
"""Fragments of one message come within milliseconds of each other: what is still missing by then was lost."""

MAX_ASSEMBLIES = 4
"""Messages in the making at once: more than UDP ever interleaves."""

BURST_GAP_S = 0.2
"""Messages that follow each other sooner belong together: a base's observations of one epoch. They go in their order,
since receivers take the last one for the end of the epoch."""

PATIENCE_S = 5.0
"""A kind that was not sent for so long goes before newer messages. The base's position (1005 or 1006), without which no
observation is of use, comes every 1 to 10 s, and may come first or last of its burst."""

MAX_AGE_S = 30.0
"""Older messages are not sent: receivers put up with corrections some ten seconds old, with none older than 60 s."""

STREAM_S = 10.0
"""So long after a piece of a stream everything of its source is taken for one."""

STREAM_AGE_S = 3.0
"""Pieces of a stream that waited so long are dropped: they go in order, so that each delays all that follow."""

MAX_WAITING = 24
"""Messages. A base with five constellations sends some twelve kinds."""

MAX_TYPES = 64
"""RTCM types counted apart."""


@dataclass(slots=True)
class CorrectionCounters:
    """What became of the fragments (and messages) offered."""

    messages: int = 0
    """Sent to their end."""
    fragments: int = 0
    bytes: int = 0
    """As they are on the wire."""
    replaced: int = 0
    """Messages that a newer one of their kind took the place of, while they waited."""
    expired: int = 0
    """Messages that waited too long."""
    dropped: int = 0
    """Messages: too many waited, the base changed, or the link went down."""
    incomplete: int = 0
    """Messages of which a fragment did not come."""
    malformed: int = 0
    repeated: int = 0
    """Fragments that came twice."""
    other_source: int = 0
    """Fragments of a second base while the first was there."""
    no_budget: int = 0
    """Fragments offered while nothing may be spent on corrections."""
    waits: Waits = field(default_factory=Waits)


@dataclass(slots=True, eq=False)
class _Message(Generic[T]):
    """A whole message that waits."""

    parts: list[tuple[T, int]]
    contents: tuple[RtcmContent, ...]
    """Empty: a piece of a stream."""
    at: float
    """When it came."""
    since: float
    """Since when its kinds wait unsent, this message or those before it."""
    burst: int


@dataclass(slots=True)
class _Assembly(Generic[T]):
    """A message in the making. ``count``: of its fragments, once known."""

    at: float
    parts: dict[int, tuple[T, int, bytes]] = field(default_factory=dict)
    count: int | None = None

    def add(self, number: int, part: tuple[T, int, bytes]) -> None:
        self.parts[number] = part
        if len(part[2]) < FRAGMENT_BYTES or number == MAX_FRAGMENTS - 1:
            self.count = number + 1

    @property
    def whole(self) -> bool:
        return self.count is not None and all(number in self.parts for number in range(self.count))

    @property
    def full_frame(self) -> bool:
        """Whether its full fragments are exactly one RTCM frame, whose sender forgot the empty one at the end."""
        first = self.parts.get(0)
        length = None if first is None else frame_length(first[2])
        return length == FRAGMENT_BYTES * len(self.parts) and all(n in self.parts for n in range(len(self.parts)))


class Corrections(Generic[T]):
    """The corrections that wait for one radio. Of one base at a time; bounded; within ``bytes_per_s`` and one fragment.

    As with `TxQueue`, who sends asks `next_send_time`, and `pop` gives what goes then. A message is sent once it has
    come as a whole, and no other between its fragments. Next is the newest burst, in the order in which it came, unless
    a kind has waited for PATIENCE_S: then that goes first. So under a lasting shortage all kinds go in turn, each as
    new as it can be, and not only those that a base happens to send last.
    """

    def __init__(self, bytes_per_s: float, now: float) -> None:
        """``bytes_per_s``: what corrections may take of the radio; 0: nothing."""
        self.counters = CorrectionCounters()
        self.source: int | None = None
        """The base that is served: whatever the one who offers tells sources apart by."""
        self._source_at = now
        self._budget = TokenBucket(bytes_per_s, BURST_BYTES, now)
        self._assemblies: dict[int, _Assembly[T]] = {}
        """By sequence id, in the order in which they began."""
        self._waiting: list[_Message[T]] = []
        """In the order in which they came."""
        self._begun: deque[tuple[T, int]] = deque()
        """What is left of the message whose first fragment went."""
        self._stream_until = now
        self._burst = 0
        self._burst_at = now
        self._burst_kinds: dict[int, int | None] = {}
        self._types: dict[int, int] = {}

    def __len__(self) -> int:
        """Fragments of whole messages that wait."""
        return len(self._begun) + sum(len(m.parts) for m in self._waiting)

    def set_rate(self, bytes_per_s: float, now: float) -> None:
        """What corrections may take from now on; 0: nothing, and what waits is kept until it is too old."""
        self._budget.set_rate(bytes_per_s, now)

    def offer(self, source: int, payload: bytes, frame: T, size: int, now: float) -> bool:
        """A GPS_RTCM_DATA that somebody wants sent: its payload (zeros at its end may be missing), what `pop` is to
        give back for it, and its bytes on the wire. False if it will not be sent (counted)."""
        counters = self.counters
        if self._budget.rate <= 0:
            counters.no_budget += 1
            return False
        flags, length = payload[0] if payload else 0, payload[1] if len(payload) > 1 else 0
        number, sequence = (flags >> 1 & 0x03, flags >> 3) if flags & FRAGMENTED else (0, -1)
        if length > FRAGMENT_BYTES or (length == 0 and number == 0):
            counters.malformed += 1
            return False
        if not self._is_served(source, now):
            counters.other_source += 1
            return False
        data = payload[2 : 2 + length].ljust(length, b"\0")
        if sequence < 0:
            self._enqueue([(frame, size, data)], now)
            return True
        return self._assemble(sequence, number, (frame, size, data), now)

    def pop(self, now: float) -> tuple[T, int] | None:
        """The fragment that goes next, and its size; None if nothing waits or the budget is spent."""
        at = self.next_send_time(now)
        if at is None or at > now:
            return None
        if not self._begun:
            self._begin(self._next(now), now)
        frame, size = self._begun.popleft()
        self._budget.spend(size, now)
        self.counters.fragments += 1
        self.counters.bytes += size
        self.counters.messages += not self._begun
        return frame, size

    def next_send_time(self, now: float) -> float | None:
        """From when `pop` gives something: ``now`` if at once, None if nothing waits. At a very low rate what waits may
        be too old by then, and `pop` gives None."""
        self._expire(now)
        if self._budget.rate <= 0 or not (self._begun or self._waiting):
            return None
        return self._budget.ready_at(BURST_BYTES, now)

    def clear(self) -> int:
        """Forget everything that waits (the link went down); how many fragments that were."""
        gone = len(self)
        self.counters.dropped += len(self._waiting) + bool(self._begun)
        self._begun.clear()
        self._waiting.clear()
        self._assemblies.clear()
        return gone

    def status(self) -> dict[str, Any]:
        """Counters, and what waits. ``types``: messages begun, by RTCM type."""
        counters = self.counters
        p50, p95 = counters.waits.percentile(0.5), counters.waits.percentile(0.95)
        return {
            "bytes_per_s": round(self._budget.rate, 1),
            "source": self.source,
            "waiting": len(self),
            "messages": counters.messages,
            "fragments": counters.fragments,
            "bytes": counters.bytes,
            "replaced": counters.replaced,
            "expired": counters.expired,
            "dropped": counters.dropped,
            "incomplete": counters.incomplete,
            "malformed": counters.malformed,
            "repeated": counters.repeated,
            "other_source": counters.other_source,
            "no_budget": counters.no_budget,
            "wait_p50_s": None if p50 is None else round(p50, 4),
            "wait_p95_s": None if p95 is None else round(p95, 4),
            "types": {str(type_): count for type_, count in sorted(self._types.items())},
        }

    # -- from fragments to messages

    def _is_served(self, source: int, now: float) -> bool:
        """Whether this is the base to follow; another one takes over once the last has been silent."""
        if source != self.source:
            if self.source is not None and now < self._source_at + SOURCE_SILENT_S:
                return False
            self.counters.dropped += len(self._waiting)
            self.counters.incomplete += len(self._assemblies)
            self._waiting.clear()
            self._assemblies.clear()
            self._stream_until = now
            self.source = source
        self._source_at = now
        return True

    def _assemble(self, sequence: int, number: int, part: tuple[T, int, bytes], now: float) -> bool:
        for other in [s for s, a in self._assemblies.items() if s != sequence and a.full_frame]:
            self._finish(other, now)  # the next message has begun: nothing more comes of that one
        assembly = self._assemblies.get(sequence)
        if assembly is not None and now > assembly.at + ASSEMBLY_S:
            self._give_up(sequence)
            assembly = None
        if assembly is not None and number in assembly.parts:
            if assembly.parts[number][2] == part[2]:
                self.counters.repeated += 1
                return False
            self._give_up(sequence)  # of another message, 32 messages later
            assembly = None
        if assembly is None:
            if len(self._assemblies) >= MAX_ASSEMBLIES:
                self._give_up(next(iter(self._assemblies)))
            assembly = self._assemblies[sequence] = _Assembly(now)
        assembly.add(number, part)
        if assembly.whole:
            self._finish(sequence, now)
        return True

    def _finish(self, sequence: int, now: float) -> None:
        assembly = self._assemblies.pop(sequence)
        count = len(assembly.parts) if assembly.count is None else assembly.count  # behind it: of an older message
        self._enqueue([assembly.parts[number] for number in range(count)], now)

    def _give_up(self, sequence: int) -> None:
        del self._assemblies[sequence]
        self.counters.incomplete += 1

    # -- messages that wait

    def _enqueue(self, parts: list[tuple[T, int, bytes]], now: float) -> None:
        contents = contents_of(b"".join(data for _, _, data in parts)) or ()
        if not contents:
            self._stream_until = now + STREAM_S
        streaming = now < self._stream_until
        kinds = {c.kind: c.epoch for c in contents}
        if now > self._burst_at + BURST_GAP_S or _is_newer(kinds, self._burst_kinds):
            self._burst += 1
            self._burst_kinds.clear()
        self._burst_at = now
        self._burst_kinds.update(kinds)
        since = now if streaming else self._replace(kinds, now)
        fragments = [(frame, size) for frame, size, _ in parts]
        self._waiting.append(_Message(fragments, contents, now, since, self._burst))
        if len(self._waiting) > MAX_WAITING:
            del self._waiting[0]
            self.counters.dropped += 1

    def _replace(self, kinds: dict[int, int | None], now: float) -> float:
        """Take out what a message of these kinds makes worthless; since when they have been waiting."""
        since = now
        kept: list[_Message[T]] = []
        for waiting in self._waiting:
            if waiting.contents and all(_is_newer(kinds, {c.kind: c.epoch}) for c in waiting.contents):
                since = min(since, waiting.since)
                self.counters.replaced += 1
            else:
                kept.append(waiting)
        self._waiting = kept
        return since

    def _next(self, now: float) -> _Message[T]:
        if now < self._stream_until:
            return self._waiting[0]
        longest = min(self._waiting, key=lambda m: m.since)
        if now >= longest.since + PATIENCE_S:
            return longest
        newest = self._waiting[-1].burst
        return next(m for m in self._waiting if m.burst == newest)

    def _begin(self, message: _Message[T], now: float) -> None:
        self._waiting.remove(message)
        self._begun.extend(message.parts)
        self.counters.waits.add(now - message.at)
        for content in message.contents:
            if content.type in self._types or len(self._types) < MAX_TYPES:
                self._types[content.type] = self._types.get(content.type, 0) + 1

    def _expire(self, now: float) -> None:
        oldest = now - (STREAM_AGE_S if now < self._stream_until else MAX_AGE_S)
        while self._waiting and self._waiting[0].at < oldest:
            del self._waiting[0]
            self.counters.expired += 1


def _is_newer(kinds: dict[int, int | None], than: dict[int, int | None]) -> bool:
    """Whether these kinds (with their epochs) hold a later one of a kind among ``than``, and not another part of it."""
    return any(kind in than and (epoch is None or epoch != than[kind]) for kind, epoch in kinds.items())
