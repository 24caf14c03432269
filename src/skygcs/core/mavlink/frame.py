"""One MAVLink frame: the received bytes, never re-encoded, and its header and checksum, which are read and written here
alone, beside `_fast_path.c`.

Layout (https://mavlink.io/en/guide/serialization.html#packet_format):

    v1  FE len seq sysid compid msgid                                  payload crc16
    v2  FD len incompat compat seq sysid compid msgid (3, little endian)  payload crc16 [signature 13]
"""

from __future__ import annotations

import struct
from binascii import crc_hqx
from collections.abc import Mapping
from typing import Any, Literal

from skygcs.core.mavlink.dialect import MAX_PAYLOAD_BYTES, MessageInfo

# --- header and checksum ----------------------------------------------------------------------------------------------

MAGIC_V1 = 0xFE
MAGIC_V2 = 0xFD
HEADER_V1_BYTES = 6
HEADER_V2_BYTES = 10
CRC_BYTES = 2
SIGNATURE_BYTES = 13
INCOMPAT_SIGNED = 0x01
"""The incompatibility flag of a signed frame; the guide defines no other."""

HEADER_BYTES = {MAGIC_V1: HEADER_V1_BYTES, MAGIC_V2: HEADER_V2_BYTES}
"""Where the payload begins, by the frame's first byte."""

Header = tuple[int, int, int, int, int, int, int, int]
"""length, incompat flags, compat flags, seq, sysid, compid, msgid, size of the frame. A plain tuple: one is made for
each frame that is received."""

_CRC_INITIAL = 0xFFFF

_REVERSED = bytes(int(f"{byte:08b}"[::-1], 2) for byte in range(256))
"""Each byte with its bits in the other order."""

_V1 = struct.Struct("<BBBBBB")
_V2 = struct.Struct("<BBBBBBBHB")


def decode_header(data: bytes, at: int = 0) -> Header | None:
    """The header that begins at ``at``; None without a magic byte there, or if the header is incomplete."""
    left = len(data) - at
    if left >= HEADER_V2_BYTES and data[at] == MAGIC_V2:
        _, length, incompat, compat, seq, sysid, compid, low, high = _V2.unpack_from(data, at)
        signature = SIGNATURE_BYTES if incompat & INCOMPAT_SIGNED else 0
        size = HEADER_V2_BYTES + length + CRC_BYTES + signature
        return length, incompat, compat, seq, sysid, compid, low | high << 16, size
    if left >= HEADER_V1_BYTES and data[at] == MAGIC_V1:
        _, length, seq, sysid, compid, msgid = _V1.unpack_from(data, at)
        return length, 0, 0, seq, sysid, compid, msgid, HEADER_V1_BYTES + length + CRC_BYTES
    return None


def encode_header(version: int, length: int, seq: int, sysid: int, compid: int, msgid: int, compat: int = 0) -> bytes:
    """The header of an unsigned frame. Raises struct.error for numbers out of range (version 1: ids above 255)."""
    if version == 1:
        return _V1.pack(MAGIC_V1, length, seq, sysid, compid, msgid)
    return _V2.pack(MAGIC_V2, length, 0, compat, seq, sysid, compid, msgid & 0xFFFF, msgid >> 16)


def mcrf4xx(data: bytes | bytearray) -> int:
    """CRC-16/MCRF4XX: in a frame of all bytes after the magic byte, and the message's CRC_EXTRA behind them.

    It is binascii's CRC of the same polynomial, which takes the highest bit of a byte first, with the bits of all bytes
    reversed. A frame of 40 bytes takes 0.4 µs (in a compiled library of its own 0.1, which has 0.6 MB resident).
    """
    crc = crc_hqx(data.translate(_REVERSED), _CRC_INITIAL)
    return _REVERSED[crc >> 8] | _REVERSED[crc & 0xFF] << 8


def frame_size(data: bytes, at: int = 0) -> int:
    """Size of the frame whose header begins at ``at``; 0 if there is no magic byte or the header is incomplete."""
    header = decode_header(data, at)
    return 0 if header is None else header[-1]


def payload_of(raw: bytes) -> bytes:
    """The payload of a whole frame as sent, trailing zeros trimmed or not."""
    at = HEADER_BYTES[raw[0]]
    return raw[at : at + raw[1]]


def crc_offset(raw: bytes) -> int:
    """Where the checksum of a whole frame stands."""
    return HEADER_BYTES[raw[0]] + raw[1]


# --- frame ------------------------------------------------------------------------------------------------------------


MAX_FRAME_BYTES = HEADER_V2_BYTES + MAX_PAYLOAD_BYTES + CRC_BYTES + SIGNATURE_BYTES
"""280: the longest frame there is, a signed one with a full payload."""

FrameVerdict = Literal["ok", "bad_crc", "unknown"]
"""Result of the CRC check; "unknown": the dialect does not have the message, so the CRC cannot be checked."""


class Frame:
    """A frame as received. ``raw`` is forwarded unchanged; ``info`` is None for an unknown id."""

    __slots__ = ("compid", "info", "msgid", "raw", "seq", "sysid")

    def __init__(self, raw: bytes, seq: int, sysid: int, compid: int, msgid: int, info: MessageInfo | None) -> None:
        self.raw = raw
        self.seq = seq
        self.sysid = sysid
        self.compid = compid
        self.msgid = msgid
        self.info = info

    def __repr__(self) -> str:
        return f"<Frame {self.name} {self.sysid}/{self.compid} seq {self.seq} {len(self.raw)} B>"

    @property
    def version(self) -> int:
        """1 or 2."""
        return 2 if self.raw[0] == MAGIC_V2 else 1

    @property
    def name(self) -> str:
        """Message name, or UNKNOWN_<id>."""
        return self.info.name if self.info is not None else f"UNKNOWN_{self.msgid}"

    @property
    def payload(self) -> bytes:
        """The payload as sent, trailing zeros trimmed or not."""
        return payload_of(self.raw)

    @property
    def signed(self) -> bool:
        return self.raw[0] == MAGIC_V2 and bool(self.raw[2] & INCOMPAT_SIGNED)

    @property
    def crc(self) -> int:
        """The checksum as sent."""
        raw = self.raw
        at = crc_offset(raw)
        return raw[at] | raw[at + 1] << 8

    def fields(self) -> dict[str, Any]:
        """All fields by name; {} for an unknown id."""
        return self.info.unpack(self.payload) if self.info is not None else {}

    def target(self) -> tuple[int, int]:
        """(target system, target component); 0 (broadcast) if the message has no such field or it was trimmed."""
        info = self.info
        if info is None or info.target_system_offset < 0:
            return 0, 0
        raw = self.raw
        length = raw[1]
        base = HEADER_BYTES[raw[0]]
        at = info.target_system_offset
        system = raw[base + at] if at < length else 0
        at = info.target_component_offset
        component = raw[base + at] if 0 <= at < length else 0
        return system, component


def check(raw: bytes, messages: Mapping[int, MessageInfo]) -> tuple[Frame | None, FrameVerdict]:
    """Make the frame of these bytes, exactly `frame_size` of them, and check its CRC.

    (None, "bad_crc") for a wrong CRC or, in MAVLink 1, for a length that the message cannot have; a frame with
    undefined incompatibility flags is "unknown".
    """
    header = decode_header(raw)
    assert header is not None
    length, incompat, _, seq, sysid, compid, msgid, _ = header
    info = messages.get(msgid) if incompat <= INCOMPAT_SIGNED else None
    if info is None:
        return Frame(raw, seq, sysid, compid, msgid, None), "unknown"
    if raw[0] == MAGIC_V1 and not info.min_length <= length <= info.length:
        return None, "bad_crc"
    crc_at = crc_offset(raw)
    crc = mcrf4xx(raw[1:crc_at] + info.crc_extra_byte)
    if raw[crc_at] != crc & 0xFF or raw[crc_at + 1] != crc >> 8:
        return None, "bad_crc"
    return Frame(raw, seq, sysid, compid, msgid, info), "ok"


def encode(
    info: MessageInfo,
    values: Mapping[str, Any],
    *,
    sysid: int,
    compid: int,
    seq: int,
    version: int = 2,
) -> bytes:
    """A complete unsigned frame. Raises ValueError as `MessageInfo.pack` does."""
    return encode_payload(info, info.pack(values), sysid=sysid, compid=compid, seq=seq, version=version)


def encode_payload(info: MessageInfo, payload: bytes, *, sysid: int, compid: int, seq: int, version: int = 2) -> bytes:
    """A complete unsigned frame around an untrimmed payload (`MessageInfo.pack`).

    Version 1 drops extensions; raises ValueError for an id above 255 in version 1.
    """
    if version == 1:
        if info.msgid > 255:
            raise ValueError(f"{info.name} (id {info.msgid}) does not fit in MAVLink 1")
        payload = payload[: info.min_length]
    else:
        payload = payload.rstrip(b"\0") or payload[:1]  # at least one byte stays (serialization guide)
    body = encode_header(version, len(payload), seq & 0xFF, sysid, compid, info.msgid) + payload
    return body + mcrf4xx(body[1:] + info.crc_extra_byte).to_bytes(CRC_BYTES, "little")
