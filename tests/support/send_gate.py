"""A gate of vehicles for tests: open until a time, for each of them."""

from __future__ import annotations

import math
from collections.abc import Collection


class TimedGate:
    """A `SendGate`. With ``fault`` it raises."""

    def __init__(self, *sysids: int) -> None:
        self.until = dict.fromkeys(sysids, -math.inf)
        self.fault: Exception | None = None

    @property
    def sysids(self) -> Collection[int]:
        return self.until.keys()

    def refusal(self, sysid: int, now: float) -> str | None:
        if self.fault is not None:
            raise self.fault
        return None if now < self.until[sysid] else f"{sysid} is not ours now"
