"""Figures of a control trace: how far the vehicle was from its reference, and how old the state was. Pure.

Positions are true east, north, up about the trace's local origin, as in its rows.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass

from skygcs.core.control.trace import TraceRow

MOST_ROWS = 2_000_000
"""Eleven hours at 50 Hz, some 400 MB as columns of a plot and 32 MB as those of figures."""


@dataclass(frozen=True)
class TraceFigures:
    """Figures of a trace. NaN where it has nothing of it."""

    rows: int
    duration_s: float
    rms_error_m: float
    p95_error_m: float
    """95 % of the errors are not above it."""
    largest_error_m: float
    age_p95_ms: float
    cut_line: int | None


def figures_line(measured: TraceFigures) -> str:
    """The figures as one line of text."""
    text = f"{measured.rows:,} rows, {measured.duration_s:.1f} s"
    if not math.isnan(measured.rms_error_m):
        text += f"; error {measured.rms_error_m:.2f} m rms, {measured.largest_error_m:.2f} m at most"
    if not math.isnan(measured.age_p95_ms):
        text += f"; state age p95 {measured.age_p95_ms:.0f} ms"
    return text if measured.cut_line is None else f"{text}; line {measured.cut_line} was cut off and is left out"


def trace_figures(
    rows: int, duration_s: float, errors_m: Iterable[float], ages_ms: Iterable[float], cut_line: int | None
) -> TraceFigures:
    """Figures of these errors and ages, in which NaN counts as nothing."""
    errors = sorted(error for error in errors_m if not math.isnan(error))
    ages = sorted(age for age in ages_ms if not math.isnan(age))
    return TraceFigures(
        rows=rows,
        duration_s=duration_s,
        rms_error_m=math.sqrt(math.fsum(e * e for e in errors) / len(errors)) if errors else math.nan,
        p95_error_m=p95(errors),
        largest_error_m=errors[-1] if errors else math.nan,
        age_p95_ms=p95(ages),
        cut_line=cut_line,
    )


def p95(ordered: list[float]) -> float:
    """The value that 95 % of these are not above; NaN without any. ``ordered``: the least first."""
    return ordered[min(len(ordered) - 1, int(0.95 * len(ordered)))] if ordered else math.nan


def wanted(row: TraceRow) -> tuple[float, float, float]:
    """The reference in metres; NaN for an axis that follows a velocity alone."""
    if row.reference is None:
        return math.nan, math.nan, math.nan
    x, y, z = row.reference.pos_enu_m
    if row.reference.velocity_only_xy:
        x = y = math.nan
    return x, y, math.nan if row.reference.velocity_only_z else z


def found(row: TraceRow) -> tuple[float, float, float]:
    """The estimate in metres; NaN without one."""
    return (math.nan, math.nan, math.nan) if row.estimate is None else row.estimate.pos_enu_m


def error_m(row: TraceRow) -> float:
    """Distance to the reference, of the axes whose position counts; NaN where none does."""
    counted = [w - f for w, f in zip(wanted(row), found(row), strict=True) if not math.isnan(w)]
    return math.hypot(*counted) if counted else math.nan


def age_ms(row: TraceRow) -> float:
    """Age of the state that was used; NaN if it was not known."""
    return math.nan if row.state_age_s is None else 1e3 * row.state_age_s
