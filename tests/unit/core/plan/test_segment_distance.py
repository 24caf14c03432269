from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from bench.plans.checker import least_distance_of_legs
from skygcs.core.plan.segment_distance import point_segment, segment_segment
from support.examples import examples
from support.table import each

number = st.one_of(st.floats(-20, 20), st.integers(-3, 3).map(float))
point = st.tuples(number, number, number)


@settings(max_examples=examples(80), deadline=None)
@given(point, point, point, point)
def test_the_distance_of_segments_is_the_independent_checkers(p, q, r, s) -> None:
    found, first, second = segment_segment(*(np.array([v]) for v in (p, q, r, s)))
    checked = least_distance_of_legs({"a": (p, q), "b": (r, s)}, 1.0)
    assert found[0] == pytest.approx(checked.distance_m, rel=2e-3, abs=2e-5)
    assert found[0] <= checked.distance_m + 1e-9
    on_first = np.array(p) + first[0] * (np.array(q) - p)
    on_second = np.array(r) + second[0] * (np.array(s) - r)
    assert np.linalg.norm(on_first - on_second) == pytest.approx(found[0], abs=1e-9)


@each(
    ("p", "q", "r", "s", "distance"),
    [
        ((0, 0, 0), (10, 0, 0), (5, -5, 1), (5, 5, 1), 1.0),  # crossing, one above the other
        ((0, 0, 0), (10, 0, 0), (2, 3, 0), (8, 3, 0), 3.0),  # parallel
        ((0, 0, 0), (10, 0, 0), (13, 4, 0), (20, 4, 0), 5.0),  # parallel, beyond the end
        ((0, 0, 0), (0, 0, 0), (3, 4, 0), (3, 4, 0), 5.0),  # two points
        ((0, 0, 0), (10, 0, 0), (4, 0, 0), (6, 0, 0), 0.0),  # one in the other
        ((0, 0, 0), (1e5, 0, 0), (0, 1, 0), (1e5, 1.00001, 0), 1.0),  # nearly parallel
    ],
)
def test_known_distances(p, q, r, s, distance) -> None:
    found, _, _ = segment_segment(*(np.array([v], dtype=float) for v in (p, q, r, s)))
    assert found[0] == pytest.approx(distance, abs=1e-9)


def test_a_point_and_a_segment() -> None:
    distance, part = point_segment(np.array([[3.0, 4.0, 0.0]]), np.zeros((1, 3)), np.array([[10.0, 0.0, 0.0]]))
    assert (distance[0], part[0]) == (4.0, pytest.approx(0.3))
