"""The whole state of a vehicle as one dictionary, for RPC and for people."""

from __future__ import annotations

import functools
import math
from collections.abc import Callable
from typing import Any

from skygcs.core.geo import world_from_enu, wrap_deg_180
from skygcs.core.protocols.command import RESULT_NAMES
from skygcs.core.vehicle.decoding import GROUPS
from skygcs.core.vehicle.message_cache import Slot
from skygcs.core.vehicle.mission_orders import number_of
from skygcs.core.vehicle.state import SEVERITY, SYSTEM_STATUS, Part, VehicleState, name_of
from skygcs.core.vehicle.status_texts import MAX_STATUS_TEXTS
from skygcs.core.vehicle.vehicle import Vehicle


def take_snapshot(
    vehicle: Vehicle, now: float, unix_now: float | None = None, names: frozenset[str] | None = None
) -> VehicleState:
    """The state at ``now``: all of it, or only the keys in ``names``, and only these are worked out: a page that shows
    200 vehicles reads a third of them ten times a second. ``unix_now`` (wall clock at ``now``) makes clock_offset_s
    known."""
    keys = _KEYS if names is None else _selected(names)
    state: dict[str, Any] = {key: read(vehicle, now) for key, read in keys}
    if unix_now is not None and "clock_offset_s" in state:
        state["clock_offset_s"] = vehicle.clock_offset_s(now, unix_now)
    return state  # type: ignore[return-value]  # the keys of `VehicleState`; a test compares them


def latest_message(vehicle: Vehicle, msgid: int, now: float) -> dict[str, Any] | None:
    """The last frame of a message with all fields, age, rate and count; None if none has come."""
    slot = vehicle.slots.get(msgid)
    return None if slot is None else reading_of(slot, now, vehicle.sysid, vehicle.compid)


def reading_of(slot: Slot, now: float, sysid: int, compid: int) -> dict[str, Any] | None:
    """The last frame of a message and its component; None after a reboot."""
    if slot.frame is None:
        return None
    return {
        "name": slot.name,
        "sysid": sysid,
        "compid": compid,
        "fields": {name: _json_able(value) for name, value in slot.frame.fields().items()},
        "age_s": round(now - slot.at, 3),
        "rate_hz": round(slot.rate_hz, 2),
        "count": slot.count,
    }


def _texts(vehicle: Vehicle, now: float) -> list[dict[str, Any]]:
    """The newest texts of the autopilot and its system's other components, oldest first."""
    texts = [(text, vehicle.compid) for text in vehicle.texts]
    others = vehicle.other_texts()
    if others:
        texts = sorted((*texts, *others), key=lambda entry: entry[0].at)[-MAX_STATUS_TEXTS:]
    return [
        {
            "severity": name_of(SEVERITY, text.severity),
            "level": text.severity,
            "text": text.text,
            "compid": compid,
            "age_s": round(now - text.at, 1),
        }
        for text, compid in texts
    ]


def _in_the_world(vehicle: Vehicle, position: Part) -> Part:
    """Fields of a position that need the fleet's origin or the takeoff altitude."""
    origin, takeoff_amsl_m = vehicle.origin, vehicle.takeoff.alt_amsl_m
    velocity = yaw_deg = height_m = None
    if takeoff_amsl_m is not None and position["lat_deg"] is not None:
        height_m = round(position["alt_amsl_m"] - takeoff_amsl_m, 3)
    if origin is not None:
        velocity = [round(v, 3) for v in world_from_enu(tuple(position["vel_enu_mps"]), origin)]
        if position["heading_deg"] is not None:
            yaw_deg = round(wrap_deg_180(origin.x_heading_deg - position["heading_deg"]), 2)
    return {
        "takeoff_alt_amsl_m": takeoff_amsl_m,
        "alt_takeoff_m": height_m,
        "enu_m": vehicle.enu_m(),
        "vel_world_mps": velocity,
        "yaw_world_deg": yaw_deg,
        "origin_generation": vehicle.origin_generation,
    }


def _last_ack(vehicle: Vehicle, now: float) -> Part | None:
    slot = vehicle.slot("COMMAND_ACK")
    if slot is None or vehicle.last_ack is None:
        return None
    return {
        "command": vehicle.enum_name("MAV_CMD", vehicle.last_ack.command),
        "result": RESULT_NAMES.get(vehicle.last_ack.result, str(vehicle.last_ack.result)),
        "age_s": round(now - slot.at, 3),
    }


def _rounded(value: float | None, digits: int) -> float | None:
    return None if value is None else round(value, digits)


def _json_able(value: Any) -> Any:
    """JSON has no NaN and infinity, which mean "not known" here."""
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if isinstance(value, list):
        return [_json_able(v) for v in value]
    return value


_Read = Callable[[Vehicle, float], Any]


def _position(vehicle: Vehicle, now: float) -> Part | None:
    position = vehicle.message_cache.telemetry_group("position", now)
    if position is not None:
        position |= _in_the_world(vehicle, position)
    return position


def _mission(vehicle: Vehicle, now: float) -> Part | None:
    mission = vehicle.message_cache.telemetry_group("mission", now)
    if mission is not None:
        mission["item"] = None if mission["seq"] is None else number_of(vehicle, mission["seq"])
    return mission


def _group(name: str) -> tuple[str, _Read]:
    read = {"position": _position, "mission": _mission}.get(name)
    if read is not None:
        return name, read
    return name, lambda vehicle, now: vehicle.message_cache.telemetry_group(name, now)


def _filled_in_later(_vehicle: Vehicle, _now: float) -> None:
    return None


_KEYS: tuple[tuple[str, _Read], ...] = (
    ("name", lambda v, _: v.name),
    ("sysid", lambda v, _: v.sysid),
    ("compid", lambda v, _: v.compid),
    ("autopilot", lambda v, _: v.family),
    ("type", lambda v, _: v.enum_name("MAV_TYPE", v.type)),
    ("firmware", lambda v, _: v.firmware),
    ("groups", lambda v, _: list(v.groups)),
    ("gcs_sysid", lambda v, _: v.gcs_sysid),
    ("connected", lambda v, _: v.connected),
    ("duplicate_sysid", lambda v, _: v.duplicate),
    ("replayed", lambda v, _: v.replayed),
    ("last_heartbeat_age_s", lambda v, now: _rounded(v.silence_s(now), 3)),
    ("uptime_s", lambda v, now: _rounded(v.boot.uptime_s(now), 1)),
    ("clock_offset_s", _filled_in_later),  # with the wall clock
    ("armed", lambda v, _: v.armed),
    ("mode", lambda v, _: v.mode),
    ("system_status", lambda v, _: name_of(SYSTEM_STATUS, v.system_status)),
    ("landed", lambda v, now: v.landed(now)),
    ("failsafe", lambda v, _: v.failsafe),
    ("authority", _filled_in_later),  # by an extension that gates the vehicle
    ("control", _filled_in_later),  # by flight control
    ("uplink", _filled_in_later),  # by the uplink watch
    ("separation", _filled_in_later),  # by the monitor
    ("calibration", _filled_in_later),  # by the calibration that runs
    ("companion", _filled_in_later),  # by the fleet, which knows companions and components
    *(_group(group.name) for group in GROUPS),
    ("last_ack", _last_ack),
    ("status_texts", _texts),
    ("components", lambda v, now: v.system(now)),
    ("messages", lambda v, now: v.message_cache.rates(now)),
    ("links", lambda _v, _now: {}),  # by the hub
)


@functools.lru_cache(maxsize=64)  # a client names its keys once; there are few kinds of clients
def _selected(names: frozenset[str]) -> tuple[tuple[str, _Read], ...]:
    return tuple(entry for entry in _KEYS if entry[0] in names)
