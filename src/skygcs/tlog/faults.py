"""What was wrong with a log, with the byte where it was found."""

from __future__ import annotations

from collections import Counter

PLACES = 3
"""Told of each kind; all are counted."""

JITTER_US = 10_000
"""A record so much older than the one before is no fault: programs write with several threads (up to 3.3 ms in own
recordings of before they had one clock), and nothing that is drawn or counted shows it."""

UNKNOWN_IDS = 8
"""Different ids told; noise may look like any of 16 million."""


class Places:
    """How often something was found and where the first few times were: (byte, what)."""

    __slots__ = ("_where", "count", "first")

    def __init__(self, where: str) -> None:
        self._where = where
        self.count = 0
        self.first: list[tuple[int, str]] = []

    def note(self, offset: int, what: str = "") -> None:
        self.count += 1
        if len(self.first) < PLACES:
            self.first.append((offset, what))

    def __str__(self) -> str:
        named = ", ".join(f"{offset}{what and f' ({what})'}" for offset, what in self.first)
        return f"{self._where} {named}{' …' if self.count > len(self.first) else ''}"


class LogFaults:
    """Faults of one log; ``where``: what the byte is that is told of each."""

    def __init__(self, where: str = "at byte") -> None:
        self.bad_crc = Places(where)
        self.unknown = Places(where)
        self.unknown_ids: Counter[int] = Counter()
        self.skipped = Places(where)
        self.skipped_bytes = 0
        self.backwards = Places(where)
        """By more than JITTER_US."""
        self.out_of_order = 0
        """Records older than the one before, by how little soever."""
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
        """``end``: the file ends with these bytes, as it does if a record was cut off."""
        self.skipped_bytes += size
        self.skipped.note(offset, f"{size:,} to the end of the file" if end else f"{size:,} bytes")

    def lines(self) -> list[str]:
        """One sentence for each kind of fault that was found; [] for a sound log."""
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
