"""RTCM 3 frames and their GPS_RTCM_DATA to test with, made by other means than those under test."""

from __future__ import annotations

from collections.abc import Iterator

STANDARD_1005 = bytes.fromhex("D300133ED7D30202980EDEEF34B4BD62AC0941986F33360B98")
"""The example of RTCM 10403.x: position of station 2003."""

GLONASS_BIASES_1230 = bytes.fromhex("D300084CE0008A00000000A8F72A")
"""Sent by a u-blox ZED-F9P (checksum as published with the definition of CRC-24Q in pycrc)."""


def bitwise_crc24q(data: bytes) -> int:
    """By long division of the whole message, as the standard defines it."""
    dividend = int.from_bytes(data, "big") << 24
    for bit in range(len(data) * 8 + 23, 23, -1):
        if dividend >> bit & 1:
            dividend ^= 0x1864CFB << bit - 24
    return dividend


def rtcm_frame(type_: int, *, station: int = 0, epoch: int = 0, body_bytes: int = 30, fill: int = 0x5A) -> bytes:
    """A sound frame of ``body_bytes`` of content, at least 7."""
    head = ((type_ << 12 | station) << 30 | epoch) << 2
    body = (head.to_bytes(7, "big") + bytes([fill]) * body_bytes)[:body_bytes]
    frame = b"\xd3" + len(body).to_bytes(2, "big") + body
    return frame + bitwise_crc24q(frame).to_bytes(3, "big")


def rtcm_payloads(message: bytes, sequence: int) -> Iterator[bytes]:
    """Payloads of the GPS_RTCM_DATA that carry it, as MAVProxy sends them, trimmed as MAVLink 2 does."""
    chunks = [message[at : at + 180] for at in range(0, len(message), 180)]
    if 1 < len(chunks) < 4 and len(chunks[-1]) == 180:
        chunks.append(b"")
    for number, chunk in enumerate(chunks):
        flags = sequence % 32 << 3 | (number << 1 | 1 if len(chunks) > 1 else 0)
        yield bytes([flags, len(chunk), *chunk]).rstrip(b"\0")
