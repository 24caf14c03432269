"""The loop's clock, to the microsecond."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable

SAME_WITHIN_S = 10.0
"""uvloop's clock is that of the begin of the turn, in whole milliseconds; a turn takes no 10 s."""


def exact_clock(loop: asyncio.AbstractEventLoop) -> Callable[[], float]:
    """What `loop.time` counts, without the rounding of uvloop: CLOCK_MONOTONIC, as both loops use it. A loop in
    virtual time keeps its own."""
    return time.monotonic if abs(loop.time() - time.monotonic()) < SAME_WITHIN_S else loop.time
