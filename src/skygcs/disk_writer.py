"""Writing of files beside the loop, for the daemon and the bridge to other stations.

One thread, one bounded queue, one report when the disk is stuck.

Everything that is written while the daemon runs goes through it, but the tlogs (`runtime.recorder`) and logs that are
read from vehicles, which have their own bounds: control traces, the journals of undo, flights and fence tests,
parameters, the clocks of signing.

the disk        what happens
--------------  ---------------------------------------------------------------------------------------------
works           jobs are done in their order
is stuck        one event after `STUCK_S`; further jobs wait until `MAX_JOBS` or `MAX_BYTES` do, then they are
                dropped and counted (`offer`) or refused (`run`); control, orders and routing go on
works again     one event; what waits is written
"""

from __future__ import annotations

import asyncio
import contextlib
import errno
import queue
import threading
import time
from collections import deque
from collections.abc import Callable
from concurrent.futures import Executor, Future
from functools import partial
from typing import Any, TypeVar

from skygcs.events import Event

MAX_JOBS = 1024
MAX_BYTES = 16 << 20
"""Bytes that may wait for the disk: the control traces of 16 vehicles at 50 Hz for 25 s."""

WITHIN_S = 5.0
"""Longest wait for a job whose outcome is needed before an order goes on (`run`)."""

STUCK_S = 2.0
"""A job that takes this long is reported. A card that the kernel throttles takes one second at times."""

LATE_S = 1.0
"""A look that is so late says that this process stood still, and the thread with it."""

CLOSE_S = 2.0
"""The end of the daemon waits for what is unwritten at most so long."""

T = TypeVar("T")


class DiskWriter:
    """One of each daemon. All methods belong to the loop's thread; ``on_event`` gets warnings."""

    def __init__(
        self,
        loop: asyncio.AbstractEventLoop,
        on_event: Callable[[Event], None],
        clock: Callable[[], float] = time.monotonic,
        thread: Executor | None = None,
    ) -> None:
        """``clock``: of the disk, which knows no virtual time. ``thread``: does the jobs, in their order; None: one of
        its own, which is begun with the first job."""
        self._loop = loop
        self._clock = clock
        self._on_event = on_event
        self._thread = WriterThread("disk") if thread is None else thread
        self._waiting: deque[tuple[str, int, float]] = deque()
        """Description of each job, its bytes, and the time at which it was given; the first one is in progress."""
        self._bytes = 0
        self._watch: asyncio.TimerHandle | None = None
        self._look_at = 0.0
        """When the next look is due, in loop time."""
        self._stuck_since: float | None = None
        self._none_waits = asyncio.Event()
        self._none_waits.set()
        self._closed = False
        self._failing: set[str] = set()
        """Descriptions of jobs of `keep` that failed last."""
        self.written = self.failed = self.dropped = 0

    def offer(self, what: str, job: Callable[[], object], size: int = 0) -> asyncio.Future[Any] | None:
        """Do ``job`` when the disk takes it. Returns its outcome to come, whose OSError the caller should report; None
        if it was dropped (and counted) as too much waits."""
        if self._closed or len(self._waiting) >= MAX_JOBS or self._bytes + size > MAX_BYTES:
            self.dropped += 1
            return None
        now = self._clock()
        self._waiting.append((what, size, now))
        self._bytes += size
        self._none_waits.clear()
        if self._watch is None:
            self._look_later()
        done = self._loop.run_in_executor(self._thread, job)
        done.add_done_callback(self._on_done)
        return done

    def keep(self, what: str, job: Callable[[], object], size: int = 0) -> None:
        """`offer` of what nobody waits for. That it cannot be written is reported once until it can be again."""
        done = self.offer(what, job, size)
        if done is not None:
            done.add_done_callback(partial(self._on_kept, what))

    async def run(self, what: str, job: Callable[[], T], size: int = 0, within_s: float = WITHIN_S) -> T:
        """Do ``job`` and return its result. Raises what it raises, and OSError if the disk does not take it within
        ``within_s``: it may still be done later."""
        return await self.outcome(what, self.offer(what, job, size), within_s)

    async def outcome(self, what: str, done: asyncio.Future[T] | None, within_s: float = WITHIN_S) -> T:
        """The result of a job that was given (`offer`), for any number of callers; as `run`."""
        if done is None:
            raise OSError(errno.EBUSY, "too much waits for the disk")
        try:
            async with asyncio.timeout(within_s):
                return await asyncio.shield(done)
        except TimeoutError:
            done.add_done_callback(_ignored)
            raise OSError(errno.ETIMEDOUT, f"the disk does not accept it ({what})") from None

    async def settled(self) -> None:
        """Wait until nothing is unwritten, CLOSE_S at most; what is given meanwhile counts."""
        with contextlib.suppress(TimeoutError):
            async with asyncio.timeout(CLOSE_S):
                await self._none_waits.wait()

    async def close(self) -> None:
        """Wait for what is unwritten, CLOSE_S at most; nothing is taken after this. Idempotent."""
        self._closed = True
        await self.settled()
        self._thread.shutdown(wait=False)
        if self._watch is not None:
            self._watch.cancel()
            self._watch = None
        if self._waiting:
            names = ", ".join(sorted({what for what, _, _ in self._waiting})[:5])
            self._report(f"{len(self._waiting)} files or parts of files are unwritten, as the disk is stuck: {names}")
            self._waiting.clear()

    def status(self) -> dict[str, Any]:
        """JSON-able."""
        return {
            "written": self.written,
            "failed": self.failed,
            "dropped": self.dropped,
            "waiting": len(self._waiting),
            "waiting_bytes": self._bytes,
            "stuck": self._stuck_since is not None,
        }

    def _on_done(self, done: asyncio.Future[Any]) -> None:
        if not self._waiting:  # after `close`
            return
        _, size, _ = self._waiting.popleft()
        self._bytes -= size
        failed = done.cancelled() or done.exception() is not None
        self.written, self.failed = self.written + (not failed), self.failed + failed
        if self._waiting:
            what, more, _ = self._waiting[0]
            self._waiting[0] = (what, more, self._clock())
        else:
            self._none_waits.set()
        since, self._stuck_since = self._stuck_since, None
        if since is not None:
            seconds = self._clock() - since
            text = f"the disk takes files again after {seconds:.0f} s; {self.dropped} writes were dropped so far"
            self._report(text, seconds=round(seconds, 1), dropped=self.dropped)

    def _on_kept(self, what: str, done: asyncio.Future[Any]) -> None:
        error = None if done.cancelled() else done.exception()
        if error is None:
            self._failing.discard(what)
        elif what not in self._failing:
            self._failing.add(what)
            why = getattr(error, "strerror", None) or error
            self._report(f"{what} cannot be written: {why}; everything else goes on", what=what)

    def _look(self) -> None:
        """Report a job that takes long, once; go on looking while any waits."""
        self._watch = None
        if not self._waiting:
            return
        what, size, since = self._waiting[0]
        if self._loop.time() - self._look_at > LATE_S and self._stuck_since is None:
            since = self._clock()  # the disk gets its time from now on
            self._waiting[0] = (what, size, since)
        if self._stuck_since is None and self._clock() - since >= STUCK_S:
            self._stuck_since = since
            self._report(f"the disk is stuck: {what} is not written; everything else goes on", what=what)
        self._look_later()

    def _look_later(self) -> None:
        self._look_at = self._loop.time() + STUCK_S
        self._watch = self._loop.call_later(STUCK_S, self._look)

    def _report(self, text: str, **data: Any) -> None:
        self._on_event(Event("warning", None, None, text, data))


def _ignored(done: asyncio.Future[Any]) -> None:
    """Take the exception of a job that nobody waits for any more."""
    if not done.cancelled():
        done.exception()


class WriterThread(Executor):
    """One daemon thread, begun with the first job: jobs in their order. For `loop.run_in_executor`; its owner bounds
    what waits.

    `concurrent.futures` and asyncio's own threads are joined at the end of the interpreter, so one write that never
    returns would keep the process for ever.
    """

    def __init__(self, name: str) -> None:
        self._name = name
        self._jobs: queue.SimpleQueue[tuple[Future[Any], Callable[[], Any]] | None] = queue.SimpleQueue()
        self._thread: threading.Thread | None = None
        self._closed = False

    def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future[Any]:
        """Raises RuntimeError after `shutdown`."""
        if self._closed:
            raise RuntimeError(f"the thread {self._name} is closed")
        if self._thread is None:
            self._thread = threading.Thread(target=self._work, name=self._name, daemon=True)
            self._thread.start()
        future: Future[Any] = Future()
        self._jobs.put((future, lambda: fn(*args, **kwargs)))
        return future

    def shutdown(self, wait: bool = False, *, cancel_futures: bool = False) -> None:
        """Take no more jobs; those that wait are done. Never waits."""
        if not self._closed:
            self._closed = True
            self._jobs.put(None)

    def _work(self) -> None:
        while (job := self._jobs.get()) is not None:
            future, call = job
            if not future.set_running_or_notify_cancel():
                continue
            try:
                result = call()
            except BaseException as error:
                future.set_exception(error)
            else:
                future.set_result(result)
            del job, future, call
