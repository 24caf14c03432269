"""The traffic of `make soak`: vehicles, companions, ground stations and a hostile peer, and what each of them may get.

Every frame that is sent is kept, byte for byte, with who must get it and who may. A receiver looks up the bytes that it
got: what is not there is misdelivered, damaged or doubled. That needs no parser of ours, and no rule of `core.routing`:
the rules below are those of docs/explanation/routing.md, written again.
"""

from __future__ import annotations

import random
import selectors
import socket
import struct
import time
from collections import Counter, deque
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, field
from typing import NamedTuple

from fastcrc.crc16 import mcrf4xx

from skygcs.core.mavlink.dialect import MessageInfo
from support.frames import dialect

AUTOPILOT, COMPANION, STATION_COMPID = 1, 191, 190
OWN = (255, 190)
"""The daemon's own ids, as the fleet file gives them."""

STATION_SYSIDS = (250, 251)
NOISE_SYSID = 238
"""No source has it: noise that looks like a frame claims it, so that none is taken for a known source's by chance."""

MOST_FRAMES = 60
"""In a datagram of ordinary traffic."""

RECEIVE_BUFFER_BYTES = 16 << 20
SO_RCVBUFFORCE = 33

TELEMETRY = (
    "ATTITUDE",
    "GLOBAL_POSITION_INT",
    "LOCAL_POSITION_NED",
    "GPS_RAW_INT",
    "SERVO_OUTPUT_RAW",
    "RC_CHANNELS",
    "SCALED_IMU",
    "SCALED_PRESSURE",
    "HIGHRES_IMU",
    "ATTITUDE_QUATERNION",
)
ONBOARD = (
    "NAMED_VALUE_FLOAT",
    "NAMED_VALUE_INT",
    "ODOMETRY",
    "OBSTACLE_DISTANCE",
    "DISTANCE_SENSOR",
    "VISION_POSITION_ESTIMATE",
)
"""All begin with a time of 4 or 8 bytes, which carries the frame's number, and none has a target."""

POSITION = {"lat": 437_806_000, "lon": -794_665_000, "alt": 120_000, "relative_alt": 10_000, "vx": 1, "hdg": 9_000}


@dataclass(frozen=True)
class Kind:
    """A message: its payload but for the number at its beginning."""

    msgid: int
    extra: bytes
    payload: bytes


def _kind(name: str) -> Kind:
    info: MessageInfo = dialect().find(name)
    payload = bytearray(info.pack(POSITION if name == "GLOBAL_POSITION_INT" else {}))
    payload[info.min_length - 1] |= 1  # so that nothing is trimmed and the number stands where it is
    return Kind(info.msgid, info.crc_extra_byte, bytes(payload[: info.min_length]))


@dataclass(slots=True)
class Entry:
    """One frame as it was sent. Masks have a bit per receiver."""

    must: int
    may: int
    due: int
    """How often it must come: a copy that the hostile peer happens to send within half a second is dropped, or this."""
    sent: int = 1
    got: dict[int, int] = field(default_factory=dict)


class Book:
    """What was sent in this leg, and what of it came where."""

    def __init__(self) -> None:
        self.entries: dict[bytes, Entry] = {}
        self.before: dict[bytes, Entry] = {}
        """The leg before this one: what comes late is not misdelivered."""
        self.totals: Counter[str] = Counter()
        self.strange: list[str] = []

    def sent(self, raw: bytes, must: int, may: int) -> None:
        self.totals["frames sent"] += 1
        known = self.entries.get(raw)
        if known is None:
            self.entries[raw] = Entry(must, must | may, due=1 if must else 0)
        else:  # a heartbeat whose number has come round
            known.sent += 1
            known.due += 1 if must else 0
            known.must |= must
            known.may |= must | may

    def received(self, raw: bytes, receiver: int, name: str) -> None:
        entry = self.entries.get(raw)
        late = self.before.get(raw)
        if late is not None and (entry is None or (late.may >> receiver & 1 and late.got.get(receiver, 0) < late.sent)):
            entry = late  # of two equal heartbeats the one of the leg before came late
        if entry is None:
            self.wrong("unknown or damaged", raw, name)
            return
        got = entry.got.get(receiver, 0) + 1
        entry.got[receiver] = got
        if not entry.may >> receiver & 1:
            self.wrong("misdelivered", raw, name)
        elif got > entry.sent:
            self.wrong("doubled", raw, name)
        else:
            self.totals["frames delivered"] += 1

    def wrong(self, what: str, raw: bytes, name: str) -> None:
        self.totals[what] += 1
        if len(self.strange) < 20:
            self.strange.append(f"{what} at {name}: {raw[:40].hex()} ({len(raw)} bytes)")

    def missing(self) -> Counter[int]:
        """Frames that must have come and did not, per receiver."""
        lost: Counter[int] = Counter()
        for entry in self.entries.values():
            left, receiver = entry.must, 0
            while left:
                if left & 1 and (short := entry.due - entry.got.get(receiver, 0)) > 0:
                    lost[receiver] += short
                left >>= 1
                receiver += 1
        return lost

    def next_leg(self) -> None:
        self.before, self.entries = self.entries, {}


class Receiver:
    """A socket whose datagrams are looked up in the book."""

    def __init__(self, index: int, name: str, book: Book, sysid: int) -> None:
        self.index, self.name, self.book, self.sysid = index, name, book, sysid
        self.sock = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        for option in (socket.SO_RCVBUF, SO_RCVBUFFORCE):
            with suppress(OSError):  # the second only as root; the first gives what net.core.rmem_max allows
                self.sock.setsockopt(socket.SOL_SOCKET, option, RECEIVE_BUFFER_BYTES)
        self.sock.bind(("127.0.0.1", 0))
        self.sock.setblocking(False)
        self.port: int = self.sock.getsockname()[1]
        self.router_at: tuple[str, int] | None = None
        self.on_command: Callable[[bytes], None] | None = None

    def drain(self) -> int:
        """Take what is there; the number of datagrams."""
        count = 0
        try:
            while count < 256:
                data, self.router_at = self.sock.recvfrom(65536)
                count += 1
                self._datagram(data)
        except BlockingIOError:
            pass
        return count

    def _datagram(self, data: bytes) -> None:
        at, end = 0, len(data)
        while at < end:
            size = _frame_size(data, at)
            raw = data[at : at + size]
            if not size or len(raw) < size:
                self.book.wrong("not a frame", data[at : at + 280], self.name)
                return
            sysid, compid, msgid = _ids(raw)
            if (sysid, compid) == OWN:
                self._own(raw, msgid)
            else:
                self.book.received(raw, self.index, self.name)
                if msgid == COMMAND_LONG and self.on_command is not None:
                    self.on_command(raw)
            at += size

    def _own(self, raw: bytes, msgid: int) -> None:
        """A message of the daemon's: for nobody by name, or for this one."""
        offset = dialect().messages[msgid].target_system_offset
        head = 10 if raw[0] == 0xFD else 6
        target = raw[head + offset] if 0 <= offset < raw[1] else 0
        self.book.totals["frames of the daemon"] += 1
        if target and self.sysid >= 0 and target != self.sysid:
            self.book.wrong("the daemon's, misdelivered", raw, self.name)


def _frame_size(data: bytes, at: int) -> int:
    if data[at] == 0xFD and len(data) - at >= 12:
        return data[at + 1] + (25 if data[at + 2] & 1 else 12)
    if data[at] == 0xFE and len(data) - at >= 8:
        return data[at + 1] + 8
    return 0


def _ids(raw: bytes) -> tuple[int, int, int]:
    if raw[0] == 0xFD:
        return raw[5], raw[6], raw[7] | raw[8] << 8 | raw[9] << 16
    return raw[3], raw[4], raw[5]


COMMAND_LONG, COMMAND_ACK = 76, 77
COMMAND_EXTRA, ACK_EXTRA, HEARTBEAT_EXTRA = bytes([152]), bytes([143]), bytes([50])
USER_COMMAND = 31010
"""MAV_CMD_USER_1: means nothing to anybody."""


class Source:
    """One (sysid, compid) and its sequence; makes frames. ``style``: "v2", "v1" or "signed"."""

    def __init__(self, sysid: int, compid: int, style: str = "v2") -> None:
        self.sysid, self.compid, self.style = sysid, compid, style
        self.seq = 0
        self.number = 0

    def frame(self, msgid: int, extra: bytes, payload: bytes) -> bytes:
        self.seq = seq = (self.seq + 1) & 0xFF
        if self.style == "v1":
            head = bytes((0xFE, len(payload), seq, self.sysid, self.compid, msgid))
        else:
            flags = 1 if self.style == "signed" else 0
            ids = (seq, self.sysid, self.compid, msgid & 0xFF, msgid >> 8 & 0xFF, msgid >> 16)
            head = bytes((0xFD, len(payload), flags, 0, *ids))
        body = head + payload
        raw = body + mcrf4xx(body[1:] + extra).to_bytes(2, "little")
        if self.style == "signed":  # whoever has no key passes it on as it is
            self.number += 1
            raw += b"\x01" + self.number.to_bytes(6, "little") + b"SIGNED"
        return raw

    def telemetry(self, kind: Kind) -> bytes:
        self.number += 1
        return self.frame(kind.msgid, kind.extra, struct.pack("<I", self.number) + kind.payload[4:])

    def heartbeat(self, type_: int, autopilot: int, *, mode: int = 4, base_mode: int = 81, status: int = 4) -> bytes:
        return self.frame(0, HEARTBEAT_EXTRA, struct.pack("<IBBBBB", mode, type_, autopilot, base_mode, status, 3))

    def command(self, sysid: int, compid: int) -> bytes:
        self.number += 1
        payload = struct.pack("<I24xHBBB", self.number, USER_COMMAND, sysid, compid, 1)
        return self.frame(COMMAND_LONG, COMMAND_EXTRA, payload)

    def ack(self, sysid: int, compid: int) -> bytes:
        self.number += 1
        payload = struct.pack("<HBBiBB", USER_COMMAND, 0, 0, self.number, sysid, compid)
        return self.frame(COMMAND_ACK, ACK_EXTRA, payload.rstrip(b"\0"))


class Vehicle:
    """An autopilot and its companion behind one socket, on one of the daemon's ports."""

    def __init__(self, receiver: Receiver, link: str, sysid: int) -> None:
        self.receiver, self.link = receiver, link
        styles = {7: "v1", 9: "signed"}
        self.autopilot = Source(sysid, AUTOPILOT, styles.get(sysid, "v2"))
        self.companion = Source(sysid, COMPANION)
        self.next_beat = 0.0


class World:
    """Everybody around the daemon. ``links``: (name, port, how many vehicles) of "field" (role peer), "air" (radio) and
    "near" (vehicle)."""

    def __init__(self, links: dict[str, tuple[int, int]], seed: int) -> None:
        self.rng = random.Random(seed)
        self.book = Book()
        self.links = links
        self.selector = selectors.DefaultSelector()
        self.receivers: list[Receiver] = []
        self.stations = [self._receiver(f"station {n}", sysid) for n, sysid in enumerate(STATION_SYSIDS)]
        self.station_sources = [Source(sysid, STATION_COMPID) for sysid in STATION_SYSIDS]
        self.vehicles: list[Vehicle] = []
        for link, (_, count) in links.items():
            for _ in range(count):
                sysid = len(self.vehicles) + 1
                vehicle = Vehicle(self._receiver(f"vehicle {sysid} ({link})", sysid), link, sysid)
                vehicle.receiver.on_command = lambda raw, v=vehicle: self._answer(v, raw)
                self.vehicles.append(vehicle)
        self.hostile = self._receiver("the hostile peer", -1)
        self.telemetry = [_kind(name) for name in TELEMETRY]
        self.onboard = [_kind(name) for name in ONBOARD]
        self.beats_at = 0.0
        everybody = self._mask(self.receivers)
        of_link = {link: self._mask([v.receiver for v in self.vehicles if v.link == link]) for link in links}
        self.ground = self._mask(self.stations)
        self.peers = of_link["field"]
        self.everybody = everybody
        self.hostile_bit = 1 << self.hostile.index

    def _receiver(self, name: str, sysid: int) -> Receiver:
        made = Receiver(len(self.receivers), name, self.book, sysid)
        self.receivers.append(made)
        self.selector.register(made.sock, selectors.EVENT_READ, made)
        return made

    @staticmethod
    def _mask(receivers: list[Receiver]) -> int:
        return sum(1 << r.index for r in receivers)

    def close(self) -> None:
        self.selector.close()
        for receiver in self.receivers:
            receiver.sock.close()

    # -- who gets what (docs/explanation/routing.md)

    def hearers(self, vehicle: Vehicle, source: Source) -> int:
        """Of what this source broadcasts. Telemetry of vehicles, and all that comes over links of role vehicle or
        radio, goes to no such link; a companion on a plain link is no vehicle. The hostile peer is on "air"."""
        plain = vehicle.link == "field" and source is vehicle.companion
        return (self.everybody if plain else self.ground | self.peers) & ~(1 << vehicle.receiver.index)

    # -- sending

    def beat(self, now: float) -> None:
        """Heartbeats: of everybody once a second."""
        for vehicle in self.vehicles:
            if now < vehicle.next_beat:
                continue
            vehicle.next_beat = now + 1.0
            self._send(vehicle, [(vehicle.autopilot, vehicle.autopilot.heartbeat(2, 12))])
            self._send(vehicle, [(vehicle.companion, vehicle.companion.heartbeat(18, 8, mode=0, base_mode=0))])
        if now >= self.beats_at:
            self.beats_at = now + 1.0
            for station, source in zip(self.stations, self.station_sources, strict=True):
                raw = source.heartbeat(6, 8, mode=0, base_mode=0)
                self._send_from(station, raw, self.everybody & ~(1 << station.index), 0)

    def speak(self) -> int:
        """One datagram of some vehicle; the number of its frames. One in twenty is junk instead."""
        rng = self.rng
        vehicle = rng.choice(self.vehicles)
        if rng.random() < 0.05:
            self.junk(vehicle.receiver.sock, self.links[vehicle.link][0])
            return 1
        size = rng.choice(
            (1, 1, 1, 1, rng.randint(2, 9), rng.randint(2, 9), rng.randint(10, 30), rng.randint(31, MOST_FRAMES))
        )
        companion_share = rng.choice((0.0, 0.0, 0.1, 0.5))
        frames = []
        for _ in range(size):
            if rng.random() < companion_share:
                frames.append((vehicle.companion, vehicle.companion.telemetry(rng.choice(self.onboard))))
            else:
                frames.append((vehicle.autopilot, vehicle.autopilot.telemetry(rng.choice(self.telemetry))))
        self._send(vehicle, frames)
        return size

    def command(self) -> None:
        """A command of a ground station to a vehicle or its companion; the hostile peer may have claimed its id."""
        rng = self.rng
        vehicle, n = rng.choice(self.vehicles), rng.randrange(len(self.stations))
        raw = self.station_sources[n].command(vehicle.autopilot.sysid, rng.choice((AUTOPILOT, COMPANION)))
        self._send_from(self.stations[n], raw, 1 << vehicle.receiver.index, self.hostile_bit)

    def _answer(self, vehicle: Vehicle, raw: bytes) -> None:
        sysid, compid, _ = _ids(raw)
        if sysid not in STATION_SYSIDS or vehicle.autopilot.style != "v2":
            return
        answer = vehicle.autopilot.ack(sysid, compid)
        station = self.stations[STATION_SYSIDS.index(sysid)]
        self.book.sent(answer, 1 << station.index, 0)
        vehicle.receiver.sock.sendto(answer, ("127.0.0.1", self.links[vehicle.link][0]))
        self.book.totals["datagrams sent"] += 1

    def _send(self, vehicle: Vehicle, frames: list[tuple[Source, bytes]]) -> None:
        masks = {source: self.hearers(vehicle, source) for source in {source for source, _ in frames}}
        for source, raw in frames:
            self.book.sent(raw, masks[source] & ~self.hostile_bit, masks[source])
        self._datagram(vehicle.receiver.sock, b"".join(raw for _, raw in frames), self.links[vehicle.link][0])

    def _send_from(self, station: Receiver, raw: bytes, must: int, may: int) -> None:
        """From a ground station to where the daemon's datagrams came from."""
        if station.router_at is not None:
            self.book.sent(raw, must & ~self.hostile_bit, may | must)
            self._datagram(station.sock, raw, station.router_at[1])

    def _datagram(self, sock: socket.socket, data: bytes, port: int) -> None:
        self.book.totals["datagrams sent"] += 1
        sock.sendto(data, ("127.0.0.1", port))

    # -- junk

    def junk(self, sock: socket.socket, port: int) -> None:
        """Noise, or what is left of a frame of nobody's; nothing of it is to be delivered."""
        self.book.totals["junk datagrams"] += 1
        self._datagram(sock, self.noise(), port)

    def noise(self) -> bytes:
        """Bytes in which no frame is, by chance neither: what looks like a header claims a system that nobody has."""
        rng = self.rng
        kind = rng.randrange(4)
        if kind == 0:
            return _claimed(rng.randbytes(rng.randint(0, 300)))
        if kind == 1:
            return _claimed(bytes((0xFD, rng.randrange(256))) + rng.randbytes(rng.randint(0, 30)))
        frame = bytearray(Source(NOISE_SYSID, 1).telemetry(rng.choice(self.telemetry)))
        if kind == 2:
            return bytes(frame[: rng.randint(1, len(frame) - 1)])
        at = rng.randrange(10, len(frame))
        frame[at] ^= 1 << rng.randrange(8)  # one bit: no CRC misses it
        return bytes(frame)

    # -- receiving

    def receive(self, wait_s: float) -> int:
        """Datagrams that came within this time, or at once what is there; their number."""
        return sum(key.data.drain() for key, _ in self.selector.select(max(wait_s, 0.0)))


def _claimed(data: bytes) -> bytes:
    """With NOISE_SYSID wherever a header might have its system id."""
    changed = bytearray(data)
    for at, byte in enumerate(data):
        behind = {0xFD: 5, 0xFE: 3}.get(byte)
        if behind is not None and at + behind < len(data):
            changed[at + behind] = NOISE_SYSID
    return bytes(changed)


STRANGERS = 40
"""Sockets that stay open for longer than the daemon sends there (a peer expires after 60 s): a port that is given to
another program meanwhile would get what is none of its."""


class HostilePeer:
    """One peer on the port "air" that sends what nobody should: forged heartbeats of vehicles, a sweep over ids, frames
    that are none, and huge datagrams. And, now and then, a stranger under a new address says one thing and is gone."""

    SWEEP_PER_S = 60
    STEP_S = 0.1

    def __init__(self, world: World) -> None:
        self.world = world
        self.rng = random.Random(world.rng.random())
        self.port = world.links["air"][0]
        self.sock = world.hostile.sock
        self.may = world.ground | world.peers
        self.sources: dict[tuple[int, int], Source] = {}
        self.swept = 0
        self.steps = 0
        self.sent: Counter[str] = Counter()
        self.strangers: deque[socket.socket] = deque()

    def step(self) -> None:
        """To be called every STEP_S."""
        self.steps += 1
        for _ in range(int(self.SWEEP_PER_S * self.STEP_S)):
            self._sweep()
        if self.steps % 5 == 0:
            self._forge()
        if self.steps % 2 == 0:
            self._malformed()
        if self.steps % 100 == 0:
            self._huge()
        if self.steps % 30 == 0:
            self._stranger()

    def _frames(self, what: str, frames: list[bytes]) -> None:
        self.sent[what] += 1
        for raw in frames:
            self.world.book.sent(raw, 0, self.may)
        self.world._datagram(self.sock, b"".join(frames), self.port)

    def _source(self, sysid: int, compid: int) -> Source:
        return (
            Source(sysid, compid)
            if len(self.sources) > 40_000
            else self.sources.setdefault((sysid, compid), Source(sysid, compid))
        )

    def _sweep(self) -> None:
        """Systems 100 to 220, all components of each. Two a second claim to be autopilots: the fleet is full of them
        within the warm-up, and replaces them from then on."""
        self.swept += 1
        sysid, compid = 100 + self.swept // 255 % 121, 1 + self.swept % 255
        source = self._source(sysid, compid)
        if compid % 32 == 1:
            self._frames("swept autopilots", [source.heartbeat(2, 12)])
        else:
            self._frames("swept sources", [source.telemetry(self.rng.choice(self.world.telemetry))])

    def _forge(self) -> None:
        """A heartbeat with the ids of one of the first six vehicles: another mode, disarmed, or of no autopilot."""
        vehicle = self.world.vehicles[self.rng.randrange(6)]
        source = self._source(vehicle.autopilot.sysid, AUTOPILOT)
        type_, autopilot = self.rng.choice(((2, 12), (2, 3), (0, 8), (18, 8)))
        mode, base_mode = self.rng.choice(((4, 81), (9, 81), (4, 209), (0, 0)))
        self._frames("forged heartbeats", [source.heartbeat(type_, autopilot, mode=mode, base_mode=base_mode)])

    def _malformed(self) -> None:
        self.sent["malformed datagrams"] += 1
        self.world.junk(self.sock, self.port)

    def _huge(self) -> None:
        """65,507 bytes: frames without end, magic bytes only, or noise."""
        rng, world = self.rng, self.world
        turn = self.steps // 100 % 4
        if turn == 0:
            source, frames, size = self._source(100, 1), [], 0
            while size < 65_000:
                frames.append(source.telemetry(rng.choice(world.telemetry)))
                size += len(frames[-1])
            self._frames("datagrams of 1,000 frames", frames)
            return
        self.sent["huge datagrams"] += 1
        data = {1: b"\xfd" * 65_507, 2: b"\xfe\x09\x00\xee\x01\x00" * 10_917, 3: _claimed(rng.randbytes(65_507))}[turn]
        world._datagram(self.sock, data, self.port)

    def _stranger(self) -> None:
        self.sent["strangers"] += 1
        source = self._source(221 + self.rng.randrange(15), 1)
        raw = source.telemetry(self.world.telemetry[0])
        self.world.book.sent(raw, 0, self.may)
        sock = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.strangers.append(sock)
        self.world._datagram(sock, raw, self.port)
        if len(self.strangers) > STRANGERS:
            self.strangers.popleft().close()

    def close(self) -> None:
        for sock in self.strangers:
            sock.close()


class UdpSocket(NamedTuple):
    """What the kernel says of one: bytes that wait to be received, and datagrams for which there was no room."""

    waiting: int
    drops: int


def udp_sockets(inodes: set[int]) -> dict[int, UdpSocket]:
    """Those of these inodes that are UDP sockets (/proc/net/udp)."""
    found = {}
    with open("/proc/net/udp") as table:
        for line in table.readlines()[1:]:
            words = line.split()
            if int(words[9]) in inodes:
                found[int(words[9])] = UdpSocket(int(words[4].partition(":")[2], 16), int(words[12]))
    return found


def wait_until(condition: Callable[[], bool], world: World, limit_s: float) -> bool:
    """Go on receiving until it is so; False if it never was."""
    until = time.monotonic() + limit_s
    while not condition():
        if time.monotonic() > until:
            return False
        world.receive(0.05)
    return True
