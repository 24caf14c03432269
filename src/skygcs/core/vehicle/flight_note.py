"""Note that is kept of a vehicle for a daemon that begins anew while it flies. Pure.

Its last frames (heartbeat, position, landed state) bring back where it was and in which mode, who flew it decides
whether it is ordered to hold when it is heard, and what its battery gave is measured on.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from skygcs.core.mavlink.msgids import EXTENDED_SYS_STATE, GLOBAL_POSITION_INT, HEARTBEAT
from skygcs.core.vehicle.vehicle import Vehicle

KEPT_MESSAGES = (HEARTBEAT, GLOBAL_POSITION_INT, EXTENDED_SYS_STATE)

MAX_NAME = 64

MAX_FRAME_BYTES = 280
"""A MAVLink 2 frame with its signature."""

LEAST_DROP_PERCENT = 5.0
LEAST_FLIGHT_S = 120.0
"""Least drop and duration of a flight before its consumption is believed: charges are whole percents, and sag at the
take-off."""


class FlightRecord:
    """Measurements of a vehicle's battery in flight, for the next plan; a restart takes them from the journal."""

    def __init__(self, flown_s: float = 0.0, dropped_percent: float = 0.0) -> None:
        self._flown_s = flown_s
        self._dropped_percent = dropped_percent
        self._last: tuple[float, float] | None = None

    def charge(self, now: float, percent: float | None, *, in_air: bool) -> None:
        """The charge as reported now; a rise (another battery) begins anew."""
        if percent is None or not in_air:
            self._last = None
            return
        if self._last is not None:
            then, before = self._last
            if percent > before:
                self._flown_s = self._dropped_percent = 0.0
            else:
                self._flown_s += now - then
                self._dropped_percent += before - percent
        self._last = (now, percent)

    @property
    def consumption(self) -> tuple[float, float]:
        """Seconds in flight, and the percents of charge that they took."""
        return self._flown_s, self._dropped_percent

    @property
    def flight_time_s(self) -> float | None:
        """How long a full battery lasts by what was consumed in flight; None: too little was flown."""
        if self._flown_s < LEAST_FLIGHT_S or self._dropped_percent < LEAST_DROP_PERCENT:
            return None
        return 100.0 * self._flown_s / self._dropped_percent


@dataclass(frozen=True, slots=True)
class FlightNote:
    """One vehicle. ``frames``: raw, with the time (Unix) at which each came."""

    sysid: int
    compid: int
    name: str
    in_air: bool
    flown_by: str | None
    """Program that flew it last, if nobody else has flown it since (`UnattendedWatch.owed_to`)."""
    frames: tuple[tuple[float, bytes], ...]
    flown_s: float = 0.0
    dropped_percent: float = 0.0
    """Percent that its battery lost in ``flown_s`` of flight."""
    waits: bool = False
    """It holds until the daemon sends it home, and nobody else does that."""

    @property
    def key(self) -> int:
        return self.sysid << 8 | self.compid

    def as_json(self) -> dict[str, Any]:
        return {
            "sysid": self.sysid,
            "compid": self.compid,
            "name": self.name,
            "in_air": self.in_air,
            "flown_by": self.flown_by,
            "frames": [[round(at, 3), raw.hex()] for at, raw in self.frames],
            "flown_s": round(self.flown_s, 1),
            "dropped_percent": self.dropped_percent,
            "waits": self.waits,
        }

    @classmethod
    def from_json(cls, table: Mapping[str, Any]) -> FlightNote:
        """Raises ValueError, KeyError, TypeError or AttributeError for what is not a note."""
        sysid, compid = int(table["sysid"]), int(table["compid"])
        if not (1 <= sysid <= 255 and 0 <= compid <= 255):
            raise ValueError(f"system {sysid}/{compid}")
        flown_by = table["flown_by"]
        frames = tuple(
            (_finite(at), bytes.fromhex(raw[: 2 * MAX_FRAME_BYTES]))
            for at, raw in table["frames"][: len(KEPT_MESSAGES)]
        )
        return cls(
            sysid,
            compid,
            str(table["name"])[:MAX_NAME],
            table["in_air"] is True,
            None if flown_by is None else str(flown_by)[:MAX_NAME],
            frames,
            max(0.0, _finite(table["flown_s"])),
            max(0.0, _finite(table["dropped_percent"])),
            table.get("waits") is True,
        )


def _finite(value: Any) -> float:
    number = float(value)
    if not math.isfinite(number):
        raise ValueError(f"{value!r} is not a number")
    return number


def lost_place(vehicle: Vehicle, now: float) -> str:
    """Where and when a vehicle was lost, for people."""
    position, silence_s = vehicle.telemetry("position"), vehicle.silence_s(now) or 0.0
    where = "in the air"
    if position is not None and position["lat_deg"] is not None:
        where += f" at {position['lat_deg']:.6f}, {position['lon_deg']:.6f}, {position['alt_amsl_m']:.0f} m"
    return f"lost {where}, {silence_s:.0f} s ago"
