"""What a companion does without the ground; all rows of the table."""

from __future__ import annotations

import itertools

import pytest

from skygcs.ext.companions.ground_contact import (
    LISTEN_S,
    MOST_STANDSTILLS,
    Action,
    ContactState,
    GroundContact,
    GroundLost,
)
from support.table import each

LOST_S = 5.0


def ticks(
    watch: GroundContact,
    begin: float,
    end: float,
    *,
    contact_at: float | None = None,
    follows: bool = False,
    controlled: bool = True,
) -> list[tuple[float, Action]]:
    """What is ordered, five ticks a second. ``contact_at`` None: contact all the time."""
    found = []
    for k in range(round((end - begin) * 5)):
        now = begin + k / 5
        at = now if contact_at is None else contact_at
        action = watch.tick(now, controlled=controlled, follows=follows, contact_at=at)
        if action is not None:
            found.append((now, action))
    return found


@each("action", ["return", "hold", "land"])
@each("follows", [True, False])
def test_it_acts_once_after_the_silence(action: GroundLost, follows: bool) -> None:
    watch = GroundContact(action, LOST_S)
    assert ticks(watch, 0.0, 20.0) == []
    ((at, ordered),) = ticks(watch, 20.0, 60.0, contact_at=19.8, follows=follows)
    assert ordered == action and at == pytest.approx(24.8, abs=0.21)
    assert watch.state is ContactState.ACTED and watch.lost
    # the order was denied, and the ground is back: its next loss is another one
    assert ticks(watch, 60.0, 70.0) == [] and not watch.lost
    assert [ordered for _, ordered in ticks(watch, 70.0, 90.0, contact_at=70.0)] == [action]


def test_finish_waits_for_the_end_and_once_more_for_the_ground() -> None:
    watch = GroundContact("finish", LOST_S)
    ticks(watch, 0.0, 10.0, follows=True)
    assert ticks(watch, 10.0, 40.0, contact_at=10.0, follows=True) == []
    assert watch.state is ContactState.FINISHING
    ((at, action),) = ticks(watch, 40.0, 60.0, contact_at=10.0)
    assert action == "return" and at == pytest.approx(45.0, abs=0.21)


def test_finish_without_a_trajectory_returns_at_once() -> None:
    watch = GroundContact("finish", LOST_S)
    ticks(watch, 0.0, 10.0)
    ((at, action),) = ticks(watch, 10.0, 30.0, contact_at=10.0)
    assert action == "return" and at == pytest.approx(15.0, abs=0.21)


@each("action", ["return", "hold", "land", "finish"])
def test_a_standstill_of_the_companion_is_no_silence_of_the_ground(action: GroundLost) -> None:
    """A board that throttled for 3 s brought its vehicle home, though the ground had spoken all the time."""
    watch = GroundContact(action, 2.0)
    assert ticks(watch, 0.0, 10.0) == []
    for end in (13.0, 13.4, 16.6):  # what waited is read a moment after it goes on, if the ground is there
        assert ticks(watch, end, end + 0.4, contact_at=10.0) == []
        assert ticks(watch, end + 0.4, end + 0.6) == [] and watch.state is ContactState.WATCHED
    ((at, _),) = ticks(watch, 20.0, 30.0, contact_at=16.8)
    assert at == 20.0 + LISTEN_S, "it is lost after a standstill, too"


@each("period_s", [0.6, 1.5, 3.0])
def test_a_companion_that_is_late_at_every_tick_loses_the_ground_all_the_same(period_s: float) -> None:
    watch = GroundContact("hold", LOST_S)
    times = [k * period_s for k in range(40)]
    heard = [watch.tick(now, controlled=True, follows=False, contact_at=now) for now in times]
    silent = [watch.tick(times[-1] + now, controlled=True, follows=False, contact_at=times[-1]) for now in times[1:]]
    assert set(heard) == {None} and silent.count("hold") == 1


def test_so_many_standstills_are_forgiven_after_each_contact_and_no_more() -> None:
    watch = GroundContact("hold", 2.0)
    for k in range(2 * MOST_STANDSTILLS):
        assert ticks(watch, 20.0 * k, 20.0 * k + 10.0) == []
        assert ticks(watch, 20.0 * k + 13.0, 20.0 * k + 13.8, contact_at=20.0 * k + 9.8) == []
    ticks(watch, 200.0, 202.0)
    late = [watch.tick(202.0 + 3.0 * k, controlled=True, follows=False, contact_at=201.8) for k in range(1, 6)]
    assert late.index("hold") == MOST_STANDSTILLS


@each("follows", [True, False])
def test_a_ground_that_comes_back_before_the_order_goes_on(follows: bool) -> None:
    watch = GroundContact("finish", LOST_S)
    ticks(watch, 0.0, 10.0, follows=True)
    ticks(watch, 10.0, 17.0, contact_at=10.0, follows=True)
    assert watch.state is ContactState.FINISHING
    if not follows:
        ticks(watch, 17.0, 18.0, contact_at=10.0)
        assert watch.state is ContactState.WAITING
    assert ticks(watch, 18.0, 40.0, follows=follows) == []
    assert watch.state is ContactState.WATCHED


@each(("action", "follows"), list(itertools.product(["return", "hold", "land", "finish"], [True, False])))
def test_without_control_nothing_is_ever_ordered(action: GroundLost, follows: bool) -> None:
    watch = GroundContact(action, LOST_S)
    assert ticks(watch, 0.0, 60.0, contact_at=-100.0, follows=follows, controlled=False) == []
    ticks(watch, 60.0, 62.0)
    assert ticks(watch, 62.0, 90.0, contact_at=61.8, controlled=False) == [], "a pilot took it in the silence"
    assert watch.state is ContactState.IDLE


def test_the_silence_counts_from_the_begin_of_control() -> None:
    """Control that begins while the last contact is old has its time, too."""
    watch = GroundContact("hold", LOST_S)
    assert ticks(watch, 100.0, 103.0, contact_at=0.0) == [] and watch.silence_s(103.0, 0.0) == 3.0
    ((at, _),) = ticks(watch, 103.0, 120.0, contact_at=0.0)
    assert watch.silence_s(120.0, 100.0) == 20.0
    assert at == pytest.approx(105.0, abs=0.21)
