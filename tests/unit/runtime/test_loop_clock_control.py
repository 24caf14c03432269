"""Ticks on absolute deadlines: late ones do not move the next, missed ones are skipped and counted."""

from __future__ import annotations

import asyncio
from collections.abc import Callable

import pytest

from skygcs.runtime.loop_clock import LATE_S, TICKS_KEPT, ControlClock
from support.table import each


class Deadlines:
    """What a clock asks of a loop, with time that passes only when a test lets it."""

    class Handle:
        def __init__(self, when: float, callback: Callable[[], None]) -> None:
            self.when, self.callback, self.cancelled = when, callback, False

        def cancel(self) -> None:
            self.cancelled = True

    def __init__(self) -> None:
        self.now = 100.0
        self.waiting: list[Deadlines.Handle] = []

    def time(self) -> float:
        return self.now

    def call_at(self, when: float, callback: Callable[[], None]) -> Deadlines.Handle:
        handle = self.Handle(when, callback)
        self.waiting.append(handle)
        return handle

    def due(self) -> list[float]:
        return [handle.when for handle in self.waiting if not handle.cancelled]

    def run(self, late_s: float = 0.0) -> None:
        """To the next deadline, and so much past it."""
        self.waiting = [handle for handle in self.waiting if not handle.cancelled]
        handle = min(self.waiting, key=lambda h: h.when)
        self.waiting.remove(handle)
        self.now = max(self.now, handle.when + late_s)
        handle.callback()


class Ticked:
    def __init__(self, period_s: float = 0.02, phase: float = 0.0) -> None:
        self.loop = Deadlines()
        self.period_s = period_s
        self.at: list[float] = []
        self.on_tick: Callable[[], None] = lambda: None
        self.clock = ControlClock(self.loop, self._tick, lambda: self.period_s, phase=phase)  # type: ignore[arg-type]  # all it uses

    def _tick(self, now: float) -> None:
        self.at.append(now - 100.0)
        self.on_tick()


@pytest.fixture
def ticked() -> Ticked:
    return Ticked()


def test_the_first_tick_comes_at_once_and_the_rest_a_period_apart(ticked: Ticked) -> None:
    assert not ticked.clock.running
    ticked.clock.start()
    assert ticked.clock.running
    for _ in range(4):
        ticked.loop.run()
    assert ticked.at == pytest.approx([0.0, 0.02, 0.04, 0.06])
    assert ticked.clock.as_dict() == {"ticks": 4, "late": 0, "skipped": 0, "lateness_p99_s": 0.0}


@each(("period_s", "first_s"), [(0.02, 0.01), (0.2, 0.025)])
def test_clocks_started_together_are_spread_over_a_short_while(period_s: float, first_s: float) -> None:
    ticked = Ticked(period_s)
    clock = ControlClock(ticked.loop, ticked._tick, lambda: period_s, phase=0.5)  # type: ignore[arg-type]  # all it uses
    clock.start()
    for _ in range(3):
        ticked.loop.run()
    assert ticked.at == pytest.approx([first_s, first_s + period_s, first_s + 2 * period_s])
    assert (clock.late, clock.skipped) == (0, 0)


@each(("period_s", "first_s"), [(0.02, 0.005), (0.2, 0.0125)])
def test_clocks_of_other_phases_tick_one_after_the_other(period_s: float, first_s: float) -> None:
    ticked = Ticked(period_s, phase=0.25)
    ticked.clock.start()
    for _ in range(2):
        ticked.loop.run()
    assert ticked.at == pytest.approx([first_s, first_s + period_s])


def test_a_late_tick_does_not_move_the_next(ticked: Ticked) -> None:
    ticked.clock.start()
    ticked.loop.run()
    ticked.loop.run(late_s=0.009)
    ticked.loop.run()
    assert ticked.at == pytest.approx([0.0, 0.029, 0.04])
    assert (ticked.clock.late, ticked.clock.skipped) == (1, 0)


def test_lateness_of_always_a_little_does_not_add_up(ticked: Ticked) -> None:
    ticked.clock.start()
    for _ in range(501):
        ticked.loop.run(late_s=0.004)
    assert ticked.at[-1] == pytest.approx(500 * 0.02 + 0.004)
    assert ticked.clock.late == 0 < LATE_S


def test_deadlines_that_have_passed_are_skipped_counted_and_not_made_up_for(ticked: Ticked) -> None:
    ticked.clock.start()
    ticked.loop.run()
    ticked.loop.run(late_s=0.05)  # at 0.07: those of 0.04 and 0.06 are over
    ticked.loop.run()
    assert ticked.at == pytest.approx([0.0, 0.07, 0.08])
    assert (ticked.clock.ticks, ticked.clock.late, ticked.clock.skipped) == (3, 1, 2)


def test_a_suspended_process_skips_without_a_burst(ticked: Ticked) -> None:
    ticked.clock.start()
    ticked.loop.run()
    ticked.loop.run(late_s=3600.0)
    assert ticked.clock.skipped == 180_000 and len(ticked.loop.due()) == 1
    assert ticked.loop.due()[0] - ticked.loop.now <= 0.02


def test_each_tick_sets_one_timer_whatever_rounding_does_to_its_deadline() -> None:
    ticked = Ticked(1 / 50)
    ticked.loop.now = 13_941.719  # where now + period - now is above the period by a rounding
    assert ticked.loop.now + 1 / 50 - ticked.loop.now > 1 / 50
    ticked.clock.start()
    set_at: list[float] = []
    call_at = ticked.loop.call_at

    def counted(when: float, callback: Callable[[], None]) -> Deadlines.Handle:
        set_at.append(when)
        return call_at(when, callback)

    ticked.loop.call_at = counted  # type: ignore[method-assign]
    for _ in range(100):
        ticked.loop.run()
    assert len(set_at) == 100


def test_goes_on_after_a_tick_that_failed(ticked: Ticked) -> None:
    ticked.clock.start()

    def fail() -> None:
        raise RuntimeError("a tick must not")

    ticked.on_tick = fail
    with pytest.raises(RuntimeError):
        ticked.loop.run()
    ticked.on_tick = lambda: None
    ticked.loop.run()
    assert ticked.at == pytest.approx([0.0, 0.02])


def test_a_slower_period_holds_from_the_next_tick_on_a_faster_one_at_once() -> None:
    ticked = Ticked(0.02)
    ticked.clock.start()
    ticked.loop.run()

    def slower() -> None:
        ticked.period_s = 0.2

    ticked.on_tick = slower
    for _ in range(3):
        ticked.loop.run()
    assert ticked.at == pytest.approx([0.0, 0.02, 0.04, 0.24])

    def faster() -> None:
        ticked.period_s = 0.02

    ticked.on_tick = faster
    for _ in range(3):
        ticked.loop.run()
    assert ticked.at[-3:] == pytest.approx([0.44, 0.46, 0.48])
    assert ticked.clock.skipped == 0 and len(ticked.loop.due()) == 1


def test_a_tick_may_stop_the_clock(ticked: Ticked) -> None:
    ticked.on_tick = ticked.clock.stop
    ticked.clock.start()
    ticked.loop.run()
    assert not ticked.clock.running and ticked.loop.due() == []
    ticked.clock.stop()  # idempotent


def test_a_tick_may_stop_and_start_it_without_a_second_clock_running(ticked: Ticked) -> None:

    def restart() -> None:
        ticked.on_tick = lambda: None
        ticked.clock.stop()
        ticked.clock.start()

    ticked.on_tick = restart
    ticked.clock.start()
    ticked.loop.run()
    assert len(ticked.loop.due()) == 1
    ticked.loop.run()
    ticked.loop.run()
    assert ticked.at == pytest.approx([0.0, 0.0, 0.02])


def test_starting_twice_is_starting_once_and_a_restart_is_not_late(ticked: Ticked) -> None:
    ticked.clock.start()
    ticked.clock.start()
    assert len(ticked.loop.due()) == 1
    ticked.loop.run()
    ticked.clock.stop()
    ticked.loop.now += 60.0
    ticked.clock.start()
    ticked.loop.run()
    assert (ticked.clock.ticks, ticked.clock.late, ticked.clock.skipped) == (2, 0, 0)


def test_a_clock_is_among_the_running_ones_while_it_runs_and_tells_when_it_is_due() -> None:
    loop = Deadlines()
    running: set[ControlClock] = set()
    clock = ControlClock(loop, lambda now: None, lambda: 0.02, running_clocks=running)  # type: ignore[arg-type]
    assert not running
    clock.start()
    assert running == {clock} and clock.due == 100.0
    loop.now += 0.005
    assert clock.due == 100.0  # it is late
    loop.run()
    assert running == {clock} and clock.due == pytest.approx(100.02)
    clock.stop()
    assert not running


def test_of_the_last_ticks_the_99th_percentile_of_lateness_is_told(ticked: Ticked) -> None:
    assert ticked.clock.lateness_p99_s() is None and ticked.clock.as_dict()["lateness_p99_s"] is None
    ticked.clock.start()
    for i in range(TICKS_KEPT):
        ticked.loop.run(late_s=0.003 if i % 50 == 0 else 0.0)
    assert ticked.clock.lateness_p99_s() == pytest.approx(0.003)
    for _ in range(TICKS_KEPT):
        ticked.loop.run()
    assert ticked.clock.lateness_p99_s() == pytest.approx(0.0)


@pytest.mark.looptime
async def test_on_a_real_loop_it_ticks_fifty_times_a_second() -> None:
    loop = asyncio.get_running_loop()
    at: list[float] = []
    clock = ControlClock(loop, at.append, lambda: 0.02)
    clock.start()
    await asyncio.sleep(10.01)
    clock.stop()
    await asyncio.sleep(1)
    assert len(at) == 501 == clock.ticks and clock.skipped == 0
    assert at[-1] - at[0] == pytest.approx(10.0)
