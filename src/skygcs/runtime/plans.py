"""The place of the fleet's one plan, light: most daemons never fly one.

no method of plans was called yet    charges are noted, and the status is that no plan is loaded
afterwards                           the rest is the `runner`'s; rpc.plans has imported it beside the loop
"""

from __future__ import annotations

import asyncio
import math
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

from skygcs.core.vehicle.flight_record import FlightRecord
from skygcs.ext.plans.planning.process import PlanningProcesses
from skygcs.runtime.trajectories import Trajectories
from skygcs.runtime.vehicle_actor import VehicleActor
from skygcs.runtime.vehicle_services import OnEvent, VehicleLinks

if TYPE_CHECKING:  # 1 MB with the geometry of plans
    from skygcs.ext.plans.plan_runner import PlanRunner, World

CHARGE_S = 5.0
"""Between two looks at the charges of all vehicles."""


class Plans:
    """Plans of one fleet. ``observers`` are called after each change of `status` that is worth a notification."""

    def __init__(
        self,
        fleet: World,
        trajectories: Trajectories,
        links: VehicleLinks,
        loop: asyncio.AbstractEventLoop,
        on_event: OnEvent,
    ) -> None:
        self.processes = PlanningProcesses()
        self.observers: set[Callable[[], None]] = set()
        self._fleet = fleet
        self._trajectories = trajectories
        self._links = links
        self._loop = loop
        self._on_event = on_event
        self._runner: PlanRunner | None = None
        self._records: dict[int, FlightRecord] = {}
        self.recalled: dict[int, FlightRecord] = {}
        """By key, records of the daemon before, of vehicles that were not heard yet."""
        self._charged_at = -math.inf
        self._ending = False

    @property
    def runner(self) -> PlanRunner:
        """Return what loads, checks and flies a plan; made when it is first asked for."""
        if self._runner is None:
            from skygcs.ext.plans.plan_runner import PlanRunner

            self._runner = PlanRunner(self, self._fleet, self._trajectories, self._links, self._loop, self._on_event)
            if self._ending:
                self._runner.end()
        return self._runner

    @property
    def moving(self) -> bool:
        """True if a flight is under way."""
        return self._runner is not None and self._runner.moving

    def record(self, actor: VehicleActor) -> FlightRecord:
        """Return what is measured of this vehicle's battery in flight."""
        key = actor.vehicle.key
        if key not in self._records:
            self._records[key] = self.recalled.pop(key, FlightRecord())
        return self._records[key]

    def status(self) -> dict[str, Any]:
        """Status as plan.status answers it."""
        nothing: dict[str, Any] = {
            "now_s": round(self._loop.time(), 3),
            "plan": None,
            "name": None,
            "kind": None,
            "state": "none",
            "busy": None,
            "phase": None,
            "step": 0,
            "steps": 0,
            "reason": "",
            "by": None,
            "mode": None,
            "speed": None,
            "clock": None,
            "waits_for": [],
            "pairs": [],
            "vehicles": [],
        }
        return nothing if self._runner is None else nothing | self._runner.status()

    def tick(self, now: float) -> None:
        """Five times a second."""
        if now - self._charged_at >= CHARGE_S:
            self._charged_at = now
            self._note_charges(now)
        if self._runner is not None:
            self._runner.tick()

    async def wind_down(self) -> None:
        """Wind down for the end of the daemon: no vehicle takes off any more, those that stand armed are disarmed.
        Those in the air hold after this."""
        self._ending = True
        if self._runner is not None:
            await self._runner.wind_down()

    def close(self) -> None:
        if self._runner is not None:
            self._runner.close()

    def changed(self) -> None:
        """Notify the observers."""
        for observer in list(self.observers):
            observer()

    def _note_charges(self, now: float) -> None:
        there = self._fleet.everybody()
        for actor in there:
            battery = actor.vehicle.telemetry("battery")
            percent = None if battery is None else battery["percent"]
            self.record(actor).charge(now, percent, in_air=actor.vehicle.armed and actor.vehicle.in_air(now) is True)
        if len(self._records) > len(there):
            keys = {actor.vehicle.key for actor in there}
            self._records = {key: record for key, record in self._records.items() if key in keys}
