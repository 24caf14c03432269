"""Frames of poses, against rotation matrices of numpy."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from skygcs.core.geo import Origin, euler_from_quaternion, quaternion_from_euler, rotated
from skygcs.ext.mocap.pose import CaptureFrame, Pose, Quaternion, angle_between_rad, ned_frd
from support.table import each

EAST = Origin(43.78, -79.46, 180.0)

angles = st.floats(-3.1, 3.1)
metres = st.floats(-50, 50)


def matrix(q: Quaternion) -> np.ndarray:
    return np.array([rotated(q, axis) for axis in ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))]).T


def turn_z(rad: float) -> np.ndarray:
    return np.array([[math.cos(rad), -math.sin(rad), 0], [math.sin(rad), math.cos(rad), 0], [0, 0, 1]])


def turn_y(rad: float) -> np.ndarray:
    return np.array([[math.cos(rad), 0, math.sin(rad)], [0, 1, 0], [-math.sin(rad), 0, math.cos(rad)]])


def turn_x(rad: float) -> np.ndarray:
    return np.array([[1, 0, 0], [0, math.cos(rad), -math.sin(rad)], [0, math.sin(rad), math.cos(rad)]])


@given(angles, st.floats(-1.5, 1.5), angles)
def test_euler_angles_are_those_of_the_textbook(roll: float, pitch: float, yaw: float) -> None:
    q = quaternion_from_euler(roll, pitch, yaw)
    assert np.allclose(matrix(q), turn_z(yaw) @ turn_y(pitch) @ turn_x(roll), atol=1e-9)
    assert np.allclose(euler_from_quaternion(*q), (roll, pitch, yaw), atol=1e-6)


@given(angles, st.floats(-1.5, 1.5), angles, metres, metres, metres)
def test_ned_and_frd_are_the_axes_swapped_on_both_sides(
    roll: float, pitch: float, yaw: float, x: float, y: float, z: float
) -> None:
    enu = Pose(1.0, (x, y, z), quaternion_from_euler(roll, pitch, yaw))
    ned = ned_frd(enu)
    swap = np.array([[0, 1, 0], [1, 0, 0], [0, 0, -1]])
    assert np.allclose(ned.pos_m, swap @ np.array(enu.pos_m))
    assert np.allclose(matrix(ned.q), swap @ matrix(enu.q) @ np.diag([1, -1, -1]), atol=1e-9)


@each(("yaw_enu_deg", "heading_deg"), [(0, 90), (90, 0), (180, -90), (-90, 180)])
def test_a_level_vehicle_has_the_compass_heading_as_yaw(yaw_enu_deg: float, heading_deg: float) -> None:
    level = Pose(0.0, (0, 0, 0), quaternion_from_euler(0, 0, math.radians(yaw_enu_deg)))
    roll, pitch, yaw = euler_from_quaternion(*ned_frd(level).q)
    assert (roll, pitch) == (pytest.approx(0, abs=1e-9), pytest.approx(0, abs=1e-9))
    assert math.cos(yaw - math.radians(heading_deg)) == pytest.approx(1.0)


def test_nose_up_in_flu_is_nose_up_in_frd() -> None:
    nose_up = quaternion_from_euler(0.0, -0.2, 0.0)  # FLU: a positive turn about y (left) lowers the nose
    assert rotated(nose_up, (1.0, 0.0, 0.0))[2] > 0
    assert euler_from_quaternion(*ned_frd(Pose(0.0, (0, 0, 0), nose_up)).q)[1] == pytest.approx(0.2)


def test_y_up_is_turned_to_z_up_with_its_body() -> None:
    frame = CaptureFrame(up="y")
    half = math.radians(30) / 2
    seen = Pose(5.0, (1.0, 2.0, 3.0), (math.cos(half), 0.0, math.sin(half), 0.0))  # 30 degrees about up
    pose = frame.to_enu(seen, EAST)
    assert pose is not None
    assert pose.pos_m == pytest.approx((1.0, -3.0, 2.0))
    assert euler_from_quaternion(*pose.q) == pytest.approx((0.0, 0.0, math.radians(30)), abs=1e-9)


def test_rotation_and_offset_are_those_of_the_world_frame() -> None:
    north = Origin(43.78, -79.46, 180.0, 0.0)  # x of the world to the north
    pose = CaptureFrame(offset_m=(10.0, 0.0, 1.0)).to_enu(Pose(0.0, (1.0, 2.0, 3.0), (1.0, 0.0, 0.0, 0.0)), north)
    assert pose is not None
    assert pose.pos_m == pytest.approx((-2.0, 11.0, 4.0))
    _, _, heading = euler_from_quaternion(*ned_frd(pose).q)
    assert heading == pytest.approx(0.0, abs=1e-9)  # nose along x of the world
    turned = CaptureFrame(rotation_rad=math.pi / 2).to_enu(Pose(0.0, (1.0, 0.0, 0.0), (1.0, 0.0, 0.0, 0.0)), EAST)
    assert turned is not None
    assert turned.pos_m == pytest.approx((0.0, 1.0, 0.0))


@given(st.sampled_from(["z", "y"]), angles, metres, metres, angles, st.floats(-1.5, 1.5), angles, st.floats(-180, 180))
def test_there_and_back(
    up: str, rotation: float, x: float, y: float, roll: float, pitch: float, yaw: float, heading: float
) -> None:
    origin = Origin(43.78, -79.46, 180.0, heading)
    frame = CaptureFrame(up, rotation, (3.0, -4.0, 0.5))  # type: ignore[arg-type]
    pose = Pose(1.5, (x, y, 1.0), quaternion_from_euler(roll, pitch, yaw))
    back = frame.to_enu(frame.from_enu(pose, origin), origin)
    assert back is not None
    assert back.pos_m == pytest.approx(pose.pos_m, abs=1e-9)
    assert angle_between_rad(back.q, pose.q) == pytest.approx(0.0, abs=1e-6)


@each(
    "pose",
    [
        Pose(0.0, (0.0, 0.0, 0.0), (1.0, 0.0, 0.0, 0.0)),
        Pose(0.0, (math.nan, 0.0, 0.0), (1.0, 0.0, 0.0, 0.0)),
        Pose(0.0, (1.0, 0.0, math.inf), (1.0, 0.0, 0.0, 0.0)),
        Pose(0.0, (1.0, 0.0, 0.0), (0.0, 0.0, 0.0, 0.0)),
        Pose(0.0, (1.0, 0.0, 0.0), (1.0, 1.0, 0.0, 0.0)),
        Pose(math.nan, (1.0, 0.0, 0.0), (1.0, 0.0, 0.0, 0.0)),
    ],
)
def test_what_is_no_measurement_has_no_pose(pose: Pose) -> None:
    assert CaptureFrame(offset_m=(5.0, 0.0, 0.0)).to_enu(pose, EAST) is None
