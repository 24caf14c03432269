"""Parameters of a simulated vehicle and their two encodings in PARAM_VALUE's float field.

PX4 puts an integer's bytes into the float (PARAM_ENCODE_BYTEWISE), ArduPilot casts it (PARAM_ENCODE_C_CAST):
https://mavlink.io/en/services/parameter.html#parameter-encoding
"""

from __future__ import annotations

import struct
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from math import isfinite
from zlib import crc32

from skygcs.sim import protocol as m

INTEGER_RANGE: dict[int, tuple[int, int]] = {
    m.MAV_PARAM_TYPE_UINT8: (0, 255),
    m.MAV_PARAM_TYPE_INT8: (-128, 127),
    m.MAV_PARAM_TYPE_INT16: (-32768, 32767),
    m.MAV_PARAM_TYPE_INT32: (-(1 << 31), (1 << 31) - 1),
}

NO_NAN = 0x7F7FFFFF
"""Keeps a hash from being a NaN where it travels as a float: Python would not carry every one of those unchanged."""


@dataclass(slots=True)
class Param:
    """One parameter; ``type`` is MAV_PARAM_TYPE."""

    name: str
    value: float
    type: int = m.MAV_PARAM_TYPE_REAL32


class Params:
    """A vehicle's parameters, in alphabetical order as the firmwares list them. They survive a reboot."""

    def __init__(self, params: Iterable[Param], *, bytewise: bool) -> None:
        self._all = sorted(params, key=lambda p: p.name)
        self._bytewise = bytewise
        self._number()

    def _number(self) -> None:
        self._index = {p.name: i for i, p in enumerate(self._all)}
        self._by_name = {p.name: p for p in self._all}

    def __len__(self) -> int:
        return len(self._all)

    def __iter__(self) -> Iterator[Param]:
        return iter(self._all)

    def __getitem__(self, name: str) -> float:
        return self._by_name[name].value

    def get(self, name: str) -> float | None:
        """None: it has no such parameter."""
        param = self._by_name.get(name)
        return None if param is None else param.value

    def find(self, name: str) -> tuple[int, Param] | None:
        index = self._index.get(name)
        return None if index is None else (index, self._all[index])

    def at(self, index: int) -> Param | None:
        return self._all[index] if 0 <= index < len(self._all) else None

    @property
    def hash(self) -> int:
        """PX4's _HASH_CHECK, 32 bits over all names and values (not its very number: it has other parameters)."""
        number = 0
        for param in self._all:
            number = crc32(param.name.encode() + struct.pack("<d", param.value), number)
        return number & NO_NAN

    def take_in(self, params: Mapping[str, Param]) -> None:
        """Values from elsewhere, and parameters that it had not; its own keep their types where the values allow."""
        for param in params.values():
            found = self.find(param.name)
            if found is None:
                self._all.append(replace(param))  # each vehicle has its own
                continue
            own = found[1]
            whole = own.type == m.MAV_PARAM_TYPE_REAL32 or param.value == round(param.value)
            own.value = param.value
            if not whole:
                own.type = param.type
        self._all.sort(key=lambda p: p.name)
        self._number()

    def encode(self, param: Param) -> float:
        """Return what goes into PARAM_VALUE.param_value."""
        if not self._bytewise or param.type == m.MAV_PARAM_TYPE_REAL32:
            return param.value
        value: float = struct.unpack("<f", struct.pack("<i", int(param.value)))[0]
        return value

    def set(self, name: str, wire_value: float) -> Param | None:
        """Take a PARAM_SET; the parameter as it is now, None if there is none of this name.

        A value its type cannot hold changes nothing.
        """
        found = self.find(name)
        if found is None:
            return None
        param = found[1]
        value = wire_value
        if param.type != m.MAV_PARAM_TYPE_REAL32:
            if self._bytewise:
                value = struct.unpack("<i", struct.pack("<f", wire_value))[0]
            low, high = INTEGER_RANGE[param.type]
            if not (isfinite(value) and low <= value <= high):
                return param
            value = round(value)
        elif not isfinite(value):
            return param
        param.value = value
        return param
