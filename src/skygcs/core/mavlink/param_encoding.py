"""Parameters as MAVLink carries them: a name, a type, and four bytes that two kinds of autopilot fill differently.

PX4 puts an integer's own bytes into the float field (bytewise), ArduPilot casts the integer to a float (C cast):
https://mavlink.io/en/services/parameter.html#parameter-encoding. Bytes of an integer may be those of a signalling NaN,
which a float variable does not keep: here the field is four bytes, an unsigned number (``bits``), never a float.

An ArduPilot has them all in one file, too, packed into some 12 bytes each (`decode_packed`). Little-endian:

    header      uint16 magic (0x671b; 0x671c: with default values), uint16 parameters in the file, uint16 in the vehicle
    then each   zero bytes if needed, so that no value is split between two packets
                low four bits: type (1 int8, 2 int16, 3 int32, 4 float); high: flags, of which bit 0: a default follows
                low four bits: number of leading bytes shared with the last name; high: number of further bytes, minus 1
                the rest of its name; its value; its default value, if flagged

Source: ArduPilot's libraries/AP_Filesystem/AP_Filesystem_Param.cpp, where the layout is described.
"""

from __future__ import annotations

import math
import re
import struct
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from enum import Enum, IntEnum

from skygcs.core.mavlink.dialect import Dialect, FieldInfo, MessageInfo
from skygcs.core.mavlink.modes import AUTOPILOT_PX4

NAME_CHARS = 16
"""char param_id[16]: a name of 16 characters has no NUL behind it."""

INDEX_UNKNOWN = 0xFFFF
"""PARAM_VALUE.param_index of a value that was asked for by name, or set (ArduPilot), and of _HASH_CHECK (PX4)."""

HASH_NAME = "_HASH_CHECK"
"""PX4's checksum over its parameters, read like one; a PARAM_SET of it stops a list that is being sent."""

CAPABILITY_BYTEWISE = 1 << 4
CAPABILITY_C_CAST = 1 << 17
"""MAV_PROTOCOL_CAPABILITY_PARAM_ENCODE_*; the former was PARAM_UNION, which PX4 sets in every version."""

_NAME = re.compile(r"[A-Za-z_][A-Za-z0-9_]{0,15}", re.ASCII)


SLACK_ERROR = 1e-6
"""Relative tolerance: a value just between two roundings matches both, as a decimal has no exact binary form."""


class ParamType(IntEnum):
    """MAV_PARAM_TYPE. The protocol's values are four bytes: no autopilot sends the 64-bit types."""

    UINT8 = 1
    INT8 = 2
    UINT16 = 3
    INT16 = 4
    UINT32 = 5
    INT32 = 6
    UINT64 = 7
    INT64 = 8
    REAL32 = 9
    REAL64 = 10

    @property
    def integer(self) -> bool:
        return self < ParamType.REAL32


_STRUCT = {1: "<B", 2: "<b", 3: "<H", 4: "<h", 5: "<I", 6: "<i"}
_RANGE = {
    ParamType.UINT8: (0, 0xFF),
    ParamType.INT8: (-0x80, 0x7F),
    ParamType.UINT16: (0, 0xFFFF),
    ParamType.INT16: (-0x8000, 0x7FFF),
    ParamType.UINT32: (0, 0xFFFF_FFFF),
    ParamType.INT32: (-0x8000_0000, 0x7FFF_FFFF),
}

Value = int | float


class Encoding(Enum):
    """How an integer parameter is sent, in the terms of the MAVLink guide."""

    BYTEWISE = "bytewise"
    C_CAST = "C cast"


@dataclass(frozen=True, slots=True)
class Param:
    """One parameter. ``value`` is an int for the integer types, else a 32-bit float's value."""

    name: str
    value: Value
    type: ParamType = ParamType.REAL32

    @property
    def number(self) -> Value | None:
        """The value to reckon with; None for the NaN or infinity that a vehicle may send as any parameter, a whole one
        too (`from_bits`)."""
        return self.value if math.isfinite(self.value) else None


@dataclass(frozen=True, slots=True)
class ParamValue:
    """A PARAM_VALUE as it came; ``index`` is None where it does not say."""

    param: Param
    count: int
    index: int | None


def encoding_of(autopilot: int, capabilities: int | None) -> Encoding:
    """``capabilities``: of AUTOPILOT_VERSION. Unknown (None), or where it says neither, the autopilot decides."""
    if capabilities is not None:
        if capabilities & CAPABILITY_BYTEWISE:
            return Encoding.BYTEWISE
        if capabilities & CAPABILITY_C_CAST:
            return Encoding.C_CAST
    return Encoding.BYTEWISE if autopilot == AUTOPILOT_PX4 else Encoding.C_CAST


def is_name(text: str) -> bool:
    """True if it can be a parameter's name."""
    return _NAME.fullmatch(text) is not None


def float32(value: float) -> float:
    """The nearest 32-bit float. Raises OverflowError for a larger number."""
    nearest: float = struct.unpack("<f", struct.pack("<f", value))[0]
    return nearest


def equal(first: Value, second: Value, slack: float = 0.0) -> bool:
    """True if two values are the same 32-bit float, or differ by at most ``slack``, by which a file's writer is known
    to have rounded (`Entry.slack`). Whole numbers are compared exactly."""
    if first == second:
        return True
    if isinstance(first, int) and isinstance(second, int):
        return False
    try:
        near = abs(first - second) <= slack * (1 + SLACK_ERROR)
        return near or float32(first) == float32(second)
    except OverflowError:
        return False


def short_float(value: float) -> str:
    """The shortest decimal that names the same 32-bit float: 0.1, not 0.10000000149011612."""
    if not math.isfinite(value):
        return str(value)
    for digits in range(6, 10):
        text = f"{value:.{digits}g}"
        if float32(float(text)) == value:
            return text
    return repr(value)


def value_text(value: Value) -> str:
    """A value for people and files."""
    return str(value) if isinstance(value, int) else short_float(value)


def to_bits(value: Value, type_: ParamType, encoding: Encoding) -> int:
    """The four bytes to send. Raises ValueError, for a person, if the type or the encoding cannot carry the value."""
    if isinstance(value, float) and not math.isfinite(value):
        raise ValueError(f"{value} is not a value for a parameter")
    if type_ in (ParamType.UINT64, ParamType.INT64, ParamType.REAL64):
        raise ValueError(f"{type_.name} does not fit into the protocol's four bytes")
    if not type_.integer:
        return _float_bits(value)
    if value != int(value):
        raise ValueError(f"{value_text(value)} is not whole; the parameter is {type_.name}")
    whole = int(value)
    least, most = _RANGE[type_]
    if not least <= whole <= most:
        raise ValueError(f"{whole} is not within {least} to {most} ({type_.name})")
    if encoding is Encoding.BYTEWISE:
        return int.from_bytes(struct.pack(_STRUCT[type_], whole).ljust(4, b"\0"), "little")
    if float32(whole) != whole:
        raise ValueError(f"{whole} would arrive as {int(float32(whole))}: this autopilot gets 32-bit floats")
    return _float_bits(whole)


def from_bits(bits: int, type_: ParamType, encoding: Encoding) -> Value:
    """The value that came. An integer that a C cast sent as no whole number stays the float that it is."""
    raw = bits.to_bytes(4, "little")
    if type_ in _RANGE and encoding is Encoding.BYTEWISE:
        whole: int = struct.unpack_from(_STRUCT[type_], raw)[0]
        return whole
    value: float = struct.unpack("<f", raw)[0]
    return int(value) if type_.integer and value.is_integer() else value


def held_as(value: Value, type_: ParamType) -> Value:
    """Return what a vehicle that takes the value will say it holds. Raises ValueError as `to_bits` does."""
    return from_bits(to_bits(value, type_, Encoding.BYTEWISE), type_, Encoding.BYTEWISE)


def bits_message(info: MessageInfo) -> MessageInfo:
    """The same message (PARAM_VALUE, PARAM_SET) with its value field as uint32_t; on the wire it is the same bytes."""
    fields = [
        FieldInfo(f.name, "uint32_t", 0, f.offset, f.extension) if f.name == "param_value" else f for f in info.fields
    ]
    offsets = (info.target_system_offset, info.target_component_offset)
    return MessageInfo(info.msgid, info.name, info.crc_extra, info.min_length, info.length, *offsets, fields)


def value_reader(dialect: Dialect) -> Callable[[bytes, Encoding], ParamValue | None]:
    """A function from PARAM_VALUE's payload to its parameter; None if its name or type is invalid.
    Raises KeyError at once for a dialect without the message."""
    read = bits_message(dialect.by_name["PARAM_VALUE"]).reader(
        "param_value", "param_count", "param_index", "param_id", "param_type"
    )

    def decode(payload: bytes, encoding: Encoding) -> ParamValue | None:
        bits, count, index, raw, kind = read(payload)
        name = raw.split(b"\0", 1)[0].decode("ascii", "replace")
        if not is_name(name) or not 1 <= kind <= ParamType.REAL64:
            return None
        type_ = ParamType(kind)
        param = Param(name, from_bits(bits, type_, encoding), type_)
        return ParamValue(param, count, None if index == INDEX_UNKNOWN or index >= count else index)

    return decode


def _float_bits(value: Value) -> int:
    try:
        return int.from_bytes(struct.pack("<f", value), "little")
    except OverflowError:
        raise ValueError(f"{value} is too large for a 32-bit float") from None


# -- the packed file

PACKED_PATH = "@PARAM/param.pck"

_MAGIC = 0x671B
_MAGIC_WITH_DEFAULTS = 0x671C

_HEADER = struct.Struct("<HHH")

MAX_PACKED = 10_000
"""ArduPilot has some 1500 parameters."""

MAX_PACKED_BYTES = _HEADER.size + MAX_PACKED * (2 + NAME_CHARS + 4 + 3)
"""Worst case: no name shares bytes with the last one, all values have four bytes, and each has padding."""

TYPES: Mapping[int, tuple[ParamType, struct.Struct]] = {
    1: (ParamType.INT8, struct.Struct("<b")),
    2: (ParamType.INT16, struct.Struct("<h")),
    3: (ParamType.INT32, struct.Struct("<i")),
    4: (ParamType.REAL32, struct.Struct("<f")),
}
"""AP_Param's numbers, which are not MAV_PARAM_TYPE's."""

_HAS_DEFAULT = 1


@dataclass(frozen=True, slots=True)
class PackedParams:
    """``params`` in the vehicle's order; ``defaults`` of those that differ from their default. ``total``: number of the
    vehicle's parameters; a file requested in parts contains some of them."""

    params: tuple[Param, ...]
    defaults: Mapping[str, Value]
    total: int


def decode_packed(data: bytes) -> PackedParams:
    """Parse a file. Raises ValueError with a message for the user unless it is a complete file of this format."""
    if len(data) < _HEADER.size:
        raise ValueError(f"{len(data)} bytes are not a file of packed parameters")
    magic, count, total = _HEADER.unpack_from(data)
    if magic not in (_MAGIC, _MAGIC_WITH_DEFAULTS):
        raise ValueError(f"it begins with {magic:#06x} instead of {_MAGIC:#06x}")
    if count > total:
        raise ValueError(f"its header has {count} of {total} parameters")
    params: dict[str, Param] = {}
    defaults: dict[str, Value] = {}
    name, at = "", _HEADER.size
    try:
        for _ in range(count):
            while not data[at]:
                at += 1
            param, default, at = _entry(data, at, name)
            name = param.name
            if name in params:
                raise ValueError(f"it contains {name} twice")
            params[name] = param
            if default is not None:
                defaults[name] = default
    except (IndexError, struct.error):
        raise ValueError(f"it ends after {len(params)} of {count} parameters") from None
    if any(data[at:]):
        raise ValueError(f"there are bytes after its {count} parameters")
    return PackedParams(tuple(params.values()), defaults, total)


def _entry(data: bytes, at: int, last_name: str) -> tuple[Param, Value | None, int]:
    """One parameter, its default or None, and the offset of the next. Raises ValueError; IndexError or struct.error if
    the file ends before."""
    kind, flags = data[at] & 0x0F, data[at] >> 4
    common, more = data[at + 1] & 0x0F, (data[at + 1] >> 4) + 1
    if kind not in TYPES:
        raise ValueError(f"the parameter after {last_name or 'the header'} has the unknown type {kind}")
    at += 2
    name = last_name[:common] + data[at : at + more].decode("ascii", "replace")
    if common > len(last_name) or not is_name(name):
        raise ValueError(f"the parameter after {last_name or 'the header'} has an impossible name: {name!r}")
    at += more
    type_, layout = TYPES[kind]
    (value,) = layout.unpack_from(data, at)
    at += layout.size
    default = None
    if flags & _HAS_DEFAULT:
        (default,) = layout.unpack_from(data, at)
        at += layout.size
    return Param(name, value, type_), default, at
