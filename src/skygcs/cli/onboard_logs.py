"""`skygcs-cli log`: the logs that autopilots have on board."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import AsyncIterator, Iterator
from datetime import UTC, datetime
from typing import Annotated, Any

import typer

from skygcs.cli.connection import client, exit_code, print_outcomes, run, show, waiting
from skygcs.cli.options import Json, Targets
from skygcs.cli.render import say
from skygcs.errors import SkygcsError
from skygcs.rpc.client import Client

log = typer.Typer(help="The logs that autopilots have on board: list them, get them.", no_args_is_help=True)


@log.command("list")
def list_(targets: Targets, json_output: Json = False) -> None:
    """List the logs on board.

    Example: skygcs-cli log list all
    """

    async def command(gcs: Client) -> int:
        async with waiting(f"logs of {targets}"):
            answer = await gcs.call("logs.list", targets=targets)
        show(answer, json_output, lambda _: _rows(answer["outcomes"]))
        return exit_code(answer["outcomes"])

    run(command)


@log.command("get")
def get(
    targets: Targets,
    logs: Annotated[
        list[str] | None,
        typer.Argument(metavar="ID …", help="As `log list` shows them. [default: the newest]", show_default=False),
    ] = None,
    everything: Annotated[bool, typer.Option("--all", help="All logs.")] = False,
    force: Annotated[bool, typer.Option("--force", help="Over a radio, too.")] = False,
    json_output: Json = False,
) -> None:
    """Get logs over USB or Wi-Fi into the daemon's log folder; the same command resumes one that was interrupted.

    A .bin of ArduPilot, a .ulg of PX4. Several vehicles at the same time. The vehicles must be disarmed.

    Example: skygcs-cli log get alpha
    """
    if everything and logs:
        raise typer.BadParameter("give ids or --all")
    wanted: Any = "all" if everything else "latest" if not logs else [_number(text) for text in logs]

    async def command(gcs: Client) -> int:
        async with _progress(quiet=json_output):
            answer = await gcs.call("logs.get", targets=targets, logs=wanted, force=force)
        outcomes = answer["outcomes"]
        code = print_outcomes(outcomes, json_output)
        if not json_output:
            for outcome in outcomes.values():
                for file in outcome["files"]:
                    say(file["path"])
        return code

    run(command)


def _number(text: str) -> int:
    if not (text.isascii() and text.isdigit() and int(text) < 65536):
        raise typer.BadParameter(f"{text!r} is not a number of a log; `skygcs-cli log list` shows them")
    return int(text)


def _rows(outcomes: dict[str, Any]) -> Iterator[str]:
    for name, outcome in outcomes.items():
        if not outcome["ok"]:
            yield f"FAIL {name}  {outcome['message']}"
        elif not outcome["logs"]:
            yield f"{name}  no logs"
        for entry in outcome["logs"]:
            at = entry["time_unix_s"]
            when = "time not known" if at is None else f"{datetime.fromtimestamp(at, UTC):%Y-%m-%d %H:%M} UTC"
            yield f"{name}  {entry['id']:>4}  {when:>20}  {entry['size_bytes'] / 1e6:>9.2f} MB"


@contextlib.asynccontextmanager
async def _progress(*, quiet: bool) -> AsyncIterator[None]:
    """Print the daemon's progress on stderr meanwhile, over a connection of its own."""

    async def follow() -> None:
        with contextlib.suppress(SkygcsError):  # the command itself says what is wrong
            async with client() as gcs:
                async for event in gcs.events(kinds=("onboard_log",)):
                    if event["data"].get("state") == "under_way":
                        say(f"{event['vehicle']}  {event['text']}", err=True)

    task = None if quiet else asyncio.create_task(follow(), name="progress")
    try:
        yield
    finally:
        if task is not None:
            task.cancel()
            await asyncio.gather(task, return_exceptions=True)


def add_to(app: typer.Typer) -> None:
    app.add_typer(log, name="log")
