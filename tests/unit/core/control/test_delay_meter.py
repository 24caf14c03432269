"""Delay of a link: percentiles as numpy has them, bounded, and unmoved by pongs that are lost, double or strange."""

from __future__ import annotations

import math
import random
from collections.abc import Iterator

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from skygcs.core.control import delay
from skygcs.core.control.delay import DelayMeter, p95
from support.examples import seeds
from support.table import each

ages = st.floats(0.0, 10.0)


def answered(meter: DelayMeter, rtt_s: float, now: float) -> None:
    meter.on_pong(meter.ping(now), now + rtt_s)


def flown(
    seconds: float,
    *,
    uplink_s: float = 0.01,
    slow_from: float = math.inf,
    slow_s: float = 0.585,
    slow_for: float = math.inf,
    until_end: bool = False,
    loss: float = 0.0,
    seed: int = 0,
    hz: float = 50.0,
    fast: bool = True,
) -> Iterator[tuple[float, float, bool]]:
    """A meter over a link that keeps its order and loses messages each way: at each tick the time, the delay and
    whether a ping went out. While the link is slow a message takes ``slow_s``, or waits ``until_end`` of that."""
    meter, rng = DelayMeter(share=1.0), random.Random(seed)
    meter.fast = fast
    under_way: list[tuple[float, int]] = []
    arrives = age_s = 0.0
    for n in range(round(seconds * hz)):
        now = n / hz
        for at, token in [pong for pong in under_way if pong[0] <= now]:
            under_way.remove((at, token))
            meter.on_pong(token, at)
        age_s = 0.02 if rng.random() >= loss else age_s + 1 / hz
        meter.on_tick(age_s, now)
        sends = meter.due_ping(now)
        if sends:
            token = meter.ping(now)
            slow = slow_from <= now < slow_from + slow_for
            takes_s = uplink_s if not slow else slow_from + slow_for - now + uplink_s if until_end else slow_s
            arrives = max(arrives, now + takes_s)
            if rng.random() >= loss and rng.random() >= loss:
                under_way.append((arrives + 0.01, token))
        yield now, meter.delay_p95_s or 0.0, sends


@given(st.lists(st.floats(-1e6, 1e6), min_size=1, max_size=200))
def test_percentile_is_that_of_numpy(values: list[float]) -> None:
    assert p95(values) == pytest.approx(float(np.percentile(values, 95)), rel=1e-12, abs=1e-12)


def test_percentile_of_infinite_values_is_never_nan() -> None:
    assert p95([]) is None
    assert p95([1.0, math.inf]) == math.inf
    assert p95([1.0, math.inf, math.inf]) == math.inf
    assert p95([1.0] * 30 + [math.inf]) == 1.0


@given(st.lists(st.tuples(st.floats(0.001, 0.5), ages), min_size=1, max_size=100), st.lists(ages, min_size=1))
def test_delay_is_that_of_numpy_on_the_window(ticks: list[tuple[float, float]], trips: list[float]) -> None:
    meter, now, seen = DelayMeter(), 0.0, []
    for pause, age in ticks:
        now += pause
        meter.on_tick(age, now)
        seen.append((now, age))
    window = [age for at, age in seen if now - at <= delay.WINDOW_S]
    estimated = []
    for trip in trips:
        now += 1.0
        answered(meter, trip, now)
        if (now + trip) - now <= delay.ROUND_TRIP_VALID_S:
            estimated.append((now + trip) - now)
    if not estimated:
        assert meter.rtt_p95_s is None
        assert meter.delay_p95_s is None
        return
    rtt = float(np.percentile(estimated[-delay.ROUND_TRIPS :], 95))
    assert meter.rtt_p95_s == pytest.approx(rtt, abs=1e-9)
    assert meter.delay_p95_s == pytest.approx(float(np.percentile([a + rtt / 2 for a in window], 95)), abs=1e-9)


def test_ages_counted_from_reception_get_both_ways() -> None:
    meter = DelayMeter(share=1.0)
    answered(meter, 0.04, 0.0)
    meter.on_tick(0.02, 0.1)
    assert meter.delay_p95_s == pytest.approx(0.06)


@pytest.fixture
def meter() -> DelayMeter:
    return DelayMeter()


def test_one_late_tick_in_a_window_moves_nothing_and_a_gap_of_states_does(meter: DelayMeter) -> None:
    answered(meter, 0.0, 0.0)
    for n in range(150):
        meter.on_tick(0.4 if n == 75 else 0.02, 0.1 + n * 0.02)
    assert meter.delay_p95_s == pytest.approx(0.02)
    for n in range(10):
        meter.on_tick(0.02 + n * 0.02 + 0.1, 3.1 + n * 0.02)
    assert (meter.delay_p95_s or 0.0) > 0.1


def test_of_21_round_trips_one_late_pong_moves_nothing_and_the_second_does(meter: DelayMeter) -> None:
    for n in range(21):
        answered(meter, 0.5 if n == 10 else 0.03, float(n))
    assert meter.rtt_p95_s == pytest.approx(0.03)
    answered(meter, 0.5, 21.0)
    assert meter.rtt_p95_s == pytest.approx(0.5)


def test_the_way_up_is_half_of_the_median_round_trip(meter: DelayMeter) -> None:
    assert meter.uplink_s is None
    for n, rtt_s in enumerate((0.2, 0.2, 3.0, 0.2, 0.1)):
        answered(meter, rtt_s, float(n))
    assert meter.uplink_s == pytest.approx(0.1)


@each("hz", [20.0, 25.0, 33.0, 50.0, 100.0])
@each("uplink_s", [0.005, 0.01, 0.03])
def test_an_uplink_that_gets_slow_is_noticed_at_any_phase_of_the_pings(hz: float, uplink_s: float) -> None:
    for phase in range(0, 21, 3):
        slow_from = 5.0 + phase * 0.01
        flight = flown(7.0, uplink_s=uplink_s, slow_from=slow_from, hz=hz)
        noticed = next(now for now, delay_s, _ in flight if delay_s > 0.1)
        assert 0 < noticed - slow_from <= 0.7


def test_the_bound_holds_until_late_pongs_show_the_same() -> None:
    seen = [(now, delay_s) for now, delay_s, _ in flown(20.0, slow_from=5.0)]
    noticed = next(now for now, delay_s in seen if delay_s > 0.1)
    assert all(delay_s > 0.1 for now, delay_s in seen if now >= noticed)
    assert seen[-1][1] == pytest.approx(0.615, abs=0.03)


@each("seed", seeds(8))
def test_no_false_alarm_in_ten_minutes_at_five_percent_loss_each_way(seed: int) -> None:
    assert max(delay_s for _, delay_s, _ in flown(600.0, loss=0.05, seed=seed)) <= 0.1


@each("pause_s", [0.1, 0.2, 0.25])
def test_a_short_pause_of_the_link_is_one_late_pong(pause_s: float) -> None:
    """What is sent within the pause arrives at its end, all at once."""
    for phase in range(20):
        begins = 5.0 + phase * 0.01
        flight = flown(10.0, uplink_s=0.01, slow_from=begins, slow_for=pause_s, until_end=True)
        assert max(delay_s for _, delay_s, _ in flight) <= 0.1


def test_pings_cost_a_slow_link_one_a_second_and_a_fast_one_five_and_twenty_only_in_doubt() -> None:
    def rate_hz(since: float, until: float, **link: float) -> float:
        flight = flown(until, fast=bool(link.pop("fast", 1)), **link)  # type: ignore[arg-type]
        return sum(sends for now, _, sends in flight if now >= since) / (until - since)

    assert rate_hz(2.0, 12.0) == pytest.approx(5.0, abs=0.3)
    assert rate_hz(2.0, 12.0, hz=20.0) == pytest.approx(5.0, abs=0.3)
    assert rate_hz(2.0, 12.0, fast=0, slow_from=5.0) == pytest.approx(1.0, abs=0.15)
    assert 18 <= rate_hz(5.3, 5.8, slow_from=5.0) <= 26
    assert 18 <= rate_hz(5.3, 5.8, slow_from=5.0, hz=20.0) <= 21
    assert rate_hz(9.0, 12.0, slow_from=5.0) == pytest.approx(5.0, abs=0.4), "known now, and no doubt any more"


def test_while_attitude_is_flown_five_late_pongs_of_101_are_accidents_and_the_last_21_count_after_it() -> None:
    meter = DelayMeter()
    meter.fast = True
    for n in range(101):
        answered(meter, 0.5 if n in (20, 40, 60, 98, 99) else 0.03, 0.2 * n)
    assert meter.rtt_p95_s == pytest.approx(0.03) and meter.uplink_s == pytest.approx(0.015)
    answered(meter, 0.5, 21.0)
    assert meter.rtt_p95_s == pytest.approx(0.5)
    answered(meter, 0.03, 21.2)
    for n in range(3):
        answered(meter, 0.03, 21.4 + 0.2 * n)
    meter.fast = False
    meter.on_tick(0.02, 22.1)
    assert meter.rtt_p95_s == pytest.approx(0.5), "three of the last 21"
    assert len(meter._trips) == delay.ROUND_TRIPS


@each("unknown", [None, math.nan, math.inf])
def test_a_state_of_unknown_age_is_infinitely_old(unknown: float | None) -> None:
    meter = DelayMeter()
    answered(meter, 0.03, 0.0)
    meter.on_tick(unknown, 0.1)
    assert meter.delay_p95_s == math.inf


def test_nothing_is_known_before_a_pong_and_a_tick(meter: DelayMeter) -> None:
    assert (meter.rtt_p95_s, meter.delay_p95_s) == (None, None)
    meter.on_tick(0.02, 0.0)
    assert meter.delay_p95_s is None
    other = DelayMeter()
    answered(other, 0.03, 0.0)
    assert other.delay_p95_s is None


def test_round_trips_are_forgotten_when_no_pong_comes_any_more(meter: DelayMeter) -> None:
    answered(meter, 0.03, 0.0)
    for n in range(1, 10):
        meter.ping(float(n))
        meter.on_tick(0.02, float(n))
        assert (meter.delay_p95_s is None) == (n > 5)


def test_what_is_from_before_the_clock_ran_backwards_is_forgotten(meter: DelayMeter) -> None:
    answered(meter, 0.03, 1000.0)
    meter.on_tick(5.0, 1000.0)
    assert not meter.due_ping(1000.1) and meter.due_ping(3.0)
    meter.on_tick(0.02, 10.0)
    assert meter.rtt_p95_s is None
    answered(meter, 0.0, 10.0)
    assert meter.delay_p95_s == pytest.approx(0.02)


def test_strange_pongs_are_counted_and_change_nothing(meter: DelayMeter) -> None:
    token = meter.ping(10.0)
    meter.on_pong(token + 1, 10.01)  # of nobody here
    meter.on_pong(token, 10.02)
    meter.on_pong(token, 10.9)  # twice
    late = meter.ping(11.0)
    meter.on_pong(late, 11.0 + delay.ROUND_TRIP_VALID_S + 0.1)
    early = meter.ping(20.0)
    meter.on_pong(early, 19.0)
    assert meter.strange == 4
    assert meter.rtt_p95_s == pytest.approx(0.02)


def test_pings_five_times_in_the_first_second_and_then_once_a_second() -> None:
    meter, sent = DelayMeter(), []
    for n in range(0, 500):
        now = n / 100
        if meter.due_ping(now):
            meter.ping(now)
            sent.append(now)
    assert sent == pytest.approx([0.0, 0.2, 0.4, 0.6, 0.8, 1.8, 2.8, 3.8, 4.8], abs=0.03)


steps = st.tuples(st.sampled_from(["tick", "ping", "pong", "stranger"]), st.floats(-5.0, 5.0), st.floats())


@given(st.lists(steps, max_size=300))
def test_no_sequence_raises_or_grows_or_gives_nan(sequence: list[tuple[str, float, float]]) -> None:
    meter, now, tokens = DelayMeter(), 100.0, [0]
    for what, pause, number in sequence:
        now += pause
        match what:
            case "tick":
                meter.on_tick(number, now)
            case "ping":
                tokens.append(meter.ping(now))
            case "pong":
                meter.on_pong(tokens[-1 - int(abs(pause)) % len(tokens)], now)
            case _:
                meter.on_pong(-7, now)
        meter.due_ping(now)
        for value in (meter.rtt_p95_s, meter.delay_p95_s):
            assert value is None or value >= 0
    assert tokens == sorted(set(tokens))


def test_memory_is_bounded_however_fast_the_loop_and_however_dead_the_link(meter: DelayMeter) -> None:
    for n in range(5000):
        meter.ping(n * 0.0001)
        meter.on_tick(0.01, n * 0.0001)
    for n in range(100):
        answered(meter, 0.01, 1.0 + n)
    assert len(meter._ages_s) == delay.MAX_TICKS
    assert len(meter._sent) <= delay.UNDER_WAY
    assert len(meter._trips) == delay.ROUND_TRIPS
