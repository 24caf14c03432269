"""The rate limiter: what is spent keeps to the rate and the burst."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from skygcs.core.token_bucket import TokenBucket


def test_it_begins_full_and_fills_at_its_rate() -> None:
    bucket = TokenBucket(2.0, 3.0, 100.0)
    assert [bucket.take(100.0) for _ in range(4)] == [True, True, True, False]
    assert bucket.ready_at(1.0, 100.0) == pytest.approx(100.5)
    assert not bucket.take(100.4) and bucket.take(100.5)
    assert bucket.saved(1e6) == 3.0


def test_what_is_larger_than_the_burst_goes_when_it_is_full_and_a_reserve_stays() -> None:
    bucket = TokenBucket(100.0, 100.0)
    assert bucket.take(0.0, 250.0)
    assert bucket.saved(0.0) == -150.0
    assert bucket.ready_at(250.0, 0.0) == pytest.approx(2.5)
    bucket = TokenBucket(10.0, 100.0)
    assert bucket.ready_at(60.0, 0.0, reserve=30.0) == 0.0
    bucket.spend(20.0, 0.0)
    assert bucket.ready_at(60.0, 0.0, reserve=30.0) == pytest.approx(1.0)


def test_a_rate_and_a_burst_change_from_now_on() -> None:
    bucket = TokenBucket(1.0, 10.0)
    bucket.spend(10.0, 0.0)
    bucket.set_rate(4.0, 2.0)
    assert bucket.saved(3.0) == pytest.approx(6.0)
    bucket.set_burst(5.0, 3.0)
    assert bucket.saved(3.0) == 5.0


def test_a_clock_that_goes_back_gives_nothing() -> None:
    bucket = TokenBucket(1.0, 1.0, 10.0)
    assert bucket.take(10.0)
    assert not bucket.take(5.0) and not bucket.take(10.5) and bucket.take(11.0)


def test_without_a_rate_only_the_burst_goes() -> None:
    bucket = TokenBucket(0.0, 2.0)
    assert [bucket.take(now) for now in (0.0, 1e3, 1e6)] == [True, True, False]


@given(
    st.lists(st.tuples(st.floats(0, 5), st.floats(0.1, 50)), max_size=60),
    st.floats(0.1, 1000),
    st.floats(1, 300),
    st.sampled_from([0.0, 1e6]),
)
def test_over_any_time_no_more_than_rate_and_burst_is_taken(steps, rate, burst, now) -> None:
    bucket = TokenBucket(rate, burst, now)
    taken: list[tuple[float, float]] = []
    for pause_s, amount in steps:
        now += pause_s
        if bucket.take(now, amount):
            taken.append((now, amount))
        elif amount <= burst:
            assert bucket.ready_at(amount, now) > now
    for first, (since, _) in enumerate(taken):
        total, largest = 0.0, 0.0
        for at, amount in taken[first:]:
            total, largest = total + amount, max(largest, amount)
            assert total <= rate * (at - since) + max(burst, burst + largest * (largest > burst)) + 0.01
