"""Velocities and headings of another site in the own frame, against pymap3d."""

from __future__ import annotations

import math

import pymap3d
import pytest
from hypothesis import given
from hypothesis import strategies as st

from skygcs.core.geo import Origin
from skygcs.ext.federation.protocol.origin_shift import velocity_in, yaw_in

latitudes, longitudes = st.floats(-75, 75), st.floats(-170, 170)
apart_deg = st.floats(-0.9, 0.9)
velocities = st.tuples(*[st.floats(-30, 30)] * 3)


@given(latitudes, longitudes, apart_deg, apart_deg, velocities)
def test_a_velocity_is_the_derivative_of_the_place_in_the_own_frame(
    lat: float, lon: float, d_lat: float, d_lon: float, velocity: tuple[float, float, float]
) -> None:
    """Moved along its own true east, north, up for a second, by pymap3d."""
    ours = Origin(lat + d_lat, lon + d_lon, 0.0)
    moved = pymap3d.enu2geodetic(*velocity, lat, lon, 100.0)
    before = pymap3d.geodetic2enu(lat, lon, 100.0, ours.lat_deg, ours.lon_deg, 0.0)
    after = pymap3d.geodetic2enu(*moved, ours.lat_deg, ours.lon_deg, 0.0)
    expected = [float(b - a) for a, b in zip(before, after, strict=True)]
    assert list(velocity_in(ours, velocity, lat, lon)) == pytest.approx(expected, abs=1e-4)


def test_meridians_converge_by_a_degree_and_a_half_over_a_hundred_kilometres_at_sixty_north() -> None:
    ours = Origin(60.0, 10.0, 0.0)
    east_100_km_deg = math.degrees(100_000.0 / (6_378_137.0 * math.cos(math.radians(60.0))))
    turned = math.degrees(yaw_in(ours, 0.0, 60.0, 10.0 + east_100_km_deg))
    assert turned == pytest.approx(math.degrees(100_000.0 / 6_378_137.0) * math.tan(math.radians(60.0)), abs=0.02)


def test_a_heading_at_the_origin_is_turned_by_its_axes_only() -> None:
    ours = Origin(48.0, 11.0, 500.0, x_heading_deg=0.0)
    assert yaw_in(ours, math.pi / 2, 48.0, 11.0) == pytest.approx(0.0, abs=1e-9)
