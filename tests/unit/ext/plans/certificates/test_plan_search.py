from __future__ import annotations

import math
import random
from itertools import combinations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from bench.plans.refusals import circle, grid
from skygcs.core.plan.fleet_plan import FlightSpace, PhasedPlan, TimedPlan
from skygcs.core.plan.margins import MarginRule
from skygcs.core.plan.straight_flight import assigned, straight_trajectories
from skygcs.core.trajectory import MotionLimits, require_within
from skygcs.errors import RefusedError
from skygcs.ext.plans.certificates.plan_search import Task, make_plan
from support.examples import examples
from support.table import each

RULE = MarginRule(fixed_m=2.5)
LIMITS = MotionLimits()
coordinate = st.floats(-50, 50)
places = st.lists(st.tuples(coordinate, coordinate, st.floats(5, 30)), min_size=1, max_size=12)


def task(starts, goals, **options) -> Task:
    names = [f"v{i}" for i in range(len(starts))]
    return Task(dict(zip(names, starts, strict=True)), dict(zip(names, goals, strict=True)), **options)


def in_metric(places):
    """With a downwash ratio of 2."""
    return np.array(places) / (1.0, 1.0, 2.0)


@settings(max_examples=examples(100), deadline=None)
@given(places, st.randoms(use_true_random=False))
def test_an_assignment_has_no_negative_product(starts, rng) -> None:
    goals = [(rng.uniform(-50, 50), rng.uniform(-50, 50), rng.uniform(5, 30)) for _ in starts]
    order = assigned(starts, goals, 2.0)
    assert sorted(order) == list(range(len(starts)))
    starts, goals = in_metric(starts), in_metric([goals[i] for i in order])
    for i, j in combinations(range(len(starts)), 2):
        assert sum((starts[i] - starts[j]) * (goals[i] - goals[j])) >= -1e-7


@settings(max_examples=examples(60), deadline=None)
@given(st.integers(0, 10**6), st.integers(2, 40))
def test_exchanged_goals_keep_the_separation_of_the_proposition(seed: int, count: int) -> None:
    """CAPT: at least the least spacing of starts and of goals, divided by √2."""
    rng = random.Random(seed)
    starts = grid(count)
    goals = [(30.0 + rng.uniform(0, 1) + 6.0 * (i % 6), rng.uniform(0, 1) + 6.0 * (i // 6), 20.0) for i in range(count)]
    rng.shuffle(goals)
    goals = [goals[i] for i in assigned(starts, goals, 2.0)]
    spacing = min(math.dist(p, q) for ends in (starts, goals) for p, q in combinations(ends, 2))
    beta = np.linspace(0.0, 1.0, 201)[:, None]
    starts, goals = in_metric(starts), in_metric(goals)
    for i, j in combinations(range(count), 2):
        apart = (1.0 - beta) * (starts[i] - starts[j]) + beta * (goals[i] - goals[j])
        assert np.linalg.norm(apart, axis=1).min() >= spacing / math.sqrt(2.0) - 1e-9


def test_all_fly_straight_by_one_time_scaling_within_the_limits() -> None:
    starts = [(0.0, 0.0, 10.0), (0.0, 10.0, 10.0), (0.0, 20.0, 10.0)]
    goals = [(50.0, 0.0, 10.0), (5.0, 10.0, 20.0), (0.0, 20.0, 10.0)]
    flown = straight_trajectories(starts, goals, LIMITS)
    assert len({t.duration_s for t in flown}) == 1
    for start, goal, trajectory in zip(starts, goals, flown, strict=True):
        require_within(trajectory, LIMITS)
        assert trajectory.start_enu_m == pytest.approx(start)
        assert trajectory.end_enu_m == pytest.approx(goal, abs=1e-9)
    t = 0.3 * flown[0].duration_s
    beta = flown[0].at(t).pos_enu_m[0] / 50.0
    assert flown[1].at(t).pos_enu_m == pytest.approx((5.0 * beta, 10.0, 10.0 + 10.0 * beta))


def test_goals_that_may_be_exchanged_are_flown_straight() -> None:
    starts = grid(50)
    goals = [(x + 60.0, y, z) for x, y, z in starts]
    random.Random(1).shuffle(goals)
    found = make_plan(task(starts, goals, exchangeable=True), RULE, LIMITS)
    assert isinstance(found.plan, TimedPlan)
    assert found.certificate is not None and found.certificate.certified
    ends = {tuple(round(value, 6) for value in t.end_enu_m) for t in found.plan.trajectories.values()}
    assert ends == set(goals)


def test_goals_of_their_own_are_reached_in_layers() -> None:
    starts = grid(20)
    goals = random.Random(2).sample(starts, 20)
    told: list[tuple[str, int, int]] = []
    found = make_plan(task(starts, goals), RULE, LIMITS, progress=lambda *work: told.append(work))
    assert isinstance(found.plan, PhasedPlan)
    assert told[-1] == ("layers", 0, 20) and told[0][0] == "straight, timed"
    heights = {z for _, _, z in found.plan.phases[0].goals.values()}
    assert found.attempts[-1].what == f"{len(heights)} layers"
    assert [phase.name for phase in found.plan.phases] == ["climb", "cross", "descend"]
    assert dict(found.plan.phases[-1].goals) == {f"v{i}": goal for i, goal in enumerate(goals)}
    flown = found.plan.trajectories(LIMITS)
    assert all(flown[f"v{i}"].end_enu_m == pytest.approx(goal, abs=1e-6) for i, goal in enumerate(goals))


def test_rounds_where_the_ceiling_leaves_too_few_layers() -> None:
    starts = grid(20)
    found = make_plan(task(starts, starts[::-1]), RULE, LIMITS, FlightSpace(ceiling_m=61.0))
    assert isinstance(found.plan, PhasedPlan)
    assert [phase.name for phase in found.plan.phases][:3] == ["climb", "cross 1", "cross 2"]
    assert found.attempts[-1].what.endswith(f" layers, {len(found.plan.phases) - 2} rounds")
    assert max(z for phase in found.plan.phases for _, _, z in phase.goals.values()) <= 61.0 - 1.25


@pytest.mark.parametrize(("ceiling_m", "left"), [(20.0, "2 layers"), (12.0, "1 layer")])
def test_a_search_that_fails_says_what_was_tried_and_why(ceiling_m: float, left: str) -> None:
    starts = grid(20)
    found = make_plan(task(starts, starts[::-1]), RULE, LIMITS, FlightSpace(ceiling_m=ceiling_m))
    assert found.plan is None
    assert found.certificate is found.attempts[0].certificate is not None
    straight, layers = found.reasons()
    assert straight.startswith("straight, timed: v") and "come within 0.000 m at" in straight
    assert f" in {left} 5.00 m apart and up to " in layers


@each("which", ["starts", "goals"])
def test_starts_or_goals_that_are_too_close_are_named_at_once(which: str) -> None:
    apart, near = [(0.0, 0.0, 10.0), (10.0, 0.0, 10.0)], [(0.0, 0.0, 10.0), (2.0, 0.0, 10.0)]
    pair = (near, apart) if which == "starts" else (apart, near)
    found = make_plan(task(*pair), RULE, LIMITS)
    assert found.plan is None
    assert f"{which}: v0 and v1 come within 2.000 m in phase standing at the {which}" in found.reasons()[0]


def test_a_parked_vehicle_is_crossed_above() -> None:
    space = FlightSpace(standing={"parked": (10.0, 0.0, 10.0)}, floor_m=0.0)
    found = make_plan(task([(0.0, 0.0, 10.0)], [(20.0, 0.0, 10.0)]), RULE, LIMITS, space)
    assert isinstance(found.plan, PhasedPlan)
    assert found.plan.phases[0].goals["v0"][2] >= 15.0


def test_fifty_antipodal_on_a_circle_need_layers() -> None:
    ring = circle(50, 45.0)
    assert make_plan(task(ring, ring[25:] + ring[:25], kind="timed"), RULE, LIMITS).plan is None
    assert isinstance(make_plan(task(ring, ring[25:] + ring[:25]), RULE, LIMITS).plan, PhasedPlan)


def test_orders_to_go_somewhere_are_one_phase_of_straight_legs() -> None:
    starts, goals = [(0.0, 0.0, 10.0), (0.0, 9.0, 10.0)], [(30.0, 0.0, 12.0), (30.0, 9.0, 10.0)]
    found = make_plan(task(starts, goals, kind="direct"), RULE, LIMITS)
    assert isinstance(found.plan, PhasedPlan)
    assert [(phase.name, dict(phase.goals)) for phase in found.plan.phases] == [
        ("straight", dict(zip(("v0", "v1"), goals, strict=True)))
    ]
    crossed = make_plan(task(starts, goals[::-1], kind="direct"), RULE, LIMITS)
    assert crossed.plan is None and "straight, each at its own speed: v0 and v1" in crossed.reasons()[0]


def test_a_task_that_is_none_is_refused() -> None:
    place = (0.0, 0.0, 0.0)
    for starts, goals, words in (
        ({}, {}, "one vehicle at least"),
        ({"a": place, "b": place}, {"b": place}, "a has no goal"),
        ({"b": place}, {"b": place, "c": place}, "c has no start"),
    ):
        with pytest.raises(RefusedError, match=words):
            make_plan(Task(starts, goals), RULE, LIMITS)
