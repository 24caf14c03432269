"""No virtual time passes while a thread works, on either loop: how long it takes is no matter of a test, and neither is
how long the machine computes."""

from __future__ import annotations

import asyncio
import socket
import threading
import time
from collections.abc import Iterator

import pytest

from skygcs.runtime.task_set import in_short_turns
from support.virtual_asyncio import BUSY_TURNS
from support.virtual_uvloop import VirtualUvloop


async def timers_during_a_thread() -> tuple[float, int]:
    """Virtual time that passed while a thread worked for a tenth of a second of true time, and ticks in it."""
    loop, ticks = asyncio.get_running_loop(), 0

    async def tick() -> None:
        nonlocal ticks
        while True:
            await asyncio.sleep(0.01)
            ticks += 1

    ticking = asyncio.create_task(tick())
    await asyncio.sleep(0)
    begun = loop.time()
    await asyncio.to_thread(time.sleep, 0.1)
    passed_s, ticked = loop.time() - begun, ticks
    await asyncio.sleep(1.0)
    ticking.cancel()
    assert ticks >= 99, "it goes on afterwards"
    return passed_s, ticked


async def ends_of_threads() -> list[float]:
    """True seconds of two threads in the order in which the loop learns of their ends."""
    ended = []

    async def work(true_s: float) -> None:
        await asyncio.to_thread(time.sleep, true_s)
        ended.append(true_s)

    await asyncio.gather(work(0.05), work(0.0))
    return ended


async def looks_until_a_thread_ends() -> None:
    """A task that yields until a thread is done, so that the loop always has something to run, waited for ever."""
    thread, looks = asyncio.get_running_loop().run_in_executor(None, time.sleep, 0.01), 0
    while not thread.done():
        await asyncio.sleep(0)
        looks += 1
        assert looks < 3 * BUSY_TURNS


@pytest.mark.looptime
async def test_the_clock_of_asyncio_stands_still_and_threads_end_as_they_began() -> None:
    assert await timers_during_a_thread() == (0.0, 0)
    assert await ends_of_threads() == [0.05, 0.0]
    await looks_until_a_thread_ends()


def test_the_clock_of_uvloop_stands_still_and_threads_end_as_they_began() -> None:
    with asyncio.Runner(loop_factory=VirtualUvloop) as runner:
        assert runner.run(timers_during_a_thread()) == (0.0, 0)
        assert runner.run(ends_of_threads()) == [0.05, 0.0]
        runner.run(looks_until_a_thread_ends())


@pytest.mark.looptime
async def test_how_long_the_machine_computes_gives_nobody_a_turn() -> None:
    turns: list[None] = []
    asyncio.get_running_loop().call_soon(turns.append, None)

    def work() -> Iterator[None]:
        begun = time.thread_time()
        while time.thread_time() - begun < 0.002:
            pass
        yield
        assert not turns

    await in_short_turns(work())


@pytest.mark.looptime
async def test_its_time_begins_at_0_and_goes_on_exactly_and_always() -> None:
    loop = asyncio.get_running_loop()
    assert loop.time() == 0.0
    for _ in range(3):
        await asyncio.sleep(0.1)
    assert loop.time() == 0.3
    with pytest.raises(TimeoutError):
        async with asyncio.timeout(1e-7):  # shorter than its microseconds: it passes all the same
            await asyncio.sleep(86_400.0)
    assert loop.time() < 0.31


@pytest.mark.looptime
async def test_what_is_read_comes_before_the_next_timer() -> None:
    ours, theirs = socket.socketpair()
    with ours, theirs:
        ours.setblocking(False)
        theirs.sendall(b"here")
        async with asyncio.timeout(0.001):
            assert await asyncio.get_running_loop().sock_recv(ours, 9) == b"here"


@pytest.mark.looptime
async def test_a_thread_that_waits_for_virtual_time_is_an_error(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("support.virtual_asyncio.BLOCKED_S", 0.05)
    over = threading.Event()
    waiting = asyncio.get_running_loop().run_in_executor(None, over.wait)
    try:
        with pytest.raises(TimeoutError, match="no virtual time passes"):
            asyncio.get_running_loop()._selector.select(1.0)  # type: ignore[attr-defined]
    finally:
        over.set()
        await waiting
