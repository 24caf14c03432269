"""Which entries of a log are wanted."""

from __future__ import annotations

from dataclasses import dataclass

from skygcs.tlog.reading import LogEntry

SourceFilter = tuple[int, int | None]
"""System and component; None: any component."""


@dataclass(frozen=True, slots=True)
class Selection:
    """Everything that is set must hold; what is not set holds for all.

    ``begin``, ``end``: seconds from the beginning (float) or microseconds since 1970 (int), both included.
    ``addressed``: what is addressed to one of the ``sources`` counts as well. What no CRC vouches for is taken as long
    as neither sources nor messages are asked for; an unknown id goes by its header.
    """

    begin: float | int | None = None
    end: float | int | None = None
    sources: frozenset[SourceFilter] = frozenset()
    messages: frozenset[int] = frozenset()
    without: frozenset[int] = frozenset()
    addressed: bool = False

    @property
    def absolute(self) -> bool:
        """Whether a time of day is asked for, which a raw capture does not have."""
        return isinstance(self.begin, int) or isinstance(self.end, int)

    @property
    def timed(self) -> bool:
        return self.begin is not None or self.end is not None

    def takes(self, entry: LogEntry) -> bool:
        return self.in_time(entry) and self.takes_frame(entry)

    def in_time(self, entry: LogEntry) -> bool:
        """Entries without a time of day are not taken if one is asked for."""
        begin, end = self.begin, self.end
        if begin is not None:
            time = entry.unix_us if isinstance(begin, int) else entry.at_s
            if time is None or time < begin:
                return False
        if end is not None:
            time = entry.unix_us if isinstance(end, int) else entry.at_s
            if time is None or time > end:
                return False
        return True

    def takes_frame(self, entry: LogEntry) -> bool:
        frame = entry.frame
        if frame is None:
            return not (self.sources or self.messages)
        if frame.msgid in self.without or (self.messages and frame.msgid not in self.messages):
            return False
        if not self.sources or self.has(frame.sysid, frame.compid):
            return True
        system, component = frame.target() if self.addressed else (0, 0)
        return bool(system) and any(s == system and c in (None, 0, component) for s, c in self.sources)

    def has(self, sysid: int, compid: int) -> bool:
        """Whether this source is asked for; all are if none is named."""
        return not self.sources or (sysid, None) in self.sources or (sysid, compid) in self.sources
