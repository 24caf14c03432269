"""All pieces of a fleet as one array of Bernstein coefficients, with a bound of their rounding errors. numpy.

Layout: (coefficient, axis, piece). Cutting a piece is de Casteljau's scheme, which only averages.

Error of one coordinate, u = 2^-53, n the degree, S = Σ|c_k| T^k of the piece (so that S bounds every coefficient):

    powers, products, weights and sum of the conversion           4n + 8    roundings of terms that sum to S
    the part of the piece at which to cut is rounded (by 2u)      4n        the curve moves by n · 2S · 2u
    two cuts, n averages each, three roundings in an average      6n
    60 halvings, one rounding in each of n averages               60n

together 74n + 8; `ERROR_UNITS` (n + 1) is above it and leaves room for the terms of second order. Besides, the times at
which pieces begin are sums that are rounded, by 4u of the last time E at most: 2n Σ_(k>0)|c_k| T^k · 4u E/T.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import comb
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from skygcs.core.trajectory import Trajectory

Array = NDArray[np.float64]
Indices = NDArray[np.intp]

UNIT = 2.0**-53
ERROR_UNITS = 128.0
MAX_HALVINGS = 60


class Pieces(NamedTuple):
    """The pieces of all vehicles, those of one vehicle after those of the one before."""

    bernstein: Array
    """(degree + 1, 3, pieces)."""
    vehicle: Indices
    begin_s: Array
    end_s: Array
    first: Indices
    """Index of the first piece of each vehicle, and the number of pieces at the end."""
    error_m: Array
    """Most by which any coordinate of the piece, however it is cut, is wrong."""


def gathered(trajectories: Sequence[Trajectory], scale: Sequence[float] = (1.0, 1.0, 1.0)) -> Pieces:
    """The pieces, axes divided by ``scale``; a vehicle whose trajectory ends before the last one stands at its end."""
    end = max(t.duration_s for t in trajectories)
    degree = max(len(c) for t in trajectories for p in t.pieces for _, c in p.axes()[:3]) - 1
    counts = [len(t.pieces) + (t.duration_s < end) for t in trajectories]
    total = sum(counts)
    power = np.zeros((degree + 1, 3, total))
    begin_s, duration_s = np.empty(total), np.empty(total)
    index = 0
    for trajectory in trajectories:
        for piece, begin in zip(trajectory.pieces, trajectory.begins_s, strict=True):
            for axis, c in enumerate((piece.east, piece.north, piece.up)):
                power[: len(c), axis, index] = c
            begin_s[index], duration_s[index] = begin, piece.duration_s
            index += 1
        if trajectory.duration_s < end:
            power[0, :, index] = trajectory.end_enu_m
            begin_s[index], duration_s[index] = trajectory.duration_s, end - trajectory.duration_s
            index += 1
    power *= duration_s ** np.arange(degree + 1)[:, None, None]
    power /= np.asarray(scale)[:, None]
    weights = np.array([[comb(i, k) / comb(degree, k) for k in range(degree + 1)] for i in range(degree + 1)])
    bernstein = np.einsum("ik,kap->iap", weights, power)
    size = np.abs(power)
    error = ERROR_UNITS * (degree + 1) * UNIT * size.sum(axis=0).max(axis=0)
    error += 8 * degree * UNIT * end / duration_s * size[1:].sum(axis=0).max(axis=0, initial=0.0)
    vehicle = np.repeat(np.arange(len(counts)), counts)
    first = np.concatenate([[0], np.cumsum(counts)])
    end_s = np.append(begin_s[1:], end)
    end_s[first[1:] - 1] = end
    return Pieces(bernstein, vehicle, begin_s, end_s, first, error)


def restricted(bernstein: Array, begin: Array, end: Array) -> Array:
    """The coefficients on the part [begin, end] of each piece, 0 ≤ begin < end ≤ 1."""
    right = _right_of(bernstein, begin)
    with np.errstate(invalid="ignore", divide="ignore"):
        inner = np.clip(np.nan_to_num((end - begin) / (1.0 - begin), nan=1.0, posinf=1.0), 0.0, 1.0)
    return _right_of(right[::-1], 1.0 - inner)[::-1]


def halved(bernstein: Array) -> tuple[Array, Array]:
    """The coefficients on the first and on the second half."""
    n = bernstein.shape[0] - 1
    left, right = np.empty_like(bernstein), np.empty_like(bernstein)
    row = bernstein
    left[0], right[n] = row[0], row[n]
    for k in range(1, n + 1):
        row = 0.5 * (row[:-1] + row[1:])
        left[k], right[n - k] = row[0], row[-1]
    return left, right


def _right_of(bernstein: Array, at: Array) -> Array:
    n = bernstein.shape[0] - 1
    right = np.empty_like(bernstein)
    row = bernstein
    right[n] = row[n]
    for k in range(1, n + 1):
        row = (1.0 - at) * row[:-1] + at * row[1:]
        right[n - k] = row[-1]
    return right


def squared_norm(bernstein: Array) -> Array:
    """Bernstein coefficients, of twice the degree, of the squared norm over the axes: (2 degree + 1, pieces)."""
    n = bernstein.shape[0] - 1
    weighted = bernstein * np.array([comb(n, i) for i in range(n + 1)], dtype=np.float64)[:, None, None]
    total = np.zeros((2 * n + 1, bernstein.shape[2]))
    for i in range(n + 1):
        total[i : i + n + 1] += np.einsum("kap,ap->kp", weighted, weighted[i])
    return total / np.array([comb(2 * n, k) for k in range(2 * n + 1)], dtype=np.float64)[:, None]
