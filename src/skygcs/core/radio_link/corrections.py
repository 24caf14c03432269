"""RTCM corrections on their way to vehicles: their frames, and those that wait for one radio. Pure.

RTCM 10403, transport layer: 0xD3, six reserved bits (zero), ten bits of length, so many bytes, CRC-24Q of all that.
Only the message type and the epoch of observations are read from the content.

`Corrections` keeps for one radio the newest message of each kind, within a share of its budget. A base sends some
hundred bytes to two kilobytes a second, whatever the radio carries. What does not fit is left out as whole messages:
half a message is of no use, and neither is last second's once this second's has come. The bytes of each GPS_RTCM_DATA,
however their sender cut them, go through one framer; its messages wait here, and are sent as fragments of our own.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator
from dataclasses import asdict, dataclass, field
from functools import cache
from typing import Any, NamedTuple

from skygcs.core.radio_link.transmit_queue import Waits
from skygcs.core.token_bucket import TokenBucket

# --- frames of RTCM ---------------------------------------------------------------------------------------------------

PREAMBLE = 0xD3
RESERVED_BITS = 0xFC
"""In the second byte; they are zero."""
HEADER_BYTES = 3
CRC_BYTES = 3
MAX_FRAME_BYTES = HEADER_BYTES + 1023 + CRC_BYTES

CHECKED_PER_BYTE = 4
"""Bytes whose checksum is computed per byte of the stream: a sound stream needs one, and any other binary data that a
base mixes in 0.03 (a preamble and six zero bits every 16 kB, with 512 bytes behind it on average)."""

CHECKED_SAVED = 16 * MAX_FRAME_BYTES
"""Most that is saved up for false starts."""

CRC24Q_POLYNOMIAL = 0x1864CFB
"""Register 0 at first, most significant bit first, nothing inverted."""

FRAGMENT_BYTES = 180
"""Bytes of RTCM that one GPS_RTCM_DATA holds."""

MAX_FRAGMENTS = 4
"""The fragment id has two bits."""

MAX_MESSAGE_BYTES = FRAGMENT_BYTES * MAX_FRAGMENTS

SEQUENCES = 32
"""The sequence id has five bits."""

FRAGMENTED = 0x01
"""Bit 0 of the flags; bits 1 and 2 are the fragment id, bits 3 to 7 the sequence id."""

MSM_TYPES = range(1071, 1138)
"""Observations as Multiple Signal Messages of any constellation: twelve bits of type, twelve of station, thirty of
epoch."""


class RtcmContent(NamedTuple):
    """Contents of one RTCM message."""

    type: int
    """0 where it is too short to have one."""
    kind: int
    """Its type and the twelve bits that follow: the station, of an ephemeris its satellite, of a maker's own message
    its subtype. A newer one of a kind takes the place of an older one ..."""
    epoch: int | None
    """... but for the parts of observations too many for one message, which have one epoch (as its 30 bits stand)."""


def crc24q(data: bytes | bytearray | memoryview) -> int:
    """The checksum of an RTCM frame; over a frame with its checksum it is 0."""
    table = _crc_table()
    crc = 0
    for byte in data:
        crc = (crc << 8 & 0xFFFFFF) ^ table[crc >> 16 ^ byte]
    return crc


@cache
def _crc_table() -> tuple[int, ...]:
    def of(byte: int) -> int:
        crc = byte << 16
        for _ in range(8):
            crc <<= 1
            if crc & 0x1000000:
                crc ^= CRC24Q_POLYNOMIAL
        return crc

    return tuple(of(byte) for byte in range(256))


def content_of(frame: bytes) -> RtcmContent:
    """Return what a whole RTCM frame is."""
    body = frame[HEADER_BYTES:-CRC_BYTES]
    if len(body) < 2:
        return RtcmContent(0, 0, None)  # a filler, or a maker's
    kind = int.from_bytes(body[:3].ljust(3, b"\0"), "big")
    type_ = kind >> 12
    epoch = int.from_bytes(body[3:7], "big") >> 2 if type_ in MSM_TYPES and len(body) >= 7 else None
    return RtcmContent(type_, kind, epoch)


class CheckAllowance:
    """Bytes of a stream whose checksums may still be computed. Bytes that look like a frame at every second place would
    cost a checksum of a kilobyte each, 75 µs per byte: such a place is passed over unchecked beyond CHECKED_PER_BYTE.
    """

    __slots__ = ("_left",)

    def __init__(self) -> None:
        self._left = CHECKED_SAVED

    def fed(self, size: int, held: int) -> None:
        """So many bytes have come, and so many are held with them."""
        self._left = min(self._left + CHECKED_PER_BYTE * size, max(CHECKED_SAVED, CHECKED_PER_BYTE * held))

    def take(self, size: int) -> bool:
        """Take so many bytes from it; False if they are not there, and no checksum over them is to be computed."""
        allowed = self._left >= size
        self._left -= size * allowed
        return allowed


class RtcmDeframer:
    """The whole and sound RTCM frames in a stream of bytes. After anything else it resumes at the next byte that may
    begin a frame, so that a false start costs none that follow. It holds less than one frame."""

    __slots__ = ("_allowance", "_held", "bad_crc", "frames", "skipped_bytes")

    def __init__(self) -> None:
        self.frames = 0
        self.bad_crc = 0
        """Starts of frames that proved false, or frames that were damaged."""
        self.skipped_bytes = 0
        """Bytes that belong to no sound frame."""
        self._held = bytearray()
        self._allowance = CheckAllowance()

    @property
    def held_bytes(self) -> int:
        """Bytes of a frame that has only begun."""
        return len(self._held)

    def drop_held(self) -> None:
        """Forget a frame that has only begun: what follows is no part of it."""
        self.skipped_bytes += len(self._held)
        self._held.clear()

    def feed(self, data: bytes) -> list[bytes]:
        """The frames that these bytes complete, in their order."""
        self._held += data
        self._allowance.fed(len(data), len(self._held))
        held = self._held
        frames: list[bytes] = []
        at = 0
        while True:
            # find the next preamble
            start = held.find(PREAMBLE, at)
            self.skipped_bytes += (len(held) if start < 0 else start) - at
            at = len(held) if start < 0 else start
            if len(held) - at < HEADER_BYTES:
                break
            if held[at + 1] & RESERVED_BITS:
                at += 1
                self.skipped_bytes += 1
                continue
            # wait for the whole frame
            length = HEADER_BYTES + (held[at + 1] << 8 | held[at + 2]) + CRC_BYTES
            if len(held) - at < length:
                break
            # a wrong CRC means that the preamble was payload: go on behind it
            frame = bytes(held[at : at + length])
            if not (self._allowance.take(length) and crc24q(frame) == 0):
                self.bad_crc += 1
                self.skipped_bytes += 1
                at += 1
                continue
            # take the frame
            self.frames += 1
            frames.append(frame)
            at += length
        del held[:at]
        return frames


def fragments_of(message: bytes, sequence: int) -> Iterator[dict[str, int | bytes]]:
    """The values of the GPS_RTCM_DATA that carry a message of 1 to MAX_MESSAGE_BYTES; ``sequence`` counts messages.

    The receiver knows the last fragment by its being short, so that after two or three full ones an empty one follows
    (ArduPilot throws the message away otherwise). Raises ValueError for a message that does not fit.
    """
    if not 0 < len(message) <= MAX_MESSAGE_BYTES:
        raise ValueError(f"{len(message)} bytes do not go as GPS_RTCM_DATA, which takes 1 to {MAX_MESSAGE_BYTES}")
    return _fragments(message, sequence % SEQUENCES << 3)


def _fragments(message: bytes, flags: int) -> Iterator[dict[str, int | bytes]]:
    if len(message) <= FRAGMENT_BYTES:
        yield _values(flags, message)
        return
    for number in range(min(MAX_FRAGMENTS, len(message) // FRAGMENT_BYTES + 1)):
        chunk = message[number * FRAGMENT_BYTES : (number + 1) * FRAGMENT_BYTES]
        yield _values(flags | number << 1 | FRAGMENTED, chunk)


def _values(flags: int, chunk: bytes) -> dict[str, int | bytes]:
    return {"flags": flags, "len": len(chunk), "data": chunk.ljust(FRAGMENT_BYTES, b"\0")}


# --- queue of one radio -----------------------------------------------------------------------------------------------


BURST_BYTES = 207.0
"""One full GPS_RTCM_DATA, signed: corrections go one by one, and what else waits finds the radio free in between."""

SOURCE_SILENT_S = 10.0
"""A base that was silent for so long may be followed by another. Two at once would have every receiver jump between two
positions of its base; and a base that fails costs its receivers no more than this."""

MAX_AGE_S = 30.0
"""Older messages are not sent: receivers accept corrections some ten seconds old, and none older than 60 s."""

MAX_KINDS = 24
"""Kinds that wait. A base with five constellations sends some twelve."""

MAX_PARTS = 4
"""Messages of one kind and epoch: observations of more satellites than one message holds."""

MAX_TYPES = 64
"""RTCM types counted apart."""

MAX_KINDS_SENT = 256
"""Kinds whose last time is known."""


class Fragment(NamedTuple):
    """The values of one GPS_RTCM_DATA to send, and the base they come from."""

    source: int
    values: dict[str, int | bytes]


@dataclass(slots=True)
class _Kind:
    """The newest message of a kind, or the parts of one epoch."""

    epoch: int | None
    at: float
    """When the newest part came."""
    messages: list[bytes] = field(default_factory=list)


@dataclass(slots=True)
class CorrectionCounters:
    """Counts of what became of the messages."""

    messages: int = 0
    """Sent to their end."""
    fragments: int = 0
    bytes: int = 0
    """Bytes on the wire."""
    replaced: int = 0
    """Messages for which a newer one of their kind came while they waited."""
    expired: int = 0
    """Messages that waited too long."""
    dropped: int = 0
    """Messages: too many kinds waited, the base changed, or the link went down."""
    too_long: int = 0
    """Messages that do not fit into four fragments."""
    malformed: int = 0
    """GPS_RTCM_DATA that say they hold more than they can."""
    other_source: int = 0
    """Fragments of a second base while the first was there."""
    no_budget: int = 0
    """Fragments offered while nothing may be spent on corrections."""


class Corrections:
    """The corrections that wait for one radio. From one base at a time; bounded; within ``bytes_per_s``.

    The sender asks `next_send_time`; `pop` gives the fragment that goes then, and `charge` says what it cost. The kind
    that was sent longest ago is next, so that under a lasting shortage all kinds go in turn, each as new as it can be.
    A message that was begun is finished first.
    """

    def __init__(self, bytes_per_s: float, now: float) -> None:
        """``bytes_per_s``: what corrections may take of the radio; 0: nothing."""
        self.counters = CorrectionCounters()
        self.waits = Waits()
        self.source: int | None = None
        """The base that is served (its sysid << 8 | compid)."""
        self._source_at = now
        self._budget = TokenBucket(bytes_per_s, BURST_BYTES, now)
        self._deframer = RtcmDeframer()
        self._kinds: dict[int, _Kind] = {}
        """In the order in which they began to wait."""
        self._sent_at: dict[int, float] = {}
        """By kind."""
        self._begun: deque[dict[str, int | bytes]] = deque()
        """The rest of the message whose first fragment went."""
        self._sequence = 0
        self._types: dict[int, int] = {}

    def __len__(self) -> int:
        """Fragments that wait."""
        messages = (message for kind in self._kinds.values() for message in kind.messages)
        return len(self._begun) + sum(len(list(fragments_of(message, 0))) for message in messages)

    def set_rate(self, bytes_per_s: float, now: float) -> None:
        """Set what corrections may take from now on; 0: nothing, and what waits is kept until it is too old."""
        self._budget.set_rate(bytes_per_s, now)

    def offer(self, source: int, payload: bytes, now: float) -> bool:
        """The payload of a GPS_RTCM_DATA (zeros at its end may be missing). False if it is not used (counted)."""
        counters = self.counters
        length = payload[1] if len(payload) > 1 else 0
        if self._budget.rate <= 0:
            counters.no_budget += 1
            return False
        if length > FRAGMENT_BYTES:
            counters.malformed += 1
            return False
        if not self._is_served(source, now):
            counters.other_source += 1
            return False
        for message in self._deframer.feed(payload[2 : 2 + length].ljust(length, b"\0")):
            if len(message) > MAX_MESSAGE_BYTES:
                counters.too_long += 1
            else:
                self._enqueue(message, now)
        return True

    def pop(self, now: float) -> Fragment | None:
        """The fragment that goes next; None if nothing waits or the budget is spent."""
        at = self.next_send_time(now)
        if at is None or at > now or self.source is None:
            return None
        if not self._begun:
            self._begin(now)
        self.counters.messages += len(self._begun) == 1
        return Fragment(self.source, self._begun.popleft())

    def charge(self, size: int, now: float) -> None:
        """The fragment that `pop` gave took so many bytes."""
        self._budget.spend(size, now)
        self.counters.fragments += 1
        self.counters.bytes += size

    def next_send_time(self, now: float) -> float | None:
        """When `pop` gives something: ``now`` if at once, None if nothing waits. At a very low rate what waits may be
        too old by then, and `pop` gives None."""
        self._expire(now)
        if self._budget.rate <= 0 or not (self._begun or self._kinds):
            return None
        return self._budget.ready_at(BURST_BYTES, now)

    def clear(self) -> int:
        """Forget everything that waits (the link went down); how many fragments that were."""
        gone = len(self)
        self._drop_all()
        self.counters.dropped += bool(self._begun)
        self._begun.clear()
        return gone

    def status(self) -> dict[str, Any]:
        """Counters, and what waits. ``types``: messages begun, by RTCM type."""
        p50, p95 = self.waits.percentile(0.5), self.waits.percentile(0.95)
        return {
            "bytes_per_s": round(self._budget.rate, 1),
            "source": self.source,
            "waiting": len(self),
            **asdict(self.counters),
            "bad_crc": self._deframer.bad_crc,
            "skipped_bytes": self._deframer.skipped_bytes,
            "wait_p50_s": None if p50 is None else round(p50, 4),
            "wait_p95_s": None if p95 is None else round(p95, 4),
            "types": {str(type_): count for type_, count in sorted(self._types.items())},
        }

    # -- the inside

    def _is_served(self, source: int, now: float) -> bool:
        """True if this is the base to follow; another one takes over once the last has been silent."""
        if source != self.source:
            if self.source is not None and now < self._source_at + SOURCE_SILENT_S:
                return False
            self._drop_all()
            self._sent_at.clear()
            self.source = source
        self._source_at = now
        return True

    def _drop_all(self) -> None:
        self.counters.dropped += sum(len(kind.messages) for kind in self._kinds.values())
        self._kinds.clear()
        self._deframer.drop_held()

    def _enqueue(self, message: bytes, now: float) -> None:
        content = content_of(message)
        waiting = self._kinds.get(content.kind)
        if waiting is None:
            if len(self._kinds) >= MAX_KINDS:
                oldest = min(self._kinds, key=lambda kind: self._kinds[kind].at)
                self.counters.dropped += len(self._kinds.pop(oldest).messages)
            waiting = self._kinds[content.kind] = _Kind(content.epoch, now)
        elif content.epoch is None or content.epoch != waiting.epoch or len(waiting.messages) >= MAX_PARTS:
            self.counters.replaced += len(waiting.messages)
            waiting.epoch = content.epoch
            waiting.messages.clear()
        waiting.at = now
        waiting.messages.append(message)

    def _begin(self, now: float) -> None:
        """Take the next message: of the kind that was sent longest ago, of several the one that waits longest."""
        kind = min(self._kinds, key=lambda kind: self._sent_at.get(kind, float("-inf")))
        waiting = self._kinds[kind]
        message = waiting.messages.pop(0)
        if not waiting.messages:
            del self._kinds[kind]
            if len(self._sent_at) >= MAX_KINDS_SENT:
                self._sent_at.clear()
            self._sent_at[kind] = now
        self._sequence += 1
        self._begun.extend(fragments_of(message, self._sequence))
        self.waits.add(now - waiting.at)
        type_ = content_of(message).type
        if type_ in self._types or len(self._types) < MAX_TYPES:
            self._types[type_] = self._types.get(type_, 0) + 1

    def _expire(self, now: float) -> None:
        for kind in [kind for kind, waiting in self._kinds.items() if waiting.at < now - MAX_AGE_S]:
            self.counters.expired += len(self._kinds.pop(kind).messages)
