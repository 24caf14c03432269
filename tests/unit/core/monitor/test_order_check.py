"""Courses compared on all their way: against dense sampling, at the margin, and what bounds the work."""

from __future__ import annotations

import math
import random

import pytest

from skygcs.core.monitor import order_check
from skygcs.core.monitor.order_check import Course, bow_m, find_conflicts
from skygcs.core.separation import Footprint, pair_margin, separation_m
from skygcs.core.trajectory import Piece, Trajectory, TrajectoryClock
from skygcs.core.vehicle.trajectory_flight import LoadedTrajectory, common_clock
from support.examples import seeds
from support.table import each

MARGIN = pair_margin(Footprint(), Footprint())
NEED_M = MARGIN.total_m


def course(key: int, loaded: LoadedTrajectory, clock: TrajectoryClock, **also: float) -> Course:
    def at(after_s: float) -> tuple[float, float, float]:
        return loaded.trajectory.at(clock.foreseen_s(after_s)).pos_enu_m

    speed = loaded.peaks.speed_mps.at_most * clock.speed_factor
    bow = bow_m(loaded, clock.speed_factor, clock.rate_limit_per_s * loaded.peaks.speed_mps.at_most)
    return Course(key, f"v{key}", Footprint(), at, speed, bow, **also)


def curve(rng: random.Random, duration_s: float) -> Trajectory:
    """Of degree 3, within some 20 m."""
    axis = [(rng.uniform(-10, 10), rng.uniform(-2, 2), rng.uniform(-0.2, 0.2), rng.uniform(-0.01, 0.01)) for _ in "xyz"]
    return Trajectory([Piece(duration_s, *axis)])


def conflicts(*courses: Course, end_s: float) -> dict[int, str]:
    found: dict[int, str] = {}
    for _ in find_conflicts(courses[:1], courses[1:], end_s, found):
        pass
    return found


@each("seed", seeds(60))
def test_it_agrees_with_dense_sampling(seed: int) -> None:
    rng = random.Random(seed)
    loaded = [LoadedTrajectory(curve(rng, rng.uniform(5.0, 20.0))) for _ in range(2)]
    clocks = []
    for one in loaded:
        clock = common_clock([one], 1.0, rng.choice((0.5, 1.0, 1.7)))
        clock.start(0.0, rng.uniform(0.0, 5.0))
        clocks.append(clock)
    a, b = (course(n, one, clock) for n, (one, clock) in enumerate(zip(loaded, clocks, strict=True), 1))
    end_s = max(clock.finishes_at_s(0.0) or 0.0 for clock in clocks)
    sampled = [
        separation_m(*(q - p for p, q in zip(a.at(t), b.at(t), strict=True)), MARGIN.downwash_ratio)
        for t in (end_s * k / 5000 for k in range(5001))
    ]
    least_m, found = min(sampled), conflicts(a, b, end_s=end_s)
    if sampled[0] < NEED_M:
        return
    slack_m = a.bow_m + b.bow_m + 0.01
    if least_m < NEED_M:
        assert f"v1 would come {least_m:.1f}"[:-2] in found[1] or least_m > NEED_M - slack_m or least_m < slack_m
        assert found
    elif least_m > NEED_M + slack_m:
        assert not found


def straight(key: int, place: tuple[float, float, float], velocity: tuple[float, float, float] = (0, 0, 0)) -> Course:
    def at(after_s: float) -> tuple[float, float, float]:
        return place[0] + velocity[0] * after_s, place[1] + velocity[1] * after_s, place[2] + velocity[2] * after_s

    return Course(key, f"v{key}", Footprint(), at, math.hypot(*velocity))


@each(("aside_m", "found"), [(NEED_M - 0.001, True), (NEED_M + 0.001, False)])
def test_a_millimetre_decides_far_ahead(aside_m: float, found: bool) -> None:
    a, b = straight(1, (0.0, 0.0, 20.0), (2.0, 0.0, 0.0)), straight(2, (400.0, aside_m, 20.0))
    assert bool(conflicts(a, b, end_s=300.0)) is found


def test_only_the_known_part_of_a_course_counts() -> None:
    a, b = straight(1, (0.0, 0.0, 20.0)), straight(2, (40.0, 0.0, 20.0), (-2.0, 0.0, 0.0))
    assert "v1 would come 0.0 m near v2 (in the air) in 20.0 s" in conflicts(a, b, end_s=60.0)[1]
    unknown = Course(2, "v2", Footprint(), b.at, 2.0, known_s=10.0)
    assert not conflicts(a, unknown, end_s=60.0)


def test_two_too_near_already_may_part_and_not_come_nearer() -> None:
    b = straight(2, (1.0, 0.0, 20.0))
    assert not conflicts(straight(1, (0.0, 0.0, 20.0), (-1.0, 0.0, 0.0)), b, end_s=10.0)
    assert conflicts(straight(1, (0.0, 0.0, 20.0), (0.4, 0.0, 0.0)), b, end_s=10.0)


def test_what_is_too_much_is_refused_and_not_passed(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(order_check, "MAX_LOOKS", 50)
    a = straight(1, (0.0, 0.0, 20.0), (1.0, 0.0, 0.0))
    assert "too much to be checked" in conflicts(a, straight(2, (0.0, 2.6, 20.0), (1.0, 0.0, 0.0)), end_s=600.0)[1]


def test_it_gives_others_their_turn() -> None:
    a, b = straight(1, (0.0, 0.0, 20.0), (1.0, 0.0, 0.0)), straight(2, (0.0, 2.6, 20.0), (1.0, 0.0, 0.0))
    assert sum(1 for _ in find_conflicts([a], [b], 600.0, {})) > 100
