"""`skygcs-cli gains`: stability, margins and step responses of the control gains. Needs no daemon.

Options and their check are here; what is computed and shown (gains_study, gains_report, gains_plot) is imported when it
is asked for.
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import Annotated

import typer

from skygcs.cli.connection import run_offline
from skygcs.cli.options import Json
from skygcs.cli.parsing import parse_number

PLOT_SUFFIXES = (".svg", ".png")


def gains(
    xy: Annotated[
        str | None,
        typer.Option(
            "--xy", metavar="KP,KV,KI", help="Gains of x and y. [default: those of the UTIAS outdoor experiment]"
        ),
    ] = None,
    z: Annotated[
        str | None,
        typer.Option("--z", metavar="KP,KV,KI", help="Gains of z. [default: those of the UTIAS outdoor experiment]"),
    ] = None,
    hover: Annotated[
        float,
        typer.Option("--hover", metavar="THRUST", help="Normalised thrust that hovers: the plant gain is g/hover."),
    ] = 0.45,
    plant_gain: Annotated[
        str | None,
        typer.Option(
            "--plant-gain", metavar="G|XY,Z", help="Only this plant gain, instead of tilt's (g and 1) and g/hover."
        ),
    ] = None,
    delay_s: Annotated[
        float | None,
        typer.Option("--delay", metavar="S", help="Measured delay, telemetry and setpoint together: suggests gains."),
    ] = None,
    reserve: Annotated[
        float, typer.Option("--reserve", metavar="FACTOR", help="Wanted delay margin over the delay.")
    ] = 2.0,
    rate_hz: Annotated[
        float | None,
        typer.Option("--rate", metavar="HZ", help="Step responses at this rate of the loop, not continuous."),
    ] = None,
    duration_s: Annotated[float, typer.Option("--duration", metavar="S", help="Of the step responses.")] = 30.0,
    plot: Annotated[Path | None, typer.Option("--plot", metavar="FILE", help="Draw them, as .svg or .png.")] = None,
    full: Annotated[
        bool, typer.Option("--full", help="Every table of the analysis, also for the default gains.")
    ] = False,
    json_output: Json = False,
) -> None:
    """Show how stable control gains are, how much delay they bear, and which gains a link's delay asks for.

    Without options: the default gains in short; any option, or --full, prints the whole analysis.
    """
    _check("--hover", hover, 0.01, 1)
    _check("--reserve", reserve, 1, 100)
    _check("--duration", duration_s, 1, 600)
    if delay_s is not None:
        _check("--delay", delay_s, 0, 60)
    if rate_hz is not None:
        _check("--rate", rate_hz, 1, 1000)
    if plot is not None and plot.suffix.lower() not in PLOT_SUFFIXES:
        raise typer.BadParameter(f"--plot: {plot.name!r} ends neither in .svg nor in .png")
    xy_gains = None if xy is None else _numbers("--xy", xy, 3)
    z_gains = None if z is None else _numbers("--z", z, 3)
    plant = None if plant_gain is None else _numbers("--plant-gain", plant_gain, 1, 2)

    def command() -> int:
        from skygcs.cli.gains_report import gains_report
        from skygcs.cli.gains_study import Question
        from skygcs.core.control.gains import UTIAS_XY, UTIAS_Z, AxisGains

        try:
            question = Question(
                xy=UTIAS_XY if xy_gains is None else AxisGains(*xy_gains),
                z=UTIAS_Z if z_gains is None else AxisGains(*z_gains),
                hover=hover,
                plant_gains=None if plant is None else (plant[0], plant[-1]),
                delay_s=delay_s,
                reserve=reserve,
                rate_hz=rate_hz,
                duration_s=duration_s,
            )
        except ValueError as error:
            raise typer.BadParameter(str(error)) from None
        brief = question == Question() and not (full or json_output or plot)
        return gains_report(question, plot, json_output, brief=brief)

    run_offline(command)


def add_to(app: typer.Typer) -> None:
    app.command(rich_help_panel="Looking")(gains)


def _numbers(option: str, text: str, *counts: int) -> tuple[float, ...]:
    parts = text.split(",")
    if len(parts) not in counts:
        wanted = " or ".join(str(count) for count in counts)
        raise typer.BadParameter(f"{option}: {text!r} is not {wanted} number{'s' if wanted != '1' else ''} with commas")
    return tuple(parse_number(part.strip(), option) for part in parts)


def _check(option: str, value: float, least: float, most: float) -> None:
    if not (math.isfinite(value) and least <= value <= most):
        raise typer.BadParameter(f"{option}: {value:g} is not between {least:g} and {most:g}")
