"""Orders of one vehicle as actions: <vehicle>/skygcs/goto, takeoff and land.

Each is the daemon's method of that name, with all of its checks. At most one goal of a vehicle is under way: an order
from any client that is accepted later ends the one before as aborted. A cancel holds the vehicle only if its goal is
the newest order. While a newer goal is unanswered nothing is sent: if its order is accepted the goal ends as replaced,
if it is refused the hold is sent. Orders by other doors (a service of ROS, the shell, the page) the daemon knows: it
awaits one that is in progress, and refuses the hold if the vehicle accepts that. A goal whose connection to the daemon
is lost ends at once as aborted; the vehicle flies on by its autopilot then, as with every order.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Mapping
from functools import partial
from typing import Any, NamedTuple

from skygcs.core.ros.action_goals import ABORTED, CANCELED, CANCELING, SUCCEEDED, Goal
from skygcs.core.ros.order_progress import ACTIONS, End, GoalError, Order, OrderProgress, order_params
from skygcs.errors import DaemonUnreachable, RpcError
from skygcs.ext.ros.action_server import ActionServer
from skygcs.ext.ros.graph import Node
from skygcs.ext.ros.order_connection import OrderConnection
from skygcs.ext.ros.vehicle_topics import VehicleTopics

ERROR, INFO = 3, 6
"""MAV_SEVERITY."""

LOST = End(ABORTED, "the connection to the daemon is lost; the vehicle flies on by its autopilot")


class UnderWay(NamedTuple):
    """The goal of a vehicle that is under way."""

    server: ActionServer
    goal: Goal
    progress: OrderProgress
    number: int | None
    """Number of its order at the daemon; None: it has none, as a goto under control."""


class VehicleActions:
    """Actions of one vehicle, from its discovery on. ``gcs()`` returns the connection to the daemon, or None;
    ``takeoff_height_m()`` the fleet file's, or None; ``on_order()`` is called when an order is accepted."""

    def __init__(
        self,
        node: Node,
        vehicle: VehicleTopics,
        gcs: Callable[[], OrderConnection | None],
        takeoff_height_m: Callable[[], float | None],
        on_order: Callable[[], None],
        clock: Callable[[], float],
        unix_ns: Callable[[], int],
    ) -> None:
        self.ended = dict.fromkeys((SUCCEEDED, CANCELED, ABORTED), 0)
        """Goals by how they ended."""
        self._vehicle = vehicle
        self._gcs = gcs
        self._takeoff_height_m = takeoff_height_m
        self._on_order = on_order
        self._clock = clock
        self._unix_ns = unix_ns
        self._under_way: UnderWay | None = None
        self._asked: list[OrderProgress] = []
        """Orders that were sent and are not answered."""
        self._holds: dict[bytes, asyncio.Task[None]] = {}
        """By the id of the goal that is canceling by it."""
        self._expires_at = 0.0
        self.servers = {
            order: ActionServer(
                node,
                f"{vehicle.root}/skygcs/{order}",
                type_,
                partial(self._on_goal, order),
                lambda goal: self._hold_if_due(),
                unix_ns,
                partial(self._log, ERROR),
            )
            for order, type_ in ACTIONS.items()
        }

    # -- what comes from the daemon

    def on_state(self, state: Mapping[str, Any]) -> None:
        """A state of the vehicle."""
        if (under_way := self._under_way) is not None:
            end = under_way.progress.on_state(state, self._clock())
            under_way.server.feed_back(under_way.goal, under_way.progress.feedback())
            self._settle(under_way, end)

    def on_event(self, event: Mapping[str, Any]) -> None:
        """An event of kind command, of any vehicle."""
        for progress in self._asked:
            progress.on_event(event)
        if (under_way := self._under_way) is not None:
            self._settle(under_way, under_way.progress.on_event(event))

    def step(self) -> None:
        """Do what is due; to be called a few times a second."""
        now = self._clock()
        if (under_way := self._under_way) is not None:
            self._settle(under_way, under_way.progress.on_time(now))
        if now >= self._expires_at:
            self._expires_at = now + 10.0
            for server in self.servers.values():
                server.expire(now)

    def lost(self) -> None:
        """The connection to the daemon has ended: the goal that is under way ends at once."""
        for task in self._holds.values():
            task.cancel()
        if (under_way := self._under_way) is not None:
            self._end(under_way, LOST)

    # -- goals

    async def _on_goal(self, order: Order, goal: dict[str, Any]) -> bool:
        try:
            params = order_params(order, goal)
            progress = OrderProgress(order, goal, self._vehicle.state, self._takeoff_height_m())
            outcome = await self._ask(progress, params)
            refusal = None if outcome["ok"] else str(outcome["message"])
        except (GoalError, RpcError, DaemonUnreachable) as error:
            refusal = str(error)
        if refusal is not None:
            self._log(ERROR, f"{order}: goal refused: {refusal}")
            self._hold_if_due()
            return False
        self._begin(order, progress, outcome.get("order_number"))
        return True

    async def _ask(self, progress: OrderProgress, params: dict[str, Any]) -> dict[str, Any]:
        """The outcome of an order at the daemon."""
        self._asked.append(progress)
        try:
            return await self._order(progress.order, **params)
        finally:
            self._asked.remove(progress)

    def _begin(self, order: Order, progress: OrderProgress, number: int | None) -> None:
        self._on_order()
        if (before := self._under_way) is not None:
            self._end(before, End(ABORTED, f"replaced: {order} was ordered"))
        server = self.servers[order]
        under_way = self._under_way = UnderWay(server, server.begin(), progress, number)
        end = progress.accepted(self._clock())
        if self._gcs() is None:
            self._end(under_way, LOST)
        elif end is not None:
            self._end(under_way, end)
        else:
            self._hold_if_due()

    def _hold_if_due(self) -> None:
        """Hold, once for each goal that is canceling, if no newer order was sent: a hold would take its place."""
        under_way = self._under_way
        if under_way is None or under_way.goal.status != CANCELING or self._asked:
            return
        goal = under_way.goal
        if goal.id in self._holds:
            return
        name = f"cancel {under_way.progress.order} of {self._vehicle.name}"
        task = asyncio.create_task(self._hold(under_way), name=name)
        self._holds[goal.id] = task
        task.add_done_callback(lambda _: self._holds.pop(goal.id))

    async def _hold(self, under_way: UnderWay) -> None:
        try:
            newest = {} if under_way.number is None else {"instead_of": under_way.number}
            outcome = await self._order("hold", **newest)
        except (GoalError, RpcError, DaemonUnreachable) as error:
            self._end(under_way, End(ABORTED, f"cancelled, and not held: {error}"))
            return
        if outcome["ok"]:
            self._end(under_way, End(CANCELED, f"cancelled: {outcome['message']}"))
        else:
            self._end(under_way, End(ABORTED, f"cancelled, and not held: {outcome['message']}"))

    def _settle(self, under_way: UnderWay, end: End | None) -> None:
        """A goal that is canceling ends by its hold, and by nothing that the hold brings about."""
        if end is not None and (under_way.goal.status != CANCELING or under_way.goal.id not in self._holds):
            self._end(under_way, end)

    def _end(self, under_way: UnderWay, end: End) -> None:
        if self._under_way is not under_way:
            return
        self._under_way = None
        self.ended[end.status] += 1
        under_way.server.end(under_way.goal, end.status, under_way.progress.result(end), self._clock())
        order = under_way.progress.order
        self._log(INFO if end.status == SUCCEEDED else ERROR, f"{order}: {end.reason}")

    async def _order(self, order: str, **params: Any) -> dict[str, Any]:
        """The vehicle's outcome."""
        gcs = self._gcs()
        if gcs is None:
            raise GoalError("the daemon is not there")
        name = self._vehicle.name
        answer = await gcs.call(f"vehicles.{order}", targets=name, **params)
        outcome: dict[str, Any] = answer["outcomes"][name]
        return outcome

    def _log(self, severity: int, text: str) -> None:
        self._vehicle.log(severity, text, self._unix_ns())

    def status(self) -> str:
        """Status as text for a person; "": no goal is under way."""
        under_way = self._under_way
        return "" if under_way is None else f"{under_way.progress.order} {under_way.progress.distance_m:.1f} m left"

    def counters(self) -> dict[str, int]:
        """Counters since the process began, for /diagnostics."""
        tables = [server.table for server in self.servers.values()]
        return {
            "goals_succeeded": self.ended[SUCCEEDED],
            "goals_canceled": self.ended[CANCELED],
            "goals_aborted": self.ended[ABORTED],
            "goals_refused": sum(table.refused for table in tables),
            "results_forgotten": sum(table.forgotten for table in tables),
            "result_requests_dropped": sum(server.results.overflown for server in self.servers.values()),
        }
