"""Motion of a recorded flight for other tools: poses, batteries and texts of each vehicle, in the field's usual axes.

Places are metres east, north and up of one origin; attitudes are quaternions of a body with x forward, y left, z up
against these axes (ROS REP 103). MAVLink's own axes are north, east, down and forward, right, down.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

from skygcs.core.geo import EnuFrame, Origin, quaternion_from_euler
from skygcs.core.mavlink.dialect import Dialect
from skygcs.core.mavlink.frame import Frame
from skygcs.core.mavlink.heartbeat import HeartbeatChecks
from skygcs.core.mavlink.msgids import HEARTBEAT
from skygcs.core.vehicle.decoding import (
    Decoder,
    decode_attitude,
    decode_battery,
    decode_gps,
    decode_position,
)
from skygcs.core.vehicle.status_texts import StatusTextAssembler
from skygcs.tlog.format import LogEntry

POSITION = "GLOBAL_POSITION_INT"
DECODED = (POSITION, "ATTITUDE", "ATTITUDE_QUATERNION", "GPS_RAW_INT", "SYS_STATUS", "BATTERY_STATUS", "STATUSTEXT")

STALE_S = 5.0
"""An older attitude is not joined to a position; as in the flight tables."""

MOST_VEHICLES = 255
"""Number of system ids; a log with more is an attack."""

Quaternion = tuple[float, float, float, float]
"""x, y, z, w."""

LEVEL: Quaternion = (0.0, 0.0, 0.0, 1.0)


@dataclass(frozen=True, slots=True)
class PoseSample:
    """A position, and the attitude that belongs to it."""

    vehicle: tuple[int, int]
    """System and component."""
    lat_deg: float
    lon_deg: float
    alt_amsl_m: float
    pos_enu_m: tuple[float, float, float]
    vel_enu_mps: tuple[float, float, float]
    orientation: Quaternion
    """LEVEL without a fresh attitude."""
    fix: bool
    """True if the last GPS_RAW_INT had a position; True if there was none."""


@dataclass(frozen=True, slots=True)
class BatterySample:
    """The newest values of the main battery; None: not reported."""

    vehicle: tuple[int, int]
    volts: float | None
    amps: float | None
    percent: float | None


@dataclass(frozen=True, slots=True)
class TextSample:
    """A whole STATUSTEXT. ``severity`` is MAV_SEVERITY: 0 emergency to 7 debug."""

    vehicle: tuple[int, int]
    severity: int
    text: str


Sample = PoseSample | BatterySample | TextSample


def orientation_of(roll_deg: float, pitch_deg: float, yaw_deg: float) -> Quaternion:
    """From the autopilot's angles: yaw is the compass heading, pitch is positive nose up."""
    yaw_enu_rad = math.pi / 2 - math.radians(yaw_deg)
    w, x, y, z = quaternion_from_euler(math.radians(roll_deg), -math.radians(pitch_deg), yaw_enu_rad)
    return x, y, z, w


class Motion:
    """Takes a log's entries and returns samples of its vehicles, which are found by their heartbeats."""

    def __init__(self, dialect: Dialect, origin: Origin | None = None) -> None:
        """``origin``: of the axes; None: the first position."""
        self.origin = origin
        self._frame = None if origin is None else EnuFrame(origin)
        self._decoder = Decoder(dialect)
        self._names = {self._decoder.msgid_of(name): name for name in DECODED}
        self._names.pop(-1, None)
        self._heartbeats = HeartbeatChecks()
        self._vehicles: dict[tuple[int, int], _Newest] = {}

    def samples(self, entry: LogEntry) -> Iterator[Sample]:
        """The samples that this entry completes."""
        # heartbeats make a vehicle known
        frame, now = entry.frame, entry.at_s
        if frame is None or frame.info is None:
            return
        key = frame.sysid, frame.compid
        own = self._heartbeats.own(frame, now)
        if frame.msgid == HEARTBEAT:
            if own and (key in self._vehicles or len(self._vehicles) < MOST_VEHICLES):
                self._vehicles.setdefault(key, _Newest())
            return
        # further messages count for known vehicles only
        newest, name = self._vehicles.get(key), self._names.get(frame.msgid)
        if newest is None or name is None:
            return
        if name == "STATUSTEXT":
            yield from newest.on_text(key, frame, now)
            return
        # decode, and join with the newest values of other messages
        values = self._decoder.values(name, frame.payload)
        if not values:
            return
        if name in ("SYS_STATUS", "BATTERY_STATUS"):
            newest.battery[name] = values
            battery = decode_battery(newest.battery, self._decoder)
            if battery is not None:
                yield BatterySample(key, battery["volts"], battery["amps"], battery["percent"])
        elif name == "GPS_RAW_INT":
            gps = decode_gps({name: values}, self._decoder)
            newest.fix = gps is not None and gps["lat_deg"] is not None
        elif name == POSITION:
            pose = self._pose(key, newest, values, now)
            if pose is not None:
                yield pose
        else:
            attitude = decode_attitude({name: values}, self._decoder)
            if attitude is not None:
                angles = attitude["roll_deg"], attitude["pitch_deg"], attitude["yaw_deg"]
                newest.orientation, newest.orientation_s = orientation_of(*angles), now

    def _pose(self, key: tuple[int, int], newest: _Newest, values: tuple[object, ...], now: float) -> PoseSample | None:
        position = decode_position({POSITION: values}, self._decoder)
        if position is None or position["lat_deg"] is None:
            return None
        place = position["lat_deg"], position["lon_deg"], position["alt_amsl_m"]
        if self._frame is None:
            self.origin = Origin(*place)
            self._frame = EnuFrame(self.origin)
        east, north, up = position["vel_enu_mps"]
        fresh = now - newest.orientation_s <= STALE_S
        return PoseSample(
            key,
            *place,
            pos_enu_m=self._frame.from_geodetic(*place),
            vel_enu_mps=(east, north, up),
            orientation=newest.orientation if fresh else LEVEL,
            fix=newest.fix,
        )


class _Newest:
    """Newest values kept of one vehicle."""

    __slots__ = ("battery", "fix", "orientation", "orientation_s", "texts")

    def __init__(self) -> None:
        self.battery: dict[str, tuple[object, ...]] = {}
        self.fix = True
        self.orientation = LEVEL
        self.orientation_s = -math.inf
        self.texts = StatusTextAssembler()

    def on_text(self, key: tuple[int, int], frame: Frame, now: float) -> Iterator[TextSample]:
        payload = frame.payload.ljust(54, b"\0")
        text_id, chunk = int.from_bytes(payload[51:53], "little"), payload[53]
        for text in self.texts.on_text(payload[0], payload[1:51], text_id, chunk, now) + self.texts.flush(now):
            yield TextSample(key, text.severity, text.text)
