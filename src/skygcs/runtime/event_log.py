"""The daemon's events: limited in rate, logged, kept for a while, and passed to subscribers."""

from __future__ import annotations

import time
from collections import Counter, defaultdict
from collections.abc import Callable, Iterable
from typing import Any

import structlog

from skygcs.core.alarms import VehicleFacts, event_record, signals
from skygcs.core.vehicle.event_limiter import EventLimiter
from skygcs.events import Event

MAX_EVENTS = 1000
"""Events kept for `events.recent`: an hour of a chatty fleet; each is some 300 bytes. The oldest of the most frequent
kind makes room: a peer that makes up vehicles (some 1,000 discovered and lost in minutes) displaces no warning."""

QUIET_KINDS = frozenset({"statustext", "command", "route", "alarm"})
"""Kinds logged at level debug, because they are not changes of the daemon's own state."""

WARNING_KINDS = frozenset({"warning", "undo"})
"""Kinds logged at level warning, beside whatever raises an alarm (`core.alarms`)."""

Handler = Callable[[Event], None]
Watcher = Callable[[dict[str, Any]], None]

log = structlog.get_logger("skygcs")


class EventLog:
    """Call `publish` for each event, `tick` a few times a second and `flush` at the end."""

    def __init__(self, now: Callable[[], float]) -> None:
        self.recent: list[dict[str, Any]] = []
        """Oldest first, at most MAX_EVENTS."""
        self.counts: Counter[str] = Counter()
        """Events by kind since the start, those not logged included."""
        self.facts: Callable[[str | None], VehicleFacts] = lambda _: VehicleFacts()
        """Known facts of the vehicle of a name, for the severity of its events."""
        self._kept: Counter[str] = Counter()
        self._now = now
        self._limiter = EventLimiter()
        self._handlers: defaultdict[str, list[Handler]] = defaultdict(list)
        self._watchers: list[Watcher] = []

    def publish(self, event: Event) -> None:
        """Call the handlers, then log the event unless too many of its kind came (`EventLimiter`)."""
        self.counts[event.kind] += 1
        for handler in self._handlers.get(event.kind, ()):
            handler(event)
        self._log_all(self._limiter.offer(event, self._now()))

    def on(self, kind: str, handler: Handler) -> None:
        """Call ``handler`` with every event of this kind, also if it is not logged."""
        self._handlers[kind].append(handler)

    def subscribe(self, watcher: Watcher) -> Callable[[], None]:
        """Call ``watcher`` with every event from now on; returns how to stop it."""
        self._watchers.append(watcher)

        def remove() -> None:
            if watcher in self._watchers:
                self._watchers.remove(watcher)

        return remove

    def tick(self) -> None:
        """Log summaries of events that were held back."""
        self._log_all(self._limiter.tick(self._now()))

    def flush(self) -> None:
        """Log all that is held back."""
        self._log_all(self._limiter.flush(self._now()))

    def _log_all(self, events: Iterable[Event]) -> None:
        for event in events:
            self._log(event)

    def _log(self, event: Event) -> None:
        """Log the event, keep it, pass it to subscribers. A subscriber that fails is removed."""
        record = event_record(event, time.time(), self.facts(event.vehicle))
        self._keep(record)
        level = log.warning if _is_warning(event) else log.debug if event.kind in QUIET_KINDS else log.info
        level(event.text, kind=event.kind, **({"vehicle": event.vehicle} if event.vehicle else {}))
        for watcher in tuple(self._watchers):
            try:
                watcher(record)
            except Exception as error:
                self._watchers.remove(watcher)
                log.error("an event watcher failed and was removed", error=repr(error))

    def _keep(self, record: dict[str, Any]) -> None:
        if len(self.recent) >= MAX_EVENTS:
            ((kind, _),) = self._kept.most_common(1)
            oldest = next(n for n, kept in enumerate(self.recent) if kept["kind"] == kind)
            del self.recent[oldest]
            self._kept[kind] -= 1
        self.recent.append(record)
        self._kept[record["kind"]] += 1


def _is_warning(event: Event) -> bool:
    """True for events that the user should check although the daemon goes on: what raises an alarm, a link that is down
    (not one that has reached its end), a warning."""
    if event.kind == "alarm":  # the event that it comes from is logged, but for one that comes from a state
        return event.data.get("change") == "raised" and not event.data.get("logged")
    if any(signal.raised for signal in signals(event, VehicleFacts())):
        return True
    return event.kind in WARNING_KINDS or (event.kind == "link_down" and not event.data.get("finished"))
