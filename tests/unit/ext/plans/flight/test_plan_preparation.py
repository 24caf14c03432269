"""From a plan and where the vehicles stand to certified steps: ways there, back and down, and what is refused."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest

from skygcs.core.plan.fleet_plan import FlightSpace, Phase, PhasedPlan, TimedPlan
from skygcs.core.plan.margins import MarginRule, Uncertainty
from skygcs.core.plan.straight_flight import straight_trajectories
from skygcs.core.trajectory import MotionLimits
from skygcs.ext.plans.flight.flight_situation import Situation
from skygcs.ext.plans.flight.flight_steps import StepKind, rest_of, steps_of
from skygcs.ext.plans.flight.preparation import at_speed, prepare, prepare_return, tubes_of, way_down

RULE = MarginRule(fixed_m=2.5)
LIMITS = MotionLimits()
Places = dict[str, tuple[float, float, float]]

GROUND: Places = {"a": (0.0, 0.0, 0.2), "b": (5.0, 0.0, -0.3), "c": (10.0, 0.0, 0.0)}


def near(places: Places) -> dict[str, object]:
    return {name: pytest.approx(place, abs=1e-6) for name, place in places.items()}


def timed(starts: Places, goals: Places) -> TimedPlan:
    ways = straight_trajectories(list(starts.values()), [goals[n] for n in starts], LIMITS)
    return TimedPlan(dict(zip(starts, ways, strict=True)))


def lifted(places: Places, up_m: float, by: tuple[float, float] = (0.0, 0.0)) -> Places:
    return {name: (x + by[0], y + by[1], up_m) for name, (x, y, _) in places.items()}


def situation(
    plan: TimedPlan | PhasedPlan, measured: Places = GROUND, grounded: bool = True, **more: object
) -> Situation:
    found = Situation(plan, FlightSpace(), measured, frozenset(measured) if grounded else frozenset(), RULE, LIMITS)
    return replace(found, **more)  # type: ignore[arg-type]


def test_those_under_their_starts_rise_and_the_plan_follows() -> None:
    starts = lifted(GROUND, 8.0)
    prepared = prepare(situation(timed(starts, lifted(GROUND, 8.0, (0.0, 10.0)))))
    assert prepared.problems == () and prepared.way is not None and prepared.way.certified
    assert prepared.steps[-1].timed and prepared.steps[0].starts() == starts
    assert prepared.tubes is not None and prepared.tubes.half_m == {"a": 1.25, "b": 1.25, "c": 1.25}


def test_starts_that_cross_are_reached_in_layers_above_those_that_stand() -> None:
    starts = {"a": (10.0, 0.0, 8.0), "b": (5.0, 0.0, 8.0), "c": (0.0, 0.0, 8.0)}
    prepared = prepare(situation(timed(starts, lifted(starts, 8.0, (0.0, 10.0)))))
    assert prepared.problems == ()
    way = [step for step in prepared.steps if step.kind is StepKind.WAY_THERE]
    assert way[-1].places() == near(starts) and len(way) >= 2
    assert all(place[2] >= 4.9 for place in way[0].starts().values()), "the take-off leads into the layer"
    ceiling = prepare(situation(timed(starts, lifted(starts, 8.0)), space=FlightSpace(ceiling_m=9.3)))
    assert any("way to the starts" in line for line in ceiling.problems), ceiling.problems


def test_one_in_the_air_already_joins_those_that_take_off() -> None:
    measured = {**GROUND, "c": (12.0, 3.0, 15.0)}
    starts = lifted(GROUND, 8.0)
    given = situation(timed(starts, lifted(starts, 8.0, (0.0, 10.0))), measured)
    prepared = prepare(replace(given, grounded=frozenset({"a", "b"})))
    assert prepared.problems == ()
    first = prepared.steps[0]
    assert first.starts()["c"] == (12.0, 3.0, 15.0) and first.starts()["a"][2] == pytest.approx(8.0)


def test_a_phased_plan_from_the_ground_begins_with_the_take_off() -> None:
    plan = PhasedPlan(GROUND, (Phase("climb", lifted(GROUND, 7.0)), Phase("cross", lifted(GROUND, 7.0, (0.0, 9.0)))))
    prepared = prepare(situation(plan))
    assert prepared.problems == () and [s.name for s in prepared.steps][-1] == "cross"
    assert prepared.steps[0].starts() == near(lifted(GROUND, 7.0))


def test_starts_and_goals_on_the_ground_and_vehicles_in_the_way_are_refused() -> None:
    low = prepare(situation(timed(lifted(GROUND, 0.5), lifted(GROUND, 8.0))))
    assert set(low.vehicles) == {"a", "b", "c"} and "above the ground" in low.problems[0]
    goals = lifted(GROUND, 8.0, (0.0, 10.0))
    for what, place in (("plan", (5.0, 5.0, 8.0)), ("way", (5.0, 0.0, 5.0))):
        given = situation(timed(lifted(GROUND, 8.0), goals), space=FlightSpace(standing={"x": place}))
        prepared = prepare(given)
        assert prepared.problems and any("x" in line and "b" in line for line in prepared.problems), what
    near = {**GROUND, "b": (1.5, 0.0, 0.0)}
    given = situation(timed(lifted(GROUND, 8.0), goals), near)
    assert any("a and b" in line for line in prepare(given).problems), "the ground is not exempt"


def test_the_way_back_is_straight_where_that_is_certified_and_refused_with_the_pair_else() -> None:
    starts, goals = lifted(GROUND, 8.0), lifted(GROUND, 8.0, (0.0, 12.0))
    plan = timed(starts, goals)
    (step,) = steps_of(plan, LIMITS)
    half_s = step.duration_s / 2
    rest = rest_of([step], half_s, frozenset(GROUND))
    here = rest[0].starts()
    off = {**here, "b": (here["b"][0], here["b"][1] - 3.0, 8.0)}
    prepared = prepare_return(situation(plan, off, grounded=False), rest)
    assert prepared.problems == () and prepared.steps[0].kind is StepKind.WAY_BACK
    assert prepared.steps[0].starts() == near(off) and prepared.steps[1].starts() == near(here)
    # an obstacle on the rest
    there = FlightSpace(standing={"x": (0.0, 11.0, 8.0)})
    refused = prepare_return(situation(plan, here, grounded=False, space=there), rest)
    assert any("a and x" in line for line in refused.problems), refused.problems
    # two that stand too near each other already
    close = {**here, "b": (here["a"][0] + 1.0, *here["a"][1:])}
    refused = prepare_return(situation(plan, close, grounded=False), rest)
    assert any("way back" in line and "a and b" in line for line in refused.problems), refused.problems


def test_landing_is_at_once_side_by_side_in_order_above_each_other_or_refused() -> None:
    rounds, certificate = way_down(lifted(GROUND, 8.0), -2.0, RULE, FlightSpace())
    assert certificate.certified and rounds == [["a", "b", "c"]]
    # b above a: whoever lands first stands where the other one comes down
    rounds, certificate = way_down({"a": (0.0, 0.0, 5.0), "b": (0.5, 0.0, 15.0)}, -2.0, RULE, FlightSpace())
    assert not certificate.certified and certificate.closest is not None
    assert set(certificate.closest.vehicles) == {"a", "b"}
    rounds, certificate = way_down({"a": (0.0, 0.0, 5.0)}, -2.0, RULE, FlightSpace())
    assert certificate.certified and rounds == [["a"]]
    parked = FlightSpace(standing={"x": (0.5, 0.0, 0.0)})
    _, certificate = way_down({"a": (0.0, 0.0, 5.0)}, -2.0, RULE, parked)
    assert not certificate.certified


def test_tubes_are_the_terms_of_the_margin_that_are_about_being_off() -> None:
    rule = MarginRule(Uncertainty(tracking_error_m=0.5, delay_s=0.2, clock_error_s=0.05))
    plan = timed(lifted(GROUND, 8.0), lifted(GROUND, 8.0, (0.0, 40.0)))
    tubes = tubes_of(rule, plan)
    assert tubes.free_m["a"] == 0.5
    assert tubes.timed_m["a"] == pytest.approx(0.5 + LIMITS.speed_mps * 0.25, rel=0.02)
    assert tubes_of(replace(rule, fixed_m=9.0), plan).timed_m == tubes.timed_m, "a fixed margin leaves the tube"
    faster = tubes_of(at_speed(rule, 2.0), plan)
    assert faster.timed_m["a"] == pytest.approx(0.5 + 2 * LIMITS.speed_mps * 0.25, rel=0.02)
    assert math.isclose(at_speed(rule, 2.0).uncertainty.acceleration_mps2, 0.5)
