"""How simulated vehicles are reached from outside: one class per kind of port.

What a port hears goes to all its vehicles, what they send goes to everybody at the port: they share it like a radio.
"""

from __future__ import annotations

import asyncio
import contextlib
import os
import pty
import socket
import termios
import time
import tty
from abc import ABC, abstractmethod
from pathlib import Path
from typing import cast

from skygcs.cli.serial_ports import port_rate, set_port_rate
from skygcs.core.mavlink.dialect import Dialect
from skygcs.core.mavlink.frame import Frame
from skygcs.core.mavlink.parser import FrameParser
from skygcs.errors import LinkError, explain_address_error
from skygcs.sim.ground_radio import GroundRadio
from skygcs.sim.radio_fleet import RadioFleet
from skygcs.sim.radio_status import SimRadio
from skygcs.sim.tdm import GROUND
from skygcs.sim.vehicle import SimVehicle
from skygcs.sim.vehicle_group import SimFleet
from skygcs.sim.xbee_mesh import XBeeMesh

MAX_BACKLOG_BYTES = 65536
"""A TCP connection that does not read loses frames instead of holding the vehicles up."""

READ_BYTES = 65536

DRIVER_BYTES = 4096
"""Buffer of a serial port's driver: more is not taken from the writer until the slow line has passed some on."""


class SimClock:
    """Seconds of the simulated world since `start`: real ones times ``speedup``."""

    def __init__(self, speedup: float) -> None:
        self._speedup = speedup
        self._began = time.monotonic()

    def start(self) -> None:
        self._began = time.monotonic()

    def now(self) -> float:
        return (time.monotonic() - self._began) * self._speedup


class SimPort(ABC):
    """Some vehicles and the way to them. `open`, then `pump` again and again, then `close`."""

    def __init__(
        self, vehicles: list[SimVehicle], dialect: Dialect, clock: SimClock, radio: SimRadio | None = None
    ) -> None:
        self.fleet = SimFleet(vehicles)
        self.dialect = dialect
        self._clock = clock
        self._radio = radio

    @abstractmethod
    async def open(self) -> str:
        """How to reach it, for a person. Raises LinkError."""

    @abstractmethod
    def close(self) -> None:
        """Idempotent."""

    @abstractmethod
    def write(self, frames: list[bytes]) -> None:
        """Send these; what cannot be sent now is lost."""

    def hear(self, frames: list[Frame]) -> None:
        """Frames from outside; what the vehicles answer goes out at once."""
        now = self._clock.now()
        for frame in frames:
            self.fleet.on_frame(frame, now)
            if self._radio is not None:
                self._radio.on_frame(frame, now)
        if frames:
            self.pump()

    def pump(self) -> None:
        """Let the vehicles live on until now, and send what they sent."""
        now = self._clock.now()
        frames = self.fleet.step(now)
        if self._radio is not None:
            frames += self._radio.step(now)
        if frames:
            self.write(frames)


class UdpPort(SimPort, asyncio.DatagramProtocol):
    """Sends to one address, a datagram per frame; hears whoever answers to its own port."""

    def __init__(self, vehicles: list[SimVehicle], dialect: Dialect, clock: SimClock, address: tuple[str, int]) -> None:
        super().__init__(vehicles, dialect, clock)
        self._address = address
        self._parser = FrameParser(dialect)
        self._transport: asyncio.DatagramTransport | None = None

    async def open(self) -> str:
        host, port = self._address
        loop = asyncio.get_running_loop()
        try:
            found = await loop.getaddrinfo(host, port, type=socket.SOCK_DGRAM)
            family, _, _, _, address = found[0]
            # the local address the kernel would choose to get there, without tying the socket to the peer
            with socket.socket(family, socket.SOCK_DGRAM) as probe:
                probe.connect(address)
                local = probe.getsockname()[0]
            transport, _ = await loop.create_datagram_endpoint(lambda: self, local_addr=(local, 0), family=family)
        except OSError as error:
            raise LinkError(f"udp {host}:{port}: {error.strerror or error}") from None
        self._address = (str(address[0]), int(address[1]))
        self._transport = transport
        own_port = transport.get_extra_info("sockname")[1]
        return f"udp to {host}:{port} from port {own_port}"

    def close(self) -> None:
        if self._transport is not None:
            self._transport.close()
            self._transport = None

    def write(self, frames: list[bytes]) -> None:
        if self._transport is not None:
            for frame in frames:
                self._transport.sendto(frame, self._address)

    def datagram_received(self, data: bytes, addr: tuple[str | object, int]) -> None:
        self.hear(self._parser.feed_datagram(data))

    def error_received(self, exc: Exception) -> None:
        return  # nobody listens there yet


class TcpPort(SimPort):
    """Listens; every connection hears every vehicle."""

    def __init__(self, vehicles: list[SimVehicle], dialect: Dialect, clock: SimClock, address: tuple[str, int]) -> None:
        super().__init__(vehicles, dialect, clock)
        self._address = address
        self._server: asyncio.Server | None = None
        self.connections: set[asyncio.Transport] = set()

    async def open(self) -> str:
        host, port = self._address
        loop = asyncio.get_running_loop()
        try:
            self._server = await loop.create_server(lambda: _TcpConnection(self), host, port)
        except OSError as error:
            raise LinkError(f"tcp {host}:{port}: {explain_address_error(error, host, port)}") from None
        return f"tcp on {host}:{self._server.sockets[0].getsockname()[1]}"

    def close(self) -> None:
        if self._server is not None:
            self._server.close()
            self._server = None
        for transport in list(self.connections):
            transport.abort()
        self.connections.clear()

    def write(self, frames: list[bytes]) -> None:
        data = b"".join(frames)
        for transport in self.connections:
            if transport.get_write_buffer_size() < MAX_BACKLOG_BYTES:
                transport.write(data)


class _TcpConnection(asyncio.Protocol):
    def __init__(self, port: TcpPort) -> None:
        self._port = port
        self._parser = FrameParser(port.dialect)
        self._transport: asyncio.Transport | None = None

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        self._transport = cast(asyncio.Transport, transport)  # uvloop's is none by inheritance
        self._port.connections.add(self._transport)

    def data_received(self, data: bytes) -> None:
        self._port.hear(self._parser.feed(data))

    def connection_lost(self, exc: Exception | None) -> None:
        if self._transport is not None:
            self._port.connections.discard(self._transport)


class PtyPort(SimPort):
    """A pseudo-terminal with a symlink to it: opened by others as a serial port with a radio. With ``air`` it is the
    ground's port of an emulated network, slow and lossy as that is, whose radio has a command line. Raises ValueError
    if no radio has that network's serial rate."""

    def __init__(
        self,
        vehicles: list[SimVehicle],
        dialect: Dialect,
        clock: SimClock,
        path: str,
        radio: SimRadio | None,
        air: RadioFleet | None = None,
    ) -> None:
        super().__init__(vehicles, dialect, clock, radio)
        self._air = air
        self._ground = None if air is None else GroundRadio(air)
        self._full = False
        self._path = Path(path)
        self._parser = FrameParser(dialect)
        self._master = -1
        self._slave = -1
        self._device = ""

    async def open(self) -> str:
        if self._path.exists() and not self._path.is_symlink():
            raise LinkError(f"pty {self._path}: something that is not a symlink is there already")
        try:
            self._master, self._slave = pty.openpty()
            tty.setraw(self._slave)
            os.set_blocking(self._master, False)
            if self._ground is not None:
                set_port_rate(self._slave, self._ground.baud)
            self._device = os.ttyname(self._slave)
            # made beside and renamed: whoever waits for the path never sees it half made
            beside = self._path.with_name(f".{self._path.name}.{os.getpid()}")
            beside.symlink_to(self._device)
            beside.replace(self._path)
        except OSError as error:
            self.close()
            raise LinkError(f"pty {self._path}: {error.strerror or error}") from None
        # our own slave end stays open: otherwise every close by a user would hang the terminal up
        asyncio.get_running_loop().add_reader(self._master, self._on_readable)
        return f"pty {self._path}"

    def close(self) -> None:
        if self._master < 0:
            return
        with contextlib.suppress(RuntimeError):
            asyncio.get_running_loop().remove_reader(self._master)
        os.close(self._master)
        os.close(self._slave)
        self._master = self._slave = -1
        with contextlib.suppress(OSError):
            if os.readlink(self._path) == self._device:  # not the one of another process that took the place
                self._path.unlink()

    def hear(self, frames: list[Frame]) -> None:
        if self._air is None:
            super().hear(frames)
            return
        now = self._clock.now()
        for frame in frames:
            self._air.uplink(frame.raw, now)

    def pump(self) -> None:
        if self._air is None:
            super().pump()
            return
        now = self._clock.now()
        assert self._ground is not None
        if output := self._ground.step(self._air.step(now), now, port_rate(self._master)):
            self.write([output])
        if self._full and self._air.network.backlog_bytes(GROUND, now) < DRIVER_BYTES / 2:
            self._full = False
            asyncio.get_running_loop().add_reader(self._master, self._on_readable)

    def write(self, frames: list[bytes]) -> None:
        data = b"".join(frames)
        try:
            written = os.write(self._master, data)
        except BlockingIOError:
            written = 0
        if written < len(data):  # nobody reads: like a UART, forget what was not fetched
            termios.tcflush(self._slave, termios.TCIFLUSH)

    def _on_readable(self) -> None:
        try:
            data = os.read(self._master, READ_BYTES if self._air is None else DRIVER_BYTES)
        except (BlockingIOError, OSError):
            return
        if self._ground is not None:
            data = self._ground.hear(data, self._clock.now(), port_rate(self._master))
        self.hear(self._parser.feed(data))
        if self._air is not None and self._air.network.backlog_bytes(GROUND, self._clock.now()) >= DRIVER_BYTES:
            self._full = True
            asyncio.get_running_loop().remove_reader(self._master)


class XBeePort(PtyPort):
    """A pseudo-terminal in front of the ground's module of an emulated XBee network."""

    def __init__(self, mesh: XBeeMesh, dialect: Dialect, clock: SimClock, path: str) -> None:
        super().__init__(mesh.fleet.vehicles, dialect, clock, path, None)
        self._mesh = mesh

    def pump(self) -> None:
        if output := self._mesh.step(self._clock.now()):
            self.write([output])

    def _on_readable(self) -> None:
        try:
            data = os.read(self._master, DRIVER_BYTES)
        except (BlockingIOError, OSError):
            return
        self._mesh.hear(data)
        self.pump()
