"""The last frame of one message of one vehicle, and how often it comes."""

from __future__ import annotations

from skygcs.core.mavlink.frame import Frame

SMOOTHING = 0.4
"""Weight of the newest second: a 1 Hz message sampled once a second is counted 0, 1 or 2 times."""


class Slot:
    """``frame`` is None only after a reboot; ``rate_hz`` is smoothed over some seconds."""

    __slots__ = ("_mark", "_sampled", "at", "count", "frame", "name", "rate_hz")

    def __init__(self, name: str) -> None:
        self.name = name
        self.frame: Frame | None = None
        self.at = 0.0
        self.count = 0
        self.rate_hz = 0.0
        self._mark = 0
        self._sampled = False

    def sample(self, period_s: float) -> None:
        """To be called about once a second with the time since the last call."""
        measured = (self.count - self._mark) / period_s
        self._mark = self.count
        if self._sampled:
            self.rate_hz += SMOOTHING * (measured - self.rate_hz)
            if self.rate_hz < 0.01:
                self.rate_hz = 0.0
        else:
            self.rate_hz = measured
            self._sampled = True
