"""Requests to plan, of the daemon's clients: one process at a time, one request of each client, a bounded queue.

The process is `skygcs.ext.plans.planning`: nothing is computed in the daemon, and its answer is passed on as it is.
"""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable, Hashable
from dataclasses import dataclass
from typing import Any

from pydantic_core import to_json

from skygcs.errors import RefusedError
from skygcs.ext.plans.planning.process import OnProgress, ProcessLimits, compute
from skygcs.ext.plans.planning.request import with_text

MAX_WAITING = 8
"""Requests that wait for the one that is computed; each takes seconds, two minutes at most."""

LIMITS = ProcessLimits(time_s=120.0, memory_mb=2048, answer_bytes=4 << 20)
"""A client is closed that leaves 8 MiB unread."""

Compute = Callable[[bytes, OnProgress | None, ProcessLimits], Awaitable[bytes]]


@dataclass(eq=False)
class PlanningJob:
    """One request. Times are the loop's."""

    number: int
    what: str
    client: Hashable
    since: float
    began: float | None = None
    progress: dict[str, Any] | None = None
    cancelled: bool = False
    work: asyncio.Task[bytes] | None = None


@dataclass
class PlanningCounters:
    """Since the daemon began."""

    answered: int = 0
    """Certified or not."""
    failed: int = 0
    """Too long, too much memory, or a broken process."""
    cancelled: int = 0
    turned_away: int = 0
    """Because the queue was full, or the client had a request already."""


class PlanningQueue:
    """Queue of one daemon."""

    def __init__(self, loop: asyncio.AbstractEventLoop, compute: Compute = compute) -> None:
        self.counters = PlanningCounters()
        self._loop = loop
        self._compute = compute
        self._one_at_a_time = asyncio.Lock()
        self._jobs: dict[int, PlanningJob] = {}
        self._last = 0

    async def run(
        self,
        client: Hashable,
        what: str,
        request: dict[str, Any],
        on_progress: OnProgress | None = None,
        text: bytes = b"",
    ) -> bytes:
        """The answer as JSON (`planning/request.py`); ``text``: of its plan. It ends with the task that awaits it.

        Raises RefusedError: another request of this client, a full queue, cancelled, too long; PlanningFailed.
        """
        if any(job.client == client for job in self._jobs.values()):
            self.counters.turned_away += 1
            raise RefusedError("this client has a request to plan already: wait for it, or plan.cancel")
        if len(self._jobs) > MAX_WAITING:
            self.counters.turned_away += 1
            raise RefusedError(f"{len(self._jobs)} requests to plan are not finished yet; try again later")
        self._last += 1
        job = PlanningJob(self._last, what, client, self._loop.time())
        self._jobs[job.number] = job
        encoded = with_text(to_json(request), text) if text else to_json(request)
        job.work = self._loop.create_task(self._in_turn(job, encoded, on_progress), name=f"planning {job.number}")
        try:
            answer = await job.work
        except asyncio.CancelledError:
            self.counters.cancelled += 1
            if not job.cancelled:
                raise  # the client has gone
            raise RefusedError(f"planning request {job.number} was cancelled") from None
        except Exception:
            self.counters.failed += 1
            raise
        finally:
            del self._jobs[job.number]
        self.counters.answered += 1
        return answer

    async def _in_turn(self, job: PlanningJob, request: bytes, on_progress: OnProgress | None) -> bytes:
        def note(progress: dict[str, Any]) -> None:
            job.progress = progress
            if on_progress is not None:
                on_progress({"job": job.number, **progress})

        async with self._one_at_a_time:
            job.began = self._loop.time()
            return await self._compute(request, note, LIMITS)

    def cancel(self, *, client: Hashable = None, number: int | None = None) -> list[int]:
        """Cancel the request of a client, or the one of this number; those that were. Their `run` is refused."""
        meant = [
            job
            for job in self._jobs.values()
            if (job.client == client if number is None else job.number == number) and not job.cancelled
        ]
        for job in meant:
            job.cancelled = True
            if job.work is not None:
                job.work.cancel()
        return [job.number for job in meant]

    def close(self) -> None:
        """Cancel all."""
        for number in list(self._jobs):
            self.cancel(number=number)

    def status(self) -> list[dict[str, Any]]:
        """Return what is computed and what waits, the oldest first."""
        now = self._loop.time()
        return [
            {
                "job": job.number,
                "what": job.what,
                "state": "waiting" if job.began is None else "running",
                "since_s": round(now - job.since, 3),
                "progress": job.progress,
            }
            for job in self._jobs.values()
        ]
