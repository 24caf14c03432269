"""`skygcs-cli trajectory`: load timed trajectories from files, and fly them."""

from __future__ import annotations

import asyncio
import json
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Annotated, Any

import typer

from skygcs.cli.connection import print_outcomes, run, run_order, run_show
from skygcs.cli.options import Json, OptionalTargets, OrderJson, Targets
from skygcs.cli.parsing import finite, within
from skygcs.cli.plan_reading import read_files
from skygcs.core.plan.fleet_plan import TimedPlan
from skygcs.core.plan.plan_files import ReadPlan
from skygcs.core.trajectory import MotionLimits, Trajectory
from skygcs.core.trajectory.trajectory_clock import MAX_SPEED_FACTOR, MIN_SPEED_FACTOR
from skygcs.errors import PlanFileError
from skygcs.ext.plans.commands.plan_inputs import origin_of_fleet, print_notes
from skygcs.rpc.client import Client

app = typer.Typer(help="Load timed trajectories and fly them on one clock.", no_args_is_help=True)

LARGEST_REQUEST = 1_000_000
"""Bytes; the daemon's limit of a line is 1 MiB."""

LATEST_START_S = 3600.0

State = Mapping[str, Any]


@app.command("load")
def load(
    file: Annotated[
        Path,
        typer.Argument(metavar="FILE", help="skygcs plan (.json), .csv, .plan, or show (.skyc).", show_default=False),
    ],
    targets: OptionalTargets = "all",
    json_output: Json = False,
) -> None:
    """Load the trajectories of a file: `trajectory load circle.csv alpha`. Nothing moves yet.

    A file of one trajectory is for the one vehicle named here, whatever its name there; a file of several is for the
    vehicles of those names, as far as TARGETS names them. CSV: vehicle,t,x,y,z,yaw, of which vehicle and yaw may be
    missing; metres of the fleet's frame, degrees counter-clockwise from x.

    Example: skygcs-cli trajectory load figure8.csv alpha
    """

    async def command(gcs: Client) -> int:
        # read the file
        origin = await origin_of_fleet(gcs, [file])
        found = await asyncio.to_thread(read_files, [file], MotionLimits(), origin)
        print_notes(found)
        plan = _timed(file, found)
        # choose a vehicle for each trajectory
        names = [state["name"] for state in await gcs.vehicles(targets)]
        chosen = _chosen(file, plan, names, targets)
        # load one after the other; a request has a limit
        outcomes: dict[str, Any] = {}
        for name, trajectory in chosen.items():
            pieces = [
                {"duration_s": p.duration_s, "x": p.east, "y": p.north, "up": p.up, "yaw": p.yaw}
                for p in trajectory.pieces
            ]
            size = len(json.dumps(pieces))
            if size > LARGEST_REQUEST:
                why = f"{name} has {len(pieces)} pieces, {size:,} bytes as a request; the most is {LARGEST_REQUEST:,}"
                raise PlanFileError(str(file), "", why)
            answer = await gcs.call("trajectory.load", target=name, pieces=pieces, name=file.stem[:64])
            outcomes.update(answer["outcomes"])
        return print_outcomes(outcomes, json_output)

    run(command)


def _timed(file: Path, found: ReadPlan) -> TimedPlan:
    """Raises PlanFileError."""
    if not isinstance(found.plan, TimedPlan):
        raise PlanFileError(str(file), "", "it has phases and no times: only a timed plan is a trajectory")
    return found.plan


def _chosen(file: Path, plan: TimedPlan, names: list[str], targets: str) -> dict[str, Trajectory]:
    """The trajectory of each vehicle. Raises PlanFileError."""
    found = dict(plan.trajectories)
    if len(found) == 1 and len(names) == 1:
        return {names[0]: next(iter(found.values()))}
    chosen = {name: found[name] for name in names if name in found}
    if not chosen:
        there = ", ".join(list(found)[:10])
        raise PlanFileError(str(file), "", f"it is for {there}; none of them is among {targets}")
    return chosen


@app.command("start")
def start(
    targets: Targets,
    after_s: Annotated[
        float | None,
        typer.Option("--in", metavar="S", help="Seconds from now. [default: 1]", parser=finite),
    ] = None,
    at_s: Annotated[
        float | None,
        typer.Option("--at", metavar="S", help="Time of the daemon's clock, see `trajectory status`.", parser=finite),
    ] = None,
    speed: Annotated[
        float, typer.Option("--speed", metavar="FACTOR", help="Multiple of the planned speed.", parser=finite)
    ] = 1.0,
    force: Annotated[bool, typer.Option("--force", help="Although one comes too close to another vehicle.")] = False,
    json_output: OrderJson = None,
) -> None:
    """Start vehicles on their trajectories, on one clock: all of them or none.

    Each must be under `control`, near its first point, its whole trajectory within fence and limits, and away from all
    other vehicles as they move now.

    Example: skygcs-cli trajectory start all --in 10
    """
    if after_s is not None and at_s is not None:
        raise typer.BadParameter("give --in or --at, not both")
    within("--in", after_s, 0.0, LATEST_START_S)
    within("--speed", speed, MIN_SPEED_FACTOR, MAX_SPEED_FACTOR)
    params = {key: value for key, value in (("after_s", after_s), ("at_s", at_s)) if value is not None}
    run_order("trajectory.start", json_output, targets=targets, speed=speed, force=force, **params)


@app.command("pause")
def pause(targets: Targets, json_output: OrderJson = None) -> None:
    """Stop vehicles smoothly on their paths, with all that started with them.

    Example: skygcs-cli trajectory pause all
    """
    run_order("trajectory.pause", json_output, targets=targets)


@app.command("resume")
def resume(targets: Targets, json_output: OrderJson = None) -> None:
    """Let paused vehicles go on, with all that started with them.

    Example: skygcs-cli trajectory resume all
    """
    run_order("trajectory.resume", json_output, targets=targets)


@app.command("speed")
def speed_(
    targets: Targets,
    factor: Annotated[float, typer.Argument(metavar="FACTOR", help="Multiple of the planned speed.", parser=finite)],
    json_output: OrderJson = None,
) -> None:
    """Fly faster or slower, with all that started with them.

    Example: skygcs-cli trajectory speed all 0.5
    """
    within("FACTOR", factor, MIN_SPEED_FACTOR, MAX_SPEED_FACTOR)
    run_order("trajectory.speed", json_output, targets=targets, speed=factor)


@app.command("abort")
def abort(targets: Targets, json_output: OrderJson = None) -> None:
    """Stop vehicles smoothly on their paths for good; they stay there under control.

    Example: skygcs-cli trajectory abort all
    """
    run_order("trajectory.abort", json_output, targets=targets)


@app.command("unload")
def unload(targets: Targets, json_output: OrderJson = None) -> None:
    """Forget loaded trajectories.

    Example: skygcs-cli trajectory unload all
    """
    run_order("trajectory.unload", json_output, targets=targets)


@app.command("status")
def status(targets: OptionalTargets = "all", json_output: Json = False) -> None:
    """Show what is loaded and flown.

    Example: skygcs-cli trajectory status
    """
    run_show("trajectory.status", json_output, status_lines, targets=targets)


def status_lines(answer: State) -> Iterator[str]:
    """One line a vehicle."""
    if not answer["trajectories"]:
        yield "no trajectory is loaded"
    for one in answer["trajectories"]:
        flight = one["flight"]
        line = f"{one['vehicle']}  {one['name']}  {one['pieces']} pieces  {one['duration_s']:.1f} s"
        if flight is None:
            x, y, up = one["start_enu_m"]
            yield f"{line}  loaded, begins at {x:.1f} {y:.1f} {up:.1f}"
            continue
        line += f"  {flight['state']} at {flight['trajectory_s']:.1f} s, {flight['speed_factor']:g} times the speed"
        if flight["finishes_in_s"] is not None:
            line += f", ends in {flight['finishes_in_s']:.1f} s"
        if one["left"]:
            line += f"; left: {', '.join(one['left'])}"
        yield line
    yield f"clock of the daemon: {answer['now_s']:.3f} s"


def add_to(app_: typer.Typer) -> None:
    app_.add_typer(app, name="trajectory")
