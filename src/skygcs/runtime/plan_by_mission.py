"""A plan's flight guided by missions: each vehicle has its whole way on board, and flies it without the ground.

An order begins a mission, or goes on with it; what is decided is decided in `core.plan.goto_legs`, for which the whole
way is one leg.
"""

from __future__ import annotations

import asyncio
from typing import TYPE_CHECKING

from skygcs.core.mission.item import MissionType
from skygcs.core.plan.guidance import Guidance
from skygcs.core.plan.own_missions import mission_along
from skygcs.core.protocols.command import Outcome
from skygcs.core.trajectory.piecewise import Vector
from skygcs.core.vehicle.mission_orders import MISSION_MODES
from skygcs.runtime.plan_by_goto import STANDS_IN, GotoGuidance, Start
from skygcs.runtime.separation_monitor import SeparationMonitor
from skygcs.runtime.vehicle_actor import VehicleActor

if TYPE_CHECKING:
    from skygcs.runtime.plan_flight import PlanFlight


class MissionGuidance(GotoGuidance):
    """See `plan_flight.FlightGuidance`. Of one flight."""

    by = Guidance.MISSION

    def __init__(self, monitor: SeparationMonitor | None, loop: asyncio.AbstractEventLoop, start: Start) -> None:
        super().__init__(monitor, loop, start)
        self._begun: set[str] = set()
        """Vehicles that fly their mission, or have."""

    async def engage(self, flight: PlanFlight, name: str, actor: VehicleActor) -> Outcome:
        """To where its way begins; there it gets its mission."""
        outcome = await super().engage(flight, name, actor)
        if not outcome.ok:
            return outcome
        step = flight.execution.step
        places = step.corners.get(name) or (step.starts()[name],)
        mission = mission_along([flight.frame.to_geodetic(*place) for place in places])
        return await self._ours(name, actor, actor.upload_plan(plan=mission, kinds=(MissionType.MISSION,)))

    def _goals(self, flight: PlanFlight) -> dict[str, Vector]:
        """Also of those that stay where they are: on a mission their firmware takes no notice of a lost ground."""
        return flight.execution.step.places()

    def _modes(self, name: str) -> frozenset[str]:
        """Until it has accepted, it holds as it was left."""
        flies = self._legs is not None and self._legs.flies(name)
        return MISSION_MODES if flies else MISSION_MODES | STANDS_IN

    async def _order(self, flight: PlanFlight, name: str, place_m: Vector) -> Outcome:
        """From the first item on; what has begun goes on where it is."""
        actor = flight.actors[name]
        if name in self._begun:
            return await self._ours(name, actor, actor.resume_mission())
        order = actor.start_mission(arm=False, force=flight.settings.force)
        outcome = await self._ours(name, actor, order)
        if outcome.ok or actor.vehicle.mode in MISSION_MODES:
            self._begun.add(name)
        return outcome
