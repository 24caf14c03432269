"""`skygcs-cli track`: how well vehicles follow what they are told, live."""

from __future__ import annotations

import json
import sys
from typing import Annotated, Any

import typer

from skygcs.cli import render
from skygcs.cli.connection import run
from skygcs.cli.options import Json, OptionalTargets
from skygcs.cli.parsing import finite
from skygcs.cli.status import live
from skygcs.rpc.client import Client


def track(
    targets: OptionalTargets = "all",
    rate_hz: Annotated[
        float, typer.Option("--rate", metavar="HZ", help="Updates per second, at most 20.", parser=finite)
    ] = 4.0,
    once: Annotated[bool, typer.Option("--once", help="Show it once and end.")] = False,
    count: Annotated[int, typer.Option("--count", metavar="N", help="End after so many updates.", min=1)] = sys.maxsize,
    json_output: Json = False,
) -> None:
    """Show tracking error, delays and ticks of controlled vehicles, until Ctrl-C. On a pipe: one line per update."""

    async def command(gcs: Client) -> None:
        if once:
            _show(await gcs.vehicles(targets), json_output)
            return
        updates = gcs.telemetry(targets, rate_hz=rate_hz, sections=["control", "connected"])
        if json_output or not sys.stdout.isatty():
            await _lines(updates, count, json_output)
        else:
            from skygcs.cli.track_table import track_table

            await live(updates, track_table, count)

    run(command)


def _show(states: list[dict[str, Any]], json_output: bool) -> None:
    if json_output:
        for state in states:
            typer.echo(json.dumps({"name": state["name"], "sysid": state["sysid"], "control": state.get("control")}))
        return
    from skygcs.cli.track_table import track_table

    screen = render.console()
    screen.print(track_table(states, screen.width))


async def _lines(updates: Any, count: int, json_output: bool) -> None:
    from skygcs.cli.track_table import track_line

    seen = 0
    async for state in updates:
        typer.echo(json.dumps(state) if json_output else track_line(state))
        sys.stdout.flush()
        seen += 1
        if seen >= count:
            return


def add_to(app: typer.Typer) -> None:
    app.command(rich_help_panel="Looking")(track)
