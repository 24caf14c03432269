"""`skygcs-cli drill`: faults of simulated vehicles, begun and ended."""

from __future__ import annotations

from collections.abc import Iterator
from enum import StrEnum
from typing import Annotated, Any

import typer

from skygcs.cli.connection import run_order, run_show
from skygcs.cli.options import Json, OrderJson, Targets
from skygcs.cli.parsing import finite
from skygcs.cli.render import fixed

app = typer.Typer(help="Practise: faults of simulated vehicles (needs [drills]).", no_args_is_help=True)


class Fault(StrEnum):
    DEAF = "deaf"
    LINK = "link"
    GPS = "gps"
    BATTERY = "battery"
    WIND = "wind"


@app.command("begin")
def begin(
    targets: Targets,
    fault: Annotated[Fault, typer.Argument(metavar="FAULT", help="deaf, link, gps, battery or wind.")],
    value: Annotated[
        float | None,
        typer.Argument(
            metavar="VALUE", parser=finite, help="Of battery in percent, of wind in m/s; each 8 by default."
        ),
    ] = None,
    json_output: OrderJson = None,
) -> None:
    """Begin a fault in simulated vehicles; it lasts until it is ended.

    Example: skygcs-cli drill begin alpha battery 10
    """
    run_order("drills.begin", json_output, targets=targets, fault=fault.value, value=value)


@app.command("end")
def end(
    targets: Targets,
    fault: Annotated[
        Fault | None, typer.Argument(metavar="FAULT", help="Default: all active ones.", show_default=False)
    ] = None,
    json_output: OrderJson = None,
) -> None:
    """End a fault, or all of them.

    Example: skygcs-cli drill end all
    """
    run_order("drills.end", json_output, targets=targets, fault=None if fault is None else fault.value)


@app.command("status")
def status(json_output: Json = False) -> None:
    """Show the active faults.

    Example: skygcs-cli drill status
    """

    def lines(answer: dict[str, Any]) -> Iterator[str]:
        for one in answer["active"]:
            yield f"{one['vehicle']:<10}  {one['text']}, for {fixed(one['lasts_s'], 0)} s"
        if not answer["active"]:
            yield f"no fault lasts; vehicles that may have one: {', '.join(answer['simulated']) or 'none'}"

    run_show("drills.status", json_output, lines)


def add_to(app_: typer.Typer) -> None:
    app_.add_typer(app, name="drill")
