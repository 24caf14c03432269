"""One item of a mission, a fence or a rally list, as MISSION_ITEM_INT carries it.

An item holds only values that can be sent: numbers are rounded to the float32 of the wire, positions to its integers,
and the two names that MAVLink has for each global frame become one. So an item that was uploaded, downloaded, written
to a file and read again compares equal to the original.

Items have one numbering: the first is 1, in files, orders, answers, events and on the page. QGroundControl and Mission
Planner show the same numbers, and a DO_JUMP of a file names them. Only the wire counts otherwise: an ArduPilot has its
home as item 0, so that its sequence numbers equal ours; those of a PX4, which has no such item, are lower by one.

Protocol: https://mavlink.io/en/services/mission.html
"""

from __future__ import annotations

import math
import struct
from collections.abc import Mapping
from dataclasses import dataclass
from enum import IntEnum
from typing import Any

from skygcs.core.mavlink import mav_cmd

UNSET_INT = 2**31 - 1
"""x or y of a global frame that is not set: the integer form of NaN in PX4."""

FIRST_ITEM = 1

MAX_ITEMS = 65535
"""MISSION_COUNT.count and seq are uint16."""

GLOBAL, MISSION_FRAME, RELATIVE_ALT, TERRAIN_ALT = 0, 2, 3, 10
"""MAV_FRAME values used in missions."""

_ONE_NAME = {5: GLOBAL, 6: RELATIVE_ALT, 11: TERRAIN_ALT}
"""The ..._INT frames mean the same in MISSION_ITEM_INT, and both autopilots accept either."""

GLOBAL_FRAMES = frozenset({GLOBAL, RELATIVE_ALT, TERRAIN_ALT})
LOCAL_FRAMES = frozenset({1, 4, 7, 8, 9, 12, 20, 21})

FENCE_COMMANDS = frozenset(
    {
        mav_cmd.NAV_FENCE_RETURN_POINT,
        mav_cmd.NAV_FENCE_POLYGON_VERTEX_INCLUSION,
        mav_cmd.NAV_FENCE_POLYGON_VERTEX_EXCLUSION,
        mav_cmd.NAV_FENCE_CIRCLE_INCLUSION,
        mav_cmd.NAV_FENCE_CIRCLE_EXCLUSION,
    }
)


class MissionType(IntEnum):
    """MAV_MISSION_TYPE."""

    MISSION = 0
    FENCE = 1
    RALLY = 2

    @property
    def word(self) -> str:
        return self.name.lower()


@dataclass(frozen=True, slots=True)
class MissionItem:
    """``params`` are param1 to param4 and ``z`` is param7; None is not set, NaN on the wire. ``x`` and ``y`` are as on
    the wire: degrees * 1e7 in a global frame (`UNSET_INT`: not set), metres * 1e4 in a local one, else plain integers.

    Raises ValueError naming the field that MISSION_ITEM_INT cannot carry.
    """

    command: int
    frame: int = RELATIVE_ALT
    params: tuple[float | None, float | None, float | None, float | None] = (0.0, 0.0, 0.0, 0.0)
    x: int = 0
    y: int = 0
    z: float | None = 0.0
    autocontinue: bool = True

    def __post_init__(self) -> None:
        if not 0 <= self.command <= 0xFFFF:
            raise ValueError(f"command {self.command} is not between 0 and 65535")
        if not 0 <= self.frame <= 0xFF:
            raise ValueError(f"frame {self.frame} is not between 0 and 255")
        for name, value in (("x", self.x), ("y", self.y)):
            if not -(2**31) <= value <= UNSET_INT:
                raise ValueError(f"{name} = {value} does not fit in 32 bits")
        put = object.__setattr__
        put(self, "frame", _ONE_NAME.get(self.frame, self.frame))
        put(self, "params", tuple(float32(value, f"param{n}") for n, value in enumerate(self.params, 1)))
        put(self, "z", float32(self.z, "param7"))

    @classmethod
    def from_params(cls, command: int, frame: int, params: tuple[float | None, ...], autocontinue: bool) -> MissionItem:
        """An item from the seven numbers in files: x and y in degrees, metres or plain. Raises ValueError."""
        p1, p2, p3, p4, p5, p6, p7 = params
        frame = _ONE_NAME.get(frame, frame)
        x, y = wire_int(frame, p5, "param5"), wire_int(frame, p6, "param6")
        return cls(command, frame, (p1, p2, p3, p4), x, y, p7, autocontinue)

    @classmethod
    def from_fields(cls, fields: Mapping[str, Any]) -> MissionItem:
        """From a MISSION_ITEM_INT. Raises ValueError for infinite numbers."""
        return cls(
            fields["command"],
            fields["frame"],
            (fields["param1"], fields["param2"], fields["param3"], fields["param4"]),
            fields["x"],
            fields["y"],
            fields["z"],
            bool(fields["autocontinue"]),
        )

    def values(self) -> dict[str, Any]:
        """Fields of MISSION_ITEM_INT, without target, seq, current and type."""
        numbers = {f"param{n}": math.nan if value is None else value for n, value in enumerate(self.params, 1)}
        return {
            "frame": self.frame,
            "command": self.command,
            "autocontinue": int(self.autocontinue),
            **numbers,
            "x": self.x,
            "y": self.y,
            "z": math.nan if self.z is None else self.z,
        }

    @property
    def seven(self) -> tuple[float | None, ...]:
        """The seven numbers for a file, in their shortest form; the inverse of `from_params`."""
        p1, p2, p3, p4, z = (None if value is None else shortest(value) for value in (*self.params, self.z))
        return p1, p2, p3, p4, file_number(self.frame, self.x), file_number(self.frame, self.y), z

    @property
    def position(self) -> tuple[float, float] | None:
        """(lat_deg, lon_deg), or None. 0, 0 is not a position: ArduPilot reads it as the vehicle's own position
        then."""
        if self.frame not in GLOBAL_FRAMES or UNSET_INT in (self.x, self.y) or (self.x, self.y) == (0, 0):
            return None
        return self.x / 1e7, self.y / 1e7

    @property
    def moves(self) -> bool:
        """True for a NAV command, which moves the vehicle."""
        return self.command < mav_cmd.NAV_LAST


def first_seq(*, home_first: bool) -> int:
    """The sequence number of `FIRST_ITEM`. ``home_first``: item 0 of the wire is the vehicle's home."""
    return 1 if home_first else 0


def item_of_seq(seq: int, *, home_first: bool) -> int:
    """The item with this sequence number; 0 is an ArduPilot's home."""
    return seq - first_seq(home_first=home_first) + FIRST_ITEM


def seq_of_item(item: int, *, home_first: bool) -> int:
    """The inverse of `item_of_seq`."""
    return item - FIRST_ITEM + first_seq(home_first=home_first)


def float32(value: float | None, name: str) -> float | None:
    """The number after rounding to float32; None for NaN. Raises ValueError if it is not finite then."""
    if value is None or math.isnan(value):
        return None
    try:
        rounded: float = struct.unpack("<f", struct.pack("<f", value))[0]
    except OverflowError:
        rounded = math.inf
    if math.isinf(rounded):
        raise ValueError(f"{name} = {value:g} is infinite or too large for a 32-bit float")
    return rounded


def shortest(value: float) -> float:
    """The float with the fewest digits for the same float32: 0.1, not 0.10000000149011612; for files."""
    for digits in range(6, 10):
        text = f"{value:.{digits}g}"
        if float32(float(text), "") == value:
            return float(text)
    return value


def wire_int(frame: int, value: float | None, name: str) -> int:
    """x or y of MISSION_ITEM_INT for a number from a file. Raises ValueError."""
    if value is None or math.isnan(value):
        return UNSET_INT if frame in GLOBAL_FRAMES else 0
    scaled = value * _scale(frame)
    if math.isinf(scaled):
        raise ValueError(f"{name} is infinite")
    return round(scaled)


def file_number(frame: int, wire: int) -> float | None:
    """The inverse of `wire_int`."""
    if frame in GLOBAL_FRAMES and wire == UNSET_INT:
        return None
    scale = _scale(frame)
    return float(wire) if scale == 1 else wire / scale


def _scale(frame: int) -> float:
    if frame in GLOBAL_FRAMES:
        return 1e7
    return 1e4 if frame in LOCAL_FRAMES else 1.0
