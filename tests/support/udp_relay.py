"""Between vehicles and the daemon: a UDP relay that cuts, delays and watches.

Every vehicle keeps a socket of its own towards the daemon, so that the daemon sees the peers that it would see without
the relay. What the vehicles send is read here with pymavlink before any cut or delay: the truth of what a vehicle does
does not depend on the daemon.
"""

from __future__ import annotations

import heapq
import itertools
import math
import random
import selectors
import socket
import threading
import time
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

from pymavlink import mavutil
from pymavlink.dialects.v20 import ardupilotmega as mav

from support.firmware_air import EmulatedAir

TICK_S = 0.005
EARTH_M_PER_DEG = 111_319.5


@dataclass
class Truth:
    """What one vehicle's autopilot says of itself, as it leaves the vehicle."""

    sysid: int
    armed: bool = False
    armed_at: float = -math.inf
    """Of the last heartbeat that said armed."""
    mode: str = ""
    modes: list[tuple[float, str]] = field(default_factory=list)
    """Time (monotonic) and name of every change of mode."""
    lat_deg: float = 0.0
    lon_deg: float = 0.0
    alt_rel_m: float = 0.0
    alt_amsl_m: float = 0.0
    speed_mps: float = 0.0
    heartbeat_at: float = -math.inf
    texts: list[tuple[float, str]] = field(default_factory=list)
    counts: Counter[str] = field(default_factory=Counter)
    track: list[tuple[float, float, float, float]] = field(default_factory=list)
    """Time, latitude, longitude, height above home."""
    clock: list[tuple[float, float]] = field(default_factory=list)
    """Time, and the vehicle's own seconds since its start, of each point of the track."""

    def on_message(self, message: Any, now: float) -> None:
        kind = message.get_type()
        self.counts[kind] += 1
        if kind == "HEARTBEAT" and message.autopilot != mav.MAV_AUTOPILOT_INVALID:
            self.heartbeat_at = now
            self.armed = bool(message.base_mode & mav.MAV_MODE_FLAG_SAFETY_ARMED)
            if self.armed:
                self.armed_at = now
            mode = mavutil.mode_string_v10(message)
            if mode != self.mode:
                self.mode = mode
                self.modes.append((now, mode))
        elif kind == "GLOBAL_POSITION_INT":
            self.lat_deg, self.lon_deg = message.lat / 1e7, message.lon / 1e7
            self.alt_rel_m, self.alt_amsl_m = message.relative_alt / 1000, message.alt / 1000
            self.speed_mps = math.hypot(message.vx, message.vy, message.vz) / 100
            self.track.append((now, self.lat_deg, self.lon_deg, self.alt_rel_m))
            self.clock.append((now, message.time_boot_ms / 1000))
        elif kind == "STATUSTEXT":
            self.texts.append((now, message.text.rstrip("\0")))

    def modes_since(self, at: float) -> list[str]:
        """The mode at that time and those that followed."""
        before = [name for when, name in self.modes if when <= at]
        return before[-1:] + [name for when, name in self.modes if when > at]

    def pace(self, since: float, until: float) -> float:
        """How fast its clock went between two times: less than 1 where its simulator had too little of the computer."""
        seen = [look for look in self.clock if since <= look[0] <= until]
        (began, began_s), (ended, ended_s) = seen[0], seen[-1]
        return (ended_s - began_s) / (ended - began)

    def texts_since(self, at: float) -> list[str]:
        return [text for when, text in self.texts if when > at]

    def metres_from(self, lat_deg: float, lon_deg: float) -> float:
        """Horizontal distance of where it is."""
        return metres(self.lat_deg, self.lon_deg, lat_deg, lon_deg)


def metres(lat_a: float, lon_a: float, lat_b: float, lon_b: float) -> float:
    """Horizontal distance of near places (degrees)."""
    east = (lon_b - lon_a) * math.cos(math.radians(lat_a))
    return math.hypot(lat_b - lat_a, east) * EARTH_M_PER_DEG


class UdpRelay(threading.Thread):
    """``port`` is where vehicles send to (0: a free one), ``daemon_port`` where it goes on. `cut_down` and `cut_up`
    (system ids), `delay_down_s`, `delay_up_s` and `loss` (of datagrams, each way) may be set at any time; down is from
    the vehicle."""

    def __init__(self, daemon_port: int, port: int = 0) -> None:
        super().__init__(name="relay", daemon=True)
        self._front = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._front.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 1 << 20)
        self._front.bind(("127.0.0.1", port))
        self.port = int(self._front.getsockname()[1])
        self.daemon_port = daemon_port
        self.cut_down: set[int] = set()
        self.cut_up: set[int] = set()
        self.delay_down_s = 0.0
        self.delay_up_s = 0.0
        self.loss = 0.0
        self.sent_up: Counter[str] = Counter()
        self.on_up: Callable[[Any, float], None] | None = None
        """Called in this thread with each message that goes on to a vehicle, and the time: it is neither cut nor
        lost."""
        self.truths: dict[int, Truth] = {}
        self.watch: Callable[[int, Any, float], None] | None = None
        """Called in this thread with the system id, each message of a vehicle's autopilot, and the time."""
        self.air: EmulatedAir | None = None
        """Radios that everything goes through instead, while it is set."""
        self._backs: dict[tuple[str, int], socket.socket] = {}
        self._sysids: dict[tuple[str, int], int] = {}
        self._readers: dict[Any, Any] = {}
        self._due: list[tuple[float, int, socket.socket, bytes, tuple[str, int] | None]] = []
        self._order = itertools.count()
        self._random = random.Random(daemon_port)
        self._ending = threading.Event()
        self._selector = selectors.DefaultSelector()
        self._selector.register(self._front, selectors.EVENT_READ)

    def clear(self) -> None:
        """Pass everything on at once again."""
        self.cut_down, self.cut_up = set(), set()
        self.delay_down_s = self.delay_up_s = self.loss = 0.0

    def stop(self) -> None:
        self._ending.set()
        self.join(5)
        for link in (self._front, *self._backs.values()):
            link.close()

    def run(self) -> None:
        while not self._ending.is_set():
            for key, _ in self._selector.select(TICK_S):
                link = key.fileobj
                assert isinstance(link, socket.socket)
                try:
                    data, address = link.recvfrom(65535)
                except OSError:
                    continue  # the daemon is not there just now
                if link is self._front:
                    self._down(data, address)
                else:
                    self._up(data, key.data)
            self._over_the_air()
            now = time.monotonic()
            while self._due and self._due[0][0] <= now:
                _, _, link, data, to = heapq.heappop(self._due)
                self._send(link, data, to)

    def _down(self, data: bytes, address: tuple[str, int]) -> None:
        now = time.monotonic()
        back = self._backs.get(address)
        if back is None:
            back = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
            back.connect(("127.0.0.1", self.daemon_port))
            back.setblocking(False)
            self._backs[address] = back
            self._selector.register(back, selectors.EVENT_READ, address)
        reader = self._readers.setdefault(address, _reader())
        for message in reader.parse_buffer(data) or []:
            if message.get_type() == "BAD_DATA":
                continue
            if message.get_srcComponent() == 1:
                sysid = message.get_srcSystem()
                self._sysids[address] = sysid
                self.truths.setdefault(sysid, Truth(sysid)).on_message(message, now)
                if self.watch is not None:
                    self.watch(sysid, message, now)
            if self.air is not None and address in self._sysids and self._sysids[address] not in self.cut_down:
                # also what pymavlink does not know, which has no ids here: a frame that is numbered and dropped is lost
                self.air.from_vehicle(self._sysids[address], bytes(message.get_msgbuf()))
        if self.air is not None:
            return
        if self._sysids.get(address) in self.cut_down or self._random.random() < self.loss:
            return
        self._later(self.delay_down_s, back, data, None)

    def _up(self, data: bytes, address: tuple[str, int]) -> None:
        reader = self._readers.setdefault(("up", address), _reader())
        lost = self._sysids.get(address) in self.cut_up or self._random.random() < self.loss
        for message in reader.parse_buffer(data) or []:
            self.sent_up[message.get_type()] += 1
            if self.on_up is not None and not lost:
                self.on_up(message, time.monotonic())
        if lost:
            return
        self._later(self.delay_up_s, self._front, data, address)

    def _over_the_air(self) -> None:
        if self.air is None:
            return
        addresses = {sysid: address for address, sysid in self._sysids.items()}
        for sysid, raw in self.air.step():
            if sysid in addresses and sysid not in self.cut_up:
                self._send(self._front, raw, addresses[sysid])
                if self.on_up is not None:
                    for message in self._readers.setdefault(("air", sysid), _reader()).parse_buffer(raw) or []:
                        if getattr(message, "target_system", 0) in (0, sysid):  # every node hears the ground's radio
                            self.on_up(message, time.monotonic())

    def _later(self, delay_s: float, link: socket.socket, data: bytes, to: tuple[str, int] | None) -> None:
        if delay_s <= 0:
            self._send(link, data, to)
        else:
            heapq.heappush(self._due, (time.monotonic() + delay_s, next(self._order), link, data, to))

    def _send(self, link: socket.socket, data: bytes, to: tuple[str, int] | None) -> None:
        try:
            link.send(data) if to is None else link.sendto(data, to)
        except OSError:
            return  # nobody listens there just now


def _reader() -> Any:
    reader = mav.MAVLink(None)
    reader.robust_parsing = True
    return reader
