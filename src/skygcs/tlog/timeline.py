"""The time of a recording: it never runs backwards, whatever the clock that wrote it did."""

from __future__ import annotations

REORDERED_S = 5.0
"""Records up to this much older than the newest are out of order (several threads write, a radio queues) and count as
simultaneous with it; older ones tell that the clock was set back. The public logs have jitter of some ms."""

LONGEST_GAP_S = 10.0
"""When played, a longer pause is cut to this: the time between two flights in one file. As links of type replay do."""

LEAST_SPEED, MAX_SPEED = 0.01, 1000.0
"""Times as fast as recorded. Slower, the longest pause would take over 17 minutes; faster is 0: as fast as possible."""


def speed_problem(speed: float) -> str | None:
    """What is wrong with a speed, in words; None: nothing."""
    if speed == 0 or LEAST_SPEED <= speed <= MAX_SPEED:
        return None
    return f"must be 0 (as fast as possible) or {LEAST_SPEED:g} to {MAX_SPEED:g}, not {speed:g}"


class Timeline:
    """Seconds since the recording began, from `Record.elapsed_s`, in which a clock set back takes no time."""

    __slots__ = ("_newest_s", "_shift_s", "set_back")

    def __init__(self) -> None:
        self._newest_s: float | None = None
        self._shift_s = 0.0
        self.set_back = 0
        """How often the clock was set back."""

    def at(self, elapsed_s: float) -> float:
        """The time of the next record; never less than before."""
        newest_s = self._newest_s
        time_s = elapsed_s + self._shift_s
        if newest_s is None or time_s >= newest_s:
            self._newest_s = time_s
            return time_s
        if newest_s - time_s > REORDERED_S:
            self.set_back += 1
            self._shift_s = newest_s - elapsed_s
        return newest_s


class Pace:
    """When each record of a recording is due when it is played ``speed`` times as fast (0: everything at once)."""

    def __init__(self, speed: float) -> None:
        self._speed = speed
        self._before_s: float | None = None
        self._due_s = 0.0

    def due_s(self, at_s: float) -> float:
        """Seconds after the first record was played."""
        if self._before_s is not None and self._speed:
            self._due_s += min(max(at_s - self._before_s, 0.0), LONGEST_GAP_S) / self._speed
        self._before_s = at_s
        return self._due_s
