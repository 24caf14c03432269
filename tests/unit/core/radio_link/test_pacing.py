"""The rate up into a radio: by its rates alone, and by its reports without the swing of the autopilots' own laws."""

from __future__ import annotations

from collections.abc import Callable

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from skygcs.core.radio_link.capacity import SLOT_BYTES, RadioRates, round_s
from skygcs.core.radio_link.pacing import (
    BUFFER_BYTES,
    HISTORY,
    LEAST_SHARE,
    STALE_AFTER_S,
    Pacer,
    RadioReport,
    report_of,
)
from support.examples import examples


def report(at: float, free: float) -> RadioReport:
    return RadioReport(at, free, 190, 180, 60, 58, 0, 0)


class Radio:
    """A transmit buffer that empties at a rate, in slots of a round, and what is paced into it."""

    def __init__(self, capacity: float, buffer_bytes: int, every_s: float) -> None:
        self.capacity = capacity
        self.buffer_bytes = buffer_bytes
        self.every_s = every_s
        self.held = 0.0
        self.sent = 0.0
        self.lost = 0.0
        self.levels: list[float] = []
        self.rates: list[float] = []

    def run(self, rate: Callable[[float], float], report: Callable[[float, float], None], seconds: float) -> None:
        """Saturated: as much is sent as the rate allows."""
        step_s, next_slot, next_report = 0.05, self.every_s, 1.0
        for n in range(int(seconds / step_s)):
            now = n * step_s
            allowed = rate(now)
            self.sent += allowed * step_s
            self.held += allowed * step_s
            if self.held > self.buffer_bytes:
                self.lost += self.held - self.buffer_bytes
                self.held = float(self.buffer_bytes)
            if now >= next_slot:
                self.held = max(0.0, self.held - self.capacity * self.every_s)
                next_slot += self.every_s
            if now >= next_report:
                next_report += 1.0
                report(now, 1 - self.held / self.buffer_bytes)
                self.rates.append(allowed)
                self.levels.append(self.held)


def saturated(capacity: float, buffer_bytes: int, every_s: float, seconds: float = 120.0) -> tuple[Radio, Pacer]:
    radio, pacer = Radio(capacity, buffer_bytes, every_s), Pacer(RadioRates(57600))
    radio.run(pacer.rate, lambda now, free: pacer.on_report(report(now, round(free, 2)), int(radio.sent)), seconds)
    return radio, pacer


@given(st.floats(150, 2800), st.integers(1000, 3000), st.floats(0.05, 0.9))
@settings(max_examples=examples(15), deadline=None)
def test_a_saturated_radio_is_filled_without_loss_and_without_swing(capacity, buffer_bytes, every_s) -> None:
    every_s = min(every_s, 0.35 * buffer_bytes / capacity)  # a slot's worth must leave room in the buffer
    radio, _ = saturated(capacity, buffer_bytes, every_s)
    late = radio.rates[-40:]
    mean = sum(late) / len(late)
    assert mean >= 0.9 * min(capacity, 2880), "it uses what there is"
    assert mean <= 1.05 * capacity
    assert max(late) - min(late) <= 0.75 * mean, "and does not swing"
    assert radio.lost <= 2880 * 6, "what the first seconds lose, before the radio has said a word"


def px4_law(radio: Radio, seconds: float) -> None:
    """The reference (field-notes 8.3), on the same radio."""
    share = 1.0

    def on_report(now: float, free: float) -> None:
        nonlocal share
        share *= 0.8 if free < 0.25 else 0.975 if free < 0.35 else 1.025 if free > 0.5 else 1.0
        share = min(1.0, max(0.01, share))

    radio.run(lambda now: 2880 * share, on_report, seconds)


def test_where_the_reference_law_swings_and_loses_this_one_settles() -> None:
    theirs = Radio(550.0, BUFFER_BYTES, 0.9)
    px4_law(theirs, 300.0)
    ours, _ = saturated(550.0, BUFFER_BYTES, 0.9, 300.0)
    late = slice(-120, None)
    swing = [max(r.rates[late]) - min(r.rates[late]) for r in (theirs, ours)]
    assert swing[0] > 0.5 * 550, "the reference swings on this radio"
    assert swing[1] < 0.5 * swing[0]
    assert ours.lost < theirs.lost
    assert max(ours.levels[late]) < 0.75 * BUFFER_BYTES


def test_without_reports_it_is_paced_by_its_rates() -> None:
    assert Pacer(RadioRates(57600)).rate(0.0) == 2880
    assert Pacer(RadioRates(115200, duty_cycle=0.1)).rate(0.0) == 576
    assert Pacer(RadioRates(57600, uplink_share=0.2)).rate(0.0) == pytest.approx(1152)
    ten = Pacer(RadioRates(57600, 64.0))
    ten.vehicles = 10
    assert ten.rate(0.0) == pytest.approx(0.9 * SLOT_BYTES / round_s(64, 11))
    ten.rates = RadioRates(57600, 64.0, nodes=16)
    assert ten.rate(0.0) == pytest.approx(0.9 * SLOT_BYTES / round_s(64, 16)), "slots are there for silent nodes too"
    fast = Pacer(RadioRates(9600, 250.0))
    assert fast.rate(0.0) == pytest.approx(0.9 * 960), "the port is the narrow place"


def test_when_reports_cease_the_rates_hold_again() -> None:
    pacer = Pacer(RadioRates(57600))
    for n in range(10):
        pacer.on_report(report(float(n), 0.1), n * 200)
    assert pacer.rate(9.0) < 300
    assert pacer.rate(9.0 + STALE_AFTER_S + 0.1) == pacer.base
    assert pacer.status(9.0)["paced_by"] == "reports" and pacer.status(20.0)["paced_by"] == "rates"


def test_one_report_that_comes_as_two_messages_is_one() -> None:
    pacer = Pacer(RadioRates(57600))
    assert pacer.on_report(report(1.0, 0.5), 100)
    assert not pacer.on_report(report(1.01, 0.5), 100)
    assert pacer.on_report(report(2.0, 0.5), 200)
    assert len(pacer.history) == 2


def test_heartbeats_always_get_through_a_jammed_radio() -> None:
    pacer = Pacer(RadioRates(57600))
    for n in range(60):
        pacer.on_report(report(float(n), 0.0), 0)
    assert pacer.rate(59.0) == pytest.approx(LEAST_SHARE * 2880)


def test_an_idle_radio_is_given_its_whole_rate_back() -> None:
    pacer = Pacer(RadioRates(57600))
    for n in range(10):
        pacer.on_report(report(float(n), 0.2), n * 100)
    assert pacer.rate(9.0) < 0.2 * pacer.base
    for n in range(10, 60):
        pacer.on_report(report(float(n), 1.0), 900 + n)
    assert pacer.rate(59.0) == pacer.base


@given(st.lists(st.tuples(st.floats(0, 10), st.integers(0, 255), st.integers(0, 10**6)), max_size=60))
def test_whatever_is_reported_the_rate_is_a_share_of_the_base(reports: list[tuple[float, int, int]]) -> None:
    pacer, now, sent = Pacer(RadioRates(57600)), 0.0, 0
    for pause_s, txbuf, more in reports:
        now, sent = now + pause_s, sent + more
        pacer.on_report(report_of(dict.fromkeys(FIELDS, 0) | {"txbuf": txbuf}, now), sent)
        assert LEAST_SHARE * pacer.base - 1e-9 <= pacer.rate(now) <= pacer.base
    assert len(pacer.history) <= HISTORY


FIELDS = ("rssi", "remrssi", "txbuf", "noise", "remnoise", "rxerrors", "fixed")
