"""How long to wait for an answer before it is asked for again."""

from __future__ import annotations

import math

FIRST_WAIT_S = 1.0
LEAST_WAIT_S = 0.25
MOST_WAIT_S = 5.0
"""For an answer, before it is asked for again: at first, and the bounds of what the link's own round trips make it."""


class ReplyWait:
    """How long to wait for an answer: smoothed round trip and four times its deviation, doubled when one is overdue.

    TCP's rule (RFC 6298); only answers to first requests are measured, as nobody knows which one a later answer is to.
    """

    def __init__(self) -> None:
        self.seconds = FIRST_WAIT_S
        self._mean: float | None = None
        self._deviation = 0.0
        self._doubled_at = -math.inf

    def measured(self, round_s: float) -> None:
        if self._mean is None:
            self._mean, self._deviation = round_s, round_s / 2
        else:
            self._deviation += (abs(round_s - self._mean) - self._deviation) / 4
            self._mean += (round_s - self._mean) / 8
        self.seconds = min(max(LEAST_WAIT_S, self._mean + 4 * self._deviation), MOST_WAIT_S)

    def overdue(self, now: float) -> None:
        if now - self._doubled_at >= self.seconds:
            self.seconds = min(2 * self.seconds, MOST_WAIT_S)
            self._doubled_at = now
