"""The control trace of one vehicle on disk: one CSV file per engagement, written during the flight."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import BinaryIO

from skygcs.config.files import make_log_folder, open_new
from skygcs.core.control.cascade import Memory
from skygcs.core.control.gains import ControlConfig
from skygcs.core.control.trace import PredictionStep, TraceHead, TraceRow, TraceWriter
from skygcs.core.vehicle.offboard_controller import OffboardController
from skygcs.core.vehicle.setpoint_generator import Tick
from skygcs.disk_writer import DiskWriter
from skygcs.events import Event

FLUSH_S = 1.0
"""A crash loses at most this much."""

LARGEST_PIECE_BYTES = 256 << 10
"""Bytes of lines that wait to be given to the disk at most: 6 s at 50 Hz."""

LARGEST_BYTES = 500_000_000
"""Three hours at 50 Hz (some 800 B a row); then the trace ends with a warning."""


class TraceFile:
    """One file. ``path`` is where it will be; if that exists by then, `write` takes another name.

    `encode` is for the loop, `write` and `close` are for the disk's thread. All three raise OSError; the caller closes
    the file then.
    """

    def __init__(self, directory: Path, head: TraceHead) -> None:
        stamp = time.strftime("%Y%m%d-%H%M%S", time.gmtime())
        name = "".join(c if c.isalnum() else "_" for c in head.vehicle)
        self.path = directory / f"control-{name}-{stamp}.csv"
        self._file: BinaryIO | None = None
        self._closed = False
        self._writer = TraceWriter(head)
        self._bytes = 0

    def encode(
        self,
        row: TraceRow,
        config: ControlConfig,
        before: Memory,
        after: Memory,
        prediction: PredictionStep | None = None,
    ) -> str:
        """The lines of a row, which are to be written in this order. Raises OSError at LARGEST_BYTES."""
        text = self._writer.lines(row, config, before, after, prediction)
        self._bytes += len(text)
        if self._bytes > LARGEST_BYTES:
            raise OSError(f"the trace has reached {LARGEST_BYTES // 1_000_000} MB")
        return text

    @property
    def begun(self) -> bool:
        """True if there is a file."""
        return self._file is not None

    def write(self, text: str) -> None:
        """Write these lines; the first ones make the file. Raises OSError."""
        if self._closed:
            return
        if self._file is None:
            self.path, self._file = _new_file(self.path)
        self._file.write(text.encode("ascii"))
        self._file.flush()

    def close(self) -> None:
        """Close the file; nothing is written afterwards. Raises OSError."""
        self._closed = True
        if self._file is not None:
            self._file.close()


class Recording:
    """Traces a controller's ticks while tracing is on: one file from each `begin` to its `end`.

    Lines are made here and written by the daemon's `DiskWriter`. A disk that is full, gone or stuck ends the trace, is
    reported once, and never affects control.
    """

    def __init__(
        self, offboard: OffboardController, directory: Path, disk: DiskWriter, on_event: Callable[[Event], None]
    ) -> None:
        self._offboard = offboard
        self._directory = directory
        self._disk = disk
        self._on_event = on_event
        self._wanted = False
        self._file: TraceFile | None = None
        self._cut: Path | None = None
        """Path of a trace that the disk has ended; `record` returns it once."""
        self._lines: list[str] = []
        self._size = 0
        self._flushed_at = 0.0

    @property
    def path(self) -> Path | None:
        """Path of the open file."""
        return None if self._file is None else self._file.path

    def record(self, on: bool) -> Path | None:
        """Turn tracing on or off, also for later engagements. Returns the path of the file that is written, or was
        until now, or until the disk took no more; None: nothing was."""
        self._wanted = on
        if on and self._offboard.active:
            self.begin()
        path, self._cut = self.path or self._cut, None
        if not on:
            self.end()
        return path

    def begin(self) -> None:
        """Control has begun: begin a file, if tracing is on and there is none."""
        if not self._wanted or self._file is not None or self._offboard.frame is None:
            return
        local_origin = self._offboard.frame.origin
        head = TraceHead(
            self._offboard.vehicle.name, local_origin.lat_deg, local_origin.lon_deg, local_origin.alt_amsl_m
        )
        self._file = TraceFile(self._directory, head)
        self._flushed_at = -FLUSH_S  # the first row makes the file
        self._offboard.tracing = True

    def write(self, tick: Tick) -> None:
        """Note a tick's row, if it has one; it is given to the disk every FLUSH_S."""
        file = self._file
        if tick.row is None or file is None or tick.before is None or tick.after is None:
            return
        try:
            text = file.encode(tick.row, self._offboard.config.law, tick.before, tick.after, tick.prediction)
        except OSError as error:
            self._give_up(error)
            return
        self._lines.append(text)
        self._size += len(text)
        if tick.row.t_s - self._flushed_at >= FLUSH_S or self._size >= LARGEST_PIECE_BYTES:
            self._flushed_at = tick.row.t_s
            self._flush(file)

    def end(self) -> None:
        """Control has ended, or tracing was turned off: write the rest and close the file. Idempotent."""
        file = self._file
        if file is None:
            return
        if self._lines:
            self._flush(file)
        if self._file is file:
            self._file, self._offboard.tracing = None, False
            self._disk.offer("control trace", file.close)

    def _flush(self, file: TraceFile) -> None:
        text, size = "".join(self._lines), self._size
        self._lines, self._size = [], 0
        written = self._disk.offer("control trace", partial(file.write, text), size)
        if written is None:
            self._give_up(OSError("the disk is stuck, and too much waits for it"))
        else:
            written.add_done_callback(partial(self._on_written, file))

    def _on_written(self, file: TraceFile, written: asyncio.Future[None]) -> None:
        error = None if written.cancelled() else written.exception()
        if error is not None:
            self._give_up(error, file)

    def _give_up(self, error: BaseException, of: TraceFile | None = None) -> None:
        file = self._file
        if file is None or (of is not None and of is not file):
            return
        self._file, self._lines, self._size, self._offboard.tracing = None, [], 0, False
        self._cut = file.path if file.begun else None
        self._disk.offer("control trace", file.close)
        vehicle = self._offboard.vehicle
        text = f"its control trace has ended: {getattr(error, 'strerror', None) or error}"
        self._on_event(Event("warning", vehicle.name, vehicle.sysid, text, {}))


def _new_file(path: Path) -> tuple[Path, BinaryIO]:
    """A new file of this name, or with a number behind it: two traces may begin within one second. Raises OSError."""
    make_log_folder(path.parent)
    number, free = 1, path
    while True:
        try:
            return free, open_new(free)
        except FileExistsError:
            number += 1
            free = path.with_name(f"{path.stem}-{number}.csv")
