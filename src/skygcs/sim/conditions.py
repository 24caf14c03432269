"""Under what conditions a simulated vehicle flies: the airframe, the air, the sensors."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from enum import StrEnum
from math import cos, hypot, isfinite, radians, sin

from skygcs.sim.body import Vector
from skygcs.sim.kinematics import Motion
from skygcs.sim.quad import F450, IDEAL, SIH, Airframe, Quad
from skygcs.sim.wind import Wind


class Dynamics(StrEnum):
    """Body and control of a vehicle."""

    RIGID = "rigid"
    """`quad`: forces, lags, wind; takes attitude setpoints."""
    KINEMATIC = "kinematic"
    """`kinematics`: exact, without wind; an attitude setpoint lets it stop. 30 us a tick in flight, a rigid one 47."""


@dataclass(frozen=True, slots=True)
class Conditions:
    """The default is still air and sensors without fault; every noise is seeded by the vehicle's own seed.

    Raises ValueError for numbers out of range.
    """

    dynamics: Dynamics = Dynamics.RIGID
    airframe: Airframe = F450
    wind_enu_mps: Vector = (0.0, 0.0, 0.0)
    """Direction towards which the air moves."""
    gust_mps: float = 0.0
    """Standard deviation of the gusts, per horizontal axis."""
    gps_noise_m: float = 0.0
    """Standard deviation of the slow wander of the estimated position; the vehicle flies by the estimate."""
    attitude_noise_rad: float = 0.0
    """Standard deviation of the reported roll and pitch."""
    sensor_latency_s: float = 0.0
    """Age of position, velocity and attitude when they are reported. The autopilot's own loops do not feel it."""

    def __post_init__(self) -> None:
        for name, value, most in (
            ("attitude_lag_s", self.airframe.attitude_lag_s, 2.0),
            ("wind", hypot(*self.wind_enu_mps), 30.0),
            ("gust_mps", self.gust_mps, 10.0),
            ("gps_noise_m", self.gps_noise_m, 10.0),
            ("attitude_noise_rad", self.attitude_noise_rad, 0.2),
            ("sensor_latency_s", self.sensor_latency_s, 2.0),
        ):
            if not 0.0 <= value <= most:
                raise ValueError(f"{name} {value:g} is not in 0..{most:g}")


CALM = Conditions()

AIRFRAMES: Mapping[str, Airframe] = {"f450": F450, "ideal": IDEAL, "sih": SIH}
"""By the names fleet files and the command line use."""


def conditions_of(  # noqa: PLR0913 - each is a key of the fleet file
    *,
    dynamics: str = "rigid",
    airframe: str = "f450",
    attitude_lag_s: float | None = None,
    wind_mps: float = 0.0,
    wind_from_deg: float = 270.0,
    gust_mps: float = 0.0,
    gps_noise_m: float = 0.0,
    attitude_noise_deg: float = 0.0,
    sensor_latency_s: float = 0.0,
) -> Conditions:
    """Conditions as a fleet file words them (docs/reference/fleet-file.md); ``attitude_lag_s`` None: the airframe's.

    Raises ValueError for a number out of range, or an unknown name.
    """
    if airframe not in AIRFRAMES:
        raise ValueError(f"airframe {airframe!r}: there are {', '.join(AIRFRAMES)}")
    if not (wind_mps >= 0.0 and isfinite(wind_from_deg)):
        raise ValueError(
            f"wind {wind_mps:g} m/s from {wind_from_deg:g}: a speed of 0 or more, from a compass direction"
        )
    frame = AIRFRAMES[airframe]
    return Conditions(
        dynamics=Dynamics(dynamics),
        airframe=frame if attitude_lag_s is None else replace(frame, attitude_lag_s=attitude_lag_s),
        wind_enu_mps=wind_enu(wind_mps, wind_from_deg),
        gust_mps=gust_mps,
        gps_noise_m=gps_noise_m,
        attitude_noise_rad=radians(attitude_noise_deg),
        sensor_latency_s=sensor_latency_s,
    )


def wind_enu(speed_mps: float, from_deg: float) -> Vector:
    """A wind as a weather report gives it: the speed, and the compass direction it comes from."""
    return -speed_mps * sin(radians(from_deg)), -speed_mps * cos(radians(from_deg)), 0.0


def body_of(conditions: Conditions, yaw_rad: float, seed: int) -> Motion | Quad:
    """A vehicle at rest on the ground under these conditions."""
    if conditions.dynamics is Dynamics.KINEMATIC:
        return Motion(yaw_rad)
    wind = Wind(conditions.wind_enu_mps, conditions.gust_mps, seed)
    return Quad(conditions.airframe, yaw_rad=yaw_rad, wind=wind)
