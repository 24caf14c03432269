"""What one vehicle can be ordered: it is given orders, carries out their plans and tells how each ended.

Every order answers with one Outcome and never raises for what the vehicle or skygcs refuses. Orders are safe to cancel.
A newer order that moves the vehicle takes the place of an older one that is still in the making: a takeoff that waits
for its arming goes no further once a landing is ordered.
"""

from __future__ import annotations

import contextlib
import math
from collections.abc import Callable, Collection, Coroutine, Mapping, Sequence
from dataclasses import replace
from typing import Any, Unpack

from skygcs.core.control.guard import ControlMode
from skygcs.core.geo import Origin, yaw_enu_from_heading_deg
from skygcs.core.mission.item import MissionType
from skygcs.core.mission.plan import MissionPlan
from skygcs.core.protocols.command import Outcome
from skygcs.core.vehicle import mission_orders, orders, unguarded
from skygcs.core.vehicle import stop as stopping
from skygcs.core.vehicle.frames import setpoint_from_world
from skygcs.core.vehicle.geodetic_position import GeodeticPosition
from skygcs.core.vehicle.order_plan import Plan
from skygcs.core.vehicle.stop import Action
from skygcs.core.vehicle.vehicle import Vehicle
from skygcs.errors import RefusedError
from skygcs.runtime.fence_orders import FenceOutcome
from skygcs.runtime.live_vehicle import LiveVehicle
from skygcs.runtime.origin_push import both, home_at, push_origin
from skygcs.runtime.plan_runner import two_of_one_id


class VehicleActor(LiveVehicle):
    """One vehicle of the fleet and its orders, which are the coroutines."""

    async def arm(self, *, force: bool = False, wait_s: float = 0.0) -> Outcome:
        """With ``wait_s`` it is tried again every second until the vehicle accepts or the time is over, and not before
        an ArduCopter has a position: in STABILIZE it would arm without, and then refuse to take off.

        ``force``: without the autopilot's checks, and without the preflight it may require here.
        """

        def planner(now: float) -> Plan:
            self._require_preflight(force=force)
            return orders.arm(self.vehicle, now, force=force, estimate_msgid=estimate)

        info = self._dialect.by_name.get("EKF_STATUS_REPORT") if wait_s > 0 else None
        estimate = None if info is None else info.msgid
        return await self._orders.retry("arm", planner, wait_s)

    async def disarm(self, *, force: bool = False) -> Outcome:
        """``force`` stops the motors even in the air, and even if the vehicle is lost: emergency priority."""
        return await self._orders.run("disarm", lambda now: orders.disarm(self.vehicle, now, force=force))

    async def set_mode(self, name: str) -> Outcome:
        return await self._orders.run("mode", lambda now: orders.set_mode(self.vehicle, now, name))

    async def takeoff(
        self, height_m: float | None = None, *, arm: bool = True, wait_s: float = 0.0, force: bool = False
    ) -> Outcome:
        """To a height above where it stands; None: the fleet file's takeoff_height_m. Arms first unless told not to.

        ``wait_s`` as for `arm`: an ArduCopter takes neither GUIDED nor arming until it knows where it is. ``force``:
        without the preflight it may require here; the autopilot still checks what it checks.
        """
        height = self.config.takeoff_height_m if height_m is None else height_m

        def planner(now: float) -> Plan:
            self._require_preflight(force=force)
            return orders.takeoff(self.vehicle, now, height, arm=arm)

        return await self._orders.retry("takeoff", planner, wait_s)

    async def land(self) -> Outcome:
        return await self._orders.run("land", lambda now: orders.land(self.vehicle, now))

    async def rtl(self) -> Outcome:
        return await self._orders.run("rtl", lambda now: orders.rtl(self.vehicle, now))

    async def hold(self) -> Outcome:
        return await self._orders.run("hold", lambda now: orders.hold(self.vehicle, now))

    async def stop(self, action: Action) -> Outcome:
        """Emergency stop; see `core.vehicle.stop`. A kill is to be confirmed by whoever calls (`Fleet.command_all`)."""
        return await self._orders.run("stop", lambda now: stopping.stop(self.vehicle, now, action))

    async def goto(self, **where: Unpack[orders.Where]) -> Outcome:
        """See `orders.destination`. While it is flown by setpoints it is their reference that goes there."""
        limit_m = self.config.goto_limit_m
        if not self.flight.flying:
            return await self._orders.run("goto", lambda now: orders.goto(self.vehicle, now, limit_m=limit_m, **where))
        try:
            to = orders.destination(self.vehicle, self._loop.time(), limit_m=limit_m, **where)
        except RefusedError as error:
            return self._orders.told("goto", Outcome.refused(str(error)))
        yaw = None if to.yaw_deg is None else math.radians(yaw_enu_from_heading_deg(to.yaw_deg))
        return self._orders.told(
            "goto", self.flight.fly_to(GeodeticPosition(to.lat_deg, to.lon_deg, to.alt_amsl_m), yaw)
        )

    async def reboot(self, *, force: bool = False) -> Outcome:
        return await self._orders.run("reboot", lambda now: orders.reboot(self.vehicle, now, force=force))

    async def set_home(
        self,
        *,
        lat_deg: float | None = None,
        lon_deg: float | None = None,
        alt_amsl_m: float | None = None,
        force: bool = False,
    ) -> Outcome:
        """Without arguments: where it is now. In the air, or farther than goto_limit_m, only with ``force``."""
        return await self._orders.run(
            "home",
            lambda now: orders.set_home(
                self.vehicle,
                now,
                lat_deg=lat_deg,
                lon_deg=lon_deg,
                alt_amsl_m=alt_amsl_m,
                limit_m=self.config.goto_limit_m,
                force=force,
            ),
        )

    async def push_origin(self, origin: Origin, *, home: bool = False, force: bool = False) -> Outcome:
        """Tell the vehicle the origin, and with ``home`` make it its home. Armed only with ``force``."""
        return await self._orders.carry("origin", self._push_origin(origin, home, force))

    async def _push_origin(self, origin: Origin, home: bool, force: bool) -> Outcome:
        told = await push_origin(self._orders.attempt, self.vehicle, self._dialect, origin, force=force)
        if not home or told.result == "refused":
            return told
        limit_m = self.config.goto_limit_m
        return both(told, await self._orders.attempt(home_at(self.vehicle, origin, limit_m=limit_m, force=force)))

    async def set_message_interval(self, message: str | int, rate_hz: float | None) -> Outcome:
        """0 turns it off, None goes back to the vehicle's own rate. From then on the rate is the caller's to keep."""
        with contextlib.suppress(RefusedError):
            name = orders.find_message(self._dialect, message)[1]
            self.streams.leave(name)
        return await self._orders.run(
            "interval", lambda now: orders.message_interval(self.vehicle, now, self._dialect, message, rate_hz)
        )

    async def request_message(self, message: str | int) -> Outcome:
        """Ask for one message; the outcome is ok once it has come (read it with `latest`)."""
        return await self._orders.run(
            "request", lambda now: orders.request_message(self.vehicle, now, self._dialect, message)
        )

    async def request_stream(self, stream: int | str, rate_hz: float) -> Outcome:
        """REQUEST_DATA_STREAM, the old way; nothing acknowledges it."""
        return await self._orders.run(
            "stream", lambda now: orders.request_stream(self.vehicle, now, self._dialect, stream, rate_hz)
        )

    async def command(
        self,
        command: str | int,
        params: Sequence[float | None] = (),
        *,
        int_frame: int | str | None = None,
        x: int | None = None,
        y: int | None = None,
        z: float | None = None,
        force: bool = False,
    ) -> Outcome:
        """Any command; see `orders.command_plan`. One that passes the checks of an order only with ``force``."""
        return await self._orders.run(
            "command",
            lambda now: unguarded.command(
                self.vehicle, now, self._dialect, command, params, force=force, int_frame=int_frame, x=x, y=y, z=z
            ),
        )

    async def upload_plan(self, *, plan: MissionPlan, kinds: Collection[MissionType], force: bool = False) -> Outcome:
        """See `Missions.bring`."""
        work = self.missions.bring(plan, kinds, limit_m=self.config.goto_limit_m, force=force)
        return await self._orders.carry("plan upload", work)

    async def clear_plan(self, *, kinds: Collection[MissionType], force: bool = False) -> Outcome:
        """See `Missions.drop`."""
        return await self._orders.carry("plan clear", self.missions.drop(kinds, force=force))

    async def download_plan(self, kinds: Collection[MissionType]) -> tuple[Outcome, MissionPlan]:
        """See `Missions.fetch`."""
        outcome, plan = await self.missions.fetch(kinds)
        return self._orders.told("plan download", outcome), plan

    async def set_fence(
        self, *, radius_m: float | None = None, height_m: float | None = None, action: str | None = None
    ) -> FenceOutcome:
        """See `VehicleFence.set`."""
        return await self._told_fence(
            "fence", lambda: self.fence.set(radius_m=radius_m, height_m=height_m, action=action)
        )

    async def read_fence(self) -> FenceOutcome:
        """See `VehicleFence.status`."""
        return await self.fence.status()

    async def test_fence(self, *, radius_m: float, action: str, timeout_s: float) -> FenceOutcome:
        """See `VehicleFence.test`."""
        return await self._told_fence(
            "fence test", lambda: self.fence.test(radius_m=radius_m, action=action, timeout_s=timeout_s)
        )

    async def _told_fence(self, order: str, work: Callable[[], Coroutine[Any, Any, FenceOutcome]]) -> FenceOutcome:
        """Tell of it like of any order; a cancelled test has told of itself."""
        if self.duplicate:
            return FenceOutcome(self._orders.told(order, two_of_one_id(self.vehicle)))
        outcome = await work()
        self._orders.told(order, outcome.outcome)
        return outcome

    async def start_mission(self, *, first: int = 1, arm: bool = True, force: bool = False) -> Outcome:
        """See `mission_orders.start`; ``force`` as for `takeoff`."""

        def planner(now: float) -> Plan:
            self._require_preflight(force=force)
            return mission_orders.start(self.vehicle, now, first=first, arm=arm)

        return await self._orders.run("mission", planner)

    async def resume_mission(self) -> Outcome:
        """Go on with the current item; pausing is `hold`."""
        return await self._orders.run("mission", lambda now: mission_orders.resume(self.vehicle, now))

    async def set_mission_item(self, *, item: int) -> Outcome:
        """Make it the current item, from 1."""
        return await self._orders.run("mission item", lambda now: mission_orders.set_current(self.vehicle, now, item))

    async def control(self, mode: str, *, force: bool = False) -> Outcome:
        """Fly it by setpoints: "position", "velocity" or "attitude"; "off": no more, and hold."""
        if mode != "off":
            work = self.flight.engage(ControlMode(mode), force=force)
            return await self._orders.carry("control", work)
        if not self.flight.pilot.active:
            self.flight.release("switched off")
            return self._orders.told("control", Outcome(True, "accepted", "control is off"))
        self.flight.release("switched off")
        return await self._orders.carry("control", self._switched_off())

    async def change_gains(self, *, changes: Mapping[str, Any], force: bool = False) -> Outcome:
        """See `FlightControl.change_gains`."""
        return self._orders.told("gains", self.flight.change_gains(changes, force=force))

    def setpoint(
        self,
        *,
        pos_enu_m: Sequence[float | None] | None = None,
        vel_enu_mps: Sequence[float | None] | None = None,
        acc_enu_mps2: Sequence[float] | None = None,
        yaw_deg: float | None = None,
        valid_s: float = 0.5,
    ) -> Outcome:
        """One setpoint of a stream in the fleet's world frame; made to be called 50 times a second."""
        origin = self.vehicle.origin
        if origin is None:
            return Outcome.refused("the fleet has no origin yet, so ENU means nothing")
        try:
            wanted = setpoint_from_world(origin, pos_enu_m, vel_enu_mps, acc_enu_mps2, yaw_deg)
        except RefusedError as error:
            return Outcome.refused(str(error))
        return self.flight.follow(wanted, valid_s)

    def record_control(self, on: bool) -> str | None:
        """See `FlightControl.record`."""
        path = self.flight.record(on)
        return None if path is None else str(path)

    def gains(self) -> dict[str, Any]:
        """Gains and limits of its control law."""
        return self.flight.gains()

    def plan(self, planner: Callable[[Vehicle, float], Plan]) -> Plan | None:
        """What `orders.land` or `orders.rtl` would do now; None if it would be refused."""
        if self.duplicate:
            return None
        try:
            return planner(self.vehicle, self._loop.time())
        except RefusedError:
            return None

    def refuse(self, order: str, reason: str) -> Outcome:
        """Refuse an order for a reason the fleet knows."""
        return self._orders.told(order, Outcome.refused(reason))

    def _require_preflight(self, *, force: bool) -> None:
        """Raises RefusedError if it must not be armed now."""
        reason = self.preflight.refusal(force=force)
        if reason is not None:
            raise RefusedError(reason)

    async def _switched_off(self) -> Outcome:
        outcome = await self._orders.attempt(lambda now: orders.hold(self.vehicle, now))
        return replace(outcome, message=f"control is off; {outcome.message}")
