"""`skygcs-cli report`: the page and the tables of a day, from a log folder. Needs no daemon."""

from __future__ import annotations

import csv
import math
from collections.abc import Callable
from datetime import date
from pathlib import Path
from typing import Annotated

import typer

from skygcs.cli.connection import Exit, fail, run_offline
from skygcs.cli.render import plural, say
from skygcs.config.files import open_regular
from skygcs.core.geo import Origin
from skygcs.core.separation import Footprint
from skygcs.errors import SkygcsError
from skygcs.ext.logs.commands import dialect_named, origin_of
from skygcs.ext.logs.report.day_figures import DayReport, FileState
from skygcs.ext.logs.report.gathering import ALL_DAYS, ReportRequest, failures, gather
from skygcs.ext.logs.report.report_page import MARK, page
from skygcs.ext.logs.report.report_tables import FigureTable, all_tables, dates
from skygcs.ext.logs.tables import VehicleKey
from skygcs.tlog.files import Outputs, make_folder

MARK_WITHIN_BYTES = 2048


def report(
    folder: Annotated[
        Path, typer.Argument(metavar="LOGDIR", help="A log folder: tlogs, control traces.", show_default=False)
    ],
    output: Annotated[
        Path, typer.Option("--output", "-o", metavar="OUT", help="The page to write, .html.", show_default=False)
    ],
    tables: Annotated[
        Path | None,
        typer.Option("--csv", metavar="FOLDER", help="Also write each table as CSV there.", show_default=False),
    ] = None,
    day: Annotated[
        str | None,
        typer.Option("--day", metavar="DATE", help="2026-04-01 (UTC), or all. [default: the newest]"),
    ] = None,
    plan: Annotated[
        list[Path] | None,
        typer.Option("--plan", metavar="FILE", help="A plan to draw with what was flown; several.", show_default=False),
    ] = None,
    fleet: Annotated[
        Path | None,
        typer.Option("--fleet", metavar="TOML", help="A fleet file: names, margins, origin.", show_default=False),
    ] = None,
    origin: Annotated[
        str | None,
        typer.Option("--origin", metavar="LAT,LON,AMSL", help="(0, 0, 0). [default: the fleet's, or first position]"),
    ] = None,
    dialect: Annotated[
        str | None, typer.Option("--dialect", metavar="NAME", help="Default: all of pymavlink's, and PX4's own.")
    ] = None,
    force: Annotated[bool, typer.Option("--force", help="Overwrite a file that is not a report.")] = False,
) -> None:
    """One page of a day: flights, paths, heights, batteries, errors, delays, losses, radios, margins, events.

    Example: skygcs-cli report logs/ -o day.html --fleet fleet.toml --plan show.json
    """
    if output.suffix.lower() not in (".html", ".htm"):
        raise typer.BadParameter(f"--output: {output.name!r} does not end in .html")
    if day is not None and day != ALL_DAYS:
        _require_date(day)
    place = None if origin is None else origin_of(origin)

    def command() -> int:
        wanted, names = _wishes(folder, day, place, fleet)
        wanted, with_plan = _with_plan(wanted, plan or [], names)
        made = gather(wanted, dialect_named(dialect))
        with_plan(made)
        say(write_report(made, output, tables, force=force))
        problems = failures(made)
        for problem in problems:
            fail(f"{folder}: {problem}")
        return Exit.FAILED if problems else Exit.DONE

    run_offline(command)


def write_report(made: DayReport, output: Path, tables: Path | None, *, force: bool) -> str:
    """Write the page, and with ``tables`` the CSV files; all of them or none. Returns a line for the user. Raises
    SkygcsError, also for a file that is there and is none of ours without ``force``."""
    figures = [] if tables is None else all_tables(made)
    if not force:
        require_own(output, _is_report)
        for table in figures:
            require_own((tables or output) / f"{table.name}.csv", _is_table(table))
    if tables is not None:
        make_folder(tables)
    with Outputs(force=True) as outputs:
        outputs.open_text(output).write(page(made))
        for table in figures:
            file = outputs.open_text((tables or output) / f"{table.name}.csv")
            csv.writer(file, lineterminator="\n").writerows(table.csv_rows())
    flights = sum(len(vehicle.flights) for vehicle in made.vehicles)
    other_days = sum(note.state is FileState.OTHER_DAY for note in made.files)
    text = f"{output}: {plural(len(made.vehicles), 'vehicle')}, {plural(flights, 'flight')}"
    if math.isfinite(made.begin_s):
        text += f" of {dates(made.begin_s, made.end_s)}"
    if other_days:
        text += f"; {plural(other_days, 'file')} of other days left out (--day)"
    return text if tables is None else f"{text}; {len(figures)} tables in {tables}"


def require_own(path: Path, is_own: Callable[[str], bool]) -> None:
    """Raises SkygcsError if there is a file whose beginning is not that of one that this command has written."""
    if path.is_dir() or not path.exists():
        return  # `Outputs` says so of a folder
    try:
        with open_regular(path) as file:
            head = file.read(MARK_WITHIN_BYTES).decode("utf-8", "replace")
    except OSError as error:
        raise SkygcsError(f"{path}: {error.strerror or error}") from None
    if not is_own(head):
        raise SkygcsError(f"{path}: exists and is not a report; --force overwrites it")


def _is_report(head: str) -> bool:
    return MARK in head


def _is_table(table: FigureTable) -> Callable[[str], bool]:
    names = ",".join(column.name for column in table.columns)
    return lambda head: head.startswith(f"{names}\n")


# -- what the options mean


def _require_date(text: str) -> None:
    try:
        date.fromisoformat(text)
    except ValueError:
        raise typer.BadParameter(f"--day: {text!r} is neither a date (2026-04-01) nor all") from None


def _wishes(
    folder: Path, day: str | None, origin: Origin | None, fleet: Path | None
) -> tuple[ReportRequest, dict[str, int]]:
    """With the names, and the system id of each. Raises ConfigError."""
    if fleet is None:
        return ReportRequest(folder, day, origin), {}
    from skygcs.config.loader import load_fleet

    config = load_fleet(fleet)
    if origin is None and config.origin is not None:
        origin = Origin(**config.origin.model_dump())
    vehicles = config.vehicle_configs()
    names = {vehicle.name: vehicle.sysid for vehicle in vehicles}
    footprints = {vehicle.sysid: vehicle.separation.footprint() for vehicle in vehicles}

    def footprint(key: VehicleKey) -> Footprint:
        return footprints.get(key[0], Footprint())

    return ReportRequest(folder, day, origin, {sysid: name for name, sysid in names.items()}, footprint), names


def _with_plan(
    wanted: ReportRequest, files: list[Path], names: dict[str, int]
) -> tuple[ReportRequest, Callable[[DayReport], None]]:
    """The wanted with the plan's origin if it has one and no other is known, and what gives the plan to a report.
    Raises SkygcsError for a plan that cannot be read."""
    if not files:
        return wanted, lambda _: None
    from dataclasses import replace

    from skygcs.cli.plan_reading import read_files
    from skygcs.core.trajectory import MotionLimits
    from skygcs.ext.logs.report.planned import add_plan, planned_paths

    found = read_files(files, MotionLimits(), wanted.origin)
    paths = planned_paths(found.plan)
    wanted = replace(wanted, origin=wanted.origin or found.origin)

    def give(made: DayReport) -> None:
        made.plan_name = ", ".join(file.name for file in files)
        made.plan_own_origin = wanted.origin is None
        if made.plan_own_origin:
            made.missing.append(
                f"{made.plan_name}: the place of the plan's origin is not known, so it is drawn beside what was flown; "
                "--origin LAT,LON,AMSL or --fleet FILE with [origin] puts one over the other"
            )
        add_plan(made, paths, names)

    return wanted, give


def add_to(app: typer.Typer) -> None:
    app.command()(report)
