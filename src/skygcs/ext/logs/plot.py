"""`skygcs-cli plot`: how a vehicle tracked its reference, from a file of `control record`. Needs no daemon."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Annotated

import typer

from skygcs.cli.connection import run_offline
from skygcs.cli.parsing import finite
from skygcs.cli.render import say

PLOT_SUFFIXES = (".png", ".svg")


def plot(
    file: Annotated[Path, typer.Argument(metavar="FILE", help="A file of `control record`.", show_default=False)],
    output: Annotated[
        Path | None, typer.Option("--output", "-o", metavar="OUT", help=".png or .svg; default: FILE with .png.")
    ] = None,
    begin_s: Annotated[
        float, typer.Option("--from", metavar="S", help="Seconds after its beginning.", parser=finite)
    ] = 0.0,
    end_s: Annotated[
        float | None, typer.Option("--to", metavar="S", help="Default: its end.", parser=finite, show_default=False)
    ] = None,
) -> None:
    """Draw reference and estimate per axis, error, thrust and tilt, ages, and the control mode.

    Example: skygcs-cli plot alpha.csv -o alpha.svg
    """
    path = file.with_suffix(".png") if output is None else output
    if path.suffix.lower() not in PLOT_SUFFIXES:
        raise typer.BadParameter(f"--output: {path.name!r} ends neither in .png nor in .svg")
    if begin_s < 0 or (end_s is not None and end_s <= begin_s):
        raise typer.BadParameter("--to must be later than --from")

    def command() -> None:
        from skygcs.ext.logs.trace_figures import figures_line
        from skygcs.ext.logs.trace_plot import draw

        measured = draw(file, path, begin_s, math.inf if end_s is None else end_s)
        say(f"{path}: {figures_line(measured)}")

    run_offline(command)


def add_to(app: typer.Typer) -> None:
    app.command()(plot)
