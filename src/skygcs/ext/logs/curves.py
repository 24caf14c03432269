"""Curves and tracks of any length in bounded memory, thinned so that a figure looks the same."""

from __future__ import annotations

import math
from collections.abc import Sequence

MOST_BUCKETS = 1500
"""A panel is some 1,100 dots wide."""

FIRST_WIDTH_S = 0.02
"""Below this even a control loop has no more than one value."""

GAP_S = 5.0
"""Longer without a value: the line is broken. Telemetry over a shared radio may come every 2 s."""

MOST_POINTS = 4000
FIRST_TOLERANCE_M = 0.05
"""Finer than any GPS."""

MOST_SPANS = 1000
"""Mode changes or silences that are kept; more are only counted."""


class _CurveBucket:
    """Summary of what a curve did within a time: where it began, its ends, and how low and high it went."""

    __slots__ = ("begin", "broken", "end", "high", "low")

    def __init__(self, time_s: float, value: float, broken: bool) -> None:
        self.begin = self.end = self.low = self.high = (time_s, value)
        self.broken = broken

    def add(self, point: tuple[float, float]) -> None:
        self.end = point
        if point[1] < self.low[1]:
            self.low = point
        if point[1] > self.high[1]:
            self.high = point

    def swallow(self, later: _CurveBucket) -> None:
        self.add(later.low)
        self.add(later.high)
        self.end = later.end


class Curve:
    """A quantity over time. Its peaks are kept: each bucket keeps its first, last, least and greatest value."""

    __slots__ = ("_buckets", "_most", "_width_s")

    def __init__(self, most: int = MOST_BUCKETS) -> None:
        self._buckets: list[_CurveBucket] = []
        self._width_s = FIRST_WIDTH_S
        self._most = most

    def __bool__(self) -> bool:
        return bool(self._buckets)

    def add(self, time_s: float, value: float) -> None:
        """``time_s`` never decreases. Values that are not finite are no part of a curve."""
        if not math.isfinite(value):
            return
        last = self._buckets[-1] if self._buckets else None
        broken = last is not None and time_s - last.end[0] > GAP_S
        if last is not None and not broken and self._index(time_s) == self._index(last.begin[0]):
            last.add((time_s, value))
            return
        self._buckets.append(_CurveBucket(time_s, value, broken))
        while len(self._buckets) > self._most:
            self._coarsen()

    @property
    def newest(self) -> float | None:
        """The value that was added last; None without any."""
        return self._buckets[-1].end[1] if self._buckets else None

    def extremes(self) -> tuple[float, float] | None:
        """The least and the greatest value of all that were added."""
        if not self._buckets:
            return None
        return min(b.low[1] for b in self._buckets), max(b.high[1] for b in self._buckets)

    def points(self) -> tuple[list[float], list[float]]:
        """Times and values to draw a line through; NaN where it is broken."""
        times: list[float] = []
        values: list[float] = []
        for bucket in self._buckets:
            if bucket.broken:
                times.append(bucket.begin[0])
                values.append(math.nan)
            for time_s, value in sorted({bucket.begin, bucket.low, bucket.high, bucket.end}):
                times.append(time_s)
                values.append(value)
        return times, values

    def _index(self, time_s: float) -> int:
        return int(time_s / self._width_s)

    def _coarsen(self) -> None:
        """Twice the width. A break that is no longer than a bucket is not seen any more."""
        self._width_s *= 2
        kept: list[_CurveBucket] = []
        for bucket in self._buckets:
            last = kept[-1] if kept else None
            fits = last is not None and self._index(bucket.begin[0]) == self._index(last.begin[0])
            if last is not None and fits and not (bucket.broken and self._width_s < GAP_S):
                last.swallow(bucket)
            else:
                kept.append(bucket)
        self._buckets = kept


class Track:
    """Where something went, in metres. What is left out is nearer to a kept point than twice ``tolerance_m``."""

    __slots__ = ("_last_s", "_most", "_newest", "points", "tolerance_m")

    def __init__(self, most: int = MOST_POINTS) -> None:
        self.points: list[tuple[float, float, bool]] = []
        """x, y, and whether the line is broken before it."""
        self.tolerance_m = FIRST_TOLERANCE_M
        self._most = most
        self._last_s = -math.inf
        self._newest: tuple[float, float] | None = None

    def add(self, time_s: float, x_m: float, y_m: float) -> None:
        broken = bool(self.points) and time_s - self._last_s > GAP_S
        self._last_s = time_s
        self._newest = x_m, y_m
        if not broken and self.points and math.dist(self.points[-1][:2], (x_m, y_m)) < self.tolerance_m:
            return
        self.points.append((x_m, y_m, broken))
        while len(self.points) > self._most:
            self._coarsen()

    def shift(self, dx_m: float, dy_m: float) -> None:
        """The same track about another origin."""
        self.points = [(x_m + dx_m, y_m + dy_m, broken) for x_m, y_m, broken in self.points]
        if self._newest is not None:
            self._newest = self._newest[0] + dx_m, self._newest[1] + dy_m

    @property
    def ends(self) -> tuple[tuple[float, float], tuple[float, float]] | None:
        """The first and the newest place."""
        return None if self._newest is None else (self.points[0][:2], self._newest)

    def line(self) -> tuple[list[float], list[float]]:
        """x and y to draw a line through, NaN where it is broken, up to the newest place."""
        xs: list[float] = []
        ys: list[float] = []
        for x_m, y_m, broken in self.points:
            if broken:
                xs.append(math.nan)
                ys.append(math.nan)
            xs.append(x_m)
            ys.append(y_m)
        if self._newest is not None:
            xs.append(self._newest[0])
            ys.append(self._newest[1])
        return xs, ys

    def _coarsen(self) -> None:
        """A break is handed on to the next point that is kept."""
        self.tolerance_m *= 2
        kept = self.points[:1]
        pending = False
        for x_m, y_m, broken in self.points[1:]:
            pending = pending or broken
            if math.dist(kept[-1][:2], (x_m, y_m)) >= self.tolerance_m:
                kept.append((x_m, y_m, pending))
                pending = False
        self.points = kept


class LossCurve:
    """Frames received and lost over time."""

    __slots__ = ("_lost", "_most", "_received", "width_s")

    def __init__(self, width_s: float = 1.0, most: int = 600) -> None:
        self.width_s = width_s
        self._most = most
        self._received: list[int] = []
        self._lost: list[int] = []

    def add(self, time_s: float, lost: int) -> None:
        """One frame was received, ``lost`` before it were not (-1: one counted as lost came late)."""
        while time_s >= self.width_s * self._most:
            self._coarsen()
        index = int(time_s / self.width_s)
        short = index + 1 - len(self._received)
        if short > 0:
            self._received += [0] * short
            self._lost += [0] * short
        self._received[index] += 1
        if lost >= 0:
            self._lost[index] += lost
        else:
            self.take_back(-lost)

    def take_back(self, count: int) -> None:
        """So many of those counted last were not lost."""
        index = len(self._lost) - 1
        while count > 0 and index >= 0:
            taken = min(count, self._lost[index])
            self._lost[index] -= taken
            count -= taken
            index -= 1

    def ratios(self, width_s: float) -> list[float | None]:
        """Loss of each piece of at least ``width_s``, 0..1; None where no frame came. With `piece_s` for the times."""
        pieces = self.pieces(width_s)
        ratios: list[float | None] = []
        for begin in range(0, len(self._received), pieces):
            received = sum(self._received[begin : begin + pieces])
            lost = sum(self._lost[begin : begin + pieces])
            ratios.append(lost / (received + lost) if received else None)
        return ratios

    def pieces(self, width_s: float) -> int:
        """How many buckets make one piece of at least ``width_s``."""
        return max(1, math.ceil(width_s / self.width_s))

    def _coarsen(self) -> None:
        self.width_s *= 2
        self._received = _in_pairs(self._received)
        self._lost = _in_pairs(self._lost)


def _in_pairs(counts: Sequence[int]) -> list[int]:
    return [sum(counts[n : n + 2]) for n in range(0, len(counts), 2)]
