"""The figures of `make bench-control`: how they are read off, and that a step flown there is the step of the notes."""

from __future__ import annotations

from dataclasses import replace

import pytest

from bench.control.measures import overshoot_percent, settling_s, swing_m, within_s
from bench.control.steps import EAST, UP, Flight, axis, bearable_delay_s, fly, swings_on, wind_arithmetic
from bench.control.wire import BEAR_ALL, WiredPilot
from bench.results import percentile
from skygcs.config.dialects import load_dialect
from skygcs.core.control.analysis import Loop, margins
from skygcs.core.control.gains import UTIAS_XY, UTIAS_Z
from skygcs.core.control.guard import ControlMode, GuardConfig
from skygcs.sim.conditions import Conditions
from skygcs.sim.quad import F450, IDEAL
from support.table import each

# -- what is read off


def test_overshoot_is_in_percent_of_the_step_whichever_way_it_goes() -> None:
    assert overshoot_percent([0.0, 2.0, 3.3, 2.9, 3.0], 3.0) == pytest.approx(10.0)
    assert overshoot_percent([0.0, -2.0, -3.3, -3.0], -3.0) == pytest.approx(10.0)
    assert overshoot_percent([0.0, 1.0, 2.9], 3.0) == 0.0


def test_it_has_settled_from_the_last_time_on_that_it_was_outside() -> None:
    track = [0.0, 0.5, 1.04, 1.06, 1.01, *[1.0] * 20]
    assert settling_s(track, 1.0, 0.1) == pytest.approx(0.4)
    assert within_s(track, 1.0, 0.6, 0.1) == pytest.approx(0.1)
    assert within_s([1.0, 1.0], 1.0, 0.1, 0.1) == 0.0


def test_what_is_outside_at_the_end_has_not_settled() -> None:
    assert settling_s([0.0, *[1.0] * 20, 1.2, 1.0], 1.0, 0.1) is None


def test_the_swing_is_that_of_the_last_seconds_only() -> None:
    assert swing_m([-5.0, 9.0, 1.0, 1.2, 1.1], 0.3, 0.1) == pytest.approx(0.2)


@each(("share", "value"), [(0.5, 50), (0.99, 99), (1.0, 100), (0.001, 1)])
def test_a_percentile_is_one_of_the_values(share: float, value: int) -> None:
    assert percentile(list(range(100, 0, -1)), share) == value


def test_there_is_no_percentile_of_nothing() -> None:
    with pytest.raises(ValueError, match="no values"):
        percentile([], 0.5)


def test_a_growing_swing_and_one_that_stays_swing_on_a_dying_one_does_not() -> None:
    wave = [(-1.0) ** n for n in range(400)]
    grown = [0.01 * x * n / 400 for n, x in enumerate(wave)]
    dying = [x * 0.98**n for n, x in enumerate(wave)]
    assert swings_on([0.1 * x for x in wave], 0.2)
    assert swings_on(grown, 0.2)
    assert not swings_on(dying, 0.2)
    assert not swings_on([0.001 * x for x in wave], 0.2), "a millimetre is rest"


# -- the arithmetic beside the flights


def test_without_lags_and_drag_the_margin_is_that_of_the_analysis() -> None:
    for gains in (UTIAS_XY, UTIAS_Z):
        known = margins(Loop(gains, 21.8))
        assert known is not None
        assert bearable_delay_s(gains, (), 0.0, 0.0) == pytest.approx(known.delay_margin_s, abs=1e-6)
    assert bearable_delay_s(UTIAS_Z, (), 0.0, 0.02) == pytest.approx(0.213 - 0.01, abs=5e-4)
    assert bearable_delay_s(UTIAS_XY, (0.15,), 0.0, 0.02) < bearable_delay_s(UTIAS_XY, (), 0.0, 0.02) - 0.1


def test_wind_blows_it_as_far_as_the_arithmetic_says_and_for_as_long() -> None:
    said = wind_arithmetic(F450, 5.0)
    assert said.push_mps2 == pytest.approx(1.25)
    blown = Flight(F450, (0.0, 0.0, 0.0), wind_enu_mps=(5.0, 0.0, 0.0), seconds=20.0)
    track = axis(fly(blown), EAST)
    assert within_s(track, 0.0, 0.1, 0.02) == pytest.approx(said.below_s(0.1), abs=0.3)
    assert axis(fly(replace(blown, following=False)), EAST)[-1] == pytest.approx(said.offset_m, abs=1e-3)


# -- the flights


@each(("delay_s", "following", "percent"), [(0.0, True, 8.1), (0.3, True, 20.1), (0.0, False, 5.6), (0.3, False, 10.6)])
def test_a_step_overshoots_as_in_the_notes(delay_s: float, following: bool, percent: float) -> None:
    track = axis(fly(Flight(IDEAL, delay_s=delay_s, following=following, seconds=12.0)), EAST)
    assert overshoot_percent(track, 3.0) == pytest.approx(percent, abs=0.1)


def test_a_fuller_battery_begins_in_balance() -> None:
    track = axis(fly(Flight(F450, (0.0, 0.0, 0.0), supply_v=16.4, seconds=5.0)), UP)
    assert max(abs(up) for up in track) < 1e-3


def test_over_the_wire_it_is_the_same_step() -> None:
    dialect = load_dialect(["ardupilotmega", "px4-extras"])
    flown = WiredPilot(dialect, Conditions(airframe=IDEAL), 0.1, BEAR_ALL).fly_step(ControlMode.ATTITUDE, 3.0, 8.0)
    alone = axis(fly(Flight(IDEAL, delay_s=0.1, seconds=8.0)), EAST)
    assert flown.control_mode is ControlMode.ATTITUDE
    # there the new reference is in the loop's middle, half of the delay before it works: 0.05 s, two ticks and a half
    assert max(abs(a - b) for a, b in zip(flown.track_m, alone[2:], strict=False)) < 0.08
    assert overshoot_percent(flown.track_m, 3.0) == pytest.approx(overshoot_percent(alone, 3.0), abs=0.5)


def test_at_three_tenths_the_guard_takes_attitude_away_and_velocity_settles() -> None:
    dialect = load_dialect(["ardupilotmega", "px4-extras"])
    flown = WiredPilot(dialect, Conditions(), 0.3, GuardConfig()).fly_step(ControlMode.ATTITUDE, 3.0, 10.0)
    assert flown.control_mode is ControlMode.VELOCITY
    assert any("limit for attitude" in text for text in flown.events)
    assert settling_s(flown.track_m, 3.0, 0.02) is not None
