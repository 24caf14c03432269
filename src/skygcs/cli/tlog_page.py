"""A flight's figure as one HTML file that needs nothing else: vehicles can be hidden, and every text is in it."""

from __future__ import annotations

from collections.abc import Sequence
from html import escape
from typing import TYPE_CHECKING

from skygcs.cli.figure import svg
from skygcs.cli.tlog_panels import HEADS, gid, summary_row
from skygcs.tlog.flight import RecordedFlight, VehicleFlight

if TYPE_CHECKING:
    from matplotlib.figure import Figure

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
    """The whole document. Texts of the vehicles are shown as text, whatever they hold."""
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
            "".join(f"<p>{escape(fault)}</p>" for fault in faults) or "<p>Nothing is wrong with it.</p>",
            f"<script>{_SCRIPT}</script></body></html>",
            "",
        ]
    )


Row = tuple[str, str, Sequence[str]]
"""Which vehicle's, a class for the style, the cells."""


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
