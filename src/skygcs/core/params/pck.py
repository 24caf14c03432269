"""ArduPilot's packed parameters, the file @PARAM/param.pck: some 12 bytes per parameter.

    header      uint16 magic (0x671b; 0x671c: with default values), uint16 parameters in the file, uint16 in the vehicle
    then each   zero bytes if needed, so that no value is split between two packets
                low four bits: type (1 int8, 2 int16, 3 int32, 4 float); high: flags, of which bit 0: a default follows
                low four bits: number of leading bytes shared with the last name; high: number of further bytes, minus 1
                the rest of its name; its value; its default value, if flagged

Little-endian. Source: ArduPilot's libraries/AP_Filesystem/AP_Filesystem_Param.cpp, where the layout is described.
"""

from __future__ import annotations

import struct
from collections.abc import Mapping
from dataclasses import dataclass

from skygcs.core.mavlink.param_encoding import NAME_CHARS, Param, ParamType, Value, is_name

PATH = "@PARAM/param.pck"

MAGIC = 0x671B
MAGIC_WITH_DEFAULTS = 0x671C

HEADER = struct.Struct("<HHH")

MAX_COUNT = 10_000
"""ArduPilot has some 1500 parameters."""

MAX_BYTES = HEADER.size + MAX_COUNT * (2 + NAME_CHARS + 4 + 3)
"""Worst case: no name shares bytes with the last one, all values have four bytes, and each has padding."""

TYPES: Mapping[int, tuple[ParamType, struct.Struct]] = {
    1: (ParamType.INT8, struct.Struct("<b")),
    2: (ParamType.INT16, struct.Struct("<h")),
    3: (ParamType.INT32, struct.Struct("<i")),
    4: (ParamType.REAL32, struct.Struct("<f")),
}
"""AP_Param's numbers, which are not MAV_PARAM_TYPE's."""

HAS_DEFAULT = 1


@dataclass(frozen=True, slots=True)
class PackedParams:
    """``params`` in the vehicle's order; ``defaults`` of those that differ from their default. ``total``: number of the
    vehicle's parameters; a file requested in parts contains some of them."""

    params: tuple[Param, ...]
    defaults: Mapping[str, Value]
    total: int


def decode(data: bytes) -> PackedParams:
    """Parse a file. Raises ValueError with a message for the user unless it is a complete file of this format."""
    if len(data) < HEADER.size:
        raise ValueError(f"{len(data)} bytes are not a file of packed parameters")
    magic, count, total = HEADER.unpack_from(data)
    if magic not in (MAGIC, MAGIC_WITH_DEFAULTS):
        raise ValueError(f"it begins with {magic:#06x} instead of {MAGIC:#06x}")
    if count > total:
        raise ValueError(f"its header has {count} of {total} parameters")
    params: dict[str, Param] = {}
    defaults: dict[str, Value] = {}
    name, at = "", HEADER.size
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
    if flags & HAS_DEFAULT:
        (default,) = layout.unpack_from(data, at)
        at += layout.size
    return Param(name, value, type_), default, at
