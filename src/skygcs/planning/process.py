"""Runs one request in a planning process, which is bounded in time, memory and the size of its answer, and ends with
the task that waits for it."""

from __future__ import annotations

import asyncio
import base64
import contextlib
import json
import os
import pickle
import signal
import sys
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, TypeVar, cast

from skygcs.errors import RefusedError, SkygcsError

ONE_THREAD = {name: "1" for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")}
"""Of what numpy computes with: one core is for planning, the others are not."""

REQUEST, CALL = "request", "call"
"""What the process reads: a request as JSON, or a pickled function with its arguments, from this program only."""

PROGRESS = b'{"progress"'
"""How a line begins that is not the answer."""

REFUSED = b'{"refused"'
"""How an answer begins that consists of a reason."""

STDERR_BYTES = 4096

T = TypeVar("T")

OnProgress = Callable[[dict[str, Any]], None]
"""Called with what, done and total."""


@dataclass(frozen=True, slots=True)
class ProcessLimits:
    """What one request may take."""

    time_s: float = 120.0
    """By the clock, and of CPU time. 255 vehicles of 400 pieces each take some seconds."""
    memory_mb: int = 2048
    """Of address space; numpy itself takes 0.3 GB of that, 100,000 pieces 0.5 GB."""
    answer_bytes: int = 64 << 20


class PlanningFailed(SkygcsError):
    """The process ended without an answer."""


async def compute(
    request: bytes, on_progress: OnProgress | None = None, limits: ProcessLimits = ProcessLimits()
) -> bytes:
    """The answer to a request, both as JSON.

    Raises RefusedError where that is the answer and where it took too long or too much memory, PlanningFailed where the
    process broke. Cancelled: the process is killed and waited for.
    """
    answer = await _process(REQUEST, request, on_progress, limits)
    if answer.startswith(REFUSED):
        raise RefusedError(json.loads(answer)["refused"])
    return answer


async def call(function: Callable[..., T], *arguments: Any, limits: ProcessLimits = ProcessLimits()) -> T:
    """As `asyncio.to_thread`, in a planning process: a function of a module, arguments and result that can be pickled.

    Raises RefusedError with the text of a SkygcsError of the function, else as `compute`.
    """
    # in threads: large ones take tens of milliseconds, and the event loop gets its turn in between
    request = await asyncio.to_thread(pickle.dumps, (function, arguments), pickle.HIGHEST_PROTOCOL)
    answer = await _process(CALL, request, None, limits)
    refused, result = await asyncio.to_thread(pickle.loads, base64.b64decode(answer))
    if refused is not None:
        raise RefusedError(refused)
    return cast("T", result)


async def _process(kind: str, request: bytes, on_progress: OnProgress | None, limits: ProcessLimits) -> bytes:
    """The line with which a process answers."""
    arguments = (kind, str(limits.memory_mb), str(int(limits.time_s) + 1), str(limits.answer_bytes))
    try:
        process = await asyncio.create_subprocess_exec(
            *(sys.executable, "-P", "-m", "skygcs.planning.worker", *arguments),
            stdin=asyncio.subprocess.PIPE,
            stdout=asyncio.subprocess.PIPE,
            stderr=asyncio.subprocess.PIPE,
            limit=limits.answer_bytes + 1024,
            env={**os.environ, **ONE_THREAD},
        )
    except OSError as error:
        raise PlanningFailed(f"the planning process cannot be started: {error.strerror or error}") from None
    errors = asyncio.create_task(_errors_of(process), name="planning errors")
    try:
        async with asyncio.timeout(limits.time_s):
            answer = await _talk(process, request, on_progress)
            await process.wait()
    except TimeoutError:
        raise RefusedError(f"planning took longer than {limits.time_s:g} s and was ended") from None
    finally:
        if process.returncode is None:
            with contextlib.suppress(ProcessLookupError):
                process.kill()
        await process.wait()
        text = await errors
    if answer:
        return answer
    raise _failure(process.returncode or 0, text, limits)


async def _talk(process: asyncio.subprocess.Process, request: bytes, on_progress: OnProgress | None) -> bytes:
    """Send the request, read up to the answer; b"" if it ended without one."""
    assert process.stdin is not None and process.stdout is not None
    with contextlib.suppress(ConnectionError):  # it has ended already: what it wrote says why
        process.stdin.write(request)
        await process.stdin.drain()
        process.stdin.close()
    while line := await process.stdout.readline():
        if not line.startswith(PROGRESS):
            return line.rstrip(b"\n")
        if on_progress is not None:
            on_progress(json.loads(line)["progress"])
    return b""


async def _errors_of(process: asyncio.subprocess.Process) -> str:
    """The end of what it writes to standard error."""
    assert process.stderr is not None
    text = b""
    while part := await process.stderr.read(STDERR_BYTES):
        text = (text + part)[-STDERR_BYTES:]
    return text.decode(errors="replace").strip()


def _failure(code: int, text: str, limits: ProcessLimits) -> SkygcsError:
    """Why there is no answer."""
    if code == -signal.SIGXCPU or (code == -signal.SIGKILL and not text):
        return RefusedError(f"planning took more than {limits.time_s:g} s of CPU time or was killed")
    last = text.rpartition("\n")[2][:200]
    if "MemoryError" in last:
        return RefusedError(f"planning needs more than {limits.memory_mb:,} MiB of memory")
    return PlanningFailed(f"the planning process ended with code {code}" + (f": {last}" if last else ""))


def run(request: dict[str, Any], on_progress: OnProgress | None = None) -> dict[str, Any]:
    """`compute` for a program without an event loop; the decoded answer."""
    answer: dict[str, Any] = json.loads(asyncio.run(compute(json.dumps(request).encode(), on_progress)))
    return answer
