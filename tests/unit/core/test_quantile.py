"""Quantiles in bounded memory: never too small, at most 5 % too large, and forgotten in time."""

from __future__ import annotations

import math
import statistics

import pytest
from hypothesis import given
from hypothesis import strategies as st

from skygcs.core.quantile import GROWTH, QuantileSketch, median, median_low

VALUES = st.lists(st.floats(0.001, 99.0), min_size=1, max_size=300)


@given(VALUES, st.sampled_from([0.5, 0.9, 0.99, 1.0]))
def test_it_is_never_below_the_quantile_and_hardly_above(values: list[float], quantile: float) -> None:
    sketch = QuantileSketch(0.001, 100.0, 1000)
    for value in values:
        sketch.add(value)
    exact = sorted(values)[max(math.ceil(quantile * len(values)), 1) - 1]
    found = sketch.at_most(quantile)
    assert found is not None and exact * (1 - 1e-9) <= found <= exact * GROWTH * (1 + 1e-9)
    least = sketch.at_least()
    assert least is not None and least <= min(values)


def test_it_forgets_and_stays_small() -> None:
    sketch = QuantileSketch(0.001, 100.0, 100)
    for _ in range(1000):
        sketch.add(50.0)
    assert sketch.at_most(0.99) == pytest.approx(50.0, rel=0.05)
    for i in range(200):
        sketch.add(0.1 + 1e-6 * i)
    found = sketch.at_most(1.0)
    assert found is not None and found < 0.11 and len(sketch) <= 200


def test_values_beyond_its_range_and_nan() -> None:
    sketch = QuantileSketch(0.001, 100.0, 100)
    assert sketch.at_most(0.99) is None and sketch.at_least() is None and len(sketch) == 0
    for value in (math.nan, math.inf, 1e308):
        sketch.add(value)
    assert len(sketch) == 2 and sketch.at_most(0.5) == 100.0
    sketch.add(-5.0)
    assert sketch.at_least() == 0.0 and sketch.at_most(0.1) == 0.001


@given(VALUES)
def test_medians_are_those_of_the_standard_library(values: list[float]) -> None:
    assert median(iter(values)) == statistics.median(values)
    assert median_low(iter(values)) == statistics.median_low(values)
