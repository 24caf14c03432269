"""`skygcs-cli tlog …`: what one does with recorded flights. Needs no daemon.

Options are here; what is computed and shown is imported when it is asked for.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import typer

from skygcs.cli.connection import fail, run_offline
from skygcs.cli.log_options import (
    Begin,
    DialectName,
    End,
    FleetFile,
    Force,
    LogPath,
    Messages,
    Vehicles,
    selection,
)
from skygcs.cli.options import Json
from skygcs.cli.parsing import finite, parse_number

tlog = typer.Typer(help="Recorded flights: tlog files and raw captures.", no_args_is_help=True)

PLOT_SUFFIXES = (".png", ".svg", ".html")

LogPaths = Annotated[list[Path], typer.Argument(metavar="FILE …", help="Tlogs.", show_default=False)]
Without = Annotated[
    str | None, typer.Option("--without", metavar="LIST", help="Messages to leave out.", show_default=False)
]


@tlog.command("info")
def _info(
    files: Annotated[list[str], typer.Argument(metavar="FILE …", help="Tlogs, or bytes as they came from a link.")],
    dialect: DialectName = None,
    json_output: Json = False,
) -> None:
    """Count each file's records, messages, sources and vehicles."""

    def command() -> int:
        from skygcs.cli.tlog import tlog_infos

        return tlog_infos([Path(file) for file in files], json_output, dialect, fail)

    run_offline(command)


@tlog.command("filter")
def _filter(
    file: LogPath,
    out: Annotated[Path, typer.Argument(metavar="OUT", help="The file to write.", show_default=False)],
    begin: Begin = None,
    end: End = None,
    vehicles: Vehicles = None,
    addressed: Annotated[
        bool, typer.Option("--addressed", help="With --vehicle: also what others sent to it.")
    ] = False,
    messages: Messages = None,
    without: Without = None,
    fleet: FleetFile = None,
    dialect: DialectName = None,
    force: Force = False,
) -> None:
    """Write a part of a log: by time, by vehicle, by message. Its records stay as they are."""

    def command() -> None:
        from skygcs.cli.log_file import dialect_named
        from skygcs.cli.tlog_cut import filter_log

        table = dialect_named(dialect)
        chosen = selection(table, begin, end, vehicles, messages, without, fleet, addressed)
        typer.echo(filter_log(file, out, chosen, table, force))

    run_offline(command)


@tlog.command("merge")
def _merge(
    files: LogPaths,
    out: Annotated[Path, typer.Option("--output", "-o", metavar="OUT", help="The file to write.", show_default=False)],
    dialect: DialectName = None,
    force: Force = False,
) -> None:
    """Make one tlog of several, by time."""

    def command() -> None:
        from skygcs.cli.log_file import dialect_named
        from skygcs.cli.tlog_cut import merge_logs

        typer.echo(merge_logs(files, out, dialect_named(dialect), force))

    run_offline(command)


@tlog.command("split")
def _split(
    file: LogPath,
    folder: Annotated[
        Path | None,
        typer.Option("--output", "-o", metavar="FOLDER", help="Default: the file's.", show_default=False),
    ] = None,
    dialect: DialectName = None,
    force: Force = False,
) -> None:
    """Make a log of each vehicle, FILE-1.tlog …, and FILE-rest.tlog of what belongs to none."""

    def command() -> None:
        from skygcs.cli.log_file import dialect_named
        from skygcs.cli.tlog_cut import split_log

        _print_lines(split_log(file, folder or file.parent, dialect_named(dialect), force))

    run_offline(command)


@tlog.command("csv")
def _csv(
    file: LogPath,
    folder: Annotated[
        str | None,
        typer.Option(
            "--output",
            "-o",
            metavar="FOLDER",
            help="Default: the file's. - is stdout, for one table.",
            show_default=False,
        ),
    ] = None,
    messages: Messages = None,
    all_messages: Annotated[bool, typer.Option("--all", help="Every message there is, a table each.")] = False,
    begin: Begin = None,
    end: End = None,
    vehicles: Vehicles = None,
    without: Without = None,
    parquet: Annotated[bool, typer.Option("--parquet", help="Parquet; needs pyarrow.")] = False,
    fleet: FleetFile = None,
    dialect: DialectName = None,
    force: Force = False,
) -> None:
    """Tables: the flight of each vehicle (time, mode, lat, lon, alt, vx, vy, vz, roll, pitch, yaw), or of messages.

    Degrees, metres above home, m/s to the north, east and down; `time` is UTC, in seconds since 1970.
    """
    if parquet and folder == "-":
        raise typer.BadParameter("--parquet does not go to stdout: --output FOLDER")

    def command() -> None:
        from skygcs.cli.log_file import dialect_named
        from skygcs.cli.tlog_tables import write_tables

        table = dialect_named(dialect)
        chosen = selection(table, begin, end, vehicles, messages, without, fleet)
        by_message = all_messages or messages is not None or without is not None
        where = None if folder == "-" else file.parent if folder is None else Path(folder)
        _print_lines(write_tables(file, where, chosen, by_message, parquet, table, force))

    run_offline(command)


@tlog.command("plot")
def _plot(
    file: LogPath,
    output: Annotated[
        Path | None, typer.Option("--output", "-o", metavar="OUT", help=".png, .svg or .html; default: FILE with .png.")
    ] = None,
    origin: Annotated[
        str | None,
        typer.Option("--origin", metavar="LAT,LON", help="(0, 0) of the map. [default: the first position]"),
    ] = None,
    begin: Begin = None,
    end: End = None,
    vehicles: Vehicles = None,
    fleet: FleetFile = None,
    dialect: DialectName = None,
) -> None:
    """Draw a flight: map of the tracks, height, battery, modes, and what the link lost, for all vehicles."""
    path = file.with_suffix(".png") if output is None else output
    if path.suffix.lower() not in PLOT_SUFFIXES:
        raise typer.BadParameter(f"--output: {path.name!r} does not end in .png, .svg or .html")
    place = None if origin is None else _place(origin)

    def command() -> None:
        from skygcs.cli.log_file import dialect_named
        from skygcs.cli.tlog_plot import plot_log

        table = dialect_named(dialect)
        typer.echo(plot_log(file, path, selection(table, begin, end, vehicles, fleet=fleet), place, table))

    run_offline(command)


@tlog.command("play")
def _play(
    file: LogPath,
    address: Annotated[
        str, typer.Argument(metavar="[HOST:]PORT", help="Where it goes, over UDP; without HOST to this machine.")
    ] = "14550",
    speed: Annotated[
        float, typer.Option("--speed", metavar="X", parser=finite, help="Times as fast; 0: at once.")
    ] = 1.0,
    loop: Annotated[bool, typer.Option("--loop", help="Again and again.")] = False,
    everything: Annotated[
        bool, typer.Option("--all", help="Also what ground stations sent: ORDERS TO VEHICLES AMONG IT.")
    ] = False,
    begin: Begin = None,
    end: End = None,
    vehicles: Vehicles = None,
    messages: Messages = None,
    without: Without = None,
    fleet: FleetFile = None,
    dialect: DialectName = None,
) -> None:
    """Send what vehicles told over UDP as it came, for a ground station or another skygcs to watch. Ctrl-C ends it."""
    from skygcs.tlog.timeline import speed_problem

    problem = speed_problem(speed)
    if problem is not None:
        raise typer.BadParameter(f"--speed: {problem}")
    where = _address(address)

    def command() -> None:
        from skygcs.cli.log_file import dialect_named
        from skygcs.cli.tlog_play import play_log

        table = dialect_named(dialect)
        chosen = selection(table, begin, end, vehicles, messages, without, fleet)
        typer.echo(play_log(file, where, chosen, speed, loop, everything, table))

    run_offline(command)


def _print_lines(lines: Sequence[str]) -> None:
    for line in lines:
        typer.echo(line)


def _place(text: str) -> tuple[float, float]:
    parts = [part.strip() for part in text.split(",")]
    if len(parts) != 2:
        raise typer.BadParameter(f"--origin: {text!r} is not LAT,LON")
    lat, lon = (parse_number(part, "--origin") for part in parts)
    if not (abs(lat) <= 90 and abs(lon) <= 180):
        raise typer.BadParameter(f"--origin: {text!r} is no place on earth")
    return lat, lon


def _address(text: str) -> tuple[str, int]:
    host, _, port = text.rpartition(":")
    if not (port.isascii() and port.isdigit() and 0 < int(port) < 65536):
        raise typer.BadParameter(f"{text!r} is not [HOST:]PORT")
    return host.strip("[]") or "127.0.0.1", int(port)


def add_to(app: typer.Typer) -> None:
    app.add_typer(tlog, name="tlog", rich_help_panel="Show")
