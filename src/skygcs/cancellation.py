"""Cancellation that is not lost: what `except*`, `asyncio.wait_for` and suppressed CancelledErrors would swallow.

A task group of asyncio whose task failed in the same turn in which its owner was cancelled raises the failure alone,
and Python 3.11 leaves its own cancellation in the count; `wait_for` of Python 3.11 returns a result that comes together
with a cancellation (CPython issue 86296); and `suppress(CancelledError)` around the await of another task cannot tell
whose cancellation it was. In each case the owner's loop goes on for ever. So such places use these functions, and
`tests/unit/test_cancellation.py` finds those that do not.
"""

from __future__ import annotations

import asyncio
from collections.abc import Coroutine
from typing import Any, TypeVar

T = TypeVar("T")


def end_if_cancelled() -> None:
    """Raise CancelledError if the current task was cancelled and something swallowed that. Not after a task group,
    which may leave its own cancellation in the count."""
    task = asyncio.current_task()
    if task is not None and task.cancelling():
        raise asyncio.CancelledError


async def together(**work: Coroutine[Any, Any, None]) -> None:
    """Run these at the same time, in tasks of these names, until the first of them fails or all have ended; the others
    are cancelled and waited for. Raises the first failure itself, or CancelledError if the caller was cancelled,
    whatever else has happened."""
    tasks = [asyncio.create_task(coroutine, name=name) for name, coroutine in work.items()]
    cancelled = False
    try:
        await asyncio.wait(tasks, return_when=asyncio.FIRST_EXCEPTION)
    except asyncio.CancelledError:
        cancelled = True
    failed = [task for task in tasks if task.done() and not task.cancelled() and task.exception() is not None]
    for task in tasks:
        task.cancel()
    while not all(task.done() for task in tasks):
        try:
            await asyncio.wait(tasks)
        except asyncio.CancelledError:
            cancelled = True
    late = [error for task in tasks if not task.cancelled() and (error := task.exception()) is not None]
    if cancelled:
        raise asyncio.CancelledError
    if failed:
        failed[0].result()
    if late:
        raise late[0]


async def ended(task: asyncio.Task[Any]) -> None:
    """Cancel a task and wait for its end, whatever that is. The cancellation of the caller is raised."""
    task.cancel()
    await asyncio.wait({task})
    if not task.cancelled():
        task.exception()  # mark it as retrieved


async def carried_through(work: Coroutine[Any, Any, T]) -> T:
    """Wait for work that must come to its end, such as that of a process that was killed, and return its result. The
    cancellations of the caller are raised once it has ended: in a ``finally`` a second one would cut it short."""
    task = asyncio.create_task(work, name="work that is carried through")
    cancelled = False
    while not task.done():
        try:
            await asyncio.wait({task})
        except asyncio.CancelledError:
            cancelled = True
    if cancelled:
        if not task.cancelled():
            task.exception()  # mark it as retrieved
        raise asyncio.CancelledError
    return task.result()
