"""State of one vehicle from its frames, decoded when it is read. Pure; the asyncio side is `VehicleActor`."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Iterable, Sequence
from typing import Any

from skygcs.core.geo import Origin, enu_from_geodetic
from skygcs.core.mavlink import modes
from skygcs.core.mavlink.dialect import Dialect
from skygcs.core.mavlink.frame import Frame
from skygcs.core.mavlink.heartbeat import DEFAULT_LOST_S, HIGH_LATENCY_FACTOR, HeartbeatCheck, HeartbeatOrigin
from skygcs.core.mavlink.msgids import HEARTBEAT
from skygcs.core.mavlink.vehicle_class import (
    HOLD_REACH,
    Q_MODES,
    Abilities,
    Program,
    ReturnRule,
    VehicleClass,
    abilities_of,
    mode_type,
    program_of_banner,
    vehicle_class,
)
from skygcs.core.protocols.command import IN_PROGRESS, Ack
from skygcs.core.vehicle.decoding import (
    Decoder,
    TelemetryGroup,
    banner_program,
    firmware_from_banner,
    firmware_from_version,
)
from skygcs.core.vehicle.message_cache import MessageCache, Parameters, Slot
from skygcs.core.vehicle.shared_ids import BootClock, Finding, SharedIds
from skygcs.core.vehicle.state import (
    ACTIVE,
    AIRBORNE,
    FAILSAFE_STATUS,
    LANDED,
    SEVERITY,
    STANDBY,
    SYSTEM_STATUS,
    name_of,
)
from skygcs.core.vehicle.status_texts import MAX_STATUS_TEXTS, StatusText, StatusTextAssembler
from skygcs.core.vehicle.takeoff_altitude import TakeoffAltitude, standing_amsl_m
from skygcs.events import Event

RATE_PERIOD_S = 1.0
LANDED_FRESH_S = 10.0
"""Oldest EXTENDED_SYS_STATE that is used; autopilots stream it at 0.5 to 1 Hz."""

VTOL_ON_ROTORS = frozenset({2, 3})
"""MAV_VTOL_STATE: in transition to a multicopter, and a multicopter."""

VTOL_TO_WING = 1
"""MAV_VTOL_STATE: in transition to a plane. A QuadPlane that stays on its rotors in GUIDED shows it in the first 0.2 s
of each goto too (QuadPlane::guided_start), and the EXTENDED_SYS_STATE of that moment is the newest for 2 s."""

BOOT_TEXT = "ardupilot ready"
"""Text that ArduPilot sends once, at the end of its start (AP_Vehicle::setup). Its version banner also answers each
GCS, and "Initialising ArduPilot" also comes while it calibrates its gyros (AP_Vehicle::scheduler_delay_callback)."""

BOOT_TEXT_MIN_UP_S = 30.0
"""A boot text within this time after the first frame or a reboot belongs to the start already known."""

GCS_SYSID_PARAMETERS = (b"SYSID_MYGCS", b"MAV_GCS_SYSID")
"""ArduPilot's parameter up to 4.6, and from 4.7 on."""

MAX_ANSWERS = 64
"""Commands whose last answer is kept: more than skygcs sends to one vehicle."""

BOOT_TIME_MESSAGES = ("ATTITUDE", "GLOBAL_POSITION_INT", "LOCAL_POSITION_NED", "ATTITUDE_QUATERNION")

Events = tuple[Event, ...]


class Vehicle:
    """State of one autopilot. `on_frame` for each of its frames, `tick` at 1 to 10 Hz; both return what happened.

    ``origin`` may be set at any time: ENU positions are relative to it. ``last_ack`` is the newest COMMAND_ACK, to any
    station; the actor reads it after `on_frame`.
    """

    transmitter: bool | None = None
    """True if a pilot's transmitter belongs to it, by the fleet file; None: it does not say."""
    program: Program | None = None
    """The ArduPilot program of its banner; None: no banner has come, or it is not ArduPilot."""
    arming_at = arming_until = -math.inf
    """When an arming of ours was last sent, and until when it may be armed by that before a heartbeat shows it."""
    _vtol_state = 0

    dropped = ""
    """Why nothing is done with it any more; see `disconnect`."""

    def __init__(
        self,
        sysid: int,
        compid: int,
        dialect: Dialect,
        *,
        name: str | None = None,
        groups: tuple[str, ...] = (),
        timeout_s: float = DEFAULT_LOST_S,
        decoder: Decoder | None = None,
        replayed: bool = False,
    ) -> None:
        self.sysid, self.compid, self.groups, self.timeout_s = sysid, compid, groups, timeout_s
        self.name = name or f"v{sysid}"
        self.origin: Origin | None = None
        self.origin_generation = 0
        """Number of the fleet's origin: positions with the same number are in the same frame."""
        self.connected = False
        self.replayed = replayed
        """True if it exists only in a recording: it takes no orders."""
        self.type = self.autopilot = self.base_mode = self.custom_mode = self.system_status = 0
        """From its last heartbeat."""
        self.firmware: str | None = None
        self.gcs_sysid: int | None = None
        """The ground station whose heartbeats its failsafe watches, once any station has read the parameter."""
        self.system: Callable[[float], list[dict[str, Any]]] = lambda now: []
        """Returns the components of its system at a time, as `component.describe` does."""
        self.other_texts: Callable[[], Sequence[tuple[StatusText, int]]] = tuple
        """Texts of its system's other components, with their component ids."""
        self.last_ack: Ack | None = None
        self.answers: dict[int, tuple[int, float]] = {}
        """By command, its last final MAV_RESULT to any station, and when that came; of the latest `MAX_ANSWERS`."""
        self.boot = BootClock()
        self.heartbeats = HeartbeatCheck(compid, timeout_s)
        self.ids = SharedIds(sysid, compid)
        self.takeoff = TakeoffAltitude()
        self.parameters = Parameters()
        self.texts: deque[StatusText] = deque(maxlen=MAX_STATUS_TEXTS)
        self._decoder = decoder or Decoder(dialect)
        self.message_cache = MessageCache(self._decoder)
        self.slots = self.message_cache.slots
        self.armed_at = self.armed_since = -math.inf
        """When its heartbeat last showed it armed, and since when it does."""
        self.mode_changes = 0
        """How often its heartbeats have shown another mode than before."""
        self.mode_since = -math.inf
        """When they first showed the present one."""
        self._landed = "undefined"
        self._landed_id = self._decoder.msgid_of("EXTENDED_SYS_STATE")
        self._high_latency_failures = 0
        self._heartbeat_payload = b""
        self._lost_after_s = timeout_s
        self._heard_at: float | None = None
        self._lost_at: float | None = None
        self._known_since: float | None = None
        self._rates_at: float | None = None
        self._clock_at = -math.inf
        self._assembler = StatusTextAssembler()
        self._enu: tuple[TelemetryGroup | None, Origin | None, list[float] | None] = (None, None, None)
        self._handlers = self._message_handlers()

    def _message_handlers(self) -> dict[int, Callable[[bytes, float], Events]]:
        """Messages of which each frame is read at once, by msgid."""
        handlers: dict[str, Callable[[bytes, float], Events]] = {
            "STATUSTEXT": self._on_statustext,
            "EXTENDED_SYS_STATE": self._on_extended_sys_state,
            "SYSTEM_TIME": self._on_system_time,
            "COMMAND_ACK": self._on_command_ack,
            "AUTOPILOT_VERSION": self._on_autopilot_version,
            "HIGH_LATENCY2": self._on_high_latency,
            "PARAM_VALUE": self._on_param_value,
        }
        able = self._decoder.read
        return {self._decoder.msgid_of(n): handler for n, handler in handlers.items() if n in able}

    def on_frame(self, frame: Frame, now: float) -> Events:
        """Note a frame of this vehicle. Hot: one dict lookup and three assignments for most of them. Never raises."""
        if frame.msgid == HEARTBEAT:
            return self.on_heartbeat(frame.payload, now, frame)
        slot = self.slots.get(frame.msgid)
        if slot is None:
            if frame.info is None:
                return ()  # without a CRC not even its id can be trusted
            slot = self.slots[frame.msgid] = Slot(frame.info.name)
        slot.frame = frame
        slot.at = now
        slot.count += 1
        handler = self._handlers.get(frame.msgid)
        return () if handler is None else handler(frame.payload, now)

    def recall(self, frames: Iterable[tuple[Frame, float]]) -> None:
        """Take its last frames, each with its time, from the journal of the daemon before. It counts as lost until it
        is heard."""
        for frame, at in frames:
            self.on_frame(frame, at)
        self.disconnect()

    def disconnect(self, why: str = "") -> None:
        """Count as lost, without an event, until it is heard; with ``why`` for good."""
        self.connected, self.dropped = False, why
        self._lost_at = self._heard_at

    def state_update_only(self, msgid: int) -> Slot | None:
        """The cache slot of a message for which `on_frame` only updates that slot; None for other messages."""
        return None if msgid in self._handlers or msgid == HEARTBEAT else self.slots.get(msgid)

    def is_last_heartbeat(self, payload: bytes) -> bool:
        """True if this is the payload of its last heartbeat."""
        return payload == self._heartbeat_payload and self.connected

    def tick(self, now: float) -> Events:
        """Events of time alone: a lost vehicle, rates, texts that stay incomplete, a reboot seen by its clock."""
        events: list[Event] = []
        for text in self._assembler.flush(now):
            events += self._on_text(text)
        if self.connected and self._heard_at is not None and now - self._heard_at > self._lost_after_s:
            self.connected = False
            self._lost_at = self._heard_at
            age = now - self._heard_at
            self.heartbeats.forget()
            events.append(self._event("vehicle_lost", f"no heartbeat for {age:.1f} s", {"age_s": round(age, 1)}))
        if self._rates_at is None:
            self._rates_at = now
        elif now - self._rates_at >= RATE_PERIOD_S:
            self.message_cache.sample(now - self._rates_at)
            self._rates_at = now
            self._update_takeoff_altitude(now)
            events += self._check_clocks(now)
        elif self.boot.went_back_at is not None:
            events += self._check_clocks(now)
        if self.ids.beside:
            events += self._found(self.ids.tick(self.heartbeats, self.boot, now))
        return tuple(events)

    def _update_takeoff_altitude(self, now: float) -> None:
        at = self.telemetry_at("position")
        altitude = None if at is None else standing_amsl_m(self.telemetry("position"), now - at)
        self.takeoff.update(self.silence_s(now), armed=self.armed, in_air=self.in_air(now), standing_amsl_m=altitude)

    @property
    def key(self) -> int:
        return self.sysid << 8 | self.compid

    @property
    def family(self) -> modes.Family:
        return modes.family(self.autopilot)

    @property
    def armed(self) -> bool:
        return bool(self.base_mode & modes.SAFETY_ARMED)

    @property
    def mode(self) -> str:
        return modes.mode_name(self.autopilot, self.mode_type, self.base_mode, self.custom_mode)

    @property
    def mode_type(self) -> int:
        """The MAV_TYPE whose modes it has: that of its firmware's program, whatever type it shows."""
        return mode_type(self.autopilot, self.type, self.program, self.param("Q_ENABLE"))

    @property
    def kind(self) -> VehicleClass:
        """The class of vehicle, by all that its messages have shown."""
        q_enable = self.param("Q_ENABLE")
        return vehicle_class(self.autopilot, self.type, self.custom_mode, self.program, q_enable, self._last_vtol_state)

    @property
    def _last_vtol_state(self) -> int:
        """MAV_VTOL_STATE of its last EXTENDED_SYS_STATE since it started; 0: undefined, or none came."""
        slot = self.slots.get(self._landed_id)
        return 0 if slot is None or slot.frame is None else self._vtol_state

    @property
    def rotors_known(self) -> bool:
        """True if an ArduPlane has shown whether it is a QuadPlane: by Q_ENABLE, which a build without QuadPlanes does
        not have, or by an EXTENDED_SYS_STATE since it started, where each QuadPlane has a vtol_state."""
        slot = self.slots.get(self._landed_id)
        return self.param("Q_ENABLE") is not None or (slot is not None and slot.frame is not None)

    @property
    def abilities(self) -> Abilities:
        """Abilities of its class, however it flies now."""
        return abilities_of(self.family, self.kind)

    def abilities_now(self, now: float) -> Abilities:
        """Abilities of its class now: a VTOL on its rotors stops, on its wing it does not."""
        return abilities_of(self.family, self.kind, hovers=self.hovers(now))

    def return_rule(self, now: float) -> ReturnRule:
        """How a return that is ordered now ends."""
        return self.abilities_now(now).return_rule(self.param)

    @property
    def mission_return_rule(self) -> ReturnRule:
        """How the returns of its missions end, which are flown later: however it flies, or stands, now."""
        return self.abilities.return_rule(self.param)

    @property
    def return_reach_m(self) -> float:
        """How far from its home it may be on the circle at the end of its mission's return, m; 0 for what stops."""
        hold, home = self.abilities.hold_radius, self.abilities.return_radius
        if not self.abilities.circles or hold is None:
            return 0.0
        radius_m = 0.0 if home is None else home.value_m(self.param(home.param))
        return HOLD_REACH * (radius_m or hold.value_m(self.param(hold.param)))

    @property
    def mission_reach_m(self) -> float:
        """The wider of the circles that it flies on its missions, m; 0 for what stops."""
        hold = self.abilities.hold_radius
        if not self.abilities.circles or hold is None:
            return 0.0
        return max(HOLD_REACH * hold.value_m(self.param(hold.param)), self.return_reach_m)

    def hold_radius_m(self, now: float) -> float:
        """Radius of the circle that it flies to hold, m; 0 for what stops, and for a VTOL on the ground: it rises on
        its rotors."""
        able = self.abilities_now(now)
        if not able.circles or able.hold_radius is None or (able.hovers and self.in_air(now) is False):
            return 0.0
        return able.hold_radius.value_m(self.param(able.hold_radius.param))

    def hold_reach_m(self, now: float) -> float:
        """How far from the middle of the circle that it flies to hold it may be, m; 0 for what stops."""
        return self.hold_radius_m(now) * HOLD_REACH

    @property
    def duplicate(self) -> bool:
        """True if another vehicle sends with its ids, on any channel."""
        return self.ids.where is not None

    @property
    def duplicate_where(self) -> str | None:
        """See `SharedIds.where`."""
        return self.ids.where

    @property
    def failsafe(self) -> bool:
        return self.system_status in FAILSAFE_STATUS or self._high_latency_failures != 0

    def silence_s(self, now: float) -> float | None:
        """Time since the last heartbeat; None if there was none."""
        return None if self._heard_at is None else now - self._heard_at

    def landed_state(self) -> tuple[str, float]:
        """Its last EXTENDED_SYS_STATE and when that came; "undefined" if there was none, or in it."""
        slot = self.slots.get(self._landed_id)
        return ("undefined", -math.inf) if slot is None or slot.frame is None else (self._landed, slot.at)

    def landed(self, now: float) -> str:
        """on_ground, in_air, takeoff, landing, or "undefined" if that is not known. What does not fly is on_ground: a
        Rover shows the status of a flying vehicle in each mode but HOLD (GCS_MAVLINK_Rover::vehicle_system_status)."""
        if self._heard_at is not None and not self.abilities.flies:
            return "on_ground"
        slot = self.slots.get(self._landed_id)
        if (
            slot is not None
            and slot.frame is not None
            and now - slot.at <= LANDED_FRESH_S
            and self._landed != "undefined"
        ):
            return self._landed
        if not self.armed:
            return "on_ground"
        if self.family == "ardupilot" and self.system_status in (STANDBY, ACTIVE):
            return "in_air" if self.system_status == ACTIVE else "on_ground"
        return "undefined"

    def hovers(self, now: float) -> bool:
        """True for a VTOL that is known to be carried by its rotors now: by its mode, or as it reports itself."""
        if self.kind is not VehicleClass.VTOL:
            return False
        if self.family == "ardupilot" and self.custom_mode in Q_MODES:
            return True
        slot = self.slots.get(self._landed_id)
        if slot is None or now - slot.at > LANDED_FRESH_S:
            return False
        if self._vtol_state == VTOL_TO_WING:
            return self.mode == "GUIDED" and self.on_rotors_in_guided
        return self._vtol_state in VTOL_ON_ROTORS

    @property
    def on_rotors_in_guided(self) -> bool:
        """True for a QuadPlane that is known to fly on its rotors in GUIDED (QuadPlane::guided_mode_enabled)."""
        return self.family == "ardupilot" and self.param("Q_GUIDED_MODE") == 1.0

    def in_air(self, now: float) -> bool | None:
        """True if it flies, and so could fall; None if that is not known. Never True for a vehicle that drives."""
        landed = self.landed(now)
        return None if landed == "undefined" else landed in AIRBORNE

    def under_way(self, now: float) -> bool:
        """True if it may be moving by itself, by what was heard of it last: it is armed, and drives or is not known to
        stand on the ground."""
        return self.armed and self.abilities.may_move(self.in_air(now))

    def last_frames(self, msgids: Iterable[int]) -> list[tuple[Frame, float]]:
        """The last frame of each of these messages that has come, with its time."""
        slots = [self.slots[msgid] for msgid in msgids if msgid in self.slots]
        return [(slot.frame, slot.at) for slot in slots if slot.frame is not None]

    def slot(self, message: str) -> Slot | None:
        """The last frame of a message, its time and count; None if none came since the last reboot."""
        return self.message_cache.slot(message)

    def count(self, message: str) -> int:
        """Number of frames of a message."""
        slot = self.slots.get(self._decoder.msgid_of(message))
        return 0 if slot is None else slot.count

    def telemetry(self, name: str) -> TelemetryGroup | None:
        """One telemetry group, without its age. It is shared: do not modify it."""
        return self.message_cache.telemetry(name)[0]

    def telemetry_at(self, name: str) -> float | None:
        """When the newest message of a telemetry group came."""
        return self.timed_telemetry(name)[1]

    def timed_telemetry(self, name: str) -> tuple[TelemetryGroup, float] | tuple[None, None]:
        """One telemetry group, and the time at which its newest message came."""
        group_values, at = self.message_cache.telemetry(name)
        return (None, None) if group_values is None else (group_values, at)

    def home_alt_amsl_m(self) -> float | None:
        """The altitude that GLOBAL_POSITION_INT.relative_alt is relative to; without a position that of
        HOME_POSITION."""
        position = self.telemetry("position")
        if position is not None and position["lat_deg"] is not None:
            return float(position["alt_amsl_m"] - position["alt_rel_m"])
        home = self.telemetry("home")
        return None if home is None else float(home["alt_amsl_m"])

    def param(self, name: str) -> float | None:
        """A parameter of `message_cache.WATCHED`; None if no station has read it since the vehicle started."""
        return self.parameters.value(name)

    def clock_offset_s(self, now: float, unix_now: float) -> float | None:
        """The vehicle's clock minus ours, from the last SYSTEM_TIME; it includes the link's delay, with a minus
        sign."""
        time, at = self.message_cache.telemetry("time")
        if time is None or time["unix_s"] is None:
            return None
        return round(float(time["unix_s"]) - (unix_now - (now - at)), 3)

    def enum_name(self, enum: str, value: int) -> str:
        """Name of an enum's entry in the dialect, without the enum's name; the number if it has no name."""
        name = self._decoder.dialect.enums.get(enum, {}).get(value)
        return str(value) if name is None else name.removeprefix(enum + "_")

    def enu_m(self) -> list[float] | None:
        """Position along the axes of the fleet's world frame; None without position or origin."""
        position = self.telemetry("position")
        if position is None or self.origin is None or position["lat_deg"] is None:
            return None
        if self._enu[0] is not position or self._enu[1] is not self.origin:
            enu = enu_from_geodetic(position["lat_deg"], position["lon_deg"], position["alt_amsl_m"], self.origin)
            self._enu = (position, self.origin, [round(c, 3) for c in enu])
        return self._enu[2]

    def _event(self, kind: str, text: str, data: dict[str, Any] | None = None) -> Event:
        return Event(kind, self.name, self.sysid, text, data or {})

    def on_heartbeat(self, payload: bytes, now: float, frame: Frame | None = None) -> Events:
        """Take in a heartbeat. ``frame``: it goes into its slot if it is the vehicle's own; None: it is already
        there.
        """
        fields = self._decoder.read["HEARTBEAT"](payload)
        origin = self.heartbeats.judge(fields[0], fields[1], fields[2], fields[3], now)
        if origin != "own":
            return self._on_other_heartbeat(origin, fields, now)
        if frame is not None:
            assert frame.info is not None
            slot = self.slots.setdefault(HEARTBEAT, Slot(frame.info.name))
            slot.frame = frame
            slot.at = now
            slot.count += 1
        return self._on_own_heartbeat(payload, fields, now)

    def _on_own_heartbeat(self, payload: bytes, fields: tuple[int, ...], now: float) -> Events:
        self._heard_at = now
        self._lost_after_s = self.timeout_s
        if fields[2] & modes.SAFETY_ARMED:
            self.armed_at = now
        if self.is_last_heartbeat(payload):
            return ()
        self._heartbeat_payload = payload
        vehicle_type, autopilot, base_mode, custom_mode, system_status = fields
        self._high_latency_failures = 0
        return self._on_life(vehicle_type, autopilot, base_mode, custom_mode, system_status, now)

    def _on_other_heartbeat(self, origin: HeartbeatOrigin, fields: tuple[int, ...], now: float) -> Events:
        """A heartbeat with the vehicle's ids that is not its own leaves the state unchanged."""
        kind = self.enum_name("MAV_TYPE", fields[0])
        autopilot = self.enum_name("MAV_AUTOPILOT", fields[1])
        known = f"{self.mode}, {_arming(self.base_mode)}"
        return self._found(self.ids.on_heartbeat(origin, kind, autopilot, _arming(fields[2]), known, now))

    def _found(self, finding: Finding | None) -> Events:
        return () if finding is None else (self._event(*finding),)

    def _on_high_latency(self, payload: bytes, now: float) -> Events:
        """HIGH_LATENCY2 replaces the heartbeat on a satellite link. It has no armed bit, so ``armed`` stays."""
        vehicle_type, autopilot, custom_mode, failures, *_ = self._decoder.read["HIGH_LATENCY2"](payload)
        if autopilot == modes.AUTOPILOT_PX4:
            custom_mode <<= 16  # PX4 sends main and sub mode in the low and high byte
        origin = self.heartbeats.judge(vehicle_type, autopilot, self.base_mode, custom_mode, now)
        if origin != "own":
            return self._on_other_heartbeat(origin, (vehicle_type, autopilot, self.base_mode), now)
        self._heard_at = now
        self._lost_after_s = self.timeout_s * HIGH_LATENCY_FACTOR
        self._heartbeat_payload = b""
        had = self.failsafe
        self._high_latency_failures = failures
        events = self._on_life(vehicle_type, autopilot, self.base_mode, custom_mode, self.system_status, now)
        return events if self.failsafe == had else (*events, self._failsafe_event())

    def _on_life(
        self, vehicle_type: int, autopilot: int, base_mode: int, custom_mode: int, system_status: int, now: float
    ) -> Events:
        events: list[Event] = []
        first = self._known_since is None
        armed, mode, failsafe, connected = self.armed, self.mode, self.failsafe, self.connected
        self.type, self.autopilot = vehicle_type, autopilot
        if custom_mode != self.custom_mode:
            self.mode_changes, self.mode_since = self.mode_changes + 1, now
        self.base_mode, self.custom_mode, self.system_status = base_mode, custom_mode, system_status
        if not self.connected:
            if self.dropped:
                return ()
            self.connected = True
            if first:
                self._known_since = now
                return ()  # the caller that created it reports its first frame
            gone = now - (self._lost_at or now)
            events.append(self._event("vehicle_back", f"back after {gone:.1f} s", {"gone_s": round(gone, 1)}))
        if self.armed != armed:
            kind = "armed" if self.armed else "disarmed"
            if self.armed:
                self.armed_since = now
                self.takeoff.armed(seen=connected)
            events.append(self._event(kind, kind, {"mode": self.mode}))
        if self.mode != mode:
            events.append(self._event("mode", f"mode {self.mode}, was {mode}", {"mode": self.mode, "was": mode}))
        if self.failsafe != failsafe:
            events.append(self._failsafe_event())
        return tuple(events)

    def _failsafe_event(self) -> Event:
        status = name_of(SYSTEM_STATUS, self.system_status)
        if not self.failsafe:
            return self._event("failsafe", f"failsafe over, system status {status}", {"failsafe": False})
        why = next((t.text for t in reversed(self.texts) if t.severity <= 4), None)
        text = f"failsafe, system status {status}" + (f": {why}" if why else "")
        return self._event("failsafe", text, {"failsafe": True, "system_status": status, "last_warning": why})

    def _on_statustext(self, payload: bytes, now: float) -> Events:
        severity, raw, text_id, chunk_seq = self._decoder.read["STATUSTEXT"](payload)
        events: list[Event] = []
        for text in self._assembler.on_text(severity, raw, text_id, chunk_seq, now):
            events += self._on_text(text)
        return tuple(events)

    def _on_text(self, text: StatusText) -> list[Event]:
        if not text.text:
            return []
        self.texts.append(text)
        name = name_of(SEVERITY, text.severity)
        data = {"severity": name, "level": text.severity, "text": text.text}
        events = [self._event("statustext", text.text, data)]
        if self.firmware is None:
            self.firmware = firmware_from_banner(text.text)
        if self.autopilot == modes.AUTOPILOT_ARDUPILOT and (word := banner_program(text.text)) is not None:
            self.program = program_of_banner(word) or self.program
        if text.text.lower().startswith(BOOT_TEXT) and self._long_up(text.at):
            self.boot.forget()
            events.append(self._rebooted(text.at, f"rebooted: {text.text}", since=text.at))
        return events

    def _long_up(self, now: float) -> bool:
        uptime = self.boot.uptime_s(now)
        since = now if self._known_since is None else self._known_since
        return now - since > BOOT_TEXT_MIN_UP_S and (uptime is None or uptime > BOOT_TEXT_MIN_UP_S)

    def _on_extended_sys_state(self, payload: bytes, now: float) -> Events:
        self._vtol_state, state = self._decoder.read["EXTENDED_SYS_STATE"](payload)
        landed = name_of(LANDED, state)
        if landed == self._landed:
            return ()
        was, self._landed = self._landed, landed
        if landed == "on_ground":
            self.takeoff.touched_down()
        if was == "undefined":
            return ()
        return (self._event("landed", landed.replace("_", " "), {"landed": landed, "was": was}),)

    def _on_system_time(self, payload: bytes, now: float) -> Events:
        _, boot_ms = self._decoder.read["SYSTEM_TIME"](payload)
        return self._on_boot_ms(boot_ms, now)

    def _on_command_ack(self, payload: bytes, now: float) -> Events:
        self.last_ack = Ack(*self._decoder.read["COMMAND_ACK"](payload))
        self.heartbeats.expect_change(self.last_ack.command, self.last_ack.result, now)
        if self.last_ack.result != IN_PROGRESS:
            self.answers.pop(self.last_ack.command, None)  # the newest is the last one
            self.answers[self.last_ack.command] = (self.last_ack.result, now)
            if len(self.answers) > MAX_ANSWERS:
                del self.answers[next(iter(self.answers))]
        return ()

    def _on_autopilot_version(self, payload: bytes, now: float) -> Events:
        version, _ = self._decoder.read["AUTOPILOT_VERSION"](payload)
        self.firmware = firmware_from_version(version) or self.firmware
        return ()

    def _on_param_value(self, payload: bytes, now: float) -> Events:
        name, value, kind = self._decoder.read["PARAM_VALUE"](payload)
        self.parameters.note(name, value, kind, now, bytewise=self.autopilot == modes.AUTOPILOT_PX4)
        if name.rstrip(b"\0") in GCS_SYSID_PARAMETERS and 0 < value <= 255:
            self.gcs_sysid = int(value)
        return ()

    def _check_clocks(self, now: float) -> Events:
        """Not every autopilot streams SYSTEM_TIME; other messages carry the same clock. While there may be two clocks,
        all of these messages are read."""
        if self.boot.went_back_at is None:
            newest = self.message_cache.newest(BOOT_TIME_MESSAGES)
            slots = [] if newest is None else [newest]
        else:
            slots = [s for s in map(self.message_cache.slot, BOOT_TIME_MESSAGES) if s is not None]
        events: list[Event] = []
        for slot in sorted(slots, key=lambda s: s.at):
            values = self.message_cache.values(slot)
            if values and slot.at > self._clock_at:
                events += self._on_boot_ms(values[0], slot.at)
        self._clock_at = max((s.at for s in slots), default=self._clock_at)
        return tuple(events)

    def _on_boot_ms(self, boot_ms: int, now: float) -> Events:
        went_back_at = self.boot.went_back_at
        if self.boot.on_boot_ms(boot_ms, now):
            text = f"rebooted, up for {boot_ms / 1000:.1f} s"
            return (self._rebooted(now, text, since=now if went_back_at is None else went_back_at),)
        return self._found(self.ids.on_clock(self.boot, now))

    def restart(self, now: float, text: str) -> Events:
        """Drop its state: it restarted on another channel, or another vehicle replaces it."""
        self.boot.forget()
        self.heartbeats.forget()
        return (self._rebooted(now, text, since=now),)

    def _rebooted(self, now: float, text: str, since: float) -> Event:
        """Drop the state from before a restart at ``since``, except the heartbeat."""
        self._known_since = now
        self._landed = "undefined"
        self.takeoff.forget()
        self.parameters.forget()
        self.answers.clear()
        self.message_cache.forget_before(since, keep="HEARTBEAT")
        return self._event("reboot", text, {})


def _arming(base_mode: int) -> str:
    return "armed" if base_mode & modes.SAFETY_ARMED else "disarmed"
