"""The filter keeps every distance, whatever is asked of it."""

from __future__ import annotations

import itertools
import math
import random

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from skygcs.ext.formation.separation_filter import (
    LONGEST_STEP_S,
    Member,
    MotionBounds,
    Moving,
    Obstacle,
    SeparationFilter,
    Vector,
)
from support.formation_encounters import places
from support.table import each

RATIO = 2.0
BOUNDS = MotionBounds(speed_mps=3.0, climb_mps=1.5, acc_xy_mps2=2.0, acc_z_mps2=1.0)


def filter_of(*starts: Vector, radius_m: float = 2.0, **more: object) -> SeparationFilter:
    members = {f"v{i}": Member(radius_m, Moving(start)) for i, start in enumerate(starts)}
    return SeparationFilter(members, BOUNDS, RATIO, **more)  # type: ignore[arg-type]


def between(before: dict[str, Moving], filter_: SeparationFilter, dt_s: float, share: float) -> dict[str, Vector]:
    """Where all are at a share of a step: the accelerations are constant, and one that stands within it stands."""
    found = {}
    for name, member in filter_.members.items():
        (pos, vel), acc, t_s = before[name], member.acc_enu_mps2, share * dt_s
        if member.taken is None and any(vel):
            t_s = min(t_s, math.hypot(*vel) / math.hypot(*acc))
        point = tuple(p + v * t_s + a * t_s * t_s / 2 for p, v, a in zip(pos, vel, acc, strict=True))
        found[name] = (point[0], point[1], point[2])
    return found


velocities = st.tuples(*(st.floats(-50.0, 50.0) for _ in range(3)))


@settings(max_examples=40)
@given(
    seed=st.integers(0, 10_000),
    count=st.integers(2, 8),
    steps=st.lists(st.tuples(st.floats(0.01, 0.5), velocities), min_size=1, max_size=60),
    near=st.floats(0.3, 1.5),
)
def test_no_pair_comes_nearer_than_is_promised(
    seed: int, count: int, steps: list[tuple[float, Vector]], near: float
) -> None:
    """Also for pairs that begin nearer than they should; looked at within the steps, too."""
    rng = random.Random(seed)
    filter_ = filter_of(*places(rng, count, 15.0, 4.0 * near))
    names = list(filter_.members)
    for dt_s, velocity in steps:
        before = {name: member.moving for name, member in filter_.members.items()}
        kept = {(a, b): filter_.kept_m(a, b) for a, b in itertools.combinations(names, 2)}
        rng.shuffle(names)
        asked = {
            name: [tuple(v * rng.uniform(-1.0, 1.0) for v in velocity), velocity]
            for name in names
            if rng.random() < 0.8
        }
        filter_.step(asked, [], dt_s)  # type: ignore[arg-type]
        for share in (0.25, 0.5, 0.75, 1.0):
            at = between(before, filter_, min(dt_s, LONGEST_STEP_S), share)
            for (a, b), kept_m in kept.items():
                away_m = math.dist(filter_.metric(at[a]), filter_.metric(at[b]))
                assert away_m >= kept_m - 1e-9, (a, b, away_m, kept_m)
        for name, member in filter_.members.items():
            assert member.moving.pos_enu_m == pytest.approx(between(before, filter_, min(dt_s, 0.3), 1.0)[name])
            assert math.hypot(*member.acc_enu_mps2[:2]) <= BOUNDS.acc_xy_mps2 + 1e-9
            assert abs(member.acc_enu_mps2[2]) <= BOUNDS.acc_z_mps2 + 1e-9
            assert math.hypot(*member.moving.vel_enu_mps[:2]) <= BOUNDS.speed_mps * 20


@each("nonsense", [math.nan, math.inf, -math.inf, 1e300])
def test_what_is_no_velocity_is_not_taken(nonsense: float) -> None:
    filter_ = filter_of((0.0, 0.0, 10.0), (9.0, 0.0, 10.0))
    for _ in range(20):
        filter_.step({"v0": [(nonsense, 0.0, 0.0), (0.0, nonsense, nonsense), (0.0, 1.0, 0.0)]}, [], 0.1)
    member = filter_.members["v0"]
    assert all(map(math.isfinite, (*member.moving.pos_enu_m, *member.moving.vel_enu_mps, *member.acc_enu_mps2)))
    assert math.hypot(*member.moving.vel_enu_mps[:2]) <= BOUNDS.acc_xy_mps2 * 2.0 + 1e-6
    assert filter_.distance_m("v0", "v1") >= 4.0


def fly(filter_: SeparationFilter, asked: dict[str, list[Vector]], seconds: float) -> None:
    for _ in range(round(seconds / 0.1)):
        filter_.step(asked, [], 0.1)


def test_two_that_are_sent_into_each_other_stand_before_their_distance() -> None:
    filter_ = filter_of((0.0, 0.0, 10.0), (40.0, 0.0, 10.0))
    fly(filter_, {"v0": [(3.0, 0.0, 0.0)], "v1": [(-3.0, 0.0, 0.0)]}, 30.0)
    assert 4.0 <= filter_.distance_m("v0", "v1") < 4.3
    assert all(math.hypot(*member.moving.vel_enu_mps) < 0.1 for member in filter_.members.values())


def test_heights_count_by_the_downwash_ratio() -> None:
    filter_ = filter_of((0.0, 0.0, 10.0), (0.0, 0.0, 40.0))
    fly(filter_, {"v1": [(0.0, 0.0, -1.5)]}, 40.0)
    up_m = filter_.members["v1"].moving.pos_enu_m[2] - 10.0
    assert 8.0 <= up_m < 8.5


def test_two_that_begin_too_near_come_no_nearer_and_keep_what_they_gain() -> None:
    filter_ = filter_of((0.0, 0.0, 10.0), (3.0, 0.0, 10.0))
    fly(filter_, {"v0": [(3.0, 0.0, 0.0)]}, 10.0)
    assert filter_.distance_m("v0", "v1") >= 2.94
    fly(filter_, {"v1": [(1.0, 0.0, 0.0)]}, 6.0)
    fly(filter_, {"v0": [(3.0, 0.0, 0.0)]}, 10.0)
    assert 4.0 <= filter_.distance_m("v0", "v1") < 4.3
    assert filter_.kept_m("v0", "v1") == 4.0


def test_the_first_that_fits_is_taken_and_said() -> None:
    filter_ = filter_of((0.0, 0.0, 10.0), (5.0, 0.0, 10.0))
    for _ in range(30):
        filter_.step({"v0": [(3.0, 0.0, 0.0), (0.0, 1.0, 0.0)]}, [], 0.1)
    assert filter_.members["v0"].taken == 1
    assert filter_.members["v1"].taken is None
    assert filter_.members["v0"].moving.vel_enu_mps[1] > 0.8


def test_where_it_may_not_stand_it_does_not_go() -> None:
    filter_ = filter_of((0.0, 0.0, 10.0), allowed=lambda name, moving, stands: stands[0] <= 12.0)
    fly(filter_, {"v0": [(3.0, 0.0, 0.0)]}, 30.0)
    assert 11.0 < filter_.members["v0"].moving.pos_enu_m[0] <= 12.0


@each("speed_mps", [0.0, 1.0])
def test_around_an_obstacle_that_flies_straight_on_there_is_room(speed_mps: float) -> None:
    filter_ = filter_of((0.0, 0.0, 10.0))
    for step in range(300):
        here = (30.0 - speed_mps * step * 0.1, 0.0, 10.0)
        stranger = Obstacle("x", here, (-speed_mps, 0.0, 0.0), 2.0)
        away = (-3.0, 0.0, 0.0)
        filter_.step({"v0": [(3.0, 0.0, 0.0), away]}, [stranger], 0.1)
        assert math.dist(filter_.members["v0"].moving.pos_enu_m, here) >= 4.0 - 1e-6


def test_the_backup_leads_to_rest_where_braking_leads() -> None:
    filter_ = filter_of((0.0, 0.0, 10.0))
    fly(filter_, {"v0": [(2.0, 1.0, 0.5)]}, 5.0)
    foreseen = filter_.backup("v0", 0.1, 40)
    for point in foreseen[1:]:
        filter_.step({}, [], 0.1)
        assert filter_.members["v0"].moving.pos_enu_m == pytest.approx(point)
    assert filter_.members["v0"].moving.vel_enu_mps == (0.0, 0.0, 0.0)
