"""API frames of Digi's XBee modules (API modes 1 and 2): bytes to frames and back.

A frame is 0x7E, a length of two bytes (big-endian), so many bytes of data, and 0xFF minus the low byte of their sum.
The first byte of the data is the frame's type. In mode 2 the bytes 0x7E, 0x7D, 0x11 and 0x13 behind the first 0x7E
are escaped: 0x7D and the byte XOR 0x20. Source: Digi, XBee-PRO 900HP/XSC user guide (90002173), "API operation". The
tests compare with Digi's own Python library.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass
from enum import IntEnum
from typing import Generic, TypeVar

START = 0x7E
ESCAPE = 0x7D
ESCAPE_XOR = 0x20

BROADCAST = 0xFFFF
"""64-bit address of all nodes."""

MAX_DATA_BYTES = 512
"""Longest data of a frame that is waited for. The longest of a real module is a received packet: 12 bytes and at most
256 of payload (900HP); text of a node's identification is shorter."""

_ANY_ADDRESS16 = b"\xff\xfe"
"""The 16-bit address of frames to and from DigiMesh modules, which have none."""

_TO_ESCAPE = re.compile(rb"[\x7e\x7d\x11\x13]")


class FrameType(IntEnum):
    """First byte of a frame's data."""

    AT_COMMAND = 0x08
    TRANSMIT_REQUEST = 0x10
    REMOTE_AT_COMMAND = 0x17
    AT_RESPONSE = 0x88
    MODEM_STATUS = 0x8A
    TRANSMIT_STATUS = 0x8B
    RECEIVE_PACKET = 0x90
    NODE_IDENTIFICATION = 0x95
    REMOTE_AT_RESPONSE = 0x97


@dataclass(frozen=True, slots=True)
class AtResponse:
    """The answer to an AT command. ``address``: of the remote module; None for the module at the port."""

    frame_id: int
    command: str
    status: int
    """0 done, 1 error, 2 no such command, 3 bad parameter, 4 the remote module did not answer."""
    value: bytes
    address: int | None = None


@dataclass(frozen=True, slots=True)
class ModemStatus:
    """The module restarted (0 or 1), or its network changed."""

    status: int


@dataclass(frozen=True, slots=True)
class TransmitStatus:
    """Status of a transmit request. ``delivery`` 0: the receiver's module acknowledged it."""

    frame_id: int
    retries: int
    delivery: int


@dataclass(frozen=True, slots=True)
class ReceivePacket:
    """Payload from a node. ``broadcast``: it was for all."""

    address: int
    broadcast: bool
    payload: bytes


@dataclass(frozen=True, slots=True)
class NodeIdentification:
    """A node that gave its name, unasked (its commissioning button)."""

    address: int
    name: str


@dataclass(frozen=True, slots=True)
class OtherFrame:
    """A type of no use here, or one too short for its type."""

    frame_type: int


ApiFrame = AtResponse | ModemStatus | TransmitStatus | ReceivePacket | NodeIdentification | OtherFrame


def encode(data: bytes, *, escaped: bool) -> bytes:
    """A whole frame around its data. Raises ValueError for data that is empty or longer than two bytes can say."""
    if not 0 < len(data) <= 0xFFFF:
        raise ValueError(f"a frame has 1 to 65535 bytes of data, not {len(data)}")
    body = len(data).to_bytes(2, "big") + data + bytes([0xFF - (sum(data) & 0xFF)])
    if escaped:
        body = _TO_ESCAPE.sub(lambda found: bytes((ESCAPE, found[0][0] ^ ESCAPE_XOR)), body)
    return bytes([START]) + body


def at_command(frame_id: int, command: str, value: bytes = b"") -> bytes:
    """Data of a command to the module at the port; without a value it is read."""
    return bytes((FrameType.AT_COMMAND, frame_id)) + _at_name(command) + value


def remote_at_command(frame_id: int, address: int, command: str, value: bytes = b"") -> bytes:
    """Data of a command to a remote module; a change counts at once."""
    head = bytes((FrameType.REMOTE_AT_COMMAND, frame_id)) + address.to_bytes(8, "big") + _ANY_ADDRESS16
    return head + b"\x02" + _at_name(command) + value


def transmit_request(frame_id: int, address: int, payload: bytes) -> bytes:
    """Data of a transmit request with the module's own delivery method (its TO) and most hops."""
    head = bytes((FrameType.TRANSMIT_REQUEST, frame_id)) + address.to_bytes(8, "big") + _ANY_ADDRESS16
    return head + b"\0\0" + payload


def _at_name(command: str) -> bytes:
    name = command.encode("ascii")
    if len(name) != 2:
        raise ValueError(f"an AT command has two letters, not {command!r}")
    return name


def decode(data: bytes) -> ApiFrame:
    """The frame with this data (not empty). Never raises."""
    kind, size = data[0], len(data)
    if kind == FrameType.RECEIVE_PACKET and size >= 12:
        return ReceivePacket(int.from_bytes(data[1:9], "big"), bool(data[11] & 0x02), data[12:])
    if kind == FrameType.TRANSMIT_STATUS and size >= 7:
        return TransmitStatus(data[1], data[4], data[5])
    if kind == FrameType.AT_RESPONSE and size >= 5:
        return AtResponse(data[1], data[2:4].decode("ascii", "replace"), data[4], data[5:])
    if kind == FrameType.REMOTE_AT_RESPONSE and size >= 15:
        address = int.from_bytes(data[2:10], "big")
        return AtResponse(data[1], data[12:14].decode("ascii", "replace"), data[14] & 0x0F, data[15:], address)
    if kind == FrameType.MODEM_STATUS and size >= 2:
        return ModemStatus(data[1])
    if kind == FrameType.NODE_IDENTIFICATION and size >= 25:
        name, _, _ = data[22:].partition(b"\0")
        return NodeIdentification(int.from_bytes(data[14:22], "big"), name.decode("ascii", "replace"))
    return OtherFrame(kind)


@dataclass(slots=True)
class ApiStats:
    """Counts since the parser was made."""

    frames: int = 0
    bad_checksum: int = 0
    skipped_bytes: int = 0
    """In no frame."""


Decoded = TypeVar("Decoded")


class ApiParser(Generic[Decoded]):
    """Parser of one direction of a module's port, in any split. ``escaped``: API mode 2; ``decode`` makes a frame of
    its data, which is not empty.

    Keeps one unfinished frame at most. After a wrong checksum the search goes on behind the frame's first byte: a false
    start hides no frame behind it. In mode 2 an unescaped 0x7E always begins a frame. Never raises.
    """

    def __init__(self, decode: Callable[[bytes], Decoded], *, escaped: bool) -> None:
        self.escaped = escaped
        self.stats = ApiStats()
        self._decode = decode
        self._buffer = b""

    @property
    def pending(self) -> bool:
        """True if bytes of an unfinished frame are kept."""
        return bool(self._buffer)

    def feed(self, data: bytes) -> list[Decoded]:
        """The frames that are complete with these bytes."""
        buffer = self._buffer + data
        frames: list[Decoded] = []
        at = 0
        while True:
            start = buffer.find(START, at)
            if start < 0:
                self.stats.skipped_bytes += len(buffer) - at
                self._buffer = b""
                return frames
            self.stats.skipped_bytes += start - at
            found, end = self._frame_at(buffer, start)
            if found is not None:
                frames.append(found)
                at = end
            elif end:
                self.stats.skipped_bytes += end - start
                at = end
            else:
                self._buffer = buffer[start:]
                return frames

    def give_up(self) -> list[Decoded]:
        """Nothing more came for a while: what is kept is no frame; those that stand in it are returned."""
        frames: list[Decoded] = []
        while self._buffer:
            rest, self._buffer = self._buffer[1:], b""
            self.stats.skipped_bytes += 1
            frames += self.feed(rest)
        return frames

    def _frame_at(self, buffer: bytes, start: int) -> tuple[Decoded | None, int]:
        """The frame that begins at ``start`` and where it ends; (None, where to go on) if none does, (None, 0) if it is
        not complete."""
        head = self._plain(buffer, start + 1, 2)
        if type(head) is int:
            return None, head
        assert isinstance(head, tuple)
        length = int.from_bytes(head[0], "big")
        if not 0 < length <= MAX_DATA_BYTES:
            return None, start + 1
        body = self._plain(buffer, head[1], length + 1)
        if type(body) is int:
            return None, body
        assert isinstance(body, tuple)
        if sum(body[0]) & 0xFF != 0xFF:
            self.stats.bad_checksum += 1
            return None, start + 1
        self.stats.frames += 1
        return self._decode(body[0][:-1]), body[1]

    def _plain(self, buffer: bytes, at: int, count: int) -> tuple[bytes, int] | int:
        """``count`` bytes from ``at`` on without their escapes, and where they end; 0 if there are fewer, or the place
        of a new start among them."""
        if not self.escaped:
            end = at + count
            return (buffer[at:end], end) if end <= len(buffer) else 0
        plain = bytearray()
        while len(plain) < count:
            if at >= len(buffer):
                return 0
            byte = buffer[at]
            if byte == START:
                return at
            if byte == ESCAPE:
                if at + 1 >= len(buffer):
                    return 0
                if buffer[at + 1] == START:
                    return at + 1
                byte = buffer[at + 1] ^ ESCAPE_XOR
                at += 1
            plain.append(byte)
            at += 1
        return bytes(plain), at
