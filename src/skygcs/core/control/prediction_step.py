"""State that velocity control with prediction needs to be run again from a trace: the model, and what a step began
with."""

from __future__ import annotations

from dataclasses import asdict
from typing import Any

from skygcs.core.control.cascade import LARGEST_INPUT, Estimate, Vector
from skygcs.core.control.record import record
from skygcs.core.control.velocity_predictor import PredictorMemory, SentVelocity, VelocityLoop

LARGEST_TIME_S = 1e12
"""Largest time of a loop's clock, which counts from any beginning: 30,000 years."""


@record
class PredictionStep:
    """One step: the model, and the memory before and after it."""

    loop: VelocityLoop
    before: PredictorMemory
    after: PredictorMemory


def encode_loop(loop: VelocityLoop) -> dict[str, float]:
    """Encode the loop for JSON."""
    return asdict(loop)


def decode_loop(value: Any) -> VelocityLoop:
    """The inverse. Raises KeyError, TypeError or ValueError."""
    loop = VelocityLoop(**{str(key): float(number) for key, number in value.items()})
    if not (0.0 < loop.lag_xy_s < LARGEST_INPUT and 0.0 < loop.lag_z_s < LARGEST_INPUT):
        raise ValueError(f"lags of {loop.lag_xy_s:g} and {loop.lag_z_s:g} s")
    return loop


def encode_memory(memory: PredictorMemory) -> dict[str, Any]:
    """Encode the memory for JSON: what was sent as [at, velocity, acceleration], one after the other."""
    estimate = memory.estimate
    return {
        "sent": [[sent.at, *sent.vel_enu_mps, *sent.acc_enu_mps2] for sent in memory.sent],
        "received_at": memory.received_at,
        "estimate": None if estimate is None else [*estimate.pos_enu_m, *estimate.vel_enu_mps],
        "disturbance_enu_mps2": list(memory.disturbance_enu_mps2),
        "round_trip_s": memory.round_trip_s,
        "ticked_at": memory.ticked_at,
    }


def decode_memory(value: Any) -> PredictorMemory:
    """The inverse. Raises KeyError, TypeError or ValueError."""
    estimate = None
    if value["estimate"] is not None:
        x, y, z, vx, vy, vz = (float(number) for number in value["estimate"])
        estimate = Estimate((x, y, z), (vx, vy, vz))
    times = [float(sent[0]) for sent in value["sent"]]
    if times != sorted(times) or not all(-LARGEST_TIME_S <= at <= LARGEST_TIME_S for at in times):
        raise ValueError("the times of what was sent do not rise")
    return PredictorMemory(
        tuple(SentVelocity(float(sent[0]), _vector(sent[1:4]), _vector(sent[4:7])) for sent in value["sent"]),
        _maybe(value["received_at"]),
        estimate,
        _vector(value["disturbance_enu_mps2"]),
        _maybe(value["round_trip_s"]),
        _maybe(value["ticked_at"]),
    )


def _maybe(value: Any) -> float | None:
    return None if value is None else float(value)


def _vector(value: Any) -> Vector:
    x, y, z = value
    return float(x), float(y), float(z)
