"""The autopilot's own controllers fly the rigid body as a well-tuned autopilot does, wind and gusts included."""

from __future__ import annotations

from math import hypot, pi, radians

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from skygcs.sim.body import AttitudeSetpoint, wrap_pi
from skygcs.sim.kinematics import Limits, Setpoint
from skygcs.sim.quad import F450, Quad
from skygcs.sim.wind import Wind
from support.examples import examples
from support.table import each

LIMITS = Limits(speed_mps=5.0, accel_mps2=2.5, climb_mps=2.0, descent_mps=1.0)
DT = 0.02


def run(quad: Quad, seconds: float, setpoint: Setpoint | AttitudeSetpoint | None) -> list[tuple[float, float, float]]:
    track = []
    for _ in range(round(seconds / DT)):
        quad.step(DT, setpoint, LIMITS)
        track.append(quad.pos_enu_m)
    return track


@each(("wind", "off_m"), [(Wind(), 0.01), (Wind((5.0, 0.0, 0.0)), 0.01), (Wind((-6.0, 8.0, 0.0), gust_mps=1.0), 0.5)])
def test_it_takes_off_arrives_and_lands(wind: Wind, off_m: float) -> None:
    quad = Quad(wind=wind)
    quad.supply_v = 16.5
    climb = run(quad, 25.0, Setpoint((0.0, 0.0, 10.0)))
    assert quad.distance_m(0.0, 0.0, 10.0) < max(0.3, off_m), "gusts push it about"
    assert max(up for _, _, up in climb) < 10.3
    fastest = 0.0
    for _ in range(round(25.0 / DT)):
        quad.step(DT, Setpoint((30.0, 40.0, 15.0)), LIMITS)
        fastest = max(fastest, quad.groundspeed_mps)
    assert quad.distance_m(30.0, 40.0, 15.0) < max(off_m, 0.02)
    assert fastest < 1.2 * LIMITS.speed_mps
    down = run(quad, 50.0, Setpoint((30.0, 40.0, None), (None, None, -0.5)))
    assert quad.on_ground and hypot(quad.east_m - 30.0, quad.north_m - 40.0) < max(off_m, 0.1)
    assert down[-1] == down[-500], "and stays on the ground while it still wants down"


def test_a_velocity_is_reached_and_a_stop_holds_no_more_than_the_wind_allows() -> None:
    quad = Quad(wind=Wind((0.0, -4.0, 0.0)))
    quad.place(0.0, 0.0, 20.0)
    run(quad, 12.0, Setpoint((None, None, 20.0), (3.0, 2.0, None)))
    assert (quad.vel_e_mps, quad.vel_n_mps) == pytest.approx((3.0, 2.0), abs=0.02)
    run(quad, 12.0, Setpoint((None, None, 20.0)))
    assert quad.groundspeed_mps < 0.02


def test_a_wind_too_strong_to_fly_against_drags_it_away_without_winding_it_up() -> None:
    storm = Wind((20.0, 0.0, 0.0))
    quad = Quad(wind=storm)
    quad.place(0.0, 0.0, 50.0)
    run(quad, 30.0, Setpoint((0.0, 0.0, 50.0)))
    assert quad.east_m > 20.0 and quad.up_m == pytest.approx(50.0, abs=1.0)
    away = quad.east_m
    storm.mean_enu_mps = (0.0, 0.0, 0.0)
    back = run(quad, 90.0, Setpoint((0.0, 0.0, 50.0)))
    assert away > 20.0 and abs(back[-1][0]) < 0.1
    assert min(east for east, _, _ in back) > -4.0


def test_a_climb_rate_under_an_attitude_keeps_the_height_of_a_leaning_vehicle() -> None:
    quad = Quad()
    quad.place(0.0, 0.0, 20.0)
    quad.supply_v = 14.0
    run(quad, 5.0, AttitudeSetpoint(None))
    assert quad.up_m == pytest.approx(20.0, abs=0.2)
    run(quad, 5.0, AttitudeSetpoint(None, climb_mps=-0.8))
    assert quad.vel_u_mps == pytest.approx(-0.8, abs=0.02)


def test_a_thrown_vehicle_catches_itself() -> None:
    quad = Quad()
    quad.place(0.0, 0.0, 60.0)
    quad.vel_e_mps, quad.vel_n_mps, quad.vel_u_mps = 8.0, -6.0, -5.0
    track = run(quad, 30.0, Setpoint((0.0, 0.0, 60.0)))
    assert quad.is_at(0.0, 0.0, 60.0)
    assert min(up for _, _, up in track) > 45.0


@settings(max_examples=examples(25))
@given(st.floats(-pi, pi), st.floats(-pi, pi))
def test_it_turns_to_a_yaw_by_the_short_way_and_stays_where_it_is(start: float, target: float) -> None:
    quad = Quad(yaw_rad=start)
    quad.place(0.0, 0.0, 20.0)
    run(quad, 5.0, Setpoint((0.0, 0.0, 20.0), yaw_rad=target))
    assert abs(wrap_pi(quad.yaw_rad - target)) < radians(0.5)
    assert hypot(quad.east_m, quad.north_m) < 0.05


def test_it_never_asks_for_a_thrust_outside_what_the_motors_have() -> None:
    quad = Quad(wind=Wind((0.0, 0.0, 0.0), gust_mps=3.0))
    quad.place(0.0, 0.0, 30.0)
    for i in range(2000):
        target = 60.0 if i // 200 % 2 else 0.5
        quad.step(DT, Setpoint((0.0, 0.0, target)), LIMITS)
        assert 0.0 <= quad.thrust <= 1.0
        assert hypot(quad.roll_rad, quad.pitch_rad) < radians(60)
    assert F450.hover_thrust < 1.0
