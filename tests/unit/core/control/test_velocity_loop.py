"""The velocity loop: PI with a filtered D, and what a far reference builds up before it: no more than can be braked."""

from __future__ import annotations

import math
from dataclasses import asdict, replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from skygcs.core.control import AxisGains, ControlConfig, Estimate, Memory, Reference, step, velocity_step
from skygcs.core.control.gains import GRAVITY_MPS2
from skygcs.core.control.velocity_loop import (
    approach_speed,
    clip,
    filtered_slope,
    grown,
    grown_xy,
    horizontal,
    horizontal_limit,
    newest_weight,
    record,
    vertical,
)
from skygcs.errors import ConfigError
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
    up = vertical(CONFIG, 1.0, 0.0, 0.01, 0.0, DT_S)
    assert up.thrust == pytest.approx(0.45 + 0.3 + 0.01), "with the integral of before this step"
    assert vertical(CONFIG, 1.0, 0.0, 0.05, 0.0, 0.0).integral == 0.05, "a step of no time"
    level = horizontal(CONFIG, (10.0, -10.0), STILL, (0.05, 0.06), STILL, 0.45, 0.0)
    assert (level.integral_x, level.integral_y) == (0.05, 0.06)


def test_the_horizontal_limit_is_the_tilt_at_hover_and_the_rest_of_the_thrust_near_full():
    for thrust, limit in (
        (0.45, 0.45 * math.tan(math.radians(35))),
        (0.85, math.sqrt(0.9**2 - 0.85**2)),
        (0.9, 0.0),
        (math.nextafter(0.9, 1.0), 0.0),  # rounding goes past it
    ):
        assert horizontal_limit(CONFIG, thrust) == pytest.approx(limit)


def test_cut_horizontal_thrust_and_a_bounded_integral_keep_their_direction():
    level = horizontal(CONFIG, (6.0, 8.0), STILL, STILL, STILL, 0.45, DT_S)
    assert level.cut
    assert (level.thrust_x, level.thrust_y) == pytest.approx((0.6 * level.limit, 0.8 * level.limit))
    level, most = horizontal(CONFIG, STILL, STILL, (3.0, 4.0), (-3.0, -4.0), 0.45, DT_S), CONFIG.integral_xy_max
    assert (level.integral_x, level.integral_y) == pytest.approx((0.6 * most, 0.8 * most))
    assert level.integral_at_bound


def test_what_is_cut_off_pulls_the_horizontal_integral_back():
    free = horizontal(CONFIG, (1.0, 0.0), STILL, STILL, STILL, 0.45, DT_S)
    assert free.integral_x == pytest.approx(0.02 * 1.0 * DT_S)
    cut = horizontal(CONFIG, (10.0, 0.0), STILL, STILL, STILL, 0.45, DT_S)
    excess = 0.08 * 10.0 - cut.limit
    assert cut.integral_x == pytest.approx(0.02 * (10.0 - excess * 2 / 0.08) * DT_S)
    assert cut.integral_x < free.integral_x * 10.0


# --- limit of the velocity setpoint -----------------------------------------------------------------------------------

LIMITED = ControlConfig(acc_xy_max_mps2=2.0, acc_z_max_mps2=1.0)
PERIOD_S = LIMITED.period_s

metres = st.floats(-100.0, 100.0)
speeds, slow = st.floats(-15.0, 15.0), st.floats(-8.0, 8.0)


@given(st.floats(0.0, 1000.0), st.floats(0.05, 5.0), st.floats(0.1, 30.0))
def test_from_the_speed_towards_a_position_it_can_be_braked_before_it(distance_m: float, p: float, acc: float) -> None:
    speed = approach_speed(p * distance_m, acc / p)
    assert speed <= p * distance_m + 1e-9
    assert speed * speed / (2.0 * acc) <= distance_m + 1e-9
    if p * p * distance_m <= acc:
        assert speed == p * distance_m, "near the position it is the loop's own"


def test_it_passes_from_the_loop_to_the_braking_curve_without_a_jump_or_a_kink() -> None:
    p, acc = 0.95, 2.0
    edge = acc / p
    for step_mps in (1e-6, 1e-4):
        assert approach_speed(edge + step_mps, edge) == pytest.approx(edge + step_mps, abs=step_mps**2)


def test_without_a_position_gain_nothing_is_limited() -> None:
    config = replace(LIMITED, xy=AxisGains(0.0, 0.08, 0.02), z=AxisGains(0.0, 0.3, 0.02))
    assert config.near_xy_squared == config.near_z_mps == math.inf
    here = Estimate((0.0, 0.0, 0.0), (0.0, 0.0, 0.0))
    assert velocity_step(config, Memory(), here, Reference((9.0, 9.0, 9.0)), PERIOD_S)[0] == (0.0, 0.0, 0.0)


@given(speeds, speeds, st.floats(0.001, 1.0))
def test_a_speed_grows_by_no_more_and_shrinks_at_once(wanted: float, before: float, most: float) -> None:
    now = grown(wanted, before, most)
    assert abs(now) <= abs(wanted) and now * wanted >= 0.0
    assert abs(now) <= max(before * math.copysign(1.0, wanted), 0.0) + most + 1e-9
    if abs(wanted) <= abs(before) and wanted * before > 0.0:
        assert now == wanted
    x, y = grown_xy(wanted, 0.0, wanted**2, before, 0.0, most)
    assert (x, y) == (pytest.approx(now), 0.0)


@given(speeds, speeds, speeds, speeds, st.floats(0.001, 1.0))
def test_a_velocity_grows_along_its_own_direction(x: float, y: float, bx: float, by: float, most: float) -> None:
    nx, ny = grown_xy(x, y, x * x + y * y, bx, by, most)
    size, now = math.hypot(x, y), math.hypot(nx, ny)
    assert now <= size + 1e-9
    if size > 1e-3:
        assert nx * y - ny * x == pytest.approx(0.0, abs=1e-6), "the direction is not changed"
        along = max((bx * x + by * y) / size, 0.0)
        assert now == pytest.approx(min(size, along + most))


@given(st.tuples(metres, metres, metres), st.tuples(slow, slow, slow))
def test_near_or_moving_references_are_followed_as_without(ref, vel) -> None:
    """Within a / Kp² of it, from the setpoint of the step before."""
    wanted = Reference(ref, 0.3, vel)
    off = (0.9, -0.8, 0.4)
    estimate = Estimate(tuple(r - o for r, o in zip(ref, off, strict=True)), vel)
    plain, _ = step(CONFIG, Memory(), estimate, wanted, PERIOD_S, following=True)
    before = replace(Memory(), vel_setpoint_enu_mps=plain.vel_setpoint_enu_mps)
    limited, _ = step(LIMITED, before, estimate, wanted, PERIOD_S, following=True)
    assert limited == plain


def flown(config: ControlConfig, goal: tuple[float, float, float], seconds: float = 12.0) -> list[tuple]:
    """A point mass at once; position, velocity and thrust's acceleration in each step."""
    x, v, memory, seen = [0.0] * 3, [0.0] * 3, Memory(), []
    for _ in range(round(seconds / PERIOD_S)):
        output, memory = step(config, memory, Estimate(tuple(x), tuple(v)), Reference(goal), PERIOD_S, following=True)
        acc = [GRAVITY_MPS2 * t / config.hover_thrust for t in output.thrust_enu]
        acc[2] -= GRAVITY_MPS2
        for i in range(3):
            v[i] += acc[i] * PERIOD_S
            x[i] += v[i] * PERIOD_S
        seen.append((tuple(x), tuple(v), tuple(acc)))
    return seen


@each("far_m", [3.0, 40.0])
def test_a_step_speeds_up_by_the_limit_and_arrives(far_m: float) -> None:
    """The integral winds up by Ki a/(G Kv) a second meanwhile, a quarter of a m/s² in a second."""
    across, up = flown(LIMITED, (far_m, 0.0, 0.0), 40.0), flown(LIMITED, (0.0, 0.0, far_m), 60.0)
    assert max(acc[0] for *_, acc in across) <= 2.0 * 1.5
    assert max(acc[2] for *_, acc in up) <= 1.0 * 1.3
    for seen, axis in ((across, 0), (up, 2)):
        assert seen[-1][0][axis] == pytest.approx(far_m, abs=0.1)
        assert max(x[axis] for x, *_ in seen) <= far_m + 0.4
    assert max(acc[0] for *_, acc in flown(CONFIG, (far_m, 0.0, 0.0))) > 4.0, "without: a lean of 25 degrees and more"


def test_velocity_control_builds_up_the_same_way() -> None:
    memory, wanted, steps = Memory(), [], 40
    estimate = Estimate((0.0, 0.0, 0.0), (0.0, 0.0, 0.0))
    for _ in range(steps):
        velocity, memory = velocity_step(LIMITED, memory, estimate, Reference((8.0, 0.0, -4.0)), 0.1)
        wanted.append(velocity)
    assert wanted[4] == pytest.approx((1.0, 0.0, -0.5))
    most = math.sqrt(2 * 2.0 * 8.0 - (2.0 / 0.95) ** 2)
    assert wanted[-1] == pytest.approx((most, 0.0, -math.sqrt(2 * 1.0 * 4.0 - 1.0)))


def test_a_velocity_alone_builds_up_too_and_a_reference_s_own_acceleration_is_not_limited() -> None:
    here = Estimate((0.0, 0.0, 0.0), (0.0, 0.0, 0.0))
    alone = Reference(vel_enu_mps=(6.0, 0.0, 3.0), velocity_only_xy=True, velocity_only_z=True)
    velocity, _ = velocity_step(LIMITED, Memory(), here, alone, 0.1)
    assert velocity == pytest.approx((0.2, 0.0, 0.1))
    moving = replace(alone, acc_enu_mps2=(5.0, 0.0, 4.0))
    velocity, _ = velocity_step(LIMITED, Memory(), here, moving, 0.1)
    assert velocity == pytest.approx((0.7, 0.0, 0.5))


def test_it_stops_and_turns_back_at_once() -> None:
    before = replace(Memory(), vel_setpoint_enu_mps=(5.0, 0.0, 2.0))
    fast = Estimate((0.0, 0.0, 0.0), (5.0, 0.0, 2.0))
    velocity, _ = velocity_step(LIMITED, before, fast, Reference((0.0, 0.0, 0.0)), PERIOD_S)
    assert velocity == (0.0, 0.0, 0.0)
    velocity, _ = velocity_step(LIMITED, before, fast, Reference((-8.0, 0.0, -8.0)), PERIOD_S)
    assert velocity == pytest.approx((-2.0 * PERIOD_S, 0.0, -1.0 * PERIOD_S))


@each("value", [0.0, 0.09, 101.0, math.nan, -1.0])
def test_limits_out_of_range_are_refused(value: float) -> None:
    for key in ("acc_xy_max_mps2", "acc_z_max_mps2"):
        with pytest.raises(ConfigError, match=key):
            ControlConfig(**{key: value})


@record
class Point:
    x: float
    y: float = 2.0


def test_a_record_is_compared_hashed_replaced_and_shown_as_a_frozen_dataclass_is() -> None:
    point = Point(1.0)
    assert point == Point(1.0, 2.0) and hash(point) == hash(Point(1.0, 2.0))
    assert replace(point, y=3.0) == Point(1.0, 3.0) != point
    assert asdict(point) == {"x": 1.0, "y": 2.0}
    assert repr(point) == "Point(x=1.0, y=2.0)"
    assert not hasattr(point, "__dict__")
