"""Logs as files: opened without being read whole, read with a progress bar, their faults told."""

from __future__ import annotations

import mmap
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from skygcs.config.dialects import load_dialect, offline_dialect
from skygcs.core.mavlink.dialect import Dialect
from skygcs.errors import SkygcsError
from skygcs.tlog.faults import LogFaults
from skygcs.tlog.format import ByteSource, sniff
from skygcs.tlog.reading import LogEntry, LogKind, LogReader

PROGRESS_FROM_BYTES = 20 << 20
"""Some 2 s of work; below this a bar would only flash up."""

RELEASE_BYTES = 16 << 20
"""So much of a mapped file stays in memory behind the place that is read."""

KIND_NAMES = {"tlog": "tlog", "raw": "raw capture"}


class Progress:
    """Called with the offset reached: draws a bar for a long file on a terminal, and gives memory back."""

    def __init__(self, data: ByteSource) -> None:
        self._data = data
        self._bar: Any = None
        self._next = 0
        self._released = 0
        if len(data) >= PROGRESS_FROM_BYTES and sys.stderr.isatty():
            from rich.console import Console
            from rich.progress import Progress as Bar

            self._bar = Bar(console=Console(stderr=True), transient=True)
            self._task = self._bar.add_task("reading", total=len(data))
            self._bar.start()

    def __call__(self, offset: int) -> None:
        if offset < self._next:
            return
        self._next = offset + (1 << 20)
        if self._bar is not None:
            self._bar.update(self._task, completed=offset)
        if isinstance(self._data, mmap.mmap) and offset - self._released >= RELEASE_BYTES:
            # the pages are the kernel's cache anyway; without this they count as ours and 1 GB of log as 1 GB of us
            end = offset // mmap.PAGESIZE * mmap.PAGESIZE
            self._data.madvise(mmap.MADV_DONTNEED, self._released, end - self._released)
            self._released = end

    def stop(self) -> None:
        if self._bar is not None:
            self._bar.stop()


class LogFile:
    """An open log. `entries` may be read several times; ``faults`` are those of the last complete reading."""

    def __init__(self, path: Path, data: ByteSource, dialect: Dialect) -> None:
        self.path = path
        self.dialect = dialect
        self.faults = LogFaults()
        self.size = len(data)
        kind: LogKind | None = sniff(data, dialect) or ("tlog" if path.suffix.lower() == ".tlog" and data else None)
        if kind is None:
            raise no_mavlink(path)
        self.kind: LogKind = kind
        self._data = data

    @property
    def stem(self) -> str:
        """What names of files made from it begin with."""
        return self.path.stem

    def entries(self) -> Iterator[LogEntry]:
        """Raises SkygcsError at the end if there was no MAVLink in it."""
        reader = LogReader(self._data, self.dialect, self.kind)
        progress = Progress(self._data)
        empty = True
        try:
            for entry in reader:
                empty = False
                progress(entry.offset)
                yield entry
        finally:
            progress.stop()
            self.faults = reader.faults
        if empty:
            raise no_mavlink(self.path)

    def tell_faults(self) -> None:
        """On stderr, one line each. They are no failure: everything else was read."""
        for line in self.faults.lines():
            note(f"{self.path}: {line}")


def note(text: str) -> None:
    """One line on stderr."""
    print(f"note: {text}", file=sys.stderr)


def no_mavlink(path: Path) -> SkygcsError:
    return SkygcsError(f"{path}: no MAVLink in it, neither as a tlog nor as a raw capture")


def dialect_named(name: str | None) -> Dialect:
    """The one that offline tools use if none is named. Raises DialectError."""
    return offline_dialect() if name is None else load_dialect(name)


@contextmanager
def opened_log(path: Path, dialect: Dialect) -> Iterator[LogFile]:
    """Raises SkygcsError for a file that cannot be read or holds no MAVLink."""
    with mapped(path) as data:
        yield LogFile(path, data, dialect)


@contextmanager
def mapped(path: Path) -> Iterator[ByteSource]:
    """The file's bytes without reading it whole; a pipe is read whole. Raises SkygcsError."""
    try:
        handle = path.open("rb")
    except OSError as error:
        raise SkygcsError(f"{path}: {error.strerror or error}") from None
    with handle:
        data: mmap.mmap | bytes
        try:
            data = mmap.mmap(handle.fileno(), 0, access=mmap.ACCESS_READ)
        except (OSError, ValueError):  # a pipe, or empty
            data = handle.read()
        try:
            yield data
        finally:
            if isinstance(data, mmap.mmap):
                data.close()
