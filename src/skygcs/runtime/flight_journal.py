"""Journal of what flies, for the daemon that begins after this one was killed: one small file in `log_dir`.

It is written beside the loop (`DiskWriter`), at changes of state and every `PERIOD_S` while a vehicle is in the air;
while the disk is stuck only the newest content waits for it.
"""

from __future__ import annotations

import asyncio
import contextlib
import json
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import Any

from skygcs.config.files import make_log_folder, open_regular, write_whole
from skygcs.core.vehicle.flight_note import FlightNote
from skygcs.disk_writer import DiskWriter
from skygcs.events import Event

FORMAT = 2

FILE = "flights.json"

OUT_OF_DATE = b"out of date: the disk did not take the newest notes\n"
"""Written over the begin of a file that could not be replaced."""

PERIOD_S = 2.0
"""Between two notes of places; what a vehicle does in that time is within the space that a lost one is given."""

MAX_NOTES = 300
"""Vehicles of a fleet at most."""

MAX_BYTES = 1_000_000
"""300 notes of 1 kB, and some room."""


class FlightJournal:
    """`recall` once, at the begin; then `note` some times a second."""

    def __init__(self, folder: Path, disk: DiskWriter, on_event: Callable[[Event], None]) -> None:
        self._path = folder / FILE
        self._disk = disk
        self._on_event = on_event
        self._states: tuple[Any, ...] = ()
        self._noted_at = -PERIOD_S
        self._writing = False
        self._waiting: bytes | None = None
        self._failed = False
        self.unreadable = False
        """There is a journal of the daemon before, and it cannot be read: anything may have been flown."""

    def recall(self) -> list[FlightNote]:
        """The notes of the daemon before. A file that cannot be read is reported, and is none."""
        try:
            with open_regular(self._path) as file:
                table = json.loads(file.read(MAX_BYTES))
            if table["format"] != FORMAT:
                raise ValueError(f"format {table['format']!r}")
            return [FlightNote.from_json(note) for note in table["notes"][:MAX_NOTES]]
        except FileNotFoundError:
            return []
        except (OSError, ValueError, KeyError, TypeError, AttributeError, RecursionError) as error:
            self.unreadable = True
            self._report(
                f"{self._path} cannot be read: {error}; a vehicle that is in the air and follows setpoints when it is "
                "heard first is ordered to hold, unless another station flies it"
            )
            return []

    def due(self, states: tuple[Any, ...], now: float, *, flying: bool) -> bool:
        """True if a note has to be made: ``states`` differ from those of the last note, or one is in the air."""
        return states != self._states or (flying and now - self._noted_at >= PERIOD_S)

    def note(self, notes: Sequence[FlightNote], states: tuple[Any, ...], now: float) -> None:
        """Write these notes, as soon as the disk takes them."""
        self._states, self._noted_at = states, now
        content = json.dumps({"format": FORMAT, "notes": [note.as_json() for note in notes[:MAX_NOTES]]})
        self._waiting = content.encode()
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
        self._failed = error is not None
        self._write_next()

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
