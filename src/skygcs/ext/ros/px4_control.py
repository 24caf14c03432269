"""Control of one PX4 by its own topics, under fmu/in.

Setpoints go into the same `SetpointStream`, commands into the same `VehicleServices` as those of MAVROS' names.
Commands are carried out one after the other, in the order in which they came: PX4's examples set OFFBOARD and arm at
once.
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
from skygcs.ext.ros.graph import Node
from skygcs.ext.ros.setpoint_stream import SetpointStream
from skygcs.ext.ros.vehicle_services import VehicleServices

MOST_WAITING = 8
"""Commands of one vehicle that wait for their turn; further ones are temporarily rejected."""

TEMPORARILY_REJECTED = 1
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
    ) -> None:
        self.rejected = 0
        """Commands that were dropped: MOST_WAITING were waiting."""
        self._sysid = sysid
        self._services = services
        self._boot_us = boot_us
        self._log = log
        self._waiting: deque[dict[str, Any]] = deque()
        self._working: asyncio.Task[None] | None = None
        command = versioned(known, "vehicle_command", PX4_INPUTS["vehicle_command"])
        self._acks = node.publish(
            f"{root}/fmu/out/{versioned(known, 'vehicle_command_ack', ACK_TYPE)}", ACK_TYPE, "px4"
        )
        node.subscribe(f"{root}/fmu/in/{command}", PX4_INPUTS["vehicle_command"], "sensor", self._on_command)

    def cancel(self) -> None:
        """Drop what waits, and what is under way: the connection to the daemon has ended."""
        self._waiting.clear()
        if self._working is not None:
            self._working.cancel()

    def _on_command(self, command: dict[str, Any]) -> None:
        if not is_for(command, self._sysid):
            return
        if len(self._waiting) >= MOST_WAITING:
            self.rejected += 1
            self._acknowledge(command, TEMPORARILY_REJECTED)
            return
        self._waiting.append(command)
        if self._working is None:
            self._working = asyncio.create_task(self._work(), name=f"vehicle_command of {self._sysid}")

    async def _work(self) -> None:
        try:
            while self._waiting:
                command = self._waiting.popleft()
                self._acknowledge(command, await self._carry_out(command))
        finally:
            self._working = None

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
