"""What `skygcs-cli gains` prints."""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from skygcs.cli import render
from skygcs.cli.gains_study import Answer, Question, study

if TYPE_CHECKING:
    from rich.console import Console
    from rich.table import Table

TABLE_TIMES_S = (0.5, 1.0, 1.5, 2.0, 3.0, 4.0, 6.0, 8.0, 12.0, 16.0, 20.0, 30.0)


def gains_report(
    question: Question, plot: Path | None = None, json_output: bool = False, *, brief: bool = False
) -> int:
    """Compute, draw, print; 0. ``brief`` prints a line per axis only. Raises SkygcsError if it cannot be drawn."""
    if plot is not None:
        from skygcs.cli.figure import require_matplotlib

        require_matplotlib()
    answer = study(question)
    if plot is not None:
        from skygcs.cli.gains_plot import draw

        draw(answer, plot)
    if json_output:
        print(json.dumps(answer))
    elif brief:
        show_brief(answer)
    else:
        show(answer)
        if plot is not None:
            print(f"step responses drawn in {plot}")
    return 0


HINT = """\
Delay is telemetry age plus the setpoint's way up plus attitude lag; skygcs-cli track NAME measures the first two.
Gains for your delay: skygcs-cli gains --delay 0.2     Every table: skygcs-cli gains --full"""


def show_brief(answer: Answer) -> None:
    """A line per axis for normalised thrust, which is what a vehicle flies by, and a hint."""
    console = render.console()
    console.print(f"default gains, hover thrust {answer['hover']:g}, step responses without delay")
    for loop in answer["loops"]:
        if loop["plant"] == "thrust":
            found, step = loop["margins"], loop["steps"][0]
            console.print(
                f"{loop['axis']:<3} {gains_text(answer['gains'][loop['axis']]):<28} stable with up to "
                f"{found['delay_margin_s']:.3f} s of delay, overshoot {100 * step['overshoot']:.0f} %, "
                f"settles in {_settling(step)}"
            )
    console.print(HINT, style="dim")


def show(answer: Answer) -> None:
    """The answer for a person."""
    console = render.console()
    for axis, gains in answer["gains"].items():
        console.print(f"[bold]{axis}[/bold]  {gains_text(gains)}")
    console.print()
    console.print(_loops_table(answer))
    console.print()
    console.print(_margins_table(answer))
    if answer["delay_s"] is not None:
        _show_suggestions(console, answer)
    console.print()
    console.print(_steps_table(answer))
    console.print()
    console.print(_positions_table(answer))
    if any(loop["plant"] == "thrust" for loop in answer["loops"]):
        console.print(
            "\nPlant thrust (G = g/hover) is what normalised thrust does: fly by it. "
            "Plant tilt is the UTIAS report's analysis."
        )
    if answer["utias_eq16"] is not None:
        _show_eq16(console, answer["utias_eq16"])


def gains_text(gains: Answer) -> str:
    return f"Kp {gains['pos_p_per_s']:.4g}  Kv {gains['vel_p']:.4g}  Ki {gains['vel_i']:.4g}"


def _table(*columns: str) -> Table:
    from rich.table import Table

    table = Table(box=None, pad_edge=False, header_style="bold")
    for n, column in enumerate(columns):
        table.add_column(column, justify="left" if n < 2 else "right")
    return table


def _loops_table(answer: Answer) -> Table:
    table = _table("axis", "plant", "G", "polynomial", "Routh's first column", "poles", "")
    for loop in answer["loops"]:
        table.add_row(
            loop["axis"],
            loop["plant"],
            f"{loop['plant_gain']:.4g}",
            "  ".join(f"{c:.4g}" for c in loop["polynomial"]),
            "  ".join(f"{c:.4g}" for c in loop["routh_first_column"]),
            poles_text(loop["poles"]),
            "stable" if loop["stable"] else "[bold red]UNSTABLE[/bold red]",
        )
    return table


def poles_text(found: Sequence[Answer]) -> str:
    """ "-0.24, -0.75±1.08j": a conjugate pair is told once."""
    texts = (
        f"{pole['re']:.4g}" if pole["im"] == 0 else f"{pole['re']:.4g}±{pole['im']:.4g}j"
        for pole in found
        if pole["im"] >= 0
    )
    return ", ".join(texts)


def _margins_table(answer: Answer) -> Table:
    table = _table("axis", "plant", "crossover", "phase margin", "gain margin", "delay margin")
    delay_s = answer["delay_s"]
    if delay_s is not None:
        table.add_column(f"left with {delay_s:g} s: phase", justify="right")
        table.add_column("gain", justify="right")
    for loop in answer["loops"]:
        table.add_row(loop["axis"], loop["plant"], *_margin_cells(loop, delay_s is not None))
    return table


def _margin_cells(loop: Answer, delayed: bool) -> Iterator[str]:
    found = loop["margins"]
    if found is None:
        yield from ("", "[bold red]none[/bold red]", "", "")
        return
    yield f"{found['crossover_radps']:.3f} rad/s"
    yield f"{found['phase_margin_deg']:.1f}°"
    yield _gain_margin(found)
    yield f"{found['delay_margin_s']:.3f} s"
    if delayed:
        left = loop["margins_with_delay"]
        yield "[bold red]UNSTABLE[/bold red]" if left is None else f"{left['phase_margin_deg']:.1f}°"
        yield "" if left is None else _gain_margin(left)


def _gain_margin(found: Answer) -> str:
    up, down = found["gain_up"], found["gain_down"]
    return f"÷{'∞' if down is None else f'{down:.3g}'} to ×{'∞' if up is None else f'{up:.3g}'}"


def _show_suggestions(console: Console, answer: Answer) -> None:
    delay_s, reserve = answer["delay_s"], answer["reserve"]
    console.print(
        f"\n[bold]For {delay_s:g} s of delay with a reserve of {reserve:g}[/bold] (λ rule: Kp/λ, Kv/λ, Ki/λ²)"
    )
    table = _table("axis", "plant", "λ", "gains", "delay margin", "settles")
    for loop in answer["loops"]:
        suggestion = loop["suggestion"]
        if suggestion is None:
            table.add_row(loop["axis"], loop["plant"], "", "unstable without delay: being slower does not help", "", "")
            continue
        slower = suggestion["factor"] > 1
        gains = gains_text(suggestion["gains"]) if slower else "as they are"
        margin = f"{suggestion['margins']['delay_margin_s']:.3f} s"
        table.add_row(
            loop["axis"], loop["plant"], f"{suggestion['factor']:.3g}", gains, margin, _settling(loop["steps"][-1])
        )
    console.print(table)


def _steps_table(answer: Answer) -> Table:
    how = "continuous" if answer["rate_hz"] is None else f"at {answer['rate_hz']:g} Hz"
    table = _table("axis", "plant", "step response, " + how, "overshoot", "rise 10-90 %", "settles to 5 %")
    table.columns[2].justify = "left"
    for loop, step in _all_steps(answer):
        overshoot = f"{100 * step['overshoot']:.1f} %" if step["stable"] else ""
        rise = f"{step['rise_s']:.2f} s" if step["rise_s"] is not None else ""
        table.add_row(loop["axis"], loop["plant"], step_text(step), overshoot, rise, _settling(step))
    return table


def _all_steps(answer: Answer) -> Iterator[tuple[Answer, Answer]]:
    return ((loop, step) for loop in answer["loops"] for step in loop["steps"])


def step_text(step: Answer) -> str:
    """Which of the responses."""
    delay = f"{step['delay_s']:g} s delay" if step["delay_s"] else "no delay"
    return delay + (", suggested gains" if step["gains"] == "suggested" else "")


def _settling(step: Answer) -> str:
    if not step["stable"]:
        return "[bold red]UNSTABLE[/bold red]"
    if step["settling_s"] is None:
        return f"not in {(len(step['positions']) - 1) * step['every_s']:.0f} s"
    return f"{step['settling_s']:.1f} s"


def _positions_table(answer: Answer) -> Table:
    table = _table("t, s")
    for loop, step in _all_steps(answer):
        short = f"{step['delay_s']:g} s" + (" λ" if step["gains"] == "suggested" else "")
        table.add_column(f"{loop['axis']} {loop['plant']}\n{short}", justify="right")
    longest_s = max(len(step["positions"]) * step["every_s"] for _, step in _all_steps(answer))
    for time_s in TABLE_TIMES_S:
        if time_s < longest_s:
            table.add_row(f"{time_s:g}", *(_position(step, time_s) for _, step in _all_steps(answer)))
    return table


def _position(step: Answer, time_s: float) -> str:
    n = round(time_s / step["every_s"])
    positions = step["positions"]
    return f"{positions[n]:.3f}" if n < len(positions) and abs(positions[n]) < 1e3 else "-"


def _show_eq16(console: Console, rows: Answer) -> None:
    console.print("\n[bold]Eq. 16 of the UTIAS report[/bold]: the polynomial as (s + K'Px) (s² + K'Pv s + K'Iv)")
    table = _table("row", "", "G", "K'Px", "K'Iv", "K'Pv")
    for axis, row in rows.items():
        numbers = (f"{row[key]:.3f}" for key in ("kpx", "kiv", "kpv"))
        table.add_row(axis, "", f"{row['plant_gain']:.4g}", *numbers)
    console.print(table)
    y = rows["y"]
    console.print(
        f"Its y row comes from K'Px = {y['kpx']:.3f}, an unstable pole at {y['unstable_poles'][0]:+.3f} rad/s: G has\n"
        "the wrong sign there. A roll that reduces the error makes the loop of y the same as that of x. The matrix of\n"
        "Eq. 16 does not show the pole because it leaves out the third state, the position itself."
    )
