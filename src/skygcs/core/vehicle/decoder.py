"""The fields that are read of each message, and readers for them: one `Decoder` per dialect, shared by all vehicles."""

from __future__ import annotations

import struct
from collections.abc import Callable, Mapping
from typing import Any

from skygcs.core.mavlink.dialect import Dialect, MessageInfo

Reader = Callable[[bytes], tuple[Any, ...]]
"""Reads fields of a payload, trimmed or not, in a fixed order with one struct call."""

Values = Mapping[str, tuple[Any, ...]]
"""Per message its scalar fields in the order of `FIELDS`, then its arrays in the order of `ARRAYS`."""

_RC = tuple(f"chan{n}_raw" for n in range(1, 19))
_RC_RAW = tuple(f"chan{n}_raw" for n in range(1, 9))
_SERVO = tuple(f"servo{n}_raw" for n in range(1, 17))
_IMU = ("xacc", "yacc", "zacc", "xgyro", "ygyro", "zgyro", "xmag", "ymag", "zmag")

FIELDS: dict[str, tuple[str, ...]] = {
    "SYS_STATUS": (
        "onboard_control_sensors_present",
        "onboard_control_sensors_enabled",
        "onboard_control_sensors_health",
        "load",
        "voltage_battery",
        "current_battery",
        "battery_remaining",
    ),
    "GPS_RAW_INT": ("fix_type", "lat", "lon", "alt", "eph", "epv", "satellites_visible", "time_usec"),
    "GLOBAL_POSITION_INT": ("time_boot_ms", "lat", "lon", "alt", "relative_alt", "vx", "vy", "vz", "hdg"),
    "LOCAL_POSITION_NED": ("time_boot_ms", "x", "y", "z", "vx", "vy", "vz"),
    "ATTITUDE": ("time_boot_ms", "roll", "pitch", "yaw", "rollspeed", "pitchspeed", "yawspeed"),
    "ATTITUDE_QUATERNION": ("time_boot_ms", "q1", "q2", "q3", "q4", "rollspeed", "pitchspeed", "yawspeed"),
    "BATTERY_STATUS": (
        "id",
        "temperature",
        "current_battery",
        "current_consumed",
        "battery_remaining",
        "time_remaining",
    ),
    "HOME_POSITION": ("latitude", "longitude", "altitude"),
    "GPS_GLOBAL_ORIGIN": ("latitude", "longitude", "altitude"),
    "ESTIMATOR_STATUS": (
        "flags",
        "vel_ratio",
        "pos_horiz_ratio",
        "pos_vert_ratio",
        "mag_ratio",
        "pos_horiz_accuracy",
        "pos_vert_accuracy",
    ),
    "EKF_STATUS_REPORT": (
        "flags",
        "velocity_variance",
        "pos_horiz_variance",
        "pos_vert_variance",
        "compass_variance",
    ),
    "VFR_HUD": ("airspeed", "groundspeed", "heading", "throttle", "alt", "climb"),
    "RC_CHANNELS": ("time_boot_ms", "chancount", "rssi", *_RC),
    "RC_CHANNELS_RAW": ("time_boot_ms", "rssi", *_RC_RAW),
    "HIGHRES_IMU": (*_IMU, "abs_pressure", "temperature"),
    "SCALED_IMU": _IMU,
    "RAW_IMU": _IMU,
    "SERVO_OUTPUT_RAW": _SERVO,
    "MISSION_CURRENT": ("seq", "total"),
    "MISSION_COUNT": ("count",),
    "MISSION_ACK": ("type",),
    "PARAM_VALUE": ("param_id", "param_value", "param_type"),
    "POSITION_TARGET_GLOBAL_INT": (
        "coordinate_frame",
        "type_mask",
        "lat_int",
        "lon_int",
        "alt",
        "vx",
        "vy",
        "vz",
        "yaw",
    ),
    "POSITION_TARGET_LOCAL_NED": ("coordinate_frame", "type_mask", "x", "y", "z", "vx", "vy", "vz", "yaw"),
    "SYSTEM_TIME": ("time_unix_usec", "time_boot_ms"),
    "HIGH_LATENCY2": (
        "type",
        "autopilot",
        "custom_mode",
        "failure_flags",
        "latitude",
        "longitude",
        "altitude",
        "heading",
        "groundspeed",
        "throttle",
        "battery",
        "wp_num",
    ),
    "COMMAND_ACK": ("command", "result", "progress", "target_system", "target_component"),
    "HEARTBEAT": ("type", "autopilot", "base_mode", "custom_mode", "system_status"),
    "STATUSTEXT": ("severity", "text", "id", "chunk_seq"),
    "EXTENDED_SYS_STATE": ("vtol_state", "landed_state"),
    "AUTOPILOT_VERSION": ("flight_sw_version", "capabilities"),
}
"""The fields read of each message. A message that a dialect lacks, or has with other fields, is not decoded."""

ARRAYS: dict[str, tuple[str, ...]] = {"BATTERY_STATUS": ("voltages",), "ATTITUDE_TARGET": ("q", "type_mask", "thrust")}


class Decoder:
    """Readers of one dialect's messages; built once and shared by all vehicles."""

    def __init__(self, dialect: Dialect) -> None:
        self.dialect = dialect
        self.read: dict[str, Reader] = {}
        """Readers of the scalar fields, without messages that this dialect does not have."""
        self._read_all: dict[str, Reader] = {}
        for name in FIELDS.keys() | ARRAYS.keys():
            info = dialect.by_name.get(name)
            fields = FIELDS.get(name, ())
            if info is not None and {f.name for f in info.fields}.issuperset((*fields, *ARRAYS.get(name, ()))):
                self.read[name] = info.reader(*fields)
                arrays = ARRAYS.get(name)
                self._read_all[name] = _reader(info, (*fields, *arrays)) if arrays else self.read[name]

    def msgid_of(self, message: str) -> int:
        """msgid of a message of the dialect; -1 if there is no message of that name."""
        info = self.dialect.by_name.get(message)
        return -1 if info is None else info.msgid

    def values(self, name: str, payload: bytes) -> tuple[Any, ...]:
        """The fields of `FIELDS`, then the message's arrays, in order; () if the dialect does not have them."""
        read = self._read_all.get(name)
        return () if read is None else read(payload)

    def bit_names(self, enum: str, bits: int, prefix: str) -> list[str]:
        """Names of the set bits, lower case, without the prefix; unnamed bits as "bit_5"."""
        entries = self.dialect.enums.get(enum, {})
        names = []
        for n in range(bits.bit_length()):
            if bits >> n & 1:
                entry = entries.get(1 << n)
                names.append(entry.removeprefix(prefix).lower() if entry else f"bit_{n}")
        return names


def _reader(info: MessageInfo, names: tuple[str, ...]) -> Reader:
    """`MessageInfo.reader` for fields some of which are arrays of numbers, which come as tuples."""
    fmt, end, count = "<", 0, 0
    places: dict[str, int | slice] = {}
    for field in sorted((f for f in info.fields if f.name in names), key=lambda f: f.offset):
        fmt += f"{field.offset - end}x{field.code}"
        end = struct.calcsize(fmt)
        places[field.name] = slice(count, count + field.array_length) if field.array_length else count
        count += field.array_length or 1
    compiled = struct.Struct(fmt)
    wanted = [places[name] for name in names]

    def read(payload: bytes) -> tuple[Any, ...]:
        values = compiled.unpack_from(payload.ljust(compiled.size, b"\0"))
        return tuple([values[place] for place in wanted])

    return read
