"""A simulated vehicle moves within its limits and gets where it was told."""

from __future__ import annotations

from math import cos, hypot, pi, radians, sin

import pymap3d
import pytest
from hypothesis import given
from hypothesis import strategies as st

from skygcs.sim.kinematics import TERMINAL_MPS, Limits, LocalFrame, Motion, Setpoint, bounded_limits, wrap_pi
from support.table import each

LIMITS = Limits(speed_mps=5.0, accel_mps2=2.5, climb_mps=2.0, descent_mps=1.0)
DT = 0.02


def in_air(up_m: float = 20.0) -> Motion:
    motion = Motion()
    motion.up_m = up_m
    return motion


@each(("east", "north", "up"), [(30, 40, 25), (-0.5, 0.2, 20), (0, 0, 60), (-200, 5, 2)])
def test_it_arrives_without_overshoot(east: float, north: float, up: float) -> None:
    motion = in_air()
    start = hypot(east, north)
    for _ in range(int(120 / DT)):
        motion.step(DT, Setpoint((east, north, up)), LIMITS)
        assert hypot(motion.east_m, motion.north_m) <= start + 0.05
    assert motion.is_at(east, north, up)
    assert motion.distance_m(east, north, up) < 0.01


def test_no_limit_is_exceeded_on_the_way() -> None:
    motion = in_air()
    velocity = (0.0, 0.0)
    for i in range(3000):
        target = Setpoint((100.0, -50.0, 60.0)) if i < 1500 else Setpoint((-100.0, 0.0, 5.0))
        motion.step(DT, target, LIMITS)
        assert motion.groundspeed_mps <= LIMITS.speed_mps + 1e-9
        assert -LIMITS.descent_mps - 1e-9 <= motion.vel_u_mps <= LIMITS.climb_mps + 1e-9
        change = hypot(motion.vel_e_mps - velocity[0], motion.vel_n_mps - velocity[1])
        assert change <= LIMITS.accel_mps2 * DT + 1e-9
        velocity = motion.vel_e_mps, motion.vel_n_mps


def test_a_velocity_setpoint_is_followed_and_clamped() -> None:
    motion = in_air()
    for _ in range(500):
        motion.step(DT, Setpoint((None, None, None), (30.0, 40.0, -9.0)), LIMITS)
    assert (motion.vel_e_mps, motion.vel_n_mps) == pytest.approx((3.0, 4.0))
    assert motion.vel_u_mps == pytest.approx(-1.0)


def test_without_lift_it_falls_and_stays_on_the_ground() -> None:
    motion = in_air(100.0)
    fastest = 0.0
    for _ in range(1000):
        motion.step(DT, None, LIMITS)
        fastest = min(fastest, motion.vel_u_mps)
    assert motion.on_ground and motion.up_m == 0.0 and motion.groundspeed_mps == 0.0
    assert -TERMINAL_MPS <= fastest < -30


def test_the_ground_stops_a_descent_and_lets_it_rise_again() -> None:
    motion = in_air(1.0)
    for _ in range(300):
        motion.step(DT, Setpoint((0.0, 0.0, None), (None, None, -1.0)), LIMITS)
    assert motion.on_ground
    for _ in range(500):
        motion.step(DT, Setpoint((0.0, 0.0, 3.0)), LIMITS)
    assert motion.is_at(0.0, 0.0, 3.0)


@given(st.floats(-pi, pi), st.floats(-10, 10))
def test_it_turns_the_short_way_round(start: float, target: float) -> None:
    motion = in_air()
    motion.yaw_rad = start
    shortest = abs(wrap_pi(target - start))
    turned = 0.0
    for _ in range(400):
        motion.step(DT, Setpoint((0.0, 0.0, 20.0), yaw_rad=target), LIMITS)
        turned += abs(motion.yaw_rate_radps) * DT
    assert abs(wrap_pi(motion.yaw_rad - target)) < 1e-6
    assert turned == pytest.approx(shortest, abs=1e-6)


def test_it_leans_into_its_acceleration() -> None:
    motion = in_air()
    motion.yaw_rad = radians(90)  # nose east
    for _ in range(50):
        motion.step(DT, Setpoint((None, None, 20.0), (5.0, 0.0, None)), LIMITS)
    assert motion.pitch_rad < -0.1, "nose down"
    assert abs(motion.roll_rad) < 0.01
    motion = in_air()
    for _ in range(50):
        motion.step(DT, Setpoint((None, None, 20.0), (5.0, 0.0, None)), LIMITS)
    assert motion.roll_rad > 0.1, "right side down"


def test_parameters_out_of_reason_leave_it_flyable() -> None:
    wild = bounded_limits(speed_mps=0.0, accel_mps2=-3.0, climb_mps=1e30, descent_mps=float("inf"), yaw_rate_radps=0)
    motion = in_air()
    for _ in range(5000):
        motion.step(DT, Setpoint((5.0, 0.0, 1e12), (None, None, None), yaw_rad=1.0), wild)
    assert 0 < motion.groundspeed_mps < 1
    assert motion.vel_u_mps <= 30


@given(st.floats(-80, 80), st.floats(-179.9, 179.9), st.floats(0, 1000), st.floats(0, 2 * pi))
def test_the_local_frame_agrees_with_wgs84_to_a_decimetre_in_a_kilometre(
    lat: float, lon: float, distance: float, bearing: float
) -> None:
    frame = LocalFrame(lat, lon, 100.0)
    east, north = distance * sin(bearing), distance * cos(bearing)
    got_lat, got_lon = frame.to_geodetic(east, north)
    # the frame is flat: compare along the ellipsoid, where the height over the tangent plane does not enter
    e, n, _ = pymap3d.geodetic2enu(got_lat, got_lon, 100.0, lat, lon, 100.0)
    tolerance = 0.1 if abs(lat) < 50 else 0.5
    assert hypot(e - east, n - north) < tolerance
    assert frame.to_local(got_lat, got_lon) == pytest.approx((east, north), abs=1e-6)


def test_the_local_frame_crosses_the_date_line() -> None:
    frame = LocalFrame(-17.0, 179.9999, 0.0)
    east, _ = frame.to_local(-17.0, -179.9999)
    assert 20 < east < 22
