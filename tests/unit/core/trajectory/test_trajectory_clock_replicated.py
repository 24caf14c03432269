"""A clock and its replica: the same trajectory time on both, whatever delays an order by less than the lead."""

from __future__ import annotations

import pytest

from skygcs.core.trajectory import ClockState
from skygcs.core.trajectory.trajectory_clock import MAX_NOTED, STOP_ROOM, ClockOrder, ReplicatedClock
from skygcs.errors import RefusedError

LEAD_S = 0.8


def pair() -> tuple[ReplicatedClock, ReplicatedClock, list[ClockOrder]]:
    """A started clock of 60 s, its replica, and the orders under way."""
    ours, theirs = ReplicatedClock(60.0, 0.5, lead_s=LEAD_S), ReplicatedClock(60.0, 0.5)
    under_way: list[ClockOrder] = []
    ours.observers.append(under_way.append)
    ours.start(0.0, 1.0)
    theirs.start(0.0, 1.0)
    return ours, theirs, under_way


def steps(ours: ReplicatedClock, theirs: ReplicatedClock, begin: float, end: float) -> float:
    """The largest difference of their trajectory times on the way, ticks of 20 ms."""
    worst = 0.0
    for k in range(round((end - begin) / 0.02)):
        now = begin + 0.02 * k
        worst = max(worst, abs(ours.at(now).trajectory_s - theirs.at(now + 0.007).trajectory_s))
    return worst


def test_every_order_takes_effect_on_both_at_the_same_time() -> None:
    ours, theirs, under_way = pair()
    for at, give in (
        (5.0, ours.pause),
        (12.0, ours.resume),
        (25.0, lambda now: ours.set_speed(now, 0.5)),
        (35.0, ours.abort),
    ):
        assert steps(ours, theirs, at - 4.0, at) < 0.01
        give(at)
        order = under_way.pop()
        assert order.at_s == at + LEAD_S
        assert steps(ours, theirs, at, at + 0.6) < 0.01  # under way
        theirs.note(order)
    assert steps(ours, theirs, 35.0, 45.0) < 0.01
    assert ours.at(46.0).state is theirs.at(46.0).state is ClockState.ABORTED


def test_an_order_that_comes_too_late_is_carried_out_then() -> None:
    ours, theirs, under_way = pair()
    ours.pause(5.0)
    steps(ours, theirs, 5.0, 7.0)
    theirs.note(under_way.pop())
    steps(ours, theirs, 7.0, 12.0)
    ahead_s = theirs.at(12.0).trajectory_s - ours.at(12.0).trajectory_s
    assert theirs.at(12.0).state is ClockState.PAUSED
    assert ahead_s == pytest.approx(7.0 - 5.0 - LEAD_S, abs=0.03)


def test_orders_that_come_too_late_together_are_carried_out_one_after_another() -> None:
    ours, theirs, under_way = pair()
    for begin, orders, end in (
        (5.0, (ours.pause, ours.resume), ClockState.RUNNING),
        (15.0, (ours.pause, ours.resume, ours.pause), ClockState.PAUSED),
    ):
        for k, order in enumerate(orders):
            order(begin + 0.5 * k)
        steps(ours, theirs, begin + 1.0, begin + 4.0)
        while under_way:
            theirs.note(under_way.pop(0))
        steps(ours, theirs, begin + 4.0, begin + 10.0)
        assert ours.at(begin + 10.0).state is theirs.at(begin + 10.0).state is end


def test_orders_are_refused_as_by_any_clock_and_not_given_twice() -> None:
    ours, _, under_way = pair()
    ours.at(5.0)
    with pytest.raises(RefusedError, match="only a paused one"):
        ours.resume(5.0)
    ours.pause(5.0)
    ours.pause(5.1)
    assert [order.kind for order in under_way] == ["pause"]
    assert ours.at(5.2).state is ClockState.RUNNING, "not yet"
    ours.resume(10.0)
    assert ours.at(10.1).state is ClockState.RUNNING and ours.at(10.1).rate == 0.0, "it waits to go on"
    with pytest.raises(RefusedError, match="speed factor"):
        ours.set_speed(10.2, float("nan"))
    ours.abort(10.3)
    ours.abort(10.4)
    assert [order.kind for order in under_way] == ["pause", "resume", "abort"]
    with pytest.raises(RefusedError, match="nothing to pause"):
        ours.pause(10.5)
    with pytest.raises(RefusedError, match="cannot be changed"):
        ours.set_speed(10.5, 0.5)


def test_orders_that_wait_are_bounded_and_a_stop_always_has_room() -> None:
    ours, theirs, under_way = pair()
    ours.at(2.0)
    for k in range(MAX_NOTED):
        ours.set_speed(2.0, 0.5 + 0.01 * k)
    for give in (lambda: ours.set_speed(2.0, 0.5), lambda: (ours.pause(2.0), ours.resume(2.0))):
        with pytest.raises(RefusedError, match="wait"):
            give()
    ours.abort(2.0)
    for order in under_way:
        theirs.note(order)
    assert [order.kind for order in under_way[MAX_NOTED:]] == ["pause", "abort"]
    assert ours.at(20.0).state is theirs.at(20.0).state is ClockState.ABORTED
    for k in range(MAX_NOTED + STOP_ROOM):
        theirs.note(ClockOrder("pause", 100.0 + k))
    with pytest.raises(RefusedError, match="wait"):
        theirs.note(ClockOrder("pause", 1.0))


def test_a_resume_of_what_is_not_paused_by_then_does_nothing() -> None:
    _, theirs, _ = pair()
    theirs.note(ClockOrder("resume", 3.0))
    assert theirs.at(4.0).state is ClockState.RUNNING and theirs.at(4.0).rate == 1.0
