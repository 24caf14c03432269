"""Draw the flight of one or many vehicles: a figure, or an HTML page that needs no other file.

Every artist of a vehicle has its name in the ``gid``: the page can hide it.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING, Any

from skygcs.cli.figure import COLOURS, new_figure, require_matplotlib, save, svg
from skygcs.core.geo import Origin
from skygcs.core.mavlink.dialect import Dialect
from skygcs.errors import SkygcsError
from skygcs.ext.logs.curves import Curve
from skygcs.ext.logs.flight import RecordedFlight, VehicleFlight
from skygcs.tlog.files import Outputs, opened_log
from skygcs.tlog.selection import Selection

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

WIDTH_IN = 13.0
MAP_IN = 6.2
TABLE_IN = 1.8
"""Instead of the map if no vehicle reported a position."""

LINES_IN = 1.7
ROW_IN = 0.2
"""Height of a vehicle's row in the panels of modes and links: one line of small print."""

EDGE_IN = 0.75
"""More height of each panel: title, ticks."""

MORE_COLOURS = ("#56B4E9", "#7A4B1E", "#222222", "#8A2BE2")
"""With those of `figure`, nine vehicles have colours that are distinct on white."""

LINE_STYLES = ("-", "--", ":", "-.")
"""From the tenth vehicle on."""

MOST_DRAWN = len(LINE_STYLES) * (len(COLOURS) + len(MORE_COLOURS))


def read_flight(
    path: Path, selection: Selection, origin: Origin | None, dialect: Dialect
) -> tuple[RecordedFlight, list[str]]:
    """The flight in the selected part of a log, and the log's faults. Raises SkygcsError if it has no vehicle."""
    with opened_log(path, dialect) as log:
        log.check_times(selection)
        flight = RecordedFlight(dialect, origin)
        for entry in log.entries():
            if selection.in_time(entry):
                if selection.takes_frame(entry):
                    flight.add(entry)
            elif flight.begin_s is None:
                flight.discover(entry)
        flight.finish()
        log.print_faults()
        faults = log.faults.lines()
    for key in [key for key, vehicle in flight.vehicles.items() if not vehicle.frames]:
        del flight.vehicles[key]
    if not flight.vehicles:
        raise SkygcsError(f"{path}: no vehicle in the selection; `tlog info` shows what the log holds")
    if len(flight.vehicles) > MOST_DRAWN:
        raise SkygcsError(f"{path}: {len(flight.vehicles)} vehicles; choose up to {MOST_DRAWN} with --vehicle")
    return flight, faults


def plot_log(path: Path, out: Path, selection: Selection, place: tuple[float, float] | None, dialect: Dialect) -> str:
    """Write the figure or the page; returns a line for the user. Raises SkygcsError."""
    require_matplotlib()
    origin = None if place is None else Origin(*place, 0.0)
    flight, faults = read_flight(path, selection, origin, dialect)
    figure = flight_figure(flight, path.name)
    if out.suffix.lower() == ".html":
        with Outputs(force=True) as outputs:
            outputs.open_text(out).write(page(figure, flight, path.name, faults))
    else:
        save(figure, out)
    return f"{out}: {summary_line(flight)}"


def summary_line(flight: RecordedFlight) -> str:
    """The flight in one line."""
    vehicles = len(flight.vehicles)
    span_s = flight.end_s - (flight.begin_s or 0.0)
    return f"{vehicles} vehicle{'s' * (vehicles > 1)}, {span_s:.1f} s"


def flight_figure(flight: RecordedFlight, name: str) -> Figure:
    """Map and table on top, below it one panel for each quantity over one axis of time."""
    vehicles = sorted(flight.vehicles.values(), key=lambda v: (v.sysid, v.compid))
    styles = _styles(vehicles)
    # the panels that have curves, and the heights of all rows
    panels = [
        ("height, m", [v.altitude for v in vehicles]),
        ("battery, %", [v.percent for v in vehicles]),
        ("battery, V", [v.volts for v in vehicles]),
    ]
    panels = [(label, curves) for label, curves in panels if any(curves)]
    rows_in = EDGE_IN + ROW_IN * len(vehicles)
    placed = any(v.track.ends is not None for v in vehicles)
    top_in = MAP_IN if placed else TABLE_IN + ROW_IN * len(vehicles)
    heights = [top_in, *(LINES_IN for _ in panels), rows_in, rows_in]
    figure = new_figure(WIDTH_IN, sum(heights))
    # map and summary on top
    outer = figure.add_gridspec(len(heights), 1, height_ratios=heights)
    top = outer[0].subgridspec(1, 2, width_ratios=(1.25, 1))
    if placed:
        draw_map(figure.add_subplot(top[0]), flight, vehicles, styles)
    draw_summary(figure.add_subplot(top[1] if placed else outer[0]), top_in, vehicles, styles)
    # one panel for each quantity, then modes and links, over one axis of time
    shared = None
    for n, (label, curves) in enumerate(panels):
        panel = figure.add_subplot(outer[n + 1], sharex=shared)
        shared = shared or panel
        draw_lines(panel, label, vehicles, curves, styles)
    for n, what in enumerate(("modes", "link")):
        panel = figure.add_subplot(outer[len(panels) + 1 + n], sharex=shared)
        shared = shared or panel
        draw_rows(panel, flight, vehicles, styles, what)
    begin_s = flight.begin_s or 0.0
    assert shared is not None
    shared.set_xlim(begin_s, max(flight.end_s, begin_s + 1.0))
    figure.axes[-1].set_xlabel(_time_label(flight))
    figure.suptitle(f"{name}: {summary_line(flight)}", fontsize=12)
    return figure


def _styles(vehicles: Sequence[VehicleFlight]) -> dict[str, Style]:
    colours = (*COLOURS, *MORE_COLOURS)
    return {
        vehicle.name: Style(colours[n % len(colours)], LINE_STYLES[n // len(colours)])
        for n, vehicle in enumerate(vehicles)
    }


def _time_label(flight: RecordedFlight) -> str:
    if flight.begin_us is None:
        return "seconds by the vehicles' own clocks"
    begin_us = flight.begin_us - round((flight.begin_s or 0.0) * 1e6)
    try:
        began = datetime.fromtimestamp(begin_us / 1e6, UTC)
    except (OverflowError, OSError, ValueError):
        return "seconds since the log began"
    return f"seconds since {began:%Y-%m-%d %H:%M:%S} UTC"


# --- panels


MODE_COLOURS = (
    *("#9CC9E8", "#F6C28B", "#A5D6A7", "#E3A9C9", "#F2E08A", "#C5B4E3", "#B7C0C7", "#F0A79B"),
    *("#8FD3CB", "#D7CBA8", "#CFE39B", "#DDDDDD"),
)
"""Background of black letters. A log has some five modes; from the thirteenth on the colours repeat, hatched."""

MODE_HATCHES = ("", "////", "....", r"\\\\\\", "xxxx", "||||", "----", "++++")
"""With the colours 96 modes that look different: PX4 has 30, ArduPilot's copters and planes 55 between them."""

MODES_SHOWN = 24
MODES_A_LINE = 12
"""In the legend; the bars have the names as well, where there is room."""

LOSS_COLOURS = ("#E8F3EA", "#FFE08A", "#FF9F43", "#D62728")
"""No loss to a quarter and more."""

LOSS_FULL = 0.25

MAV_SEVERITY_WARNING = 4

ROW_SHARE_IN = 0.3
TEXT_LINE_IN = 0.165
"""Heights of a table's row and of a line of small print."""

LONGEST_TEXT = 66
SILENT_COLOUR = "#303030"
SMALLEST_MAP_M = 4.0
"""In a smaller map the GPS noise of a vehicle at rest would look like a flight."""

GRID: dict[str, Any] = {"color": "0.88", "linewidth": 0.6}
FEW = 60
"""Points that are shown as such: a line through one is not seen."""

LETTER_SHARE = 0.0075
"""Width of one letter of a mode's name, as a share of the axis."""


@dataclass(frozen=True, slots=True)
class Style:
    colour: str
    line: str


def gid(vehicle: VehicleFlight, what: str) -> str:
    return f"v{vehicle.sysid}.{vehicle.compid}-{what}"


# --- the map ---------------------------------------------------------------------------------------------------------


def draw_map(panel: Axes, flight: RecordedFlight, vehicles: Sequence[VehicleFlight], styles: dict[str, Style]) -> None:
    """Tracks of the vehicles that reported a position; there is at least one."""
    placed = [v for v in vehicles if v.track.ends is not None]
    for vehicle in placed:
        _draw_track(panel, vehicle, styles[vehicle.name])
    panel.set_aspect("equal", adjustable="datalim")
    panel.grid(**GRID)
    panel.set_axisbelow(True)
    panel.set_xlabel("east, m")
    panel.set_ylabel("north, m")
    _widen(panel, placed)
    panel.plot(0, 0, "+", color="0.3", markersize=10, zorder=1)
    panel.set_title(_map_title(flight, placed), fontsize=9, loc="left")
    panel.legend(fontsize=8, loc="best", ncols=1 + len(placed) // 10, framealpha=0.85)


def _draw_track(panel: Axes, vehicle: VehicleFlight, style: Style) -> None:
    xs, ys = vehicle.track.line()
    line: dict[str, Any] = dict(color=style.colour, linestyle=style.line, linewidth=1.4, solid_capstyle="round")
    panel.plot(xs, ys, label=f"vehicle {vehicle.name}", gid=gid(vehicle, "track"), **line)
    ends = vehicle.track.ends
    assert ends is not None
    for (x_m, y_m), marker, size in zip(ends, ("o", "s"), (9, 6), strict=True):
        face = "white" if marker == "o" else style.colour
        edge = style.colour if marker == "o" else "white"
        dot: dict[str, Any] = dict(
            markerfacecolor=face, markeredgecolor=edge, markersize=size, markeredgewidth=1.4, zorder=3
        )
        panel.plot(x_m, y_m, marker, gid=gid(vehicle, f"end-{marker}"), **dot)


def _widen(panel: Axes, placed: Sequence[VehicleFlight]) -> None:
    xs = [x for v in placed for x in v.track.line()[0] if not math.isnan(x)]
    ys = [y for v in placed for y in v.track.line()[1] if not math.isnan(y)]
    middle_x, middle_y = (min(xs) + max(xs)) / 2, (min(ys) + max(ys)) / 2
    half = SMALLEST_MAP_M / 2
    panel.update_datalim([(middle_x - half, middle_y - half), (middle_x + half, middle_y + half)])
    panel.autoscale_view()


def _map_title(flight: RecordedFlight, placed: Sequence[VehicleFlight]) -> str:
    own = [v.name for v in placed if v.place == "LOCAL_POSITION_NED"]
    text = "○ first, ■ last position"
    if flight.origin is not None and len(own) < len(placed):
        text += f";  + is {flight.origin.lat_deg:.6f}, {flight.origin.lon_deg:.6f}"
    if own:
        text += f";  about its own origin: {', '.join(own)}"
    return text


# --- the table -------------------------------------------------------------------------------------------------------

HEADS = ("vehicle", "kind", "armed", "height", "farthest", "frames", "lost", "silent")


def summary_row(vehicle: VehicleFlight) -> tuple[str, ...]:
    heights = vehicle.altitude.extremes()
    silent_s = sum(end - begin for begin, end in vehicle.silences)
    return (
        vehicle.name,
        f"{vehicle.autopilot} {vehicle.kind.replace('_', ' ')}",
        f"{vehicle.armed_s:.0f} s" if vehicle.armed_s else "–",
        "–" if heights is None else f"{heights[0]:z.1f} … {heights[1]:z.1f} m",
        f"{vehicle.farthest_m:.1f} m" if vehicle.track.ends is not None else "–",
        f"{vehicle.frames:,}",
        f"{100 * vehicle.loss_ratio:.1f} %",
        f"{silent_s:.0f} s" if silent_s else "–",
    )


def draw_summary(panel: Axes, height_in: float, vehicles: Sequence[VehicleFlight], styles: dict[str, Style]) -> None:
    """A table of the vehicles and, if there is room, their warnings below it."""
    from matplotlib.transforms import Bbox

    panel.set_axis_off()
    rows = [summary_row(vehicle) for vehicle in vehicles]
    widths = [max(len(row[n]) for row in (HEADS, *rows)) + 2 for n in range(len(HEADS))]
    total = sum(widths)
    high = ROW_SHARE_IN * (len(rows) + 1) / height_in
    table = panel.table(
        cellText=rows,
        colLabels=HEADS,
        colWidths=[width / total for width in widths],
        loc="upper left",
        cellLoc="left",
        edges="horizontal",
        colLoc="left",
        bbox=Bbox.from_bounds(0, 1 - high, 1, high),
    )
    table.auto_set_font_size(False)
    table.set_fontsize(8)
    for (row, column), cell in table.get_celld().items():
        cell.set_edgecolor("0.85")
        if row == 0:
            cell.set_text_props(color="0.35")
        elif column == 0:
            cell.set_text_props(color=styles[vehicles[row - 1].name].colour, weight="bold")
    _draw_warnings(panel, height_in, high, vehicles, styles)


def _draw_warnings(
    panel: Axes, height_in: float, used: float, vehicles: Sequence[VehicleFlight], styles: dict[str, Style]
) -> None:
    warned = _warnings(vehicles)
    line = TEXT_LINE_IN / height_in
    room = int((1 - used) / line) - 3
    if not warned or room < 1:
        return
    shown = warned if len(warned) <= room else warned[: room - 1]
    y = 1 - used - 2 * line
    small: dict[str, Any] = dict(fontsize=7, va="top", clip_on=True)
    panel.text(0, y, "warnings: first time in s, vehicle, text", color="0.35", **small)
    for at_s, name, text, count in shown:
        y -= line
        panel.text(0.075, y, f"{at_s:.1f}", ha="right", color="0.35", **small)
        panel.text(0.1, y, name, color=styles[name].colour, weight="bold", **small)
        panel.text(0.16, y, _plain(text) + (f"  ×{count}" if count > 1 else ""), **small)
    if len(shown) < len(warned):
        panel.text(0.16, y - line, f"… and {len(warned) - len(shown)} more", color="0.35", **small)


def _warnings(vehicles: Sequence[VehicleFlight]) -> list[tuple[float, str, str, int]]:
    """First time, vehicle, text and count of each warning."""
    found: dict[tuple[str, str], tuple[float, int]] = {}
    for vehicle in vehicles:
        for text in vehicle.texts:
            if text.severity <= MAV_SEVERITY_WARNING:
                first_s, count = found.get((vehicle.name, text.text), (text.at_s, 0))
                found[vehicle.name, text.text] = first_s, count + 1
    return sorted((first_s, name, text, count) for (name, text), (first_s, count) in found.items())


def _plain(text: str) -> str:
    """The text as a line that is not too long."""
    text = "".join(c if c.isprintable() else "·" for c in text)
    return text if len(text) <= LONGEST_TEXT else text[: LONGEST_TEXT - 1] + "…"


# --- over time -------------------------------------------------------------------------------------------------------


def draw_lines(
    panel: Axes, label: str, vehicles: Sequence[VehicleFlight], curves: Sequence[Curve], styles: dict[str, Style]
) -> None:
    for vehicle, curve in zip(vehicles, curves, strict=True):
        if curve:
            style = styles[vehicle.name]
            line: dict[str, Any] = dict(color=style.colour, linestyle=style.line, linewidth=1.2)
            times, values = curve.points()
            if len(times) < FEW:
                line |= dict(marker=".", markersize=4)
            panel.plot(times, values, gid=gid(vehicle, label.partition(",")[0]), **line)
    panel.set_ylabel(label)
    panel.grid(**GRID)
    panel.set_axisbelow(True)
    if label.endswith("%"):
        panel.set_ylim(-2, 104)
    else:
        low, high = panel.get_ylim()
        if high - low < 1.0:  # else noise looks like a flight
            panel.set_ylim((low + high) / 2 - 0.5, (low + high) / 2 + 0.5)
    panel.tick_params(labelbottom=False)


def draw_rows(
    panel: Axes, flight: RecordedFlight, vehicles: Sequence[VehicleFlight], styles: dict[str, Style], what: str
) -> None:
    """One row for each vehicle, the first on top: its modes, or what its link lost."""
    if what == "modes":
        _draw_modes(panel, flight, vehicles)
        panel.tick_params(labelbottom=False)
    else:
        _draw_links(panel, flight, vehicles)
    panel.set_ylim(len(vehicles) - 0.5, -0.5)
    panel.set_yticks(range(len(vehicles)), [v.name for v in vehicles], fontsize=8)
    for tick, vehicle in zip(panel.get_yticklabels(), vehicles, strict=True):
        tick.set_color(styles[vehicle.name].colour)
        tick.set_fontweight("bold")
    panel.tick_params(axis="y", length=0)
    panel.set_ylabel(what)


def _draw_modes(panel: Axes, flight: RecordedFlight, vehicles: Sequence[VehicleFlight]) -> None:
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

    modes = list(dict.fromkeys(span.mode for vehicle in vehicles for span in vehicle.modes))
    looks = _looks(modes)
    # a row of bars for each vehicle, with names where there is room
    letter_s = LETTER_SHARE * max(flight.end_s - (flight.begin_s or 0.0), 1.0)
    for row, vehicle in enumerate(vehicles):
        for hatch in MODE_HATCHES:
            spans = [(span, end_s) for span, end_s in vehicle.spans() if looks[span.mode][1] == hatch]
            bars = [(span.begin_s, end_s - span.begin_s) for span, end_s in spans]
            hatched: dict[str, Any] = dict(hatch=hatch, edgecolor="#FFFFFFB0") if hatch else {}
            _draw_bars(panel, row, bars, [looks[span.mode][0] for span, _ in spans], gid(vehicle, "mode"), **hatched)
        for mode, begin_s, end_s in _runs(vehicle):
            left_s, right_s = _longest_heard(begin_s, end_s, vehicle.silences)
            if right_s - left_s > letter_s * (len(mode) + 1):
                words: dict[str, Any] = dict(fontsize=7, va="center", ha="center", clip_on=True)
                panel.text((left_s + right_s) / 2, row, mode, gid=gid(vehicle, "mode-name"), **words)
        for begin_s, end_s in _armed(vehicle):
            line: dict[str, Any] = dict(color="#B00000", linewidth=2.2, solid_capstyle="butt")
            panel.plot((begin_s, end_s), (row + 0.36, row + 0.36), gid=gid(vehicle, "armed"), **line)
        # its mode is not known while it was silent
        veils = [(begin_s, end_s - begin_s) for begin_s, end_s in vehicle.silences]
        _draw_bars(panel, row, veils, ["white"] * len(veils), gid(vehicle, "veil"), alpha=0.8, zorder=3)
    # the legend
    handles: list[Any] = [
        Patch(facecolor=looks[mode][0], hatch=looks[mode][1], edgecolor="#FFFFFFB0", linewidth=0, label=mode)
        for mode in modes[:MODES_SHOWN]
    ]
    if len(modes) > MODES_SHOWN:
        handles.append(Patch(facecolor="none", label=f"and {len(modes) - MODES_SHOWN} more"))
    handles.append(Line2D([], [], color="#B00000", linewidth=2.2, label="armed"))
    _legend_above(panel, handles)


def _looks(modes: Sequence[str]) -> dict[str, tuple[str, str]]:
    """Colour and hatch of each mode; no two alike up to 96."""
    return {
        mode: (MODE_COLOURS[n % len(MODE_COLOURS)], MODE_HATCHES[n // len(MODE_COLOURS) % len(MODE_HATCHES)])
        for n, mode in enumerate(modes)
    }


def _draw_bars(
    panel: Axes, row: int, bars: Sequence[tuple[float, float]], colours: Sequence[Any], name: str, **more: Any
) -> None:
    """Bars (begin, length) in one row, as one artist: an artist for each bar takes a second for nine vehicles."""
    if bars:
        panel.broken_barh(bars, (row - 0.4, 0.8), facecolors=list(colours), linewidth=0, gid=name, **more)


def _runs(vehicle: VehicleFlight) -> list[tuple[str, float, float]]:
    """Modes with their times; arming alone does not begin a new one."""
    runs: list[tuple[str, float, float]] = []
    for span, end_s in vehicle.spans():
        if runs and runs[-1][0] == span.mode:
            runs[-1] = (span.mode, runs[-1][1], end_s)
        else:
            runs.append((span.mode, span.begin_s, end_s))
    return runs


def _longest_heard(begin_s: float, end_s: float, silences: Sequence[tuple[float, float]]) -> tuple[float, float]:
    """The longest part of a span without silence: the place for the mode's name."""
    best, at_s = (begin_s, begin_s), begin_s
    for silent_s, heard_s in [*(s for s in silences if s[0] < end_s and s[1] > begin_s), (end_s, end_s)]:
        if silent_s - at_s > best[1] - best[0]:
            best = at_s, silent_s
        at_s = heard_s
    return best


def _armed(vehicle: VehicleFlight) -> list[tuple[float, float]]:
    times: list[tuple[float, float]] = []
    for span, end_s in vehicle.spans():
        if not span.armed:
            continue
        if times and times[-1][1] == span.begin_s:
            times[-1] = (times[-1][0], end_s)
        else:
            times.append((span.begin_s, end_s))
    return times


def _draw_links(panel: Axes, flight: RecordedFlight, vehicles: Sequence[VehicleFlight]) -> None:
    from matplotlib.colors import LinearSegmentedColormap
    from matplotlib.patches import Patch

    shades = LinearSegmentedColormap.from_list("loss", LOSS_COLOURS)
    span_s = flight.end_s - (flight.begin_s or 0.0)
    for row, vehicle in enumerate(vehicles):
        curve = vehicle.loss
        width_s = curve.pieces(span_s / 150) * curve.width_s
        ratios = [(n * width_s, ratio) for n, ratio in enumerate(curve.ratios(span_s / 150)) if ratio is not None]
        lefts = [(max(left_s, vehicle.first_s), min(left_s + width_s, flight.end_s)) for left_s, _ in ratios]
        bars = [(left_s, max(right_s - left_s, 0.0)) for left_s, right_s in lefts]
        _draw_bars(panel, row, bars, [shades(_shade(ratio)) for _, ratio in ratios], gid(vehicle, "loss"))
        silences = [(begin_s, end_s - begin_s) for begin_s, end_s in vehicle.silences]
        _draw_bars(panel, row, silences, [SILENT_COLOUR] * len(silences), gid(vehicle, "silent"))
    words = {0.0: "no loss", 0.02: "2 %", 0.1: "10 %", LOSS_FULL: f"{100 * LOSS_FULL:.0f} % and more lost"}
    handles = [Patch(facecolor=shades(_shade(ratio)), label=text) for ratio, text in words.items()]
    _legend_above(panel, [*handles, Patch(facecolor=SILENT_COLOUR, label="silent for 3 s and more")])


def _shade(ratio: float) -> float:
    """Small losses differ most."""
    return math.sqrt(min(ratio / LOSS_FULL, 1.0))


def _legend_above(panel: Axes, handles: Sequence[Any]) -> None:
    """Where it covers nothing."""
    columns = min(len(handles), MODES_A_LINE + 1)
    place: dict[str, Any] = dict(loc="lower right", bbox_to_anchor=(1, 0.98), ncols=columns, columnspacing=1.2)
    panel.legend(handles=handles, fontsize=7.5, frameon=False, handlelength=1.2, **place)


# --- the page

SEVERITIES = ("emergency", "alert", "critical", "error", "warning", "notice", "info", "debug")
"""MAV_SEVERITY."""

_STYLE = """
body { font: 14px/1.4 system-ui, sans-serif; margin: 1.5em auto; max-width: 1300px; padding: 0 1em; color: #222 }
h1 { font-size: 1.3em } h2 { font-size: 1.05em; margin-top: 1.6em }
svg { width: 100%; height: auto }
table { border-collapse: collapse } td, th { text-align: left; padding: .15em .9em .15em 0; vertical-align: top }
tr { border-bottom: 1px solid #e4e4e4 } th { color: #666; font-weight: normal }
td.number { text-align: right; font-variant-numeric: tabular-nums }
tr.s0, tr.s1, tr.s2, tr.s3 { color: #b00000 } tr.s4 { color: #9a5b00 } tr.s7 { color: #888 }
label { margin-right: 1em; white-space: nowrap }
.bar { position: sticky; top: 0; background: #fffffff0; padding: .5em 0 }
@media print { .bar { display: none } }
"""

_SCRIPT = """
const show = (box) => {
  const id = box.dataset.id;
  for (const part of document.querySelectorAll(`[id^="${id}"]`)) part.style.display = box.checked ? "" : "none";
  for (const row of document.querySelectorAll(`tr[data-id="${id}"]`)) row.hidden = !box.checked;
};
const boxes = [...document.querySelectorAll("input[data-id]")];
for (const box of boxes) box.addEventListener("change", () => show(box));
document.getElementById("all").addEventListener("click", () => boxes.forEach((b) => { b.checked = true; show(b); }));
document.getElementById("none").addEventListener("click", () => boxes.forEach((b) => { b.checked = false; show(b); }));
"""


def page(figure: Figure, flight: RecordedFlight, name: str, faults: Sequence[str]) -> str:
    """The whole document: the figure, whose vehicles can be hidden, tables and texts. Texts are escaped."""
    vehicles = sorted(flight.vehicles.values(), key=lambda v: (v.sysid, v.compid))
    return "\n".join(
        [
            "<!doctype html>",
            f'<html lang="en"><head><meta charset="utf-8"><title>{escape(name)}</title>',
            f"<style>{_STYLE}</style></head><body>",
            f"<h1>{escape(name)}</h1>",
            _bar(vehicles),
            svg(figure),
            "<h2>Vehicles</h2>",
            _table(HEADS, [(gid(v, ""), "", summary_row(v)) for v in vehicles]),
            "<h2>Modes</h2>",
            _table(("time, s", "vehicle", "mode", ""), _mode_rows(vehicles)),
            "<h2>Texts</h2>",
            _table(("time, s", "vehicle", "", "text"), _text_rows(vehicles)),
            "<h2>The log</h2>",
            "".join(f"<p>{escape(fault)}</p>" for fault in faults) or "<p>No faults.</p>",
            f"<script>{_SCRIPT}</script></body></html>",
            "",
        ]
    )


Row = tuple[str, str, Sequence[str]]
"""gid of the vehicle, class for the style, cells."""


def _bar(vehicles: Sequence[VehicleFlight]) -> str:
    boxes = "".join(
        f'<label><input type="checkbox" checked data-id="{gid(v, "")}"> {escape(v.name)}</label>' for v in vehicles
    )
    return f'<div class="bar">{boxes}<button id="all">all</button> <button id="none">none</button></div>'


def _table(heads: Sequence[str], rows: Sequence[Row]) -> str:
    if not rows:
        return "<p>None.</p>"
    head = "".join(f"<th>{escape(text)}</th>" for text in heads)
    return f"<table><tr>{head}</tr>{''.join(map(_row, rows))}</table>"


def _row(row: Row) -> str:
    owner, style, cells = row
    number = ' class="number"' if style else ""
    first, *rest = cells
    filled = f"<td{number}>{escape(first)}</td>" + "".join(f"<td>{escape(cell)}</td>" for cell in rest)
    return f'<tr data-id="{owner}" class="{style}">{filled}</tr>'


def _mode_rows(vehicles: Sequence[VehicleFlight]) -> list[Row]:
    spans = sorted(((span, v) for v in vehicles for span in v.modes), key=lambda found: found[0].begin_s)
    return [
        (gid(v, ""), "mode", (f"{span.begin_s:.1f}", v.name, span.mode, "armed" if span.armed else ""))
        for span, v in spans
    ]


def _text_rows(vehicles: Sequence[VehicleFlight]) -> list[Row]:
    texts = sorted(((text, v) for v in vehicles for text in v.texts), key=lambda found: found[0].at_s)
    return [
        (gid(v, ""), f"s{text.severity}", (f"{text.at_s:.1f}", v.name, _severity(text.severity), text.text))
        for text, v in texts
    ]


def _severity(severity: int) -> str:
    return SEVERITIES[severity] if severity < len(SEVERITIES) else str(severity)
