"""Journal of what flies, for the daemon that begins after this one was killed: one small file in `log_dir`.

It is written beside the loop (`DiskWriter`), at changes of state and every `PERIOD_S` while a vehicle is in the air;
while the disk is stuck only the newest content waits for it.

Times in it are Unix time. Beside them stand the id of this start of the computer, and how far Unix time was ahead of
the clock of that start: a wall clock that was set meanwhile (by NTP, or by a person) makes no note of the same start
older or newer.
"""

from __future__ import annotations

import asyncio
import contextlib
import json
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

from skygcs.config.files import boot_id, make_log_folder, read_state, write_whole
from skygcs.core.vehicle.flight_note import FlightNote
from skygcs.disk_writer import DiskWriter
from skygcs.events import Event
from skygcs.number_text import is_number
from skygcs.runtime.vehicle_services import MAX_VEHICLES

FORMAT = 2

FILE = "flights.json"

OUT_OF_DATE = b"out of date: the disk did not take the newest notes\n"
"""Written over the begin of a file that could not be replaced."""

PERIOD_S = 2.0
"""Between two notes of places; what a vehicle does in that time is within the space that a lost one is given."""

MAX_BYTES = 1_000_000
"""Notes of 1 kB for `MAX_VEHICLES`, and some room."""


class FlightJournal:
    """`recall` once, at the start; then `note` a few times a second."""

    def __init__(
        self, folder: Path, disk: DiskWriter, on_event: Callable[[Event], None], clock: Callable[[], float]
    ) -> None:
        """``clock``: `loop_clock.boot_clock`."""
        self._path = folder / FILE
        self._disk = disk
        self._on_event = on_event
        self._states: tuple[Any, ...] = ()
        self._noted_at = -PERIOD_S
        self._writing = False
        self._waiting: bytes | None = None
        self._failed = False
        self._clock = clock
        self._boot_id = boot_id()
        self.unreadable = False
        """There is a journal of the daemon before, and it cannot be read: anything may have been flown."""

    def recall(self) -> list[FlightNote]:
        """The notes of the daemon before. A file that cannot be read is reported, and is none."""
        try:
            return read_state(self._path, MAX_BYTES, self._notes_of)
        except FileNotFoundError:
            return []
        except (OSError, ValueError) as error:
            self.unreadable = True
            self._report(
                f"{self._path} cannot be read: {error}; a vehicle that is in the air and follows setpoints when it is "
                "heard first is ordered to hold, unless another station flies it"
            )
            return []

    def due(self, states: tuple[Any, ...], now: float, *, flying: bool) -> bool:
        """True if a note has to be made: ``states`` differ from those of the last note, one is in the air, or the last
        note is not on disk."""
        return states != self._states or ((flying or self._failed) and now - self._noted_at >= PERIOD_S)

    def note(self, notes: Sequence[FlightNote], states: tuple[Any, ...], now: float) -> None:
        """Write these notes, as soon as the disk takes them."""
        self._states, self._noted_at = states, now
        table = {
            "format": FORMAT,
            "boot_id": self._boot_id,
            "unix_less_boot_s": time.time() - self._clock(),
            "notes": [note.as_json() for note in notes[:MAX_VEHICLES]],
        }
        self._waiting = json.dumps(table).encode()
        self._write_next()

    def _write_next(self) -> None:
        if self._writing or self._waiting is None:
            return
        content, self._waiting = self._waiting, None
        written = self._disk.offer("the journal of flights", partial(_write, self._path, content), len(content))
        if written is None:  # stuck: `DiskWriter` has reported it
            self._waiting = content
            return
        self._writing = True
        written.add_done_callback(self._written)

    def _written(self, written: asyncio.Future[None]) -> None:
        self._writing = False
        error = None if written.cancelled() else written.exception()
        if error is not None and not self._failed:
            self._report(f"{self._path} cannot be written: {error}; a restart will not know what flies")
        elif error is None and self._failed:
            self._report(f"{self._path} is written again")
        self._failed = error is not None
        self._write_next()

    def _notes_of(self, table: Any) -> list[FlightNote]:
        if table["format"] != FORMAT:
            raise ValueError(f"format {table['format']!r}")
        notes = [FlightNote.from_json(note) for note in table["notes"][:MAX_VEHICLES]]
        return self._by_wall_clock(table, notes)

    def _by_wall_clock(self, table: Mapping[str, Any], notes: list[FlightNote]) -> list[FlightNote]:
        """The notes with their times as the wall clock would have shown them that is right now, if they are of this
        start of the computer; those of another start, or of a version before, as they are."""
        ahead_s = table.get("unix_less_boot_s")
        if not self._boot_id or table.get("boot_id") != self._boot_id or not is_number(ahead_s):
            return notes
        set_by_s = time.time() - self._clock() - ahead_s
        return [replace(note, frames=tuple((at + set_by_s, raw) for at, raw in note.frames)) for note in notes]

    def _report(self, text: str) -> None:
        self._on_event(Event("warning", None, None, text, {"file": str(self._path)}))


def _write(path: Path, content: bytes) -> None:
    """Raises OSError; the file then says that it is out of date, which a full disk still takes: its blocks are there.
    An old note would be believed, and one that is missing would be taken for a daemon's first start."""
    try:
        make_log_folder(path.parent)
        write_whole(path, content, 0o600, durable=False)
    except OSError:
        with contextlib.suppress(OSError), path.open("r+b") as file:
            file.write(OUT_OF_DATE)
        raise
