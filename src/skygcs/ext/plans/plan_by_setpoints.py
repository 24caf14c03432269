"""A plan's flight guided by setpoints: each step is trajectories on one clock, followed under control."""

from __future__ import annotations

import asyncio
import contextlib
from typing import TYPE_CHECKING, Any

from skygcs.core.protocols.command import Outcome
from skygcs.core.trajectory import ClockState
from skygcs.core.vehicle.frames import GeodeticPosition
from skygcs.core.vehicle.offboard_controller import OffboardState
from skygcs.core.vehicle.trajectory_flight import StartTube
from skygcs.errors import RefusedError
from skygcs.ext.plans.flight.execution import FAR, START_LEAD_S
from skygcs.ext.plans.flight.guidance import Guidance
from skygcs.ext.plans.flight.sights import Departure, DepartureCause
from skygcs.runtime.trajectories import Trajectories, TrajectoryGroup
from skygcs.runtime.vehicle_actor import VehicleActor

if TYPE_CHECKING:
    from skygcs.ext.plans.plan_flight import PlanFlight


class SetpointGuidance:
    """See `plan_flight.FlightGuidance`. Of one flight."""

    def __init__(
        self, trajectories: Trajectories, loop: asyncio.AbstractEventLoop, by: Guidance = Guidance.SETPOINTS
    ) -> None:
        self.by = by
        self._trajectories = trajectories
        self._loop = loop
        self._group: TrajectoryGroup | None = None
        """Trajectories of the step under way."""

    def clock(self, now: float) -> tuple[ClockState | None, float]:
        if self._group is None:
            return None, 0.0
        time = self._group.clock.at(now)
        return time.state, time.trajectory_s

    def status(self, now: float) -> dict[str, Any] | None:
        if self._group is None:
            return None
        clock = self._group.clock
        time, finishes = clock.at(now), clock.finishes_at_s(now)
        return {
            "state": time.state.value,
            "trajectory_s": round(time.trajectory_s, 3),
            "duration_s": round(clock.duration_s, 3),
            "rate": round(time.rate, 3),
            "speed_factor": clock.speed_factor,
            "finishes_in_s": None if finishes is None else round(max(0.0, finishes - now), 3),
        }

    def left(self, flight: PlanFlight, name: str, actor: VehicleActor) -> Departure | None:
        controller = actor.offboard.controller
        if (successor := actor.offboard.successor) is not None:
            return Departure(_why(successor), successor)
        why = "; ".join(controller.reasons)
        if controller.state is OffboardState.HELD:
            return Departure(DepartureCause.GUARD, f"the guard holds it: {why}")
        if controller.state is not OffboardState.FLYING:
            return Departure(_why(why), why or f"control is {controller.state.value}")
        if self._group is not None and name in self._group.left:
            if (ordered := self._group.ordered_otherwise(actor)) is not None:
                return Departure(DepartureCause.ORDER, ordered)
            return Departure(
                DepartureCause.GUARD,
                why or "it does not follow its trajectory any more: its reference led out of the fence",
            )
        return None

    async def engage(self, flight: PlanFlight, name: str, actor: VehicleActor) -> Outcome:
        """Under control, and to where its first step begins."""
        settings = flight.settings
        if not (actor.offboard.flying and actor.offboard.controller.wanted.value == settings.control_mode):
            outcome = await actor.control(settings.control_mode, force=settings.force)
            if not outcome.ok:
                return outcome
        # it may have been moved meanwhile: the way from there to its start is not certified
        if (why := flight.why_displaced(name, self._loop.time())) is not None:
            return Outcome.refused(f"{why}: it is not sent to its start")
        lat_deg, lon_deg, alt_m = flight.frame.to_geodetic(*flight.execution.step.starts()[name])
        outcome = await actor.offboard.fly_to(GeodeticPosition(lat_deg, lon_deg, alt_m), None)
        if outcome.ok:
            actor.runner.precedence.note_effect()
        return outcome

    def fly(self, flight: PlanFlight) -> str | None:
        """Start the step under way on one clock."""
        now, settings = self._loop.time(), flight.settings
        execution = flight.execution
        loaded, tubes = flight.loaded[execution.index], execution.tubes
        chosen = {flight.actors[name]: one for name, one in loaded.items() if name in flight.actors}
        lead_s = max(START_LEAD_S, self._trajectories.lead_s(chosen))
        allowed = {name: StartTube(FAR * tube_m, tubes.downwash_ratio) for name, tube_m in tubes.free_m.items()}
        begun = self._trajectories.begin(chosen, now + lead_s, settings.speed_factor, flight.lock, allowed)
        if isinstance(begun, TrajectoryGroup):
            self._group = begun
            return None
        self._group = None
        why = "; ".join(f"{actor.name}: {text}" for actor, text in list(begun.items())[:3])
        return f"{execution.step.name} does not start: {why}"

    def look(self, flight: PlanFlight, now: float) -> None:
        """The group has its own ticks."""

    def set_speed(self, speed_factor: float) -> bool:
        if self._group is None:
            return False
        self._group.clock.set_speed(self._loop.time(), speed_factor)
        return True

    def stop(self, flight: PlanFlight) -> None:
        if self._group is not None:
            with contextlib.suppress(RefusedError):  # it stands already
                self._group.clock.pause(self._loop.time())

    def go_on(self, flight: PlanFlight) -> None:
        if self._group is not None:
            with contextlib.suppress(RefusedError):  # it runs already
                self._group.clock.resume(self._loop.time())

    def end(self, flight: PlanFlight) -> None:
        if self._group is not None:
            with contextlib.suppress(RefusedError):  # it has ended already
                self._group.clock.abort(self._loop.time())


def _why(text: str) -> DepartureCause:
    """The kind of reason for which control ended."""
    return DepartureCause.ORDER if "was ordered" in text or "switched off" in text else DepartureCause.PILOT
