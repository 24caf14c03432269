"""A task that is cancelled while it starts a process, at every moment."""

from __future__ import annotations

import asyncio
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pytest

from skygcs.child_process import start_process
from support.loops import on_every_loop

PIPE = asyncio.subprocess.PIPE
SLEEPS = ("sleep", "600")
AT_MOST_TURNS = 200
"""Of the loop, until a process is started; some ten are usual."""


def children() -> set[int]:
    return {int(pid) for pid in Path(f"/proc/self/task/{os.getpid()}/children").read_text().split()}


@on_every_loop
async def test_cancelled_at_any_moment_no_process_is_left() -> None:
    before = children()
    for pipes in ({}, {"stdin": PIPE, "stdout": PIPE, "stderr": PIPE}):
        found = None
        for turns in range(AT_MOST_TURNS):
            found = await cancelled_after(turns, pipes)
            assert children() == before, f"cancelled after {turns} turns of the loop"
            if found is not None:
                break
        assert found is not None and found.returncode == -9, "in the end it is started before it is cancelled"


async def cancelled_after(turns: int, pipes: Mapping[str, Any]) -> asyncio.subprocess.Process | None:
    """The process if it was started by then; it is ended."""
    task = asyncio.create_task(start_process(*SLEEPS, **pipes))
    for _ in range(turns):
        await asyncio.sleep(0)
    if not task.done():
        task.cancel()
        with pytest.raises(asyncio.CancelledError):
            await task
        return None
    process = await task
    assert os.getsid(process.pid) == process.pid, "a terminal's signal is for us, not for it"
    process.kill()
    if process.stdin is not None:
        process.stdin.close()
    await process.communicate()
    return process


@on_every_loop
async def test_a_program_that_is_not_there_is_an_error_and_a_cancellation_comes_first() -> None:
    with pytest.raises(FileNotFoundError):
        await start_process("/no-such-program")
    task = asyncio.create_task(start_process("/no-such-program"))
    await asyncio.sleep(0)
    task.cancel()
    with pytest.raises(asyncio.CancelledError):
        await task
