"""A pose of a rigid body, and the frames it is given in.

    frame                  axes                                              used by
    --------------------   -----------------------------------------------   -----------------------------------------
    capture frame          as its software was calibrated; z or y is up      lines of the capture process, recordings
    the fleet's world      x along [origin].x_heading_deg, y left, z up      [mocap] offset_m and rotation_deg
    ENU, body FLU          true east, north, up about [origin]               `Pose` inside skygcs
    NED, body FRD          true north, east, down about [origin]             MAVLink messages

A rigid body's axes are x forward, y left, z up (with y up: x forward, y up, z right), which they are if it was created
in the capture software while the vehicle's nose pointed along the capture frame's x axis.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

from skygcs.core.geo import Origin, conjugate, quaternion_product, rotated

Vector = tuple[float, float, float]
Quaternion = tuple[float, float, float, float]
"""(w, x, y, z), Hamilton, turning vectors of the body into those of the frame."""

HALF = math.sqrt(0.5)

NED_FROM_ENU: Quaternion = (0.0, HALF, HALF, 0.0)
"""A half turn about the line between east and north: (e, n, u) becomes (n, e, -u)."""

FLU_FROM_FRD: Quaternion = (0.0, 1.0, 0.0, 0.0)
"""A half turn about the forward axis; it is its own inverse."""

Z_FROM_Y_UP: Quaternion = (HALF, HALF, 0.0, 0.0)
"""A quarter turn about x: (x, y, z) with y up becomes (x, -z, y) with z up."""

NORM_ERROR = 0.02
"""By which the norm of a quaternion may differ from 1: single precision and rounding in streams give 1e-6; a
quaternion of zeros, which some systems send for a body that is not seen, has 0."""


@dataclass(frozen=True, slots=True)
class Pose:
    """``at`` is when it was captured, by the daemon's monotonic clock in seconds."""

    at: float
    pos_m: Vector
    q: Quaternion

    def finite(self) -> bool:
        """True if all numbers are finite and the quaternion is a rotation."""
        numbers = (self.at, *self.pos_m, *self.q)
        return all(map(math.isfinite, numbers)) and abs(math.hypot(*self.q) - 1.0) <= NORM_ERROR

    def same_place(self, other: Pose) -> bool:
        """True if position and attitude are bit for bit those of the other: no camera measures the same twice."""
        return self.pos_m == other.pos_m and self.q == other.q


@dataclass(frozen=True, slots=True)
class CaptureFrame:
    """Where the capture frame lies in the fleet's world frame.

    ``rotation_rad``: yaw of its x axis, counter-clockwise from the world's x. ``offset_m``: its origin, in the world.
    """

    up: Literal["z", "y"] = "z"
    rotation_rad: float = 0.0
    offset_m: Vector = (0.0, 0.0, 0.0)

    def to_enu(self, pose: Pose, origin: Origin) -> Pose | None:
        """The pose in true east, north, up about the origin; None for one that is no measurement: not finite, or
        exactly at zero, which some systems send for a body that is not seen."""
        if not pose.finite() or not any(pose.pos_m):
            return None
        pos_m, q = pose.pos_m, normalized(pose.q)
        if self.up == "y":
            pos_m = rotated(Z_FROM_Y_UP, pos_m)
            q = quaternion_product(quaternion_product(Z_FROM_Y_UP, q), conjugate(Z_FROM_Y_UP))
        x, y, z = rotated(about_up(self.rotation_rad), pos_m)
        dx, dy, dz = self.offset_m
        # the world's x axis is turned from east by this much, counter-clockwise
        world_rad = math.radians(90.0 - origin.x_heading_deg)
        return Pose(
            pose.at,
            rotated(about_up(world_rad), (x + dx, y + dy, z + dz)),
            quaternion_product(about_up(world_rad + self.rotation_rad), q),
        )

    def from_enu(self, pose: Pose, origin: Origin) -> Pose:
        """The inverse of `to_enu`."""
        world_rad = math.radians(90.0 - origin.x_heading_deg)
        x, y, z = rotated(about_up(-world_rad), pose.pos_m)
        dx, dy, dz = self.offset_m
        pos_m = rotated(about_up(-self.rotation_rad), (x - dx, y - dy, z - dz))
        q = quaternion_product(about_up(-world_rad - self.rotation_rad), pose.q)
        if self.up == "y":
            pos_m = rotated(conjugate(Z_FROM_Y_UP), pos_m)
            q = quaternion_product(quaternion_product(conjugate(Z_FROM_Y_UP), q), Z_FROM_Y_UP)
        return Pose(pose.at, pos_m, q)


def ned_frd(pose: Pose) -> Pose:
    """A pose of ENU and FLU in NED and FRD."""
    east, north, up = pose.pos_m
    return Pose(pose.at, (north, east, -up), quaternion_product(quaternion_product(NED_FROM_ENU, pose.q), FLU_FROM_FRD))


def about_up(angle_rad: float) -> Quaternion:
    """A turn about z, counter-clockwise from above."""
    return math.cos(angle_rad / 2), 0.0, 0.0, math.sin(angle_rad / 2)


def normalized(q: Quaternion) -> Quaternion:
    """With norm 1. The norm must not be 0."""
    norm = math.hypot(*q)
    w, x, y, z = q
    return w / norm, x / norm, y / norm, z / norm


def angle_between_rad(a: Quaternion, b: Quaternion) -> float:
    """The turn from one attitude to the other, 0 to pi; q and -q are the same attitude."""
    return 2.0 * math.acos(min(1.0, abs(sum(p * q for p, q in zip(a, b, strict=True)))))
