"""Converters: which message takes the place of which, and values at their limits. Values: `test_mavros_conversions`."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from skygcs.config.dialects import load_dialect
from skygcs.core.ros.interfaces import ros2_interfaces
from skygcs.core.ros.memory import FrameNames, VehicleMemory
from skygcs.core.ros.topics import SOURCES, TELEMETRY, samples


def matrix(q: Any) -> Any:
    """The matrix of geometry_msgs' Quaternion."""
    w, x, y, z = (q[name] for name in "wxyz")
    assert w * w + x * x + y * y + z * z == pytest.approx(1, abs=1e-6)
    v = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.eye(3) + 2 * w * v + 2 * v @ v


def vector(fields: Any) -> Any:
    return np.array([fields[name] for name in "xyz"])


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


PLACE = {"time_boot_ms": 5000, "lat": 437806000, "lon": -794653000, "alt": 184500, "relative_alt": 4500, "hdg": 0}
PLACE |= {"vx": 0, "vy": 0, "vz": 0}


def test_before_the_receiver_is_heard_there_is_no_fix() -> None:
    """lib/uas_data.cpp: Data::Data; global_position: handle_global_position_int takes an origin of a fix alone."""
    memory = VehicleMemory()
    made = dict(samples("GLOBAL_POSITION_INT", PLACE, 10**9, memory))
    fix = made["global_position/global"]
    assert fix["status"] == {"status": -1, "service": 1} and fix["position_covariance_type"] == 0
    assert list(fix["position_covariance"]) == [-1.0, *[0.0] * 8]
    assert memory.map_frame is None


def test_a_pause_of_the_radio_moves_no_origin() -> None:
    """connection_cb of imu, sys_status and rc_io: these forget; global_position and lib/uas_data do not."""
    memory = VehicleMemory()
    gps = {"time_usec": 5_000_000, "fix_type": 3, "lat": PLACE["lat"], "lon": PLACE["lon"], "alt": 184500}
    gps |= {"eph": 100, "epv": 100, "vel": 0, "cog": 0, "satellites_visible": 9}
    samples("GPS_RAW_INT", gps, 10**9, memory)
    samples("GLOBAL_POSITION_INT", PLACE, 10**9, memory)
    memory.has_attitude_quaternion = memory.has_battery0 = memory.has_rc_channels = memory.has_highres_imu = True
    memory.rc_in.append(1500)
    later = memory.after_loss()
    assert not (later.has_attitude_quaternion or later.has_battery0 or later.has_rc_channels or later.has_highres_imu)
    assert later.rc_in == [] and later.clock is memory.clock
    moved = PLACE | {"lat": PLACE["lat"] + 9000}  # 100 m to the north
    local = dict(samples("GLOBAL_POSITION_INT", moved, 2 * 10**9, later))["global_position/local"]
    assert local["pose"]["pose"]["position"]["y"] == pytest.approx(100, abs=0.2)


def test_a_cell_goes_on_in_the_second_array() -> None:
    """sys_status: handle_battery_status adds 65.534 V up over both arrays."""
    fields = {"id": 0, "type": 1, "current_battery": 0, "battery_remaining": 50}
    fields |= {"voltages": [4000] * 9 + [0xFFFE], "voltages_ext": [3000, 0, 0, 0]}  # type: ignore[dict-item]
    (battery,) = samples("BATTERY_STATUS", fields, 10**9, VehicleMemory())
    assert battery.fields["cell_voltage"] == pytest.approx([4.0] * 9 + [68.534])


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
