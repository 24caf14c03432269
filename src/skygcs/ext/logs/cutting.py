"""Write logs from logs: filter, merge, split. The records keep their bytes."""

from __future__ import annotations

import contextlib
import heapq
import operator
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import IO

from skygcs.core.mavlink.dialect import Dialect
from skygcs.core.mavlink.heartbeat import discovers
from skygcs.errors import SkygcsError
from skygcs.ext.logs.flight import MOST_VEHICLES
from skygcs.tlog.files import LogFile, Outputs, make_folder, note, opened_log
from skygcs.tlog.format import CLOCK_STEP_US, LogEntry, encode_record
from skygcs.tlog.selection import Selection

REST = "rest"

TLOG_SUFFIX, RAW_SUFFIX = ".tlog", ".raw"

VehicleKey = tuple[int, int]
"""System and component of an autopilot."""


def filter_log(path: Path, out: Path, selection: Selection, dialect: Dialect, force: bool) -> str:
    """Write the selected entries, a tlog from a tlog and a raw capture from a raw one; returns a line for the user."""
    kept = left = unvouched = 0
    with opened_log(path, dialect) as log:
        log.check_times(selection)
        if log.kind == "raw" and out.suffix.lower() == TLOG_SUFFIX:
            raise SkygcsError(
                f"{out}: {path.name} is a raw capture, whose frames have no times: a part of it is not a tlog; "
                f"name it {out.with_suffix(RAW_SUFFIX).name}"
            )
        with Outputs(force) as outputs:
            file = outputs.open_bytes(out)
            for entry in log.entries():
                if selection.takes(entry):
                    write_entry(file, entry)
                    kept += 1
                else:
                    left += 1
                    unvouched += entry.frame is None and selection.in_time(entry)
            if not kept:
                raise SkygcsError(f"{path}: no record matches; {out} was not written")
        log.print_faults()
    if unvouched:
        note(f"{unvouched:,} of the records left out have a wrong CRC: their senders are not known")
    return f"{out}: {kept:,} of {kept + left:,} {_units(log)}"


def merge_logs(paths: Sequence[Path], out: Path, dialect: Dialect, force: bool) -> str:
    """Write all records of several tlogs by time; returns a line for the user.

    Records of one file keep their order, also where its time goes backwards; for equal times the file named first
    comes first. A record with a damaged time that others follow is written behind the one before it.
    """
    with contextlib.ExitStack() as stack:
        logs = [stack.enter_context(opened_log(path, dialect)) for path in paths]
        for log in logs:
            if log.kind == "raw":
                raise SkygcsError(f"{log.path}: a raw capture has no times, so it cannot be merged")
        outputs = stack.enter_context(Outputs(force))
        file = outputs.open_bytes(out)
        count = 0
        for _, entry in heapq.merge(*(_timed(log.entries()) for log in logs), key=operator.itemgetter(0)):
            write_entry(file, entry)
            count += 1
        for log in logs:
            log.print_faults()
    return f"{out}: {count:,} records of {len(paths)} files"


def split_log(path: Path, folder: Path, dialect: Dialect, force: bool) -> list[str]:
    """Write a log for each vehicle, and one of what belongs to none; returns a line for each file.

    A vehicle is an autopilot: system and component. Its log has what its system sent, and what others but vehicles sent
    to it. If several autopilots share a system id, each log has what that autopilot sent and what was sent to it; the
    one with the lowest component also has the rest of the system. Every record is in one of the logs.
    """
    with opened_log(path, dialect) as log:
        # find the vehicles
        vehicles = {
            (e.frame.sysid, e.frame.compid) for e in log.entries() if e.frame is not None and discovers(e.frame)
        }
        if not vehicles:
            raise SkygcsError(f"{path}: it cannot be split: no vehicle in it")
        if len(vehicles) > MOST_VEHICLES:
            raise SkygcsError(f"{path}: {len(vehicles):,} vehicles; at most {MOST_VEHICLES} can be split")
        # write each entry to the file of its vehicle
        make_folder(folder)
        parts = _Parts(vehicles)
        counts: Counter[VehicleKey | None] = Counter()
        files: dict[VehicleKey | None, IO[bytes]] = {}
        with Outputs(force) as outputs:
            for entry in log.entries():
                part = parts.of(entry)
                if part not in files:
                    files[part] = outputs.open_bytes(folder / f"{log.stem}-{_part_name(part)}{_suffix(log)}")
                write_entry(files[part], entry)
                counts[part] += 1
        log.print_faults()
    # list the files
    names = dict(zip(files, outputs.paths, strict=True))
    order = sorted(counts, key=lambda part: (part is None, part or (0, 0)))
    return [f"{names[part]}: {counts[part]:,} {_units(log)}" for part in order]


def write_entry(file: IO[bytes], entry: LogEntry) -> None:
    """Write a record, or the bare frame if it has no time."""
    file.write(entry.raw if entry.unix_us is None else encode_record(entry.unix_us, entry.raw))


class _Parts:
    """The vehicle whose log a record belongs to; None: no vehicle."""

    def __init__(self, vehicles: set[VehicleKey]) -> None:
        self._vehicles = vehicles
        self._first: dict[int, VehicleKey] = {}
        for key in sorted(vehicles, reverse=True):
            self._first[key[0]] = key

    def of(self, entry: LogEntry) -> VehicleKey | None:
        frame = entry.frame
        if frame is None:
            return None
        return self._of_source(frame.sysid, frame.compid) or self._of_source(*frame.target())

    def _of_source(self, sysid: int, compid: int) -> VehicleKey | None:
        return (sysid, compid) if (sysid, compid) in self._vehicles else self._first.get(sysid)


def _part_name(part: VehicleKey | None) -> str:
    """Name as in names of tables: with the component if it is not 1."""
    if part is None:
        return REST
    sysid, compid = part
    return str(sysid) if compid == 1 else f"{sysid}.{compid}"


def _suffix(log: LogFile) -> str:
    """The file's own suffix, but not a tlog's for a raw capture."""
    suffix = log.path.suffix
    if log.kind == "raw" and suffix.lower() in ("", TLOG_SUFFIX):
        return RAW_SUFFIX
    return suffix or TLOG_SUFFIX


def _timed(entries: Iterable[LogEntry]) -> Iterator[tuple[int, LogEntry]]:
    """Entries with the times by which they are merged: their own, but that of the one before where a time is a day away
    from those on both sides, and not between them as in a sparse log. By its own, all that follows it would be written
    behind all other files."""
    time_us: int | None = None
    held: LogEntry | None = None
    """It is a day away from the one before."""
    for entry in entries:
        own_us = entry.dated_us or 0
        if held is not None:
            held_us = held.dated_us or 0
            if abs(own_us - held_us) < CLOCK_STEP_US or (time_us is not None and time_us < held_us < own_us):
                time_us = held_us  # the clock was set, another flight begins, or days passed without a record
            elif time_us is None:
                time_us = min(own_us, held_us)
            yield time_us, held
            held = None
        if time_us is not None and abs(own_us - time_us) < CLOCK_STEP_US:
            time_us = own_us
            yield own_us, entry
        else:
            held = entry
    if held is not None:
        yield max(held.dated_us or 0, time_us or 0), held  # nothing follows it that it would delay


def _units(log: LogFile) -> str:
    return "records" if log.kind == "tlog" else "frames"
