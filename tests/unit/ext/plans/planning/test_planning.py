"""One request to plan at a time, one of each client, a bounded queue; cancelled with its client or by its number."""

from __future__ import annotations

import asyncio
import json
from dataclasses import asdict
from typing import Any

import pytest

from skygcs.core.plan.fleet_plan import FlightSpace, Phase, PhasedPlan
from skygcs.core.plan.margins import MarginRule, Uncertainty
from skygcs.core.plan.plan_json import plan_from_json
from skygcs.core.trajectory import MotionLimits
from skygcs.errors import PlanFileError, RefusedError, SkygcsError, TrajectoryError
from skygcs.ext.plans.planning.planning_queue import MAX_WAITING, PlanningQueue
from skygcs.ext.plans.planning.process import OnProgress, PlanningFailed, ProcessLimits
from skygcs.ext.plans.planning.request import WrittenPath, check_request, make_request, paths_request
from skygcs.ext.plans.planning.worker import answered
from support.table import each


class Computer:
    """In place of the process: answers when it is let."""

    def __init__(self) -> None:
        self.running: list[bytes] = []
        self.most = 0
        self.ended: list[bytes] = []
        self.go = asyncio.Event()
        self.fails: Exception | None = None

    async def __call__(self, request: bytes, on_progress: OnProgress | None, limits: ProcessLimits) -> bytes:
        self.running.append(request)
        self.most = max(self.most, len(self.running))
        try:
            if on_progress is not None:
                on_progress({"what": "layers", "done": 0, "total": 3})
            await self.go.wait()
            if self.fails is not None:
                raise self.fails
            return request
        finally:
            self.running.remove(request)
            self.ended.append(request)


def queue_of(computer: Computer) -> PlanningQueue:
    return PlanningQueue(asyncio.get_running_loop(), computer)


async def settle() -> None:
    for _ in range(5):
        await asyncio.sleep(0)


async def test_one_is_computed_at_a_time_in_the_order_in_which_they_came() -> None:
    computer = Computer()
    queue = queue_of(computer)
    tasks = [asyncio.create_task(queue.run(client, "make", {"n": client})) for client in range(4)]
    await settle()
    assert [job["state"] for job in queue.status()] == ["running", "waiting", "waiting", "waiting"]
    assert queue.status()[0]["progress"] == {"what": "layers", "done": 0, "total": 3}
    computer.go.set()
    assert await asyncio.gather(*tasks) == [b'{"n":0}', b'{"n":1}', b'{"n":2}', b'{"n":3}']
    assert computer.most == 1 and computer.ended == [b'{"n":0}', b'{"n":1}', b'{"n":2}', b'{"n":3}']
    assert queue.counters.answered == 4 and queue.status() == []


async def test_a_client_has_one_request_and_the_queue_a_bound() -> None:
    computer = Computer()
    queue = queue_of(computer)
    tasks = [asyncio.create_task(queue.run(client, "make", {})) for client in range(MAX_WAITING + 1)]
    await settle()
    with pytest.raises(RefusedError, match="this client has a request"):
        await queue.run(0, "make", {})
    with pytest.raises(RefusedError, match="not finished yet"):
        await queue.run("another", "make", {})
    assert queue.counters.turned_away == 2
    computer.go.set()
    await asyncio.gather(*tasks)
    await queue.run(0, "make", {})


async def test_a_client_that_leaves_ends_its_request_and_the_next_one_begins() -> None:
    computer = Computer()
    queue = queue_of(computer)
    first, second = (asyncio.create_task(queue.run(client, "make", {"n": client})) for client in "ab")
    await settle()
    first.cancel()
    await settle()
    assert first.cancelled() and computer.running == [b'{"n":"b"}']
    computer.go.set()
    assert await second == b'{"n":"b"}' and queue.counters.cancelled == 1


@each("which", ["running", "waiting"])
async def test_a_request_is_cancelled_by_its_client_or_its_number(which: str) -> None:
    computer = Computer()
    queue = queue_of(computer)
    told: list[dict[str, Any]] = []
    first = asyncio.create_task(queue.run("a", "make", {}, told.append))
    second = asyncio.create_task(queue.run("b", "make", {}))
    await settle()
    assert told == [{"job": 1, "what": "layers", "done": 0, "total": 3}]
    assert queue.cancel(client="nobody") == [] and queue.cancel(number=99) == []
    assert (queue.cancel(client="a") if which == "running" else queue.cancel(number=2)) == [
        1 if which == "running" else 2
    ]
    with pytest.raises(RefusedError, match="was cancelled"):
        await (first if which == "running" else second)
    computer.go.set()
    await (second if which == "running" else first)


async def test_a_broken_process_is_counted_and_the_next_request_is_answered() -> None:
    computer = Computer()
    queue = queue_of(computer)
    computer.fails = PlanningFailed("the planning process ended with code 1")
    computer.go.set()
    with pytest.raises(PlanningFailed):
        await queue.run("a", "make", {})
    computer.fails = None
    assert await queue.run("a", "make", {}) == b"{}"
    assert (queue.counters.failed, queue.counters.answered) == (1, 1)


async def test_the_end_of_the_daemon_ends_all() -> None:
    computer = Computer()
    queue = queue_of(computer)
    tasks = [asyncio.create_task(queue.run(client, "make", {})) for client in range(3)]
    await settle()
    queue.close()
    assert all(isinstance(end, RefusedError) for end in await asyncio.gather(*tasks, return_exceptions=True))
    assert computer.running == []


# -- What the planning process answers, without the process.


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
