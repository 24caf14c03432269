"""The same work for many companions or vehicles at once: a bound on how many, a limit of time, an outcome for each."""

from __future__ import annotations

import asyncio
import os
from collections.abc import Awaitable, Callable, Sequence
from dataclasses import dataclass, field
from typing import Any, Protocol, TypeVar

from skygcs.errors import SkygcsError

AT_ONCE = 8
"""Ten uploads at once over one Wi-Fi take as long as ten in turn, and a laptop has threads for some."""

DEBUG_VARIABLE = "SKYGCS_DEBUG"


@dataclass(slots=True)
class Progress:
    """The progress of one of them. ``step`` is for a person."""

    name: str
    step: str = "waiting"
    began: float | None = None
    """The loop's clock at its begin; None: not yet."""
    ended: float | None = None
    ok: bool | None = None
    message: str = ""
    data: dict[str, Any] = field(default_factory=dict)
    """Data of the work, for JSON."""

    def elapsed_s(self, now: float) -> float:
        """0 before it began."""
        if self.began is None:
            return 0.0
        return (now if self.ended is None else self.ended) - self.began

    def outcome(self) -> dict[str, Any]:
        """The outcome in the form of an order to a vehicle, with the data of the work."""
        return {
            "ok": bool(self.ok),
            "result": "done" if self.ok else "failed",
            "message": self.message,
            "attempts": 1,
            "elapsed_s": round(self.elapsed_s(0.0), 3),
            **self.data,
        }


class Named(Protocol):
    """A thing with a name: a companion, a vehicle to be made ready."""

    @property
    def name(self) -> str: ...


T = TypeVar("T", bound=Named)
Work = Callable[[T, Progress], Awaitable[str]]
"""Does it, names its step in the progress, and returns the message of its success."""


async def side_by_side(
    targets: Sequence[T],
    work: Work[T],
    *,
    at_once: int = AT_ONCE,
    timeout_s: float,
    on_change: Callable[[Progress], None] = lambda progress: None,
) -> dict[str, Progress]:
    """Run ``work`` for each target; never raises what it raises, but for cancellation.

    ``on_change`` is called when one begins and when it ends. ``timeout_s`` counts for each from its own beginning.
    """
    slots = asyncio.Semaphore(at_once)
    loop = asyncio.get_running_loop()
    all_progress = {target.name: Progress(target.name) for target in targets}

    async def one(target: T) -> None:
        progress = all_progress[target.name]
        async with slots:
            progress.began, progress.step = loop.time(), "connecting"
            on_change(progress)
            await _guarded(target, work, progress, timeout_s)
            progress.ended = loop.time()
            on_change(progress)

    async with asyncio.TaskGroup() as group:
        for target in targets:
            group.create_task(one(target), name=f"work for {target.name}")
    return all_progress


async def _guarded(target: T, work: Work[T], progress: Progress, timeout_s: float) -> None:
    try:
        async with asyncio.timeout(timeout_s):
            progress.message = await work(target, progress)
        progress.ok = True
    except TimeoutError:
        progress.ok, progress.message = False, f"{progress.step}: not done within {timeout_s:g} s (--timeout)"
    except (SkygcsError, OSError) as error:
        progress.ok, progress.message = False, str(error)
    except Exception as error:  # a fault with one leaves the others alone
        if os.environ.get(DEBUG_VARIABLE):
            raise
        text = f"internal error: {type(error).__name__}: {error} (set {DEBUG_VARIABLE}=1 to see where)"
        progress.ok, progress.message = False, text
