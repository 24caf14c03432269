"""Ticks on absolute deadlines: a late one does not move the next, and missed ones are skipped and counted."""

from __future__ import annotations

import asyncio
from collections import deque
from collections.abc import Callable
from typing import Any

LATE_S = 0.005
"""A tick this long after its deadline is counted as late: a quarter of a period at 50 Hz."""

TICKS_KEPT = 500
"""Number of ticks whose lateness is kept for percentiles: ten seconds at 50 Hz."""

SPREAD_S = 0.05
"""Time over which clocks started together are spread: a period at 20 Hz, in which fifty vehicles have 1 ms each."""


class ControlClock:
    """Calls ``tick(now)`` every ``period_s()`` seconds between `start` and `stop`.

    The period may change from tick to tick. ``tick`` must not raise. ``phase`` (0..1) is the part of a period, of
    SPREAD_S at most, that the first tick waits: clocks that are started together tick one after the other.
    ``running_clocks`` has it while it runs.
    """

    def __init__(
        self,
        loop: asyncio.AbstractEventLoop,
        tick: Callable[[float], None],
        period_s: Callable[[], float],
        *,
        phase: float = 0.0,
        running_clocks: set[ControlClock] | None = None,
    ) -> None:
        self.ticks = 0
        self.late = 0
        self.skipped = 0
        self._loop = loop
        self._tick = tick
        self._period_s = period_s
        self._phase = phase
        self._running_clocks = set() if running_clocks is None else running_clocks
        self._due = 0.0
        self._pace_s = 0.0
        """The period when the next deadline was set."""
        self._handle: asyncio.TimerHandle | None = None
        self._lateness_s: deque[float] = deque(maxlen=TICKS_KEPT)

    @property
    def running(self) -> bool:
        return self._handle is not None

    @property
    def due(self) -> float:
        """Time at which the next tick is due, or was if it is late. Only while the clock runs."""
        return self._due

    def start(self) -> None:
        """Start; the first tick comes at once, or ``phase`` later. Without effect while it runs."""
        if self._handle is None:
            self._pace_s = self._period_s()
            self._due = self._loop.time() + self._phase * min(self._pace_s, SPREAD_S)
            self._handle = self._loop.call_at(self._due, self._run)
            self._running_clocks.add(self)

    def stop(self) -> None:
        """Stop ticking. Idempotent."""
        if self._handle is not None:
            self._handle.cancel()
            self._handle = None
            self._running_clocks.discard(self)

    def lateness_p99_s(self) -> float | None:
        """99th percentile of the last ticks; None before the first."""
        if not self._lateness_s:
            return None
        ordered = sorted(self._lateness_s)
        return ordered[min(len(ordered) - 1, int(0.99 * len(ordered)))]

    def as_dict(self) -> dict[str, Any]:
        p99_s = self.lateness_p99_s()
        return {
            "ticks": self.ticks,
            "late": self.late,
            "skipped": self.skipped,
            "lateness_p99_s": None if p99_s is None else round(p99_s, 6),
        }

    def _run(self) -> None:
        now, handle = self._loop.time(), self._handle
        lateness_s = now - self._due if now > self._due else 0.0
        self.ticks += 1
        self.late += lateness_s > LATE_S
        self._lateness_s.append(lateness_s)
        try:
            self._tick(now)
        finally:
            if self._handle is handle:  # it was neither stopped nor restarted
                self._handle = self._loop.call_at(self._next(now), self._run)

    def _next(self, now: float) -> float:
        """The next deadline after ``now``; deadlines that have passed are skipped. A longer period holds from the next
        tick on, a shorter one at once."""
        before_s, self._pace_s = self._pace_s, self._period_s()
        self._due += before_s
        if self._due <= now:
            missed = int((now - self._due) / before_s) + 1
            self.skipped += missed
            self._due += missed * before_s
        if self._pace_s < before_s and self._due > now + self._pace_s:
            self._due = now + self._pace_s
        return self._due
