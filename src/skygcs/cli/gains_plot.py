"""Step responses of `skygcs-cli gains` as a figure: one panel per axis and plant."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from skygcs.cli.figure import COLOURS, new_figure, save
from skygcs.cli.gains_report import gains_text, step_text
from skygcs.cli.gains_study import Answer

if TYPE_CHECKING:
    from matplotlib.axes import Axes

LINES = ("-", "--", "-.")
LOWEST, HIGHEST = -0.5, 2.2
"""Steps; a response that leaves them is drawn to there."""

CALM = 1.4

PLANT_TEXTS = {"tilt": "tilt angle and vertical acceleration", "thrust": "normalised thrust", "given": "plant gain"}


def draw(answer: Answer, path: Path) -> None:
    """Raises SkygcsError if the file cannot be written."""
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
    room = 0.05 if highest < CALM else 0.45  # for the legend, below what swings
    return max(LOWEST, min(shown) - room), highest


def _shown(step: Answer) -> list[float]:
    """Up to where it leaves the figure."""
    positions: list[float] = step["positions"]
    left = next((n for n, x in enumerate(positions) if not LOWEST <= x <= HIGHEST), len(positions))
    return positions[: left + 1]


def _label(step: Answer) -> str:
    if not step["stable"]:
        return f"{step_text(step)}: unstable"
    return f"{step_text(step)}: overshoot {100 * step['overshoot']:.0f} %"
