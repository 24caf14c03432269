"""The trace of one vehicle's control on disk: one CSV file from `open` to `close`, written as it flies.

A disk that is full or gone ends the trace, is told once, and never touches control.
"""

from __future__ import annotations

import time
from pathlib import Path
from typing import TextIO

from skygcs.core.control.cascade import Memory
from skygcs.core.control.config import ControlConfig
from skygcs.core.control.trace import TraceHead, TraceRow, TraceWriter

FLUSH_S = 1.0
"""A crash loses at most this much."""

LARGEST_BYTES = 500_000_000
"""Three hours at 50 Hz (some 800 B a row); then the trace ends and says so."""


class TraceFile:
    """Raises OSError from every method; the caller gives it up then."""

    def __init__(self, directory: Path, head: TraceHead) -> None:
        directory.mkdir(parents=True, exist_ok=True)
        stamp = time.strftime("%Y%m%d-%H%M%S", time.gmtime())
        name = "".join(c if c.isalnum() else "_" for c in head.vehicle)
        self.path = _free(directory, f"control-{name}-{stamp}")
        self._file: TextIO = self.path.open("x", encoding="ascii", buffering=1 << 16)
        self._writer = TraceWriter(head)
        self._flushed_at = 0.0
        self._bytes = 0

    def write(self, row: TraceRow, config: ControlConfig, before: Memory, after: Memory) -> None:
        """Raises OSError."""
        text = self._writer.lines(row, config, before, after)
        self._bytes += len(text)
        if self._bytes > LARGEST_BYTES:
            raise OSError(f"the trace has reached {LARGEST_BYTES // 1_000_000} MB")
        self._file.write(text)
        if row.t_s - self._flushed_at >= FLUSH_S:
            self._flushed_at = row.t_s
            self._file.flush()

    def close(self) -> None:
        self._file.close()


def _free(directory: Path, name: str) -> Path:
    """A path that does not exist yet: two traces may begin within one second."""
    path = directory / f"{name}.csv"
    number = 1
    while path.exists():
        number += 1
        path = directory / f"{name}-{number}.csv"
    return path
