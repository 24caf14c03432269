"""Clocks of the daemon, and a timer, exact where uvloop rounds to whole milliseconds; and one clock for gates."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable

SAME_WITHIN_S = 10.0
"""uvloop's clock is that of the begin of the turn, in whole milliseconds; a turn takes no 10 s."""

EARLY_S = 0.001
"""uvloop's clock has whole milliseconds and rounds delays: a timer may fire up to half a millisecond early."""


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


class DeadlineTimer:
    """Calls ``ring()`` once at the time it is `set` for, or later, never before. An owner of several deadlines sets it
    to the earliest whenever one of them may have changed, and after each ring.

    The time is kept here because uvloop returns a plain Handle without ``when`` for a time that is almost due.
    """

    def __init__(self, loop: asyncio.AbstractEventLoop, ring: Callable[[], None]) -> None:
        self._loop = loop
        self._ring = ring
        self._timer: asyncio.Handle | None = None
        self._due: float | None = None

    @property
    def due(self) -> float | None:
        """When it rings next; None: not set."""
        return self._due

    def set(self, due: float | None) -> None:
        """Set it to this loop time; None: do not ring."""
        if due == self._due:
            return
        if self._timer is not None:
            self._timer.cancel()
            self._timer = None
        self._due = due
        if due is not None:
            self._timer = self._loop.call_at(due, self._rang)

    def _rang(self) -> None:
        due = self._due
        if due is not None and self._loop.time() < due:
            # not at once: the loop would spin until its clock has advanced
            self._timer = self._loop.call_later(EARLY_S, self._rang)
            return
        self._timer = self._due = None
        self._ring()
