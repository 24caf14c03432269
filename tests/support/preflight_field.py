"""Simulated vehicles, one PX4 and one ArduCopter, before a fleet: joined by bytes, ready to fly, to be broken."""

from __future__ import annotations

import asyncio
from collections.abc import Mapping
from typing import Any, Self

from skygcs.core.routing.source_statistics import LinkFacts
from skygcs.runtime.preflight_run import Preflight, examine_fleet
from skygcs.runtime.vehicle_actor import VehicleActor
from skygcs.sim.vehicle import SimVehicle
from support.services import KnownLinks
from support.sim_field import SimField

UNIX_S = 1_700_000_000.0
"""Where the time of day stands when the loop's clock is at 0."""

READY_S = 12.0
"""An ArduCopter's estimator has converged, and a PX4's long before."""


class PreflightField(SimField):
    """Vehicle 1, "papa", is a PX4, vehicle 2, "echo", an ArduCopter. ``heard`` is what the links say of both."""

    delay_s = 0.1
    ready_s = READY_S

    def __init__(self, **config: Any) -> None:
        self.heard: dict[str, LinkFacts] = {"radio": LinkFacts(0.01, 300, 25.0)}
        self.known_links = KnownLinks()
        self.known_links.heard = self.heard
        self.asked: list[tuple[str, Mapping[str, Any]]] = []
        named = {"papa": {"sysid": 1}, "echo": {"sysid": 2}}
        unix_us = round((UNIX_S + asyncio.get_running_loop().time()) * 1e6)
        super().__init__(1, 1, {"vehicles": named, **config}, unix_us=unix_us, links=self.known_links)

    async def __aenter__(self) -> Self:
        await super().__aenter__()
        for actor in self.fleet.vehicles.values():
            actor.part(Preflight).wall_clock = lambda: UNIX_S + self.loop.time()
        return self

    def on_send(self, message: str, values: Mapping[str, Any]) -> None:
        self.asked.append((message, values))

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

    def held(self, name: str, *params: str) -> dict[str, float]:
        """The values that a vehicle has for these parameters."""
        return {param: self.vehicle(name).params[param] for param in params}

    async def complaints(self, name: str) -> dict[str, str]:
        """What a preflight has to say against a vehicle: text by check, worst first."""
        answer = await examine_fleet(self.fleet, name)
        wrong = [f for f in answer[name]["findings"] if f["verdict"] in ("fail", "unknown")]
        assert answer[name]["ok"] is (not wrong)
        return {f["check"]: f["text"] for f in wrong}

    def names_asked(self) -> list[str]:
        """Parameters that were asked for by name."""
        return [v["param_id"] for n, v in self.asked if n == "PARAM_REQUEST_READ" and v["param_index"] == -1]
