"""Rate, latency and drop-outs of the poses of one rigid body. Pure."""

from __future__ import annotations

from collections import deque
from typing import Any

WINDOW_S = 5.0
"""Rates and latencies are those of the last while."""

MAX_SAMPLES = 2048
"""400 Hz for `WINDOW_S`: the fastest cameras."""


class PoseStatistics:
    """Call `arrived` for each accepted pose, `sent` for each message, `gone` when tracking ends."""

    def __init__(self) -> None:
        self.dropouts = 0
        """Times the body was lost after it had been tracked."""
        self.longest_dropout_s = 0.0
        self.sent_count = 0
        self._arrivals: deque[tuple[float, float]] = deque(maxlen=MAX_SAMPLES)
        self._sent: deque[float] = deque(maxlen=MAX_SAMPLES)
        self._last_at: float | None = None
        self._gone = False

    def arrived(self, captured_at: float, now: float) -> None:
        """A pose was accepted: captured then, here now."""
        if self._gone and self._last_at is not None:
            self.longest_dropout_s = max(self.longest_dropout_s, captured_at - self._last_at)
            self._gone = False
        self._last_at = captured_at
        self._arrivals.append((now, max(0.0, now - captured_at)))

    def gone(self) -> bool:
        """The body was lost; True the first time since it was tracked."""
        if self._gone or self._last_at is None:
            return False
        self._gone = True
        self.dropouts += 1
        return True

    def sent(self, now: float) -> None:
        self.sent_count += 1
        self._sent.append(now)

    def age_s(self, now: float) -> float | None:
        """Since the last accepted pose was captured; None if there was none."""
        return None if self._last_at is None else max(0.0, now - self._last_at)

    def status(self, now: float) -> dict[str, Any]:
        """JSON-able."""
        since = now - WINDOW_S
        while self._arrivals and self._arrivals[0][0] < since:
            self._arrivals.popleft()
        while self._sent and self._sent[0] < since:
            self._sent.popleft()
        delays = sorted(delay for _, delay in self._arrivals)
        age_s = self.age_s(now)
        longest_s = self.longest_dropout_s
        if self._gone and age_s is not None:
            longest_s = max(longest_s, age_s)
        return {
            "age_s": None if age_s is None else round(age_s, 3),
            "rate_hz": round(len(delays) / WINDOW_S, 1),
            "sent_hz": round(len(self._sent) / WINDOW_S, 1),
            "sent": self.sent_count,
            "latency_p50_s": round(delays[len(delays) // 2], 4) if delays else None,
            "latency_max_s": round(delays[-1], 4) if delays else None,
            "dropouts": self.dropouts,
            "longest_dropout_s": round(longest_s, 3),
        }
