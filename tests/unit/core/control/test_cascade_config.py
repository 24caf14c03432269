from __future__ import annotations

import math
from dataclasses import replace

import pytest

from skygcs.core.control import AxisGains, ControlConfig
from skygcs.errors import ConfigError
from support.table import each


def test_the_defaults_are_those_flown_with_the_seeds_gains():
    config = ControlConfig()
    assert config.xy == AxisGains(0.95, 0.08, 0.02, 0.0)
    assert config.z == AxisGains(1.0, 0.3, 0.02, 0.0)
    assert (config.hover_thrust, config.thrust_min, config.thrust_max) == (0.45, 0.1, 0.9)
    assert math.degrees(config.tilt_max_rad) == pytest.approx(35.0)
    assert (config.vel_xy_max_mps, config.vel_z_max_mps, config.derivative_cutoff_hz) == (10.0, 10.0, 5.0)
    assert (config.dt_min_s, config.dt_max_s) == pytest.approx((0.01, 0.03))


@each(
    ("change", "named"),
    [
        ({"hover_thrust": 0.95}, "hover_thrust"),
        ({"hover_thrust": math.nan}, "hover_thrust"),
        ({"thrust_min": -0.1}, "thrust_min"),
        ({"thrust_max": 1.1}, "thrust_max"),
        ({"tilt_max_rad": 0.0}, "tilt_max_rad"),
        ({"tilt_max_rad": math.radians(81)}, "tilt_max_rad"),
        ({"vel_xy_max_mps": 0.0}, "vel_xy_max_mps"),
        ({"vel_z_max_mps": math.inf}, "vel_z_max_mps"),
        ({"derivative_cutoff_hz": -1.0}, "derivative_cutoff_hz"),
        ({"period_s": 0.0}, "period_s"),
        ({"xy": AxisGains(-0.1, 0.08, 0.02)}, "xy.pos_p_per_s"),
        ({"xy": AxisGains(0.95, 0.0, 0.02)}, "xy.vel_p"),
        ({"z": AxisGains(1.0, 0.3, math.nan)}, "z.vel_i"),
        ({"z": AxisGains(1.0, 0.3, 0.02, 1e3)}, "z.vel_d"),
    ],
)
def test_a_value_that_cannot_fly_is_named(change, named):
    with pytest.raises(ConfigError) as error:
        replace(ControlConfig(), **change)
    assert len(error.value.problems) == 1
    assert named in error.value.problems[0]


def test_all_problems_are_told_at_once():
    with pytest.raises(ConfigError) as error:
        ControlConfig(xy=AxisGains(-1.0, -1.0, 0.02), period_s=2.0)
    assert len(error.value.problems) == 3


@each("pos_p_per_s", [0.0, 5e-324, 1e-300, 1e-160])
def test_a_position_gain_of_nearly_zero_leaves_the_velocity_unlimited(pos_p_per_s: float) -> None:
    gains = AxisGains(pos_p_per_s, 0.08, 0.02)
    assert ControlConfig(xy=gains, acc_xy_max_mps2=2.0).near_xy_squared == math.inf
