"""The parts of the compiled fast path by themselves: one on a real socket between objects that only count."""

from __future__ import annotations

import socket
from collections.abc import Callable
from typing import Any

from skygcs.core.routing.source_statistics import SourceStats
from skygcs.links import fast_path
from skygcs.links.peers import Address
from support.fast_path import AMPLE, encoded
from support.frames import dialect
from support.hosts import drained

__all__ = ["AMPLE", "Bench", "Channel", "ParserCounts", "Slot", "attitude"]

ATTITUDE = 30


def attitude(seq: int, *, sysid: int = 1, compid: int = 1, number: int = 0) -> bytes:
    """A frame of 40 bytes."""
    return encoded("ATTITUDE", number.to_bytes(4, "little") + b"\x01" * 24, sysid, compid, seq & 0xFF)


class Channel:
    """What the fast path sees of `skygcs.links.base.Channel`."""

    def __init__(self) -> None:
        self.rx_frames = self.rx_bytes = self.tx_frames = self.tx_bytes = self.tx_dropped = 0
        self.last_rx_at = 0.0


class ParserCounts:
    def __init__(self) -> None:
        self.good = 0


class Slot:
    def __init__(self) -> None:
        self.frame: Any = None
        self.at = 0.0
        self.count = 0


class Bench:
    """A table, a fast path, one vehicle's socket that sends to it and one ground station's that receives."""

    def __init__(self, *, recording: bool = True) -> None:
        table = fast_path.new_table(dialect(), recording=recording)
        assert table is not None, "there is no compiled fast path"
        self.table = table
        self.sockets: list[socket.socket] = []
        self.vehicle, self.station, self.server = (self.socket() for _ in range(3))
        self.now = 1000.0
        self.left: list[bytes] = []
        self.errors: list[OSError] = []
        self.taken = 0
        self.on_left: Callable[[bytes, Address, float], None] = lambda data, address, now: None
        self.channel, self.counts, self.target = Channel(), ParserCounts(), Channel()
        self.stats = SourceStats(1, 1)
        self.heard: dict[int, float] = {}
        self.fast_path = self.new_fast_path(self.server)
        self.out = self.new_out(self.target)
        self.fast_path.add_peer(self.vehicle.getsockname(), self.channel, self.counts, 1)

    def socket(self) -> socket.socket:
        sock = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        sock.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4 << 20)
        sock.bind(("127.0.0.1", 0))
        sock.setblocking(False)
        self.sockets.append(sock)
        return sock

    def new_fast_path(self, server: socket.socket) -> Any:
        return fast_path.new_fast_path(
            self.table,
            server.fileno(),
            clock=lambda: self.now,
            slow=self._on_left,
            after=self._after,
            broken=self.errors.append,
        )

    def new_out(self, target: Channel, *, whole: bool = False) -> Any:
        return fast_path.new_out(self.server.fileno(), self.station.getsockname(), target, whole=whole)

    def _on_left(self, data: bytes, address: Address, now: float) -> None:
        self.left.append(data)
        self.on_left(data, address, now)

    def _after(self) -> None:
        self.taken += 1
        self.table.take()

    def open_flow(self, msgid: int = ATTITUDE, *, source: int = 0x0101, **more: Any) -> None:
        """Further frames of this source and message go to the ground station."""
        values = {"outs": (self.out,), "slot": None, "watches": None, "steady": None, "again": None} | more
        self.fast_path.add_flow(self.vehicle.getsockname(), source, msgid, self.stats, self.heard, *values.values())

    def learn(self) -> None:
        """Python makes the first swap of the memory of duplicates."""
        self.table.first_heard_on((1 << 40) - 1, 1, self.now)

    def send(self, *datagrams: bytes) -> None:
        for data in datagrams:
            self.vehicle.sendto(data, self.server.getsockname())

    def received(self) -> list[bytes]:
        """What the ground station got since the last call."""
        return drained(self.station)

    def close(self) -> None:
        self.fast_path.close()
        for sock in self.sockets:
            sock.close()
