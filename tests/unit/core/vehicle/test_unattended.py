from __future__ import annotations

from dataclasses import replace

import pytest

from skygcs.core.vehicle.unattended import (
    GRACE_S,
    LEFT_S,
    REPEAT_S,
    STREAM_S,
    Effect,
    HoldIt,
    HoldsAfterAll,
    UnattendedWatch,
    Watched,
)
from support.table import each

TICK_S = 0.2
US = "this station's setpoints"
FLOWN = Watched(heard=True, flying=True, follows=True, mode="GUIDED", flown_by=US)
NOBODY = replace(FLOWN, flown_by=None)
LOITER = replace(NOBODY, follows=False, mode="LOITER")


class Rig:
    """The watch and a clock; ``effects``: what it wanted, with the time since the last `show`."""

    def __init__(self, flown_before: str | None = None) -> None:
        self.watch = UnattendedWatch(flown_before)
        self.now = 100.0

    def show(self, facts: Watched, for_s: float) -> list[tuple[float, Effect]]:
        began, found = self.now, []
        while self.now < began + for_s:
            effect = self.watch.tick(facts, self.now)
            if effect is not None:
                found.append((self.now - began, effect))
            self.now += TICK_S
        return found


@pytest.fixture
def rig() -> Rig:
    return Rig()


def test_a_vehicle_that_nobody_flies_any_more_is_held_within_a_second_and_again(rig: Rig) -> None:
    assert rig.show(FLOWN, 5.0) == []
    (first, again) = rig.show(NOBODY, GRACE_S + REPEAT_S + 3 * TICK_S)
    assert first == (pytest.approx(GRACE_S, abs=TICK_S), HoldIt(US, again=False))
    assert again[1] == HoldIt(US, again=True)
    rig.show(FLOWN, 5.0)
    assert rig.show(NOBODY, 1.0) == [(pytest.approx(GRACE_S, abs=TICK_S), HoldIt(US, again=False))]


@each(
    ("why", "facts"),
    [
        ("it is silent", replace(NOBODY, heard=False)),
        ("it is on the ground or disarmed", replace(NOBODY, flying=False)),
        ("another mode does not follow setpoints", LOITER),
        ("an order of ours is on its way", replace(NOBODY, ordered=True)),
    ],
)
def test_it_is_left_alone_while(why: str, facts: Watched) -> None:
    rig = Rig()
    rig.show(FLOWN, 1.0)
    assert rig.show(facts, 20.0) == [], why


def test_of_two_streams_that_end_together_none_gives_a_second_to_the_other(rig: Rig) -> None:
    """A program streamed beside our control, and both ended: held 1.3 s after the last setpoint."""
    for _ in range(10):
        rig.watch.on_station("250/190", "motion", rig.now)
        rig.show(FLOWN, TICK_S)
    ((held_s, effect),) = rig.show(NOBODY, 1.0)
    assert held_s <= GRACE_S + TICK_S and effect == HoldIt(US, again=False)


def test_of_two_streams_the_one_that_goes_on_flies_it(rig: Rig) -> None:
    for facts in (FLOWN,) * 10 + (NOBODY,) * 50:
        rig.watch.on_station("250/190", "motion", rig.now)
        assert rig.show(facts, TICK_S) == []


def test_an_order_that_was_denied_meanwhile_gives_no_further_grace(rig: Rig) -> None:
    """A program had ended 0.2 s before a mission was ordered and denied: held 2.3 s after the last setpoint."""
    rig.show(FLOWN, 1.0)
    assert rig.show(replace(NOBODY, ordered=True), 0.8) == []
    ((at, effect),) = rig.show(NOBODY, 1.0)
    assert at <= TICK_S and effect == HoldIt(US, again=False)


def test_one_that_was_in_the_mode_when_it_was_heard_first_is_left_alone() -> None:
    assert Rig().show(NOBODY, 20.0) == []
    assert Rig().show(replace(LOITER, mode="AUTO.LOITER"), 1.0) == []


def test_one_that_was_flown_between_two_looks_only_is_held(rig: Rig) -> None:
    """Control that was ended while it was being engaged had sent one setpoint, and no tick had seen it."""
    rig.watch.on_order("goto")
    assert rig.show(NOBODY, 5.0) == []
    rig.watch.on_flown(US, rig.now)
    ((at, effect),) = rig.show(NOBODY, 1.0)
    assert at <= 0.5 and effect == HoldIt(US, again=False)


def test_one_that_was_given_up_before_its_mode_was_seen_is_held(rig: Rig) -> None:
    """It stood in LOITER; control sent setpoints and the mode, and was ended by an order that was denied."""
    assert rig.show(LOITER, 20.0) == []
    assert rig.show(replace(LOITER, flown_by=US), 1.0) == []
    assert rig.show(LOITER, 0.6) == []
    ((at, effect),) = rig.show(NOBODY, 1.0)
    assert at <= 0.5 and effect == HoldIt(US, again=False)
    # a pilot who has it for longer has it
    assert rig.show(LOITER, LEFT_S + 1.0) == []
    assert rig.show(NOBODY, 20.0) == []


def test_a_station_whose_stream_ended_before_the_mode_was_seen_leaves_one_that_is_held(rig: Rig) -> None:
    assert rig.show(LOITER, 20.0) == []
    for _ in range(3):
        rig.watch.on_station("250/190", "motion", rig.now)
        assert rig.show(LOITER, 0.2) == []
    ((at, effect),) = rig.show(NOBODY, STREAM_S + 1.0)
    assert at <= STREAM_S + 0.5 and effect == HoldIt("250/190", again=False)


def test_one_that_the_daemon_before_flew_is_held() -> None:
    ((at, effect),) = Rig("the daemon that ran before").show(NOBODY, 1.0)
    assert at <= 0.5 and isinstance(effect, HoldIt)


@each("order", ["goto", "takeoff", "hold"])
def test_an_order_that_its_autopilot_carries_out_is_left_alone(order: str) -> None:
    rig = Rig()
    rig.show(FLOWN, 1.0)
    rig.watch.on_order(order)
    assert rig.show(NOBODY, 60.0) == []
    rig.show(FLOWN, 1.0)
    assert rig.show(NOBODY, 1.0), "setpoints have taken the order's place"


def test_a_mode_that_others_changed_is_theirs_and_a_short_change_is_not(rig: Rig) -> None:
    rig.show(FLOWN, 1.0)
    rig.show(LOITER, LEFT_S + 1.0)
    assert rig.watch.owed_to is None
    assert rig.show(NOBODY, 20.0) == []
    rig = Rig()
    rig.show(FLOWN, 1.0)
    rig.show(LOITER, 1.0)
    assert len(rig.show(NOBODY, GRACE_S + 3 * REPEAT_S + 2 * TICK_S)) == 4, "one heartbeat may be forged"
    rig = Rig()
    rig.show(FLOWN, 1.0)
    rig.show(LOITER, 1.0)
    rig.show(replace(NOBODY, heard=False), LEFT_S)
    assert rig.show(NOBODY, 20.0) == [], "it may have shown the other mode meanwhile"
    rig = Rig("the daemon that ran before")
    rig.show(LOITER, LEFT_S + 1.0)
    assert rig.show(NOBODY, 20.0) == []


def test_the_stream_of_another_station_is_left_alone_until_it_ends(rig: Rig) -> None:
    for _ in range(50):
        rig.watch.on_station("255/190", "motion", rig.now)
        assert rig.show(NOBODY, TICK_S) == []
    (at, effect), *_ = rig.show(NOBODY, 3.0)
    assert at <= STREAM_S + GRACE_S + 2 * TICK_S and effect == HoldIt("255/190", again=False)
    rig.watch.on_station("255/190", "place", rig.now)
    assert rig.show(NOBODY, 20.0) == [], "it holds there by itself"


def test_a_stream_has_ended_after_its_longest_gap_and_not_at_it() -> None:
    watch = UnattendedWatch()
    watch.on_station("255/190", "motion", 100.0)
    begins_s = STREAM_S + 0.1  # nobody flies it at this look
    assert [watch.tick(NOBODY, 100.0 + s) for s in (STREAM_S, begins_s, STREAM_S + GRACE_S)] == [None] * 3
    assert watch.tick(NOBODY, 100.01 + begins_s + GRACE_S) == HoldIt("255/190", again=False)


def test_a_hold_that_was_not_answered_is_confirmed_when_it_is_heard_again(rig: Rig) -> None:
    rig.show(FLOWN, 1.0)
    rig.watch.on_hold(ok=False, unheard=True)
    assert rig.show(replace(NOBODY, heard=False), 10.0) == []
    held = replace(LOITER, mode="AUTO.LOITER")
    assert [effect for _, effect in rig.show(held, 10.0)] == [HoldsAfterAll("AUTO.LOITER")]
    rig.show(FLOWN, 1.0)
    rig.watch.on_hold(ok=False, unheard=False)
    assert rig.show(held, 1.0) == [], "denied: its mode is not of our order"


def test_an_order_that_is_denied_changes_nothing_of_who_flies_it(rig: Rig) -> None:
    """It hovers by our order to hold: a mission that it denied had it held again, with an alarm."""
    rig.show(FLOWN, 5.0)
    rig.watch.on_order("hold")
    assert rig.show(NOBODY, 5.0) == []
    rig.show(replace(NOBODY, ordered=True), 1.0)
    assert rig.show(NOBODY, 10.0) == []
    # while our setpoints fly it, and end with the denied order, nobody does
    rig.show(FLOWN, 1.0)
    rig.show(replace(NOBODY, ordered=True), 1.0)
    assert [effect for _, effect in rig.show(NOBODY, 1.0)] == [HoldIt(US, again=False)]


def test_what_a_restart_has_to_know_is_who_flew_it_unless_it_does_something_by_itself(rig: Rig) -> None:
    assert rig.watch.owed_to is None
    rig.show(FLOWN, 1.0)
    assert rig.watch.owed_to == US
    rig.watch.on_order("goto")
    assert rig.watch.owed_to is None
    rig.watch.on_station("250/190", "motion", rig.now)
    rig.show(NOBODY, 0.4)
    assert rig.watch.owed_to == "250/190"
