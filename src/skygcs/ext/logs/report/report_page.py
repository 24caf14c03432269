"""The report as one HTML page that needs no other file and no script. Pure.

Names and texts come from vehicles and files: every one is escaped, characters that turn or hide text are shown as
such, and the page forbids scripts to itself.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from html import escape
from typing import Any

from skygcs.ext.logs.report.day_figures import DayReport, FlightFigures, RadioFigures, VehicleDay
from skygcs.ext.logs.report.report_style import STYLE
from skygcs.ext.logs.report.report_tables import (
    NONE,
    Column,
    FigureTable,
    alarms_table,
    approaches_table,
    clock,
    count,
    dates,
    delays_table,
    events_table,
    files_table,
    flights_table,
    losses_table,
    number,
    radio_signals,
    span,
    summary_table,
    tracking_table,
)
from skygcs.ext.logs.report.svg_drawing import Drawn, curves, ground_map
from skygcs.terminal_text import visible

MARK = '<meta name="generator" content="skygcs-cli report">'
"""The mark within the first bytes of a report: a file with it may be overwritten by another report."""

POLICY = "default-src 'none'; style-src 'unsafe-inline'"

COLOURS = 8
"""Styles ``c0`` to ``c7`` of vehicles in the map of all."""

FEW_COLUMNS = 5
"""A table of no more fits a telephone."""

SHORT = 12
"""Characters that fit half of a telephone's width beside the head of their column."""

MOST_PAIRS = 60
MOST_EVENTS = 400
"""Rows that the page shows; the CSV has all."""


def page(report: DayReport) -> str:
    """The whole document."""
    recorded = math.isfinite(report.begin_s)
    title = f"Field day {dates(report.begin_s, report.end_s)}" if recorded else f"Nothing recorded: {report.title}"
    body = [
        f"<header><h1>{shown(title)}</h1><p>{_subtitle(report)}</p></header>",
        _navigation(report),
        _section("summary", "The day", _summary(report)),
        _section("missing", "What is missing", _list(report.missing)) if report.missing else "",
        _section("margins", "Margins used", _margins(report)) if report.approaches else "",
        _section("radios", "Radios", "".join(map(_radio, report.radios))) if report.radios else "",
        _section("alarms", "Alarms of the daemon", table(alarms_table(report))) if report.alarms else "",
        *(_vehicle(report, number_, day) for number_, day in enumerate(report.vehicles)),
        _others(report),
        _section("files", "Files of the folder", table(files_table(report), style="figures")),
        _section("how", "How the figures are made", _list(HOW)),
    ]
    head = (
        f'<!doctype html>\n<html lang="en"><head><meta charset="utf-8">{MARK}'
        f'<meta http-equiv="Content-Security-Policy" content="{POLICY}">'
        '<meta name="viewport" content="width=device-width, initial-scale=1"><meta name="color-scheme" '
        f'content="light dark"><title>{shown(title)}</title><style>{STYLE}</style></head>'
    )
    return f"{head}\n<body>\n{chr(10).join(part for part in body if part)}\n</body></html>\n"


HOW = (
    "All times are UTC, of the computer that recorded. Heights are above home; paths are in metres along the axes of "
    "the origin.",
    "A flight lasts from arming to disarming. A vehicle is in the air while it says so (EXTENDED_SYS_STATE, or the "
    "state in ArduPilot's heartbeat); one that does not report it counts as in the air while it is armed.",
    "The distance is the length of the path in space; steps below half a metre are noise and do not count.",
    "Losses are gaps in the sequence numbers of a source. A tlog does not record the link of a frame: what came over "
    "two links counts as repeated, and there are no losses per link.",
    "The delay of a command is the time from its first sending to the first COMMAND_ACK, both as recorded: it has both "
    "ways of the link in it. A command that was sent again before its answer counts once.",
    "The separation weighs a distance in height less than one along the ground, as the monitor does; the margin is "
    "half of both wingspans and the errors of both positions, by the fleet file or the defaults. Between "
    "two positions, as recorded, a vehicle is taken to have flown straight on; only vehicles in the air are compared.",
    "Errors of tracking are distances from the reference, as the control loop saw them: an error of the position "
    "itself is not in them.",
)
"""Facts that a reader has to know to believe the figures."""


def shown(value: str) -> str:
    """Text of others as HTML."""
    return escape(visible(value))


def table(figures: FigureTable, *, without: Sequence[str] = (), style: str = "") -> str:
    """The rows as the page shows them; on a narrow screen a row becomes a block of lines."""
    kept = [n for n, column in enumerate(figures.columns) if column.name not in without]
    if not figures.rows or not kept:
        return f'<p class="none">{NONE}</p>'
    heads = "".join(f"<th{_class(figures.columns[n])}>{escape(figures.columns[n].head)}</th>" for n in kept)
    rows = ""
    for at, row in enumerate(figures.rows):
        cells = "".join(_cell(figures.columns[n], row[n]) for n in kept)
        rows += f"<tr{' class=bad' if at in figures.bad else ''}>{cells}</tr>"
    style = style or ("figures" if len(kept) > FEW_COLUMNS else "small")
    return f'<table class="{style}"><thead><tr>{heads}</tr></thead><tbody>{rows}</tbody></table>'


def _cell(column: Column, value: Any) -> str:
    said = column.show(value)
    return f'<td{_class(column, said)} data-head="{escape(column.head)}">{shown(said)}</td>'


def _class(column: Column, said: str = "") -> str:
    """``said``: what the cell shows. On a narrow screen a dash is left out, and a long text has the whole width."""
    words = ["number"] if column.number else []
    if said == NONE:
        words.append("none")
    elif len(said) > SHORT:
        words.append("long")
    return f' class="{" ".join(words)}"' if words else ""


def _section(name: str, title: str, content: str) -> str:
    return f'<section id="{name}"><h2>{shown(title)}</h2>{content}</section>'


def _list(lines: Iterable[str]) -> str:
    return f"<ul>{''.join(f'<li>{shown(line)}</li>' for line in lines)}</ul>"


def _figure(drawing: str, caption: str) -> str:
    return f"<figure>{drawing}<figcaption>{caption}</figcaption></figure>" if drawing else ""


# -- the day


def _subtitle(report: DayReport) -> str:
    if not math.isfinite(report.begin_s):
        return f"No tlog of the folder {shown(report.title)} could be used."
    flights = sum(len(day.flights) + day.flights_left_out for day in report.vehicles)
    air_s = sum(day.air_s for day in report.vehicles)
    words = [
        f"{clock(report.begin_s)} to {clock(report.end_s)} UTC",
        f"{len(report.vehicles)} vehicle{'' if len(report.vehicles) == 1 else 's'}",
        f"{flights} flight{'' if flights == 1 else 's'}, {span(air_s)} in the air",
    ]
    words.append(f"folder {shown(report.title)}")
    if report.plan_name:
        words.append(f"plan {shown(report.plan_name)}")
    return " · ".join(words)


def _navigation(report: DayReport) -> str:
    if len(report.vehicles) < 2:
        return ""
    links = (f'<a href="#v{n}">{shown(day.name)}</a>' for n, day in enumerate(report.vehicles))
    return f"<nav>{''.join(links)}</nav>"


def _summary(report: DayReport) -> str:
    drawn = []
    words = []
    for n, day in enumerate(report.vehicles):
        style = f"c{n % COLOURS}"
        lines = [Drawn(style, f.drawing.track) for f in day.flights if f.drawing is not None]
        drawn += lines
        if lines:
            words.append(f'<span class="key {style}">{shown(day.name)}</span>')
    everything = ground_map("the paths of all vehicles", drawn, ends=False)
    where = ""
    if report.origin is not None:
        where = f'<span class="origin">(0, 0) is {report.origin.lat_deg:.6f}, {report.origin.lon_deg:.6f}</span>'
    overview = _figure(everything, f"{' '.join(words)} {where}")
    return table(summary_table(report)) + (f'<div class="overview">{overview}</div>' if overview else "")


def _margins(report: DayReport) -> str:
    more = len(report.approaches) - MOST_PAIRS
    rest = f'<p class="none">and {more:,} more pairs, farther from their margin</p>' if more > 0 else ""
    return table(approaches_table(report, MOST_PAIRS)) + rest


def _radio(radio: RadioFigures) -> str:
    name = f"Radio {radio.sysid}/{radio.compid}"
    facts = (
        f"{count(radio.reports)} reports, {count(radio.receive_errors)} receive errors; buffer free: median "
        f"{number(0, ' %')(radio.median_txbuf_percent)}, least {number(0, ' %')(radio.least_txbuf_percent)}"
    )
    signals = [Drawn("c0", radio.rssi_line), Drawn("c1", radio.noise_line)]
    drawings = _figure(
        curves("signal and noise", signals, "", least_span=20.0),
        '<span class="key c0">RSSI</span> <span class="key c1">noise</span>, counts of the radio',
    ) + _figure(
        curves("free part of the buffer", [Drawn("c2", radio.txbuf_line)], " %", limits=(0.0, 105.0)),
        "free part of the buffer (txbuf)",
    )
    return f'<h3>{name}</h3><p>{facts}</p>{table(radio_signals(radio))}<div class="drawings">{drawings}</div>'


def _others(report: DayReport) -> str:
    """Sources and traces that belong to no vehicle of the report."""
    found = ""
    if report.other_traces:
        found += f"<h3>Tracking errors</h3>{table(tracking_table(report.other_traces))}"
    if report.other_sources:
        sources = losses_table(("", source) for source in report.other_sources)
        found += f"<h3>Losses per source</h3>{table(sources, without=('vehicle',))}"
    return _section("others", "Other sources and traces", found) if found else ""


# -- one vehicle

OWN = ("vehicle",)
"""Column that is left out where all rows are one vehicle's."""


def _vehicle(report: DayReport, at: int, day: VehicleDay) -> str:
    facts = [day.kind, day.firmware or "firmware not reported", f"system {day.key[0]}, component {day.key[1]}"]
    facts.append(f"heard from {clock(day.first_s)} to {clock(day.last_s)}")
    if day.reboots:
        facts.append(f"{day.reboots} reboot{'' if day.reboots == 1 else 's'}")
    parts = [f"<p>{shown(' · '.join(facts))}</p>", _flights(report, day)]
    if day.traces:
        parts.append(f"<h3>Tracking errors</h3>{table(tracking_table(day.traces), without=OWN)}")
    if day.delays:
        parts.append(f"<h3>Delays of commands</h3>{table(delays_table([day]), without=OWN)}")
    if day.sources:
        losses = losses_table((day.name, source) for source in day.sources)
        parts.append(f"<h3>Losses per source</h3>{table(losses, without=OWN)}")
    parts.append(_events(day))
    return _section(f"v{at}", day.name, "".join(parts))


def _flights(report: DayReport, day: VehicleDay) -> str:
    """Table and drawings of the flights."""
    plan = [] if day.plan is None else [Drawn("plan", day.plan)]
    beside = bool(plan) and report.plan_own_origin
    if not day.flights:
        drawn = _figure(ground_map("the plan", plan), _plan_caption(day)) if plan else ""
        return f'<h3>Flights</h3><p class="none">None.</p><div class="drawings">{drawn}</div>'
    found = f"<h3>Flights</h3>{table(flights_table([day]), without=OWN)}"
    if day.flights_left_out:
        found += f'<p class="none">and {day.flights_left_out:,} more, which are not in the report</p>'
    if beside:
        drawn = _figure(ground_map("the plan", plan), f"{_plan_caption(day)}, about the plan's own origin")
        found += f'<div class="drawings">{drawn}</div>'
    return found + "".join(_flight(flight, [] if beside else plan) for flight in day.flights)


def _plan_caption(day: VehicleDay) -> str:
    heights = ""
    if day.plan_heights_m is not None:
        low, high = map(number(1), day.plan_heights_m)
        heights = f", {low} to {high} m high"
    return f'<span class="key plan">plan</span>{heights}'


def _flight(flight: FlightFigures, plan: Sequence[Drawn]) -> str:
    drawing = flight.drawing
    head = f"<h4>Flight {flight.number}, {clock(flight.begin_s)}, {span(flight.air_s)} in the air</h4>"
    if drawing is None:
        return ""
    path = '<span class="key flown">flown</span>, ○ first, ■ last place'
    if plan:
        path = f'<span class="key plan">plan</span> {path}'
    drawings = (
        _figure(ground_map("the flown path", [*plan, Drawn("flown", drawing.track)]), f"path, m: {path}"),
        _figure(curves("height", [Drawn("flown", drawing.height)], " m"), "height above home"),
        _figure(
            curves("battery, percent", [Drawn("flown", drawing.percent)], " %", limits=(0.0, 105.0)), "battery, charge"
        ),
        _figure(curves("battery, volts", [Drawn("flown", drawing.volts)], " V", least_span=0.5), "battery, voltage"),
    )
    return f'<article>{head}<div class="drawings">{"".join(drawings)}</div></article>'


def _events(day: VehicleDay) -> str:
    found = "<h3>Events</h3>"
    for trouble, title in ((True, "trouble"), (False, "modes, arming and other texts")):
        figures = events_table([day], trouble=trouble)
        more = len(figures.rows) - MOST_EVENTS
        if more > 0:
            figures = FigureTable(figures.name, figures.columns, figures.rows[:MOST_EVENTS], figures.bad)
        rest = f'<p class="none">and {more:,} more; --csv writes all</p>' if more > 0 else ""
        if figures.rows:
            rows = table(figures, without=OWN, style="events")
            found += f'<h4>{title}</h4><div class="scrolled">{rows}</div>{rest}'
        else:
            found += f'<h4>{title}</h4><p class="none">None.</p>'
    if day.events_left_out:
        found += f'<p class="none">and {day.events_left_out:,} more, which were not kept</p>'
    return found
