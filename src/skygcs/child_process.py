"""Starts a process so that a task that is cancelled meanwhile leaves none behind, and that no signal of a terminal
reaches: its starter ends it."""

from __future__ import annotations

import asyncio
import contextlib
from typing import Any

from skygcs.cancellation import carried_through


async def start_process(*line: str, **options: Any) -> asyncio.subprocess.Process:
    """Start a process like `asyncio.create_subprocess_exec`, in a session of its own: Ctrl-C and the hang-up of a
    terminal are for its starter. Cancelled: the process is killed and waited for. Raises OSError."""
    # uvloop only kills it: it is waited for by nobody, and the loop may be closed before its end
    creating = asyncio.create_subprocess_exec(*line, start_new_session=True, **options)
    starting = asyncio.create_task(creating, name=f"start of {line[0]}")
    try:
        return await asyncio.shield(starting)
    except asyncio.CancelledError:
        with contextlib.suppress(OSError):
            await carried_through(_end(starting))
        raise


async def _end(starting: asyncio.Task[asyncio.subprocess.Process]) -> None:
    process = await starting
    with contextlib.suppress(ProcessLookupError):
        process.kill()
    if process.stdin is not None:
        process.stdin.close()
    await process.communicate()  # up to the end of what it wrote: its pipes are closed only then
