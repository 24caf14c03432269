"""An emulated multipoint network of SiK-like radios: one at the ground, one on each vehicle, sharing the air in turns.

Pure, time is an argument; seeded. The model is open SiK multipoint's: strict round-robin, a slot of two packets
of 252 bytes for each node and a sync slot, ArduPilot/SiK's serial buffers. It is calibrated only against published
figures (docs/explanation/airtime.md says which, and what it leaves out); the closed RFD900x firmware may be otherwise.

What happens to a byte: serial port at its baud -> the radio's transmit buffer, which loses what does not fit -> whole
frames into the packets of the node's next slot -> air, where a packet may be lost -> the receiver's output buffer,
which loses what does not fit -> its serial port at its baud.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, field
from math import log10

from skygcs.core.mavlink.dialect import Dialect
from skygcs.core.mavlink.frame import encode
from skygcs.core.radio_link.capacity import (
    BITS_PER_BYTE,
    PACKET_BYTES,
    SLOT_BITS,
    SLOT_BYTES,
    SLOT_LATENCY_S,
    SYNC_BITS,
    SYNC_LATENCY_S,
)
from skygcs.sim.radio_status import HEARTBEAT_TIMEOUT_S, RADIO_COMPID, RADIO_SYSID, REPORT_EVERY_S
from skygcs.sim.rng import Rng

TX_BUFFER_BYTES = 1850
RX_BUFFER_BYTES = 645
"""rx_buf and tx_buf of ArduPilot/SiK's serial.c on Si1000 boards: from the serial port to the air, and back."""

GROUND = 0
"""The node whose serial port is the ground station's."""

PACKETS_PER_SLOT = SLOT_BYTES // PACKET_BYTES

RSSI_AT_1_M = 230.0
RSSI_PER_DECADE = 38.0
"""RSSI of SiK radios is some 1.9 counts per dB; 20 dB per decade of distance in free space."""

NOISE = 60

LOST_BELOW = 30
"""Counts between signal and noise under which packets are lost besides (16 dB): all of them at 0."""


@dataclass(frozen=True, slots=True)
class TdmConfig:
    """One network. ``nodes`` counts the ground's; node ids are 0 to nodes - 1."""

    nodes: int
    air_kbps: float = 64.0
    baud: int = 57600
    loss: float = 0.0
    """Share of packets that are lost by chance, each independently."""
    burst_loss: float = 0.0
    """Share of time in which a fade swallows every packet of a node."""
    burst_s: float = 1.0
    """Mean duration of a fade."""
    rtscts: bool = False
    """True if a program that writes to a radio waits while its buffer is full, instead of losing bytes in it."""
    node_ids: tuple[int, ...] | None = None
    """Configured node ids of the radios, where they are wrong: nodes of one id send in one slot, and both are lost."""
    distances_m: tuple[float, ...] = ()
    """Distances of the vehicles' nodes from the ground; 50 m where none is given."""
    slot_bits: float = SLOT_BITS
    slot_latency_s: float = SLOT_LATENCY_S
    sync_bits: float = SYNC_BITS
    sync_latency_s: float = SYNC_LATENCY_S
    packet_bytes: int = PACKET_BYTES
    """Timing of the firmware; open SiK's unless it is another."""

    def __post_init__(self) -> None:
        if self.nodes < 2:
            raise ValueError("a network has at least two nodes")
        if self.air_kbps <= 0 or self.baud <= 0:
            raise ValueError("rates are above 0")

    @property
    def sync_s(self) -> float:
        return self.sync_latency_s + self.sync_bits / (self.air_kbps * 1000)

    @property
    def slot_s(self) -> float:
        return self.slot_latency_s + self.slot_bits / (self.air_kbps * 1000)

    @property
    def round_s(self) -> float:
        return self.sync_s + self.nodes * self.slot_s

    @property
    def packet_s(self) -> float:
        """On air, of a full one, its share of the slot's overhead with it."""
        return self.slot_bits / (self.air_kbps * 1000) / PACKETS_PER_SLOT


@dataclass(slots=True)
class NodeStats:
    """Counts of what became of the frames of one node."""

    sent_frames: int = 0
    sent_bytes: int = 0
    overflow_bytes: int = 0
    """Lost in the transmit buffer: more was written than the air took."""
    lost_packets: int = 0
    output_overflow_bytes: int = 0
    """Lost in the output buffer: the air brought more than the serial port took."""


class _Serial:
    """One direction of a serial port: bytes leave it at its baud."""

    __slots__ = ("_free_at", "byte_s")

    def __init__(self, baud: int) -> None:
        self.byte_s = BITS_PER_BYTE / baud
        self._free_at = 0.0

    def through(self, size: int, now: float) -> float:
        """When ``size`` bytes that are given to it now have passed."""
        self._free_at = max(self._free_at, now) + size * self.byte_s
        return self._free_at

    def held(self, now: float) -> int:
        """Bytes that have not passed."""
        return max(0, round((self._free_at - now) / self.byte_s))


@dataclass(slots=True)
class _Node:
    """One radio. ``arriving``: (when the last byte is in, frame) still on the serial line into it."""

    serial_in: _Serial
    serial_out: _Serial
    arriving: deque[tuple[float, bytes]] = field(default_factory=deque)
    buffer: deque[bytes] = field(default_factory=deque)
    buffered: int = 0
    output: deque[tuple[float, bytes]] = field(default_factory=deque)
    """(when its last byte has left the serial port, bytes)"""
    heard_heartbeat_at: float = -1e9
    next_report: float = 0.0
    seq: int = 0
    faded_until: float = -1.0
    stats: NodeStats = field(default_factory=NodeStats)


class TdmNetwork:
    """`write` what a node's serial port is given, `step` often: it returns what comes out of the ports.

    Frames of the ground reach every node, those of a vehicle the ground only: its node's destination is the master.
    """

    def __init__(self, config: TdmConfig, dialect: Dialect, rng: Rng, now: float = 0.0) -> None:
        self.config = config
        self._report = dialect.by_name["RADIO_STATUS"]
        self._rng = rng
        self._nodes = [_Node(_Serial(config.baud), _Serial(config.baud)) for _ in range(config.nodes)]
        ids = config.node_ids or tuple(range(config.nodes))
        self._slots: list[list[int]] = [[n for n, i in enumerate(ids) if i == slot] for slot in range(config.nodes)]
        self._slot = 0
        self._slot_at = now + config.sync_s
        self._clock = now

    def stats(self, node: int) -> NodeStats:
        return self._nodes[node].stats

    def backlog_bytes(self, node: int, now: float) -> int:
        """Written and not yet in the radio: what a UART's buffer still holds."""
        return self._nodes[node].serial_in.held(now)

    def txbuf_percent(self, node: int) -> int:
        """Free, of the transmit buffer."""
        return max(0, 100 - round(100 * self._nodes[node].buffered / TX_BUFFER_BYTES))

    def has_room(self, node: int, size: int) -> bool:
        """True if CTS lets a frame into this radio; without CTS always."""
        at = self._nodes[node]
        waiting = sum(len(raw) for _, raw in at.arriving)
        return not self.config.rtscts or at.buffered + waiting + size <= TX_BUFFER_BYTES

    def write(self, node: int, raw: bytes, now: float) -> None:
        """One frame to a node's serial port; it takes its time to get in."""
        at = self._nodes[node]
        at.arriving.append((at.serial_in.through(len(raw), now), raw))

    def step(self, now: float) -> list[tuple[int, bytes]]:
        """Go on until ``now``: (node, frame) for each that has left a serial port, in order of time per node."""
        while self._slot_at <= now:
            self._take_in(self._slot_at)
            self._send_slot(self._slot, self._slot_at)
            self._slot += 1
            self._slot_at += self.config.slot_s
            if self._slot == self.config.nodes:
                self._slot = 0
                self._slot_at += self.config.sync_s
        self._take_in(now)
        self._clock = now
        out = []
        for number, node in enumerate(self._nodes):
            self._tell(number, node, now)
            while node.output and node.output[0][0] <= now:
                out.append((number, node.output.popleft()[1]))
        return out

    # -- the inside

    def _take_in(self, now: float) -> None:
        """Take in what has passed the serial lines: it is in the buffers, or lost for want of room."""
        for node in self._nodes:
            while node.arriving and node.arriving[0][0] <= now:
                at, raw = node.arriving.popleft()
                if _is_heartbeat(raw):
                    if at - node.heard_heartbeat_at > HEARTBEAT_TIMEOUT_S:
                        node.next_report = at
                    node.heard_heartbeat_at = at
                room = TX_BUFFER_BYTES - node.buffered
                if len(raw) > room:
                    node.stats.overflow_bytes += len(raw) - room
                    raw = raw[:room]
                if raw:
                    node.buffer.append(raw)
                    node.buffered += len(raw)

    def _send_slot(self, slot: int, now: float) -> None:
        senders = self._slots[slot]
        for number in senders:
            for index, packet in enumerate(self._packets(number)):
                arrives = now + self.config.slot_latency_s + (index + 1) * self.config.packet_s
                collides = len(senders) > 1
                receivers = range(1, self.config.nodes) if number == GROUND else (GROUND,)
                for receiver in receivers:
                    if collides or self._is_lost(number or receiver, now):
                        self._nodes[number].stats.lost_packets += 1
                    else:
                        self._receive(receiver, packet, arrives)

    def _packets(self, number: int) -> list[list[bytes]]:
        """Return what goes in one slot: whole frames, as many as two packets hold. A longer one has a packet for
        itself."""
        node = self._nodes[number]
        packets: list[list[bytes]] = []
        for _ in range(PACKETS_PER_SLOT):
            packet: list[bytes] = []
            size = 0
            while node.buffer and (size + len(node.buffer[0]) <= self.config.packet_bytes or not packet):
                raw = node.buffer.popleft()
                packet.append(raw)
                size += len(raw)
                node.buffered -= len(raw)
                node.stats.sent_frames += 1
                node.stats.sent_bytes += len(raw)
            if packet:
                packets.append(packet)
        return packets

    def _receive(self, number: int, packet: Sequence[bytes], now: float) -> None:
        node = self._nodes[number]
        for raw in packet:
            room = RX_BUFFER_BYTES - node.serial_out.held(now)
            if len(raw) > room:
                node.stats.output_overflow_bytes += len(raw) - max(0, room)
                raw = raw[: max(0, room)]
            if raw:
                node.output.append((node.serial_out.through(len(raw), now), raw))

    def _is_lost(self, vehicle_node: int, now: float) -> bool:
        """A packet between the ground and this node."""
        config, node = self.config, self._nodes[vehicle_node]
        if config.burst_loss > 0:
            if now < node.faded_until:
                return True
            good_s = config.burst_s * (1 - config.burst_loss) / config.burst_loss
            if self._rng.happens(min(1.0, config.round_s / good_s)):
                node.faded_until = now + config.burst_s * 2 * self._rng.random()
                return True
        margin = self.rssi(vehicle_node) - NOISE
        weak = 0.0 if margin >= LOST_BELOW else 1 - max(0.0, margin) / LOST_BELOW
        return self._rng.happens(min(1.0, config.loss + weak))

    def rssi(self, vehicle_node: int) -> float:
        """Between the ground and this node, before chance."""
        distances = self.config.distances_m
        distance_m = distances[vehicle_node - 1] if 0 < vehicle_node <= len(distances) else 50.0
        return max(0.0, RSSI_AT_1_M - RSSI_PER_DECADE * log10(max(distance_m, 1.0)))

    def _tell(self, number: int, node: _Node, now: float) -> None:
        """RADIO_STATUS out of a port into which heartbeats go; left out where it does not fit, as the firmware does."""
        if now - node.heard_heartbeat_at > HEARTBEAT_TIMEOUT_S or now < node.next_report:
            return
        node.next_report = max(node.next_report + REPORT_EVERY_S, now)
        peer = number or 1 + node.seq % (self.config.nodes - 1)  # not known: the one heard last
        signal = round(self.rssi(peer) + self._rng.spread(4))
        fields = {
            "rssi": min(254, max(0, signal)),
            "remrssi": min(254, max(0, signal + round(self._rng.spread(4)))),
            "txbuf": self.txbuf_percent(number),
            "noise": NOISE + round(self._rng.spread(4)),
            "remnoise": NOISE + round(self._rng.spread(4)),
            "rxerrors": node.stats.output_overflow_bytes & 0xFFFF,
            "fixed": 0,
        }
        raw = encode(self._report, fields, sysid=RADIO_SYSID, compid=RADIO_COMPID, seq=node.seq)
        node.seq = (node.seq + 1) & 0xFF
        if RX_BUFFER_BYTES - node.serial_out.held(now) >= len(raw):
            node.output.append((node.serial_out.through(len(raw), now), raw))


def _is_heartbeat(raw: bytes) -> bool:
    """True for a heartbeat of MAVLink 1 or 2."""
    return (raw[:1] == b"\xfe" and raw[5:6] == b"\0") or (raw[:1] == b"\xfd" and raw[7:10] == b"\0\0\0")
