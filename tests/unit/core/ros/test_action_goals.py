"""Goals by the protocol of ROS 2's actions: states, cancel rules, bounds; hostile ids and orders of events."""

from __future__ import annotations

import random
from typing import Any

from skygcs.core.ros.action_goals import (
    ABORTED,
    CANCELED,
    CANCELING,
    EXECUTING,
    KEPT_S,
    MOST_KEPT,
    SUCCEEDED,
    UNKNOWN,
    Goal,
    GoalTable,
)
from skygcs.core.ros.interfaces import ros2_interfaces
from support.table import each


def ident(number: int) -> bytes:
    return number.to_bytes(16, "big")


def accepted(table: GoalTable, number: int, at_ns: int = 0) -> Goal:
    assert table.ask(ident(number)) is None
    return table.accept(at_ns or number * 10**9)


def cancel(table: GoalTable, number: int = 0, until_ns: int = 0) -> tuple[int, list[int]]:
    """As it came over the network, and as its answer goes there."""
    known = ros2_interfaces()
    stamp = {"sec": until_ns // 10**9, "nanosec": until_ns % 10**9}
    request = {"goal_info": {"goal_id": {"uuid": list(ident(number))}, "stamp": stamp}}
    name = "action_msgs/srv/CancelGoal"
    answer = table.cancel(known.decode(f"{name}_Request", known.encode(f"{name}_Request", request)))
    read = known.decode(f"{name}_Response", known.encode(f"{name}_Response", answer.fields()))
    ids = [int.from_bytes(bytes(goal["goal_id"]["uuid"]), "big") for goal in read["goals_canceling"]]
    return read["return_code"], ids


def test_a_goal_goes_from_asked_to_its_result() -> None:
    table = GoalTable()
    goal = accepted(table, 1, at_ns=7_000_000_008)
    assert goal.status == EXECUTING and table.result(goal.id) is None
    (row,) = table.status_list()["status_list"]
    assert row["goal_info"]["stamp"] == {"sec": 7, "nanosec": 8} and row["status"] == EXECUTING
    table.end(goal, SUCCEEDED, {"ok": True}, 5.0)
    table.end(goal, ABORTED, {}, 6.0)  # the first end counts
    assert table.result(goal.id) == {"status": SUCCEEDED, "result": {"ok": True}}
    assert not table.under_way
    assert not table.expire(5.0 + KEPT_S)
    assert table.expire(5.1 + KEPT_S)
    assert table.result(goal.id) == {"status": UNKNOWN}


def test_ids_are_used_once_and_one_goal_is_asked_at_a_time() -> None:
    table = GoalTable()
    assert table.ask(ident(1)) is None
    assert table.ask(ident(1)) == "this goal's id is in use"
    assert "not decided" in (table.ask(ident(2)) or "")
    assert "zeros" in (table.ask(ident(0)) or "")
    table.refuse()
    assert table.ask(ident(1)) is None  # it was not accepted: unknown again
    table.end(table.accept(1), ABORTED, {}, 0.0)
    assert table.ask(ident(1)) == "this goal's id is in use"
    assert table.refused == 5


@each(
    ("number", "until_ns", "code", "found"),
    [
        (0, 0, 0, [2, 3]),  # all
        (3, 0, 0, [3]),
        (0, 2_500_000_000, 0, [2]),  # accepted until then
        (3, 2_500_000_000, 0, [2, 3]),
        (1, 0, 3, []),  # terminated
        (9, 0, 2, []),  # unknown
        (9, 2_500_000_000, 0, [2]),
        (0, 1, 0, []),
    ],
)
def test_a_cancel_request_names_goals_by_id_and_stamp(number: int, until_ns: int, code: int, found: list[int]) -> None:
    table = GoalTable()
    ended, second, third = (accepted(table, n) for n in (1, 2, 3))
    table.end(ended, SUCCEEDED, {}, 0.0)
    assert cancel(table, number, until_ns) == (code, found)
    assert [goal.status for goal in (second, third)] == [CANCELING if n in found else EXECUTING for n in (2, 3)]
    assert ended.status == SUCCEEDED


@each("number", [0, 4])
def test_a_goal_that_is_still_asked_is_cancelled_when_it_is_accepted(number: int) -> None:
    table = GoalTable()
    assert table.ask(ident(4)) is None
    assert cancel(table, number) == (0, [])
    assert table.accept(1).status == CANCELING
    assert table.ask(ident(5)) is None
    assert table.accept(1).status == EXECUTING


def test_what_has_ended_is_bounded() -> None:
    table = GoalTable()
    going = accepted(table, 10_000)
    for number in range(1, 1001):
        table.end(accepted(table, number), SUCCEEDED, {}, float(number))
    assert len(table.goals) == MOST_KEPT + 1 and table.forgotten == 1000 - MOST_KEPT
    assert table.result(ident(1000 - MOST_KEPT)) == {"status": UNKNOWN}
    assert table.result(ident(1001 - MOST_KEPT)) == {"status": SUCCEEDED, "result": {}}
    assert table.under_way == [going]
    array = table.status_list()
    assert len(ros2_interfaces().encode("action_msgs/msg/GoalStatusArray", array)) < 4096


def test_no_order_of_events_breaks_a_rule() -> None:
    """Random events: an ended goal stays as it ended, every bound holds, nothing raises."""
    rng = random.Random(1)
    table, asked = GoalTable(), False
    ends: dict[bytes, tuple[int, Any]] = {}
    for now in range(5_000):
        match rng.randrange(6):
            case 0:
                asked = table.ask(ident(rng.randrange(200))) is None or asked
            case 1 if asked:
                asked = False
                table.accept(now)
            case 2 if asked:
                asked = False
                table.refuse()
            case 3 if table.under_way:
                goal = rng.choice(table.under_way)
                status = rng.choice([SUCCEEDED, CANCELED, ABORTED])
                table.end(goal, status, {"reason": str(now)}, float(now))
                ends[goal.id] = (status, {"reason": str(now)})
            case 4:
                cancel(table, rng.randrange(200), rng.choice([0, now]))
            case 5:
                table.expire(float(now))
        for goal in table.goals.values():
            if goal.ended_at is not None:
                assert (goal.status, goal.result) == ends[goal.id]
        assert sum(goal.ended_at is not None for goal in table.goals.values()) <= MOST_KEPT
