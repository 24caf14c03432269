"""Curves and maps as SVG elements for a page: no script, no file beside it; colours come from the page's style. Pure.

A panel is 360 units wide, about what a telephone shows, so that its letters have the size of the page's small print.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from datetime import UTC, datetime
from html import escape
from typing import NamedTuple

from skygcs.ext.logs.report.day_figures import Line
from skygcs.spelling import rounded

WIDTH, CURVE_HEIGHT, MAP_HEIGHT = 360.0, 170.0, 300.0
LEFT, RIGHT, TOP, BOTTOM = 44.0, 8.0, 8.0, 22.0
"""Margins about the axes."""

MAP_MARGIN = 26.0
SMALLEST_MAP_M = 4.0
"""In a smaller map the noise of a vehicle at rest would look like a flight."""

TICKS_X, TICKS_Y = 4, 4

STEPS_S = (1, 2, 5, 10, 15, 30, 60, 120, 300, 600, 900, 1800, 3600, 7200, 14_400, 21_600, 43_200, 86_400)
"""Between the ticks of an axis of time."""


class Drawn(NamedTuple):
    """A line with the class of its style: ``flown``, ``plan``, ``c0`` to ``c7``."""

    style: str
    line: Line


class _Scale(NamedTuple):
    """From values to units of the panel."""

    low: float
    high: float
    first: float
    last: float

    def at(self, value: float) -> float:
        return self.first + (value - self.low) / (self.high - self.low) * (self.last - self.first)


def curves(
    label: str, drawn: Sequence[Drawn], unit: str, *, limits: tuple[float, float] | None = None, least_span: float = 1.0
) -> str:
    """A panel of curves over time of day (UTC); empty without any value. ``limits``: of the ordinate, else what the
    values need, and at least ``least_span``: noise shall not look like a flight."""
    times = _finite(x for _, (xs, _) in drawn for x in xs)
    values = _finite(y for _, (_, ys) in drawn for y in ys)
    if not times or not values:
        return ""
    low, high = limits or _widened(min(values), max(values), least_span)
    begin_s, end_s = min(times), max(max(times), min(times) + 1.0)
    across = _Scale(begin_s, end_s, LEFT, WIDTH - RIGHT)
    up = _Scale(low, high, CURVE_HEIGHT - BOTTOM, TOP)
    parts = [_rows(ticks(low, high, TICKS_Y), up, unit), _columns(begin_s, end_s, across)]
    parts += [_path(one, across, up) for one in drawn]
    return _svg(label, CURVE_HEIGHT, parts)


def ground_map(label: str, drawn: Sequence[Drawn], *, ends: bool = True) -> str:
    """A map with the same scale on both axes, in metres; empty without any place. ``ends``: mark the first and the last
    place of flown lines."""
    xs, ys = (_finite(v for _, line in drawn for v in line[axis]) for axis in (0, 1))
    if not xs or not ys:
        return ""
    width, height = WIDTH - LEFT - RIGHT, MAP_HEIGHT - TOP - BOTTOM
    span_x = max(max(xs) - min(xs), SMALLEST_MAP_M)
    span_y = max(max(ys) - min(ys), SMALLEST_MAP_M)
    per_m = min((width - MAP_MARGIN) / span_x, (height - MAP_MARGIN) / span_y)
    middle_x, middle_y = (min(xs) + max(xs)) / 2, (min(ys) + max(ys)) / 2
    half_x, half_y = width / per_m / 2, height / per_m / 2
    across = _Scale(middle_x - half_x, middle_x + half_x, LEFT, WIDTH - RIGHT)
    up = _Scale(middle_y - half_y, middle_y + half_y, MAP_HEIGHT - BOTTOM, TOP)
    step = _step(2 * half_x, TICKS_X)
    parts = [
        _rows(_multiples(up.low, up.high, step), up, " m"),
        *(_column(across.at(x), rounded(x, 2), MAP_HEIGHT) for x in _multiples(across.low, across.high, step)),
    ]
    parts += [_path(one, across, up) for one in drawn]
    if ends:
        parts += [_ends(one, across, up) for one in drawn if one.style != "plan"]
    return _svg(label, MAP_HEIGHT, parts)


def ticks(low: float, high: float, most: int) -> list[float]:
    """Round values from ``low`` to ``high``, about ``most``."""
    return _multiples(low, high, _step(high - low, most))


# -- parts


def _svg(label: str, height: float, parts: Iterable[str]) -> str:
    box = f'viewBox="0 0 {WIDTH:g} {height:g}"'
    return f'<svg {box} role="img" aria-label="{escape(label)}">{"".join(parts)}</svg>'


def _rows(values: Iterable[float], up: _Scale, unit: str) -> str:
    found = []
    for value in values:
        y = up.at(value)
        found.append(f'<line class="grid" x1="{LEFT:g}" x2="{WIDTH - RIGHT:g}" y1="{y:.1f}" y2="{y:.1f}"/>')
        found.append(f'<text class="y" x="{LEFT - 5:g}" y="{y + 3.5:.1f}">{escape(rounded(value, 2) + unit)}</text>')
    return "".join(found)


def _columns(begin_s: float, end_s: float, across: _Scale) -> str:
    step_s = next((s for s in STEPS_S if (end_s - begin_s) / s <= TICKS_X), STEPS_S[-1])
    while (end_s - begin_s) / step_s > TICKS_X:
        step_s *= 2
    form = "%H:%M" if step_s >= 60 else "%H:%M:%S"
    show: Callable[[float], str] = lambda t_s: datetime.fromtimestamp(t_s, UTC).strftime(form)  # noqa: E731
    return "".join(_column(across.at(t), show(t), CURVE_HEIGHT) for t in _multiples(begin_s, end_s, step_s))


def _column(x: float, text: str, height: float) -> str:
    line = f'<line class="grid" x1="{x:.1f}" x2="{x:.1f}" y1="{TOP:g}" y2="{height - BOTTOM:g}"/>'
    return f'{line}<text class="x" x="{min(x, WIDTH - 24):.1f}" y="{height - 6:g}">{escape(text)}</text>'


def _path(one: Drawn, across: _Scale, up: _Scale) -> str:
    pieces = []
    begun = False
    for x, y in zip(*one.line, strict=True):
        if not (math.isfinite(x) and math.isfinite(y)):
            begun = False
            continue
        pieces.append(f"{'L' if begun else 'M'}{across.at(x):.1f} {up.at(y):.1f}")
        begun = True
    if not pieces:
        return ""
    if len(pieces) == 1:  # a line of one point is not seen
        pieces.append("h0.1")
    return f'<path class="{one.style}" d="{"".join(pieces)}"/>'


def _ends(one: Drawn, across: _Scale, up: _Scale) -> str:
    places = [(x, y) for x, y in zip(*one.line, strict=True) if math.isfinite(x) and math.isfinite(y)]
    if not places:
        return ""
    (x0, y0), (x1, y1) = places[0], places[-1]
    first = f'<circle class="{one.style} first" cx="{across.at(x0):.1f}" cy="{up.at(y0):.1f}" r="4.5"/>'
    side = 7.0
    corner = f'x="{across.at(x1) - side / 2:.1f}" y="{up.at(y1) - side / 2:.1f}"'
    return f'{first}<rect class="{one.style} last" {corner} width="{side:g}" height="{side:g}"/>'


# -- numbers


def _finite(values: Iterable[float]) -> list[float]:
    return [value for value in values if math.isfinite(value)]


def _widened(low: float, high: float, least_span: float) -> tuple[float, float]:
    """A little more than the values need."""
    missing = max(least_span - (high - low), 0.0) / 2
    low, high = low - missing, high + missing
    edge = 0.05 * (high - low)
    return low - edge, high + edge


def _step(span: float, most: int) -> float:
    """1, 2 or 5 times a power of ten, of which at most so many fit."""
    raw = span / most
    power = 10.0 ** math.floor(math.log10(raw))
    return next((factor * power for factor in (1, 2, 5, 10) if factor * power >= raw * 0.999), 10 * power)


def _multiples(low: float, high: float, step: float) -> list[float]:
    first, last = math.ceil(low / step), math.floor(high / step)
    return [n * step for n in range(first, min(last, first + 50) + 1)]
