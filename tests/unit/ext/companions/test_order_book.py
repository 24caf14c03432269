"""Each order of the ground is carried out once, in order and in time."""

from __future__ import annotations

import random

from skygcs.core.protocols.command import Outcome
from skygcs.ext.companions.order_book import MAX_KEPT, REPLACED, Fresh, Known, OrderBook, Refused
from skygcs.ext.companions.relayed_order import LEAST_REPEAT_S, MOST_REPEAT_S, RelayedOrder, unknown
from support.table import each

DONE = Outcome(True, "accepted", "done")


def book() -> OrderBook:
    made = OrderBook("s1", 5.0)
    assert made.contact("g1", 0.0) is None
    return made


def admit(of: OrderBook, number: int, *, moves: bool = True, until_s: float = 100.0, now: float = 1.0) -> object:
    return of.admit("g1", "s1", number, moves=moves, until_s=until_s, now=now)


def test_a_repeat_gets_the_outcome_and_nothing_is_done_again() -> None:
    of = book()
    assert admit(of, 1) == Fresh()
    assert admit(of, 1) == Known(None)
    of.ended("g1", 1, DONE)
    assert admit(of, 1) == Known(DONE)
    assert admit(of, 1, now=500.0) == Known(DONE), "the outcome is known long after the deadline"


def test_what_comes_too_late_or_after_a_newer_order_is_refused() -> None:
    of = book()
    assert isinstance(admit(of, 3, until_s=0.9), Refused)
    assert isinstance(admit(of, 3, until_s=float("nan")), Refused)
    assert admit(of, 5) == Fresh()
    refused = admit(of, 4)
    assert isinstance(refused, Refused) and "newer" in refused.why
    assert admit(of, 2, moves=False) == Fresh(), "gains move nothing"


def test_orders_of_another_session_or_ground_are_refused() -> None:
    of = book()
    for ground, session in (("g1", "s0"), ("g2", "s1")):
        found = of.admit(ground, session, 1, moves=True, until_s=9.0, now=1.0)
        assert isinstance(found, Refused)


def test_another_ground_gets_it_only_after_a_silence() -> None:
    of = book()
    assert admit(of, 7) == Fresh()
    assert "another ground" in (of.contact("g2", 4.9) or "")
    assert of.contact("g2", 5.1) is None
    assert isinstance(admit(of, 8), Refused)
    assert of.admit("g2", "s1", 1, moves=True, until_s=9.0, now=5.2) == Fresh()
    of.ended("g1", 7, DONE)  # what the first one began ends late: it is of nobody
    assert of.admit("g2", "s1", 7, moves=True, until_s=9.0, now=5.2) == Fresh()


def test_of_setpoints_and_orders_that_move_the_vehicle_the_newest_counts() -> None:
    of = book()
    assert admit(of, 3) == Fresh()
    found = [of.admit_setpoint("g1", "s1", number) for number in (2, 5, 4, 5, 7)]
    assert found == [REPLACED, None, REPLACED, REPLACED, None]
    assert admit(of, 9) == Fresh() and admit(of, 12, moves=False) == Fresh()
    assert [of.admit_setpoint("g1", "s1", number) for number in (8, 10)] == [REPLACED, None]
    for ground, session in (("g2", "s1"), ("g1", "s0")):
        answered = of.admit_setpoint(ground, session, 20)
        assert answered is not None and not answered.ok
    assert of.contact("g2", 9.0) is None
    assert of.admit_setpoint("g2", "s1", 1) is None, "another ground's numbers begin anew"


def test_the_book_is_bounded_and_what_it_forgot_is_not_done_again() -> None:
    of = book()
    for number in range(1, MAX_KEPT + 11):
        assert admit(of, number) == Fresh()
        of.ended("g1", number, DONE)
    assert isinstance(admit(of, 5, moves=False), Refused)
    assert admit(of, 11) == Known(DONE)


@each("seed", range(20))
def test_in_a_network_that_loses_repeats_and_reorders_nothing_is_done_twice_or_out_of_order(seed: int) -> None:
    rng, of, done = random.Random(seed), book(), []
    under_way = [number for number in range(1, 60) for _ in range(rng.randint(1, 4))]
    under_way.sort(key=lambda number: number + rng.uniform(0, 6))
    for number in under_way:
        if admit(of, number) == Fresh():
            done.append(number)
            if rng.random() < 0.8:
                of.ended("g1", number, DONE)
    assert done == sorted(set(done)) and len(done) > 10


# -- How long a relayed order is asked for.


def test_it_is_asked_again_after_a_round_trip_until_patience_is_over() -> None:
    order = RelayedOrder(1, "s", start_by=3.0, give_up_at=7.0)
    assert order.wait_s(0.0, 0.01) == LEAST_REPEAT_S
    assert order.wait_s(0.0, 1.6) == 2.0
    assert order.wait_s(0.0, None) == order.wait_s(0.0, 60.0) == MOST_REPEAT_S
    assert order.wait_s(6.9, 1.6) == 7.0 - 6.9
    assert order.wait_s(7.0, 0.01) is None


def test_an_unknown_outcome_says_so() -> None:
    outcome = unknown("no answer came", 7.0)
    assert not outcome.ok and "not known" in outcome.message and outcome.elapsed_s == 7.0
