"""The fleet as messages of skygcs_msgs: states, events and the plan, as the daemon's RPC returns them. Pure.

Frame: "map", whose origin and axes are those of the fleet. Unknown numbers are NaN, unknown texts "".
"""

from __future__ import annotations

import json
import math
from collections.abc import Iterable, Mapping
from typing import Any

from skygcs.core.ros.rotations import xyz
from skygcs.core.ros.stamps import header, time_fields

FRAME = "map"

MOST_TEXT = 1000
"""Characters of a text that comes from outside."""

MOST_DATA = 4096
"""Characters of an event's data; longer data is left out, as truncated JSON cannot be read."""

MOST_VEHICLES = 250
"""Vehicles in one message."""

Fields = Mapping[str, Any]

UNKNOWN_POINT = (math.nan,) * 3


def fleet(vehicles: Iterable[tuple[Fields, str]], has_origin: bool, connected: bool, now_ns: int) -> dict[str, Any]:
    """skygcs_msgs' Fleet. ``vehicles``: the state of each and its namespace; ``connected``: to the daemon."""
    rows = [vehicle(state, root, connected) for state, root in vehicles][:MOST_VEHICLES]
    head = header(now_ns, FRAME)
    return {"header": head, "daemon_connected": connected, "has_origin": has_origin and connected, "vehicles": rows}


def vehicle(state: Fields, root: str, connected: bool = True) -> dict[str, Any]:
    """skygcs_msgs' Vehicle. ``connected``: to the daemon, without which nothing is known of the vehicle."""
    position, battery = state.get("position") or {}, state.get("battery") or {}
    control = state.get("control") or {}
    return {
        "name": text(state["name"]),
        "system_id": state["sysid"],
        "namespace_root": root,
        "autopilot": text(state.get("autopilot")),
        "connected": connected and bool(state.get("connected")),
        "armed": bool(state.get("armed")),
        "failsafe": bool(state.get("failsafe")),
        "mode": text(state.get("mode")),
        "landed": text(state.get("landed")),
        "lat_deg": number(position.get("lat_deg")),
        "lon_deg": number(position.get("lon_deg")),
        "alt_amsl_m": number(position.get("alt_amsl_m")),
        "height_m": number(position.get("alt_rel_m")),
        "position_age_s": number(position.get("age_s")),
        "position": point(position.get("enu_m")),
        "velocity": point(position.get("vel_world_mps")),
        "yaw_deg": number(position.get("yaw_world_deg")),
        "battery_percent": number(battery.get("percent")),
        "battery_volts": number(battery.get("volts")),
        "control": text(control.get("state")) or "off",
        "control_mode": text(control.get("control_mode")),
    }


def event(given: Fields) -> dict[str, Any]:
    """skygcs_msgs' Event of one of the daemon's."""
    data = json.dumps(given.get("data") or {}, separators=(",", ":"))
    at_s = given.get("time_unix_s") or 0.0
    known = 0.0 <= at_s < 2.0**31
    return {
        "stamp": time_fields(round(at_s * 1e6) * 1000 if known else 0),
        "kind": text(given.get("kind")),
        "vehicle": text(given.get("vehicle")),
        "text": text(given.get("text")),
        "data": data if len(data) <= MOST_DATA else "",
        "dropped": min(int(given.get("dropped") or 0), 2**32 - 1),
    }


def plan(status: Fields, now_ns: int) -> dict[str, Any]:
    """skygcs_msgs' Plan of plan.status."""
    names = ("plan", "name", "kind", "state", "busy", "phase", "reason", "by")
    return {
        "header": header(now_ns, FRAME),
        **{name: text(status.get(name)) for name in names},
        "step": status.get("step") or 0,
        "steps": status.get("steps") or 0,
        "speed": number(status.get("speed")),
        "waits_for": [text(name) for name in (status.get("waits_for") or ())[:MOST_VEHICLES]],
        "vehicles": [_plan_vehicle(row) for row in (status.get("vehicles") or ())[:MOST_VEHICLES]],
    }


def _plan_vehicle(row: Fields) -> dict[str, Any]:
    return {
        "name": text(row.get("vehicle")),
        "state": text(row.get("state")),
        "error_m": number(row.get("error_m")),
        "tube_m": number(row.get("tube_m")),
        "position": point(row.get("pos_enu_m")),
        "goal": point(row.get("goal_enu_m")),
        "left": text(row.get("left")),
    }


def text(value: Any) -> str:
    """A text for a message: no longer than MOST_TEXT, without zeros, which end a string of CDR, and in UTF-8."""
    if value is None:
        return ""
    return str(value)[:MOST_TEXT].replace("\0", "").encode("utf-8", "replace").decode()


def number(value: Any) -> float:
    """A number for a message; NaN if it is not known."""
    return float(value) if isinstance(value, int | float) else math.nan


def point(values: Any) -> dict[str, float]:
    """geometry_msgs' Point or Vector3; NaN where an axis is not known."""
    known = values if isinstance(values, list | tuple) and len(values) == 3 else UNKNOWN_POINT
    return xyz([number(value) for value in known])
