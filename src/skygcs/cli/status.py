"""Commands that show: status, watch, events, and the interface itself."""

from __future__ import annotations

import asyncio
import json
import sys
from collections.abc import AsyncIterator, Callable, Sequence
from typing import TYPE_CHECKING, Annotated, Any

import typer

from skygcs.cli import completion, render
from skygcs.cli.connection import Exit, fail, run, waiting
from skygcs.cli.options import Json, OptionalTargets
from skygcs.cli.parsing import finite, parse_json
from skygcs.cli.render import State
from skygcs.rpc.client import EVENT_KINDS, Client

if TYPE_CHECKING:
    from rich.console import RenderableType

SCREEN_HZ = 4.0
"""How often a live table is drawn anew."""

OUTCOME_KEYS = ("outcome", "outcomes", "lists")
"""Under which answers of methods tell how it went."""


def status(targets: OptionalTargets = "all", json_output: Json = False) -> None:
    """Show every vehicle, or some."""

    async def command(gcs: Client) -> None:
        states = await gcs.vehicles(targets)
        if json_output:
            typer.echo(json.dumps(states, indent=2))
        elif states:
            screen = render.console()
            screen.print(render.status_table(states, width=screen.width))
        else:
            typer.echo("no vehicle heard yet (skygcs-cli links shows what arrives)")
        if left := (await gcs.call("daemon.info")).get("to_undo"):
            fail(f"{left} change{'s' if left > 1 else ''} in vehicles not undone: skygcs-cli undo list")

    run(command)


def components(json_output: Json = False) -> None:
    """Show every component that was heard: autopilots, companions, cameras, gimbals, ground stations."""

    async def command(gcs: Client) -> None:
        heard = await gcs.call("components.list")
        if json_output:
            typer.echo(json.dumps(heard, indent=2))
        elif heard:
            render.console().print(render.components_table(heard))
        else:
            typer.echo("nothing heard yet (skygcs-cli links shows what arrives)")

    run(command)


def watch(
    targets: OptionalTargets = "all",
    rate_hz: Annotated[
        float, typer.Option("--rate", metavar="HZ", help="Updates per second, at most 20.", parser=finite)
    ] = 2.0,
    fields: Annotated[
        str,
        typer.Option(
            "--fields", "--telemetry", metavar="F,F,…", help="Only these: position.alt_rel_m,battery.volts, …"
        ),
    ] = "",
    count: Annotated[int, typer.Option("--count", metavar="N", help="End after so many updates.", min=1)] = sys.maxsize,
    json_output: Json = False,
) -> None:
    """Show vehicles as they change, until Ctrl-C. On a pipe or with --json: one line per update."""
    wanted = [f.strip() for f in fields.split(",") if f.strip()]
    sections = sorted({f.split(".")[0] for f in wanted} | {"connected"}) if wanted else None

    async def command(gcs: Client) -> None:
        updates = gcs.telemetry(targets, rate_hz=rate_hz, sections=sections)
        if json_output or not sys.stdout.isatty():
            seen = 0
            async for state in updates:
                typer.echo(json.dumps(state) if json_output else _line(state, wanted))
                seen += 1
                if seen >= count:
                    return
        else:
            await live(updates, lambda states, width: render.status_table(states, wanted, width), count)

    run(command)


async def live(updates: AsyncIterator[State], draw: Callable[[list[State], int], RenderableType], count: int) -> None:
    """A table on the terminal that follows the updates until there were ``count``.

    ``draw(states, columns)`` gets the newest state of every vehicle, by system id.
    """
    from rich.live import Live

    states: dict[str, State] = {}
    seen = 0
    screen = render.console()
    with Live("waiting for vehicles …", console=screen, auto_refresh=False, vertical_overflow="crop") as shown:
        drawn_at = 0.0
        loop_time = asyncio.get_running_loop().time
        async for state in updates:
            states[str(state["name"])] = state
            seen += 1
            if loop_time() - drawn_at >= 1 / SCREEN_HZ or seen >= count or len(states) == seen:
                drawn_at = loop_time()
                ordered = sorted(states.values(), key=lambda s: int(s["sysid"]))
                shown.update(draw(ordered, screen.width), refresh=True)
            if seen >= count:
                return


def _line(state: dict[str, Any], fields: Sequence[str]) -> str:
    if fields:
        return f"{state['name']} " + " ".join(f"{f}={render.field_text(state, f)}" for f in fields)
    return "  ".join(cell for cell in render.status_cells(state) if cell)


def events(
    follow: Annotated[bool, typer.Option("--follow", "-f", help="Go on with what happens, until Ctrl-C.")] = False,
    limit: Annotated[int, typer.Option("--limit", "-n", metavar="N", help="So many past ones.", min=0)] = 20,
    kind: Annotated[
        list[str] | None, typer.Option("--kind", metavar="KIND", help="Only these kinds (may be repeated).")
    ] = None,
    json_output: Json = False,
) -> None:
    """Show what happened: found and lost vehicles, arming, modes, texts, links."""

    unknown = [k for k in kind or () if k not in EVENT_KINDS]
    if unknown:
        raise typer.BadParameter(f"--kind: no kind {', '.join(unknown)}; there are: {', '.join(EVENT_KINDS)}")

    def show(event: dict[str, Any]) -> None:
        typer.echo(json.dumps(event) if json_output else render.event_line(event))

    async def command(gcs: Client) -> None:
        news = gcs.events(kinds=kind) if follow else None
        if limit:
            past = await gcs.call("events.recent", limit=10000 if kind else limit)
            wanted = [e for e in past if not kind or e["kind"] in kind][-limit:]
            for event in wanted:
                show(event)
            if not (wanted or follow or json_output):
                typer.echo(f"no event of kind {', '.join(kind)} yet" if kind else "no event yet")
        if news is not None:
            async for event in news:
                show(event)
                sys.stdout.flush()

    run(command)


def call(
    method: Annotated[str, typer.Argument(metavar="METHOD", autocompletion=completion.methods, help="Any RPC method.")],
    params: Annotated[str, typer.Argument(metavar="[JSON]", help="Its parameters, an object.")] = "{}",
    _json: Annotated[bool, typer.Option("--json", help="It is JSON anyway.")] = False,
) -> None:
    """Call any method and print the result as JSON; `discover` lists them."""
    try:
        given = parse_json(params)
    except ValueError as error:
        raise typer.BadParameter(f"not JSON: {error}") from None
    if not isinstance(given, dict):
        raise typer.BadParameter('parameters are a JSON object: {"targets": "all"}')

    async def command(gcs: Client) -> int:
        async with waiting(method):
            result = await gcs.call(method, **given)
        typer.echo(json.dumps(result, indent=2))
        told = [result.get(key, {}) for key in OUTCOME_KEYS] if isinstance(result, dict) else []
        return Exit.DONE if all(_is_good(outcome) for outcome in told) else Exit.FAILED

    run(command)


def _is_good(told: dict[str, Any]) -> bool:
    """Of an outcome, or of outcomes by vehicle, or (parameters) by vehicle and name."""
    return bool(told["ok"]) if "ok" in told else all(_is_good(outcome) for outcome in told.values())


def discover(json_output: Json = False) -> None:
    """List the RPC methods; --json gives the OpenRPC document."""

    async def command(gcs: Client) -> None:
        document = await gcs.call("rpc.discover")
        if json_output:
            typer.echo(json.dumps(document, indent=2))
            return
        for method in document["methods"]:
            params = ", ".join(p["name"] if p["required"] else f"[{p['name']}]" for p in method["params"])
            typer.echo(f"{method['name']:<20} {params}")
            typer.echo(f"{'':<20} {method['summary']}")

    run(command)


def info(json_output: Json = False) -> None:
    """Show the daemon itself: version, ids, dialect, recorder."""

    async def command(gcs: Client) -> None:
        answer = {"daemon": await gcs.call("daemon.info"), "recorder": await gcs.call("recorder.status")}
        if json_output:
            typer.echo(json.dumps(answer, indent=2))
            return
        rows = [(f"{section}.{key}", value) for section, values in answer.items() for key, value in values.items()]
        width = max(len(key) for key, _ in rows)
        for key, value in rows:
            typer.echo(f"{key:<{width}}  {render.plain(value)}")

    run(command)


def add_to(app: typer.Typer) -> None:
    looking: tuple[Callable[..., None], ...] = (status, components, watch, events, info)
    for function in looking:
        app.command(rich_help_panel="Looking")(function)
    programming: tuple[Callable[..., None], ...] = (call, discover)
    for function in programming:
        app.command(rich_help_panel="Programming")(function)
