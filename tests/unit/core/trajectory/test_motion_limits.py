from __future__ import annotations

import math

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from skygcs.core.trajectory import MotionLimits, Piece, Trajectory, motion_peaks, require_within, within_at_speed
from skygcs.core.trajectory.piecewise import derivative, error_bound, from_power, halves, product, to_power
from skygcs.core.trajectory.timing import path_within
from skygcs.errors import TrajectoryError
from support.examples import examples
from support.table import each

coefficients = st.lists(st.floats(-20, 20), min_size=1, max_size=9).map(tuple)
pieces = st.builds(Piece, st.floats(0.1, 2.5), coefficients, coefficients, coefficients)
trajectories = st.lists(pieces, min_size=1, max_size=3).map(Trajectory)


@given(coefficients, st.floats(0.1, 5.0), st.floats(0, 1))
def test_the_bernstein_form_encloses_the_polynomial_and_meets_it_at_the_ends(c, duration, part) -> None:
    b = from_power(c, duration)
    error = error_bound(c, duration) + 1e-9
    value = math.fsum(a * (part * duration) ** k for k, a in enumerate(c))
    assert min(b) - error <= value <= max(b) + error
    assert b[0] == pytest.approx(c[0])
    assert b[-1] == pytest.approx(math.fsum(a * duration**k for k, a in enumerate(c)), abs=error)
    for a, b_ in zip(to_power(b, duration), c, strict=True):
        assert a == pytest.approx(b_, rel=1e-6, abs=1e3 * error / min(duration, 1.0) ** (len(c) - 1))


def test_products_derivatives_and_halves_of_a_known_polynomial() -> None:
    square = from_power((0.0, 0.0, 1.0), 2.0)  # t² on [0, 2]
    assert square == [0.0, 0.0, 4.0]
    assert derivative(square, 2.0) == [0.0, 4.0]
    assert product([0.0, 2.0], [0.0, 2.0]) == square
    left, right = halves(square)
    assert (left, right) == ([0.0, 0.0, 1.0], [1.0, 2.0, 4.0])


@settings(max_examples=examples(60))
@given(trajectories)
def test_the_peaks_are_never_below_any_sample_and_are_reached(trajectory: Trajectory) -> None:
    peaks = motion_peaks(trajectory)
    speeds, accelerations, climbs = [], [], []
    for piece in trajectory.pieces:
        single = Trajectory([piece])
        for i in range(201):
            point = single.at(min(i / 200 * piece.duration_s, piece.duration_s))
            speeds.append(math.hypot(*point.vel_enu_mps))
            accelerations.append(math.hypot(*point.acc_enu_mps2))
            climbs.append(point.vel_enu_mps[2])
    for sampled, peak in (
        (max(speeds), peaks.speed_mps),
        (max(accelerations), peaks.acceleration_mps2),
        (max(0.0, *climbs), peaks.climb_mps),
        (max(0.0, *(-c for c in climbs)), peaks.descent_mps),
    ):
        assert sampled <= peak.at_most * (1 + 1e-9) + 1e-6
        assert peak.at_least <= peak.at_most
        assert peak.at_most - peak.at_least <= 1e-5 * peak.at_most + 1e-4
        assert sampled >= peak.at_least * 0.98 - 1e-3


def test_a_speed_between_the_samples_is_seen() -> None:
    """Speed 1 m/s but for 5.8 ms, in which it is 3 m/s: sampled at 5 Hz it is not there."""
    duration = 10.0
    ends = Piece(duration, (0.0, 1.0), (0.0,), (0.0,))
    fast = Piece(0.006, (10.0, 3.0), (0.0,), (0.0,))
    peak = motion_peaks(Trajectory([ends, fast, ends])).speed_mps
    assert (peak.piece, peak.at_least) == (2, pytest.approx(3.0, rel=1e-6))
    assert peak.at_most == pytest.approx(3.0, rel=1e-5)


def test_the_peak_of_a_minimum_jerk_leg_is_the_textbooks() -> None:
    """10 m in 4 s: speed 1.875 L/T, acceleration 10/√3 L/T², jerk 60 L/T³."""
    length, time = 10.0, 4.0
    east = (0.0, 0.0, 0.0, 10 * length / time**3, -15 * length / time**4, 6 * length / time**5)
    peaks = motion_peaks(Trajectory([Piece(time, east, (0.0,), (0.0,))]))
    assert peaks.speed_mps.at_most == pytest.approx(1.875 * length / time, rel=2e-6)
    assert peaks.acceleration_mps2.at_most == pytest.approx(10 / math.sqrt(3) * length / time**2, rel=2e-6)
    assert peaks.jerk_mps3.at_most == pytest.approx(60 * length / time**3, rel=2e-6)
    assert peaks.speed_mps.t_s == pytest.approx(2.0, abs=0.01)


def test_limits_name_what_where_and_how_much() -> None:
    sinking = Trajectory([Piece(1.0, (0.0,), (0.0,), (20.0,)), Piece(2.0, (0.0,), (0.0,), (20.0, -2.0))])
    with pytest.raises(TrajectoryError, match=r"piece 2, up: descent rate of 2 m/s at 1 s; the limit is 1\.5 m/s"):
        require_within(sinking, MotionLimits())
    require_within(sinking, MotionLimits(descent_mps=2.0))


@each("value", [0.0, -1.0, math.nan, 1e9])
def test_a_limit_that_is_none_is_refused(value: float) -> None:
    with pytest.raises(TrajectoryError, match="speed_mps"):
        MotionLimits(speed_mps=value)


@given(st.floats(0.2, 4.0), st.floats(2.0, 200.0), st.floats(0.5, 4.0), st.floats(1.0, 8.0))
@settings(max_examples=examples(60), deadline=None)
def test_a_way_that_is_timed_for_a_faster_clock_is_flown_within_the_limits(
    factor: float, length_m: float, acceleration: float, jerk: float
) -> None:
    limits = MotionLimits(acceleration_mps2=acceleration, jerk_mps3=jerk)
    peaks = motion_peaks(path_within(((0.0, 0.0, 10.0), (length_m, 0.0, 10.0)), within_at_speed(limits, factor)))
    assert peaks.speed_mps.at_most <= limits.speed_mps * 1.001
    assert peaks.acceleration_mps2.at_most * factor**2 <= acceleration * 1.01
    assert peaks.jerk_mps3.at_most * factor**3 <= jerk * 1.01
