"""A MAVLink dialect as tables: what a message looks like on the wire, and what its enums are called.

Pure data. Where it comes from (XML, through mavgen's parser, cached) is `skygcs.config.dialects`.
Wire layout: https://mavlink.io/en/guide/serialization.html (little-endian, base fields sorted by type length,
extension fields behind them unsorted, trailing zero bytes of a MAVLink 2 payload trimmed).

A daemon uses some 60 of 400 messages and 10 of 200 enums. The fields and entries of a table are kept as its text until
they are first asked for: 20 µs for a message, 0.3 ms for MAV_CMD, and 1 MB of memory less.
"""

from __future__ import annotations

import json
import operator
import struct
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping
from typing import Any

from skygcs.spelling import near_names

STRUCT_CODE = {
    "char": "c",
    "int8_t": "b",
    "uint8_t": "B",
    "int16_t": "h",
    "uint16_t": "H",
    "int32_t": "i",
    "uint32_t": "I",
    "int64_t": "q",
    "uint64_t": "Q",
    "float": "f",
    "double": "d",
}

MAX_PAYLOAD_BYTES = 255
"""The length field is one byte (MAVLink serialization guide)."""

ABSENT = -1
"""Offset of a target field that a message does not have."""

_ZEROS = bytes(MAX_PAYLOAD_BYTES + 8)

MAX_PACKERS = 8
"""Sets of fields of one message that have a packer of their own: what people send by hand makes no end of them."""

Packer = Callable[[Mapping[str, Any]], bytes | None]


def _pack_nothing(values: Mapping[str, Any]) -> bytes | None:
    """Return None: the fields have to be packed one by one."""
    return None


class FieldInfo:
    """One field of a message. ``array_length`` is 0 for a scalar; ``offset`` in bytes from the payload's start."""

    __slots__ = ("array_length", "bitmask", "enum", "extension", "name", "offset", "type", "units")

    def __init__(
        self,
        name: str,
        type: str,
        array_length: int,
        offset: int,
        extension: bool,
        enum: str = "",
        units: str = "",
        bitmask: bool = False,
    ) -> None:
        # of 4,000 fields most share their words: 0.5 MB of a daemon's memory
        self.name = sys.intern(name)
        self.type = sys.intern(type)
        self.array_length = array_length
        self.offset = offset
        self.extension = extension
        self.enum = sys.intern(enum)
        self.units = sys.intern(units)
        self.bitmask = bitmask

    @property
    def code(self) -> str:
        """struct format of the whole field, without byte order."""
        if not self.array_length:
            return STRUCT_CODE[self.type]
        if self.type == "char":
            return f"{self.array_length}s"
        return f"{self.array_length}{STRUCT_CODE[self.type]}"


class MessageInfo:
    """Wire layout of one message.

    ``min_length`` is the payload without extensions (what MAVLink 1 carries), ``length`` with them, in bytes.
    ``target_system_offset``/``target_component_offset`` are ABSENT where the message has no such field.
    """

    __slots__ = (
        "_fields",
        "_names",
        "_packers",
        "_struct",
        "crc_extra",
        "crc_extra_byte",
        "length",
        "min_length",
        "msgid",
        "name",
        "target_component_offset",
        "target_system_offset",
    )

    def __init__(
        self,
        msgid: int,
        name: str,
        crc_extra: int,
        min_length: int,
        length: int,
        target_system_offset: int,
        target_component_offset: int,
        fields: Iterable[FieldInfo] | str,
    ) -> None:
        """``fields``: these, or the text of `_fields_text`."""
        self.msgid = msgid
        self.name = name
        self.crc_extra = crc_extra
        self.crc_extra_byte = bytes([crc_extra])
        self.min_length = min_length
        self.length = length
        self.target_system_offset = target_system_offset
        self.target_component_offset = target_component_offset
        self._fields = fields if isinstance(fields, str) else tuple(fields)
        self._struct: struct.Struct | None = None
        self._names: tuple[tuple[str, int, bool], ...] = ()
        self._packers: dict[tuple[str, ...], Packer] = {}

    def __repr__(self) -> str:
        return f"<MessageInfo {self.name} id {self.msgid}>"

    @property
    def fields(self) -> tuple[FieldInfo, ...]:
        """All fields in the order of the XML."""
        fields = self._fields  # read once: another thread may ask for them at the same time
        if isinstance(fields, str):
            fields = self._fields = tuple(FieldInfo(*row) for row in json.loads(fields))
        return fields

    @fields.setter
    def fields(self, fields: tuple[FieldInfo, ...]) -> None:
        self._fields = fields

    def _compiled(self) -> struct.Struct:
        """The struct of the whole payload, made on first use: most of a dialect's messages are never unpacked."""
        if self._struct is None:
            wire = sorted(self.fields, key=lambda f: f.offset)
            self._names = tuple((f.name, f.array_length, f.type == "char") for f in wire)
            self._struct = struct.Struct("<" + "".join(f.code for f in wire))
        return self._struct

    def unpack(self, payload: bytes) -> dict[str, Any]:
        """Fields by name in wire order; a shorter payload is zero-extended, a longer one cut.

        char arrays become str up to the first NUL; number arrays become lists. Never raises.
        """
        compiled = self._compiled()
        if len(payload) < compiled.size:
            payload = payload + _ZEROS[: compiled.size - len(payload)]
        values = compiled.unpack_from(payload)
        result: dict[str, Any] = {}
        at = 0
        for name, count, is_char in self._names:
            if is_char:
                raw = values[at].split(b"\0", 1)[0] if count else values[at]
                result[name] = raw.decode("utf-8", "replace")
                at += 1
            elif count:
                result[name] = list(values[at : at + count])
                at += count
            else:
                result[name] = values[at]
                at += 1
        return result

    def pack(self, values: Mapping[str, Any]) -> bytes:
        """The full payload, extensions included, untrimmed. Missing fields are 0.

        Raises ValueError naming the message and field for an unknown field, a wrong type or a value out of range.
        """
        given = tuple(values)
        packer = self._packers.get(given)
        if packer is None and len(self._packers) < MAX_PACKERS:
            packer = self._packers[given] = self._packer_of(given)
        if packer is not None and (packed := packer(values)) is not None:
            return packed
        unknown = values.keys() - {f.name for f in self.fields}
        if unknown:
            names = ", ".join(sorted(f.name for f in self.fields))
            raise ValueError(f"{self.name} has no field {sorted(unknown)[0]!r}; it has: {names}")
        payload = bytearray(self.length)
        for field in self.fields:
            if field.name in values:
                self._pack_field(payload, field, values[field.name])
        return bytes(payload)

    def _packer_of(self, names: tuple[str, ...]) -> Packer:
        """A function that packs just these fields in one struct call; it returns None for values that do not fit,
        which are then packed field by field for an error with the name. Our periodic messages, above all setpoints,
        have the same fields each time (SET_ATTITUDE_TARGET: 0.7 us instead of 1.3)."""
        wire = sorted(self.fields, key=lambda f: f.offset)
        given = [f for f in wire if f.name in names]
        arrays = [n for n, field in enumerate(given) if field.array_length]
        if len(given) != len(names) or len(given) < 2 or len(arrays) > 1 or any(f.type == "char" for f in given):
            return _pack_nothing
        codes = (f.code if f.name in names else f"{struct.calcsize('<' + f.code)}x" for f in wire)
        pack = struct.Struct("<" + "".join(codes)).pack  # pad bytes are zero
        pick = operator.itemgetter(*(f.name for f in given))
        at = arrays[0] if arrays else len(given)

        def packed(values: Mapping[str, Any]) -> bytes | None:
            numbers = pick(values)
            try:
                return pack(*numbers[:at], *numbers[at], *numbers[at + 1 :]) if arrays else pack(*numbers)
            except (struct.error, TypeError, OverflowError):
                return None

        return packed

    def _pack_field(self, payload: bytearray, field: FieldInfo, value: Any) -> None:
        try:
            if field.type == "char":
                raw = value.encode() if isinstance(value, str) else bytes(value)
                size = field.array_length or 1
                if len(raw) > size:
                    raise ValueError(f"{len(raw)} bytes do not fit in {size}")
                payload[field.offset : field.offset + len(raw)] = raw
            elif field.array_length:
                items = list(value)
                if len(items) > field.array_length:
                    raise ValueError(f"{len(items)} values do not fit in {field.array_length}")
                items += [0] * (field.array_length - len(items))
                struct.pack_into("<" + field.code, payload, field.offset, *items)
            else:
                struct.pack_into("<" + field.code, payload, field.offset, value)
        except (struct.error, TypeError, ValueError, OverflowError) as error:
            raise ValueError(f"{self.name}.{field.name} ({field.type}): {error}") from None

    def reader(self, *names: str) -> Callable[[bytes], tuple[Any, ...]]:
        """A function payload -> the named scalar fields, in the order given, by one struct call.

        For folding state: unpacks only what is wanted; a trimmed payload is zero-extended first.
        Raises KeyError (at once, not when reading) if the message has no such field.
        """
        by_name = {f.name: f for f in self.fields}
        wanted = sorted((by_name[n] for n in names), key=lambda f: f.offset)
        fmt, at = "<", 0
        for field in wanted:
            if field.offset > at:
                fmt += f"{field.offset - at}x"
            fmt += field.code
            at = field.offset + struct.calcsize("<" + field.code)
        compiled = struct.Struct(fmt)
        size = compiled.size
        order = [f.name for f in wanted]
        permutation = None if order == list(names) else tuple(order.index(n) for n in names)

        def read(payload: bytes) -> tuple[Any, ...]:
            if len(payload) < size:
                payload = payload + _ZEROS[: size - len(payload)]
            values = compiled.unpack_from(payload)
            if permutation is None:
                return values
            return tuple(values[i] for i in permutation)

        return read


class EnumTable(Mapping[str, Mapping[int, str]]):
    """Enums by name, each entry's name by its value."""

    __slots__ = ("_enums",)

    def __init__(self, enums: Mapping[str, Mapping[int, str] | str]) -> None:
        """An enum that is a text: a list of (value, name) in JSON."""
        self._enums = {k: v if isinstance(v, str) else dict(v) for k, v in enums.items()}

    def __getitem__(self, name: str) -> Mapping[int, str]:
        entries = self._enums[name]
        if isinstance(entries, str):
            entries = self._enums[name] = {int(value): entry for value, entry in json.loads(entries)}
        return entries

    def __iter__(self) -> Iterator[str]:
        return iter(self._enums)

    def __len__(self) -> int:
        return len(self._enums)


class Dialect:
    """All messages and enums of one dialect: ``messages`` by id, ``by_name``, ``enums[enum][value] = entry``."""

    __slots__ = ("by_name", "enums", "messages", "name")

    def __init__(
        self, name: str, messages: Iterable[MessageInfo], enums: Mapping[str, Mapping[int, str] | str]
    ) -> None:
        """``enums``: as of `EnumTable`."""
        self.name = name
        self.messages: dict[int, MessageInfo] = {m.msgid: m for m in messages}
        self.by_name: dict[str, MessageInfo] = {m.name: m for m in self.messages.values()}
        self.enums = EnumTable(enums)

    def find(self, name_or_id: str | int) -> MessageInfo:
        """The message of that name (any case) or id. Raises KeyError with a text for a person."""
        if isinstance(name_or_id, int) or name_or_id.isdigit():
            info = self.messages.get(int(name_or_id))
        else:
            info = self.by_name.get(name_or_id) or self.by_name.get(name_or_id.upper())
            if info is None:  # XML may use another case than upper: the UTIAS lab's message is called "utias"
                group_values = name_or_id.upper()
                info = next((m for n, m in self.by_name.items() if n.upper() == group_values), None)
        if info is None:
            near = near_names(str(name_or_id), self.by_name)
            hint = f"; did you mean {', '.join(near)}?" if near else ""
            raise KeyError(f"dialect {self.name} has no message {name_or_id!r}{hint}")
        return info

    def enum_value(self, enum: str, name: str) -> int:
        """Value of an enum entry by its full name. Raises KeyError."""
        for value, entry in self.enums.get(enum, {}).items():
            if entry == name:
                return value
        raise KeyError(f"{enum} has no entry {name}")

    def to_table(self) -> dict[str, Any]:
        """JSON-able form, the content of the cache file; `from_table` is its inverse."""
        return {
            "name": self.name,
            "messages": [
                [
                    m.msgid,
                    m.name,
                    m.crc_extra,
                    m.min_length,
                    m.length,
                    m.target_system_offset,
                    m.target_component_offset,
                    _fields_text(m.fields),
                ]
                for m in self.messages.values()
            ],
            "enums": {k: _text(list(v.items())) for k, v in self.enums.items()},
        }

    @classmethod
    def from_table(cls, table: Mapping[str, Any]) -> Dialect:
        """Inverse of `to_table`. Raises KeyError, TypeError or ValueError on a table of another shape; the texts of
        fields and enums in it are not read yet."""
        return cls(table["name"], [MessageInfo(*row) for row in table["messages"]], table["enums"])


def _fields_text(fields: Iterable[FieldInfo]) -> str:
    """The arguments of each `FieldInfo`."""
    return _text([[f.name, f.type, f.array_length, f.offset, f.extension, f.enum, f.units, f.bitmask] for f in fields])


def _text(rows: list[Any]) -> str:
    return json.dumps(rows, separators=(",", ":"))
