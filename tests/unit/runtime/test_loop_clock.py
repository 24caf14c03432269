"""One timer for several deadlines: the last `set` counts, and each ring is one."""

from __future__ import annotations

import asyncio

import pytest

from skygcs.runtime.loop_clock import DeadlineTimer

pytestmark = pytest.mark.looptime


class Rings:
    def __init__(self) -> None:
        self.loop = asyncio.get_running_loop()
        self.began = self.loop.time()
        self.at: list[float] = []
        self.next: list[float] = []
        self.alarm = DeadlineTimer(self.loop, self.ring)

    def ring(self) -> None:
        self.at.append(round(self.loop.time() - self.began, 3))
        if self.next:
            self.alarm.set(self.began + self.next.pop(0))


async def test_it_rings_once_at_the_time_it_was_set_for_last() -> None:
    rings = Rings()
    for due in (5.0, 1.0, 3.0, 3.0):
        rings.alarm.set(rings.began + due)
    await asyncio.sleep(10.0)
    assert rings.at == [3.0] and rings.alarm.due is None


async def test_set_for_nothing_it_does_not_ring() -> None:
    rings = Rings()
    rings.alarm.set(rings.began + 1.0)
    rings.alarm.set(None)
    rings.alarm.set(None)
    await asyncio.sleep(10.0)
    assert rings.at == []


async def test_it_may_be_set_anew_as_it_rings_also_for_a_time_that_has_come() -> None:
    rings = Rings()
    rings.next = [1.0, 4.0]
    rings.alarm.set(rings.began + 1.0)
    await asyncio.sleep(10.0)
    assert rings.at == [1.0, 1.0, 4.0]


@pytest.mark.parametrize("ahead_s", [-1.0, 0.0, 0.0002, 0.0004])
async def test_a_time_that_is_due_or_nearly_due_may_be_read_and_set_again(ahead_s: float) -> None:
    """uvloop gives no timer for these, but a plain Handle without a time."""
    rings = Rings()
    due = rings.began + ahead_s
    rings.alarm.set(due)
    rings.alarm.set(due)
    assert rings.alarm.due == due
    await asyncio.sleep(1.0)
    assert len(rings.at) == 1 and rings.alarm.due is None
    rings.alarm.set(due)
    rings.alarm.set(None)
    await asyncio.sleep(1.0)
    assert len(rings.at) == 1


@pytest.mark.parametrize("ahead_s", [0.0003, 0.0104, 1.00049])
async def test_it_never_rings_before_its_time(ahead_s: float) -> None:
    """uvloop rounds a delay to whole milliseconds."""
    rings = Rings()
    due = rings.began + ahead_s
    early: list[float] = []
    rings.alarm = DeadlineTimer(rings.loop, lambda: early.append(due - rings.loop.time()))
    rings.alarm.set(due)
    await asyncio.sleep(2.0)
    assert len(early) == 1 and -0.01 < early[0] <= 1e-9
