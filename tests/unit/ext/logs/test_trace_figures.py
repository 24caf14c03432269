"""Figures of a trace against numpy's, and what they mean."""

from __future__ import annotations

import math

import numpy
import pytest
from hypothesis import given
from hypothesis import strategies as st

from skygcs.ext.logs.trace_figures import p95, trace_figures

distances = st.lists(st.one_of(st.floats(0, 1e3), st.just(math.nan)), max_size=60)


@given(distances, distances)
def test_figures_are_numpys_and_nan_is_nothing(errors_m: list[float], ages_ms: list[float]) -> None:
    measured = trace_figures(len(errors_m), 1.0, errors_m, ages_ms, None)
    known = numpy.array([error for error in errors_m if not math.isnan(error)])
    if not len(known):
        assert math.isnan(measured.rms_error_m) and math.isnan(measured.p95_error_m)
        assert math.isnan(measured.largest_error_m)
        return
    assert measured.rms_error_m == pytest.approx(numpy.sqrt(numpy.mean(known**2)))
    assert measured.largest_error_m == known.max()
    assert measured.p95_error_m in known
    assert numpy.mean(known <= measured.p95_error_m) >= 0.95


def test_p95_of_a_hundred_is_the_96th() -> None:
    assert p95([float(n) for n in range(100)]) == 95.0
    assert math.isnan(p95([]))
