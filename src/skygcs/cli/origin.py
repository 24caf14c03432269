"""`skygcs-cli origin`: the fleet's world frame."""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import Annotated, Any

import typer

from skygcs.cli.connection import run, waiting
from skygcs.cli.options import Json, Targets
from skygcs.cli.orders import tell_outcomes
from skygcs.cli.parsing import NUMBERS, NumbersCommand, finite
from skygcs.rpc.client import Client

app = typer.Typer(
    help="Show or set the origin of the frame that all positions are told in; no vehicle moves by that.",
    invoke_without_command=True,
)

EAST_DEG = 90.0
"""Compass heading of the x axis unless said otherwise."""

Heading = Annotated[
    float | None,
    typer.Option(
        "--heading",
        metavar="DEG",
        help="Compass heading of the x axis; 90 is east. Default: as it is.",
        parser=finite,
    ),
]


@app.callback()
def origin(ctx: typer.Context, json_output: Json = False) -> None:
    if ctx.invoked_subcommand is None:
        _ask("origin.get", json_output)


@app.command("get")
def get(json_output: Json = False) -> None:
    """Show the origin (as `origin` alone)."""
    _ask("origin.get", json_output)


@app.command("set", cls=NumbersCommand, context_settings=dict(NUMBERS))
def set_(
    lat: Annotated[float, typer.Argument(metavar="LAT", help="Degrees.", parser=finite)],
    lon: Annotated[float, typer.Argument(metavar="LON", help="Degrees.", parser=finite)],
    alt: Annotated[float, typer.Argument(metavar="ALT", help="Metres above mean sea level.", parser=finite)],
    heading: Heading = None,
    force: Annotated[bool, typer.Option("--force", help="Although a vehicle is farther than 20 km from it.")] = False,
    json_output: Json = False,
) -> None:
    """Set the origin: `origin set 43.7806 -79.4653 180 --heading 30`. All positions are told anew, no vehicle moves."""
    _ask(
        "origin.set",
        json_output,
        kept_heading=heading is None,
        lat_deg=lat,
        lon_deg=lon,
        alt_amsl_m=alt,
        x_heading_deg=heading,
        force=force,
    )


@app.command("from")
def from_(
    vehicle: Annotated[str, typer.Argument(metavar="VEHICLE", help="Its name or system id.")],
    heading: Annotated[bool, typer.Option("--heading", help="Point x along its nose.")] = False,
    force: Annotated[bool, typer.Option("--force", help="Without a 3D fix, or far from other vehicles.")] = False,
    json_output: Json = False,
) -> None:
    """Set the origin to where a vehicle is now."""
    _ask("origin.from_vehicle", json_output, target=vehicle, heading=heading, force=force)


@app.command("push")
def push(
    targets: Targets,
    home: Annotated[bool, typer.Option("--home", help="Set their homes there, too: all return to that place.")] = False,
    force: Annotated[bool, typer.Option("--force", help="Although armed; a home in the air or far away, too.")] = False,
    json_output: Json = False,
) -> None:
    """Tell vehicles the origin as that of their own local frame, for programs on board; skygcs does not need it.

    ArduPilot takes it only while it has none.
    """

    async def command(gcs: Client) -> int:
        async with waiting(f"origin push {targets}"):
            answer = await gcs.call("origin.push", targets=targets, home=home, force=force)
        return tell_outcomes(answer["outcomes"], json_output)

    run(command)


def _ask(method: str, json_output: bool, *, kept_heading: bool = False, **params: Any) -> None:
    async def command(gcs: Client) -> None:
        status = await gcs.call(method, **params)
        typer.echo(json.dumps(status, indent=2) if json_output else _line(status))
        origin = status["origin"]
        if kept_heading and not json_output and origin is not None and origin["x_heading_deg"] != EAST_DEG:
            typer.echo(
                f"the x axis keeps its heading of {origin['x_heading_deg']:.1f}°; "
                f"--heading {EAST_DEG:g} turns it to the east"
            )

    run(command)


def _line(status: Mapping[str, Any]) -> str:
    origin = status["origin"]
    if origin is None:
        return "no origin: set one with `origin set LAT LON ALT` or `origin from VEHICLE`"
    heading_deg = origin["x_heading_deg"]
    axes = (
        "x east, y north"
        if heading_deg == EAST_DEG
        else f"x to {heading_deg:.1f}°, y to {(heading_deg - 90) % 360:.1f}°"
    )
    place = f"{origin['lat_deg']:.7f}, {origin['lon_deg']:.7f}, {origin['alt_amsl_m']:.2f} m above sea level"
    return f"{place}; {axes} (frame {status['generation']})"
