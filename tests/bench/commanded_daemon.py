"""What benches of links measure of a daemon and simulated vehicles in virtual time: how old known positions are, and
how long orders take to be acknowledged."""

from __future__ import annotations

import asyncio
from dataclasses import dataclass, field
from typing import Any, Literal

from bench.results import percentile
from skygcs.daemon import Daemon
from skygcs.sim import protocol as m
from skygcs.sim.param_table import Param
from skygcs.sim.vehicle import SimVehicle

Column = Literal["plain", "skygcs"]

STREAMS_HZ = 4.0
"""Of every group of an ArduCopter at start: what MAVProxy and MAVROS ask for, and what it keeps (SR1_...)."""

PARAMETERS = 900
"""Of a vehicle: about what both firmwares have."""

COMMAND_EVERY_S = 5.0
"""To each vehicle. Commands of one kind go to a vehicle one after the other: were the next one there before one that
was lost has been repeated, its waiting would count as well, and the more so the fewer vehicles there are."""

GET_MESSAGE_INTERVAL = 510
"""Asks and changes nothing, and is acknowledged by both firmwares."""

SETTLE_S, MEASURE_S = 40.0, 120.0
"""Before and while it is measured."""


@dataclass
class Measured:
    """Of one cell."""

    column: Column
    vehicles: int
    air_kbps: float
    round_s: float = 0.0
    heard: int = 0
    ages_s: list[float] = field(default_factory=list)
    positions_per_s: float = 0.0
    loss: float = 0.0
    acks_s: list[float] = field(default_factory=list)
    commands: int = 0
    usable_s: float | None = None
    emergency_s: list[float] = field(default_factory=list)
    """From an emergency stop for all, on the saturated link, until each vehicle heard it."""

    def as_dict(self) -> dict[str, Any]:
        def at(values: list[float], share: float) -> float | None:
            return round(percentile(values, share), 3) if values else None

        return {
            **{"column": self.column, "vehicles": self.vehicles, "air_kbps": self.air_kbps, "heard": self.heard},
            **{"round_s": round(self.round_s, 3), "loss": round(self.loss, 4), "usable_s": self.usable_s},
            **{"age_p50_s": at(self.ages_s, 0.5), "age_p95_s": at(self.ages_s, 0.95)},
            **{"ack_p50_s": at(self.acks_s, 0.5), "ack_p95_s": at(self.acks_s, 0.95)},
            "positions_per_vehicle_per_s": round(self.positions_per_s, 3),
            **{"commands": self.commands, "lost_commands": self.commands - len(self.acks_s)},
            **{"emergency_max_s": at(self.emergency_s, 1.0), "emergency_reached": len(self.emergency_s)},
        }


def furnish(sim: SimVehicle, now: float) -> None:
    """As it comes out of the box and off a ground station: its streams, and all of its parameters."""
    if sim.autopilot != m.MAV_AUTOPILOT_PX4:
        for group in ("EXTRA1", "EXTRA2", "EXTRA3", "EXT_STAT", "POSITION", "RAW_SENS", "RC_CHAN"):
            sim.params.set(f"SR1_{group}", STREAMS_HZ)
            sim.on_param(f"SR1_{group}", now)
    more = {f"X{n:04d}": Param(f"X{n:04d}", float(n)) for n in range(PARAMETERS - len(sim.params))}
    sim.params.take_in(more)


class CommandedDaemon:
    """A running daemon whose vehicles are watched and get orders; what comes of it goes into `told`."""

    def __init__(self, daemon: Daemon, sims: list[SimVehicle], told: Measured) -> None:
        self.daemon = daemon
        self.sims = sims
        self.told = told

    async def measure(self, measure_s: float) -> None:
        """Look five times a second, while one vehicle after the other gets an order."""
        before, end = self._positions(), self.daemon.now() + measure_s
        commanding = asyncio.create_task(self._command_until(end))
        while self.daemon.now() < end:
            await asyncio.sleep(0.2)
            self.told.ages_s += self.ages()
        self.told.heard = len(self.daemon.fleet.vehicles)
        self.told.positions_per_s = (self._positions() - before) / measure_s / self.told.vehicles
        await commanding

    def ages(self) -> list[float]:
        """Of what is known of where each vehicle is: since the vehicle measured it."""
        ages = []
        for sim in self.sims:
            actor = self.daemon.fleet.vehicles.get(sim.sysid << 8 | 1)
            slot = None if actor is None else actor.vehicle.slot("GLOBAL_POSITION_INT")
            if slot is None or slot.frame is None:
                ages.append(self.daemon.now())
            else:
                ages.append(max(0.0, (sim.boot_ms - slot.frame.fields()["time_boot_ms"]) / 1000))
        return ages

    def _positions(self) -> int:
        """That have come, of all vehicles."""
        return sum(a.vehicle.count("GLOBAL_POSITION_INT") for a in self.daemon.fleet.vehicles.values())

    async def _command_until(self, end: float) -> None:
        """Without waiting for the answer of the order before."""
        under_way: list[asyncio.Task[None]] = []
        while self.daemon.now() < end:
            sim = self.sims[len(under_way) % len(self.sims)]
            under_way.append(asyncio.create_task(self._command(sim)))
            await asyncio.sleep(COMMAND_EVERY_S / len(self.sims))
        await asyncio.gather(*under_way)

    async def _command(self, sim: SimVehicle) -> None:
        self.told.commands += 1
        actor = self.daemon.fleet.vehicles.get(sim.sysid << 8 | 1)
        outcome = None if actor is None else await actor.command(GET_MESSAGE_INTERVAL, (33.0,))
        if outcome is not None and outcome.ok:
            self.told.acks_s.append(outcome.elapsed_s)
