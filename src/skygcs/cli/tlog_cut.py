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
from skygcs.core.mavlink.heartbeat import discovers
from skygcs.errors import SkygcsError
from skygcs.tlog.flight import MOST_VEHICLES
from skygcs.tlog.format import encode_record
from skygcs.tlog.reading import LogEntry
from skygcs.tlog.selection import Selection

REST = "rest"

TLOG_SUFFIX, RAW_SUFFIX = ".tlog", ".raw"

VehicleKey = tuple[int, int]
"""System and component of an autopilot."""


def filter_log(path: Path, out: Path, selection: Selection, dialect: Dialect, force: bool) -> str:
    """Write what is selected, a tlog from a tlog and a raw capture from a raw one; what to say of it."""
    kept = left = unvouched = 0
    with opened_log(path, dialect) as log:
        check_times(log, selection)
        if log.kind == "raw" and out.suffix.lower() == TLOG_SUFFIX:
            raise SkygcsError(
                f"{out}: {path.name} is a raw capture, whose frames have no times: what is cut from it is no tlog; "
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

    A vehicle is an autopilot: system and component. Its log has what its system sent, and what others but vehicles sent
    to it. Where several autopilots share a system id, each has what itself sent and what was sent to it; the one of the
    lowest component has what other components of that system sent and what was sent to all of it. Every record is in
    one of the logs.
    """
    with opened_log(path, dialect) as log:
        vehicles = {
            (e.frame.sysid, e.frame.compid) for e in log.entries() if e.frame is not None and discovers(e.frame)
        }
        if not vehicles:
            raise SkygcsError(f"{path}: no vehicle in it to split it by")
        if len(vehicles) > MOST_VEHICLES:
            raise SkygcsError(f"{path}: {len(vehicles):,} vehicles; a log of {MOST_VEHICLES} at most is split")
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
        log.tell_faults()
    names = dict(zip(files, outputs.paths, strict=True))
    order = sorted(counts, key=lambda part: (part is None, part or (0, 0)))
    return [f"{names[part]}: {counts[part]:,} {_units(log)}" for part in order]


def write_entry(file: IO[bytes], entry: LogEntry) -> None:
    """As a record, or as it is if it has no time."""
    file.write(entry.raw if entry.unix_us is None else encode_record(entry.unix_us, entry.raw))


def check_times(log: LogFile, selection: Selection) -> None:
    """Raises SkygcsError if a time of day is asked for in a log that has none."""
    if log.kind == "raw" and selection.absolute:
        raise SkygcsError(f"{log.path}: a raw capture has no time of day; give --from and --to in seconds")


class _Parts:
    """Which vehicle's log a record belongs to; None: to no vehicle's."""

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
    """As of the tables: the component is named if it is not 1."""
    if part is None:
        return REST
    sysid, compid = part
    return str(sysid) if compid == 1 else f"{sysid}.{compid}"


def _suffix(log: LogFile) -> str:
    """The file's own, but never that of a tlog for bytes that are none."""
    suffix = log.path.suffix
    if log.kind == "raw" and suffix.lower() in ("", TLOG_SUFFIX):
        return RAW_SUFFIX
    return suffix or TLOG_SUFFIX


def _time_us(entry: LogEntry) -> int:
    return entry.unix_us or 0


def _units(log: LogFile) -> str:
    return "records" if log.kind == "tlog" else "frames"


def selected(log: LogFile, selection: Selection) -> Iterator[LogEntry]:
    """The entries that are selected."""
    check_times(log, selection)
    return (entry for entry in log.entries() if selection.takes(entry))
