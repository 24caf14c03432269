"""The messages of poses, packed, and read by pymavlink; the rate that fits a link."""

from __future__ import annotations

import math

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mav

from skygcs.config.dialects import load_dialect
from skygcs.core.geo import quaternion_from_euler
from skygcs.core.mavlink.frame import encode_payload
from skygcs.ext.mocap.pose import Pose
from skygcs.ext.mocap.pose_messages import LEAST_HZ, WIRE_BYTES, PoseMessage, message_of, rate_that_fits
from support.table import each

POSE = Pose(100.5, (1.0, 2.0, 3.0), quaternion_from_euler(0.1, 0.0, math.radians(30)))  # ENU, FLU


def read(kind: PoseMessage, family: str, reset_counter: int = 3) -> tuple[mav.MAVLink_message, bytes]:
    name, values = message_of(kind, POSE, family, reset_counter, 0.02)
    info = load_dialect("ardupilotmega").by_name[name]
    raw = encode_payload(info, info.pack(values), sysid=255, compid=25, seq=0, version=2)
    (message,) = mav.MAVLink(None).parse_buffer(raw)
    return message, raw


@each("family", ["px4", "ardupilot"])
def test_vision_position_estimate_is_ned_with_the_time_of_capture(family: str) -> None:
    message, raw = read("vision_position_estimate", family)
    assert (message.x, message.y, message.z) == pytest.approx((2.0, 1.0, -3.0))
    assert (message.roll, message.pitch, message.yaw) == pytest.approx((0.1, 0.0, math.radians(60)), abs=1e-6)
    assert message.usec == 100_480_000
    assert message.reset_counter == 3
    assert math.isnan(message.covariance[0])
    assert len(raw) == WIRE_BYTES["vision_position_estimate"]


@each(("family", "frame"), [("px4", mav.MAV_FRAME_LOCAL_NED), ("ardupilot", mav.MAV_FRAME_LOCAL_FRD)])
def test_odometry_names_the_frame_that_its_firmware_takes(family: str, frame: int) -> None:
    message, raw = read("odometry", family)
    assert (message.frame_id, message.child_frame_id) == (frame, mav.MAV_FRAME_BODY_FRD)
    assert (message.x, message.y, message.z) == pytest.approx((2.0, 1.0, -3.0))
    assert all(map(math.isnan, (message.vx, message.vy, message.vz, message.pose_covariance[0])))
    # PX4 publishes MOCAP as vehicle_mocap_odometry, which its EKF2 does not read
    assert message.estimator_type == mav.MAV_ESTIMATOR_TYPE_VISION
    assert message.time_usec == 100_480_000
    assert len(raw) <= WIRE_BYTES["odometry"]


def test_the_longest_odometry_has_the_bytes_that_are_counted() -> None:
    info = load_dialect("ardupilotmega").by_name["ODOMETRY"]
    _, values = message_of("odometry", POSE, "px4", 3, 0.0)
    payload = info.pack({**values, "quality": 1})
    assert len(encode_payload(info, payload, sysid=1, compid=1, seq=0, version=2)) == WIRE_BYTES["odometry"]


@each(
    ("kind", "uplink", "fits"),
    [
        ("vision_position_estimate", None, 30.0),
        ("vision_position_estimate", 2880.0, 11.2),  # 57600 baud, half of it up, half of that
        ("odometry", 2880.0, 5.9),
        ("vision_position_estimate", 11520.0, 30.0),  # 230400 baud would carry 44
        ("vision_position_estimate", 0.0, 0.0),
    ],
)
def test_the_rate_is_what_half_of_the_uplink_carries(kind: PoseMessage, uplink: float | None, fits: float) -> None:
    assert rate_that_fits(kind, 30.0, uplink, signed=False) == pytest.approx(fits, abs=0.1)


def test_signatures_count() -> None:
    plain = rate_that_fits("vision_position_estimate", 100.0, 2880.0, signed=False)
    assert rate_that_fits("vision_position_estimate", 100.0, 2880.0, signed=True) == pytest.approx(plain * 129 / 142)
    assert plain > LEAST_HZ
