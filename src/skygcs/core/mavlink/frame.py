"""One MAVLink frame: the received bytes and the fields of its header (`core.mavlink.header`). Never re-encoded."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Literal

from skygcs.core.mavlink.dialect import MAX_PAYLOAD_BYTES, MessageInfo
from skygcs.core.mavlink.header import (
    CRC_BYTES,
    HEADER_BYTES,
    HEADER_V2_BYTES,
    INCOMPAT_SIGNED,
    MAGIC_V1,
    MAGIC_V2,
    SIGNATURE_BYTES,
    crc_offset,
    decode_header,
    encode_header,
    mcrf4xx,
    payload_of,
)

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
