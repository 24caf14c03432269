"""The attitude in which an ArduCopter is handed over: the steady lean, and against its motion what brakes it."""

from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from skygcs.core.control import ControlConfig
from skygcs.core.control.gains import GRAVITY_MPS2
from skygcs.core.vehicle.bumpless_transfer import BRAKING_MPS2, handover_attitude
from support.table import each

LAW = ControlConfig()


def acceleration(attitude_ned_frd: tuple[float, float, float, float], thrust: float) -> tuple[float, float, float]:
    """East, north, up, of the thrust along the body's axis and gravity."""
    w, x, y, z = attitude_ned_frd
    north, east, down = 2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y)
    push = GRAVITY_MPS2 * thrust / LAW.hover_thrust
    return -east * push, -north * push, down * push - GRAVITY_MPS2


@each("yaw_rad", [0.0, 1.0, -2.5])
def test_a_fast_one_is_braked_with_what_the_autopilot_brakes_with(yaw_rad: float) -> None:
    east, north, up = acceleration(*handover_attitude(LAW, (0.0, 0.0, 0.0), (3.0, -4.0, 2.0), yaw_rad, 1.0))
    assert (east, north, up) == pytest.approx((-0.6 * BRAKING_MPS2, 0.8 * BRAKING_MPS2, 0.0), abs=1e-9)


def test_a_slow_one_only_to_a_standstill_by_the_time_it_levels() -> None:
    east, north, _ = acceleration(*handover_attitude(LAW, (0.0, 0.0, 0.0), (0.6, 0.0, 0.0), 0.4, 1.0))
    assert (east, north) == pytest.approx((-0.6, 0.0), abs=1e-9)
    east, _, _ = acceleration(*handover_attitude(LAW, (0.0, 0.0, 0.0), (0.6, 0.0, 0.0), 0.4, 3.0))
    assert east == pytest.approx(-0.2)


def test_one_that_stands_keeps_the_lean_against_the_wind_and_its_true_hover_thrust() -> None:
    weight = LAW.hover_thrust / GRAVITY_MPS2
    found = handover_attitude(LAW, (1.2 * weight, -0.5 * weight, 0.3 * weight), (0.0, 0.0, 0.0), 0.0, 1.0)
    assert acceleration(*found) == pytest.approx((1.2, -0.5, 0.3))


finite = st.floats(-100.0, 100.0)


@given(st.tuples(finite, finite, finite), st.tuples(finite, finite, finite), finite, st.floats(0.0, 60.0))
def test_it_is_within_the_law_s_limits_whatever_comes(
    integral: tuple[float, float, float], vel: tuple[float, float, float], yaw: float, timeout_s: float
) -> None:
    attitude, thrust = handover_attitude(LAW, integral, vel, yaw, timeout_s)
    assert math.isclose(sum(part * part for part in attitude), 1.0, abs_tol=1e-9)
    assert 0.0 < thrust <= LAW.thrust_max
    _, x, y, _ = attitude
    assert math.acos(max(-1.0, 1 - 2 * (x * x + y * y))) <= LAW.tilt_max_rad + 1e-9
