"""uvloop in virtual time: its own handles, descriptors and millisecond clock, but nobody waits for a timer.

What differs between asyncio's loop and uvloop decides whether timers of ours work: uvloop's clock has whole
milliseconds, a timer that is due or nearly due is a plain Handle without `when`, and a timer may fire up to half a
millisecond early. Here that is uvloop's own code; only the passing of time is ours: when nothing has been ready for
some turns of the loop, the clock goes on to the next timer.
"""

from __future__ import annotations

import asyncio
import heapq
import itertools
from collections.abc import Callable
from contextvars import Context
from time import monotonic
from typing import Any

import uvloop

from support.virtual_asyncio import BLOCKED_S, IN_TURN_S, ThreadsInTurn

IDLE_TURNS = 2
"""Turns of the loop with nothing to do before the clock goes on: descriptors that are ready are read in them."""

NEVER_S = 1e6
"""Of real time: libuv's timer behind a handle does not fire; `_pass_time` runs what it is for."""

LOOK_AGAIN_S = 0.001
"""Of real time, while only a thread or a descriptor can go on."""


class VirtualUvloop(uvloop.Loop):  # type: ignore[misc]  # uvloop has no types
    """The loop. Its time begins at 0."""

    def __init__(self) -> None:
        super().__init__()
        self._now_ms = 0
        self._timers: list[tuple[int, int, asyncio.Handle, Callable[..., Any], tuple[Any, ...], Context | None]] = []
        self._numbers = itertools.count()
        self._scheduled = 0
        """Callbacks that were ever scheduled; unchanged over some turns: nothing is going on."""
        self._seen = -1
        self._idle_turns = 0
        self._threads = ThreadsInTurn(self._wake)
        self.set_default_executor(self._threads.pool)
        self._waits_since: float | None = None

    def time(self) -> float:
        return self._now_ms / 1000

    def stand_still(self, seconds: float) -> None:
        """The process was stopped for so long: its clock has gone on, its timers are late, and its sockets have
        filled."""
        self._now_ms += round(seconds * 1000)

    def call_soon(self, callback: Callable[..., Any], *args: Any, context: Context | None = None) -> Any:
        self._scheduled += 1
        return super().call_soon(callback, *args, context=context)

    def call_soon_threadsafe(self, callback: Callable[..., Any], *args: Any, context: Context | None = None) -> Any:
        self._scheduled += 1
        return super().call_soon_threadsafe(callback, *args, context=context)

    def call_at(self, when: float, callback: Callable[..., Any], *args: Any, context: Context | None = None) -> Any:
        return self.call_later(when - self.time(), callback, *args, context=context)

    def call_later(self, delay: float, callback: Callable[..., Any], *args: Any, context: Context | None = None) -> Any:
        """As uvloop's: in whole milliseconds, and at once, by a plain Handle, if that makes 0."""
        delay_ms = round(max(delay, 0.0) * 1000)
        if delay_ms == 0:
            return self.call_soon(callback, *args, context=context)
        handle = super().call_later(NEVER_S, callback, *args, context=context)
        heapq.heappush(self._timers, (self._now_ms + delay_ms, next(self._numbers), handle, callback, args, context))
        return handle

    def run_in_executor(self, executor: Any, func: Callable[..., Any], *args: Any) -> Any:
        return asyncio.wrap_future(self._threads.submit_to(executor, func, *args), loop=self)

    def _wake(self) -> None:
        if not self.is_closed():
            self.call_soon_threadsafe(lambda: None)

    def run_forever(self) -> None:
        super().call_soon(self._turn)
        super().run_forever()

    def _turn(self) -> None:
        if self._scheduled != self._seen:
            self._seen, self._idle_turns = self._scheduled, 0
        else:
            self._idle_turns += 1
        idle = self._idle_turns >= IDLE_TURNS
        if idle and self._threads:
            self._wait_for_thread()
        elif idle and not self._pass_time():
            super().call_later(LOOK_AGAIN_S, self._turn)
        else:
            if not idle:
                self._threads.busy_turn()
            super().call_soon(self._turn)

    def _wait_for_thread(self) -> None:
        """The clock stands still while one works."""
        true_s = monotonic()
        if self._waits_since is None:
            self._waits_since = true_s
        waited_s = true_s - self._waits_since
        if self._threads.hand_over(out_of_turn=waited_s > IN_TURN_S):
            self._waits_since = None
            super().call_soon(self._turn)
            return
        if waited_s > BLOCKED_S:
            raise TimeoutError(f"a thread was not done after {BLOCKED_S:g} s: no virtual time passes while one works")
        super().call_later(LOOK_AGAIN_S, self._turn)

    def _pass_time(self) -> bool:
        """To the next timer; False without one."""
        timers = self._timers
        while timers and timers[0][2].cancelled():
            heapq.heappop(timers)
        if not timers:
            return False
        self._now_ms = max(self._now_ms, timers[0][0])
        while timers and timers[0][0] <= self._now_ms:
            _, _, handle, callback, args, context = heapq.heappop(timers)
            if not handle.cancelled():
                self.call_soon(_fire, handle, callback, args, context=context)
        return True


def _fire(handle: asyncio.Handle, callback: Callable[..., Any], args: tuple[Any, ...]) -> None:
    """Unless it was cancelled since the clock has reached it; libuv's timer is of no use from now on."""
    if not handle.cancelled():
        handle.cancel()
        callback(*args)
