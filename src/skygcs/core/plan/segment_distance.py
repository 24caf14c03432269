"""Least distances of straight segments, for all pairs at once. numpy.

Points are arrays of shape (..., 3) in the downwash metric (`scaled`). All distances are exact up to rounding; what is
called safe by them must be so by `SLACK_M`.

Why 1e-6 m is enough: coordinates are below 1e5 m, so a difference is rounded by at most 1.5e-11 m, and the projection
of a point on a segment loses no more than a few of these. Only the crossing point of two nearly parallel segments is
ill-conditioned: there the squared distance hardly depends on it (below sin² = 1e-10 it changes by less than 1e-10 of
the squared length over the whole segment, and its minimum at an end is found too).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

SLACK_M = 1e-6


def scaled(points: Sequence[Sequence[float]] | Array, downwash_ratio: float) -> Array:
    """The points in the downwash metric."""
    return np.asarray(np.asarray(points, dtype=np.float64).reshape(-1, 3) / np.array([1.0, 1.0, downwash_ratio]))


def point_segment(point: Array, begin: Array, end: Array) -> tuple[Array, Array]:
    """(distance, part of the segment where it is) of points from segments."""
    along = end - begin
    square = np.sum(along * along, axis=-1)
    with np.errstate(invalid="ignore", divide="ignore"):
        part = np.where(square > 0.0, np.sum((point - begin) * along, axis=-1) / square, 0.0)
    part = np.clip(np.nan_to_num(part), 0.0, 1.0)
    return np.sqrt(np.sum((point - begin - part[..., None] * along) ** 2, axis=-1)), part


def segment_segment(p: Array, q: Array, r: Array, s: Array) -> tuple[Array, Array, Array]:
    """(least distance, part of pq, part of rs) of segments pq from rs, wherever each vehicle is on its own."""
    d1, d2, w = q - p, s - r, p - r
    a, e = np.sum(d1 * d1, axis=-1), np.sum(d2 * d2, axis=-1)
    b, c, f = np.sum(d1 * d2, axis=-1), np.sum(d1 * w, axis=-1), np.sum(d2 * w, axis=-1)
    with np.errstate(invalid="ignore", divide="ignore"):
        crossing = np.clip(np.nan_to_num((b * f - c * e) / (a * e - b * b)), 0.0, 1.0)
    middle = p + crossing[..., None] * d1
    _, other = point_segment(middle, r, s)
    inner, crossing = point_segment(r + other[..., None] * d2, p, q)
    best, part_1, part_2 = inner, crossing, other
    zero, one = np.zeros_like(a), np.ones_like(a)
    for distance, first, second in (
        _with(point_segment(p, r, s), zero, swapped=True),
        _with(point_segment(q, r, s), one, swapped=True),
        _with(point_segment(r, p, q), zero, swapped=False),
        _with(point_segment(s, p, q), one, swapped=False),
    ):
        nearer = distance < best
        best = np.where(nearer, distance, best)
        part_1, part_2 = np.where(nearer, first, part_1), np.where(nearer, second, part_2)
    return best, part_1, part_2


def _with(found: tuple[Array, Array], end: Array, *, swapped: bool) -> tuple[Array, Array, Array]:
    distance, part = found
    return (distance, end, part) if swapped else (distance, part, end)
