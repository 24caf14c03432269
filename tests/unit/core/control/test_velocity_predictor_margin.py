"""The delay margin of velocity control with prediction, against a simulation that shares no code with the analysis."""

from __future__ import annotations

import math
from itertools import pairwise

import numpy as np
import pytest

from skygcs.core.control.gains import AxisGains, ControlConfig
from skygcs.core.control.velocity_predictor import (
    ARDUCOPTER_LOOP,
    DISTURBANCE_TIME_S,
    OPPOSED,
    PX4_LOOP,
    UNCERTAINTY,
    DelayRange,
    delay_range,
    velocity_delay_range,
    why_not_predicted,
)
from support.examples import thinned
from support.table import each

STEP_S = 0.004
OBSERVER_S = DISTURBANCE_TIME_S


def grows(kp: float, lag_s: float, attitude_lag_s: float, assumed_s: float, true_s: float) -> bool:
    """True if a nudge grows: Euler steps of 4 ms, a second-order vehicle behind a pure delay."""
    horizon_s = assumed_s
    taps = round(horizon_s / STEP_S)
    ages = (np.arange(taps) + 0.5) * STEP_S
    weights = (1.0 - np.exp(-ages / lag_s)) * STEP_S
    ahead_s = lag_s * (1.0 - math.exp(-horizon_s / lag_s))
    pushed = lag_s * (horizon_s - ahead_s)
    steps, late = round(120.0 / STEP_S), round(true_s / STEP_S)
    room = max(taps, late) + 1
    sent = np.zeros(steps + room)
    x, v, change = 0.1, 0.0, 0.0
    disturbance, position = 0.0, np.zeros(steps)
    for n in range(steps):
        at = n + room
        under_way = float(sent[at - taps : at][::-1] @ weights)
        sent[at] = -kp * (x + ahead_s * v + under_way + pushed * disturbance) - OPPOSED * lag_s * disturbance
        change += ((sent[at - late] - v) / lag_s - change) * STEP_S / attitude_lag_s
        shown = change - (sent[at - taps] - v) / lag_s
        disturbance += (shown - disturbance) * STEP_S / OBSERVER_S
        x += v * STEP_S
        v += change * STEP_S
        position[n] = x
        if abs(x) > 1e3:
            return True
    third = steps // 3
    return float(np.abs(position[-third:]).max()) > float(np.abs(position[third:-third]).max())


@each(
    ("kp", "lag_s", "assumed_s"),
    thinned([(kp, lag_s, s) for s in (0.2, 0.8, 1.2) for kp, lag_s in ((0.95, 0.667), (1.0, 0.25))], 2),
)
def test_the_range_is_where_a_nudge_dies_out(kp: float, lag_s: float, assumed_s: float) -> None:
    found = delay_range(kp, lag_s, 0.15, assumed_s)
    assert found is not None
    assert not grows(kp, lag_s, 0.15, assumed_s, assumed_s)
    assert not grows(kp, lag_s, 0.15, assumed_s, 0.96 * found.most_s)
    assert grows(kp, lag_s, 0.15, assumed_s, 1.04 * found.most_s)
    if found.least_s > 0:
        assert not grows(kp, lag_s, 0.15, assumed_s, 1.06 * found.least_s)
        assert grows(kp, lag_s, 0.15, assumed_s, 0.94 * found.least_s)


def test_the_figures_of_the_documentation() -> None:
    law = ControlConfig()
    px4 = [velocity_delay_range(law, PX4_LOOP, s) for s in (0.05, 0.8, 1.2, 1.5)]
    assert [round(r.most_s, 2) for r in px4 if r] == [0.83, 1.38, 1.45, 1.69]
    assert [round(r.least_s, 2) for r in px4 if r] == [0.0, 0.0, 0.79, 1.14]
    copter = velocity_delay_range(law, ARDUCOPTER_LOOP, 0.8)
    assert copter is not None and round(copter.most_s, 2) == 1.42


def test_the_margin_shrinks_beyond_a_second() -> None:
    ranges = [velocity_delay_range(ControlConfig(), PX4_LOOP, s / 10) for s in range(10, 30, 2)]
    margins = [r.margin_s for r in ranges if r is not None]
    assert all(later < earlier for earlier, later in pairwise(margins))


def test_a_gain_that_cannot_be_stable_has_no_range() -> None:
    assert delay_range(40.0, 0.556, 0.5, 0.8) is None
    wild = ControlConfig(xy=AxisGains(40.0, 0.08, 0.02))
    assert velocity_delay_range(wild, PX4_LOOP, 0.8) is None
    assert "unstable with prediction" in str(why_not_predicted(wild, PX4_LOOP, 0.8, 0.0))


def test_a_gain_of_zero_limits_nothing() -> None:
    still = ControlConfig(xy=AxisGains(0.0, 0.08, 0.02))
    found = velocity_delay_range(still, PX4_LOOP, 0.8)
    assert found is not None and found.most_s > 1.2


@each("bad", [(0.0, 0.5, 0.1, 0.5), (1.0, 0.0, 0.1, 0.5), (1.0, 0.5, -0.1, 0.5), (1.0, 0.5, 0.1, math.inf)])
def test_numbers_that_are_none_are_refused(bad: tuple[float, float, float, float]) -> None:
    with pytest.raises(ValueError, match="must be above 0"):
        delay_range(*bad)


def test_prediction_is_refused_where_the_margin_does_not_hold() -> None:
    law = ControlConfig()
    assert why_not_predicted(law, PX4_LOOP, 0.8, 0.1) is None
    assert "uncertain by 1.200 s" in str(why_not_predicted(law, PX4_LOOP, 0.8, 1.2))
    assert "may be wrong by 0.195" in str(why_not_predicted(law, PX4_LOOP, 1.5, 0.0)), "30 % of 1.5 s"
    assert UNCERTAINTY == 0.3


def test_no_delay_is_less_than_none() -> None:
    assert DelayRange(0.4, 0.0, 1.6).margin_s == pytest.approx(1.2)
    assert DelayRange(1.2, 0.7, 1.8).margin_s == pytest.approx(0.5)
    assert DelayRange(1.5, 1.09, 1.95).holds is False
