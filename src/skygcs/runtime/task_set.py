"""Background tasks, each with an owner."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Coroutine
from typing import Any, TypeVar

from skygcs.events import Event

T = TypeVar("T")


class TaskSet:
    """The tasks of one owner: each is referenced until it is done, and an internal fault in it is reported as an event,
    with ``name`` and ``sysid`` if it concerns one vehicle. The owner bounds their number."""

    def __init__(
        self,
        loop: asyncio.AbstractEventLoop,
        on_event: Callable[[Event], None],
        name: str | None = None,
        sysid: int | None = None,
    ) -> None:
        self._loop = loop
        self._on_event = on_event
        self._name = name
        self._sysid = sysid
        self._tasks: set[asyncio.Task[Any]] = set()

    def __len__(self) -> int:
        return len(self._tasks)

    def start(self, work: Coroutine[Any, Any, T], what: str) -> asyncio.Task[T]:
        """``what``: its name in reports of faults and in lists of tasks."""
        task = self._loop.create_task(work, name=what if self._name is None else f"{self._name} {what}")
        self._tasks.add(task)
        task.add_done_callback(self._ended)
        return task

    async def settled(self) -> None:
        """Wait until all are done."""
        while self._tasks:
            await asyncio.wait(set(self._tasks))

    def close(self) -> None:
        """Cancel the running tasks."""
        for task in self._tasks:
            task.cancel()

    def _ended(self, task: asyncio.Task[Any]) -> None:
        self._tasks.discard(task)
        if (text := fault(task)) is not None:
            self._on_event(Event("fault", self._name, self._sysid, text, {}))


def fault(done: asyncio.Task[Any]) -> str | None:
    """The internal fault of a task that is done; None: none, or it was cancelled."""
    if done.cancelled() or (error := done.exception()) is None:
        return None
    return f"{done.get_name()} failed inside skygcs: {error!r}"
