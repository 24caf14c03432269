"""Which of several links to one vehicle is used: the tables of `core.routing.link_choice`, and how it flaps."""

from __future__ import annotations

import random

import pytest

from skygcs.core.routing.link_choice import (
    DEFAULT_COST,
    REPORT_S,
    REPORTS,
    SCARCE_COST,
    TRIAL_MOST_S,
    TRIAL_S,
    Health,
    LinkChoice,
    LinkHealth,
)
from support.examples import seeds
from support.table import each

WIFI, RADIO = 1, 2


class Wire:
    """One link that carries frames at a rate; ``up`` and ``loss`` may change at any time."""

    def __init__(self, rate_hz: float, cost: int, now: float, *, known_good: bool = False) -> None:
        self.health = LinkHealth(now, cost=cost, known_good=known_good)
        self.period_s = 1.0 / rate_hz
        self.up = True
        self.loss = 0.0
        self.lag_s: float | None = None
        self.frames = self.lost = 0
        self._next = now
        self._pending = 0

    def run(self, until: float, rng: random.Random) -> None:
        while self._next <= until:
            if self.up and rng.random() >= self.loss:
                self.lost += self._pending  # a gap shows with the next frame
                self.frames, self._pending = self.frames + 1, 0
                self.health.heard(self._next)
            else:
                self._pending += 1
            self._next += self.period_s
        self.health.lag_s = self.lag_s
        self.health.sample(self.frames, self.lost, until)
        self.health.assess(until)


class Both:
    """Wi-Fi with 20 frames a second, and a radio on standby with two."""

    def __init__(self, seed: int = 1) -> None:
        self.rng = random.Random(seed)
        self.now = 0.0
        self.wifi = Wire(20.0, DEFAULT_COST, 0.0, known_good=True)
        self.radio = Wire(2.0, SCARCE_COST, 0.0)
        self.wires = {WIFI: self.wifi, RADIO: self.radio}
        self.choice = LinkChoice()
        self.chosen = WIFI
        self.changes: list[tuple[float, int, str]] = []

    def run(self, seconds: float) -> None:
        for _ in range(round(seconds / 0.2)):
            self.now = round(self.now + 0.2, 3)
            for wire in self.wires.values():
                wire.run(self.now, self.rng)
            standby = {i: w.health for i, w in self.wires.items() if i != self.chosen}
            better = self.choice.decide(self.wires[self.chosen].health, standby, lambda _: True, self.now)
            if better is not None:
                self.chosen = better.channel_id
                self.choice.changed(self.now)
                self.changes.append((self.now, self.chosen, better.why))

    def cut(self, seconds: float) -> None:
        """Wi-Fi is away for so long."""
        self.wifi.up = False
        self.run(seconds)
        self.wifi.up = True


@pytest.fixture
def both() -> Both:
    return Both()


def test_two_good_links_stay_as_they_are(both: Both) -> None:
    both.run(600)
    assert both.changes == [] and both.radio.health.health is Health.GOOD


def test_a_link_that_is_cut_is_left_within_a_second_and_a_half_until_a_trial_without_a_fault(both: Both) -> None:
    both.run(30)
    both.cut(5)
    ((at, chosen, why),) = both.changes
    assert at <= 31.5 and chosen == RADIO and why.startswith("silent for 1")
    both.run(TRIAL_S - 1)
    assert len(both.changes) == 1
    both.run(3)
    assert [chosen for _, chosen, _ in both.changes] == [RADIO, WIFI]


def test_a_link_that_flaps_for_a_minute_is_left_once(both: Both) -> None:
    both.run(30)
    for _ in range(10):
        both.cut(3)
        both.run(3)
    assert [chosen for _, chosen, _ in both.changes] == [RADIO]
    both.run(TRIAL_S + 1)
    assert [chosen for _, chosen, _ in both.changes] == [RADIO, WIFI]


def test_each_fault_soon_after_the_last_makes_the_next_trial_longer_and_two_good_minutes_forgive(both: Both) -> None:
    trials = []
    for good_s in (61, 61, 61, 61, 61, 61, 261):
        both.run(good_s)
        both.cut(3)
        trials.append(both.wifi.health.trial_s())
    assert trials == [TRIAL_S, 20.0, 40.0, 60.0, 60.0, TRIAL_MOST_S, TRIAL_S]


@each("seed", seeds(8))
def test_two_links_that_lose_little_or_the_same_do_not_alternate(seed: int) -> None:
    for loss, changes in ((0.04, 0), (0.2, 1)):
        both = Both(seed)
        both.wifi.loss = both.radio.loss = loss
        both.radio.period_s = 0.05 if changes else both.radio.period_s
        both.run(600)
        assert len(both.changes) <= changes


@each("seed", seeds(5))
def test_a_link_that_loses_a_third_is_left_and_at_risk_before(seed: int) -> None:
    both = Both(seed)
    both.run(30)
    for percent in range(0, 40, 2):
        both.wifi.loss = percent / 100
        both.run(1)
        if both.wifi.health.at_risk(both.now):
            break
    assert both.changes == [], "what the other link needs is restored before it is used"
    both.wifi.loss = 0.33
    both.run(10)
    ((_, chosen, why),) = both.changes
    assert chosen == RADIO and why.endswith("of its frames are lost")
    both.run(120)
    assert len(both.changes) == 1


def test_of_two_poor_links_the_one_that_loses_far_less_is_used(both: Both) -> None:
    both.radio.period_s = 0.05
    both.wifi.loss, both.radio.loss = 0.5, 0.2
    both.run(60)
    assert both.chosen == RADIO and len(both.changes) == 1


def test_a_link_that_falls_behind_is_left(both: Both) -> None:
    both.run(30)
    both.wifi.lag_s = 1.2
    both.run(3)
    assert [change[1:] for change in both.changes] == [(RADIO, "it is 1.2 s behind")]


def test_nothing_is_chosen_that_is_not_shown_to_be_the_same_vehicle(both: Both) -> None:
    both.run(30)
    both.cut(2)
    down, radio = both.wifi.health, both.radio.health
    assert down.health is Health.DOWN
    assert LinkChoice().decide(down, {RADIO: radio}, lambda _: False, both.now) is None


def test_with_both_links_down_the_choice_stays_and_the_first_to_return_is_used(both: Both) -> None:
    both.run(30)
    both.wifi.up = both.radio.up = False
    both.run(60)
    assert len(both.changes) <= 1
    both.wifi.up = True
    both.run(2)
    assert both.chosen == WIFI


def test_a_slow_link_has_a_longer_limit_of_silence_than_a_fast_one(both: Both) -> None:
    both.run(30)
    assert both.wifi.health.silent_limit_s == 1.0
    assert 1.4 <= both.radio.health.silent_limit_s <= 2.5
    assert LinkHealth(0.0).silent_limit_s == 2.5, "of one that is not known yet"


def test_a_restarted_counter_is_no_loss_and_memory_is_bounded() -> None:
    link = LinkHealth(0.0, known_good=True)
    for n in range(10_000):
        now = n * 0.1
        link.heard(now)
        link.sample(n % 1000, 0, now)
        assert link.assess(now) is Health.GOOD
    assert link.loss == 0.0


def test_a_deaf_link_is_left_at_once_though_its_telemetry_comes_and_is_taken_again_after_an_answer(both: Both) -> None:
    both.run(60)
    both.wifi.health.deaf = True
    both.run(0.2)
    assert both.changes == [(60.2, RADIO, "the vehicle does not hear us over it")]
    both.run(120)
    assert len(both.changes) == 1 and both.wifi.health.health is Health.POOR
    both.wifi.health.deaf = False
    both.run(TRIAL_S - 1)
    assert both.chosen == RADIO
    both.run(2)
    assert both.chosen == WIFI and len(both.changes) == 2


def test_a_deaf_link_is_left_for_one_on_trial_and_not_for_one_that_is_deaf_or_down(both: Both) -> None:
    both.run(5)
    assert both.radio.health.health is Health.TRIAL
    both.radio.health.deaf = True
    both.wifi.health.deaf = True
    both.run(5)
    assert both.chosen == WIFI, "both are deaf"
    both.radio.health.deaf = False
    both.run(0.4)
    assert both.chosen == RADIO and both.radio.health.health is not Health.GOOD


def test_a_deaf_link_is_asked_every_two_seconds_while_it_is_heard() -> None:
    link = LinkHealth(0.0)
    assert not link.probe_due(0.0)
    link.deaf = True
    assert [t for t in range(6) if link.probe_due(float(t))] == [0, 2, 4]
    link.assess(10.0)
    assert link.health is Health.DOWN and not link.probe_due(10.0)


def test_changes_are_reported_up_to_a_rate_and_all_are_counted() -> None:
    choice = LinkChoice()
    loud = [choice.changed(float(second)) for second in range(600)]
    assert loud[:REPORTS] == [True] * REPORTS
    assert sum(loud) == pytest.approx(REPORTS + 600 / REPORT_S, abs=1)
    assert choice.changes == 600 and choice.unreported == 600 - sum(loud)
