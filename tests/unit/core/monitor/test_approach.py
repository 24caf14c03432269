"""The closest approach in closed form, against dense sampling."""

from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from skygcs.core.monitor.approach import Piece, Vector, closest_approach, closest_on_paths
from support.table import each

STEP_S = 0.001


def vectors(most: float) -> st.SearchStrategy[Vector]:
    number = st.floats(-most, most)
    return st.tuples(number, number, number)


def sampled(offset: Vector, first: list[Piece], second: list[Piece], horizon_s: float) -> list[float]:
    """Distances every `STEP_S`, by adding up small steps."""
    distances, here, at = [], list(offset), 0.0

    def velocity(pieces: list[Piece], at: float) -> Vector:
        for piece in pieces:
            if at < piece.duration_s:
                return piece.velocity_mps
            at -= piece.duration_s
        return (0.0, 0.0, 0.0)

    while at <= horizon_s:
        distances.append(math.hypot(*here))
        a, b = velocity(first, at), velocity(second, at)
        here = [h + (v - u) * STEP_S for h, u, v in zip(here, a, b, strict=True)]
        at += STEP_S
    return distances


@given(vectors(100.0), vectors(20.0), st.floats(0.1, 30.0))
def test_straight_flight_is_as_sampled(offset: Vector, velocity: Vector, radius_m: float) -> None:
    approach = closest_approach(offset, velocity, radius_m, 5.0)
    found = sampled(offset, [], [Piece(math.inf, velocity)], 5.0)
    step_m = math.hypot(*velocity) * STEP_S
    assert approach.separation_m <= min(found) + 1e-6
    assert approach.separation_m >= min(found) - step_m - 1e-6
    inside = [i * STEP_S for i, distance in enumerate(found) if distance < radius_m]
    if math.isfinite(approach.enters_s):
        at = [o + v * approach.enters_s for o, v in zip(offset, velocity, strict=True)]
        assert math.hypot(*at) <= radius_m * (1 + 1e-6) + 1e-6
    if inside:
        assert approach.enters_s <= inside[0] + 1e-6
    elif math.isfinite(approach.enters_s):  # dipped in between two samples only
        assert approach.separation_m >= radius_m - step_m


@given(
    vectors(60.0),
    st.lists(st.builds(Piece, st.floats(0.0, 3.0), vectors(8.0)), max_size=3),
    st.lists(st.builds(Piece, st.floats(0.0, 3.0), vectors(8.0)), max_size=3),
)
def test_paths_of_pieces_are_as_sampled(offset: Vector, first: list[Piece], second: list[Piece]) -> None:
    approach = closest_on_paths(offset, first, second, 5.0, 6.0)
    found = sampled(offset, first, second, 6.0)
    assert approach.separation_m == pytest.approx(min(found), abs=0.12)  # a change of velocity falls between samples
    if min(found) < 4.8:
        assert math.isfinite(approach.enters_s)
    if min(found) > 5.2:
        assert math.isinf(approach.enters_s)


def test_what_does_not_move_is_where_it_is() -> None:
    assert closest_approach((3.0, 4.0, 0.0), (0.0, 0.0, 0.0), 4.9, 10.0) == (5.0, 0.0, math.inf)
    assert closest_approach((3.0, 4.0, 0.0), (0.0, 0.0, 0.0), 5.1, 10.0) == (5.0, 0.0, 0.0)
    assert closest_on_paths((3.0, 4.0, 0.0), (), (), 4.9, 0.0) == (5.0, 0.0, math.inf)


def test_head_on_at_a_known_time() -> None:
    approach = closest_approach((20.0, 0.0, 0.0), (-4.0, 0.0, 0.0), 2.0, 10.0)
    assert approach == pytest.approx((0.0, 5.0, 4.5))
    assert math.isinf(closest_approach((20.0, 0.0, 0.0), (-4.0, 0.0, 0.0), 2.0, 4.4).enters_s)
    assert closest_approach((20.0, 0.0, 0.0), (4.0, 0.0, 0.0), 2.0, 10.0).separation_m == 20.0


@each("scale", [1e-9, 1.0, 1e7])
def test_digits_are_kept_at_any_scale(scale: float) -> None:
    approach = closest_approach((scale, 0.0, 0.0), (-scale, 0.0, 0.0), 0.25 * scale, 10.0)
    assert approach.enters_s == pytest.approx(0.75, rel=1e-9)
