"""A vehicle that several ground stations hear over UDP: a log of what arrives there, and streams of orders to it."""

from __future__ import annotations

import contextlib
import json
import socket
import threading
import time
from dataclasses import dataclass
from typing import NamedTuple

from skygcs.core.mavlink.parser import FrameParser
from support.process import DaemonProcess
from support.routed import DIALECT, heartbeat

BEATS_HZ = 5.0


def boot_s() -> float:
    """The clock of the log."""
    return time.clock_gettime(time.CLOCK_BOOTTIME)


class Arrival(NamedTuple):
    at_s: float
    sysid: int
    """Of the ground station that sent it."""
    name: str


class HeardVehicle:
    """Use as a context manager. ``arrivals`` is the log; a thread of its own writes it."""

    def __init__(self, sysid: int, ports: dict[str, int]) -> None:
        """``ports``: of the stations' UDP servers on loopback."""
        self.arrivals: list[Arrival] = []
        self._ports = ports
        self._sysid = sysid
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.bind(("127.0.0.1", 0))
        self._socket.settimeout(0.05)
        self._ended = threading.Event()
        self._threads = [threading.Thread(target=work, daemon=True) for work in (self._beat, self._read)]

    def __enter__(self) -> HeardVehicle:
        for thread in self._threads:
            thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._ended.set()
        for thread in self._threads:
            thread.join()
        self._socket.close()

    def of(self, sysid: int, since_s: float = 0.0) -> list[Arrival]:
        """What arrived from a station."""
        return [a for a in list(self.arrivals) if a.sysid == sysid and a.at_s >= since_s]

    def _beat(self) -> None:
        seq = 0
        while not self._ended.wait(1 / BEATS_HZ):
            seq = (seq + 1) & 0xFF
            for port in self._ports.values():
                with contextlib.suppress(OSError):  # nobody listens there now
                    self._socket.sendto(heartbeat(self._sysid, seq=seq), ("127.0.0.1", port))

    def _read(self) -> None:
        parsers: dict[tuple[str, int], FrameParser] = {}
        while not self._ended.is_set():
            try:
                data, address = self._socket.recvfrom(2048)
            except OSError:
                continue
            now = boot_s()
            for frame in parsers.setdefault(address, FrameParser(DIALECT)).feed_datagram(data):
                self.arrivals.append(Arrival(now, frame.sysid, frame.name))


@dataclass
class Orders:
    """A client that asks a daemon for a message to the vehicle, again and again, and waits for no answer: what a daemon
    that is stopped has not read yet waits in its socket. Use as a context manager."""

    daemon: DaemonProcess
    vehicle: str
    rate_hz: float = 20.0

    def __enter__(self) -> Orders:
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._ended.set()
        self._thread.join()

    def _run(self) -> None:
        params = {"name": "PING", "fields": {}, "target": self.vehicle}
        line = json.dumps({"jsonrpc": "2.0", "id": 1, "method": "messages.send", "params": params}).encode() + b"\n"
        link: socket.socket | None = None
        while not self._ended.wait(1 / self.rate_hz):
            try:
                if link is None:
                    link = socket.socket(socket.AF_UNIX)
                    link.connect(str(self.daemon.socket))
                    link.setblocking(False)
                link.sendall(line)
                with contextlib.suppress(BlockingIOError):
                    link.recv(65536)
            except BlockingIOError:
                continue
            except OSError:
                if link is not None:
                    link.close()
                link = None
        if link is not None:
            link.close()
