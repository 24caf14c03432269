"""Writes every frame, both directions, to tlogs that QGroundControl and Mission Planner read.

`offer` only appends to memory; one writer thread writes whole chunks to the file. A thread, because a write to a slow
card can block for seconds when the kernel throttles dirty pages; only one thread, so that chunks keep their order.
There is no fsync: written bytes belong to the kernel and survive a kill -9; losses at a power cut depend on the file
system.

A disk fault is a state, not an error: one event when it begins, one when it ends, a growing pause between attempts, and
routing never waits. Only the last record of a file may be incomplete.
"""

from __future__ import annotations

import asyncio
import contextlib
import errno
import io
import os
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from skygcs.back_off import BackOff
from skygcs.config.files import LOG_MODE, make_log_folder
from skygcs.disk_writer import WriterThread
from skygcs.events import Event
from skygcs.tlog.format import TIME_BYTES, encode_record

FLUSH_PERIOD_S = 0.25
"""Longest time that a record waits in memory while the disk works; the write takes well below a second."""

PIECE_BYTES = 65536
"""Size of one write. A chunk of this size is written at once: 11 s of a full 57600 baud radio, 30 ms of a flood."""

MAX_BUFFER_BYTES = 8 << 20
"""Most bytes that wait for the disk; further records are dropped and counted. 24 minutes of a full 57600 baud radio."""

RETRY_FIRST_S = 1.0
RETRY_MAX_S = 10.0
"""Pause between attempts while the disk fails, doubling between these."""

CLOSE_TIMEOUT_S = 3.0
"""A stuck disk delays the end of the daemon by at most this."""

CLOCK_SET_US = 1_000_000
"""A time that is older than the last one by less than this belongs to the same burst, or the clock was slewed. With a
larger step the clock was set, and the file follows it."""

_FULL = frozenset({errno.ENOSPC, errno.EDQUOT})

OpenFile = Callable[[Path], io.FileIO]


def _open_new(path: Path) -> io.FileIO:
    """Open a new file, unbuffered; fails if it exists."""
    return io.FileIO(os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC, LOG_MODE), "wb")


@dataclass(slots=True)
class _Piece:
    """Whole records, in order."""

    data: bytearray = field(default_factory=bytearray)
    records: int = 0


class TlogFiles:
    """The files of one run of the daemon, on the writer's thread: opens, writes whole chunks, rotates, truncates.

    Names begin with the UTC time of their first record, so that they sort, and end with a counter.
    """

    def __init__(self, folder: Path, max_bytes: int, max_age_s: float, open_file: OpenFile) -> None:
        self.path: Path | None = None
        self.size = 0
        self.count = 0
        self._folder = folder
        self._max_bytes = max_bytes
        self._max_age_s = max_age_s
        self._open_file = open_file
        self._file: io.FileIO | None = None
        self._opened_at = 0.0
        self._number = 0

    def write(self, data: bytes | bytearray, now: float) -> None:
        """Write all of ``data`` (whole records); on OSError nothing of it is in the file."""
        if self._file is not None and self._is_over(len(data), now):
            self.close()
        file = self._file or self._open(data, now)
        start = self.size
        try:
            view = memoryview(data)
            while view:
                written = file.write(view)
                if not written:
                    raise OSError(f"{self.path}: nothing was written")
                view = view[written:]
        except OSError as error:
            self._cut(file, start)
            if error.errno not in _FULL:
                self.close()  # try another file: this one may be at its file system's limit, or its device gone
            raise
        self.size = start + len(data)

    def close(self) -> None:
        """Close the present file; the next write opens another."""
        file, self._file = self._file, None
        if file is not None:
            with contextlib.suppress(OSError):  # the data is written; a late error here can no longer be reported
                file.close()

    def _is_over(self, coming: int, now: float) -> bool:
        """True if the file is full, too old, or was deleted (its records would be lost)."""
        assert self._file is not None
        if self.size and (self.size + coming > self._max_bytes or now - self._opened_at >= self._max_age_s):
            return True
        try:
            return os.fstat(self._file.fileno()).st_nlink == 0
        except OSError:
            return True

    def _open(self, data: bytes | bytearray, now: float) -> io.FileIO:
        make_log_folder(self._folder)
        unix_us = int.from_bytes(data[:TIME_BYTES], "big")
        try:
            begun = f"{datetime.fromtimestamp(unix_us / 1e6, UTC):%Y%m%dT%H%M%SZ}"
        except (ValueError, OverflowError, OSError):
            begun = "00000000T000000Z"  # a clock that was never set: the counter keeps the order
        while True:
            path = self._folder / f"{begun}-{self._number + 1:04d}.tlog"
            try:
                file = self._open_file(path)
            except FileExistsError:
                self._number += 1
                continue
            self._number += 1
            self.count += 1
            self._file, self.path, self.size, self._opened_at = file, path, 0, now
            return file

    def _cut(self, file: io.FileIO, size: int) -> None:
        """Remove a partly written chunk; if that fails, too, the file ends there and a new one is begun."""
        try:
            if size:
                file.truncate(size)
                file.seek(size)
                return
        except OSError:
            self.close()
            return
        self.close()  # the first write failed: leave no empty file at every attempt
        self._number -= 1
        self.count -= 1
        with contextlib.suppress(OSError):
            if self.path is not None:
                self.path.unlink()
        self.path = None


class Recorder:
    """Bounded memory before `TlogFiles`. `offer` takes records, `run` writes them, `close` writes the rest.

    All methods belong to the loop's thread. ``on_event`` gets kind "recorder" when recording stops and when it is back.
    """

    def __init__(
        self,
        log_dir: Path,
        max_bytes: int,
        max_age_s: float,
        on_event: Callable[[Event], None],
        *,
        open_file: OpenFile = _open_new,
        max_buffer_bytes: int = MAX_BUFFER_BYTES,
    ) -> None:
        self._files = TlogFiles(log_dir, max_bytes, max_age_s, open_file)
        self._log_dir = log_dir
        self._on_event = on_event
        self._piece_bytes = max(min(PIECE_BYTES, max_bytes // 4), 1)
        self._max_buffer_bytes = max_buffer_bytes
        self._executor = WriterThread("tlog")
        self._flushing: asyncio.Task[None] | None = None
        self._closed = False
        self._newest_us = 0
        self._pieces: deque[_Piece] = deque()  # closed and waiting
        self._piece = _Piece()  # being filled
        self._buffered_bytes = 0
        self._some = asyncio.Event()
        self._many = asyncio.Event()
        self._records = 0
        self._bytes = 0
        self._lost = 0
        self._lost_in_fault = 0
        self._fault: str | None = None
        self._fault_since = 0.0
        self._refused = False  # the last write failed
        self._back_off = BackOff(RETRY_FIRST_S, RETRY_MAX_S)

    def offer(self, raw: bytes, unix_us: int) -> None:
        """Record one frame. Hot: never blocks, never raises; without room the frame is dropped and counted.

        A time that is older than the last record's by less than CLOCK_SET_US becomes that record's time: an answer of
        ours is recorded between the frames of one datagram, which all have the time of its arrival.
        """
        if unix_us >= 0 and 0 < self._newest_us - unix_us < CLOCK_SET_US:
            unix_us = self._newest_us
        else:
            self._newest_us = unix_us
        piece = self._piece
        size = TIME_BYTES + len(raw)
        if self._closed or unix_us < 0 or self._buffered_bytes + size > self._max_buffer_bytes:
            self._drop()
            return
        piece.data += encode_record(unix_us, raw)
        piece.records += 1
        self._buffered_bytes += size
        self._offered(piece, piece.records == 1)

    def _offered(self, piece: _Piece, first: bool) -> None:
        if first:
            self._some.set()
        if len(piece.data) >= self._piece_bytes:
            self._pieces.append(piece)
            self._piece = _Piece()
            self._some.set()
            self._many.set()

    def offer_many(self, records: bytes, count: int) -> None:
        """`offer` for several encoded records in order; without room for all, all are dropped."""
        piece = self._piece
        if self._closed or self._buffered_bytes + len(records) > self._max_buffer_bytes:
            self._drop(count)
            return
        self._newest_us = max(self._newest_us, int.from_bytes(records[:TIME_BYTES], "big"))
        piece.data += records
        piece.records += count
        self._buffered_bytes += len(records)
        self._offered(piece, piece.records == count)

    async def run(self) -> None:
        """Write until cancelled; then call `close`. A disk fault never ends it."""
        loop = asyncio.get_running_loop()
        while True:
            await self._some.wait()
            self._some.clear()
            if not self._many.is_set():
                with contextlib.suppress(TimeoutError):
                    async with asyncio.timeout(FLUSH_PERIOD_S):
                        await self._many.wait()
            self._many.clear()
            if self._refused:
                await asyncio.sleep(self._back_off.after())
            self._flushing = loop.create_task(self._flush(), name="tlog flush")
            await asyncio.shield(self._flushing)  # let the thread finish its write, and count it
            if self._refused:
                self._some.set()

    async def close(self) -> None:
        """Write the waiting records and close the file. Idempotent. Never raises; waits CLOSE_TIMEOUT_S for a stuck
        disk."""
        if self._closed:
            return
        self._closed = True
        loop = asyncio.get_running_loop()
        with contextlib.suppress(TimeoutError):
            async with asyncio.timeout(CLOSE_TIMEOUT_S):
                if self._flushing is not None and not self._flushing.done():
                    await asyncio.shield(self._flushing)
                self._flushing = loop.create_task(self._flush(), name="last tlog flush")
                await asyncio.shield(self._flushing)
                await loop.run_in_executor(self._executor, self._files.close)
        self._executor.shutdown()
        if waiting := sum(p.records for p in self._pieces) + self._piece.records:
            self._lost += waiting
            self._report(f"recording ended with {waiting} records unwritten: {self._fault or 'the disk is stuck'}")

    def status(self) -> dict[str, Any]:
        """JSON-able: file, records written and lost, and the present fault."""
        return {
            "state": "closed" if self._closed else "failing" if self._fault is not None else "recording",
            "folder": str(self._log_dir),
            "file": str(self._files.path) if self._files.path is not None else None,
            "file_bytes": self._files.size,
            "files": self._files.count,
            "records": self._records,
            "bytes": self._bytes,
            "buffered_bytes": self._buffered_bytes,
            "lost_records": self._lost,
            "error": self._fault,
        }

    async def _flush(self) -> None:
        """Write all present chunks in order; on a fault keep the rest for the next attempt."""
        loop = asyncio.get_running_loop()
        if self._piece.records:
            self._pieces.append(self._piece)
            self._piece = _Piece()
        for _ in range(len(self._pieces)):
            piece = self._pieces[0]
            try:
                await loop.run_in_executor(self._executor, self._files.write, piece.data, loop.time())
            except Exception as error:  # routing and later attempts go on in any case
                self._refused = True
                self._failed(getattr(error, "strerror", None) or str(error) or type(error).__name__)
                return
            self._pieces.popleft()
            self._buffered_bytes -= len(piece.data)
            self._records += piece.records
            self._bytes += len(piece.data)
        self._refused = False
        self._recovered()

    def _drop(self, records: int = 1) -> None:
        self._lost += records
        self._lost_in_fault += records
        if self._fault is None and not self._closed:
            self._failed("the disk is too slow, memory is full")

    def _failed(self, reason: str) -> None:
        if self._fault is None:
            self._fault_since = asyncio.get_running_loop().time()
            self._back_off.reset()
            self._fault = reason
            self._report(
                f"recording to {self._log_dir} stopped: {reason}; everything else goes on",
                error=reason,
                recording=False,
            )
        self._fault = reason

    def _recovered(self) -> None:
        if self._fault is None:
            return
        seconds = asyncio.get_running_loop().time() - self._fault_since
        lost, self._lost_in_fault, self._fault = self._lost_in_fault, 0, None
        self._report(
            f"recording again after {seconds:.0f} s; {lost} records lost",
            lost=lost,
            seconds=round(seconds, 1),
            recording=True,
        )

    def _report(self, text: str, **data: Any) -> None:
        self._on_event(Event("recorder", None, None, text, data))
