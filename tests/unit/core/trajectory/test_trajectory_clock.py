from __future__ import annotations

import math
from collections.abc import Callable

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from skygcs.core.trajectory import MotionLimits, Piece, Trajectory, TrajectoryClock, motion_peaks
from skygcs.core.trajectory.timing import path_within
from skygcs.core.trajectory.trajectory_clock import ClockState, rate_limit
from skygcs.core.vehicle.trajectory_flight import LoadedTrajectory, common_clock
from skygcs.errors import RefusedError, TrajectoryError
from support.examples import examples
from support.table import each

SQUARE = path_within(
    [(0.0, 0.0, 5.0), (20.0, 0.0, 5.0), (20.0, 20.0, 8.0), (0.0, 20.0, 5.0), (0.0, 0.0, 5.0)], MotionLimits()
)
LINE = Trajectory([Piece(20.0, (0.0, 2.0), (0.0,), (5.0,))])
"""2 m/s from the first moment to the last."""


def running(clock: TrajectoryClock, at_s: float = 0.0) -> TrajectoryClock:
    clock.start(at_s, at_s)
    return clock


def test_it_waits_runs_and_finishes_with_the_time_of_the_fleet() -> None:
    clock = common_clock([LoadedTrajectory(SQUARE)], 2.0, 1.0)
    assert clock.at(5.0).state is ClockState.READY
    clock.start(10.0, 12.0)
    assert clock.at(11.0) == (0.0, 0.0, 0.0, ClockState.WAITING)
    assert clock.at(12.0) == (0.0, 1.0, 0.0, ClockState.RUNNING)
    assert clock.at(15.5) == (3.5, 1.0, 0.0, ClockState.RUNNING)
    assert clock.finishes_at_s(15.5) == pytest.approx(12.0 + SQUARE.duration_s)
    assert clock.at(12.0 + SQUARE.duration_s + 0.1) == (SQUARE.duration_s, 0.0, 0.0, ClockState.FINISHED)


def test_a_pause_stops_on_the_path_and_a_resumption_goes_on() -> None:
    clock = running(TrajectoryClock(60.0, 0.5))
    clock.pause(10.0)
    assert clock.at(10.0).state is ClockState.PAUSING
    assert clock.at(11.0)[:3] == (pytest.approx(10.75), 0.5, -0.5)
    assert clock.at(12.0) == (pytest.approx(11.0), 0.0, 0.0, ClockState.PAUSED)
    assert clock.at(100.0)[0] == pytest.approx(11.0)
    assert clock.finishes_at_s(100.0) is None
    clock.resume(200.0)
    assert clock.at(201.0)[:3] == (pytest.approx(11.25), 0.5, 0.5)
    assert clock.at(202.5)[:3] == (pytest.approx(12.5), 1.0, 0.0)
    assert clock.finishes_at_s(203.0) == pytest.approx(250.0)


def test_the_speed_factor_ramps_and_a_resumption_while_it_still_slows_down_speeds_up_from_there() -> None:
    clock = running(TrajectoryClock(60.0, 0.5))
    clock.set_speed(10.0, 0.5)
    assert clock.at(10.5)[1:3] == (0.75, -0.5)
    assert clock.at(11.0)[:3] == (pytest.approx(10.75), 0.5, 0.0)
    clock.set_speed(20.0, 2.0)
    assert clock.at(30.0).rate == 2.0
    clock = running(TrajectoryClock(60.0, 0.5))
    clock.pause(10.0)
    clock.resume(11.0)
    assert clock.at(11.0)[:3] == (pytest.approx(10.75), 0.5, 0.5)


def test_an_abort_is_a_stop_for_good() -> None:
    clock = running(TrajectoryClock(60.0, 0.5))
    clock.abort(10.0)
    assert clock.at(11.0).state is ClockState.ABORTING
    assert clock.at(12.0) == (pytest.approx(11.0), 0.0, 0.0, ClockState.ABORTED)
    for order in (clock.pause, clock.resume, lambda now: clock.set_speed(now, 1.0), lambda now: clock.start(now, now)):
        with pytest.raises(RefusedError, match="aborted"):
            order(13.0)
    clock.abort(14.0)
    assert clock.at(14.0).state is ClockState.ABORTED


def test_an_abort_before_the_start_or_in_a_pause_is_immediate() -> None:
    for prepare in (lambda c: None, lambda c: c.start(0.0, 5.0), lambda c: (c.start(0.0, 0.0), c.pause(1.0))):
        clock = TrajectoryClock(60.0, 10.0)
        prepare(clock)
        clock.abort(3.0)
        assert clock.at(3.0).state is ClockState.ABORTED
        assert clock.at(100.0).rate == 0.0


def test_a_start_that_was_paused_goes_on_from_the_beginning() -> None:
    clock = TrajectoryClock(60.0, 1.0)
    clock.start(0.0, 5.0)
    clock.pause(3.0)
    assert clock.at(10.0) == (0.0, 0.0, 0.0, ClockState.PAUSED)
    clock.resume(20.0)
    assert clock.at(22.0)[:2] == (pytest.approx(1.5), 1.0)


@each("factor", [0.0, -1.0, math.nan, math.inf, 5.0])
def test_a_speed_factor_that_is_none_is_refused(factor: float) -> None:
    with pytest.raises(RefusedError, match="speed factor"):
        TrajectoryClock(10.0, 1.0, speed_factor=factor)
    clock = running(TrajectoryClock(10.0, 1.0))
    with pytest.raises(RefusedError, match="speed factor"):
        clock.set_speed(1.0, factor)
    assert clock.at(2.0)[:2] == (2.0, 1.0)


@each("at_s", [9.9, math.nan, math.inf, 1e6])
def test_a_start_in_the_past_or_never_is_refused(at_s: float) -> None:
    clock = TrajectoryClock(10.0, 1.0)
    with pytest.raises(RefusedError, match="ahead"):
        clock.start(10.0, at_s)
    assert clock.at(11.0).state is ClockState.READY


def test_what_the_state_does_not_allow_is_refused() -> None:
    clock = TrajectoryClock(10.0, 1.0)

    def refused(now: float, word: str, *orders: Callable[[float], object]) -> None:
        for order in orders:
            with pytest.raises(RefusedError, match=word):
                order(now)

    refused(0.0, "ready", clock.pause, clock.resume)
    clock.start(0.0, 1.0)
    refused(0.5, "waiting", clock.resume, lambda now: clock.start(now, now))
    clock.at(20.0)
    refused(21.0, "finished", clock.pause, clock.resume)


def test_a_moving_start_and_end_are_ramped() -> None:
    clock = running(common_clock([LoadedTrajectory(LINE)], 1.0, 1.0))
    assert (clock.rests_at_start, clock.rests_at_end) == (False, False)
    assert clock.at(0.0).rate == 0.0
    assert clock.at(1.0).rate == pytest.approx(0.5)
    assert clock.at(10.0).rate == 1.0
    end = clock.finishes_at_s(10.0)
    assert end == pytest.approx(22.0)
    assert clock.at(end - 1.0).rate == pytest.approx(0.5)
    assert clock.at(end - 1e-6).rate == pytest.approx(0.0, abs=1e-5)
    assert clock.at(end)[0] == 20.0


def test_the_rate_limit_suits_the_fastest_trajectory() -> None:
    assert rate_limit(5.0, 2.5) == pytest.approx(0.5, rel=1e-4)
    assert rate_limit(0.0, 2.5) == 10.0
    with pytest.raises(TrajectoryError, match="longer than 100 s"):
        rate_limit(2.0, 0.001)
    with pytest.raises(TrajectoryError, match="not positive"):
        rate_limit(2.0, math.nan)


orders = st.lists(
    st.tuples(st.floats(0.0, 15.0), st.one_of(st.sampled_from(["pause", "resume", "abort"]), st.floats(0.05, 3.0))),
    max_size=8,
)


@settings(max_examples=examples(80))
@given(orders, st.floats(0.05, 3.0), st.sampled_from([SQUARE, LINE]))
def test_the_clock_never_jumps_nor_goes_back_and_keeps_the_bound_of_acceleration(steps, factor, trajectory) -> None:
    """Whatever is ordered and when: s is continuous and monotone, the reference a motion with bounded acceleration."""
    brake = 1.5
    clock = running(common_clock([LoadedTrajectory(trajectory)], brake, factor))
    due = iter([*((sum(d for d, _ in steps[: i + 1]), what) for i, (_, what) in enumerate(steps)), (math.inf, "")])
    when, what = next(due)
    peaks = motion_peaks(trajectory)
    now, dt = 0.0, 0.02
    before = clock.at(0.0)
    fastest = factor
    for _ in range(4000):
        now += dt
        while when <= now:
            _order(clock, when, what)
            when, what = next(due)
        fastest = max(fastest, clock.speed_factor)
        time = clock.at(now)
        moved = time.trajectory_s - before.trajectory_s
        assert 0.0 <= moved <= fastest * dt * (1 + 1e-9)
        assert abs(time.rate_change_per_s) <= clock.rate_limit_per_s * (1 + 1e-6)
        if before.state is ClockState.RUNNING and time.state is not ClockState.FINISHED:
            assert abs(time.rate - before.rate) <= clock.rate_limit_per_s * dt * (1 + 1e-6)
        if time.state in (ClockState.PAUSED, ClockState.ABORTED, ClockState.FINISHED):
            assert time.rate == 0.0 and (before.rate <= fastest)
        point = trajectory.at(*time[:3])
        most = peaks.acceleration_mps2.at_most * fastest**2 + brake
        assert math.hypot(*point.acc_enu_mps2) <= most * (1 + 1e-6) + 1e-9
        before = time
        if time.state in (ClockState.ABORTED, ClockState.FINISHED):
            break


def _order(clock: TrajectoryClock, now: float, what: str | float) -> None:
    try:
        if isinstance(what, float):
            clock.set_speed(now, what)
        else:
            getattr(clock, what)(now)
    except RefusedError:
        pass


def test_a_time_that_goes_back_or_is_no_number_does_not_move_it() -> None:
    clock = running(TrajectoryClock(60.0, 0.5))
    assert clock.at(10.0).trajectory_s == 10.0
    for now in (9.0, math.nan, -math.inf):
        assert clock.at(now).trajectory_s == 10.0
    clock.pause(5.0)
    assert clock.at(10.0) == (10.0, 1.0, -0.5, ClockState.PAUSING)
    assert clock.at(12.0).trajectory_s == pytest.approx(11.0)


@each(("duration_s", "limit"), [(0.0, 1.0), (math.nan, 1.0), (10.0, 0.0), (10.0, math.nan)])
def test_a_clock_of_no_time_or_no_limit_is_refused(duration_s: float, limit: float) -> None:
    with pytest.raises(TrajectoryError):
        TrajectoryClock(duration_s, limit)
