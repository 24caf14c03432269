"""Urgency and levels of one pair by hand-computed numbers, and which pairs of a fleet are found, ranked and left."""

from __future__ import annotations

import math
from collections import deque
from dataclasses import replace
from typing import Any

import pytest

from skygcs.core.monitor.approach import Piece, Vector
from skygcs.core.monitor.conflict_levels import Conflict, Level, Pair, believed_velocity, find_conflict, rank
from skygcs.core.monitor.monitor import conflict_text
from skygcs.core.monitor.tracks import Sample, Track
from skygcs.core.separation import Footprint, Margin
from support.table import each
from support.watched_fleet import Watched, WatchedVehicle, flying, standing

NOW = 10.0
TOWARDS: Vector = (-2.2, 0.0, 0.0)
"""Of these 2.2 m/s 2.0 are believed."""

MARGIN = Margin(0.7, 1.8, 2.0)
"""2.5 m: that of two default footprints."""


def track(key: int, place_m: Vector, velocity_mps: Vector = (0.0, 0.0, 0.0), **more: Any) -> Track:
    more = {"at": NOW, "parked": False, "path": (Piece(20.0, velocity_mps),)} | more
    return Track(WatchedVehicle(key).vehicle, Footprint(), 0, place_m=place_m, velocity_mps=velocity_mps, **more)


# -- one pair


@each("goal", [False, True])
@each(("ball_a_m", "ball_b_m", "enters_s"), [(0.0, 0.0, 6.0), (2.0, 0.0, 5.0), (0.0, 2.0, 5.0), (1.0, 3.0, 4.0)])
def test_urgency_is_the_time_until_the_margin_and_both_balls_are_lost(
    goal: bool, ball_a_m: float, ball_b_m: float, enters_s: float
) -> None:
    a = track(1, (0.0, 0.0, 0.0), ball_m=ball_a_m)
    b = track(2, (14.5, 0.0, 0.0), TOWARDS, ball_m=ball_b_m, has_goal=goal)
    assert rank(a, b) == rank(b, a) == pytest.approx((enters_s, 0.0))
    found = find_conflict(a, b)
    assert found is not None and (found.enters_s, found.closest_m, found.balls_m) == pytest.approx(
        (enters_s, 0.0, ball_a_m + ball_b_m)
    )


def test_heights_and_climbs_are_divided_by_the_downwash_ratio() -> None:
    assert believed_velocity((0.0, 0.0, 0.0), (0.0, 0.0, -2.2), 2.0) == pytest.approx((0.0, 0.0, -1.0))
    above = track(2, (0.0, 0.0, 13.0), (0.0, 0.0, -2.2))
    assert rank(track(1, (0.0, 0.0, 0.0)), above) == pytest.approx((4.0, 0.0))


@each(
    ("planned", "level"),
    [((False, False), Level.NOTICE), ((True, False), None), ((False, True), None), ((True, True), None)],
)
def test_one_that_would_fly_on_past_its_goal_is_a_notice_and_one_on_a_trajectory_is_none(
    planned: tuple[bool, bool], level: Level | None
) -> None:
    a = track(1, (0.0, 0.0, 0.0), planned=planned[0], has_goal=planned[0])
    b = track(2, (14.5, 0.0, 0.0), TOWARDS, path=(), planned=planned[1], has_goal=True)
    found = find_conflict(a, b)
    assert (None if found is None else found.level) is level
    assert (rank(a, b) is None) is (level is None)


@each(("aside_m", "deep"), [(0.0, True), (1.2, True), (1.3, False)])
def test_a_deep_conflict_comes_within_half_the_margin(aside_m: float, deep: bool) -> None:
    found = find_conflict(track(1, (0.0, 0.0, 0.0)), track(2, (6.0, aside_m, 0.0), TOWARDS))
    assert found is not None and found.deep is deep


@each(("parked", "predicted"), [(False, False), (True, True)])
def test_velocities_of_different_times_are_compared_at_the_earlier_one_but_for_parked_vehicles(
    parked: bool, predicted: bool
) -> None:
    """The newer report alone shows it coming; at the time of the other's report it flew away."""
    reports = deque([Sample(NOW - 0.5, (2.2, 0.0, 0.0)), Sample(NOW, TOWARDS)])
    a = track(1, (0.0, 0.0, 0.0), at=NOW - 0.5, parked=parked)
    b = track(2, (14.5, 0.0, 0.0), TOWARDS, history=reports)
    assert (find_conflict(a, b) is not None) is (find_conflict(b, a) is not None) is predicted


def conflict(level: Level, closest_m: float) -> Conflict:
    return Conflict(level, 12.3456, closest_m, 5.6789, 4.3219, MARGIN, 1.2345, deep=False, closing=True)


@each(
    ("level", "closest_m", "text"),
    [
        (Level.NOTICE, 2.4, "v1 and v2 will come 2.4 m near each other in 6 s (margin 2.5 m)"),
        (Level.NOTICE, 2.5, "v1 and v2 may come near each other: the position of v2 is 3.0 s old"),
        (Level.NOTICE, 3.0, "v1 and v2 may come near each other: the position of v2 is 3.0 s old"),
        (Level.WARNING, 3.0, "v1 and v2 will come 3.0 m near each other in 6 s (margin 2.5 m)"),
        (Level.NONE, 3.0, "v1 and v2 are clear of each other"),
    ],
)
def test_a_level_in_words(level: Level, closest_m: float, text: str) -> None:
    a, b = track(1, (0.0, 0.0, 0.0), age_s=0.2), track(2, (14.5, 0.0, 0.0), age_s=3.0)
    assert conflict_text(Pair(a, b, NOW, level, conflict(level, closest_m))) == text


def test_a_conflict_is_described_in_rounded_metres_and_seconds() -> None:
    odd = replace(conflict(Level.NOTICE, 2.3456), margin=Margin(0.7123, 1.8234, 2.0))
    assert odd.as_dict() == {
        **{"distance_m": 12.35, "closest_m": 2.35, "closest_in_s": 5.7, "enters_in_s": 4.3},
        **{"margin_m": 3.77, "wingspans_m": 0.71, "position_errors_m": 1.82, "balls_m": 1.23},
    }


# -- pairs of a fleet


def keys(*systems: int) -> tuple[int, ...]:
    return tuple(system << 8 | 1 for system in systems)


@each("places_m", [(0.0, 500.0, 1.0), (500.0, 1.0, 0.0), (1.0, 0.0, 500.0), (500.0, 0.0, 1.0)])
def test_a_pair_is_found_in_whatever_order_its_vehicles_come_and_nothing_else_is_checked(
    places_m: tuple[float, ...],
) -> None:
    fleet = Watched(*(WatchedVehicle(n) for n in (1, 2, 3)))
    fleet.run(0.5, *(standing(x, 0.0, 20.0) for x in places_m))
    near = [n for n, x in enumerate(places_m, 1) if x < 500.0]
    assert set(fleet.monitor.pairs) == {keys(*near)}
    counters = fleet.monitor.counters
    assert (counters.pairs_checked, counters.pairs_dropped) == (counters.evaluations, 0)


def test_the_sooner_conflicts_are_kept_and_not_the_nearer_ones() -> None:
    """Eight stand about each of two within the margin; the two will meet, later and nearer."""
    ring = [(2.3 * math.cos(n * math.pi / 4), 2.3 * math.sin(n * math.pi / 4)) for n in range(8)]
    fleet = Watched(*(WatchedVehicle(n) for n in range(1, 19)))
    about = [standing(x, y, 20.0) for x, y in ring]
    beside = [flying((16.0 + x, y, 20.0), TOWARDS) for x, y in ring]
    both = standing(0.0, 0.0, 20.0), flying((16.0, 0.0, 20.0), TOWARDS)
    fleet.run(0.5, *both, *about, *beside)
    kept = set(fleet.monitor.pairs)
    assert keys(1, 2) not in kept
    assert {keys(1, n) for n in range(3, 11)} | {keys(2, n) for n in range(11, 19)} <= kept
    fleet = Watched(*(WatchedVehicle(n) for n in (1, 2)))
    fleet.run(0.5, *both)
    assert set(fleet.monitor.pairs) == {keys(1, 2)}, "alone they are a pair"
