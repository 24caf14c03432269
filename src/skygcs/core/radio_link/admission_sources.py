"""One program or station that sends into a radio: what it has waiting, its rates, and what became of its frames."""

from __future__ import annotations

from collections.abc import Hashable
from typing import Any

from skygcs.core.radio_link.admission_frames import ThirdPartyFrame, is_change

OTHERS = -1
"""Key of all those who are more than are told apart."""


class Bucket:
    """Frames that one source may send of one group: a rate and a burst."""

    __slots__ = ("_at", "_tokens", "burst", "hz")

    def __init__(self, hz: float, burst: float, now: float) -> None:
        self.hz, self.burst = hz, burst
        self._tokens = burst
        self._at = now

    def ready_at(self, now: float) -> float:
        tokens = min(self.burst, self._tokens + (now - self._at) * self.hz)
        return now if tokens >= 1.0 - 1e-6 else now + (1.0 - tokens) / self.hz

    def take(self, now: float) -> bool:
        if self.ready_at(now) > now:
            return False
        self._tokens = min(self.burst, self._tokens + (now - self._at) * self.hz) - 1.0
        self._at = now
        return True


class Line:
    """What one source has waiting of one group."""

    __slots__ = ("bucket", "frames")

    def __init__(self, bucket: Bucket) -> None:
        self.bucket = bucket
        self.frames: dict[Hashable, ThirdPartyFrame] = {}


class Source:
    """One program or ground station, by what its frames say."""

    __slots__ = (
        "changes",
        "counts",
        "heard_at",
        "key",
        "late",
        "lines",
        "orders",
        "serial",
        "stops",
        "thinned",
        "told",
    )

    def __init__(self, key: int, now: float) -> None:
        self.key = key
        self.heard_at = now
        self.counts: dict[str, int] = {}
        self.lines: dict[str, Line] = {}
        """By group of `RateClass`; there are as many as message ids with a rate, at most."""
        self.orders: dict[int, Bucket] = {}
        self.stops: dict[int, Bucket] = {}
        """By vehicle."""
        self.changes: dict[int, tuple[Hashable, int]] = {}
        """By vehicle, what was to be changed there last, and its number: the same again is a repeat only of that."""
        self.serial = 0
        self.late: dict[int, Hashable] = {}
        """By vehicle, the key of the last order that did not go as one: those after it are not to overtake it."""
        self.thinned: dict[int, tuple[int, float]] = {}
        """By message id with a rate, how many were left out since when."""
        self.told: set[tuple[str, int]] = set()

    def count(self, what: str, number: int = 1) -> None:
        self.counts[what] = self.counts.get(what, 0) + number

    def key_of(self, frame: ThirdPartyFrame) -> Hashable:
        """What a repeat of it has in common with it. Of what changes something a repeat follows at once: on, off, on
        are three."""
        if not is_change(frame):
            return frame.identity
        identity, number = self.changes.get(frame.target, (None, 0))
        if identity != frame.identity:
            self.serial = number = self.serial + 1
            self.changes[frame.target] = frame.identity, number
        return (*frame.identity, number)

    @property
    def waiting(self) -> int:
        return sum(len(line.frames) for line in self.lines.values())

    def status(self, now: float) -> dict[str, Any]:
        """What became of its frames; JSON-able."""
        counts = dict(sorted(self.counts.items()))
        return {
            "source": "others" if self.key == OTHERS else f"{self.key >> 8}/{self.key & 0xFF}",
            "age_s": round(now - self.heard_at, 1),
            "waiting": self.waiting,
            "sent": counts.pop("sent", 0),
            "sent_bytes": counts.pop("sent_bytes", 0),
            "counts": counts,
        }
