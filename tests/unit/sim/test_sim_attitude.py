"""SET_ATTITUDE_TARGET on a simulated PX4 and ArduCopter: who takes what, what it does, and what its end does."""

from __future__ import annotations

from collections.abc import Callable
from math import cos, hypot, inf, isfinite, nan, pi, radians

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pymavlink.dialects.v20 import ardupilotmega as mav

from skygcs.core.geo import quaternion_from_euler
from skygcs.sim.ardupilot import CopterVehicle
from skygcs.sim.attitude_targets import copter_attitude, px4_attitude
from skygcs.sim.behaviours import PX4
from skygcs.sim.body import AttitudeSetpoint
from skygcs.sim.firmware_modes import CopterMode, Px4Mode
from support.sim_pilot import COPTER_GUIDED, Pilot, copter, int_param, px4, px4_mode
from support.table import each

ATTITUDE_AND_THRUST = 0b111
LEVEL = [1.0, 0.0, 0.0, 0.0]
CONTROLLERS_S = PX4.controllers_s.simulated
Message = mav.MAVLink_set_attitude_target_message


def target(
    thrust: float, roll: float = 0.0, pitch: float = 0.0, yaw: float = 0.0, mask: int = ATTITUDE_AND_THRUST
) -> Message:
    return raw_target(list(quaternion_from_euler(roll, pitch, yaw)), thrust, mask)


def raw_target(q: list[float], thrust: float, mask: int = ATTITUDE_AND_THRUST) -> Message:
    return mav.MAVLink_set_attitude_target_message(0, 1, 1, mask, q, 0.0, 0.0, 0.0, thrust)


def stream(pilot: Pilot, seconds: float, message: Message, rate_hz: float = 20.0) -> None:
    for _ in range(round(seconds * rate_hz)):
        pilot.send(message)
        pilot.run(1 / rate_hz, 0.05)


def hover_thrust(pilot: Pilot) -> float:
    """What holds the height at this battery's voltage."""
    motion = pilot.vehicles[0].motion
    stream(pilot, 0.1, target(0.45))
    return 0.45 * (15.6 / motion.supply_v) ** 2  # type: ignore[union-attr]  # a Quad here


def offboard(height_m: float = 10.0) -> Pilot:
    pilot = Pilot(px4())
    pilot.hovering(height_m)
    stream(pilot, 1.3, target(0.42))
    assert pilot.command(mav.MAV_CMD_DO_SET_MODE, 1, 6, 0) == 0
    return pilot


def guided(options: int = 0, height_m: float = 10.0) -> Pilot:
    pilot = Pilot(copter())
    pilot.get_ready()
    pilot.send(mav.MAVLink_param_set_message(1, 1, b"GUID_OPTIONS", options, mav.MAV_PARAM_TYPE_INT32))
    pilot.take_off(height_m)
    pilot.forget()
    return pilot


def guided_with_thrust() -> Pilot:
    return guided(options=8)


FLOAT = st.sampled_from([0.0, 1.0, -1.0, 0.5, nan, inf, -inf, 3e38]) | st.floats(width=32)


@given(q=st.lists(FLOAT, min_size=4, max_size=4), thrust=FLOAT, rate=FLOAT, mask=st.integers(0, 255))
def test_no_target_from_outside_is_anything_but_a_unit_attitude_with_a_bounded_thrust(
    q: list[float], thrust: float, rate: float, mask: int
) -> None:
    rates = {"body_roll_rate": rate, "body_pitch_rate": rate, "body_yaw_rate": rate}
    fields = {"q": q, "thrust": thrust, "type_mask": mask, **rates}
    for taken in (
        px4_attitude(fields),
        copter_attitude(fields, thrust_as_thrust=True, climb_mps=2.5, descent_mps=1.5, angle_boost=True),
        copter_attitude(fields, thrust_as_thrust=False, climb_mps=2.5, descent_mps=1.5),
    ):
        if isinstance(taken, AttitudeSetpoint):
            if taken.attitude_ned_frd is None:
                assert taken.rates_frd_radps is not None
            else:
                assert hypot(*taken.attitude_ned_frd) == pytest.approx(1.0)
            assert all(rate is None or isfinite(rate) for rate in taken.rates_frd_radps or ())
            assert taken.thrust is None or -1.0 <= taken.thrust <= 1.0
            assert -1.5 <= taken.climb_mps <= 2.5


# -- both


@each("start", [offboard, guided_with_thrust])
def test_thrust_is_thrust_and_a_lean_moves_it(start: Callable[[], Pilot]) -> None:
    pilot = start()
    motion = pilot.vehicles[0].motion
    thrust = hover_thrust(pilot)
    before = motion.pos_enu_m
    stream(pilot, 2.0, target(thrust, pitch=-radians(5)))
    assert motion.north_m - before[0] > 1.0, "nose north, nose down"
    assert abs(motion.east_m - before[0]) < 0.1
    assert motion.up_m == pytest.approx(before[2], abs=0.5)
    stream(pilot, 2.0, target(thrust + 0.05))
    assert motion.vel_u_mps > 1.0
    stream(pilot, 3.0, target(thrust, yaw=radians(60)))
    assert motion.heading_deg == pytest.approx(60, abs=1)
    assert pilot.last("ATTITUDE").yaw == pytest.approx(radians(60), abs=0.05)


def test_the_accelerometer_of_a_leaning_vehicle_feels_its_thrust_along_its_own_axis() -> None:
    pilot = guided_with_thrust()
    thrust = hover_thrust(pilot)
    stream(pilot, 0.6, target(thrust, roll=0.3, pitch=-0.2, yaw=0.2))
    pilot.command(mav.MAV_CMD_REQUEST_MESSAGE, 27)
    felt = pilot.last("RAW_IMU")
    assert (felt.xacc, felt.yacc) == pytest.approx((0, 0), abs=60), "milli-g; drag is what is left"
    assert felt.zacc == pytest.approx(-1000, abs=60)
    pilot.command(mav.MAV_CMD_REQUEST_MESSAGE, 74)
    assert pilot.last("VFR_HUD").throttle == round(100 * thrust / (cos(0.3) * cos(0.2))), "a copter boosts by the tilt"


def test_where_it_truly_is_agrees_with_what_it_tells() -> None:
    pilot = offboard()
    pilot.run(1.0)
    pilot.command(mav.MAV_CMD_REQUEST_MESSAGE, 33)
    told = pilot.last("GLOBAL_POSITION_INT")
    assert pilot.vehicles[0].true_position() == pytest.approx(
        (told.lat / 1e7, told.lon / 1e7, told.alt / 1e3), abs=2e-3
    )


# -- body rates

RATES_AND_THRUST = 128


def rates(roll: float, pitch: float, yaw: float, thrust: float, mask: int = RATES_AND_THRUST) -> Message:
    return mav.MAVLink_set_attitude_target_message(0, 1, 1, mask, LEVEL, roll, pitch, yaw, thrust)


@each("start", [offboard, guided_with_thrust, guided])
def test_rates_without_an_attitude_turn_it_and_what_they_have_turned_stays(start: Callable[[], Pilot]) -> None:
    pilot = start()
    motion = pilot.vehicles[0].motion
    thrust = 0.5 if start is guided else hover_thrust(pilot)
    stream(pilot, CONTROLLERS_S, rates(0.0, 0.0, 0.0, thrust))
    stream(pilot, 0.5, rates(0.4, -0.2, 0.0, thrust))
    stream(pilot, 0.5, rates(0.0, 0.0, 0.0, thrust))
    assert (motion.roll_rad, motion.pitch_rad) == pytest.approx((0.2, -0.1), abs=0.02)
    stream(pilot, 0.5, rates(-0.4, 0.2, 0.0, thrust))
    stream(pilot, 0.5, rates(0.0, 0.0, 0.0, thrust))
    assert (motion.roll_rad, motion.pitch_rad) == pytest.approx((0.0, 0.0), abs=0.02)
    stream(pilot, 2.0, rates(0.0, 0.0, 0.5, thrust))
    assert motion.yaw_rad == pytest.approx(1.0, abs=0.06)
    assert motion.vel_n_mps > 0.2 and motion.vel_e_mps > 0.4, "nobody stops it"


def test_no_rates_at_all_are_rates_of_nothing_for_a_copter_and_no_target_for_a_px4() -> None:
    pilot = guided()
    stream(pilot, 0.5, rates(0.0, -0.2, 0.0, 0.5))
    stream(pilot, 2.0, rates(1.0, 1.0, 1.0, 0.5, mask=RATES_AND_THRUST | 0b111))
    assert pilot.vehicles[0].motion.pitch_rad == pytest.approx(-0.1, abs=0.02)
    for ignored in (0b001, 0b010, 0b111):
        pilot = offboard()
        pilot.vehicles[0].params.set("COM_OBL_RC_ACT", int_param(5))
        stream(pilot, 1.5, rates(0.0, 0.0, 0.0, 0.42, mask=RATES_AND_THRUST | ignored))
        assert px4_mode(pilot) == Px4Mode.LOITER


def test_a_px4_goes_on_turning_when_the_yaw_rate_alone_is_ignored() -> None:
    pilot = offboard()
    thrust = hover_thrust(pilot)
    stream(pilot, 1.0, rates(0.0, 0.0, 0.5, thrust))
    before = pilot.vehicles[0].motion.yaw_rad
    stream(pilot, 1.0, rates(0.0, 0.0, -1.0, thrust, mask=RATES_AND_THRUST | 0b100))
    assert pilot.vehicles[0].motion.yaw_rad - before == pytest.approx(0.5, abs=0.05)


def test_rates_that_nobody_renews_end_level_and_without_climb() -> None:
    pilot = guided()
    motion = pilot.vehicles[0].motion
    stream(pilot, 0.3, rates(0.0, -0.1, 0.0, 0.6))
    pilot.run(2.5)
    assert motion.pitch_rad < -0.2, "3 s of GUID_TIMEOUT at this rate"
    pilot.run(3.0)
    assert motion.pitch_rad == pytest.approx(0.0, abs=0.01)
    assert motion.vel_u_mps == pytest.approx(0.0, abs=0.1)


def test_an_attitude_turns_on_with_its_rates_on_a_copter_and_not_on_a_px4() -> None:
    for start, turned in ((guided, 0.5), (offboard, 0.0)):
        pilot = start()
        thrust = 0.5 if start is guided else hover_thrust(pilot)
        message = mav.MAVLink_set_attitude_target_message(0, 1, 1, 0, LEVEL, 0.0, 0.0, 0.5, thrust)
        pilot.send(message)
        pilot.run(0.9)
        assert pilot.vehicles[0].motion.yaw_rad == pytest.approx(turned, abs=0.12), start.__name__


@each("start", [offboard, guided])
def test_an_attitude_with_its_yaw_rate_is_followed_without_lag(start: Callable[[], Pilot]) -> None:
    pilot = start()
    thrust = 0.5 if start is guided else hover_thrust(pilot)
    behind = {}
    for rate in (0.0, 0.5):
        for i in range(60):
            q = list(quaternion_from_euler(0.0, 0.0, 0.025 * i))
            pilot.send(mav.MAVLink_set_attitude_target_message(0, 1, 1, 0, q, 0.0, 0.0, rate, thrust))
            pilot.run(0.05, 0.05)
        behind[rate] = (0.025 * 60 - pilot.vehicles[0].motion.yaw_rad + pi) % (2 * pi) - pi
        stream(pilot, 4.0, target(thrust))
    assert abs(behind[0.5]) < 0.03 < 0.06 < behind[0.0]


# -- PX4


@each("ordered", [False, True])
def test_a_px4_flies_another_kind_of_target_from_its_next_status_on(ordered: bool) -> None:
    """Twice a second, or with whatever is ordered. Until then it leans on, and nobody controls the position."""
    pilot = offboard()
    thrust = hover_thrust(pilot)
    stream(pilot, 0.55 + CONTROLLERS_S, target(thrust, roll=0.2))
    place = mav.MAVLink_set_position_target_local_ned_message(0, 1, 1, 1, 0xDF8, 0, 0, -10, *[0] * 8)
    if ordered:
        pilot.send(place)
        pilot.command(mav.MAV_CMD_DO_SET_MODE, 1, 6, 0)
    stream(pilot, 0.3, place)
    assert (pilot.vehicles[0].motion.roll_rad > 0.15) != ordered
    stream(pilot, 0.5, place)
    assert pilot.vehicles[0].motion.roll_rad < 0.1


@each("q", [[nan] * 4, [0.0] * 4])
def test_nothing_controls_the_attitude_of_a_px4_that_is_given_no_rotation(q: list[float]) -> None:
    """As flown with 1.16.1: it stays in OFFBOARD and drifts with the lean and the turn that it has."""
    pilot = offboard()
    thrust = hover_thrust(pilot)
    stream(pilot, 0.6, target(thrust, roll=0.1))
    stream(pilot, 2.0, raw_target(q, thrust))
    motion = pilot.vehicles[0].motion
    assert px4_mode(pilot) == Px4Mode.OFFBOARD
    assert motion.roll_rad > 0.08 and motion.vel_e_mps > 1.5


def test_a_px4_falls_with_a_thrust_that_is_no_number() -> None:
    pilot = offboard()
    up = pilot.vehicles[0].motion.up_m
    stream(pilot, 0.7, raw_target(LEVEL, nan))
    assert up - pilot.vehicles[0].motion.up_m > 1.0 and px4_mode(pilot) == Px4Mode.OFFBOARD


def test_px4_has_no_thrust_where_a_message_ignores_it() -> None:
    """vehicle_attitude_setpoint begins with zeros."""
    pilot = offboard()
    stream(pilot, 0.5, target(hover_thrust(pilot)))
    up = pilot.vehicles[0].motion.up_m
    stream(pilot, 1.0, target(0.45, mask=ATTITUDE_AND_THRUST | 64))
    assert up - pilot.vehicles[0].motion.up_m > 2.5, "it falls"


def test_px4_lifts_off_and_lands_on_thrust_alone() -> None:
    pilot = Pilot(px4())
    pilot.get_ready()
    stream(pilot, 1.3, target(0.0))
    assert pilot.command(mav.MAV_CMD_DO_SET_MODE, 1, 6, 0) == 0
    assert pilot.command(mav.MAV_CMD_COMPONENT_ARM_DISARM, 1) == 0
    stream(pilot, 2.0, target(0.2, roll=0.2))
    assert pilot.vehicles[0].motion.pos_enu_m == (0.0, 0.0, 0.0)
    stream(pilot, 3.0, target(0.5))
    assert pilot.vehicles[0].motion.up_m > 1.0
    stream(pilot, 15.0, target(0.36))
    assert pilot.vehicles[0].landed and not pilot.vehicles[0].armed


# -- ArduCopter


def test_without_the_option_the_thrust_is_a_climb_rate() -> None:
    pilot = guided()
    motion = pilot.vehicles[0].motion
    stream(pilot, 3.0, target(0.5))
    assert motion.up_m == pytest.approx(10.0, abs=0.1), "half holds the height, whatever carries the weight"
    stream(pilot, 4.0, target(1.0))
    assert motion.vel_u_mps == pytest.approx(2.5, abs=0.1), "WPNAV_SPEED_UP"
    stream(pilot, 4.0, target(0.25))
    assert motion.vel_u_mps == pytest.approx(-0.75, abs=0.1), "half of WPNAV_SPEED_DN"
    stream(pilot, 2.0, target(0.5, pitch=-0.2))
    assert motion.vel_n_mps > 2.0
    assert motion.vel_u_mps == pytest.approx(0.0, abs=0.1), "leaning costs no height"


@each("options", [0, 8])
def test_up_to_4_0_an_attitude_nobody_renews_for_a_second_ends_level_and_without_climb(options: int) -> None:
    pilot = guided(options)
    vehicle = pilot.vehicles[0]
    assert isinstance(vehicle, CopterVehicle)
    vehicle.attitude_timeout_s = 1.0
    stream(pilot, 1.5, target(0.6, pitch=-0.15))
    pilot.run(0.9)
    assert vehicle.motion.pitch_rad == pytest.approx(-0.15, abs=0.01)
    pilot.run(10.0)
    assert (vehicle.motion.pitch_rad, vehicle.motion.roll_rad) == pytest.approx((0.0, 0.0), abs=0.01)
    assert vehicle.motion.vel_u_mps == pytest.approx(0.0, abs=0.3)
    assert vehicle.motion.vel_n_mps > 0.3, "level is not still"
    assert vehicle.mode == CopterMode.GUIDED


def test_from_4_1_on_the_timeout_is_that_of_guid_timeout() -> None:
    pilot = guided()
    vehicle = pilot.vehicles[0]
    stream(pilot, 1.0, target(0.5, pitch=-0.15))
    pilot.run(2.8)
    assert vehicle.motion.pitch_rad == pytest.approx(-0.15, abs=0.01)
    pilot.run(1.5)
    assert vehicle.motion.pitch_rad == pytest.approx(0.0, abs=0.01)


@each(
    "bad",
    [
        target(0.8, mask=ATTITUDE_AND_THRUST | 64),
        raw_target([1.01, 0.0, 0.0, 0.0], 0.8),
        raw_target([nan, 0.0, 0.0, 0.0], 0.8),
    ],
)
def test_a_target_that_4_6_passes_over_leaves_the_last_attitude_until_guid_timeout(bad: Message) -> None:
    """From 4.7 on it stops at once (mode_guided.init)."""
    pilot = guided()
    motion = pilot.vehicles[0].motion
    stream(pilot, 2.0, target(0.5, pitch=-0.1))
    stream(pilot, 2.8, bad)
    assert motion.pitch_rad == pytest.approx(-0.1, abs=0.01)
    stream(pilot, 1.5, bad)
    assert motion.pitch_rad == pytest.approx(0.0, abs=0.01)


def test_one_rate_of_three_makes_it_stop_and_hold() -> None:
    pilot = guided()
    motion = pilot.vehicles[0].motion
    stream(pilot, 2.0, target(0.5, pitch=-0.1))
    assert motion.vel_n_mps > 1.0
    stream(pilot, 8.0, target(0.8, mask=0b011))
    assert motion.groundspeed_mps < 0.1
    assert motion.up_m == pytest.approx(10.0, abs=0.3)


def test_a_thrust_that_is_no_number_is_the_middle_of_its_range() -> None:
    """constrain_float: no climb, but no thrust either where thrust is thrust."""
    pilot = guided()
    stream(pilot, 3.0, raw_target(LEVEL, nan))
    assert pilot.vehicles[0].motion.up_m == pytest.approx(10.0, abs=0.2)
    pilot = guided_with_thrust()
    stream(pilot, 1.0, raw_target(LEVEL, nan))
    assert pilot.vehicles[0].motion.up_m < 8.0


def test_attitudes_do_nothing_outside_guided_or_during_the_take_off() -> None:
    pilot = Pilot(copter())
    pilot.get_ready()
    pilot.command(mav.MAV_CMD_DO_SET_MODE, 1, COPTER_GUIDED)
    pilot.command(mav.MAV_CMD_COMPONENT_ARM_DISARM, 1)
    pilot.command(mav.MAV_CMD_NAV_TAKEOFF, 0, 0, 0, 0, 0, 0, 10.0)
    stream(pilot, 6.0, target(0.0, pitch=0.3))
    motion = pilot.vehicles[0].motion
    assert motion.up_m > 5.0 and motion.pitch_rad == 0.0
    pilot.run(10.0)
    pilot.command(mav.MAV_CMD_DO_SET_MODE, 1, CopterMode.LOITER)
    pilot.run(5.0)
    before = motion.pos_enu_m
    stream(pilot, 5.0, target(0.9, pitch=0.3))
    assert motion.pos_enu_m == pytest.approx(before, abs=0.2)


def test_an_attitude_with_a_climb_lifts_it_off_the_ground() -> None:
    pilot = Pilot(copter())
    pilot.get_ready()
    pilot.command(mav.MAV_CMD_DO_SET_MODE, 1, COPTER_GUIDED)
    pilot.command(mav.MAV_CMD_COMPONENT_ARM_DISARM, 1)
    pilot.run(3.0)
    stream(pilot, 2.0, target(0.5))
    assert pilot.vehicles[0].motion.on_ground
    stream(pilot, 4.0, target(0.8))
    assert pilot.vehicles[0].motion.up_m > 1.0


@each(("boost", "thrust"), [(True, 0.6), (False, 0.3)])
def test_a_copter_divides_thrust_by_the_cosine_of_the_tilt_unless_told_not_to(boost: bool, thrust: float) -> None:
    rates = {"body_roll_rate": 0.0, "body_pitch_rate": 0.0, "body_yaw_rate": 0.0}
    fields = {
        "q": list(quaternion_from_euler(radians(60), 0.0, 0.0)),
        "thrust": 0.3,
        "type_mask": ATTITUDE_AND_THRUST,
        **rates,
    }
    taken = copter_attitude(fields, thrust_as_thrust=True, climb_mps=2.5, descent_mps=1.5, angle_boost=boost)
    assert isinstance(taken, AttitudeSetpoint)
    assert taken.thrust == pytest.approx(thrust)
