"""Linear analysis of the position loop: the report's numbers, and every margin against an independent computation."""

from __future__ import annotations

import cmath
import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from skygcs.core.control.analysis import (
    Loop,
    Margins,
    factorings,
    margins,
    poles,
    routh,
    slowed,
    step_response,
    suggest,
)
from skygcs.core.control.gains import GRAVITY_MPS2, UTIAS_HOVER_THRUST, UTIAS_XY, UTIAS_Z, AxisGains
from support.examples import thinned
from support.table import each

THRUST = GRAVITY_MPS2 / UTIAS_HOVER_THRUST
LOOPS = {
    "xy tilt": Loop(UTIAS_XY, GRAVITY_MPS2),
    "z tilt": Loop(UTIAS_Z, 1.0),
    "xy thrust": Loop(UTIAS_XY, THRUST),
    "z thrust": Loop(UTIAS_Z, THRUST),
    "xy without integrator": Loop(AxisGains(0.95, 0.08, 0.0), THRUST),
    "y with both signs turned": Loop(AxisGains(0.95, -0.08, -0.02), -GRAVITY_MPS2),
}
UTIAS_Y = Loop(UTIAS_XY, -GRAVITY_MPS2)

every_loop = each("loop", LOOPS.values())
sizes = st.floats(0.01, 10.0)
stable_loops = st.builds(Loop, st.builds(AxisGains, sizes, sizes, sizes), st.floats(0.1, 50.0)).filter(
    lambda loop: routh(loop).stable
)
any_loops = st.builds(Loop, st.builds(AxisGains, *[st.floats(-5, 5).filter(lambda x: abs(x) > 1e-3)] * 3), sizes)


def margins_of(loop: Loop, delay_s: float = 0.0) -> Margins:
    found = margins(loop, delay_s)
    assert found is not None
    return found


def numbers(loop: Loop) -> tuple[float, float, float]:
    return loop.gains.pos_p_per_s, loop.gains.vel_p, loop.gains.vel_i


def characteristic(loop: Loop, s: complex, delay_s: float, gain: float = 1.0) -> complex:
    """1 + L(s), written from the block diagram and not from the polynomial."""
    kp, kv, ki = numbers(loop)
    return 1 + gain * cmath.exp(-s * delay_s) * loop.plant_gain * (kv + ki / s) * (kp + s) / s**2


def root_near(loop: Loop, s: complex, delay_s: float, gain: float = 1.0) -> complex:
    """A root of the characteristic equation by the secant method: of the transcendental one, delay and all."""
    before, f_before = s * 1.001, characteristic(loop, s * 1.001, delay_s, gain)
    for _ in range(50):
        f = characteristic(loop, s, delay_s, gain)
        if abs(f) < 1e-13 or s == before:
            break
        s, before, f_before = s - f * (s - before) / (f - f_before), s, f
    assert abs(characteristic(loop, s, delay_s, gain)) < 1e-9
    return s


def swings(loop: Loop, delay_s: float) -> tuple[float, float]:
    """Largest error from the tenth to the twentieth and from the thirtieth to the fortieth crossover period.

    A Heun simulation in small steps of its own, with the delay in the measurements.
    """
    (kp, kv, ki), g = numbers(loop), loop.plant_gain
    period = 2 * math.pi / margins_of(loop).crossover_radps
    dt = delay_s / round(delay_s / (period / 1000))
    lag = round(delay_s / dt)
    x, v, integral = [0.0] * (lag + 1), [0.0] * (lag + 1), 0.0
    for _ in range(40_000):
        e0, e1 = (kp * (1 - x[n]) - v[n] for n in (-lag - 1, -lag))
        a0, a1 = g * (kv * e0 + integral), g * (kv * e1 + integral + ki * dt * (e0 + e1) / 2)
        integral += ki * dt * (e0 + e1) / 2
        x.append(x[-1] + dt * v[-1] + dt * dt * (a0 + a1) / 4)
        v.append(v[-1] + dt * (a0 + a1) / 2)
    errors = [abs(position - 1) for position in x]
    return max(errors[10_000:20_000]), max(errors[30_000:])


@each(
    ("name", "wanted"),
    [
        ("xy tilt", [-0.229, -0.278 - 0.859j, -0.278 + 0.859j]),
        ("xy thrust", [-0.239, -0.753 - 1.08j, -0.753 + 1.08j]),
        ("z tilt", [-0.066, -0.117 - 0.539j, -0.117 + 0.539j]),
        ("z thrust", [-0.067, -1.254, -5.219]),
    ],
)
def test_poles_are_those_known_for_the_default_gains(name: str, wanted: list[complex]) -> None:
    assert poles(LOOPS[name]) == pytest.approx(wanted, abs=6e-4)


@each(
    ("gains", "crossover", "phase_deg", "delay"),
    [
        (UTIAS_XY, 1.955, 56.8, 0.507),
        (UTIAS_Z, 6.615, 80.8, 0.213),
        (AxisGains(0.95, 0.09, 0.02), 2.155, 60.3, 0.488),
        (AxisGains(1.0, 0.2, 0.02), 4.469, 76.1, 0.297),
    ],
)
def test_margins_are_those_known_for_normalised_thrust(gains, crossover, phase_deg, delay) -> None:
    found = margins_of(Loop(gains, THRUST))
    assert found.crossover_radps == pytest.approx(crossover, abs=6e-4)
    assert math.degrees(found.phase_margin_rad) == pytest.approx(phase_deg, abs=0.06)
    assert found.delay_margin_s == pytest.approx(delay, abs=6e-4)


@each(("name", "kiv", "kpv"), [("xy tilt", 0.815, 0.556), ("z tilt", 0.305, 0.234)])
def test_rows_x_and_z_of_eq_16_come_out_and_are_the_only_factoring(name: str, kiv: float, kpv: float) -> None:
    (row,) = factorings(LOOPS[name])
    assert (row.kiv, row.kpv) == pytest.approx((kiv, kpv), abs=6e-4)
    assert row.kpx > 0


def test_row_y_of_eq_16_comes_from_an_unstable_pole() -> None:
    row = factorings(UTIAS_Y)[0]
    assert (row.kiv, row.kpv) == pytest.approx((0.125, 0.712), abs=6e-4)
    assert row.kpx == pytest.approx(-1.497, abs=1e-4)
    assert poles(UTIAS_Y)[0] == pytest.approx(1.497, abs=1e-4)
    assert not routh(UTIAS_Y).stable
    assert margins(UTIAS_Y) is None
    assert suggest(UTIAS_Y, 0.1) is None


@given(any_loops)
def test_every_factoring_multiplies_out_to_the_polynomial(loop: Loop) -> None:
    assert factorings(loop)
    for row in factorings(loop):
        product = (1.0, row.kpx + row.kpv, row.kpx * row.kpv + row.kiv, row.kpx * row.kiv)
        assert product == pytest.approx(loop.polynomial, rel=1e-6, abs=1e-6)


@given(any_loops)
def test_poles_are_roots_of_the_block_diagram(loop: Loop) -> None:
    assert len(poles(loop)) == 3
    for pole in poles(loop):
        terms = abs(pole) ** 3 + sum(abs(c) * abs(pole) ** n for n, c in enumerate(reversed(loop.polynomial)))
        assert abs(characteristic(loop, pole, 0.0) * pole**3) < 1e-9 * (1 + terms)


@given(any_loops)
def test_routh_says_what_the_poles_say(loop: Loop) -> None:
    slowest = poles(loop)[0].real
    if abs(slowest) > 1e-6:
        assert routh(loop).stable == (slowest < 0)
    changes = sum(a * b < 0 for a, b in zip(routh(loop).first_column, routh(loop).first_column[1:], strict=False))
    if all(abs(pole.real) > 1e-6 for pole in poles(loop)):
        assert changes == sum(pole.real > 0 for pole in poles(loop))


def test_routh_stops_where_it_cannot_divide() -> None:
    assert routh(Loop(AxisGains(1.0, 0.0, 0.1), 1.0)).first_column == (1.0, 0.0)
    assert not routh(Loop(AxisGains(1.0, 0.0, 0.1), 1.0)).stable


def test_a_position_that_nobody_controls_is_not_called_stable() -> None:
    """Kp = 0: the velocity is held, the position is left where it is."""
    loop = Loop(AxisGains(0.0, 0.08, 0.02), THRUST)
    assert poles(loop)[0] == 0
    assert not routh(loop).stable
    assert margins(loop) is None


@every_loop
def test_at_the_delay_margin_a_pole_crosses_the_imaginary_axis_at_the_crossover(loop: Loop) -> None:
    found = margins_of(loop)
    crossing = 1j * found.crossover_radps
    assert abs(characteristic(loop, crossing, found.delay_margin_s)) < 1e-12
    assert root_near(loop, crossing, 0.98 * found.delay_margin_s).real < -1e-4
    assert root_near(loop, crossing, 1.02 * found.delay_margin_s).real > 1e-4


@each("name", thinned(["xy tilt", "z tilt", "xy thrust", "z thrust"], 2))
def test_simulated_2_percent_below_the_delay_margin_it_calms_down_and_2_percent_above_it_does_not(name: str) -> None:
    loop = LOOPS[name]
    delay_s = margins_of(loop).delay_margin_s
    early, late = swings(loop, 0.98 * delay_s)
    assert late < 0.8 * early
    early, late = swings(loop, 1.02 * delay_s)
    assert late > 1.2 * early


@every_loop
@each("share", [0.0, 0.3, 0.9])
def test_gain_margins_put_poles_on_the_imaginary_axis(loop: Loop, share: float) -> None:
    delay_s = share * margins_of(loop).delay_margin_s
    found = margins_of(loop, delay_s)
    limits = [(found.gain_up, 1), (1 / found.gain_down, -1)]
    for gain, sense in [(gain, sense) for gain, sense in limits if 0 < gain < math.inf]:
        scaled = Loop(loop.gains, loop.plant_gain * gain)
        # the crossover of the loop so scaled is where its phase margin is used up
        crossing = 1j * _crossover(scaled)
        assert abs(characteristic(loop, crossing, delay_s, gain)) < 1e-9
        assert sense * root_near(loop, crossing, delay_s, gain * 1.02).real > 0
        assert sense * root_near(loop, crossing, delay_s, gain / 1.02).real < 0
    assert (found.gain_up == math.inf) == (delay_s == 0)
    assert (found.gain_down == math.inf) == (loop.gains.vel_i == 0)


def _crossover(loop: Loop) -> float:
    """By brute force."""
    low, high = 1e-6, 1e6
    while high / low > 1 + 1e-14:
        middle = math.sqrt(low * high)
        size = abs(characteristic(loop, 1j * middle, 0.0) - 1)
        low, high = (middle, high) if size > 1 else (low, middle)
    return low


@every_loop
def test_without_delay_the_lower_gain_margin_is_rouths(loop: Loop) -> None:
    if loop.gains.vel_i != 0:
        _, a, b, c = loop.polynomial
        assert margins_of(loop).gain_down == pytest.approx(a * b / c, rel=1e-9)


@every_loop
def test_a_delay_uses_up_phase_and_delay_margin_and_at_the_end_there_is_none(loop: Loop) -> None:
    free = margins_of(loop)
    half = margins_of(loop, free.delay_margin_s / 2)
    assert half.crossover_radps == free.crossover_radps
    assert half.delay_margin_s == pytest.approx(free.delay_margin_s / 2)
    assert half.phase_margin_rad == pytest.approx(free.phase_margin_rad / 2)
    assert 1 < half.gain_up < math.inf
    assert half.gain_down < free.gain_down or loop.gains.vel_i == 0
    assert margins(loop, free.delay_margin_s * 1.001) is None


@given(stable_loops, st.floats(0.2, 20.0))
def test_slowing_by_lambda_multiplies_the_delay_margin_and_leaves_the_others(loop: Loop, factor: float) -> None:
    before, after = margins_of(loop), margins_of(Loop(slowed(loop.gains, factor), loop.plant_gain))
    assert after.delay_margin_s == pytest.approx(before.delay_margin_s * factor, rel=1e-6)
    assert after.phase_margin_rad == pytest.approx(before.phase_margin_rad, rel=1e-6)
    assert after.gain_down == pytest.approx(before.gain_down, rel=1e-6)
    assert after.crossover_radps == pytest.approx(before.crossover_radps / factor, rel=1e-9)


def test_slowing_by_lambda_is_the_same_motion_in_slow_motion() -> None:
    loop = LOOPS["xy thrust"]
    fast = step_response(loop, delay_s=0.2, duration_s=5, period_s=0.01)
    slow = step_response(Loop(slowed(loop.gains, 3), loop.plant_gain), delay_s=0.6, duration_s=15, period_s=0.03)
    assert slow.positions == pytest.approx(fast.positions, abs=1e-9)


def test_half_a_second_of_radio_delay_asks_z_to_be_4_7_times_slower() -> None:
    loop = LOOPS["z thrust"]
    found = suggest(loop, 0.5)
    assert found is not None
    assert found.factor == pytest.approx(4.69, abs=0.005)
    assert found.gains == slowed(loop.gains, found.factor)
    assert margins_of(Loop(found.gains, loop.plant_gain)).delay_margin_s == pytest.approx(1.0)


def test_gains_that_bear_the_delay_are_left_alone() -> None:
    found = suggest(LOOPS["xy thrust"], 0.25)
    assert found is not None and (found.factor, found.gains) == (1.0, UTIAS_XY)
    with_more = suggest(LOOPS["xy thrust"], 0.25, reserve=3)
    assert with_more is not None and with_more.factor == pytest.approx(0.75 / 0.50707, rel=1e-4)


@each(
    ("delay_s", "with_integrator", "without"),
    [(0.0, 0.08, 0.055), (0.2, 0.12, 0.067), (0.3, 0.20, 0.105), (0.4, 0.38, 0.23)],
)
def test_overshoot_at_50_hz_is_the_known_one(delay_s: float, with_integrator: float, without: float) -> None:
    for name, wanted in (("xy thrust", with_integrator), ("xy without integrator", without)):
        response = step_response(LOOPS[name], delay_s=delay_s, period_s=0.02)
        assert response.overshoot == pytest.approx(wanted, abs=0.006)


def test_half_a_second_is_too_much_for_the_sampled_loop_and_just_borne_by_the_continuous_one() -> None:
    def swing(period_s: float, late: slice) -> float:
        positions = step_response(LOOPS["xy thrust"], delay_s=0.5, duration_s=60, period_s=period_s).positions
        return max(abs(x - 1) for x in positions[late])

    assert swing(0.02, slice(2500, None)) > 1.1 * swing(0.02, slice(500, 1000))
    assert swing(0.002, slice(25000, None)) < 0.9 * swing(0.002, slice(5000, 10000))


@each(("delay_s", "overshoot"), [(0.0, 0.0), (0.15, 0.0), (0.2, 0.14)])
def test_z_at_50_hz_overshoots_only_close_to_its_delay_margin(delay_s: float, overshoot: float) -> None:
    response = step_response(LOOPS["z thrust"], delay_s=delay_s, duration_s=30, period_s=0.02)
    assert response.overshoot == pytest.approx(overshoot, abs=0.005)
    assert response.settling_s is not None


@each(("rate_hz", "delay_s", "calm"), [(50, 0.25, False), (5, 0.1, True), (5, 0.15, False)])
def test_a_slow_rate_costs_z_as_much_as_a_delay(rate_hz: float, delay_s: float, calm: bool) -> None:
    response = step_response(LOOPS["z thrust"], delay_s=delay_s, duration_s=60, period_s=1 / rate_hz)
    assert (response.settling_s is not None) == calm
    assert (max(map(abs, response.positions)) < 1.05) == calm


def test_a_diverging_simulation_ends_early_and_finite() -> None:
    response = step_response(UTIAS_Y, duration_s=500)
    assert len(response.positions) < 20_000
    assert all(map(math.isfinite, response.positions))
    assert response.settling_s is None


def test_a_free_step_is_the_sum_of_its_poles() -> None:
    """Partial fractions of G Kp (Kv s + Ki) / (s p(s)) against the simulation."""
    for name in ("xy tilt", "z tilt", "xy thrust", "z thrust"):
        loop = LOOPS[name]
        response = step_response(loop, duration_s=10)
        for time_s in (0.3, 1.0, 2.5, 7.0):
            exact = 1 + sum(_mode(loop, pole, time_s) for pole in poles(loop)).real
            assert response.positions[round(time_s / response.period_s)] == pytest.approx(exact, abs=2e-3)


def _mode(loop: Loop, pole: complex, time_s: float) -> complex:
    slope = sum(n * c * pole ** (n - 1) for n, c in enumerate(reversed(loop.polynomial)) if n)
    kp, kv, ki = numbers(loop)
    numerator = loop.plant_gain * kp * (kv * pole + ki)
    return numerator / (pole * slope) * cmath.exp(pole * time_s)


@each("delay_s", [0.1, 0.1337])
def test_a_delay_that_is_no_multiple_of_the_period_is_kept_to(delay_s: float) -> None:
    coarse = step_response(LOOPS["xy thrust"], delay_s=delay_s, duration_s=2, period_s=0.02).positions
    fine = _held(LOOPS["xy thrust"], delay_s, 0.02, 2)
    assert coarse == pytest.approx(fine, abs=2e-3)


def _held(loop: Loop, delay_s: float, period_s: float, duration_s: float) -> list[float]:
    """The same sampled law by Euler in steps of 0.1 ms."""
    dt = 1e-4
    kp, kv, ki = numbers(loop)
    per_period, lag = round(period_s / dt), round(delay_s / dt)
    x = v = integral = 0.0
    sent: list[float] = []
    at_ticks = []
    for n in range(round(duration_s / dt) + 1):
        if n % per_period == 0:
            at_ticks.append(x)
            error = kp * (1 - x) - v
            output = kv * error + integral
            integral += ki * error * period_s
        sent.append(output)
        v += dt * loop.plant_gain * (sent[n - lag] if n >= lag else 0.0)
        x += dt * v
    return at_ticks


def test_rise_and_settling_are_counted_from_the_response() -> None:
    response = step_response(LOOPS["xy thrust"], duration_s=20)
    times = [n * response.period_s for n in range(len(response.positions))]
    inside = [t for t, x in zip(times, response.positions, strict=True) if abs(x - 1) <= 0.05]
    outside = [t for t, x in zip(times, response.positions, strict=True) if abs(x - 1) > 0.05]
    assert response.settling_s == pytest.approx(max(outside), abs=0.002)
    assert response.settling_s is not None and response.settling_s > min(inside)  # it has overshot the band once
    assert response.rise_s == pytest.approx(1.43, abs=0.01)


def test_a_response_cut_short_has_neither_risen_nor_settled() -> None:
    response = step_response(LOOPS["z tilt"], duration_s=1.0)
    assert (response.rise_s, response.settling_s, response.overshoot) == (None, None, 0.0)


def test_a_response_that_swings_through_the_band_at_the_end_has_not_settled() -> None:
    response = step_response(LOOPS["z tilt"], delay_s=0.3, duration_s=30)
    assert abs(response.positions[-1] - 1) < 0.05
    assert response.settling_s is None
    assert step_response(LOOPS["z tilt"], delay_s=0.3, duration_s=80).settling_s == pytest.approx(39.3, abs=0.1)


@each("bad", [math.nan, math.inf, -math.inf, 1e7, 1e-13])
@each("place", range(4))
def test_numbers_nobody_means_are_refused(bad: float, place: int) -> None:
    values = [1.0, 1.0, 1.0, 1.0]
    values[place] = bad
    with pytest.raises(ValueError, match="gain"):
        Loop(AxisGains(*values[:3]), values[3])


def test_a_derivative_gain_a_plant_without_gain_and_a_reserve_below_one_are_refused() -> None:
    with pytest.raises(ValueError, match="derivative"):  # its filter is not modelled
        Loop(AxisGains(0.95, 0.08, 0.02, 0.01), THRUST)
    with pytest.raises(ValueError, match="not 0"):
        Loop(UTIAS_XY, 0.0)
    with pytest.raises(ValueError, match="reserve"):
        suggest(LOOPS["xy thrust"], 0.1, reserve=0.99)


@given(st.builds(Loop, st.builds(AxisGains, *[st.floats(1e-12, 1e6)] * 3), st.floats(1e-12, 1e6)))
def test_margins_exist_exactly_for_stable_loops_of_any_allowed_size(loop: Loop) -> None:
    found = margins(loop)
    if not routh(loop).stable:
        assert found is None
    elif found is not None:  # None: stable by less than the arithmetic resolves
        assert found.crossover_radps > 0 and found.delay_margin_s > 0 and found.gain_down >= 1
