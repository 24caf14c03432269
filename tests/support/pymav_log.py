"""A tlog as pymavlink reads it: the oracle of what is counted and measured in logs.

Records are found by the length in each frame's header, and decoded by pymavlink's own tables.
"""

from __future__ import annotations

import contextlib
import struct
from collections.abc import Iterator
from typing import Any, NamedTuple

from pymavlink.dialects.v20 import all as mav

V1_ID, V2_ID = 5, 7
"""Where the message's id stands in a frame; its lowest byte in MAVLink 2."""


class PymavRecord(NamedTuple):
    """A good record; ``message`` is pymavlink's, also of an id that it does not know."""

    at_s: float
    sysid: int
    compid: int
    message: Any

    @property
    def name(self) -> str:
        return str(self.message.get_type())


def records(content: bytes, only: frozenset[int] = frozenset()) -> Iterator[PymavRecord]:
    """The records in the file's order, of a log without junk between them. ``only``: ids below 256; none: all."""
    reader = mav.MAVLink(None)
    at = 0
    while at + 20 <= len(content):
        (unix_us,) = struct.unpack(">Q", content[at : at + 8])
        v1 = content[at + 8] == 0xFE
        size = content[at + 9] + (8 if v1 else 12 + 13 * (content[at + 10] & 1))
        frame = content[at + 8 : at + 8 + size]
        at += 8 + size
        if only and frame[V1_ID if v1 else V2_ID] not in only:
            continue
        with contextlib.suppress(mav.MAVError):
            message = reader.decode(bytearray(frame))
            yield PymavRecord(unix_us / 1e6, *(frame[3:5] if v1 else frame[5:7]), message)
