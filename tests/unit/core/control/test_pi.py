from __future__ import annotations

import math

import pytest

from skygcs.core.control.gains import ControlConfig
from skygcs.core.control.velocity_loop import (
    clip,
    filtered_slope,
    horizontal,
    horizontal_limit,
    newest_weight,
    vertical,
)
from support.table import each

CONFIG = ControlConfig()
DT_S = 0.02
STILL = (0.0, 0.0)


def test_clip_keeps_the_sign_and_bounds_the_magnitude():
    assert [clip(v, 2.0) for v in (-5.0, -2.0, 0.5, 2.0, 5.0)] == [-2.0, -2.0, 0.5, 2.0, 2.0]


def test_the_slope_of_a_ramp_is_found_within_a_few_time_constants():
    slope = 0.0
    for tick in range(50):
        slope = filtered_slope(0.1 * (tick + 1), 0.1 * tick, slope, DT_S, newest_weight(DT_S, 5.0))
    assert slope == pytest.approx(5.0, rel=1e-6)


def test_the_slope_of_a_step_dies_at_the_cut_off_frequency():
    """One sample of 5 Hz at 50 Hz: weight 2 pi 5 x 0.02 / (1 + that) = 0.386."""
    first = filtered_slope(1.0, 0.0, 0.0, DT_S, newest_weight(DT_S, 5.0))
    assert first == pytest.approx(0.38587 / DT_S, rel=1e-4)
    second = filtered_slope(1.0, 1.0, first, DT_S, newest_weight(DT_S, 5.0))
    assert second == pytest.approx(first * (1 - 0.38587), rel=1e-4)


@each(
    ("error", "before", "after", "at_max"),
    [
        (2.0, 0.3, 0.3, True),
        (-2.0, -0.3, -0.3, False),
        (-0.5, 0.9, 0.9 - 0.02 * 0.5 * DT_S, True),
        (0.5, -0.9, -0.9 + 0.02 * 0.5 * DT_S, False),
    ],
)
def test_the_vertical_integral_stops_at_a_limit_of_thrust_unless_the_error_unwinds_it(error, before, after, at_max):
    up = vertical(CONFIG, error, 0.0, before, 0.0, DT_S)
    assert (up.at_max, up.at_min) == (at_max, not at_max)
    assert up.integral == pytest.approx(after)
    assert abs(error) < 2.0 or up.thrust == (0.9 if at_max else 0.1)


def test_the_vertical_integral_is_never_larger_than_the_thrust():
    """The feed-forward keeps the thrust itself off its limits, so that nothing stops the integral."""
    assert vertical(CONFIG, 1e5, 0.0, 0.8, -0.3e5 - 0.8, DT_S).integral == 0.9
    assert vertical(CONFIG, -1e5, 0.0, -0.8, 0.3e5 + 0.8, DT_S).integral == -0.9


def test_the_vertical_thrust_takes_the_integral_of_before_this_step():
    assert vertical(CONFIG, 1.0, 0.0, 0.01, 0.0, DT_S).thrust == pytest.approx(0.45 + 0.3 + 0.01)


def test_the_horizontal_limit_is_the_tilt_at_hover_and_the_rest_of_the_thrust_near_full():
    assert horizontal_limit(CONFIG, 0.45) == pytest.approx(0.45 * math.tan(math.radians(35)))
    assert horizontal_limit(CONFIG, 0.85) == pytest.approx(math.sqrt(0.9**2 - 0.85**2))
    assert horizontal_limit(CONFIG, 0.9) == 0.0
    assert horizontal_limit(CONFIG, math.nextafter(0.9, 1.0)) == 0.0, "rounding goes past it"


def test_cut_horizontal_thrust_keeps_its_direction():
    level = horizontal(CONFIG, (6.0, 8.0), STILL, STILL, STILL, 0.45, DT_S)
    assert level.cut
    assert math.hypot(level.thrust_x, level.thrust_y) == pytest.approx(level.limit)
    assert level.thrust_y / level.thrust_x == pytest.approx(8 / 6)


def test_what_is_cut_off_pulls_the_horizontal_integral_back():
    free = horizontal(CONFIG, (1.0, 0.0), STILL, STILL, STILL, 0.45, DT_S)
    assert free.integral_x == pytest.approx(0.02 * 1.0 * DT_S)
    cut = horizontal(CONFIG, (10.0, 0.0), STILL, STILL, STILL, 0.45, DT_S)
    excess = 0.08 * 10.0 - cut.limit
    assert cut.integral_x == pytest.approx(0.02 * (10.0 - excess * 2 / 0.08) * DT_S)
    assert cut.integral_x < free.integral_x * 10.0


def test_the_horizontal_integral_is_bounded_in_norm_and_keeps_its_direction():
    level = horizontal(CONFIG, STILL, STILL, (3.0, 4.0), (-3.0, -4.0), 0.45, DT_S)
    assert (level.integral_x, level.integral_y) == pytest.approx(
        (0.6 * CONFIG.integral_xy_max, 0.8 * CONFIG.integral_xy_max)
    )
    assert level.integral_at_bound


def test_a_step_of_no_time_integrates_nothing():
    assert vertical(CONFIG, 1.0, 0.0, 0.05, 0.0, 0.0).integral == 0.05
    level = horizontal(CONFIG, (10.0, -10.0), STILL, (0.05, 0.06), STILL, 0.45, 0.0)
    assert (level.integral_x, level.integral_y) == (0.05, 0.06)
