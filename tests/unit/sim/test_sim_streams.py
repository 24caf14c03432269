"""Message intervals of a simulated vehicle."""

from __future__ import annotations

from collections import Counter

from hypothesis import given
from hypothesis import strategies as st

from skygcs.sim.rng import Rng
from skygcs.sim.stream_schedule import NEVER, Streams


def collect(streams: Streams, start: float, end: float, tick_s: float = 0.02) -> Counter[str]:
    sent: Counter[str] = Counter()
    for i in range(round((end - start) / tick_s)):
        sent.update(streams.due(start + (i + 1) * tick_s))
    return sent


@given(st.floats(0.1, 50.0), st.integers(0, 1000))
def test_a_rate_is_kept_over_time(rate_hz: float, seed: int) -> None:
    streams = Streams(["A"], {"A": rate_hz}, Rng(seed), 0.0)
    count = collect(streams, 0.0, 60.0)["A"]
    assert abs(count - 60 * rate_hz) <= max(1.0, 0.02 * 60 * rate_hz)


def test_off_default_and_back() -> None:
    streams = Streams(["A", "B"], {"A": 2}, Rng(1), 0.0)
    assert collect(streams, 0, 10) == {"A": 20}
    assert streams.set_interval("A", NEVER, 10)
    assert streams.set_interval("B", 0.1, 10)
    assert collect(streams, 10, 20) == {"B": 100}
    assert streams.set_interval("A", None, 20)
    assert streams.set_interval("B", None, 20)
    assert collect(streams, 20, 30) == {"A": 20}


def test_a_message_it_does_not_have_is_refused() -> None:
    streams = Streams(["A"], {"GONE": 5}, Rng(1), 0.0)
    assert not streams.set_interval("B", 1.0, 0)
    assert streams.interval("B") == NEVER
    assert collect(streams, 0, 10) == {}


def test_missed_deadlines_are_not_made_up_for() -> None:
    streams = Streams(["A"], {"A": 10}, Rng(1), 0.0)
    assert streams.due(100.0) == ["A"]
    assert streams.due(100.01) == []


def test_messages_of_one_rate_do_not_come_in_one_burst() -> None:
    names = [f"M{i}" for i in range(10)]
    streams = Streams(names, dict.fromkeys(names, 1), Rng(3), 0.0)
    largest = max(len(streams.due(i * 0.02)) for i in range(1, 500))
    assert largest < 5
