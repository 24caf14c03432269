"""Ways of many vehicles compared as space: each pair once, boxes first, in pieces."""

from __future__ import annotations

import itertools
import math
import random
from collections.abc import Iterator

import pytest

from skygcs.core.monitor import ways
from skygcs.core.monitor.approach import Vector
from skygcs.core.monitor.ways import Way, along, distance_m, find_way_conflicts, needed_m, too_near
from skygcs.core.separation import Footprint


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
                legs = [ways._legs_distance_m(p, q, 2.0) for p in one.legs for q in other.legs]
                assert distance_m(one, other) == min(legs)
            assert (one.key in found) is bool(near)
            met, clear = met + bool(near), clear + (not near)
            if near:
                assert any(f"m near {o.name} " in found[one.key] for o in near)
    assert met > 4 < clear


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
    before, most = 0, 0
    for _ in find_way_conflicts([a, b], [], found := {}):
        most, before = max(most, compared[0] - before), compared[0]
    assert set(found) == {1, 2}
    assert most <= ways.LEGS_A_PART**2 and compared[0] <= len(a.legs) * len(b.legs)


def test_a_leg_without_a_top_meets_what_is_above_it() -> None:
    column = Way(1, "v1", Footprint(), (ways.Leg((0.0, 0.0), (0.0, 0.0), 5.0, math.inf),))
    high, low = way(2, [(0.0, 0.0, 900.0)]), way(3, [(0.0, 0.0, -900.0)])
    found, _ = work([column, high, low], [])
    assert set(found) == {1, 2}
    assert all(itertools.starmap(lambda a, b: too_near(a, b) is too_near(b, a), [(column, high), (column, low)]))
