"""The telemetry log that QGroundControl, Mission Planner and MAVExplorer read: records of 8 bytes time and one frame.

    record    microseconds since 1970, 8 bytes big-endian    frame, as it was on the wire

A record has no checksum and no mark of its own, but its frame says how long it is, so that the next record's place is
known. That is used here: a frame that no CRC vouches for (wrong CRC, unknown id) still counts as a record if another
one follows in its place; anything else is passed over byte by byte until a record is found again.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from typing import Literal, Protocol, overload

from skygcs.core.mavlink.dialect import Dialect
from skygcs.core.mavlink.frame import Frame, FrameVerdict, check
from skygcs.core.mavlink.header import HEADER_V2_BYTES, MAGIC_V1, MAGIC_V2, frame_size
from skygcs.core.mavlink.parser import FrameParser

TIME_BYTES = 8

CLOCK_STEP_US = 24 * 3600 * 1_000_000
"""Two neighbouring records whose times are farther apart than a day: the clock was set, a byte was damaged, or it is
another flight appended to the same file. Never a part of the flight's duration."""

_REAL_TIMES_US = range(946_684_800_000_000, 4_102_444_800_000_000)
"""The years 2000 to 2099: a time in here was written by a clock that was set; noise has one of 5,000 chances."""

_WINDOW_BYTES = 65536
_SCAN_BYTES = 4096
"""Looked through at once for the next magic byte; noise has one in 128 bytes."""

LOOKS = 4096
"""`RecordReader.find` for whoever has nothing else to do."""

_SNIFF_BYTES = 16 << 20
"""How far `sniff` looks for the first frame."""

_SNIFF_SHARE = 0.05
"""Least share of a 64 kB window in good frames: chance makes one good frame (some 30 bytes) in 10 MB of noise."""

_MAGIC = re.compile(rb"[\xfd\xfe]")


class ByteSource(Protocol):
    """What is read from: bytes, or a memory-mapped file."""

    def __len__(self) -> int: ...

    @overload
    def __getitem__(self, index: int, /) -> int: ...

    @overload
    def __getitem__(self, index: slice, /) -> bytes: ...


class Record:
    """One record. ``frame`` is None for a bad CRC only; ``elapsed_s`` counts from the first record (see CLOCK_STEP_US).

    ``unix_us`` is the time as written, whatever it says; ``offset`` is where the record begins in the file.
    """

    __slots__ = ("elapsed_s", "frame", "offset", "raw", "unix_us", "verdict")

    def __init__(
        self, unix_us: int, elapsed_s: float, raw: bytes, frame: Frame | None, verdict: FrameVerdict, offset: int
    ) -> None:
        self.unix_us = unix_us
        self.elapsed_s = elapsed_s
        self.raw = raw
        self.frame = frame
        self.verdict: FrameVerdict = verdict
        self.offset = offset

    def __repr__(self) -> str:
        return f"<Record at {self.offset} {self.verdict} {self.frame or len(self.raw)}>"


def encode_record(unix_us: int, raw: bytes) -> bytes:
    """The record of one frame. Raises OverflowError for a time before 1970 or after the year 586,000."""
    return unix_us.to_bytes(TIME_BYTES, "big") + raw


class RecordReader:
    """Iterator over the records of a whole tlog. Never raises, whatever the bytes are.

    ``skipped_bytes`` is what was passed over so far: a truncated last record, noise, a damaged record's bytes.
    """

    def __init__(self, data: ByteSource, dialect: Dialect) -> None:
        self.skipped_bytes = 0
        self._data = data
        self._messages = dialect.messages
        self._at = 0
        self._elapsed_us = 0
        self._last_us: int | None = None

    def __iter__(self) -> Iterator[Record]:
        return self

    def __next__(self) -> Record:
        while not self.at_end:
            record = self.find(LOOKS)
            if record is not None:
                return record
        raise StopIteration

    @property
    def at_end(self) -> bool:
        """Whether the whole file was read."""
        return self._at >= len(self._data)

    def find(self, looks: int) -> Record | None:
        """The next record, if it is found within so many looks; else None, and the next call goes on from there. For
        whoever has other things to do beside: a file without any record takes some 10 s for each MB."""
        data = self._data
        size = len(data)
        at = self._at
        for _ in range(looks):
            if at + TIME_BYTES >= size:
                self.skipped_bytes += max(size - at, 0)
                self._at = size
                return None
            magic = data[at + TIME_BYTES]
            if magic in (MAGIC_V2, MAGIC_V1):
                record = self._record_at(at)
                if record is not None:
                    self._at = at + TIME_BYTES + len(record.raw)
                    return record
                step = 1
            else:
                step = self._distance_to_magic(at + TIME_BYTES)
            self.skipped_bytes += step
            at += step
        self._at = at
        return None

    def _distance_to_magic(self, at: int) -> int:
        """Bytes to the next magic byte, or to the end of the window; at least 1."""
        window = self._data[at : at + _SCAN_BYTES]
        found = _MAGIC.search(window)
        return found.start() if found is not None else len(window)

    def _record_at(self, at: int) -> Record | None:
        data = self._data
        begin = at + TIME_BYTES
        head = data[begin : begin + HEADER_V2_BYTES]
        size = frame_size(head)
        if not size or begin + size > len(data):
            return None
        raw = data[begin : begin + size]
        frame, verdict = check(raw, self._messages)
        unix_us = int.from_bytes(data[at:begin], "big")
        if verdict != "ok" and (not self._in_place(unix_us, begin + size) or self._holds_record(unix_us, raw)):
            return None
        last = self._last_us
        if last is not None and -CLOCK_STEP_US < unix_us - last < CLOCK_STEP_US:
            self._elapsed_us += unix_us - last
        self._last_us = unix_us
        return Record(unix_us, self._elapsed_us / 1e6, raw, frame, verdict, at)

    def _in_place(self, unix_us: int, end: int) -> bool:
        """Whether a record follows at ``end``; at the end of the file, whether one went before.

        Its time must be near this one's, or both real: without that, noise would make a bad record of every 16 kB.
        """
        data = self._data
        if end + TIME_BYTES >= len(data):
            other = self._last_us
        elif data[end + TIME_BYTES] in (MAGIC_V2, MAGIC_V1):
            other = int.from_bytes(data[end : end + TIME_BYTES], "big")
        else:
            return False
        return unix_us in _REAL_TIMES_US if other is None else _belong_together(unix_us, other)

    def _holds_record(self, unix_us: int, raw: bytes) -> bool:
        """Whether a good record stands inside: then the length is damaged and would swallow it."""
        for found in _MAGIC.finditer(raw, TIME_BYTES):
            at = found.start()
            size = frame_size(raw, at)
            if not size or at + size > len(raw):
                continue
            time = int.from_bytes(raw[at - TIME_BYTES : at], "big")
            if _belong_together(unix_us, time) and check(raw[at : at + size], self._messages)[1] == "ok":
                return True
        return False


def _belong_together(a_us: int, b_us: int) -> bool:
    """Whether these may be the times of two records of one file: near each other, or both real."""
    if a_us in _REAL_TIMES_US and b_us in _REAL_TIMES_US:
        return True
    return -CLOCK_STEP_US < a_us - b_us < CLOCK_STEP_US and a_us < _REAL_TIMES_US.stop


def iter_records(data: ByteSource, dialect: Dialect) -> RecordReader:
    """Every record of a whole tlog in the file's order; the iterator's ``skipped_bytes`` is final when it ends."""
    return RecordReader(data, dialect)


def sniff(data: ByteSource, dialect: Dialect) -> Literal["tlog", "raw"] | None:
    """What kind of file this is: a tlog, bare frames as they came from a link, or None if it is neither.

    Looks at the first window that holds good frames: between the frames of a tlog stand 8 bytes, between others none.
    """
    size = min(len(data), _SNIFF_BYTES)
    for start in range(0, size, _WINDOW_BYTES):
        window = data[start : start + _WINDOW_BYTES]
        stream = FrameParser(dialect)
        raw_bytes = sum(len(frame.raw) for frame in stream.feed_datagram(window) if frame.info is not None)
        reader = RecordReader(window, dialect)
        tlog_bytes = sum(len(record.raw) for record in reader if record.verdict == "ok")
        if max(raw_bytes, tlog_bytes) < _SNIFF_SHARE * len(window) and len(data) > _WINDOW_BYTES:
            continue
        if not raw_bytes and not tlog_bytes:
            continue
        return "tlog" if reader.skipped_bytes < stream.stats.skipped_bytes else "raw"
    return None
