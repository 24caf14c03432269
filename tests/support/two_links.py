"""A whole daemon and simulated vehicles with two links each: an emulated radio that all share, and a network link each.

In virtual time. Each of a vehicle's two ports has streams and sequence numbers of its own, as on an autopilot.
"""

from __future__ import annotations

import asyncio
import contextlib
import random
from collections.abc import AsyncIterator, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from skygcs.core.mavlink.frame import Frame
from skygcs.core.mavlink.parser import FrameParser
from skygcs.core.routing.link_choice import LinkHealth
from skygcs.daemon import Daemon
from skygcs.links.memory import MemoryLink
from skygcs.sim.rng import Rng
from skygcs.sim.stream_schedule import Streams
from skygcs.sim.transmitter import Transmitter
from skygcs.sim.vehicle import SimVehicle
from support.daemons import listening, made_daemon, memory_link, started
from support.on_air import FIELD, OnAir

NETWORK_HZ = {
    "HEARTBEAT": 1.0,
    "ATTITUDE": 10.0,
    "GLOBAL_POSITION_INT": 5.0,
    "SYS_STATUS": 1.0,
    "EXTENDED_SYS_STATE": 1.0,
    "SYSTEM_TIME": 1.0,
    "GPS_RAW_INT": 1.0,
}
"""What a vehicle streams on its network port: 20 frames a second."""

STEP_S = 0.02


@dataclass(frozen=True, slots=True)
class Delivered:
    """A command or setpoint that reached a vehicle."""

    at: float
    sysid: int
    over: str
    """The link: "wifi" or "air"."""
    name: str
    values: Mapping[str, Any]


class NetworkPort:
    """A vehicle's second port. Each frame is lost, or comes ``delay_s`` and up to ``jitter_s`` later, both ways."""

    def __init__(self, sim: SimVehicle, link: MemoryLink, log: list[Delivered], seed: int) -> None:
        self.sim = sim
        self.log = log
        self.cut = False
        self.deaf = False
        """What is sent to the vehicle is lost, what it sends is not."""
        self.loss = 0.0
        self.delay_s = 0.005
        self.jitter_s = 0.0
        self._loop = asyncio.get_running_loop()
        self._random = random.Random(seed)
        self._peer = link.peer
        self._peer.on_bytes = self._on_bytes
        self._parser = FrameParser(sim.dialect)
        self.streams = Streams(sim.builders, NETWORK_HZ, Rng(seed), self._loop.time())
        self._tx = Transmitter(sim.dialect, Rng(seed), sim.faults, sim.signing)
        self._tx.restart(sim.sysid)

    def step(self, now: float) -> None:
        """What its port streams now."""
        with self._on_this_port():
            for name in self.streams.due(now):
                self.sim.send_message(name, now)
        self._flush()

    @contextlib.contextmanager
    def _on_this_port(self) -> Iterator[None]:
        sim = self.sim
        before, sim.streams, sim.tx = (sim.streams, sim.tx), self.streams, self._tx
        try:
            yield
        finally:
            sim.streams, sim.tx = before

    def _flush(self) -> None:
        for raw in self._tx.take():
            if not self.cut and self._random.random() >= self.loss:
                self._loop.call_later(self._delay_s(), self._peer.send, raw)

    def _delay_s(self) -> float:
        return self.delay_s + self.jitter_s * self._random.random()

    def _on_bytes(self, data: bytes) -> None:
        for frame in self._parser.feed(data):
            if not self.cut and not self.deaf and self._random.random() >= self.loss:
                self._loop.call_later(self._delay_s(), self._hear, frame)

    def _hear(self, frame: Frame) -> None:
        if self.cut:
            return
        note(self.log, frame, self.sim, "wifi", self._loop.time())
        with self._on_this_port():
            self.sim.on_frame(frame, self._loop.time())
        self._flush()


def note(log: list[Delivered], frame: Frame, sim: SimVehicle, over: str, now: float) -> None:
    """Keep it if it is a command or setpoint for this vehicle."""
    ordered = frame.name.startswith(("COMMAND_", "SET_", "REQUEST_DATA")) and frame.name != "COMMAND_ACK"
    if ordered and frame.target()[0] in (0, sim.sysid):
        log.append(Delivered(now, sim.sysid, over, frame.name, frame.fields()))


@dataclass
class TwoLinks(OnAir):
    """``ports`` by system id; ``delivered``: what reached the vehicles."""

    daemon: Daemon
    ports: dict[int, NetworkPort] = field(default_factory=dict)
    delivered: list[Delivered] = field(default_factory=list)

    def links(self, sysid: int) -> dict[str, Any]:
        """The state's "links" of a vehicle."""
        return self.daemon.hub.statistics.link_quality(sysid << 8 | 1)

    def chosen(self, sysid: int) -> str:
        """ "wifi" or "air"."""
        (channel_id,) = self.daemon.hub.channels_to(sysid, 1)
        return self.daemon.hub.channels[channel_id].link.name.rstrip("0123456789")

    def health(self, sysid: int, link: str) -> LinkHealth:
        state = self.daemon.hub.router.state_sources[sysid << 8 | 1]
        return next(h for i, h in state.links().items() if self.daemon.hub.channels[i].link.name.startswith(link))

    def switches(self) -> list[str]:
        return [e["text"] for e in self.daemon.event_log.recent if "is followed over" in e["text"]]

    async def watch(self, seconds: float) -> list[float]:
        """The age of every vehicle's newest position, ten times a second from now on for so long, sorted."""
        ages = []
        for _ in range(round(seconds * 10)):
            await asyncio.sleep(0.1)
            now = self.daemon.now()
            for actor in self.daemon.fleet.vehicles.values():
                at = actor.vehicle.telemetry_at("position")
                ages.append(now - at if at is not None else float("inf"))
        return sorted(ages)

    async def carried_by(self, link: str) -> float:
        return await self.until(lambda: all(self.chosen(s) == link for s in self.ports))


@contextlib.asynccontextmanager
async def two_links(
    tmp_path: Path,
    *,
    px4: int = 0,
    ardupilot: int = 0,
    radio: Mapping[str, Any] | None = None,
) -> AsyncIterator[TwoLinks]:
    """From the moment at which every vehicle's network link carries its state and the radio has its plan."""
    vehicles = px4 + ardupilot
    air = {"type": "simulated", "role": "radio", "px4": px4, "ardupilot": ardupilot, "dynamics": "kinematic"}
    daemon = made_daemon(
        tmp_path,
        origin=FIELD,
        links={
            "air": {**air, "seed": 1, "stream_profile": "nav", "radio": dict(radio or {})},
            **{f"wifi{n}": {"type": "memory"} for n in range(1, vehicles + 1)},
        },
    )
    async with started(daemon):
        field_ = TwoLinks(daemon)
        await field_.until(lambda: field_.link.channels)
        for sim in field_.link.vehicles:
            wifi = memory_link(daemon, f"wifi{sim.sysid}")
            field_.ports[sim.sysid] = NetworkPort(sim, wifi, field_.delivered, 1000 + sim.sysid)
            _log_radio(field_, sim)
        ticking = asyncio.create_task(_tick(field_), name="network ports")
        try:
            await field_.until(lambda: len(daemon.hub.router.state_sources) == vehicles)
            await field_.carried_by("wifi")
            yield field_
            assert not field_.events("fault")
        finally:
            ticking.cancel()


def _log_radio(field_: TwoLinks, sim: SimVehicle) -> None:
    """Keep what reaches it over the radio, too."""

    def hear(frame: Frame, now: float) -> None:
        if sim.tx is not field_.ports[sim.sysid]._tx:
            note(field_.delivered, frame, sim, "air", now)

    listening(sim, hear)


async def _tick(field_: TwoLinks) -> None:
    loop = asyncio.get_running_loop()
    while True:
        for port in field_.ports.values():
            port.step(loop.time())
        await asyncio.sleep(STEP_S)
