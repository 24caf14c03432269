"""One request to plan at a time, one of each client, a bounded queue; cancelled with its client or by its number."""

from __future__ import annotations

import asyncio
from typing import Any

import pytest

from skygcs.errors import RefusedError
from skygcs.ext.plans.planning.planning_queue import MAX_WAITING, PlanningQueue
from skygcs.ext.plans.planning.process import OnProgress, PlanningFailed, ProcessLimits
from support.table import each


class Computer:
    """In place of the process: answers when it is let."""

    def __init__(self) -> None:
        self.running: list[bytes] = []
        self.most = 0
        self.ended: list[bytes] = []
        self.go = asyncio.Event()
        self.fails: Exception | None = None

    async def __call__(self, request: bytes, on_progress: OnProgress | None, limits: ProcessLimits) -> bytes:
        self.running.append(request)
        self.most = max(self.most, len(self.running))
        try:
            if on_progress is not None:
                on_progress({"what": "layers", "done": 0, "total": 3})
            await self.go.wait()
            if self.fails is not None:
                raise self.fails
            return request
        finally:
            self.running.remove(request)
            self.ended.append(request)


def queue_of(computer: Computer) -> PlanningQueue:
    return PlanningQueue(asyncio.get_running_loop(), computer)


async def settle() -> None:
    for _ in range(5):
        await asyncio.sleep(0)


async def test_one_is_computed_at_a_time_in_the_order_in_which_they_came() -> None:
    computer = Computer()
    queue = queue_of(computer)
    tasks = [asyncio.create_task(queue.run(client, "make", {"n": client})) for client in range(4)]
    await settle()
    assert [job["state"] for job in queue.status()] == ["running", "waiting", "waiting", "waiting"]
    assert queue.status()[0]["progress"] == {"what": "layers", "done": 0, "total": 3}
    computer.go.set()
    assert await asyncio.gather(*tasks) == [b'{"n":0}', b'{"n":1}', b'{"n":2}', b'{"n":3}']
    assert computer.most == 1 and computer.ended == [b'{"n":0}', b'{"n":1}', b'{"n":2}', b'{"n":3}']
    assert queue.counters.answered == 4 and queue.status() == []


async def test_a_client_has_one_request_and_the_queue_a_bound() -> None:
    computer = Computer()
    queue = queue_of(computer)
    tasks = [asyncio.create_task(queue.run(client, "make", {})) for client in range(MAX_WAITING + 1)]
    await settle()
    with pytest.raises(RefusedError, match="this client has a request"):
        await queue.run(0, "make", {})
    with pytest.raises(RefusedError, match="not finished yet"):
        await queue.run("another", "make", {})
    assert queue.counters.turned_away == 2
    computer.go.set()
    await asyncio.gather(*tasks)
    await queue.run(0, "make", {})


async def test_a_client_that_leaves_ends_its_request_and_the_next_one_begins() -> None:
    computer = Computer()
    queue = queue_of(computer)
    first, second = (asyncio.create_task(queue.run(client, "make", {"n": client})) for client in "ab")
    await settle()
    first.cancel()
    await settle()
    assert first.cancelled() and computer.running == [b'{"n":"b"}']
    computer.go.set()
    assert await second == b'{"n":"b"}' and queue.counters.cancelled == 1


@each("which", ["running", "waiting"])
async def test_a_request_is_cancelled_by_its_client_or_its_number(which: str) -> None:
    computer = Computer()
    queue = queue_of(computer)
    told: list[dict[str, Any]] = []
    first = asyncio.create_task(queue.run("a", "make", {}, told.append))
    second = asyncio.create_task(queue.run("b", "make", {}))
    await settle()
    assert told == [{"job": 1, "what": "layers", "done": 0, "total": 3}]
    assert queue.cancel(client="nobody") == [] and queue.cancel(number=99) == []
    assert (queue.cancel(client="a") if which == "running" else queue.cancel(number=2)) == [
        1 if which == "running" else 2
    ]
    with pytest.raises(RefusedError, match="was cancelled"):
        await (first if which == "running" else second)
    computer.go.set()
    await (second if which == "running" else first)


async def test_a_broken_process_is_counted_and_the_next_request_is_answered() -> None:
    computer = Computer()
    queue = queue_of(computer)
    computer.fails = PlanningFailed("the planning process ended with code 1")
    computer.go.set()
    with pytest.raises(PlanningFailed):
        await queue.run("a", "make", {})
    computer.fails = None
    assert await queue.run("a", "make", {}) == b"{}"
    assert (queue.counters.failed, queue.counters.answered) == (1, 1)


async def test_the_end_of_the_daemon_ends_all() -> None:
    computer = Computer()
    queue = queue_of(computer)
    tasks = [asyncio.create_task(queue.run(client, "make", {})) for client in range(3)]
    await settle()
    queue.close()
    assert all(isinstance(end, RefusedError) for end in await asyncio.gather(*tasks, return_exceptions=True))
    assert computer.running == []
