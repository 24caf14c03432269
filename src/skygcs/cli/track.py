"""`skygcs-cli track`: how well vehicles follow what they are told, live."""

from __future__ import annotations

import asyncio
import json
import sys
from typing import Annotated, Any

import typer

from skygcs.cli import render
from skygcs.cli.connection import run
from skygcs.cli.options import Json, OptionalTargets
from skygcs.cli.reading import SCREEN_HZ
from skygcs.cli.values import finite
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
            await _live(updates, count)

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


async def _live(updates: Any, count: int) -> None:
    from rich.live import Live

    from skygcs.cli.track_table import track_table

    states: dict[str, dict[str, Any]] = {}
    seen = 0
    screen = render.console()
    with Live("waiting for vehicles …", console=screen, auto_refresh=False, vertical_overflow="crop") as live:
        drawn_at = 0.0
        loop_time = asyncio.get_running_loop().time
        async for state in updates:
            states[state["name"]] = state
            seen += 1
            if loop_time() - drawn_at >= 1 / SCREEN_HZ or seen >= count or len(states) == seen:
                drawn_at = loop_time()
                ordered = sorted(states.values(), key=lambda s: int(s["sysid"]))
                live.update(track_table(ordered, screen.width), refresh=True)
            if seen >= count:
                return


def add_to(app: typer.Typer) -> None:
    app.command(rich_help_panel="Looking")(track)
