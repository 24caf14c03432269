"""Simulated vehicles, one PX4 and one ArduCopter, before a fleet: joined by bytes, ready to fly, to be broken."""

from __future__ import annotations

import asyncio
from collections.abc import Mapping
from typing import Any

from skygcs.config.models import FleetConfig
from skygcs.core.airtime import Priority
from skygcs.core.mavlink.dialect import MessageInfo
from skygcs.core.mavlink.frame import encode
from skygcs.core.mavlink.parser import FrameParser
from skygcs.core.preflight.facts import LinkFacts
from skygcs.core.sim.fleet import SimFleet, make_vehicles
from skygcs.core.sim.kinematics import LocalFrame
from skygcs.core.sim.vehicle import SimVehicle
from skygcs.core.vehicle.events import Event
from skygcs.runtime.fleet import Fleet
from skygcs.runtime.vehicle_actor import VehicleActor
from support.vehicles import HOME, flight_dialect

UNIX_S = 1_700_000_000.0
"""Where the time of day stands when the loop's clock is at 0."""

READY_S = 12.0
"""An ArduCopter's estimator has converged, and a PX4's long before."""

DELAY_S = 0.1


class PreflightField:
    """Vehicle 1, "papa", is a PX4, vehicle 2, "echo", an ArduCopter. ``heard`` is what the links say of both."""

    def __init__(self, **config: Any) -> None:
        self.loop = asyncio.get_running_loop()
        self.dialect = flight_dialect()
        self.events: list[Event] = []
        self.heard: dict[str, LinkFacts] = {"radio": LinkFacts(0.01, 300, 25.0)}
        self.asked: list[tuple[str, Mapping[str, Any]]] = []
        now = self.loop.time()
        unix_us = round((UNIX_S + now) * 1e6)
        vehicles = make_vehicles(
            self.dialect, px4=1, ardupilot=1, first_sysid=1, home=LocalFrame(*HOME), now=now, unix_us=unix_us
        )
        self.sim = SimFleet(vehicles)
        named = {"papa": {"sysid": 1}, "echo": {"sysid": 2}}
        self.fleet = Fleet(
            FleetConfig.model_validate({"vehicles": named, **config}),
            self.dialect,
            self._send,
            self.loop,
            self.events.append,
            heard=lambda key: self.heard,
        )
        self._down = FrameParser(self.dialect)
        self._up = FrameParser(self.dialect)
        self._seq = 0
        self._task = self.loop.create_task(self._run())

    async def __aenter__(self) -> PreflightField:
        await asyncio.sleep(READY_S)
        for actor in self.fleet.vehicles.values():
            actor.preflight.wall_clock = lambda: UNIX_S + self.loop.time()
        return self

    async def __aexit__(self, *_: object) -> None:
        self._task.cancel()
        await asyncio.gather(self._task, return_exceptions=True)
        self.fleet.close()
        await asyncio.sleep(0)

    def vehicle(self, name: str) -> SimVehicle:
        return self.sim.vehicles[0 if name == "papa" else 1]

    def actor(self, name: str) -> VehicleActor:
        return self.fleet.find(name)

    def hold(self, name: str, **params: float) -> None:
        """Let a vehicle hold these parameters."""
        for param, value in params.items():
            found = self.vehicle(name).params.find(param)
            assert found is not None, param
            found[1].value = value

    async def complaints(self, name: str) -> dict[str, str]:
        """What a preflight has to say against a vehicle: text by check, worst first."""
        told = await self.fleet.preflight(name)
        wrong = [f for f in told[name]["findings"] if f["verdict"] in ("fail", "unknown")]
        assert told[name]["ok"] is (not wrong)
        return {f["check"]: f["text"] for f in wrong}

    def names_asked(self) -> list[str]:
        """Parameters that were asked for by name."""
        return [v["param_id"] for n, v in self.asked if n == "PARAM_REQUEST_READ" and v["param_index"] == -1]

    def _send(
        self,
        info: MessageInfo,
        values: Mapping[str, Any],
        sysid: int,
        compid: int,
        priority: Priority,
        *,
        everywhere: bool = False,
    ) -> bool:
        self._seq += 1
        self.asked.append((info.name, values))
        raw = encode(info, values, sysid=255, compid=25, seq=self._seq & 0xFF)
        self.loop.call_later(DELAY_S, self._arrive, raw)
        return True

    def _arrive(self, raw: bytes) -> None:
        for frame in self._up.feed_datagram(raw):
            self.sim.on_frame(frame, self.loop.time())

    def _hear(self, raw: bytes) -> None:
        for frame in self._down.feed_datagram(raw):
            self.fleet.on_frame(frame.sysid << 8 | frame.compid, frame, "radio", self.loop.time())

    async def _run(self) -> None:
        while True:
            for raw in self.sim.step(self.loop.time()):
                self.loop.call_later(DELAY_S, self._hear, raw)
            self.fleet.tick(self.loop.time())
            await asyncio.sleep(0.1)
