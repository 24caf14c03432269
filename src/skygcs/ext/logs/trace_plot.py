"""A control trace as a figure: what was asked, what became of it, and what it cost."""

from __future__ import annotations

import math
from array import array
from dataclasses import dataclass, field
from itertools import groupby
from pathlib import Path
from typing import TYPE_CHECKING

from skygcs.cli.figure import COLOURS, new_figure, require_matplotlib, save
from skygcs.core.control.gains import ControlConfig
from skygcs.core.control.trace import CONTROL_MODES, TraceRow
from skygcs.errors import SkygcsError
from skygcs.ext.logs.trace_figures import (
    MOST_ROWS,
    TraceFigures,
    age_ms,
    error_m,
    figures_line,
    found,
    trace_figures,
    wanted,
)
from skygcs.tlog.trace_file import read_trace

if TYPE_CHECKING:
    from matplotlib.axes import Axes

AXES = "xyz"
MODE_COLOURS = {"attitude": "#E3F1FA", "velocity": "#FFF1DA", "position": "#ECECEC", None: "#FBE3EC"}
"""Backgrounds, light enough for the curves and their grid."""

MODE_WORDS = {"attitude": "attitude: all loops here", "velocity": "velocity: position loop here"}
MODE_WORDS |= {"position": "position: no loop here"}
NOTHING_SENT = "nothing sent"

REFERENCE, ESTIMATE, THIRD = "#555555", COLOURS[0], COLOURS[1]

PAUSE_S = 1.0
"""A longer gap between two rows is drawn as one: nothing was controlled in it."""


@dataclass
class Columns:
    """The rows that are drawn, as columns; NaN where a cell was empty. Times are since the trace began."""

    vehicle: str
    rows: int = 0
    t: array[float] = field(default_factory=lambda: array("d"))
    control_mode: list[str | None] = field(default_factory=list)
    reference: tuple[array[float], ...] = field(default_factory=lambda: _doubles(3))
    estimate: tuple[array[float], ...] = field(default_factory=lambda: _doubles(3))
    followed: array[float] = field(default_factory=lambda: array("d"))
    """Distance to the reference, of the axes whose position counts."""
    thrust: array[float] = field(default_factory=lambda: array("d"))
    tilt_deg: array[float] = field(default_factory=lambda: array("d"))
    age_ms: array[float] = field(default_factory=lambda: array("d"))
    dt_ms: array[float] = field(default_factory=lambda: array("d"))
    limited: list[tuple[str, ...]] = field(default_factory=list)
    config_changes: list[float] = field(default_factory=list)
    config: ControlConfig | None = None

    def add(self, t_s: float, row: TraceRow) -> None:
        self.rows += 1
        if self.t and t_s - self.t[-1] > PAUSE_S:
            self._add(self.t[-1] + 1e-3, _EMPTY)
        self._add(t_s, row)

    def use(self, t_s: float, config: ControlConfig) -> None:
        """The config of the row just added; limits are drawn as they were at last."""
        if self.config is not None and config != self.config:
            self.config_changes.append(t_s)
        self.config = config

    def _add(self, t_s: float, row: TraceRow) -> None:
        self.t.append(t_s)
        self.control_mode.append(row.control_mode)
        reference, estimate = wanted(row), found(row)
        for axis in range(3):
            self.reference[axis].append(reference[axis])
            self.estimate[axis].append(estimate[axis])
        self.followed.append(error_m(row))
        self.thrust.append(math.nan if row.thrust is None else row.thrust)
        self.tilt_deg.append(_tilt_deg(row))
        self.age_ms.append(age_ms(row))
        self.dt_ms.append(1e3 * row.dt_s)
        self.limited.append(row.saturation)


def draw(file: Path, path: Path, begin_s: float, end_s: float) -> TraceFigures:
    """Raises SkygcsError if the trace cannot be read, has no row in that time, or the figure cannot be written."""
    require_matplotlib()
    columns, cut_line = _read(file, begin_s, end_s)
    span_s = columns.t[-1] - columns.t[0]
    measured = trace_figures(columns.rows, span_s, columns.followed, columns.age_ms, cut_line)
    figure = new_figure(11, 11)
    panels = figure.subplots(6, 1, sharex=True, height_ratios=(3, 3, 3, 2, 2.4, 2))
    for axis, panel in enumerate(panels[:3]):
        _draw_axis(panel, columns, axis)
    _draw_error(panels[3], columns, measured)
    _draw_effort(panels[4], columns)
    _draw_ages(panels[5], columns, measured)
    for panel in panels:
        _draw_modes(panel, columns)
        panel.grid(color="0.85", linewidth=0.6)
        panel.set_axisbelow(True)
        panel.margins(x=0)
    panels[-1].set_xlabel("time, s")
    figure.suptitle(f"{columns.vehicle}: {figures_line(measured)}", fontsize=11)
    control_modes = _mode_handles(columns)
    if control_modes:
        figure.legend(
            handles=control_modes, loc="outside lower center", ncols=len(control_modes), fontsize=8, frameon=False
        )
    figure.align_ylabels(list(panels))
    save(figure, path)
    return measured


# --- the panels ------------------------------------------------------------------------------------------------------


def _draw_axis(panel: Axes, columns: Columns, axis: int) -> None:
    panel.plot(columns.t, columns.estimate[axis], color=ESTIMATE, linewidth=1.5, label="estimate")
    panel.plot(columns.t, columns.reference[axis], "--", color=REFERENCE, linewidth=1.3, label="reference")
    panel.set_ylabel(f"{AXES[axis]}, m")
    low, high = panel.get_ylim()
    if high - low < 0.5:  # else a vehicle that stands still looks as if it did not
        middle = (low + high) / 2
        panel.set_ylim(middle - 0.25, middle + 0.25)
    if axis == 0:
        _legend_above(panel)
        for t in columns.config_changes:
            panel.annotate(
                *("new gains", (t, 0)),
                xycoords=("data", "axes fraction"),
                xytext=(-2, 4),
                textcoords="offset points",
                ha="right",
                rotation=90,
                fontsize=8,
                color="0.3",
            )


def _draw_error(panel: Axes, columns: Columns, measured: TraceFigures) -> None:
    panel.plot(columns.t, columns.followed, color=THIRD, linewidth=1.3)
    if not math.isnan(measured.rms_error_m):
        panel.axhline(measured.rms_error_m, color=THIRD, linewidth=0.9, linestyle=":")
        _note(panel, f"rms {measured.rms_error_m:.2f} m", measured.rms_error_m, THIRD)
    panel.set_ylabel("error, m")
    panel.set_ylim(bottom=0)


def _draw_effort(panel: Axes, columns: Columns) -> None:
    panel.plot(columns.t, columns.thrust, color=COLOURS[2], linewidth=1.2)
    panel.set_ylim(0, 1)
    panel.set_ylabel("thrust, 0..1", color=COLOURS[2])
    assert columns.config is not None
    for value, word in ((columns.config.hover_thrust, "hover"), (columns.config.thrust_max, "")):
        panel.axhline(value, color=COLOURS[2], linewidth=0.8, linestyle=":")
        _note(panel, word, value, COLOURS[2])
    right = panel.twinx()
    right.plot(columns.t, columns.tilt_deg, color=COLOURS[3], linewidth=1.2)
    tilt_max_deg = math.degrees(columns.config.tilt_max_rad)
    right.axhline(tilt_max_deg, color=COLOURS[3], linewidth=0.8, linestyle=":")
    right.set_ylabel("tilt, °", color=COLOURS[3])
    # the same five lines of the grid on both sides
    right.set_ylim(0, max(10.0, 10 * math.ceil(1.25 * tilt_max_deg / 10)))
    limited = [t for t, names in zip(columns.t, columns.limited, strict=True) if names]
    if limited:
        panel.plot(limited, [0.03] * len(limited), "|", color="#A00000", markersize=5)
        names = ", ".join(dict.fromkeys(name for names in columns.limited for name in names))
        panel.set_title(f"limits reached (|): {names}", loc="left", fontsize=8, color="#A00000", pad=3)


def _draw_ages(panel: Axes, columns: Columns, measured: TraceFigures) -> None:
    panel.plot(columns.t, columns.age_ms, color=COLOURS[0], linewidth=0.9, label="age of the state")
    panel.plot(columns.t, columns.dt_ms, color=COLOURS[4], linewidth=0.9, label="time between steps")
    panel.set_ylabel("ms")
    panel.set_ylim(0, 1.3 * _nearly_most([*columns.age_ms, *columns.dt_ms]))
    _legend_above(panel)


def _draw_modes(panel: Axes, columns: Columns) -> None:
    begin = 0
    for control_mode, run in groupby(columns.control_mode):
        end = begin + len(list(run))
        right = columns.t[end] if end < len(columns.t) else columns.t[-1]
        panel.axvspan(columns.t[begin], right, color=MODE_COLOURS[control_mode], linewidth=0, zorder=0)
        if begin:
            panel.axvline(columns.t[begin], color="0.6", linewidth=0.7, zorder=0.5)
        begin = end
    for t in columns.config_changes:
        panel.axvline(t, color="0.3", linewidth=0.8, linestyle="-.", zorder=0.5)


def _mode_handles(columns: Columns) -> list[object]:
    from matplotlib.patches import Patch

    there = set(columns.control_mode)
    known = [control_mode for control_mode in (*CONTROL_MODES, None) if control_mode in there]
    return [
        Patch(
            facecolor=MODE_COLOURS[control_mode],
            edgecolor="0.6",
            linewidth=0.5,
            label=MODE_WORDS.get(str(control_mode), NOTHING_SENT),
        )
        for control_mode in known
    ]


def _legend_above(panel: Axes) -> None:
    """Where it covers no curve."""
    panel.legend(fontsize=8, loc="lower right", bbox_to_anchor=(1, 0.97), ncols=2, frameon=False)


def _note(panel: Axes, text: str, y: float, colour: str) -> None:
    """Above a level line, at the right end."""
    panel.annotate(
        *(text, (1, y)),
        xycoords=("axes fraction", "data"),
        xytext=(-3, 2),
        textcoords="offset points",
        ha="right",
        va="bottom",
        fontsize=8,
        color=colour,
    )


# --- the numbers -----------------------------------------------------------------------------------------------------


def _read(file: Path, begin_s: float, end_s: float) -> tuple[Columns, int | None]:
    with read_trace(file) as trace:
        columns = Columns(trace.head.vehicle)
        began: float | None = None
        for entry in trace:
            began = entry.row.t_s if began is None else began
            t_s = entry.row.t_s - began
            if not begin_s <= t_s <= end_s:
                continue
            if columns.rows >= MOST_ROWS:
                raise SkygcsError(f"{file}: more than {MOST_ROWS:,} rows: choose a part with --from and --to")
            columns.add(t_s, entry.row)
            columns.use(t_s, entry.config)
    if not columns.t:
        raise SkygcsError(f"{file}: no row in it" if began is None else f"{file}: no row between --from and --to")
    return columns, trace.cut_line


def _tilt_deg(row: TraceRow) -> float:
    """Between the body's up axis and the vertical."""
    if row.attitude_ned_frd is None:
        return math.nan
    _, x, y, _ = row.attitude_ned_frd
    return math.degrees(math.acos(min(max(1 - 2 * (x * x + y * y), -1.0), 1.0)))


def _nearly_most(values: list[float]) -> float:
    """Return what one value in two hundred exceeds: a single pause does not flatten all the rest."""
    known = sorted(value for value in values if not math.isnan(value))
    return max(known[int(0.995 * (len(known) - 1))], 1.0) if known else 1.0


def _doubles(count: int) -> tuple[array[float], ...]:
    return tuple(array("d") for _ in range(count))


_EMPTY = TraceRow(0.0, math.nan, None, False, None, None, None)
"""Breaks the curves where nothing was controlled."""


# --- the file
