"""One cell of the table: so many vehicles on one XBee network, with the seed's script or with skygcs; in virtual time.

"plain" does what the seed's script (its section 7.3) does with digi-xbee: `send_data` to one vehicle after the other,
which waits for the transmit status, 4 s at most, then one `read_data`, again and again. The library keeps the last 40
packets for `read_data` (its reader.py) and drops the oldest. More favourable than the script: payloads of one node are
one byte stream, from which every MAVLink frame is read, and an order takes the place of the 27 bytes that the script
sends to each vehicle in its turn.
"""

from __future__ import annotations

import asyncio
import contextlib
import socket
from collections import deque
from collections.abc import Iterator
from pathlib import Path
from unittest import mock

from bench.commanded_daemon import (
    COMMAND_EVERY_S,
    GET_MESSAGE_INTERVAL,
    MEASURE_S,
    SETTLE_S,
    Column,
    CommandedDaemon,
    Measured,
    furnish,
)
from bench.results import in_virtual_time
from skygcs.config.dialects import load_dialect
from skygcs.core.mavlink.dialect import Dialect
from skygcs.core.mavlink.frame import Frame, encode
from skygcs.core.mavlink.parser import FrameParser
from skygcs.core.xbee import api_frames
from skygcs.core.xbee.api_frames import ApiFrame, ApiParser, ReceivePacket, TransmitStatus, decode, transmit_request
from skygcs.sim.kinematics import LocalFrame
from skygcs.sim.rng import Rng
from skygcs.sim.vehicle_group import make_vehicles
from skygcs.sim.xbee_mesh import MeshConfig, XBeeMesh
from support.daemons import made_daemon, started

RF_KBPS = 200.0
PACKET_LOSS = 0.05
"""Of one transmission; the modules repeat it."""

STEP_S = 0.005
"""How often bytes pass between the ground's module and the computer."""

SYNC_S = 4.0
"""digi-xbee's default time-out of `send_data`."""

KEPT_PACKETS = 40
"""digi-xbee keeps so many for `read_data`."""

OWN_BYTES = 27
"""The script's own message: a mark, its header, position and time."""


def measure(column: Column, vehicles: int, *, settle_s: float = SETTLE_S, measure_s: float = MEASURE_S) -> Measured:
    """Run one cell; takes a few seconds of real time."""
    if column == "plain":
        return _PlainCell(vehicles, settle_s, measure_s).run()
    return in_virtual_time(lambda folder: _daemon_cell(vehicles, folder, settle_s, measure_s))


def network(vehicles: int, dialect: Dialect) -> XBeeMesh:
    """Half PX4, half ArduCopter, as they come off a ground station, all of them one hop away."""
    made = make_vehicles(
        dialect,
        px4=vehicles // 2,
        ardupilot=vehicles - vehicles // 2,
        first_sysid=1,
        home=LocalFrame(43.7806, -79.4653, 180.0),
    )
    for sim in made:
        furnish(sim, 0.0)
    return XBeeMesh(made, dialect, MeshConfig(rf_kbps=RF_KBPS, loss=PACKET_LOSS), Rng(1), 0.0)


class _PlainCell:
    def __init__(self, vehicles: int, settle_s: float, measure_s: float) -> None:
        self.told = Measured("plain", vehicles, RF_KBPS)
        self.settle_s, self.end_s = settle_s, settle_s + measure_s
        self.dialect = load_dialect("ardupilotmega")
        self.mesh = network(vehicles, self.dialect)
        self._port: ApiParser[ApiFrame] = ApiParser(decode, escaped=True)
        self._kept: deque[ReceivePacket] = deque(maxlen=KEPT_PACKETS)
        self._parsers = {self.mesh.address(n): FrameParser(self.dialect) for n in range(vehicles)}
        self._statuses: set[int] = set()
        self._ordered_at: dict[int, float] = {}
        self._positions: dict[int, float] = {}
        """When the vehicle measured its newest position that was read, by sysid."""
        self._now = 0.0
        self._number = 0

    def run(self) -> Measured:
        script = self._script()
        next(script)
        count = self.told.vehicles
        while self._now < self.end_s:
            before = self._now
            self._now += STEP_S
            for heard in self._port.feed(self.mesh.step(self._now)):
                if isinstance(heard, TransmitStatus):
                    self._statuses.add(heard.frame_id)
                elif isinstance(heard, ReceivePacket):
                    self._kept.append(heard)
            next(script)
            if self._now >= self.settle_s and int(self._now / 0.2) > int(before / 0.2):
                known = self._positions
                self.told.ages_s += [self._now - known.get(sysid, 0.0) for sysid in range(1, count + 1)]
        self.told.heard = len(self._positions)
        return self.told

    def _script(self) -> Iterator[None]:
        """The script's own loop; it goes on at each `next`."""
        while True:
            for vehicle in range(self.told.vehicles):
                self._number = self._number % 255 + 1
                self._statuses.clear()
                began = self._now
                payload = self._payload(vehicle + 1)
                request = transmit_request(self._number, self.mesh.address(vehicle), payload)
                self.mesh.hear(api_frames.encode(request, escaped=True))
                while self._number not in self._statuses and self._now - began < SYNC_S:
                    yield
            if self._kept:
                packet = self._kept.popleft()
                for frame in self._parsers[packet.address].feed(packet.payload):
                    self._read(frame)
            yield

    def _payload(self, sysid: int) -> bytes:
        """An order if one is due, otherwise the script's own message."""
        first_at = self.settle_s + COMMAND_EVERY_S * sysid / self.told.vehicles
        if self._now < max(first_at, self._ordered_at.get(sysid, 0.0) + COMMAND_EVERY_S):
            return bytes(OWN_BYTES)
        self._ordered_at[sysid] = self._now
        self.told.commands += 1
        values = {"target_system": sysid, "target_component": 1, "command": GET_MESSAGE_INTERVAL, "param1": 33.0}
        return encode(self.dialect.by_name["COMMAND_LONG"], values, sysid=255, compid=25, seq=self._number)

    def _read(self, frame: Frame) -> None:
        if frame.name == "GLOBAL_POSITION_INT":
            self._positions[frame.sysid] = frame.fields()["time_boot_ms"] / 1000
        elif frame.name == "COMMAND_ACK" and frame.fields()["command"] == GET_MESSAGE_INTERVAL:
            self.told.acks_s.append(self._now - self._ordered_at[frame.sysid])


async def _daemon_cell(vehicles: int, folder: Path, settle_s: float, measure_s: float) -> Measured:
    """The daemon in service, at the emulated module."""
    told = Measured("skygcs", vehicles, RF_KBPS)
    keys = {"type": "xbee", "device": "the emulated module", "rf_kbps": RF_KBPS, "rtscts": False}
    daemon = made_daemon(folder, links={"mesh": keys})
    mesh = network(vehicles, daemon.dialect)
    ours, modules = socket.socketpair()
    with ours, modules, mock.patch("skygcs.links.xbee.open_port", lambda *_, **__: ours):
        for end in (ours, modules):
            end.setblocking(False)
        air = asyncio.create_task(_air(mesh, modules))
        async with started(daemon):
            await asyncio.sleep(settle_s)
            await CommandedDaemon(daemon, mesh.fleet.vehicles, told).measure(measure_s)
        air.cancel()
    return told


async def _air(mesh: XBeeMesh, port: socket.socket) -> None:
    """Pass bytes between the computer and the module."""
    loop = asyncio.get_running_loop()
    began = loop.time()
    while True:
        with contextlib.suppress(BlockingIOError):
            mesh.hear(port.recv(65536))
        if out := mesh.step(loop.time() - began):
            port.sendall(out)
        await asyncio.sleep(STEP_S)
