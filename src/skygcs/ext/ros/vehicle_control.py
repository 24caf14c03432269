"""Control of one vehicle by nodes: setpoints, services, OFFBOARD by them, and actions, as [ros] allows it."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Coroutine, Mapping
from typing import Any

from skygcs.core.ros.fleet_origin import FleetOrigin
from skygcs.core.ros.interfaces import Interfaces
from skygcs.errors import DaemonUnreachable, RpcError
from skygcs.ext.ros.config import RosConfig
from skygcs.ext.ros.graph import Node
from skygcs.ext.ros.offboard import Engage, TakeOff
from skygcs.ext.ros.order_connection import OrderConnection
from skygcs.ext.ros.px4_control import Px4Commands, Px4Setpoints
from skygcs.ext.ros.px4_topics import Px4Topics
from skygcs.ext.ros.setpoint_stream import SetpointStream
from skygcs.ext.ros.vehicle_actions import VehicleActions
from skygcs.ext.ros.vehicle_services import VehicleServices
from skygcs.ext.ros.vehicle_topics import VehicleTopics

EVENTS = ("command", "reboot")
"""Kinds of events that control by nodes follows."""

ERROR, INFO = 3, 6
"""MAV_SEVERITY."""


class VehicleControl:
    """Control of a vehicle, from its discovery on. `on_state` with each of its states, `step` a few times a second."""

    def __init__(
        self,
        node: Node,
        config: RosConfig,
        vehicle: VehicleTopics,
        gcs: Callable[[], OrderConnection | None],
        origin: Callable[[], FleetOrigin | None],
        unix_ns: Callable[[], int],
        takeoff_height_m: Callable[[], float | None],
    ) -> None:
        clock = asyncio.get_running_loop().time
        self.stream = SetpointStream(node, vehicle, gcs, origin, clock, unix_ns)
        self._vehicle = vehicle
        self._gcs = gcs
        self._clock = clock
        self._unix_ns = unix_ns
        self._tasks: set[asyncio.Task[None]] = set()
        self._asks_origin_at = 0.0
        self._node = node
        self._services: VehicleServices | None = None
        self._px4_commands: Px4Commands | None = None
        self.actions: VehicleActions | None = None
        if config.commands == "all":
            ros1 = config.version == 1
            self._services = VehicleServices(node, vehicle, self.stream.offboard, gcs, clock, unix_ns, ros1)
            if not ros1:  # ROS 1 has actions of another kind
                end = self._end_offboard
                self.actions = VehicleActions(node, vehicle, gcs, takeoff_height_m, end, clock, unix_ns)

    def add_px4(self, known: Interfaces, px4: Px4Topics) -> None:
        """Take setpoints, and commands if services are allowed, from PX4's own topics as well."""
        root = self._vehicle.root
        Px4Setpoints(self._node, known, root, self.stream, self._clock)
        if self._services is not None:

            def boot_us() -> int:
                return px4.memory.clock.boot_us(self._unix_ns())

            sysid = self._vehicle.sysid
            self._px4_commands = Px4Commands(
                self._node, known, root, sysid, self._services, boot_us, self._log, self._clock
            )

    @property
    def commands_rejected(self) -> int:
        """Commands by PX4's own topic that were dropped."""
        return 0 if self._px4_commands is None else self._px4_commands.rejected

    def on_state(self) -> None:
        """Take in a state of the vehicle."""
        if self._services is not None:
            self._services.on_state()
        if self.actions is not None:
            self.actions.on_state(self._vehicle.state)
        self.step()

    def on_message(self, name: str, fields: Mapping[str, Any], age_s: float) -> None:
        """A MAVLink message of the vehicle's autopilot, to any station."""
        if self._services is not None:
            self._services.on_message(name, fields, age_s)

    def on_event(self, event: Mapping[str, Any]) -> None:
        """An event of the daemon of the kinds in EVENTS."""
        if event["kind"] == "reboot":
            if self._services is not None and event["vehicle"] == self._vehicle.name:
                self._services.forget_mission()
        elif self.actions is not None:
            self.actions.on_event(event)

    def step(self) -> None:
        """Do what is due."""
        if self.actions is not None:
            self.actions.step()
        self.stream.settle()
        offboard, now = self.stream.offboard, self._clock()
        match offboard.next_step(self._vehicle.state, now):
            case TakeOff(height_m):
                self._begin(self._take_off(height_m))
            case Engage() as engage:
                self._begin(self._engage(engage))
            case None:
                pass
        self._vehicle.shown_mode = offboard.shown_mode
        if self._vehicle.connected and self._vehicle.state.get("ekf_origin") is None and now >= self._asks_origin_at:
            self._asks_origin_at = now + ASK_ORIGIN_S
            self._begin(self._ask_origin())

    def lost(self) -> None:
        """The connection to the daemon has ended: nothing is under way any more."""
        self.stream.offboard.end()
        for task in self._tasks:
            task.cancel()
        if self._px4_commands is not None:
            self._px4_commands.cancel()
        if self._services is not None:
            self._services.forget_mission()
        if self.actions is not None:
            self.actions.lost()

    def _end_offboard(self) -> None:
        """An order by an action takes the place of OFFBOARD, as a mode does."""
        self.stream.offboard.end()
        self._vehicle.shown_mode = ""

    async def _take_off(self, height_m: float | None) -> None:
        gcs = self._gcs()
        if gcs is not None:
            name = self._vehicle.name
            answer = await gcs.call("vehicles.takeoff", targets=name, height_m=height_m, arm=False)
            outcome = answer["outcomes"][name]
            if not outcome["ok"]:
                self._log(ERROR, f"take-off: {outcome['message']}")
                self.stream.offboard.end()

    async def _engage(self, engage: Engage) -> None:
        ok, text = False, "the daemon is not there"
        try:
            gcs = self._gcs()
            if gcs is not None:
                name = self._vehicle.name
                answer = await gcs.call("control.set", targets=name, mode=engage.mode)
                outcome = answer["outcomes"][name]
                ok, text = bool(outcome["ok"]), outcome["message"]
        finally:
            kept = self.stream.offboard.on_engaged(engage.mode, ok, self._clock())
        if not ok:
            self._log(ERROR, f"control: {text}" + ("" if kept else "; given up, call set_mode again"))

    async def _ask_origin(self) -> None:
        """Its local frame's origin, once: setpoints of positions need it, and few vehicles send it unasked."""
        gcs = self._gcs()
        if gcs is not None:
            await gcs.call("vehicles.request", targets=self._vehicle.name, message="GPS_GLOBAL_ORIGIN")

    def _begin(self, work: Coroutine[Any, Any, None]) -> None:
        task = asyncio.create_task(self._guarded(work), name=f"ros control of {self._vehicle.name}")
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)

    async def _guarded(self, work: Coroutine[Any, Any, None]) -> None:
        try:
            await work
        except (RpcError, DaemonUnreachable) as error:
            self._log(ERROR, str(error))

    def _log(self, severity: int, text: str) -> None:
        self._vehicle.log(severity, text, self._unix_ns())


ASK_ORIGIN_S = 20.0
"""Between two requests of a vehicle that has no origin yet, as before its first fix."""
