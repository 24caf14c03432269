"""The standard error of a process that flies: no write waits for its reader, whether there is one or not.

A terminal that was stopped with Ctrl-S, a pipe that nobody reads, and a full disk make a write wait for ever or fail.
The loop that writes is the one that flies: log lines, warnings, tracebacks and what the interpreter itself prints.

    stderr is                  a line is written
    -------------------------  -----------------------------------------------------------------------------------------
    a pipe, a terminal         at once by its caller, as far as there is room: lines before an abrupt end (a signal,
                               os.abort) are there. A thread waits for room for the rest
    a socket                   likewise
    a file                     by the thread: a disk may make any write wait, and no way exists to ask it. An abrupt end
                               may lose the lines of its last milliseconds
    what cannot be opened      by the thread: a pipe of another user, whose flags are shared with its other writers
    in memory                  at once by its caller

What cannot be written is left out and counted; the count stands where the lines are missing.
"""

from __future__ import annotations

import contextlib
import io
import os
import select
import socket
import stat
import threading
import time
from collections import deque
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import TextIO

MAX_WAITING_BYTES = 256 * 1024
"""Some 2,000 lines: more than `log_limit` lets through while a slow terminal scrolls."""

MAX_PART_CHARS = 8192
"""Text without the end of its line that is kept until its end comes."""

DRAIN_S = 1.0
"""Longest wait, at the end of the process, for lines that are not written yet."""

ROOM_AGAIN_S = 0.01
"""Pause of the thread between two attempts: some terminals report room and then take nothing."""

LOCK_S = 1.0
"""Longest wait of a write for another thread's. No write takes so long; but the interpreter stops threads at its end,
and one of them may hold the lock for ever."""

Write = Callable[[bytes], int]
"""Writes to a descriptor as much as it takes; raises OSError, BlockingIOError for nothing."""


@dataclass(slots=True)
class _Waiting:
    """Text that waits for the thread, and the number of lines that were left out right behind it."""

    data: bytes
    lost_behind: int = 0


class LogStream(io.TextIOBase):
    """A text file in place of ``file``, for loggers and as `sys.stderr`: `write` never blocks and never raises.

    ``file`` None (a process without stderr): nothing is written. One without a descriptor is in memory.
    """

    encoding = "utf-8"
    errors = "backslashreplace"

    def __init__(self, file: TextIO | None) -> None:
        self._file = file
        self._descriptor = _duplicate(file)
        self._at_once = None if self._descriptor is None else _without_waiting(self._descriptor)
        """None: a write may wait."""
        self._memory = file if self._descriptor is None else None
        self._changed = threading.Condition()  # of an RLock: what a finalizer prints may come in the middle of a write
        self._part = ""
        """Text whose line has no end yet."""
        self._waiting: deque[_Waiting] = deque()
        """The first stays in it until it is written."""
        self._waiting_bytes = 0
        self._lost = 0
        """Lines that were left out before the first that waits, or before the next."""
        self._torn = False
        """True if the last line was written in part, and has no end."""
        self._thread: threading.Thread | None = None

    def writable(self) -> bool:
        return True

    def fileno(self) -> int:
        """The descriptor that ``file`` has. Raises OSError without one."""
        if self._file is None:
            raise OSError("this process has no stderr")
        return self._file.fileno()

    def isatty(self) -> bool:
        return self._file is not None and self._file.isatty()

    def write(self, text: str) -> int:
        """Take text; what finds no room is left out. A line is written when it is complete, or at `flush`."""
        if self._descriptor is None:
            if self._memory is not None:
                with contextlib.suppress(OSError, ValueError):
                    self._memory.write(text)
            return len(text)
        with self._locked() as locked:
            if locked:
                whole, newline, self._part = (self._part + text).rpartition("\n")
                if newline:
                    self._take(whole + newline)
                if len(self._part) > MAX_PART_CHARS:
                    self._take_part()
        return len(text)

    def flush(self) -> None:
        """Take what was written of a line that has no end yet; does not wait."""
        with self._locked() as locked:
            if locked:
                self._take_part()

    def drain(self, within_s: float = DRAIN_S) -> bool:
        """Wait until everything is written, with the count of what is missing at the end; False after ``within_s``. For
        the end of the process."""
        until_s = time.monotonic() + within_s
        with self._locked() as locked:
            if not locked:
                return False
            self._take_part()
            if not self._wait_written(until_s):
                return False
            if self._lost:
                self._take("")
            return self._wait_written(until_s)

    # -- with the lock

    @contextlib.contextmanager
    def _locked(self) -> Iterator[bool]:
        locked = self._changed.acquire(timeout=LOCK_S)
        try:
            yield locked
        finally:
            if locked:
                self._changed.release()

    def _wait_written(self, until_s: float) -> bool:
        return self._changed.wait_for(lambda: not self._waiting, max(0.0, until_s - time.monotonic()))

    def _take_part(self) -> None:
        part, self._part = self._part, ""
        if part:
            self._take(part)

    def _take(self, text: str) -> None:
        """Write text, or leave it to the thread, or leave it out. Without text: the count that is owed."""
        data = rest = text.encode(errors=self.errors)
        if not self._waiting and self._at_once is not None:
            rest = self._begin(data)
            if not rest and (data or not self._lost):
                return
        if self._waiting_bytes + len(rest) > MAX_WAITING_BYTES or not self._has_thread():
            self._leave_out(rest, begun=len(rest) < len(data))
            return
        self._waiting.append(_Waiting(rest))
        self._waiting_bytes += len(rest)
        self._changed.notify_all()

    def _begin(self, data: bytes) -> bytes:
        """Write what there is room for, or count what cannot be written at all; returns the rest."""
        assert self._at_once is not None
        owed = self._owed()
        whole = owed + data
        try:
            written = self._at_once(whole)
        except BlockingIOError:
            return data
        except OSError:
            self._lost += _lines(data)
            return b""
        if written < len(owed):  # of a count in part: it is written anew, on a line of its own
            self._torn = _ends_within_line(whole, written, self._torn)
            return data
        self._lost, self._torn = 0, False
        return whole[written:]

    def _leave_out(self, data: bytes, *, begun: bool) -> None:
        lines = _lines(data)
        if self._waiting:
            self._waiting[-1].lost_behind += lines
        else:
            self._lost += lines
            self._torn = self._torn or begun

    def _owed(self) -> bytes:
        """The end of a torn line and the count of lines that are missing, to stand before the next text."""
        note = f"({self._lost} lines of this log could not be written)\n" if self._lost else ""
        return ("\n" if self._torn else "").encode() + note.encode()

    def _has_thread(self) -> bool:
        """True if the thread runs; it is started for the first text that has to wait."""
        if self._thread is None:
            thread = threading.Thread(target=self._work, name="log", daemon=True)
            try:
                thread.start()
            except RuntimeError:  # no further thread can be started, now or as the interpreter ends
                return False
            self._thread = thread
        return True

    # -- the thread

    def _work(self) -> None:
        while True:
            with self._changed:
                self._changed.wait_for(lambda: bool(self._waiting))
                first = self._waiting[0]
                owed = self._owed()
            whole = owed + first.data
            written = self._put(whole)
            with self._changed:
                self._torn = written < len(whole) and _ends_within_line(whole, written, self._torn)
                counted = written >= len(owed)
                self._lost = (0 if counted else self._lost) + _lines(whole[max(written, len(owed)) :])
                self._lost += first.lost_behind
                self._waiting.popleft()
                self._waiting_bytes -= len(first.data)
                self._changed.notify_all()

    def _put(self, data: bytes) -> int:
        """Write it, however long that takes; returns how many bytes could be written."""
        assert self._descriptor is not None
        write = self._at_once or self._write
        poll = select.poll()
        poll.register(self._descriptor, select.POLLOUT)
        written = 0
        while written < len(data):
            try:
                written += write(data[written:])
            except BlockingIOError:  # another process may have set O_NONBLOCK, which all that share the file have then
                poll.poll()
                time.sleep(ROOM_AGAIN_S)
            except OSError:
                break
        return written

    def _write(self, data: bytes) -> int:
        assert self._descriptor is not None
        return os.write(self._descriptor, data)


def _ends_within_line(data: bytes, written: int, before: bool) -> bool:
    """True if a file whose last line has no end (``before``) has none after so many bytes of this."""
    return data[written - 1 : written] != b"\n" if written else before


def _lines(data: bytes) -> int:
    return data.count(b"\n") or bool(data)


def _duplicate(file: TextIO | None) -> int | None:
    """A descriptor of the file that is ours alone: a write that waits keeps no lock that the interpreter needs at its
    end. None: the file has none."""
    try:
        return None if file is None else os.dup(file.fileno())
    except (OSError, ValueError):
        return None


def _without_waiting(descriptor: int) -> Write | None:
    """Writes to the same pipe, terminal or socket without waiting for room; None: that cannot be done.

    The flag O_NONBLOCK of a descriptor is shared with all processes that inherited it. So a pipe or terminal is opened
    once more (proc(5), /proc/PID/fd), and a socket is asked at each write.
    """
    mode = os.fstat(descriptor).st_mode
    if stat.S_ISSOCK(mode):
        with contextlib.suppress(OSError):
            sock = socket.socket(fileno=os.dup(descriptor))
            return lambda data: sock.send(data, socket.MSG_DONTWAIT)
    if stat.S_ISFIFO(mode) or stat.S_ISCHR(mode):
        with contextlib.suppress(OSError):
            path = f"/proc/self/fd/{descriptor}"
            own = os.open(path, os.O_WRONLY | os.O_NONBLOCK | os.O_NOCTTY | os.O_CLOEXEC)
            return lambda data: os.write(own, data)
    return None
