"""Converts between the fleet's world frame, which people and programs use, and a vehicle's control frame. Pure.

Positions are converted by latitude and longitude, velocities and angles are rotated. So the frames may differ in origin
and heading. Targets of control are geodetic positions, so a change of any frame moves no vehicle.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from skygcs.core.control.cascade import Reference, Vector
from skygcs.core.geo import (
    EnuFrame,
    Origin,
    enu_from_geodetic,
    enu_from_world,
    geodetic_from_enu,
    heading_from_world_yaw_deg,
    heading_from_yaw_enu_deg,
    world_from_enu,
    world_yaw_rad,
    yaw_enu_from_heading_deg,
)
from skygcs.errors import RefusedError


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


# --- conversions ------------------------------------------------------------------------------------------------------


MAX_OFFSET_M = 100_000.0
MAX_SPEED_MPS = 100.0
MAX_ACCELERATION_MPS2 = 30.0
MAX_YAW_RATE_DPS = 360.0
"""A larger value is a mistake in the unit."""

Axes = Sequence[float | None]


def setpoint_from_world(
    origin: Origin,
    pos_m: Axes | None,
    vel_mps: Axes | None,
    acc_mps2: Sequence[float] | None,
    yaw_deg: float | None,
    yaw_rate_dps: float | None = None,
) -> Setpoint:
    """Make a setpoint from values along the world frame's axes; None is "not given". An axis without a position follows
    its velocity. Raises RefusedError for impossible values."""
    x, y, up = _axes("pos_enu_m", pos_m, MAX_OFFSET_M)
    vel = _axes("vel_enu_mps", vel_mps, MAX_SPEED_MPS)
    acc = None if acc_mps2 is None else _axes("acc_enu_mps2", acc_mps2, MAX_ACCELERATION_MPS2)
    if (x is None) != (y is None):
        raise RefusedError("pos_enu_m: give x and y together, or neither")
    place = None
    if x is not None or up is not None:
        place = GeodeticPosition(*geodetic_from_enu(x or 0.0, y or 0.0, up or 0.0, origin))
    return Setpoint(
        place,
        enu_from_world(_whole(vel), origin),
        None if acc is None else enu_from_world(_whole(acc), origin),
        None if yaw_deg is None else yaw_enu_rad(yaw_deg, origin),
        free_xy=x is None,
        free_z=up is None,
        yaw_rate_enu_radps=None if yaw_rate_dps is None else _yaw_rate(yaw_rate_dps),
    )


def yaw_enu_rad(world_yaw_deg: float, origin: Origin) -> float:
    """Yaw in the world frame (from its x axis) -> true ENU yaw."""
    if not abs(world_yaw_deg) <= 360.0:  # also false for NaN
        raise RefusedError(f"a yaw of {world_yaw_deg:g} is not between -360 and 360")
    return math.radians(yaw_enu_from_heading_deg(heading_from_world_yaw_deg(math.radians(world_yaw_deg), origin)))


def _yaw_rate(yaw_rate_dps: float) -> float:
    if not abs(yaw_rate_dps) <= MAX_YAW_RATE_DPS:  # also false for NaN
        raise RefusedError(
            f"a yaw rate of {yaw_rate_dps:g} is not between {-MAX_YAW_RATE_DPS:g} and {MAX_YAW_RATE_DPS:g}"
        )
    return math.radians(yaw_rate_dps)


def shown(status: dict[str, Any], frame: EnuFrame | None, origin: Origin | None) -> dict[str, Any]:
    """Convert an `OffboardController.status` for display: JSON-able, along the world frame's axes. Without an origin
    it has no position, and directions are true ENU."""
    reference, error = status["reference"], status["error_enu_m"]
    where = None
    if reference is not None and frame is not None and origin is not None:
        where = _reference(reference, frame, origin)

    def along(vector: Sequence[float], digits: int) -> list[float]:
        x, y, z = vector
        return _rounded((x, y, z) if origin is None else world_from_enu((x, y, z), origin), digits)

    numbers = {key: _number(value) for key, value in status.items() if isinstance(value, float)}
    return {
        **status,
        **numbers,
        "reference": where,
        "error_enu_m": None if error is None else along(error, 3),
        "integral_enu": along(status["integral_enu"], 4),
    }


def _reference(reference: Reference, frame: EnuFrame, origin: Origin) -> dict[str, Any]:
    pos = enu_from_geodetic(*frame.to_geodetic(*reference.pos_enu_m), origin)
    heading_deg = heading_from_yaw_enu_deg(math.degrees(reference.yaw_rad))
    free = (reference.velocity_only_xy, reference.velocity_only_xy, reference.velocity_only_z)
    return {
        "pos_enu_m": [None if f else p for f, p in zip(free, _rounded(pos, 3), strict=True)],
        "vel_enu_mps": _rounded(world_from_enu(reference.vel_enu_mps, origin), 3),
        "yaw_deg": round(math.degrees(world_yaw_rad(heading_deg, origin)), 2),
    }


def _axes(what: str, values: Axes | None, most: float) -> tuple[float | None, float | None, float | None]:
    if values is None:
        return None, None, None
    if len(values) != 3:
        raise RefusedError(f"{what} is x, y, up: three numbers, not {len(values)}")
    for value in values:
        if value is not None and not abs(value) <= most:  # also false for NaN
            raise RefusedError(f"{what} of {value:g} is not between {-most:g} and {most:g}")
    return values[0], values[1], values[2]


def _whole(values: tuple[float | None, float | None, float | None]) -> Vector:
    return values[0] or 0.0, values[1] or 0.0, values[2] or 0.0


def _rounded(vector: Sequence[float], digits: int) -> list[float]:
    return [round(value, digits) for value in vector]


def _number(value: float) -> float | None:
    return round(value, 4) if math.isfinite(value) else None
