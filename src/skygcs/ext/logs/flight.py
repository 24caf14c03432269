"""A recorded flight, vehicle by vehicle: track, height, battery, modes, losses of the link, texts."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Any

from skygcs.core.geo import EnuFrame, Origin
from skygcs.core.mavlink.dialect import Dialect
from skygcs.core.mavlink.frame import Frame
from skygcs.core.mavlink.heartbeat import HeartbeatChecks
from skygcs.core.mavlink.modes import SAFETY_ARMED, family, mode_name
from skygcs.core.mavlink.msgids import HEARTBEAT
from skygcs.core.routing.source_statistics import SourceStats
from skygcs.core.vehicle.decoding import (
    Decoder,
    TelemetryGroup,
    banner_program,
    decode_battery,
    decode_gps,
    decode_local,
    decode_position,
    firmware_from_banner,
    firmware_from_version,
)
from skygcs.core.vehicle.shared_ids import BootClock
from skygcs.core.vehicle.state import AIRBORNE, FAILSAFE_STATUS, LANDED, STANDBY, name_of
from skygcs.core.vehicle.status_texts import StatusTextAssembler
from skygcs.ext.logs.curves import MOST_SPANS, Curve, LossCurve, Track
from skygcs.ext.logs.tables import VehicleKey
from skygcs.tlog.format import LogEntry

FIX_3D = 3
"""GPS_FIX_TYPE: before it a receiver guesses."""

RECORD_SILENT_S = 3.0
"""A vehicle without any frame for this time counts as silent: heartbeats come every second."""

LANDED_FRESH_S = 10.0
"""An older EXTENDED_SYS_STATE is not believed; as in the daemon."""

FARTHEST_M = 2e7
"""From a vehicle's own origin: no place on Earth is farther. A frame with a larger float is damaged or forged, and in a
drawing that shows it nothing else is seen. Other positions and heights are integers that say no more than this."""

MOST_TEXTS = 2000
MOST_VEHICLES = 255
"""Number of system ids; a log with more is an attack."""

GLOBAL = ("GLOBAL_POSITION_INT", "GPS_RAW_INT")
DECODED = (
    *("GLOBAL_POSITION_INT", "GPS_RAW_INT", "LOCAL_POSITION_NED", "SYS_STATUS", "BATTERY_STATUS", "STATUSTEXT"),
    *("EXTENDED_SYS_STATE", "AUTOPILOT_VERSION"),
)


@dataclass(slots=True)
class ModeSpan:
    """A mode from this time on, until the next one's."""

    begin_s: float
    mode: str
    armed: bool


@dataclass(slots=True)
class Text:
    at_s: float
    severity: int
    text: str


@dataclass
class VehicleFlight:
    """One vehicle's flight. Times in seconds of the log (`LogEntry.at_s`)."""

    sysid: int
    compid: int
    first_s: float
    autopilot: str = ""
    kind: str = ""
    firmware: str = ""
    """Version, behind the program's name if that is known: "ArduCopter 4.6.3"."""
    armed: bool = False
    """The newest of its own heartbeats says so."""
    system_status: int = 0
    """MAV_STATE of that heartbeat."""
    landed: tuple[str, float] = ("undefined", -math.inf)
    """Its newest EXTENDED_SYS_STATE, and when that came."""
    frames: int = 0
    last_s: float = 0.0
    track: Track = field(default_factory=Track)
    place: str = ""
    """The message of the track; LOCAL_POSITION_NED counts from the vehicle's own origin, not the map's."""
    placed_s: float = 0.0
    """When the track begins."""
    altitude: Curve = field(default_factory=Curve)
    """Metres above home; above its own origin if only LOCAL_POSITION_NED reports it."""
    percent: Curve = field(default_factory=Curve)
    volts: Curve = field(default_factory=Curve)
    modes: list[ModeSpan] = field(default_factory=list)
    armed_s: float = 0.0
    reboots: int = 0
    loss: LossCurve = field(default_factory=LossCurve)
    stats: SourceStats = field(default_factory=lambda: SourceStats(0, 0))
    silences: list[tuple[float, float]] = field(default_factory=list)
    failsafes: list[tuple[float, float]] = field(default_factory=list)
    """Times from the first to the last heartbeat that reported one."""
    texts: list[Text] = field(default_factory=list)
    left_out: int = 0
    """Modes, silences, failsafes and texts that were not kept, as there were too many."""
    farthest_m: float = 0.0
    """From its first place, along the ground."""

    @property
    def name(self) -> str:
        return f"{self.sysid}" if self.compid == 1 else f"{self.sysid}/{self.compid}"

    def spans(self) -> list[tuple[ModeSpan, float]]:
        """The modes, each with its end; the last ends when the vehicle was last heard."""
        ends = [*(span.begin_s for span in self.modes[1:]), self.last_s]
        return list(zip(self.modes, ends, strict=False))

    def in_air(self, now: float) -> bool:
        """True if it flies, as the daemon decides it; an armed vehicle that does not report it counts as flying."""
        state, at_s = self.landed
        if state != "undefined" and now - at_s <= LANDED_FRESH_S:
            return state in AIRBORNE
        if not self.armed:
            return False
        return not (self.autopilot == "ardupilot" and self.system_status == STANDBY)

    @property
    def loss_ratio(self) -> float:
        return self.stats.loss_ratio


class RecordedFlight:
    """Takes a log's entries and keeps what is drawn, in bounded memory."""

    def __init__(self, dialect: Dialect, origin: Origin | None = None) -> None:
        self.origin = origin
        """The origin of the tracks. If none is given, `finish` sets it to the first position of a track."""
        self._given = origin is not None
        self.vehicles: dict[VehicleKey, VehicleFlight] = {}
        self.begin_us: int | None = None
        self.begin_s: float | None = None
        self.end_s = 0.0
        self._stamped = False
        """True if frames have times. A raw capture has only its senders' clocks, which stand still between reports."""
        self._decoder = Decoder(dialect)
        self._names = {self._decoder.msgid_of(name): name for name in DECODED}
        self._names.pop(-1, None)
        self._types = dialect.enums.get("MAV_TYPE", {})
        self._frame = EnuFrame(origin) if origin is not None else None
        self._folding: dict[VehicleKey, _Folding] = {}
        self._heartbeats = HeartbeatChecks()

    def discover(self, entry: LogEntry) -> None:
        """Find vehicles and their modes before the selected time."""
        frame = entry.frame
        if frame is not None and self._heartbeats.own(frame, entry.at_s):
            vehicle = self._known(frame, entry.at_s)
            if vehicle is not None:
                vehicle.first_s = vehicle.last_s = entry.at_s
                vehicle.modes.clear()
                self._on_heartbeat(vehicle, frame, entry.at_s)

    def add(self, entry: LogEntry) -> None:
        frame, now = entry.frame, entry.at_s
        if self.begin_s is None:
            self.begin_s, self.begin_us = now, entry.unix_us
            self._stamped = entry.unix_us is not None
        self.end_s = max(self.end_s, now)
        if frame is None:
            return
        key = frame.sysid, frame.compid
        vehicle = self.vehicles.get(key)
        if frame.info is None:  # unknown message: it still counts as received
            if vehicle is not None:
                self._on_frame(vehicle, frame, now)
            return
        own = self._heartbeats.own(frame, now)
        if own:
            vehicle = self._known(frame, now)
        if vehicle is None:
            return
        self._on_frame(vehicle, frame, now)
        if frame.msgid == HEARTBEAT:
            if own:
                self._on_heartbeat(vehicle, frame, now)
            return
        name = self._names.get(frame.msgid)
        if name is not None:
            self._on_message(vehicle, self._folding[key], name, frame, now)

    def finish(self) -> None:
        """At the log's end: the origin, the last silences and the time armed."""
        self._settle_origin()
        for vehicle in self.vehicles.values():
            if vehicle.frames:
                self._note_silence(vehicle, self.end_s)
            for span in vehicle.modes:
                span.begin_s = max(span.begin_s, self.begin_s or 0.0)
            vehicle.armed_s = sum(end_s - span.begin_s for span, end_s in vehicle.spans() if span.armed)

    def _settle_origin(self) -> None:
        """The first position need not be on a track: a better message may have come later."""
        placed = [v for v in self.vehicles.values() if v.place in GLOBAL and v.track.ends is not None]
        if self._given or self._frame is None or self.origin is None or not placed:
            return
        first = min(placed, key=lambda v: v.placed_s)
        x_m, y_m, _ = first.track.points[0]
        lat_deg, lon_deg, _ = self._frame.to_geodetic(x_m, y_m, 0.0)
        self.origin = Origin(lat_deg, lon_deg, self.origin.alt_amsl_m)
        for vehicle in placed:
            vehicle.track.shift(-x_m, -y_m)

    def _known(self, frame: Frame, now: float) -> VehicleFlight | None:
        key = frame.sysid, frame.compid
        vehicle = self.vehicles.get(key)
        if vehicle is None and len(self.vehicles) < MOST_VEHICLES:
            vehicle = self.vehicles[key] = VehicleFlight(*key, first_s=now)
            vehicle.stats = SourceStats(*key)
            vehicle.last_s = now
            self._folding[key] = _Folding()
        return vehicle

    def _on_frame(self, vehicle: VehicleFlight, frame: Frame, now: float) -> None:
        self._note_silence(vehicle, now)
        vehicle.frames += 1
        vehicle.last_s = now
        lost = vehicle.stats.lost
        vehicle.stats.on_frame(frame.seq, len(frame.raw), now)
        vehicle.loss.add(now, vehicle.stats.lost - lost)

    def _note_silence(self, vehicle: VehicleFlight, now: float) -> None:
        if now - vehicle.last_s <= RECORD_SILENT_S or not self._stamped:
            return
        if len(vehicle.silences) < MOST_SPANS:
            vehicle.silences.append((vehicle.last_s, now))
        else:
            vehicle.left_out += 1

    def _on_heartbeat(self, vehicle: VehicleFlight, frame: Frame, now: float) -> None:
        values = frame.fields()
        base_mode = values.get("base_mode", 0)
        mode = mode_name(values["autopilot"], values["type"], base_mode, values.get("custom_mode", 0))
        armed = bool(base_mode & SAFETY_ARMED)
        vehicle.autopilot = family(values["autopilot"])
        vehicle.kind = self._types.get(values["type"], str(values["type"])).removeprefix("MAV_TYPE_").lower()
        vehicle.armed, vehicle.system_status = armed, values.get("system_status", 0)
        self._note_failsafe(vehicle, now)
        last = vehicle.modes[-1] if vehicle.modes else None
        if last is not None and (last.mode, last.armed) == (mode, armed):
            return
        if len(vehicle.modes) < MOST_SPANS:
            vehicle.modes.append(ModeSpan(now, mode, armed))
        else:
            vehicle.left_out += 1

    def _note_failsafe(self, vehicle: VehicleFlight, now: float) -> None:
        folding = self._folding[vehicle.sysid, vehicle.compid]
        had, folding.failsafe = folding.failsafe, vehicle.system_status in FAILSAFE_STATUS
        if had and vehicle.failsafes:
            vehicle.failsafes[-1] = vehicle.failsafes[-1][0], now
        elif folding.failsafe and len(vehicle.failsafes) < MOST_SPANS:
            vehicle.failsafes.append((now, now))
        elif folding.failsafe:
            vehicle.left_out += 1

    def _on_message(self, vehicle: VehicleFlight, folding: _Folding, name: str, frame: Frame, now: float) -> None:
        if name == "STATUSTEXT":
            self._on_text(vehicle, folding, frame, now)
            return
        values = self._decoder.values(name, frame.payload)
        if not values:
            return
        if name == "EXTENDED_SYS_STATE":
            vehicle.landed = name_of(LANDED, values[1]), now
            return
        if name == "AUTOPILOT_VERSION":
            vehicle.firmware = vehicle.firmware or firmware_from_version(values[0]) or ""
            return
        self._on_telemetry(vehicle, folding, name, values, now)

    def _on_telemetry(
        self, vehicle: VehicleFlight, folding: _Folding, name: str, values: tuple[Any, ...], now: float
    ) -> None:
        # battery, then positions from the best message to the least
        if name in ("SYS_STATUS", "BATTERY_STATUS"):
            folding.battery[name] = values
            battery = decode_battery(folding.battery, self._decoder)
            _add(vehicle.percent, now, battery, "percent")
            _add(vehicle.volts, now, battery, "volts")
        elif name == "GLOBAL_POSITION_INT":
            if not folding.height_reported:  # earlier heights may have another zero
                folding.height_reported, vehicle.altitude = True, Curve()
            # a restart takes back the losses since the silence before it
            if folding.clock.on_boot_ms(values[0], now):
                vehicle.reboots += 1
                lost = vehicle.stats.lost
                vehicle.stats.restart()
                vehicle.loss.take_back(lost - vehicle.stats.lost)
            position = decode_position({name: values}, self._decoder)
            self._on_place(vehicle, name, position, now)
            _add(vehicle.altitude, now, position, "alt_rel_m")
        elif name == "GPS_RAW_INT":
            if vehicle.place in ("", name) and values[0] >= FIX_3D:
                self._on_place(vehicle, name, decode_gps({name: values}, self._decoder), now)
        elif vehicle.place in ("", name):
            local = decode_local({name: values}, self._decoder)
            if local is not None and all(v is not None and abs(v) <= FARTHEST_M for v in local["pos_enu_m"]):
                east, north, up = local["pos_enu_m"]
                self._move(vehicle, name, now, east, north)
                if not folding.height_reported:
                    vehicle.altitude.add(now, up)

    def _on_place(self, vehicle: VehicleFlight, name: str, place: TelemetryGroup | None, now: float) -> None:
        if place is None or place["lat_deg"] is None or not math.isfinite(place["alt_amsl_m"]):
            return
        if self._frame is None:
            self.origin = Origin(place["lat_deg"], place["lon_deg"], place["alt_amsl_m"])
            self._frame = EnuFrame(self.origin)
        x, y, _ = self._frame.from_geodetic(place["lat_deg"], place["lon_deg"], place["alt_amsl_m"])
        self._move(vehicle, name, now, x, y)

    def _move(self, vehicle: VehicleFlight, name: str, now: float, x_m: float, y_m: float) -> None:
        if vehicle.place != name:  # a better message than before: its track restarts
            vehicle.place, vehicle.track, vehicle.farthest_m = name, Track(), 0.0
            vehicle.placed_s = now
        vehicle.track.add(now, x_m, y_m)
        ends = vehicle.track.ends
        if ends is not None:
            vehicle.farthest_m = max(vehicle.farthest_m, math.dist(ends[0], (x_m, y_m)))

    def _on_text(self, vehicle: VehicleFlight, folding: _Folding, frame: Frame, now: float) -> None:
        payload = frame.payload.ljust(54, b"\0")
        text_id, chunk = int.from_bytes(payload[51:53], "little"), payload[53]
        for text in folding.texts.on_text(payload[0], payload[1:51], text_id, chunk, now) + folding.texts.flush(now):
            version = firmware_from_banner(text.text)
            if version is not None:
                vehicle.firmware = f"{banner_program(text.text)} {version}"
            if len(vehicle.texts) < MOST_TEXTS:
                vehicle.texts.append(Text(text.at, text.severity, text.text))
            else:
                vehicle.left_out += 1


class _Folding:
    """State kept between the messages of one vehicle."""

    def __init__(self) -> None:
        self.battery: dict[str, tuple[object, ...]] = {}
        self.clock = BootClock()
        self.texts = StatusTextAssembler()
        self.failsafe = False
        self.height_reported = False
        """By GLOBAL_POSITION_INT, above home."""


def _add(curve: Curve, now: float, group_values: TelemetryGroup | None, name: str) -> None:
    value = None if group_values is None else group_values[name]
    if value is not None:
        curve.add(now, value)
