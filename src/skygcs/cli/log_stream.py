"""The log of a process on stderr: whoever reads it, or does not, never holds the process up.

A terminal that was stopped with Ctrl-S, a pipe that nobody reads, and a full disk make a write wait for ever or fail.
The loop that logs is the one that flies, so a thread writes; what it cannot write is left out and counted.
"""

from __future__ import annotations

import contextlib
import io
import os
import threading
from collections import deque
from typing import TextIO

MAX_WAITING_BYTES = 256 * 1024
"""Some 2,000 lines: more than `log_limit` lets through while a slow terminal scrolls."""

DRAIN_S = 1.0
"""How long the end of the process waits for lines that are not written yet."""


class LogStream(io.TextIOBase):
    """A text file for loggers, in place of ``file``: `write` never blocks and never raises.

    ``file`` None (a process without stderr): nothing is written. One without a descriptor is in memory and is written
    at once.
    """

    def __init__(self, file: TextIO | None) -> None:
        self._descriptor = _duplicate(file)
        self._memory = file if self._descriptor is None else None
        self._changed = threading.Condition()
        self._waiting: deque[bytes] = deque()
        self._waiting_bytes = 0
        self._lost = 0
        self._thread: threading.Thread | None = None

    def writable(self) -> bool:
        return True

    def write(self, text: str) -> int:
        """Take text of whole lines; what finds no room is left out."""
        if self._descriptor is None:
            if self._memory is not None:
                with contextlib.suppress(OSError, ValueError):
                    self._memory.write(text)
            return len(text)
        data = text.encode(errors="replace")
        with self._changed:
            if self._waiting_bytes + len(data) > MAX_WAITING_BYTES:
                self._lost += 1
                return len(text)
            self._waiting.append(data)
            self._waiting_bytes += len(data)
            if self._thread is None:
                self._thread = threading.Thread(target=self._work, name="log", daemon=True)
                self._thread.start()
            self._changed.notify_all()
        return len(text)

    def drain(self, within_s: float = DRAIN_S) -> bool:
        """Wait until everything is written; False after ``within_s``. For the end of the process."""
        with self._changed:
            return self._changed.wait_for(lambda: not self._waiting_bytes, within_s)

    def _work(self) -> None:
        while True:
            with self._changed:
                self._changed.wait_for(lambda: bool(self._waiting))
                data, lost = self._waiting.popleft(), self._lost
            note = f"({lost} lines of this log could not be written)\n".encode() if lost else b""
            written = self._put(note + data)
            with self._changed:
                self._lost = self._lost - lost if written else self._lost + 1
                self._waiting_bytes -= len(data)
                self._changed.notify_all()

    def _put(self, data: bytes) -> bool:
        """Write it whole, however long that takes; False if it cannot be written."""
        assert self._descriptor is not None
        try:
            while data:
                data = data[os.write(self._descriptor, data) :]
        except OSError:
            return False
        return True


def _duplicate(file: TextIO | None) -> int | None:
    """A descriptor of the file that is ours alone: a write that waits keeps no lock that the interpreter needs at its
    end. None: the file has none."""
    try:
        return None if file is None else os.dup(file.fileno())
    except (OSError, ValueError):
        return None
