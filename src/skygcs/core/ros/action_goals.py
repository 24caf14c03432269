"""Goals of one action server by the protocol of ROS 2's actions: which are known, their states and results. Pure.

    state         event                                     next
    ---------     ---------------------------------------   -----------------------------------------------------
    asked         its order is refused                      unknown again
    asked         its order is accepted                     executing; canceling, if it was cancelled meanwhile
    executing     a cancel request                          canceling
    executing,    its order has ended                       succeeded, canceled or aborted: with its result
    canceling
    ended         KEPT_S later, or MOST_KEPT newer ones     unknown: its result is forgotten

At most one goal is asked at a time: a further one is refused until that is decided. Ids come from anywhere.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, NamedTuple

from skygcs.core.ros.stamps import time_fields

UNKNOWN, ACCEPTED, EXECUTING, CANCELING, SUCCEEDED, CANCELED, ABORTED = range(7)
"""action_msgs' GoalStatus."""

CANCEL_NONE, CANCEL_REJECTED, CANCEL_UNKNOWN_GOAL, CANCEL_TERMINATED = range(4)
"""Return codes of action_msgs' CancelGoal."""

MOST_KEPT = 64
"""Goals that have ended; the oldest is forgotten for a further one."""

KEPT_S = 900.0
"""From its end until a result is forgotten."""

ID_BYTES = 16
ANY_ID = bytes(ID_BYTES)

Fields = Mapping[str, Any]


@dataclass(slots=True)
class Goal:
    """One goal. ``accepted_ns``: since 1970; ``ended_at``: None while it is under way."""

    id: bytes
    accepted_ns: int
    status: int = EXECUTING
    ended_at: float | None = None
    result: dict[str, Any] = field(default_factory=dict)

    @property
    def info(self) -> dict[str, Any]:
        """action_msgs' GoalInfo."""
        return {"goal_id": {"uuid": list(self.id)}, "stamp": time_fields(self.accepted_ns)}


class CancelAnswer(NamedTuple):
    """The response to a cancel request, and the goals that are canceling by it."""

    code: int
    goals: list[Goal]

    def fields(self) -> dict[str, Any]:
        """action_msgs' CancelGoal_Response."""
        return {"return_code": self.code, "goals_canceling": [goal.info for goal in self.goals]}


class GoalTable:
    """Goals of one action server. At most one is asked, few are under way, MOST_KEPT have ended."""

    def __init__(self) -> None:
        self.goals: dict[bytes, Goal] = {}
        """By id, in the order in which they were accepted."""
        self.refused = 0
        """Goals that were not accepted."""
        self.forgotten = 0
        """Results that were forgotten because MOST_KEPT newer ones were there."""
        self._asked: bytes | None = None
        self._asked_cancelled = False

    # -- goals

    def ask(self, goal_id: bytes) -> str | None:
        """A goal that came; the daemon is asked next. Why it is not to be asked; None: it is, and `accept` or `refuse`
        follows."""
        if goal_id in self.goals or goal_id == self._asked:
            why = "this goal's id is in use"
        elif goal_id == ANY_ID:
            why = "a goal's id of zeros names all goals"
        elif self._asked is not None:
            why = "the goal before it is not decided yet"
        else:
            self._asked, self._asked_cancelled = goal_id, False
            return None
        self.refused += 1
        return why

    def refuse(self) -> None:
        """Reject the requested goal."""
        self._asked = None
        self.refused += 1

    def accept(self, unix_ns: int) -> Goal:
        """The goal that was asked is under way: executing, or canceling if it was cancelled meanwhile."""
        assert self._asked is not None
        goal = Goal(self._asked, unix_ns, CANCELING if self._asked_cancelled else EXECUTING)
        self.goals[goal.id] = goal
        self._asked = None
        return goal

    def end(self, goal: Goal, status: int, result: dict[str, Any], now: float) -> None:
        """A goal that is under way has ended, in this state. Idempotent: the first end counts."""
        if goal.ended_at is not None:
            return
        goal.status, goal.result, goal.ended_at = status, result, now
        ended = [one for one in self.goals.values() if one.ended_at is not None]
        for old in sorted(ended, key=lambda one: one.ended_at or 0.0)[: max(len(ended) - MOST_KEPT, 0)]:
            del self.goals[old.id]
            self.forgotten += 1

    def expire(self, now: float) -> bool:
        """Forget what ended KEPT_S ago. True if anything was forgotten."""
        old = [one.id for one in self.goals.values() if one.ended_at is not None and now - one.ended_at > KEPT_S]
        for goal_id in old:
            del self.goals[goal_id]
        return bool(old)

    # -- requests

    def cancel(self, request: Fields) -> CancelAnswer:
        """A cancel request, by the rules of CancelGoal: an id names one goal, a stamp those accepted until then, both
        either, and neither all. A goal that is still asked is cancelled when it is accepted."""
        info = request["goal_info"]
        goal_id = bytes(info["goal_id"]["uuid"])
        until_ns = info["stamp"]["sec"] * 1_000_000_000 + info["stamp"]["nanosec"]
        everything = goal_id == ANY_ID and until_ns == 0
        if self._asked is not None and (everything or goal_id == self._asked):
            self._asked_cancelled = True
        named = [
            goal
            for goal in self.goals.values()
            if everything or goal.id == goal_id or (until_ns and goal.accepted_ns <= until_ns)
        ]
        going = [goal for goal in named if goal.ended_at is None]
        for goal in going:
            goal.status = CANCELING
        if going or goal_id in (ANY_ID, self._asked):
            return CancelAnswer(CANCEL_NONE, going)
        known = goal_id in self.goals
        return CancelAnswer(CANCEL_TERMINATED if known else CANCEL_UNKNOWN_GOAL, [])

    def result(self, goal_id: bytes) -> dict[str, Any] | None:
        """Status and result of a goal, as GetResult_Response has them; None: it is under way. An unknown goal has the
        status UNKNOWN."""
        goal = self.goals.get(goal_id)
        if goal is None:
            return {"status": UNKNOWN}
        return None if goal.ended_at is None else {"status": goal.status, "result": goal.result}

    def status_list(self) -> dict[str, Any]:
        """action_msgs' GoalStatusArray."""
        return {"status_list": [{"goal_info": goal.info, "status": goal.status} for goal in self.goals.values()]}

    @property
    def under_way(self) -> list[Goal]:
        """Goals that have not ended."""
        return [goal for goal in self.goals.values() if goal.ended_at is None]
