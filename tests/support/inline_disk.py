"""The disk for virtual time, which waits for no thread: each job is done at once."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from concurrent.futures import Executor, Future
from typing import Any

from skygcs.disk_writer import DiskWriter
from skygcs.events import Event


class Inline(Executor):
    """``stuck``: jobs wait until it is False, and are then done by the next one."""

    def __init__(self) -> None:
        self.stuck = False
        self._waiting: list[tuple[Future[Any], Callable[[], Any]]] = []

    def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future[Any]:
        future: Future[Any] = Future()
        self._waiting.append((future, lambda: fn(*args, **kwargs)))
        if not self.stuck:
            for waiting, job in self._waiting:
                try:
                    waiting.set_result(job())
                except OSError as error:
                    waiting.set_exception(error)
            self._waiting.clear()
        return future

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:
        pass


def inline_disk(loop: asyncio.AbstractEventLoop, on_event: Callable[[Event], None] = lambda event: None) -> DiskWriter:
    """A writer without a thread."""
    return DiskWriter(loop, on_event, loop.time, Inline())
