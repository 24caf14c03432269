"""The offset of another clock, with its bound: always right within it, whatever the way there and back took."""

from __future__ import annotations

import math
import random

import pytest
from hypothesis import given
from hypothesis import strategies as st

from skygcs.core.clock_offset import DRIFT, MAX_SAMPLES, WINDOW_S, ClockComparison
from support.table import each


@given(true_s=st.floats(-1e6, 1e6), ways=st.lists(st.tuples(st.floats(0, 3), st.floats(0, 3)), min_size=1, max_size=20))
def test_the_bound_holds_however_the_round_trip_divides(true_s: float, ways: list[tuple[float, float]]) -> None:
    clocks = ClockComparison()
    now = 100.0
    for there_s, back_s in ways:
        received = now + there_s + back_s
        remote = now + there_s + true_s
        assert clocks.add(now, received, remote, wall_received=received + 5e8, remote_wall=remote + 5e8)
        now = received
    best = clocks.best(now)
    assert best is not None
    assert abs(best.offset_s - true_s) <= best.error_s + 1e-6
    assert abs(best.wall_offset_s - true_s) <= best.error_s + 1e-6


def test_the_quickest_answer_of_the_last_minute_counts_until_drift_outweighs_it() -> None:
    clocks = ClockComparison()
    clocks.add(0.0, 0.004, 10.0, wall_received=0.0, remote_wall=0.0)
    clocks.add(2.0, 2.4, 12.0, wall_received=0.0, remote_wall=0.0)
    best = clocks.best(2.4)
    assert best is not None
    assert (best.round_trip_s, best.offset_s) == (0.004, pytest.approx(9.998))
    assert best.error_s == pytest.approx(0.002 + 2.396 * DRIFT)
    clocks.add(50.0, 50.02, 60.0, wall_received=0.0, remote_wall=0.0)
    later = clocks.best(50.02)
    assert later is not None
    assert later.round_trip_s == pytest.approx(0.02)


def test_a_clock_that_drifts_by_a_hundred_ppm_stays_within_the_bound() -> None:
    rng = random.Random(1)
    clocks = ClockComparison()
    for step in range(300):
        now = 2.0 * step
        there_s, back_s = rng.uniform(0.001, 0.4), rng.uniform(0.001, 0.4)
        remote = (now + there_s) * 1.0001
        received = now + there_s + back_s
        clocks.add(now, received, remote, wall_received=received, remote_wall=remote)
        best = clocks.best(received)
        assert best is not None
        assert abs(best.offset_s - received * 0.0001) <= best.error_s


@each("remote_s", [10**400, -(10**400), 1e308, math.inf, math.nan])
def test_a_clock_that_shows_what_no_clock_can_is_left_out(remote_s: float) -> None:
    clocks = ClockComparison()
    assert not clocks.add(0.0, 0.1, remote_s, wall_received=0.0, remote_wall=0.0)
    assert not clocks.add(0.0, 0.1, 0.0, wall_received=0.0, remote_wall=remote_s)
    assert clocks.best(0.1) is None


def test_what_cannot_be_is_not_kept_and_memory_is_bounded() -> None:
    clocks = ClockComparison()
    for sent, received in ((1.0, 0.5), (0.0, WINDOW_S + 1)):
        assert not clocks.add(sent, received, 0.0, wall_received=0.0, remote_wall=0.0)
    assert clocks.best(1.0) is None
    for _ in range(10 * MAX_SAMPLES):
        clocks.add(0.0, 0.1, 5.0, wall_received=0.0, remote_wall=0.0)
    assert len(clocks._samples) == MAX_SAMPLES
    assert clocks.best(WINDOW_S + 1.0) is None


@each("step_s", [60.0, -60.0, 0.5])
def test_after_a_clock_was_set_no_quicker_answer_from_before_counts(step_s: float) -> None:
    clocks = ClockComparison()
    clocks.add(0.0, 0.004, 10.0, wall_received=0.0, remote_wall=0.0)
    clocks.add(0.1, 1.9, 11.0, wall_received=0.0, remote_wall=0.0)  # slow: it agrees with a step of half a second
    clocks.add(2.0, 2.2, 12.1 + step_s, wall_received=0.0, remote_wall=0.0)
    best = clocks.best(2.2)
    assert best is not None
    assert abs(best.offset_s - 10.0 - step_s) <= best.error_s
