"""One timer for several deadlines."""

from __future__ import annotations

import asyncio
from collections.abc import Callable

EARLY_S = 0.001
"""uvloop's clock has whole milliseconds and rounds a delay to them: a timer may fire half of one before its time."""


class DeadlineTimer:
    """Calls ``ring()`` once at the time it is `set` for, or later, never before. Whoever has several deadlines sets it
    for the earliest, whenever one of them may have changed, and anew after each ring.

    The time is kept here: uvloop returns a plain Handle, which has no ``when``, for a time that is due or nearly so.
    """

    def __init__(self, loop: asyncio.AbstractEventLoop, ring: Callable[[], None]) -> None:
        self._loop = loop
        self._ring = ring
        self._timer: asyncio.Handle | None = None
        self._due: float | None = None

    @property
    def due(self) -> float | None:
        """When it rings next; None: it does not."""
        return self._due

    def set(self, due: float | None) -> None:
        """For this loop time instead of any other; None: for none."""
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
            # not at once again: the loop would turn without a rest until its clock has moved on
            self._timer = self._loop.call_later(EARLY_S, self._rang)
            return
        self._timer = self._due = None
        self._ring()
