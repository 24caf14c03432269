"""Token bucket: the one rate limiter of the project, in bytes or in messages."""

from __future__ import annotations

TOLERANCE = 3e-6
"""Share of the burst by which the bucket may be overdrawn: sums of floats at large clock values are no more exact."""


class TokenBucket:
    """``rate`` tokens a second, of which ``burst`` can be saved up. It begins full.

    Over any time W no more than rate * W + burst are spent by a caller that waits for `ready_at` (or uses `take`). An
    amount above the burst can be spent when the bucket is full.
    """

    __slots__ = ("_at", "_saved", "burst", "rate")

    def __init__(self, rate: float, burst: float, now: float = 0.0) -> None:
        self.rate = rate
        self.burst = burst
        self._saved = burst
        self._at = now

    def saved(self, now: float) -> float:
        """Tokens that can be spent at once; below 0 after an amount above the burst."""
        if now > self._at:
            self._saved = min(self.burst, self._saved + (now - self._at) * self.rate)
            self._at = now
        return self._saved

    def set_rate(self, rate: float, now: float) -> None:
        """Change the rate from now on; what was saved stays."""
        self.saved(now)
        self.rate = rate

    def set_burst(self, burst: float, now: float) -> None:
        """Change the burst from now on; what was saved beyond it is lost."""
        self._saved = min(self.saved(now), burst)
        self.burst = burst

    def ready_at(self, amount: float, now: float, *, reserve: float = 0.0) -> float:
        """When ``amount`` can be spent so that ``reserve`` stays; ``now`` if at once. The rate must be positive."""
        missing = min(amount + reserve, self.burst) - self.saved(now)
        return now if missing <= TOLERANCE * self.burst else now + missing / self.rate

    def spend(self, amount: float, now: float) -> None:
        """Spend it, whether it is there or not."""
        self._saved = self.saved(now) - amount

    def take(self, now: float, amount: float = 1.0) -> bool:
        """Spend it if it is there; whether it was."""
        if min(amount, self.burst) - self.saved(now) > TOLERANCE * self.burst:
            return False
        self.spend(amount, now)
        return True
