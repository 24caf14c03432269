"""The difference between the daemon's clock and the page's process'."""

from __future__ import annotations

import pytest

from skygcs.web.daemon_clock import SAME_CLOCK_S, DaemonClock


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
