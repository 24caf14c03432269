"""Notices that this computer slept: the loop's clock stood still meanwhile, so what came before looks fresh.

CLOCK_BOOTTIME goes on during a suspend, CLOCK_MONOTONIC (which both loops use) does not: what the first gains on the
second is the time that was slept. What counts across computers reads CLOCK_BOOTTIME itself.
"""

from __future__ import annotations

import time
from collections.abc import Callable

LEAST_S = 0.5
"""A shorter sleep is no older than a late message. The two clocks are otherwise equal to the microsecond."""


def slept_s() -> float:
    """How long this computer has slept since it was started."""
    return time.clock_gettime(time.CLOCK_BOOTTIME) - time.clock_gettime(time.CLOCK_MONOTONIC)


class SleepWatch:
    """Call `check` before anything is done with a state or a deadline of before: at every control tick, and often
    without one. ``on_woke(seconds)`` is called once after each sleep."""

    def __init__(self, on_woke: Callable[[float], None], slept_s: Callable[[], float] = slept_s) -> None:
        self.slept_s = slept_s
        self._on_woke = on_woke
        self._known_s = slept_s()

    def check(self) -> bool:
        """True if the computer has slept since the last call."""
        now_s = self.slept_s()
        seconds = now_s - self._known_s
        if seconds < LEAST_S:
            return False
        self._known_s = now_s
        self._on_woke(seconds)
        return True
