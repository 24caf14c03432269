"""The difference between the daemon's clock and the page's process'."""

from __future__ import annotations

import pytest

from skygcs.rpc.daemon_clock import SAME_CLOCK_S, DaemonClock


def test_before_an_answer_nothing_is_known() -> None:
    clock = DaemonClock()
    assert clock.ahead_s is None
    for value in (None, "12", True):  # of a daemon of another version
        clock.sample(1.0, value, 2.0)
    assert clock.ahead_s is None


def test_on_one_machine_the_clock_is_the_same_however_late_the_answers_are() -> None:
    clock = DaemonClock()
    for sent_at, read_at, came_at in ((100.0, 107.0, 109.0), (110.0, 110.0, 119.0), (120.0, 128.0, 128.0)):
        clock.sample(sent_at, read_at, came_at)
        assert clock.ahead_s == 0.0


def test_the_grain_of_the_loops_clocks_is_no_difference() -> None:
    clock = DaemonClock()
    clock.sample(100.0, 100.002 + SAME_CLOCK_S / 2, 100.001)
    assert clock.ahead_s == 0.0


def test_another_machines_clock_is_known_the_better_the_quicker_an_answer_was() -> None:
    clock = DaemonClock()
    clock.sample(100.0, 5103.0, 104.0)  # 5000 ahead; 3 s there, 1 s back
    assert clock.ahead_s == pytest.approx(5001.0)
    clock.sample(110.0, 5110.01, 110.02)
    assert clock.ahead_s == pytest.approx(5000.0, abs=0.01)
    clock.sample(120.0, 5125.0, 130.0)
    assert clock.ahead_s == pytest.approx(5000.0, abs=0.01)


def test_a_clock_that_drifts_is_followed_for_a_day() -> None:
    """A quick answer of this morning must not hold for the evening: 50 ppm are 4 s a day."""
    clock = DaemonClock()
    for at in range(0, 86_400, 5):
        clock.sample(at, 5000.0 + (at + 0.02) * (1 + 50e-6), at + (0.03 if at else 0.001))
    assert clock.ahead_s == pytest.approx(5000.0 + 86_400 * 50e-6, abs=0.02)


def test_what_was_known_of_a_clock_stays_while_no_answer_comes() -> None:
    clock = DaemonClock()
    clock.sample(100.0, 5100.0, 100.01)
    clock.sample(160.0, 5400.0, 400.0)  # an answer after four minutes is no comparison
    assert clock.ahead_s == pytest.approx(5000.0, abs=0.01)
