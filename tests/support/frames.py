"""Frames to test with: good ones, ones of unknown id, damaged ones, noise. Everything from a seed."""

from __future__ import annotations

import functools
import random
from collections.abc import Mapping
from typing import Any

from fastcrc.crc16 import mcrf4xx

from skygcs.config.dialects import load_dialect, offline_dialect
from skygcs.core.mavlink.dialect import Dialect, MessageInfo
from skygcs.core.mavlink.frame import MAGIC_V1, MAGIC_V2, encode

UNKNOWN_ID = 54321
"""In no dialect."""

UNKNOWN_ID_V1 = 13
"""In no dialect, and it fits in MAVLink 1."""


@functools.cache
def dialect() -> Dialect:
    """What a daemon uses without being told otherwise."""
    return load_dialect(["ardupilotmega", "px4-extras"])


@functools.cache
def offline() -> Dialect:
    """What offline tools use, and what expected.json was measured with."""
    return offline_dialect()


def frame(
    name: str = "HEARTBEAT",
    values: Mapping[str, Any] | None = None,
    *,
    sysid: int = 1,
    compid: int = 1,
    seq: int = 0,
    version: int = 2,
) -> bytes:
    """A good frame."""
    info = dialect().find(name)
    return encode(info, values or {}, sysid=sysid, compid=compid, seq=seq, version=version)


def heartbeat(
    sysid: int = 1, compid: int = 1, *, seq: int = 0, version: int = 2, type: int = 2, autopilot: int = 12, **more: int
) -> bytes:
    """The heartbeat of a PX4 quadrotor, or of whatever the fields say."""
    values = {"type": type, "autopilot": autopilot, "base_mode": 81, "mavlink_version": 3, **more}
    return frame("HEARTBEAT", values, sysid=sysid, compid=compid, seq=seq, version=version)


def unknown_frame(
    payload: bytes = b"\x01\x02\x03\x04",
    *,
    sysid: int = 1,
    compid: int = 1,
    seq: int = 0,
    msgid: int = UNKNOWN_ID,
    crc_extra: int | None = 77,
    incompat: int = 0,
    compat: int = 0,
    version: int = 2,
) -> bytes:
    """A frame of an id the dialect does not know; ``crc_extra`` None puts a CRC that none can make right."""
    if version == 1:
        head = bytes((MAGIC_V1, len(payload), seq, sysid, compid, UNKNOWN_ID_V1 if msgid > 255 else msgid))
    else:
        head = bytes((MAGIC_V2, len(payload), incompat, compat, seq, sysid, compid, *msgid.to_bytes(3, "little")))
    body = head + payload
    if crc_extra is not None:
        return body + mcrf4xx(body[1:] + bytes([crc_extra])).to_bytes(2, "little")
    possible = {mcrf4xx(body[1:] + bytes([extra])) for extra in range(256)}
    return body + next(crc for crc in range(0x10000) if crc not in possible).to_bytes(2, "little")


def noise(size: int, seed: int) -> bytes:
    return random.Random(seed).randbytes(size)


def with_bit_errors(data: bytes, rate: float, rng: random.Random) -> bytes:
    """The same bytes with every bit flipped with that probability."""
    damaged = bytearray(data)
    at = -1
    while True:
        at += 1 + int(rng.expovariate(rate))
        if at >= 8 * len(data):
            return bytes(damaged)
        damaged[at // 8] ^= 1 << at % 8


_LIMITS = {
    "int8_t": (-(1 << 7), (1 << 7) - 1),
    "uint8_t": (0, (1 << 8) - 1),
    "int16_t": (-(1 << 15), (1 << 15) - 1),
    "uint16_t": (0, (1 << 16) - 1),
    "int32_t": (-(1 << 31), (1 << 31) - 1),
    "uint32_t": (0, (1 << 32) - 1),
    "int64_t": (-(1 << 63), (1 << 63) - 1),
    "uint64_t": (0, (1 << 64) - 1),
}


def random_values(info: MessageInfo, rng: random.Random) -> dict[str, Any]:
    """A value of its type for every field; about a third of them zero, so that payloads get trimmed."""
    values: dict[str, Any] = {}
    for field in info.fields:
        if field.type == "char":
            size = rng.randrange(field.array_length + 1) if field.array_length else 1
            values[field.name] = "".join(rng.choice("abcXYZ_0189") for _ in range(size))
        elif field.array_length:
            values[field.name] = [_number(field.type, rng) for _ in range(field.array_length)]
        else:
            values[field.name] = _number(field.type, rng)
    return values


def _number(kind: str, rng: random.Random) -> int | float:
    if rng.random() < 0.33:
        return 0
    if kind in ("float", "double"):
        return rng.randrange(-(1 << 20), 1 << 20) / 64  # exact in a float32
    low, high = _LIMITS[kind]
    return rng.choice((low, high, rng.randint(low, high)))
