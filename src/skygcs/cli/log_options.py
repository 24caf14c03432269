"""Options by which offline tools choose a part of a log, and what people type for them."""

from __future__ import annotations

import re
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:
    from skygcs.core.mavlink.dialect import Dialect
    from skygcs.tlog.selection import Selection, SourceFilter

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
    typer.Option("--fleet", metavar="TOML", help="A fleet file: whose names mean what.", show_default=False),
]
DialectName = Annotated[
    str | None,
    typer.Option("--dialect", metavar="NAME", help="Default: all of pymavlink's, and PX4's own.", show_default=False),
]
Force = Annotated[bool, typer.Option("--force", help="Overwrite what is there.")]

_MINUTES = re.compile(r"(?:(\d+):)?(\d+):(\d{2}(?:\.\d+)?)")
_SOURCE = re.compile(r"(\d{1,3})(?:/(\d{1,3}))?")
_RANGE = re.compile(r"(\d{1,3})-(\d{1,3})")


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
    """What the options say. Raises BadParameter, ConfigError for the fleet file."""
    from skygcs.tlog.selection import Selection

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
        raise typer.BadParameter("--from and --to: not a span of time")
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
            raise typer.BadParameter(f"--vehicle: {part!r} is no system id{known}")
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
        raise typer.BadParameter(f"--vehicle: {text} is no id: they go up to 255")
    return int(text)
