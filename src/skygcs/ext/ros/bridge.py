"""The process of ROS: a client of the daemon on one side, a node of ROS on the other.

Tasks of one connection:

    messages    decoded MAVLink of every vehicle -> topics
    states      who is there, connected, under control -> vehicles, lost connections, the frames of TF
    reports     each second: what was measured -> ros.status and /diagnostics; what readers need -> requested rates
    outcomes    of orders, whoever gave them -> goals of actions that they replace
    fleet       states, events, the plan -> /skygcs/…
"""

from __future__ import annotations

import asyncio
import contextlib
import math
import time
from collections.abc import Callable, Mapping
from typing import Any

import structlog

from skygcs.core.ros.fleet_origin import FleetOrigin
from skygcs.core.ros.interfaces import InterfaceError, Interfaces, ros2_interfaces
from skygcs.core.ros.px4_telemetry import PX4_SOURCES
from skygcs.core.ros.ros_names import vehicle_root
from skygcs.core.ros.shared_topics import OK, WARN, connection_status, diagnostic, map_transform
from skygcs.core.ros.topics import SOURCES
from skygcs.errors import RpcError
from skygcs.ext.ros.config import RosConfig
from skygcs.ext.ros.fleet_topics import FleetTopics
from skygcs.ext.ros.fresh_node import FreshNode
from skygcs.ext.ros.graph import Node, SharedTopics
from skygcs.ext.ros.late_gate import LateGate
from skygcs.ext.ros.order_connection import OrderConnection
from skygcs.ext.ros.px4_topics import Px4Topics
from skygcs.ext.ros.rate_requests import RateRequests
from skygcs.ext.ros.vehicle_control import EVENTS, VehicleControl
from skygcs.ext.ros.vehicle_services import MISSION_ACK
from skygcs.ext.ros.vehicle_topics import VehicleTopics
from skygcs.rpc.client import Client
from skygcs.runtime.loop_clock import SleepWatch, Standstill

REPORT_S = 1.0

ORIGIN_S = 1.0
"""The fleet's origin is read so often, and at once when a state names another than the one that is known."""

ORIGIN_AGAIN_S = 0.1
"""Between two readings at least: states that were sent before a change arrive after it."""

COUNT_S = 0.25
"""From a new reader to its first message at most; 400 topics are counted in 2 ms."""

STATE_HZ = 5.0

STATE_GROUPS = (
    *("connected", "compid", "autopilot", "armed", "mode", "landed", "control"),
    *("ekf_origin", "position", "local", "home", "mission"),
)

STALE_S = 1.0
"""After a sleep or a standstill all that waited has been read within this time: as many messages of a topic as its
history holds, 10 as a rule, and 64 kB of the pipe from rospy. A node that streams is followed again after it."""

BEAT_S = 0.1
LATE_S = 1.0
"""A pause of the loop that is this much longer than a beat is one in which what came has waited for too long, ..."""

CATCH_UP_S = 0.2
"""... and so has what is read within this time after it: the histories of all readers are taken in some turns. Shorter
than `order_connection.VALID_S`, so that the setpoints of a node that goes on are followed without a gap."""

CLOCKS_S = 5.0
"""Between two comparisons with the daemon's clock, which is the same one unless the daemon is elsewhere."""

WARNING = 4
"""MAV_SEVERITY."""

MOST_VEHICLES = 250
"""Number of system ids; further names are those of vehicles that were renumbered again and again."""

MOST_REPORTED = 5000
"""Topics and services in a report: some 130 bytes each, and a line of the socket has 1 MiB."""

RADIO = "RADIO_STATUS"

_log = structlog.get_logger(__name__)


class Bridge:
    """`serve` with each connection to the daemon; topics and their readers outlive it."""

    def __init__(
        self,
        node: Node,
        config: RosConfig,
        unix_ns: Callable[[], int] = time.time_ns,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        """``clock``: the loop's, by which what waited is refused."""
        self._clock = clock
        self.sleep: SleepWatch | None = None
        """Since `watch` runs."""
        self._beat_at = math.inf
        self._stale_until = -math.inf
        self._woken = asyncio.Event()
        """Set once this connection is not to be used any more."""
        self.node = node = FreshNode(node, LateGate(self.is_awake), self._log_late)
        self.config = config
        self.shared = SharedTopics(node)
        self.vehicles: dict[str, VehicleTopics] = {}
        self.controls: dict[str, VehicleControl] = {}
        """By vehicle's name; empty if nodes only read."""
        self.fleet = FleetTopics(node, lambda: ((v.state, v.root) for v in self.vehicles.values()), unix_ns)
        self._gcs: OrderConnection | None = None
        self.faults = 0
        """Messages that could not be converted."""
        self._unix_ns = unix_ns
        self._refused: set[str] = set()
        self._counted: dict[str, int] = {}
        self._origin: FleetOrigin | None = None
        """None: it has not been read over this connection. After another start of the daemon its generations are
        others."""
        self._origin_is_old = asyncio.Event()
        self._settings: Mapping[str, Mapping[str, Any]] = {}
        """Settings of the fleet file for each vehicle, by name (ros.settings)."""
        self._px4 = None if config.px4_msgs == "none" else ros2_interfaces(config.px4_msgs)
        self._sources = [*(SOURCES if self._px4 is None else {**SOURCES, **PX4_SOURCES}), MISSION_ACK]
        """Names of the messages that topics are made of, and of those that services follow."""

    # -- sleep and standstill of this process

    async def watch(self) -> None:
        """Watch for standstills of this process, until cancelled."""
        self.sleep = SleepWatch(self._on_woke, asyncio.get_running_loop())
        while True:
            self.sleep.beat()
            self.is_awake()
            self._beat_at = self._clock()
            await asyncio.sleep(BEAT_S)

    def is_awake(self) -> bool:
        """False while what comes from nodes may have waited through a sleep, a standstill or a long turn of this
        process. The daemon may have run all the while: to it, an order from here is new."""
        if self.sleep is not None and self.sleep.check():
            self._forget_all()
        now = self._clock()
        if now - self._beat_at > BEAT_S + LATE_S:
            self._beat_at = now
            self._stale_until = max(self._stale_until, now + CATCH_UP_S)
        return now >= self._stale_until

    def _on_woke(self, pause: Standstill) -> None:
        _log.warning("what waited is not carried out, and the daemon is connected anew", reason=pause.text)
        self._forget_all()

    def _forget_all(self) -> None:
        """Nothing of before is ordered but what ends a flight: neither what waits here, nor what waits in the
        connection to the daemon."""
        self._stale_until = self._clock() + STALE_S
        if self._gcs is not None:
            self._gcs.retired = True
        self._woken.set()
        for control in self.controls.values():
            control.lost()

    def _connected(self) -> OrderConnection | None:
        """The connection for orders, the only way of this process to one."""
        return self._gcs

    def _log_late(self, name: str, reason: str) -> None:
        for vehicle in self.vehicles.values():
            if name.startswith(f"{vehicle.root}/"):
                short = name.removeprefix(f"{vehicle.root}/")
                vehicle.log(WARNING, f"{short}: not carried out: {reason}", self._unix_ns())

    # -- one connection

    async def serve(self, gcs: Client) -> None:
        """Until the connection ends, or is not to be used any more. Raises DaemonUnreachable, RpcError."""
        self._gcs, self._settings = None, {}
        self._woken.clear()
        orders = OrderConnection(gcs, self._clock, self.is_awake)
        await orders.compare_clocks()
        if self._woken.is_set():
            return
        self._gcs = orders
        tasks: list[asyncio.Future[Any]] = []
        try:  # from here on orders are given over this connection
            known = {message["name"] for message in await gcs.call("messages.list")}
            await self._read_origin(gcs)
            for state in await gcs.vehicles():
                self.on_state(state)
            rates = {name: hz for name, hz in self.config.rates.items() if name in known}
            work = (
                self._messages(gcs, [name for name in self._sources if name in known]),
                self._states(gcs),
                self._reports(gcs),
                self._follow_origin(gcs),
                self._rates(gcs, rates),
                self._count_readers(),
                self._compare_clocks(orders),
                self.fleet.follow_events(gcs),
                self.fleet.follow_plan(gcs),
                self.fleet.publish_states(gcs),
                self._woken.wait(),
                *([self._outcomes(gcs)] if self.config.commands == "all" else []),
            )
            tasks = [asyncio.ensure_future(one) for one in work]
            done, _ = await asyncio.wait(tasks, return_when=asyncio.FIRST_COMPLETED)
            for task in done:
                task.result()
            await orders.endings_ended()
        finally:
            for task in tasks:
                task.cancel()
            try:
                await asyncio.gather(*tasks, return_exceptions=True)
            finally:  # this task is cancelled there when the daemon was killed: two pipes of it end one after the other
                self._lost()

    def _lost(self) -> None:
        """Nothing is known of any vehicle without the daemon."""
        self._gcs = self._origin = None
        for control in self.controls.values():
            control.lost()
        for vehicle in self.vehicles.values():
            vehicle.on_lost(self._unix_ns())
        self.fleet.lost()

    # -- messages

    async def _messages(self, gcs: Client, names: list[str]) -> None:
        async for message in gcs.messages(*names):
            self.on_message(message)

    def on_message(self, message: Mapping[str, Any]) -> None:
        """One decoded message of the daemon."""
        arrival_ns = self._unix_ns() - round(message["age_s"] * 1e9)
        name = message["name"]
        if name == RADIO:
            readers = list(self.vehicles.values())  # of the ground's radio: it is the radio of every vehicle
        else:
            vehicle = self.vehicles.get(message["vehicle"])
            readers = [vehicle] if vehicle is not None and message["compid"] == vehicle.state["compid"] else []
        for vehicle in readers:
            try:
                vehicle.on_message(name, message["fields"], arrival_ns)
                if (control := self.controls.get(vehicle.name)) is not None:
                    control.on_message(name, message["fields"], message["age_s"])
            except (InterfaceError, KeyError, TypeError, ValueError, OverflowError) as error:
                self.faults += 1
                if self.faults == 1:
                    _log.warning("a message was not converted", message=name, vehicle=vehicle.name, error=str(error))

    # -- states

    async def _states(self, gcs: Client) -> None:
        async for state in gcs.telemetry("all", rate_hz=STATE_HZ, groups=STATE_GROUPS):
            self.on_state(state)

    def on_state(self, state: Mapping[str, Any]) -> None:
        """A vehicle's state."""
        vehicle = self.vehicles.get(state["name"]) or self._add(state)
        if vehicle is None:
            return
        vehicle.state = state
        if self._px4 is not None and vehicle.px4 is None and state.get("autopilot") == "px4":
            self._add_px4(vehicle, self._px4)
        if (control := self.controls.get(vehicle.name)) is not None:
            control.on_state()
        if not state["connected"]:
            vehicle.on_lost(self._unix_ns())
        place, known = state.get("ekf_origin"), self._origin
        if known is None or not known.is_of(state.get("position")):
            self._origin_is_old.set()
        elif known.origin is not None and place is not None and self.config.frame_prefix:
            frame = vehicle.memory.frames.map
            self.shared.fix_transforms(map_transform(place, known.origin, frame, self._unix_ns()))

    def _add(self, state: Mapping[str, Any]) -> VehicleTopics | None:
        name = state["name"]
        if name in self._refused:
            return None
        try:
            if len(self.vehicles) + len(self._refused) >= MOST_VEHICLES:
                raise ValueError(f"there are {MOST_VEHICLES} names already")
            taken = {vehicle.root: vehicle.name for vehicle in self.vehicles.values()}
            root = vehicle_root(self.config.root, name, state["sysid"])
            if root in taken:
                raise ValueError(f"{root} are the topics of {taken[root]}")
            vehicle = self.vehicles[name] = VehicleTopics(self.shared, self.config, state, self._unix_ns())
            if self.config.commands != "none":
                self.controls[name] = VehicleControl(
                    self.node,
                    self.config,
                    vehicle,
                    self._connected,
                    lambda: self._origin,
                    self._unix_ns,
                    lambda: self._settings.get(name, {}).get("takeoff_height_m"),
                )
        except ValueError as error:
            if len(self._refused) < MOST_VEHICLES:
                self._refused.add(name)
                _log.warning("a vehicle has no topics", vehicle=name, reason=str(error))
            return None
        return vehicle

    def _add_px4(self, vehicle: VehicleTopics, known: Interfaces) -> None:
        vehicle.px4 = Px4Topics(self.node, known, vehicle.root, vehicle.sysid)
        if (control := self.controls.get(vehicle.name)) is not None:
            control.add_px4(known, vehicle.px4)

    async def _follow_origin(self, gcs: Client) -> None:
        """A task of its own: by it the places of setpoints are those of the fleet's frame."""
        while True:
            with contextlib.suppress(TimeoutError):
                async with asyncio.timeout(ORIGIN_S):
                    await self._origin_is_old.wait()
            await self._read_origin(gcs)
            await asyncio.sleep(ORIGIN_AGAIN_S)

    async def _read_origin(self, gcs: Client) -> None:
        self._origin_is_old.clear()
        self._origin = FleetOrigin.read(await gcs.call("origin.get"))
        self.fleet.has_origin = self._origin.origin is not None

    async def _compare_clocks(self, orders: OrderConnection) -> None:
        """A task of its own: a daemon that answers late must keep nothing else."""
        while True:
            await asyncio.sleep(CLOCKS_S)
            await orders.compare_clocks()

    async def _outcomes(self, gcs: Client) -> None:
        """A subscription of its own: no flood of other events pushes an outcome out."""
        async for event in gcs.events(kinds=EVENTS):
            for control in self.controls.values():
                control.on_event(event)

    # -- reports

    async def _count_readers(self) -> None:
        while True:
            self.node.count_readers()
            for control in self.controls.values():
                control.step()
            await asyncio.sleep(COUNT_S)

    async def _rates(self, gcs: Client, rates: Mapping[str, float]) -> None:
        """A task of its own: vehicles that answer slowly must keep nothing else."""
        requests = RateRequests(gcs, asyncio.get_running_loop().time, self._rates_of_setpoints)
        while True:
            await requests.update(
                {
                    vehicle.name: {name: rates[name] for name in vehicle.wanted_messages() if name in rates}
                    for vehicle in self.vehicles.values()
                    if vehicle.connected
                }
            )
            await asyncio.sleep(REPORT_S)

    def _rates_of_setpoints(self) -> dict[str, dict[str, float]]:
        """Rates that the setpoints of nodes need, of the vehicles that are connected."""
        wanted = {name: control.stream.wanted_rates() for name, control in self.controls.items()}
        return {name: rates for name, rates in wanted.items() if rates and self.vehicles[name].connected}

    async def _reports(self, gcs: Client) -> None:
        loop = asyncio.get_running_loop()
        began = loop.time()
        while True:
            if not self.vehicles.keys() <= self._settings.keys():
                self._settings = {**self._settings, **(await gcs.call("ros.settings"))["vehicles"]}
            self.fleet.fences = {name: settings["fence"] for name, settings in self._settings.items()}
            try:
                await gcs.call("ros.report", **self.report(max(loop.time() - began, 1e-3)))
            except RpcError as error:  # a status must not end what nodes fly by
                self.faults += 1
                if self.faults == 1:
                    _log.warning("the daemon did not take the report of ROS", error=str(error))
            began = loop.time()
            self.shared.diagnose(self._unix_ns(), self.diagnostics())
            await asyncio.sleep(REPORT_S)

    def report(self, period_s: float) -> dict[str, Any]:
        """Return what ros.report takes: rates since the last call, ``period_s`` ago."""
        used = [
            *((p.name, p.readers, p.sent, p.dropped) for p in self.node.publications.values() if p.readers),
            *((s.name, 0, s.received, s.rejected) for s in self.node.subscribers.values() if s.received),
            *((s.name, 0, s.calls, s.overflown) for s in self.node.services.values() if s.calls),
        ][:MOST_REPORTED]
        before, self._counted = self._counted, {name: count for name, _, count, _ in used}
        topics = [
            {
                "name": name,
                "readers": readers,
                "rate_hz": round((count - before.get(name, count)) / period_s, 2),
                "count": count,
                "refused": refused,
            }
            for name, readers, count, refused in used
        ]
        return {
            "domain": self.config.domain or 0,
            "network": self.config.network if self.config.version == 2 else f"ROS 1, {self.config.network}",
            "commands": self.config.commands,
            "vehicles": [{"name": v.name, "root": v.root, **self._control_of(v.name)} for v in self.vehicles.values()],
            "topics": topics,
            "rejected": sum(s.rejected for s in self.node.subscribers.values())
            + sum(s.rejected for s in self.node.services.values()),
        }

    def _control_of(self, name: str) -> dict[str, Any]:
        """Return the state of its setpoints as text, and how many setpoints and commands were taken and refused."""
        control = self.controls.get(name)
        stream = None if control is None else control.stream
        return {
            "setpoints": "" if stream is None else stream.status(),
            "setpoints_sent": 0 if stream is None else stream.sent,
            "setpoints_refused": 0 if stream is None else stream.refused,
            "commands_rejected": 0 if control is None else control.commands_rejected,
        }

    def diagnostics(self) -> list[dict[str, Any]]:
        """The state of each vehicle, for /diagnostics."""
        connections = [
            connection_status(vehicle.mavros, vehicle.connected, vehicle.state.get("mode"), vehicle.state.get("armed"))
            for vehicle in self.vehicles.values()
        ]
        actions = [
            diagnostic(OK, f"{self.vehicles[name].root}/skygcs: actions", made.status() or "no goal", made.counters())
            for name, control in self.controls.items()
            if (made := control.actions) is not None
        ]
        setpoints = [
            diagnostic(
                OK if control.stream.refusal is None else WARN,
                f"{self.vehicles[name].mavros}: setpoints",
                control.stream.status(),
                {"sent": control.stream.sent, "refused": control.stream.refused},
            )
            for name, control in self.controls.items()
        ]
        return connections + actions + setpoints
