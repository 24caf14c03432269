"""The least clearance of vehicles on polynomial trajectories, for all pairs and all times, proven and not sampled.

For two vehicles i, j with parts m_i, m_j of the margin, the clearance is |x_i(t) - x_j(t)| - (m_i + m_j). Where both
are polynomials of degree n, x_i - x_j has Bernstein coefficients d_k, and

    |x_i - x_j| ≥ distance of the origin from the box around the d_k          (convex hull)
    |x_i - x_j|² ≥ the least Bernstein coefficient of Σ_axes (x_i - x_j)²      (degree 2n)

Both bounds are lowered by what rounding can cost; distances at the ends of intervals bound the minimum from above.
Branch and bound: intervals that cannot hold the minimum are dropped, the others are halved. Pieces that overlap in time
but are far apart are dropped by their boxes before anything is computed for the pair.

Outward rounding. Each coordinate of each piece is wrong by at most `Pieces.error_m`, so the distance of two vehicles
by √3 (e_i + e_j). The products of the squared norm are sums of 3 (n + 1) terms with weights that sum to 1: their error
is at most (3n + 10) u Σ_axes max|d|², taken as (4n + 16) u. The direction comes from these bounds, not from a rounding
mode.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from skygcs.core.trajectory import Trajectory
from skygcs.ext.plans.certificates.bernstein_arrays import (
    MAX_HALVINGS,
    UNIT,
    Array,
    Indices,
    Pieces,
    gathered,
    halved,
    restricted,
    squared_norm,
)

TOLERANCE_M = 1e-4
"""The least clearance is found to this; where it decides on safe or not, to `RESOLUTION_M`."""

RESOLUTION_M = 1e-9
"""Distance to the margin below which a clearance counts as inside."""

BATCH = 30_000
"""Pairs of pieces looked at together: some 30 MB of arrays."""

SAMPLES = 65
"""Times at which all vehicles are compared first, so that most pieces can be dropped at once."""

Progress = Callable[[int, int], None]
"""Called with vehicles done and in all; it may raise to cancel."""


@dataclass(frozen=True, slots=True)
class Minimum:
    """Where the clearance is least."""

    first: int
    second: int
    t_s: float
    distance_m: float
    """At that time, in the downwash metric."""
    distance_at_least_m: float
    """Lower bound of the distance of these two at any time; it holds for the clearance of all pairs."""
    clearance_m: float
    clearance_at_least_m: float


def least_clearance(
    trajectories: Sequence[Trajectory],
    half_margins_m: Sequence[float],
    downwash_ratio: float,
    *,
    standing: int = 0,
    progress: Progress | None = None,
) -> Minimum | None:
    """The least clearance of all pairs; None for fewer than two vehicles.

    The last ``standing`` trajectories are those of obstacles, which are not compared with each other.
    """
    moving = len(trajectories) - standing
    if moving < 1 or len(trajectories) < 2:
        return None
    pieces = gathered(trajectories, (1.0, 1.0, downwash_ratio))
    search = _Search(pieces, np.asarray(half_margins_m, dtype=np.float64))
    search.sample(moving)
    waiting: list[tuple[Indices, Indices]] = []
    count = 0
    for vehicle in range(moving):
        for found in search.candidates(vehicle):
            waiting.append(found)
            count += len(found[0])
            if count >= BATCH:
                search.examine(waiting)
                waiting, count = [], 0
        if progress is not None:
            progress(vehicle + 1, moving)
    search.examine(waiting)
    return search.minimum()


class _Search:
    """Branch and bound over pairs of pieces."""

    def __init__(self, pieces: Pieces, half_m: Array) -> None:
        self._p = pieces
        self._half = half_m
        self._low, self._high = pieces.bernstein.min(axis=0), pieces.bernstein.max(axis=0)
        self._best = np.inf
        """The least clearance found."""
        self._where = (0, 0, 0.0, np.inf)
        self._proven = np.inf
        """No dropped interval has less clearance than this."""

    def minimum(self) -> Minimum:
        first, second, t_s, distance = self._where
        proven = min(self._proven, self._best)
        margin = float(self._half[first] + self._half[second])
        return Minimum(
            first, second, float(t_s), float(distance), float(proven) + margin, float(self._best), float(proven)
        )

    def sample(self, moving: int) -> None:
        """A first bound from above: all vehicles at some times."""
        p = self._p
        count = len(p.first) - 1
        for t in np.linspace(0.0, p.end_s[-1], SAMPLES):
            index = np.array(
                [
                    p.first[v] + np.searchsorted(p.begin_s[p.first[v] : p.first[v + 1]], t, "right") - 1
                    for v in range(count)
                ]
            )
            part = np.clip((t - p.begin_s[index]) / (p.end_s[index] - p.begin_s[index]), 0.0, 1.0)
            row = p.bernstein[:, :, index]
            while len(row) > 1:
                row = (1.0 - part) * row[:-1] + part * row[1:]
            places = row[0].T
            distance = np.sqrt(((places[:moving, None] - places[None]) ** 2).sum(axis=2))
            clearance = distance - self._half[:moving, None] - self._half[None]
            clearance[np.tril_indices(moving, 0, count)] = np.inf
            first, second = np.unravel_index(int(np.argmin(clearance)), clearance.shape)
            if clearance[first, second] < self._best:
                self._best = float(clearance[first, second])
                self._where = (int(first), int(second), float(t), float(distance[first, second]))

    def candidates(self, vehicle: int) -> list[tuple[Indices, Indices]]:
        """Pairs of a piece of this vehicle and one of a later vehicle that overlap in time and are near."""
        p = self._p
        own, others = slice(p.first[vehicle], p.first[vehicle + 1]), np.arange(p.first[vehicle + 1], p.first[-1])
        # the own pieces follow each other in time: those that overlap with another one are neighbours
        earliest = np.searchsorted(p.end_s[own], p.begin_s[others], "right")
        counts = np.maximum(np.searchsorted(p.begin_s[own], p.end_s[others], "left") - earliest, 0)
        pairs = np.cumsum(counts)
        ends = np.searchsorted(pairs, np.arange(4 * BATCH, (pairs[-1] if len(pairs) else 0) + 4 * BATCH, 4 * BATCH)) + 1
        found = []
        for begin, end in itertools.pairwise((0, *ends.tolist())):
            number = counts[begin:end]
            total = int(number.sum())
            within = np.arange(total) - np.repeat(np.cumsum(number) - number, number)
            a = p.first[vehicle] + np.repeat(earliest[begin:end], number) + within
            b = np.repeat(others[begin:end], number)
            gap = np.maximum(np.maximum(self._low[:, a] - self._high[:, b], self._low[:, b] - self._high[:, a]), 0.0)
            bound = np.sqrt((gap * gap).sum(axis=0)) * (1.0 - 8 * UNIT) - 2.0 * (p.error_m[a] + p.error_m[b])
            bound -= self._half[p.vehicle[a]] + self._half[p.vehicle[b]]
            near = bound < self._best - TOLERANCE_M
            if not near.all():
                self._proven = min(self._proven, float(bound[~near].min()))
            if near.any():
                found.append((a[near], b[near]))
        return found

    def examine(self, pairs: list[tuple[Indices, Indices]]) -> None:
        """Find the least clearance of these pairs of pieces, or that it is above the least so far."""
        if not pairs:
            return
        p = self._p
        a = np.concatenate([first for first, _ in pairs])
        b = np.concatenate([second for _, second in pairs])
        begin, end = np.maximum(p.begin_s[a], p.begin_s[b]), np.minimum(p.end_s[a], p.end_s[b])
        curves = []
        for index in (a, b):
            length = p.end_s[index] - p.begin_s[index]
            curves.append(
                restricted(
                    p.bernstein[:, :, index],
                    np.clip((begin - p.begin_s[index]) / length, 0.0, 1.0),
                    np.clip((end - p.begin_s[index]) / length, 0.0, 1.0),
                )
            )
        difference = curves[0] - curves[1]
        error = 1.7320509 * (p.error_m[a] + p.error_m[b])
        margin = self._half[p.vehicle[a]] + self._half[p.vehicle[b]]
        self._halve(_Intervals(difference, a, b, begin, end, margin, error))

    def _halve(self, now: _Intervals) -> None:
        for _ in range(MAX_HALVINGS):
            bound = now.bound()
            self._improve(now)
            # where the minimum is safe or refused, TOLERANCE_M is enough; between, it has to be decided
            decided = (bound >= 0.0) | (self._best < 0.0)
            done = (decided & (bound >= self._best - TOLERANCE_M)) | (bound >= self._best - RESOLUTION_M)
            if done.any():
                self._proven = min(self._proven, float(bound[done].min()))
            if done.all():
                return
            now = now.selected(~done).halves()
            if now.count() > 40 * BATCH:  # bounds the memory: what is left counts as its bound
                break
        self._proven = min(self._proven, float(now.bound().min()))

    def _improve(self, now: _Intervals) -> None:
        for coefficients, times in ((now.difference[0], now.begin), (now.difference[-1], now.end)):
            distance = np.sqrt((coefficients * coefficients).sum(axis=0))
            clearance = distance - now.margin
            index = int(np.argmin(clearance))
            if clearance[index] < self._best:
                self._best = float(clearance[index])
                first, second = self._p.vehicle[now.a[index]], self._p.vehicle[now.b[index]]
                self._where = (int(first), int(second), float(times[index]), float(distance[index]))


@dataclass(frozen=True, slots=True)
class _Intervals:
    """Differences of two vehicles on intervals of time."""

    difference: Array
    a: Indices
    b: Indices
    begin: Array
    end: Array
    margin: Array
    error: Array

    def count(self) -> int:
        return len(self.a)

    def bound(self) -> Array:
        """The least clearance on each interval, from below."""
        n = self.difference.shape[0] - 1
        low, high = self.difference.min(axis=0), self.difference.max(axis=0)
        gap = np.maximum(np.maximum(low, -high), 0.0)
        largest = (np.maximum(-low, high) ** 2).sum(axis=0)
        square = np.maximum((gap * gap).sum(axis=0), squared_norm(self.difference).min(axis=0))
        square = np.maximum(square - (4 * n + 16) * UNIT * largest, 0.0)
        return np.asarray(np.sqrt(square) * (1.0 - 4 * UNIT) - self.error - self.margin)

    def selected(self, chosen: NDArray[np.bool_]) -> _Intervals:
        return _Intervals(
            self.difference[:, :, chosen],
            self.a[chosen],
            self.b[chosen],
            self.begin[chosen],
            self.end[chosen],
            self.margin[chosen],
            self.error[chosen],
        )

    def halves(self) -> _Intervals:
        left, right = halved(self.difference)
        middle = 0.5 * (self.begin + self.end)
        return _Intervals(
            np.concatenate([left, right], axis=2),
            np.concatenate([self.a, self.a]),
            np.concatenate([self.b, self.b]),
            np.concatenate([self.begin, middle]),
            np.concatenate([middle, self.end]),
            np.concatenate([self.margin, self.margin]),
            np.concatenate([self.error, self.error]),
        )
