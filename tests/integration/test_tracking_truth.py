"""The tracking error that is recorded in flight, against the simulator's truth at the same times."""

from __future__ import annotations

import asyncio
import math
from pathlib import Path
from typing import Any

import pytest

from skygcs.core.geo import EnuFrame
from skygcs.sim.conditions import Conditions
from support.flown import FIELD, KINDS, Flown, flown

RADIUS_M, SPEED_MPS, UP_M = 5.0, 2.0, 10.0
FLOWN_S, RAMP_S, PIECE_S = 120.0, 8.0, 0.5


def angle(t: float) -> tuple[float, float]:
    """Angle and its rate: from rest to speed and back."""
    rate, down = SPEED_MPS / RADIUS_M, FLOWN_S - RAMP_S
    if t < RAMP_S:
        u = t / RAMP_S
        return rate * RAMP_S * (u**3 - u**4 / 2), rate * (3 * u**2 - 2 * u**3)
    if t <= down:
        return rate * (RAMP_S / 2 + t - RAMP_S), rate
    back, fast = angle(FLOWN_S - t)
    return rate * (FLOWN_S - RAMP_S) - back, fast


def circle(x_m: float, y_m: float) -> list[dict[str, Any]]:
    """Cubic pieces with the places and velocities of the circle at their ends."""

    def at(t: float) -> tuple[tuple[float, float], tuple[float, float]]:
        a, w = angle(t)
        place = (x_m + RADIUS_M * math.sin(a), y_m + RADIUS_M * (1.0 - math.cos(a)))
        return place, (RADIUS_M * w * math.cos(a), RADIUS_M * w * math.sin(a))

    pieces = []
    for k in range(round(FLOWN_S / PIECE_S)):
        (p, v), (q, w) = at(k * PIECE_S), at((k + 1) * PIECE_S)
        axes = [
            [a, da, (3 * (b - a) / PIECE_S - 2 * da - db) / PIECE_S, (2 * (a - b) / PIECE_S + da + db) / PIECE_S**2]
            for a, b, da, db in zip(p, q, v, w, strict=True)
        ]
        pieces.append({"duration_s": PIECE_S, "x": axes[0], "y": axes[1], "up": [UP_M], "yaw": [0.0]})
    return pieces


def true_error_m(gcs: Flown) -> float | None:
    """The distance of the vehicle from its reference, both now."""
    controller = gcs.actor().offboard.controller
    if controller.reference is None or controller.frame is None or not controller.reference.moves:
        return None
    x, y, up = gcs.place()
    lat, lon = FIELD.to_geodetic(x, y)
    flight = controller.flight
    assert flight is not None
    frame: EnuFrame = controller.frame
    return math.dist(frame.from_geodetic(lat, lon, FIELD.alt_amsl_m + up), flight.reference(gcs.now, 0.0).pos_enu_m)


@pytest.mark.deep
@KINDS
@pytest.mark.parametrize("delay_s", [0.02, 0.15])
async def test_what_is_recorded_on_a_circle_is_what_was_flown(
    tmp_path: Path, kind: dict[str, int], delay_s: float
) -> None:
    """Positions come twice a second: the newest one is up to .5 s old, in which the reference moves on by 1 m."""
    async with flown(tmp_path, **kind, delay_s=delay_s, conditions=Conditions(wind_enu_mps=(6.0, 0.0, 0.0))) as gcs:
        await gcs.fly("position")
        x, y, _ = gcs.place()
        await gcs("trajectory.load", target="v1", pieces=circle(x, y), name="circle")
        await gcs.done("trajectory.start", targets="v1", after_s=1.0)
        await asyncio.sleep(2.0)
        errors = []
        while gcs.control()["trajectory"] is not None:
            if (error := true_error_m(gcs)) is not None:
                errors.append(error)
            await asyncio.sleep(0.05)
        truth = sorted(errors)[int(0.99 * len(errors))]
        recorded = gcs.actor().offboard.tracking.tracking_error_m
        assert recorded == pytest.approx(truth, rel=0.2)
