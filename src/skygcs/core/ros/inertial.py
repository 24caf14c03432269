"""imu/…: attitude, rates, accelerations, magnetic field, pressures (MAVROS' plugin imu)."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any

from skygcs.core.geo import Quaternion, Vector, quaternion_from_euler
from skygcs.core.mavlink.modes import AUTOPILOT_ARDUPILOT, AUTOPILOT_PX4
from skygcs.core.ros.memory import UNKNOWN_COVARIANCE, Sample, VehicleMemory
from skygcs.core.ros.rotations import enu_orientation, flu_from_frd, wxyz, xyz
from skygcs.core.ros.stamps import header

ORIENTATION_VARIANCE = 1.0**2
ANGULAR_VARIANCE = math.radians(0.02) ** 2
LINEAR_VARIANCE = 0.0003**2
"""MAVROS' parameters orientation_stdev, angular_velocity_stdev and linear_acceleration_stdev, as they ship."""

MILLIRAD = 1e-3
MILLI_G_MPS2 = 9.80665 / 1000
MILLIMPS2 = 1e-3
GAUSS_T = 1e-4
MILLITESLA_T = 1000.0
"""MAVROS' factor for RAW_IMU and SCALED_IMU. The message has milligauss, so the value is 10^10 times too large; it is
MAVROS' own, and nodes that were written for it expect it."""

ACCEL_OR_GYRO, MAG, STATIC_PRESSURE, DIFF_PRESSURE, TEMPERATURE = 0x3F, 0x1C0, 1 << 9, 1 << 10, 1 << 12
"""Bits of HIGHRES_IMU.fields_updated as MAVROS reads them."""


def attitude(fields: dict[str, Any], arrival_ns: int, memory: VehicleMemory) -> Iterator[Sample]:
    """ATTITUDE, unless the vehicle sends quaternions."""
    if memory.has_attitude_quaternion:
        return iter(())
    return _data(fields, quaternion_from_euler(fields["roll"], fields["pitch"], fields["yaw"]), arrival_ns, memory)


def attitude_quaternion(fields: dict[str, Any], arrival_ns: int, memory: VehicleMemory) -> Iterator[Sample]:
    """ATTITUDE_QUATERNION."""
    memory.has_attitude_quaternion = True
    q = (fields["q1"], fields["q2"], fields["q3"], fields["q4"])
    return _data(fields, q, arrival_ns, memory)


def _data(fields: dict[str, Any], q_ned: Quaternion, arrival_ns: int, memory: VehicleMemory) -> Iterator[Sample]:
    memory.orientation = enu_orientation(q_ned)
    memory.angular_flu = flu_from_frd(fields["rollspeed"], fields["pitchspeed"], fields["yawspeed"])
    linear = diagonal(LINEAR_VARIANCE)
    stamp_ns = memory.orientation_ns = memory.clock.stamp_ns(fields["time_boot_ms"] * 1000, arrival_ns)
    yield Sample(
        "imu/data",
        {
            "header": header(stamp_ns, memory.frames.base_link),
            "orientation": wxyz(memory.orientation),
            "orientation_covariance": diagonal(ORIENTATION_VARIANCE),
            "angular_velocity": xyz(memory.angular_flu),
            "angular_velocity_covariance": diagonal(ANGULAR_VARIANCE),
            "linear_acceleration": xyz(memory.accel_flu),
            "linear_acceleration_covariance": linear if memory.has_accel else (-1.0, *linear[1:]),
        },
    )


def highres_imu(fields: dict[str, Any], arrival_ns: int, memory: VehicleMemory) -> Iterator[Sample]:
    """HIGHRES_IMU."""
    memory.has_highres_imu = True
    head = _head(fields["time_usec"], arrival_ns, memory)
    updated = fields["fields_updated"]
    if updated & ACCEL_OR_GYRO:
        gyro = flu_from_frd(fields["xgyro"], fields["ygyro"], fields["zgyro"])
        accel = flu_from_frd(fields["xacc"], fields["yacc"], fields["zacc"])
        yield _raw(head, gyro, accel, memory)
    if updated & MAG:
        yield _mag(head, (fields["xmag"], fields["ymag"], fields["zmag"]), GAUSS_T)
    if updated & STATIC_PRESSURE:
        yield Sample("imu/static_pressure", {"header": head, "fluid_pressure": fields["abs_pressure"]})
    if updated & DIFF_PRESSURE:
        yield Sample("imu/diff_pressure", {"header": head, "fluid_pressure": fields["diff_pressure"]})
    if updated & TEMPERATURE:
        yield Sample("imu/temperature_imu", {"header": head, "temperature": fields["temperature"]})


def raw_imu(fields: dict[str, Any], arrival_ns: int, memory: VehicleMemory) -> Iterator[Sample]:
    """RAW_IMU, unless the vehicle sends something better."""
    if memory.has_highres_imu or memory.has_scaled_imu:
        return
    unit = {AUTOPILOT_ARDUPILOT: MILLI_G_MPS2, AUTOPILOT_PX4: MILLIMPS2}.get(memory.autopilot, 1.0)
    yield from _millis(fields, fields["time_usec"], unit, arrival_ns, memory)
    if memory.autopilot != AUTOPILOT_ARDUPILOT:
        memory.accel_flu = (0.0, 0.0, 0.0)  # it is not scaled: not for imu/data


def scaled_imu(fields: dict[str, Any], arrival_ns: int, memory: VehicleMemory) -> Iterator[Sample]:
    """SCALED_IMU, unless the vehicle sends HIGHRES_IMU."""
    if memory.has_highres_imu:
        return iter(())
    memory.has_scaled_imu = True
    return _millis(fields, fields["time_boot_ms"] * 1000, MILLI_G_MPS2, arrival_ns, memory)


def _millis(
    fields: dict[str, Any], boot_us: int, accel_unit: float, arrival_ns: int, memory: VehicleMemory
) -> Iterator[Sample]:
    head = _head(boot_us, arrival_ns, memory)
    gyro = flu_from_frd(fields["xgyro"] * MILLIRAD, fields["ygyro"] * MILLIRAD, fields["zgyro"] * MILLIRAD)
    accel = flu_from_frd(fields["xacc"] * accel_unit, fields["yacc"] * accel_unit, fields["zacc"] * accel_unit)
    yield _raw(head, gyro, accel, memory)
    yield _mag(head, (fields["xmag"], fields["ymag"], fields["zmag"]), MILLITESLA_T)


def scaled_pressure(fields: dict[str, Any], arrival_ns: int, memory: VehicleMemory) -> Iterator[Sample]:
    """SCALED_PRESSURE, unless the vehicle sends HIGHRES_IMU; hectopascals and centidegrees."""
    if memory.has_highres_imu:
        return
    head = _head(fields["time_boot_ms"] * 1000, arrival_ns, memory)
    yield Sample("imu/temperature_baro", {"header": head, "temperature": fields["temperature"] / 100})
    yield Sample("imu/static_pressure", {"header": head, "fluid_pressure": fields["press_abs"] * 100})
    yield Sample("imu/diff_pressure", {"header": head, "fluid_pressure": fields["press_diff"] * 100})


def diagonal(variance: float) -> tuple[float, ...]:
    """A covariance of 3 by 3 with this variance of each axis."""
    return variance, 0.0, 0.0, 0.0, variance, 0.0, 0.0, 0.0, variance


def _head(boot_us: int, arrival_ns: int, memory: VehicleMemory) -> dict[str, Any]:
    return header(memory.clock.stamp_ns(boot_us, arrival_ns), memory.frames.base_link)


def _raw(head: dict[str, Any], gyro: Vector, accel: Vector, memory: VehicleMemory) -> Sample:
    memory.accel_flu, memory.has_accel = accel, True
    fields = {
        "header": head,
        "orientation_covariance": UNKNOWN_COVARIANCE,
        "angular_velocity": xyz(gyro),
        "angular_velocity_covariance": diagonal(ANGULAR_VARIANCE),
        "linear_acceleration": xyz(accel),
        "linear_acceleration_covariance": diagonal(LINEAR_VARIANCE),
    }
    return Sample("imu/data_raw", fields)


def _mag(head: dict[str, Any], mag_frd: Vector, unit: float) -> Sample:
    x, y, z = mag_frd
    field = xyz(flu_from_frd(x * unit, y * unit, z * unit))
    return Sample("imu/mag", {"header": head, "magnetic_field": field, "magnetic_field_covariance": UNKNOWN_COVARIANCE})
