"""`skygcs-cli tlog plot`: a flight of one or many vehicles as a figure, or as a page that holds everything itself."""

from __future__ import annotations

from collections.abc import Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING

from skygcs.cli.figure import COLOURS, new_figure, require_matplotlib, save
from skygcs.cli.log_file import opened_log
from skygcs.cli.log_output import Outputs
from skygcs.cli.tlog_cut import check_times
from skygcs.cli.tlog_panels import Style, draw_lines, draw_map, draw_rows, draw_summary
from skygcs.core.geo import Origin
from skygcs.core.mavlink.dialect import Dialect
from skygcs.errors import SkygcsError
from skygcs.tlog.flight import RecordedFlight, VehicleFlight
from skygcs.tlog.selection import Selection

if TYPE_CHECKING:
    from matplotlib.figure import Figure

WIDTH_IN = 13.0
MAP_IN = 6.2
TABLE_IN = 1.8
"""Instead of the map where no vehicle told a position."""

LINES_IN = 1.7
ROW_IN = 0.2
"""Of one vehicle in the bands of modes and links: one line of small print."""

EDGE_IN = 0.75
"""Of each panel besides: title, ticks."""

MORE_COLOURS = ("#56B4E9", "#7A4B1E", "#222222", "#8A2BE2")
"""Beyond those of `figure`: nine vehicles that can be told apart on white."""

LINE_STYLES = ("-", "--", ":", "-.")
"""From the tenth vehicle on."""

MOST_DRAWN = len(LINE_STYLES) * (len(COLOURS) + len(MORE_COLOURS))


def read_flight(
    path: Path, selection: Selection, origin: Origin | None, dialect: Dialect
) -> tuple[RecordedFlight, list[str]]:
    """What the selected part of a log tells, and the log's faults. Raises SkygcsError if it has no vehicle."""
    with opened_log(path, dialect) as log:
        check_times(log, selection)
        flight = RecordedFlight(dialect, origin)
        for entry in log.entries():
            if selection.in_time(entry):
                if selection.takes_frame(entry):
                    flight.add(entry)
            elif flight.begin_s is None:
                flight.discover(entry)
        flight.finish()
        log.tell_faults()
        faults = log.faults.lines()
    for key in [key for key, vehicle in flight.vehicles.items() if not vehicle.frames]:
        del flight.vehicles[key]
    if not flight.vehicles:
        raise SkygcsError(f"{path}: no vehicle in what is selected; `tlog info` shows what is there")
    if len(flight.vehicles) > MOST_DRAWN:
        raise SkygcsError(f"{path}: {len(flight.vehicles)} vehicles; choose up to {MOST_DRAWN} with --vehicle")
    return flight, faults


def plot_log(path: Path, out: Path, selection: Selection, place: tuple[float, float] | None, dialect: Dialect) -> str:
    """Write the picture or the page; what to say of it. Raises SkygcsError."""
    require_matplotlib()
    origin = None if place is None else Origin(*place, 0.0)
    flight, faults = read_flight(path, selection, origin, dialect)
    figure = flight_figure(flight, path.name)
    if out.suffix.lower() == ".html":
        from skygcs.cli.tlog_page import page

        with Outputs(force=True) as outputs:
            outputs.open_text(out).write(page(figure, flight, path.name, faults))
    else:
        save(figure, out)
    return f"{out}: {told(flight)}"


def told(flight: RecordedFlight) -> str:
    """The flight in one line."""
    vehicles = len(flight.vehicles)
    span_s = flight.end_s - (flight.begin_s or 0.0)
    return f"{vehicles} vehicle{'s' * (vehicles > 1)}, {span_s:.1f} s"


def flight_figure(flight: RecordedFlight, name: str) -> Figure:
    """Map and table on top, below it one panel for each quantity over one axis of time."""
    vehicles = sorted(flight.vehicles.values(), key=lambda v: (v.sysid, v.compid))
    styles = _styles(vehicles)
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
    outer = figure.add_gridspec(len(heights), 1, height_ratios=heights)
    top = outer[0].subgridspec(1, 2, width_ratios=(1.25, 1))
    if placed:
        draw_map(figure.add_subplot(top[0]), flight, vehicles, styles)
    draw_summary(figure.add_subplot(top[1] if placed else outer[0]), top_in, vehicles, styles)
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
    figure.suptitle(f"{name}: {told(flight)}", fontsize=12)
    return figure


def _styles(vehicles: Sequence[VehicleFlight]) -> dict[str, Style]:
    colours = (*COLOURS, *MORE_COLOURS)
    return {
        vehicle.name: Style(colours[n % len(colours)], LINE_STYLES[n // len(colours)])
        for n, vehicle in enumerate(vehicles)
    }


def _time_label(flight: RecordedFlight) -> str:
    if flight.begin_us is None:
        return "seconds, by the vehicles' own clocks"
    begin_us = flight.begin_us - round((flight.begin_s or 0.0) * 1e6)
    try:
        began = datetime.fromtimestamp(begin_us / 1e6, UTC)
    except (OverflowError, OSError, ValueError):
        return "seconds since the log began"
    return f"seconds since {began:%Y-%m-%d %H:%M:%S} UTC"
