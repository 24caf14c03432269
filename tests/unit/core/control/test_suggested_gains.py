"""Suggested gains in a simulation that shares nothing with the analysis: stable, and with little overshoot."""

from __future__ import annotations

import itertools

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from bench.control.sampled_loop import SampledLoop, fly_step
from skygcs.core.control.analysis import Loop, delay_margin_s, step_response, suggest
from skygcs.core.control.gains import GRAVITY_MPS2, UTIAS_XY, UTIAS_Z, AxisGains
from support.examples import examples, thinned
from support.table import each

HOVER_THRUST = 0.45
PLANT_GAIN = GRAVITY_MPS2 / HOVER_THRUST
LAG_S = 0.15
AXES = each("gains", [UTIAS_XY, UTIAS_Z])


def suggested(gains: AxisGains, delay_s: float, rate_hz: float, telemetry_hz: float) -> AxisGains:
    held_s = 0.5 / rate_hz + 0.5 / telemetry_hz
    found = suggest(Loop(gains, PLANT_GAIN), delay_s, held_s=held_s, lag_s=LAG_S)
    assert found is not None
    return found.gains


def flown(gains: AxisGains, delay_s: float, rate_hz: float, telemetry_hz: float, phase: float) -> SampledLoop:
    return fly_step(
        (gains.pos_p_per_s, gains.vel_p, gains.vel_i),
        plant_gain=PLANT_GAIN,
        lag_s=LAG_S,
        delays_s=(0.5 * delay_s, 0.5 * delay_s),
        rate_hz=rate_hz,
        telemetry_hz=telemetry_hz,
        phase=phase,
    )


@AXES
@each(("delay_s", "rate_hz"), thinned(itertools.product((0.1, 0.2, 0.3, 0.4, 0.5), (5.0, 10.0, 20.0, 50.0)), 9))
def test_suggested_gains_are_stable_and_overshoot_by_less_than_30_percent(gains, delay_s, rate_hz) -> None:
    slow = suggested(gains, delay_s, rate_hz, rate_hz)
    worst = max((flown(slow, delay_s, rate_hz, rate_hz, phase) for phase in (0.02, 0.98)), key=lambda f: f.overshoot)
    assert worst.settled and worst.overshoot <= 0.3


@given(
    gains=st.sampled_from([UTIAS_XY, UTIAS_Z]),
    delay_s=st.floats(0.1, 0.5),
    rate_hz=st.floats(5.0, 50.0),
    telemetry_hz=st.floats(5.0, 50.0),
    phase=st.floats(0.0, 0.99),
)
@settings(max_examples=examples(15))
def test_the_same_anywhere_in_between(gains, delay_s, rate_hz, telemetry_hz, phase) -> None:
    found = flown(suggested(gains, delay_s, rate_hz, telemetry_hz), delay_s, rate_hz, telemetry_hz, phase)
    assert found.settled and found.overshoot <= 0.3


@each("rate_hz", [5.0, 10.0])
def test_without_rate_and_lag_what_was_suggested_swings(rate_hz: float) -> None:
    found = suggest(Loop(UTIAS_Z, PLANT_GAIN), 0.1)
    assert found is not None and found.factor == 1.0
    assert not flown(found.gains, 0.1, rate_hz, rate_hz, 0.5).settled


@AXES
def test_the_delay_margin_with_lag_is_where_the_simulation_begins_to_swing(gains: AxisGains) -> None:
    """At 500 Hz, whose holding is 2 ms."""
    margin_s = delay_margin_s(Loop(gains, PLANT_GAIN), LAG_S)
    assert margin_s == pytest.approx({UTIAS_XY: 0.3685, UTIAS_Z: 0.1344}[gains], abs=1e-4)  # field-notes-2 §5
    assert flown(gains, 0.9 * margin_s, 500.0, 500.0, 0.5).grows < 1.0
    assert flown(gains, 1.1 * margin_s, 500.0, 500.0, 0.5).grows > 1.0


@AXES
@each("lag_s", [0.0, 0.15])
def test_the_step_response_with_lag_is_that_of_the_simulation(gains: AxisGains, lag_s: float) -> None:
    delay_s, rate_hz = 0.04, 50.0
    response = step_response(
        Loop(gains, PLANT_GAIN), delay_s=delay_s, duration_s=10.0, period_s=1 / rate_hz, lag_s=lag_s
    )
    found = fly_step(
        (gains.pos_p_per_s, gains.vel_p, gains.vel_i),
        plant_gain=PLANT_GAIN,
        lag_s=lag_s,
        delays_s=(0.0, delay_s),
        rate_hz=rate_hz,
        telemetry_hz=1000.0,
        phase=0.0,
        seconds=10.0,
    )
    assert max(response.positions) - 1 == pytest.approx(found.overshoot, abs=0.01)
