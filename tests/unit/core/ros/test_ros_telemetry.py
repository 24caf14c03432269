"""Converters against MAVROS' formulas, computed again here with numpy's matrices, on recorded flights."""

from __future__ import annotations

import math
from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np
import pymap3d
import pytest

from skygcs.config.dialects import load_dialect
from skygcs.core.ros.interfaces import ros2_interfaces
from skygcs.core.ros.memory import FrameNames, VehicleMemory
from skygcs.core.ros.topics import SOURCES, TELEMETRY, samples
from skygcs.tlog.files import opened_log

DATA = Path(__file__).parents[3] / "data"

ENU = np.array([[0, 1, 0], [1, 0, 0], [0, 0, -1]])
FLU = np.diag([1, -1, -1])
"""NED to ENU, and FRD to FLU: the rotations of REP 103 as matrices."""


def euler(roll: float, pitch: float, yaw: float) -> Any:
    """The matrix that turns the body's vectors into NED."""
    (cr, cp, cy), (sr, sp, sy) = np.cos([roll, pitch, yaw]), np.sin([roll, pitch, yaw])
    x = np.array([[1, 0, 0], [0, cr, -sr], [0, sr, cr]])
    y = np.array([[cp, 0, sp], [0, 1, 0], [-sp, 0, cp]])
    z = np.array([[cy, -sy, 0], [sy, cy, 0], [0, 0, 1]])
    return z @ y @ x


def matrix(q: Any) -> Any:
    """The matrix of geometry_msgs' Quaternion."""
    w, x, y, z = (q[name] for name in "wxyz")
    assert w * w + x * x + y * y + z * z == pytest.approx(1, abs=1e-6)
    v = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.eye(3) + 2 * w * v + 2 * v @ v


def vector(fields: Any) -> Any:
    return np.array([fields[name] for name in "xyz"])


class Oracle:
    """What MAVROS publishes of the messages of one vehicle (its sources: imu, local_position, global_position)."""

    def __init__(self) -> None:
        self.body = np.eye(3)
        self.rates = np.zeros(3)
        self.accel = np.zeros(3)
        self.home: tuple[float, float, float] | None = None
        self.checked: Counter[str] = Counter()

    def check(self, name: str, m: dict[str, Any], out: dict[str, Any]) -> None:
        self.checked.update(out.keys())
        getattr(self, name.lower(), lambda *_: None)(m, out)

    def attitude(self, m: dict[str, Any], out: dict[str, Any]) -> None:
        if "imu/data" in out:
            self.check_data(m, euler(m["roll"], m["pitch"], m["yaw"]), out["imu/data"])

    def attitude_quaternion(self, m: dict[str, Any], out: dict[str, Any]) -> None:
        q = {"w": m["q1"], "x": m["q2"], "y": m["q3"], "z": m["q4"]}
        self.check_data(m, matrix(q), out["imu/data"])

    def check_data(self, m: dict[str, Any], body_ned: Any, imu: Any) -> None:
        self.body = ENU @ body_ned @ FLU
        self.rates = FLU @ [m["rollspeed"], m["pitchspeed"], m["yawspeed"]]
        assert matrix(imu["orientation"]) == pytest.approx(self.body, abs=1e-6)
        assert vector(imu["angular_velocity"]) == pytest.approx(self.rates, abs=1e-7)
        assert vector(imu["linear_acceleration"]) == pytest.approx(self.accel, abs=1e-6)

    def highres_imu(self, m: dict[str, Any], out: dict[str, Any]) -> None:
        self.accel = FLU @ [m["xacc"], m["yacc"], m["zacc"]]
        raw = out["imu/data_raw"]
        assert vector(raw["linear_acceleration"]) == pytest.approx(self.accel)
        assert vector(raw["angular_velocity"]) == pytest.approx(FLU @ [m["xgyro"], m["ygyro"], m["zgyro"]])
        assert raw["orientation_covariance"][0] == -1
        tesla = FLU @ np.array([m["xmag"], m["ymag"], m["zmag"]]) / 1e4
        assert vector(out["imu/mag"]["magnetic_field"]) == pytest.approx(tesla)

    def raw_imu(self, m: dict[str, Any], out: dict[str, Any]) -> None:
        if "imu/data_raw" in out:  # an ArduPilot: milli-g and millirad/s
            self.accel = FLU @ np.array([m["xacc"], m["yacc"], m["zacc"]]) * 9.80665e-3
            assert vector(out["imu/data_raw"]["linear_acceleration"]) == pytest.approx(self.accel)

    def local_position_ned(self, m: dict[str, Any], out: dict[str, Any]) -> None:
        velocity = ENU @ [m["vx"], m["vy"], m["vz"]]
        pose, odom = out["local_position/pose"], out["local_position/odom"]
        assert vector(pose["pose"]["position"]) == pytest.approx(ENU @ [m["x"], m["y"], m["z"]])
        assert pose["pose"] == odom["pose"]["pose"] and odom["child_frame_id"] == "base_link"
        body = self.body.T @ velocity
        assert vector(odom["twist"]["twist"]["linear"]) == pytest.approx(body, abs=1e-5)
        local = out["local_position/velocity_local"]["twist"]
        assert vector(local["linear"]) == pytest.approx(velocity)
        assert vector(local["angular"]) == pytest.approx(self.body @ self.rates, abs=1e-6)

    def gps_raw_int(self, m: dict[str, Any], out: dict[str, Any]) -> None:
        fix = out["global_position/raw/fix"]
        assert fix["status"] == {"status": 0 if m["fix_type"] >= 3 else -1, "service": 1}
        assert (fix["latitude"], fix["longitude"]) == (m["lat"] / 1e7, m["lon"] / 1e7)
        ellipsoid_mm = m["alt_ellipsoid"] if m["alt_ellipsoid"] and m["fix_type"] >= 3 else m["alt"]
        assert fix["altitude"] == pytest.approx(ellipsoid_mm / 1e3)
        assert out["global_position/raw/satellites"] == {"data": m["satellites_visible"]}
        covariance = np.reshape(fix["position_covariance"], (3, 3))
        if m["h_acc"] and m["v_acc"]:
            assert covariance == pytest.approx(np.diag([m["h_acc"], m["h_acc"], m["v_acc"]]) ** 2 / 1e6)
        elif m["eph"] != 65535 and m["epv"] != 65535:
            assert covariance == pytest.approx(np.diag([m["eph"], m["eph"], m["epv"]]) ** 2 / 1e4)
        if "global_position/raw/gps_vel" in out:
            velocity = vector(out["global_position/raw/gps_vel"]["twist"]["linear"])
            assert np.linalg.norm(velocity) == pytest.approx(m["vel"] / 100)
            heading = math.degrees(math.atan2(velocity[0], velocity[1])) % 360
            assert m["vel"] == 0 or heading == pytest.approx(m["cog"] / 100 % 360, abs=1e-6)

    def home_position(self, m: dict[str, Any], out: dict[str, Any]) -> None:
        geo = out["home_position/home"]["geo"]
        self.home = geo["latitude"], geo["longitude"], geo["altitude"]
        assert self.home[:2] == (m["latitude"] / 1e7, m["longitude"] / 1e7)

    def global_position_int(self, m: dict[str, Any], out: dict[str, Any]) -> None:
        fix, odom = out["global_position/global"], out["global_position/local"]
        assert (fix["latitude"], fix["longitude"]) == (m["lat"] / 1e7, m["lon"] / 1e7)
        assert out["global_position/rel_alt"] == {"data": m["relative_alt"] / 1e3}
        heading = out["global_position/compass_hdg"]["data"]
        assert math.isnan(heading) if m["hdg"] == 65535 else heading == m["hdg"] / 100
        position = vector(odom["pose"]["pose"]["position"])
        assert position[2] == m["relative_alt"] / 1e3
        if self.home is not None:
            enu = pymap3d.geodetic2enu(fix["latitude"], fix["longitude"], fix["altitude"], *self.home)
            assert position[:2] == pytest.approx(enu[:2], abs=1e-3)
        assert vector(odom["twist"]["twist"]["linear"]) == pytest.approx(np.array([m["vy"], m["vx"], m["vz"]]) / 100)

    def sys_status(self, m: dict[str, Any], out: dict[str, Any]) -> None:
        assert out["sys_status"]["sensors_health"] == m["onboard_control_sensors_health"]
        if "battery" in out:
            assert out["battery"]["voltage"] == m["voltage_battery"] / 1000
            assert out["battery"]["current"] == -m["current_battery"] / 100
            assert out["battery"]["percentage"] == m["battery_remaining"] / 100

    def battery_status(self, m: dict[str, Any], out: dict[str, Any]) -> None:
        cells = [v / 1000 for v in m["voltages"] if v < 65534] + [v / 1000 for v in m["voltages_ext"] if 0 < v < 65534]
        assert out["battery"]["cell_voltage"] == pytest.approx(cells)
        assert out["battery"]["voltage"] == pytest.approx(sum(cells))

    def heartbeat(self, m: dict[str, Any], out: dict[str, Any]) -> None:
        assert out["state"]["armed"] is (m["base_mode"] & 128 != 0)
        assert out["state"]["guided"] is (m["base_mode"] & 8 != 0) and out["state"]["connected"]

    def attitude_target(self, m: dict[str, Any], out: dict[str, Any]) -> None:
        target = out["setpoint_raw/target_attitude"]
        w, x, y, z = m["q"]
        body_ned = matrix({"w": w, "x": x, "y": y, "z": z})
        assert matrix(target["orientation"]) == pytest.approx(ENU @ body_ned @ FLU, abs=1e-6)

    def position_target_local_ned(self, m: dict[str, Any], out: dict[str, Any]) -> None:
        target = out["setpoint_raw/target_local"]
        assert vector(target["position"]) == pytest.approx(ENU @ [m["x"], m["y"], m["z"]], nan_ok=True)
        if math.isfinite(m["yaw"]):
            east_of = math.pi / 2 - m["yaw"]
            assert math.remainder(target["yaw"] - east_of, 2 * math.pi) == pytest.approx(0, abs=1e-6)


@pytest.mark.parametrize("log", ["px4-mission-flight.tlog", "copter-radio-flight.tlog", "px4-battery-low.tlog"])
def test_recorded_messages_become_those_of_mavros(log: str) -> None:
    known = ros2_interfaces()
    memories: dict[int, VehicleMemory] = {}
    oracles: dict[int, Oracle] = {}
    with opened_log(DATA / log, load_dialect(("ardupilotmega", "px4-extras"))) as opened:
        entries = [entry for entry in opened.entries() if entry.frame is not None]
    for entry in entries:
        frame = entry.frame
        if frame is None or frame.info is None or frame.compid != 1 or frame.sysid > 250:
            continue
        memory = memories.setdefault(frame.sysid, VehicleMemory())
        oracle = oracles.setdefault(frame.sysid, Oracle())
        fields = dict(frame.fields())
        out = dict(samples(frame.name, fields, 1000 * entry.unix_us, memory))
        for topic, message in out.items():
            assert topic in SOURCES[frame.name].topics
            known.encode(TELEMETRY[topic].type, message)
            if "header" in message and topic != "home_position/home":
                stamp = message["header"]["stamp"]
                age_ns = 1000 * entry.unix_us - (stamp["sec"] * 10**9 + stamp["nanosec"])
                assert 0 <= age_ns < 10e9, (topic, age_ns)
        oracle.check(frame.name, fields, out)
    checked = sum((oracle.checked for oracle in oracles.values()), Counter())
    for topic in ("state", "global_position/global", "sys_status", "battery"):
        assert checked[topic], (topic, checked)


def test_quaternions_replace_angles_and_highres_replaces_raw() -> None:
    memory = VehicleMemory()
    half = math.sqrt(0.5)
    quaternion = {"time_boot_ms": 1, "q1": half, "q2": 0.0, "q3": 0.0, "q4": half}  # nose to the east
    rates = {"rollspeed": 0.1, "pitchspeed": 0.2, "yawspeed": 0.3}
    (imu,) = samples("ATTITUDE_QUATERNION", quaternion | rates, 10**9, memory)
    assert matrix(imu.fields["orientation"]) == pytest.approx(np.eye(3), abs=1e-9)  # as a vehicle along x
    assert vector(imu.fields["angular_velocity"]) == pytest.approx([0.1, -0.2, -0.3])
    assert imu.fields["linear_acceleration_covariance"][0] == -1  # none has come
    angles = {"time_boot_ms": 2, "roll": 0.0, "pitch": 0.0, "yaw": 0.0} | rates
    assert samples("ATTITUDE", angles, 10**9, memory) == []
    axes = {f"{axis}{kind}": 1 for axis in "xyz" for kind in ("acc", "gyro", "mag")}
    pressures = {"abs_pressure": 990.0, "diff_pressure": 0.0, "pressure_alt": 0.0, "temperature": 20.0}
    highres = {"time_usec": 1000, "fields_updated": 0x3F} | axes | pressures
    assert [s.topic for s in samples("HIGHRES_IMU", highres, 10**9, memory)] == ["imu/data_raw"]
    assert samples("RAW_IMU", {"time_usec": 1} | axes, 10**9, memory) == []


def test_every_message_has_its_topics_and_hostile_values_stay_inside() -> None:
    """Fields at their limits, as a hostile vehicle sends them: an error of one message, or messages that ROS takes."""
    known = ros2_interfaces()
    made: set[str] = set()
    for name in SOURCES:
        info = load_dialect(("ardupilotmega", "px4-extras")).find(name)
        for extreme in (0.0, 1.0, -1.0, math.inf, -math.inf, math.nan):
            fields = {f.name: limit_value(f, extreme) for f in info.fields}
            memory = VehicleMemory(FrameNames("a/map", "a/base_link"))
            try:
                out = samples(name, fields, 1_700_000_000 * 10**9, memory)
                for topic, message in out:
                    known.encode(TELEMETRY[topic].type, message)
                    made.add(topic)
            except (ValueError, OverflowError):
                assert not math.isfinite(extreme), (name, extreme)
    assert made == set(TELEMETRY)
    assert {topic for source in SOURCES.values() for topic in source.topics} == set(TELEMETRY)


def limit_value(field: Any, extreme: float) -> Any:
    if field.type == "char":
        return "x" * field.array_length
    if field.type in ("float", "double"):
        value: Any = extreme
    else:
        bits = int("".join(c for c in field.type if c.isdigit()))
        signed = not field.type.startswith("u")
        least, most = (-(2 ** (bits - 1)), 2 ** (bits - 1) - 1) if signed else (0, 2**bits - 1)
        value = {1.0: most, -1.0: least}.get(extreme, 0 if extreme == 0 else most)
        if field.name == "time_unix_usec":
            value = 1_700_000_000_000_000
        if field.name == "fix_type":
            value = 3
    return [value] * field.array_length if field.array_length else value
