"""The virtual part of `make bench-control`: each section flies its cases and compares."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from typing import Any

from bench.control import steps
from bench.control.measures import overshoot_percent, settling_s, swing_m, within_s
from bench.control.steps import ATTITUDE_LAG, EAST, UP, Flight, axis, fly
from bench.control.wire import BEAR_ALL, Flown, WiredPilot
from skygcs.config.dialects import load_dialect
from skygcs.core.control import ControlConfig
from skygcs.core.control.gains import UTIAS_XY, UTIAS_Z
from skygcs.core.control.guard import ControlMode, GuardConfig
from skygcs.core.mavlink.dialect import Dialect
from skygcs.sim.conditions import Conditions
from skygcs.sim.quad import F450, IDEAL

DELAYS_S = (0.0, 0.1, 0.2, 0.3, 0.4, 0.5)
NOTED = {0.0: 8.0, 0.2: 12.0, 0.3: 20.0, 0.4: 38.0}
"""field-notes 10.4, 3 m east, percent; and without the integral:"""
NOTED_WITHOUT_INTEGRAL = {0.0: 5.5, 0.2: 6.7, 0.3: 10.5, 0.4: 23.0, 0.5: 44.0}
NOTED_UP = {0.0: 0.0, 0.1: 0.0, 0.15: 0.0, 0.2: 14.0}
ROUNDING = 0.6
"""Percent of the step: the note gives whole percents."""
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
    data: Any = None
    missed: list[str] = field(default_factory=list)
    """Targets that were not met."""

    def text(self) -> str:
        table = [self.header, *self.rows] if self.header else self.rows
        widths = [max(len(row[n]) for row in table) for n in range(len(table[0]))] if table else []
        lines = ["  " + "  ".join(cell.rjust(width) for cell, width in zip(r, widths, strict=True)) for r in table]
        return "\n".join([*lines, *(f"  {remark}" for remark in self.remarks)])


def virtual_sections() -> Iterator[Section]:
    """In the order of docs/developers/control-figures.md."""
    dialect = load_dialect(["ardupilotmega", "px4-extras"])
    yield east_steps()
    yield up_steps()
    yield margins()
    yield wind()
    yield rest()
    yield over_the_wire(dialect)
    yield guarded(dialect)


def east_steps() -> Section:
    """Overshoot (and settling) of 3 m to the east."""
    section = Section("east_3m", "3 m east, default gains, 50 Hz: overshoot %, within 5 % after s (- : swings on)")
    section.header = ("delay s", "note", "at once", "note I=0", "at once I=0", "lag 0.15 s", "F450")
    section.data = []
    for delay_s in DELAYS_S:
        flights = {
            "at_once": Flight(IDEAL, delay_s=delay_s),
            "at_once_no_integral": Flight(IDEAL, delay_s=delay_s, following=False),
            "lag": Flight(ATTITUDE_LAG, delay_s=delay_s),
            "f450": Flight(F450, delay_s=delay_s),
        }
        row = {name: _step(flight, EAST, 3.0) for name, flight in flights.items()}
        section.data.append({"delay_s": delay_s, **row})
        cells = {name: _cell(figures) for name, figures in row.items()}
        section.rows.append(
            (
                f"{delay_s:.1f}",
                _noted(NOTED, delay_s, "diverges" if delay_s == 0.5 else ""),
                cells["at_once"],
                _noted(NOTED_WITHOUT_INTEGRAL, delay_s),
                cells["at_once_no_integral"],
                cells["lag"],
                cells["f450"],
            )
        )
        _compare(section, f"3 m east at {delay_s} s", row["at_once"], NOTED.get(delay_s))
        _compare(
            section, f"without integral at {delay_s} s", row["at_once_no_integral"], NOTED_WITHOUT_INTEGRAL.get(delay_s)
        )
    return section


def up_steps() -> Section:
    """Overshoot and what swings on of 1 m up, at 50 and at 5 Hz."""
    section = Section("up_1m", "1 m up: overshoot %, and what still swings after 40 s, m peak to peak")
    section.header = ("delay s", "note", "at once", "F450", "at once 5 Hz")
    section.data = []
    slow = ControlConfig(period_s=0.2)
    for delay_s in (0.0, 0.05, 0.1, 0.15, 0.2, 0.25):
        flights = {
            "at_once": Flight(IDEAL, delay_s=delay_s),
            "f450": Flight(F450, delay_s=delay_s),
            "at_once_5_hz": Flight(IDEAL, delay_s=delay_s, config=slow),
        }
        up = {name: replace(flight, step_m=(0.0, 0.0, 1.0), seconds=60.0) for name, flight in flights.items()}
        row = {name: _step(flight, UP, 1.0) for name, flight in up.items()}
        section.data.append({"delay_s": delay_s, **row})
        note = _noted(NOTED_UP, delay_s, "swings" if delay_s == 0.25 else "")
        cells = [f"{figures['overshoot_percent']:.1f} / {figures['swing_m']:.2f}" for figures in row.values()]
        section.rows.append((f"{delay_s:.2f}", note, *cells))
        _compare(section, f"1 m up at {delay_s} s", row["at_once"], NOTED_UP.get(delay_s))
    section.remarks = [
        "The note has z swing at 5 Hz with 0.1 s. Holding an output for 0.2 s is 0.1 s of delay on average: 0.1 s more",
        "is less than the margin of 0.213 s, 0.15 s more is beyond it. In whole periods 0.1 s is 0.2 s, and swings.",
    ]
    return section


def margins() -> Section:
    """From which delay on a nudge is not damped any more, against the linear loop's margin."""
    section = Section(
        "margins", "The first delay (10 ms apart) with which a nudge of 0.1 m swings on, and the margin less 10 ms"
    )
    section.header = ("airframe", "z", "margin", "x (z slowed 4 times)", "margin")
    section.data = []
    period_s = ControlConfig().period_s
    for name, frame in steps.AIRFRAMES.items():
        (lags_x, lags_z), drag_per_s = steps.LAGS_S[name], frame.drag_linear_n_per_mps / frame.mass_kg
        expected_z = steps.bearable_delay_s(UTIAS_Z, lags_z, drag_per_s, period_s)
        expected_x = steps.bearable_delay_s(UTIAS_XY, lags_x, drag_per_s, period_s)
        found_z = steps.first_swinging_s(Flight(frame), UP, expected_z)
        found_x = steps.first_swinging_s(Flight(frame, config=steps.SLOW_Z), EAST, expected_x)
        section.rows.append((name, _seconds(found_z), f"{expected_z:.3f}", _seconds(found_x), f"{expected_x:.3f}"))
        section.data.append(
            {
                "airframe": name,
                "z_first_s": found_z,
                "z_margin_s": round(expected_z, 4),
                "x_first_s": found_x,
                "x_margin_s": round(expected_x, 4),
            }
        )
        for what, found, expected in (("z", found_z, expected_z), ("x", found_x, expected_x)):
            if found is None or not -0.011 < found - expected < 0.021:
                section.missed.append(f"{name}: {what} swings from {found} s on, the linear loop says {expected:.3f} s")
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
    section.data = {"push_mps2": said.push_mps2, "flights": []}
    blow = (WIND_MPS, 0.0, 0.0)
    for name, step_m, delay_s in (
        ("hover", 0.0, 0.0),
        ("hover", 0.0, 0.1),
        ("3 m downwind", 3.0, 0.1),
        ("3 m upwind", -3.0, 0.1),
    ):
        flight = Flight(F450, (step_m, 0.0, 0.0), delay_s, wind_enu_mps=blow, seconds=80.0)
        track = axis(fly(flight), EAST)
        period_s = flight.config.period_s
        near_s = within_s(track, step_m, NEAR_M, period_s)
        off = [abs(track[round(at_s / period_s)] - step_m) for at_s in (20.0, 60.0)]
        most = max(x * math.copysign(1.0, step_m) for x in track) - abs(step_m)
        section.rows.append((name, f"{delay_s:g}", f"{most:.2f}", _seconds(near_s), f"{off[0]:.3f}", f"{off[1]:.4f}"))
        section.data["flights"].append(
            {
                "flight": name,
                "delay_s": delay_s,
                "most_m": most,
                "near_s": near_s,
                "off_20_s_m": off[0],
                "off_60_s_m": off[1],
            }
        )
        if off[1] > NEAR_M:
            section.missed.append(f"{name} in wind: {off[1]:.2f} m off after a minute")
    without = axis(fly(Flight(F450, (0.0, 0.0, 0.0), following=False, wind_enu_mps=blow)), EAST)[-1]
    section.data["without_integral_m"] = without
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
    section = Section(
        "rest", "0.1 s of delay, F450, step of 3 m east and 1 m up: what still moves in the last 20 s of 80, m"
    )
    section.header = ("air", "x", "y", "z")
    section.data = []
    for air, blow in (("still", steps.ZERO), ("5 m/s", (3.0, 4.0, 0.0))):
        flight = Flight(F450, (3.0, 0.0, 1.0), 0.1, wind_enu_mps=blow, seconds=steps.LONG_S)
        track = fly(flight)
        moved = [swing_m(axis(track, n), steps.LAST_S, flight.config.period_s) for n in range(3)]
        section.rows.append((air, *(f"{m:.6f}" for m in moved)))
        section.data.append({"air": air, "swing_m": moved})
        if max(moved) > 0.01:
            section.missed.append(f"a limit cycle at 0.1 s of delay ({air} air): {max(moved):.3f} m")
    return section


def over_the_wire(dialect: Dialect) -> Section:
    """The same through the pilot, MAVLink and a simulated PX4."""
    section = Section(
        "wire",
        "3 m east through the pilot, MAVLink and a simulated PX4 in OFFBOARD, against the law alone: overshoot %",
    )
    section.header = ("airframe", "link delay s", "measured p95 s", "wire", "law alone")
    section.data = []
    for name, frame, delays_s in (("at once", IDEAL, (0.0, 0.1, 0.2, 0.3)), ("F450", F450, (0.0, 0.1))):
        for delay_s in delays_s:
            # beyond 0.213 s z is unstable, and swings from whatever it begins with: x is compared with z slowed
            law = steps.SLOW_Z if delay_s > 0.2 else ControlConfig()
            pilot = WiredPilot(dialect, Conditions(airframe=frame), delay_s, BEAR_ALL, law)
            flown = pilot.fly_step(ControlMode.ATTITUDE, 3.0, 30.0)
            wire = _figures(flown.track_m, 3.0, law.period_s)
            alone = _step(Flight(frame, delay_s=delay_s, supply_v=flown.supply_v, config=law), EAST, 3.0)
            cells = (name, f"{delay_s:g}", _seconds(flown.delay_s, 3), _cell(wire), _cell(alone))
            section.rows.append(cells)
            section.data.append(
                {"airframe": name, "delay_s": delay_s, "measured_p95_s": flown.delay_s, "wire": wire, "alone": alone}
            )
            if (
                abs(wire["overshoot_percent"] - alone["overshoot_percent"]) > ROUNDING
                or flown.control_mode is not ControlMode.ATTITUDE
            ):
                section.missed.append(
                    f"over the wire, {name} at {delay_s} s: {wire} by {flown.control_mode}, the law alone: {alone}"
                )
    section.remarks = [
        "The F450's battery is fuller here (16.4 V) than above (15.6 V): thrust is (16.4/15.6)² = 1.11 times as strong",
        'and the loop that much stiffer, x damped better, z bears less. "Law alone" has the same battery.',
    ]
    return section


def guarded(dialect: Dialect) -> Section:
    """At 0.3 s the guard takes attitude away, and velocity settles."""
    section = Section("guard", "3 m east ordered as attitude with 0.3 s of round trip, the guard as it is by default")
    flown: Flown = WiredPilot(dialect, Conditions(), 0.3, GuardConfig()).fly_step(ControlMode.ATTITUDE, 3.0, 30.0)
    figures = _figures(flown.track_m, 3.0, ControlConfig().period_s)
    section.data = {"control_mode": flown.control_mode, "events": flown.events, **figures}
    section.remarks = [
        *flown.events,
        f"{figures['overshoot_percent']:.1f} % over, within 5 % after {_seconds(figures['settling_s'])} s",
    ]
    if flown.control_mode is not ControlMode.VELOCITY or figures["settling_s"] is None:
        section.missed.append(f"at 0.3 s: flown by {flown.control_mode}, settled after {figures['settling_s']} s")
    return section


# -- the inside

Figures = dict[str, Any]


def _step(flight: Flight, number: int, step_m: float) -> Figures:
    return _figures(axis(fly(flight), number), step_m, flight.config.period_s)


def _figures(track_m: list[float], step_m: float, period_s: float) -> Figures:
    settled_s = settling_s(track_m, step_m, period_s)
    return {
        "overshoot_percent": round(overshoot_percent(track_m, step_m), 2),
        "settling_s": None if settled_s is None else round(settled_s, 2),
        "swing_m": round(swing_m(track_m, steps.LAST_S, period_s), 4),
    }


def _compare(section: Section, what: str, figures: Figures, noted: float | None) -> None:
    if noted is not None and abs(figures["overshoot_percent"] - noted) > ROUNDING:
        section.missed.append(f"{what}: {figures['overshoot_percent']} % over, the notes say {noted:g} %")


def _cell(figures: Figures) -> str:
    settled_s = figures["settling_s"]
    return f"{figures['overshoot_percent']:.1f}, {'-' if settled_s is None else format(settled_s, '.1f')}"


def _noted(noted: dict[float, float], delay_s: float, otherwise: str = "") -> str:
    return f"{noted[delay_s]:g}" if delay_s in noted else otherwise


def _seconds(value: float | None, digits: int = 2) -> str:
    return "-" if value is None else f"{value:.{digits}f}"
