"""One MAVLink frame: the received bytes and what its header says. Never re-encoded.

Layout: https://mavlink.io/en/guide/serialization.html#packet_format
    v1  FE len seq sysid compid msgid           payload crc16
    v2  FD len incompat compat seq sysid compid msgid24 payload crc16 [signature 13]
"""

from __future__ import annotations

import struct
from collections.abc import Mapping
from typing import Any, Literal

from fastcrc.crc16 import mcrf4xx

from skygcs.core.mavlink.dialect import MAX_PAYLOAD_BYTES, MessageInfo

MAGIC_V1 = 0xFE
MAGIC_V2 = 0xFD
HEADER_V1_BYTES = 6
HEADER_V2_BYTES = 10
CRC_BYTES = 2
SIGNATURE_BYTES = 13
INCOMPAT_SIGNED = 0x01
MAX_FRAME_BYTES = HEADER_V2_BYTES + MAX_PAYLOAD_BYTES + CRC_BYTES + SIGNATURE_BYTES
"""280: the longest frame there is, a signed one with a full payload."""

_HEAD_V2 = struct.Struct("<BBBBBBBHB").pack

Verdict = Literal["ok", "bad_crc", "unknown"]
"""What the CRC says; "unknown": the dialect has no such message, so nothing can be said."""


class Frame:
    """A frame as it came from the wire. ``raw`` is forwarded as it is; ``info`` is None for an unknown id."""

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
        raw = self.raw
        if raw[0] == MAGIC_V2:
            return raw[HEADER_V2_BYTES : HEADER_V2_BYTES + raw[1]]
        return raw[HEADER_V1_BYTES : HEADER_V1_BYTES + raw[1]]

    @property
    def signed(self) -> bool:
        return self.raw[0] == MAGIC_V2 and bool(self.raw[2] & INCOMPAT_SIGNED)

    @property
    def crc(self) -> int:
        """The checksum as sent."""
        raw = self.raw
        at = raw[1] + (HEADER_V2_BYTES if raw[0] == MAGIC_V2 else HEADER_V1_BYTES)
        return raw[at] | raw[at + 1] << 8

    def fields(self) -> dict[str, Any]:
        """All fields by name; {} for an unknown id."""
        return self.info.unpack(self.payload) if self.info is not None else {}

    def target(self) -> tuple[int, int]:
        """(target system, target component); 0 where the message has none or it was trimmed away: broadcast."""
        info = self.info
        if info is None or info.target_system_offset < 0:
            return 0, 0
        raw = self.raw
        length = raw[1]
        base = HEADER_V2_BYTES if raw[0] == MAGIC_V2 else HEADER_V1_BYTES
        at = info.target_system_offset
        system = raw[base + at] if at < length else 0
        at = info.target_component_offset
        component = raw[base + at] if 0 <= at < length else 0
        return system, component


def frame_size(data: bytes, at: int = 0) -> int:
    """Size of the frame whose header begins at ``at``; 0 if there is no magic byte or the header is incomplete."""
    left = len(data) - at
    if left >= HEADER_V1_BYTES and data[at] == MAGIC_V1:
        return HEADER_V1_BYTES + data[at + 1] + CRC_BYTES
    if left >= HEADER_V2_BYTES and data[at] == MAGIC_V2:
        signature = SIGNATURE_BYTES if data[at + 2] & INCOMPAT_SIGNED else 0
        return HEADER_V2_BYTES + data[at + 1] + CRC_BYTES + signature
    return 0


def check(raw: bytes, messages: Mapping[int, MessageInfo]) -> tuple[Frame | None, Verdict]:
    """The frame that these bytes, exactly `frame_size` of them, are, and what its CRC says.

    (None, "bad_crc") for a wrong CRC or, in MAVLink 1, a length that the message cannot have; a frame with
    incompatibility flags that nobody defined is "unknown".
    """
    length = raw[1]
    if raw[0] == MAGIC_V2:
        crc_at = HEADER_V2_BYTES + length
        seq, sysid, compid = raw[4], raw[5], raw[6]
        msgid = raw[7] | raw[8] << 8 | raw[9] << 16
        info = messages.get(msgid) if raw[2] <= INCOMPAT_SIGNED else None
    else:
        crc_at = HEADER_V1_BYTES + length
        seq, sysid, compid, msgid = raw[2], raw[3], raw[4], raw[5]
        info = messages.get(msgid)
        if info is not None and not info.min_length <= length <= info.length:
            return None, "bad_crc"
    if info is None:
        return Frame(raw, seq, sysid, compid, msgid, None), "unknown"
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
        head = bytes((MAGIC_V1, len(payload), seq & 0xFF, sysid, compid, info.msgid))
    else:
        payload = payload.rstrip(b"\0") or payload[:1]  # at least one byte stays (serialization guide)
        head = _HEAD_V2(MAGIC_V2, len(payload), 0, 0, seq & 0xFF, sysid, compid, info.msgid & 0xFFFF, info.msgid >> 16)
    body = head + payload
    return body + mcrf4xx(body[1:] + info.crc_extra_byte).to_bytes(CRC_BYTES, "little")
