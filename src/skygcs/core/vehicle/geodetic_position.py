"""Targets of control as geodetic positions, so that a change of any frame moves no vehicle."""

from __future__ import annotations

from dataclasses import dataclass

from skygcs.core.control.cascade import Vector


@dataclass(frozen=True, slots=True)
class GeodeticPosition:
    """A point on earth."""

    lat_deg: float
    lon_deg: float
    alt_amsl_m: float


@dataclass(frozen=True, slots=True)
class Setpoint:
    """One setpoint of a stream. The velocity is true ENU; an axis that is ``free`` follows the velocity alone and
    ignores ``place``. None: zero; a yaw of None keeps the present reference."""

    place: GeodeticPosition | None = None
    vel_enu_mps: Vector | None = None
    acc_enu_mps2: Vector | None = None
    yaw_enu_rad: float | None = None
    free_xy: bool = False
    free_z: bool = False
    yaw_rate_enu_radps: float | None = None
    """Counter-clockwise positive. Without a yaw it turns from wherever its nose is."""
