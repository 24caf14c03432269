"""Simulated vehicles before a fleet, joined by nothing but bytes and a delay."""

from __future__ import annotations

import asyncio
from collections.abc import Mapping
from typing import Any, Self

from skygcs.config.models import FleetConfig
from skygcs.core.mavlink.dialect import MessageInfo
from skygcs.core.mavlink.frame import encode
from skygcs.core.mavlink.parser import FrameParser
from skygcs.events import Event
from skygcs.runtime.fleet import Fleet
from skygcs.sim.kinematics import LocalFrame
from skygcs.sim.vehicle_group import SimFleet, make_vehicles
from support.services import KnownLinks
from support.vehicles import HOME, flight_dialect


class SimField:
    """``delay_s`` is one way; ``ready_s`` passes before the field is entered; ``sim`` are the vehicles, PX4s first."""

    delay_s = 0.25
    """A half round of a five-node radio."""
    ready_s = 3.0

    def __init__(self, px4: int, ardupilot: int, config: Mapping[str, Any], *, unix_us: int = 1, **fleet: Any) -> None:
        self.loop = asyncio.get_running_loop()
        self.dialect = flight_dialect()
        self.events: list[Event] = []
        vehicles = make_vehicles(
            self.dialect,
            px4=px4,
            ardupilot=ardupilot,
            first_sysid=1,
            home=LocalFrame(*HOME),
            now=self.loop.time(),
            unix_us=unix_us,
        )
        self.sim = SimFleet(vehicles)
        self.fleet = Fleet(
            FleetConfig.model_validate(config),
            self.dialect,
            self._send,
            self.loop,
            self.events.append,
            **{"links": KnownLinks(), **fleet},
        )
        self._down = FrameParser(self.dialect)
        self._up = FrameParser(self.dialect)
        self._seq = 0
        self._task = self.loop.create_task(self._run())

    async def __aenter__(self) -> Self:
        await asyncio.sleep(self.ready_s)
        return self

    async def __aexit__(self, *_: object) -> None:
        self._task.cancel()
        await asyncio.gather(self._task, return_exceptions=True)
        self.fleet.close()
        await asyncio.sleep(0)

    def on_send(self, message: str, values: Mapping[str, Any]) -> None:
        """What the fleet sends, as it leaves."""

    def _send(self, info: MessageInfo, values: Mapping[str, Any], *_: Any, **__: Any) -> bool:
        self._seq += 1
        self.on_send(info.name, values)
        raw = encode(info, values, sysid=255, compid=25, seq=self._seq & 0xFF)
        self.loop.call_later(self.delay_s, self.deliver, raw)
        return True

    def deliver(self, raw: bytes) -> None:
        """The vehicles hear these bytes now."""
        for frame in self._up.feed_datagram(raw):
            self.sim.on_frame(frame, self.loop.time())

    def _hear(self, raw: bytes) -> None:
        for frame in self._down.feed_datagram(raw):
            self.fleet.on_frame(frame.sysid << 8 | frame.compid, frame, "radio", self.loop.time())

    async def _run(self) -> None:
        while True:
            for raw in self.sim.step(self.loop.time()):
                self.loop.call_later(self.delay_s, self._hear, raw)
            self.fleet.tick(self.loop.time())
            await asyncio.sleep(0.1)
