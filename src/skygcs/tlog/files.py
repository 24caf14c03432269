"""Logs and tables as files: opened without being read whole, written whole or not at all."""

from __future__ import annotations

import signal
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from types import TracebackType
from typing import IO, Any, BinaryIO, NoReturn, overload

from skygcs.core.mavlink.dialect import Dialect
from skygcs.ending_signals import ending_signals
from skygcs.errors import SkygcsError
from skygcs.terminal_text import visible
from skygcs.tlog.format import ByteSource, LogEntry, LogKind, sniff
from skygcs.tlog.reading import LogFaults, LogReader
from skygcs.tlog.selection import Selection

WINDOW_BYTES = 65536

PROGRESS_FROM_BYTES = 20 << 20
"""Some 2 s of work; a shorter log shows no bar."""

PROGRESS_STEP_BYTES = 1 << 20

KIND_NAMES = {"tlog": "tlog", "raw": "raw capture"}

OTHER_FILES = {
    b"ULog\x01\x12\x35": "a log that a PX4 wrote on board; PlotJuggler and Flight Review read it",
    b"\xa3\x95\x80\x80": "a log that an ArduPilot wrote on board; Mission Planner and MAVExplorer read it",
    b"\x1f\x8b": "packed; unpack it with gunzip",
    b"PK\x03\x04": "packed; unpack it with unzip",
}
"""Other files that lie beside tlogs, by the bytes they begin with."""

PART_SUFFIX = ".part"
"""Suffix of a file while it is written."""


class FileWindow:
    """A file as a sequence of bytes, read piecewise: memory does not grow with it.

    Not memory-mapped: a mapped file that is truncated while it is read kills the process by SIGBUS; here the missing
    bytes read as nothing."""

    def __init__(self, file: BinaryIO) -> None:
        self._file = file
        self._size = file.seek(0, 2)
        self._window = b""
        self._start = 0

    def __len__(self) -> int:
        return self._size

    @overload
    def __getitem__(self, index: int, /) -> int: ...

    @overload
    def __getitem__(self, index: slice, /) -> bytes: ...

    def __getitem__(self, index: int | slice, /) -> int | bytes:
        if isinstance(index, slice):
            start, stop, _ = index.indices(self._size)
            return self._read(start, max(stop - start, 0))
        found = self._read(index, 1)
        return found[0] if found else 0

    def _read(self, start: int, size: int) -> bytes:
        at = start - self._start
        if at < 0 or at + size > len(self._window):
            self._file.seek(start)
            self._window = self._file.read(max(size, WINDOW_BYTES))
            self._start = start
            at = 0
        return self._window[at : at + size]


class _Progress:
    """A progress bar on stderr, for a long file on a terminal. Called with the offset reached."""

    def __init__(self, size: int) -> None:
        self._bar: Any = None
        self._next = 0
        if size >= PROGRESS_FROM_BYTES and sys.stderr.isatty():
            from rich.console import Console
            from rich.progress import Progress

            self._bar = Progress(console=Console(stderr=True), transient=True)
            self._task = self._bar.add_task("reading", total=size)
            self._bar.start()

    def __call__(self, offset: int) -> None:
        if self._bar is not None and offset >= self._next:
            self._next = offset + PROGRESS_STEP_BYTES
            self._bar.update(self._task, completed=offset)

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
            raise _no_mavlink(path, data)
        self.kind: LogKind = kind
        self._data = data

    @property
    def stem(self) -> str:
        """The beginning of the names of files made from it."""
        return self.path.stem

    def entries(self) -> Iterator[LogEntry]:
        """Raises SkygcsError at the end if there was no MAVLink in it."""
        reader = LogReader(self._data, self.dialect, self.kind)
        progress = _Progress(self.size)
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
            raise _no_mavlink(self.path, self._data)

    def selected(self, selection: Selection) -> Iterator[LogEntry]:
        """The entries that match. Raises SkygcsError as `check_times` does."""
        self.check_times(selection)
        return (entry for entry in self.entries() if selection.takes(entry))

    def check_times(self, selection: Selection) -> None:
        """Raises SkygcsError if a time of day is selected in a log that has none."""
        if self.kind == "raw" and selection.absolute:
            raise SkygcsError(f"{self.path}: a raw capture has no time of day; give --from and --to in seconds")

    def print_faults(self) -> None:
        """On stderr, a line each. Faults are no failure: everything else was read."""
        for line in self.faults.lines():
            note(f"{self.path}: {line}")


def note(text: str) -> None:
    """One line on stderr."""
    print(f"note: {visible(text)}", file=sys.stderr)


def _no_mavlink(path: Path, data: ByteSource) -> SkygcsError:
    head = data[:8]
    other = next((what for mark, what in OTHER_FILES.items() if head.startswith(mark)), None)
    fault = "no MAVLink in it, neither as a tlog nor as a raw capture" if head else "it is empty"
    return SkygcsError(f"{path}: {fault}{(other and f': it is {other}') or ''}")


@contextmanager
def opened_log(path: Path, dialect: Dialect) -> Iterator[LogFile]:
    """An open log; a pipe is read whole. Raises SkygcsError for a file that cannot be read or holds no MAVLink."""
    try:
        file = path.open("rb")
    except OSError as error:
        raise SkygcsError(f"{path}: {error.strerror or error}") from None
    with file:
        yield LogFile(path, FileWindow(file) if file.seekable() else file.read(), dialect)


class Outputs:
    """Files that a tool writes: all of them whole, or none of them there. They are written beside their place and moved
    there at the end of the ``with`` block if it raised nothing. Meanwhile a signal that ends the program raises
    SystemExit: what it would leave half written may be gigabytes. For the main thread."""

    def __init__(self, force: bool) -> None:
        self._force = force
        self._open: dict[Path, IO[Any]] = {}
        self._handlers: dict[signal.Signals, Any] = {}

    def __enter__(self) -> Outputs:
        for number in ending_signals():
            if signal.getsignal(number) is signal.SIG_DFL:
                self._handlers[number] = signal.signal(number, _end)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        for number in self._handlers:  # a terminal's end sends one more: it must not end this half done
            signal.signal(number, signal.SIG_IGN)
        problem: SkygcsError | None = None
        for path, file in self._open.items():
            try:
                file.close()
            except OSError as full:  # the buffer is written only now
                problem = SkygcsError(f"{path}: {full.strerror or full}")
        for path in self._open:
            if kind is None and problem is None:
                _part(path).replace(path)
            else:
                _part(path).unlink(missing_ok=True)
        for number, handler in self._handlers.items():
            signal.signal(number, handler)
        if kind is None and problem is not None:
            raise problem

    @property
    def paths(self) -> list[Path]:
        return list(self._open)

    def open_bytes(self, path: Path) -> IO[bytes]:
        """A new file. Raises SkygcsError if it cannot be made, or exists and must not be overwritten."""
        return self._opened(path, "wb")

    def open_text(self, path: Path) -> IO[str]:
        """The same for text (UTF-8, line ends as written)."""
        return self._opened(path, "w", encoding="utf-8", newline="")

    def _opened(self, path: Path, mode: str, **more: Any) -> IO[Any]:
        if path.is_dir():
            raise SkygcsError(f"{path}: is a folder; name a file in it")
        if path.exists() and not self._force:
            raise SkygcsError(f"{path}: exists; --force overwrites it")
        try:
            file: IO[Any] = open(_part(path), mode, **more)  # noqa: SIM115 - closed by __exit__
        except OSError as error:
            raise SkygcsError(f"{path}: {error.strerror or error}") from None
        self._open[path] = file
        return file


def make_folder(path: Path) -> None:
    """Raises SkygcsError."""
    try:
        path.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise SkygcsError(f"{path}: {error.strerror or error}") from None


def _end(number: int, _: object) -> NoReturn:
    raise SystemExit(128 + number)


def _part(path: Path) -> Path:
    return path.with_name(path.name + PART_SUFFIX)
