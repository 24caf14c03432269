"""One cell of the table: so many vehicles, so fast an air, and a ground station that paces itself or does not.

The whole daemon in virtual time, with an emulated radio in its simulated link. Both columns use the same daemon, its
retries of commands too: what "plain" does not do is pace its writes, plan the streams, and leave the parameters alone.
"""

from __future__ import annotations

import asyncio
import contextlib
import itertools
import logging
import tempfile
from collections.abc import Coroutine
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

import looptime
import structlog

from skygcs.config.dialects import load_dialect
from skygcs.config.models import FleetConfig
from skygcs.core.mavlink.frame import Frame
from skygcs.core.radio_link.transmit_queue import Priority
from skygcs.daemon import Daemon
from skygcs.events import Event
from skygcs.links.simulated import SimulatedVehiclesLink
from skygcs.runtime.vehicle_actor import VehicleActor
from skygcs.sim import protocol as m
from skygcs.sim.param_table import Param
from skygcs.sim.vehicle import SimVehicle

Column = Literal["plain", "skygcs"]

STREAMS_HZ = 4.0
"""Of every group of an ArduCopter at start: what MAVProxy and MAVROS ask for, and what it keeps (SR1_...)."""

PARAMETERS = 900
"""Of a vehicle: about what both firmwares have."""

PACKET_LOSS = 0.01
"""On air, of every packet between the ground and a vehicle."""

SETTLE_S, MEASURE_S = 40.0, 120.0
"""Before and while it is measured."""

USABLE_AGE_S = 2.5
USABLE_S = 5.0
"""All vehicles are usable when for so long no position was older."""

COMMAND_EVERY_S = 5.0
"""To each vehicle. Commands of one kind go to a vehicle one after the other: were the next one there before one that
was lost has been repeated, its waiting would count as well, and the more so the fewer vehicles there are."""

GET_MESSAGE_INTERVAL = 510
"""Asks and changes nothing, and is acknowledged by both firmwares."""


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
    lost_commands: int = 0
    usable_s: float | None = None
    emergency_s: list[float] = field(default_factory=list)
    """From an emergency stop for all, on the saturated link, until each vehicle heard it."""

    def as_dict(self) -> dict[str, Any]:
        return {
            "column": self.column,
            "vehicles": self.vehicles,
            "air_kbps": self.air_kbps,
            "round_s": round(self.round_s, 3),
            "heard": self.heard,
            "age_p50_s": percentile(self.ages_s, 0.5),
            "age_p95_s": percentile(self.ages_s, 0.95),
            "positions_per_vehicle_per_s": round(self.positions_per_s, 3),
            "loss": round(self.loss, 4),
            "ack_p50_s": percentile(self.acks_s, 0.5),
            "ack_p95_s": percentile(self.acks_s, 0.95),
            "commands": self.commands,
            "lost_commands": self.lost_commands,
            "usable_s": None if self.usable_s is None else round(self.usable_s, 1),
            "emergency_max_s": percentile(self.emergency_s, 1.0),
            "emergency_reached": len(self.emergency_s),
        }


def percentile(values: list[float], share: float) -> float | None:
    """None of nothing."""
    ordered = sorted(values)
    return round(ordered[min(len(ordered) - 1, int(share * len(ordered)))], 3) if ordered else None


def measure(
    column: Column, vehicles: int, air_kbps: float, *, settle_s: float = SETTLE_S, measure_s: float = MEASURE_S
) -> Measured:
    """Run one cell; takes some seconds of real time."""
    with contextlib.closing(_Quiet()), tempfile.TemporaryDirectory() as folder:
        cell = _Cell(column, vehicles, air_kbps, Path(folder), settle_s, measure_s)
        return in_virtual_time(cell.run())


def in_virtual_time(work: Coroutine[Any, Any, Measured]) -> Measured:
    """On a loop whose clock jumps to the next thing to do."""
    loop = looptime.patch_event_loop(asyncio.new_event_loop())
    asyncio.set_event_loop(loop)
    try:
        return loop.run_until_complete(work)
    finally:
        asyncio.set_event_loop(None)
        loop.close()


class _Quiet:
    """No logs of a daemon that is measured, until `close`."""

    def __init__(self) -> None:
        structlog.configure(wrapper_class=structlog.make_filtering_bound_logger(logging.ERROR))

    def close(self) -> None:
        structlog.reset_defaults()


class _Cell:
    def __init__(
        self, column: Column, vehicles: int, air_kbps: float, folder: Path, settle_s: float, measure_s: float
    ) -> None:
        self.told = Measured(column, vehicles, air_kbps)
        self.settle_s, self.measure_s = settle_s, measure_s
        skygcs = column == "skygcs"
        link = {
            "type": "simulated",
            "role": "radio" if skygcs else "peer",
            "px4": vehicles // 2,
            "ardupilot": vehicles - vehicles // 2,
            "dynamics": "kinematic",
            "radio": {"air_kbps": air_kbps, "loss": PACKET_LOSS},
        }
        if skygcs:  # nobody is slowed down: what others send fills whatever is left
            link["third_party"] = {"bytes_per_s": 100_000, "rates": {"PARAM_REQUEST_READ": 1000}}
        table = {
            "daemon": {"socket": folder / "s", "log_dir": folder / "logs", "record": False},
            "links": {"air": link},
            "defaults": {} if skygcs else {"streams": {}},
        }
        self.config = FleetConfig.model_validate(table)
        self.daemon: Daemon
        self.sims: list[SimVehicle] = []

    async def run(self) -> Measured:
        self.daemon = Daemon(self.config, load_dialect(self.config.dialect))
        if self.told.column == "plain":
            self.daemon.event_log.subscribe(self._on_event)
        running = asyncio.create_task(self.daemon.run())
        await self.daemon.ready.wait()
        await asyncio.sleep(0.01)  # the link opens
        radio = self._link().radio
        assert radio is not None
        self.sims = radio.fleet.vehicles
        self.told.round_s = radio.network.config.round_s
        for sim in self.sims:
            self._furnish(sim)
        started = self.daemon.now()
        watching = asyncio.create_task(self._watch_usable(started))
        await asyncio.sleep(self.settle_s)
        await self._measured_while_commanded()
        watching.cancel()
        await self._emergency()
        self.daemon.stop()
        with contextlib.suppress(asyncio.CancelledError):
            await running
        return self.told

    def _link(self) -> SimulatedVehiclesLink:
        link = self.daemon.links.link("air")
        assert isinstance(link, SimulatedVehiclesLink)
        return link

    def _furnish(self, sim: SimVehicle) -> None:
        """As it comes out of the box and off a ground station: its streams, and all of its parameters."""
        if sim.autopilot != m.MAV_AUTOPILOT_PX4:
            for group in ("EXTRA1", "EXTRA2", "EXTRA3", "EXT_STAT", "POSITION", "RAW_SENS", "RC_CHAN"):
                sim.params.set(f"SR1_{group}", STREAMS_HZ)
                sim.on_param(f"SR1_{group}", self.daemon.now())
        more = {f"X{n:04d}": Param(f"X{n:04d}", float(n)) for n in range(PARAMETERS - len(sim.params))}
        sim.params.take_in(more)

    def _on_event(self, event: Event | Any) -> None:
        """The UTIAS lab's ground station downloaded the parameters of whomever it meets."""
        if event["kind"] == "vehicle_discovered":
            info = self.daemon.dialect.by_name["PARAM_REQUEST_LIST"]
            values = {"target_system": event["sysid"], "target_component": 1}
            self.daemon.hub.send(info, values, event["sysid"], 1, Priority.PROTOCOL)

    def _ages(self) -> list[float]:
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

    async def _watch_usable(self, started: float) -> None:
        since: float | None = None
        while self.told.usable_s is None:
            await asyncio.sleep(0.2)
            now = self.daemon.now()
            fresh = max(self._ages()) <= USABLE_AGE_S
            since = (now if since is None else since) if fresh else None
            if since is not None and now - since >= USABLE_S:
                self.told.usable_s = since - started

    def _counts(self) -> tuple[int, int, int]:
        """Frames, lost frames, positions, of all vehicles."""
        (channel,) = self._link().channels
        stats = [s for key, s in channel.sources.items() if key & 0xFF == 1]
        positions = sum(a.vehicle.count("GLOBAL_POSITION_INT") for a in self.daemon.fleet.vehicles.values())
        return sum(s.frames for s in stats), sum(s.lost for s in stats), positions

    async def _measured_while_commanded(self) -> None:
        began, end = self._counts(), self.daemon.now() + self.measure_s
        commanding = asyncio.create_task(self._command_until(end))
        while self.daemon.now() < end:
            await asyncio.sleep(0.2)
            self.told.ages_s += self._ages()
        frames, lost, positions = (b - a for a, b in zip(began, self._counts(), strict=True))
        self.told.heard = len(self.daemon.fleet.vehicles)
        self.told.loss = lost / max(1, lost + frames)
        self.told.positions_per_s = positions / self.measure_s / self.told.vehicles
        await commanding

    async def _command_until(self, end: float) -> None:
        """To one vehicle after the other, without waiting for the answer of the one before."""
        under_way: list[asyncio.Task[None]] = []
        turn = 0
        while self.daemon.now() < end:
            under_way.append(asyncio.create_task(self._command(self.sims[turn % len(self.sims)])))
            turn += 1
            await asyncio.sleep(COMMAND_EVERY_S / len(self.sims))
        await asyncio.gather(*under_way)

    async def _command(self, sim: SimVehicle) -> None:
        self.told.commands += 1
        actor = self.daemon.fleet.vehicles.get(sim.sysid << 8 | 1)
        outcome = None if actor is None else await actor.command(GET_MESSAGE_INTERVAL, (33.0,))
        if outcome is not None and outcome.ok:
            self.told.acks_s.append(outcome.elapsed_s)
        else:
            self.told.lost_commands += 1

    async def _emergency(self) -> None:
        """A stop for all while a ground station floods the link."""
        heard: dict[int, float] = {}
        for sim in self.sims:
            self._note_stops(sim, heard)
        (channel,) = self._link().channels
        flood = asyncio.create_task(self._flood(channel))
        await asyncio.sleep(10)
        ordered = self.daemon.now()
        stop = asyncio.create_task(self.daemon.fleet.command_all("all", VehicleActor.stop, action="land"))
        await asyncio.sleep(20)
        stop.cancel()
        flood.cancel()
        await asyncio.gather(stop, flood, return_exceptions=True)
        self.told.emergency_s = [at - ordered for at in heard.values() if at >= ordered]

    def _note_stops(self, sim: SimVehicle, heard: dict[int, float]) -> None:
        before = sim.on_frame

        def on_frame(frame: Frame, now: float) -> None:
            if frame.name == "COMMAND_LONG" and frame.fields()["command"] in (21, 176):
                heard.setdefault(sim.sysid, now)
            before(frame, now)

        sim.on_frame = on_frame  # type: ignore[method-assign]

    async def _flood(self, channel: Any) -> None:
        """As much as the port takes, of what somebody else sends to the vehicles."""
        info = self.daemon.dialect.by_name["PARAM_REQUEST_READ"]
        for index in itertools.count():
            for sim in self.sims:
                values = {"target_system": sim.sysid, "target_component": 1, "param_index": index % PARAMETERS}
                channel.send(_raw(info, values), Priority.FORWARDED)
            await asyncio.sleep(0.1)


def _raw(info: Any, values: dict[str, Any]) -> bytes:
    from skygcs.core.mavlink.frame import encode

    return encode(info, values, sysid=250, compid=190, seq=0)
