"""Steps and wind in `make bench-control`, flown by the law and a quadrotor alone in virtual time."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any

from bench.control import steps
from bench.control.measures import overshoot_percent, settling_s, swing_m, within_s
from bench.control.steps import ATTITUDE_LAG, EAST, UP, Flight, axis, fly
from skygcs.core.control import ControlConfig
from skygcs.core.control.gains import UTIAS_XY, UTIAS_Z
from skygcs.sim.quad import F450, IDEAL

WIND_MPS = 5.0
NEAR_M = 0.1


@dataclass(slots=True)
class Section:
    """One table with what follows from it."""

    key: str
    title: str
    header: tuple[str, ...] = ()
    rows: list[tuple[str, ...]] = field(default_factory=list)
    remarks: list[str] = field(default_factory=list)
    missed: list[str] = field(default_factory=list)
    """Targets that were not met."""

    def text(self) -> str:
        table = [self.header, *self.rows] if self.header else self.rows
        widths = [max(len(row[n]) for row in table) for n in range(len(table[0]))] if table else []
        lines = ["  " + "  ".join(cell.rjust(width) for cell, width in zip(r, widths, strict=True)) for r in table]
        return "\n".join([*lines, *(f"  {remark}" for remark in self.remarks)])

    def data(self) -> Any:
        """Each row by the table's head; without a head, the second column by the first."""
        return [dict(zip(self.header, row, strict=True)) for row in self.rows] if self.header else dict(self.rows)

    def judge(self, what: str, value: float, limit: float | None) -> None:
        """Note what is above its limit."""
        if limit is not None and not value <= limit:
            self.missed.append(f"{self.key}: {what}: {value:.3f}, wanted at most {limit:g}")


def virtual_sections() -> Iterator[Section]:
    """In the order of docs/developers/control-figures.md."""
    yield east_steps()
    yield margins()
    yield wind()
    yield rest()


def east_steps() -> Section:
    """Overshoot (and settling) of 3 m to the east."""
    section = Section("east_3m", "3 m east, default gains, 50 Hz: overshoot %, within 5 % after s (- : swings on)")
    section.header = ("delay s", "at once", "at once I=0", "lag 0.15 s", "F450")
    for delay_s in (0.0, 0.1, 0.2, 0.3, 0.4, 0.5):
        flights = (
            Flight(IDEAL, delay_s=delay_s),
            Flight(IDEAL, delay_s=delay_s, following=False),
            Flight(ATTITUDE_LAG, delay_s=delay_s),
            Flight(F450, delay_s=delay_s),
        )
        section.rows.append((f"{delay_s:.1f}", *map(_step_cell, flights)))
    return section


def margins() -> Section:
    """From which delay on a nudge is not damped any more, against the linear loop's margin."""
    title = "The first delay (10 ms apart) with which a nudge of 0.1 m swings on, and the margin less 10 ms"
    section = Section("margins", title, ("airframe", "z", "margin", "x (z slowed 4 times)", "margin of x"))
    period_s = ControlConfig().period_s
    for name, frame in steps.AIRFRAMES.items():
        (lags_x, lags_z), drag_per_s = steps.LAGS_S[name], frame.drag_linear_n_per_mps / frame.mass_kg
        row = [name]
        for axis_, gains, lags, flight in (
            (UP, UTIAS_Z, lags_z, Flight(frame)),
            (EAST, UTIAS_XY, lags_x, Flight(frame, config=steps.SLOW_Z)),
        ):
            expected = steps.bearable_delay_s(gains, lags, drag_per_s, period_s)
            found = steps.first_swinging_s(flight, axis_, expected)
            row += [_seconds(found), f"{expected:.3f}"]
            if found is None or not -0.011 < found - expected < 0.021:
                what = "z" if axis_ == UP else "x"
                section.missed.append(f"{name}: {what} swings from {found} s on, the linear loop says {expected:.3f} s")
        section.rows.append(tuple(row))
    section.remarks = [
        "z is the first to swing on each airframe: it sets the delay attitude may have (guard: 0.1 s).",
        "x with z at the default gains is worse than its margin from there on: a swinging z takes its thrust away.",
    ]
    return section


def wind() -> Section:
    """A steady wind: how far it blows the vehicle, and how long the small Ki takes."""
    said = steps.wind_arithmetic(F450, WIND_MPS)
    section = Section("wind", f"F450 in {WIND_MPS:g} m/s of wind from its first moment: m off")
    section.header = ("flight", "delay s", "most off", f"under {NEAR_M:g} m after s", "off at 20 s", "off at 60 s")
    blow = (WIND_MPS, 0.0, 0.0)
    flights = (("hover", 0.0, 0.0), ("hover", 0.0, 0.1), ("3 m downwind", 3.0, 0.1), ("3 m upwind", -3.0, 0.1))
    for name, step_m, delay_s in flights:
        flight = Flight(F450, (step_m, 0.0, 0.0), delay_s, wind_enu_mps=blow, seconds=80.0)
        track = axis(fly(flight), EAST)
        period_s = flight.config.period_s
        near_s = within_s(track, step_m, NEAR_M, period_s)
        off = [abs(track[round(at_s / period_s)] - step_m) for at_s in (20.0, 60.0)]
        most = max(x * math.copysign(1.0, step_m) for x in track) - abs(step_m)
        section.rows.append((name, f"{delay_s:g}", f"{most:.2f}", _seconds(near_s), f"{off[0]:.3f}", f"{off[1]:.4f}"))
        section.judge(f"{name}: m off after a minute", off[1], NEAR_M)
    without = axis(fly(Flight(F450, (0.0, 0.0, 0.0), following=False, wind_enu_mps=blow)), EAST)[-1]
    section.remarks = [
        f"Drag pushes with {said.push_mps2:.2f} m/s². Without the integral it stays {without:.3f} m off for ever "
        f"(arithmetic: push / (G Kv Kp) = {said.offset_m:.3f}).",
        f"Ki is small: the slow pole is Kp Ki / (Kp Kv + Ki) = {said.slow_pole_per_s:.3f}/s, a time constant of "
        f"{1 / said.slow_pole_per_s:.1f} s,",
        f"from push / (G (Kv Kp + Ki)) = {said.most_m:.2f} m on: below {NEAR_M:g} m after {said.below_s(NEAR_M):.1f} "
        f"s, below 1 cm after {said.below_s(0.01):.0f} s.",
    ]
    return section


def rest() -> Section:
    """With 0.1 s of delay and every lag it comes to rest."""
    title = "0.1 s of delay, F450, step of 3 m east and 1 m up: what still moves in the last 20 s of 80, m"
    section = Section("rest", title, ("air", "x", "y", "z"))
    for air, blow in (("still", steps.ZERO), ("5 m/s", (3.0, 4.0, 0.0))):
        flight = Flight(F450, (3.0, 0.0, 1.0), 0.1, wind_enu_mps=blow, seconds=steps.LONG_S)
        track = fly(flight)
        moved = [swing_m(axis(track, n), steps.LAST_S, flight.config.period_s) for n in range(3)]
        section.rows.append((air, *(f"{m:.6f}" for m in moved)))
        section.judge(f"a limit cycle in {air} air", max(moved), 0.01)
    return section


def _step_cell(flight: Flight) -> str:
    track = axis(fly(flight), EAST)
    settled_s = settling_s(track, flight.step_m[EAST], flight.config.period_s)
    return f"{overshoot_percent(track, flight.step_m[EAST]):.1f}, {_seconds(settled_s, 1)}"


def _seconds(value: float | None, digits: int = 2) -> str:
    return "-" if value is None else f"{value:.{digits}f}"
