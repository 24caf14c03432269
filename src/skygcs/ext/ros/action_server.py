"""One action server: the services and topics by which ROS 2 carries an action, about a table of goals.

<name>/_action/send_goal      answered when the order is decided
<name>/_action/cancel_goal    answered at once
<name>/_action/get_result     answered when the goal has ended: MOST_WAITING requests wait, further ones are dropped
                              and counted; they are no part of the limit of any other service
<name>/_action/feedback       reliable, the last 10
<name>/_action/status         reliable, the newest list, also for readers that come later
"""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable, Mapping
from typing import Any

from skygcs.core.ros.action_goals import Goal, GoalTable
from skygcs.core.ros.stamps import time_fields
from skygcs.ext.ros.graph import Node

MOST_WAITING = 64
"""Requests for results of one action that wait at the same time."""

MOST_SENT = 8
"""Goals of one action that are answered at the same time: all but one are refused at once."""

OnGoal = Callable[[dict[str, Any]], Awaitable[bool]]
"""Gives the order of a goal's own fields; True: it is accepted, and ``begin`` was called for it."""


class ActionServer:
    """One action of one vehicle. ``on_goal(fields)`` gives its order; ``on_cancel(goal)`` is called once for each goal
    that is canceling from then on; ``log(text)`` is for people."""

    def __init__(
        self,
        node: Node,
        name: str,
        type_: str,
        on_goal: OnGoal,
        on_cancel: Callable[[Goal], None],
        unix_ns: Callable[[], int],
        log: Callable[[str], None],
    ) -> None:
        self.name = name
        self.table = GoalTable()
        self._on_goal = on_goal
        self._on_cancel = on_cancel
        self._unix_ns = unix_ns
        self._log = log
        self._ended: dict[bytes, asyncio.Event] = {}
        base = f"{name}/_action"
        self._feedback = node.publish(f"{base}/feedback", f"{type_}_FeedbackMessage", "default")
        self._status = node.publish(f"{base}/status", "action_msgs/msg/GoalStatusArray", "newest")
        node.serve(f"{base}/send_goal", f"{type_}_SendGoal", self._send_goal, MOST_SENT)
        node.serve(f"{base}/cancel_goal", "action_msgs/srv/CancelGoal", self._cancel_goal)
        self.results = node.serve(f"{base}/get_result", f"{type_}_GetResult", self._get_result, MOST_WAITING)
        self._show()

    # -- for its owner

    def begin(self) -> Goal:
        """The order of the goal that was asked is accepted."""
        goal = self.table.accept(self._unix_ns())
        self._ended[goal.id] = asyncio.Event()
        self._show()
        return goal

    def feed_back(self, goal: Goal, fields: Mapping[str, Any]) -> None:
        """Publish how far a goal is."""
        if self._feedback.wanted:
            self._feedback.write({"goal_id": {"uuid": list(goal.id)}, "feedback": fields})

    def end(self, goal: Goal, status: int, result: dict[str, Any], now: float) -> None:
        """A goal has ended: answer those that wait for its result. Idempotent: the first end counts."""
        if goal.ended_at is not None:
            return
        self.table.end(goal, status, result, now)
        self._ended.pop(goal.id).set()
        self._show()

    def expire(self, now: float) -> None:
        """Forget old results; to be called now and then."""
        if self.table.expire(now):
            self._show()

    # -- requests

    async def _send_goal(self, request: dict[str, Any]) -> dict[str, Any]:
        why = self.table.ask(bytes(request["goal_id"]["uuid"]))
        if why is not None:
            self._log(f"{self.name}: goal refused: {why}")
            return {"accepted": False, "stamp": time_fields(self._unix_ns())}
        accepted = False
        try:
            accepted = await self._on_goal(request["goal"])
        finally:
            if not accepted:
                self.table.refuse()
        return {"accepted": accepted, "stamp": time_fields(self._unix_ns())}

    async def _cancel_goal(self, request: dict[str, Any]) -> dict[str, Any]:
        answer = self.table.cancel(request)
        if answer.goals:
            self._show()
        for goal in answer.goals:
            self._on_cancel(goal)
        return answer.fields()

    async def _get_result(self, request: dict[str, Any]) -> dict[str, Any]:
        goal_id = bytes(request["goal_id"]["uuid"])
        ended = self._ended.get(goal_id)
        if ended is not None:
            await ended.wait()
        return self.table.result(goal_id) or {"status": 0}

    def _show(self) -> None:
        self._status.write(self.table.status_list())
