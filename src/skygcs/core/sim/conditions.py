"""Under what conditions a simulated vehicle flies: the airframe, the air, the sensors."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from math import cos, radians, sin

from skygcs.core.sim.body import Vector
from skygcs.core.sim.kinematics import Motion
from skygcs.core.sim.quad import F450, Airframe, Quad
from skygcs.core.sim.wind import Wind


class Dynamics(StrEnum):
    """How a vehicle moves."""

    RIGID = "rigid"
    """`quad`: forces, lags, wind; takes attitude setpoints."""
    KINEMATIC = "kinematic"
    """`kinematics`: a seventh of the cost, exact, without wind; an attitude setpoint lets it stop."""


@dataclass(frozen=True, slots=True)
class Conditions:
    """The default is still air and sensors without fault; every noise is seeded by the vehicle's own seed."""

    dynamics: Dynamics = Dynamics.RIGID
    airframe: Airframe = F450
    wind_enu_mps: Vector = (0.0, 0.0, 0.0)
    """Where the air moves to."""
    gust_mps: float = 0.0
    """Standard deviation of the gusts, per horizontal axis."""
    gps_noise_m: float = 0.0
    """Standard deviation of the slow wander of the estimated position; the vehicle flies by the estimate."""
    attitude_noise_rad: float = 0.0
    """Standard deviation of the told roll and pitch."""
    sensor_latency_s: float = 0.0
    """Age of position, velocity and attitude when they are told. The autopilot's own loops do not feel it."""


CALM = Conditions()


def wind_enu(speed_mps: float, from_deg: float) -> Vector:
    """A wind as a weather report gives it: the speed, and the compass direction it comes from."""
    return -speed_mps * sin(radians(from_deg)), -speed_mps * cos(radians(from_deg)), 0.0


def body_of(conditions: Conditions, yaw_rad: float, seed: int) -> Motion | Quad:
    """A vehicle at rest on the ground under these conditions."""
    if conditions.dynamics is Dynamics.KINEMATIC:
        return Motion(yaw_rad)
    wind = Wind(conditions.wind_enu_mps, conditions.gust_mps, seed)
    return Quad(conditions.airframe, yaw_rad=yaw_rad, wind=wind)
