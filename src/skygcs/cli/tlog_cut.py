"""`skygcs-cli tlog filter`, `merge` and `split`: logs from logs, their records as they were, byte by byte."""

from __future__ import annotations

import contextlib
import heapq
from collections import Counter
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import IO

from skygcs.cli.log_file import LogFile, note, opened_log
from skygcs.cli.log_output import Outputs, make_folder
from skygcs.core.mavlink.dialect import Dialect
from skygcs.core.recording.reading import Entry
from skygcs.core.recording.selection import Selection
from skygcs.core.tlog import encode_record
from skygcs.core.vehicle.discovery import discovers
from skygcs.errors import SkygcsError

REST = "rest"


def filter_log(path: Path, out: Path, selection: Selection, dialect: Dialect, force: bool) -> str:
    """Write what is selected, a tlog from a tlog and a raw capture from a raw one; what to say of it."""
    kept = left = unvouched = 0
    with opened_log(path, dialect) as log:
        check_times(log, selection)
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
                raise SkygcsError(f"{path}: nothing in it is selected; {out} is not written")
        log.tell_faults()
    if unvouched:
        note(f"{unvouched:,} of the records left out have a wrong CRC: nobody knows whose they are")
    return f"{out}: {kept:,} of {kept + left:,} {_units(log)}"


def merge_logs(paths: Sequence[Path], out: Path, dialect: Dialect, force: bool) -> str:
    """Write all records of several tlogs by time; what to say of it.

    Records of one file keep their order, also where its time goes backwards; at the same time the file named first
    comes first.
    """
    with contextlib.ExitStack() as stack:
        logs = [stack.enter_context(opened_log(path, dialect)) for path in paths]
        for log in logs:
            if log.kind == "raw":
                raise SkygcsError(f"{log.path}: a raw capture has no times to merge by")
        outputs = stack.enter_context(Outputs(force))
        file = outputs.open_bytes(out)
        count = 0
        for entry in heapq.merge(*(log.entries() for log in logs), key=_time_us):
            write_entry(file, entry)
            count += 1
        for log in logs:
            log.tell_faults()
    return f"{out}: {count:,} records of {len(paths)} files"


def split_log(path: Path, folder: Path, dialect: Dialect, force: bool) -> list[str]:
    """Write a log for each vehicle, and one of what belongs to none; a line to say of each.

    A vehicle's log has what its system sent, and what others but vehicles sent to it. Every record is in one of them.
    """
    with opened_log(path, dialect) as log:
        vehicles = frozenset(e.frame.sysid for e in log.entries() if e.frame is not None and discovers(e.frame))
        if not vehicles:
            raise SkygcsError(f"{path}: no vehicle in it to split it by")
        make_folder(folder)
        counts: Counter[str] = Counter()
        files: dict[str, IO[bytes]] = {}
        with Outputs(force) as outputs:
            for entry in log.entries():
                part = _part_of(entry, vehicles)
                if part not in files:
                    files[part] = outputs.open_bytes(folder / f"{log.stem}-{part}{path.suffix or '.tlog'}")
                write_entry(files[part], entry)
                counts[part] += 1
        log.tell_faults()
    names = dict(zip(files, outputs.paths, strict=True))
    order = sorted(counts, key=lambda part: (part == REST, part.zfill(3)))
    return [f"{names[part]}: {counts[part]:,} {_units(log)}" for part in order]


def write_entry(file: IO[bytes], entry: Entry) -> None:
    """As a record, or as it is if it has no time."""
    file.write(entry.raw if entry.unix_us is None else encode_record(entry.unix_us, entry.raw))


def check_times(log: LogFile, selection: Selection) -> None:
    """Raises SkygcsError if a time of day is asked for in a log that has none."""
    if log.kind == "raw" and selection.absolute:
        raise SkygcsError(f"{log.path}: a raw capture has no time of day; give --from and --to in seconds")


def _part_of(entry: Entry, vehicles: frozenset[int]) -> str:
    frame = entry.frame
    if frame is None:
        return REST
    if frame.sysid in vehicles:
        return str(frame.sysid)
    system, _ = frame.target()
    return str(system) if system in vehicles else REST


def _time_us(entry: Entry) -> int:
    return entry.unix_us or 0


def _units(log: LogFile) -> str:
    return "records" if log.kind == "tlog" else "frames"


def selected(log: LogFile, selection: Selection) -> Iterator[Entry]:
    """The entries that are selected."""
    check_times(log, selection)
    return (entry for entry in log.entries() if selection.takes(entry))
