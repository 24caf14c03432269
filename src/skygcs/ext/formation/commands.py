"""`skygcs-cli formation`: live formations about a leader."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Annotated, Any

import typer

from skygcs.cli.connection import run_show
from skygcs.cli.options import Json, Targets
from skygcs.cli.parsing import NUMBERS, NumbersCommand, finite, parse_number
from skygcs.cli.render import fixed

app = typer.Typer(help="Fly several vehicles as a formation about a leader.", no_args_is_help=True)

SHAPES = ("current", "line", "column", "v", "circle", "grid")

Heading = Annotated[float, typer.Argument(metavar="DEG", help="Counter-clockwise from the frame's x axis.")]


@app.command("start")
def start(
    targets: Targets,
    shape: Annotated[
        str, typer.Option("--shape", metavar="SHAPE", help=f"{', '.join(SHAPES)}; current: as they are.")
    ] = "current",
    spacing: Annotated[
        float, typer.Option("--spacing", metavar="M", help="Between neighbours of a shape.", parser=finite)
    ] = 8.0,
    heading: Annotated[
        float | None,
        typer.Option("--heading", metavar="DEG", help="Counter-clockwise from the frame's x axis.", parser=finite),
    ] = None,
    leader: Annotated[
        str | None, typer.Option("--leader", metavar="VEHICLE", help="It leads; default: a virtual point.")
    ] = None,
    at: Annotated[
        str | None, typer.Option("--at", metavar="X,Y,UP", help="Where its middle is to be; default: where they are.")
    ] = None,
    json_output: Json = False,
) -> None:
    """Take vehicles under control and fly to the formation. While it flies: give it another shape.

    Example: skygcs-cli formation start alpha,bravo,charlie --shape v --spacing 8
    """
    if shape not in SHAPES:
        raise typer.BadParameter(f"{shape}: one of {', '.join(SHAPES)}", param_hint="--shape")
    params: dict[str, Any] = {"targets": targets, "shape": shape, "spacing_m": spacing}
    params |= {} if heading is None else {"heading_deg": heading}
    params |= {} if leader is None else {"leader": leader}
    params |= {} if at is None else {"at_enu_m": _vector(at, "--at")}
    run_show("formation.start", json_output, status_lines, **params)


@app.command("move", cls=NumbersCommand, context_settings=NUMBERS)
def move(
    to: Annotated[str | None, typer.Argument(metavar="X,Y,UP", help="Metres in the fleet's frame.")] = None,
    velocity: Annotated[
        str | None, typer.Option("--vel", metavar="X,Y,UP", help="Fly with this velocity instead, in m/s.")
    ] = None,
    speed: Annotated[float | None, typer.Option("--speed", metavar="MPS", help="To the place.", parser=finite)] = None,
    seconds: Annotated[
        float, typer.Option("--for", metavar="S", help="A velocity ends by itself after S seconds.", parser=finite)
    ] = 10.0,
    json_output: Json = False,
) -> None:
    """Send the virtual leader to a place or along a velocity; without either it stays.

    Example: skygcs-cli formation move 20,30,12 --speed 1.5
    """
    if to is not None and velocity is not None:
        raise typer.BadParameter("give a place or --vel, not both")
    params: dict[str, Any] = {}
    if to is not None:
        params = {"to_enu_m": _vector(to, "X,Y,UP")} | ({} if speed is None else {"speed_mps": speed})
    if velocity is not None:
        params = {"vel_enu_mps": _vector(velocity, "--vel"), "valid_s": seconds}
    run_show("formation.move", json_output, status_lines, **params)


@app.command("turn", cls=NumbersCommand, context_settings=NUMBERS)
def turn(heading: Heading, json_output: Json = False) -> None:
    """Turn the formation about its leader, the shorter way round.

    Example: skygcs-cli formation turn 90
    """
    run_show("formation.turn", json_output, status_lines, heading_deg=heading)


@app.command("scale")
def scale(
    factor: Annotated[float, typer.Argument(metavar="FACTOR", help="Of the offsets at the start.")],
    json_output: Json = False,
) -> None:
    """Make the formation larger or smaller.

    Example: skygcs-cli formation scale 1.5
    """
    run_show("formation.scale", json_output, status_lines, factor=factor)


@app.command("stop")
def stop(json_output: Json = False) -> None:
    """Brake all; they stay under control, and hold their places.

    Example: skygcs-cli formation stop
    """
    run_show("formation.stop", json_output, status_lines)


@app.command("status")
def status(json_output: Json = False) -> None:
    """Show the leader, how far each member is from its place, and the least distance of two.

    Example: skygcs-cli formation status
    """
    run_show("formation.status", json_output, status_lines)


def status_lines(state: Mapping[str, Any]) -> Iterator[str]:
    """A formation for a person."""
    if state["state"] == "none":
        yield "no formation flies"
        return
    why = f": {state['reason']}" if state["reason"] else ""
    yield f"{state['state']}{why}"
    yield (
        f"leader {state['leader']} at {_shown(state['middle_enu_m'])} m  velocity {_shown(state['vel_enu_mps'])} m/s  "
        f"heading {state['heading_deg']:.0f} deg  scale {state['scale']:g}"
    )
    width = max(len(member["vehicle"]) for member in state["members"])
    for member in state["members"]:
        note = f"left: {member['left']}" if member["left"] else "another is in its way" if member["hindered"] else ""
        off = "not seen" if member["off_place_m"] is None else f"{fixed(member['off_place_m'], 1):>5} m off"
        yield f"  {member['vehicle']:{width}}  {off}  place {_shown(member['place_enu_m'])}  {note}".rstrip()
    if state["rms_m"] is not None:
        pair = "" if state["least_m"] is None else f", least distance {state['least_m']:.1f} m"
        yield f"{state['rms_m']:.1f} m off in the mean (RMS){pair}" + (
            f" ({' and '.join(state['least_pair'])})" if state["least_pair"] else ""
        )


def _shown(vector: list[float]) -> str:
    return ", ".join(f"{value:.1f}" for value in vector)


def _vector(text: str, option: str) -> list[float]:
    """ "X,Y,UP" as three numbers. Raises BadParameter."""
    parts = text.split(",")
    if len(parts) != 3:
        raise typer.BadParameter(f"{option}: {text!r} is not of the form X,Y,UP")
    return [parse_number(part, option) for part in parts]


def add_to(main: typer.Typer) -> None:
    """Add the commands to the program."""
    main.add_typer(app, name="formation")
