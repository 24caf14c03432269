"""Control of one PX4 by its own topics, under fmu/in.

Setpoints go into the same `SetpointStream`, commands into the same `VehicleServices` as those of MAVROS' names.
Commands are carried out one after the other, in the order in which they came: PX4's examples set OFFBOARD and arm at
once. One that ends a flight (`ending_orders`) goes at once, in place of all others: those that wait are dropped, and
the one under way is cancelled unless it ends a flight, too. What comes after it waits for its end.
"""

from __future__ import annotations

import asyncio
from collections import deque
from collections.abc import Callable
from typing import Any

from skygcs.core.ros.interfaces import Interfaces
from skygcs.core.ros.px4_setpoints import ACK_TYPE, PX4_INPUTS, OffboardControlMode, ack, is_for, service_call
from skygcs.core.ros.px4_telemetry import versioned
from skygcs.core.ros.services import FAILED, RequestError
from skygcs.ext.ros.ending_orders import command_ends_flight
from skygcs.ext.ros.graph import Node
from skygcs.ext.ros.setpoint_stream import SetpointStream
from skygcs.ext.ros.vehicle_services import VehicleServices

MOST_WAITING = 8
"""Commands of one vehicle that wait for their turn; further ones are temporarily rejected."""

MOST_WAITED_S = 5.0
"""One that waited longer for those before it is temporarily rejected: by then nobody expects it. To change the mode
takes 3 s over a bad link, and to arm comes after it."""

TEMPORARILY_REJECTED, IN_PROGRESS, CANCELLED = 1, 5, 6
"""MAV_RESULT."""

WARNING = 4
"""MAV_SEVERITY."""


class Px4Setpoints:
    """offboard_control_mode and trajectory_setpoint of one PX4."""

    def __init__(
        self, node: Node, known: Interfaces, root: str, stream: SetpointStream, clock: Callable[[], float]
    ) -> None:
        self._mode = OffboardControlMode()

        def on_mode(fields: dict[str, Any]) -> None:
            self._mode.on_message(fields, clock())
            stream.offboard.on_proof(clock())

        for topic, on_message in {
            "offboard_control_mode": on_mode,
            "trajectory_setpoint": stream.reader(lambda fields, frame: self._mode.demand(fields, frame, clock())),
        }.items():
            type_ = PX4_INPUTS[topic]
            node.subscribe(f"{root}/fmu/in/{versioned(known, topic, type_)}", type_, "sensor", on_message)


class Px4Commands:
    """vehicle_command of one PX4, and vehicle_command_ack. ``log(severity, text)``."""

    def __init__(
        self,
        node: Node,
        known: Interfaces,
        root: str,
        sysid: int,
        services: VehicleServices,
        boot_us: Callable[[], int],
        log: Callable[[int, str], None],
        clock: Callable[[], float],
    ) -> None:
        self.rejected = 0
        """Commands that were dropped: MOST_WAITING were waiting, it waited for MOST_WAITED_S, or a flight was ended."""
        self._clock = clock
        self._sysid = sysid
        self._services = services
        self._boot_us = boot_us
        self._log = log
        self._waiting: deque[tuple[float, dict[str, Any]]] = deque()
        self._working: asyncio.Task[None] | None = None
        self._ending: dict[Any, asyncio.Task[None]] = {}
        """Those that end a flight and are under way, by what they ask for: a flood of the same is one."""
        command = versioned(known, "vehicle_command", PX4_INPUTS["vehicle_command"])
        self._acks = node.publish(
            f"{root}/fmu/out/{versioned(known, 'vehicle_command_ack', ACK_TYPE)}", ACK_TYPE, "px4"
        )
        node.subscribe(f"{root}/fmu/in/{command}", PX4_INPUTS["vehicle_command"], "sensor", self._on_command)

    def cancel(self) -> None:
        """Drop what waits, and what is under way but does not end a flight: the connection to the daemon has ended."""
        self._waiting.clear()
        if self._working is not None:
            self._working.cancel()
            self._working = None

    def _on_command(self, command: dict[str, Any]) -> None:
        if not is_for(command, self._sysid):
            return
        if command_ends_flight(command):
            self._end_flight(command)
            return
        if len(self._waiting) >= MOST_WAITING:
            self._reject(command)
            return
        self._waiting.append((self._clock(), command))
        if self._working is None:
            self._working = asyncio.create_task(self._work(), name=f"vehicle_command of {self._sysid}")

    def _end_flight(self, command: dict[str, Any]) -> None:
        name, request = service_call(command)
        kind = name, request.get("command"), request.get("custom_mode")
        if kind in self._ending:
            self._acknowledge(command, IN_PROGRESS)
            return
        dropped = [waiting for _, waiting in self._waiting]
        self.cancel()
        for one in dropped:
            self._reject(one)
        task = asyncio.create_task(self._at_once(command), name=f"vehicle_command of {self._sysid}: {name}")
        self._ending[kind] = task
        task.add_done_callback(lambda _: self._ending.pop(kind))

    async def _at_once(self, command: dict[str, Any]) -> None:
        self._acknowledge(command, await self._carry_out(command))

    async def _work(self) -> None:
        this = asyncio.current_task()
        try:
            while self._waiting:
                if self._ending:
                    await asyncio.wait(set(self._ending.values()))
                came_at, command = self._waiting.popleft()
                if (waited_s := self._clock() - came_at) > MOST_WAITED_S:
                    self._log(WARNING, f"vehicle_command was not carried out: it waited {waited_s:.1f} s for others")
                    self._reject(command)
                    continue
                try:
                    result = await self._carry_out(command)
                except asyncio.CancelledError:
                    self._acknowledge(command, CANCELLED)
                    raise
                self._acknowledge(command, result)
        finally:
            if self._working is this:
                self._working = None

    def _reject(self, command: dict[str, Any]) -> None:
        self.rejected += 1
        self._acknowledge(command, TEMPORARILY_REJECTED)

    async def _carry_out(self, command: dict[str, Any]) -> int:
        """Its MAV_RESULT. Why it failed is in the log."""
        try:
            name, request = service_call(command)
        except RequestError as error:
            self._log(WARNING, f"vehicle_command: {error}")
            return FAILED
        answer = await self._services.call(name, request)
        if name == "set_mode":
            return 0 if answer.get("mode_sent") else FAILED
        return int(answer["result"])

    def _acknowledge(self, command: dict[str, Any], result: int) -> None:
        if self._acks.wanted:
            self._acks.write({"timestamp": self._boot_us(), **ack(command, result)})
