"""An independent judge of plans: dense sampling with a Lipschitz bound. It shares no code with what it judges.

It evaluates the polynomials itself, from their coefficients. The speed bound of a piece is √Σ_axes(Σ k|c_k|T^(k-1))².
Between two samples h apart the distance of two vehicles is at least half of the sum of the two distances less half of
h times the sum of both speed bounds. Where that does not exclude a smaller distance than the least one sampled, the
interval is halved.
"""

from __future__ import annotations

from itertools import combinations
from typing import Any, NamedTuple

import numpy as np

PRECISION = 1e-3
"""Relative: the least distance found is at most this far above the true one."""

ENOUGH_M = 1e-5
"""Absolute, where vehicles collide."""


class Least(NamedTuple):
    pair: tuple[str, str]
    distance_m: float
    t_s: float


class Curve:
    """One vehicle's polynomials, standing at its end."""

    def __init__(self, pieces: Any, ratio: float) -> None:
        self.starts, self.coefficients, self.speeds, self.durations = [], [], [], []
        now = 0.0
        for piece in pieces:
            axes = [np.array(piece.east), np.array(piece.north), np.array(piece.up) / ratio]
            bounds = [sum(k * abs(c) * piece.duration_s ** (k - 1) for k, c in enumerate(axis) if k) for axis in axes]
            self.starts.append(now)
            self.coefficients.append(axes)
            self.durations.append(piece.duration_s)
            self.speeds.append(float(np.sqrt(sum(b * b for b in bounds))))
            now += piece.duration_s
        self.end = now
        self._starts = np.array(self.starts)
        self._speeds = np.array([*self.speeds, 0.0])

    def at(self, times: np.ndarray) -> np.ndarray:
        index = np.clip(np.searchsorted(self._starts, times, "right") - 1, 0, len(self.starts) - 1)
        places = np.empty((len(times), 3))
        for k in np.unique(index):
            here = index == k
            u = np.minimum(times[here], self.end) - self.starts[k]
            for axis in range(3):
                places[here, axis] = np.polynomial.polynomial.polyval(u, self.coefficients[k][axis])
        return places

    def speed_bound(self, begins: np.ndarray, ends: np.ndarray) -> np.ndarray:
        """Of each interval, which may cover two pieces or more."""
        from_s = np.append(self._starts, self.end)  # beyond its end it stands
        first = np.searchsorted(from_s, begins, "right") - 1
        last = np.maximum(np.searchsorted(from_s, ends, "left") - 1, first)
        bound = np.maximum(self._speeds[first], self._speeds[last])
        for i in np.nonzero(last > first + 1)[0]:
            bound[i] = self._speeds[first[i] : last[i] + 1].max()
        return bound


def least_distance(trajectories: dict[str, Any], ratio: float, standing: dict[str, Any] | None = None) -> Least | None:
    """Of all pairs with a moving vehicle, to `PRECISION`."""
    curves = {name: Curve(t.pieces, ratio) for name, t in trajectories.items()}
    end = max(curve.end for curve in curves.values())
    still = {name: np.array(place) / (1.0, 1.0, ratio) for name, place in (standing or {}).items()}
    best: Least | None = None
    for one, other in combinations([*curves, *still], 2):
        if one in still:
            continue
        found = _pair(
            curves[one], curves.get(other), still.get(other), end, np.inf if best is None else best.distance_m
        )
        if found is not None and (best is None or found[0] < best.distance_m):
            best = Least((one, other), *found)
    return best


def _pair(a: Curve, b: Curve | None, place: Any, end: float, best: float) -> tuple[float, float] | None:
    """The least distance if it is below ``best``."""
    times = np.linspace(0.0, end, max(33, int(end * 4) + 1))
    begins, ends = times[:-1], times[1:]
    found = None
    while len(begins):
        pair = [_distance(a, b, place, t) for t in (begins, ends)]
        for distance, when in zip(pair, (begins, ends), strict=True):
            k = int(np.argmin(distance))
            if distance[k] < best:
                best, found = float(distance[k]), (float(distance[k]), float(when[k]))
        speed = a.speed_bound(begins, ends) + (0.0 if b is None else b.speed_bound(begins, ends))
        bound = 0.5 * (pair[0] + pair[1]) - 0.5 * (ends - begins) * speed
        left = (bound < best * (1.0 - PRECISION)) & (best > ENOUGH_M)
        begins, ends = begins[left], ends[left]
        middle = 0.5 * (begins + ends)
        begins, ends = np.concatenate([begins, middle]), np.concatenate([middle, ends])
        assert len(begins) < 5_000_000
    return found


def _distance(a: Curve, b: Curve | None, place: Any, times: np.ndarray) -> np.ndarray:
    return np.sqrt(((a.at(times) - (place if b is None else b.at(times))) ** 2).sum(axis=1))


def least_distance_of_legs(legs: dict[str, Any], ratio: float) -> Least | None:
    """Of all pairs that may be anywhere on their legs: cells of both parameters, halved like the intervals above."""
    best: Least | None = None
    scale = np.array([1.0, 1.0, ratio])
    for one, other in combinations(legs, 2):
        p, q = (np.array(v) / scale for v in legs[one])
        r, s = (np.array(v) / scale for v in legs[other])
        cells = np.array([[0.5, 0.5]])
        half = 0.5
        least = np.inf
        for _ in range(40):
            places = p + cells[:, :1] * (q - p) - r - cells[:, 1:] * (s - r)
            distance = np.sqrt((places**2).sum(axis=1))
            least = min(least, float(distance.min()))
            reach = half * (np.linalg.norm(q - p) + np.linalg.norm(s - r))
            cells = cells[
                (distance - reach < least * (1.0 - PRECISION)) & (distance - reach < (best or _NONE).distance_m)
            ]
            if not len(cells) or least < ENOUGH_M:
                break
            half /= 2.0
            cells = np.concatenate([cells + half * np.array(d) for d in ((-1, -1), (-1, 1), (1, -1), (1, 1))])
        if best is None or least < best.distance_m:
            best = Least((one, other), least, 0.0)
    return best


_NONE = Least(("", ""), np.inf, 0.0)
