"""Reads a log folder for the report: tlogs as recordings of one day, traces, alarms; every file is named with its fate.

The folder itself is read, not the folders in it. Files are streamed: memory does not grow with them.
"""

from __future__ import annotations

import re
from array import array
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from datetime import UTC, date, datetime
from pathlib import Path

from skygcs.config.files import open_regular, read_state
from skygcs.core.alarms import Alarms
from skygcs.core.geo import Origin
from skygcs.core.mavlink.dialect import Dialect
from skygcs.core.separation import Footprint
from skygcs.errors import SkygcsError
from skygcs.ext.logs.report.day_figures import AlarmFigures, DayReport, FileNote, FileState, Trace
from skygcs.ext.logs.report.day_reader import DayReader
from skygcs.ext.logs.report.planned import system_of
from skygcs.ext.logs.tables import VehicleKey
from skygcs.ext.logs.trace_figures import MOST_ROWS, age_ms, error_m, trace_figures
from skygcs.tlog.files import FileWindow, opened_log
from skygcs.tlog.format import CLOCK_STEP_US, RecordFinder, sniff
from skygcs.tlog.trace_file import read_trace

ALL_DAYS = "all"

DAY_GAP_S = 6 * 3600.0
"""Nothing recorded for longer: another day begins, whatever the time zone."""

RECORDING_GAP_S = 10.0
"""Nothing recorded for longer between two files: nobody listened."""

OVERLAP_S = 2.0
"""Files of one recorder overlap by less."""

SNIFFED_BYTES = 1 << 20
TAIL_BYTES = 128 << 10
"""Read for the time of the last record; it holds several hundred."""

END_US = 4_102_444_800_000_000
"""The year 2100: a later time is damaged."""

MOST_FILES = 20_000
MOST_ALARM_BYTES = 1_000_000

OWN_TLOG = re.compile(r"\d{8}T\d{6}Z-\d+\.tlog")
"""A file of the daemon's recorder."""

TRACE_HEAD = b"# format"
_STAMP = re.compile(r"(\d{8}-\d{6})(?:-\d+)?\.csv$")
"""The part of a trace's name that says when it began, UTC."""

LOG_SUFFIXES = (".tlog", ".raw")

KNOWN_FILES = (
    (re.compile(r"flights\.json"), "what flies now, for the next start of the daemon; not reported"),
    (re.compile(r"fence-test-.*\.json"), "record of a fence test; not reported"),
    (re.compile(r"federation-orders\.jsonl"), "orders of other stations; not reported"),
    (re.compile(r".*\.part"), "a file that is or was being written; not read"),
)


@dataclass(frozen=True)
class ReportRequest:
    """The wanted report, and the facts that no log holds."""

    folder: Path
    day: str | None = None
    """2026-04-01 (UTC, of the first record of a file), "all", or None: the newest."""
    origin: Origin | None = None
    names: Mapping[int, str] = field(default_factory=dict)
    """System id to name."""
    footprint: Callable[[VehicleKey], Footprint] = lambda _: Footprint()


@dataclass(frozen=True)
class _Tlog:
    path: Path
    first_s: float
    last_s: float
    size: int

    @property
    def own(self) -> bool:
        return OWN_TLOG.fullmatch(self.path.name) is not None


def gather(wanted: ReportRequest, dialect: Dialect) -> DayReport:
    """The report of a day. Raises SkygcsError if the folder cannot be read; what is wrong with a file is in `files`."""
    paths = _listed(wanted.folder)
    notes: list[FileNote] = []
    tlogs = _looked_at([p for p in paths if p.suffix.lower() in LOG_SUFFIXES], dialect, notes)
    chosen = _of_the_day(tlogs, wanted.day, notes)
    chosen = _without_overlaps(chosen, notes)
    reader = DayReader(dialect, wanted.origin, wanted.names, wanted.footprint)
    _read_tlogs(chosen, reader, dialect, notes)
    report = reader.finish(wanted.folder.resolve().name or str(wanted.folder))
    rest = [p for p in paths if p.suffix.lower() not in LOG_SUFFIXES]
    for path in rest:
        notes.append(_other_file(path, report, wanted))
    report.files = sorted(notes, key=lambda note: note.name)
    report.missing += _missing(report)
    return report


def failures(report: DayReport) -> list[str]:
    """A line for each thing that could not be read although it should have been."""
    found = [f"{note.name}: {note.about}" for note in report.files if note.state is FileState.FAILED]
    if not any(note.state in (FileState.READ, FileState.DAMAGED) and _is_log(note.name) for note in report.files):
        found.append("no tlog was read")
    return found


def _is_log(name: str) -> bool:
    return Path(name).suffix.lower() in LOG_SUFFIXES


def _listed(folder: Path) -> list[Path]:
    try:
        paths = sorted(folder.iterdir())
    except OSError as error:
        raise SkygcsError(f"{folder}: {error.strerror or error}") from None
    if len(paths) > MOST_FILES:
        raise SkygcsError(f"{folder}: {len(paths):,} files; a report reads up to {MOST_FILES:,}")
    return paths


def _missing(report: DayReport) -> list[str]:
    """Sentences on what the folder lacks."""
    found = [f"{note.name}: {note.state}: {note.about}" for note in report.files if _lacks(note)]
    if not report.vehicles:
        found.append("no vehicle: no tlog of the day has a heartbeat of an autopilot")
    if report.vehicles and not report.radios:
        found.append("no radio reported its link (RADIO_STATUS), so there are no signals and no buffers")
    if not report.other_traces and not any(day.traces for day in report.vehicles):
        found.append("no control trace of the day (skygcs-cli control record), so there are no tracking errors")
    if report.vehicles and not any(day.flights for day in report.vehicles):
        found.append("no vehicle was in the air while it was recorded")
    return found


def _lacks(note: FileNote) -> bool:
    """True if figures may be missing because of this file."""
    return note.state in (FileState.FAILED, FileState.DAMAGED) or (
        note.state is FileState.LEFT_OUT and _is_log(note.name)
    )


# -- tlogs


def _looked_at(paths: Iterable[Path], dialect: Dialect, notes: list[FileNote]) -> list[_Tlog]:
    """Those of the files that are tlogs, with their times; the others are noted."""
    found = []
    for path in paths:
        size = 0
        try:
            with open_regular(path) as file:
                window = FileWindow(file)
                size = len(window)
                found.append(_looked_into(path, window, dialect))
        except SkygcsError as error:
            state = FileState.LEFT_OUT if isinstance(error, _NotThisKind) else FileState.FAILED
            notes.append(FileNote(path.name, state, str(error), size))
        except OSError as error:
            notes.append(FileNote(path.name, FileState.FAILED, f"{error.strerror or error}", size))
    return found


class _NotThisKind(SkygcsError):
    """A file that is whole and cannot be in a report."""


def _looked_into(path: Path, window: FileWindow, dialect: Dialect) -> _Tlog:
    """Raises SkygcsError for what is no tlog, or one whose times cannot be used."""
    if not len(window):
        raise SkygcsError("empty")
    head = window[:SNIFFED_BYTES]
    kind = sniff(head, dialect)
    if kind is None:
        raise SkygcsError("no MAVLink in its first MB")
    if kind == "raw":
        raise _NotThisKind("a raw capture: its frames have no time of day, so they belong to no day")
    first_us = _time_us(head, dialect, last=False)
    last_us = _time_us(window[max(0, len(window) - TAIL_BYTES) : len(window)], dialect, last=True)
    if first_us is None:
        raise SkygcsError("no record with a right checksum and a time before 2100 in its first MB")
    last_us = max(first_us, first_us if last_us is None else last_us)
    if last_us - first_us >= CLOCK_STEP_US:
        raise _NotThisKind(
            f"its times span {(last_us - first_us) / 86_400e6:,.1f} days: its clock was set, or it holds several "
            "flights; cut it with `tlog filter --from --to`"
        )
    return _Tlog(path, first_us / 1e6, last_us / 1e6, len(window))


def _time_us(data: bytes, dialect: Dialect, *, last: bool) -> int | None:
    """The time of the first or the last good record in these bytes; None: there is none. A damaged time is passed
    over."""
    finder = RecordFinder(data, dialect)
    found = None
    while not finder.at_end:
        entry = finder.find(len(data))
        if entry is not None and entry.verdict == "ok" and (entry.unix_us or 0) < END_US:
            found = entry.unix_us
            if not last:
                break
    return found


def _of_the_day(tlogs: Sequence[_Tlog], day: str | None, notes: list[FileNote]) -> list[_Tlog]:
    """Those of the day that is asked for, by time."""
    ordered = sorted(tlogs, key=lambda log: (log.first_s, log.path.name))
    if day == ALL_DAYS:
        return ordered
    if day is not None:
        wanted = [log for log in ordered if _date_of(log.first_s) == date.fromisoformat(day)]
    else:
        wanted, end_s = [], -float("inf")
        for log in ordered:
            if log.first_s - end_s > DAY_GAP_S:
                wanted = []
            wanted.append(log)
            end_s = max(end_s, log.last_s)
    for log in ordered:
        if log not in wanted:
            when = f"of {_date_of(log.first_s)}: --day {_date_of(log.first_s)} reports it"
            notes.append(FileNote(log.path.name, FileState.OTHER_DAY, when, log.size))
    return wanted


def _date_of(unix_s: float) -> date:
    return datetime.fromtimestamp(unix_s, UTC).date()


def _without_overlaps(tlogs: Sequence[_Tlog], notes: list[FileNote]) -> list[_Tlog]:
    """One recording of each time: the daemon's own files before others, then the longest. The same frames in two files
    would be counted twice."""
    taken: list[_Tlog] = []
    for log in sorted(tlogs, key=lambda log: (not log.own, log.first_s - log.last_s, log.path.name)):
        over = next(
            (t for t in taken if min(t.last_s, log.last_s) - max(t.first_s, log.first_s) > _tolerated_s(t, log)), None
        )
        if over is None:
            taken.append(log)
        else:
            about = f"recorded at the same time as {over.path.name}: its frames would count twice; report it alone"
            notes.append(FileNote(log.path.name, FileState.LEFT_OUT, about, log.size))
    return sorted(taken, key=lambda log: (log.first_s, log.path.name))


def _tolerated_s(a: _Tlog, b: _Tlog) -> float:
    """A short file may lie within another's time as a whole: then half of it is too much."""
    return min(OVERLAP_S, (a.last_s - a.first_s) / 2, (b.last_s - b.first_s) / 2)


def _read_tlogs(tlogs: Sequence[_Tlog], reader: DayReader, dialect: Dialect, notes: list[FileNote]) -> None:
    end_s = -float("inf")
    for log in tlogs:
        if log.first_s - end_s > RECORDING_GAP_S and end_s > 0:
            reader.end_recording()
        begin_s = max(log.first_s, end_s)
        end_s = begin_s
        records = 0
        try:
            with opened_log(log.path, dialect) as file:
                for entry in file.entries():
                    entry.at_s = min(begin_s + entry.at_s, END_US / 1e6)
                    end_s = entry.at_s
                    records += 1
                    reader.add(entry)
            lines = file.faults.lines()
        except (OSError, SkygcsError) as error:
            why = f"{records:,} records were read, then: {getattr(error, 'strerror', None) or error}"
            notes.append(FileNote(log.path.name, FileState.FAILED, why, log.size))
            continue
        about = f"{records:,} records, {_clock(begin_s)} to {_clock(end_s)}"
        state = FileState.DAMAGED if lines else FileState.READ
        notes.append(FileNote(log.path.name, state, "; ".join([about, *lines]), log.size))
    reader.end_recording()


def _clock(unix_s: float) -> str:
    return datetime.fromtimestamp(unix_s, UTC).strftime("%H:%M:%S")


# -- other files


def _other_file(path: Path, report: DayReport, wanted: ReportRequest) -> FileNote:
    """Take what it holds into the report; returns what was made of it."""
    try:
        if path.is_dir():
            return _folder(path)
        with open_regular(path) as file:
            head = file.read(256)
        size = path.stat().st_size
        if path.name == "alarms.json":
            return _alarms(path, report, size)
        known = next((about for name, about in KNOWN_FILES if name.fullmatch(path.name)), None)
        if known is not None:
            return FileNote(path.name, FileState.LEFT_OUT, known, size)
        if path.suffix.lower() == ".csv" and head.startswith(TRACE_HEAD):
            return _trace(path, report, wanted, size)
    except SkygcsError as error:
        return FileNote(path.name, FileState.FAILED, str(error).removeprefix(f"{path}:").strip())
    except OSError as error:
        return FileNote(path.name, FileState.FAILED, f"{error.strerror or error}")
    return FileNote(path.name, FileState.LEFT_OUT, "no log that the report knows; not read", size)


def _folder(path: Path) -> FileNote:
    inside = [one.name for one in path.iterdir()]
    logs = sum(_is_log(name) for name in inside)
    if path.name == "undo" and inside:
        about = f"{len(inside)} changes of parameters that were not undone (skygcs-cli undo)"
    elif logs:
        about = f"a folder with {logs} logs; folders are not read: report it alone"
    else:
        about = "a folder; not read"
    return FileNote(f"{path.name}/", FileState.LEFT_OUT, about)


def _alarms(path: Path, report: DayReport, size: int) -> FileNote:
    alarms = Alarms()
    try:
        read_state(path, MOST_ALARM_BYTES, alarms.restore)
        found = alarms.all()
    except ValueError as error:
        return FileNote(path.name, FileState.FAILED, f"no alarms of a daemon: {error}"[:200], size)
    for alarm in found:
        if report.begin_s - DAY_GAP_S <= alarm.raised_unix_s <= report.end_s + DAY_GAP_S:
            report.alarms.append(
                AlarmFigures(
                    alarm.raised_unix_s,
                    alarm.severity,
                    alarm.vehicle or "",
                    alarm.kind,
                    alarm.text,
                    alarm.count,
                    alarm.acknowledged_by or "",
                )
            )
    report.alarms.sort(key=lambda alarm: alarm.raised_s)
    return FileNote(path.name, FileState.READ, f"{len(found)} alarms, {len(report.alarms)} of the day", size)


def _trace(path: Path, report: DayReport, wanted: ReportRequest, size: int) -> FileNote:
    """Raises SkygcsError for what is no trace."""
    began_s = _stamped_s(path.name)
    if began_s is not None and not _on_the_day(began_s, report, wanted.day):
        about = f"of {_date_of(began_s)}: --day {_date_of(began_s)} reports it"
        return FileNote(path.name, FileState.OTHER_DAY, about, size)
    errors_m, ages_ms = array("d"), array("d")
    first_s = last_s = 0.0
    cut = ""
    with read_trace(path) as trace:
        for entry in trace:
            if len(errors_m) >= MOST_ROWS:
                cut = f"; only the first {MOST_ROWS:,} rows were read"
                break
            first_s, last_s = (first_s if errors_m else entry.row.t_s), entry.row.t_s
            errors_m.append(error_m(entry.row))
            ages_ms.append(age_ms(entry.row))
    if not errors_m:
        raise SkygcsError("no row in it")
    measured = trace_figures(len(errors_m), last_s - first_s, errors_m, ages_ms, trace.cut_line)
    made = Trace(path.name, trace.head.vehicle, measured)
    system = system_of(made.vehicle, {name: sysid for sysid, name in wanted.names.items()})
    owners = [vehicle for vehicle in report.vehicles if vehicle.key[0] == system]
    (owners[0].traces if owners else report.other_traces).append(made)
    if trace.cut_line is not None:
        cut += f"; line {trace.cut_line} was cut off and is left out"
    state = FileState.DAMAGED if cut else FileState.READ
    return FileNote(path.name, state, f"control trace of {made.vehicle}, {measured.rows:,} rows{cut}", size)


def _on_the_day(began_s: float, report: DayReport, day: str | None) -> bool:
    if day == ALL_DAYS or not report.begin_s <= report.end_s:  # false for NaN: no tlog says when the day was
        return day in (None, ALL_DAYS) or _date_of(began_s) == date.fromisoformat(str(day))
    return report.begin_s - DAY_GAP_S <= began_s <= report.end_s + DAY_GAP_S


def _stamped_s(name: str) -> float | None:
    """When a trace began, by its name."""
    stamp = _STAMP.search(name)
    try:
        return None if stamp is None else datetime.strptime(stamp[1], "%Y%m%d-%H%M%S").replace(tzinfo=UTC).timestamp()
    except ValueError:
        return None
