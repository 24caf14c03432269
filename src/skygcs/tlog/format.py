"""The tlog format, which QGroundControl, Mission Planner and MAVExplorer read: records of a time and one frame.

    record    microseconds since 1970, 8 bytes big-endian    frame, as it was on the wire

Old files of QGroundControl have the time with its lowest byte first, which is found out by the first two records.

A record has no checksum and no mark of its own, but the length of its frame gives the place of the next record. So a
frame whose CRC is wrong or cannot be checked (unknown id) still counts as a record if another one follows in its place;
anything else is skipped byte by byte until a record is found again.
"""

from __future__ import annotations

import re
from typing import Literal, Protocol, overload

from skygcs.core.mavlink.dialect import Dialect
from skygcs.core.mavlink.frame import HEADER_BYTES, MAX_FRAME_BYTES, Frame, FrameVerdict, check, frame_size
from skygcs.core.mavlink.parser import FrameParser

CLOCK_STEP_US = 24 * 3600 * 1_000_000
"""Two neighbouring records whose times differ by more than a day: the clock was set, a byte was damaged, or another
flight was appended to the file. Such a step is no part of the flight's duration."""

TIME_BYTES = 8

_REAL_TIMES_US = range(946_684_800_000_000, 4_102_444_800_000_000)
"""The years 2000 to 2099: such a time was written by a clock that was set; noise falls into the range once in 5,000."""

_WINDOW_BYTES = 65536
_SCAN_BYTES = 4096
"""Searched at once for the next magic byte; noise has one in 128 bytes."""

_RECORD_BYTES = 2 * TIME_BYTES + MAX_FRAME_BYTES + 1
"""The longest record, and the time and the first byte of the next one."""

_SNIFF_BYTES = 16 << 20
"""How far `sniff` searches for the first frame."""

_SNIFF_SHARE = 0.05
"""Least share of good frames in a 64 kB window: 10 MB of noise contain one good frame (some 30 bytes) by chance."""

_MAGIC = re.compile(rb"[\xfd\xfe]")


class ByteSource(Protocol):
    """Source that is read: bytes, or a file in pieces."""

    def __len__(self) -> int: ...

    @overload
    def __getitem__(self, index: int, /) -> int: ...

    @overload
    def __getitem__(self, index: slice, /) -> bytes: ...


LogKind = Literal["tlog", "raw"]

LATEST_UNIX_S = 1 << 31
"""The seconds of ROS messages have 31 bits; a time beyond (2038) was never a flight's."""


class LogEntry:
    """One record of a tlog, or one frame of a raw capture.

    ``frame`` is None for a wrong CRC only, and its ``info`` for an unknown id. ``unix_us`` is the time as written, None
    in a raw capture. ``at_s`` counts from the beginning and never decreases; in a raw capture it follows the senders'
    clocks. ``offset`` is the record's first byte in the file, in a raw capture that of its 4 kB. ``dated_us`` is
    ``unix_us``, or the time of the record before where the neighbours' times show that ``unix_us`` is wrong.
    """

    __slots__ = ("at_s", "dated_us", "frame", "offset", "raw", "unix_us", "verdict")

    def __init__(
        self, raw: bytes, frame: Frame | None, verdict: FrameVerdict, unix_us: int | None, at_s: float, offset: int
    ) -> None:
        self.raw = raw
        self.frame = frame
        self.verdict: FrameVerdict = verdict
        self.unix_us = unix_us
        self.at_s = at_s
        self.offset = offset
        self.dated_us = unix_us

    def __repr__(self) -> str:
        return f"<LogEntry at {self.offset} {self.verdict} {self.frame or len(self.raw)}>"

    def unix_ns(self) -> int | None:
        """Its time for files of other programs, in nanoseconds; None for one that these cannot hold.
        `LogReader.faults` counts what a wrong time does to the order."""
        unix_ns = 1000 * self.dated_us if self.dated_us is not None else round(self.at_s * 1e9)
        return unix_ns if 0 <= unix_ns < LATEST_UNIX_S * 10**9 else None


def encode_record(unix_us: int, raw: bytes) -> bytes:
    """The record of one frame. Raises OverflowError for a time before 1970 or after the year 586,000."""
    return unix_us.to_bytes(TIME_BYTES, "big") + raw


class RecordFinder:
    """Finds the records of a tlog one after the other. Never raises, whatever the bytes are."""

    def __init__(self, data: ByteSource, dialect: Dialect) -> None:
        self.at = 0
        """Where it searches next."""
        self._data = data
        self._size = len(data)
        self._messages = dialect.messages
        self._last_us: int | None = None
        self._order: Literal["big", "little"] | None = None
        """Order of the bytes of a time; None: not known yet, and read as "big"."""

    @property
    def at_end(self) -> bool:
        """True if the whole file was read."""
        return self.at >= self._size

    def find(self, looks: int) -> LogEntry | None:
        """The next record, its time not yet in ``at_s``, if it is found within so many looks; else None, and the next
        call continues there. A file without any record takes some 10 s for each MB, so a caller that has other work
        asks for few looks at a time."""
        for _ in range(looks):
            at = self.at
            window = self._data[at : at + _RECORD_BYTES]
            if len(window) <= TIME_BYTES:  # the end, or the file was truncated meanwhile
                self.at = self._size
                return None
            if window[TIME_BYTES] in HEADER_BYTES:
                entry = self._record_in(window, at)
                if entry is not None:
                    self.at = at + TIME_BYTES + len(entry.raw)
                    return entry
                self.at = at + 1
            else:
                self.at = at + self._distance_to_magic(at + TIME_BYTES)
        return None

    def _distance_to_magic(self, at: int) -> int:
        """Bytes to the next magic byte, or to the end of the window; at least 1."""
        window = self._data[at : at + _SCAN_BYTES]
        found = _MAGIC.search(window)
        return found.start() if found is not None else max(len(window), 1)

    def _record_in(self, window: bytes, at: int) -> LogEntry | None:
        """The record that ``window`` begins with, if it is one; ``at`` is its place in the file."""
        size = frame_size(window, TIME_BYTES)
        raw = window[TIME_BYTES : TIME_BYTES + size]
        if not size or len(raw) < size:
            return None
        frame, verdict = check(raw, self._messages)
        if self._order is None and verdict == "ok":
            self._order = _order_of(window[:TIME_BYTES], window[TIME_BYTES + size :])
        unix_us = self._time_us(window)
        if verdict != "ok":
            following = window[TIME_BYTES + size :]
            if not self._in_place(unix_us, following) or self._holds_record(unix_us, raw):
                return None
        self._last_us = unix_us
        return LogEntry(raw, frame, verdict, unix_us, 0.0, at)

    def _time_us(self, record: bytes) -> int:
        return int.from_bytes(record[:TIME_BYTES], self._order or "big")

    def _in_place(self, unix_us: int, following: bytes) -> bool:
        """True if a record follows; at the end of the file, whether one went before.

        Its time must be near this one's, or both real: without that, noise would make a bad record of every 16 kB.
        """
        if len(following) <= TIME_BYTES:
            other = self._last_us
        elif following[TIME_BYTES] in HEADER_BYTES:
            other = self._time_us(following)
        else:
            return False
        return unix_us in _REAL_TIMES_US if other is None else _belong_together(unix_us, other)

    def _holds_record(self, unix_us: int, raw: bytes) -> bool:
        """True if a good record stands inside: then the length is damaged and the record would be lost."""
        for found in _MAGIC.finditer(raw, TIME_BYTES):
            at = found.start()
            size = frame_size(raw, at)
            if not size or at + size > len(raw):
                continue
            time = self._time_us(raw[at - TIME_BYTES : at])
            if _belong_together(unix_us, time) and check(raw[at : at + size], self._messages)[1] == "ok":
                return True
        return False


def _order_of(time: bytes, following: bytes) -> Literal["big", "little"] | None:
    """Order of the bytes of a file's times, by a good record and what follows it; None: it does not show."""
    if int.from_bytes(time, "big") in _REAL_TIMES_US:
        return "big"
    if len(following) <= TIME_BYTES or following[TIME_BYTES] not in HEADER_BYTES:
        return None
    both = (int.from_bytes(one, "little") for one in (time, following[:TIME_BYTES]))
    return "little" if all(one in _REAL_TIMES_US for one in both) else None


def _belong_together(a_us: int, b_us: int) -> bool:
    """True if these may be the times of two records of one file: near each other, or both real."""
    if a_us in _REAL_TIMES_US and b_us in _REAL_TIMES_US:
        return True
    return -CLOCK_STEP_US < a_us - b_us < CLOCK_STEP_US and a_us < _REAL_TIMES_US.stop


def sniff(data: ByteSource, dialect: Dialect) -> LogKind | None:
    """The kind of file: a tlog, a raw capture (bytes as they came from a link), or None for neither.

    Decides by the first window that holds good frames: a tlog has 8 bytes between its frames, a raw capture none.
    """
    size = min(len(data), _SNIFF_BYTES)
    for start in range(0, size, _WINDOW_BYTES):
        window = data[start : start + _WINDOW_BYTES]
        stream = FrameParser(dialect)
        raw_bytes = sum(len(frame.raw) for frame in stream.feed_datagram(window) if frame.info is not None)
        tlog_bytes, tlog_skipped = _good_records(window, dialect)
        if max(raw_bytes, tlog_bytes) < _SNIFF_SHARE * len(window) and len(data) > _WINDOW_BYTES:
            continue
        if not raw_bytes and not tlog_bytes:
            continue
        return "tlog" if tlog_skipped < stream.stats.skipped_bytes else "raw"
    return None


def _good_records(window: bytes, dialect: Dialect) -> tuple[int, int]:
    """Bytes in frames of good records, and bytes in no record."""
    finder = RecordFinder(window, dialect)
    good = in_records = 0
    while not finder.at_end:
        entry = finder.find(_SCAN_BYTES)
        if entry is not None:
            in_records += TIME_BYTES + len(entry.raw)
            good += len(entry.raw) if entry.verdict == "ok" else 0
    return good, len(window) - in_records
