"""COMMAND_LONG and COMMAND_INT as one thing, the way the firmwares treat them."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from math import nan
from typing import Any

INT_UNSET = (1 << 31) - 1
"""x or y of a COMMAND_INT that says nothing (MAVLink command guide); NaN's counterpart."""


@dataclass(frozen=True, slots=True)
class Command:
    """One order and who gave it. ``frame`` is None for a COMMAND_LONG, which has none.

    ``p5``/``p6`` are the raw values; ``lat_deg``/``lon_deg`` the same as a position, NaN where unset.
    """

    id: int
    p1: float
    p2: float
    p3: float
    p4: float
    p5: float
    p6: float
    p7: float
    lat_deg: float
    lon_deg: float
    frame: int | None
    sender: tuple[int, int]


def from_long(fields: dict[str, Any], sender: tuple[int, int]) -> Command:
    return Command(
        int(fields["command"]),
        fields["param1"],
        fields["param2"],
        fields["param3"],
        fields["param4"],
        fields["param5"],
        fields["param6"],
        fields["param7"],
        lat_deg=fields["param5"],
        lon_deg=fields["param6"],
        frame=None,
        sender=sender,
    )


def from_int(fields: dict[str, Any], sender: tuple[int, int]) -> Command:
    x, y = int(fields["x"]), int(fields["y"])
    return Command(
        int(fields["command"]),
        fields["param1"],
        fields["param2"],
        fields["param3"],
        fields["param4"],
        float(x),
        float(y),
        fields["z"],
        lat_deg=nan if x == INT_UNSET else x / 1e7,
        lon_deg=nan if y == INT_UNSET else y / 1e7,
        frame=int(fields["frame"]),
        sender=sender,
    )


Script = Iterator[float]
"""Sequence of actions; each yields the seconds until the next one."""


@dataclass(slots=True)
class Calibration:
    """A calibration that runs: its command's sender, its script, and when that goes on."""

    sender: tuple[int, int]
    script: Script
    due: float
    sensor: str
    position: int = 0
    """The pose an ArduCopter waits for, as ACCELCAL_VEHICLE_POS; 0: none."""
    confirmed: bool = False
