"""The UTIAS scripts' flight table, one per vehicle: time, mode, lat, lon, alt, vx, vy, vz, roll, pitch, yaw."""

from __future__ import annotations

from typing import Any

from skygcs.core.mavlink.dialect import Dialect
from skygcs.core.mavlink.frame import Frame
from skygcs.core.mavlink.heartbeat import HeartbeatChecks
from skygcs.core.mavlink.modes import mode_name
from skygcs.core.mavlink.msgids import HEARTBEAT
from skygcs.core.vehicle.decoder import Decoder
from skygcs.core.vehicle.decoding import TelemetryGroup, fold_attitude, fold_position
from skygcs.tlog.columns import NUMBER, TEXT, TIME, Kind
from skygcs.tlog.reading import LogEntry

COLUMNS: tuple[tuple[str, Kind], ...] = (
    ("time", TIME),
    ("mode", TEXT),
    *((name, NUMBER) for name in ("lat", "lon", "alt", "vx", "vy", "vz", "roll", "pitch", "yaw")),
)
"""Degrees; ``alt`` metres above home; ``vx``, ``vy``, ``vz`` m/s to the north, east and **down**, the axes of
GLOBAL_POSITION_INT; roll, pitch and compass heading (-180..180) in degrees."""

STALE_S = 5.0
"""What was told longer ago is no part of a row any more; thin links send attitude once a second and lose some."""

POSITION, ATTITUDES = "GLOBAL_POSITION_INT", ("ATTITUDE", "ATTITUDE_QUATERNION")

VehicleKey = tuple[int, int]
"""System and component."""


class FlightTables:
    """Rows of all vehicles: one with each position; while none comes, one with each attitude.

    A vehicle is what a daemon would have found (`core.mavlink.heartbeat`); what came before its first heartbeat makes
    no row.
    """

    def __init__(self, dialect: Dialect) -> None:
        self._decoder = Decoder(dialect)
        self._position = self._decoder.msgid_of(POSITION)
        self._attitudes = {self._decoder.msgid_of(name): name for name in ATTITUDES}
        self._heartbeats = HeartbeatChecks()
        self._vehicles: dict[VehicleKey, _Newest] = {}

    def row(self, entry: LogEntry) -> tuple[VehicleKey, list[Any]] | None:
        """The vehicle and its next row, if this entry makes one. In a raw capture ``time`` is `at_s`."""
        frame = entry.frame
        if frame is None or frame.info is None:
            return None
        key = frame.sysid, frame.compid
        own = self._heartbeats.own(frame, entry.at_s)
        if frame.msgid == HEARTBEAT:
            if own:
                self._vehicles.setdefault(key, _Newest()).mode = _mode(frame)
            return None
        vehicle = self._vehicles.get(key)
        if vehicle is None:
            return None
        now = entry.at_s
        if frame.msgid == self._position:
            vehicle.position = fold_position({POSITION: self._decoder.values(POSITION, frame.payload)}, self._decoder)
            vehicle.position_s = now
        elif frame.msgid in self._attitudes:
            name = self._attitudes[frame.msgid]
            vehicle.attitude = fold_attitude({name: self._decoder.values(name, frame.payload)}, self._decoder)
            vehicle.attitude_s = now
            if vehicle.position is not None and now - vehicle.position_s <= STALE_S:
                return None
        else:
            return None
        time = entry.unix_us if entry.unix_us is not None else round(now * 1e6)
        return key, [time, *vehicle.cells(now)]


class _Newest:
    """What one vehicle last told."""

    __slots__ = ("attitude", "attitude_s", "mode", "position", "position_s")

    def __init__(self) -> None:
        self.mode = ""
        self.position: TelemetryGroup | None = None
        self.position_s = 0.0
        self.attitude: TelemetryGroup | None = None
        self.attitude_s = 0.0

    def cells(self, now: float) -> list[Any]:
        place: list[Any] = [None] * 6
        angles: list[Any] = [None] * 3
        if self.position is not None and now - self.position_s <= STALE_S:
            east, north, up = self.position["vel_enu_mps"]
            place = [*(self.position[name] for name in ("lat_deg", "lon_deg", "alt_rel_m")), north, east, 0.0 - up]
        if self.attitude is not None and now - self.attitude_s <= STALE_S:
            angles = [self.attitude[name] for name in ("roll_deg", "pitch_deg", "yaw_deg")]
        return [self.mode, *place, *angles]


def _mode(frame: Frame) -> str:
    fields = frame.fields()
    return mode_name(fields["autopilot"], fields["type"], fields.get("base_mode", 0), fields.get("custom_mode", 0))
