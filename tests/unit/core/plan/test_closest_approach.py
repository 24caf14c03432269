from __future__ import annotations

import math
import random

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from bench.plans import checker
from bench.plans.random_plans import _curve
from skygcs.core.plan.bernstein_arrays import gathered, halved, restricted, squared_norm
from skygcs.core.plan.closest_approach import least_clearance
from skygcs.core.trajectory import Piece, Trajectory, hover


@settings(max_examples=60, deadline=None)
@given(st.integers(0, 10**6), st.integers(2, 5), st.sampled_from([3.0, 8.0, 20.0]))
def test_the_least_distance_is_the_independent_checkers_and_its_bound_holds(seed: int, count: int, room: float) -> None:
    rng = random.Random(seed)
    fleet = {f"v{i}": _curve(rng, room) for i in range(count)}
    found = least_clearance(list(fleet.values()), [1.25] * count, 2.0)
    checked = checker.least_distance(fleet, 2.0)
    assert found is not None and checked is not None
    assert found.distance_at_least_m <= checked.distance_m + 1e-9  # never above any sample
    assert found.distance_m <= checked.distance_m + 2e-4
    assert found.distance_m - found.distance_at_least_m <= 1.01e-4
    places = [fleet[f"v{i}"].at(found.t_s).pos_enu_m for i in (found.first, found.second)]
    assert math.dist(*((*p[:2], p[2] / 2.0) for p in places)) == pytest.approx(found.distance_m, abs=1e-6)


def test_margins_that_differ_decide_which_pair_is_worst() -> None:
    fleet = [hover((x, 0.0, 10.0), 5.0) for x in (0.0, 4.0, 9.0)]
    assert least_clearance(fleet, [1.0, 1.0, 1.0], 2.0).clearance_m == 2.0
    found = least_clearance(fleet, [1.0, 1.0, 5.0], 2.0)
    assert (found.first, found.second, found.clearance_m) == (1, 2, -1.0)


def test_obstacles_are_not_compared_with_each_other() -> None:
    fleet = [hover((x, 0.0, 10.0), 5.0) for x in (0.0, 40.0, 40.5)]
    assert least_clearance(fleet, [1.0] * 3, 2.0, standing=2).distance_m == 40.0
    assert least_clearance(fleet, [1.0] * 3, 2.0, standing=3) is None
    assert least_clearance(fleet[:1], [1.0], 2.0) is None


def test_a_vehicle_whose_trajectory_has_ended_stands_in_the_way() -> None:
    early = Trajectory([Piece(1.0, (0.0, 5.0), (0.0,), (10.0,))])
    late = Trajectory([Piece(10.0, (5.0,), (-20.0, 4.0), (10.0,))])
    found = least_clearance([early, late], [1.0, 1.0], 2.0)
    assert (found.distance_m, found.t_s) == (pytest.approx(0.0, abs=1e-4), pytest.approx(5.0, abs=1e-3))


@pytest.mark.parametrize("off_m", [1e-3, 1e-6, 1e-8])
def test_a_millionth_of_a_metre_decides(off_m: float) -> None:
    """Two curves of degree 7 that keep one distance all the time: curves do not make the bound worse."""
    curve = (0.0, 1.0, -0.3, 0.2, -0.05, 0.01, 1e-3, -1e-4)
    for sign in (1.0, -1.0):
        fleet = [Trajectory([Piece(5.0, curve, (offset, *curve[1:]), (10.0,))]) for offset in (0.0, 2.5 + sign * off_m)]
        assert (least_clearance(fleet, [1.25, 1.25], 2.0).clearance_at_least_m >= 0.0) == (sign > 0)


def test_exactly_at_the_margin_ends_and_counts_as_inside_or_touching() -> None:
    curve = (0.0, 1.0, -0.3, 0.2)
    fleet = [Trajectory([Piece(5.0, curve, (offset, *curve[1:]), (10.0,))]) for offset in (0.0, 2.5)]
    assert abs(least_clearance(fleet, [1.25, 1.25], 2.0).clearance_at_least_m) < 1e-8


def test_progress_is_reported_and_may_cancel() -> None:
    fleet = [hover((5.0 * i, 0.0, 10.0), 5.0) for i in range(4)]
    seen: list[tuple[int, int]] = []
    least_clearance(fleet, [1.0] * 4, 2.0, progress=lambda done, total: seen.append((done, total)))
    assert seen == [(1, 4), (2, 4), (3, 4), (4, 4)]

    def cancel(done: int, total: int) -> None:
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        least_clearance(fleet, [1.0] * 4, 2.0, progress=cancel)


@settings(max_examples=50, deadline=None)
@given(st.integers(0, 10**6), st.floats(0, 0.95), st.floats(0.01, 1.0))
def test_cutting_keeps_the_curve(seed: int, begin: float, length: float) -> None:
    pieces = gathered([_curve(random.Random(seed), 10.0)])
    end = min(begin + length, 1.0)
    count = len(pieces.begin_s)
    part = restricted(pieces.bernstein, np.full(count, begin), np.full(count, end))
    left, right = halved(part)
    for inner, coefficients in ((0.0, part[0]), (0.5, left[-1]), (0.5, right[0]), (1.0, part[-1])):
        row, u = pieces.bernstein, begin + inner * (end - begin)
        while len(row) > 1:
            row = (1 - u) * row[:-1] + u * row[1:]
        assert np.abs(row[0] - coefficients).max() < 1e-9
    square = squared_norm(part)
    assert square[0] == pytest.approx((part[0] ** 2).sum(axis=0))
    assert square[-1] == pytest.approx((part[-1] ** 2).sum(axis=0))
