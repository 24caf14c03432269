from __future__ import annotations

import itertools
import math
import random
from fractions import Fraction
from itertools import combinations, pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from bench.plans import checker
from bench.plans.random_plans import _curve
from skygcs.core.trajectory import Piece, Trajectory
from skygcs.core.trajectory.timing import hover
from skygcs.ext.plans.certificates import closest_approach
from skygcs.ext.plans.certificates.bernstein_arrays import gathered, halved, restricted, squared_norm
from skygcs.ext.plans.certificates.closest_approach import TOLERANCE_M, _Intervals, least_clearance
from support.examples import examples


@settings(max_examples=examples(40), deadline=None)
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


def test_a_hundred_millionth_of_a_metre_decides() -> None:
    """Two curves of degree 7 that keep one distance all the time: curves do not make the bound worse."""
    curve = (0.0, 1.0, -0.3, 0.2, -0.05, 0.01, 1e-3, -1e-4)
    for off_m in (1e-3, 1e-6, 1e-8, -1e-8, -1e-6, -1e-3):
        fleet = [Trajectory([Piece(5.0, curve, (offset, *curve[1:]), (10.0,))]) for offset in (0.0, 2.5 + off_m)]
        assert (least_clearance(fleet, [1.25, 1.25], 2.0).clearance_at_least_m >= 0.0) == (off_m > 0), off_m


def exactly(curve: NDArray[np.float64], u: Fraction) -> Fraction:
    """Squared distance from the origin of a curve (coefficient, axis) at ``u``, without any rounding."""
    square = Fraction(0)
    for axis in curve.T:
        row = [Fraction(float(value)) for value in axis]
        while len(row) > 1:
            row = [(1 - u) * left + u * right for left, right in pairwise(row)]
        square += row[0] ** 2
    return square


def test_a_bound_is_below_the_exact_distance_and_of_what_stands_still_by_rounding_alone() -> None:
    """Against rational arithmetic, without the allowance for the errors of pieces: rounding goes outward by itself."""
    rng = np.random.default_rng(1)
    for degree in (0, 1, 3, 7):
        count = 60
        difference = rng.uniform(-30.0, 30.0, (degree + 1, 3, count)) * 10.0 ** rng.integers(-3, 3, count)
        difference[:, :, : count // 2] = difference[:1, :, : count // 2]  # no motion
        difference[:, 1, : count // 4] = 0.0  # gaps along two axes
        none, some = np.zeros(count), np.full(count, 0.5)
        index = np.zeros(count, dtype=np.intp)
        bound = _Intervals(difference, index, index, none, none + 1.0, none, none).bound()
        for number in range(count):
            places = [exactly(difference[:, :, number], Fraction(part, 6)) for part in range(7)]
            least = Fraction(max(float(bound[number]), 0.0)) ** 2
            assert all(least <= place for place in places), (degree, number)
            if number < count // 2:
                assert float(least) >= float(places[0]) * (1.0 - 1e-13), (degree, number)
        reduced = _Intervals(difference, index, index, none, none + 1.0, some, 2.0 * some).bound()
        assert reduced == pytest.approx(bound - 1.5)


def test_vehicles_that_stand_still_are_never_said_to_be_farther_apart_than_they_are() -> None:
    """Their pairs are decided by boxes alone."""
    rng = random.Random(3)
    for _ in range(30):
        places = [tuple(rng.uniform(-300.0, 300.0) for _ in range(3)) for _ in range(3)]
        found = least_clearance([hover(place, 5.0) for place in places], [0.0] * 3, 2.0)
        assert found is not None
        squares = [
            sum(((Fraction(a) - Fraction(b)) / scale) ** 2 for a, b, scale in zip(one, other, (1, 1, 2), strict=True))
            for one, other in combinations(places, 2)
        ]
        assert Fraction(found.distance_at_least_m) ** 2 <= min(squares)
        assert found.distance_at_least_m == found.clearance_at_least_m == pytest.approx(math.sqrt(min(squares)), 1e-9)


def test_curves_that_keep_their_distance_are_never_said_to_be_farther_apart() -> None:
    """Large coordinates, high degrees and several pieces: what rounding costs is subtracted."""
    rng = random.Random(5)
    for _ in range(40):
        offset = tuple(rng.uniform(-3.0, 3.0) for _ in range(3))
        pieces = [
            [[rng.uniform(-4096.0, 4096.0) * 0.5**k for k in range(8)] for _ in range(3)]
            for _ in range(rng.randint(1, 3))
        ]
        rounded = [[[round(c * 1024) / 1024 for c in axis] for axis in piece] for piece in pieces]
        shift = [round(value * 1024) / 1024 for value in offset]
        one, other = (
            Trajectory([Piece(1.5, *((axis[0] + by * s, *axis[1:]) for axis, s in zip(piece, shift, strict=True)))
                        for piece in rounded])
            for by in (0.0, 1.0)
        )  # fmt: skip
        found = least_clearance([one, other], [0.0, 0.0], 2.0)
        assert found is not None
        square = sum((Fraction(s) / scale) ** 2 for s, scale in zip(shift, (1, 1, 2), strict=True))
        assert Fraction(found.distance_at_least_m) ** 2 <= square
        assert found.distance_at_least_m == pytest.approx(math.sqrt(square), abs=1e-6)


def test_a_clearance_below_the_tolerance_is_decided_and_not_rounded() -> None:
    """Vehicles that pass each other on ways that are no axis: the least distance is that of one moment, which ends no
    half, quarter, …"""
    for off_m, back_mps in itertools.product((1e-5, 2e-5, 9e-5, -2e-5, -9e-5), (3.1, 3.7, 4.3, 4.9)):
        aside_m = (2.5 + off_m) / math.sqrt(2)
        there = Trajectory([Piece(4.0, (-10.0, 5.0), (-10.0, 5.0), (10.0,))])
        back = Trajectory([Piece(4.0, (9.0 + aside_m, -back_mps), (9.0 - aside_m, -back_mps), (10.0,))])
        found = least_clearance([there, back], [1.25, 1.25], 2.0)
        assert found is not None
        assert (found.clearance_at_least_m >= 0.0) is (off_m > 0), off_m
        assert found.clearance_m == pytest.approx(off_m, abs=TOLERANCE_M)
        assert found.t_s == pytest.approx(19 / (5 + back_mps), abs=1e-2)


def test_small_batches_find_the_same(monkeypatch: pytest.MonkeyPatch) -> None:
    """Memory is bounded by looking at some pairs at a time; what is left over counts as its bound."""
    rng = random.Random(9)
    fleet = {f"v{i}": _curve(rng, 8.0) for i in range(5)}
    whole = least_clearance(list(fleet.values()), [1.25] * 5, 2.0)
    checked = checker.least_distance(fleet, 2.0)
    assert whole is not None and checked is not None
    for batch in (50, 7, 1):
        monkeypatch.setattr(closest_approach, "BATCH", batch)
        found = least_clearance(list(fleet.values()), [1.25] * 5, 2.0)
        assert found is not None
        assert found.distance_at_least_m <= checked.distance_m + 1e-9
        if batch == 50:
            assert (found.first, found.second) == (whole.first, whole.second)
            assert found.distance_m == pytest.approx(whole.distance_m, abs=1e-3)


def test_what_is_left_when_halving_ends_counts_as_its_bound(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(closest_approach, "MAX_HALVINGS", 1)
    rng = random.Random(4)
    for _ in range(5):
        fleet = {f"v{i}": _curve(rng, 8.0) for i in range(3)}
        found = least_clearance(list(fleet.values()), [1.25] * 3, 2.0)
        checked = checker.least_distance(fleet, 2.0)
        assert found is not None and checked is not None
        assert found.distance_at_least_m <= checked.distance_m + 1e-9


@settings(max_examples=examples(100), deadline=None)
@given(st.lists(st.lists(st.floats(0.01, 20.0), min_size=1, max_size=30), min_size=2, max_size=6), st.integers(1, 40))
def test_the_pieces_that_are_compared_are_those_that_overlap_in_time(lengths: list[list[float]], batch: int) -> None:
    """By every pair of pieces: of 250 vehicles with 392 pieces each those were 4.8e9."""
    ways = [Trajectory(tuple(Piece(dt, (0.0,), (0.0,), (0.0,)) for dt in durations)) for durations in lengths]
    pieces = gathered(ways)
    search = closest_approach._Search(pieces, np.zeros(len(ways)))
    search._best = math.inf
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(closest_approach, "BATCH", batch)
        parts = [part for vehicle in range(len(ways)) for part in search.candidates(vehicle)]
    assert all(len(a) == len(b) <= 4 * batch + 30 for a, b in parts)
    found = [pair for a, b in parts for pair in zip(a.tolist(), b.tolist(), strict=True)]
    wanted = {
        (a, b)
        for a, b in combinations(range(len(pieces.vehicle)), 2)
        if pieces.vehicle[a] < pieces.vehicle[b]
        and max(pieces.begin_s[a], pieces.begin_s[b]) < min(pieces.end_s[a], pieces.end_s[b])
    }
    assert len(found) == len(set(found)) and set(found) == wanted


def test_only_pieces_that_are_flown_at_the_same_time_are_compared() -> None:
    """Each is where the other one was or will be; the nearest is when the first piece of one meets the second's."""
    there = Trajectory([Piece(4.0, (0.0, 10.0), (0.0,), (10.0,)), Piece(4.0, (40.0,), (0.0, 10.0), (10.0,))])
    back = Trajectory([Piece(4.0, (40.0,), (40.0, -8.0), (10.0,)), Piece(4.0, (40.0, -10.0), (8.0,), (10.0,))])
    found = least_clearance([there, back], [1.0, 0.5], 2.0)
    checked = checker.least_distance({"there": there, "back": back}, 2.0)
    assert found is not None and checked is not None
    assert found.distance_m == pytest.approx(checked.distance_m, abs=1e-4)
    assert found.t_s == pytest.approx(checked.t_s, abs=1e-2)
    assert found.clearance_m == pytest.approx(found.distance_m - 1.5)
    assert found.clearance_at_least_m == pytest.approx(found.distance_at_least_m - 1.5)


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


@settings(max_examples=examples(50), deadline=None)
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
    assert halved(square[:, None, :])[0][-1, 0] == pytest.approx((left[-1] ** 2).sum(axis=0))


def test_the_bound_of_rounding_errors_is_that_of_the_largest_axis_of_each_piece() -> None:
    fleet = [
        Trajectory(
            [Piece(2.0, (0.25, -0.5), (0.125, 0.25, 0.0625), (0.5,)), Piece(0.5, (-0.75, 1.0), (0.875,), (0.5,))]
        ),
        Trajectory([Piece(1.0, (0.0,), (-0.25, 0.125), (3.0,))]),
    ]
    sums = [  # by axis: S, and S without its constant, at the end of the piece
        [(1.25, 1.0), (0.875, 0.75), (0.5, 0.0)],
        [(1.25, 0.5), (0.875, 0.0), (0.5, 0.0)],
        [(0.0, 0.0), (0.375, 0.125), (3.0, 0.0)],
        [(0.0, 0.0), (0.125, 0.0), (3.0, 0.0)],  # it stands until the first has ended
    ]
    unit, degree, end_s = 2.0**-53, 2, 2.5
    wanted = [
        unit * (128 * (degree + 1) * max(s for s, _ in axes) + 8 * degree * end_s / length_s * max(t for _, t in axes))
        for axes, length_s in zip(sums, (2.0, 0.5, 1.0, 1.5), strict=True)
    ]
    assert gathered(fleet).error_m == pytest.approx(wanted, rel=1e-9)
