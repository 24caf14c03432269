"""Frames that measure the way between two radios whose serial ports are both at this computer.

Pure: `feed` what came out of an end, `advance` the time, write `take_output` to each end, until `done`. Both ways are
measured at the same time, by MAVLink frames that no vehicle takes for an order (ENCAPSULATED_DATA). Three phases:

    find      one frame on its way, the next as soon as it arrives: is there a way, and how long is a round about?
    single    one frame on its way, the next written at a moment that is spread evenly over the round: delay and loss
              of each size, and arrivals on the grid of the rounds
    stream    the radio's transmit buffer never empty, and never full: throughput of each size

A radio keeps frames in order, so a frame is lost once a later one has arrived, or after `lost_after_s`.
"""

from __future__ import annotations

import struct
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, field
from enum import StrEnum
from itertools import pairwise

from skygcs.core.mavlink.dialect import Dialect
from skygcs.core.mavlink.frame import CRC_BYTES, HEADER_V2_BYTES, encode_payload
from skygcs.core.mavlink.parser import FrameParser

FRAME_SIZES = (24, 64, 128, 252)
"""Bytes of a frame on the wire: a heartbeat has 21, and a packet of open SiK holds 252."""

WINDOW_BYTES = 1764
"""Most bytes of a stream on their way: seven packets of open SiK, so that a slot is full although those of the two
before it were lost and are not known to be; and less than its transmit buffer of 1850 bytes."""

FIND_ARRIVALS = 8
"""Arrivals of each way that end the first phase."""

LEAST_LOST_AFTER_S, LOST_AFTER_ROUNDS = 0.5, 4
"""A single frame that has not arrived after so many rounds does not."""

STREAM_QUEUE = 4
"""And one of a stream after so many times that: the window may be seven packets, and a round carry one of them."""

SILENT_AFTER = 4
"""So many losses in a row at the start, and none has arrived: there is no way."""

SINGLE_SHARE = 0.6
"""Part of the time for single frames; streams have the rest."""

GOLDEN = 0.6180339887498949
"""Multiples of it, less their whole part, are spread evenly over 0 to 1 from the first ones on."""

LATER_EVERY = 8
"""One single frame in so many is written a round later: where all came two rounds after the one before, twice the
round fitted as well, and a slot held twice its bytes (2 of 16 simulated measurements at 20 % loss)."""

WAYS = (0, 1)
"""The way from end 0 (A) to end 1 (B), and the way back. A way has the number of the end at which it begins."""

_HEAD = struct.Struct("<HBIH")
_FILL = 0x55
_SYSID, _COMPID = 254, 191


class Phase(StrEnum):
    FIND = "find"
    SINGLE = "single"
    STREAM = "stream"


@dataclass(slots=True)
class Sent:
    """One frame. ``arrived_at`` None: it was lost, or is on its way."""

    size: int
    phase: Phase
    sent_at: float
    arrived_at: float | None = None


@dataclass(slots=True)
class _Way:
    """Frames of one way, by their number, and those of which nothing is known yet."""

    frames: list[Sent] = field(default_factory=list)
    open: deque[int] = field(default_factory=deque)
    open_bytes: int = 0
    next_at: float = 0.0
    lost_in_row: int = 0
    arrivals: int = 0
    duplicates: int = 0


class LinkProbe:
    """One measurement. ``seconds``: how long single frames and streams take together."""

    def __init__(
        self,
        dialect: Dialect,
        *,
        seconds: float,
        session: int,
        lost_after_s: float,
        now: float,
        sizes: Sequence[int] = FRAME_SIZES,
    ) -> None:
        self.sizes = tuple(sizes)
        self.round_s: float | None = None
        """About how long a round is; None until both ways are found."""
        self._info = dialect.by_name["ENCAPSULATED_DATA"]
        self._parsers = (FrameParser(dialect), FrameParser(dialect))
        self._session = session & 0xFFFF
        self._lost_after_s = lost_after_s
        self._seconds = seconds
        self._ways = (_Way(next_at=now), _Way(next_at=now))
        self._output: tuple[list[bytes], list[bytes]] = ([], [])
        self._phases = deque([(Phase.FIND, min(self.sizes), 0.0)])
        self._phases += [(Phase.SINGLE, size, SINGLE_SHARE / len(self.sizes)) for size in self.sizes]
        self._phases += [(Phase.STREAM, size, (1 - SINGLE_SHARE) / len(self.sizes)) for size in self.sizes]
        self._until = float("inf")
        self._now = now
        self._start(now)

    # -- its owner's side

    @property
    def done(self) -> bool:
        return not self._phases

    @property
    def silent(self) -> list[int]:
        """Ways on which nothing arrives. Nothing more is measured then."""
        return [n for n in WAYS if not self._ways[n].arrivals and self._ways[n].lost_in_row >= SILENT_AFTER]

    @property
    def frames(self) -> tuple[Sequence[Sent], Sequence[Sent]]:
        """All frames of each way in the order in which they were written."""
        return self._ways[0].frames, self._ways[1].frames

    @property
    def noise_bytes(self) -> tuple[int, int]:
        """Bytes that came out of each end and belong to no frame."""
        a, b = (parser.stats.skipped_bytes for parser in self._parsers)
        return a, b

    @property
    def duplicates(self) -> int:
        """Frames that arrived more than once."""
        return sum(way.duplicates for way in self._ways)

    def feed(self, end: int, data: bytes, now: float) -> None:
        """Take what was read at an end. Frames of other measurements are skipped."""
        for frame in self._parsers[end].feed(data):
            payload = frame.payload
            if frame.info is not self._info or len(payload) < _HEAD.size:
                continue
            _, way, number, session = _HEAD.unpack_from(payload)
            if session == self._session and way == 1 - end:
                self._arrived(self._ways[way], number, now)
        self.advance(now)

    def advance(self, now: float) -> None:
        """Let time pass: losses are noticed, and frames that are due are written."""
        self._now = now
        for way in self._ways:
            while way.open and now >= self._lost_at(way):
                self._lost(way)
        if not self.done and not self.silent:
            self._next_phase(now)
        if not self.done and not self.silent:
            for number in WAYS:
                self._write(number, now)

    def take_output(self, end: int) -> list[bytes]:
        """Return the frames to write to an end now."""
        output = list(self._output[end])
        self._output[end].clear()
        return output

    def next_deadline(self) -> float | None:
        """When `advance` is due, if nothing is read before; None when it is over."""
        if self.done or self.silent:
            return None
        times = [self._until]
        for way in self._ways:
            if way.open:
                times.append(self._lost_at(way))
            elif self._now < self._until:
                times.append(way.next_at)
        return min(times)

    # -- the inside

    def _arrived(self, way: _Way, number: int, now: float) -> None:
        if number >= len(way.frames) or way.frames[number].arrived_at is not None:
            way.duplicates += number < len(way.frames)
            return
        way.frames[number].arrived_at = now
        way.arrivals += 1
        way.lost_in_row = 0
        while way.open and way.open[0] <= number:
            self._close(way)
        if not way.open:
            way.next_at = now
            if self._phases and self._phases[0][0] is Phase.SINGLE and self.round_s is not None:
                number = len(way.frames)
                way.next_at += (number * GOLDEN % 1.0 + (number % LATER_EVERY == 0)) * self.round_s

    def _lost_at(self, way: _Way) -> float:
        """When the oldest frame on its way is taken for lost. In a stream it waits for those before it as well."""
        sent = way.frames[way.open[0]]
        return sent.sent_at + self._lost_after_s * (STREAM_QUEUE if sent.phase is Phase.STREAM else 1)

    def _lost(self, way: _Way) -> None:
        way.next_at = self._lost_at(way)
        self._close(way)
        way.lost_in_row += 1

    def _close(self, way: _Way) -> None:
        way.open_bytes -= way.frames[way.open.popleft()].size

    def _next_phase(self, now: float) -> None:
        """Go on to the next phase when this one's time is over and all its frames have arrived or are lost."""
        if self._phases[0][0] is Phase.FIND and self.round_s is None:
            if any(way.arrivals < FIND_ARRIVALS for way in self._ways):
                return
            self.round_s = self._about_a_round()
            self._lost_after_s = max(LEAST_LOST_AFTER_S, LOST_AFTER_ROUNDS * self.round_s)
            self._until = now
        if now < self._until or any(way.open for way in self._ways):
            return
        self._phases.popleft()
        if self._phases:
            self._start(now)

    def _start(self, now: float) -> None:
        phase, _, share = self._phases[0]
        if phase is not Phase.FIND:
            self._until = now + share * self._seconds
        for way in self._ways:
            way.next_at = now

    def _about_a_round(self) -> float:
        """The time between two arrivals of frames that were written one right after the other: their lower quartile,
        for between some of them one was lost."""
        gaps = []
        for way in self._ways:
            times = [sent.arrived_at for sent in way.frames if sent.arrived_at is not None]
            gaps += [later - earlier for earlier, later in pairwise(times)]
        return sorted(gaps)[len(gaps) // 4]

    def _write(self, number: int, now: float) -> None:
        """Write what is due: one frame, or in a stream as many as the window has room for."""
        phase, size, _ = self._phases[0]
        way = self._ways[number]
        if phase is Phase.STREAM:
            while now < self._until and way.open_bytes + size <= WINDOW_BYTES:
                self._put(number, size, phase, now)
        elif not way.open and way.next_at <= now < self._until:
            self._put(number, size, phase, now)

    def _put(self, number: int, size: int, phase: Phase, now: float) -> None:
        way = self._ways[number]
        count = len(way.frames)
        head = _HEAD.pack(count & 0xFFFF, number, count, self._session)
        payload = head.ljust(size - HEADER_V2_BYTES - CRC_BYTES, bytes([_FILL]))
        raw = encode_payload(self._info, payload, sysid=_SYSID, compid=_COMPID, seq=count & 0xFF)
        way.frames.append(Sent(len(raw), phase, now))
        way.open.append(count)
        way.open_bytes += len(raw)
        self._output[number].append(raw)
