"""How far the daemon's clock is ahead of this process', for the deadlines of orders. Pure.

Processes of one machine share a monotonic clock; a daemon at the other end of an SSH tunnel has another one, which
drifts. Each answer of daemon.info is one comparison (`core.clock_offset`).
"""

from __future__ import annotations

from skygcs.core.clock_offset import ClockComparison
from skygcs.spelling import is_number

SAME_CLOCK_S = 0.1
"""Event loops keep the time of their turn: milliseconds, on a busy machine tens of them."""


class DaemonClock:
    """``ahead_s``: seconds to add to a time of this process; None before the first `sample`. It is kept while no answer
    comes: an order to a daemon that hangs needs its deadline most."""

    def __init__(self) -> None:
        self.ahead_s: float | None = None
        self._comparison = ClockComparison()

    def sample(self, sent_at: float, daemon_now_s: object, came_at: float) -> None:
        """The daemon's clock was ``daemon_now_s`` between two times of this process. A value that is not a time is left
        out: the daemon is of another version."""
        if not is_number(daemon_now_s):
            return
        self._comparison.add(sent_at, came_at, daemon_now_s, wall_received=0.0, remote_wall=0.0)
        best = self._comparison.best(came_at)
        if best is not None:
            same = abs(best.offset_s) <= best.error_s + SAME_CLOCK_S
            self.ahead_s = 0.0 if same else best.offset_s
