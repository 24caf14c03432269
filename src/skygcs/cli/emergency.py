"""`skygcs-cli stop`: the emergency stop, which asks before it lets anything fall."""

from __future__ import annotations

import asyncio
import sys
from enum import StrEnum
from typing import Annotated

import typer

from skygcs.cli.connection import Exit, fail, run, waiting
from skygcs.cli.options import Json, Targets
from skygcs.cli.orders import tell_outcomes
from skygcs.errors import RpcError
from skygcs.rpc.client import Client

REFUSED = -32002
"""JSON-RPC code of what skygcs itself refuses (docs/reference/rpc.md)."""


class Action(StrEnum):
    HOLD = "hold"
    LAND = "land"
    KILL = "kill"


def stop(
    targets: Targets,
    action: Annotated[
        Action, typer.Argument(help="hold where it is, land there, or kill: stop the motors, it falls.")
    ] = Action.HOLD,
    confirm: Annotated[
        str | None,
        typer.Option("--confirm", metavar="WORD", help="For kill: kill-N, N the number of vehicles. Else it is asked."),
    ] = None,
    json_output: Json = False,
) -> None:
    """Emergency stop: over every link, repeated until the vehicle shows it, also if it is lost."""

    async def command(gcs: Client) -> int:
        async def ordered(word: str | None) -> int:
            async with waiting(f"stop {targets} {action.value}"):
                answer = await gcs.call("vehicles.stop", targets=targets, action=action.value, confirm=word)
            return tell_outcomes(answer["outcomes"], json_output)

        try:
            return await ordered(confirm)
        except RpcError as error:
            unasked = action is Action.KILL and confirm is None and error.code == REFUSED
            if not (unasked and _somebody_there()):
                raise
            fail(str(error))
        word = await asyncio.to_thread(_asked)
        if not word:
            fail("not confirmed; nothing was sent")
            return Exit.FAILED
        return await ordered(word)

    run(command)


def _somebody_there() -> bool:
    """Whether there is a person to ask; a script has to say the word itself."""
    return sys.stdin.isatty()


def _asked() -> str:
    typer.echo("> ", nl=False, err=True)
    return sys.stdin.readline().strip()


def add_to(app: typer.Typer) -> None:
    app.command(rich_help_panel="Orders")(stop)
