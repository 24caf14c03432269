"""`skygcs-cli gains`: stability, margins and step responses of the control gains. Needs no daemon.

`study` computes the JSON answer; text and plot are made from it. numpy is imported when poles are computed.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from skygcs.cli.connection import run_offline
from skygcs.cli.options import Json
from skygcs.cli.parsing import finite, parse_number, within
from skygcs.cli.render import console, print_json, say, table
from skygcs.core.control.analysis import (
    AIRFRAME_LAG_S,
    CONTINUOUS_PERIOD_S,
    DEFAULT_RESERVE,
    Loop,
    Margins,
    StepResponse,
    Suggestion,
    delay_margin_s,
    factorings,
    margins,
    poles,
    routh,
    step_response,
    suggest,
)
from skygcs.core.control.gains import GRAVITY_MPS2, UTIAS_HOVER_THRUST, UTIAS_XY, UTIAS_Z, AxisGains, ControlConfig
from skygcs.core.control.velocity_predictor import ARDUCOPTER_LOOP, PX4_LOOP, velocity_delay_range
from skygcs.errors import ConfigError

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from rich.table import Table

Answer = dict[str, Any]

PLOT_SUFFIXES = (".svg", ".png")

_UTIAS = "[default: those of the UTIAS outdoor experiment]"

XyGains = Annotated[str | None, typer.Option("--xy", metavar="KP,KV,KI", help=f"Gains of x and y. {_UTIAS}")]
ZGains = Annotated[str | None, typer.Option("--z", metavar="KP,KV,KI", help=f"Gains of z. {_UTIAS}")]
Hover = Annotated[
    float,
    typer.Option(
        "--hover", metavar="THRUST", help="Normalised thrust at hover: the plant gain is g/hover.", parser=finite
    ),
]
PlantGain = Annotated[
    str | None,
    typer.Option(
        "--plant-gain", metavar="G|XY,Z", help="Only this plant gain, in place of tilt (g and 1) and g/hover."
    ),
]
Delay = Annotated[
    float | None,
    typer.Option(
        "--delay", metavar="S", help="Measured delay of telemetry and setpoint together: suggests gains.", parser=finite
    ),
]
Reserve = Annotated[
    float, typer.Option("--reserve", metavar="FACTOR", help="Delay margin divided by delay, at least.", parser=finite)
]
LoopRate = Annotated[
    float | None,
    typer.Option(
        "--rate", metavar="HZ", help="Step responses of a loop at this rate. [default: continuous]", parser=finite
    ),
]
TelemetryRate = Annotated[
    float | None,
    typer.Option(
        "--telemetry",
        metavar="HZ",
        help="Positions per second, for suggested gains. [default: as --rate, or 50]",
        parser=finite,
    ),
]
Lag = Annotated[
    float,
    typer.Option("--lag", metavar="S", help="Lag of the airframe's attitude, for suggested gains.", parser=finite),
]
Duration = Annotated[
    float, typer.Option("--duration", metavar="S", help="Length of the step responses.", parser=finite)
]
PlotFile = Annotated[
    Path | None, typer.Option("--plot", metavar="FILE", help="Draw the step responses, as .svg or .png.")
]
Full = Annotated[bool, typer.Option("--full", help="Print every table of the analysis, also for the default gains.")]


def gains(
    xy: XyGains = None,
    z: ZGains = None,
    hover: Hover = UTIAS_HOVER_THRUST,
    plant_gain: PlantGain = None,
    delay_s: Delay = None,
    reserve: Reserve = DEFAULT_RESERVE,
    rate_hz: LoopRate = None,
    telemetry_hz: TelemetryRate = None,
    lag_s: Lag = AIRFRAME_LAG_S,
    duration_s: Duration = 30.0,
    plot: PlotFile = None,
    full: Full = False,
    json_output: Json = False,
) -> None:
    """Show how stable control gains are, what delay they tolerate, and which gains suit the delay of a link.

    Without options: the default gains in short. Any option, or --full, prints the whole analysis.

    Example: skygcs-cli gains --delay 0.15
    """
    # check the options
    within("--hover", hover, 0.01, 1)
    within("--reserve", reserve, 1, 100)
    within("--duration", duration_s, 1, 600)
    within("--delay", delay_s, 0, 60)
    within("--rate", rate_hz, 1, 1000)
    within("--telemetry", telemetry_hz, 0.5, 1000)
    within("--lag", lag_s, 0, 2)
    if plot is not None and plot.suffix.lower() not in PLOT_SUFFIXES:
        raise typer.BadParameter(f"--plot: {plot.name!r} ends neither in .svg nor in .png")
    plant = None if plant_gain is None else _numbers("--plant-gain", plant_gain, 1, 2)
    try:
        question = Question(
            xy=UTIAS_XY if xy is None else AxisGains(*_numbers("--xy", xy, 3)),
            z=UTIAS_Z if z is None else AxisGains(*_numbers("--z", z, 3)),
            hover=hover,
            plant_gains=None if plant is None else (plant[0], plant[-1]),
            delay_s=delay_s,
            reserve=reserve,
            rate_hz=rate_hz,
            telemetry_hz=telemetry_hz,
            lag_s=lag_s,
            duration_s=duration_s,
        )
    except ValueError as error:
        raise typer.BadParameter(str(error)) from None
    brief = question == Question() and not (full or json_output or plot)
    run_offline(lambda: _report(question, plot, json_output, brief=brief))


def _report(question: Question, plot: Path | None, json_output: bool, *, brief: bool) -> None:
    """Compute, draw, print. ``brief`` prints one line per axis. Raises SkygcsError if the figure cannot be drawn."""
    if plot is not None:
        from skygcs.cli.figure import require_matplotlib

        require_matplotlib()
    answer = study(question)
    if plot is not None:
        draw(answer, plot)
    if json_output:
        print_json(answer, line=True)
    elif brief:
        show_brief(answer)
    else:
        show(answer)
        if plot is not None:
            say(f"step responses drawn in {plot}")


def _numbers(option: str, text: str, *counts: int) -> tuple[float, ...]:
    parts = text.split(",")
    if len(parts) not in counts:
        wanted = " or ".join(str(count) for count in counts)
        raise typer.BadParameter(f"{option}: {text!r} is not {wanted} number{'s' if wanted != '1' else ''} with commas")
    return tuple(parse_number(part.strip(), option) for part in parts)


# --- analysis ---------------------------------------------------------------------------------------------------------

TYPICAL_DELAY_S = 0.1
"""Shown if no delay is given: up to this delay skygcs closes the attitude loop over a link."""

TRACE_PERIOD_S = 0.05
"""Time between two positions of the answer: 19 of them in one period of the fastest crossover in use (6.6 rad/s)."""

FINEST_PERIOD_S = 1e-4
"""Smallest step of the simulation; no loop of a vehicle needs a smaller one."""

FLOWN_HZ = 50.0
"""Rate of attitude setpoints and of positions for them, where none is given."""

PERIODS_PER_DELAY_MARGIN = 200
"""The hold of the simulation delays by half a period: 0.25 % of the delay margin."""


@dataclass(frozen=True, slots=True)
class Question:
    """Input of the computation. Raises ValueError for gains that no loop can have.

    ``plant_gains`` (xy, z) replace those of tilt and of normalised thrust.
    """

    xy: AxisGains = UTIAS_XY
    z: AxisGains = UTIAS_Z
    hover: float = UTIAS_HOVER_THRUST
    plant_gains: tuple[float, float] | None = None
    delay_s: float | None = None
    reserve: float = DEFAULT_RESERVE
    rate_hz: float | None = None
    telemetry_hz: float | None = None
    lag_s: float = AIRFRAME_LAG_S
    duration_s: float = 30.0

    def __post_init__(self) -> None:
        for _ in self.loops():
            pass  # each checks its numbers

    @property
    def plants(self) -> Mapping[str, tuple[float, float]]:
        """Plant gains of xy and z, by plant.

        ``tilt``: the input is a tilt angle (xy) and a vertical acceleration (z), as in Eqs. 7 to 16 of the UTIAS
        report. ``thrust``: the input is normalised thrust.
        """
        if self.plant_gains is not None:
            return {"given": self.plant_gains}
        thrust = GRAVITY_MPS2 / self.hover
        return {"tilt": (GRAVITY_MPS2, 1.0), "thrust": (thrust, thrust)}

    @property
    def flown_hz(self) -> float:
        """The loop's rate that suggested gains are for."""
        return FLOWN_HZ if self.rate_hz is None else self.rate_hz

    @property
    def held_s(self) -> float:
        """The delay by holding each output and each position until the next one: half a period each, on average."""
        return 0.5 / self.flown_hz + 0.5 / (self.telemetry_hz or self.flown_hz)

    def loops(self) -> Iterator[tuple[str, str, Loop]]:
        """Axis, plant and loop of each."""
        for plant, (xy, z) in self.plants.items():
            yield "xy", plant, Loop(self.xy, xy)
            yield "z", plant, Loop(self.z, z)

    @property
    def of_utias(self) -> bool:
        """True for the gains that Eq. 16 of the UTIAS report is about."""
        return (self.xy, self.z, self.plant_gains) == (UTIAS_XY, UTIAS_Z, None)


def study(question: Question) -> Answer:
    """The whole analysis for JSON; docs/reference/gains.md lists its keys. None: unlimited, or does not exist."""
    return {
        "gains": {"xy": asdict(question.xy), "z": asdict(question.z)},
        "hover": question.hover,
        "delay_s": question.delay_s,
        "reserve": question.reserve,
        "rate_hz": question.rate_hz,
        "telemetry_hz": question.telemetry_hz,
        "lag_s": question.lag_s,
        "loops": [_loop(question, axis, plant, loop) for axis, plant, loop in question.loops()],
        "velocity_prediction": None if question.delay_s is None else _prediction(question, question.delay_s),
        "utias_eq16": _utias_eq16() if question.of_utias else None,
    }


def _prediction(question: Question, delay_s: float) -> Answer:
    """The delays between which velocity control with prediction over ``delay_s`` is stable, by autopilot; None for
    gains that no vehicle may have."""
    try:
        law = ControlConfig(xy=question.xy, z=question.z)
    except ConfigError:
        return {"px4": None, "ardupilot": None}
    return {
        name: {"least_s": found.least_s, "most_s": found.most_s, "margin_s": found.margin_s, "holds": found.holds}
        if (found := velocity_delay_range(law, loop, delay_s)) is not None
        else None
        for name, loop in (("px4", PX4_LOOP), ("ardupilot", ARDUCOPTER_LOOP))
    }


def _loop(question: Question, axis: str, plant: str, loop: Loop) -> Answer:
    criterion = routh(loop)
    suggestion = None
    if question.delay_s is not None:
        held_s, lag_s = question.held_s, question.lag_s
        suggestion = suggest(loop, question.delay_s, question.reserve, held_s=held_s, lag_s=lag_s)
    return {
        "axis": axis,
        "plant": plant,
        "plant_gain": loop.plant_gain,
        "polynomial": list(loop.polynomial),
        "poles": [{"re": pole.real, "im": pole.imag} for pole in poles(loop)],
        "routh_first_column": list(criterion.first_column),
        "stable": criterion.stable,
        "factorings": [asdict(factoring) for factoring in factorings(loop)],
        "margins": _margins(margins(loop)),
        "margins_with_delay": None if question.delay_s is None else _margins(margins(loop, question.delay_s)),
        "suggestion": _suggestion(suggestion, loop.plant_gain, question.lag_s),
        "steps": list(_steps(question, loop, suggestion)),
    }


def _margins(found: Margins | None) -> Answer | None:
    if found is None:
        return None
    return {
        "crossover_radps": found.crossover_radps,
        "phase_margin_deg": math.degrees(found.phase_margin_rad),
        "delay_margin_s": found.delay_margin_s,
        "gain_up": None if math.isinf(found.gain_up) else found.gain_up,
        "gain_down": None if math.isinf(found.gain_down) else found.gain_down,
    }


def _suggestion(suggestion: Suggestion | None, plant_gain: float, lag_s: float) -> Answer | None:
    if suggestion is None:
        return None
    loop = Loop(suggestion.gains, plant_gain)
    return {
        "factor": suggestion.factor,
        "gains": asdict(suggestion.gains),
        "margins": _margins(margins(loop)),
        "delay_margin_s": delay_margin_s(loop, lag_s),
    }


def _steps(question: Question, loop: Loop, suggestion: Suggestion | None) -> Iterator[Answer]:
    delay_s = TYPICAL_DELAY_S if question.delay_s is None else question.delay_s
    yield _step(question, "given", loop, 0.0)
    if delay_s > 0:
        yield _step(question, "given", loop, delay_s)
    if suggestion is not None and suggestion.factor > 1:
        yield _suggested_step(question, Loop(suggestion.gains, loop.plant_gain), delay_s)


def _step(question: Question, gains: str, loop: Loop, delay_s: float) -> Answer:
    tolerated_s = delay_margin_s(loop)
    period_s = CONTINUOUS_PERIOD_S
    hold_s = 0.0
    if question.rate_hz is not None:
        period_s = 1 / question.rate_hz
        hold_s = period_s / 2  # the average delay of sampling with a hold
    elif tolerated_s > 0:
        period_s = min(period_s, max(FINEST_PERIOD_S, tolerated_s / PERIODS_PER_DELAY_MARGIN))
    response = step_response(loop, delay_s=delay_s, duration_s=question.duration_s, period_s=period_s)
    return _response(gains, delay_s, response, stable=delay_s + hold_s < tolerated_s)


def _suggested_step(question: Question, loop: Loop, delay_s: float) -> Answer:
    """With all that the suggestion counts: the loop's rate, the positions' as half a period of delay, the lag."""
    response = step_response(
        loop,
        delay_s=delay_s + question.held_s - 0.5 / question.flown_hz,
        duration_s=question.duration_s,
        period_s=1 / question.flown_hz,
        lag_s=question.lag_s,
    )
    stable = delay_s + question.held_s < delay_margin_s(loop, question.lag_s)
    return _response("suggested", delay_s, response, stable=stable)


def _response(gains: str, delay_s: float, response: StepResponse, *, stable: bool) -> Answer:
    period_s = response.period_s
    every = max(1, round(TRACE_PERIOD_S / period_s))
    return {
        "gains": gains,
        "delay_s": delay_s,
        "stable": stable,
        "overshoot": response.overshoot if stable else None,
        "rise_s": response.rise_s if stable else None,
        "settling_s": response.settling_s if stable else None,
        "every_s": every * period_s,
        "positions": [round(x, 5) for x in response.positions[::every]],
    }


def _utias_eq16() -> Answer:
    """The factoring behind each row of the UTIAS report's Eq. 16. G = -g in the y row is taken from the report."""
    rows = {"x": Loop(UTIAS_XY, GRAVITY_MPS2), "y": Loop(UTIAS_XY, -GRAVITY_MPS2), "z": Loop(UTIAS_Z, 1.0)}
    return {
        axis: {
            "plant_gain": loop.plant_gain,
            **asdict(factorings(loop)[0]),
            "unstable_poles": [pole.real for pole in poles(loop) if pole.real > 0],
        }
        for axis, loop in rows.items()
    }


# --- text -------------------------------------------------------------------------------------------------------------

UNSTABLE = "UNSTABLE"
UNSTABLE_STYLE = "bold red"

TABLE_TIMES_S = (0.5, 1.0, 1.5, 2.0, 3.0, 4.0, 6.0, 8.0, 12.0, 16.0, 20.0, 30.0)

HINT = """\
Delay is telemetry age + setpoint transmission, as skygcs-cli track NAME measures them; rates and lag count besides.
Gains for your delay: skygcs-cli gains --delay 0.2     Every table: skygcs-cli gains --full"""


def show_brief(answer: Answer) -> None:
    """One line per axis for normalised thrust, the command that a vehicle gets, and a hint."""
    screen = console()
    screen.print(f"default gains, hover thrust {answer['hover']:g}, step responses without delay")
    for loop in answer["loops"]:
        if loop["plant"] == "thrust":
            found, step = loop["margins"], loop["steps"][0]
            screen.print(
                f"{loop['axis']:<3} {gains_text(answer['gains'][loop['axis']]):<28} stable with up to "
                f"{found['delay_margin_s']:.3f} s of delay, overshoot {100 * step['overshoot']:.0f} %, "
                f"settles in {_settling(step)}"
            )
    screen.print(HINT, style="dim")


def show(answer: Answer) -> None:
    """Print the answer for a person."""
    screen = console()
    # the gains, their loops and margins
    for axis, gains in answer["gains"].items():
        screen.print(f"[bold]{axis}[/bold]  {gains_text(gains)}")
    screen.print()
    screen.print(_loops_table(answer))
    screen.print()
    screen.print(_margins_table(answer))
    if answer["delay_s"] is not None:
        rate_hz = FLOWN_HZ if answer["rate_hz"] is None else answer["rate_hz"]
        screen.print(
            f"\n[bold]For {answer['delay_s']:g} s of delay with a reserve of {answer['reserve']:g}[/bold] "
            f"(λ rule: Kp/λ, Kv/λ, Ki/λ²),\nan attitude lag of {answer['lag_s']:g} s, {rate_hz:g} Hz, and positions at "
            f"{answer['telemetry_hz'] or rate_hz:g} Hz"
        )
        screen.print(_suggestions_table(answer))
        for autopilot, found in answer["velocity_prediction"].items():
            screen.print(f"velocity with prediction, {autopilot}: {_prediction_text(found)}")
    # step responses, and what the plants mean
    screen.print()
    screen.print(_steps_table(answer))
    screen.print()
    screen.print(_positions_table(answer))
    if any(loop["plant"] == "thrust" for loop in answer["loops"]):
        screen.print(
            "\nPlant thrust (G = g/hover) is what normalised thrust does: use it for flight. "
            "Plant tilt is the analysis of the UTIAS report."
        )
    # for the gains of the UTIAS report also its Eq. 16
    if (rows := answer["utias_eq16"]) is not None:
        screen.print("\n[bold]Eq. 16 of the UTIAS report[/bold]: the polynomial as (s + K'Px) (s² + K'Pv s + K'Iv)")
        screen.print(_eq16_table(rows))
        y = rows["y"]
        screen.print(
            f"Its y row comes from K'Px = {y['kpx']:.3f}, an unstable pole at "
            f"{y['unstable_poles'][0]:+.3f} rad/s: "
            "G has\nthe wrong sign there. With a roll that reduces the error the loop of y equals that of x. "
            "The matrix of\n"
            "Eq. 16 does not show the pole because it leaves out the third state, the position itself."
        )


def _prediction_text(found: Answer | None) -> str:
    if found is None:
        return "[red]UNSTABLE[/red] with this delay"
    flown = "it is flown" if found["holds"] else "less than 30 % either way, so it is not flown"
    return f"stable from {found['least_s']:.3f} to {found['most_s']:.3f} s of delay: {flown}"


def gains_text(gains: Answer) -> str:
    return f"Kp {gains['pos_p_per_s']:.4g}  Kv {gains['vel_p']:.4g}  Ki {gains['vel_i']:.4g}"


def _table(columns: Sequence[str], rows: Sequence[Sequence[str]], left: int = 2) -> Table:
    """The first ``left`` columns are aligned left, the numbers behind them right; UNSTABLE is red."""
    cells = [[(cell, UNSTABLE_STYLE) if cell in (UNSTABLE, "none") else cell for cell in row] for row in rows]
    return table(columns, cells, right=columns[left:])


def _loops_table(answer: Answer) -> Table:
    rows = [
        (
            loop["axis"],
            loop["plant"],
            f"{loop['plant_gain']:.4g}",
            "  ".join(f"{c:.4g}" for c in loop["polynomial"]),
            "  ".join(f"{c:.4g}" for c in loop["routh_first_column"]),
            poles_text(loop["poles"]),
            "stable" if loop["stable"] else UNSTABLE,
        )
        for loop in answer["loops"]
    ]
    return _table(("axis", "plant", "G", "polynomial", "Routh's first column", "poles", ""), rows)


def poles_text(found: Sequence[Answer]) -> str:
    """ "-0.24, -0.75±1.08j": a conjugate pair is shown once."""
    texts = (
        f"{pole['re']:.4g}" if pole["im"] == 0 else f"{pole['re']:.4g}±{pole['im']:.4g}j"
        for pole in found
        if pole["im"] >= 0
    )
    return ", ".join(texts)


def _margins_table(answer: Answer) -> Table:
    columns = ["axis", "plant", "crossover", "phase margin", "gain margin", "delay margin"]
    delay_s = answer["delay_s"]
    if delay_s is not None:
        columns += [f"left with {delay_s:g} s: phase", "gain"]
    rows = [(loop["axis"], loop["plant"], *_margin_cells(loop, delay_s is not None)) for loop in answer["loops"]]
    return _table(columns, rows)


def _margin_cells(loop: Answer, delayed: bool) -> Iterator[str]:
    found = loop["margins"]
    if found is None:
        yield from ("", "none", "", "", *("", "") * delayed)
        return
    yield f"{found['crossover_radps']:.3f} rad/s"
    yield f"{found['phase_margin_deg']:.1f}°"
    yield _gain_margin(found)
    yield f"{found['delay_margin_s']:.3f} s"
    if delayed:
        left = loop["margins_with_delay"]
        yield UNSTABLE if left is None else f"{left['phase_margin_deg']:.1f}°"
        yield "" if left is None else _gain_margin(left)


def _gain_margin(found: Answer) -> str:
    up, down = found["gain_up"], found["gain_down"]
    return f"÷{'∞' if down is None else f'{down:.3g}'} to ×{'∞' if up is None else f'{up:.3g}'}"


def _suggestions_table(answer: Answer) -> Table:
    rows: list[tuple[str, ...]] = []
    for loop in answer["loops"]:
        suggestion = loop["suggestion"]
        if suggestion is None:
            rows.append((loop["axis"], loop["plant"], "", "unstable without delay: slower gains do not help", "", ""))
            continue
        gains = gains_text(suggestion["gains"]) if suggestion["factor"] > 1 else "as they are"
        margin = f"{suggestion['delay_margin_s']:.3f} s"
        factor = f"{suggestion['factor']:.3g}"
        rows.append((loop["axis"], loop["plant"], factor, gains, margin, _settling(loop["steps"][-1])))
    return _table(("axis", "plant", "λ", "gains", "delay margin", "settles"), rows)


def _steps_table(answer: Answer) -> Table:
    how = "continuous" if answer["rate_hz"] is None else f"at {answer['rate_hz']:g} Hz"
    rows = []
    for loop, step in _all_steps(answer):
        overshoot = f"{100 * step['overshoot']:.1f} %" if step["stable"] else ""
        rise = f"{step['rise_s']:.2f} s" if step["rise_s"] is not None else ""
        rows.append((loop["axis"], loop["plant"], step_text(step), overshoot, rise, _settling(step)))
    columns = ("axis", "plant", "step response, " + how, "overshoot", "rise 10-90 %", "settles to 5 %")
    return _table(columns, rows, left=3)


def _all_steps(answer: Answer) -> Iterator[tuple[Answer, Answer]]:
    return ((loop, step) for loop in answer["loops"] for step in loop["steps"])


def step_text(step: Answer) -> str:
    """Delay and gains of a step response."""
    delay = f"{step['delay_s']:g} s delay" if step["delay_s"] else "no delay"
    return delay + (", suggested gains" if step["gains"] == "suggested" else "")


def _settling(step: Answer) -> str:
    if not step["stable"]:
        return UNSTABLE
    if step["settling_s"] is None:
        return f"not in {(len(step['positions']) - 1) * step['every_s']:.0f} s"
    return f"{step['settling_s']:.1f} s"


def _positions_table(answer: Answer) -> Table:
    steps = list(_all_steps(answer))
    heads = (
        f"{loop['axis']} {loop['plant']}\n{step['delay_s']:g} s" + (" λ" if step["gains"] == "suggested" else "")
        for loop, step in steps
    )
    longest_s = max(len(step["positions"]) * step["every_s"] for _, step in steps)
    times = [time_s for time_s in TABLE_TIMES_S if time_s < longest_s]
    return _table(("t, s", *heads), [(f"{t:g}", *(_position(step, t) for _, step in steps)) for t in times], left=1)


def _position(step: Answer, time_s: float) -> str:
    n = round(time_s / step["every_s"])
    positions = step["positions"]
    return f"{positions[n]:.3f}" if n < len(positions) and abs(positions[n]) < 1e3 else "-"


def _eq16_table(rows: Mapping[str, Answer]) -> Table:
    cells = [
        (axis, f"{row['plant_gain']:.4g}", *(f"{row[key]:.3f}" for key in ("kpx", "kiv", "kpv")))
        for axis, row in rows.items()
    ]
    return _table(("row", "G", "K'Px", "K'Iv", "K'Pv"), cells, left=1)


# --- figure -----------------------------------------------------------------------------------------------------------

LINES = ("-", "--", "-.")
LOWEST, HIGHEST = -0.5, 2.2
"""Limits of the figure, in steps; a response is drawn until it leaves them."""

LITTLE_OVERSHOOT = 1.4
"""Largest position below which the legend needs no room of its own."""

PLANT_TEXTS = {"tilt": "tilt angle and vertical acceleration", "thrust": "normalised thrust", "given": "plant gain"}


def draw(answer: Answer, path: Path) -> None:
    """Draw the step responses, one panel per axis and plant. Raises SkygcsError if the file cannot be written."""
    from skygcs.cli.figure import new_figure, save

    loops = answer["loops"]
    plants = list(dict.fromkeys(loop["plant"] for loop in loops))
    figure = new_figure(1.5 + 5 * len(plants), 7)
    panels = figure.subplots(2, len(plants), sharex=True, sharey=True, squeeze=False)
    for loop in loops:
        panel = panels[["xy", "z"].index(loop["axis"])][plants.index(loop["plant"])]
        _draw_loop(panel, loop, answer["gains"][loop["axis"]])
    panels[0][0].set_ylim(*_limits(loops))
    panels[0][0].set_xlim(left=0)
    for panel in panels[-1]:
        panel.set_xlabel("time after the step, s")
    for row in panels:
        row[0].set_ylabel("position / step")
    save(figure, path)


def _draw_loop(panel: Axes, loop: Answer, gains: Answer) -> None:
    from skygcs.cli.figure import COLOURS

    panel.axhline(1, color="0.7", linewidth=0.8)
    for step, colour, line in zip(loop["steps"], COLOURS, LINES, strict=False):
        shown = _shown(step)
        times = [n * step["every_s"] for n in range(len(shown))]
        panel.plot(times, shown, line, color=colour, label=_label(step), linewidth=1.6)
    margins = loop["margins"]
    margin = "unstable" if margins is None else f"delay margin {margins['delay_margin_s']:.3f} s"
    plant = f"{PLANT_TEXTS[loop['plant']]}, G = {loop['plant_gain']:.4g}"
    title = f"{loop['axis']}, {plant}: {margin}\n{gains_text(gains)}"
    if loop["steps"][-1]["gains"] == "suggested":
        title += f"\nsuggested: {gains_text(loop['suggestion']['gains'])}"
    panel.set_title(title, fontsize=9)
    panel.grid(color="0.9", linewidth=0.6)
    panel.set_axisbelow(True)
    panel.legend(fontsize=8, loc="lower right")


def _limits(loops: list[Answer]) -> tuple[float, float]:
    shown = [x for loop in loops for step in loop["steps"] for x in _shown(step)]
    highest = min(HIGHEST, max(1.15, max(shown) + 0.05))
    room = 0.05 if highest < LITTLE_OVERSHOOT else 0.45  # for the legend, below the oscillation
    return max(LOWEST, min(shown) - room), highest


def _shown(step: Answer) -> list[float]:
    """The positions until the response leaves the figure."""
    positions: list[float] = step["positions"]
    left = next((n for n, x in enumerate(positions) if not LOWEST <= x <= HIGHEST), len(positions))
    return positions[: left + 1]


def _label(step: Answer) -> str:
    if not step["stable"]:
        return f"{step_text(step)}: unstable"
    return f"{step_text(step)}: overshoot {100 * step['overshoot']:.0f} %"


def add_to(app: typer.Typer) -> None:
    app.command()(gains)
