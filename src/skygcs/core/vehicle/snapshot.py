"""The whole state of a vehicle as one dictionary, for RPC and for people."""

from __future__ import annotations

import math
from typing import Any

from skygcs.core.geo import world_from_enu, wrap_deg_180
from skygcs.core.protocols.command import RESULT_NAMES
from skygcs.core.vehicle.message_cache import Slot
from skygcs.core.vehicle.state import SEVERITY, SYSTEM_STATUS, Part, VehicleState, name_of
from skygcs.core.vehicle.statustext import MAX_STATUS_TEXTS
from skygcs.core.vehicle.vehicle import Vehicle


def take_snapshot(vehicle: Vehicle, now: float, unix_now: float | None = None) -> VehicleState:
    """The whole state at ``now``. ``unix_now`` (wall clock at ``now``) makes clock_offset_s known."""
    groups = vehicle.message_cache.telemetry_groups(now)
    position = groups["position"]
    if position is not None:
        position |= _in_the_world(vehicle, position)
    state: dict[str, Any] = {
        "name": vehicle.name,
        "sysid": vehicle.sysid,
        "compid": vehicle.compid,
        "autopilot": vehicle.family,
        "type": vehicle.enum_name("MAV_TYPE", vehicle.type),
        "firmware": vehicle.firmware,
        "groups": list(vehicle.groups),
        "gcs_sysid": vehicle.gcs_sysid,
        "connected": vehicle.connected,
        "duplicate_sysid": vehicle.duplicate,
        "replayed": vehicle.replayed,
        "last_heartbeat_age_s": _rounded(vehicle.silence_s(now), 3),
        "uptime_s": _rounded(vehicle.boot.uptime_s(now), 1),
        "clock_offset_s": None if unix_now is None else vehicle.clock_offset_s(now, unix_now),
        "armed": vehicle.armed,
        "mode": vehicle.mode,
        "system_status": name_of(SYSTEM_STATUS, vehicle.system_status),
        "landed": vehicle.landed(now),
        "failsafe": vehicle.failsafe,
        "control": None,  # filled in by flight control
        "uplink": None,  # filled in by the uplink watch
        "separation": None,  # filled in by the monitor
        "calibration": None,  # filled in by the calibration that runs
        **groups,
        "last_ack": _last_ack(vehicle, now),
        "status_texts": _texts(vehicle, now),
        "components": vehicle.system(now),
        "messages": vehicle.message_cache.rates(now),
        "links": {},
    }
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
