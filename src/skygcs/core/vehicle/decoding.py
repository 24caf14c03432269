"""Decodes messages to telemetry groups: the only place where scaled integers, NED and FRD are read.

The fields that are read of each message have readers: one `Decoder` per dialect, shared by all vehicles. Firmware
versions come from AUTOPILOT_VERSION and from ArduPilot's banner text.

A group is decoded when it is read, from the last frame of each of its messages. "Not known" values of the protocol
(65535, -1, INT_MAX, NaN ...) become None. Results are JSON-able, in SI units, degrees and ENU.
"""

from __future__ import annotations

import math
import re
import struct
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from skygcs.core.geo import euler_from_quaternion, is_no_place, quaternion_from_euler, wrap_deg_180
from skygcs.core.mavlink.dialect import Dialect, MessageInfo

# --- firmware versions ------------------------------------------------------------------------------------------------

_STAGES = ((255, ""), (192, "-rc"), (128, "-beta"), (64, "-alpha"), (0, "-dev"))
"""FIRMWARE_VERSION_TYPE, lowest value of each."""

_BANNER = re.compile(
    r"^(Ardu\w+|AP\w+(?::\w+)?|Blimp|Rover|AntennaTracker) V(\d+\.\d+\.\d+(?:-?[a-z]+\d*)?)\b", re.ASCII
)


def firmware_from_version(flight_sw_version: int) -> str | None:
    """``4.5.1``, ``1.16.0-rc2``; None for 0, which is "unknown"."""
    if not flight_sw_version:
        return None
    major, minor, patch = flight_sw_version >> 24 & 0xFF, flight_sw_version >> 16 & 0xFF, flight_sw_version >> 8 & 0xFF
    kind = flight_sw_version & 0xFF
    least, stage = next((low, name) for low, name in _STAGES if kind >= low)
    number = str(kind - least) if stage and kind > least else ""
    return f"{major}.{minor}.{patch}{stage}{number}"


def firmware_from_banner(text: str) -> str | None:
    """The version in ``ArduCopter V4.5.1 (f4a2dcba)``; None if the text is not a banner."""
    match = _BANNER.match(text)
    return match[2] if match else None


def banner_program(text: str) -> str | None:
    """The program in a banner, as it names itself: "ArduCopter"; None if the text is not a banner."""
    match = _BANNER.match(text)
    return match[1] if match else None


# --- fields and their readers -----------------------------------------------------------------------------------------


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


# --- telemetry groups -------------------------------------------------------------------------------------------------


TelemetryGroup = dict[str, Any]

GRAVITY_MPS2 = 9.80665

FIX_NAMES = ("no_gps", "no_fix", "2d", "3d", "dgps", "rtk_float", "rtk_fixed", "static", "ppp")
"""GPS_FIX_TYPE."""


@dataclass(frozen=True, slots=True)
class TelemetryGroupSpec:
    """A telemetry group: its name, its messages, and the function that decodes them (None: no data).

    ``combine``: the messages complete each other and all are passed. Otherwise they carry the same data and one is
    passed: the first in the list that is not much older than the others.
    """

    name: str
    messages: tuple[str, ...]
    decode: Callable[[Values, Decoder], TelemetryGroup | None]
    combine: bool = False


def _number(value: float, digits: int = 3) -> float | None:
    return round(value, digits) if math.isfinite(value) else None


def _scaled(value: int, unknown: int, scale: float, digits: int) -> float | None:
    return None if value == unknown else round(value * scale, digits)


def _amps(centiamps: int) -> float | None:
    """-1 is "not measured"; PX4 multiplies its -1 A for this by 100."""
    return None if centiamps in (-1, -100) else centiamps / 100


def _numbers(values: Sequence[float], scale: float = 1.0, digits: int = 4) -> list[float | None]:
    return [_number(v * scale, digits) for v in values]


def _lat_lon(lat: int, lon: int) -> tuple[float | None, float | None]:
    return (None, None) if is_no_place(lat, lon) else (lat / 1e7, lon / 1e7)


def decode_gps(v: Values, decoder: Decoder) -> TelemetryGroup | None:
    fix, lat, lon, alt, eph, epv, satellites, time_usec = v["GPS_RAW_INT"]
    lat_deg, lon_deg = _lat_lon(lat, lon)
    return {
        "fix": FIX_NAMES[fix] if fix < len(FIX_NAMES) else f"fix_{fix}",
        "fix_type": fix,
        "satellites": None if satellites == 255 else satellites,
        "hdop": _scaled(eph, 65535, 0.01, 2),
        "vdop": _scaled(epv, 65535, 0.01, 2),
        "lat_deg": lat_deg,
        "lon_deg": lon_deg,
        "alt_amsl_m": None if lat_deg is None else alt / 1000,
        "time_usec": time_usec,
    }


GlobalPosition = tuple[float | None, float | None, float, tuple[float, float, float]]
"""lat_deg, lon_deg (None, both of them: not known), alt_amsl_m, vel_enu_mps."""


def global_position(fields: tuple[Any, ...]) -> GlobalPosition:
    """The part of GLOBAL_POSITION_INT that control reads for every setpoint. Its velocity is north, east, **down**
    (cm/s): it is rotated to ENU here and nowhere else."""
    _, lat, lon, alt, _, vx, vy, vz, _ = fields
    lat_deg, lon_deg = _lat_lon(lat, lon)
    return lat_deg, lon_deg, alt / 1000, (vy / 100, vx / 100, -vz / 100)


def decode_position(v: Values, decoder: Decoder) -> TelemetryGroup | None:
    fields = v["GLOBAL_POSITION_INT"]
    lat_deg, lon_deg, alt_amsl_m, vel_enu_mps = global_position(fields)
    boot_ms, rel, hdg = fields[0], fields[4], fields[8]
    return {
        "lat_deg": lat_deg,
        "lon_deg": lon_deg,
        "alt_amsl_m": alt_amsl_m,
        "alt_rel_m": rel / 1000,
        "heading_deg": _scaled(hdg, 65535, 0.01, 2),
        "vel_enu_mps": list(vel_enu_mps),
        "time_boot_s": boot_ms / 1000,
    }


def decode_local(v: Values, decoder: Decoder) -> TelemetryGroup | None:
    boot_ms, x, y, z, vx, vy, vz = v["LOCAL_POSITION_NED"]
    return {
        "pos_enu_m": _numbers((y, x, -z), digits=3),
        "vel_enu_mps": _numbers((vy, vx, -vz), digits=3),
        "time_boot_s": boot_ms / 1000,
    }


def finite_angles(fields: tuple[Any, ...]) -> bool:
    """True if roll, pitch and yaw of an ATTITUDE are finite."""
    return math.isfinite(fields[1] + fields[2] + fields[3])  # 32-bit floats: a sum of three stays in a double's range


def decode_attitude(v: Values, decoder: Decoder) -> TelemetryGroup | None:
    """Angles of the body (FRD) against NED, as every autopilot shows them: yaw is the compass heading."""
    if "ATTITUDE" in v:
        boot_ms, roll, pitch, yaw, *rates = v["ATTITUDE"]
        if not finite_angles(v["ATTITUDE"]):
            return None
        quaternion = quaternion_from_euler(roll, pitch, yaw)
    else:
        boot_ms, *parts = v["ATTITUDE_QUATERNION"][:5]
        rates = list(v["ATTITUDE_QUATERNION"][5:])
        if not all(abs(part) <= 2.0 for part in parts):  # also false for NaN
            return None
        quaternion = (parts[0], parts[1], parts[2], parts[3])
        roll, pitch, yaw = euler_from_quaternion(*quaternion)
    return {
        "roll_deg": round(math.degrees(roll), 2),
        "pitch_deg": round(math.degrees(pitch), 2),
        "yaw_deg": round(wrap_deg_180(math.degrees(yaw)), 2),
        "rates_dps": _numbers(rates, 180 / math.pi, 2),
        "quaternion": _numbers(quaternion, digits=5),
        "time_boot_s": boot_ms / 1000,
    }


def decode_battery(v: Values, decoder: Decoder) -> TelemetryGroup | None:
    """SYS_STATUS describes the main battery; values it lacks are taken from BATTERY_STATUS of battery 0."""
    volts = amps = percent = consumed = temperature = remaining_s = None
    if "SYS_STATUS" in v:
        millivolts, centiamps, left = v["SYS_STATUS"][4:7]
        monitored = millivolts or left >= 0 or centiamps >= 0  # an ArduPilot without a battery monitor sends 0 V
        volts = _scaled(millivolts, 65535, 0.001, 3) if monitored else None
        amps = _amps(centiamps)
        percent = None if left < 0 else left
    if "BATTERY_STATUS" in v and v["BATTERY_STATUS"][0] == 0:
        _, centidegrees, centiamps, mah, left, seconds, cells = v["BATTERY_STATUS"]
        known = [c for c in cells if c != 65535]
        if volts is None and known:
            volts = round(sum(known) / 1000, 3)
        amps = _amps(centiamps) if amps is None else amps
        percent = (None if left < 0 else left) if percent is None else percent
        consumed = None if mah < 0 else mah
        temperature = _scaled(centidegrees, 32767, 0.01, 2)
        remaining_s = seconds or None
    return {
        "volts": volts,
        "amps": amps,
        "percent": percent,
        "consumed_mah": consumed,
        "temperature_degc": temperature,
        "remaining_s": remaining_s,
    }


def decode_home(v: Values, decoder: Decoder) -> TelemetryGroup | None:
    lat_deg, lon_deg = _lat_lon(*v["HOME_POSITION"][:2])
    if lat_deg is None:
        return None
    return {"lat_deg": lat_deg, "lon_deg": lon_deg, "alt_amsl_m": v["HOME_POSITION"][2] / 1000}


def decode_ekf_origin(v: Values, decoder: Decoder) -> TelemetryGroup | None:
    lat_deg, lon_deg = _lat_lon(*v["GPS_GLOBAL_ORIGIN"][:2])
    if lat_deg is None:
        return None
    return {"lat_deg": lat_deg, "lon_deg": lon_deg, "alt_amsl_m": v["GPS_GLOBAL_ORIGIN"][2] / 1000}


ESTIMATE_NEEDED = 1 | 2 | 4 | 16 | 32
"""Attitude, both velocities, absolute horizontal and vertical position: the same bits in both messages."""

EKF_BAD = 128 | 1024 | 32768
"""EKF_STATUS_REPORT: constant position mode, uninitialised, GPS glitch."""

ESTIMATOR_BAD = 1024 | 2048
"""ESTIMATOR_STATUS: GPS glitch, accelerometer error. Not the constant position mode (128): PX4, its only sender, sets
it whenever the vehicle is at rest (EKF2, ekf_helper.cpp, 1.16); without any aiding it lacks the absolute position."""

EKF_VARIANCE_LIMIT = 0.8
"""ArduPilot's default of FS_EKF_THRESH."""


def decode_estimator(v: Values, decoder: Decoder) -> TelemetryGroup | None:
    """``ok``: good enough to navigate by; ``ratios``: innovations relative to their gates (1 = rejected)."""
    accuracy: list[float | None] = [None, None]
    if "EKF_STATUS_REPORT" in v:
        flags, *ratios = v["EKF_STATUS_REPORT"]
        names = decoder.bit_names("EKF_STATUS_FLAGS", flags, "EKF_")
        bad, limit = EKF_BAD, EKF_VARIANCE_LIMIT
    else:
        flags, *ratios, horizontal, vertical = v["ESTIMATOR_STATUS"]
        names = decoder.bit_names("ESTIMATOR_STATUS_FLAGS", flags, "ESTIMATOR_")
        bad, limit = ESTIMATOR_BAD, 1.0
        accuracy = [_number(horizontal, 2), _number(vertical, 2)]
    sane = all(r < limit for r in ratios if math.isfinite(r))
    return {
        "flags": flags,
        "ok": flags & ESTIMATE_NEEDED == ESTIMATE_NEEDED and not flags & bad and sane,
        "names": names,
        "ratios": dict(zip(("vel", "pos_horiz", "pos_vert", "mag"), _numbers(tuple(ratios), digits=3), strict=True)),
        "accuracy_m": accuracy,
    }


def decode_sensors(v: Values, decoder: Decoder) -> TelemetryGroup | None:
    present, enabled, health, load, *_ = v["SYS_STATUS"]
    enum, prefix = "MAV_SYS_STATUS_SENSOR", "MAV_SYS_STATUS_"
    return {
        "present": [_sensor(n) for n in decoder.bit_names(enum, present, prefix)],
        "enabled": [_sensor(n) for n in decoder.bit_names(enum, enabled, prefix)],
        "health": [_sensor(n) for n in decoder.bit_names(enum, health, prefix)],
        "unhealthy": [_sensor(n) for n in decoder.bit_names(enum, enabled & present & ~health, prefix)],
        "load_percent": round(load / 10, 1),
    }


def _sensor(name: str) -> str:
    return name.removeprefix("sensor_")


def decode_vfr(v: Values, decoder: Decoder) -> TelemetryGroup | None:
    airspeed, groundspeed, heading, throttle, alt, climb = v["VFR_HUD"]
    return {
        "airspeed_mps": _number(airspeed, 2),
        "groundspeed_mps": _number(groundspeed, 2),
        "heading_deg": heading,
        "throttle_percent": throttle,
        "alt_m": _number(alt, 2),
        "climb_mps": _number(climb, 2),
    }


def decode_rc(v: Values, decoder: Decoder) -> TelemetryGroup | None:
    if "RC_CHANNELS" in v:
        _, count, rssi, *channels = v["RC_CHANNELS"]
        channels = channels[: min(count, len(channels))]
    else:
        _, rssi, *channels = v["RC_CHANNELS_RAW"]
    return {
        "channels": [None if c in (0, 65535) else c for c in channels],
        "rssi": None if rssi == 255 else rssi,
    }


def decode_imu(v: Values, decoder: Decoder) -> TelemetryGroup | None:
    """Body axes (FRD). ArduPilot, the only sender of RAW_IMU here, uses the units of SCALED_IMU in it."""
    pressure = temperature = None
    if "HIGHRES_IMU" in v:
        *axes, pressure_hpa, temperature_degc = v["HIGHRES_IMU"]
        scales = (1.0, 1.0, 1.0)
        pressure, temperature = _number(pressure_hpa, 2), _number(temperature_degc, 2)
    else:
        axes = list(v["SCALED_IMU"] if "SCALED_IMU" in v else v["RAW_IMU"])
        scales = (GRAVITY_MPS2 / 1000, 1e-3, 1e-3)
    accel, gyro, mag = (_numbers(tuple(axes[3 * n : 3 * n + 3]), scales[n]) for n in range(3))
    return {
        "accel_mps2": accel,
        "gyro_radps": gyro,
        "mag_gauss": mag,
        "pressure_hpa": pressure,
        "temperature_degc": temperature,
    }


def decode_servos(v: Values, decoder: Decoder) -> TelemetryGroup | None:
    return {"pwm_us": list(v["SERVO_OUTPUT_RAW"])}


def decode_mission(v: Values, decoder: Decoder) -> TelemetryGroup | None:
    """``count``: number of items; ``last_ack``: the last MAV_MISSION_RESULT of a transfer."""
    seq, total = v.get("MISSION_CURRENT", (None, 0))
    (count,) = v.get("MISSION_COUNT", (None,))
    if total:  # 0: not reported; 65535: no mission
        count = 0 if total == 65535 else total
    last_ack = None
    if "MISSION_ACK" in v:
        (result,) = v["MISSION_ACK"]
        name = decoder.dialect.enums.get("MAV_MISSION_RESULT", {}).get(result, str(result))
        last_ack = name.removeprefix("MAV_MISSION_").lower()
    return {"seq": seq, "count": count, "last_ack": last_ack}


def _target_common(frame: int, mask: int, vx: float, vy: float, vz: float, yaw: float) -> TelemetryGroup:
    return {
        "frame": frame,
        "type_mask": mask,
        "vel_enu_mps": None if mask & 0x38 else _numbers((vy, vx, -vz), digits=2),
        "yaw_deg": None if mask & 0x400 else _number(math.degrees(yaw), 1),
    }


def decode_target_global(v: Values, decoder: Decoder) -> TelemetryGroup | None:
    frame, mask, lat, lon, alt, vx, vy, vz, yaw = v["POSITION_TARGET_GLOBAL_INT"]
    lat_deg, lon_deg = (None, None) if mask & 0x3 else _lat_lon(lat, lon)
    return {
        "lat_deg": lat_deg,
        "lon_deg": lon_deg,
        "alt_m": None if mask & 0x4 else _number(alt, 2),
        **_target_common(frame, mask, vx, vy, vz, yaw),
    }


def decode_target_local(v: Values, decoder: Decoder) -> TelemetryGroup | None:
    frame, mask, x, y, z, vx, vy, vz, yaw = v["POSITION_TARGET_LOCAL_NED"]
    return {
        "pos_enu_m": None if mask & 0x7 else _numbers((y, x, -z), digits=2),
        **_target_common(frame, mask, vx, vy, vz, yaw),
    }


def decode_target_attitude(v: Values, decoder: Decoder) -> TelemetryGroup | None:
    quaternion, mask, thrust = v["ATTITUDE_TARGET"]
    return {
        "quaternion": None if mask & 0x80 else _numbers(tuple(quaternion)),
        "thrust": _number(thrust),
        "type_mask": mask,
    }


def decode_time(v: Values, decoder: Decoder) -> TelemetryGroup | None:
    unix_us, boot_ms = v["SYSTEM_TIME"]
    return {"unix_s": unix_us / 1e6 if unix_us else None, "boot_s": boot_ms / 1000}


def decode_high_latency(v: Values, decoder: Decoder) -> TelemetryGroup | None:
    _, _, _, flags, lat, lon, alt, heading, groundspeed, throttle, battery, wp_num = v["HIGH_LATENCY2"]
    lat_deg, lon_deg = _lat_lon(lat, lon)
    return {
        "failures": decoder.bit_names("HL_FAILURE_FLAG", flags, "HL_FAILURE_FLAG_"),
        "lat_deg": lat_deg,
        "lon_deg": lon_deg,
        "alt_amsl_m": alt,
        "heading_deg": heading * 2,
        "groundspeed_mps": groundspeed / 5,
        "throttle_percent": throttle,
        "battery_percent": None if battery < 0 else battery,
        "mission_seq": wp_num,
    }


GROUPS: tuple[TelemetryGroupSpec, ...] = (
    TelemetryGroupSpec("gps", ("GPS_RAW_INT",), decode_gps),
    TelemetryGroupSpec("position", ("GLOBAL_POSITION_INT",), decode_position),
    TelemetryGroupSpec("local", ("LOCAL_POSITION_NED",), decode_local),
    TelemetryGroupSpec("attitude", ("ATTITUDE", "ATTITUDE_QUATERNION"), decode_attitude),
    TelemetryGroupSpec("battery", ("SYS_STATUS", "BATTERY_STATUS"), decode_battery, combine=True),
    TelemetryGroupSpec("home", ("HOME_POSITION",), decode_home),
    TelemetryGroupSpec("ekf_origin", ("GPS_GLOBAL_ORIGIN",), decode_ekf_origin),
    TelemetryGroupSpec("estimator", ("EKF_STATUS_REPORT", "ESTIMATOR_STATUS"), decode_estimator),
    TelemetryGroupSpec("sensors", ("SYS_STATUS",), decode_sensors),
    TelemetryGroupSpec("vfr", ("VFR_HUD",), decode_vfr),
    TelemetryGroupSpec("rc", ("RC_CHANNELS", "RC_CHANNELS_RAW"), decode_rc),
    TelemetryGroupSpec("imu", ("HIGHRES_IMU", "SCALED_IMU", "RAW_IMU"), decode_imu),
    TelemetryGroupSpec("servos", ("SERVO_OUTPUT_RAW",), decode_servos),
    TelemetryGroupSpec("mission", ("MISSION_CURRENT", "MISSION_COUNT", "MISSION_ACK"), decode_mission, combine=True),
    TelemetryGroupSpec("target_global", ("POSITION_TARGET_GLOBAL_INT",), decode_target_global),
    TelemetryGroupSpec("target_local", ("POSITION_TARGET_LOCAL_NED",), decode_target_local),
    TelemetryGroupSpec("target_attitude", ("ATTITUDE_TARGET",), decode_target_attitude),
    TelemetryGroupSpec("time", ("SYSTEM_TIME",), decode_time),
    TelemetryGroupSpec("high_latency", ("HIGH_LATENCY2",), decode_high_latency),
)
