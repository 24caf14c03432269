"""The clocks of the daemon: the loop's, to the microsecond, and one for gates before sending."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable

SAME_WITHIN_S = 10.0
"""uvloop's clock is that of the begin of the turn, in whole milliseconds; a turn takes no 10 s."""


def exact_clock(loop: asyncio.AbstractEventLoop) -> Callable[[], float]:
    """Return the clock that `loop.time` counts, without the rounding of uvloop: CLOCK_MONOTONIC, as both loops use it.
    A loop in virtual time keeps its own."""
    return time.monotonic if abs(loop.time() - time.monotonic()) < SAME_WITHIN_S else loop.time


def boot_clock(loop: asyncio.AbstractEventLoop) -> Callable[[], float]:
    """A clock that all processes of this machine read alike and that runs on while the machine sleeps, read anew at
    each call: CLOCK_BOOTTIME. A loop in virtual time keeps its own."""
    if exact_clock(loop) == loop.time:
        return loop.time
    return lambda: time.clock_gettime(time.CLOCK_BOOTTIME)
