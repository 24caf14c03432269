"""Background tasks, each with an owner, and the order that each carries out.

Of two orders the later one counts, whichever waited longer on its way. So each has a serial from where it is asked for:

    asked for by                                    its serial
    ---------------------------------------------   ------------------------------------------------------------
    a person or program (`FleetOrders.command_all`)  a new one (`ask`)
    that, in a call that waits for its methods      that of when the call came (`asking_from`)
    the daemon, to carry out one of these later     that of the order which it carries out
    a plan, with each of its orders                 that of the last order of a person to the plan
    the daemon by itself: a hold                    `OWN`: it makes no order of a person void
    a caller of an actor that has none              a new one, where it reaches the gate (`OrderRunner.attempt`)
"""

from __future__ import annotations

import asyncio
import itertools
import time
from collections.abc import Callable, Coroutine, Generator, Iterator
from contextlib import AbstractContextManager, contextmanager
from contextvars import ContextVar, copy_context
from typing import Any, NamedTuple, TypeVar

from skygcs.events import Event

TURN_S = 0.0005
"""CPU time after which work in short turns gives other tasks their turn: a fortieth of a control period."""

T = TypeVar("T")

OWN = 0
"""Serial of an order that the daemon gives by itself."""

ORDER_SERIAL: ContextVar[int | None] = ContextVar("order_serial", default=None)
"""Serial of the order that the present task carries out; None: it carries out none. Tasks that begin within an order
inherit it, and so never count as a newer order."""

ASKED_NOW: ContextVar[bool] = ContextVar("asked_now", default=False)
"""True while the present task carries out an order that a person gives: only that may end a flight over a pilot who
takes the vehicle meanwhile. No task of a `TaskSet` inherits it."""

_serials = itertools.count(OWN + 1)

_came: ContextVar[int | None] = ContextVar("came", default=None)
"""Serial of when the present call came, until its first order has it."""


def ask() -> int:
    """Serial of an order that is asked for now, or was when the present call came (`asking_from`). Nothing else makes
    one."""
    if (serial := _came.get()) is None:
        return next(_serials)
    _came.set(None)
    return serial


def asking_from(serial: int) -> None:
    """The present task carries out a call that came when this serial was made, and has waited since: its first order
    was asked for then, and one that was asked for meanwhile is newer."""
    _came.set(serial)


@contextmanager
def carrying_out(serial: int) -> Iterator[None]:
    """Carry out the order of this serial in a block."""
    before = ORDER_SERIAL.get()
    ORDER_SERIAL.set(serial)
    try:
        yield
    finally:
        ORDER_SERIAL.set(before)


def numbered(new: Callable[[], int] = ask) -> AbstractContextManager[None]:
    """Carry out the order of the present task in a block, or, in a task without one, an order with a new serial."""
    serial = ORDER_SERIAL.get()
    return carrying_out(new() if serial is None else serial)


class Asked(NamedTuple):
    """An order that is asked for, and the vehicle's mode then; see `OrderPrecedence.overtaken`."""

    serial: int
    custom_mode: int | None = None
    """None: an order of ours was changing it, or a take-off was under way."""
    number: int = 0
    """`OrderLedger.number` then."""


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

    def start(self, work: Coroutine[Any, Any, T], what: str, serial: int | None = None) -> asyncio.Task[T]:
        """``what``: its name in reports of faults and in lists of tasks. ``serial``: of the order that it carries out;
        None: that of the task that starts it."""
        context = copy_context()
        context.run(ASKED_NOW.set, False)
        if serial is not None:
            context.run(ORDER_SERIAL.set, serial)
        name = what if self._name is None else f"{self._name} {what}"
        task = self._loop.create_task(work, name=name, context=context)
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


async def in_turns(work: Generator[None, None, T]) -> T:
    """Carry out work that yields; others get their turn each time."""
    while True:
        try:
            next(work)
        except StopIteration as end:
            made: T = end.value
            return made
        await asyncio.sleep(0)


async def in_short_turns(work: Iterator[None]) -> tuple[float, float]:
    """Do it, so that others have their turn every `TURN_S`; its CPU time, and the longest part of that at a stretch."""
    took_s = longest_s = 0.0
    begun = time.thread_time()
    for _ in work:
        turn_s = time.thread_time() - begun
        if turn_s < TURN_S:
            continue
        took_s, longest_s = took_s + turn_s, max(longest_s, turn_s)
        await asyncio.sleep(0)
        begun = time.thread_time()
    turn_s = time.thread_time() - begun
    return took_s + turn_s, max(longest_s, turn_s)


class OneATurn:
    """Lets tasks that begin together go on one by one: what each of them then does at once takes milliseconds."""

    def __init__(self) -> None:
        self._lock = asyncio.Lock()

    async def wait(self) -> None:
        """Return in a turn of the loop in which no other waiter does."""
        async with self._lock:
            await asyncio.sleep(0)
