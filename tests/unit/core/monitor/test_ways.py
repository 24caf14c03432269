"""Ways of many vehicles compared as space: each pair once, boxes first, in pieces."""

from __future__ import annotations

import itertools
import math
import random
from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from skygcs.core.monitor import ways
from skygcs.core.monitor.approach import Vector
from skygcs.core.monitor.ways import (
    Way,
    along,
    are_apart,
    column,
    distance_m,
    find_way_conflicts,
    joined,
    nearest_m,
    needed_m,
    shown_m,
    sloped,
    too_near,
)
from skygcs.core.separation import Footprint
from support.examples import examples
from support.table import each


def way(key: int, points: list[Vector], ball_m: float = 0.0) -> Way:
    return Way(key, f"v{key}", Footprint(), along(points), ball_m)


def comb(up_m: float, east_m: float = 0.0, count: int = 500) -> list[Vector]:
    """A search pattern of so many places, level."""
    return [(east_m + 10.0 * (n // 2), 400.0 * ((n + 1) // 2 % 2), up_m) for n in range(count)]


def work(starting: list[Way], others: list[Way]) -> tuple[dict[int, str], int]:
    """What is found, and in how many pieces."""
    found: dict[int, str] = {}
    return found, sum(1 for _ in find_way_conflicts(starting, others, found))


def wandering(chance: random.Random, key: int) -> Way:
    at = [chance.uniform(-150, 150), chance.uniform(-150, 150), chance.uniform(5, 60)]
    points: list[Vector] = []
    for _ in range(chance.randint(1, 30)):
        at = [a + chance.uniform(-12, 12) for a in at]
        points.append((at[0], at[1], at[2]))
    return way(key, points, chance.uniform(0, 5))


def test_the_nearest_is_found_without_a_look_at_all_legs() -> None:
    """Also of a way that was joined out of two."""
    chance = random.Random(5)
    for _ in range(400):
        a, b = wandering(chance, 1), wandering(chance, 2)
        at, least_m = chance.randint(0, len(a.legs) - 1), distance_m(a, b)
        two = joined(replace(a, legs=a.legs[: at + 1]), replace(a, legs=a.legs[at:]))
        assert (two.box, two.heights, two.is_known) == (a.box, a.heights, True)
        for one, below_m in itertools.product((a, two), (0.001, least_m or 0.002, least_m * 1.01 + 0.01, 500.0)):
            assert (
                nearest_m(one, b, below_m) == nearest_m(b, one, below_m) == (least_m if least_m < below_m else math.inf)
            )
    nowhere = replace(a, legs=(*a.legs, column((math.nan, 0.0, 0.0), 5.0)))
    assert nearest_m(nowhere, b, 1.0) == nearest_m(joined(a, nowhere), b, 1.0) == 0.0


def test_what_is_found_is_what_a_comparison_of_all_legs_finds() -> None:
    """The oracle has no boxes and no parts."""
    chance, met, clear = random.Random(8), 0, 0
    for _ in range(12):
        starting = [wandering(chance, key) for key in range(4)]
        others = [wandering(chance, key) for key in range(4, 7)]
        found, _ = work(starting, others)
        for one in starting:
            near = [o for o in (*starting, *others) if o is not one and distance_m(one, o) < needed_m(one, o)]
            assert all(too_near(one, other) for other in near)
            for other in others:
                singly = [replace(one, legs=(p,)) for p in one.legs], [replace(other, legs=(q,)) for q in other.legs]
                assert distance_m(one, other) == min(itertools.starmap(distance_m, itertools.product(*singly)))
                assert too_near(one, other) is (distance_m(one, other) < needed_m(one, other))
            assert (one.key in found) is bool(near)
            met, clear = met + bool(near), clear + (not near)
            if near:
                assert any(f"m near {o.name} " in found[one.key] for o in near)
    assert met > 4 < clear


number = st.integers(-6, 6)
ends = st.tuples(number, number)
leg = st.builds(
    lambda begin, end, low, up: ways.Leg(begin, end, float(low), float(low + up)), ends, ends, number, st.integers(0, 5)
)


@settings(max_examples=examples(200))
@given(leg, leg)
def test_two_legs_are_as_far_apart_as_their_nearest_points(p: ways.Leg, q: ways.Leg) -> None:
    """The oracle samples both lines; above each of their points is all between two heights."""
    x, y = (
        np.linspace(one.begin, one.end, 241)[(slice(None), None) if one is p else (None, slice(None))] for one in (p, q)
    )
    over_ground = float(np.hypot(*np.moveaxis(x - y, -1, 0)).min())
    above = max(0.0, p.low_m - q.high_m, q.low_m - p.high_m) / 2.0
    found = distance_m(Way(1, "v1", Footprint(), (p,)), Way(2, "v2", Footprint(), (q,)))
    assert math.hypot(max(0.0, over_ground - 0.1), above) - 1e-9 <= found <= math.hypot(over_ground, above) + 1e-9


@given(
    st.lists(st.tuples(*[st.sampled_from((-60.0, -9.0, -3.0, 0.0, 1.5, 2.0, 8.0, 50.0))] * 3), min_size=1, max_size=4)
)
def test_a_sloped_way_holds_its_line_in_legs_that_are_short_or_flat(points: list[Vector]) -> None:
    legs = list(sloped(points))
    if len(points) == 1:
        assert legs == [ways.Leg(points[0][:2], points[0][:2], points[0][2], points[0][2])]
        return
    for a, b in itertools.pairwise(points):
        off_m = min(abs(b[2] - a[2]), math.dist(a[:2], b[:2]))
        count = 1 if off_m <= 2.0 else min(16, math.ceil(off_m / 2.0))
        for n, one in enumerate(legs[:count]):
            begin, end = ([p + (q - p) * share / count for p, q in zip(a, b, strict=True)] for share in (n, n + 1))
            assert (*one.begin, *one.end) == pytest.approx((*begin[:2], *end[:2]))
            assert (one.low_m, one.high_m) == pytest.approx(tuple(sorted((begin[2], end[2]))))
        del legs[:count]
    assert not legs
    assert column(points[0], points[1][2]) == along([points[0], (*points[0][:2], points[1][2])])[0]


@given(*[st.tuples(number, number, number)] * 4, st.tuples(*[st.integers(0, 5)] * 3))
def test_lines_are_apart_along_one_axis_or_not(a: Vector, b: Vector, c: Vector, d: Vector, need: Vector) -> None:
    gaps = (max(min(r, s) - max(p, q), min(p, q) - max(r, s)) for p, q, r, s in zip(a, b, c, d, strict=True))
    assert are_apart((a, b), (c, d), need) is any(gap > need_m for gap, need_m in zip(gaps, need, strict=True))
    assert not are_apart((a, (math.nan,) * 3), (c, d), need)


def test_a_way_of_which_a_number_is_not_known_may_be_anywhere() -> None:
    far = way(2, [(900.0, 0.0, 90.0)])
    assert way(1, [(0.0, 0.0, 0.0)]).is_known and not too_near(far, way(1, [(0.0, 0.0, 0.0)]))
    for n in range(6):
        begin, end, low, high = [0.0, 0.0], [0.0, 0.0], 0.0, 0.0
        values = [*begin, *end, low, high]
        values[n] = math.nan
        odd = Way(1, "v1", Footprint(), (ways.Leg(tuple(values[:2]), tuple(values[2:4]), *values[4:]),))
        assert not odd.is_known and distance_m(odd, far) == distance_m(far, odd) == 0.0
        assert too_near(odd, far) and too_near(far, odd)
    assert too_near(way(1, [(0.0, 0.0, 0.0)], math.nan), far)
    found, _ = work([odd], [far])
    assert found == {1: "v1 may come too near v2: the way of v1 is not known"}


@each(
    ("near_m", "need_m", "shown"),
    [
        (0.0, 2.5, ("0.0", "2.5")),
        (2.44, 2.5, ("2.4", "2.5")),
        (2.46, 2.5, ("2.46", "2.50")),
        (2.4999, 2.5, ("2.50",) * 2),
    ],
)
def test_two_distances_are_shown_so_that_they_differ(near_m: float, need_m: float, shown: tuple[str, str]) -> None:
    assert shown_m(near_m, need_m) == shown


def test_each_is_told_of_the_first_other_way_and_none_of_itself() -> None:
    a, b, c = (way(n, [(0.0, 0.4 * n, 20.0), (50.0, 0.4 * n, 20.0)], n / 10.0) for n in (1, 2, 3))
    found, _ = work([a, b], [replace(a, name="older"), c])
    said = "{} would come {} m near {} (in the air); they need {} m, heights divided by 2"
    assert found == {1: said.format("v1", "0.4", "v2", "2.8"), 2: said.format("v2", "0.4", "v1", "2.8")}
    found, _ = work([a], [replace(a, name="older"), c])
    assert found == {1: said.format("v1", "0.8", "v3", "2.9")}
    beside = [way(n, [(0.0, y, 20.0), (50.0, y, 20.0)]) for n, y in ((1, 0.0), (2, 2.0), (3, -2.0))]
    assert set(work(beside, [])[0]) == {1, 2, 3}, "of the first with both others, which keep clear of each other"
    far = way(4, [(0.0, 90.0, 20.0)])
    assert work([far, a], [c])[0] == {1: said.format("v1", "0.8", "v3", "2.9")}


def test_the_distance_in_words_is_the_least_of_the_whole_pair() -> None:
    a, b = way(1, comb(20.0, count=100)), way(2, comb(21.0, east_m=3.0, count=100))
    found, _ = work([a, b], [])
    assert f"{distance_m(a, b):.1f} m near v2" in found[1] and f"{distance_m(a, b):.1f} m near v1" in found[2]


@pytest.fixture
def compared(monkeypatch: pytest.MonkeyPatch) -> Iterator[list[int]]:
    """Counts the pairs of legs that are compared."""
    counts = [0]
    real = ways._legs_distance_m

    def counted(*args: object) -> float:
        counts[0] += 1
        return real(*args)  # type: ignore[arg-type]

    monkeypatch.setattr(ways, "_legs_distance_m", counted)
    yield counts


def test_missions_above_or_beside_each_other_are_told_apart_by_their_boxes(compared: list[int]) -> None:
    """20 x 500 items: all pairs of their legs are 47 million."""
    above = [way(n, comb(20.0 + 6.0 * n)) for n in range(10)]
    beside = [way(10 + n, comb(20.0, east_m=5000.0 * (n + 1))) for n in range(10)]
    found, _ = work([*above, *beside], [])
    assert found == {} and compared == [0]


def test_each_pair_is_compared_once_and_in_small_pieces(compared: list[int]) -> None:
    a, b = way(1, comb(20.0, count=60)), way(2, comb(40.0, east_m=5.0, count=60), 30.0)
    before, most, turns = 0, 0, 0
    for _ in find_way_conflicts([a, b], [], found := {}):
        turns += 1
        most, before = max(most, compared[0] - before), compared[0]
    assert set(found) == {1, 2}
    meet = sum(ways._boxes_meet(p, q, needed_m(a, b)) for p in a.parts for q in b.parts)
    assert turns == 1 + len(a.parts) + meet > 20
    assert most <= ways.LEGS_A_PART**2 and compared[0] <= len(a.legs) * len(b.legs)


def test_parts_that_meet_the_box_of_another_way_and_none_of_its_parts_are_looked_at_one_by_one() -> None:
    """It flies around the other one."""
    corners = [(-900.0, -900.0), (900.0, -900.0), (900.0, 900.0), (-900.0, 900.0), (-900.0, -900.0)]
    around: list[Vector] = []
    for (x, y), (u, v) in itertools.pairwise(corners):
        around += [(x + (u - x) * n / 8, y + (v - y) * n / 8, 20.0) for n in range(8)]
    a, b = way(1, comb(20.0, count=60)), way(2, around)
    found, pieces = work([a], [b])
    assert not found and pieces == 1 + len(a.parts) == 9


def test_a_leg_without_a_top_meets_what_is_above_it() -> None:
    column = Way(1, "v1", Footprint(), (ways.Leg((0.0, 0.0), (0.0, 0.0), 5.0, math.inf),))
    high, low = way(2, [(0.0, 0.0, 900.0)]), way(3, [(0.0, 0.0, -900.0)])
    found, _ = work([column, high, low], [])
    assert set(found) == {1, 2}
    assert all(itertools.starmap(lambda a, b: too_near(a, b) is too_near(b, a), [(column, high), (column, low)]))
