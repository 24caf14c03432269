"""The pauses between attempts to open, to connect or to run again what has failed."""

from __future__ import annotations

import math


class BackOff:
    """Pauses of seconds, each twice the one before, from ``first_s`` to ``longest_s``. They begin anew after `reset`,
    and after an attempt that was a success for ``steady_s``."""

    def __init__(self, first_s: float, longest_s: float, steady_s: float = math.inf) -> None:
        self._first_s = self._next_s = first_s
        self._longest_s = longest_s
        self._steady_s = steady_s

    def reset(self) -> None:
        """Begin anew: an attempt is a success."""
        self._next_s = self._first_s

    def after(self, up_s: float = 0.0) -> float:
        """The pause after an attempt that was a success for so long; 0: it was none."""
        if up_s >= self._steady_s:
            self.reset()
        pause_s = self._next_s
        self._next_s = min(2 * pause_s, self._longest_s)
        return pause_s
