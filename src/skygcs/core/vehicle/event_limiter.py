"""Limits the events of each vehicle and kind: a vehicle whose state alternates must not fill log and event list.

Each source and kind has a token bucket. While it is empty, further events are withheld: counted, and the newest kept.
At the end of the period the newest passes, with the number withheld. So the last event always shows the present
state, although not every change before it is reported.
"""

from __future__ import annotations

from collections.abc import Hashable
from dataclasses import dataclass, replace
from typing import NamedTuple

from skygcs.events import Event


class Limit(NamedTuple):
    """``burst`` events at once, then one per ``period_s``: the newest of those withheld."""

    burst: int
    period_s: float


STATE = Limit(30, 1.0)
"""A vehicle that lands, is disarmed and armed again makes some ten changes in a minute. The newest state is shown after
at most a second."""

TEXT = Limit(60, 5.0)
"""ArduPilot sends some 30 texts when it starts, and up to 20 pre-arm reasons at once every 30 s."""

ORDER = Limit(100, 0.1)
"""A program that gives ten orders a second finds each outcome among the events."""

WARNING = 4
"""MAV_SEVERITY_WARNING; lower is worse."""

URGENT_TEXT = "urgent text"
"""Errors and worse have a bucket of their own, so that frequent other texts cannot hide a crash."""

LIMITS = {"statustext": TEXT, URGENT_TEXT: TEXT, "command": ORDER, "params": ORDER, "mission": ORDER}

GROUPS = {
    "disarmed": "armed",
    "vehicle_back": "vehicle_lost",
    "link_down": "link_up",
    "link_recovered": "link_degraded",
}
"""Kinds that undo each other share a bucket: the newer of the two is kept."""

MAX_SOURCES = 1024
"""Buckets: 250 vehicles with four kinds of changes each on a bad link. Further vehicles share one bucket per kind."""


@dataclass(slots=True)
class _Bucket:
    limit: Limit
    tokens: float
    filled_at: float
    newest: Event | None = None
    """The newest of the withheld events."""
    withheld: int = 0
    withheld_since: float = 0.0

    def take(self, now: float) -> bool:
        burst, period_s = self.limit
        self.tokens = min(float(burst), self.tokens + max(0.0, now - self.filled_at) / period_s)
        self.filled_at = now
        if self.tokens < 1.0:
            return False
        self.tokens -= 1.0
        return True


class EventLimiter:
    """Call `offer` for every event and `tick` once to ten times a second; both return the events that pass, in
    order."""

    def __init__(self) -> None:
        self.withheld = 0
        """Total number of events that were only counted."""
        self._buckets: dict[Hashable, _Bucket] = {}

    def offer(self, event: Event, now: float) -> tuple[Event, ...]:
        """The event if it passes, after withheld events that are due."""
        bucket = self._bucket(event, now)
        due = self._due(bucket, now)
        if bucket.newest is None and bucket.take(now):
            return (event,) if due is None else (due, event)
        if bucket.newest is None:
            bucket.withheld_since = now
        bucket.newest = event
        bucket.withheld += 1
        return () if due is None else (due,)

    def tick(self, now: float) -> tuple[Event, ...]:
        """Return the withheld events whose period is over."""
        passed = [due for bucket in self._buckets.values() if (due := self._due(bucket, now)) is not None]
        for key in [key for key, bucket in self._buckets.items() if _is_idle(bucket, now)]:
            del self._buckets[key]
        return tuple(passed)

    def flush(self, now: float) -> tuple[Event, ...]:
        """Return all withheld events; no more events follow."""
        return tuple(e for bucket in self._buckets.values() if (e := self._newest(bucket, now)) is not None)

    def _due(self, bucket: _Bucket, now: float) -> Event | None:
        if bucket.newest is None or now - bucket.withheld_since < bucket.limit.period_s:
            return None
        bucket.take(now)
        return self._newest(bucket, now)

    def _newest(self, bucket: _Bucket, now: float) -> Event | None:
        event, count, seconds = bucket.newest, bucket.withheld - 1, max(0.0, now - bucket.withheld_since)
        bucket.newest, bucket.withheld = None, 0
        if event is None or count <= 0:
            return event
        self.withheld += count
        text = f"{event.text} ({count} more of this kind in the last {seconds:.1f} s)"
        return replace(event, text=text, data={**event.data, "withheld": count, "withheld_s": round(seconds, 1)})

    def _bucket(self, event: Event, now: float) -> _Bucket:
        kind = GROUPS.get(event.kind, event.kind)
        if kind == "statustext" and event.data.get("level", WARNING) < WARNING:
            kind = URGENT_TEXT
        key: Hashable = (event.vehicle or event.sysid or event.data.get("link"), kind)
        if kind in ("statustext", URGENT_TEXT):
            key = (event.vehicle or event.sysid, event.data.get("compid"), kind)
        bucket = self._buckets.get(key)
        if bucket is None and len(self._buckets) >= MAX_SOURCES:
            key = kind
            bucket = self._buckets.get(key)
        if bucket is None:
            limit = LIMITS.get(kind, STATE)
            bucket = self._buckets[key] = _Bucket(limit, float(limit.burst), now)
        return bucket


def _is_idle(bucket: _Bucket, now: float) -> bool:
    """True if the bucket is full again: a new one would behave alike."""
    burst, period_s = bucket.limit
    return bucket.newest is None and bucket.tokens + (now - bucket.filled_at) / period_s >= burst
