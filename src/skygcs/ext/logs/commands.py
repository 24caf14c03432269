"""`skygcs-cli tlog …`: options and commands for recorded flights, tlogs and raw captures. Needs no daemon.

What needs packages of an extra (plots, MCAP, ROS 2) is imported when a command runs.
"""

from __future__ import annotations

import json
import re
from collections.abc import Iterator, Sequence
from datetime import UTC, datetime
from importlib.util import find_spec
from pathlib import Path
from typing import Annotated, Any

import typer

from skygcs.cli.connection import fail, run_offline
from skygcs.cli.options import Json
from skygcs.cli.parsing import finite, parse_number
from skygcs.cli.render import console, print_lines, say, table
from skygcs.config.dialects import load_dialect, offline_dialect
from skygcs.core.geo import Origin
from skygcs.core.mavlink.dialect import Dialect
from skygcs.errors import SkygcsError
from skygcs.ext.logs.census import Census
from skygcs.ext.logs.cutting import filter_log, merge_logs, split_log
from skygcs.ext.logs.player import play_log
from skygcs.ext.logs.table_files import write_tables
from skygcs.tlog.files import KIND_NAMES, opened_log
from skygcs.tlog.selection import Selection, SourceFilter

tlog = typer.Typer(help="Recorded flights: tlog files and raw captures.", no_args_is_help=True)

PLOT_SUFFIXES = (".png", ".svg", ".html")

LogPath = Annotated[
    Path, typer.Argument(metavar="FILE", help="A tlog, or bytes as they came from a link.", show_default=False)
]
Begin = Annotated[
    str | None,
    typer.Option(
        "--from", metavar="T", help="Seconds (or M:SS) from the beginning, or a time of day in UTC.", show_default=False
    ),
]
End = Annotated[str | None, typer.Option("--to", metavar="T", help="Likewise. [default: the end]", show_default=False)]
Vehicles = Annotated[
    str | None,
    typer.Option(
        "--vehicle",
        metavar="LIST",
        help="System ids: 1, 1,3, 2-5, 1/190 for one component, or names with --fleet.",
        show_default=False,
    ),
]
Messages = Annotated[
    str | None, typer.Option("--message", metavar="LIST", help="Names or ids: ATTITUDE,SYS_STATUS.", show_default=False)
]
FleetFile = Annotated[
    Path | None,
    typer.Option("--fleet", metavar="TOML", help="A fleet file, for names of vehicles.", show_default=False),
]
DialectName = Annotated[
    str | None,
    typer.Option("--dialect", metavar="NAME", help="Default: all of pymavlink's, and PX4's own.", show_default=False),
]
Force = Annotated[bool, typer.Option("--force", help="Overwrite what is there.")]
BagOrigin = Annotated[
    str | None,
    typer.Option(
        "--origin",
        metavar="LAT,LON,AMSL",
        help="(0, 0, 0) of the poses; of a bag's frame map. [default: that of --fleet, else the first position]",
    ),
]
Px4Msgs = Annotated[
    str | None,
    typer.Option(
        "--px4-msgs",
        metavar="RELEASE",
        help="With --rosbag2: PX4's own topics of this release, as 1.16. [default: as the fleet file says]",
    ),
]
LogPaths = Annotated[list[Path], typer.Argument(metavar="FILE …", help="Tlogs.", show_default=False)]
Without = Annotated[
    str | None, typer.Option("--without", metavar="LIST", help="Messages to leave out.", show_default=False)
]

MOST_ROWS = 300
"""Most rows of a table for a person: more than any fleet has. The 65,000 sources of an attack take a minute."""

_MINUTES = re.compile(r"(?:(\d+):)?(\d+):(\d{2}(?:\.\d+)?)")
_SOURCE = re.compile(r"(\d{1,3})(?:/(\d{1,3}))?")
_RANGE = re.compile(r"(\d{1,3})-(\d{1,3})")


# -- commands


@tlog.command("info")
def _info(
    files: Annotated[list[str], typer.Argument(metavar="FILE …", help="Tlogs, or bytes as they came from a link.")],
    dialect: DialectName = None,
    json_output: Json = False,
) -> None:
    """Count each file's records, messages, sources and vehicles.

    Example: skygcs-cli tlog info flight.tlog
    """

    def command() -> int:
        return print_info([Path(file) for file in files], json_output, dialect)

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
    """Write a part of a log: by time, by vehicle, by message. Records keep their bytes.

    Example: skygcs-cli tlog filter flight.tlog part.tlog --from 60 --to 120 --vehicle 2
    """

    def command() -> None:
        table = dialect_named(dialect)
        chosen = selection(table, begin, end, vehicles, messages, without, fleet, addressed)
        say(filter_log(file, out, chosen, table, force))

    run_offline(command)


@tlog.command("merge")
def _merge(
    files: LogPaths,
    out: Annotated[Path, typer.Option("--output", "-o", metavar="OUT", help="The file to write.", show_default=False)],
    dialect: DialectName = None,
    force: Force = False,
) -> None:
    """Merge several tlogs into one, by time.

    Example: skygcs-cli tlog merge left.tlog right.tlog -o both.tlog
    """

    def command() -> None:
        say(merge_logs(files, out, dialect_named(dialect), force))

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
    """Write a log for each vehicle, FILE-1.tlog …, and FILE-rest.tlog for records that belong to none.

    Example: skygcs-cli tlog split flight.tlog -o parts/
    """

    def command() -> None:
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
    all_messages: Annotated[bool, typer.Option("--all", help="Every message, a table each.")] = False,
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

    Example: skygcs-cli tlog csv flight.tlog --message ATTITUDE,SYS_STATUS
    """
    if parquet and folder == "-":
        raise typer.BadParameter("--parquet does not go to stdout: --output FOLDER")

    def command() -> None:
        table = dialect_named(dialect)
        chosen = selection(table, begin, end, vehicles, messages, without, fleet)
        by_message = all_messages or messages is not None or without is not None
        where = None if folder == "-" else file.parent if folder is None else Path(folder)
        _print_lines(write_tables(file, where, chosen, by_message, parquet, table, force))

    run_offline(command)


@tlog.command("export")
def _export(
    file: LogPath,
    mcap: Annotated[bool, typer.Option("--mcap", help="One MCAP file, for Foxglove and Lichtblick.")] = False,
    rosbag2: Annotated[bool, typer.Option("--rosbag2", help="A rosbag2 folder; ROS is not needed for it.")] = False,
    output: Annotated[
        Path | None,
        typer.Option("--output", "-o", metavar="OUT", help="Default: FILE with .mcap, or FILE-rosbag2."),
    ] = None,
    origin: BagOrigin = None,
    frames: Annotated[
        bool, typer.Option("--frames", help="With --rosbag2: also every frame, as mavros_msgs/Mavlink.")
    ] = False,
    px4_msgs: Px4Msgs = None,
    begin: Begin = None,
    end: End = None,
    vehicles: Vehicles = None,
    messages: Messages = None,
    without: Without = None,
    fleet: FleetFile = None,
    dialect: DialectName = None,
    force: Force = False,
) -> None:
    """Write a log for other programs: poses, map positions, batteries, texts; as MCAP also paths and every message.

    A bag has the topics of the live node of ROS 2. Poses are metres east, north and up, attitudes of a body with x
    forward, y left, z up.

    Example: skygcs-cli tlog export flight.tlog --mcap
    """
    # check the options
    if mcap == rosbag2:
        raise typer.BadParameter("give one of --mcap and --rosbag2")
    if rosbag2 and force:
        raise typer.BadParameter("--force: a rosbag2 is a folder, which is not overwritten; remove it")
    if mcap and (frames or px4_msgs is not None):
        raise typer.BadParameter("--frames and --px4-msgs are for --rosbag2")
    where = None if origin is None else origin_of(origin)

    def command() -> None:
        # choose the frames
        table = dialect_named(dialect)
        chosen = selection(table, begin, end, vehicles, messages, without, fleet)
        names = {sysid: name for name, sysid in names_of(fleet).items()}
        # write the format that is asked for
        if mcap:
            from skygcs.ext.logs.mcap_file import write_mcap

            out = output or file.with_suffix(".mcap")
            _print_lines(write_mcap(file, out, chosen, names, where, table, force))
        else:
            out = output or file.with_name(f"{file.stem}-rosbag2")
            _print_lines(_bag(file, out, chosen, fleet, where, px4_msgs, frames, table))

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
    """Draw a flight: map of the tracks, height, battery, modes and losses of the link, for all vehicles.

    Example: skygcs-cli tlog plot flight.tlog -o flight.html
    """
    path = file.with_suffix(".png") if output is None else output
    if path.suffix.lower() not in PLOT_SUFFIXES:
        raise typer.BadParameter(f"--output: {path.name!r} does not end in .png, .svg or .html")
    place = None if origin is None else _place(origin)

    def command() -> None:
        from skygcs.ext.logs.flight_plot import plot_log

        table = dialect_named(dialect)
        say(plot_log(file, path, selection(table, begin, end, vehicles, fleet=fleet), place, table))

    run_offline(command)


@tlog.command("play")
def _play(
    file: LogPath,
    address: Annotated[
        str, typer.Argument(metavar="[HOST:]PORT", help="Destination, over UDP; without HOST this machine.")
    ] = "14550",
    speed: Annotated[
        float, typer.Option("--speed", metavar="X", parser=finite, help="Factor; 0: as fast as possible.")
    ] = 1.0,
    loop: Annotated[bool, typer.Option("--loop", help="Again and again.")] = False,
    everything: Annotated[
        bool, typer.Option("--all", help="Also what ground stations sent, WHICH MAY BE ORDERS TO VEHICLES.")
    ] = False,
    begin: Begin = None,
    end: End = None,
    vehicles: Vehicles = None,
    messages: Messages = None,
    without: Without = None,
    fleet: FleetFile = None,
    dialect: DialectName = None,
) -> None:
    """Send a recording's telemetry over UDP at its recorded pace, to a ground station or skygcs. Ctrl-C ends it.

    Example: skygcs-cli tlog play flight.tlog 10.0.0.5:14550 --speed 10
    """
    from skygcs.config.models import speed_problem  # pydantic's models are heavy

    if (problem := speed_problem(speed)) is not None:
        raise typer.BadParameter(f"--speed: {problem}")
    where = _address(address)

    def command() -> None:
        table = dialect_named(dialect)
        chosen = selection(table, begin, end, vehicles, messages, without, fleet)
        say(play_log(file, where, chosen, speed, loop, everything, table))

    run_offline(command)


def _print_lines(lines: Sequence[str]) -> None:
    for line in lines:
        say(line)


def _place(text: str) -> tuple[float, float]:
    parts = [part.strip() for part in text.split(",")]
    if len(parts) != 2:
        raise typer.BadParameter(f"--origin: {text!r} is not LAT,LON")
    lat, lon = (parse_number(part, "--origin") for part in parts)
    if not (abs(lat) <= 90 and abs(lon) <= 180):
        raise typer.BadParameter(f"--origin: {text!r} is not a position on earth")
    return lat, lon


def _bag(
    file: Path,
    out: Path,
    chosen: Selection,
    fleet: Path | None,
    origin: Origin | None,
    px4_msgs: str | None,
    frames: bool,
    dialect: Dialect,
) -> list[str]:
    """Write a bag by [ros], [origin] and the names of the fleet file. Raises BadParameter, SkygcsError."""
    if find_spec("rosbags") is None:
        raise SkygcsError("rosbag2 needs the library rosbags: pip install 'skygcs[foxglove]'")
    from skygcs.config.loader import load_fleet
    from skygcs.core.ros.interfaces import PX4_RELEASES
    from skygcs.ext.logs.recorded_node import Naming, Wanted
    from skygcs.ext.logs.rosbag_file import write_rosbag

    naming, names = Naming(), {}
    if fleet is not None:
        config = load_fleet(fleet)
        names = {vehicle.sysid: vehicle.name for vehicle in config.vehicle_configs()}
        if origin is None and config.origin is not None:
            origin = Origin(**config.origin.model_dump())
        if (ros := config.extensions.get("ros")) is not None:
            naming = Naming(**{key: getattr(ros, key) for key in Naming._fields})
    if px4_msgs is not None:
        if px4_msgs not in ("none", *PX4_RELEASES):
            raise typer.BadParameter(f"--px4-msgs: {px4_msgs!r} is none of {', '.join(PX4_RELEASES)}, none")
        naming = naming._replace(px4_msgs=px4_msgs)
    return write_rosbag(file, out, Wanted(chosen, names, naming, origin, frames), dialect)


def origin_of(text: str) -> Origin:
    """The origin in LAT,LON,AMSL. Raises BadParameter."""
    parts = [part.strip() for part in text.split(",")]
    if len(parts) != 3:
        raise typer.BadParameter(f"--origin: {text!r} is not LAT,LON,AMSL")
    lat, lon = _place(",".join(parts[:2]))
    return Origin(lat, lon, parse_number(parts[2], "--origin"))


def _address(text: str) -> tuple[str, int]:
    host, _, port = text.rpartition(":")
    if not (port.isascii() and port.isdigit() and 0 < int(port) < 65536):
        raise typer.BadParameter(f"{text!r} is not [HOST:]PORT")
    return host.strip("[]") or "127.0.0.1", int(port)


def parquet_beside(files: Sequence[Path]) -> Iterator[str]:
    """Write all tables of these recordings as Parquet beside them; a line for each. Raises SkygcsError (no pyarrow)."""
    table = dialect_named(None)
    for file in files:
        yield from write_tables(file, file.parent, selection(table), False, True, table, True)


# -- what the options mean


def dialect_named(name: str | None) -> Dialect:
    """The dialect of this name, or all of pymavlink's and PX4's own. Raises DialectError."""
    return offline_dialect() if name is None else load_dialect(name)


def selection(
    dialect: Dialect,
    begin: str | None = None,
    end: str | None = None,
    vehicles: str | None = None,
    messages: str | None = None,
    without: str | None = None,
    fleet: Path | None = None,
    addressed: bool = False,
) -> Selection:
    """Return what the options say. Raises BadParameter, ConfigError for the fleet file."""
    chosen = Selection(
        begin=None if begin is None else moment(begin, "--from"),
        end=None if end is None else moment(end, "--to"),
        sources=frozenset() if vehicles is None else sources(vehicles, names_of(fleet)),
        messages=frozenset() if messages is None else message_ids(messages, dialect, "--message"),
        without=frozenset() if without is None else message_ids(without, dialect, "--without"),
        addressed=addressed,
    )
    begin_, end_ = chosen.begin, chosen.end
    if begin_ is not None and end_ is not None and type(begin_) is type(end_) and end_ < begin_:
        raise typer.BadParameter("--to must be later than --from")
    return chosen


def moment(text: str, option: str) -> float | int:
    """Seconds from the beginning (float), or microseconds since 1970 (int) of a time such as 2024-06-11T22:15:49."""
    minutes = _MINUTES.fullmatch(text)
    if minutes is not None:
        return int(minutes[1] or 0) * 3600.0 + int(minutes[2]) * 60.0 + float(minutes[3])
    try:
        seconds = float(text)
    except ValueError:
        pass
    else:
        if 0 <= seconds < 1e9:  # false for NaN; thirty years
            return seconds
        raise typer.BadParameter(f"{option}: {text!r} is not a number of seconds from the beginning")
    try:
        when = datetime.fromisoformat(text)
    except ValueError:
        raise typer.BadParameter(
            f"{option}: {text!r} is neither seconds (90.5), minutes (1:30.5) nor a time (2024-06-11T22:15:49)"
        ) from None
    when = when.replace(tzinfo=UTC) if when.tzinfo is None else when
    return round(when.timestamp() * 1e6)


def sources(text: str, names: dict[str, int]) -> frozenset[SourceFilter]:
    """System ids, ranges, components and names, with commas between. Raises BadParameter."""
    found: set[SourceFilter] = set()
    for part in (part.strip() for part in text.split(",")):
        single, span = _SOURCE.fullmatch(part), _RANGE.fullmatch(part)
        if part in names:
            found.add((names[part], None))
        elif single is not None:
            found.add((_id(single[1]), None if single[2] is None else _id(single[2])))
        elif span is not None and int(span[1]) <= int(span[2]):
            found |= {(sysid, None) for sysid in range(_id(span[1]), _id(span[2]) + 1)}
        else:
            known = f"; the fleet file has {', '.join(sorted(names))}" if names else "; names need --fleet FILE"
            raise typer.BadParameter(f"--vehicle: {part!r} is not a system id{known}")
    return frozenset(found)


def message_ids(text: str, dialect: Dialect, option: str) -> frozenset[int]:
    """Ids of messages by name or id; an id that the dialect does not have is taken, too. Raises BadParameter."""
    found = set()
    for part in (part.strip() for part in text.split(",")):
        if part.isdigit() and int(part) < 1 << 24:
            found.add(int(part))
            continue
        try:
            found.add(dialect.find(part).msgid)
        except KeyError as error:
            raise typer.BadParameter(f"{option}: {error.args[0]}") from None
    return frozenset(found)


def names_of(fleet: Path | None) -> dict[str, int]:
    """Vehicles of a fleet file: name to system id. Raises ConfigError."""
    if fleet is None:
        return {}
    from skygcs.config.loader import load_fleet

    return {vehicle.name: vehicle.sysid for vehicle in load_fleet(fleet).vehicle_configs()}


def _id(text: str) -> int:
    if int(text) > 255:
        raise typer.BadParameter(f"--vehicle: {text} is not an id: they go up to 255")
    return int(text)


# -- tlog info


def print_info(files: Sequence[Path], json_output: bool = False, dialect: str | None = None) -> int:
    """Print what each file holds; 0 if all are good. Raises SkygcsError if there is one file, and it is not.

    JSON is one answer for one file, else a list of answers with the "file". A file of several that cannot be read or
    holds no MAVLink is reported on stderr, and the others are still shown.
    """
    table = dialect_named(dialect)
    answers: list[dict[str, Any]] = []
    for file in files:
        try:
            kind, answer = _counted(file, table)
        except SkygcsError as error:
            if len(files) == 1:
                raise
            fail(str(error))
            continue
        answers.append(answer if len(files) == 1 else {"file": str(file), **answer})
        if not json_output:
            _print_summary(file, kind, answer)
    if json_output:
        print(json.dumps(answers[0] if len(files) == 1 else answers, indent=1))
    return int(len(answers) < len(files))


def _counted(file: Path, dialect: Dialect) -> tuple[str, dict[str, Any]]:
    """The kind of the file, and its counts."""
    census = Census(dialect)
    with opened_log(file, dialect) as log:
        for entry in log.entries():
            census.add(entry)
    return KIND_NAMES[log.kind], census.as_dict(log.faults)


def _print_summary(file: Path, kind: str, answer: dict[str, Any]) -> None:
    # the file as a whole
    duration = "" if answer["duration_s"] is None else f", {answer['duration_s']:.1f} s"
    say(f"{file.name}: {kind}, {answer['records']} records{duration}")
    counts = f"{answer['ok']} good, {answer['bad_crc']} with a wrong CRC, {answer['unknown']} with an unknown id"
    print_lines([f"{counts}, {answer['skipped_bytes']} bytes skipped", *_remarks(answer), ""])
    # its vehicles
    screen = console()
    columns = ("vehicle", "autopilot", "type", "heard, s", "armed", "lost", "modes")
    if answer["vehicles"]:
        rows = [_vehicle_row(v) for v in answer["vehicles"][:MOST_ROWS]]
        screen.print(table(columns, rows, right=("lost",), wrap=("modes",)))
        _print_more(len(answer["vehicles"]))
    else:
        say("no vehicle")
    # its sources and messages
    for title, frames in (("source", answer["sources"]), ("message", answer["types"])):
        say("")
        rows = [(name, str(count)) for name, count in list(frames.items())[:MOST_ROWS]]
        screen.print(table((title, "frames"), rows, right=("frames",)))
        _print_more(len(frames))


def _vehicle_row(v: dict[str, Any]) -> tuple[str, ...]:
    heard = "" if v["first_s"] is None else f"{v['first_s']:.1f} to {v['last_s']:.1f}"
    armed, lost = "yes" if v["armed"] else "no", f"{100 * v['loss_ratio']:.1f} %"
    return (f"{v['sysid']}/{v['compid']}", v["autopilot"], v["type"], heard, armed, lost, ", ".join(v["modes"]))


def _print_more(rows: int) -> None:
    if rows > MOST_ROWS:
        say(f"  and {rows - MOST_ROWS:,} more; --json has all")


def _remarks(answer: dict[str, Any]) -> list[str]:
    """Return what is unusual, a line each."""
    lines = []
    if answer["signed"]:
        lines.append(f"{answer['signed']} signed frames (the signatures are not checked)")
    if answer["backwards"]:
        lines.append(f"the time goes backwards {answer['backwards']}×, by up to {_span(answer['most_backwards_s'])}")
    if answer["clock_steps"]:
        lines.append(f"the clock steps by more than a day {answer['clock_steps']}×")
    for v in answer["vehicles"]:
        others = ", ".join(f"{c['heartbeats']} of {c['autopilot']} {c['type']}" for c in v["conflicting"])
        if others:
            lines.append(f"conflicting heartbeats under {v['sysid']}/{v['compid']}: {others}")
    return lines


def _span(seconds: float) -> str:
    return f"{1000 * seconds:.3g} ms" if seconds < 1 else f"{seconds:.1f} s"


def add_to(app: typer.Typer) -> None:
    app.add_typer(tlog, name="tlog")
