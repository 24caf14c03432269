"""Write tables of a log, of flights or of messages, as CSV or Parquet. pyarrow is an extra (`skygcs[parquet]`)."""

from __future__ import annotations

import csv
import functools
import re
import sys
from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path
from typing import IO, Any, Protocol

from skygcs.core.mavlink.dialect import Dialect
from skygcs.errors import SkygcsError
from skygcs.ext.logs.tables import (
    FLIGHT_COLUMNS,
    NUMBER,
    TEXT,
    TIME,
    FlightTables,
    Kind,
    MessageColumns,
    VehicleKey,
    csv_text,
)
from skygcs.tlog.files import LogFile, Outputs, make_folder, opened_log
from skygcs.tlog.selection import Selection

Columns = tuple[tuple[str, Kind], ...]

CELLS_PER_GROUP = 200_000
"""Cells of one table in memory: some 10 MB of Python objects, a row group of 20,000 rows with ten columns."""

_TYPES: dict[Kind, str] = {TEXT: "string", NUMBER: "float64", "float": "float32", "double": "float64", "char": "string"}


class Table(Protocol):
    """Rows of values in the order of the columns; a time is microseconds, None is an empty cell."""

    rows: int

    def add(self, row: list[Any]) -> None: ...


NewTable = Callable[[str, Columns], Table]
"""A table of that name; two tables of one log have different names."""


class CsvTable:
    """RFC 4180; times in seconds with six decimals, floats with all digits needed to read them back exactly."""

    def __init__(self, file: IO[str], columns: Columns) -> None:
        self.rows = 0
        self._writer = csv.writer(file, lineterminator="\n")
        self._cells = [_CELLS.get(kind) for _, kind in columns]
        self._writer.writerow([name for name, _ in columns])

    def add(self, row: list[Any]) -> None:
        self.rows += 1
        self._writer.writerow(
            [v if cell is None or v is None else cell(v) for cell, v in zip(self._cells, row, strict=True)]
        )


def seconds(time_us: int) -> str:
    return f"{time_us // 1_000_000}.{time_us % 1_000_000:06d}"


_CELLS: dict[Kind, Callable[[Any], str]] = {
    TIME: seconds,
    "float": lambda value: format(value, ".9g"),
    TEXT: functools.partial(csv_text, lines=True),
}
"""9 digits give back every float of 32 bits; a double is written by repr."""

LATEST_US = (1 << 63) - 1
"""Parquet's timestamps are signed. A later time was never a flight's: a byte of it is damaged."""


class ParquetTable:
    """Columns with the types of the message's fields; times are timestamps of UTC in microseconds, none beyond
    LATEST_US."""

    def __init__(self, file: IO[bytes], columns: tuple[tuple[str, Kind], ...]) -> None:
        import pyarrow as pa
        import pyarrow.parquet as pq

        self.rows = 0
        self._pa = pa
        self._schema = pa.schema([(name, _arrow_type(pa, kind)) for name, kind in columns])
        self._writer = pq.ParquetWriter(file, self._schema)
        self._times = [n for n, (_, kind) in enumerate(columns) if kind == TIME]
        self._most = max(CELLS_PER_GROUP // len(columns), 1)
        self._waiting: list[list[Any]] = []

    def add(self, row: list[Any]) -> None:
        self.rows += 1
        for n in self._times:
            row[n] = None if row[n] is None or row[n] > LATEST_US else row[n]
        self._waiting.append(row)
        if len(self._waiting) >= self._most:
            self._write()

    def close(self) -> None:
        try:
            if self._waiting:
                self._write()
        finally:
            self._writer.close()

    def _write(self) -> None:
        columns = [
            self._pa.array(values, field.type)
            for field, values in zip(self._schema, zip(*self._waiting, strict=True), strict=True)
        ]
        self._writer.write_table(self._pa.Table.from_arrays(columns, schema=self._schema))
        self._waiting.clear()


class Stdout:
    """The one table that goes to stdout; a second one is an error."""

    def __init__(self) -> None:
        self._name: str | None = None

    def __call__(self, name: str, columns: Columns) -> Table:
        if self._name is not None:
            raise SkygcsError(
                f"more than one table ({self._name}, {name}): choose one with --vehicle or --message, "
                "or --output FOLDER"
            )
        self._name = name
        return CsvTable(sys.stdout, columns)


def write_tables(
    path: Path,
    folder: Path | None,
    selection: Selection,
    messages: bool,
    parquet: bool,
    dialect: Dialect,
    force: bool,
) -> list[str]:
    """Write the flight of each vehicle, or with ``messages`` each selected message, as a table of its own.

    ``folder`` None: the one table goes to stdout. Returns a line for each file, by name. Raises SkygcsError.
    """
    with opened_log(path, dialect) as log:
        fill = _fill_messages if messages else _fill_flights
        if folder is None:
            counts = _filled(log, selection, fill, Stdout())
            lines = []
        else:
            make_folder(folder)
            with Outputs(force) as outputs, ExitStack() as closing:
                new = _new_tables(outputs, closing, folder, log.stem, parquet)
                counts = _filled(log, selection, fill, new)
            by_name = sorted(zip(outputs.paths, counts, strict=True), key=lambda pair: _by_number(pair[0].name))
            lines = [f"{file}: {rows:,} rows" for file, rows in by_name]
        log.print_faults()
    return lines


def _by_number(name: str) -> list[str | int]:
    """A key that sorts names by the numbers in them: 2 before 10."""
    return [int(part) if part.isdecimal() else part for part in re.split(r"([0-9]+)", name)]


def _filled(
    log: LogFile, selection: Selection, fill: Callable[[LogFile, Selection, NewTable], list[Table]], new: NewTable
) -> list[int]:
    tables = fill(log, selection, new)
    if not tables:
        raise SkygcsError(f"{log.path}: no row in it; `tlog info` shows what it holds")
    return [table.rows for table in tables]


def _fill_flights(log: LogFile, selection: Selection, new: NewTable) -> list[Table]:
    tables: dict[VehicleKey, Table] = {}
    flights = FlightTables(log.dialect)
    for entry in log.entries():
        made = flights.row(entry)  # also before the selected time: the mode was reported then
        if made is None or not selection.in_time(entry) or not selection.has(*made[0]):
            continue
        (sysid, compid), row = made
        table = tables.get((sysid, compid))
        if table is None:
            name = f"{sysid}" if compid == 1 else f"{sysid}.{compid}"
            table = tables[sysid, compid] = new(name, FLIGHT_COLUMNS)
        table.add(row)
    return list(tables.values())


def _fill_messages(log: LogFile, selection: Selection, new: NewTable) -> list[Table]:
    tables: dict[int, tuple[MessageColumns, Table]] = {}
    for entry in log.selected(selection):
        frame = entry.frame
        if frame is None or frame.info is None:
            continue
        known = tables.get(frame.msgid)
        if known is None:
            columns = MessageColumns(frame.info)
            known = tables[frame.msgid] = columns, new(columns.name, columns.columns)
        columns, table = known
        table.add(columns.row(entry, frame))
    return [table for _, table in tables.values()]


def _new_tables(outputs: Outputs, closing: ExitStack, folder: Path, stem: str, parquet: bool) -> NewTable:
    if not parquet:
        return lambda name, columns: CsvTable(outputs.open_text(folder / f"{stem}-{name}.csv"), columns)
    require_pyarrow()

    def new(name: str, columns: Columns) -> Table:
        table = ParquetTable(outputs.open_bytes(folder / f"{stem}-{name}.parquet"), columns)
        closing.callback(table.close)
        return table

    return new


def require_pyarrow() -> None:
    """Raises SkygcsError that says how to install it."""
    try:
        import pyarrow.parquet  # noqa: F401
    except ImportError:
        raise SkygcsError(
            "Parquet needs pyarrow: pip install 'skygcs[parquet]', or pip install '.[parquet]' in a checkout"
        ) from None


def _arrow_type(pa: Any, kind: Kind) -> Any:
    if kind == TIME:
        return pa.timestamp("us", tz="UTC")
    return getattr(pa, _TYPES.get(kind) or kind.removesuffix("_t"))()
