"""An emulated network of XBee-PRO 900HP modules: in API mode at the ground, in transparent mode at each vehicle.

Pure, time is an argument; seeded. What happens to a byte of a vehicle: serial port at its baud -> the module's buffer,
which loses what does not fit -> a packet as soon as NP bytes are there or the port was silent for RO characters -> the
air, which one packet has at a time, hop by hop -> a receive packet at the ground's port. A packet that is not
acknowledged is repeated; after the last repetition it is lost, and the ground's transmit status says so.

Calibrated with Digi's measured throughput of one hop without encryption, 105.5 kbit/s at 200 on air and 8.8 at 10 (user
guide 90002173, P2MP throughput, 100,000 bytes over a port of 115200 baud): the two give HOP_S and HEADER_BITS. Left
out: route discovery (routes are known), sleeping nodes, frequency hopping, the baud of the ground's port, and
collisions, which count as loss.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial

from skygcs.core.mavlink.dialect import Dialect
from skygcs.core.mavlink.parser import FrameParser
from skygcs.core.xbee.api_frames import BROADCAST, ApiParser, FrameType, encode
from skygcs.sim.rng import Rng
from skygcs.sim.vehicle import SimVehicle
from skygcs.sim.vehicle_group import SimFleet
from skygcs.sim.vehicle_state import TICK_S

HOP_S = 0.0082
HEADER_BITS = 200
"""Bits on air of one packet over one hop besides its payload, with its acknowledgement: see the module's docstring."""

MAC_RETRIES = 10
"""RR of a 900HP as it is delivered."""

BROADCAST_TIMES = 4
"""MT + 1: how often each module sends a broadcast."""

SERIAL_BUFFER_BYTES = 2100
"""From the port to the air (Digi 90002173, "serial buffers": about 2.1 kB)."""

GROUND_BUFFERS = 5
"""Transmit requests that the ground's module keeps; one more is answered with "out of buffers"."""

SILENT_CHARACTERS = 3
"""RO as it is delivered."""

BITS_PER_BYTE = 10

FIRST_SERIAL = 0x0013A20041000000
"""Digi's part of the addresses; the ground's module has this one, vehicle i (from 0) the one i + 1 above."""

DONE, ERROR, NO_SUCH_COMMAND, BAD_PARAMETER, NO_ANSWER = 0, 1, 2, 3, 4
"""Statuses of AT responses."""

NO_ACK, OUT_OF_BUFFERS, TOO_LARGE = 0x01, 0x32, 0x74
"""Delivery statuses."""

WIDTH = {"ID": 2, "CM": 8, "NP": 2, "AP": 1, "PL": 1, "EE": 1, "BD": 4, "HV": 2, "VR": 2, "SH": 4, "SL": 4, "DH": 4,
         "DL": 4, "TO": 1, "MT": 1, "RR": 1, "NH": 1, "HP": 1, "BR": 1, "RO": 1}  # fmt: skip
"""Bytes of each register's value."""

READ_ONLY = frozenset({"NP", "HV", "VR", "SH", "SL"})
ACTIONS = frozenset({"WR", "AC", "FR"})


@dataclass(frozen=True, slots=True)
class MeshConfig:
    """One network. ``hops`` of the vehicles from the ground, 1 where none is given."""

    rf_kbps: float = 200.0
    payload_bytes: int = 256
    """NP."""
    baud: int = 57600
    """Serial rate of the vehicles' ports."""
    loss: float = 0.0
    """Share of transmissions over one hop that are lost, by chance."""
    hops: tuple[int, ...] = ()
    api_mode: int = 2
    """AP of the ground's module."""
    network_id: int = 0x7FFF
    encrypted: bool = False

    def packet_s(self, size: int) -> float:
        """One transmission of so many bytes of payload over one hop."""
        return HOP_S + (HEADER_BITS + 8 * size) / (self.rf_kbps * 1000)


@dataclass(slots=True)
class _Packet:
    """Something to be sent by one node. ``frame_id``: of the ground's request, 0 for none."""

    target: int
    payload: bytes
    frame_id: int = 0
    answer: bytes = b""
    """Instead of a payload: data of a frame for the ground's port, when it has arrived."""


@dataclass(slots=True)
class MeshStats:
    """Counts of what became of packets."""

    up: int = 0
    down: int = 0
    broadcasts: int = 0
    retries: int = 0
    lost: int = 0
    overflow_bytes: int = 0
    busy_s: float = 0.0
    """Time in which the air was taken."""


@dataclass(slots=True)
class _Node:
    """A module at a vehicle."""

    address: int
    vehicle: SimVehicle
    parser: FrameParser
    hops: int
    registers: dict[str, bytes]
    cut_off: bool = False
    """Another network id: neither hears the other."""
    waiting: deque[tuple[float, bytes]] = field(default_factory=deque)
    """Pieces from the autopilot and when their last byte has passed the port."""
    held: int = 0
    port_free_at: float = 0.0
    answers: deque[_Packet] = field(default_factory=deque)


class XBeeMesh:
    """`hear` what is written to the ground module's port, `step` often for what comes out of it."""

    def __init__(self, vehicles: list[SimVehicle], dialect: Dialect, config: MeshConfig, rng: Rng, now: float) -> None:
        self.config = config
        self.fleet = SimFleet(vehicles)
        self.stats = MeshStats()
        self.unplugged: set[int] = set()
        """Vehicles (from 0) whose modules have no power."""
        self._rng = rng
        self._dialect = dialect
        self._nodes = [self._node(number, vehicle) for number, vehicle in enumerate(vehicles)]
        self._registers = self._made(FIRST_SERIAL, "ground") | {"AP": bytes([config.api_mode])}
        self._requests: ApiParser[bytes] = ApiParser(bytes, escaped=config.api_mode == 2)
        self._ground: deque[_Packet] = deque()
        self._air_free_at = now
        self._turn = 0
        self._arrivals: deque[tuple[float, Callable[[float], None]]] = deque()
        """Actions to run when a packet has passed the air, in order of their times."""
        self._out: list[bytes] = []

    @property
    def escaped(self) -> bool:
        """True if the ground's module is in API mode 2."""
        return self._registers["AP"] == b"\x02"

    def address(self, vehicle: int) -> int:
        """64-bit address of the module at a vehicle (from 0)."""
        return self._nodes[vehicle].address

    def hear(self, data: bytes) -> None:
        """Bytes written to the port of the ground's module."""
        for request in self._requests.feed(data):
            self._request(request)

    def step(self, now: float) -> bytes:
        """Live on until ``now``; the bytes that came out of the ground module's port."""
        for node in self._nodes:
            for raw in node.vehicle.step(now):
                self._from_autopilot(node, raw, now)
        while self._air_free_at <= now and (sender := self._next_sender(now)) is not None:
            self._send(sender, now)
        while self._arrivals and self._arrivals[0][0] <= now:
            self._arrivals.popleft()[1](now)
        out, self._out = self._out, []
        return b"".join(out)

    def restart(self) -> None:
        """The ground's module loses power and comes back."""
        self._ground.clear()
        self._requests = ApiParser(bytes, escaped=self.escaped)
        self._emit(bytes((FrameType.MODEM_STATUS, 0)))

    # -- the vehicles' modules

    def _node(self, number: int, vehicle: SimVehicle) -> _Node:
        hops = self.config.hops[number] if number < len(self.config.hops) else 1
        address = FIRST_SERIAL + number + 1
        registers = self._made(address, f"vehicle{number + 1}")
        return _Node(address, vehicle, FrameParser(self._dialect), max(hops, 1), registers)

    def _from_autopilot(self, node: _Node, raw: bytes, now: float) -> None:
        if node.held + len(raw) > SERIAL_BUFFER_BYTES:
            self.stats.overflow_bytes += len(raw)
            return
        node.port_free_at = max(node.port_free_at, now) + len(raw) * BITS_PER_BYTE / self.config.baud
        node.waiting.append((node.port_free_at, raw))
        node.held += len(raw)

    def _packet_of(self, node: _Node, now: float) -> _Packet | None:
        """The next packet of a transparent module: NP bytes, or what there is once its port is silent."""
        if node.answers:
            return node.answers.popleft()
        silent_s = SILENT_CHARACTERS * BITS_PER_BYTE / self.config.baud
        passed = [piece for at, piece in node.waiting if at <= now]
        size = sum(map(len, passed))
        if not passed or (size < self.config.payload_bytes and now < node.port_free_at + silent_s):
            return None
        data = b"".join(passed)[: self.config.payload_bytes]
        left = len(data)
        while left:
            at, piece = node.waiting.popleft()
            if len(piece) > left:
                node.waiting.appendleft((at, piece[left:]))
                break
            left -= len(piece)
        node.held -= len(data)
        return _Packet(FIRST_SERIAL, data)

    # -- the air

    def _next_sender(self, now: float) -> tuple[_Node | None, _Packet] | None:
        """Return which module has the air next, of all in turn; None is the ground's module."""
        senders: list[_Node | None] = [None, *self._nodes]
        for offset in range(len(senders)):
            number = (self._turn + offset) % len(senders)
            node = senders[number]
            if node is None:
                packet = self._ground.popleft() if self._ground else None
            else:
                packet = None if node.address - FIRST_SERIAL - 1 in self.unplugged else self._packet_of(node, now)
            if packet is not None:
                self._turn = number + 1
                return node, packet
        return None

    def _send(self, sender: tuple[_Node | None, _Packet], now: float) -> None:
        node, packet = sender
        # it may have been ready any time since the last step
        began = self._air_free_at = max(self._air_free_at, now - TICK_S)
        if node is not None:
            arrived, _ = self._transmitted(node.hops, len(packet.payload) + len(packet.answer))
            arrived = arrived and not node.cut_off
            self.stats.down += 1
            if arrived:
                data = packet.answer or (
                    bytes([FrameType.RECEIVE_PACKET]) + node.address.to_bytes(8, "big") + b"\xff\xfe\x01"
                    + packet.payload
                )  # fmt: skip
                self._later(partial(self._emit, data))
        elif packet.target == BROADCAST:
            self._broadcast(packet)
        else:
            self._unicast(packet)
        self.stats.busy_s += self._air_free_at - began

    def _transmitted(self, hops: int, size: int) -> tuple[bool, int]:
        """Return whether a packet arrived over so many hops, and how often it was repeated; the air is taken for as
        long."""
        repeated = 0
        for _ in range(hops):
            for attempt in range(MAC_RETRIES + 1):
                self._air_free_at += self.config.packet_s(size)
                if self._rng.random() >= self.config.loss:
                    repeated += attempt
                    break
            else:
                self.stats.lost += 1
                return False, repeated + MAC_RETRIES
        self.stats.retries += repeated
        return True, repeated

    def _unicast(self, packet: _Packet) -> None:
        self.stats.up += 1
        node = next((node for node in self._nodes if node.address == packet.target), None)
        if node is None or node.cut_off or packet.target - FIRST_SERIAL - 1 in self.unplugged:
            self._air_free_at += (MAC_RETRIES + 1) * self.config.packet_s(len(packet.payload))
            arrived, repeated = False, MAC_RETRIES
            self.stats.lost += 1
        else:
            arrived, repeated = self._transmitted(node.hops, len(packet.payload))
        if node is not None and arrived:
            if packet.answer:
                self._later(partial(self._remote_command, node, packet))
            else:
                self._later(partial(_to_autopilot, node, packet.payload))
        elif packet.answer:
            self._later(partial(self._emit, _remote_head(packet) + bytes([NO_ANSWER])))
        if packet.frame_id and not packet.answer:
            status = 0 if arrived else NO_ACK
            self._later(partial(self._emit, _status(packet, min(repeated, 255), status)))

    def _broadcast(self, packet: _Packet) -> None:
        """Sent several times by the ground's module, and as often by each module that heard it; no acknowledgement."""
        self.stats.broadcasts += 1
        heard = [node for n, node in enumerate(self._nodes) if n not in self.unplugged and not node.cut_off]
        times = BROADCAST_TIMES * (1 + len(heard))
        self._air_free_at += times * self.config.packet_s(len(packet.payload))
        for node in heard:
            if self._rng.random() >= self.config.loss**BROADCAST_TIMES:
                self._later(partial(_to_autopilot, node, packet.payload))
        if packet.frame_id:
            self._later(partial(self._emit, _status(packet, 0, 0)))

    def _later(self, action: Callable[[float], None]) -> None:
        """When the packet that has the air now has passed it."""
        self._arrivals.append((self._air_free_at, action))

    # -- the ground module's port

    def _emit(self, data: bytes, now: float = 0.0) -> None:
        """A frame out of the port; ``now`` does not matter."""
        self._out.append(encode(data, escaped=self.escaped))

    def _request(self, data: bytes) -> None:
        kind = data[0]
        if kind == FrameType.AT_COMMAND and len(data) >= 4:
            self._local_command(data)
        elif kind == FrameType.TRANSMIT_REQUEST and len(data) >= 14:
            packet = _Packet(int.from_bytes(data[2:10], "big"), data[14:], data[1])
            problem = TOO_LARGE if len(packet.payload) > self.config.payload_bytes else 0
            if len(self._ground) >= GROUND_BUFFERS:
                problem = OUT_OF_BUFFERS
            if not problem:
                self._ground.append(packet)
            elif packet.frame_id:
                self._emit(_status(packet, 0, problem))
        elif kind == FrameType.REMOTE_AT_COMMAND and len(data) >= 15:
            self._ground.append(_Packet(int.from_bytes(data[2:10], "big"), b"", data[1], data))

    def _local_command(self, data: bytes) -> None:
        head = bytes((FrameType.AT_RESPONSE, data[1])) + data[2:4]
        name = data[2:4].decode("ascii", "replace")
        if name == "ND":
            for node in self._nodes:
                if node.address - FIRST_SERIAL - 1 not in self.unplugged and not node.cut_off:
                    self._air_free_at += 2 * self.config.packet_s(40)
                    self._emit(head + bytes([DONE]) + _identity(node))
            return
        if name == "AP" and data[4:] not in (b"", b"\1", b"\2"):  # transparent: not emulated at the ground
            self._emit(head + bytes([BAD_PARAMETER]))
            return
        status, value = _command(self._registers, name, data[4:])
        self._emit(head + bytes([status]) + value)
        self._requests.escaped = self.escaped
        for node in self._nodes:
            node.cut_off = node.registers["ID"] != self._registers["ID"]

    def _remote_command(self, node: _Node, packet: _Packet, now: float) -> None:
        request = packet.answer
        status, value = _command(node.registers, request[13:15].decode("ascii", "replace"), request[15:])
        node.cut_off = node.registers["ID"] != self._registers["ID"]
        self._emit(_remote_head(packet) + bytes([status]) + value)

    def _made(self, address: int, name: str) -> dict[str, bytes]:
        config = self.config
        values = {"ID": config.network_id, "CM": 0xFFFFFFFFFFFFFFFF, "NP": config.payload_bytes, "AP": 0, "PL": 4,
                  "EE": int(config.encrypted), "BD": 6, "HV": 0x3842, "VR": 0x8073, "SH": address >> 32,
                  "SL": address & 0xFFFFFFFF, "DH": FIRST_SERIAL >> 32, "DL": FIRST_SERIAL & 0xFFFFFFFF, "TO": 0xC0,
                  "MT": BROADCAST_TIMES - 1, "RR": MAC_RETRIES, "NH": 7, "HP": 0, "BR": 1,
                  "RO": SILENT_CHARACTERS}  # fmt: skip
        return {register: value.to_bytes(WIDTH[register], "big") for register, value in values.items()} | {
            "NI": name.encode("ascii")
        }


def _command(registers: dict[str, bytes], name: str, value: bytes) -> tuple[int, bytes]:
    """Status and value of an AT command's answer."""
    if name in ACTIONS:
        return DONE, b""
    if name == "KY":  # may be written, never read
        return (DONE, b"") if len(value) in (16, 32) else (BAD_PARAMETER, b"") if value else (DONE, b"")
    if name not in registers:
        return NO_SUCH_COMMAND, b""
    if not value:
        return DONE, registers[name]
    if name in READ_ONLY or (name == "NI" and len(value) > 20) or (name != "NI" and len(value) > WIDTH[name]):
        return BAD_PARAMETER, b""
    registers[name] = value if name == "NI" else value.rjust(WIDTH[name], b"\0")
    return DONE, b""


def _identity(node: _Node) -> bytes:
    """A node's part of the answer to ND."""
    tail = b"\xff\xfe\x01\x00\xc1\x05\x10\x1e"  # no parent, router, status, Digi's profile, Digi
    return b"\xff\xfe" + node.address.to_bytes(8, "big") + node.registers["NI"] + b"\0" + tail


def _remote_head(packet: _Packet) -> bytes:
    request = packet.answer
    address, name = packet.target.to_bytes(8, "big"), request[13:15]
    return bytes((FrameType.REMOTE_AT_RESPONSE, request[1])) + address + b"\xff\xfe" + name


def _status(packet: _Packet, repeated: int, delivery: int) -> bytes:
    return bytes((FrameType.TRANSMIT_STATUS, packet.frame_id, 0xFF, 0xFE, repeated, delivery, 0))


def _to_autopilot(node: _Node, payload: bytes, now: float) -> None:
    for frame in node.parser.feed(payload):
        node.vehicle.on_frame(frame, now)
