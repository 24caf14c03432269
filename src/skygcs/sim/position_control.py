"""Position controller of a firmware: a target in, an acceleration out.

PX4's is in `px4_position_control`, ArduCopter's in `copter_position_control`; `steering` makes attitude and thrust of
the acceleration.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from math import cos, hypot, pi, sin, tan
from typing import Final

from skygcs.sim.body import GRAVITY_MPS2, AccelerationSetpoint, Body
from skygcs.sim.kinematics import Limits

Axes = tuple[float | None, float | None, float | None]

NO_AXES: Final[Axes] = (None, None, None)


@dataclass(frozen=True, slots=True)
class PositionTarget:
    """SET_POSITION_TARGET_* as a firmware took it: east, north, up about the simulator's origin; None: not given."""

    pos_enu_m: Axes = NO_AXES
    vel_enu_mps: Axes = NO_AXES
    acc_enu_mps2: Axes = NO_AXES
    yaw_rad: float | None = None
    """Compass yaw: 0 north, clockwise."""
    yaw_rate_radps: float | None = None


@dataclass(frozen=True, slots=True)
class ControlGains:
    """The gains of position and velocity control, and how far it may lean."""

    xy_p: float
    """Velocity per metre, 1/s."""
    xy_vel_p: float
    """Acceleration per m/s of error, 1/s; `xy_vel_i` of its integral, `xy_vel_d` of its derivative."""
    xy_vel_i: float
    xy_vel_d: float
    z_p: float
    z_vel_p: float
    z_vel_i: float
    tilt_max_rad: float
    jerk_xy_mps3: float
    jerk_z_mps3: float
    """Change of the acceleration of ArduCopter's shaped path; PX4 shapes no offboard target."""

    @property
    def accel_max_mps2(self) -> float:
        """Return what it can push sideways with its lift at hover."""
        return GRAVITY_MPS2 * tan(self.tilt_max_rad)


class PositionControl(ABC):
    """Follows targets; `gains` are those of the vehicle's parameters, set by the vehicle."""

    def __init__(self, gains: ControlGains) -> None:
        self.gains = gains

    @abstractmethod
    def restart(self, *, by_attitude: bool = False) -> None:
        """Something else has flown (``by_attitude``: attitude setpoints): forget the path, begin from the body's state
        at the next `step`."""

    @abstractmethod
    def step(self, body: Body, dt_s: float, target: PositionTarget, limits: Limits) -> AccelerationSetpoint:
        """The acceleration for the next ``dt_s``; ``body`` is the estimate."""


def filter_share(dt_s: float, cutoff_hz: float) -> float:
    """Share of the way to its input that a first-order low-pass goes in ``dt_s`` (AlphaFilter,
    calc_lowpass_alpha_dt)."""
    return dt_s / (dt_s + 1.0 / (2.0 * pi * cutoff_hz))


def bounded_length(x: float, y: float, most: float) -> tuple[float, float]:
    """The vector, no longer than ``most``."""
    size = hypot(x, y)
    return (x, y) if size <= most else (x * most / size, y * most / size)


def leaning_acceleration(body: Body) -> tuple[float, float]:
    """East and north: what the lean of the body gives at hover thrust. It begins the integrals, so that taking over a
    vehicle that leans against the wind does not jolt it."""
    ahead = -GRAVITY_MPS2 * tan(max(-1.2, min(1.2, body.pitch_rad)))
    right = GRAVITY_MPS2 * tan(max(-1.2, min(1.2, body.roll_rad)))
    yaw = body.yaw_rad
    return ahead * sin(yaw) + right * cos(yaw), ahead * cos(yaw) - right * sin(yaw)
