"""Operator watchdog: when no ground station and no client was active for a time, vehicles that are controlled by
setpoints are ordered to hold, land or return (`core.control.deadman`)."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Mapping
from typing import Any

from skygcs.core.control.deadman import DeadMan, Fired
from skygcs.core.mavlink.frame import Frame
from skygcs.events import Event
from skygcs.links.base import Channel
from skygcs.runtime.fleet import Fleet
from skygcs.runtime.fleet_orders import Order
from skygcs.runtime.task_set import TaskSet
from skygcs.runtime.vehicle_actor import VehicleActor

GCS_TYPE = 6
"""MAV_TYPE_GCS in a HEARTBEAT."""

ACTIONS: Mapping[str, Order] = {"hold": VehicleActor.hold, "land": VehicleActor.land, "rtl": VehicleActor.rtl}
"""The order of each `Fired.action`."""


class OperatorWatchdog:
    """Call `on_client` for every request of an RPC client, `on_heartbeat` for every heartbeat, and `tick` once a
    second."""

    def __init__(
        self, dead_man: DeadMan, fleet: Fleet, loop: asyncio.AbstractEventLoop, on_event: Callable[[Event], None]
    ) -> None:
        self._dead_man = dead_man
        self._fleet = fleet
        self._loop = loop
        self._on_event = on_event
        self._flown: frozenset[str] = frozenset()
        self._tasks = TaskSet(loop, on_event)

    @property
    def watching(self) -> bool:
        return self._dead_man.timeout_s is not None

    def on_client(self) -> None:
        self._dead_man.alive("a client of the socket", self._loop.time())

    def on_frame(self, frame: Frame, channel: Channel, now: float) -> None:
        """A heartbeat from any link; those of a recording do not count."""
        if channel.config.type != "replay":
            self.on_heartbeat(frame, now)

    def on_heartbeat(self, frame: Frame, now: float) -> None:
        """Any HEARTBEAT; only a ground station's counts."""
        if frame.fields().get("type") == GCS_TYPE:
            self._dead_man.alive(f"ground station {frame.sysid}/{frame.compid}", now)

    def tick(self, now: float) -> None:
        """Start the timer when control begins, and act when the silence is too long."""
        if not self.watching:
            return
        flown = frozenset(actor.name for actor in self._fleet.flown())
        if flown - self._flown:
            self._dead_man.begin(now)
        self._flown = flown
        if flown and (fired := self._dead_man.check(now)) is not None:
            self._act(fired, sorted(flown))

    def slept(self, seconds: float) -> None:
        """The computer slept for so long, or this process stood still (0 s): orders of before end."""
        self._tasks.close()
        self._dead_man.slept(seconds)

    def close(self) -> None:
        self._tasks.close()

    def _act(self, fired: Fired, names: list[str]) -> None:
        data = {"action": fired.action, "vehicles": names}
        self._on_event(Event("warning", None, None, f"{fired.reason}: {fired.action} for {', '.join(names)}", data))
        self._tasks.start(self._order(fired, names), f"dead-man {fired.action}")

    async def _order(self, fired: Fired, names: list[str]) -> None:
        # each vehicle reports its outcome as an event; nobody is there for one whose way home does not become clear
        at_end: dict[str, Any] = {"at_end": "land"} if fired.action == "rtl" else {}
        await self._fleet.orders.command_all(names, ACTIONS[fired.action], by_person=False, **at_end)
