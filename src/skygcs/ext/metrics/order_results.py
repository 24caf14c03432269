"""Orders that ended, by what they were and their result, for the metrics of a daemon."""

from __future__ import annotations

from collections import Counter

from skygcs.events import Event
from skygcs.runtime.event_log import EventLog

MAX_ORDER_RESULTS = 512
"""Pairs of order and result that are counted apart: 40 orders have a dozen results. Further ones are "other"."""


class OrderResults:
    """Make it before links open: it counts orders from then on."""

    def __init__(self, event_log: EventLog) -> None:
        self.counts: Counter[tuple[str, str]] = Counter()
        event_log.on("command", self._on_order)

    def _on_order(self, event: Event) -> None:
        result = event.data.get("result")
        if result is None or result == "in_progress":
            return
        pair = (str(event.data.get("order", "command")), str(result))
        if pair not in self.counts and len(self.counts) >= MAX_ORDER_RESULTS:
            pair = ("other", "other")
        self.counts[pair] += 1
