"""From the fleet's world frame to what flies a vehicle and back, whatever the origin; pymap3d is the oracle."""

from __future__ import annotations

import math
from typing import Any

import pymap3d
import pytest
from hypothesis import given
from hypothesis import strategies as st

from skygcs.core.control.cascade import Reference
from skygcs.core.geo import EnuFrame, Origin
from skygcs.core.vehicle.frames import setpoint_from_world, shown, yaw_enu_rad
from skygcs.errors import RefusedError
from support.table import each

origins = st.builds(
    Origin, st.floats(-80, 80), st.floats(-179, 179), st.floats(-100, 3000), x_heading_deg=st.floats(-360, 360)
)
offsets = st.tuples(st.floats(-2000, 2000), st.floats(-2000, 2000), st.floats(-50, 200))
velocities = st.tuples(st.floats(-20, 20), st.floats(-20, 20), st.floats(-5, 5))
HERE = Origin(47.397742, 8.545594, 488.0)
OFF: dict[str, Any] = {"reference": None, "error_enu_m": None, "integral_enu": [0.0, 0.0, 0.0]}


def turned(vector: tuple[float, float, float], heading_deg: float) -> tuple[float, float, float]:
    """East, north, up of a vector whose x axis points along a compass heading: written down independently, as the sum
    of its parts along the two axes."""
    x_axis, y_axis = math.radians(heading_deg), math.radians(heading_deg - 90.0)
    east = vector[0] * math.sin(x_axis) + vector[1] * math.sin(y_axis)
    north = vector[0] * math.cos(x_axis) + vector[1] * math.cos(y_axis)
    return east, north, vector[2]


def same_angle(a: float, b: float) -> bool:
    return abs(math.remainder(a - b, math.tau)) < 1e-6


@given(origins, offsets, velocities, velocities, st.floats(-360, 360))
def test_a_setpoint_is_the_place_and_the_directions_that_were_meant(
    origin: Origin,
    pos: tuple[float, float, float],
    vel: tuple[float, float, float],
    acc: tuple[float, float, float],
    yaw_deg: float,
) -> None:
    setpoint = setpoint_from_world(origin, pos, vel, acc, yaw_deg)
    assert setpoint.place is not None and not setpoint.free_xy and not setpoint.free_z
    place = setpoint.place
    enu = pymap3d.geodetic2enu(
        *(place.lat_deg, place.lon_deg, place.alt_amsl_m), *(origin.lat_deg, origin.lon_deg, origin.alt_amsl_m)
    )
    assert [float(v) for v in enu] == pytest.approx(turned(pos, origin.x_heading_deg), abs=1e-3)
    assert setpoint.vel_enu_mps == pytest.approx(turned(vel, origin.x_heading_deg), abs=1e-9)
    assert setpoint.acc_enu_mps2 == pytest.approx(turned(acc, origin.x_heading_deg), abs=1e-9)
    nose = turned((math.cos(math.radians(yaw_deg)), math.sin(math.radians(yaw_deg)), 0.0), origin.x_heading_deg)
    assert setpoint.yaw_enu_rad is not None
    assert same_angle(setpoint.yaw_enu_rad, math.atan2(nose[1], nose[0]))


@given(origins, offsets, offsets, velocities, st.floats(-180, 180))
def test_what_is_shown_is_what_was_asked_for_wherever_the_anchor_is(
    origin: Origin,
    pos: tuple[float, float, float],
    anchor_at: tuple[float, float, float],
    vel: tuple[float, float, float],
    yaw_deg: float,
) -> None:
    setpoint = setpoint_from_world(origin, pos, vel, None, yaw_deg)
    anchor_place = setpoint_from_world(origin, anchor_at, None, None, None).place
    assert setpoint.place is not None and anchor_place is not None
    assert setpoint.vel_enu_mps is not None and setpoint.yaw_enu_rad is not None
    frame = EnuFrame(Origin(anchor_place.lat_deg, anchor_place.lon_deg, anchor_place.alt_amsl_m))
    place = setpoint.place
    reference = Reference(
        frame.from_geodetic(place.lat_deg, place.lon_deg, place.alt_amsl_m), setpoint.yaw_enu_rad, setpoint.vel_enu_mps
    )
    reported = shown({**OFF, "reference": reference}, frame, origin)["reference"]
    assert reported["pos_enu_m"] == pytest.approx(pos, abs=2e-3)
    assert reported["vel_enu_mps"] == pytest.approx(vel, abs=1e-3)
    assert abs(math.remainder(reported["yaw_deg"] - yaw_deg, 360)) < 0.011


def test_in_a_frame_whose_x_points_north_x_is_north_and_y_is_west() -> None:
    north = Origin(HERE.lat_deg, HERE.lon_deg, HERE.alt_amsl_m, x_heading_deg=0.0)
    setpoint = setpoint_from_world(north, (100.0, 0.0, 5.0), (1.0, 2.0, 3.0), None, 0.0)
    assert setpoint.place is not None and setpoint.place.lat_deg > HERE.lat_deg + 8e-4
    assert setpoint.place.lon_deg == pytest.approx(HERE.lon_deg, abs=1e-9)
    assert setpoint.vel_enu_mps == pytest.approx((-2.0, 1.0, 3.0))
    assert setpoint.yaw_enu_rad == pytest.approx(math.pi / 2)
    assert math.degrees(yaw_enu_rad(90.0, north)) == pytest.approx(-180.0)


def test_errors_and_integrals_are_shown_along_the_worlds_axes_and_rounded() -> None:
    north = Origin(HERE.lat_deg, HERE.lon_deg, HERE.alt_amsl_m, x_heading_deg=0.0)
    status = {**OFF, "error_enu_m": [1.0, 2.0, 3.00049], "integral_enu": [0.1, 0.0, 0.2], "rate_hz": 1 / 3}
    reported = shown(status, EnuFrame(HERE), north)
    assert reported["error_enu_m"] == pytest.approx([2.0, -1.0, 3.0])
    assert reported["integral_enu"] == pytest.approx([0.0, -0.1, 0.2])
    assert reported["rate_hz"] == 0.3333


def test_what_has_no_number_in_json_is_not_known() -> None:
    reported = shown({**OFF, "state_age_s": math.inf, "rtt_s": math.nan, "thrust": None}, None, None)
    assert (reported["state_age_s"], reported["rtt_s"], reported["thrust"]) == (None, None, None)


def test_without_an_origin_no_place_in_the_world_is_claimed() -> None:
    reported = shown(
        {**OFF, "reference": Reference((1.0, 2.0, 3.0)), "error_enu_m": [1.0004, 0.0, 0.0]}, EnuFrame(HERE), None
    )
    assert reported["reference"] is None and reported["error_enu_m"] == [1.0, 0.0, 0.0]


def test_axes_that_follow_a_velocity_have_no_place() -> None:
    free = setpoint_from_world(HERE, (None, None, 10.0), (1.0, 0.0, None), None, None)
    assert (free.free_xy, free.free_z) == (True, False)
    assert free.place is not None and free.place.alt_amsl_m == pytest.approx(HERE.alt_amsl_m + 10.0)
    assert free.vel_enu_mps == (1.0, 0.0, 0.0) and free.acc_enu_mps2 is None and free.yaw_enu_rad is None
    climb = setpoint_from_world(HERE, (1.0, 2.0, None), (None, None, 1.0), None, None)
    assert (climb.free_xy, climb.free_z) == (False, True)
    only = setpoint_from_world(HERE, None, (1.0, 0.0, 0.0), None, None)
    assert only.place is None and only.free_xy and only.free_z
    reference = Reference((5.0, 6.0, 7.0), velocity_only_xy=True)
    reported = shown({**OFF, "reference": reference}, EnuFrame(HERE), HERE)["reference"]
    assert reported["pos_enu_m"] == [None, None, pytest.approx(7.0, abs=1e-3)]


@each(
    ("pos", "vel", "acc", "yaw", "why"),
    [
        ((1.0, None, 2.0), None, None, None, "x and y together"),
        ((1.0, 2.0), None, None, None, "three numbers, not 2"),
        ((1e6, 0.0, 0.0), None, None, None, "pos_enu_m of 1e+06"),
        ((math.nan, 0.0, 0.0), None, None, None, "pos_enu_m of nan"),
        (None, (0.0, 0.0, 101.0), None, None, "vel_enu_mps of 101"),
        (None, (0.0, 0.0, math.inf), None, None, "vel_enu_mps of inf"),
        (None, None, (31.0, 0.0, 0.0), None, "acc_enu_mps2 of 31"),
        (None, None, None, 361.0, "yaw of 361"),
        (None, None, None, math.nan, "yaw of nan"),
    ],
)
def test_what_nobody_can_mean_is_refused_by_name(pos: Any, vel: Any, acc: Any, yaw: Any, why: str) -> None:
    with pytest.raises(RefusedError) as refused:
        setpoint_from_world(HERE, pos, vel, acc, yaw)
    assert why in str(refused.value)
