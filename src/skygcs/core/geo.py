"""WGS84 and the fleet's world frame: ENU (x east, y north, z up, metres) about one origin, and compass angles.

Heights are AMSL throughout: an ellipsoid height differs from it by the geoid's undulation, which over a flying site is
one constant that cancels between a point and the origin.
pymap3d does the geodesy; it is imported on first use because it brings numpy with it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

EARTH_RADIUS_M = 6_371_008.8
"""Mean radius (IUGG); only for `distance_m`, whose error stays below 0.6 %."""


@dataclass(frozen=True, slots=True)
class Origin:
    """The point that is (0, 0, 0) for the whole fleet."""

    lat_deg: float
    lon_deg: float
    alt_amsl_m: float


def enu_from_geodetic(lat_deg: float, lon_deg: float, alt_amsl_m: float, origin: Origin) -> tuple[float, float, float]:
    """(east, north, up) in metres of a point about the origin."""
    import pymap3d

    east, north, up = pymap3d.geodetic2enu(
        lat_deg, lon_deg, alt_amsl_m, origin.lat_deg, origin.lon_deg, origin.alt_amsl_m
    )
    return float(east), float(north), float(up)


def geodetic_from_enu(east_m: float, north_m: float, up_m: float, origin: Origin) -> tuple[float, float, float]:
    """(lat_deg, lon_deg, alt_amsl_m) of an ENU point; the inverse of `enu_from_geodetic`."""
    import pymap3d

    lat, lon, alt = pymap3d.enu2geodetic(east_m, north_m, up_m, origin.lat_deg, origin.lon_deg, origin.alt_amsl_m)
    return float(lat), float(lon), float(alt)


def distance_m(lat_a_deg: float, lon_a_deg: float, lat_b_deg: float, lon_b_deg: float) -> float:
    """Great-circle distance on a sphere: for limits, not for control."""
    lat_a, lat_b = math.radians(lat_a_deg), math.radians(lat_b_deg)
    half_lat = math.sin((lat_b - lat_a) / 2)
    half_lon = math.sin(math.radians(lon_b_deg - lon_a_deg) / 2)
    chord = half_lat * half_lat + math.cos(lat_a) * math.cos(lat_b) * half_lon * half_lon
    return 2 * EARTH_RADIUS_M * math.asin(min(1.0, math.sqrt(chord)))


def wrap_deg_360(angle_deg: float) -> float:
    """The same direction in [0, 360)."""
    wrapped = math.fmod(angle_deg, 360.0)
    if wrapped < 0:
        wrapped += 360.0
    return 0.0 if wrapped >= 360.0 else wrapped


def wrap_deg_180(angle_deg: float) -> float:
    """The same direction in [-180, 180)."""
    return wrap_deg_360(angle_deg + 180.0) - 180.0


def yaw_enu_from_heading_deg(heading_deg: float) -> float:
    """Compass heading (0 north, clockwise) -> ENU yaw (0 east, counter-clockwise), both degrees, in [-180, 180)."""
    return wrap_deg_180(90.0 - heading_deg)


def heading_from_yaw_enu_deg(yaw_deg: float) -> float:
    """ENU yaw -> compass heading in [0, 360), both degrees."""
    return wrap_deg_360(90.0 - yaw_deg)
