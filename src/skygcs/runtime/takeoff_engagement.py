"""Engages control by itself when a take-off ordered through skygcs has reached its height (engage_after_takeoff)."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Coroutine
from typing import Any

from skygcs.core.protocols.command import Outcome
from skygcs.core.vehicle.takeoff_watch import TakeoffWatch
from skygcs.core.vehicle.vehicle import Vehicle
from skygcs.events import Event
from skygcs.runtime.order_runner import OrderRunner
from skygcs.runtime.task_set import TaskSet

LOOK_S = 0.2


class TakeoffEngagement:
    """Of one vehicle. ``control_mode``: of the fleet file; "off": nothing is ever begun."""

    def __init__(
        self,
        vehicle: Vehicle,
        control_mode: str,
        orders: OrderRunner,
        engage: Callable[[str], Coroutine[Any, Any, Outcome]],
        loop: asyncio.AbstractEventLoop,
        on_event: Callable[[Event], None],
    ) -> None:
        self._vehicle = vehicle
        self._control_mode = control_mode
        self._orders = orders
        self._engage = engage
        self._loop = loop
        self._on_event = on_event
        self._tasks = TaskSet(loop, on_event, vehicle.name, vehicle.sysid)

    def begin(self, outcome: Outcome, from_amsl_m: float | None, height_m: float) -> None:
        """Watch a take-off that has this outcome."""
        if self._control_mode == "off" or not outcome.ok or from_amsl_m is None:
            return
        watch = TakeoffWatch(self._vehicle, from_amsl_m, height_m, self._loop.time())
        self._tasks.start(self._watch(watch, self._orders.number), "control after the take-off")

    def cancel(self) -> None:
        """Watch no more: something else was ordered, or the daemon ends. Idempotent."""
        self._tasks.close()

    async def _watch(self, watch: TakeoffWatch, number: int) -> None:
        while True:
            if self._orders.number != number:
                return  # another order came: what it wants is flown
            verdict = watch.look(self._loop.time())
            if verdict == "reached":
                await self._engage(self._control_mode)
                return
            if verdict != "climbs":
                text = f"control is not engaged after the take-off: {verdict}"
                self._on_event(Event("control", self._vehicle.name, self._vehicle.sysid, text, {"state": "off"}))
                return
            await asyncio.sleep(LOOK_S)
