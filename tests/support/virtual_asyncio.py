"""asyncio's loop in virtual time: nobody waits for a timer, and no time passes while a thread works.

The clock stands still for what the loop itself computes, and for threads: were it to go on with the true time while one
works, the phase of every timer after it would differ between a quiet and a busy machine, and a test that looks between
two of them would pass on one and fail on the other. For the same reason ends of threads reach the loop in the order in
which they were begun, and only when it has nothing else to run: at one instant of a lossy network the order of two
frames decides which of them is lost, and with it all that follows.
"""

from __future__ import annotations

import asyncio
import itertools
import selectors
from collections import deque
from collections.abc import Callable, Iterator
from concurrent.futures import Executor, Future, ThreadPoolExecutor, wait
from contextlib import contextmanager
from types import SimpleNamespace
from typing import Any

from skygcs.runtime import task_set

BLOCKED_S = 60.0
"""Of true time: a thread that is not done by then waits for something that only virtual time could bring. The longest
piece of work in `make test` took less than half a second on a busy machine (none of 1,130 tests waited longer)."""

IN_TURN_S = 1.0
"""True time that a finished thread waits for an older one, which may be waiting for it."""

BUSY_TURNS = 1000
"""Turns of a loop that always has something to run, after which the oldest thread is waited for: a task that yields
again and again until a thread is done would wait for ever."""

LOOK_S = 1e-5
"""CPU time that a step of work in short turns is said to take: about what one pair of vehicles takes the monitor."""

Ready = list[tuple[selectors.SelectorKey, int]]


def count_work() -> None:
    """Count the steps of work in short turns (`task_set.in_short_turns`) in this process instead of measuring their CPU
    time. On a busy machine the monitor's next look came later, and other tasks had their turn elsewhere: a vehicle's
    requests went out in another order, other frames were lost, and a vehicle was settled 4 s later."""
    looks = itertools.count()
    task_set.time = SimpleNamespace(thread_time=lambda: next(looks) * LOOK_S)  # type: ignore[assignment]


class ThreadsInTurn:
    """Where a loop's threads work: `hand_over` passes their results on, the oldest first."""

    def __init__(self, wake: Callable[[], None]) -> None:
        self.pool = ThreadPoolExecutor(thread_name_prefix="asyncio")
        self._wake = wake
        self._jobs: deque[tuple[Future[Any], Future[Any]]] = deque()
        """Each piece of work, and the future that the loop sees."""
        self._busy_turns = 0

    def __bool__(self) -> bool:
        """True if there is work that the loop waits for."""
        while self._jobs and self._jobs[0][1].done():  # cancelled
            self._jobs.popleft()
        return bool(self._jobs)

    def submit_to(self, executor: Executor | None, function: Callable[..., Any], *args: Any) -> Future[Any]:
        job = (executor or self.pool).submit(function, *args)
        shown: Future[Any] = Future()
        shown.add_done_callback(lambda _: job.cancel())
        self._jobs.append((job, shown))
        job.add_done_callback(lambda _: self._wake())
        return shown

    def busy_turn(self) -> None:
        """Count a turn in which the loop has something else to run."""
        self._busy_turns += 1
        if self._busy_turns >= BUSY_TURNS and self:
            wait((self._jobs[0][0],), IN_TURN_S)
            self.hand_over(out_of_turn=True)

    def hand_over(self, *, out_of_turn: bool = False) -> bool:
        """Pass on what the oldest has found, or ``out_of_turn`` the oldest that is done; False if it still works."""
        self._busy_turns = 0
        if not self:
            return False
        done = (pair for pair in self._jobs if pair[0].done() and not pair[1].done())
        pair = next(done, None) if out_of_turn else self._jobs[0]
        if pair is None or not pair[0].done():
            return False
        self._jobs.remove(pair)
        job, shown = pair
        if job.cancelled():
            shown.cancel()
            shown.set_running_or_notify_cancel()
        elif (error := job.exception()) is not None:
            shown.set_exception(error)
        else:
            shown.set_result(job.result())
        return True


class VirtualAsyncio(asyncio.SelectorEventLoop):
    """The loop. Its time begins at 0 and is in whole microseconds, so that 0.1 three times is 0.3."""

    _selector: selectors.BaseSelector

    def __init__(self) -> None:
        super().__init__()
        self._now_us, self._now_s = 0, 0.0
        self._threads = ThreadsInTurn(self._wake)
        self.set_default_executor(self._threads.pool)
        self._shuts_down = False
        self.threads_are_stuck = False
        self._look = self._selector.select
        self._selector.select = self._select  # type: ignore[method-assign]

    def time(self) -> float:
        return self._now_s

    def stand_still(self, seconds: float) -> None:
        """The process was stopped for so long: its clock has gone on, its timers are late, and its sockets have
        filled."""
        self._now_us += round(seconds * 1_000_000)
        self._now_s = self._now_us / 1_000_000

    def run_in_executor(self, executor: Any, func: Callable[..., Any], *args: Any) -> asyncio.Future[Any]:  # type: ignore[override]
        return asyncio.wrap_future(self._threads.submit_to(executor, func, *args), loop=self)

    def _wake(self) -> None:
        if not self.is_closed():
            self.call_soon_threadsafe(lambda: None)

    async def shutdown_default_executor(self, *timeout_s: Any) -> None:
        self._shuts_down = True
        try:
            await super().shutdown_default_executor(*timeout_s)
        finally:
            self._shuts_down = False

    def _select(self, timeout: float | None = None) -> Ready:
        """What is ready to be read or written. If nothing is and nothing is to be run, the clock goes on to the next
        timer, which is ``timeout`` from now. None: there is none, and only somebody else can bring something."""
        ready = self._look(0)
        if ready or timeout == 0:
            self._threads.busy_turn()
            return ready
        if self._threads.hand_over(out_of_turn=self.threads_are_stuck):
            return self._look(0)
        if (self._threads or self._shuts_down) and not self.threads_are_stuck:
            if ready := self._look(IN_TURN_S):
                return ready
            if self._threads.hand_over(out_of_turn=True):
                return self._look(0)
            if ready := self._look(BLOCKED_S):
                return ready
            raise TimeoutError(f"a thread was not done after {BLOCKED_S:g} s: no virtual time passes while one works")
        if timeout is None:
            return self._look(None)
        if ready := self._look(0):  # what another socket of this process has just sent may take the kernel a moment
            return ready
        self._now_us += round(timeout * 1_000_000) or 1
        self._now_s = self._now_us / 1_000_000
        return ready


@contextmanager
def stuck_threads() -> Iterator[None]:
    """A test that holds a thread up on purpose: until the end of the block the clock goes on without threads."""
    loop: Any = asyncio.get_running_loop()
    loop.threads_are_stuck = True
    try:
        yield
    finally:
        loop.threads_are_stuck = False
