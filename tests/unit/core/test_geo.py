from __future__ import annotations

import math

import pymap3d
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pymap3d.vincenty import vdist

from skygcs.core import geo
from skygcs.core.geo import Origin
from support.table import each

HOME = (43.7806, -79.4653, 180.0)
TORONTO = Origin(*HOME)

headings = st.floats(-360, 360)
places = st.tuples(st.floats(-85, 85), st.floats(-179.9, 179.9), st.floats(-100, 5000))
offsets = st.tuples(*[st.floats(-20_000, 20_000)] * 2, st.floats(-500, 3000))


def ecef_enu(lat: float, lon: float, alt: float, origin: Origin) -> tuple[float, float, float]:
    """The textbook way, written out: WGS84 to ECEF, difference, rotation."""
    a, f = 6378137.0, 1 / 298.257223563
    e2 = f * (2 - f)

    def ecef(lat: float, lon: float, alt: float) -> tuple[float, float, float]:
        p, q = math.radians(lat), math.radians(lon)
        n = a / math.sqrt(1 - e2 * math.sin(p) ** 2)
        r = (n + alt) * math.cos(p)
        return r * math.cos(q), r * math.sin(q), (n * (1 - e2) + alt) * math.sin(p)

    d = [u - v for u, v in zip(ecef(lat, lon, alt), ecef(origin.lat_deg, origin.lon_deg, origin.alt_amsl_m))]  # noqa: B905
    p, q = math.radians(origin.lat_deg), math.radians(origin.lon_deg)
    sp, cp, sq, cq = math.sin(p), math.cos(p), math.sin(q), math.cos(q)
    east = -sq * d[0] + cq * d[1]
    north = -sp * cq * d[0] - sp * sq * d[1] + cp * d[2]
    return east, north, cp * cq * d[0] + cp * sq * d[1] + sp * d[2]


@given(places, offsets, headings)
def test_conversions_agree_with_pymap3d_and_come_back_within_a_millimetre(place, offset, heading) -> None:
    origin = Origin(*place, x_heading_deg=heading)
    ours = geo.geodetic_from_enu(*offset, origin)
    theirs = [float(v) for v in pymap3d.enu2geodetic(*geo.enu_from_world(offset, origin), *place)]
    assert geo.EnuFrame(origin).to_geodetic(*offset) == ours
    assert geo.EnuFrame(origin).from_geodetic(*ours) == geo.enu_from_geodetic(*ours, origin)
    assert geo.enu_from_geodetic(*theirs, origin) == pytest.approx(offset, abs=1e-4)
    back = [float(v) for v in pymap3d.geodetic2enu(*ours, *place)]
    assert geo.world_from_enu((back[0], back[1], back[2]), origin) == pytest.approx(offset, abs=1e-4)
    assert geo.enu_from_geodetic(*ours, origin) == pytest.approx(offset, abs=1e-3)


@given(places, offsets, headings)
def test_x_points_along_its_heading_and_y_to_the_left_of_it(place, offset, heading) -> None:
    origin, turned = Origin(*place), Origin(*place, x_heading_deg=heading)
    east, north, up = geo.enu_from_geodetic(*geo.geodetic_from_enu(*offset, turned), origin)
    sin, cos = math.sin(math.radians(heading)), math.cos(math.radians(heading))
    x, y, _ = offset
    assert (east, north) == pytest.approx((x * sin - y * cos, x * cos + y * sin), abs=1e-3)
    assert up == pytest.approx(offset[2], abs=1e-3)


def test_plain_enu_turns_nothing_to_the_last_bit() -> None:
    vector = (0.1, 1 / 3, -7e-9)
    assert geo.world_from_enu(vector, TORONTO) == vector
    assert geo.enu_from_world(vector, TORONTO) == vector
    assert geo.world_yaw_rad(90.0, TORONTO) == 0.0


@given(headings, st.tuples(*[st.floats(-50, 50)] * 3), st.floats(0, 359.9))
def test_velocities_and_yaws_come_back_and_keep_their_length_and_their_place_to_each_other(
    heading: float, velocity: tuple[float, float, float], course: float
) -> None:
    origin = Origin(*HOME, x_heading_deg=heading)
    world = geo.world_from_enu(velocity, origin)
    assert geo.enu_from_world(world, origin) == pytest.approx(velocity, abs=1e-12)
    assert math.hypot(*world) == pytest.approx(math.hypot(*velocity))
    yaw = geo.world_yaw_rad(course, origin)
    assert -math.pi <= yaw < math.pi
    back = geo.heading_from_world_yaw_deg(yaw, origin)
    assert geo.wrap_deg_180(back - course) == pytest.approx(0, abs=1e-9)
    nose = (math.sin(math.radians(course)), math.cos(math.radians(course)), 0.0)
    assert geo.world_from_enu(nose, origin) == pytest.approx((math.cos(yaw), math.sin(yaw), 0.0), abs=1e-9)


@given(places, offsets)
def test_enu_is_the_rotated_ecef_difference_and_has_an_inverse(place, offset) -> None:
    origin = Origin(*place)
    lat, lon, alt = geo.geodetic_from_enu(*offset, origin)
    assert geo.enu_from_geodetic(lat, lon, alt, origin) == pytest.approx(offset, abs=1e-4)
    assert ecef_enu(lat, lon, alt, origin) == pytest.approx(offset, abs=1e-3)


def test_axes_point_east_north_up() -> None:
    at = TORONTO
    east = geo.enu_from_geodetic(at.lat_deg, at.lon_deg + 1e-3, at.alt_amsl_m, at)
    north = geo.enu_from_geodetic(at.lat_deg + 1e-3, at.lon_deg, at.alt_amsl_m, at)
    up = geo.enu_from_geodetic(at.lat_deg, at.lon_deg, at.alt_amsl_m + 7, at)
    assert east == pytest.approx((80.5, 0, 0), abs=0.1)
    assert north == pytest.approx((0, 111.1, 0), abs=0.1)
    assert up == pytest.approx((0, 0, 7), abs=1e-6)


def test_a_degree_has_its_published_length() -> None:
    """Lengths of a degree on WGS84 (NGA): at the equator 110574.3 m and 111319.5 m, at 45 degrees 111131.7, 78846.8."""
    equator, middle = Origin(0, 10, 0), Origin(45, 10, 0)
    step = 1e-3
    assert geo.enu_from_geodetic(step, 10, 0, equator)[1] / step == pytest.approx(110574.3, abs=1)
    assert geo.enu_from_geodetic(0, 10 + step, 0, equator)[0] / step == pytest.approx(111319.5, abs=1)
    assert geo.enu_from_geodetic(45 + step, 10, 0, middle)[1] / step == pytest.approx(111131.7, abs=2)
    assert geo.enu_from_geodetic(45, 10 + step, 0, middle)[0] / step == pytest.approx(78846.8, abs=1)


@given(st.floats(-85, 85), st.floats(-179, 179), st.floats(-0.3, 0.3), st.floats(-0.3, 0.3))
def test_distance_is_within_its_promise_of_vincentys(lat: float, lon: float, dlat: float, dlon: float) -> None:
    true, _ = vdist(lat, lon, lat + dlat, lon + dlon)
    assert geo.distance_m(lat, lon, lat + dlat, lon + dlon) == pytest.approx(float(true), rel=0.006, abs=0.01)


def test_distance_goes_the_short_way_over_the_date_line() -> None:
    assert geo.distance_m(0, 179.9995, 0, -179.9995) == pytest.approx(111.2, abs=1)


@given(st.floats(-1e6, 1e6))
def test_wrapping_keeps_the_direction_and_stays_in_range(angle: float) -> None:
    full, half = geo.wrap_deg_360(angle), geo.wrap_deg_180(angle)
    assert 0 <= full < 360
    assert -180 <= half < 180
    for wrapped in (full, half):
        assert math.cos(math.radians(wrapped)) == pytest.approx(math.cos(math.radians(angle)), abs=1e-6)
        assert math.sin(math.radians(wrapped)) == pytest.approx(math.sin(math.radians(angle)), abs=1e-6)


@each(("heading", "yaw"), [(0, 90), (90, 0), (180, -90), (270, -180), (45, 45)])
def test_compass_and_enu_yaw_turn_into_each_other(heading: float, yaw: float) -> None:
    assert geo.yaw_enu_from_heading_deg(heading) == pytest.approx(yaw)
    assert geo.heading_from_yaw_enu_deg(yaw) == pytest.approx(heading)


ASKED = "; did you swap latitude and longitude?"


def test_the_swap_is_asked_for_where_it_fits_and_only_there() -> None:
    here = (43.78, -79.46)
    assert geo.swapped_hint(-79.46, 43.78, here, 1000.0) == ASKED
    assert geo.swapped_hint(43.78, -79.47, here, 1000.0) == "", "near as it is"
    assert geo.swapped_hint(10.0, 20.0, here, 1000.0) == "", "far both ways"
    assert geo.swapped_hint(120.0, 45.0, (45.0, 120.0), 1000.0) == ASKED, "no place on earth as it is"
    assert geo.swapped_hint(120.0, 45.0, None, 0.0) == ASKED and geo.swapped_hint(45.0, 120.0, None, 0.0) == ""
    assert geo.swapped_hint(float("nan"), 45.0, here, 1000.0) == ""
