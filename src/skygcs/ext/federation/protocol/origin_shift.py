"""Another site's velocities and headings in the own world frame. Pure.

Sites exchange positions in degrees, and velocities along true east, north and up at the vehicle. East and up differ
between two places: by 1.5 degrees over 100 km at 60 degrees north. A velocity is rotated by that difference, so that it
is the derivative of the position in the own frame.
"""

from __future__ import annotations

import math

from skygcs.core.geo import Origin, Vector, world_from_enu


def velocity_in(ours: Origin, vel_enu_mps: Vector, lat_deg: float, lon_deg: float) -> Vector:
    """A velocity (true east, north, up at that place, m/s) along the axes of the own world frame, m/s."""
    return world_from_enu(_turned(vel_enu_mps, lat_deg, lon_deg, ours), ours)


def yaw_in(ours: Origin, yaw_rad: float, lat_deg: float, lon_deg: float) -> float:
    """A yaw (0 true east, counter-clockwise) at that place as yaw in the own world frame, in [-pi, pi]."""
    x, y, _ = velocity_in(ours, (math.cos(yaw_rad), math.sin(yaw_rad), 0.0), lat_deg, lon_deg)
    return math.atan2(y, x)


def _turned(vector: Vector, lat_deg: float, lon_deg: float, to: Origin) -> Vector:
    """From east, north, up at a place to those at the origin, by way of the earth's axes."""
    east, north, up = vector
    lat, lon = math.radians(lat_deg), math.radians(lon_deg)
    sin_lat, cos_lat, sin_lon, cos_lon = math.sin(lat), math.cos(lat), math.sin(lon), math.cos(lon)
    outward = cos_lat * up - sin_lat * north
    x = cos_lon * outward - sin_lon * east
    y = sin_lon * outward + cos_lon * east
    z = cos_lat * north + sin_lat * up
    lat, lon = math.radians(to.lat_deg), math.radians(to.lon_deg)
    sin_lat, cos_lat, sin_lon, cos_lon = math.sin(lat), math.cos(lat), math.sin(lon), math.cos(lon)
    outward = cos_lon * x + sin_lon * y
    return cos_lon * y - sin_lon * x, cos_lat * z - sin_lat * outward, cos_lat * outward + sin_lat * z
