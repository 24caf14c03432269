"""A message's fields as columns of a table: scalars as they are, arrays element by element."""

from __future__ import annotations

from typing import Any

from skygcs.core.mavlink.dialect import FieldInfo, MessageInfo
from skygcs.core.mavlink.frame import Frame
from skygcs.tlog.reading import LogEntry

LONGEST_SPLIT = 32
"""A longer array of bytes is data (of a file, a log, a serial port) and one cell in hexadecimal."""

Kind = str
"""Type of a column: a scalar type of MAVLink (uint8_t … double), or one of the three below."""

TEXT: Kind = "text"
TIME: Kind = "time"
NUMBER: Kind = "number"

HEAD = (("time", TIME), ("sysid", "uint8_t"), ("compid", "uint8_t"))
"""What stands before the fields; ``time`` is microseconds since 1970, None in a raw capture."""


class MessageColumns:
    """The table of one message: ``columns`` are (name, kind), `row` has a value for each."""

    def __init__(self, info: MessageInfo) -> None:
        self.name = info.name
        self._fields = tuple((field.name, _is_split(field), _is_hex(field)) for field in info.fields)
        columns: list[tuple[str, Kind]] = list(HEAD)
        taken = {name for name, _ in HEAD}
        for field in info.fields:
            columns += [(_free(name, taken), kind) for name, kind in _columns_of(field)]
        self.columns = tuple(columns)

    def row(self, entry: LogEntry, frame: Frame) -> list[Any]:
        """A time in microseconds since 1970 or None, numbers as decoded, text."""
        row: list[Any] = [entry.unix_us, frame.sysid, frame.compid]
        values = frame.fields()
        for name, split, is_hex in self._fields:
            value = values[name]
            if split:
                row += value
            elif is_hex:
                row.append(bytes(value).hex())
            else:
                row.append(value)
        return row


def _is_hex(field: FieldInfo) -> bool:
    return field.type == "uint8_t" and field.array_length > LONGEST_SPLIT


def _is_split(field: FieldInfo) -> bool:
    return bool(field.array_length) and field.type != "char" and not _is_hex(field)


def _columns_of(field: FieldInfo) -> list[tuple[str, Kind]]:
    if field.type == "char" or _is_hex(field):
        return [(field.name, TEXT)]
    if field.array_length:
        return [(f"{field.name}_{n}", field.type) for n in range(field.array_length)]
    return [(field.name, field.type)]


def _free(name: str, taken: set[str]) -> str:
    """A name that no other column of the table has: some messages have a field called "time"."""
    while name in taken:
        name += "_"
    taken.add(name)
    return name
