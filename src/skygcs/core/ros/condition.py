"""state, battery, rc/…, statustext, radio_status and the like (MAVROS' plugins sys, rc, time, 3dr_radio, vfr_hud)."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any

from skygcs.core.mavlink.modes import (
    AUTOPILOT_PX4,
    CUSTOM_MODE_ENABLED,
    PX4_MAIN_AUTO,
    SAFETY_ARMED,
    family,
    mode_name,
)
from skygcs.core.ros.memory import Sample, VehicleMemory
from skygcs.core.ros.stamps import header, time_fields

GUIDED_ENABLED, MANUAL_INPUT_ENABLED = 8, 64
"""MAV_MODE_FLAG."""

DISCHARGING = 2
TECHNOLOGY = {1: 3, 2: 4, 3: 2, 4: 1}
"""sensor_msgs' BatteryState.POWER_SUPPLY_TECHNOLOGY of each MAV_BATTERY_TYPE (LIPO, LIFE, LION, NIMH)."""

CELL_UNKNOWN, CELL_CONTINUES = 0xFFFF, 0xFFFE
"""BATTERY_STATUS.voltages: no cell; a cell of which the next entry has the rest (mV)."""

GPS_TIME_US = 1_234_567_890_000_000
"""An earlier SYSTEM_TIME is not set by a receiver."""

RC_CHANNELS_MOST = 18

ESTIMATOR_FLAGS = (
    *("attitude", "velocity_horiz", "velocity_vert", "pos_horiz_rel", "pos_horiz_abs", "pos_vert_abs"),
    *("pos_vert_agl", "const_pos_mode", "pred_pos_horiz_rel", "pred_pos_horiz_abs", "gps_glitch", "accel_error"),
)
"""ESTIMATOR_STATUS_FLAGS from bit 0 on, as mavros_msgs' EstimatorStatus names them."""

RADIO_DBM = 1.9, 127.0
"""Units of a SiK radio's rssi per dB, and what 0 means in dBm below 0."""

LOG_LEVELS = dict(enumerate((40, 40, 40, 40, 30, 30, 20, 10)))
LOG_WARN = 30
"""rcl_interfaces' Log level of each MAV_SEVERITY, by the classes in which MAVROS logs (process_statustext_normal of
its plugin sys_status): from emergency on errors, a notice is a warning, and so is an unknown severity."""


def heartbeat(fields: dict[str, Any], arrival_ns: int, memory: VehicleMemory) -> Iterator[Sample]:
    """HEARTBEAT of the autopilot."""
    memory.autopilot, memory.mav_type = fields["autopilot"], fields["type"]
    base_mode = fields["base_mode"]
    yield Sample(
        "state",
        {
            "header": header(arrival_ns),
            "connected": True,
            "armed": bool(base_mode & SAFETY_ARMED),
            "guided": bool(base_mode & GUIDED_ENABLED),
            "manual_input": bool(base_mode & MANUAL_INPUT_ENABLED),
            "mode": ros_mode(fields),
            "system_status": fields["system_status"],
        },
    )


def ros_mode(fields: dict[str, Any]) -> str:
    """The mode's name as MAVROS has it (UAS::str_mode_v10, lib/uas_stringify.cpp): of a PX4 a sub mode counts in AUTO
    alone. A mode for which MAVROS has no name, as CMODE(21), has the autopilot's."""
    if not fields["base_mode"] & CUSTOM_MODE_ENABLED:
        return f"MODE(0x{fields['base_mode']:2X})"
    autopilot, number = fields["autopilot"], fields["custom_mode"]
    if autopilot == AUTOPILOT_PX4:
        number &= 0xFFFF0000 if number >> 16 & 0xFF == PX4_MAIN_AUTO else 0x00FF0000
    name = mode_name(autopilot, fields["type"], fields["base_mode"], number)
    known = family(autopilot) != "generic" and not name.startswith("UNKNOWN")
    return name if known else f"CMODE({number})"


def disconnected(now_ns: int) -> Sample:
    """State of a vehicle that is not heard."""
    return Sample("state", {"header": header(now_ns)})


def extended_sys_state(fields: dict[str, Any], arrival_ns: int, memory: VehicleMemory) -> Iterator[Sample]:
    """EXTENDED_SYS_STATE."""
    state = {"vtol_state": fields["vtol_state"], "landed_state": fields["landed_state"]}
    yield Sample("extended_state", {"header": header(arrival_ns), **state})


def sys_status(fields: dict[str, Any], arrival_ns: int, memory: VehicleMemory) -> Iterator[Sample]:
    """SYS_STATUS; its battery unless the vehicle sends BATTERY_STATUS of the first."""
    names = {name: f"onboard_control_{name}" for name in ("sensors_present", "sensors_enabled", "sensors_health")}
    plain = ("load", "voltage_battery", "current_battery", "battery_remaining", "drop_rate_comm", "errors_comm")
    counts = tuple(f"errors_count{n}" for n in range(1, 5))
    status = {name: fields[names.get(name, name)] for name in (*names, *plain, *counts)}
    yield Sample("sys_status", {"header": header(arrival_ns), **status})
    if not memory.has_battery0:
        volts, amps = fields["voltage_battery"] / 1000, fields["current_battery"] / 100
        yield Sample("battery", _battery(arrival_ns, volts, amps, fields["battery_remaining"] / 100))


def battery_status(fields: dict[str, Any], arrival_ns: int, memory: VehicleMemory) -> Iterator[Sample]:
    """BATTERY_STATUS."""
    cells, above = _cells(fields["voltages"], {CELL_UNKNOWN}, 0.0)
    cells += _cells(fields.get("voltages_ext") or (), {CELL_UNKNOWN, 0}, above)[0]
    battery = _battery(arrival_ns, sum(cells), fields["current_battery"] / 100, fields["battery_remaining"] / 100)
    battery["power_supply_technology"] = TECHNOLOGY.get(fields["type"], 0)
    battery["cell_voltage"] = cells
    battery["location"] = f"id{fields['id']}"
    memory.has_battery0 |= fields["id"] == 0
    yield Sample("battery", battery)


def _battery(arrival_ns: int, volts: float, amps: float, fraction: float) -> dict[str, Any]:
    """Convert a battery. For unknown values MAVROS passes the -1 of the message on: 0.01 A, -0.01 of the capacity."""
    return {
        "header": header(arrival_ns),
        "voltage": volts,
        "current": -amps,
        "charge": math.nan,
        "capacity": math.nan,
        "design_capacity": math.nan,
        "percentage": fraction,
        "power_supply_status": DISCHARGING,
        "present": True,
    }


def _cells(millivolts: Any, ends: set[int], above: float) -> tuple[list[float], float]:
    """The voltages of cells, and what the next array's first one continues; ``above``: what its own first continues."""
    cells = []
    for value in millivolts:
        if value in ends:
            break
        if value == CELL_CONTINUES:
            above += CELL_CONTINUES * 1e-3
            continue
        cells.append(above + value * 1e-3)
        above = 0.0
    return cells, above


def estimator_status(fields: dict[str, Any], arrival_ns: int, memory: VehicleMemory) -> Iterator[Sample]:
    """ESTIMATOR_STATUS."""
    flags = {f"{name}_status_flag": bool(fields["flags"] >> bit & 1) for bit, name in enumerate(ESTIMATOR_FLAGS)}
    yield Sample("estimator_status", {"header": header(arrival_ns), **flags})


def statustext(fields: dict[str, Any], arrival_ns: int, memory: VehicleMemory) -> Iterator[Sample]:
    """STATUSTEXT."""
    text = {"severity": fields["severity"], "text": fields["text"]}
    yield Sample("statustext/recv", {"header": header(arrival_ns), **text})


def log_entry(name: str, severity: int, text: str, now_ns: int) -> dict[str, Any]:
    """A message of /rosout (rcl_interfaces' Log)."""
    level = LOG_LEVELS.get(severity, LOG_WARN)
    return {"stamp": time_fields(now_ns), "level": level, "name": name, "msg": text}


def event(fields: dict[str, Any], arrival_ns: int, memory: VehicleMemory) -> Iterator[Sample]:
    """EVENT of a PX4."""
    yield Sample(
        "status_event",
        {
            "header": header(memory.clock.stamp_ns(fields["event_time_boot_ms"] * 1000, arrival_ns)),
            "severity": fields["log_levels"] & 0x0F,
            "px4_id": fields["id"] & 0x00FFFFFF,
            "arguments": fields["arguments"],
            "sequence": fields["sequence"],
        },
    )


def rc_channels(fields: dict[str, Any], arrival_ns: int, memory: VehicleMemory) -> Iterator[Sample]:
    """RC_CHANNELS."""
    memory.has_rc_channels = True
    count = min(fields["chancount"], RC_CHANNELS_MOST)
    memory.rc_in = [fields[f"chan{n}_raw"] for n in range(1, count + 1)]
    yield _rc_in(fields, arrival_ns, memory)


def rc_channels_raw(fields: dict[str, Any], arrival_ns: int, memory: VehicleMemory) -> Iterator[Sample]:
    """RC_CHANNELS_RAW, unless the vehicle sends RC_CHANNELS."""
    if memory.has_rc_channels:
        return
    _put_port(memory.rc_in, fields["port"], [fields[f"chan{n}_raw"] for n in range(1, 9)])
    yield _rc_in(fields, arrival_ns, memory)


def _rc_in(fields: dict[str, Any], arrival_ns: int, memory: VehicleMemory) -> Sample:
    head = header(memory.clock.stamp_ns(fields["time_boot_ms"] * 1000, arrival_ns))
    return Sample("rc/in", {"header": head, "rssi": fields["rssi"], "channels": list(memory.rc_in)})


def servo_output_raw(fields: dict[str, Any], arrival_ns: int, memory: VehicleMemory) -> Iterator[Sample]:
    """SERVO_OUTPUT_RAW; 16 of each port, as of MAVLink 2."""
    _put_port(memory.rc_out, fields["port"], [fields.get(f"servo{n}_raw") or 0 for n in range(1, 17)])
    head = header(memory.clock.stamp_ns(fields["time_usec"], arrival_ns))
    yield Sample("rc/out", {"header": head, "channels": list(memory.rc_out)})


def _put_port(channels: list[int], port: int, values: list[int]) -> None:
    """Values of one of at most 16 ports (the message has one of 256)."""
    at = (port & 0x0F) * len(values)
    channels.extend([0] * (at + len(values) - len(channels)))
    channels[at : at + len(values)] = values


def radio_status(fields: dict[str, Any], arrival_ns: int, memory: VehicleMemory) -> Iterator[Sample]:
    """RADIO_STATUS of a SiK radio."""
    per_db, below = RADIO_DBM
    names = ("rssi", "remrssi", "txbuf", "noise", "remnoise", "rxerrors", "fixed")
    dbm = {f"{name}_dbm": fields[name] / per_db - below for name in ("rssi", "remrssi")}
    yield Sample("radio_status", {"header": header(arrival_ns), **{name: fields[name] for name in names}, **dbm})


def system_time(fields: dict[str, Any], arrival_ns: int, memory: VehicleMemory) -> Iterator[Sample]:
    """SYSTEM_TIME, once a receiver has set it."""
    unix_us = fields["time_unix_usec"]
    if unix_us > GPS_TIME_US:
        reference = {"time_ref": time_fields(min(unix_us * 1000, 2**31 * 10**9 - 1)), "source": "fcu"}
        yield Sample("time_reference", {"header": header(arrival_ns), **reference})


def mission_item_reached(fields: dict[str, Any], arrival_ns: int, memory: VehicleMemory) -> Iterator[Sample]:
    """MISSION_ITEM_REACHED."""
    yield Sample("mission/reached", {"header": header(arrival_ns), "wp_seq": fields["seq"]})


def vfr_hud(fields: dict[str, Any], arrival_ns: int, memory: VehicleMemory) -> Iterator[Sample]:
    """VFR_HUD."""
    names = {
        "airspeed": "airspeed",
        "groundspeed": "groundspeed",
        "heading": "heading",
        "altitude": "alt",
        "climb": "climb",
    }
    hud = {name: fields[source] for name, source in names.items()}
    yield Sample("vfr_hud", {"header": header(arrival_ns), **hud, "throttle": fields["throttle"] / 100})
