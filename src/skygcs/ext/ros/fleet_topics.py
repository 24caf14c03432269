"""The fleet as topics: /skygcs/fleet, /skygcs/events, /skygcs/plan and /skygcs/markers.

    topic      quality of service                        published
    -------    ---------------------------------------   ------------------------------------------------------
    fleet      reliable, the last 10                     FLEET_HZ times a second, and once when the daemon is lost
    events     reliable, the last 100 for late readers   each as it comes
    plan       reliable, the last one for late readers   after each change, and twice a second while it is flown
    markers    reliable, the last 10                     FLEET_HZ times a second

A reader of events that comes later gets the last 100, with their stamps: what failed before it began is often why it
began.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Iterable, Mapping
from typing import Any

import structlog

from skygcs.core.ros import fleet_markers, fleet_messages
from skygcs.core.ros.fleet_markers import Line, Trails, Turns
from skygcs.core.ros.interfaces import InterfaceError
from skygcs.errors import RpcError
from skygcs.ext.ros.graph import Node, PublicationPort
from skygcs.rpc.client import Client

FLEET_HZ = 2.0

PATHS_S = 2.0
"""Between two looks at the paths of trajectories, while somebody reads markers."""

ROOT = "/skygcs"

_log = structlog.get_logger(__name__)

State = Mapping[str, Any]


class FleetTopics:
    """The topics of the fleet. ``vehicles()``: each vehicle's state and namespace, as the daemon sent it last.

    Its coroutines run with each connection to the daemon; `lost` at its end.
    """

    def __init__(
        self, node: Node, vehicles: Callable[[], Iterable[tuple[State, str]]], unix_ns: Callable[[], int]
    ) -> None:
        self.fleet = node.publish(f"{ROOT}/fleet", "skygcs_msgs/msg/Fleet", "default")
        self.events = node.publish(f"{ROOT}/events", "skygcs_msgs/msg/Event", "events")
        self.plan = node.publish(f"{ROOT}/plan", "skygcs_msgs/msg/Plan", "newest")
        self.markers = node.publish(f"{ROOT}/markers", "visualization_msgs/msg/MarkerArray", "default")
        self.faults = 0
        """Messages that could not be made of what the daemon sent."""
        self.trails = Trails()
        self.has_origin = False
        self.fences: Mapping[str, Mapping[str, Any]] = {}
        """Box of flight control of each vehicle, by name (ros.settings)."""
        self._vehicles = vehicles
        self._unix_ns = unix_ns
        self._plan: Mapping[str, Any] = {}
        self._turns = Turns()
        self._paths: list[Line] = []
        self._paths_before: list[Line] = []
        """Paths that are still in the display."""
        self._paths_key: str | None = None

    async def follow_events(self, gcs: Client) -> None:
        """Publish events until the connection ends. Raises DaemonUnreachable."""
        async for event in gcs.events():
            self.on_event(event)

    async def follow_plan(self, gcs: Client) -> None:
        """Publish the plan's state until the connection ends. Raises DaemonUnreachable."""
        async for status in gcs.plan():
            self.on_plan(status)

    async def publish_states(self, gcs: Client) -> None:
        """Publish states and markers until the connection ends. Raises DaemonUnreachable."""
        loop = asyncio.get_running_loop()
        look_at = loop.time()
        while True:
            if self.markers.wanted and loop.time() >= look_at:
                look_at = loop.time() + PATHS_S
                await self._look_at_paths(gcs)
            self.publish_now()
            await asyncio.sleep(1 / FLEET_HZ)

    def on_event(self, event: Mapping[str, Any]) -> None:
        """An event of the daemon."""
        self._write(self.events, lambda: fleet_messages.event(event))

    def on_plan(self, status: Mapping[str, Any]) -> None:
        """The plan's status."""
        self._plan = status
        self._write(self.plan, lambda: fleet_messages.plan(status, self._unix_ns()))

    def publish_now(self) -> None:
        """The fleet and its markers, as far as somebody reads them; trails grow in any case."""
        now_ns, vehicles = self._unix_ns(), list(self._vehicles())
        for state, _ in vehicles:
            place = fleet_markers.place_of(state)
            if place is not None:
                self.trails.add(state["name"], place)
        self._write(self.fleet, lambda: fleet_messages.fleet(vehicles, self.has_origin, True, now_ns))
        self._write(self.markers, lambda: {"markers": self._markers([state for state, _ in vehicles], now_ns)})

    def lost(self) -> None:
        """The connection to the daemon has ended: nothing is known of any vehicle, nor of the plan."""
        now_ns = self._unix_ns()
        self._write(self.fleet, lambda: fleet_messages.fleet(self._vehicles(), self.has_origin, False, now_ns))
        self._write(self.plan, lambda: fleet_messages.plan({"state": "unknown"}, now_ns))
        self._plan, self._paths_key = {}, None
        self._take_paths([])

    async def _look_at_paths(self, gcs: Client) -> None:
        try:
            answer = await gcs.call("trajectory.paths", known=self._paths_key)
        except RpcError:  # there is no vehicle yet
            return
        self._paths_key = answer["key"]
        if answer["paths"] is not None:
            self._take_paths(fleet_markers.path_lines(answer["paths"]))

    def _take_paths(self, paths: list[Line]) -> None:
        self._paths_before = self._paths[len(paths) :]  # the others are drawn over
        self._paths = paths

    def _markers(self, states: list[State], now_ns: int) -> list[dict[str, Any]]:
        gone, self._paths_before = self._paths_before, []
        lines = [*self._paths, *fleet_markers.trail_lines(states, self.trails)]
        return [
            *fleet_markers.deleted(gone, now_ns),
            *fleet_markers.vehicle_markers(self._turns.vehicles(states), now_ns),
            *fleet_markers.fence_markers(self.fences.values() if self.has_origin else (), now_ns),
            *fleet_markers.goal_markers(self._plan, now_ns),
            *self._turns.lines(lines, now_ns),
        ]

    def _write(self, publication: PublicationPort, made: Callable[[], dict[str, Any]]) -> None:
        if not publication.wanted:
            return
        try:
            publication.write(made())
        except (InterfaceError, KeyError, TypeError, ValueError, AttributeError, OverflowError) as error:
            self.faults += 1
            if self.faults == 1:
                _log.warning("a topic of the fleet was not published", topic=publication.name, error=str(error))
