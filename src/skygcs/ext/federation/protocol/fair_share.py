"""Places of one pool among senders: none can take them all, and one that comes late finds some. Pure.

The dynamic threshold of shared buffers (Choudhury and Hahne, "Dynamic queue length thresholds for shared-memory packet
switches", IEEE/ACM Transactions on Networking 6(2), 1998): a sender may take a place while it has fewer than ``factor``
times the free ones. Of M places one greedy sender gets M factor / (1 + factor), n of them M factor / (1 + n factor)
each, and M / (1 + n factor) stay free.
"""

from __future__ import annotations

from collections import Counter


class FairShare:
    """One pool. Call `give_back` once for each `take`."""

    def __init__(self, places: int, factor: float = 1.0) -> None:
        self.places = places
        self._factor = factor
        self._taken: Counter[str] = Counter()
        self._total = 0

    def __len__(self) -> int:
        return self._total

    def of(self, sender: str) -> int:
        """How many this sender has."""
        return self._taken.get(sender, 0)

    def has_room(self, sender: str) -> bool:
        """True if this sender may take a place."""
        return self.of(sender) < self._factor * (self.places - self._total)

    def take(self, sender: str) -> None:
        """Take a place, whether there is room or not."""
        self._taken[sender] += 1
        self._total += 1

    def give_back(self, sender: str) -> None:
        self._total -= 1
        self._taken[sender] -= 1
        if self._taken[sender] <= 0:
            del self._taken[sender]
