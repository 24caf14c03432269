from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from skygcs.core.trajectory import Piece, Trajectory, joints, require_continuous
from skygcs.core.trajectory.piecewise import MAX_DEGREE, MAX_PIECES
from skygcs.core.trajectory.timing import hover
from skygcs.errors import TrajectoryError
from support.table import each

coefficients = st.lists(st.floats(-20, 20), min_size=1, max_size=9).map(tuple)
pieces = st.builds(Piece, st.floats(0.1, 2.5), coefficients, coefficients, coefficients, coefficients)
trajectories = st.lists(pieces, min_size=1, max_size=4).map(Trajectory)


def polynomial(piece: Piece, axis: str) -> np.polynomial.Polynomial:
    return np.polynomial.Polynomial(getattr(piece, axis))


@given(trajectories, st.floats(0, 1))
def test_values_and_derivatives_are_those_of_the_polynomials(trajectory: Trajectory, part: float) -> None:
    t = part * trajectory.duration_s
    index = max(i for i, begin in enumerate(trajectory.begins_s) if begin <= t)
    piece, u = trajectory.pieces[index], t - trajectory.begins_s[index]
    point = trajectory.at(t)
    for k, axis in enumerate(("east", "north", "up")):
        p = polynomial(piece, axis)
        assert point.pos_enu_m[k] == pytest.approx(p(u), rel=1e-9, abs=1e-6)
        assert point.vel_enu_mps[k] == pytest.approx(p.deriv()(u), rel=1e-9, abs=1e-6)
        assert point.acc_enu_mps2[k] == pytest.approx(p.deriv(2)(u), rel=1e-9, abs=1e-5)
    assert point.yaw_rad == pytest.approx(polynomial(piece, "yaw")(u), rel=1e-9, abs=1e-6)
    assert point.yaw_rate_radps == pytest.approx(polynomial(piece, "yaw").deriv()(u), rel=1e-9, abs=1e-6)


@given(st.floats(0.2, 2.0), st.floats(-1.0, 1.0), st.floats(0.3, 2.5))
def test_a_time_scaling_scales_as_finite_differences_say(rate: float, change: float, middle: float) -> None:
    trajectory = Trajectory([Piece(3.0, (1.0, 2.0, -1.0, 0.5), (0.0, -1.0, 0.0, 0.2), (5.0, 0.3), (0.1, 0.2))])
    h = 1e-4

    def position(t: float) -> tuple[float, float, float]:
        return trajectory.at(middle + rate * t + 0.5 * change * t * t).pos_enu_m

    point = trajectory.at(middle, rate, change)
    for k in range(3):
        before, here, after = position(-h)[k], position(0.0)[k], position(h)[k]
        assert point.vel_enu_mps[k] == pytest.approx((after - before) / (2 * h), abs=1e-5)
        assert point.acc_enu_mps2[k] == pytest.approx((after - 2 * here + before) / h**2, abs=1e-4)
    assert point.yaw_rate_radps == pytest.approx(0.2 * rate)


def test_outside_its_time_the_vehicle_stands_at_the_nearest_end() -> None:
    trajectory = Trajectory([Piece(2.0, (1.0, 1.0), (0.0,), (5.0,), (0.0, 0.5))])
    for t, east, yaw in ((-1.0, 1.0, 0.0), (math.nan, 1.0, 0.0), (2.5, 3.0, 1.0), (math.inf, 3.0, 1.0)):
        point = trajectory.at(t)
        assert (point.pos_enu_m, point.yaw_rad) == ((east, 0.0, 5.0), yaw)
        assert point.vel_enu_mps == point.acc_enu_mps2 == (0.0, 0.0, 0.0)
        assert point.yaw_rate_radps == 0.0
    assert trajectory.at(2.0).vel_enu_mps == (1.0, 0.0, 0.0)


@each(
    ("piece", "words"),
    [
        (Piece(0.0, (0.0,), (0.0,), (0.0,)), "piece 2: a duration of 0 s"),
        (Piece(math.nan, (0.0,), (0.0,), (0.0,)), "piece 2: a duration of nan s"),
        (Piece(1.0, (0.0,), (0.0, math.inf), (0.0,)), "piece 2, north: coefficient 1 is inf"),
        (Piece(1.0, (0.0,), (0.0,), (math.nan,)), "piece 2, up: coefficient 0 is nan"),
        (Piece(1.0, (0.0,) * (MAX_DEGREE + 2), (0.0,), (0.0,)), "piece 2, east: 17 coefficients"),
        (Piece(1.0, (), (0.0,), (0.0,)), "piece 2, east: 0 coefficients"),
        (Piece(100.0, (0.0,) * 15 + (1.0,), (0.0,), (0.0,)), "piece 2, east: coefficient 15 of 1 over 100 s"),
        (Piece(1.0, (0.0,), (1.1e5,), (0.0,)), "piece 2, north: a position of 110000 m"),
        (Piece(1.0, (0.0,), (0.0,), (0.0,), (0.0,)), "piece 2, yaw: either every piece has a yaw or none"),
    ],
)
def test_what_cannot_be_flown_is_refused_with_piece_and_axis(piece: Piece, words: str) -> None:
    with pytest.raises(TrajectoryError) as refused:
        Trajectory([Piece(1.0, (0.0,), (0.0,), (0.0,)), piece])
    assert str(refused.value).startswith(words)


def test_a_trajectory_has_a_bounded_size() -> None:
    for count, words in ((0, "no pieces"), (MAX_PIECES + 1, "10001 pieces"), (7201, "7201 s")):
        with pytest.raises(TrajectoryError, match=words):
            Trajectory([Piece(1.0, (0.0,), (0.0,), (0.0,))] * count)


def test_jumps_are_found_where_they_are() -> None:
    first = Piece(1.0, (0.0, 1.0), (0.0,), (0.0,), (0.0,))
    second = Piece(1.0, (1.0, 1.0, 0.5), (0.0, 2.0), (0.0,), (math.tau,))
    start, middle, end = joints(Trajectory([first, second]))
    assert (start.velocity_mps, start.acceleration_mps2) == (1.0, 0.0)
    found = middle.piece, middle.t_s, middle.position_m, middle.velocity_mps, middle.acceleration_mps2
    assert found == (2, 1, 0, 2, 1)
    assert middle.yaw_rad == pytest.approx(0.0, abs=1e-12)
    assert end.velocity_mps == pytest.approx(math.hypot(2.0, 2.0))
    require_continuous(Trajectory([first, second]))
    aside, turned = Piece(1.0, (1.02,), (0.0,), (0.0,), (0.0,)), Piece(1.0, (1.0,), (0.0,), (0.0,), (0.1,))
    for then, speed_mps, words in (
        (second, (1.5,), r"piece 2: the velocity jumps by 2 m/s at 1 s"),
        (aside, (), r"piece 2: the position jumps by 0\.02 m at 1 s"),
        (turned, (), r"piece 2, yaw: the yaw jumps by 5\.73° at 1 s"),
    ):
        with pytest.raises(TrajectoryError, match=words):
            require_continuous(Trajectory([first, then]), *speed_mps)


def test_a_trajectory_without_yaw_gives_none() -> None:
    point = hover((1.0, 2.0, 3.0), 5.0).at(1.0)
    assert (point.pos_enu_m, point.yaw_rad, point.yaw_rate_radps) == ((1.0, 2.0, 3.0), None, 0.0)
