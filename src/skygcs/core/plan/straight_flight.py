"""Timed certificate (b): all vehicles fly straight to their goals, together, by one time scaling. numpy.

Vehicle i is at s_i + β(t) (g_i - s_i) with the same β from 0 to 1 for all. The offset of two vehicles then runs along
the straight segment from s = s_i - s_j to g = g_i - g_j, so its least length is the distance of the origin from that
segment, in closed form, and any common β keeps it: faster, slower, paused, resumed.

Proposition (Turpin, Michael, Kumar: CAPT). If s·g ≥ 0 and |s|, |g| ≥ Δ, the distance is at least Δ/√2:
|(1 - β) s + β g|² = (1 - β)²|s|² + β²|g|² + 2 β (1 - β) s·g ≥ ((1 - β)² + β²) Δ² ≥ Δ²/2.

Goals that may be exchanged are assigned so that (s_i - s_j)·(g_i - g_j) ≥ 0 for every pair. Exchanging the goals of a
pair whose product is negative changes Σ|g_i - s_i|² by 2 (s_i - s_j)·(g_i - g_j) < 0, so exchanging while there is
such a pair ends, because there are finitely many assignments; the end need not be the optimum, the products alone are
enough. In the downwash metric the same holds for scaled heights.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from skygcs.core.plan.segment_distance import Array, scaled
from skygcs.core.trajectory import MotionLimits, Piece, Trajectory
from skygcs.core.trajectory.piecewise import Vector
from skygcs.core.trajectory.timing import hover, rest_to_rest

MAX_EXCHANGES = 1_000_000
"""255 vehicles need some thousand."""

AT_GOAL_M = 1e-6


def assigned(starts: Sequence[Vector], goals: Sequence[Vector], downwash_ratio: float) -> list[int]:
    """Return for each start the index of its goal, such that no pair has a negative product (beyond rounding)."""
    s, g = scaled(starts, downwash_ratio), scaled(goals, downwash_ratio)
    count = len(s)
    order = _nearest_first(s, g)
    span = max(float(np.ptp(s, axis=0).max()), float(np.ptp(g, axis=0).max()), 1.0)
    rounding = 1e-12 * span * span
    for _ in range(MAX_EXCHANGES):
        h = g[order]
        square = s @ h.T
        diagonal = np.diag(square)
        products = diagonal[:, None] + diagonal[None] - square - square.T
        partner = np.argmin(products, axis=1)
        best = products[np.arange(count), partner]
        if best.min() >= -rounding:
            break
        # exchange disjoint pairs, the worst first: each lowers the sum by itself
        busy = np.zeros(count, dtype=bool)
        for i in np.argsort(best):
            j = partner[i]
            if best[i] >= -rounding:
                break
            if not busy[i] and not busy[j]:
                order[i], order[j] = order[j], order[i]
                busy[i] = busy[j] = True
    return [int(index) for index in order]


def straight_trajectories(starts: Sequence[Vector], goals: Sequence[Vector], limits: MotionLimits) -> list[Trajectory]:
    """All by one β, as fast as the vehicle with the hardest leg allows; all of the same duration."""
    legs = [np.subtract(goal, start) for start, goal in zip(starts, goals, strict=True)]
    longest = max(float(np.linalg.norm(leg)) for leg in legs)
    if longest < AT_GOAL_M:
        return [hover(start, 1.0) for start in starts]
    rate = limits.speed_mps / longest
    climb, descent = max(float(leg[2]) for leg in legs), max(-float(leg[2]) for leg in legs)
    if climb > 0.0:
        rate = min(rate, limits.climb_mps / climb)
    if descent > 0.0:
        rate = min(rate, limits.descent_mps / descent)
    profile = rest_to_rest(1.0, rate, limits.acceleration_mps2 / longest, limits.jerk_mps3 / longest)
    found = []
    for start, leg in zip(starts, legs, strict=True):
        pieces = []
        for duration, beta in profile:
            axes = [
                (a + float(d) * beta[0], *(float(d) * c for c in beta[1:])) for a, d in zip(start, leg, strict=True)
            ]
            pieces.append(Piece(duration, axes[0], axes[1], axes[2]))
        found.append(Trajectory(pieces))
    return found


def _nearest_first(s: Array, g: Array) -> Array:
    """A first assignment: pairs of start and goal in the order of their distance."""
    count = len(s)
    square = ((s[:, None] - g[None]) ** 2).sum(axis=2)
    order = np.full(count, -1, dtype=np.intp)
    taken = np.zeros(count, dtype=bool)
    left = count
    for flat in np.argsort(square, axis=None):
        i, j = divmod(int(flat), count)
        if order[i] < 0 and not taken[j]:
            order[i], taken[j] = j, True
            left -= 1
            if not left:
                break
    return order  # type: ignore[return-value]
