"""UBX, the protocol of u-blox receivers, as far as a base needs it: settings (CFG-VALSET), answers, survey-in.

u-blox, "ZED-F9P Interface Description": 0xB5 0x62, class, id, length (little-endian), content, two bytes of checksum.
"""

from __future__ import annotations

import struct
from collections.abc import Mapping
from enum import IntEnum
from typing import NamedTuple

SYNC = b"\xb5\x62"
HEADER_BYTES = 6
CHECKSUM_BYTES = 2
MAX_CONTENT_BYTES = 1024
"""A longer message is none of those that a base is asked for, or none at all."""

ACK_NAK = (0x05, 0x00)
ACK_ACK = (0x05, 0x01)
CFG_VALSET = (0x06, 0x8A)
NAV_SVIN = (0x01, 0x3B)

MAX_KEYS = 64
"""Settings in one CFG-VALSET."""

RAM = 0x01
"""The layer that a power cycle clears: a receiver that is used elsewhere later is as it was."""


class Key(IntEnum):
    """Settings; bits 28 to 30 of a key say how large its value is."""

    TMODE_MODE = 0x20030001
    TMODE_POS_TYPE = 0x20030002
    TMODE_LAT = 0x40030009
    TMODE_LON = 0x4003000A
    TMODE_HEIGHT = 0x4003000B
    TMODE_LAT_HP = 0x2003000C
    TMODE_LON_HP = 0x2003000D
    TMODE_HEIGHT_HP = 0x2003000E
    TMODE_FIXED_POS_ACC = 0x4003000F
    TMODE_SVIN_MIN_DUR = 0x40030010
    TMODE_SVIN_ACC_LIMIT = 0x40030011


PORTS = {"uart1": (0, 0x10740000), "uart2": (1, 0x10760000), "usb": (2, 0x10780000)}
"""A port's place among the keys of a message, which have the order uart1, uart2, usb; and the base of the keys of its
output protocols."""

OUT_UBX, OUT_NMEA, OUT_RTCM = 1, 2, 4
"""Added to that base."""

RATE_UART1 = {
    **{1005: 0x209102BE, 1230: 0x20910304},
    **{1074: 0x2091035F, 1084: 0x20910364, 1094: 0x20910369, 1124: 0x2091036E},
    **{1077: 0x209102CD, 1087: 0x209102D2, 1097: 0x20910319, 1127: 0x209102D7},
}
"""The key of an RTCM message's rate on UART1: each so many navigation epochs (of one second), 0: never."""

OBSERVATIONS = {"msm4": (1074, 1084, 1094, 1124), "msm7": (1077, 1087, 1097, 1127)}
"""GPS, GLONASS, Galileo and BeiDou."""

SVIN_RATE_UART1 = 0x20910089

_SIZE_CODES = {1: 1, 2: 1, 3: 2, 4: 4, 5: 8}


class UbxMessage(NamedTuple):
    """A sound message."""

    kind: tuple[int, int]
    """Class and id."""
    content: bytes


class SurveyIn(NamedTuple):
    """NAV-SVIN: how far the receiver is with the position of its antenna."""

    duration_s: int
    accuracy_m: float
    observations: int
    valid: bool
    active: bool


def checksum(data: bytes | bytearray | memoryview) -> bytes:
    """Fletcher's 8-bit checksum over class, id, length and content."""
    a = b = 0
    for byte in data:
        a = (a + byte) & 0xFF
        b = (b + a) & 0xFF
    return bytes((a, b))


def packed(kind: tuple[int, int], content: bytes) -> bytes:
    """The bytes of a message."""
    body = bytes(kind) + len(content).to_bytes(2, "little") + content
    return SYNC + body + checksum(body)


def value_bytes(key: int) -> int:
    """How many bytes the value of a setting has. Raises ValueError for a number that is no key."""
    size = _SIZE_CODES.get(key >> 28 & 0x07)
    if size is None:
        raise ValueError(f"0x{key:08x} is not a key of a setting")
    return size


def valset(settings: Mapping[int, int]) -> bytes:
    """CFG-VALSET of these settings in the RAM. Raises ValueError for more than `MAX_KEYS`."""
    if len(settings) > MAX_KEYS:
        raise ValueError(f"{len(settings)} settings: CFG-VALSET takes {MAX_KEYS}")
    content = bytearray((0, RAM, 0, 0))
    for key, value in settings.items():
        size = value_bytes(key)
        content += key.to_bytes(4, "little")
        content += (value & (1 << 8 * size) - 1).to_bytes(size, "little")
    return packed(CFG_VALSET, bytes(content))


def survey_of(message: UbxMessage) -> SurveyIn | None:
    """The progress in a NAV-SVIN; None if it is none."""
    if message.kind != NAV_SVIN or len(message.content) != 40 or message.content[0] != 0:
        return None
    duration, accuracy, observations, valid, active = struct.unpack_from("<8xI16xIIBB", message.content)
    return SurveyIn(duration, accuracy / 1e4, observations, bool(valid), bool(active))


def answered(message: UbxMessage) -> bool | None:
    """True for the acknowledgement of a CFG-VALSET, False for its refusal, None for anything else."""
    if message.kind not in (ACK_ACK, ACK_NAK) or message.content[:2] != bytes(CFG_VALSET):
        return None
    return message.kind == ACK_ACK


def output_settings(port: str, observations: str) -> dict[int, int]:
    """Have a port put out a base's messages and NAV-SVIN, and no NMEA. ``observations``: "msm4" or "msm7"."""
    place, protocols = PORTS[port]
    wanted = dict.fromkeys(OBSERVATIONS[observations], 1) | {1005: 10, 1230: 10}
    rates = {key + place: wanted.get(type_, 0) for type_, key in RATE_UART1.items()}
    return {
        protocols + OUT_UBX: 1,
        protocols + OUT_NMEA: 0,
        protocols + OUT_RTCM: 1,
        SVIN_RATE_UART1 + place: 1,
        **rates,
    }


def survey_settings(seconds: int, accuracy_m: float) -> dict[int, int]:
    """Survey in: average the position for so long, and until it is so accurate."""
    return {
        Key.TMODE_MODE: 1,
        Key.TMODE_SVIN_MIN_DUR: seconds,
        Key.TMODE_SVIN_ACC_LIMIT: round(accuracy_m * 1e4),
    }


def no_survey_settings() -> dict[int, int]:
    """Be no base: a survey that is asked for after that begins anew."""
    return {Key.TMODE_MODE: 0}


def fixed_settings(lat_deg: float, lon_deg: float, height_m: float, accuracy_m: float) -> dict[int, int]:
    """Be at a known position; ``height_m`` is above the ellipsoid."""
    lat, lat_hp = _coarse_and_fine(lat_deg * 1e9)
    lon, lon_hp = _coarse_and_fine(lon_deg * 1e9)
    height, height_hp = _coarse_and_fine(height_m * 1e4)
    return {
        Key.TMODE_MODE: 2,
        Key.TMODE_POS_TYPE: 1,
        Key.TMODE_LAT: lat,
        Key.TMODE_LON: lon,
        Key.TMODE_HEIGHT: height,
        Key.TMODE_LAT_HP: lat_hp,
        Key.TMODE_LON_HP: lon_hp,
        Key.TMODE_HEIGHT_HP: height_hp,
        Key.TMODE_FIXED_POS_ACC: round(accuracy_m * 1e4),
    }


def _coarse_and_fine(value: float) -> tuple[int, int]:
    """A value in hundreds, and the rest, which has its sign."""
    whole = round(value)
    coarse = abs(whole) // 100 * (-1 if whole < 0 else 1)
    return coarse, whole - coarse * 100
