"""One cell of the table: so many vehicles, so fast an air, and a ground station that paces itself or does not.

The whole daemon in virtual time, with an emulated radio in its simulated link. Both columns use the same daemon, its
retries of commands too: what "plain" does not do is pace its writes, plan the streams, and leave the parameters alone.
"""

from __future__ import annotations

import asyncio
import contextlib
import itertools
import tempfile
from pathlib import Path
from typing import Any

from bench.commanded_daemon import PARAMETERS, Column, CommandedDaemon, Measured, furnish
from bench.monitor.virtual import in_virtual_time
from skygcs.config.dialects import load_dialect
from skygcs.config.models import FleetConfig
from skygcs.core.mavlink.frame import Frame
from skygcs.core.radio_link.transmit_queue import Priority
from skygcs.daemon import Daemon
from skygcs.events import Event
from skygcs.links.simulated import SimulatedVehiclesLink
from skygcs.runtime.vehicle_actor import VehicleActor
from skygcs.sim.vehicle import SimVehicle

PACKET_LOSS = 0.01
"""On air, of every packet between the ground and a vehicle."""

SETTLE_S, MEASURE_S = 40.0, 120.0
"""Before and while it is measured."""

USABLE_AGE_S = 2.5
USABLE_S = 5.0
"""All vehicles are usable when for so long no position was older."""


def measure(
    column: Column, vehicles: int, air_kbps: float, *, settle_s: float = SETTLE_S, measure_s: float = MEASURE_S
) -> Measured:
    """Run one cell; takes a few seconds of real time."""
    with tempfile.TemporaryDirectory() as folder:
        cell = _Cell(column, vehicles, air_kbps, Path(folder), settle_s, measure_s)
        return in_virtual_time(cell.run())


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
        self.commanded: CommandedDaemon

    async def run(self) -> Measured:
        self.daemon = Daemon(self.config, load_dialect(self.config.dialect))
        if self.told.column == "plain":
            self.daemon.event_log.subscribe(self._on_event)
        running = asyncio.create_task(self.daemon.run())
        await self.daemon.ready.wait()
        await asyncio.sleep(0.01)  # the link opens
        radio = self._link().radio
        assert radio is not None
        self.commanded = CommandedDaemon(self.daemon, radio.fleet.vehicles, self.told)
        self.told.round_s = radio.network.config.round_s
        for sim in self.commanded.sims:
            furnish(sim, self.daemon.now())
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

    def _on_event(self, event: Event | Any) -> None:
        """The UTIAS lab's ground station downloaded the parameters of whomever it meets."""
        if event["kind"] == "vehicle_discovered":
            info = self.daemon.dialect.by_name["PARAM_REQUEST_LIST"]
            values = {"target_system": event["sysid"], "target_component": 1}
            self.daemon.hub.send(info, values, event["sysid"], 1, Priority.PROTOCOL)

    async def _watch_usable(self, started: float) -> None:
        since: float | None = None
        while self.told.usable_s is None:
            await asyncio.sleep(0.2)
            now = self.daemon.now()
            fresh = max(self.commanded.ages()) <= USABLE_AGE_S
            since = (now if since is None else since) if fresh else None
            if since is not None and now - since >= USABLE_S:
                self.told.usable_s = since - started

    def _counts(self) -> tuple[int, int, int]:
        """Frames, lost frames, positions, of all vehicles."""
        (channel,) = self._link().channels
        stats = [s for key, s in channel.sources.items() if key & 0xFF == 1]
        return sum(s.frames for s in stats), sum(s.lost for s in stats), self.commanded.positions()

    async def _measured_while_commanded(self) -> None:
        began, end = self._counts(), self.daemon.now() + self.measure_s
        commanding = asyncio.create_task(self.commanded.command_until(end))
        while self.daemon.now() < end:
            await asyncio.sleep(0.2)
            self.told.ages_s += self.commanded.ages()
        frames, lost, positions = (b - a for a, b in zip(began, self._counts(), strict=True))
        self.told.heard = len(self.daemon.fleet.vehicles)
        self.told.loss = lost / max(1, lost + frames)
        self.told.positions_per_s = positions / self.measure_s / self.told.vehicles
        await commanding

    async def _emergency(self) -> None:
        """A stop for all while a ground station floods the link."""
        heard: dict[int, float] = {}
        for sim in self.commanded.sims:
            self._note_stops(sim, heard)
        (channel,) = self._link().channels
        flood = asyncio.create_task(self._flood(channel))
        await asyncio.sleep(10)
        ordered = self.daemon.now()
        stop = asyncio.create_task(self.daemon.fleet.orders.command_all("all", VehicleActor.stop, action="land"))
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
            for sim in self.commanded.sims:
                values = {"target_system": sim.sysid, "target_component": 1, "param_index": index % PARAMETERS}
                channel.send(_raw(info, values), Priority.FORWARDED)
            await asyncio.sleep(0.1)


def _raw(info: Any, values: dict[str, Any]) -> bytes:
    from skygcs.core.mavlink.frame import encode

    return encode(info, values, sysid=250, compid=190, seq=0)
