"""The time of a recording, and when each record is due when it is played."""

from __future__ import annotations

from skygcs.tlog.format import CLOCK_STEP_US

REORDERED_S = 5.0
"""Records up to this much older than the newest are out of order (several threads write, a radio queues) and count as
simultaneous with it; for older ones the clock was set back. The public logs have jitter of some ms."""

LONGEST_GAP_S = 10.0
"""When played, a longer pause is cut to this: the time between two flights in one file."""


class Timeline:
    """Seconds since the recording began; a clock that steps by a day, or is set back, takes no time."""

    __slots__ = ("_elapsed_us", "_last_us", "_newest_us", "set_back")

    def __init__(self) -> None:
        self._last_us: int | None = None
        self._elapsed_us = 0
        """The time of the last record; its clock may be behind the newest one's by REORDERED_S."""
        self._newest_us = 0
        self.set_back = 0
        """How often the clock was set back."""

    def dated_us(self, unix_us: int, following_us: int | None) -> int:
        """Return the time of the next record: that of the record before it if its own is far from both those of the
        records before and after it, which are near each other. A damaged byte does that, and two programs with
        different clocks that write one file; a clock that is set does not."""
        last_us = self._last_us
        if last_us is None or following_us is None or abs(following_us - last_us) > REORDERED_S * 1e6:
            return unix_us
        wrong = min(abs(unix_us - last_us), abs(unix_us - following_us)) > REORDERED_S * 1e6
        return last_us if wrong else unix_us

    def at_s(self, unix_us: int) -> float:
        """The time of the next record; never less than before."""
        last_us = self._last_us
        self._last_us = unix_us
        if last_us is not None and -CLOCK_STEP_US < unix_us - last_us < CLOCK_STEP_US:
            self._elapsed_us += unix_us - last_us
        if self._newest_us - self._elapsed_us > REORDERED_S * 1e6:
            self.set_back += 1
            self._elapsed_us = self._newest_us
        self._newest_us = max(self._newest_us, self._elapsed_us)
        return self._newest_us / 1e6


class Pace:
    """When each record of a recording is due when it is played ``speed`` times as fast (0: everything at once)."""

    def __init__(self, speed: float) -> None:
        self._speed = speed
        self._before_s: float | None = None
        self._due_s = 0.0

    def due_s(self, at_s: float) -> float:
        """Seconds after the first record at which this one is due."""
        if self._before_s is not None and self._speed:
            self._due_s += min(max(at_s - self._before_s, 0.0), LONGEST_GAP_S) / self._speed
        self._before_s = at_s
        return self._due_s
