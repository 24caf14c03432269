"""A log from end to end, tlog or raw capture, as one sequence of entries; faults are counted on the way."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Literal

from skygcs.core.mavlink.dialect import Dialect, MessageInfo
from skygcs.core.mavlink.frame import Frame, FrameVerdict
from skygcs.core.mavlink.parser import FrameParser
from skygcs.tlog.faults import LogFaults
from skygcs.tlog.format import CLOCK_STEP_US, TIME_BYTES, ByteSource, RecordReader
from skygcs.tlog.timeline import REORDERED_S, Timeline

LogKind = Literal["tlog", "raw"]

PIECE_BYTES = 4096
"""Of a raw capture, whose faults are told to within one piece."""

BOOT_FIELD = "time_boot_ms"


class LogEntry:
    """One record of a tlog, or one frame of a raw capture.

    ``frame`` is None for a wrong CRC only, and its ``info`` for an unknown id. ``unix_us`` is the time as written, None
    in a raw capture. ``at_s`` counts from the beginning and never decreases; in a raw capture it is by the senders' own
    clocks. ``offset`` is the record's first byte in the file, in a raw capture that of its 4 kB.
    """

    __slots__ = ("at_s", "frame", "offset", "raw", "unix_us", "verdict")

    def __init__(
        self, raw: bytes, frame: Frame | None, verdict: FrameVerdict, unix_us: int | None, at_s: float, offset: int
    ) -> None:
        self.raw = raw
        self.frame = frame
        self.verdict: FrameVerdict = verdict
        self.unix_us = unix_us
        self.at_s = at_s
        self.offset = offset


class LogReader:
    """Iterator over the entries of a log in the file's order; ``faults`` are final when it ends. Never raises."""

    def __init__(self, data: ByteSource, dialect: Dialect, kind: LogKind) -> None:
        self.faults = LogFaults() if kind == "tlog" else LogFaults("in the 4 kB from byte")
        self._data = data
        self._dialect = dialect
        self._entries = self._tlog() if kind == "tlog" else self._raw()

    def __iter__(self) -> Iterator[LogEntry]:
        return self._entries

    def _tlog(self) -> Iterator[LogEntry]:
        faults, timeline = self.faults, Timeline()
        end = 0
        before_us: int | None = None
        for record in RecordReader(self._data, self._dialect):
            offset, unix_us, verdict = record.offset, record.unix_us, record.verdict
            if offset > end:
                faults.note_skipped(end, offset - end)
            end = offset + TIME_BYTES + len(record.raw)
            if before_us is not None and not 0 <= unix_us - before_us < CLOCK_STEP_US:
                self._note_step(offset, unix_us - before_us)
            before_us = unix_us
            if verdict == "bad_crc":
                faults.bad_crc.note(offset)
            elif verdict == "unknown" and record.frame is not None:
                faults.note_unknown(offset, record.frame.msgid)
            yield LogEntry(record.raw, record.frame, verdict, unix_us, timeline.at(record.elapsed_s), offset)
        if end < len(self._data):
            faults.note_skipped(end, len(self._data) - end, end=True)

    def _note_step(self, offset: int, step_us: int) -> None:
        if abs(step_us) >= CLOCK_STEP_US:
            self.faults.clock_steps.note(offset, f"by {step_us / 86_400e6:+,.1f} days")
        else:
            self.faults.note_backwards(offset, -step_us)

    def _raw(self) -> Iterator[LogEntry]:
        parser = FrameParser(self._dialect)
        clocks = OwnClocks()
        size = len(self._data)
        for offset in range(0, size, PIECE_BYTES):
            before = parser.stats.skipped_bytes, parser.stats.bad_crc
            frames = parser.feed(self._data[offset : offset + PIECE_BYTES])
            if offset + PIECE_BYTES >= size:
                frames += parser.finish()
            for frame in frames:
                verdict: FrameVerdict = "ok" if frame.info is not None else "unknown"
                if verdict == "unknown":
                    self.faults.note_unknown(offset, frame.msgid)
                yield LogEntry(frame.raw, frame, verdict, None, clocks.at_s(frame), offset)
            self._note_raw(offset, parser.stats.skipped_bytes - before[0], parser.stats.bad_crc - before[1])

    def _note_raw(self, offset: int, skipped: int, bad_crc: int) -> None:
        for _ in range(bad_crc):
            self.faults.bad_crc.note(offset)
        if skipped:
            self.faults.note_skipped(offset, skipped)


class OwnClocks:
    """The time of bytes that nobody stamped, by their senders' own clocks (time_boot_ms): seconds since the first of
    them told it. Each sender's clock is set to the common time when it is first heard, and again when it reboots.
    """

    def __init__(self) -> None:
        self._now_s = 0.0
        self._shift_s: dict[tuple[int, int], float] = {}
        self._offsets: dict[int, int] = {}
        """Of time_boot_ms in the payload, by message id; -1 if it has none."""

    def at_s(self, frame: Frame) -> float:
        """The time of the next frame; never less than before."""
        info = frame.info
        at = -1 if info is None else self._offset(info)
        if at < 0:
            return self._now_s
        boot_s = int.from_bytes(frame.payload[at : at + 4], "little") / 1000
        source = frame.sysid, frame.compid
        time_s = boot_s + self._shift_s.get(source, self._now_s - boot_s)
        if not -REORDERED_S <= time_s - self._now_s < CLOCK_STEP_US / 1e6:
            time_s = self._now_s
        self._shift_s[source] = time_s - boot_s
        self._now_s = max(self._now_s, time_s)
        return self._now_s

    def _offset(self, info: MessageInfo) -> int:
        at = self._offsets.get(info.msgid)
        if at is None:
            known = (f.offset for f in info.fields if f.name == BOOT_FIELD and f.type == "uint32_t")
            # what is sent to a vehicle may tell the vehicle's time back to it
            at = self._offsets[info.msgid] = next(known, -1) if info.target_system_offset < 0 else -1
        return at
