"""pymavlink as an independent client: it packs and parses, a plain socket carries."""

from __future__ import annotations

import socket
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as mav

from support.hanging import HANG_S


class Outbox:
    """What pymavlink believes is a file."""

    def __init__(self) -> None:
        self.data = b""

    def write(self, data: bytes) -> None:
        self.data += bytes(data)


class PymavPeer:
    """Packs as (sysid, compid), parses whatever is handed to `parse`. ``link`` (send/recv) is up to the subclass."""

    def __init__(self, sysid: int, compid: int) -> None:
        self._outbox = Outbox()
        self.mav = mav.MAVLink(self._outbox, srcSystem=sysid, srcComponent=compid)
        self.mav.robust_parsing = True
        self.seen: list[Any] = []

    def pack(self, message: Any) -> bytes:
        self._outbox.data = b""
        self.mav.send(message)
        return self._outbox.data

    def heartbeat(self, *, vehicle: bool = True, custom_mode: int = 4, armed: bool = False, version: int = 2) -> bytes:
        kind, autopilot = (2, 3) if vehicle else (6, 8)
        base = 0x51 | (0x80 if armed else 0)
        message = mav.MAVLink_heartbeat_message(kind, autopilot, base, custom_mode, 3, 3)
        self._outbox.data = b""
        self.mav.send(message, force_mavlink1=version == 1)
        return self._outbox.data

    def command(self, target: int, component: int, command: int = 400, **params: float) -> bytes:
        values = [params.get(f"p{n}", 0.0) for n in range(1, 8)]
        return self.pack(mav.MAVLink_command_long_message(target, component, command, 0, *values))

    def parse(self, data: bytes) -> None:
        for message in self.mav.parse_buffer(data) or []:
            self.seen.append(message)

    def names(self, *, without: tuple[str, ...] = ()) -> list[tuple[str, int, int]]:
        """(type, sysid, compid) of all that was seen."""
        return [
            (m.get_type(), m.get_srcSystem(), m.get_srcComponent()) for m in self.seen if m.get_type() not in without
        ]


class UdpPeer(PymavPeer):
    """A pymavlink client on a UDP socket of its own."""

    def __init__(self, sysid: int, compid: int, port: int) -> None:
        super().__init__(sysid, compid)
        self.socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.socket.bind(("127.0.0.1", 0))
        self.socket.connect(("127.0.0.1", port))
        self.socket.setblocking(False)

    def send(self, data: bytes) -> None:
        self.socket.send(data)

    def poll(self) -> None:
        while True:
            try:
                self.parse(self.socket.recv(65536))
            except (BlockingIOError, ConnectionRefusedError):
                return

    def close(self) -> None:
        self.socket.close()


class TcpPeer(PymavPeer):
    """A pymavlink client on a TCP connection."""

    def __init__(self, sysid: int, compid: int, port: int) -> None:
        super().__init__(sysid, compid)
        self.socket = socket.create_connection(("127.0.0.1", port), timeout=HANG_S)
        self.socket.setblocking(False)

    def send(self, data: bytes) -> None:
        self.socket.sendall(data)

    def poll(self) -> None:
        while True:
            try:
                data = self.socket.recv(65536)
            except BlockingIOError:
                return
            if not data:
                return
            self.parse(data)

    def close(self) -> None:
        self.socket.close()
