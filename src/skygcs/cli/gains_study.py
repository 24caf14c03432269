"""What `skygcs-cli gains` computes: the JSON answer, from which text and plot are made."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass
from typing import Any

from skygcs.core.control.analysis import (
    CONTINUOUS_PERIOD_S,
    DEFAULT_RESERVE,
    Loop,
    Margins,
    Suggestion,
    factorings,
    margins,
    poles,
    routh,
    step_response,
    suggest,
)
from skygcs.core.control.gains import GRAVITY_MPS2, UTIAS_HOVER_THRUST, UTIAS_XY, UTIAS_Z, AxisGains

Answer = dict[str, Any]

TYPICAL_DELAY_S = 0.1
"""Shown if no delay is given: up to here the attitude loop is closed over a link."""

TRACE_PERIOD_S = 0.05
"""Between two positions of the answer: 19 in a period of the fastest crossover in use (6.6 rad/s)."""

FINEST_PERIOD_S = 1e-4
"""Of the simulation; a loop that needs a finer one is none of a vehicle."""

PERIODS_PER_DELAY_MARGIN = 200
"""So the half period by which the simulation's hold delays is 0.25 % of it."""


@dataclass(frozen=True, slots=True)
class Question:
    """What is asked. Raises ValueError for gains that no loop can have.

    ``plant_gains`` (xy, z) replace those of tilt and of normalised thrust.
    """

    xy: AxisGains = UTIAS_XY
    z: AxisGains = UTIAS_Z
    hover: float = UTIAS_HOVER_THRUST
    plant_gains: tuple[float, float] | None = None
    delay_s: float | None = None
    reserve: float = DEFAULT_RESERVE
    rate_hz: float | None = None
    duration_s: float = 30.0

    def __post_init__(self) -> None:
        for _ in self.loops():
            pass  # each checks its numbers

    @property
    def plants(self) -> Mapping[str, tuple[float, float]]:
        """Plant gains of xy and z by plant.

        ``tilt``: the input is a tilt angle (xy) and a vertical acceleration (z), as in Eqs. 7 to 16 of the UTIAS
        report. ``thrust``: the input is normalised thrust.
        """
        if self.plant_gains is not None:
            return {"given": self.plant_gains}
        thrust = GRAVITY_MPS2 / self.hover
        return {"tilt": (GRAVITY_MPS2, 1.0), "thrust": (thrust, thrust)}

    def loops(self) -> Iterator[tuple[str, str, Loop]]:
        """(axis, plant, loop) of each."""
        for plant, (xy, z) in self.plants.items():
            yield "xy", plant, Loop(self.xy, xy)
            yield "z", plant, Loop(self.z, z)

    @property
    def of_utias(self) -> bool:
        """True for the gains that Eq. 16 of the UTIAS report is about."""
        return (self.xy, self.z, self.plant_gains) == (UTIAS_XY, UTIAS_Z, None)


def study(question: Question) -> Answer:
    """Everything, JSON-able; its keys are in docs/reference/gains.md. What is unlimited or does not exist is None."""
    return {
        "gains": {"xy": asdict(question.xy), "z": asdict(question.z)},
        "hover": question.hover,
        "delay_s": question.delay_s,
        "reserve": question.reserve,
        "rate_hz": question.rate_hz,
        "loops": [_loop(question, axis, plant, loop) for axis, plant, loop in question.loops()],
        "utias_eq16": _utias_eq16() if question.of_utias else None,
    }


def _loop(question: Question, axis: str, plant: str, loop: Loop) -> Answer:
    criterion = routh(loop)
    suggestion = None
    if question.delay_s is not None:
        suggestion = suggest(loop, question.delay_s, question.reserve)
    return {
        "axis": axis,
        "plant": plant,
        "plant_gain": loop.plant_gain,
        "polynomial": list(loop.polynomial),
        "poles": [{"re": pole.real, "im": pole.imag} for pole in poles(loop)],
        "routh_first_column": list(criterion.first_column),
        "stable": criterion.stable,
        "factorings": [asdict(factoring) for factoring in factorings(loop)],
        "margins": _margins(margins(loop)),
        "margins_with_delay": None if question.delay_s is None else _margins(margins(loop, question.delay_s)),
        "suggestion": _suggestion(suggestion, loop.plant_gain),
        "steps": list(_steps(question, loop, suggestion)),
    }


def _margins(found: Margins | None) -> Answer | None:
    if found is None:
        return None
    return {
        "crossover_radps": found.crossover_radps,
        "phase_margin_deg": math.degrees(found.phase_margin_rad),
        "delay_margin_s": found.delay_margin_s,
        "gain_up": None if math.isinf(found.gain_up) else found.gain_up,
        "gain_down": None if math.isinf(found.gain_down) else found.gain_down,
    }


def _suggestion(suggestion: Suggestion | None, plant_gain: float) -> Answer | None:
    if suggestion is None:
        return None
    bearable = margins(Loop(suggestion.gains, plant_gain))
    return {"factor": suggestion.factor, "gains": asdict(suggestion.gains), "margins": _margins(bearable)}


def _steps(question: Question, loop: Loop, suggestion: Suggestion | None) -> Iterator[Answer]:
    delay_s = TYPICAL_DELAY_S if question.delay_s is None else question.delay_s
    yield _step(question, "given", loop, 0.0)
    if delay_s > 0:
        yield _step(question, "given", loop, delay_s)
    if suggestion is not None and suggestion.factor > 1:
        yield _step(question, "suggested", Loop(suggestion.gains, loop.plant_gain), delay_s)


def _step(question: Question, gains: str, loop: Loop, delay_s: float) -> Answer:
    bearable = margins(loop)
    period_s = CONTINUOUS_PERIOD_S
    hold_s = 0.0
    if question.rate_hz is not None:
        period_s = 1 / question.rate_hz
        hold_s = period_s / 2  # what sampling with hold delays on average
    elif bearable is not None:
        period_s = min(period_s, max(FINEST_PERIOD_S, bearable.delay_margin_s / PERIODS_PER_DELAY_MARGIN))
    response = step_response(loop, delay_s=delay_s, duration_s=question.duration_s, period_s=period_s)
    stable = bearable is not None and delay_s + hold_s < bearable.delay_margin_s
    every = max(1, round(TRACE_PERIOD_S / period_s))
    return {
        "gains": gains,
        "delay_s": delay_s,
        "stable": stable,
        "overshoot": response.overshoot if stable else None,
        "rise_s": response.rise_s if stable else None,
        "settling_s": response.settling_s if stable else None,
        "every_s": every * period_s,
        "positions": [round(x, 5) for x in response.positions[::every]],
    }


def _utias_eq16() -> Answer:
    """The factoring behind each row of the UTIAS report's Eq. 16. G = -g in the y row is the report's own."""
    rows = {"x": Loop(UTIAS_XY, GRAVITY_MPS2), "y": Loop(UTIAS_XY, -GRAVITY_MPS2), "z": Loop(UTIAS_Z, 1.0)}
    return {
        axis: {
            "plant_gain": loop.plant_gain,
            **asdict(factorings(loop)[0]),
            "unstable_poles": [pole.real for pole in poles(loop) if pole.real > 0],
        }
        for axis, loop in rows.items()
    }
