"""`skygcs-cli stop`: the emergency stop, which asks before it lets anything fall."""

from __future__ import annotations

from enum import StrEnum
from typing import Annotated

import typer

from skygcs.cli.options import Json, Targets
from skygcs.cli.orders import order_confirmed


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

    order_confirmed("stop", targets, json_output, confirm, action=action.value)


def add_to(app: typer.Typer) -> None:
    app.command(rich_help_panel="Orders")(stop)
