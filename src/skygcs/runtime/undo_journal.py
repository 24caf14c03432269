"""Journal of temporary changes to vehicles: on disk from before the change until its undo.

One file per change in `log_dir`/undo, written before anything is sent, removed when the vehicle has its old values
again. Files found at the start were left by a daemon that was killed, or that could not reach the vehicle in time. They
are reported and offered for undo, never undone automatically: something else may have been set since.
"""

from __future__ import annotations

import json
import math
import os
import time
from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import Any

from skygcs.config.files import read_state, write_whole
from skygcs.errors import RefusedError
from skygcs.events import Event

FORMAT = 1

MAX_ENTRIES = 256
"""One per vehicle of a full fleet. With more entries further temporary changes are refused."""

MAX_FILE_BYTES = 64 * 1024
"""Largest size of an entry, which contains a few parameters."""

MAX_PARAMETERS = 64


@dataclass(frozen=True, slots=True)
class UndoableChange:
    """Parameters of one vehicle with their values ``before``, which are ``changed`` for the time of ``what``, in the
    order in which they are restored. ``id`` names the entry."""

    id: str
    vehicle: str
    sysid: int
    autopilot: str
    what: str
    began: str
    before: Mapping[str, float]
    changed: Mapping[str, float]

    def as_dict(self) -> dict[str, Any]:
        return asdict(self) | {"before": dict(self.before), "changed": dict(self.changed)}

    def __str__(self) -> str:
        values = ", ".join(f"{name} {value:g}" for name, value in self.before.items())
        return f"{self.vehicle} (system {self.sysid}): {self.what} of {self.began} was not undone; before it: {values}"


class UndoJournal:
    """The journal of a daemon's changes to undo. `left` lists entries of an earlier run, and those that this run could
    not undo.

    Its methods wait for the disk: `DiskWriter.run` calls them, one after another. ``number_left`` does not.
    """

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._in_progress: set[str] = set()
        self._number = 0
        self.number_left = 0
        """Number of entries that wait for their undo; from the last `left`, `begin`, `undone` or `drop`."""
        self.problems: list[str] = []
        """Files of the folder that cannot be read, or the folder, and why; from the last `left`."""

    def reports(self) -> Iterator[Event]:
        """One event for each change that was left, and one for files that cannot be read."""
        for change in self.left():
            text = f"{change}; skygcs-cli undo run {change.id} restores it, undo drop removes the entry"
            yield Event("undo", change.vehicle, change.sysid, text, {"id": change.id, "state": "left"})
        if self.problems:
            text = f"{self._folder}: {'; '.join(self.problems[:5])}; these are not undone"
            yield Event("undo", None, None, text, {"state": "unreadable"})

    @property
    def folder(self) -> Path:
        return self._folder

    def begin(
        self,
        vehicle: str,
        sysid: int,
        autopilot: str,
        what: str,
        before: Mapping[str, float],
        changed: Mapping[str, float],
    ) -> UndoableChange:
        """Write it to disk, before anything is changed. Raises RefusedError if that fails."""
        # describe the change
        self._number += 1
        stamp = time.strftime("%Y%m%d-%H%M%S", time.gmtime())
        change = UndoableChange(
            f"{sysid}-{stamp}-{os.getpid()}-{self._number}",
            vehicle,
            sysid,
            autopilot,
            what,
            time.strftime("%Y-%m-%dT%H:%M:%SZ", time.gmtime()),
            dict(before),
            dict(changed),
        )
        # write it before anything is changed
        try:
            if len(self._files()) >= MAX_ENTRIES:
                raise RefusedError(
                    f"{MAX_ENTRIES} changes wait to be undone already: skygcs-cli undo list, run or drop them first"
                )
            self._write(change)
        except OSError as error:
            raise RefusedError(
                f"the undo journal cannot be written in {self._folder}: {error.strerror or error}"
            ) from None
        self._in_progress.add(change.id)
        return change

    def undone(self, change: UndoableChange) -> None:
        """The vehicle has its old values again. Raises OSError if the entry cannot be removed."""
        self._path(change.id).unlink(missing_ok=True)
        self._in_progress.discard(change.id)
        self.left()

    def left_over(self, change: UndoableChange) -> None:
        """Keep an entry that could not be undone now."""
        self._in_progress.discard(change.id)
        self.left()

    def left(self) -> list[UndoableChange]:
        """The entries that wait for their undo, oldest first, without those in progress. Other files are `problems`."""
        self.problems = []
        found = []
        try:
            files = self._files()
        except OSError as error:
            self.problems, files = [f"the folder cannot be read ({error.strerror}): it may hold changes"], []
        for path in files:
            try:
                change = _read(path)
            except (OSError, ValueError) as error:
                if len(self.problems) < MAX_ENTRIES:
                    self.problems.append(f"{path.name} cannot be read: {error}"[:200])
                continue
            if change.id not in self._in_progress:
                found.append(change)
        self.number_left = len(found)
        return sorted(found, key=lambda c: (c.began, c.id))

    def find(self, id: str) -> UndoableChange:
        """One entry. Raises RefusedError if it does not exist or is in progress."""
        for change in self.left():
            if change.id == id:
                return change
        raise RefusedError(f"no change with id {id[:80]!r} waits to be undone; skygcs-cli undo list shows them")

    def drop(self, change: UndoableChange) -> None:
        """Remove an entry without an undo. Raises RefusedError if the file cannot be removed."""
        try:
            self._path(change.id).unlink(missing_ok=True)
        except OSError as error:
            raise RefusedError(f"{self._path(change.id)} cannot be removed: {error.strerror or error}") from None
        self.left()

    def _files(self) -> list[Path]:
        """The files of entries. Raises OSError for a folder that is there and cannot be read, of which `Path.glob` says
        that it is empty."""
        try:
            names = os.listdir(self._folder)
        except FileNotFoundError:
            return []
        return [self._folder / name for name in sorted(names) if name.endswith(".json")][: 2 * MAX_ENTRIES]

    def _path(self, id: str) -> Path:
        return self._folder / f"{id}.json"

    def _write(self, change: UndoableChange) -> None:
        """Write the entry; it is on the disk when this returns."""
        self._folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        content = json.dumps({"format": FORMAT, **change.as_dict()}, indent=1)
        write_whole(self._path(change.id), content.encode(), 0o600)


def _read(path: Path) -> UndoableChange:
    """Read an entry. Raises OSError, and ValueError for an invalid one."""
    return read_state(path, MAX_FILE_BYTES, partial(_change_of, path.stem))


def _change_of(id: str, table: Any) -> UndoableChange:
    if table["format"] != FORMAT:
        raise ValueError(f"format {table['format']!r}")
    change = UndoableChange(
        id,
        str(table["vehicle"])[:64],
        int(table["sysid"]),
        str(table["autopilot"])[:32],
        str(table["what"])[:64],
        str(table["began"])[:32],
        _numbers(table["before"]),
        _numbers(table["changed"]),
    )
    if not 1 <= change.sysid <= 255:
        raise ValueError(f"system {change.sysid}")
    return change


def _numbers(table: Mapping[str, Any]) -> dict[str, float]:
    numbers = {str(name): float(value) for name, value in table.items()}
    if len(numbers) > MAX_PARAMETERS or not all(math.isfinite(v) and 0 < len(n) <= 16 for n, v in numbers.items()):
        raise ValueError("it contains no parameters")
    return numbers
