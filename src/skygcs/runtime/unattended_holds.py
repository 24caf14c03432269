"""Orders one vehicle to hold that is in the air, follows setpoints, and that nobody flies.

When that is so is decided in `core.vehicle.unattended`; here the watch meets orders, flights elsewhere and the clock.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable

from skygcs.core.mavlink import mav_cmd
from skygcs.core.mavlink.frame import Frame
from skygcs.core.protocols.command import Outcome
from skygcs.core.vehicle.order_plan import Plan
from skygcs.core.vehicle.unattended import OURS, HoldIt, Target, UnattendedWatch, watched
from skygcs.core.vehicle.vehicle import Vehicle
from skygcs.events import Event
from skygcs.runtime.flight_elsewhere import FlightElsewhere
from skygcs.runtime.offboard_engagement import OffboardEngagement
from skygcs.runtime.order_runner import UNHEARD, OrderRunner, Planner
from skygcs.runtime.task_set import OWN, TaskSet

KIND = "unattended"

CARRIED_OUT = frozenset({"goto", "takeoff", "hold", "stop", "release", "mode"})
"""Orders that an autopilot carries out in a mode that follows setpoints."""

POSITION_IGNORE = 0b111
"""Bits of the type_mask of SET_POSITION_TARGET_*: without them the target is a place."""

STATION_ORDERS = frozenset({mav_cmd.DO_SET_MODE, mav_cmd.DO_REPOSITION, mav_cmd.NAV_TAKEOFF})
"""Commands of another station after which a vehicle flies by itself in a mode that follows setpoints."""

STATION_MESSAGES = (
    "SET_ATTITUDE_TARGET",
    "SET_POSITION_TARGET_LOCAL_NED",
    "SET_POSITION_TARGET_GLOBAL_INT",
    "COMMAND_LONG",
    "COMMAND_INT",
    "SET_MODE",
)
"""Messages of other stations that show that they fly a vehicle."""


class UnattendedHolds:
    """The watch over one vehicle: call `tick` a few times a second."""

    def __init__(
        self,
        vehicle: Vehicle,
        offboard: OffboardEngagement | FlightElsewhere,
        orders: OrderRunner,
        plan_hold: Planner,
        loop: asyncio.AbstractEventLoop,
        on_event: Callable[[Event], None],
        *,
        flown_before: str | None = None,
    ) -> None:
        """``plan_hold``: plans the order to hold. ``flown_before``: see `UnattendedWatch`."""
        self.watch = UnattendedWatch(flown_before)
        self._flown_before = flown_before
        self._heard_since: float | None = None
        """When the vehicle was heard first."""
        self._vehicle = vehicle
        self._offboard = offboard
        self._orders = orders
        self._plan_hold = plan_hold
        self._loop = loop
        self._on_event = on_event
        self._tasks = TaskSet(loop, on_event, vehicle.name, vehicle.sysid)
        self._reported: str | None = None
        """The outcome of the last order to hold as it was reported."""
        orders.on_carried_out = self._on_carried_out

    def tick(self, now: float, site: str | None) -> None:
        """Look, and order it to hold if nobody flies it. ``site``: why another site may command it; None: none may."""
        facts = watched(self._vehicle, self._flown_by(now, site), now, ordered=self._orders.ledger.in_progress > 0)
        effect = self.watch.tick(facts, now)
        if effect is None:
            return
        if not isinstance(effect, HoldIt):
            self._publish(f"it holds in {effect.mode}, as it was ordered while it was not heard", {"hold": True})
            return
        if not effect.again:
            self._reported = None
            text = f"nobody flies it in {self._vehicle.mode} ({effect.who} did): it is ordered to hold"
            self._publish(text, {"flown_before": effect.who})
        self._tasks.start(self._hold(), "hold of an unattended vehicle", OWN)

    def on_station(self, frame: Frame, now: float) -> None:
        """A message of another station to it, one of `STATION_MESSAGES`, passed us."""
        target = _target(frame)
        if target is not None:
            self.watch.on_station(f"{frame.sysid}/{frame.compid}", target, now)

    def on_begin(self) -> None:
        """Control by setpoints of this daemon begins. It may end before the next `tick`."""
        self.watch.on_flown(OURS, self._loop.time())

    def on_hold(self, outcome: Outcome) -> None:
        """The outcome of an order to hold that control by setpoints has given at its end."""
        self.watch.on_hold(ok=outcome.ok, unheard=outcome.result in UNHEARD)

    def close(self) -> None:
        self._tasks.close()

    # -- internal

    def _flown_by(self, now: float, site: str | None) -> str | None:
        """The program that flies it now, of those whose flight is known here; None: none does."""
        if site is not None:
            return "the site that may command it"
        if isinstance(self._offboard, OffboardEngagement):
            return OURS if self._offboard.controller.active else None
        flown_by = self._offboard.flown_by(now)
        if flown_by is not None or self._offboard.reported or self._flown_before is None:
            return flown_by
        # a program that flew it before a restart of ours goes on, unless it does not answer in time
        if self._heard_since is None and self._vehicle.connected:
            self._heard_since = now
        since = self._heard_since
        return self._flown_before if since is None or now - since <= self._offboard.silent_after_s else None

    def _on_carried_out(self, plan: Plan) -> None:
        if plan.order in CARRIED_OUT:
            self.watch.on_order(plan.order)

    async def _hold(self) -> None:
        """Order it, and report an outcome that differs from the last one."""
        flown_elsewhere = not isinstance(self._offboard, OffboardEngagement)
        attempt = self._orders.attempt if flown_elsewhere else self._orders.attempt_in_control
        outcome = await attempt(self._plan_hold)
        self.on_hold(outcome)
        if outcome.result == "cancelled" or outcome.message == self._reported:
            return
        self._reported = outcome.message
        text = f"nobody flew it: {outcome.message}"
        if not outcome.ok and outcome.result not in UNHEARD:
            text += "; it is ordered again while nobody flies it, or land it: vehicles.land"
        self._publish(text, {"hold": outcome.ok})

    def _publish(self, text: str, data: dict[str, object]) -> None:
        self._on_event(Event(KIND, self._vehicle.name, self._vehicle.sysid, text, data))


def _target(frame: Frame) -> Target | None:
    """The kind of target that a message of another station gives the vehicle; None: it moves nothing."""
    fields = frame.fields()
    name = "" if frame.info is None else frame.info.name
    if name == "SET_ATTITUDE_TARGET":
        return "motion"
    if name.startswith("SET_POSITION_TARGET"):
        return "motion" if int(fields["type_mask"]) & POSITION_IGNORE else "place"
    if name == "SET_MODE":
        return "place"
    return "place" if fields.get("command") in STATION_ORDERS else None
