from __future__ import annotations

import math
from itertools import combinations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from skygcs.core.plan.formations import SHAPES, formation, placed
from skygcs.errors import RefusedError

NINETY = math.radians(90.0)


@given(st.sampled_from(SHAPES), st.integers(2, 60), st.floats(0.5, 20), st.floats(-10, 10))
def test_neighbours_are_a_spacing_apart_and_the_middle_is_where_it_is_put(
    shape: str, count: int, spacing: float, yaw: float
) -> None:
    places = formation(shape, count, spacing, (10.0, -5.0, 7.0), yaw)
    assert len(places) == count
    assert min(math.dist(p, q) for p, q in combinations(places, 2)) == pytest.approx(spacing, rel=1e-9)
    assert [sum(p[k] for p in places) / count for k in range(3)] == pytest.approx([10.0, -5.0, 7.0], abs=1e-9)


def test_the_shapes_look_along_the_heading() -> None:
    assert formation("line", 3, 2.0) == [(0.0, 2.0, 0.0), (0.0, 0.0, 0.0), (0.0, -2.0, 0.0)]
    assert formation("column", 3, 2.0) == [(2.0, 0.0, 0.0), (0.0, 0.0, 0.0), (-2.0, 0.0, 0.0)]
    first, *others = formation("column", 3, 2.0, yaw_rad=NINETY)
    assert first == pytest.approx((0.0, 2.0, 0.0))
    assert formation("v", 3, 2.0)[0][0] > max(place[0] for place in formation("v", 3, 2.0)[1:])
    assert formation("circle", 1, 5.0, (1.0, 2.0, 3.0)) == [(1.0, 2.0, 3.0)]
    assert len(others) == 2


def test_points_are_moved_turned_and_scaled_about_their_middle() -> None:
    points = [(0.0, 0.0, 1.0), (4.0, 0.0, 3.0)]
    found = placed(points, (0.0, 0.0, 10.0), NINETY, 2.0)
    assert found[0] == pytest.approx((0.0, -4.0, 8.0))
    assert found[1] == pytest.approx((0.0, 4.0, 12.0))


@pytest.mark.parametrize(
    ("shape", "count", "spacing", "words"),
    [("star", 3, 1.0, "no formation 'star'"), ("line", 0, 1.0, "0 vehicles"), ("line", 3, math.nan, "spacing of nan")],
)
def test_what_is_no_formation_is_refused(shape: str, count: int, spacing: float, words: str) -> None:
    with pytest.raises(RefusedError, match=words):
        formation(shape, count, spacing)
    for scale, yaw in ((0.0, 0.0), (math.nan, 0.0), (1.0, math.inf)):
        with pytest.raises(RefusedError):
            placed([(0.0, 0.0, 0.0)], scale=scale, yaw_rad=yaw)
    with pytest.raises(RefusedError, match="not within"):
        placed([(0.0, 0.0, 0.0)], (math.inf, 0.0, 0.0))
