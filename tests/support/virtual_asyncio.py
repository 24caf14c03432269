"""asyncio's loop in virtual time: nobody waits for a timer, and no time passes while a thread works.

The clock stands still for what the loop itself computes, and for threads: were it to go on with the true time while one
works, the phase of every timer after it would differ between a quiet and a busy machine, and a test that looks between
two of them would pass on one and fail on the other.
"""

from __future__ import annotations

import asyncio
import selectors
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

BLOCKED_S = 60.0
"""Of true time: a thread that is not done by then waits for something that only virtual time could bring. The longest
piece of work in `make test` took less than half a second on a busy machine (none of 1,130 tests waited longer)."""

Ready = list[tuple[selectors.SelectorKey, int]]


class VirtualAsyncio(asyncio.SelectorEventLoop):
    """The loop. Its time begins at 0 and is in whole microseconds, so that 0.1 three times is 0.3."""

    _selector: selectors.BaseSelector

    def __init__(self) -> None:
        super().__init__()
        self._now_us, self._now_s = 0, 0.0
        self._in_threads = 0
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
        future = super().run_in_executor(executor, func, *args)
        self._in_threads += 1
        future.add_done_callback(self._on_thread)
        return future

    def _on_thread(self, _: object) -> None:
        self._in_threads -= 1

    async def shutdown_default_executor(self, *timeout_s: Any) -> None:
        self._in_threads += 1
        try:
            await super().shutdown_default_executor(*timeout_s)
        finally:
            self._in_threads -= 1

    def _select(self, timeout: float | None = None) -> Ready:
        """What is ready to be read or written. If nothing is and nothing is to be run, the clock goes on to the next
        timer, which is ``timeout`` from now. None: there is none, and only somebody else can bring something."""
        ready = self._look(0)
        if ready or timeout == 0:
            return ready
        if self._in_threads and not self.threads_are_stuck:
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
