"""The steps of a flight: phases as straight ways, what is left of a trajectory, and distances from it."""

from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from skygcs.core.plan.fleet_plan import Phase, PhasedPlan, TimedPlan
from skygcs.core.trajectory import MotionLimits, Piece, Trajectory
from skygcs.ext.plans.flight.flight_steps import (
    StepKind,
    distance_to_leg,
    free_step,
    joined,
    phased_steps,
    plan_of,
    remainder,
    renamed,
    rest_of,
    starts_of,
    steps_of,
)

LIMITS = MotionLimits()
CURVE = Trajectory(
    [
        Piece(3.0, (0.0, 1.0, 0.5, -0.1), (1.0, 0.0, 0.2), (5.0,), (0.1, 0.2)),
        Piece(2.0, (4.8, 1.3, -0.2), (2.8, 1.2), (5.0, 0.0, 0.3), (0.7, -0.1)),
    ]
)
AT = st.floats(0.0, 6.0, allow_nan=False)


@given(AT, AT)
def test_the_remainder_is_the_same_curve_later(from_s: float, after_s: float) -> None:
    rest = remainder(CURVE, from_s)
    if from_s >= CURVE.duration_s - 1e-3:
        assert rest.start_enu_m == pytest.approx(CURVE.end_enu_m, abs=1e-2)
        return
    after_s = min(after_s, rest.duration_s)
    one, other = rest.at(after_s), CURVE.at(min(from_s + after_s, CURVE.duration_s))
    assert one.pos_enu_m == pytest.approx(other.pos_enu_m, abs=2e-3)
    assert one.yaw_rad == pytest.approx(other.yaw_rad, abs=2e-3)


def test_phases_are_steps_in_which_those_without_a_goal_stand() -> None:
    plan = PhasedPlan(
        {"a": (0.0, 0.0, 5.0), "b": (9.0, 0.0, 5.0)},
        (Phase("wait", {}), Phase("cross", {"a": (0.0, 8.0, 5.0)}), Phase("both", {"a": (1.0, 8.0, 5.0)})),
    )
    steps = phased_steps(plan, StepKind.PLAN, LIMITS)
    assert [step.name for step in steps] == ["cross", "both"], "nobody moves in the first one"
    assert steps[0].places() == {"a": pytest.approx((0.0, 8.0, 5.0)), "b": (9.0, 0.0, 5.0)}
    assert steps[0].trajectories["b"].duration_s == pytest.approx(steps[0].trajectories["a"].duration_s)
    assert not steps[0].timed and steps[0].off_m("a", (0.5, 3.0, 5.0), 0.0, 2.0) == pytest.approx(0.5)
    certified = plan_of(steps[0])
    assert isinstance(certified, PhasedPlan) and certified.starts == steps[0].starts()


def test_a_timed_step_measures_from_the_reference_with_heights_as_in_the_certificate() -> None:
    (step,) = steps_of(TimedPlan({"a": CURVE}), LIMITS)
    x, y, z = CURVE.at(1.5).pos_enu_m
    assert step.timed and step.off_m("a", (x + 3.0, y, z + 8.0), 1.5, 2.0) == pytest.approx(5.0)


def test_the_rest_of_a_plan_is_of_those_that_stay() -> None:
    (step,) = steps_of(TimedPlan({"a": CURVE, "b": CURVE}), LIMITS)
    rest = rest_of([step, step], 2.0, frozenset({"a"}))
    assert [set(one.trajectories) for one in rest] == [{"a"}, {"a"}]
    assert rest[0].duration_s == pytest.approx(3.0) and rest[1].duration_s == 5.0
    assert rest_of([], 0.0, frozenset()) == []


def test_names_of_the_plan_become_vehicles_and_those_left_out_do_not_fly() -> None:
    timed = renamed(TimedPlan({"1": CURVE, "2": CURVE}), {"2": "bravo"})
    assert isinstance(timed, TimedPlan) and set(timed.trajectories) == {"bravo"}
    plan = PhasedPlan({"1": (0.0, 0.0, 1.0), "2": (5.0, 0.0, 1.0)}, (Phase("up", {"1": (0.0, 0.0, 5.0)}),))
    phased = renamed(plan, {"1": "alpha"})
    assert isinstance(phased, PhasedPlan) and starts_of(phased) == {"alpha": (0.0, 0.0, 1.0)}
    assert phased.phases[0].goals == {"alpha": (0.0, 0.0, 5.0)}


@given(*[st.tuples(*[st.floats(-50, 50)] * 3)] * 3)
def test_the_distance_to_a_leg_is_the_least_of_its_points(p: tuple, a: tuple, b: tuple) -> None:  # type: ignore[type-arg]
    points = [tuple(u + k / 200 * (v - u) for u, v in zip(a, b, strict=True)) for k in range(201)]
    sampled = min(math.dist(p, point) for point in points)
    assert distance_to_leg(p, a, b) == pytest.approx(sampled, abs=1e-6 + math.dist(a, b) / 200)
    assert distance_to_leg(p, a, b) <= sampled + 1e-9


def test_a_plan_without_barriers_is_one_step_along_all_its_corners() -> None:
    starts = {"a": (0.0, 0.0, 5.0), "b": (9.0, 0.0, 5.0), "c": (20.0, 0.0, 5.0)}
    there = PhasedPlan(starts, (Phase("climb", {"a": (0.0, 0.0, 10.0)}),))
    plan = PhasedPlan(
        {"a": (0.0, 0.0, 10.0), "b": (9.0, 0.0, 5.0), "c": (20.0, 0.0, 5.0)},
        (Phase("go", {"a": (0.0, 8.0, 10.0), "b": (9.0, 8.0, 5.0)}), Phase("on", {"a": (-6.0, 8.0, 10.0)})),
    )
    step = free_step(joined((there, plan)), LIMITS)
    assert step.corners == {
        "a": ((0.0, 0.0, 5.0), (0.0, 0.0, 10.0), (0.0, 8.0, 10.0), (-6.0, 8.0, 10.0)),
        "b": ((9.0, 0.0, 5.0), (9.0, 8.0, 5.0)),
    }
    assert not step.timed and step.starts() == starts
    assert step.places() == {name: pytest.approx(leg[1]) for name, leg in plan.legs()[-1][1].items()}
    for place, off_m in (
        ((0.0, 0.0, 7.0), 0.0),
        ((0.5, 4.0, 10.0), 0.5),
        ((-3.0, 8.0, 11.0), 0.5),
        ((-3.0, 4.0, 10.0), 3.0),
    ):
        assert step.off_m("a", place, 0.0, 2.0) == pytest.approx(off_m), place
    assert step.off_m("c", (20.0, 0.7, 5.0), 0.0, 2.0) == pytest.approx(0.7)
