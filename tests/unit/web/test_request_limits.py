"""The allowance of one page, and the deadline of an order."""

from __future__ import annotations

import math

from skygcs.web.request_limits import (
    DEADLINE_MAX_S,
    MAX_ENDING_WAITING,
    MAX_MESSAGE_BYTES,
    MAX_REFUSED,
    MAX_WAITING,
    READ_AHEAD_S,
    READ_MESSAGES_PER_S,
    REQUEST_BURST,
    PageLimits,
    deadline_problem,
)
from support.table import each


def test_a_flood_is_refused_and_stop_is_not_behind_it() -> None:
    limits = PageLimits(0.0)
    granted = 0
    for _ in range(10_000):
        if limits.begin(0.0, ends_flight=False) is None:
            granted += 1
            limits.end(ends_flight=False)
    assert granted == REQUEST_BURST
    assert limits.exceeded and limits.refused >= MAX_REFUSED
    assert limits.begin(0.0, ends_flight=True) is None


def test_only_so_many_may_wait_for_their_answer() -> None:
    limits = PageLimits(0.0)
    for _ in range(MAX_WAITING):
        assert limits.begin(0.0, ends_flight=False) is None
    assert limits.begin(0.0, ends_flight=False) is not None
    for _ in range(MAX_ENDING_WAITING):
        assert limits.begin(0.0, ends_flight=True) is None
    assert limits.begin(0.0, ends_flight=True) is not None
    limits.end(ends_flight=False)
    assert limits.begin(0.0, ends_flight=False) is None


@each("deadline", [100.0, 100, 103.5, 100.0 + DEADLINE_MAX_S])
def test_an_order_in_time_is_carried_out(deadline: float) -> None:
    assert deadline_problem(deadline, 100.0) is None


@each(
    "deadline",
    [
        None,
        True,
        "103",
        [],
        99.99,
        -1e300,
        0,
        100.0 + DEADLINE_MAX_S + 0.01,
        1e300,
        math.inf,
        math.nan,
        10**400,
        -(10**400),
    ],
)
def test_an_order_without_a_deadline_or_after_it_is_not(deadline: object) -> None:
    assert deadline_problem(deadline, 100.0) is not None


def test_a_page_is_read_from_at_a_pace_that_a_person_never_reaches() -> None:
    limits = PageLimits(0.0)
    assert not any(limits.pause_s(200, at / 50) for at in range(10_000)), "fifty messages a second for minutes"
    flood = PageLimits(0.0)
    now, read = 0.0, 0
    while now < 10.0:
        read += 1
        now += flood.pause_s(40, now)
    assert read <= READ_MESSAGES_PER_S * (10.0 + READ_AHEAD_S) + 1
    large = PageLimits(0.0)
    assert [large.pause_s(MAX_MESSAGE_BYTES, 0.0) > 0 for _ in range(4)] == [False, False, True, True]
    assert large.pause_s(0, 60.0) == 0.0
