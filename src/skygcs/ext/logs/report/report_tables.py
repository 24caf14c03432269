"""The tables of the report: one set of rows for the page and for CSV, so that no figure is written twice. Pure.

In CSV a column has its unit in its name, a time is UTC in seconds since 1970, and what is not known is empty. The page
shows the same values rounded, times of day in UTC, and a dash for what is not known.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from typing import Any

from skygcs.ext.logs.report.day_figures import (
    HARMLESS,
    DayReport,
    RadioFigures,
    SourceFigures,
    Trace,
    VehicleDay,
)
from skygcs.ext.logs.tables import VehicleKey, csv_text
from skygcs.spelling import rounded
from skygcs.terminal_text import visible

NONE = "–"

DBM_SLOPE, DBM_OFFSET = 1.9, 127.0
"""SiK radios: dBm = count / 1.9 - 127 (their documentation of RADIO_STATUS)."""

Show = Callable[[Any], str]


@dataclass(frozen=True)
class Column:
    """``name`` in CSV, ``head`` and ``show`` on the page."""

    name: str
    head: str
    show: Show = str
    number: bool = False


@dataclass(frozen=True)
class FigureTable:
    """Rows of values in the order of the columns. ``name``: of the CSV file."""

    name: str
    columns: tuple[Column, ...]
    rows: Sequence[tuple[Any, ...]]
    bad: frozenset[int] = frozenset()
    """Rows that are trouble."""

    def csv_rows(self) -> Iterable[list[str]]:
        """The head, then the rows."""
        yield [column.name for column in self.columns]
        for row in self.rows:
            yield [_cell(column, value) for column, value in zip(self.columns, row, strict=True)]


def _cell(column: Column, value: Any) -> str:
    if value is None or (isinstance(value, float) and not math.isfinite(value)):
        return ""
    if isinstance(value, float):
        return f"{value:.6f}" if column.name.endswith("time_s") else repr(round(value, 6))
    return csv_text(value) if isinstance(value, str) else visible(str(value))


# -- how values are shown


def number(decimals: int = 1, unit: str = "") -> Show:
    """A rounded number with its unit."""

    def show(value: float | None) -> str:
        if value is None or not math.isfinite(value):
            return NONE
        return f"{rounded(value, decimals)}{unit}"

    return show


def count(value: int | None) -> str:
    return NONE if value is None else f"{value:,}"


def clock(unix_s: float | None) -> str:
    """Time of day, UTC."""
    if unix_s is None or not math.isfinite(unix_s):
        return NONE
    return datetime.fromtimestamp(unix_s, UTC).strftime("%H:%M:%S")


def dates(begin_s: float, end_s: float) -> str:
    """The day, UTC, or "2026-04-01 to 2026-04-03"."""
    first, last = (datetime.fromtimestamp(at_s, UTC).strftime("%Y-%m-%d") for at_s in (begin_s, end_s))
    return first if first == last else f"{first} to {last}"


def span(seconds: float | None) -> str:
    """M:SS, or H:MM:SS from an hour on."""
    if seconds is None or not math.isfinite(seconds):
        return NONE
    whole = round(seconds)
    minutes, rest = divmod(whole, 60)
    hours, minutes = divmod(minutes, 60)
    return f"{hours}:{minutes:02}:{rest:02}" if hours else f"{minutes}:{rest:02}"


def share(ratio: float | None) -> str:
    return NONE if ratio is None or not math.isfinite(ratio) else f"{rounded(100 * ratio, 1)} %"


def text(value: Any) -> str:
    return str(value) if value not in (None, "") else NONE


def name_of(report: DayReport, key: VehicleKey) -> str:
    """A vehicle of the report, for people."""
    return next((day.name for day in report.vehicles if day.key == key), f"{key[0]}/{key[1]}")


# -- the tables

VEHICLE = Column("vehicle", "vehicle", text)


def summary_table(report: DayReport) -> FigureTable:
    """A row for each vehicle: what it flew, and its worst event."""
    columns = (
        *(VEHICLE, Column("system", "id"), Column("kind", "kind", text), Column("firmware", "firmware", text)),
        Column("flights", "flights", count, number=True),
        Column("air_s", "in the air", span, number=True),
        Column("distance_m", "distance", number(0, " m"), number=True),
        Column("highest_m", "highest", number(1, " m"), number=True),
        Column("battery_used_percent", "battery used", number(0, " %"), number=True),
        Column("worst_event", "worst event", text),
    )
    rows = []
    bad = set()
    for n, day in enumerate(report.vehicles):
        worst = day.worst
        said = None if worst is None else f"{worst.word}: {worst.text}"
        flights = len(day.flights) + day.flights_left_out
        shown = (day.name, f"{day.key[0]}/{day.key[1]}", day.kind, day.firmware, flights, day.air_s, day.distance_m)
        rows.append((*shown, day.highest_m, day.used_percent, said))
        if worst is not None and worst.rank < HARMLESS - 1:
            bad.add(n)
    return FigureTable("summary", columns, rows, frozenset(bad))


def flights_table(days: Iterable[VehicleDay]) -> FigureTable:
    """A row for each flight."""
    columns = (
        *(VEHICLE, Column("flight", "flight", lambda n: f"flight {n}")),
        *(Column("begin_time_s", "armed", clock), Column("end_time_s", "until", clock)),
        Column("air_s", "in the air", span, number=True),
        Column("distance_m", "distance", number(0, " m"), number=True),
        Column("highest_m", "highest", number(1, " m"), number=True),
        Column("battery_used_percent", "battery used", number(0, " %"), number=True),
        Column("battery_left_percent", "left", number(0, " %"), number=True),
        Column("least_volts", "least", number(2, " V"), number=True),
        Column("whole", "recorded", lambda whole: "whole" if whole else "in part"),
    )
    rows = [
        (
            *(day.name, f.number, f.begin_s, f.end_s, f.air_s, f.distance_m, f.highest_m, f.used_percent),
            *(f.last_percent, f.least_volts, f.whole),
        )
        for day in days
        for f in day.flights
    ]
    return FigureTable("flights", columns, rows)


def tracking_table(traces: Iterable[Trace]) -> FigureTable:
    """A row for each control trace."""
    columns = (
        *(VEHICLE, Column("file", "trace", text)),
        *(Column("rows", "rows", count, number=True), Column("duration_s", "time", span, number=True)),
        Column("rms_error_m", "error rms", number(2, " m"), number=True),
        Column("p95_error_m", "p95", number(2, " m"), number=True),
        Column("largest_error_m", "largest", number(2, " m"), number=True),
        Column("age_p95_ms", "state age p95", number(0, " ms"), number=True),
    )
    rows = []
    for trace in traces:
        m = trace.measured
        errors = m.rms_error_m, m.p95_error_m, m.largest_error_m
        rows.append((trace.vehicle, trace.file, m.rows, m.duration_s, *errors, m.age_p95_ms))
    return FigureTable("tracking", columns, rows)


def delays_table(days: Iterable[VehicleDay]) -> FigureTable:
    """A row for each kind of command to a vehicle."""
    columns = (
        *(VEHICLE, Column("command", "command", text), Column("sent", "sent", count, number=True)),
        *(Column("answered", "answered", count, number=True), Column("repeats", "repeats", count, number=True)),
        Column("median_ms", "median", number(0, " ms"), number=True),
        Column("p95_ms", "p95", number(0, " ms"), number=True),
        Column("largest_ms", "longest", number(0, " ms"), number=True),
    )
    rows = [
        (day.name, d.command, d.asked, d.answered, d.repeats, d.median_ms, d.p95_ms, d.largest_ms)
        for day in days
        for d in day.delays
    ]
    return FigureTable("delays", columns, rows, frozenset(n for n, row in enumerate(rows) if row[3] < row[2]))


def losses_table(sources: Iterable[tuple[str, SourceFigures]]) -> FigureTable:
    """A row for each source, with the vehicle that it belongs to."""
    columns = (
        *(VEHICLE, Column("source", "source")),
        Column("frames", "frames", count, number=True),
        Column("lost", "lost", count, number=True),
        Column("loss_ratio", "share", share, number=True),
    )
    rows = [(owner, f"{s.sysid}/{s.compid}", s.frames, s.lost, s.loss_ratio) for owner, s in sources]
    return FigureTable("losses", columns, rows)


def radios_table(report: DayReport) -> FigureTable:
    """A row for each radio. Signals are the radio's own counts."""
    columns = (
        *(Column("radio", "radio"), Column("reports", "reports", count, number=True)),
        *_signal("rssi", "RSSI"),
        *_signal("remote_rssi", "remote RSSI"),
        *_signal("noise", "noise"),
        *_signal("remote_noise", "remote noise"),
        Column("txbuf_least_percent", "buffer free, least", number(0, " %"), number=True),
        Column("txbuf_median_percent", "median", number(0, " %"), number=True),
        Column("receive_errors", "receive errors", count, number=True),
    )
    rows = [
        (
            *(f"{r.sysid}/{r.compid}", r.reports, *r.rssi, *r.remote_rssi, *r.noise, *r.remote_noise),
            *(r.least_txbuf_percent, r.median_txbuf_percent, r.receive_errors),
        )
        for r in report.radios
    ]
    return FigureTable("radios", columns, rows)


def radio_signals(radio: RadioFigures) -> FigureTable:
    """A row for each signal of one radio, for the page: `radios_table` has the same in one row."""
    columns = (
        Column("signal", "signal"),
        *(Column(name, name, number(0), number=True) for name in ("least", "median", "greatest")),
        Column("median_dbm", "SiK: dBm", number(0), number=True),
    )
    signals = ("RSSI", radio.rssi), ("remote RSSI", radio.remote_rssi)
    noises = ("noise", radio.noise), ("remote noise", radio.remote_noise)
    rows = [(name, *values, values[1] / DBM_SLOPE - DBM_OFFSET) for name, values in (*signals, *noises)]
    return FigureTable("radio_signals", columns, rows)


def _signal(name: str, head: str) -> tuple[Column, ...]:
    parts = (("least", f"{head} least"), ("median", "median"), ("greatest", "greatest"))
    return tuple(Column(f"{name}_{part}", shown, number(0), number=True) for part, shown in parts)


def approaches_table(report: DayReport, most: int | None = None) -> FigureTable:
    """A row for each pair that was in the air together; the least part of the margin left, first."""
    columns = (
        *(Column("first", "vehicle"), Column("second", "and")),
        Column("time_s", "nearest at", clock),
        Column("distance_m", "distance", number(1, " m"), number=True),
        Column("level_m", "level", number(1, " m"), number=True),
        Column("vertical_m", "in height", number(1, " m"), number=True),
        Column("separation_m", "separation", number(1, " m"), number=True),
        Column("margin_m", "margin", number(1, " m"), number=True),
        Column("separation_to_margin", "of margin", number(1, " ×"), number=True),
    )
    rows = [
        (
            *(name_of(report, a.first), name_of(report, a.second), a.at_s, a.distance_m, a.level_m, a.vertical_m),
            *(a.separation_m, a.margin_m, a.used),
        )
        for a in report.approaches[:most]
    ]
    return FigureTable("approaches", columns, rows, frozenset(n for n, row in enumerate(rows) if row[-1] < 1))


def events_table(days: Iterable[VehicleDay], *, trouble: bool | None = None) -> FigureTable:
    """A row for each event by time. ``trouble``: only those that are (True) or are not (False)."""
    columns = (
        *(VEHICLE, Column("time_s", "time", clock), Column("kind", "kind"), Column("severity", "severity", text)),
        Column("text", "what", text),
    )
    found = [(day.name, e) for day in days for e in day.events if trouble is None or (e.rank < HARMLESS) == trouble]
    found.sort(key=lambda pair: pair[1].at_s)
    rows = [(name, e.at_s, str(e.kind), e.word if e.severity is not None else None, e.text) for name, e in found]
    bad = frozenset(n for n, (_, e) in enumerate(found) if e.rank < HARMLESS - 1)
    return FigureTable("events", columns, rows, bad)


def alarms_table(report: DayReport) -> FigureTable:
    """A row for each alarm of the daemon."""
    columns = (
        *(Column("time_s", "raised", clock), Column("severity", "severity", text), VEHICLE),
        *(Column("kind", "kind", text), Column("text", "what", text), Column("count", "times", count, number=True)),
        Column("acknowledged_by", "acknowledged by", text),
    )
    rows = [(a.raised_s, a.severity, a.vehicle, a.kind, a.text, a.count, a.acknowledged_by) for a in report.alarms]
    return FigureTable("alarms", columns, rows)


def files_table(report: DayReport) -> FigureTable:
    """A row for each file of the folder."""
    columns = (
        *(Column("file", "file"), Column("state", "state"), Column("about", "what", text)),
        Column("bytes", "size", lambda size: f"{size / 1000:,.0f} kB" if size else NONE, number=True),
    )
    rows = [(note.name, str(note.state), note.about, note.size) for note in report.files]
    failed = {n for n, note in enumerate(report.files) if note.state in ("cannot be read", "read, with faults")}
    return FigureTable("files", columns, rows, frozenset(failed))


def all_tables(report: DayReport) -> list[FigureTable]:
    """Every table whole, as it goes into CSV."""
    owned = [(day.name, source) for day in report.vehicles for source in day.sources]
    others = [("", source) for source in report.other_sources]
    traces = [trace for day in report.vehicles for trace in day.traces] + report.other_traces
    return [
        summary_table(report),
        flights_table(report.vehicles),
        tracking_table(traces),
        delays_table(report.vehicles),
        losses_table([*owned, *others]),
        radios_table(report),
        approaches_table(report),
        events_table(report.vehicles),
        alarms_table(report),
        files_table(report),
    ]
