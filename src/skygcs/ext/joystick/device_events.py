"""The Linux joystick device (/dev/input/jsN): struct js_event, and what axes and buttons are after it.

linux/joystick.h: u32 time in ms, s16 value, u8 type (1 button, 2 axis; 0x80 marks the state at opening), u8 number. The
kernel sends the state of everything once after opening, then changes only: a stick that is held still sends nothing.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator
from dataclasses import dataclass

EVENT = struct.Struct("=IhBB")
BUTTON = 0x01
AXIS = 0x02
INITIAL = 0x80
FULL_SCALE = 32767


@dataclass(frozen=True)
class JoystickEvent:
    """``kind`` is BUTTON or AXIS; ``value`` is 0 or 1 of a button, -1 to 1 of an axis."""

    kind: int
    number: int
    value: float


class EventReader:
    """Splits bytes into events. Others than those of buttons and axes are counted and passed over."""

    def __init__(self) -> None:
        self._rest = b""
        self.unknown = 0

    def feed(self, data: bytes) -> Iterator[JoystickEvent]:
        """The events that are complete now; at most 7 bytes are kept for the next."""
        data = self._rest + data
        whole = len(data) - len(data) % EVENT.size
        self._rest = data[whole:]
        for _, value, kind, number in EVENT.iter_unpack(data[:whole]):
            kind &= ~INITIAL
            if kind == AXIS:
                yield JoystickEvent(AXIS, number, max(-1.0, value / FULL_SCALE))  # -32768 exists
            elif kind == BUTTON:
                yield JoystickEvent(BUTTON, number, float(value != 0))
            else:
                self.unknown += 1
