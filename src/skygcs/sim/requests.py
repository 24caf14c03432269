"""Requests that a ground station can make of either firmware: commands common to both, parameters, missions, clocks."""

from __future__ import annotations

import struct
from collections.abc import Callable, Mapping
from math import atan2, isfinite
from typing import Any

from skygcs.core.mavlink.param_encoding import HASH_NAME
from skygcs.sim import calibration, mission_lists, onboard_logs
from skygcs.sim import protocol as m
from skygcs.sim.command_message import Command, from_int, from_long
from skygcs.sim.position_targets import is_position
from skygcs.sim.stream_schedule import NEVER
from skygcs.sim.vehicle_state import VehicleState

Fields = dict[str, Any]
Sender = tuple[int, int]

PARAMS_PER_TICK = 2
"""100 a second: the rate of a list over USB; a telemetry port is slower."""

ORIGIN_S = 0.1
"""Until PX4's estimator has an origin it was given; its vehicle_command passes two modules."""

MIN_INTERVAL_US = 20_000
"""A tick: faster streams are sent at this rate."""

MAX_INTERVAL_US = 60_000_000
"""ArduPilot's longest."""

INDEX_UNKNOWN = 65535
"""PARAM_VALUE.param_index of _HASH_CHECK (PX4)."""


BROADCAST_TO_PX4 = frozenset({519, 520})
"""REQUEST_PROTOCOL_VERSION and REQUEST_AUTOPILOT_CAPABILITIES: all that PX4 1.16 takes for system 0."""


def handle(v: VehicleState, name: str, fields: Fields, sender: Sender, now: float) -> None:
    """Answer one message addressed to this vehicle or to all."""
    if name in ("COMMAND_LONG", "COMMAND_INT"):
        command = from_long(fields, sender) if name == "COMMAND_LONG" else from_int(fields, sender)
        deaf = fields["target_system"] == 0 and not v.hears_broadcast_commands
        if deaf and command.id not in BROADCAST_TO_PX4:
            return
        result = v.command(command, now)
        if result is not None:
            v.tx.acknowledge(command.id, result, sender)
        return
    if name in mission_lists.MESSAGES:
        v.lists.hear(v, name, fields, sender, now)
        return
    if name in onboard_logs.MESSAGES:
        v.logs.hear(name, fields, armed=v.armed)
        return
    handler = _HANDLERS.get(name)
    if handler is not None:
        handler(v, fields, sender, now)
    elif name.startswith("SET_POSITION_TARGET_") or name == "SET_ATTITUDE_TARGET":
        v.on_setpoint(name, fields, now)


def step(v: VehicleState, now: float) -> None:
    """Advance what goes on over many ticks: a parameter list, a calibration, a mission transfer."""
    v.lists.step(v, now)
    v.logs.step(armed=v.armed)
    if v.shell is not None:
        v.shell.step(now)
    if v.param_queue:
        for _ in range(min(PARAMS_PER_TICK, len(v.param_queue))):
            _send_param(v, v.param_queue.pop(0))
    if v.calibration is not None:
        calibration.step(v, now)


# -- commands


def common_command(v: VehicleState, c: Command, now: float) -> int | None:
    """Result of a command both firmwares treat alike; UNSUPPORTED for all others; None: answered later."""
    handler = _COMMANDS.get(c.id)
    return m.MAV_RESULT_UNSUPPORTED if handler is None else handler(v, c, now)


def _message_name(v: VehicleState, msgid: float) -> str | None:
    info = v.dialect.messages.get(int(msgid)) if isfinite(msgid) else None
    return info.name if info is not None and v.streams.knows(info.name) else None


def _set_interval(v: VehicleState, c: Command, now: float) -> int:
    name = _message_name(v, c.p1)
    if name is None or not isfinite(c.p2):
        return v.firmware.answers.simulated.unknown_interval
    if c.p2 < 0:
        interval: float | None = NEVER
    else:
        interval = min(max(c.p2, MIN_INTERVAL_US), MAX_INTERVAL_US) / 1e6 if c.p2 > 0 else None
    v.streams.set_interval(name, interval, now)
    return m.MAV_RESULT_ACCEPTED


def _get_interval(v: VehicleState, c: Command, now: float) -> int:
    name = _message_name(v, c.p1)
    if name is None:
        v.tx.send("MESSAGE_INTERVAL", {"message_id": int(c.p1) & 0xFFFF if isfinite(c.p1) else 0, "interval_us": 0})
        return m.MAV_RESULT_FAILED
    interval = v.streams.interval(name)
    interval_us = -1 if interval == NEVER else round(interval * 1e6)
    v.tx.send("MESSAGE_INTERVAL", {"message_id": int(c.p1), "interval_us": interval_us})
    return m.MAV_RESULT_ACCEPTED


def _request_message(v: VehicleState, c: Command, now: float) -> int:
    name = _message_name(v, c.p1)
    if name is None:
        return v.firmware.answers.simulated.unknown_message
    v.send_soon(name)
    return m.MAV_RESULT_ACCEPTED


def _request_fixed(name: str) -> Callable[[VehicleState, Command, float], int]:
    def handler(v: VehicleState, c: Command, now: float) -> int:
        if not v.streams.knows(name):  # the dialect lacks it
            return m.MAV_RESULT_UNSUPPORTED
        v.send_soon(name)
        return m.MAV_RESULT_ACCEPTED

    return handler


def _reboot(v: VehicleState, c: Command, now: float) -> int | None:
    answers = v.firmware.answers.simulated
    if c.p1 == 0:
        return answers.reboot_nothing
    if c.p1 != 1:
        return m.MAV_RESULT_UNSUPPORTED
    if v.armed:
        return answers.reboot_armed
    v.tx.acknowledge(c.id, m.MAV_RESULT_ACCEPTED, c.sender)
    if v.motion.on_ground:
        v.motion.set_up()
    v.reboot(now)
    return None


def _terminate(v: VehicleState, c: Command, now: float) -> int | None:
    if c.p1 <= 0.5 or not v.armed:
        return v.firmware.answers.simulated.terminate_not
    v.switch_off("termination")
    return m.MAV_RESULT_ACCEPTED


def _pause(v: VehicleState, c: Command, now: float) -> int | None:
    return v.firmware.answers.simulated.pause


_COMMANDS: Mapping[int, Callable[[VehicleState, Command, float], int | None]] = {
    m.MAV_CMD_SET_MESSAGE_INTERVAL: _set_interval,
    m.MAV_CMD_GET_MESSAGE_INTERVAL: _get_interval,
    m.MAV_CMD_REQUEST_MESSAGE: _request_message,
    m.MAV_CMD_REQUEST_PROTOCOL_VERSION: _request_fixed("PROTOCOL_VERSION"),
    m.MAV_CMD_REQUEST_AUTOPILOT_CAPABILITIES: _request_fixed("AUTOPILOT_VERSION"),
    m.MAV_CMD_GET_HOME_POSITION: _request_fixed("HOME_POSITION"),
    m.MAV_CMD_PREFLIGHT_CALIBRATION: calibration.start,
    m.MAV_CMD_DO_START_MAG_CAL: calibration.compass_command,
    m.MAV_CMD_DO_CANCEL_MAG_CAL: calibration.compass_command,
    m.MAV_CMD_ACCELCAL_VEHICLE_POS: calibration.pose_command,
    m.MAV_CMD_PREFLIGHT_REBOOT_SHUTDOWN: _reboot,
    m.MAV_CMD_DO_FLIGHTTERMINATION: _terminate,
    m.MAV_CMD_DO_PAUSE_CONTINUE: _pause,
}


# -- parameters


def _send_param(v: VehicleState, index: int, reported_index: int | None = None) -> None:
    param = v.params.at(index)
    if param is not None:
        v.tx.send(
            "PARAM_VALUE",
            {
                "param_id": param.name,
                "param_value": v.params.encode(param),
                "param_type": param.type,
                "param_count": len(v.params),
                "param_index": index if reported_index is None else reported_index,
            },
        )


def _send_hash(v: VehicleState) -> None:
    bits = struct.unpack("<f", struct.pack("<I", v.params.hash))[0]
    fields = {"param_id": HASH_NAME, "param_value": bits, "param_type": m.MAV_PARAM_TYPE_UINT32}
    v.tx.send("PARAM_VALUE", {**fields, "param_count": len(v.params), "param_index": INDEX_UNKNOWN})


def _is_hash(v: VehicleState, fields: Fields) -> bool:
    return v.autopilot == m.MAV_AUTOPILOT_PX4 and fields["param_id"] == HASH_NAME


def _param_list(v: VehicleState, fields: Fields, sender: Sender, now: float) -> None:
    if v.autopilot == m.MAV_AUTOPILOT_PX4:
        _send_hash(v)
    v.param_queue = list(range(len(v.params)))


def _param_read(v: VehicleState, fields: Fields, sender: Sender, now: float) -> None:
    index = int(fields["param_index"])
    if index >= 0:
        _send_param(v, index)
        return
    if _is_hash(v, fields):
        _send_hash(v)
        return
    found = v.params.find(fields["param_id"])
    if found is not None:
        _send_param(v, found[0], v.named_param_index)


def _param_set(v: VehicleState, fields: Fields, sender: Sender, now: float) -> None:
    if _is_hash(v, fields):  # the ground station knows all: no list
        v.param_queue = []
        return
    param = v.params.set(fields["param_id"], fields["param_value"])
    found = v.params.find(fields["param_id"])
    if param is not None and found is not None:
        _send_param(v, found[0], v.named_param_index)
        v.position_control.gains = v.control_gains()
        v.on_param(param.name, now)


# -- missions


def _mission_current(v: VehicleState, fields: Fields, sender: Sender, now: float) -> None:
    v.run.on_set_current(v, int(fields["seq"]), now)


# -- clocks, streams, modes


def _to(sender: Sender) -> Fields:
    return {"target_system": sender[0], "target_component": sender[1]}


def _ping(v: VehicleState, fields: Fields, sender: Sender, now: float) -> None:
    if fields["target_system"] == 0 and fields["target_component"] == 0:  # else it is an answer
        v.tx.send("PING", _to(sender) | {"time_usec": fields["time_usec"], "seq": fields["seq"]})


def _timesync(v: VehicleState, fields: Fields, sender: Sender, now: float) -> None:
    if fields["tc1"] == 0:
        answer = {"tc1": round((now - v.boot_at) * 1e9), "ts1": fields["ts1"]}
        info = v.dialect.by_name["TIMESYNC"]
        if info.target_system_offset >= 0:
            answer |= _to(sender)
        v.tx.send("TIMESYNC", answer)


def _set_origin(v: VehicleState, fields: Fields, sender: Sender, now: float) -> None:
    """PX4 takes it whenever it comes for its own id, and answers at once with what it has until its estimator has the
    new one. ArduPilot takes it while it has none, and is silent otherwise."""
    lat, lon = fields["latitude"] / 1e7, fields["longitude"] / 1e7
    place = (*v.where.to_local(lat, lon), fields["altitude"] / 1000 - v.where.alt_amsl_m)

    def take() -> None:
        v.set_local_origin(*place)

    if v.autopilot == m.MAV_AUTOPILOT_PX4:
        v.send_message("GPS_GLOBAL_ORIGIN", now)
        if fields["target_system"] == v.sysid and is_position(lat, lon):
            v.later(now + ORIGIN_S, take)
    elif v.home is None and v.local_zero is None and is_position(lat, lon):
        take()


def _vision(v: VehicleState, fields: Fields, sender: Sender, now: float) -> None:
    _pose(v, fields, fields["yaw"], int(fields["usec"]), now)


def _odometry(v: VehicleState, fields: Fields, sender: Sender, now: float) -> None:
    if v.vision.takes("ODOMETRY", fields):
        w, x, y, z = fields["q"]
        yaw_rad = atan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))
        _pose(v, fields, yaw_rad, int(fields["time_usec"]), now)


def _pose(v: VehicleState, fields: Fields, yaw_rad: float, usec: int, now: float) -> None:
    """Its local frame counts from the origin it was given; until then the poses say where that is."""
    if not v.by_vision:
        return
    v.vision.stamp(usec, int(fields["reset_counter"]))
    body, zero, pos_ned_m = v.motion, v.local_zero, (fields["x"], fields["y"], fields["z"])
    true_ned_m = pos_ned_m
    if zero is not None:
        true_ned_m = (body.north_m - zero.north_m, body.east_m - zero.east_m, zero.up_m - body.up_m)
    v.vision.on_pose(pos_ned_m, yaw_rad, true_ned_m, body.yaw_rad, now)


def _data_stream(v: VehicleState, fields: Fields, sender: Sender, now: float) -> None:
    rate_hz = float(fields["req_message_rate"]) if fields["start_stop"] else 0.0
    v.on_data_stream(int(fields["req_stream_id"]), rate_hz, now)


def _set_mode(v: VehicleState, fields: Fields, sender: Sender, now: float) -> None:
    if fields["base_mode"] & m.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED:
        v.on_set_mode_message(int(fields["custom_mode"]), sender, now)


def _setup_signing(v: VehicleState, fields: Fields, sender: Sender, now: float) -> None:
    if not v.can_sign:
        return
    if v.armed:
        v.tx.say(m.MAV_SEVERITY_WARNING, "ERROR: Won't setup signing when armed")
        return
    v.signing.set_up(fields)


def _heartbeat(v: VehicleState, fields: Fields, sender: Sender, now: float) -> None:
    if fields["type"] == m.MAV_TYPE_GCS:
        v.on_gcs_heartbeat(sender, now)


def _corrections(v: VehicleState, fields: Fields, sender: Sender, now: float) -> None:
    v.rtk.on_message(fields, now)


def _serial_control(v: VehicleState, fields: Fields, sender: Sender, now: float) -> None:
    if v.shell is not None:  # an ArduPilot answers nothing for a device that it does not have (GCS_serial_control.cpp)
        v.shell.hear(fields, sender)


def _file_transfer(v: VehicleState, fields: Fields, sender: Sender, now: float) -> None:
    v.on_file_transfer(bytes(fields["payload"]), sender, now)


_HANDLERS: Mapping[str, Callable[[VehicleState, Fields, Sender, float], None]] = {
    "HEARTBEAT": _heartbeat,
    "PARAM_REQUEST_LIST": _param_list,
    "PARAM_REQUEST_READ": _param_read,
    "PARAM_SET": _param_set,
    "MISSION_SET_CURRENT": _mission_current,
    "PING": _ping,
    "TIMESYNC": _timesync,
    "SET_GPS_GLOBAL_ORIGIN": _set_origin,
    "VISION_POSITION_ESTIMATE": _vision,
    "ODOMETRY": _odometry,
    "REQUEST_DATA_STREAM": _data_stream,
    "SET_MODE": _set_mode,
    "SETUP_SIGNING": _setup_signing,
    "FILE_TRANSFER_PROTOCOL": _file_transfer,
    "SERIAL_CONTROL": _serial_control,
    "GPS_RTCM_DATA": _corrections,
}
