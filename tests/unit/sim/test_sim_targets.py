"""SET_POSITION_TARGET_* as PX4 1.16 and ArduCopter 4.6 follow it: what is taken, how it is followed, when it ends.

The circle's figures were flown with the firmwares' own simulators, without wind and radio
(docs/developers/control-figures.md).
"""

from __future__ import annotations

from dataclasses import dataclass
from math import degrees, hypot, isfinite, nan, pi, radians
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pymavlink.dialects.v20 import ardupilotmega as mav

from skygcs.sim.body import wrap_pi
from skygcs.sim.copter_position_control import CopterPositionControl
from skygcs.sim.firmware_modes import CopterMode, Px4Mode
from skygcs.sim.kinematics import Limits, Motion
from skygcs.sim.position_control import NO_AXES, PositionTarget
from skygcs.sim.px4_position_control import Px4PositionControl
from skygcs.sim.vehicle import SimVehicle
from support.behaviour_flights import get_ready
from support.examples import examples, thinned
from support.followed_targets import WAYS, follow, rms, simulated
from support.sim_pilot import Pilot, copter, px4
from support.table import each

REAL_CIRCLE_M = {
    "px4": {
        "position": 3.14,
        "position, velocity": 1.36,
        "position, velocity, led by 0.1 s": 1.04,
        "position, velocity, led by 0.25 s, global": 0.87,
    },
    "ardupilot": {
        "position": 2.72,
        "position, velocity": 0.61,
        "position, velocity, led by 0.1 s": 0.52,
        "position, velocity, led by 0.25 s, global": 0.54,
    },
}
"""RMS of the distance from a circle of 5 m at 2 m/s."""


@each("firmware", sorted(REAL_CIRCLE_M))
def test_a_circle_is_followed_as_closely_as_by_the_real_firmware(firmware: str) -> None:
    rig = simulated(firmware)
    get_ready(rig)
    for name, real_m in thinned(REAL_CIRCLE_M[firmware].items(), 1, turn=1):
        flown_m = rms(follow(rig, WAYS[name]))
        assert 0.85 * real_m < flown_m < 1.2 * real_m, f"{name}: {flown_m:.2f} m, the firmware {real_m} m"


# -- one message at a time

POSITION, VELOCITY, ACCELERATION, YAW, YAW_RATE = 0b111, 0b111 << 3, 0b111 << 6, 1 << 10, 1 << 11
EVERYTHING = POSITION | VELOCITY | ACCELERATION | YAW | YAW_RATE


@dataclass
class Flight:
    """A vehicle that hovers at 10 m and takes targets; ENU metres."""

    pilot: Pilot
    vehicle: SimVehicle

    def send(self, take: int, *, frame: int = 1, as_global: bool = False, **fields: float) -> None:
        """A target of the groups ``take``; x, y, z, vx, … as in the message (NED)."""
        rest = [fields.get(key, 0.0) for key in ("vx", "vy", "vz", "afx", "afy", "afz", "yaw", "yaw_rate")]
        mask = EVERYTHING & ~take | int(fields.get("bits", 0))
        x, y, z = (fields.get(axis, 0.0) for axis in "xyz")
        if not as_global:
            self.pilot.send(mav.MAVLink_set_position_target_local_ned_message(0, 1, 1, frame, mask, x, y, z, *rest))
            return
        lat, lon = self.vehicle.where.to_geodetic(y, x)
        where = (round(lat * 1e7), round(lon * 1e7), -z)
        self.pilot.send(mav.MAVLink_set_position_target_global_int_message(0, 1, 1, frame, mask, *where, *rest))

    def stream(self, seconds: float, take: int, *, every_s: float = 0.2, frame: int = 1, **fields: float) -> None:
        """The same target again and again."""
        for _ in range(round(seconds / every_s)):
            self.send(take, frame=frame, **fields)
            self.pilot.run(every_s, step_s=0.02)

    @property
    def body(self) -> Any:
        return self.vehicle.motion


def said(f: Flight) -> str:
    """Its texts, which come in pieces of 50 characters."""
    return "".join(f.pilot.texts())


def flight(firmware: str) -> Flight:
    vehicle = px4() if firmware == "px4" else copter()
    pilot = Pilot(vehicle)
    pilot.hovering()
    found = Flight(pilot, vehicle)
    if firmware == "px4":
        found.stream(0.4, VELOCITY)
        assert pilot.command(mav.MAV_CMD_DO_SET_MODE, 1, 6) == 0
    return found


BOTH = pytest.mark.parametrize("firmware", ["px4", "ardupilot"])


@BOTH
def test_an_acceleration_beside_a_velocity_is_followed_at_once(firmware: str) -> None:
    """1 s of 1 m/s² with the velocity that fits it: hardly behind; without it, well behind."""
    reached = {}
    for take in (VELOCITY, VELOCITY | ACCELERATION):
        f = flight(firmware)
        f.stream(1.0, VELOCITY)
        for i in range(20):
            f.send(take, vx=0.05 * i, afx=1.0)
            f.pilot.run(0.05, step_s=0.02)
        reached[take] = f.body.vel_n_mps
    assert reached[VELOCITY | ACCELERATION] > reached[VELOCITY] + 0.15
    assert 0.6 < reached[VELOCITY | ACCELERATION] < 1.15


@BOTH
def test_an_acceleration_alone_is_flown_without_feedback(firmware: str) -> None:
    f = flight(firmware)
    f.stream(2.0, ACCELERATION, afx=1.0)
    assert 1.2 < f.body.vel_n_mps < 2.2
    f.stream(1.0, ACCELERATION)
    assert f.body.vel_n_mps > 0.8, "no acceleration is not an order to stop"


def test_a_px4_takes_position_and_acceleration_without_velocity_and_an_arducopter_stops() -> None:
    f = flight("px4")
    f.stream(8.0, POSITION | ACCELERATION, x=5.0, z=-10.0)
    assert abs(f.body.north_m - 5.0) < 0.5
    f = flight("ardupilot")
    f.stream(3.0, VELOCITY, vx=2.0)
    f.stream(4.0, POSITION | ACCELERATION, x=50.0, z=-10.0)
    assert f.body.groundspeed_mps < 0.2 and f.body.north_m < 15.0


def test_a_px4_mixes_axes_in_one_message() -> None:
    """Height by position, the rest by velocity: what an ArduCopter takes as nothing but a stop."""
    z_alone = EVERYTHING & ~(0b100 | 0b011 << 3)
    f = flight("px4")
    f.stream(6.0, EVERYTHING & ~z_alone, z=-13.0, vx=1.0)
    assert abs(f.body.up_m - 13.0) < 0.3 and abs(f.body.vel_n_mps - 1.0) < 0.2
    f = flight("ardupilot")
    f.stream(3.0, EVERYTHING & ~z_alone, z=-13.0, vx=1.0)
    assert abs(f.body.up_m - 10.0) < 0.2 and f.body.groundspeed_mps < 0.1


def test_a_px4_stops_when_a_target_leaves_an_axis_without_anything() -> None:
    f = flight("px4")
    f.stream(3.0, VELOCITY, vx=2.0)
    f.stream(3.0, 0b011 << 3, vx=2.0)
    assert f.body.groundspeed_mps < 0.2 and f.vehicle.mode == Px4Mode.OFFBOARD


def test_a_px4_refuses_frames_that_it_does_not_have_and_they_count_as_none() -> None:
    f = flight("px4")
    for frame in (7, 9):
        f.pilot.forget()
        f.stream(0.2, VELOCITY, frame=frame, vx=1.0)
        assert f"SET_POSITION_TARGET_LOCAL_NED coordinate frame {frame} unsupported" in said(f)
    f.stream(2.0, VELOCITY, frame=7, vx=1.0)
    assert f.vehicle.mode != Px4Mode.OFFBOARD, "COM_OF_LOSS_T has passed"
    f = flight("px4")
    f.pilot.forget()
    f.stream(0.2, ACCELERATION, bits=512)
    assert "SET_POSITION_TARGET_LOCAL_NED force not supported" in said(f)
    f.stream(0.2, 0)
    assert "SET_POSITION_TARGET_LOCAL_NED invalid" in said(f)


def test_a_velocity_of_the_body_goes_where_the_nose_points() -> None:
    for firmware in ("px4", "ardupilot"):
        f = flight(firmware)
        f.stream(4.0, VELOCITY | YAW, yaw=radians(90))
        f.stream(3.0, VELOCITY, frame=8, vx=1.0)
        assert f.body.vel_e_mps > 0.7 and abs(f.body.vel_n_mps) < 0.2


def test_an_arducopter_keeps_moving_its_target_until_guid_timeout_and_holds_it_then() -> None:
    f = flight("ardupilot")
    f.stream(4.0, VELOCITY, vx=2.0)
    at = f.body.north_m
    f.send(POSITION | VELOCITY, x=at, z=-10.0, vx=2.0)
    f.pilot.run(2.9)
    assert 4.0 < f.body.north_m - at < 7.0 and f.body.vel_n_mps > 1.5
    f.pilot.run(10.0)
    assert abs(f.body.north_m - at - 6.0) < 0.7 and f.body.groundspeed_mps < 0.1
    assert f.vehicle.mode == CopterMode.GUIDED


def test_a_px4_does_not_move_a_target_between_messages() -> None:
    """The velocity goes on pushing: it comes to rest where P (p_sp - p) has eaten it up, at v / MPC_XY_P beyond."""
    f = flight("px4")
    f.stream(15.0, POSITION | VELOCITY, x=5.0, z=-10.0, vx=1.0)
    assert abs(f.body.north_m - (5.0 + 1.0 / 0.95)) < 0.2 and f.body.groundspeed_mps < 0.1


def test_an_arducopter_stops_when_an_acceleration_is_not_renewed() -> None:
    f = flight("ardupilot")
    f.stream(1.0, ACCELERATION, afx=1.0)
    f.pilot.run(2.5)
    assert f.body.vel_n_mps > 2.0, "it goes on for GUID_TIMEOUT"
    f.pilot.run(8.0)
    assert f.body.groundspeed_mps < 0.1


def test_an_arducopter_drops_the_acceleration_of_a_global_target_with_a_velocity() -> None:
    peaks = {}
    for as_global in (False, True):
        f = flight("ardupilot")
        f.send(POSITION | VELOCITY | ACCELERATION, frame=6 if as_global else 1, as_global=as_global, z=-10.0, afx=2.0)
        f.pilot.run(1.0, step_s=0.02)
        peaks[as_global] = f.body.north_m
    assert peaks[False] > 0.2 > 0.05 > abs(peaks[True])


@each("bad", [{"vx": nan}, {"vx": 1001.0}])
def test_an_arducopter_stops_at_a_velocity_that_is_none(bad: dict[str, float]) -> None:
    f = flight("ardupilot")
    f.stream(3.0, VELOCITY, vx=2.0)
    f.send(VELOCITY, **bad)
    f.pilot.run(2.9)
    assert f.body.groundspeed_mps < 0.2


@BOTH
def test_a_yaw_rate_turns_it(firmware: str) -> None:
    f = flight(firmware)
    yaw = f.body.yaw_rad
    f.stream(3.0, VELOCITY | YAW_RATE, yaw_rate=0.5)
    turned = (f.body.yaw_rad - yaw) % (2 * pi)
    assert abs(turned - 1.5) < 0.25


@BOTH
def test_a_yaw_with_its_rate_is_followed_without_lag(firmware: str) -> None:
    f = flight(firmware)
    errors, yaw = [], f.body.yaw_rad - 0.05
    for _ in range(50):
        yaw += 0.05
        f.send(VELOCITY | YAW | YAW_RATE, yaw=wrap_pi(yaw), yaw_rate=0.5)
        f.pilot.run(0.1, step_s=0.02)
        errors.append(abs(wrap_pi(yaw + 0.05 - f.body.yaw_rad)))
    assert max(errors[20:]) < radians(4)


def test_an_arducopter_stops_turning_with_guid_timeout() -> None:
    f = flight("ardupilot")
    f.stream(1.0, POSITION | YAW_RATE, z=-10.0, yaw_rate=0.5)
    f.pilot.run(5.0)
    yaw = f.body.yaw_rad
    f.pilot.run(2.0)
    assert abs(wrap_pi(f.body.yaw_rad - yaw)) < radians(2)


def test_without_a_yaw_an_arducopter_looks_where_it_flies_and_a_px4_where_it_looked() -> None:
    looked = {}
    for firmware in ("px4", "ardupilot"):
        f = flight(firmware)
        f.stream(2.0, VELOCITY | YAW)
        f.stream(6.0, VELOCITY, vy=2.0)
        looked[firmware] = degrees(f.body.yaw_rad)
    assert abs(looked["px4"]) < 3 and abs(looked["ardupilot"] - 90) < 5


@BOTH
def test_it_flies_no_faster_than_its_parameters_say(firmware: str) -> None:
    f = flight(firmware)
    f.stream(12.0, POSITION, x=400.0, z=-10.0)
    top = f.vehicle.params["MPC_XY_VEL_MAX"] if firmware == "px4" else f.vehicle.params["WPNAV_SPEED"] / 100
    assert top - 1.5 < f.body.groundspeed_mps < top + 0.3
    assert hypot(f.body.east_m, 0.0) < 0.5


@BOTH
def test_targets_take_over_a_vehicle_that_leans_against_the_wind_without_a_jolt(firmware: str) -> None:
    pilot = Pilot(px4() if firmware == "px4" else copter())
    pilot.hovering()
    f = Flight(pilot, pilot.vehicles[0])
    f.body.wind.mean_enu_mps = (5.0, 0.0, 0.0)
    pilot.run(30.0)
    place, farthest = f.body.east_m, 0.0
    f.send(POSITION, y=0.0, z=-10.0)
    assert firmware == "ardupilot" or pilot.command(mav.MAV_CMD_DO_SET_MODE, 1, 6) == 0
    for _ in range(25):
        f.stream(0.2, POSITION, y=0.0, z=-10.0)
        farthest = max(farthest, abs(f.body.east_m - place))
    assert farthest < 0.12


@BOTH
def test_wind_does_not_jolt_it_when_targets_end(firmware: str) -> None:
    f = flight(firmware)
    f.body.wind.mean_enu_mps = (5.0, 0.0, 0.0)
    f.stream(20.0, POSITION | VELOCITY, z=-10.0)
    assert f.pilot.command(mav.MAV_CMD_DO_SET_MODE, 1, *((4, 3) if firmware == "px4" else (5,))) == 0
    place = f.body.east_m
    for _ in range(30):
        f.pilot.run(0.1)
        assert abs(f.body.east_m - place) < 0.3


def test_a_gain_that_is_set_in_flight_counts_at_once() -> None:
    behind: dict[float, float] = {}
    for gain in (0.95, 1.9):
        f = flight("px4")
        f.pilot.send(mav.MAVLink_param_set_message(1, 1, b"MPC_XY_P", gain, 9))
        for i in range(60):
            f.send(POSITION, x=0.2 * i, z=-10.0)
            f.pilot.run(0.1, step_s=0.02)
        behind[gain] = 0.2 * 60 - f.body.north_m
    assert behind[1.9] < 0.7 * behind[0.95]


# -- the controllers by themselves

WILD = st.sampled_from([None, 0.0, 1.0, -1.0, 1e6, -3e38, 3e38]) | st.floats(-50, 50)
LIMITS = Limits(speed_mps=10.0, accel_mps2=2.5, climb_mps=2.5, descent_mps=1.5)


def groups() -> st.SearchStrategy[tuple[float | None, float | None, float | None]]:
    return st.tuples(WILD, WILD, WILD)


@given(
    targets=st.lists(st.tuples(groups(), groups(), groups(), WILD, WILD), min_size=1, max_size=4),
    begin=st.tuples(*[st.floats(-30, 30)] * 6),
)
@settings(max_examples=examples(150), deadline=None)
def test_whatever_a_px4_is_given_its_acceleration_stays_within_lean_and_thrust(
    targets: list[Any], begin: tuple[float, ...]
) -> None:
    control, motion = Px4PositionControl(px4().control_gains()), flying(begin)
    for target in targets:
        for _ in range(20):
            asked = control.step(motion, 0.02, PositionTarget(*target), LIMITS)
            assert hypot(*asked.acc_enu_mps2[:2]) <= control.gains.accel_max_mps2 * 1.001
            assert -9.82 <= asked.acc_enu_mps2[2] <= 12.0
            motion.step(0.02, asked, LIMITS)
        assert all(map(isfinite, (*motion.pos_enu_m, *motion.vel_enu_mps, motion.yaw_rad)))


@given(
    targets=st.lists(st.tuples(st.integers(1, 7), groups(), groups(), groups(), WILD, WILD), min_size=1, max_size=4),
    begin=st.tuples(*[st.floats(-30, 30)] * 6),
)
@settings(max_examples=examples(150), deadline=None)
def test_whatever_an_arducopter_is_given_its_acceleration_stays_within_lean_and_thrust(
    targets: list[Any], begin: tuple[float, ...]
) -> None:
    control, motion = CopterPositionControl(copter().control_gains()), flying(begin)
    for take, pos, vel, acc, yaw, rate in targets:
        whole = [
            tuple(value or 0.0 for value in group) if take >> i & 1 else NO_AXES
            for i, group in enumerate((pos, vel, acc))
        ]
        target = PositionTarget(*whole, yaw, rate)
        for i in range(20):
            if i == 15:
                control.cease()
            asked = control.step(motion, 0.02, target, LIMITS)
            assert hypot(*asked.acc_enu_mps2[:2]) <= control.gains.accel_max_mps2 * 1.001
            assert abs(asked.acc_enu_mps2[2]) <= 9.82
            motion.step(0.02, asked, LIMITS)
        assert all(map(isfinite, (*motion.pos_enu_m, *motion.vel_enu_mps, motion.yaw_rad)))


def flying(begin: tuple[float, ...]) -> Motion:
    motion = Motion()
    motion.east_m, motion.north_m, motion.up_m, motion.vel_e_mps, motion.vel_n_mps, motion.vel_u_mps = begin
    motion.up_m = abs(motion.up_m) + 1.0
    return motion
