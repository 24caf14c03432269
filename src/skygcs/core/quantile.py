"""Medians of a few values, and a quantile of many in bounded memory. Pure.

The sketch counts in bins whose widths grow with the value (DDSketch: Masson, Rim, Lee, VLDB 2019). What it returns is
never below the quantile and at most `GROWTH` above it.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterable

GROWTH = 1.05
"""From one edge of a bin to the next: answers are at most 5 % too large."""


def median(values: Iterable[float]) -> float:
    """The middle value, or the mean of the two; at least one is given. As statistics.median, whose module would take
    the daemon 0.15 MB."""
    ordered = sorted(values)
    middle = len(ordered) // 2
    return ordered[middle] if len(ordered) % 2 else (ordered[middle - 1] + ordered[middle]) / 2


def median_low(values: Iterable[float]) -> float:
    """The middle value, or the lower of the two; at least one is given."""
    ordered = sorted(values)
    return ordered[(len(ordered) - 1) // 2]


class QuantileSketch:
    """Counts values from ``least`` to ``greatest``; below and above they count as these.

    It forgets: answers come from the newest ``window`` to 2 * ``window`` values.
    """

    __slots__ = ("_before", "_counts", "_greatest", "_held", "_last", "_least", "_window")

    def __init__(self, least: float, greatest: float, window: int) -> None:
        self._least = least
        self._greatest = greatest
        self._last = math.ceil(math.log(greatest / least) / math.log(GROWTH))
        self._window = window
        self._counts: Counter[int] = Counter()
        self._before: Counter[int] = Counter()
        self._held = 0
        """Values in ``_counts``."""

    def __len__(self) -> int:
        """How many values the answers come from."""
        return self._held + self._before.total()

    def add(self, value: float) -> None:
        """Count a value. NaN is not counted."""
        if math.isnan(value):
            return
        if self._held >= self._window:
            self._before, self._counts, self._held = self._counts, Counter(), 0
        self._counts[self._bin(value)] += 1
        self._held += 1

    def at_most(self, quantile: float) -> float | None:
        """A value that at least this share of all is not above; None without any."""
        total = len(self)
        if total == 0:
            return None
        rank, seen = max(math.ceil(quantile * total), 1), 0
        both = self._counts + self._before
        for index in sorted(both):
            seen += both[index]
            if seen >= rank:
                return self._edge(index)
        return self._greatest

    def at_least(self) -> float | None:
        """Return what no value is below; None without any."""
        if len(self) == 0:
            return None
        lowest = min(min(counts) for counts in (self._counts, self._before) if counts)
        return 0.0 if lowest == 0 else self._edge(lowest - 1)

    def _bin(self, value: float) -> int:
        if value <= self._least:
            return 0
        if value >= self._greatest:
            return self._last
        return min(math.ceil(math.log(value / self._least) / math.log(GROWTH)), self._last)

    def _edge(self, index: int) -> float:
        """The upper end of a bin."""
        return self._greatest if index >= self._last else self._least * GROWTH**index
