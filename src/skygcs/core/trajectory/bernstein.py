"""Bernstein form of polynomials on [0, T]: bounds of a polynomial that hold between all samples.

A polynomial of degree n on [0, T] is p(t) = Σ b_i C(n, i) u^i (1 - u)^(n-i) with u = t/T. The weights are not negative
and sum to 1, so min b ≤ p(t) ≤ max b on the whole interval, and b_0 and b_n are its values at the two ends. Cutting the
interval in two (de Casteljau) makes the bounds tighter, quadratically in the length of the parts.
Sources: Farouki, "The Bernstein polynomial basis: a centennial retrospective", CAGD 29 (2012).

Plain Python, for a few trajectories; checks of all pairs of a fleet need the same in numpy.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from functools import cache
from math import comb

UNIT_ROUNDOFF = 2.0**-53
"""Relative error of one floating-point operation (IEEE 754 binary64, round to nearest)."""


def from_power(coefficients: Sequence[float], duration_s: float) -> list[float]:
    """Bernstein coefficients on [0, duration_s] of the polynomial with these ascending coefficients."""
    n = len(coefficients) - 1
    scaled, power = [], 1.0
    for c in coefficients:
        scaled.append(c * power)
        power *= duration_s
    return [sum(w * a for w, a in zip(row, scaled, strict=False)) for row in _rows(n)]


def error_bound(coefficients: Sequence[float], duration_s: float) -> float:
    """Most by which `from_power` is wrong in any coefficient.

    A term is rounded at most n times in its power, once in the product, twice in the weight, once when weighted and n
    times in the sum; weights are at most 1. So (2n + 4) roundings of terms whose sizes sum to Σ|c_k| T^k; doubled for
    the terms of second order.
    """
    n = len(coefficients) - 1
    size, power = 0.0, 1.0
    for c in coefficients:
        size += abs(c) * power
        power *= duration_s
    return 2.0 * (2 * n + 4) * UNIT_ROUNDOFF * size


def derivative(bernstein: Sequence[float], duration_s: float) -> list[float]:
    """Bernstein coefficients of the derivative with respect to time; of a constant, [0]."""
    n = len(bernstein) - 1
    if n == 0:
        return [0.0]
    return [n / duration_s * (b - a) for a, b in itertools.pairwise(bernstein)]


def to_power(bernstein: Sequence[float], duration_s: float) -> tuple[float, ...]:
    """Ascending coefficients in seconds: c_k = C(n, k) Δ^k b_0 / T^k."""
    n = len(bernstein) - 1
    row, coefficients = list(bernstein), []
    for k in range(n + 1):
        coefficients.append(comb(n, k) * row[0] / duration_s**k)
        row = [b - a for a, b in itertools.pairwise(row)]
    return tuple(coefficients)


def product(a: Sequence[float], b: Sequence[float]) -> list[float]:
    """Bernstein coefficients of the product: c_k = Σ C(m, i) C(n, k - i) / C(m + n, k) a_i b_(k - i)."""
    m, n = len(a) - 1, len(b) - 1
    return [
        sum(comb(m, i) * comb(n, k - i) * a[i] * b[k - i] for i in range(max(0, k - n), min(m, k) + 1)) / comb(m + n, k)
        for k in range(m + n + 1)
    ]


def halves(bernstein: Sequence[float]) -> tuple[list[float], list[float]]:
    """The coefficients on the first and on the second half of the interval (de Casteljau)."""
    row = list(bernstein)
    left, right = [row[0]], [row[-1]]
    while len(row) > 1:
        row = [0.5 * (a + b) for a, b in itertools.pairwise(row)]
        left.append(row[0])
        right.append(row[-1])
    return left, right[::-1]


@cache
def _rows(n: int) -> tuple[tuple[float, ...], ...]:
    """Row i holds the weights C(i, k) / C(n, k) of power k ≤ i."""
    return tuple(tuple(comb(i, k) / comb(n, k) for k in range(i + 1)) for i in range(n + 1))
