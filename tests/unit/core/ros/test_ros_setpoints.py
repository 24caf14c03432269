"""Setpoints against matrices of numpy and pymap3d; hostile numbers are refused."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pymap3d
import pytest

from skygcs.core.geo import Origin
from skygcs.core.ros import setpoints
from skygcs.core.ros.interfaces import ros2_interfaces
from skygcs.core.ros.memory import VehicleMemory
from skygcs.core.ros.setpoints import SETPOINTS, AttitudeError, AttitudePair, LocalFrame, SetpointError
from skygcs.core.ros.topics import samples
from support.table import each

FLEET = Origin(43.7806, -79.4653, 180.0, 60.0)
EKF = (43.7810, -79.4660, 182.0)
FRAME = LocalFrame(FLEET, EKF, 181.0, math.radians(30))

A = math.radians(FLEET.x_heading_deg - 90)
TURN = np.array([[math.cos(A), -math.sin(A), 0], [math.sin(A), math.cos(A), 0], [0, 0, 1]])
"""True ENU along the fleet's axes, whose x points to 60 degrees: east is 30 degrees to the right of it."""


def message(topic: str, **fields: Any) -> dict[str, Any]:
    """As it comes over the wire."""
    known, type_ = ros2_interfaces(), SETPOINTS[topic][0].type
    return known.decode(type_, known.encode(type_, fields))


def demand(topic: str, frame: LocalFrame = FRAME, **fields: Any) -> setpoints.Demand:
    return SETPOINTS[topic][1](message(topic, **fields), frame)


def xyz(*values: float) -> dict[str, float]:
    return dict(zip("xyz", values, strict=True))


def of_yaw(yaw: float) -> dict[str, float]:
    return {"w": math.cos(yaw / 2), "z": math.sin(yaw / 2)}


def in_fleet(local: tuple[float, float, float]) -> Any:
    lat, lon, alt = pymap3d.enu2geodetic(*local, *EKF)
    return TURN @ pymap3d.geodetic2enu(lat, lon, alt, FLEET.lat_deg, FLEET.lon_deg, FLEET.alt_amsl_m)


def test_places_of_the_local_frame_are_places_of_the_fleets() -> None:
    pose = {"position": xyz(10, 20, 5), "orientation": of_yaw(1.0)}
    got = demand("setpoint_position/local", pose=pose)
    assert got.mode == "position" and got.climbs_m == 5
    assert got.params["pos_enu_m"] == pytest.approx(in_fleet((10, 20, 5)), abs=0.01)
    assert got.params["yaw_deg"] == pytest.approx(math.degrees(1.0) - 30)
    zeros = {"position": xyz(0, 0, 1), "orientation": {"w": 0.0}}  # as an rospy message begins: MAVROS flies it to east
    assert demand("setpoint_position/local", pose=zeros).params["yaw_deg"] == -30
    earth = {"latitude": EKF[0], "longitude": EKF[1], "altitude": 190.0}
    got = demand("setpoint_position/global", pose={"position": earth, "orientation": of_yaw(0.0)})
    assert got.params["pos_enu_m"] == pytest.approx(in_fleet((0, 0, 8)), abs=0.01)


def test_velocities_turn_with_the_fleets_axes() -> None:
    twist = {"linear": xyz(1, 2, 0.5), "angular": xyz(0, 0, 0.5)}
    for got in (
        demand("setpoint_velocity/cmd_vel", twist=twist),
        demand("setpoint_velocity/cmd_vel_unstamped", **twist),
        demand("setpoint_raw/local", coordinate_frame=1, type_mask=0x5C7, velocity=xyz(1, 2, 0.5), yaw_rate=0.5),
    ):
        assert got.mode == "velocity"
        assert got.params["vel_enu_mps"] == pytest.approx(TURN @ [1, 2, 0.5])
        assert got.params["yaw_rate_dps"] == pytest.approx(math.degrees(0.5))
    body = demand("setpoint_raw/local", coordinate_frame=8, type_mask=0x5C7, velocity=xyz(1, 0, 0))
    nose = TURN @ [math.cos(math.radians(30)), math.sin(math.radians(30)), 0]
    assert body.params["vel_enu_mps"] == pytest.approx(nose)


def test_masks() -> None:
    place, nan = xyz(1, 2, 3), math.nan
    got = demand("setpoint_raw/local", coordinate_frame=1, type_mask=0x9F8, position=place, velocity=xyz(nan, nan, nan))
    assert set(got.params) == {"pos_enu_m", "yaw_deg"} and got.climbs_m == 3
    plain = LocalFrame(Origin(*EKF), EKF, None, 0.0)
    height = demand(
        "setpoint_raw/local", plain, coordinate_frame=1, type_mask=0xDE3, position=xyz(9, 9, 3), velocity=xyz(1, 1, 1)
    )
    assert height.params["pos_enu_m"] == pytest.approx([None, None, 3.0])
    assert height.params["vel_enu_mps"] == pytest.approx([1.0, 1.0, None])
    accel = demand("setpoint_raw/local", coordinate_frame=1, type_mask=0xC3F, acceleration_or_force=xyz(0, 1, 0))
    assert accel.mode == "raw" and accel.params["acc_enu_mps2"] == pytest.approx(TURN @ [0, 1, 0])
    earth = {"latitude": EKF[0], "longitude": EKF[1]}
    above = demand("setpoint_raw/global", coordinate_frame=6, type_mask=0xDF8, altitude=10.0, **earth)
    assert above.params["pos_enu_m"] == pytest.approx(in_fleet((0, 0, 9)), abs=0.01)


NED_OF_ENU = np.array([[0, 1, 0], [1, 0, 0], [0, 0, -1]])


@each("ignored", range(7))
@each(("part", "shift"), [("velocity", 3), ("acceleration_or_force", 6)])
def test_a_mask_is_of_mavlinks_axes(part: str, shift: int, ignored: int) -> None:
    """MAVROS (setpoint_raw: local_cb) turns the values into NED and passes the mask on, whose first bit is north's."""
    plain = LocalFrame(Origin(*EKF), EKF, None, 0.0)
    mask = 0xDFF & ~(7 << shift) | ignored << shift
    vector = {"velocity": [1, 2, 0.5], "acceleration_or_force": [0.1, 0.2, 0.3]}[part]
    north, east, down = (math.nan if ignored & 1 << axis else value for axis, value in enumerate(NED_OF_ENU @ vector))
    got = demand("setpoint_raw/local", plain, coordinate_frame=1, type_mask=mask, **{part: xyz(*vector)})
    enu = [east, north, -down]
    if part == "velocity":
        found = [math.nan if value is None else value for value in got.params["vel_enu_mps"]]
        assert found == pytest.approx(enu, rel=1e-6, nan_ok=True)
    else:  # an axis that is left out is not accelerated
        assert got.params["acc_enu_mps2"] == pytest.approx(np.nan_to_num(enu), rel=1e-6)


def test_a_mask_in_the_bodys_frame_is_of_its_axes() -> None:
    forward = demand("setpoint_raw/local", coordinate_frame=8, type_mask=0x5D7, velocity=xyz(1, 9, 0))  # not left
    nose = TURN @ [math.cos(math.radians(30)), math.sin(math.radians(30)), 0]
    assert forward.params["vel_enu_mps"] == pytest.approx(nose)
    level = demand("setpoint_raw/local", coordinate_frame=8, type_mask=0x5E7, velocity=xyz(1, 0, 9))  # not up
    assert level.params["vel_enu_mps"][:2] == pytest.approx(nose[:2]) and level.params["vel_enu_mps"][2] is None


def test_without_an_attitude_nothing_is_turned_out_of_the_bodys_frame() -> None:
    unknown = LocalFrame(FLEET, EKF, 181.0, None)
    with pytest.raises(AttitudeError, match="attitude"):
        demand("setpoint_raw/local", unknown, coordinate_frame=8, type_mask=0x5C7, velocity=xyz(5, 0, 0))
    assert demand("setpoint_raw/local", coordinate_frame=8, type_mask=0x5C7, velocity=xyz(5, 0, 0)).by_attitude
    assert not demand("setpoint_raw/local", unknown, coordinate_frame=1, type_mask=0x5C7).by_attitude


def test_a_yaw_is_known_while_its_attitude_is_fresh() -> None:
    """The nose to the south: MAVLink's yaw of 180 degrees is -90 degrees from east."""
    memory, fresh_ns = VehicleMemory(), 500_000_000
    angles = {"roll": 0.0, "pitch": 0.0, "yaw": math.pi, "rollspeed": 0.0, "pitchspeed": 0.0, "yawspeed": 0.0}
    assert memory.yaw_enu_rad(0, fresh_ns) is None  # before the first
    samples("ATTITUDE", angles | {"time_boot_ms": 1000}, 10 * 10**9, memory)
    assert memory.yaw_enu_rad(10 * 10**9 + fresh_ns, fresh_ns) == pytest.approx(-math.pi / 2)
    assert memory.yaw_enu_rad(10 * 10**9 + fresh_ns + 1, fresh_ns) is None
    samples("ATTITUDE", angles | {"time_boot_ms": 2000}, 11_600_000_000, memory)  # 0.6 s late: it is of 11.0 s
    assert memory.yaw_enu_rad(11_600_000_000, fresh_ns) is None
    samples("ATTITUDE", angles | {"time_boot_ms": 3000}, 12 * 10**9, memory)
    assert memory.yaw_enu_rad(12 * 10**9, fresh_ns) is not None
    assert memory.after_loss().yaw_enu_rad(12 * 10**9, fresh_ns) is None
    samples("ATTITUDE", angles | {"time_boot_ms": 3100, "yaw": math.nan}, 12_100_000_000, memory)
    assert memory.yaw_enu_rad(12_100_000_000, fresh_ns) is None


def test_rates_of_setpoint_attitude_are_about_right_forward_up() -> None:
    """setpoint_attitude: send_attitude_ang_velocity sends transform_frame_ned_enu(angular) as SET_ATTITUDE_TARGET's
    rates about forward, right, down."""
    pair = AttitudePair()
    pair.on_thrust({"thrust": 0.5}, 10.0)
    angular = [0.1, 0.2, 0.3]
    roll, pitch, yaw_right = np.degrees(NED_OF_ENU @ angular)
    got = pair.on_twist({"twist": {"angular": xyz(*angular)}}, 10.0)
    assert got.params["body_rates_deg_s"] == pytest.approx([roll, pitch, -yaw_right])


def test_attitudes_and_rates() -> None:
    q = np.array([0.9, 0.1, -0.2, 0.3])
    q /= np.linalg.norm(q)
    orientation = dict(zip("wxyz", q, strict=True))
    got = demand("setpoint_raw/attitude", type_mask=7, orientation=orientation, thrust=0.5)
    w, x, y, z = got.params["attitude"]
    half = A / 2
    turned = np.array([math.cos(half), 0, 0, math.sin(half)])
    expected = [turned[0] * q[0] - turned[3] * q[3], turned[0] * q[1] - turned[3] * q[2]]
    assert [w, x] == pytest.approx(expected) and math.hypot(w, x, y, z) == pytest.approx(1)
    rates = demand("setpoint_raw/attitude", type_mask=128, body_rate=xyz(0.1, 0.2, 0.3), thrust=0.4)
    assert rates.params["body_rates_deg_s"] == pytest.approx(np.degrees([0.1, -0.2, 0.3]))
    pair = AttitudePair()
    pose = {"pose": {"orientation": orientation | {}}}
    with pytest.raises(SetpointError, match="thrust"):
        pair.on_pose(pose, FRAME, 10.0)
    pair.on_thrust({"thrust": 0.5}, 10.0)
    assert pair.on_pose(pose, FRAME, 10.1).params["attitude"] == pytest.approx(got.params["attitude"])
    with pytest.raises(SetpointError, match="thrust"):
        pair.on_twist({"twist": {"angular": xyz(0, 0, 0)}}, 10.3)


@each(
    ("topic", "fields"),
    [
        ("setpoint_position/local", {"pose": {"position": xyz(math.nan, 0, 0), "orientation": {"w": 1.0}}}),
        ("setpoint_position/local", {"pose": {"position": xyz(1e9, 0, 0), "orientation": {"w": 1.0}}}),
        ("setpoint_position/local", {"pose": {"position": xyz(0, 0, 0), "orientation": {"w": math.inf}}}),
        ("setpoint_position/local", {"pose": {"position": xyz(0, 0, 0), "orientation": {"w": 0.3}}}),
        ("setpoint_position/global", {"pose": {"position": {"latitude": 91.0}, "orientation": {"w": 1.0}}}),
        ("setpoint_velocity/cmd_vel", {"twist": {"linear": xyz(0, math.inf, 0)}}),
        ("setpoint_velocity/cmd_vel", {"twist": {"angular": xyz(0, 0, math.nan)}}),
        ("setpoint_velocity/cmd_vel", {"twist": {"angular": xyz(0, 0, 50)}}),
        ("setpoint_accel/accel", {"vector": xyz(0, 0, 1e6)}),
        ("setpoint_raw/local", {"coordinate_frame": 1, "type_mask": 0xFFF}),
        ("setpoint_raw/local", {"coordinate_frame": 1, "type_mask": 0x200}),
        ("setpoint_raw/local", {"coordinate_frame": 12, "type_mask": 0}),
        ("setpoint_raw/local", {"coordinate_frame": 8, "type_mask": 0}),
        ("setpoint_raw/local", {"coordinate_frame": 1, "type_mask": 0xDF9}),
        ("setpoint_raw/local", {"coordinate_frame": 1, "type_mask": 0x9F8, "yaw": math.nan}),
        ("setpoint_raw/global", {"coordinate_frame": 11, "type_mask": 0xDF8}),
        ("setpoint_raw/global", {"coordinate_frame": 8, "type_mask": 0xDC7}),
        ("setpoint_raw/global", {"coordinate_frame": 5, "type_mask": 0xDF9}),
        ("setpoint_raw/attitude", {"type_mask": 7, "orientation": {"w": 1.0}, "thrust": 1.1}),
        ("setpoint_raw/attitude", {"type_mask": 7, "orientation": {"w": 1.0}, "thrust": math.nan}),
        ("setpoint_raw/attitude", {"type_mask": 64, "orientation": {"w": 1.0}}),
        ("setpoint_raw/attitude", {"type_mask": 135, "thrust": 0.5}),
    ],
)
def test_what_is_no_setpoint_is_refused_with_its_reason(topic: str, fields: dict[str, Any]) -> None:
    with pytest.raises(SetpointError, match=r"[a-z]"):
        demand(topic, **fields)


def test_places_need_both_origins() -> None:
    pose = {"position": xyz(0, 0, 1), "orientation": {"w": 1.0}}
    for frame in (LocalFrame(None, EKF, None, 0.0), LocalFrame(FLEET, None, None, 0.0)):
        with pytest.raises(SetpointError, match="origin"):
            demand("setpoint_position/local", frame, pose=pose)
    assert demand("setpoint_velocity/cmd_vel", LocalFrame(None, None, None, 0.0)).mode == "velocity"
