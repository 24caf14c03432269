"""Bounds of a process' log: lines of one kind come at a bounded rate, and no text in them moves the terminal.

A line's kind is its text without its fields, or for a library its logger and the template of its message: what a client
can cause again and again (9,580 malformed requests wrote 4.7 MB) is then one kind.
"""

from __future__ import annotations

import logging
import time
from collections import OrderedDict
from collections.abc import Callable
from typing import Any

from skygcs.cli.log_stream import LogStream
from skygcs.core.token_bucket import TokenBucket
from skygcs.terminal_text import visible

LINES_PER_S, BURST_LINES = 0.2, 20.0
"""Bounds for each kind of line: 20 at once, then one in five seconds. A line whose text has a vehicle's name is of
another kind for each of 250 vehicles."""

MAX_KINDS = 512
"""Beyond, the kind that was heard of least recently is forgotten."""

MAX_CHARS = 4000
"""Longest line of a library in characters: a traceback of 40 lines."""


class LogLimit:
    """One of each process."""

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self._clock = clock
        self._kinds: OrderedDict[str, tuple[TokenBucket, list[int]]] = OrderedDict()

    def admit(self, kind: str) -> int | None:
        """Number of lines of this kind left out since its last one; None: leave this one out, too."""
        now = self._clock()
        found = self._kinds.pop(kind, None)
        if found is None:
            found = TokenBucket(LINES_PER_S, BURST_LINES, now), [0]
        self._kinds[kind] = found
        if len(self._kinds) > MAX_KINDS:
            self._kinds.popitem(last=False)
        bucket, left_out = found
        if not bucket.take(now):
            left_out[0] += 1
            return None
        count, left_out[0] = left_out[0], 0
        return count


def bounded(limit: LogLimit, drop: type[Exception]) -> Callable[[Any, str, Any], Any]:
    """A processor of structlog. ``drop``: its DropEvent."""

    def process(logger: Any, method: str, record: Any) -> Any:
        left_out = limit.admit(str(record.get("event"))[:200])
        if left_out is None:
            raise drop
        if left_out:
            record["left_out"] = left_out
        return record

    return process


def readable(logger: Any, method: str, record: Any) -> Any:
    """A processor of structlog: what others wrote into texts cannot move the terminal."""
    return {
        key: visible(value, lines=key == "exception") if type(value) is str else value for key, value in record.items()
    }


class LibraryLog(logging.StreamHandler[Any]):
    """Writes what libraries log (aiohttp, asyncio, nats), within the same bounds."""

    def __init__(self, limit: LogLimit, stream: LogStream) -> None:
        super().__init__(stream)
        self._limit = limit

    def emit(self, record: logging.LogRecord) -> None:
        left_out = self._limit.admit(f"{record.name} {record.msg}"[:200])
        if left_out is not None:
            if left_out:
                record.msg = f"{record.msg} ({left_out} like it were left out)"
            super().emit(record)

    def format(self, record: logging.LogRecord) -> str:
        return visible(super().format(record)[:MAX_CHARS], lines=True)
