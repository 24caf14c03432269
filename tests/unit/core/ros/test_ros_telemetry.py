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
