"""`skygcs-cli mission …`: plan files checked and converted, without a daemon.

Options are here; what is computed and shown is imported when it is asked for.
"""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from skygcs.cli.connection import run_offline
from skygcs.cli.options import Json
from skygcs.cli.parsing import finite, parse_number

if TYPE_CHECKING:
    from skygcs.core.mission.firmware_items import Family

missions = typer.Typer(
    help="Missions, fences and rally points: plan files of QGroundControl and Mission Planner.", no_args_is_help=True
)


class AutopilotName(StrEnum):
    PX4 = "px4"
    ARDUPILOT = "ardupilot"


class ListName(StrEnum):
    """MAV_MISSION_TYPE in words."""

    MISSION = "mission"
    FENCE = "fence"
    RALLY = "rally"


PlanFile = Annotated[
    Path, typer.Argument(metavar="FILE", help="A .plan, .waypoints, .txt or .mission file.", show_default=False)
]


@missions.command("check")
def _check(
    file: PlanFile,
    autopilot: Annotated[
        AutopilotName | None, typer.Option("--autopilot", help="Who will fly it. [default: either]", show_default=False)
    ] = None,
    max_height_m: Annotated[
        float, typer.Option("--max-height", metavar="M", parser=finite, help="Above home.")
    ] = 500.0,
    max_distance_m: Annotated[
        float, typer.Option("--max-distance", metavar="M", parser=finite, help="From the vehicle, else from home.")
    ] = 1000.0,
    max_items: Annotated[
        int | None, typer.Option("--max-items", min=1, metavar="N", help="What the vehicle can hold.")
    ] = None,
    vehicle: Annotated[
        str | None, typer.Option("--vehicle", metavar="LAT,LON", help="Where the vehicle stands.")
    ] = None,
    dialect: Annotated[
        str | None, typer.Option("--dialect", metavar="NAME", help="Whose commands are known. [default: the daemon's]")
    ] = None,
    json_output: Json = False,
) -> None:
    """Say what a plan file holds, and everything that is wrong with it, by item."""
    place = None if vehicle is None else _place("--vehicle", vehicle)

    def command() -> int:
        from skygcs.cli.mission_files import check_file
        from skygcs.core.mission.check import CheckLimits

        limits = CheckLimits(max_height_m, max_distance_m, max_items)
        return check_file(file, limits, _family(autopilot), place, dialect, json_output)

    run_offline(command)


@missions.command("convert")
def _convert(
    file: PlanFile,
    out: Annotated[
        Path, typer.Argument(metavar="OUT", help="Ends in .plan, or in .waypoints, .txt or .mission (QGC WPL 110).")
    ],
    only: Annotated[
        ListName | None, typer.Option("--only", help="One of the lists; WPL holds no more.", show_default=False)
    ] = None,
    autopilot: Annotated[
        AutopilotName | None,
        typer.Option("--autopilot", help="As this one takes it, as an upload does.", show_default=False),
    ] = None,
    force: Annotated[bool, typer.Option("--force", help="Overwrite OUT.")] = False,
) -> None:
    """Write a plan in the other format. Surveys and scans become their single items."""

    def command() -> int:
        from skygcs.cli.mission_files import convert_file

        return convert_file(file, out, None if only is None else only.value, force, _family(autopilot))

    run_offline(command)


def _family(autopilot: AutopilotName | None) -> Family | None:
    families: dict[AutopilotName | None, Family] = {AutopilotName.PX4: "px4", AutopilotName.ARDUPILOT: "ardupilot"}
    return families.get(autopilot)


def _place(option: str, text: str) -> tuple[float, float]:
    parts = [part.strip() for part in text.split(",")]
    if len(parts) != 2:
        raise typer.BadParameter(f"{option}: {text!r} is not LAT,LON")
    lat, lon = (parse_number(part, option) for part in parts)
    if not (abs(lat) <= 90 and abs(lon) <= 180):
        raise typer.BadParameter(f"{option}: {text!r} is no place on earth")
    return lat, lon
