"""`skygcs-cli origin`: the origin of the fleet's world frame."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Annotated, Any

import typer

from skygcs.cli.connection import run, run_order, run_show, show
from skygcs.cli.options import Json, OneVehicle, OrderJson, Targets
from skygcs.cli.parsing import NUMBERS, NumbersCommand, finite
from skygcs.core.vehicle.state import AIRBORNE
from skygcs.rpc.client import Client

app = typer.Typer(
    help="Show or set the origin of the frame in which positions are given; this moves no vehicle.",
    invoke_without_command=True,
)

EAST_DEG = 90.0
"""Default compass heading of the x axis."""

Heading = Annotated[
    float | None,
    typer.Option(
        "--heading",
        metavar="DEG",
        help="Compass heading of the x axis; 90 is east. [default: unchanged]",
        parser=finite,
    ),
]


@app.callback()
def _origin_default(ctx: typer.Context, json_output: Json = False) -> None:
    if ctx.invoked_subcommand is None:
        _ask("origin.get", json_output)


@app.command("get")
def get(json_output: Json = False) -> None:
    """Show the origin (as `origin` alone).

    Example: skygcs-cli origin get
    """
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
    """Set the origin. Coordinates change, no vehicle moves.

    Example: skygcs-cli origin set 43.7806 -79.4653 180 --heading 30
    """
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
    vehicle: OneVehicle,
    heading: Annotated[bool, typer.Option("--heading", help="Point the x axis along its nose.")] = False,
    force: Annotated[bool, typer.Option("--force", help="Without a 3D fix, or far from other vehicles.")] = False,
    json_output: Json = False,
) -> None:
    """Set the origin to the present position of a vehicle.

    Example: skygcs-cli origin from alpha
    """

    async def command(gcs: Client) -> None:
        status = await gcs.call("origin.from_vehicle", target=vehicle, heading=heading, force=force)
        state = await gcs.call("vehicles.get", target=vehicle)
        show(status, json_output, lambda _: (_line(status), *zero_in_the_air(status["origin"], state)))

    run(command)


@app.command("push")
def push(
    targets: Targets,
    home: Annotated[
        bool, typer.Option("--home", help="Set their homes there, too: all of them would return to that place.")
    ] = False,
    force: Annotated[
        bool, typer.Option("--force", help="Although vehicles are armed, or the home would be in the air or far away.")
    ] = False,
    json_output: OrderJson = None,
) -> None:
    """Send the origin to vehicles for their own local frame, which programs on board use; skygcs does not need it.

    ArduPilot accepts it only while it has no origin.

    Example: skygcs-cli origin push all
    """
    run_order("origin.push", json_output, targets=targets, home=home, force=force)


def _ask(method: str, json_output: bool, *, kept_heading: bool = False, **params: Any) -> None:
    """``kept_heading``: if the x axis keeps a heading other than east, print how to change it."""

    def lines(status: Mapping[str, Any]) -> Iterator[str]:
        yield _line(status)
        origin = status["origin"]
        if kept_heading and origin is not None and origin["x_heading_deg"] != EAST_DEG:
            yield (
                f"the x axis keeps its heading of {origin['x_heading_deg']:.1f}°; "
                f"--heading {EAST_DEG:g} turns it to the east"
            )

    run_show(method, json_output, lines, **params)


def zero_in_the_air(origin: Mapping[str, Any], state: Mapping[str, Any]) -> Iterator[str]:
    """The altitude of zero, if the vehicle that gave the origin flies: "up" then counts from there, not the ground."""
    if state["landed"] not in AIRBORNE:
        return
    position = state["position"]
    over_home = "" if position is None else f", {position['alt_rel_m']:.1f} m above its home"
    yield (
        f"up is 0 where {state['name']} flies: {origin['alt_amsl_m']:.1f} m above sea level{over_home}; "
        "heights near the ground are negative"
    )


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


def add_to(app_: typer.Typer) -> None:
    app_.add_typer(app, name="origin")
