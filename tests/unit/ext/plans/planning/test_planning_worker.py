"""What the planning process answers, without the process."""

from __future__ import annotations

import json
from dataclasses import asdict
from typing import Any

import pytest

from skygcs.core.plan.fleet_plan import FlightSpace, Phase, PhasedPlan
from skygcs.core.plan.margins import MarginRule, Uncertainty
from skygcs.core.plan.plan_json import plan_from_json
from skygcs.core.trajectory import MotionLimits
from skygcs.errors import PlanFileError, SkygcsError, TrajectoryError
from skygcs.ext.plans.planning.request import WrittenPath, check_request, make_request, paths_request
from skygcs.ext.plans.planning.worker import answered
from support.table import each

RULE = MarginRule(fixed_m=2.5)
LIMITS = MotionLimits()
SPACE = FlightSpace()


def answer(request: dict[str, Any], told: list[tuple[str, int, int]] | None = None) -> dict[str, Any]:
    """As the process does, by way of JSON in both directions."""
    report = (lambda *_: None) if told is None else lambda *progress: told.append(progress)
    found: dict[str, Any] = json.loads(json.dumps(answered(json.loads(json.dumps(request)), report)))
    return found


def test_a_search_answers_with_a_plan_that_is_certified_again() -> None:
    told: list[tuple[str, int, int]] = []
    starts = {"a": (0.0, 0.0, 10.0), "b": (20.0, 0.0, 10.0)}
    goals = {"a": (20.0, 0.0, 10.0), "b": (0.0, 0.0, 10.0)}
    found = answer(make_request(starts, goals, RULE, LIMITS, SPACE), told)
    assert found["certificate"]["certified"] and found["attempts"] == ["straight, timed", "2 layers"]
    assert ("straight, timed", 2, 2) in told and ("layers", 0, 2) in told
    again = answer(check_request(plan_from_json("it", found["plan"])[0], RULE, LIMITS, SPACE))
    assert again["certificate"]["certified"] and again["certificate"]["closest"] == found["certificate"]["closest"]


def test_direct_is_one_phase_of_straight_legs() -> None:
    starts = {"a": (0.0, 0.0, 10.0), "b": (10.0, 0.0, 10.0)}
    beside = {"a": (0.0, 9.0, 10.0), "b": (10.0, 9.0, 10.0)}
    found = answer(make_request(starts, beside, RULE, LIMITS, SPACE, kind="direct"))
    assert [phase["goals"] for phase in found["plan"]["phases"]] == [{n: list(p) for n, p in beside.items()}]
    # at one speed they would pass: a arrives behind b when that has left; but b may be late
    behind = {"a": (10.0, 0.0, 10.0), "b": (20.0, 0.0, 10.0)}
    refused = answer(make_request(starts, behind, RULE, LIMITS, SPACE, kind="direct"))
    assert refused["plan"] is None and "a and b come within 0.000 m in phase straight" in refused["reasons"][0]


def test_each_vehicle_is_timed_and_judged_by_its_own_limits() -> None:
    starts = {"a": (0.0, 0.0, 10.0), "b": (0.0, 20.0, 10.0)}
    goals = {"a": (30.0, 0.0, 10.0), "b": (30.0, 20.0, 10.0)}
    slow = MotionLimits(speed_mps=1.0)
    request = make_request(starts, goals, RULE, LIMITS, SPACE) | {"limits_of": {"b": asdict(slow)}}
    assert answer(request)["certificate"]["duration_s"] > 30.0  # all by the slowest, as they fly on one time scaling
    paths = {name: WrittenPath([starts[name], goals[name]]) for name in starts}
    request = paths_request(paths, RULE, LIMITS, SPACE, within_limits=True) | {"limits_of": {"b": asdict(slow)}}
    found = answer(request)
    plan, _ = plan_from_json("it", found["plan"])
    durations = {name: path.duration_s for name, path in plan.trajectories.items()}  # type: ignore[union-attr]
    assert durations["a"] < 10.0 and durations["b"] > 30.0
    again = check_request(plan, RULE, LIMITS, SPACE, within_limits=True) | {"limits_of": {"a": asdict(slow)}}
    (why,) = answer(again)["certificate"]["motion"]
    assert why.startswith("a: ") and "speed of 5 m/s" in why and "the limit is 1 m/s" in why


def test_written_paths_become_trajectories() -> None:
    timed = WrittenPath([(0.0, 0.0, 5.0), (10.0, 0.0, 5.0)], [0.0, 5.0], [0.0, 1.0])
    free = WrittenPath([(0.0, 10.0, 5.0), (10.0, 10.0, 5.0), (10.0, 20.0, 5.0)])
    found = answer(paths_request({"a": timed, "b": free}, RULE, LIMITS, SPACE))
    plan, _ = plan_from_json("it", found["plan"])
    assert plan.trajectories["a"].at(2.5).pos_enu_m == (5.0, 0.0, 5.0)  # type: ignore[union-attr]
    assert plan.trajectories["b"].end_enu_m == (10.0, 20.0, 5.0)  # type: ignore[union-attr]
    backwards = WrittenPath([(0.0, 0.0, 5.0), (1.0, 0.0, 5.0)], [5.0, 1.0])
    with pytest.raises(TrajectoryError, match=r"^c: "):
        answer(paths_request({"c": backwards}, RULE, LIMITS, SPACE))


def test_terms_and_where_they_come_from_survive_the_way() -> None:
    measured = Uncertainty(tracking_error_m=0.2, sources={"tracking_error_m": "measured over 4 min"})
    rule = MarginRule(by_vehicle={"a": measured})
    plan = PhasedPlan({"a": (0.0, 0.0, 5.0), "b": (9.0, 0.0, 5.0)}, (Phase("stand", {}),))
    closest = answer(check_request(plan, rule, LIMITS, SPACE))["certificate"]["closest"]
    assert closest["terms"]["a"]["tracking error p99"] == 0.2 and closest["terms"]["b"]["tracking error p99"] == 0.4
    assert closest["sources"]["a"]["tracking error p99"] == "measured over 4 min"
    assert closest["sources"]["b"]["tracking error p99"] == "default"


def test_the_space_of_a_plan_and_of_the_request_are_both_kept() -> None:
    plan = {
        "format": "skygcs-plan",
        "version": 1,
        "kind": "phased",
        "starts": {"a": [0, 0, 5]},
        "phases": [{"name": "go", "goals": {"a": [20, 0, 5]}}],
        "space": {"standing": {"parked": [10, 9, 0]}},
    }
    assert answer(check_request(plan, RULE, LIMITS, SPACE))["certificate"]["certified"]
    other = FlightSpace(standing={"other": (10.0, 1.0, 5.0)})
    (reason,) = answer(check_request(plan, RULE, LIMITS, other))["reasons"]
    assert reason.startswith("a and other come within 1.000 m")
    plan["space"] = {"standing": {"parked": [10, 1, 5]}}
    assert not answer(check_request(plan, RULE, LIMITS, SPACE))["certificate"]["certified"]


@each(
    "plan",
    [
        {},
        {"format": "skygcs-plan", "version": 1, "kind": "timed", "vehicles": {}},
        {"format": "skygcs-plan", "version": 1, "kind": "timed", "vehicles": {"a": [[1, [1e308], [0], [0], None]]}},
        {"format": "skygcs-plan", "version": 1, "kind": "timed", "vehicles": {"a": [["nan", [0], [0], [0], None]]}},
        {"format": "skygcs-plan", "version": 1, "kind": "phased", "starts": {"a": [0, 0, 0]}, "phases": [[]]},
        {"format": "skygcs-plan", "version": 1, "kind": "phased", "starts": [], "phases": 3},
    ],
)
def test_what_is_no_plan_is_refused_with_a_reason(plan: dict[str, Any]) -> None:
    with pytest.raises(SkygcsError) as caught:
        answer(check_request(plan, RULE, LIMITS, SPACE))
    assert isinstance(caught.value, PlanFileError | TrajectoryError)
