"""Reports what becomes of one vehicle's orders, as events, and knows which of them are under way."""

from __future__ import annotations

import asyncio
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial
from typing import Any

from skygcs.core.protocols.command import Outcome
from skygcs.core.vehicle.vehicle import Vehicle
from skygcs.events import Event


class OrderOutcomes:
    """The outcomes of the orders to one vehicle: each that begins is reported once when it has ended."""

    def __init__(self, vehicle: Vehicle, loop: asyncio.AbstractEventLoop, on_event: Callable[[Event], None]) -> None:
        self._vehicle = vehicle
        self._loop = loop
        self._on_event = on_event
        self._under_way: Counter[str] = Counter()

    @contextmanager
    def tracked(self, order: str) -> Iterator[Callable[[Outcome], Outcome]]:
        """An order is under way in a block, which passes its outcome to the function that is yielded: that reports and
        returns it. If the block is cancelled, that is the outcome."""
        started = self._loop.time()
        self._under_way[order] += 1
        try:
            yield partial(self.finish, order)
        except asyncio.CancelledError:
            text = "cancelled: the client that gave it is gone; what was sent already cannot be undone"
            self.finish(order, Outcome(False, "cancelled", text, elapsed_s=self._loop.time() - started))
            raise
        finally:
            self._under_way[order] -= 1

    def cut_stops(self, why: str) -> None:
        """Report each stop that is under way as lost, which is an alarm: it will not be repeated any more."""
        for _ in range(self._under_way["stop"]):
            self.finish("stop", Outcome(False, "lost", f"{why}: the stop was not confirmed, order it again"))

    def finish(self, order: str, outcome: Outcome) -> Outcome:
        """Report the outcome of an order that has ended."""
        self._publish(f"{order}: {outcome.message}", {"order": order, **outcome.as_dict()})
        return outcome

    def report_progress(self, order: str, percent: int | None) -> None:
        """Report that an order is in progress."""
        progress = "" if percent is None else f" {percent} %"
        data = {"order": order, "result": "in_progress", "percent": percent}
        self._publish(f"{order}: in progress{progress}", data)

    def _publish(self, text: str, data: dict[str, Any]) -> None:
        self._on_event(Event("command", self._vehicle.name, self._vehicle.sysid, text, data))
