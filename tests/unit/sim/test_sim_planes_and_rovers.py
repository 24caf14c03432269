"""Simulated planes and a rover: modes, refusals and motion, by pymavlink's tables and by what a wing can do."""

from __future__ import annotations

import math
from collections.abc import Callable

import pytest
from pymavlink import mavutil
from pymavlink.dialects.v20 import ardupilotmega as mav

from skygcs.config.dialects import load_dialect
from skygcs.sim.body import GRAVITY_MPS2
from skygcs.sim.command_message import Command
from skygcs.sim.courses import CoursePlan, Turning
from skygcs.sim.kinematics import CourseSetpoint, Limits, LocalFrame
from skygcs.sim.legs import ClimbOut, Course, Glide, GoTo, Land, Stay, Wait
from skygcs.sim.plane import PlaneMode
from skygcs.sim.rover import RoverMode
from skygcs.sim.vehicle import SimVehicle
from skygcs.sim.vehicle_group import KINDS, make_vehicles
from skygcs.sim.wings_and_wheels import Rover, Wing, turn_limit_radps
from support.table import each

NAN = math.nan
TICK_S = 0.02
ACCEPTED, DENIED, UNSUPPORTED, FAILED = 0, 2, 3, 4


class Simulated:
    """One vehicle that has lived until its estimator is ready."""

    def __init__(self, kind: str) -> None:
        dialect = load_dialect("ardupilotmega")
        counts = dict.fromkeys(KINDS, 0) | {kind: 1}
        (self.sim,) = make_vehicles(dialect, first_sysid=1, home=LocalFrame(43.78, -79.46, 180.0), **counts)
        self.now = 0.0
        self.live(12.0)

    def live(self, seconds: float) -> None:
        self.now += seconds
        self.sim.step(self.now)

    def until(self, condition: Callable[[SimVehicle], bool], limit_s: float) -> None:
        end = self.now + limit_s
        while not condition(self.sim):
            assert self.now < end, (self.sim.mode, self.sim.motion.pos_enu_m, self.sim.plan.leg)
            self.live(0.2)

    def command(self, number: int, *params: float, place: tuple[float, float] | None = None, frame: int = 3) -> int:
        p1, p2, p3, p4, p5, p6, p7 = (*params, *[0.0] * 7)[:7]
        lat, lon = (NAN, NAN) if place is None else self.sim.where.to_geodetic(*place)
        given = None if place is None else frame
        result = self.sim.command(Command(number, p1, p2, p3, p4, p5, p6, p7, lat, lon, given, (255, 190)), self.now)
        assert result is not None
        return result


@each(("modes", "mav_type"), [(PlaneMode, mav.MAV_TYPE_FIXED_WING), (RoverMode, mav.MAV_TYPE_GROUND_ROVER)])
def test_modes_have_the_numbers_that_pymavlink_knows(modes: type[PlaneMode] | type[RoverMode], mav_type: int) -> None:
    theirs = mavutil.mode_mapping_bynumber(mav_type)
    assert {mode.value: mode.name for mode in modes} == {mode.value: theirs[mode.value] for mode in modes}


@each("kind", ["rover", "ardupilot_plane"])
def test_every_mode_is_entered_while_disarmed_or_refused_with_a_reason(kind: str) -> None:
    known = Simulated(kind)
    for mode, rule in known.sim.firmware.modes.simulated.items():
        assert known.command(mav.MAV_CMD_DO_SET_MODE, 1, mode) == (ACCEPTED if rule.by_command else FAILED)
    assert known.command(mav.MAV_CMD_DO_SET_MODE, 1, 17) == FAILED  # a copter's BRAKE, a QuadPlane's QSTABILIZE
    assert known.command(mav.MAV_CMD_DO_SET_MODE, 1, NAN) == DENIED


def test_an_arduplane_does_not_arm_in_its_return_and_has_no_auto_without_a_mission() -> None:
    """Seen of ArduPlane 4.6.3: "Arm: RTL mode not armable"; AUTO, and "Mission complete, changing mode to RTL"."""
    known = Simulated("ardupilot_plane")
    assert known.command(mav.MAV_CMD_DO_SET_MODE, 1, PlaneMode.AUTO) == ACCEPTED
    assert known.sim.mode == PlaneMode.RTL
    assert known.command(mav.MAV_CMD_COMPONENT_ARM_DISARM, 1) == FAILED
    assert known.command(mav.MAV_CMD_DO_SET_MODE, 1, PlaneMode.GUIDED) == ACCEPTED
    assert known.command(mav.MAV_CMD_COMPONENT_ARM_DISARM, 1) == ACCEPTED


def test_a_rover_knows_no_take_off_and_no_landing() -> None:
    """Neither is a case of Rover's handle_command_int_packet."""
    rover = Simulated("rover")
    for command in (mav.MAV_CMD_NAV_TAKEOFF, mav.MAV_CMD_NAV_LAND, mav.MAV_CMD_CONDITION_YAW):
        assert rover.command(command, 0, 0, 0, 0, 0, 0, 5) == UNSUPPORTED
    assert rover.command(mav.MAV_CMD_DO_SET_MODE, 1, RoverMode.RTL) == ACCEPTED
    assert rover.command(mav.MAV_CMD_COMPONENT_ARM_DISARM, 1) == FAILED  # ModeRTL does not allow arming
    assert rover.command(mav.MAV_CMD_DO_SET_MODE, 1, RoverMode.AUTO) == ACCEPTED  # disarmed, also without a mission


def test_a_rover_shows_active_in_every_mode_but_hold_and_no_landed_state() -> None:
    rover = Simulated("rover")
    for mode, status in ((RoverMode.MANUAL, 4), (RoverMode.HOLD, 3), (RoverMode.GUIDED, 4)):
        rover.command(mav.MAV_CMD_DO_SET_MODE, 1, mode)
        assert (rover.sim.system_status, rover.sim.landed_state) == (status, mav.MAV_LANDED_STATE_UNDEFINED)


def test_an_arduplane_has_a_quadplanes_take_off_only_and_no_landing_but_its_missions() -> None:
    plane = Simulated("ardupilot_plane")
    assert plane.command(mav.MAV_CMD_NAV_TAKEOFF, 0, 0, 0, 0, 0, 0, 50) == FAILED
    assert plane.command(mav.MAV_CMD_NAV_LAND) == UNSUPPORTED
    assert plane.command(mav.MAV_CMD_DO_LAND_START) == FAILED


@each("place", [(NAN, 0.0), (0.0, NAN), (1e9, 0.0)])
def test_a_place_that_is_none_moves_nothing(place: tuple[float, float]) -> None:
    for kind in ("rover", "ardupilot_plane"):
        known = Simulated(kind)
        known.command(mav.MAV_CMD_COMPONENT_ARM_DISARM, 1)
        assert known.command(mav.MAV_CMD_DO_REPOSITION, -1, 1, 0, NAN, 0, 0, 50, place=place) == DENIED
        known.live(5.0)
        assert known.sim.motion.pos_enu_m == (0.0, 0.0, 0.0)


def test_a_plane_that_is_armed_in_guided_stays_on_the_ground() -> None:
    """Its throttle is suppressed until it moves or is 10 m high (servos.cpp: Plane::suppress_throttle)."""
    plane = Simulated("ardupilot_plane")
    plane.command(mav.MAV_CMD_DO_SET_MODE, 1, PlaneMode.GUIDED)
    assert plane.command(mav.MAV_CMD_COMPONENT_ARM_DISARM, 1) == ACCEPTED
    plane.command(mav.MAV_CMD_DO_REPOSITION, -1, 1, 0, NAN, 0, 0, 50, place=(100.0, 100.0))
    plane.live(20.0)
    assert plane.sim.motion.pos_enu_m == (0.0, 0.0, 0.0)


@each("kind", ["px4_plane", "ardupilot_plane"])
def test_a_reboot_in_the_air_lets_a_plane_glide_to_the_ground(kind: str) -> None:
    plane = Simulated(kind)
    if kind == "px4_plane":
        plane.command(mav.MAV_CMD_COMPONENT_ARM_DISARM, 1)
        plane.command(mav.MAV_CMD_NAV_TAKEOFF, 0, 0, 0, NAN, NAN, NAN, 220)
    else:
        plane.command(mav.MAV_CMD_DO_SET_MODE, 1, PlaneMode.TAKEOFF)
        plane.command(mav.MAV_CMD_COMPONENT_ARM_DISARM, 1)
    plane.until(lambda sim: sim.motion.up_m > 30, 60.0)
    plane.sim.faults.reboot = True
    plane.until(lambda sim: sim.motion.on_ground and sim.motion.groundspeed_mps == 0.0, 60.0)
    assert not plane.sim.armed and not plane.sim.motion.crashed


# -- bodies


def wing(speed_mps: float, up_m: float) -> Wing:
    body = Wing()
    body.up_m, body.vel_n_mps = up_m, speed_mps
    return body


LIMITS = Limits(15.0, 2.0, 3.0, 2.0, turn_limit_radps(15.0, math.radians(45)))


@each("radius_m", [80.0, -80.0, 40.0])
def test_a_wing_circles_on_its_radius_and_to_its_side(radius_m: float) -> None:
    body = wing(15.0, 50.0)
    setpoint = CourseSetpoint((300.0, 100.0, 60.0), circle_m=radius_m)
    for _ in range(round(90 / TICK_S)):
        body.step(TICK_S, setpoint, LIMITS)
    for _ in range(round(30 / TICK_S)):
        body.step(TICK_S, setpoint, LIMITS)
        assert math.hypot(body.east_m - 300.0, body.north_m - 100.0) == pytest.approx(abs(radius_m), rel=0.05)
        assert math.copysign(1.0, body.yaw_rate_radps) == math.copysign(1.0, radius_m)  # clockwise is positive
    assert body.up_m == pytest.approx(60.0, abs=0.5)
    assert math.tan(body.roll_rad) == pytest.approx(15.0**2 / (GRAVITY_MPS2 * radius_m), rel=0.1)


def test_a_wing_keeps_its_limits_wherever_it_is_sent() -> None:
    """Also to a circle that it cannot fly: it flies the tightest one that its bank allows."""
    for place in ((0.0, 0.0, 0.0), (-200.0, -5.0, 500.0), (1.0, 1.0, 51.0)):
        body = wing(15.0, 50.0)
        for circle_m in (0.0, 5.0):
            for _ in range(round(60 / TICK_S)):
                body.step(TICK_S, CourseSetpoint(place, circle_m=circle_m), LIMITS)
                assert body.groundspeed_mps == pytest.approx(15.0)
                assert abs(body.yaw_rate_radps) <= LIMITS.yaw_rate_radps + 1e-9
                assert -2.0 - 1e-9 <= body.vel_u_mps <= 3.0 + 1e-9
                assert body.up_m >= 0.0


def test_a_wing_on_the_ground_rolls_before_it_climbs() -> None:
    body = Wing()
    heights = []
    for _ in range(round(10 / TICK_S)):
        body.step(TICK_S, CourseSetpoint((None, None, 50.0), yaw_rad=0.0), LIMITS)
        heights.append((body.groundspeed_mps, body.up_m))
    assert all(up == 0.0 for speed, up in heights if speed < 0.7 * 15.0) and heights[-1][1] > 5.0


def test_a_rover_stops_at_its_place_however_it_stands_to_it() -> None:
    limits = Limits(2.0, 1.0, 1.0, 1.0, 3.0)
    for bearing_deg in range(0, 360, 30):
        for away_m in (1.0, 3.0, 30.0):
            body = Rover()
            east, north = away_m * math.sin(math.radians(bearing_deg)), away_m * math.cos(math.radians(bearing_deg))
            for _ in range(round(60 / TICK_S)):
                body.step(TICK_S, CourseSetpoint((east, north, 0.0), stops=True, reached_m=2.0), limits)
                assert body.groundspeed_mps <= 2.0 + 1e-9
            assert body.groundspeed_mps == 0.0
            assert math.hypot(body.east_m - east, body.north_m - north) <= 2.0


def test_legs_of_orders_become_courses() -> None:
    planes = CoursePlan(Wing, lambda: Turning(90.0, 60.0))
    rovers = CoursePlan(Rover, lambda: Turning(2.0))
    place, above = GoTo(10.0, 20.0, 30.0), GoTo(0.0, 0.0, 30.0, climb_mps=0.0)

    def of(plan: CoursePlan, *legs: object) -> list[object]:
        plan.fly(*legs)  # type: ignore[arg-type]
        return list(plan._legs)

    passing, circling = Course(10.0, 20.0, 30.0, 90.0), Course(10.0, 20.0, 30.0, 90.0, 60.0)
    assert of(planes, place) == [circling]
    assert of(planes, place, Wait(0.0)) == [passing]
    assert of(planes, place, Wait(5.0)) == [Stay(circling, 5.0)]
    assert of(planes, above, place) == [ClimbOut(0.0, 30.0), circling]
    assert of(planes, above, GoTo(0.0, 0.0, 30.0)) == [ClimbOut(0.0, 30.0)]
    assert of(planes, place, Land(10.0, 20.0, 1.0)) == [Glide(10.0, 20.0)]
    assert of(rovers, place) == [Course(10.0, 20.0, 30.0, 2.0, stops=True)]
    assert of(rovers, place, Wait(0.0)) == [Course(10.0, 20.0, 30.0, 2.0)]
    assert of(rovers, Land(10.0, 20.0, 1.0)) == []
