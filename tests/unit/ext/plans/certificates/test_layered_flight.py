"""Layers and rounds by an oracle that measures each pair of corridors by itself, and where the lowest layer is."""

from __future__ import annotations

import math
import random
from itertools import combinations, pairwise

import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from skygcs.core.monitor.ways import Way, along, distance_m, standing
from skygcs.core.plan.fleet_plan import FlightSpace
from skygcs.core.separation import Footprint
from skygcs.ext.plans.certificates.layered_flight import GAP_M, LIFT_M, MAX_LAYERS, layered, layers_text
from support.examples import examples
from support.table import each

RATIO, HALF_M = 2.0, 1.25
SPACING_M = RATIO * (2.0 * HALF_M + GAP_M)
place = st.tuples(st.integers(-8, 8), st.integers(-8, 8), st.integers(10, 14))


def over_ground_m(*lines) -> float:
    """The distance of two lines or points, by the monitor's own geometry."""
    a, b = (along([(*p[:2], 0.0) for p in line]) if len(line) > 1 else standing((*line[0][:2], 0.0)) for line in lines)
    return distance_m(Way(1, "", Footprint(), a), Way(2, "", Footprint(), b))


@settings(max_examples=examples(400))
@given(
    st.lists(st.tuples(place, place, st.sampled_from((0.5, 0.9, HALF_M))), min_size=1, max_size=5),
    st.lists(place, max_size=2),
    st.sampled_from((1, 1, 1, 2, 3)),
)
def test_who_shares_a_layer_keeps_apart_and_no_more_layers_or_rounds_are_used_than_needed(fleet, parked, count) -> None:
    names, parked_half_m = [f"v{n}" for n in range(len(fleet))], 0.7
    starts, goals, half = zip(*fleet, strict=True)
    spacing = RATIO * (2.0 * max(half) + GAP_M)
    base = min(p[2] for p in (*starts, *goals))
    heights = [base + spacing * n for n in range(count)]
    space = FlightSpace(
        standing={str(n): p for n, p in enumerate(parked)}, ceiling_m=heights[-1] + max(half) + 0.9 * spacing
    )

    def keeps(distance, need_m) -> bool:
        assume(abs(distance - need_m) > 3 * GAP_M)
        return distance > need_m

    # what the table of the module says, pair by pair
    together, may_precede = {}, {}
    for i, j in combinations(range(len(fleet)), 2):
        need_m, mine, theirs = half[i] + half[j], (starts[i], goals[i]), (starts[j], goals[j])
        together[i, j] = keeps(over_ground_m(mine, theirs), need_m)
        may_precede[i, j] = all([
            keeps(over_ground_m(mine, (starts[j],)), need_m), keeps(over_ground_m((goals[i],), theirs), need_m)
        ])  # fmt: skip
        may_precede[j, i] = all([
            keeps(over_ground_m(theirs, (starts[i],)), need_m), keeps(over_ground_m((goals[j],), mine), need_m)
        ])  # fmt: skip
    clear = [
        [
            all([
                keeps(math.hypot(over_ground_m((p,), (starts[i], goals[i])), (h - p[2]) / RATIO), half[i] + 0.7)
                for p in parked
            ])
            for h in heights
        ]
        for i in range(len(fleet))
    ]  # fmt: skip

    found = layered(names, starts, goals, half, RATIO, space, parked_half_m)
    free = [[n for n, is_free in enumerate(layers) if is_free] for layers in clear]
    if isinstance(found, str):
        assert f"in {layers_text(count)} {spacing:.2f} m apart and up to " in found
        assert found.partition(" ")[0] in names
        if len(fleet) == 1:
            assert free == [[]]
        if len(fleet) == 2 and all(free):
            (a, b), both = free, together[0, 1] and set(free[0]) & set(free[1])
            assert not both and not {(p, q) for p in a for q in b if p != q}
        return
    plan, layers = found
    assert layers.heights_m == pytest.approx(heights)
    assert all(clear[i][layer] for i, layer in enumerate(layers.layer))
    for i, j in combinations(range(len(fleet)), 2):
        if layers.layer[i] == layers.layer[j]:
            r, s = layers.round[i], layers.round[j]
            assert together[i, j] if r == s else may_precede[(i, j) if r < s else (j, i)]
    if len(fleet) == 1:
        assert (layers.layer, layers.round) == ([free[0][0]], [0])
    if len(fleet) == 2 and together[0, 1]:
        assert layers.round == [0, 0] and layers.layer == [options[0] for options in free]

    # the phases fly them
    height = [heights[layer] for layer in layers.layer]
    used = sorted(set(layers.round))
    assert used == list(range(len(used)))
    crossings = ["cross"] if len(used) == 1 else [f"cross {n + 1}" for n in used]
    assert [phase.name for phase in plan.phases] == ["climb", *crossings, "descend"]
    assert plan.phases[0].goals == {
        n: (*s[:2], pytest.approx(h)) for n, s, h in zip(names, starts, height, strict=True)
    }
    for turn, phase in zip(used, plan.phases[1:-1], strict=True):
        crossing = [i for i in range(len(fleet)) if layers.round[i] == turn]
        assert phase.goals == {names[i]: (*goals[i][:2], pytest.approx(height[i])) for i in crossing}
    assert dict(plan.phases[-1].goals) == dict(zip(names, goals, strict=True)) and plan.starts == dict(
        zip(names, starts, strict=True)
    )


@each(
    ("start_m", "goal_m", "floor_m", "lowest_m"),
    [
        (12.0, 10.0, None, 10.0),
        (10.0, 12.0, None, 10.0),
        (10.0, 12.0, 9.0, 10.0),
        (0.0, 5.0, None, 0.0),
        # nobody crosses on the ground
        (0.0, LIFT_M, 0.0, LIFT_M),
        (0.0, LIFT_M - 0.1, 0.0, SPACING_M),
        (0.0, 12.0, 0.0, 12.0),
        (3.0, 3.0 + LIFT_M, 3.0, 3.0 + LIFT_M),
        (3.0, 3.0, 3.0, 3.0 + SPACING_M),
        # those on the ground stand below the floor of the plan
        (1.0, 4.0, 3.0, 3.0 + SPACING_M),
        (-2.0, 1.0, 0.0, SPACING_M),
    ],
)
def test_where_the_lowest_layer_is(start_m: float, goal_m: float, floor_m: float | None, lowest_m: float) -> None:
    ends = [(0.0, 0.0, start_m)], [(9.0, 0.0, goal_m)]
    found = layered(["v0"], *ends, [HALF_M], RATIO, FlightSpace(floor_m=floor_m), 0.0)
    assert not isinstance(found, str)
    heights = found[1].heights_m
    assert len(heights) == MAX_LAYERS and heights[0] == pytest.approx(lowest_m)
    assert [b - a for a, b in pairwise(heights)] == pytest.approx([SPACING_M] * (MAX_LAYERS - 1))
    # each layer needs half a margin below the ceiling
    for layers in (1, 2, 3):
        for above_m, count in ((1e-6, layers), (-0.01, layers - 1)):
            space = FlightSpace(floor_m=floor_m, ceiling_m=heights[layers - 1] + HALF_M + above_m)
            found = layered(["v0"], *ends, [HALF_M], RATIO, space, 0.0)
            if count:
                assert len(found[1].heights_m) == count
            else:
                assert found == f"there is no layer between {lowest_m:g} m and the ceiling at {space.ceiling_m:g} m"


def test_the_most_constrained_go_first() -> None:
    """Five exchanges of a grid, the same in each run (a text is a seed that is not shifted), take 36 layers in the
    order of their names."""
    places = [(5.0 * (n % 5), 5.0 * (n // 5), 10.0) for n in range(20)]
    used = []
    for seed in range(5):
        goals = random.Random(f"grid {seed}").sample(places, 20)
        found = layered([f"v{n}" for n in range(20)], places, goals, [HALF_M] * 20, RATIO, FlightSpace(), 0.0)
        used.append(len(set(found[1].layer)))
    assert sum(used) <= 34, used
