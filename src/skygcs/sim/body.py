"""A vehicle in space: where it is, how it moves and how it lies. What moves it is in `kinematics` and `quad`.

ENU metres about the point where the vehicle was first powered; the ground is flat, up 0.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import acos, cos, degrees, hypot, pi, remainder, sin

GRAVITY_MPS2 = 9.81

ARRIVED_M = 0.3
"""Closer than this and slower than ARRIVED_MPS is there."""

ARRIVED_MPS = 0.3

IMPACT_MPS = 4.0
"""Met faster than this, the ground breaks a quadrotor: a fall from 0.8 m. Landings are six times slower."""

TOPPLED_RAD = pi / 2
"""A quadrotor that has crashed lies on its side."""

Vector = tuple[float, float, float]
Quaternion = tuple[float, float, float, float]


def wrap_pi(angle_rad: float) -> float:
    """Into [-pi, pi]."""
    return remainder(angle_rad, 2 * pi)


def turned_by(rates_frd_radps: Vector, seconds: float) -> Quaternion:
    """The rotation that these body rates make in so long."""
    p, q, r = rates_frd_radps
    speed = hypot(p, q, r)
    half = speed * seconds / 2
    if half < 1e-9:
        return 1.0, 0.0, 0.0, 0.0
    scale = sin(half) / speed
    return cos(half), p * scale, q * scale, r * scale


@dataclass(frozen=True, slots=True)
class AttitudeSetpoint:
    """Attitude or body rates, and thrust, as SET_ATTITUDE_TARGET requests them.

    ``attitude_ned_frd`` turns FRD body vectors into NED ones (w, x, y, z), of unit length; None keeps level and the
    yaw there is, or turns with the rates. ``thrust`` is collective and normalised (0..1); None: the autopilot's height
    controller follows ``climb_mps`` instead.
    """

    attitude_ned_frd: Quaternion | None
    thrust: float | None = None
    climb_mps: float = 0.0
    rates_frd_radps: tuple[float | None, float | None, float | None] | None = None
    """Body rates: feed-forward of an attitude, or flown alone; None for one: the turn there is."""
    turns_on: bool = False
    """The attitude turns on with the rates until the next one (ArduCopter)."""


@dataclass(frozen=True, slots=True)
class AccelerationSetpoint:
    """Acceleration that a position controller requests. Compass yaw; None keeps it, or turns with the yaw rate."""

    acc_enu_mps2: Vector
    yaw_rad: float | None = None
    yaw_rate_radps: float = 0.0


class Body:
    """Position, velocity and attitude of one vehicle. Yaw is compass yaw: 0 north, clockwise."""

    __slots__ = (
        "accel_enu_mps2",
        "crashed",
        "east_m",
        "north_m",
        "pitch_rad",
        "pitch_rate_radps",
        "roll_rad",
        "roll_rate_radps",
        "up_m",
        "vel_e_mps",
        "vel_n_mps",
        "vel_u_mps",
        "yaw_rad",
        "yaw_rate_radps",
    )

    def __init__(self, yaw_rad: float = 0.0) -> None:
        self.east_m = 0.0
        self.north_m = 0.0
        self.up_m = 0.0
        self.vel_e_mps = 0.0
        self.vel_n_mps = 0.0
        self.vel_u_mps = 0.0
        self.accel_enu_mps2: Vector = (0.0, 0.0, 0.0)
        self.yaw_rad = wrap_pi(yaw_rad)
        self.yaw_rate_radps = 0.0
        self.roll_rad = 0.0
        self.pitch_rad = 0.0
        self.roll_rate_radps = 0.0
        self.pitch_rate_radps = 0.0
        self.crashed = False
        """True after a hard impact: the vehicle lies on its side, and its motors do not lift it."""

    @property
    def lean_deg(self) -> float:
        """Angle of the thrust axis from the vertical."""
        return degrees(acos(max(-1.0, min(1.0, cos(self.roll_rad) * cos(self.pitch_rad)))))

    @property
    def on_ground(self) -> bool:
        return self.up_m <= 0.0 and self.vel_u_mps <= 0.0

    @property
    def groundspeed_mps(self) -> float:
        return hypot(self.vel_e_mps, self.vel_n_mps)

    @property
    def heading_deg(self) -> float:
        """Compass heading, [0, 360)."""
        return degrees(self.yaw_rad) % 360.0

    @property
    def pos_enu_m(self) -> Vector:
        return self.east_m, self.north_m, self.up_m

    @property
    def vel_enu_mps(self) -> Vector:
        return self.vel_e_mps, self.vel_n_mps, self.vel_u_mps

    def distance_m(self, east_m: float, north_m: float, up_m: float) -> float:
        return hypot(east_m - self.east_m, north_m - self.north_m, up_m - self.up_m)

    def is_at(self, east_m: float, north_m: float, up_m: float) -> bool:
        """Near the point and nearly still."""
        near = self.distance_m(east_m, north_m, up_m) < ARRIVED_M
        return near and hypot(self.groundspeed_mps, self.vel_u_mps) < ARRIVED_MPS

    def copy(self, other: Body) -> None:
        """Be where the other is, as it is."""
        self.east_m, self.north_m, self.up_m = other.east_m, other.north_m, other.up_m
        self.vel_e_mps, self.vel_n_mps, self.vel_u_mps = other.vel_e_mps, other.vel_n_mps, other.vel_u_mps
        self.accel_enu_mps2, self.crashed = other.accel_enu_mps2, other.crashed
        self.roll_rad, self.pitch_rad, self.yaw_rad = other.roll_rad, other.pitch_rad, other.yaw_rad
        self.roll_rate_radps, self.pitch_rate_radps = other.roll_rate_radps, other.pitch_rate_radps
        self.yaw_rate_radps = other.yaw_rate_radps

    def touch(self) -> None:
        """Meet the ground with the speed that it has, and lie there."""
        if self.vel_u_mps < -IMPACT_MPS:
            self.crashed = True
        self.up_m = max(0.0, self.up_m)
        self.rest()

    def set_up(self) -> None:
        """Stand upright again, as after a person has picked it up where it lay."""
        self.crashed = False
        self.rest()

    def rest(self) -> None:
        """Lie still where it is: level, or on its side."""
        self.vel_e_mps = self.vel_n_mps = self.vel_u_mps = 0.0
        self.accel_enu_mps2 = (0.0, 0.0, 0.0)
        self.roll_rad, self.pitch_rad = (TOPPLED_RAD if self.crashed else 0.0), 0.0
        self.roll_rate_radps = self.pitch_rate_radps = 0.0
