from __future__ import annotations

import math
from itertools import combinations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from skygcs.core.plan.formations import SHAPES, WantedFormation, formation, placed
from skygcs.errors import RefusedError
from support.table import each

NINETY = math.radians(90.0)


@given(st.sampled_from(SHAPES), st.integers(2, 60), st.floats(0.5, 20), st.floats(-10, 10))
def test_neighbours_are_a_spacing_apart_and_the_middle_is_where_it_is_put(shape, count, spacing, yaw) -> None:
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
    first, second = placed([(0.0, 0.0, 1.0), (4.0, 0.0, 3.0)], (0.0, 0.0, 10.0), NINETY, 2.0)
    assert (*first, *second) == pytest.approx((0.0, -4.0, 8.0, 0.0, 4.0, 12.0))


@each(
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


STARTS = {"alpha": (0.0, 0.0, 10.0), "bravo": (10.0, 0.0, 12.0), "charlie": (5.0, 0.0, 14.0)}


def test_the_current_formation_is_moved_turned_and_scaled_and_each_keeps_its_place() -> None:
    wanted = WantedFormation("current", (100.0, 0.0, 12.0), NINETY, 2.0)
    found = wanted.places(list(STARTS), STARTS)
    assert not wanted.exchangeable
    assert found["alpha"] == pytest.approx((100.0, -10.0, 8.0))
    assert found["bravo"] == pytest.approx((100.0, 10.0, 12.0))
    assert found["charlie"] == pytest.approx((100.0, 0.0, 16.0))
    stays = WantedFormation("current").places(["bravo", "alpha"], STARTS)  # about the middle of those two
    assert stays == {"bravo": pytest.approx(STARTS["bravo"]), "alpha": pytest.approx(STARTS["alpha"])}


def test_points_and_shapes_are_for_as_many_vehicles() -> None:
    points = ((0.0, 0.0, 0.0), (4.0, 0.0, 0.0), (0.0, 4.0, 1.0))
    wanted = WantedFormation("points", points_m=points)
    assert wanted.exchangeable
    assert list(wanted.places(list(STARTS), {}).values()) == [pytest.approx(point) for point in points]
    shape = WantedFormation("line", (0.0, 0.0, 5.0), 0.0, 2.0, 3.0)
    assert [y for _, y, _ in shape.places(list(STARTS), {}).values()] == pytest.approx([6.0, 0.0, -6.0])


@each(
    ("wanted", "words"),
    [
        (WantedFormation("points", points_m=((0.0, 0.0, 0.0),)), "1 points for 3 vehicles"),
        (WantedFormation("points"), "0 points for 3 vehicles"),
        (WantedFormation("line"), "a line needs its middle"),
        (WantedFormation("current", points_m=((0.0, 0.0, 0.0),)), "points are for the formation 'points'"),
        (WantedFormation("star"), "no formation 'star'"),
        (WantedFormation("current", scale=math.nan), "scale of nan"),
        (WantedFormation("current", yaw_rad=math.inf), "not an angle"),
        (WantedFormation("current", (math.nan, 0.0, 0.0)), "not within"),
    ],
)
def test_what_cannot_be_taken_is_refused(wanted: WantedFormation, words: str) -> None:
    with pytest.raises(RefusedError, match=words):
        wanted.places(list(STARTS), STARTS)


def test_the_current_formation_needs_the_place_of_each() -> None:
    with pytest.raises(RefusedError, match="delta: its place in the current formation is not known"):
        WantedFormation("current").places(["alpha", "delta"], STARTS)
