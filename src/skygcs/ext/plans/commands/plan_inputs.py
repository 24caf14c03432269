"""Inputs of commands about plans: plan files, starts and goals, formations."""

from __future__ import annotations

import asyncio
from collections.abc import Iterable
from dataclasses import dataclass
from math import radians
from pathlib import Path
from typing import Annotated, Any

import typer

from skygcs.cli.parsing import finite
from skygcs.cli.plan_reading import bytes_of
from skygcs.cli.render import say
from skygcs.core.geo import Origin
from skygcs.core.plan.formations import CURRENT, POINTS, SHAPES, WantedFormation
from skygcs.core.plan.plan_files import ReadPlan
from skygcs.core.plan.plan_json import read_plan_json
from skygcs.core.plan.trajectory_csv import read_formation_csv, read_paths
from skygcs.core.trajectory.piecewise import Vector
from skygcs.errors import PlanFileError
from skygcs.ext.plans.commands.plan_options import vector
from skygcs.ext.plans.commands.table import read_table
from skygcs.ext.plans.flight.flight_steps import ends_of, starts_of
from skygcs.ext.plans.position_table import spots
from skygcs.rpc.client import Client

Files = Annotated[
    list[Path],
    typer.Argument(
        metavar="FILE…",
        help=".json, .skyc, .csv or .plan; Crazyswarm and QGroundControl have a file per vehicle, named by it "
        "(or NAME=FILE).",
        show_default=False,
    ),
]

MISSIONS = ".plan"

Places = dict[str, Vector]


async def origin_of_fleet(gcs: Client, files: Iterable[Path]) -> Origin | None:
    """The fleet's origin. Raises SkygcsError if it is not set and a file needs it to be placed."""
    known = (await gcs.call("origin.get"))["origin"]
    if known is not None:
        return Origin(**known)
    for file in files:
        if file.suffix.lower() == MISSIONS:
            todo = "the fleet has no origin yet: `skygcs-cli origin set` or `origin from`"
            raise PlanFileError(str(file), "", f"its positions are by latitude and longitude, and {todo}")
    return None


def print_notes(found: ReadPlan) -> None:
    """Print what was assumed or left out, on standard error."""
    if found.origin is not None and found.notes:
        at = found.origin
        place = f"{at.lat_deg:.7f}, {at.lon_deg:.7f}, {at.alt_amsl_m:.2f} m AMSL, x to {at.x_heading_deg:g}°"
        say(f"positions are about {place}: the fleet's origin, when they are flown", err=True)
    for note in found.notes:
        say(note, err=True)


# --- starts, goals and formations -------------------------------------------------------------------------------------


@dataclass(frozen=True)
class FormationOptions:
    """The goals as a formation."""

    formation: Annotated[
        str | None,
        typer.Option(
            "--formation",
            metavar="SHAPE|FILE",
            help=f"The goals: {', '.join(SHAPES)}; a .csv of points x,y,z; or {CURRENT}, where they are.",
        ),
    ] = None
    spacing: Annotated[
        float, typer.Option("--spacing", metavar="M", help="Between neighbours of a shape.", parser=finite)
    ] = 5.0
    at: Annotated[
        str | None,
        typer.Option(
            "--at", metavar="X,Y,Z", help="Middle of the formation; points and current keep theirs without it."
        ),
    ] = None
    heading: Annotated[
        float,
        typer.Option(
            "--yaw",
            metavar="DEG",
            help="A shape faces there, points are turned by it; counter-clockwise from x.",
            parser=finite,
        ),
    ] = 0.0
    scale: Annotated[
        float,
        typer.Option("--scale", metavar="FACTOR", help="Factor for all distances from the middle.", parser=finite),
    ] = 1.0

    @property
    def of_file(self) -> bool:
        return self.formation is not None and self.formation.lower().endswith(".csv")

    def require_valid(self) -> None:
        """Raises BadParameter."""
        if self.at is not None:
            vector("--at", self.at)
        if self.formation is None or self.of_file or self.formation == CURRENT:
            return
        if self.formation not in SHAPES:
            known = ", ".join((*SHAPES, CURRENT))
            raise typer.BadParameter(
                f"--formation: {self.formation!r} is neither one of {known} nor a .csv file of points"
            )
        if self.at is None:
            raise typer.BadParameter(f"--formation {self.formation} needs --at X,Y,Z")

    def wanted(self) -> WantedFormation | None:
        """None: the goals are not a formation. Raises SkygcsError for a file of points."""
        if self.formation is None:
            return None
        shape: str = self.formation
        points: tuple[Vector, ...] = ()
        if self.of_file:
            shape, points = POINTS, read_formation_csv(shape, bytes_of(Path(shape)))
        middle = None if self.at is None else vector("--at", self.at)
        return WantedFormation(shape, middle, radians(self.heading), self.scale, self.spacing, points)


def starts_and_goals(file: Path, *, one_is_enough: bool = False) -> tuple[Places, Places | None]:
    """Starts and goals; no goals where the file holds paths. ``one_is_enough``: a single place is a goal. Raises
    SkygcsError."""
    if file.suffix.lower() == MISSIONS or "=" in file.name:
        return {}, None
    if file.suffix.lower() == ".json":  # another plan between the places of one
        plan, _ = read_plan_json(str(file), bytes_of(file))
        return starts_of(plan), ends_of(plan)
    if file.suffix.lower() == ".toml" or any(column in bytes_of(file)[:4096] for column in (b"initial_x", b"final_x")):
        places = read_table(file)
        starts = {name: spot.position_m for name, spot in spots(places, "initial").items()}
        return starts, {name: spot.position_m for name, spot in spots(places, "final").items()}
    if file.suffix.lower() != ".csv":
        raise PlanFileError(str(file), "", "starts and goals are in a .csv or .toml")
    paths = read_paths(str(file), bytes_of(file))
    starts = {name: path.points[0] for name, path in paths.items()}
    counts = {len(path.points) for path in paths.values()}
    if any(path.times for path in paths.values()) or counts - {2, 1 if one_is_enough else 2}:
        return starts, None
    return starts, {name: path.points[-1] for name, path in paths.items()}


async def vehicles_of(gcs: Client, file: Path) -> list[str]:
    """The vehicles of a file, or of the fleet by target: `v1,v2` or a group. Raises SkygcsError."""
    if file.suffix:
        starts, _ = await asyncio.to_thread(starts_and_goals, file, one_is_enough=True)
        return list(starts)
    names: dict[str, Any] = {}
    for part in str(file).split(","):
        names |= dict.fromkeys(state["name"] for state in await gcs.vehicles(part.strip()))
    return list(names)
