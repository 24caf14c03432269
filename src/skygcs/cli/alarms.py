"""`skygcs-cli alarms`: what needs a person, and its acknowledgement for every client of the daemon."""

from __future__ import annotations

import getpass
import socket
import time
from collections.abc import Iterator, Mapping
from typing import Annotated, Any

import typer

from skygcs.cli.connection import Exit, run, show
from skygcs.cli.options import Json
from skygcs.cli.render import duration, plural
from skygcs.rpc.client import Client

app = typer.Typer(
    help="Show what needs a person: lost, does not hear us, battery, failsafe, a stop that was refused …",
    invoke_without_command=True,
    no_args_is_help=False,
)


@app.callback(invoke_without_command=True)
def alarms(ctx: typer.Context, json_output: Json = False) -> None:
    """Show the alarms that are open, and those that were acknowledged and last; `alarms ack` acknowledges them.

    They are the daemon's: the same on every page and in every shell, and kept over a restart. Exit 1 while one is open.
    """
    if ctx.invoked_subcommand is not None:
        return

    async def command(gcs: Client) -> int:
        answer = await gcs.call("alarms.list")
        show(answer, json_output, lambda answer: alarm_lines(answer["alarms"], time.time()))
        return Exit.FAILED if any(alarm["acknowledged_by"] is None for alarm in answer["alarms"]) else Exit.DONE

    run(command)


@app.command("ack")
def acknowledge(
    numbers: Annotated[
        list[int] | None,
        typer.Argument(metavar="NUMBER …", help="As `alarms` shows them. [default: all]", show_default=False),
    ] = None,
    json_output: Json = False,
) -> None:
    """Acknowledge alarms: you have seen them. One whose condition is over leaves the list.

    Example: skygcs-cli alarms ack 3
    """

    async def command(gcs: Client) -> None:
        answer = await gcs.call("alarms.acknowledge", numbers=numbers or None, by=who())
        show(answer, json_output, lambda answer: acknowledged_lines(answer["acknowledged"]))

    run(command)


def who() -> str:
    """The person at this shell, as the daemon notes who acknowledged: "mia@field1"."""
    try:
        user = getpass.getuser()
    except (KeyError, OSError):
        user = "unknown"
    return f"{user}@{socket.gethostname()}"[:80]


def alarm_lines(alarms: list[Mapping[str, Any]], now_unix_s: float) -> Iterator[str]:
    """A line for each: whether it is open, number, age, vehicle, text, what followed from it, who has seen it."""
    if not alarms:
        yield "no alarm"
        return
    width = max(len(alarm["vehicle"] or "-") for alarm in alarms)
    for alarm in alarms:
        seen = alarm["acknowledged_by"]
        word = "seen " if seen is not None else "ALARM" if alarm["severity"] == "alarm" else "warn "
        age = duration(max(0.0, now_unix_s - alarm["raised_unix_s"]))
        notes = [] if alarm["active"] else ["over"]
        notes += [f"{alarm['count']} times"] if alarm["count"] > 1 else []
        followed = sum(alarm["consequences"].values())
        notes += [f"{followed} more followed from it: {', '.join(alarm['consequences'])}"] if followed else []
        if seen is not None:
            clock = time.strftime("%H:%M:%S", time.localtime(alarm["acknowledged_unix_s"]))
            notes.append(f"acknowledged by {seen} at {clock}")
        tail = f" ({'; '.join(notes)})" if notes else ""
        name = alarm["vehicle"] or "-"
        yield f"{word} {alarm['number']:>4}  {age:>6}  {name:<{width}}  {alarm['kind']}: {alarm['text']}{tail}"


def acknowledged_lines(alarms: list[Mapping[str, Any]]) -> Iterator[str]:
    """The number of alarms, then a line for each."""
    yield f"{plural(len(alarms), 'alarm')} acknowledged" if alarms else "no open alarm"
    for alarm in alarms:
        yield f"  {alarm['number']}  {alarm['vehicle'] or '-'}  {alarm['kind']}: {alarm['text']}"


def add_to(root: typer.Typer) -> None:
    """Add `skygcs-cli alarms`."""
    root.add_typer(app, name="alarms", rich_help_panel="Show")
