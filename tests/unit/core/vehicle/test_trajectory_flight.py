"""A trajectory in the vehicle's local frame, and what is checked before it begins."""

from __future__ import annotations

import math

import pytest

from skygcs.core.control.control_fence import Fence
from skygcs.core.geo import EnuFrame, Origin
from skygcs.core.trajectory import ClockState, Piece, Trajectory
from skygcs.core.vehicle.trajectory_flight import (
    LoadedTrajectory,
    TrajectoryFlight,
    TrajectoryLimits,
    common_clock,
    distance_refusal,
    require_speed,
)
from skygcs.errors import ConfigError, RefusedError, TrajectoryError
from support.table import each

WORLD = Origin(47.4, 8.5, 400.0, x_heading_deg=0.0)
"""x is north."""

LOCAL = EnuFrame(Origin(47.401, 8.502, 410.0))


def along_x(by_m: float = 8.0, seconds: float = 4.0, up_m: float = 5.0, yaw: float | None = 0.0) -> LoadedTrajectory:
    x = (0.0, 0.0, 3 * by_m / seconds**2, -2 * by_m / seconds**3)
    yaws = None if yaw is None else (yaw, 0.1)
    return LoadedTrajectory(Trajectory([Piece(seconds, x, (1.0,), (up_m,), yaws)]), "leg")


def test_positions_and_directions_are_those_of_the_world_on_earth() -> None:
    loaded = along_x()
    clock = common_clock([loaded], 1.0, 1.0)
    flight = TrajectoryFlight(loaded, clock, WORLD, LOCAL)
    clock.start(0.0, 0.0)
    world = EnuFrame(WORLD)
    for t in (0.0, 1.0, 2.5, 4.0):
        point = loaded.trajectory.at(t)
        reference = flight.reference(t, 9.0)
        on_earth = LOCAL.from_geodetic(*world.to_geodetic(*point.pos_enu_m))
        assert reference.pos_enu_m == pytest.approx(on_earth, abs=1e-5)
        # world x is north; the two frames are 190 m apart, so their axes differ by 3e-5
        assert reference.vel_enu_mps == pytest.approx((0.0, point.vel_enu_mps[0], 0.0), abs=1e-3)
        assert reference.yaw_rad == pytest.approx(math.pi / 2 + 0.1 * t, abs=1e-4)
        if 0.0 < t < 4.0:
            assert reference.yaw_rate_radps == pytest.approx(0.1)


def test_without_a_yaw_it_keeps_the_one_it_has() -> None:
    loaded = along_x(yaw=None)
    clock = common_clock([loaded], 1.0, 1.0)
    assert TrajectoryFlight(loaded, clock, WORLD, LOCAL).reference(0.0, 1.25).yaw_rad == 1.25


@each(
    ("loaded", "limits", "factor", "why"),
    [
        (along_x(), TrajectoryLimits(), 1.0, None),
        (along_x(), TrajectoryLimits(), 2.0, "speed of 6"),
        (along_x(), TrajectoryLimits(acceleration_mps2=2.9), 1.0, "acceleration of 3"),
        (along_x(), TrajectoryLimits(acceleration_mps2=3.0), 1.0, None),
        (along_x(), TrajectoryLimits(jerk_mps3=0.5), 1.0, "jerk of"),
        (along_x(), TrajectoryLimits(jerk_mps3=1000.0), 1.0, None),
    ],
)
def test_limits_are_held_exactly(
    loaded: LoadedTrajectory, limits: TrajectoryLimits, factor: float, why: str | None
) -> None:
    found = loaded.why_not(limits, factor)
    assert (found is None) if why is None else found is not None and why in found
    clock = common_clock([loaded], 1.0, 1.0)
    flight = TrajectoryFlight(loaded, clock, WORLD, LOCAL)
    if why is None:
        require_speed([flight], [limits], factor)
    else:
        with pytest.raises(RefusedError, match=why):
            require_speed([flight], [limits], factor)


def test_a_jump_of_position_is_refused_and_one_of_velocity_measured() -> None:
    with pytest.raises(TrajectoryError, match="jumps"):
        LoadedTrajectory(Trajectory([Piece(1.0, (x,), (0.0,), (5.0,)) for x in (0.0, 1.0)]))
    corner = [Piece(1.0, (0.0, 1.0), (0.0,), (5.0,)), Piece(1.0, (1.0,), (0.0, 1.0), (5.0,))]
    assert LoadedTrajectory(Trajectory(corner)).velocity_jump_mps == pytest.approx(math.sqrt(2))


def test_the_fence_is_compared_with_the_whole_box() -> None:
    fence = Fence(WORLD, (-1.0, 20.0), (-5.0, 5.0), (0.0, 10.0), margin_m=0.5)
    assert along_x(8.0).outside(WORLD, fence) is None
    out = along_x(20.0, 20.0).outside(WORLD, fence)
    assert out is not None and "x 20.0 m (limit -0.5..19.5 m" in out
    assert along_x(8.0, up_m=9.8).outside(WORLD, fence) is not None
    elsewhere = Origin(47.4, 8.5, 395.0, x_heading_deg=90.0)
    assert along_x(8.0).outside(elsewhere, fence) is not None, "the world was moved since the fence was made"


def test_one_clock_brakes_for_the_fastest_and_lasts_for_the_longest() -> None:
    fast, slow = along_x(8.0, 4.0), along_x(1.0, 9.0)
    clock = common_clock([fast, slow], 1.5, 1.0)
    assert clock.duration_s == 9.0
    assert clock.rate_limit_per_s == pytest.approx(1.5 / 3.0, rel=1e-5)
    flight = TrajectoryFlight(fast, clock, WORLD, LOCAL)
    clock.start(0.0, 1.0)
    assert flight.status(0.5)["state"] == "waiting"
    assert not flight.over(6.0), "its own end is not the clock's"
    clock.pause(6.0)
    assert flight.status(9.0)["state"] == ClockState.PAUSED and flight.status(9.0)["finishes_in_s"] is None
    clock.abort(9.5)
    assert flight.over(9.6)


def test_it_begins_only_near_its_first_point() -> None:
    limits = TrajectoryLimits()
    assert distance_refusal((0.6, 0.6, 0.5), (0.0, 0.0, 0.0), limits) is None
    assert "1.2 m from the first point" in (distance_refusal((0.7, 0.7, 0.7), (0.0, 0.0, 0.0), limits) or "")
    assert distance_refusal(None, (0.0, 0.0, 0.0), limits) == "its position is not known"
    assert distance_refusal((math.nan, 0.0, 0.0), (0.0, 0.0, 0.0), limits) is not None


def test_impossible_limits_are_an_error() -> None:
    for wrong in ({"start_within_m": 0.0}, {"brake_mps2": math.nan}, {"speed_mps": -1.0}):
        with pytest.raises(ConfigError):
            TrajectoryLimits(**wrong)
