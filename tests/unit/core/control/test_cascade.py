from __future__ import annotations

import math
from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from skygcs.core.control import AxisGains, ControlConfig, Estimate, Memory, Output, Reference, step, velocity_step
from support.table import each

CONFIG = ControlConfig()
HERE = Estimate((0.0, 0.0, 0.0), (0.0, 0.0, 0.0))
PERIOD_S = 0.02


def flown(
    reference: Reference,
    *,
    config: ControlConfig = CONFIG,
    memory: Memory | None = None,
    estimate: Estimate = HERE,
    dt_s: float = PERIOD_S,
    following: bool = True,
    steps: int = 1,
) -> tuple[Output, Memory]:
    output, memory = None, memory or Memory()
    for _ in range(steps):
        output, memory = step(config, memory, estimate, reference, dt_s, following=following)
    assert output is not None
    return output, memory


# --- golden vectors --------------------------------------------------------------------------------------------------


@each(
    ("position_error", "velocity", "thrust", "norm", "tilt_deg", "integral"),
    [
        ((0, 0, 0), (0, 0, 0), (0, 0, 0.45), 0.45, 0.0, (0, 0, 0)),
        ((1, 0, 0), (0, 0, 0), (0.076, 0, 0.45), 0.456373, 9.586, (3.8e-4, 0, 0)),
        ((0, 0, 1), (0, 0, 0), (0, 0, 0.75), 0.75, 0.0, (0, 0, 4e-4)),
        ((0, 0, -1), (0, 0, 0), (0, 0, 0.15), 0.15, 0.0, (0, 0, -4e-4)),
        ((0, 5, 0), (0, 0, 0), (0, 0.315093, 0.45), 0.549349, 35.0, (0, 1.251e-3, 0)),
        ((1, 0, -3), (0, 0, 0), (0.070021, 0, 0.1), 0.122077, 35.0, (3.202e-4, 0, 0)),
        ((0, 0, 0), (1, 0, 0), (-0.08, 0, 0.45), 0.457056, 10.081, (-4e-4, 0, 0)),
        ((20, 0, 10), (0, 0, 0), (0, 0, 0.9), 0.9, 0.0, (-4.0e-3, 0, 0)),
    ],
)
def test_golden_vectors(position_error, velocity, thrust, norm, tilt_deg, integral):
    output, memory = flown(Reference(position_error), estimate=Estimate((0, 0, 0), velocity))
    assert output.thrust_enu == pytest.approx(thrust, abs=6e-7)
    assert output.collective_thrust == pytest.approx(norm, abs=6e-7)
    _, x, y, _ = output.attitude_enu_flu
    assert math.degrees(math.acos(1 - 2 * (x * x + y * y))) == pytest.approx(tilt_deg, abs=6e-4)
    assert memory.integral_enu == pytest.approx(integral, abs=6e-7)


def test_the_error_counts_and_not_the_place():
    far, _ = flown(Reference((101.0, -50.0, 20.0)), estimate=Estimate((100.0, -50.0, 20.0), (0.0, 0.0, 0.0)))
    near, _ = flown(Reference((1.0, 0.0, 0.0)))
    assert far == near


# --- repairs ---------------------------------------------------------------------------------------------------------


def test_the_thrust_to_send_is_within_its_limit_even_where_rounding_leaves_the_vector_a_hair_above():
    output, _ = flown(Reference((30.0, 7.0, 1.2016)))
    assert math.hypot(*output.thrust_enu) > 0.9
    assert output.collective_thrust == 0.9


def test_the_horizontal_integral_is_bounded_even_while_its_anti_windup_drives_it_the_wrong_way():
    """At full vertical thrust all horizontal thrust is cut, and tracking pulls to -vel_p/2 x error = -1.6."""
    climbing = Estimate((0.0, 0.0, 0.0), (-30.0, 0.0, -5.0))
    _, memory = flown(Reference((40.0, 0.0, 20.0)), estimate=climbing, steps=5000)
    assert math.hypot(*memory.integral_enu[:2]) == pytest.approx(0.45 * math.tan(math.radians(35)))


def test_the_integral_grows_while_the_autopilot_follows_and_is_kept_while_it_does_not():
    held, reference = (0.01, -0.02, 0.03), Reference((1.0, 1.0, 0.5))
    _, kept = flown(reference, memory=Memory(held), following=False, steps=500)
    _, memory = flown(reference, memory=Memory(held), steps=500)
    assert kept.integral_enu == held
    assert all(after > before + 0.05 for after, before in zip(memory.integral_enu, held, strict=True))


@each("acc_enu_mps2", [(1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0), (-2.0, 0.5, -0.25)])
def test_an_acceleration_of_1_mps2_weighs_hover_over_g_along_each_axis(acc_enu_mps2):
    output, _ = flown(Reference(acc_enu_mps2=acc_enu_mps2))
    x, y, z = (0.45 / 9.81 * acc for acc in acc_enu_mps2)
    assert output.thrust_enu == pytest.approx((x, y, 0.45 + z))


@each(
    ("dt_s", "believed_s"),
    [
        *((0.011, 0.011), (0.02, 0.02), (0.029, 0.029), (0.0201, 0.0201), (0.1, 0.03), (1e5, 0.03)),
        *((0.001, 0.01), (0.0, 0.01), (-1.0, 0.01)),
    ],
)
def test_the_measured_time_is_integrated_and_clamped_to_what_the_period_allows(dt_s, believed_s):
    output, memory = flown(Reference((1.0, 0.0, 1.0)), dt_s=dt_s)
    assert memory.integral_enu == pytest.approx((0.02 * 0.95 * believed_s, 0.0, 0.02 * 1.0 * believed_s))
    assert output.saturation.dt == (dt_s != believed_s)


@each("rate_hz", [5, 10, 20, 50, 100])
def test_a_second_integrates_to_the_same_at_any_rate(rate_hz):
    config = ControlConfig(period_s=1 / rate_hz)
    _, memory = flown(Reference((1.0, 0.0, 0.0)), config=config, dt_s=1 / rate_hz, steps=rate_hz)
    assert memory.integral_enu[0] == pytest.approx(0.02 * 0.95)


WITH_D = ControlConfig(xy=AxisGains(0.95, 0.08, 0.02, 0.01), z=AxisGains(1.0, 0.3, 0.02, 0.01))


def test_the_first_step_has_no_kick_and_a_change_of_the_error_is_damped_by_the_derivative():
    output, memory = flown(Reference((1.0, -1.0, 0.5)), config=WITH_D)
    assert output.thrust_enu == pytest.approx((0.076, -0.076, 0.6))
    _, memory = flown(Reference((1.0, 0.0, 0.0)), config=WITH_D)
    moving = Estimate((0.0, 0.0, 0.0), (0.1, 0.0, 0.0))
    output, _ = flown(Reference((1.0, 0.0, 0.0)), config=WITH_D, memory=memory, estimate=moving)
    weight = math.tau * 5 * PERIOD_S / (1 + math.tau * 5 * PERIOD_S)
    damping = 0.01 * weight * -0.1 / PERIOD_S
    assert output.thrust_enu[0] == pytest.approx(0.08 * 0.85 + 0.02 * 0.95 * PERIOD_S + damping)


def test_a_wrong_number_costs_its_step_only():
    """Two flights, one with rubbish in between, go on alike to the last bit."""
    reference, rubbish = Reference((1.0, 2.0, 0.5)), Estimate((0.0, math.nan, 0.0), (0.0, 0.0, 0.0))
    clean, disturbed = Memory(), Memory()
    for _ in range(20):
        clean_output, clean = step(WITH_D, clean, HERE, reference, PERIOD_S, following=True)
        refused, disturbed = step(WITH_D, disturbed, rubbish, reference, PERIOD_S, following=True)
        output, disturbed = step(WITH_D, disturbed, HERE, reference, PERIOD_S, following=True)
        assert refused is None
        assert (output, disturbed) == (clean_output, clean)


@each("bad", [math.nan, math.inf, -math.inf, 1.1e6, -1e300])
@each("place", range(17))
def test_one_wrong_number_anywhere_gives_no_output_and_leaves_the_memory(place, bad):
    n = [0.0] * 16 + [PERIOD_S]
    n[place] = bad
    estimate = Estimate((n[0], n[1], n[2]), (n[3], n[4], n[5]))
    reference = Reference((n[6], n[7], n[8]), n[9], (n[10], n[11], n[12]), (n[13], n[14], n[15]))
    memory = Memory((0.1, 0.1, 0.1), (1.0, 1.0, 1.0), (2.0, 2.0, 2.0))
    output, after = step(CONFIG, memory, estimate, reference, n[16], following=True)
    assert output is None
    assert after is memory
    assert velocity_step(CONFIG, memory, estimate, reference, n[16]) == (None, memory)


# --- references ------------------------------------------------------------------------------------------------------


@each(
    ("xy", "z", "expected"),
    [
        (False, False, (0.5 + 0.95, -0.5 + 1.9, 0.2 + 3.0)),
        (True, False, (0.5, -0.5, 0.2 + 3.0)),
        (False, True, (0.5 + 0.95, -0.5 + 1.9, 0.2)),
        (True, True, (0.5, -0.5, 0.2)),
    ],
)
def test_an_axis_asked_for_velocity_only_leaves_its_position_alone(xy, z, expected):
    reference = Reference((1.0, 2.0, 3.0), 0.0, (0.5, -0.5, 0.2), velocity_only_xy=xy, velocity_only_z=z)
    assert velocity_step(CONFIG, Memory(), HERE, reference, PERIOD_S)[0] == pytest.approx(expected)
    output, memory = flown(reference)
    assert output.vel_setpoint_enu_mps == pytest.approx(expected)
    assert memory.vel_error_enu_mps == pytest.approx(expected)


def test_the_asked_velocity_is_clipped_axis_by_axis():
    config = replace(CONFIG, vel_xy_max_mps=2.0, vel_z_max_mps=0.5)
    for far, expected in (((100.0, -100.0, -100.0), (2.0, -2.0, -0.5)), ((1.0, -100.0, 100.0), (0.95, -2.0, 0.5))):
        assert velocity_step(config, Memory(), HERE, Reference(far), PERIOD_S)[0] == pytest.approx(expected)


@each("yaw_deg", [-180, -90, 0, 45, 200, 725])
def test_the_nose_points_along_the_yaw_even_when_tilted(yaw_deg):
    output, _ = flown(Reference((2.0, -1.0, 0.0), math.radians(yaw_deg)))
    w, x, y, z = output.attitude_enu_flu
    nose = math.degrees(math.atan2(2 * (x * y + w * z), 1 - 2 * (y * y + z * z)))
    assert math.remainder(nose - yaw_deg, 360) == pytest.approx(0.0, abs=1e-9)
    w, x, y, z = output.attitude_ned_frd
    compass = math.degrees(math.atan2(2 * (x * y + w * z), 1 - 2 * (y * y + z * z)))
    assert math.remainder(compass - (90 - yaw_deg), 360) == pytest.approx(0.0, abs=1e-9)


# --- saturation ------------------------------------------------------------------------------------------------------


@each(
    ("position_error", "integral", "names"),
    [
        ((0, 0, 0), (0, 0, 0), ()),
        ((1, 1, 0.5), (0, 0, 0), ()),
        ((5, 0, 0), (0, 0, 0), ("tilt",)),
        ((0, 0, 2), (0, 0, 0), ("thrust_max",)),
        ((0, 0, -2), (0, 0, 0), ("thrust_min",)),
        ((1, 0, 2), (0, 0, 0), ("thrust_max", "no_thrust_left")),
        ((0, 11, 0), (0, 0, 0), ("velocity_xy", "tilt")),
        ((0, 0, -11), (0, 0, 0), ("velocity_z", "thrust_min")),
        ((0.1, 0, 0), (0.33, 0, 0), ("tilt", "integral_xy")),
        ((0, 0, 0.1), (0, 0, 0.9), ("thrust_max", "integral_z")),
    ],
)
def test_the_limits_reached_are_named(position_error, integral, names):
    output, _ = flown(Reference(position_error), memory=Memory(integral))
    assert set(output.saturation.names()) == set(names)


# --- any input whatsoever --------------------------------------------------------------------------------------------

ANY = st.floats(allow_nan=True, allow_infinity=True) | st.floats(-100.0, 100.0) | st.floats(-1e6, 1e6)
ANY_VECTOR = st.tuples(ANY, ANY, ANY)
DT = st.floats(allow_nan=True, allow_infinity=True) | st.floats(-0.1, 1.0)
SANE = st.tuples(st.floats(-50.0, 50.0), st.floats(-50.0, 50.0), st.floats(-50.0, 50.0))
STEPS = st.lists(
    st.tuples(
        st.builds(Estimate, SANE | ANY_VECTOR, SANE | ANY_VECTOR),
        st.builds(Reference, SANE | ANY_VECTOR, ANY, SANE | ANY_VECTOR, SANE, st.booleans(), st.booleans()),
        DT,
        st.booleans(),
    ),
    max_size=30,
)
GAINS = st.builds(AxisGains, st.floats(0, 100), st.floats(1e-3, 100), st.floats(0, 100), st.floats(0, 100))
CONFIGS = st.just(CONFIG) | st.builds(
    ControlConfig,
    xy=GAINS,
    z=GAINS,
    hover_thrust=st.floats(0.2, 0.6),
    thrust_min=st.just(0.0) | st.floats(1e-6, 0.19),  # a thrust of 1e-308 has no 9 digits to compare
    thrust_max=st.floats(0.61, 1.0),
    tilt_max_rad=st.floats(0.01, 1.39),
    vel_xy_max_mps=st.floats(0.01, 100),
    vel_z_max_mps=st.floats(0.01, 100),
    acc_xy_max_mps2=st.none() | st.floats(0.1, 100),
    acc_z_max_mps2=st.none() | st.floats(0.1, 100),
    period_s=st.floats(0.001, 1.0),
)
HAIR = 1 + 1e-9


@given(config=CONFIGS, steps=STEPS)
def test_whatever_comes_in_what_goes_out_is_finite_and_within_the_limits(config, steps):
    memory = Memory()
    for estimate, reference, dt_s, following in steps:
        before = memory
        output, memory = step(config, memory, estimate, reference, dt_s, following=following)
        integral_x, integral_y, integral_z = memory.integral_enu
        assert math.hypot(integral_x, integral_y) <= config.integral_xy_max * HAIR
        assert abs(integral_z) <= config.thrust_max
        assert all(math.isfinite(v) for v in (*(memory.vel_error_enu_mps or ()), *memory.slope_enu_mps2))
        if output is None:
            assert memory is before
            continue
        x, y, z = output.thrust_enu
        assert config.thrust_min <= z <= config.thrust_max
        assert math.hypot(x, y) <= z * math.tan(config.tilt_max_rad) * HAIR
        assert math.hypot(x, y, z) <= config.thrust_max * HAIR
        assert 0.0 <= output.collective_thrust <= config.thrust_max
        assert math.hypot(*output.attitude_enu_flu) == pytest.approx(1.0)
        assert math.hypot(*output.attitude_ned_frd) == pytest.approx(1.0)
        assert max(abs(output.roll_frd_rad), abs(output.pitch_frd_rad)) <= config.tilt_max_rad * HAIR
        vx, vy, vz = output.vel_setpoint_enu_mps
        assert max(abs(vx), abs(vy)) <= config.vel_xy_max_mps and abs(vz) <= config.vel_z_max_mps


@given(error=st.tuples(*[st.floats(-5e5, 5e5)] * 3), velocity=SANE, count=st.integers(1, 400))
def test_no_constant_error_however_long_winds_an_integral_past_its_bound(error, velocity, count):
    estimate = Estimate((0.0, 0.0, 0.0), velocity)
    _, memory = flown(Reference(error), estimate=estimate, dt_s=0.03, steps=count)
    assert math.hypot(*memory.integral_enu[:2]) <= CONFIG.integral_xy_max * HAIR
    assert abs(memory.integral_enu[2]) <= CONFIG.thrust_max
