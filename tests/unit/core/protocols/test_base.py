"""Requests under way: never more than the window, never faster than the spacing, each answered or given up."""

from __future__ import annotations

import math

from hypothesis import given
from hypothesis import strategies as st

from skygcs.core.protocols.base import FIRST_WAIT_S, MAX_WAIT_S, MIN_WAIT_S, ReplyTimeout, SlidingWindow


class Numbers:
    """0 to ``count`` - 1, of which some have been answered."""

    def __init__(self, count: int, *, size: int = 4, spacing_s: float = 0.0, max_tries: int = 3) -> None:
        self.answered: set[int] = set()
        self.count = count
        self.next = 0
        self.window = SlidingWindow(
            self.next_new, lambda n: n not in self.answered, size=size, spacing_s=spacing_s, max_tries=max_tries
        )

    def next_new(self) -> int | None:
        if self.next >= self.count:
            return None
        self.next += 1
        return self.next - 1

    def answer(self, number: int, now: float) -> None:
        self.answered.add(number)
        self.window.answered(number, now)


def test_as_many_as_the_window_holds_are_requested_and_one_more_for_each_answer() -> None:
    numbers = Numbers(5)
    assert numbers.window.advance(0.0) == [0, 1, 2, 3]
    assert numbers.window.advance(0.1) == [] and 2 in numbers.window
    numbers.answer(2, 0.2)
    assert numbers.window.advance(0.2) == [4]
    for number in (0, 1, 3, 4):
        numbers.answer(number, 0.3)
    assert numbers.window.advance(0.3) == [] and numbers.window.due == math.inf


def test_requests_keep_their_spacing() -> None:
    numbers = Numbers(10, spacing_s=0.5)
    assert numbers.window.advance(0.0) == [0] and numbers.window.due == 0.5
    assert numbers.window.advance(0.4) == [] and numbers.window.advance(0.5) == [1]


def test_what_is_overdue_is_requested_before_what_is_new_and_given_up_after_its_tries() -> None:
    numbers = Numbers(9, size=2, max_tries=2)
    assert numbers.window.advance(0.0) == [0, 1]
    numbers.answer(0, 0.1)
    assert numbers.window.advance(0.1) == [2]
    assert numbers.window.advance(1.0) == [1, 2]
    assert numbers.window.advance(20.0) == [3, 4] and numbers.window.given_up == {1, 2}


@given(st.integers(1, 40), st.integers(1, 8), st.integers(1, 5), st.lists(st.booleans(), max_size=300))
def test_every_number_is_answered_or_given_up_whatever_is_lost(count, size, tries, arrives) -> None:
    numbers = Numbers(count, size=size, spacing_s=0.01, max_tries=tries)
    sent: dict[int, int] = {}
    now, fate = 0.0, iter(arrives)
    while True:
        requested = numbers.window.advance(now)
        for number in requested:
            sent[number] = sent.get(number, 0) + 1
            if next(fate, True):
                numbers.answer(number, now)
        assert sum(number in numbers.window for number in range(count)) <= size
        if numbers.window.due == math.inf and not requested:
            break
        now = max(now, min(numbers.window.due, now + 10.0))
    assert numbers.answered | numbers.window.given_up == set(range(count))
    assert not numbers.answered & numbers.window.given_up and max(sent.values()) <= tries


def test_the_timeout_follows_the_round_trip_within_its_bounds() -> None:
    timeout = ReplyTimeout()
    assert timeout.seconds == FIRST_WAIT_S
    for _ in range(50):
        timeout.measured(0.001)
    assert timeout.seconds == MIN_WAIT_S
    timeout.overdue(0.0)
    timeout.overdue(0.1)  # of the same wait
    assert timeout.seconds == 2 * MIN_WAIT_S
    for _ in range(50):
        timeout.measured(30.0)
    assert timeout.seconds == MAX_WAIT_S
