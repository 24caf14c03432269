"""`skygcs-cli undo`: what was changed in vehicles for a while and could not be put back."""

from __future__ import annotations

import json
from typing import Annotated, Any

import typer

from skygcs.cli.connection import run, waiting
from skygcs.cli.options import Json
from skygcs.cli.orders import tell_outcomes
from skygcs.rpc.client import Client

app = typer.Typer(
    help="Put back what a fence test left changed in a vehicle when the daemon was killed or could not reach it.",
    no_args_is_help=True,
)

Id = Annotated[str, typer.Argument(metavar="ID|all", help="Of undo list.")]


@app.command("list")
def left(json_output: Json = False) -> None:
    """Show what waits to be undone; nothing is ever undone by itself."""

    async def command(gcs: Client) -> None:
        answer = await gcs.call("undo.list")
        typer.echo(json.dumps(answer, indent=2) if json_output else "\n".join(_lines(answer)))

    run(command)


@app.command("run")
def undo(
    id: Id,
    force: Annotated[
        bool, typer.Option("--force", help="Although it is armed, or somebody else has changed it since.")
    ] = False,
    json_output: Json = False,
) -> None:
    """Put back what it was, and read it back."""

    async def command(gcs: Client) -> int:
        outcomes: dict[str, Any] = {}
        for one in await _ids(gcs, id):
            async with waiting(f"undo {one}"):
                outcomes |= (await gcs.call("undo.run", id=one, force=force))["outcomes"]
        return tell_outcomes(outcomes, json_output)

    run(command)


@app.command("drop")
def drop(id: Id) -> None:
    """Forget it: what the vehicle holds stays."""

    async def command(gcs: Client) -> None:
        for one in await _ids(gcs, id):
            await gcs.call("undo.drop", id=one)
            typer.echo(f"{one} is not to be undone")

    run(command)


async def _ids(gcs: Client, id: str) -> list[str]:
    if id != "all":
        return [id]
    return [change["id"] for change in (await gcs.call("undo.list"))["changes"]]


def _lines(answer: dict[str, Any]) -> list[str]:
    lines = []
    for change in answer["changes"]:
        lines += [
            f"{change['id']}: {change['vehicle']} (system {change['sysid']}), {change['what']} of {change['began']}",
            f"  before  {_values(change['before'])}",
            f"  set to  {_values(change['changed'])}",
        ]
    lines += [f"cannot be read: {problem}" for problem in answer["problems"]]
    if answer["changes"]:
        lines.append("skygcs-cli undo run ID puts it back, undo drop ID forgets it")
    return lines or ["nothing waits to be undone"]


def _values(table: dict[str, float]) -> str:
    return ", ".join(f"{name} {value:g}" for name, value in table.items())
