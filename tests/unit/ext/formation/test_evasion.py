"""References get around each other, mostly."""

from __future__ import annotations

import math

from skygcs.ext.formation.evasion import Evasion, straight_to
from skygcs.ext.formation.separation_filter import Member, MotionBounds, Moving, Obstacle, SeparationFilter, Vector
from support.examples import seeds
from support.formation_encounters import encounter
from support.table import each

BOUNDS = MotionBounds()


def flown(starts: list[Vector], goals: list[Vector], seconds: float, obstacles: list[Obstacle]) -> SeparationFilter:
    names = [f"v{i}" for i in range(len(starts))]
    members = {name: Member(2.0, Moving(start)) for name, start in zip(names, starts, strict=True)}
    filter_, evasion = SeparationFilter(members, BOUNDS, 2.0), Evasion()
    wanted = {name: Moving(goal) for name, goal in zip(names, goals, strict=True)}
    for step in range(round(seconds / 0.1)):
        filter_.step(evasion.asked(filter_, wanted, obstacles, step * 0.1), obstacles, 0.1)
    return filter_


def off_m(filter_: SeparationFilter, goals: list[Vector]) -> list[float]:
    return [math.dist(m.moving.pos_enu_m, goal) for m, goal in zip(filter_.members.values(), goals, strict=True)]


@each("away", [(20.0, 0.0, 0.0), (0.0, 0.0, 20.0), (8.0, 8.0, 4.0)])
def test_two_change_places(away: Vector) -> None:
    a = (0.0, 0.0, 10.0)
    b = (a[0] + away[0], a[1] + away[1], a[2] + away[2])
    assert max(off_m(flown([a, b], [b, a], 70.0, []), [b, a])) < 0.3


def test_eight_on_a_circle_change_places_with_those_across() -> None:
    circle = [(12.0 * math.cos(k * math.pi / 4), 12.0 * math.sin(k * math.pi / 4), 15.0) for k in range(8)]
    goals = circle[4:] + circle[:4]
    assert max(off_m(flown(circle, goals, 90.0, []), goals)) < 0.3


def test_one_that_stands_in_the_way_gives_way_and_comes_back() -> None:
    starts = [(0.0, 0.0, 10.0), (10.0, 0.0, 10.0)]
    goals = [(20.0, 0.0, 10.0), (10.0, 0.0, 10.0)]
    assert max(off_m(flown(starts, goals, 40.0, []), goals)) < 0.3


def test_four_that_begin_nearer_than_they_should_get_apart_and_arrive() -> None:
    starts = [(3.5 * k, 0.0, 10.0) for k in range(4)]
    goals = [(x, y, 10.0) for x, y in ((0.0, 7.0), (6.0, 3.0), (6.0, -7.0), (12.0, -2.0))]
    assert max(off_m(flown(starts, goals, 60.0, []), goals)) < 0.3


def test_an_obstacle_is_flown_around() -> None:
    goals = [(30.0, 0.0, 10.0)]
    stands = [Obstacle("x", (15.0, 0.0, 10.0), (0.0, 0.0, 0.0), 2.0)]
    assert off_m(flown([(0.0, 0.0, 10.0)], goals, 40.0, stands), goals)[0] < 0.3


def test_a_place_that_is_taken_is_waited_for_nearby() -> None:
    goals = [(15.0, 0.0, 10.0)]
    stands = [Obstacle("x", (15.0, 0.0, 10.0), (0.0, 0.0, 0.0), 2.0)]
    assert 4.0 <= off_m(flown([(0.0, 0.0, 10.0)], goals, 60.0, stands), goals)[0] < 25.0


def test_a_formation_that_moves_as_one_hinders_nobody() -> None:
    starts = [(5.0 * k, 0.0, 10.0) for k in range(5)]
    members = {f"v{k}": Member(2.0, Moving(start)) for k, start in enumerate(starts)}
    filter_, evasion = SeparationFilter(members, BOUNDS, 2.0), Evasion()
    for step in range(100):
        along_m = 1.5 * step * 0.1
        wanted = {
            f"v{k}": Moving((x, y + along_m, z), (0.0, 1.5, 0.0)) for k, (x, y, z) in enumerate(starts)
        }  # fmt: skip
        filter_.step(evasion.asked(filter_, wanted, [], step * 0.1), [], 0.1)
        assert not any(progress.hindered(step * 0.1) for progress in evasion.progress.values())


def test_the_velocity_towards_a_place_lets_it_stop_there() -> None:
    moving = Moving((0.0, 0.0, 10.0))
    for step in range(400):
        velocity = straight_to(moving, Moving((20.0, -10.0, 14.0)), BOUNDS)
        pos = [p + v * 0.1 for p, v in zip(moving.pos_enu_m, velocity, strict=True)]
        moving = Moving((pos[0], pos[1], pos[2]), velocity)
        assert step > 0 or math.hypot(*velocity[:2]) <= BOUNDS.speed_mps + 1e-9
    assert math.dist(moving.pos_enu_m, (20.0, -10.0, 14.0)) < 0.01


@each("seed", seeds(6))
def test_vehicles_in_the_wind_keep_their_footprints_clear(seed: int) -> None:
    outcome = encounter(seed, seconds=25.0, strangers=False)
    assert outcome.references_m >= 0.0
    assert outcome.vehicles_m > 0.5
