"""One timer for several deadlines."""

from __future__ import annotations

import asyncio
from collections.abc import Callable


class Alarm:
    """Calls ``ring()`` once at the time it is `set` for. Whoever has several deadlines sets it for the earliest,
    whenever one of them may have changed, and anew after each ring."""

    def __init__(self, loop: asyncio.AbstractEventLoop, ring: Callable[[], None]) -> None:
        self._loop = loop
        self._ring = ring
        self._timer: asyncio.TimerHandle | None = None

    @property
    def due(self) -> float | None:
        """When it rings next; None: it does not."""
        return None if self._timer is None else self._timer.when()

    def set(self, due: float | None) -> None:
        """For this loop time instead of any other; None: for none."""
        if self._timer is not None:
            if due is not None and self._timer.when() == due:
                return
            self._timer.cancel()
            self._timer = None
        if due is not None:
            self._timer = self._loop.call_at(due, self._rang)

    def _rang(self) -> None:
        self._timer = None
        self._ring()
