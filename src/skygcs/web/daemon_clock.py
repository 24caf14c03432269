"""How far the daemon's clock is ahead of this process', for the deadlines of orders. Pure.

Processes of one machine share a monotonic clock; a daemon at the other end of an SSH tunnel has another one. Each
answer of daemon.info bounds the difference: the daemon read its clock after the request was sent and before the answer
came.
"""

from __future__ import annotations

SAME_CLOCK_S = 0.1
"""Event loops keep the time of their turn: milliseconds, on a busy machine tens of them."""


class DaemonClock:
    """``ahead_s`` is None before the first `sample`."""

    def __init__(self) -> None:
        self._least_s = float("-inf")
        self._most_s = float("inf")

    def sample(self, sent_at: float, daemon_now_s: object, came_at: float) -> None:
        """The daemon's clock was ``daemon_now_s`` between two times of this process. A value that is no time is left
        out: the daemon is of another version."""
        if isinstance(daemon_now_s, bool) or not isinstance(daemon_now_s, int | float):
            return
        self._least_s = max(self._least_s, daemon_now_s - came_at)
        self._most_s = min(self._most_s, daemon_now_s - sent_at)

    @property
    def ahead_s(self) -> float | None:
        """Seconds to add to a time of this process; None: not known."""
        if self._most_s == float("inf"):
            return None
        if self._least_s - SAME_CLOCK_S <= 0.0 <= self._most_s + SAME_CLOCK_S:
            return 0.0
        return (self._least_s + self._most_s) / 2
