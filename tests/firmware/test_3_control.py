"""Position, velocity and attitude control on real autopilots: a step and a circle each, with the error."""

from __future__ import annotations

import csv
import math
import time
from pathlib import Path
from typing import Any

import pytest

from support.firmware_field import HEIGHT_M, Field, Stream

RADIUS_M = 5.0
SPEED_MPS = 1.5
STEP_M = 5.0
CIRCLE_S = 30.0
RATE_HZ = 20.0
ATTEMPTS = 3
"""On a computer that does other things setpoints come late now and then, and the guard flies on in another mode."""

RMS_LIMIT_M = {"position": 4.0, "velocity": 1.5, "attitude": 1.5}
"""Horizontal error that the circle may have. `position` has no feed-forward: the autopilot trails by its own lag."""


def circle(t: float) -> dict[str, Any]:
    """Begins and ends at (RADIUS_M, 0) about the place of take-off, with feed-forward."""
    omega = SPEED_MPS / RADIUS_M
    c, s = math.cos(omega * t), math.sin(omega * t)
    return {
        "pos_enu_m": [RADIUS_M * c, RADIUS_M * s, HEIGHT_M],
        "vel_enu_mps": [-SPEED_MPS * s, SPEED_MPS * c, None],
    }


def settled(field: Field, place: tuple[float, float, float], within_m: float = 1.0) -> bool:
    return math.dist(field.enu(field.one), place) < within_m and field.truth(field.one).speed_mps < 0.5


def trace_rms(path: Path, began_s: float) -> tuple[float, float]:
    """Horizontal root mean square and largest distance to the reference, from the control trace."""
    with path.open() as file:
        rows = list(csv.DictReader(line for line in file if not line.startswith("#")))
    end = float(rows[-1]["t_s"])
    errors = []
    for row in rows:
        if float(row["t_s"]) >= end - began_s and row["ref_x_m"] and row["x_m"]:
            errors.append(math.hypot(*(float(row[f"ref_{a}_m"]) - float(row[f"{a}_m"]) for a in "xy")))
    assert errors, f"{path} has no row with a reference"
    return math.sqrt(sum(e * e for e in errors) / len(errors)), max(errors)


MODES = [*(pytest.param(mode, marks=pytest.mark.minutes) for mode in ("position", "velocity")), "attitude"]


@pytest.mark.parametrize("mode", MODES)
def test_a_step_and_a_circle(air: Field, figures: dict[str, Any], mode: str) -> None:
    for _ in range(ATTEMPTS):
        fell_back = step_and_circle(air, figures, mode)
        if fell_back is None:
            break
        air.takeoff()
    else:
        pytest.skip(f"this computer is too busy for it: {fell_back}")
    figures["circle RMS m"], figures["circle largest m"] = trace_rms(newest_trace(air), CIRCLE_S - 5)
    assert figures["circle RMS m"] < RMS_LIMIT_M[mode]
    figures["after off"] = air.truth(air.one).mode


def step_and_circle(air: Field, figures: dict[str, Any], mode: str) -> str | None:
    """Why the guard did not fly it in this mode to the end; None if it did."""
    since = time.monotonic()
    air.order("control.set", air.one, mode=mode, force=True)
    air.daemon.call("control.record", targets=air.one, on=True)
    try:
        steps: dict[str, Any] = {"pos_enu_m": [0.0, 0.0, HEIGHT_M]}
        with Stream(air.daemon.socket, air.one, lambda t: steps, RATE_HZ) as stream:
            air.wait(lambda: settled(air, (0, 0, HEIGHT_M)), 30, "it stands at the place of take-off")
            steps = {"pos_enu_m": [RADIUS_M, 0.0, HEIGHT_M]}
            far = 0.0
            began = time.monotonic()
            while not settled(air, (RADIUS_M, 0, HEIGHT_M)):
                far = max(far, air.enu(air.one)[0] - RADIUS_M)
                assert time.monotonic() - began < 40, f"the step never settles; {air.summary()}"
                time.sleep(0.05)
        if (why := air.fell_back(since)) is not None:
            return why
        assert not stream.refused, stream.refused[:2]
        figures["step settles s"] = time.monotonic() - began
        figures["overshoot m"] = far
        with Stream(air.daemon.socket, air.one, circle, RATE_HZ) as stream:
            time.sleep(CIRCLE_S)
            status = air.control(air.one)
        if (why := air.fell_back(since)) is not None:
            return why
        assert not stream.refused, stream.refused[:2]
        assert status["control_mode"] == mode, status
        figures["state age s"], figures["delay p95 s"] = status["state_age_s"], status["delay_p95_s"]
        figures["late ticks"] = status["late"]
        return None
    finally:
        air.daemon.call("control.record", targets=air.one, on=False)
        air.daemon.call("control.set", targets=air.one, mode="off")


def newest_trace(field: Field) -> Path:
    return max(field.daemon.logs.glob("*.csv"), key=lambda p: p.stat().st_mtime)


def test_a_stream_that_ends_leaves_it_where_it_is(air: Field, figures: dict[str, Any]) -> None:
    air.order("control.set", air.one, mode="velocity")
    with Stream(air.daemon.socket, air.one, lambda t: {"vel_enu_mps": [0, 1.5, 0]}, RATE_HZ):
        time.sleep(4)
    truth = air.truth(air.one)
    at = (truth.lat_deg, truth.lon_deg)
    figures["speed m/s"] = truth.speed_mps
    assert truth.speed_mps > 0.8, "it never flew"
    figures["standing s"] = air.wait(lambda: truth.speed_mps < 0.4, 15, "it stands")
    figures["stopped after m"] = truth.metres_from(*at)
    assert figures["stopped after m"] < 5
    assert air.control(air.one)["state"] != "off"
    air.daemon.call("control.set", targets=air.one, mode="off")


def test_one_client_leads_it_until_another_insists(air: Field, figures: dict[str, Any]) -> None:
    """Both stream all the time: the vehicle goes the way of one of them, in the air too."""
    away, north = {"vel_enu_mps": [0.0, 0.0, 0.0]}, {"vel_enu_mps": [0.0, 1.0, 0.0]}

    def flown(seconds: float) -> tuple[float, ...]:
        """Mean velocity of the vehicle, by its own positions."""
        began = air.enu(air.one)
        time.sleep(seconds)
        return tuple((b - a) / seconds for a, b in zip(began, air.enu(air.one), strict=True))

    with air.controlled("velocity", lambda t: away) as first:
        air.wait(lambda: air.control(air.one)["stream"], 10, "the first leads it")
        away = {"vel_enu_mps": [-1.0, 0.0, 0.0]}  # from the second vehicle
        with Stream(air.daemon.socket, air.one, lambda t: north, RATE_HZ) as second:
            time.sleep(2)
            figures["the first's m/s"] = led = flown(6)
            assert second.sent and len(second.refused) == len(second.sent) and not first.refused, first.refused[:1]
            north = north | {"take_over": True}
            time.sleep(2)
            figures["the second's m/s"] = taken = flown(6)
            refused = [answer["result"]["outcomes"][air.one] for answer in first.refused]
            assert refused and all(outcome["taken"] for outcome in refused), refused[:1]
        figures["standing s"] = air.wait(lambda: air.truth(air.one).speed_mps < 0.4, 15, "it stands")
        air.holds(lambda: air.truth(air.one).speed_mps < 0.8, 2, "the first leads again although it lost the vehicle")
        refusals = len(second.refused), len(first.refused)
        figures["refused"] = f"{refusals[0]} of the second, then {refusals[1]} of the first"
    # of 1 m/s; a busy computer slows a simulator down, and the position of PX4's wanders
    assert led[0] < -0.3 and abs(led[1]) < 0.3 and taken[1] > 0.3 and abs(taken[0]) < 0.3, (led, taken)
