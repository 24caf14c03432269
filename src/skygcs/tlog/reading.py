"""Read a log from end to end, tlog or raw capture, as one sequence of entries, and count its faults.

The one reader of the daemon's replay and of every log tool.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator

from skygcs.core.mavlink.dialect import Dialect, MessageInfo
from skygcs.core.mavlink.frame import Frame, FrameVerdict
from skygcs.core.mavlink.parser import FrameParser
from skygcs.tlog.format import CLOCK_STEP_US, ByteSource, LogEntry, LogKind, RecordFinder
from skygcs.tlog.timeline import REORDERED_S, Timeline

LOOKS = 4096
"""Places searched at a time for the next record, by a caller that has no other work."""

PIECE_BYTES = 4096
"""A raw capture is read in such pieces; its faults are reported by piece."""

BOOT_FIELD = "time_boot_ms"

PLACES = 3
"""Reported of each kind; all are counted."""

JITTER_US = 10_000
"""A record up to this much older than the one before is no fault: programs write with several threads (up to 3.3 ms in
our own early recordings), and neither plots nor counts are affected."""

UNKNOWN_IDS = 8
"""Different unknown ids that are reported; noise may look like any of 16 million."""


class Places:
    """How often a fault was found, and the first few places: (byte, what)."""

    __slots__ = ("_where", "count", "first")

    def __init__(self, where: str) -> None:
        self._where = where
        self.count = 0
        self.first: list[tuple[int, str]] = []

    def note(self, offset: int, what: str = "") -> None:
        self.count += 1
        if len(self.first) < PLACES and (offset, what) not in self.first[-1:]:
            self.first.append((offset, what))

    def __str__(self) -> str:
        named = ", ".join(f"{offset}{what and f' ({what})'}" for offset, what in self.first)
        return f"{self._where} {named}{' …' if self.count > len(self.first) else ''}"


class LogFaults:
    """Faults of one log. ``where``: how a place in the file is named."""

    def __init__(self, where: str = "at byte") -> None:
        self.bad_crc = Places(where)
        self.unknown = Places(where)
        self.unknown_ids: Counter[int] = Counter()
        self.skipped = Places(where)
        self.skipped_bytes = 0
        self.backwards = Places(where)
        """By more than JITTER_US."""
        self.out_of_order = 0
        """Records older than the one before, by any amount."""
        self.most_backwards_us = 0
        self.clock_steps = Places(where)

    def note_unknown(self, offset: int, msgid: int) -> None:
        self.unknown.note(offset)
        if msgid in self.unknown_ids or len(self.unknown_ids) < UNKNOWN_IDS:
            self.unknown_ids[msgid] += 1

    def note_backwards(self, offset: int, by_us: int) -> None:
        self.out_of_order += 1
        self.most_backwards_us = max(self.most_backwards_us, by_us)
        if by_us > JITTER_US:
            self.backwards.note(offset, f"by {by_us / 1e6:.6f} s")

    def note_skipped(self, offset: int, size: int, end: bool = False) -> None:
        """``end``: the file ends with these bytes, as when its last record is incomplete."""
        self.skipped_bytes += size
        self.skipped.note(offset, f"{size:,} to the end of the file" if end else f"{size:,} bytes")

    def lines(self) -> list[str]:
        """One sentence for each kind of fault that was found; [] for a log without faults."""
        found = []
        if self.bad_crc.count:
            found.append(f"{_records(self.bad_crc.count)} with a wrong CRC, not decoded: {self.bad_crc}")
        if self.unknown.count:
            ids = ", ".join(f"id {msgid} ×{count}" for msgid, count in self.unknown_ids.most_common())
            found.append(
                f"{_records(self.unknown.count)} of messages the dialect does not have ({ids}): {self.unknown}"
            )
        if self.skipped_bytes:
            found.append(f"{self.skipped_bytes:,} bytes belong to no record: {self.skipped}")
        if self.backwards.count:
            found.append(f"the time goes backwards {_times(self.backwards.count)}: {self.backwards}")
        if self.clock_steps.count:
            found.append(f"the clock steps by more than a day {_times(self.clock_steps.count)}: {self.clock_steps}")
        return found


def _records(count: int) -> str:
    return "1 record" if count == 1 else f"{count:,} records"


def _times(count: int) -> str:
    return "once" if count == 1 else f"{count:,} times"


class LogReader:
    """Iterator over the entries of a log in the file's order; ``faults`` are final when it ends. Never raises."""

    def __init__(self, data: ByteSource, dialect: Dialect, kind: LogKind = "tlog") -> None:
        self.faults = LogFaults() if kind == "tlog" else LogFaults("in the 4 kB from byte")
        self._data = data
        self._dialect = dialect
        self._kind = kind

    def __iter__(self) -> Iterator[LogEntry]:
        return (entry for entry in self.steps(LOOKS) if entry is not None)

    def steps(self, looks: int) -> Iterator[LogEntry | None]:
        """The entries; None each time when so many places were searched and held no record."""
        return self._tlog(looks) if self._kind == "tlog" else self._raw()

    def _tlog(self, looks: int) -> Iterator[LogEntry | None]:
        timeline = Timeline()
        held: LogEntry | None = None  # until the time after its own is known
        for entry in self._records(looks):
            if entry is None:
                yield None
                continue
            if held is not None:
                yield _timed(held, timeline, entry.unix_us)
            held = entry
        if held is not None:
            yield _timed(held, timeline, None)

    def _records(self, looks: int) -> Iterator[LogEntry | None]:
        faults, finder = self.faults, RecordFinder(self._data, self._dialect)
        end = 0
        before_us: int | None = None
        while not finder.at_end:
            entry = finder.find(looks)
            if entry is None:
                yield None
                continue
            assert entry.unix_us is not None
            # what is wrong before this entry, or with it
            if entry.offset > end:
                faults.note_skipped(end, entry.offset - end)
            end = finder.at
            if before_us is not None and not 0 <= entry.unix_us - before_us < CLOCK_STEP_US:
                self._note_step(entry.offset, entry.unix_us - before_us)
            before_us = entry.unix_us
            if entry.verdict == "bad_crc":
                faults.bad_crc.note(entry.offset)
            elif entry.verdict == "unknown" and entry.frame is not None:
                faults.note_unknown(entry.offset, entry.frame.msgid)
            yield entry
        if end < len(self._data):
            faults.note_skipped(end, len(self._data) - end, end=True)

    def _note_step(self, offset: int, step_us: int) -> None:
        if abs(step_us) >= CLOCK_STEP_US:
            self.faults.clock_steps.note(offset, f"by {step_us / 86_400e6:+,.1f} days")
        else:
            self.faults.note_backwards(offset, -step_us)

    def _raw(self) -> Iterator[LogEntry]:
        parser = FrameParser(self._dialect)
        clocks = SenderClocks()
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


def _timed(entry: LogEntry, timeline: Timeline, following_us: int | None) -> LogEntry:
    assert entry.unix_us is not None
    entry.dated_us = timeline.dated_us(entry.unix_us, following_us)
    entry.at_s = timeline.at_s(entry.dated_us)
    return entry


class SenderClocks:
    """The time of a raw capture, from its senders' own clocks (time_boot_ms): seconds since the first such field. Each
    sender's clock is set to the common time when it is first heard, and again when it reboots.
    """

    def __init__(self) -> None:
        self._now_s = 0.0
        self._shift_s: dict[tuple[int, int], float] = {}
        self._offsets: dict[int, int] = {}
        """Offset of time_boot_ms in the payload by message id; -1: no such field."""

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
            # a message to a vehicle may return the vehicle's own time to it
            at = self._offsets[info.msgid] = next(known, -1) if info.target_system_offset < 0 else -1
        return at
