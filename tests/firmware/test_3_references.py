"""Moving references on real autopilots: how near the vehicle is to one, and how far a fault carries it."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from functools import partial
from typing import Any

import pytest

from support.firmware_field import HEIGHT_M, HOME, Field, Stream

IN_FULL = partial(pytest.param, marks=pytest.mark.minutes)
"""A way of it that the full form flies as well."""

RADIUS_M, SPEED_MPS = 5.0, 2.0
CIRCLE_S, BEGINNING_S = 40.0, 10.0
RATE_HZ = 10.0
CIRCLE_LIMIT_M = {"ardupilot": 0.5, "px4": 0.75}
"""PX4's simulated position wanders by 0.3 m."""

LEAST_PACE = 0.98
"""Of a simulator's clock. At 0.956 the reference was 4 % faster than the velocity that was sent for it, and the
circle of a PX4 1.10 m off, with 0.82 and 0.85 m in the flights beside it."""

STEP_M = 8.0
UPLINK_S, CUT_S = 0.5, 2.0
Point = dict[str, Any]


def beyond_m(speed_mps: float) -> float:
    """What a fault may add: 0.7 s to notice it, braking with 2.5 m/s², and the noise of the position."""
    return 0.7 * speed_mps + speed_mps**2 / 5.0 + 0.5


def circle(t: float) -> Point:
    """About a place west of the first vehicle's: the second hovers 10 m east of that, and a goto to the circle's begin
    was refused where its estimate wandered towards it (PX4's by 0.35 m/s)."""
    w = SPEED_MPS / RADIUS_M
    c, s = math.cos(w * t), math.sin(w * t)
    return {
        "pos_enu_m": [RADIUS_M * (c - 1.0), RADIUS_M * s, HEIGHT_M],
        "vel_enu_mps": [-SPEED_MPS * s, SPEED_MPS * c, 0.0],
        "acc_enu_mps2": [-w * SPEED_MPS * c, -w * SPEED_MPS * s, 0.0],
    }


def eight(t: float) -> Point:
    """A lemniscate of Gerono of 12 m by 6 m, at most 2.6 m/s."""
    a, b, w = 6.0, 3.0, 0.3
    return {
        "pos_enu_m": [a * math.sin(w * t), b * math.sin(2 * w * t), HEIGHT_M],
        "vel_enu_mps": [a * w * math.cos(w * t), 2 * b * w * math.cos(2 * w * t), 0.0],
        "acc_enu_mps2": [-a * w * w * math.sin(w * t), -4 * b * w * w * math.sin(2 * w * t), 0.0],
    }


def behind_m(at: tuple[float, float], point: Point) -> float:
    """How far it is behind the reference, along its way."""
    (x, y, _), (vx, vy, _) = point["pos_enu_m"], point["vel_enu_mps"]
    return float(((x - at[0]) * vx + (y - at[1]) * vy) / math.hypot(vx, vy))


def at_top_speed(field: Field) -> tuple[float, float]:
    """Time and speed when the speed has ceased to rise: what accelerates goes on doing so while nothing reaches it."""
    before = 0.0
    while (speed := field.truth(field.one).speed_mps) > before:
        before = speed
        time.sleep(0.1)
    return time.monotonic(), speed


def track_enu(field: Field, since: float) -> list[tuple[float, float, float]]:
    """Time, east and north about the first vehicle's place of take-off, from its own frames."""
    lat_0, lon_0 = HOME[0], HOME[1]
    east_m = 111_319.5 * math.cos(math.radians(lat_0))
    track = field.truth(field.one).track
    return [(t, (lon - lon_0) * east_m, (lat - lat_0) * 111_132.0) for t, lat, lon, _ in track if t >= since]


def fastest_mps(looks: list[tuple[float, float, float]], over_s: float = 0.3) -> float:
    """The largest mean speed over so long."""
    fastest, first = 0.0, 0
    for t, x, y in looks:
        while t - looks[first][0] > over_s:
            t_0, x_0, y_0 = looks[first]
            fastest, first = max(fastest, math.hypot(x - x_0, y - y_0) / (t - t_0)), first + 1
    return fastest


@pytest.mark.parametrize("path", [circle, IN_FULL(eight)])
def test_a_moving_reference_in_position(air: Field, figures: dict[str, Any], path: Callable[[float], Point]) -> None:
    air.order("control.set", air.one, mode="position")
    try:
        start = path(0.0)["pos_enu_m"]
        air.order("vehicles.goto", air.one, enu_m=start)
        air.wait(lambda: math.dist(air.enu(air.one), start) < 1.0, 30, "it is at the beginning")
        began = time.monotonic()
        with Stream(air.daemon.socket, air.one, lambda t: path(time.monotonic() - began), RATE_HZ) as stream:
            time.sleep(CIRCLE_S)
        assert not stream.refused, stream.refused[:2]
        assert air.control(air.one)["control_mode"] == "position"
        looks = [look for look in track_enu(air, began + BEGINNING_S) if look[0] < began + CIRCLE_S]
        off = [math.dist((x, y), path(t - began)["pos_enu_m"][:2]) for t, x, y in looks]
        figures["behind m"] = sum(behind_m((x, y), path(t - began)) for t, x, y in looks) / len(looks)
        figures["RMS m"] = math.sqrt(sum(d * d for d in off) / len(off))
        figures["largest m"] = max(off)
        figures["pace"] = air.truth(air.one).pace(began, began + CIRCLE_S)
        if figures["pace"] < LEAST_PACE:
            pytest.skip(f"its simulator ran at {figures['pace']:.3f} of real time: the figures are not the vehicle's")
        assert figures["RMS m"] <= CIRCLE_LIMIT_M[air.firmware]
    finally:
        air.daemon.call("control.set", targets=air.one, mode="off")


@pytest.mark.parametrize(
    "at_mps",
    [
        IN_FULL(1.0),
        IN_FULL(1.8),
        2.5,
        pytest.param(3.2, marks=[pytest.mark.only("ardupilot"), pytest.mark.minutes]),
        None,
    ],
    ids=lambda v: "top speed" if v is None else f"{v:g} mps",
)
def test_a_slow_uplink_during_a_step_by_attitude(air: Field, figures: dict[str, Any], at_mps: float | None) -> None:
    """While it speeds up and at its fastest. It used to be noticed after 2 s, and an ArduCopter went 10 m beyond its
    goal; one that had just begun the step 12 m, because it sped up to 6.7 m/s and braked with 2 m/s²."""
    goal = {"pos_enu_m": [0.0, STEP_M, HEIGHT_M]}
    air.order("control.set", air.one, mode="attitude", force=True)
    try:
        time.sleep(4.0)  # the round trip is measured
        with Stream(air.daemon.socket, air.one, lambda t: goal, 20.0) as stream:
            under_way_mps = 1.8 if at_mps is None else at_mps
            air.wait(lambda: stream.refused or air.truth(air.one).speed_mps > under_way_mps, 10, "it is under way")
            assert not stream.refused, stream.refused[:2]
            fault, v = at_top_speed(air) if at_mps is None else (time.monotonic(), air.truth(air.one).speed_mps)
            air.relay.delay_up_s = UPLINK_S
            time.sleep(10.0)
            status = air.control(air.one)
        looks = track_enu(air, fault)
        figures["speed m/s"], figures["flown by"] = v, status["control_mode"]
        figures["fastest m/s"] = fastest_mps(looks)
        figures["beyond m"], figures["allowed m"] = max(y for _, _, y in looks) - STEP_M, beyond_m(v)
        assert status["control_mode"] in ("velocity", "position"), status
        assert figures["beyond m"] <= beyond_m(v)
    finally:
        air.relay.clear()
        air.daemon.call("control.set", targets=air.one, mode="off")


@pytest.mark.parametrize("climb_m", [8.0, IN_FULL(-6.0)], ids=["climb", "descent"])
def test_a_slow_uplink_during_a_climb_by_attitude(air: Field, figures: dict[str, Any], climb_m: float) -> None:
    """An ArduCopter brakes a climb with 1 m/s²: without a limit to what the step builds up, simulated, 10 m beyond."""
    goal = {"pos_enu_m": [0.0, 0.0, HEIGHT_M + climb_m]}
    air.order("control.set", air.one, mode="attitude", force=True)
    try:
        time.sleep(4.0)
        with Stream(air.daemon.socket, air.one, lambda t: goal, 20.0) as stream:
            air.wait(lambda: stream.refused or air.truth(air.one).speed_mps > 1.0, 10, "it is under way")
            assert not stream.refused, stream.refused[:2]
            fault, v = time.monotonic(), air.truth(air.one).speed_mps
            air.relay.delay_up_s = UPLINK_S
            time.sleep(10.0)
        ups = [up for t, *_, up in air.truth(air.one).track if t >= fault]
        farthest = max(ups) if climb_m > 0 else -min(ups)
        figures["speed m/s"], figures["allowed m"] = v, beyond_m(v)
        figures["beyond m"] = farthest - math.copysign(HEIGHT_M + climb_m, climb_m)
        assert figures["beyond m"] <= beyond_m(v)
    finally:
        air.relay.clear()
        air.daemon.call("control.set", targets=air.one, mode="off")


@pytest.mark.parametrize("cut_s", [CUT_S, IN_FULL(0.8)], ids=["cut of 2 s", "fall to position"])
def test_telemetry_that_is_cut_under_a_velocity(air: Field, figures: dict[str, Any], cut_s: float) -> None:
    """0.5 s later the velocity is not flown on: it stops ahead of where it was last seen, and not back there."""
    air.order("control.set", air.one, mode="velocity")
    try:
        with Stream(air.daemon.socket, air.one, lambda t: {"vel_enu_mps": [0.0, SPEED_MPS, 0.0]}, 20.0):
            time.sleep(7.0)
            fault, v = time.monotonic(), air.truth(air.one).speed_mps
            air.relay.cut_down = {air.sysids[0]}
            time.sleep(cut_s)
            air.relay.clear()
            time.sleep(8.0)
        looks = track_enu(air, fault)
        (_, x, y), (_, last_x, last_y) = looks[0], looks[-1]
        figures["speed m/s"] = v
        figures["farthest m"] = max(math.dist((x, y), look[1:]) for look in looks)
        figures["at rest after m"] = math.dist((x, y), (last_x, last_y))
        assert v > 0.8 * SPEED_MPS, "it never flew"
        assert figures["farthest m"] <= beyond_m(max(v, SPEED_MPS))  # PX4's simulator has got up to 1.7 m/s by then
    finally:
        air.relay.clear()
        air.daemon.call("control.set", targets=air.one, mode="off")
