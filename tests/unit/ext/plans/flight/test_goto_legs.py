"""The legs of a step by goto, order by order, and the choice of the way in which a plan is flown."""

from __future__ import annotations

import pytest

from skygcs.core.plan.fleet_plan import Phase, PhasedPlan
from skygcs.core.plan.margins import MarginRule, Uncertainty
from skygcs.core.trajectory import ClockState
from skygcs.errors import RefusedError
from skygcs.ext.plans.flight.goto_legs import AGAIN_S, STUCK_S, GotoLegs
from skygcs.ext.plans.flight.guidance import GOTO_SOURCE, GOTO_TUBE_M, Guidance, by_goto, choose, level_or_vertical

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
