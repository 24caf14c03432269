"""Rotations between MAVLink's frames and those of ROS (REP 103, REP 105), as MAVROS has them (its files
lib/ftf_frame_conversions.cpp and lib/ftf_quaternion_utils.cpp).

    NED -> ENU           the local frame: north, east, down becomes east, north, up
    FRD -> FLU           the body ("aircraft" becomes "base_link"): forward, right, down becomes forward, left, up

A quaternion is (w, x, y, z). One from MAVLink turns vectors of the body FRD into NED, one for ROS those of FLU into
ENU.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

from skygcs.core.geo import Quaternion, Vector

HALF = math.sqrt(0.5)
"""Sine and cosine of 45 degrees: NED to ENU is half a turn about their common diagonal."""


def enu_from_ned(x: float, y: float, z: float) -> Vector:
    """Its own inverse."""
    return y, x, -z


def flu_from_frd(x: float, y: float, z: float) -> Vector:
    """Its own inverse."""
    return x, -y, -z


def enu_orientation(q: Sequence[float]) -> Quaternion:
    """ROS' orientation (FLU to ENU) of MAVLink's (FRD to NED). Its own inverse, but for the sign of all four."""
    w, x, y, z = q
    return -HALF * (w + z), -HALF * (x + y), HALF * (y - x), HALF * (z - w)


def yaw_of(q: Sequence[float]) -> float:
    """The yaw of a quaternion, radians."""
    w, x, y, z = q
    return math.atan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))


def xyz(v: Sequence[float]) -> dict[str, float]:
    """A vector as geometry_msgs' Vector3 and Point."""
    return {"x": v[0], "y": v[1], "z": v[2]}


def wxyz(q: Sequence[float]) -> dict[str, float]:
    """A quaternion as geometry_msgs' Quaternion."""
    return {"w": q[0], "x": q[1], "y": q[2], "z": q[3]}


def vector_of(fields: Any) -> Vector:
    """geometry_msgs' Vector3 or Point as a vector."""
    return fields["x"], fields["y"], fields["z"]


def quaternion_of(fields: Any) -> Quaternion:
    """geometry_msgs' Quaternion as a quaternion."""
    return fields["w"], fields["x"], fields["y"], fields["z"]
