"""The pauses of a back-off."""

from __future__ import annotations

from skygcs.back_off import BackOff


def test_each_pause_is_twice_the_one_before_until_an_attempt_was_a_success() -> None:
    back_off = BackOff(1.0, 30.0, 5.0)
    assert [back_off.after() for _ in range(7)] == [1.0, 2.0, 4.0, 8.0, 16.0, 30.0, 30.0]
    assert back_off.after(4.9) == 30.0
    assert [back_off.after(5.0), back_off.after()] == [1.0, 2.0]
    back_off.reset()
    assert back_off.after() == 1.0
