"""From thrust and yaw to an attitude, checked against rotation matrices built another way."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from skygcs.core.control.cascade import attitude_from_thrust, ned_frd_from_enu_flu
from support.table import each

NED_FROM_ENU = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
FLU_FROM_FRD = np.diag([1.0, -1.0, -1.0])
HALF = math.sqrt(0.5)

SIDEWAYS = st.floats(-5.0, 5.0)
THRUSTS = st.tuples(SIDEWAYS, SIDEWAYS, st.floats(0.01, 1.0))
YAWS = st.floats(-20.0, 20.0)


def matrix(quaternion) -> np.ndarray:
    w, x, y, z = quaternion
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )


@given(thrust=THRUSTS, yaw_rad=YAWS)
def test_the_attitude_is_the_one_made_of_cross_products(thrust, yaw_rad):
    """up = T/|T|, nose = (left of the heading) x up, normalised: the construction of the law this follows."""
    up = np.array(thrust) / np.linalg.norm(thrust)
    nose = np.cross([-math.sin(yaw_rad), math.cos(yaw_rad), 0.0], up)
    nose /= np.linalg.norm(nose)
    attitude, _, _ = attitude_from_thrust(thrust, yaw_rad)
    assert matrix(attitude) == pytest.approx(np.column_stack([nose, np.cross(up, nose), up]), abs=1e-9)


@given(thrust=THRUSTS, yaw_rad=YAWS)
def test_ned_frd_is_the_same_attitude_with_both_frames_turned(thrust, yaw_rad):
    attitude, _, _ = attitude_from_thrust(thrust, yaw_rad)
    ned = ned_frd_from_enu_flu(attitude)
    assert matrix(ned) == pytest.approx(NED_FROM_ENU @ matrix(attitude) @ FLU_FROM_FRD, abs=1e-12)
    for quaternion in (attitude, ned):
        assert math.hypot(*quaternion) == pytest.approx(1.0, abs=1e-12) and quaternion[0] >= 0.0


@each(
    ("yaw_deg", "ned_frd"),
    [(90, (1, 0, 0, 0)), (0, (HALF, 0, 0, HALF)), (180, (HALF, 0, 0, -HALF)), (-90, (0, 0, 0, 1))],
)
def test_a_level_attitude_in_ned_is_the_compass_heading(yaw_deg, ned_frd):
    """ENU yaw 90 is north, 0 east, 180 west, -90 south."""
    attitude, _, _ = attitude_from_thrust((0.0, 0.0, 0.45), math.radians(yaw_deg))
    given_ned = np.array(ned_frd_from_enu_flu(attitude))
    assert abs(float(np.dot(given_ned, ned_frd))) == pytest.approx(1.0, abs=1e-12)


@given(thrust=THRUSTS, yaw_rad=st.floats(-3.0, 3.0))
def test_roll_and_pitch_are_those_of_the_attitude(thrust, yaw_rad):
    attitude, roll, pitch = attitude_from_thrust(thrust, yaw_rad)
    turned = matrix(attitude)
    assert pitch == pytest.approx(-math.asin(turned[2, 0]), abs=1e-6)
    assert roll == pytest.approx(math.atan2(turned[2, 1], turned[2, 2]), abs=1e-6)
    assert math.remainder(yaw_rad - math.atan2(turned[1, 0], turned[0, 0]), math.tau) == pytest.approx(0.0, abs=1e-6)
    assert attitude_from_thrust((0.0, 0.0, 0.0), 0.0) == ((1.0, 0.0, 0.0, 0.0), 0.0, 0.0), "without thrust it is level"
