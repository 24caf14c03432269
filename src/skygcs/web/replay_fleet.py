"""The vehicles of a recording at one moment of it: the daemon's own `Vehicle`, fed by entries of a log. Pure.

A checkpoint holds the newest frame of each message of each source. Fed again in their order they give the same state,
so that a jump in a long recording reads from the nearest checkpoint on and not from the beginning.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

from skygcs.core.geo import Origin
from skygcs.core.mavlink.dialect import Dialect
from skygcs.core.mavlink.frame import Frame
from skygcs.core.mavlink.heartbeat import discovers
from skygcs.core.mavlink.msgids import STATUSTEXT
from skygcs.core.routing.source_statistics import SourceStats
from skygcs.core.vehicle.decoding import Decoder
from skygcs.core.vehicle.snapshot import take_snapshot
from skygcs.core.vehicle.status_texts import MAX_STATUS_TEXTS
from skygcs.core.vehicle.vehicle import Vehicle
from skygcs.events import Event

MAX_VEHICLES = 255
"""Number of system ids; a log with more is an attack."""

MAX_KEPT_OF_SOURCE = 256
"""Different messages of one vehicle in a checkpoint; an autopilot sends some 60."""

LINK = "recording"
"""The name of the link in the states of a replay."""

ORIGIN_FIX = 3
"""GPS_FIX_TYPE 3D: from there on the first position is the origin of the view."""


@dataclass(slots=True)
class _Kept:
    """The newest frame of one message."""

    frame: Frame
    at_s: float
    number: int


@dataclass(frozen=True, slots=True)
class Checkpoint:
    """State that `ReplayFleet.restore` needs, and where the log goes on after it."""

    at_s: float
    offset: int
    """Offset in the log of the first entry that is not in it."""
    frames: tuple[tuple[Frame, float], ...]
    origin: Origin | None


class ReplayFleet:
    """`on_frame` for each frame of the log, `tick` a few times per second of it; both return events."""

    def __init__(self, dialect: Dialect) -> None:
        self.vehicles: dict[int, Vehicle] = {}
        self.origin: Origin | None = None
        self._dialect = dialect
        self._decoder = Decoder(dialect)
        self._stats: dict[int, SourceStats] = {}
        self._kept: dict[int, dict[int, _Kept]] = {}
        self._number = self._texts = 0

    def on_frame(self, frame: Frame, at_s: float) -> Sequence[Event]:
        """One frame. Never raises for what is in it."""
        if frame.info is None:
            return ()
        key = frame.sysid << 8 | frame.compid
        vehicle = self.vehicles.get(key)
        events: tuple[Event, ...] = ()
        if vehicle is None:
            if len(self.vehicles) >= MAX_VEHICLES or not discovers(frame):
                return ()
            vehicle = self._add(frame)
            events = (Event("vehicle_discovered", vehicle.name, vehicle.sysid, "first heard", {}),)
        self._stats[key].on_frame(frame.seq, len(frame.raw), at_s)
        self._keep(key, frame, at_s)
        events += tuple(vehicle.on_frame(frame, at_s))
        if self.origin is None:
            self._find_origin(vehicle)
        return events

    def tick(self, at_s: float) -> Sequence[Event]:
        """Events of time alone."""
        events: list[Event] = []
        for vehicle in self.vehicles.values():
            events += vehicle.tick(at_s)
        for stats in self._stats.values():
            if at_s - stats.last_at < 5.0:
                stats.sample(at_s)
        return events

    def state(self, vehicle: Vehicle, at_s: float) -> dict[str, Any]:
        """The state of a vehicle, as the daemon returns it."""
        state: dict[str, Any] = dict(take_snapshot(vehicle, at_s))
        state["links"] = {LINK: self._stats[vehicle.key].as_dict(at_s) | {"replayed": True}}
        return state

    def find(self, target: object) -> Vehicle | None:
        """A vehicle by name or system id."""
        return next((v for v in self.vehicles.values() if str(target) in (v.name, str(v.sysid))), None)

    def checkpoint(self, at_s: float, offset: int) -> Checkpoint:
        """The present state; ``offset`` is where the log goes on."""
        kept = sorted((entry for of in self._kept.values() for entry in of.values()), key=lambda entry: entry.number)
        return Checkpoint(at_s, offset, tuple((entry.frame, entry.at_s) for entry in kept), self.origin)

    def restore(self, checkpoint: Checkpoint) -> None:
        """Begin from a checkpoint; for a fleet that was fed nothing yet."""
        self.origin = checkpoint.origin
        for frame, at_s in _heartbeats_first(checkpoint.frames):
            self.on_frame(frame, at_s)
        for key, vehicle in self.vehicles.items():  # the frames between were left out, not lost
            stats = self._stats[key] = SourceStats(vehicle.sysid, vehicle.compid)
            stats.last_at = max(entry.at_s for entry in self._kept[key].values())

    def _add(self, frame: Frame) -> Vehicle:
        first = all(v.sysid != frame.sysid for v in self.vehicles.values())
        name = f"v{frame.sysid}" if first else f"v{frame.sysid}.{frame.compid}"
        vehicle = Vehicle(frame.sysid, frame.compid, self._dialect, name=name, decoder=self._decoder, replayed=True)
        vehicle.origin = self.origin
        self.vehicles[vehicle.key] = vehicle
        self._stats[vehicle.key] = SourceStats(frame.sysid, frame.compid)
        self._kept[vehicle.key] = {}
        return vehicle

    def _keep(self, key: int, frame: Frame, at_s: float) -> None:
        kept = self._kept[key]
        self._number += 1
        place = frame.msgid
        if place == STATUSTEXT:  # the newest of these, not the newest alone
            self._texts += 1
            place = -1 - self._texts % MAX_STATUS_TEXTS
        entry = kept.get(place)
        if entry is not None:
            entry.frame, entry.at_s, entry.number = frame, at_s, self._number
        elif len(kept) < MAX_KEPT_OF_SOURCE:
            kept[place] = _Kept(frame, at_s, self._number)

    def _find_origin(self, vehicle: Vehicle) -> None:
        gps, position = vehicle.telemetry("gps"), vehicle.telemetry("position")
        if gps is None or position is None or position["lat_deg"] is None or gps.get("fix_type", 0) < ORIGIN_FIX:
            return
        self.origin = Origin(position["lat_deg"], position["lon_deg"], position["alt_amsl_m"])
        for other in self.vehicles.values():
            other.origin = self.origin


def _heartbeats_first(frames: Iterable[tuple[Frame, float]]) -> list[tuple[Frame, float]]:
    """The heartbeats make the vehicles known to which all other frames belong."""
    return sorted(frames, key=lambda entry: entry[0].msgid != 0)
