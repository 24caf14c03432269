"""asyncio's loop in virtual time (looptime), in which no time passes while a thread works.

looptime lets its clock go on with the true time while work in a thread is under way. What then differs between a quiet
and a busy machine is the phase of every timer after it: a test that looks between two of them passes on one and fails
on the other. Here the clock stands still until the thread is done, as it does for what the loop itself computes.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import SimpleNamespace
from typing import Any

from looptime._internal import loops, plugin

BLOCKED_S = 60.0
"""Of true time: a thread that is not done by then waits for something that only virtual time could bring. The longest
piece of work in `make test` took less than half a second on a busy machine (none of 1,130 tests waited longer)."""

Ready = list[tuple[Any, Any]]


def _makes_loops(fixturedef: Any, request: Any) -> bool:
    return bool(fixturedef.func.__module__ == "pytest_asyncio.plugin")


class _InThreads(set[asyncio.Future[Any]]):
    """What is under way in threads: looptime's own weak set is walked in each of some hundred million turns."""

    def add(self, future: asyncio.Future[Any]) -> None:
        super().add(future)
        future.add_done_callback(self.discard)


def install() -> None:
    """Every loop of looptime that is made from now on stands still while a thread works.

    looptime looks through all of pytest-asyncio's names at each fixture of each test for those that make a loop."""
    loops.weakref = SimpleNamespace(WeakSet=_InThreads)
    plugin._should_patch = _makes_loops
    set_up = loops.LoopTimeEventLoop.setup_looptime

    def setup_looptime(self: Any, **options: Any) -> None:
        first = not hasattr(self, "looptime_on")
        look = self._selector.select
        set_up(self, **options)
        if first:
            self.threads_are_stuck = False
            self._selector.select = _threads_first(self, look, self._selector.select)

    loops.LoopTimeEventLoop.setup_looptime = setup_looptime


@contextmanager
def stuck_threads() -> Iterator[None]:
    """A test that holds a thread up on purpose: until the end of the block the clock goes on without threads, with the
    true time, as looptime has it."""
    loop: Any = asyncio.get_running_loop()
    loop.threads_are_stuck = True
    try:
        yield
    finally:
        loop.threads_are_stuck = False


def _threads_first(loop: Any, look: Callable[[float], Ready], pass_time: Callable[[Any], Ready]) -> Any:
    def select(timeout: float | None) -> Ready:
        if timeout != 0 and loop.looptime_on and not loop.threads_are_stuck:
            in_threads: set[asyncio.Future[Any]] = loop._LoopTimeEventLoop__sync_futures
            if any(not future.done() for future in in_threads):
                if ready := look(BLOCKED_S):
                    return ready
                raise TimeoutError(
                    f"a thread was not done after {BLOCKED_S:g} s: no virtual time passes while one works"
                )
        return pass_time(timeout)

    return select
