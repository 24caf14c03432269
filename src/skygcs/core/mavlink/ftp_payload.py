"""MAVLink FTP as FILE_TRANSFER_PROTOCOL carries it: the 251 bytes of its payload, and the words in them.

Layout and words: https://mavlink.io/en/services/ftp.html (little-endian; req_opcode and offset of a reply are those of
the request it answers, its seq_number is the request's plus one).
"""

from __future__ import annotations

import struct
from dataclasses import dataclass
from enum import IntEnum

MESSAGE = "FILE_TRANSFER_PROTOCOL"

CAPABILITY_FTP = 1 << 5
"""MAV_PROTOCOL_CAPABILITY_FTP of AUTOPILOT_VERSION."""

PAYLOAD_BYTES = 251
MAX_DATA_BYTES = 239
"""Data bytes of one packet: the payload without its header of 12 bytes."""

FRAME_BYTES = 12 + 3 + PAYLOAD_BYTES
"""A full packet as a MAVLink 2 frame: header and checksum, target fields, payload."""

_PAYLOAD_AT = 3
"""Behind target_network, target_system and target_component."""

_HEAD = struct.Struct("<HBBBBBxI")


class Op(IntEnum):
    """opcode: what is asked for, or how it was answered."""

    TERMINATE_SESSION = 1
    RESET_SESSIONS = 2
    OPEN_FILE_RO = 4
    READ_FILE = 5
    BURST_READ_FILE = 15
    ACK = 128
    NAK = 129


class Error(IntEnum):
    """The first byte of a NAK's data."""

    FAIL = 1
    FAIL_ERRNO = 2
    INVALID_DATA_SIZE = 3
    INVALID_SESSION = 4
    NO_SESSIONS_AVAILABLE = 5
    END_OF_FILE = 6
    UNKNOWN_COMMAND = 7
    FILE_EXISTS = 8
    FILE_PROTECTED = 9
    FILE_NOT_FOUND = 10


ERROR_TEXTS = {
    Error.FAIL: "it failed",
    Error.INVALID_DATA_SIZE: "the request had a wrong size",
    Error.INVALID_SESSION: "the session is not open",
    Error.NO_SESSIONS_AVAILABLE: "no session is free",
    Error.END_OF_FILE: "the file ended",
    Error.UNKNOWN_COMMAND: "it does not know the command",
    Error.FILE_PROTECTED: "the file is protected",
    Error.FILE_NOT_FOUND: "it has no such file",
}


@dataclass(frozen=True, slots=True)
class Packet:
    """One request or reply. ``opcode`` and ``req_opcode`` are plain numbers: others than `Op`'s may come.

    ``size``: of the data, or how much is asked for; None: as long as ``data`` is.
    """

    seq: int
    session: int
    opcode: int
    data: bytes = b""
    size: int | None = None
    req_opcode: int = 0
    burst_complete: bool = False
    offset: int = 0

    @property
    def error(self) -> int:
        """Error code of a NAK; 0 if it has none."""
        return self.data[0] if self.data else 0


def encode(packet: Packet) -> bytes:
    """The field ``payload``. Raises ValueError for more data than a packet holds, struct.error for large numbers."""
    if len(packet.data) > MAX_DATA_BYTES:
        raise ValueError(f"{len(packet.data)} bytes do not fit into a packet of {MAX_DATA_BYTES}")
    size = len(packet.data) if packet.size is None else packet.size
    head = _HEAD.pack(
        packet.seq, packet.session, packet.opcode, size, packet.req_opcode, packet.burst_complete, packet.offset
    )
    return (head + packet.data).ljust(PAYLOAD_BYTES, b"\0")


def decode(frame_payload: bytes) -> Packet | None:
    """Return what a FILE_TRANSFER_PROTOCOL frame's payload, trimmed or not, says as a reply; None if its size cannot
    be."""
    raw = frame_payload[_PAYLOAD_AT:].ljust(PAYLOAD_BYTES, b"\0")
    seq, session, opcode, size, req_opcode, burst_complete, offset = _HEAD.unpack_from(raw)
    if size > MAX_DATA_BYTES:
        return None
    data = raw[_HEAD.size : _HEAD.size + size]
    return Packet(seq, session, opcode, data, size, req_opcode, bool(burst_complete), offset)


def error_text(packet: Packet) -> str:
    """Return what a NAK says, for a person."""
    if packet.error == Error.FAIL_ERRNO and len(packet.data) > 1:
        return f"it failed with error number {packet.data[1]}"
    try:
        return ERROR_TEXTS[Error(packet.error)]
    except (KeyError, ValueError):
        return f"it failed (error {packet.error})"
