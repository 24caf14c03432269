"""The control trace of one vehicle on disk: one CSV file per engagement, written during the flight."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable
from pathlib import Path
from typing import TextIO

from skygcs.core.control.cascade import Memory
from skygcs.core.control.gains import ControlConfig
from skygcs.core.control.trace import PredictionStep, TraceHead, TraceRow, TraceWriter
from skygcs.core.vehicle.offboard_controller import OffboardController
from skygcs.core.vehicle.offboard_tick import Tick
from skygcs.events import Event

FLUSH_S = 1.0
"""A crash loses at most this much."""

LARGEST_BYTES = 500_000_000
"""Three hours at 50 Hz (some 800 B a row); then the trace ends with a warning."""


class TraceFile:
    """One file. Every method raises OSError; the caller closes the file then."""

    def __init__(self, directory: Path, head: TraceHead) -> None:
        directory.mkdir(parents=True, exist_ok=True)
        stamp = time.strftime("%Y%m%d-%H%M%S", time.gmtime())
        name = "".join(c if c.isalnum() else "_" for c in head.vehicle)
        self.path = _free(directory, f"control-{name}-{stamp}")
        self._file: TextIO = self.path.open("x", encoding="ascii", buffering=1 << 16)
        self._writer = TraceWriter(head)
        self._flushed_at = 0.0
        self._bytes = 0

    def write(
        self,
        row: TraceRow,
        config: ControlConfig,
        before: Memory,
        after: Memory,
        prediction: PredictionStep | None = None,
    ) -> None:
        """Raises OSError."""
        text = self._writer.lines(row, config, before, after, prediction)
        self._bytes += len(text)
        if self._bytes > LARGEST_BYTES:
            raise OSError(f"the trace has reached {LARGEST_BYTES // 1_000_000} MB")
        self._file.write(text)
        if row.t_s - self._flushed_at >= FLUSH_S:
            self._flushed_at = row.t_s
            self._file.flush()

    def close(self) -> None:
        self._file.close()


class Recording:
    """Traces a controller's ticks while tracing is on: one file from each `begin` to its `end`.

    A disk that is full or gone ends the trace, is reported once, and never affects control.
    """

    def __init__(self, offboard: OffboardController, directory: Path, on_event: Callable[[Event], None]) -> None:
        self._offboard = offboard
        self._directory = directory
        self._on_event = on_event
        self._wanted = False
        self._file: TraceFile | None = None

    @property
    def path(self) -> Path | None:
        """Path of the open file."""
        return None if self._file is None else self._file.path

    def record(self, on: bool) -> Path | None:
        """Turn tracing on or off, also for later engagements. Returns the path of the open file, or of the last one;
        None if there is none yet."""
        self._wanted = on
        if on and self._offboard.active:
            self.begin()
        path = self.path
        if not on:
            self.end()
        return path

    def begin(self) -> None:
        """Control has begun: open a file, if tracing is on and none is open."""
        if not self._wanted or self._file is not None or self._offboard.frame is None:
            return
        local_origin = self._offboard.frame.origin
        head = TraceHead(
            self._offboard.vehicle.name, local_origin.lat_deg, local_origin.lon_deg, local_origin.alt_amsl_m
        )
        try:
            self._file = TraceFile(self._directory, head)
        except OSError as error:
            self._give_up(error)
            return
        self._offboard.tracing = True

    def write(self, tick: Tick) -> None:
        """Write a tick's row, if it has one."""
        if tick.row is None or self._file is None or tick.before is None or tick.after is None:
            return
        try:
            self._file.write(tick.row, self._offboard.config.law, tick.before, tick.after, tick.prediction)
        except OSError as error:
            self._give_up(error)

    def end(self) -> None:
        """Control has ended, or tracing was turned off: close the file. Idempotent."""
        file, self._file, self._offboard.tracing = self._file, None, False
        if file is not None:
            try:
                file.close()
            except OSError as error:
                self._give_up(error)

    def _give_up(self, error: OSError) -> None:
        file, self._file, self._offboard.tracing = self._file, None, False
        if file is not None:
            with contextlib.suppress(OSError):  # errors are reported below
                file.close()
        vehicle = self._offboard.vehicle
        text = f"its control trace has ended: {error.strerror or error}"
        self._on_event(Event("warning", vehicle.name, vehicle.sysid, text, {}))


def _free(directory: Path, name: str) -> Path:
    """A path that does not exist yet: two traces may begin within one second."""
    path = directory / f"{name}.csv"
    number = 1
    while path.exists():
        number += 1
        path = directory / f"{name}-{number}.csv"
    return path
