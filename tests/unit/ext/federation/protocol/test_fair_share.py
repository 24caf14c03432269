"""The places of one pool among senders."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from skygcs.ext.federation.protocol.fair_share import FairShare
from support.table import each


def fill(pool: FairShare, *senders: str) -> None:
    """Each takes what it may, in turns."""
    while any(pool.has_room(sender) for sender in senders):
        for sender in senders:
            if pool.has_room(sender):
                pool.take(sender)


@each("factor", [1.0, 4.0])
@each("greedy", [1, 2, 5])
def test_greedy_senders_leave_places_for_one_that_comes_later(factor: float, greedy: int) -> None:
    pool = FairShare(1000, factor)
    senders = [f"s{n}" for n in range(greedy)]
    fill(pool, *senders)
    for sender in senders:
        assert pool.of(sender) == pytest.approx(1000 * factor / (1 + greedy * factor), abs=factor + 1)
    assert pool.places - len(pool) >= 1000 / (1 + greedy * factor) - greedy - 1
    assert pool.has_room("late")


@given(st.lists(st.tuples(st.integers(0, 4), st.booleans()), max_size=300))
def test_it_never_gives_more_than_it_has_and_counts_right(steps: list[tuple[int, bool]]) -> None:
    pool, taken = FairShare(20, 4.0), dict.fromkeys(map(str, range(5)), 0)
    for number, back in steps:
        sender = str(number)
        if back and taken[sender]:
            pool.give_back(sender)
            taken[sender] -= 1
        elif not back and pool.has_room(sender):
            pool.take(sender)
            taken[sender] += 1
        assert len(pool) == sum(taken.values()) <= 20
        assert all(pool.of(sender) == count for sender, count in taken.items())
