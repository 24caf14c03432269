"""Background work is kept until it is done, told of when it fails, and ended with its owner."""

from __future__ import annotations

import asyncio
import gc

import pytest

from skygcs.events import Event
from skygcs.runtime.task_set import OneATurn, TaskSet, fault

pytestmark = pytest.mark.looptime


async def test_an_errand_nobody_holds_outlives_the_collector_and_is_forgotten_when_done() -> None:
    tasks, done = TaskSet(asyncio.get_running_loop(), lambda event: None), []

    async def work() -> None:
        await asyncio.sleep(1.0)
        done.append(True)

    tasks.start(work(), "look")
    await asyncio.sleep(0)
    gc.collect()
    assert len(tasks) == 1
    await asyncio.sleep(2.0)
    assert done == [True] and len(tasks) == 0


@pytest.mark.parametrize(("name", "sysid", "reported"), [(None, None, "look"), ("alpha", 7, "alpha look")])
async def test_a_fault_of_ours_is_told_with_whose_errand_it_was(
    name: str | None, sysid: int | None, reported: str
) -> None:
    events: list[Event] = []
    tasks = TaskSet(asyncio.get_running_loop(), events.append, name, sysid)

    async def work() -> None:
        raise RuntimeError("a bug")

    tasks.start(work(), "look")
    await asyncio.sleep(0.1)
    (event,) = events
    assert (event.kind, event.vehicle, event.sysid) == ("fault", name, sysid)
    assert event.text == f"{reported} failed inside skygcs: RuntimeError('a bug')"


async def test_close_cancels_what_is_under_way_and_tells_nothing() -> None:
    events: list[Event] = []
    tasks = TaskSet(asyncio.get_running_loop(), events.append)
    task = tasks.start(asyncio.sleep(60.0), "wait")
    await asyncio.sleep(0)
    tasks.close()
    await asyncio.gather(task, return_exceptions=True)
    await asyncio.sleep(0)
    assert task.cancelled() and len(tasks) == 0 and events == []
    assert fault(task) is None


async def test_of_those_that_wait_for_a_turn_one_goes_on_in_each() -> None:
    turn, turns, went_on = OneATurn(), 0, []

    async def count() -> None:
        nonlocal turns
        while len(went_on) < 20:
            turns += 1
            await asyncio.sleep(0)

    async def work() -> None:
        await turn.wait()
        went_on.append(turns)

    counting = asyncio.create_task(count())
    works = [asyncio.create_task(work()) for _ in range(21)]
    await asyncio.sleep(0)
    works[3].cancel()
    await asyncio.gather(*works, counting, return_exceptions=True)
    assert len(went_on) == len(set(went_on)) == 20
