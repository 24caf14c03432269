"""Runs requests in planning processes. Each is bounded in time, memory and the size of its answer; a process ends with
the task that waits for it.

To start a process stops the whole program for some milliseconds (the interpreter's lock is held until the new one
runs), which control ticks notice. So a daemon keeps one that is done for the next request (`PlanningProcesses`).
"""

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

from skygcs.cancellation import carried_through
from skygcs.child_process import start_process
from skygcs.errors import RefusedError, SkygcsError

ONE_THREAD = {name: "1" for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")}
"""Environment that limits numpy's libraries to one thread: one core is for planning, the others are not."""

REQUEST, CALL = "request", "call"
"""Kinds of input of the process: a request as JSON, or a pickled function with its arguments, from this program
only."""

KEPT_S = 120.0
"""A process that waits for the next request has 60 MB; a plan is looked at again within minutes, or hours later."""

LONGEST_LINE_BYTES = (64 << 20) + 1024
"""Longest answer; the process keeps to the limit of its request."""

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
    """Limits of one request."""

    time_s: float = 120.0
    """By the clock, and of CPU time. 255 vehicles of 400 pieces each take a few seconds."""
    memory_mb: int = 2048
    """Limit of address space; numpy itself takes 0.3 GB of it, 100,000 pieces 0.5 GB."""
    answer_bytes: int = 64 << 20


class PlanningFailed(SkygcsError):
    """The process ended without an answer."""


async def compute(
    request: bytes, on_progress: OnProgress | None = None, limits: ProcessLimits = ProcessLimits()
) -> bytes:
    """The answer to a request, both as JSON, by a process of its own.

    Raises RefusedError where that is the answer and where it took too long or too much memory, PlanningFailed where the
    process broke. Cancelled: the process is killed and waited for.
    """
    return await PlanningProcesses(keep=False).compute(request, on_progress, limits)


async def call(function: Callable[..., T], *arguments: Any, limits: ProcessLimits = ProcessLimits()) -> T:
    """`PlanningProcesses.call` by a process of its own."""
    return await PlanningProcesses(keep=False).call(function, *arguments, limits=limits)


class PlanningProcesses:
    """Processes, as many as there are requests at the same time; ``keep``: one of them waits for the next request.

    `close` ends the one that waits; those with a request end with the tasks that wait for them.
    """

    def __init__(self, *, keep: bool = True) -> None:
        self._keep = keep
        self._idle: _Process | None = None
        self._ending: asyncio.TimerHandle | None = None

    async def compute(
        self, request: bytes, on_progress: OnProgress | None = None, limits: ProcessLimits = ProcessLimits()
    ) -> bytes:
        """See the function of this name."""
        return await self._answer(REQUEST, request, on_progress, limits)

    async def call(self, function: Callable[..., T], *arguments: Any, limits: ProcessLimits = ProcessLimits()) -> T:
        """Call a function like `asyncio.to_thread`, in a planning process: a function of a module, arguments and result
        that can be pickled.

        Raises RefusedError with the text of a SkygcsError of the function, else as `compute`.
        """
        # in threads: large ones take tens of milliseconds, and the event loop gets its turn in between
        request = await asyncio.to_thread(pickle.dumps, (function, arguments), pickle.HIGHEST_PROTOCOL)
        answer = await self._answer(CALL, request, None, limits)
        refused, result = await asyncio.to_thread(pickle.loads, base64.b64decode(answer))
        if refused is not None:
            raise RefusedError(refused)
        return cast("T", result)

    async def close(self) -> None:
        """End the one that waits."""
        if (process := self._taken()) is not None:
            await process.end()

    async def _answer(self, kind: str, request: bytes, on_progress: OnProgress | None, limits: ProcessLimits) -> bytes:
        """The line with which a process answers. Raises RefusedError with the reason if that is the answer."""
        process = self._taken()
        if process is None or not process.alive:
            if process is not None:
                await process.end()
            process = await _Process.started()
        answer, text = b"", ""
        try:
            async with asyncio.timeout(limits.time_s):
                answer = await process.answer(kind, request, on_progress, limits)
        except TimeoutError:
            raise RefusedError(
                f"planning took longer than {limits.time_s:g} s and was ended: check the plan in parts, in time or by "
                "groups of vehicles, or on a less busy computer"
            ) from None
        finally:
            # one that refused may have met the end of its memory
            if self._keep and self._idle is None and answer and not answer.startswith(REFUSED):
                self._idle = process
                self._ending = asyncio.get_running_loop().call_later(KEPT_S, self._end_idle)
            else:
                text = await process.end()
        if answer.startswith(REFUSED):
            raise RefusedError(json.loads(answer)["refused"])
        if answer:
            return answer
        raise _failure(process.code, text, limits)

    def _taken(self) -> _Process | None:
        """The one that waits; it may have ended."""
        process, self._idle = self._idle, None
        if self._ending is not None:
            self._ending.cancel()
            self._ending = None
        return process

    def _end_idle(self) -> None:
        if self._idle is not None:
            self._idle.stop()  # it is waited for by the next request, or by `close`


class _Process:
    """One process, and the end of what it writes to standard error."""

    def __init__(self, process: asyncio.subprocess.Process) -> None:
        self._process = process
        self._errors = asyncio.create_task(_errors_of(process), name="planning errors")

    @classmethod
    async def started(cls) -> _Process:
        """Raises PlanningFailed."""
        try:
            process = await start_process(
                *(sys.executable, "-P", "-m", "skygcs.ext.plans.planning.worker"),
                stdin=asyncio.subprocess.PIPE,
                stdout=asyncio.subprocess.PIPE,
                stderr=asyncio.subprocess.PIPE,
                limit=LONGEST_LINE_BYTES,
                env={**os.environ, **ONE_THREAD},
            )
        except OSError as error:
            raise PlanningFailed(f"the planning process cannot be started: {error.strerror or error}") from None
        return cls(process)

    @property
    def code(self) -> int:
        return self._process.returncode or 0

    @property
    def alive(self) -> bool:
        return self._process.returncode is None

    async def answer(self, kind: str, request: bytes, on_progress: OnProgress | None, limits: ProcessLimits) -> bytes:
        """Send a request, read up to the answer; b"" if it ended without one."""
        writer, reader = self._process.stdin, self._process.stdout
        assert writer is not None and reader is not None
        arguments = (kind, limits.memory_mb, int(limits.time_s) + 1, limits.answer_bytes, len(request))
        with contextlib.suppress(ConnectionError):  # it has ended already: what it wrote says why
            writer.write(" ".join(str(argument) for argument in arguments).encode() + b"\n")
            writer.write(request)
            await writer.drain()
        while line := await reader.readline():
            if not line.startswith(PROGRESS):
                return line.rstrip(b"\n")
            if on_progress is not None:
                on_progress(json.loads(line)["progress"])
        await self._process.wait()
        return b""

    def stop(self) -> None:
        """Kill it."""
        if self.alive:
            with contextlib.suppress(ProcessLookupError):
                self._process.kill()

    async def end(self) -> str:
        """Kill it and wait for it; the end of its errors."""
        self.stop()
        return await carried_through(self._ended())

    async def _ended(self) -> str:
        await self._process.wait()
        return await self._errors


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
