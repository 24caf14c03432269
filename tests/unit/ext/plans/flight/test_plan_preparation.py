"""From a plan and where the vehicles stand to certified steps: ways there, back and down, and what is refused."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest

from skygcs.core.plan.fleet_plan import FlightSpace, Phase, PhasedPlan, TimedPlan
from skygcs.core.plan.margins import MarginRule, Uncertainty
from skygcs.core.plan.straight_flight import straight_trajectories
from skygcs.core.trajectory import ClockState, MotionLimits, Piece, Trajectory
from skygcs.errors import RefusedError
from skygcs.ext.plans.flight.execution import Execution
from skygcs.ext.plans.flight.flight_situation import Situation
from skygcs.ext.plans.flight.flight_steps import FlightStep, StepKind, rest_of, steps_of
from skygcs.ext.plans.flight.goto_legs import AGAIN_S, STUCK_S, GotoLegs
from skygcs.ext.plans.flight.guidance import GOTO_SOURCE, GOTO_TUBE_M, Guidance, by_goto, choose, level_or_vertical
from skygcs.ext.plans.flight.plan_states import OrderKind, PlanState
from skygcs.ext.plans.flight.preparation import at_speed, prepare, prepare_return, tubes_of, way_down
from skygcs.ext.plans.flight.sights import Measurement, Tubes

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


# -- A vehicle whose positions come late is judged by where it was when it reported, not by where it may be by now.


TUBES = Tubes({"v1": 1.65}, {"v1": 0.4}, {"v1": 0.4}, 2.0)


def flying(*, timed: bool) -> Execution:
    """Along x with 2 m/s for 10 s; begun, at time 100."""
    way = Trajectory([Piece(10.0, (0.0, 2.0), (0.0,), (10.0,))])
    execution = Execution(
        [FlightStep("leg", StepKind.PLAN, {"v1": way}, timed=timed)], (), TUBES, {"v1": way.start_enu_m}
    )
    execution.begin()
    execution.outcome(OrderKind.ENGAGE, "v1", True, "")
    for at in (98.0, 99.0, 100.0):
        execution.tick(at, None, 0.0, {"v1": Measurement((0.0, 0.0, 10.0))})
    assert execution.state is PlanState.FLYING
    return execution


def test_a_gap_at_the_end_of_a_leg_is_no_trouble() -> None:
    execution = flying(timed=False)
    for n in range(1, 9):  # 1.6 s without a position: carried on, it is 2 m beyond the end
        sight = Measurement((20.0 + 0.3 * n, 0.0, 10.0), 0.2 * n, 2.0, reported_m=(19.8, 0.0, 10.0), before_s=0.2 * n)
        execution.tick(109.9 + 0.2 * n, ClockState.RUNNING, 9.95, {"v1": sight})
    assert execution.state is PlanState.FLYING


def test_a_gap_is_compared_with_the_reference_of_that_time() -> None:
    execution = flying(timed=True)
    for n in range(1, 26):
        now, s = 100.0 + 0.2 * n, 0.2 * n
        age_s = max(0.0, now - 103.5)  # the vehicle was last heard then, and turned away from its velocity since
        seen = 2.0 * (s - age_s)
        execution.tick(
            now,
            ClockState.RUNNING,
            s,
            {"v1": Measurement((seen + 9.0, 0.0, 10.0), age_s, 2.0, reported_m=(seen, 0.0, 10.0), before_s=age_s)},
        )
    assert execution.state is PlanState.FLYING


def test_one_that_was_late_when_it_reported_is_in_trouble() -> None:
    execution = flying(timed=True)
    for n in range(1, 16):
        now, s = 100.0 + 0.2 * n, 0.2 * n
        sight = Measurement((2.0 * s, 0.0, 10.0), 0.2, 2.0, reported_m=(2.0 * s - 1.0, 0.0, 10.0), before_s=0.2)
        execution.tick(now, ClockState.RUNNING, s, {"v1": sight})
    assert execution.state is PlanState.STOPPED and "from its reference" in execution.reason


# -- The legs of a step by goto, order by order, and the choice of the way in which a plan is flown.


GOAL = (10.0, 0.0, 5.0)


def legs() -> GotoLegs:
    return GotoLegs({"a": GOAL, "b": (0.0, 10.0, 5.0)}, {"a": 0.5, "b": 0.5}, 2.0)


def test_an_order_is_given_again_until_it_is_heard_and_finished_is_when_all_stand_at_their_places() -> None:
    step = legs()
    assert step.due() == ["a", "b"] and step.due() == []
    step.ended("a", ok=True, unheard=False, now=0.0)
    step.ended("b", ok=False, unheard=True, now=0.0)
    at = {"a": (GOAL, 0.0), "b": ((0.0, 0.0, 5.0), 0.0)}
    step.look(AGAIN_S - 0.1, at)
    assert step.due() == [] and step.state is ClockState.RUNNING
    step.look(AGAIN_S, at)
    assert step.due() == ["b"] and step.orders == 3
    step.ended("b", ok=True, unheard=False, now=3.0)
    # it has accepted, and does not move
    step.look(3.0 + STUCK_S - 0.1, at)
    assert step.due() == []
    step.look(3.0 + STUCK_S, at)
    assert step.due() == ["b"]
    step.ended("b", ok=True, unheard=False, now=10.0)
    step.look(11.0, {**at, "b": ((0.0, 9.8, 5.9), 0.1)})
    assert step.state is ClockState.FINISHED  # the height counts half
    step.look(11.2, {**at, "b": (None, 0.1)})
    assert step.state is ClockState.RUNNING, "one that is not heard has not arrived"


def test_a_denied_order_is_no_lost_one() -> None:
    step = legs()
    step.due()
    step.ended("a", ok=False, unheard=False, now=0.0)
    step.look(60.0, {"a": (GOAL, 0.0), "b": (GOAL, 0.0)})
    assert step.refused() == ["a"] and step.due() == []


def test_a_stop_waits_for_the_holds_and_going_on_orders_every_leg_anew() -> None:
    step = legs()
    step.due()
    for name in ("a", "b"):
        step.ended(name, ok=True, unheard=False, now=0.0)
    assert step.stop(["a", "b", "unknown"]) == ["a", "b"] and step.stop(["a"]) == []
    step.held("a")
    assert step.state is ClockState.PAUSING
    step.look(60.0, {"a": (GOAL, 0.0), "b": (GOAL, 0.0)})
    assert step.due() == [], "nothing is ordered while it is stopped"
    step.held("b")
    assert step.state is ClockState.PAUSED
    step.go_on(without=["b"])
    assert step.state is ClockState.RUNNING and step.due() == ["a"]
    step.end()
    step.go_on()
    assert step.due() == [] and step.state is ClockState.ABORTED


CHOICES = [
    # by, timed, companions, not streamed → way, or what the refusal says to do
    ("auto", False, [], [], "setpoints"),
    ("auto", False, [], ["b"], "goto"),
    ("auto", True, [], ["b"], "setpoints"),  # and the finding of the link refuses it
    ("auto", False, ["a", "b"], [], "onboard"),
    ("auto", True, ["a", "b"], [], "onboard"),
    ("auto", False, ["a"], ["b"], "setpoints"),
    ("goto", False, [], [], "goto"),
    ("goto", True, [], [], "plan make FILE --fleet --kind phased"),
    ("setpoints", False, [], ["a"], "setpoints"),
    ("onboard", True, ["a"], [], "plan run FILE --by setpoints"),
    ("onboard", False, ["a"], [], "plan run FILE --by goto"),
    ("onboard", False, ["a", "b"], [], "onboard"),
    ("onboard", False, [], [], "mission"),
    ("onboard", True, [], [], "plan run FILE --by setpoints"),
    ("mission", False, ["a", "b"], [], "mission"),
    ("mission", True, [], [], "plan make FILE --fleet --kind phased"),
]


def test_the_way_is_what_the_links_carry() -> None:
    for by, timed, companions, narrow, expected in CHOICES:
        own = {name: name in companions for name in ("a", "b")}
        case = (by, timed, companions, narrow)
        if expected in [way.value for way in Guidance]:
            choice = choose(by, timed=timed, own_companion=own, not_streamed=dict.fromkeys(narrow, "54 B/s"))
            assert choice.by.value == expected and choice.reason, case
        else:
            with pytest.raises(RefusedError, match=expected):
                choose(by, timed=timed, own_companion=own, not_streamed={})


def test_slanted_legs_are_flown_up_and_level_or_level_and_down_and_others_stay() -> None:
    starts = {"a": (0.0, 0.0, 10.0), "b": (5.0, 0.0, 10.0), "c": (9.0, 0.0, 10.0)}
    level = Phase("level", {"a": (0.0, 5.0, 10.0)})
    slanted = Phase("go", {"a": (0.0, 9.0, 14.0), "b": (5.0, 9.0, 6.0)})
    plan = level_or_vertical(PhasedPlan(starts, (level, slanted)))
    assert plan.phases == (
        level,
        Phase("go: up", {"a": (0.0, 5.0, 14.0)}),
        Phase("go: level", {"a": (0.0, 9.0, 14.0), "b": (5.0, 9.0, 10.0)}),
        Phase("go: down", {"b": (5.0, 9.0, 6.0)}),
    )
    assert level_or_vertical(plan) == plan


def test_legs_by_goto_have_the_tube_of_the_autopilot_unless_a_larger_one_is_known() -> None:
    known = Uncertainty(tracking_error_m=9.0)
    rule = by_goto(MarginRule(by_vehicle={"c": known}), {"a": "px4", "b": "ardupilot", "c": "px4", "d": "generic"})
    tubes = {name: rule.by_vehicle[name].tracking_error_m for name in "abcd"}
    assert tubes == {"a": GOTO_TUBE_M["px4"], "b": GOTO_TUBE_M["ardupilot"], "c": 9.0, "d": max(GOTO_TUBE_M.values())}
    assert rule.sources("a")["tracking error p99"] == GOTO_SOURCE
