"""`skygcs-cli tlog csv`: tables from logs, of flights or of messages, as CSV or Parquet."""

from __future__ import annotations

import csv
import sys
from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path
from typing import IO, Any, Protocol

from skygcs.cli.log_file import LogFile, opened_log
from skygcs.cli.log_output import Outputs, make_folder
from skygcs.cli.tlog_cut import selected
from skygcs.core.mavlink.dialect import Dialect
from skygcs.errors import SkygcsError
from skygcs.tlog.columns import TIME, Kind, MessageColumns
from skygcs.tlog.flight_table import COLUMNS, FlightTables, VehicleKey
from skygcs.tlog.selection import Selection

Columns = tuple[tuple[str, Kind], ...]


class Table(Protocol):
    """Rows of values in the order of the columns; a time is microseconds, None is an empty cell."""

    rows: int

    def add(self, row: list[Any]) -> None: ...


NewTable = Callable[[str, Columns], Table]
"""A table of that name; two tables of one log have different names."""


class CsvTable:
    """RFC 4180; times in seconds with six decimals, floats so that they are read back exactly."""

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


_CELLS: dict[Kind, Callable[[Any], str]] = {TIME: seconds, "float": lambda value: format(value, ".9g")}
"""9 digits give back every float of 32 bits; a double is written by repr."""


class Stdout:
    """The one table that goes to stdout; a second one is refused."""

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

    ``folder`` None: the one table there is goes to stdout. What to say of each file. Raises SkygcsError.
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
            lines = [f"{file}: {rows:,} rows" for file, rows in zip(outputs.paths, counts, strict=True)]
        log.tell_faults()
    return lines


def _filled(
    log: LogFile, selection: Selection, fill: Callable[[LogFile, Selection, NewTable], list[Table]], new: NewTable
) -> list[int]:
    tables = fill(log, selection, new)
    if not tables:
        raise SkygcsError(f"{log.path}: nothing in it makes a row; `tlog info` shows what is there")
    return [table.rows for table in tables]


def _fill_flights(log: LogFile, selection: Selection, new: NewTable) -> list[Table]:
    tables: dict[VehicleKey, Table] = {}
    flights = FlightTables(log.dialect)
    for entry in log.entries():
        made = flights.row(entry)  # also before the time that is asked for: the mode was told then
        if made is None or not selection.in_time(entry) or not selection.has(*made[0]):
            continue
        (sysid, compid), row = made
        table = tables.get((sysid, compid))
        if table is None:
            name = f"{sysid}" if compid == 1 else f"{sysid}.{compid}"
            table = tables[sysid, compid] = new(name, COLUMNS)
        table.add(row)
    return list(tables.values())


def _fill_messages(log: LogFile, selection: Selection, new: NewTable) -> list[Table]:
    tables: dict[int, tuple[MessageColumns, Table]] = {}
    for entry in selected(log, selection):
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
    from skygcs.cli.tlog_parquet import ParquetTable, require_pyarrow

    require_pyarrow()

    def new(name: str, columns: Columns) -> Table:
        table = ParquetTable(outputs.open_bytes(folder / f"{stem}-{name}.parquet"), columns)
        closing.callback(table.close)
        return table

    return new
