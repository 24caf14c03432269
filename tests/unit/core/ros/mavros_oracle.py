"""What MAVROS publishes of a MAVLink message: its plugins' conversions, written a second time with numpy's matrices.

The formulas are those of MAVROS 2.12.0's source: the plugin and the function of each stand beside it ("sys_status" is
mavros/src/plugins/sys_status.cpp, or a file of mavros_extras). The frames are those of lib/ftf_frame_conversions.cpp
and lib/ftf_quaternion_utils.cpp.

Messages are those that pymavlink decoded; nothing of skygcs is used. Every field that MAVROS sets is here; what is not
is zero. Known differences (`docs/reference/from-mavros.md`): stamps; the geoid, which is the receiver's in place of
EGM96; and a global_position/local before its origin is known, which is 0.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pymap3d
import pytest
from pymavlink import mavutil

ENU = np.array([[0, 1, 0], [1, 0, 0], [0, 0, -1]])
FLU = np.diag([1, -1, -1])
"""NED to ENU, and FRD to FLU: the rotations of REP 103 as matrices (ftf_frame_conversions: transform_static_frame)."""

G = 9.80665
NAN = math.nan
ANGULAR, LINEAR = math.radians(0.02) ** 2, 0.0003**2

_AUTO = ("READY", "TAKEOFF", "LOITER", "MISSION", "RTL", "LAND", "RTGS", "FOLLOW_TARGET", "PRECLAND")

PX4_MODES = {
    **{1 << 16: "MANUAL", 2 << 16: "ALTCTL", 3 << 16: "POSCTL", 5 << 16: "ACRO", 6 << 16: "OFFBOARD"},
    **{7 << 16: "STABILIZED", 8 << 16: "RATTITUDE"},
    **{4 << 16 | sub << 24: f"AUTO.{name}" for sub, name in enumerate(_AUTO, 1)},
}
"""lib/uas_stringify.cpp, `px4_cmode_map`; numbers of px4_custom_mode.hpp."""

TECHNOLOGIES = {0: 0, 1: 3, 2: 4, 3: 2, 4: 1}
"""MAV_BATTERY_TYPE to sensor_msgs' BatteryState."""

FLAGS = (
    *("attitude", "velocity_horiz", "velocity_vert", "pos_horiz_rel", "pos_horiz_abs", "pos_vert_abs", "pos_vert_agl"),
    *("const_pos_mode", "pred_pos_horiz_rel", "pred_pos_horiz_abs", "gps_glitch", "accel_error"),
)


def turned(matrix: Any) -> Any:
    """A rotation as a value that is compared as one: a quaternion and its negative are the same."""
    return ("rotation", matrix)


def of_quaternion(w: float, x: float, y: float, z: float) -> Any:
    v = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.eye(3) + 2 * w * v + 2 * v @ v


def of_angles(roll: float, pitch: float, yaw: float) -> Any:
    (cr, cp, cy), (sr, sp, sy) = np.cos([roll, pitch, yaw]), np.sin([roll, pitch, yaw])
    x = np.array([[1, 0, 0], [0, cr, -sr], [0, sr, cr]])
    y = np.array([[cp, 0, sp], [0, 1, 0], [-sp, 0, cp]])
    z = np.array([[cy, -sy, 0], [sy, cy, 0], [0, 0, 1]])
    return z @ y @ x


def xyz(vector: Any) -> dict[str, float]:
    return dict(zip("xyz", map(float, vector), strict=True))


def diagonal(*values: float) -> list[float]:
    return list(map(float, np.diag(values).ravel()))


def upper(row: int, column: int, size: int = 9) -> int:
    """Where an element of a symmetric matrix is, of which the upper right triangle is written row by row."""
    return [(r, c) for r in range(size) for c in range(r, size)].index((row, column))


def like(found: Any, wanted: Any, where: str) -> None:
    """Assert that a message is the wanted one, which may lack what is zero."""
    if isinstance(wanted, tuple) and wanted[0] == "rotation":
        assert of_quaternion(*(found[name] for name in "wxyz")) == pytest.approx(wanted[1], abs=1e-5, nan_ok=True), (
            where
        )
    elif isinstance(wanted, tuple):
        assert abs(math.remainder(found - wanted[1], 2 * math.pi)) < 1e-5 or math.isnan(found) == math.isnan(
            wanted[1]
        ), where
    elif isinstance(found, dict):
        assert wanted.keys() <= found.keys(), where
        for name, value in found.items():
            like(value, wanted.get(name, blank(value)), f"{where}.{name}")
    elif isinstance(found, list):
        assert np.shape(found) == np.shape(wanted), where
        assert np.asarray(found, float) == pytest.approx(np.asarray(wanted, float), rel=1e-6, abs=1e-6, nan_ok=True), (
            where
        )
    elif isinstance(found, float):
        assert found == pytest.approx(wanted, rel=1e-6, abs=1e-5, nan_ok=True), where
    else:
        assert found == wanted, where


def blank(value: Any) -> Any:
    if isinstance(value, list):
        return [0.0] * len(value)
    return {} if isinstance(value, dict) else type(value)()


class Mavros:
    """One vehicle's MAVROS. A message: the values of its fields; "@" is its frame, "t" the message's own time in
    microseconds since boot, or None for the time of arrival."""

    def __init__(self) -> None:
        self.autopilot = 0
        self.body = np.eye(3)
        self.rates = np.zeros(3)
        self.accel: Any = np.zeros(3)
        self.seen: set[str] = set()
        self.has_accel = False
        self.battery0 = False
        self.geoid_m = 0.0
        self.fix: dict[str, Any] = {  # lib/uas_data.cpp, `Data::Data`
            "status": {"status": -1, "service": 1},
            "position_covariance": [-1.0, *[0.0] * 8],
            "position_covariance_type": 0,
        }
        self.home: tuple[float, float, float] | None = None
        self.rc_in: list[int] = []
        self.rc_out: list[int] = []

    def of(self, m: Any) -> dict[str, dict[str, Any]]:
        """Messages by topic."""
        name = m.get_type()
        self.seen.add(name)
        handle: Callable[[Any], dict[str, dict[str, Any]]] = getattr(self, name.lower())
        return handle(m)

    # -- sys_status, rc_io, 3dr_radio, sys_time, waypoint, vfr_hud

    def mode(self, m: Any) -> str:
        """lib/uas_stringify.cpp: `str_mode_v10`, `str_mode_px4`. ArduPilot's names: those of a copter."""
        if not m.base_mode & 1:
            return f"MODE(0x{m.base_mode:2X})"
        number = m.custom_mode
        if m.autopilot == 12:
            main, sub = number >> 16 & 255, number >> 24
            number = main << 16 | (sub << 24 if main == 4 else 0)
        modes = {3: mavutil.mode_mapping_acm, 12: PX4_MODES}.get(m.autopilot, {})
        return str(modes.get(number, f"CMODE({number})"))

    def heartbeat(self, m: Any) -> dict[str, Any]:  # sys_status: handle_heartbeat
        self.autopilot = m.autopilot
        mode = self.mode(m)
        flags = {"armed": m.base_mode & 128, "guided": m.base_mode & 8, "manual_input": m.base_mode & 64}
        state = {"connected": True, "mode": mode, "system_status": m.system_status}
        return {"state": state | {name: bool(flag) for name, flag in flags.items()}}

    def extended_sys_state(self, m: Any) -> dict[str, Any]:  # sys_status: handle_extended_sys_state
        return {"extended_state": {"vtol_state": m.vtol_state, "landed_state": m.landed_state}}

    def sys_status(self, m: Any) -> dict[str, Any]:  # sys_status: handle_sys_status
        own = {
            f"sensors_{part}": getattr(m, f"onboard_control_sensors_{part}")
            for part in ("present", "enabled", "health")
        }
        plain = ("load", "voltage_battery", "current_battery", "battery_remaining", "drop_rate_comm", "errors_comm")
        counts = tuple(f"errors_count{n}" for n in (1, 2, 3, 4))
        made = {"sys_status": own | {name: getattr(m, name) for name in plain + counts}}
        if not self.battery0:
            made["battery"] = self.battery(m.voltage_battery / 1000, m)
        return made

    def battery_status(self, m: Any) -> dict[str, Any]:  # sys_status: handle_battery_status
        self.battery0 |= m.id == 0
        cells: list[float] = []
        above = 0.0  # goes on from the first array into the second
        for values, ends in ((m.voltages, {65535}), (m.voltages_ext, {0, 65535})):
            for value in values:
                if value in ends:
                    break
                if value == 65534:
                    above += 65.534
                else:
                    cells.append(above + value / 1000)
                    above = 0.0
        more = {"power_supply_technology": TECHNOLOGIES[m.type], "cell_voltage": cells, "location": f"id{m.id}"}
        return {"battery": self.battery(sum(cells), m) | more}

    def battery(self, volts: float, m: Any) -> dict[str, Any]:
        known = {"voltage": volts, "current": -m.current_battery / 100, "percentage": m.battery_remaining / 100}
        return (
            known
            | dict.fromkeys(("charge", "capacity", "design_capacity"), NAN)
            | {"power_supply_status": 2, "present": True}
        )

    def estimator_status(self, m: Any) -> dict[str, Any]:  # sys_status: handle_estimator_status
        return {"estimator_status": {f"{flag}_status_flag": bool(m.flags & 1 << n) for n, flag in enumerate(FLAGS)}}

    def statustext(self, m: Any) -> dict[str, Any]:  # sys_status: handle_statustext
        return {"statustext/recv": {"severity": m.severity, "text": m.text}}

    def event(self, m: Any) -> dict[str, Any]:  # sys_status: handle_event
        plain = {"arguments": list(m.arguments), "sequence": m.sequence, "t": 1000 * m.event_time_boot_ms}
        return {"status_event": {"severity": m.log_levels % 16, "px4_id": m.id % 2**24, **plain}}

    def rc_channels(self, m: Any) -> dict[str, Any]:  # rc_io: handle_rc_channels
        self.rc_in = [getattr(m, f"chan{n}_raw") for n in range(1, m.chancount + 1)]
        return {"rc/in": {"rssi": m.rssi, "channels": list(self.rc_in), "t": 1000 * m.time_boot_ms}}

    def rc_channels_raw(self, m: Any) -> dict[str, Any]:  # rc_io: handle_rc_channels_raw
        if "RC_CHANNELS" in self.seen:
            return {}
        self.rc_in += [0] * (8 * m.port + 8 - len(self.rc_in))
        self.rc_in[8 * m.port : 8 * m.port + 8] = [getattr(m, f"chan{n}_raw") for n in range(1, 9)]
        return {"rc/in": {"rssi": m.rssi, "channels": list(self.rc_in), "t": 1000 * m.time_boot_ms}}

    def servo_output_raw(self, m: Any) -> dict[str, Any]:  # rc_io: handle_servo_output_raw, of MAVLink 2
        self.rc_out += [0] * (16 * m.port + 16 - len(self.rc_out))
        self.rc_out[16 * m.port : 16 * m.port + 16] = [getattr(m, f"servo{n}_raw") for n in range(1, 17)]
        return {"rc/out": {"channels": list(self.rc_out), "t": m.time_usec}}

    def radio_status(self, m: Any) -> dict[str, Any]:  # 3dr_radio: handle_message
        plain = ("rssi", "remrssi", "txbuf", "noise", "remnoise", "rxerrors", "fixed")
        dbm = {f"{name}_dbm": getattr(m, name) / 1.9 - 127 for name in ("rssi", "remrssi")}
        return {"radio_status": dbm | {name: getattr(m, name) for name in plain}}

    def system_time(self, m: Any) -> dict[str, Any]:  # sys_time: handle_system_time
        s, us = divmod(m.time_unix_usec, 10**6)
        if m.time_unix_usec <= 1234567890 * 10**6:
            return {}
        return {"time_reference": {"time_ref": {"sec": s, "nanosec": 1000 * us}, "source": "fcu"}}

    def mission_item_reached(self, m: Any) -> dict[str, Any]:  # waypoint: publish_reached
        return {"mission/reached": {"wp_seq": m.seq}}

    def vfr_hud(self, m: Any) -> dict[str, Any]:  # vfr_hud: handle_vfr_hud
        plain = {name: getattr(m, name) for name in ("airspeed", "groundspeed", "heading", "climb")}
        return {"vfr_hud": plain | {"throttle": m.throttle / 100, "altitude": m.alt}}

    # -- imu

    def attitude(self, m: Any) -> dict[str, Any]:  # imu: handle_attitude
        if "ATTITUDE_QUATERNION" in self.seen:
            return {}
        return self.imu(m, of_angles(m.roll, m.pitch, m.yaw))

    def attitude_quaternion(self, m: Any) -> dict[str, Any]:  # imu: handle_attitude_quaternion
        return self.imu(m, of_quaternion(m.q1, m.q2, m.q3, m.q4))

    def imu(self, m: Any, ned: Any) -> dict[str, Any]:  # imu: publish_imu_data
        self.body = ENU @ ned @ FLU
        self.rates = FLU @ [m.rollspeed, m.pitchspeed, m.yawspeed]
        linear = diagonal(LINEAR, LINEAR, LINEAR)
        data = {
            "orientation": turned(self.body),
            "orientation_covariance": diagonal(1, 1, 1),
            "angular_velocity": xyz(self.rates),
            "angular_velocity_covariance": diagonal(*[ANGULAR] * 3),
            "linear_acceleration": xyz(self.accel),
            "linear_acceleration_covariance": linear if self.has_accel else [-1.0, *linear[1:]],
        }
        return {"imu/data": data | {"@": "base_link", "t": 1000 * m.time_boot_ms}}

    def highres_imu(self, m: Any) -> dict[str, Any]:  # imu: handle_highres_imu
        kept = self.accel, self.has_accel
        made = self.raw(m, m.time_usec, 1.0, 1.0, 1e-4)
        if not m.fields_updated & 0x3F:  # then publish_imu_data_raw, which keeps the acceleration, is not called
            self.accel, self.has_accel = kept
        plain = {"imu/static_pressure": m.abs_pressure, "imu/diff_pressure": m.diff_pressure}
        made |= {topic: {"fluid_pressure": value} for topic, value in plain.items()}
        made["imu/temperature_imu"] = {"temperature": m.temperature}
        bits = {"imu/data_raw": 0x3F, "imu/mag": 0x1C0, "imu/static_pressure": 0x200, "imu/diff_pressure": 0x400}
        bits["imu/temperature_imu"] = 0x1000
        where = {"@": "base_link", "t": m.time_usec}
        return {topic: message | where for topic, message in made.items() if m.fields_updated & bits[topic]}

    def raw_imu(self, m: Any) -> dict[str, Any]:  # imu: handle_raw_imu
        if self.seen & {"HIGHRES_IMU", "SCALED_IMU"}:
            return {}
        made = self.raw(m, m.time_usec, 1e-3, {3: G / 1000, 12: 1e-3}.get(self.autopilot, 1.0), 1000.0)
        if self.autopilot != 3:  # "APM only": of others it is not for imu/data
            self.accel = np.zeros(3)
        return made

    def scaled_imu(self, m: Any) -> dict[str, Any]:  # imu: handle_scaled_imu
        return {} if "HIGHRES_IMU" in self.seen else self.raw(m, 1000 * m.time_boot_ms, 1e-3, G / 1000, 1000.0)

    def raw(self, m: Any, t: int, gyro: float, accel: float, mag: float) -> dict[str, Any]:
        """imu: publish_imu_data_raw, publish_mag."""
        self.accel, self.has_accel = FLU @ np.array([m.xacc, m.yacc, m.zacc]) * accel, True
        unknown = [-1.0, *[0.0] * 8]
        data = {
            "orientation_covariance": unknown,
            "angular_velocity": xyz(FLU @ np.array([m.xgyro, m.ygyro, m.zgyro]) * gyro),
            "angular_velocity_covariance": diagonal(*[ANGULAR] * 3),
            "linear_acceleration": xyz(self.accel),
            "linear_acceleration_covariance": diagonal(*[LINEAR] * 3),
        }
        field = {"magnetic_field": xyz(FLU @ np.array([m.xmag, m.ymag, m.zmag]) * mag)}
        where = {"@": "base_link", "t": t}
        return {"imu/data_raw": data | where, "imu/mag": field | {"magnetic_field_covariance": unknown} | where}

    def scaled_pressure(self, m: Any) -> dict[str, Any]:  # imu: handle_scaled_pressure
        if "HIGHRES_IMU" in self.seen:
            return {}
        where = {"@": "base_link", "t": 1000 * m.time_boot_ms}
        return {
            "imu/temperature_baro": {"temperature": m.temperature / 100} | where,
            "imu/static_pressure": {"fluid_pressure": 100 * m.press_abs} | where,
            "imu/diff_pressure": {"fluid_pressure": 100 * m.press_diff} | where,
        }

    # -- local_position

    def local_position_ned(self, m: Any) -> dict[str, Any]:  # local_position: handle_local_position_ned
        velocity = ENU @ [m.vx, m.vy, m.vz]
        where = {"t": 1000 * m.time_boot_ms}
        pose, twist = self.local(m)
        local = {"linear": xyz(velocity), "angular": xyz(self.body @ self.rates)}
        made = {
            "local_position/pose": {"pose": pose, "@": "map"},
            "local_position/velocity_body": {"twist": twist, "@": "base_link"},
            "local_position/velocity_local": {"twist": local, "@": "base_link"},
        }
        if "LOCAL_POSITION_NED_COV" not in self.seen:
            made["local_position/odom"] = self.odom({"pose": pose}, {"twist": twist})
        return {topic: message | where for topic, message in made.items()}

    def local_position_ned_cov(self, m: Any) -> dict[str, Any]:  # local_position: handle_local_position_ned_cov
        pose, twist = self.local(m)
        at = [m.covariance[upper(n, n)] for n in range(9)]
        blocks = [self.block(*at[n : n + 3]) for n in (0, 3, 6)]
        full_pose, full_twist = {"pose": pose, "covariance": blocks[0]}, {"twist": twist, "covariance": blocks[1]}
        accel = {"accel": {"linear": xyz(ENU @ [m.ax, m.ay, m.az])}, "covariance": blocks[2]}
        made = {
            "local_position/odom": self.odom(full_pose, full_twist),
            "local_position/pose_cov": {"pose": full_pose, "@": "map"},
            "local_position/velocity_body_cov": {"twist": full_twist, "@": "base_link"},
            "local_position/accel": {"accel": accel, "@": "map"},
        }
        if "LOCAL_POSITION_NED" not in self.seen:
            made["local_position/pose"] = {"pose": pose, "@": "map"}
            made["local_position/velocity_body"] = {"twist": twist, "@": "base_link"}
        return {topic: message | {"t": m.time_usec} for topic, message in made.items()}

    def local(self, m: Any) -> tuple[dict[str, Any], dict[str, Any]]:
        pose = {"position": xyz(ENU @ [m.x, m.y, m.z]), "orientation": turned(self.body)}
        return pose, {"linear": xyz(self.body.T @ ENU @ [m.vx, m.vy, m.vz]), "angular": xyz(self.rates)}

    def odom(self, pose: dict[str, Any], twist: dict[str, Any]) -> dict[str, Any]:
        return {"child_frame_id": "base_link", "pose": pose, "twist": twist, "@": "map"}

    def block(self, *values: float) -> list[float]:
        """The first three of the diagonal of a covariance of 6 by 6."""
        return diagonal(*values, 0, 0, 0)

    # -- global_position, home_position, altitude

    def gps_raw_int(self, m: Any) -> dict[str, Any]:  # global_position: handle_gps_raw_int
        has_fix = m.fix_type > 2
        if has_fix and m.alt_ellipsoid:
            self.geoid_m = (m.alt_ellipsoid - m.alt) / 1000
        covariance, kind = [-1.0, *[0.0] * 8], 0
        if m.h_acc > 0 and m.v_acc > 0:
            covariance, kind = diagonal(*np.square([m.h_acc, m.h_acc, m.v_acc]) / 1e6), 2
        elif 65535 not in (m.eph, m.epv):
            covariance, kind = diagonal(*np.square([m.eph, m.eph, m.epv]) / 1e4), 1
        self.fix = {
            "status": {"status": 0 if has_fix else -1, "service": 1},
            "position_covariance": covariance,
            "position_covariance_type": kind,
        }
        made: dict[str, Any] = {"global_position/raw/fix": self.place(m) | {"@": "base_link", "t": m.time_usec}}
        if 65535 not in (m.vel, m.cog):
            course = math.radians(m.cog / 100)
            linear = xyz([m.vel / 100 * math.sin(course), m.vel / 100 * math.cos(course), 0])
            made["global_position/raw/gps_vel"] = {"twist": {"linear": linear}, "@": "map", "t": m.time_usec}
        return made | {"global_position/raw/satellites": {"data": m.satellites_visible}}

    def place(self, m: Any) -> dict[str, Any]:  # global_position: fill_lla
        place = {"latitude": m.lat / 1e7, "longitude": m.lon / 1e7, "altitude": m.alt / 1000 + self.geoid_m}
        return self.fix | place

    def global_position_int(self, m: Any) -> dict[str, Any]:  # global_position: handle_global_position_int
        place = self.place(m)
        where = place["latitude"], place["longitude"], place["altitude"]
        if self.home is None and self.fix["status"]["status"] >= 0:
            self.home = where
        east, north = (0.0, 0.0) if self.home is None else pymap3d.geodetic2enu(*where, *self.home)[:2]
        covariance = np.diag([0.0] * 3 + [99999.0] * 3)
        covariance[:3, :3] = np.reshape(self.fix["position_covariance"], (3, 3))
        pose = {"position": xyz([east, north, m.relative_alt / 1000]), "orientation": turned(self.body)}
        odom = self.odom(
            {"pose": pose, "covariance": list(map(float, covariance.ravel()))},
            {"twist": {"linear": xyz(np.array([m.vy, m.vx, m.vz]) / 100)}, "covariance": [-1.0, *[0.0] * 35]},
        )
        return {
            "global_position/global": place | {"@": "base_link", "t": 1000 * m.time_boot_ms},
            "global_position/local": odom | {"t": 1000 * m.time_boot_ms},
            "global_position/rel_alt": {"data": m.relative_alt / 1000},
            "global_position/compass_hdg": {"data": NAN if m.hdg == 65535 else m.hdg / 100},
        }

    def gps_global_origin(self, m: Any) -> dict[str, Any]:  # global_position: handle_gps_global_origin
        position = {"latitude": m.latitude / 1e7, "longitude": m.longitude / 1e7}
        position["altitude"] = m.altitude / 1000 + self.geoid_m
        return {"global_position/gp_origin": {"position": position, "@": "earth", "t": m.time_usec or None}}

    def home_position(self, m: Any) -> dict[str, Any]:  # home_position: handle_home_position
        geo = {
            "latitude": m.latitude / 1e7,
            "longitude": m.longitude / 1e7,
            "altitude": m.altitude / 1000 + self.geoid_m,
        }
        self.home = geo["latitude"], geo["longitude"], geo["altitude"]
        home = {
            "geo": geo,
            "position": xyz(ENU @ [m.x, m.y, m.z]),
            "orientation": turned(ENU @ of_quaternion(*m.q)),
            "approach": xyz(ENU @ [m.approach_x, m.approach_y, m.approach_z]),
        }
        return {"home_position/home": home | {"t": m.time_usec or None}}

    def altitude(self, m: Any) -> dict[str, Any]:  # altitude: handle_altitude
        names = ("monotonic", "amsl", "local", "relative", "terrain")
        heights = {name: getattr(m, f"altitude_{name}") for name in names} | {"bottom_clearance": m.bottom_clearance}
        return {"altitude": heights | {"@": "map", "t": m.time_usec}}

    # -- setpoint_raw

    def position_target_local_ned(self, m: Any) -> dict[str, Any]:  # setpoint_raw: handle_position_target_local_ned
        return {"setpoint_raw/target_local": self.target(m) | {"position": xyz(ENU @ [m.x, m.y, m.z])}}

    def position_target_global_int(self, m: Any) -> dict[str, Any]:  # setpoint_raw: handle_position_target_global_int
        place = {"latitude": m.lat_int / 1e7, "longitude": m.lon_int / 1e7, "altitude": m.alt}
        return {"setpoint_raw/target_global": self.target(m) | place}

    def target(self, m: Any) -> dict[str, Any]:
        return {
            "coordinate_frame": m.coordinate_frame,
            "type_mask": m.type_mask,
            "velocity": xyz(ENU @ [m.vx, m.vy, m.vz]),
            "acceleration_or_force": xyz(ENU @ [m.afx, m.afy, m.afz]),
            "yaw": ("angle", math.pi / 2 - m.yaw),
            "yaw_rate": -m.yaw_rate,
            "t": 1000 * m.time_boot_ms,
        }

    def attitude_target(self, m: Any) -> dict[str, Any]:  # setpoint_raw: handle_attitude_target
        target = {
            "type_mask": m.type_mask,
            "orientation": turned(ENU @ of_quaternion(*m.q) @ FLU),
            "body_rate": xyz(FLU @ [m.body_roll_rate, m.body_pitch_rate, m.body_yaw_rate]),
            "thrust": m.thrust,
        }
        return {"setpoint_raw/target_attitude": target | {"t": 1000 * m.time_boot_ms}}
