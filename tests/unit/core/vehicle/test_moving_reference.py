"""A stream's reference between its setpoints, what position control sends of it, and where it ends."""

from __future__ import annotations

import math
from typing import Any

import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from pymavlink.dialects.v20 import ardupilotmega as mav

from skygcs.core.control.cascade import Reference
from skygcs.core.control.control_fence import COPTER_BRAKING, PX4_BRAKING, BrakingLimits, Fence
from skygcs.core.control.guard import ControlMode
from skygcs.core.geo import Origin
from skygcs.core.vehicle import setpoint
from skygcs.core.vehicle.frames import GeodeticPosition, Setpoint
from skygcs.core.vehicle.offboard_entry import PX4_RESPONSE_S
from skygcs.core.vehicle.origin import METRES_PER_DEG, EstimatorOrigin
from skygcs.core.vehicle.setpoint_generator import Tick
from skygcs.errors import RefusedError
from support.table import each
from support.vehicles import ARDUPILOT, HOME, PX4
from unit.core.vehicle.test_offboard_controller import Flight, place, texts

KINDS = each("autopilot", [PX4, ARDUPILOT])
POSITION, VELOCITY, ATTITUDE = ControlMode.POSITION, ControlMode.VELOCITY, ControlMode.ATTITUDE
RTT_S = 0.2


def say(flight: Flight, message: Any) -> None:
    flight.vehicle.on_frame(flight.voice.say(message), flight.now)


def moving(flight: Flight, east_m: float, speed_mps: float, up_m: float = 10.0) -> None:
    """It is there, and flies to the east."""
    here = place(east_m, 0.0, up_m)
    lat, lon, alt = round(here.lat_deg * 1e7), round(here.lon_deg * 1e7), round(here.alt_amsl_m * 1000)
    speed = round(speed_mps * 100)
    say(flight, mav.MAVLink_global_position_int_message(1000, lat, lon, alt, round(up_m * 1000), 0, speed, 0, 0))


def origin_told(flight: Flight, *, north_m: float = 0.0) -> None:
    lat = round((HOME[0] + north_m / METRES_PER_DEG) * 1e7)
    say(flight, mav.MAVLink_gps_global_origin_message(lat, round(HOME[1] * 1e7), round(HOME[2] * 1000), 0))


def sent(tick: Tick) -> tuple[str, dict[str, Any]]:
    assert tick.message is not None, tick
    return tick.message


def flown_place_m(values: dict[str, Any]) -> tuple[float, float, float]:
    """East, north, up of the flight's start, which is 10 m above HOME, of a position target of either kind."""
    if "lat_int" not in values:
        return values["y"], values["x"], -values["z"] - 10.0
    east = (values["lon_int"] / 1e7 - HOME[1]) * math.cos(math.radians(HOME[0])) * 111_319.5
    return east, (values["lat_int"] / 1e7 - HOME[0]) * 111_132.0, values["alt"] - HOME[2] - 10.0


# --- the reference between setpoints


@given(*(st.tuples(*[st.floats(-5, 5)] * 3) for _ in range(2)), st.floats(0, 2), st.floats(0, 2))
def test_moved_on_twice_is_moved_on_once(
    vel: tuple[float, float, float], acc: tuple[float, float, float], t: float, u: float
) -> None:
    assume(sum(v * a for v, a in zip(vel, acc, strict=True)) >= 0.0)  # it does not slow down
    reference = Reference((1.0, 2.0, 3.0), 0.1, vel, acc, yaw_rate_radps=0.2)
    once, twice = reference.ahead(t + u), reference.ahead(t).ahead(u)
    assert twice.pos_enu_m == pytest.approx(once.pos_enu_m, abs=1e-3)
    assert twice.vel_enu_mps == pytest.approx(once.vel_enu_mps, abs=1e-3)
    assert twice.yaw_rad == pytest.approx(once.yaw_rad)


def test_a_reference_that_slows_down_stops_and_does_not_turn_back() -> None:
    reference = Reference(vel_enu_mps=(2.0, 0.0, 0.0), acc_enu_mps2=(-1.0, 0.0, 0.0))
    for t in (2.0, 3.0, 10.0):
        later = reference.ahead(t)
        assert later.pos_enu_m == pytest.approx((2.0, 0.0, 0.0)) and later.vel_enu_mps == pytest.approx((0.0, 0.0, 0.0))


def test_a_reference_without_a_velocity_stands_whatever_its_acceleration() -> None:
    reference = Reference((1.0, 0.0, 0.0), acc_enu_mps2=(3.0, 0.0, 0.0))
    assert reference.ahead(5.0) is reference


@each("control_mode", [ATTITUDE, VELOCITY, POSITION])
def test_between_setpoints_it_moves_on_in_every_control_mode_and_not_beyond_its_deadline(
    control_mode: ControlMode,
) -> None:
    flight = Flight().fly(control_mode)
    flight.pilot.follow(
        Setpoint(place(1.0, 0.0, 10.0), (2.0, 0.0, 0.0), (0.0, 1.0, 0.0), 0.3, yaw_rate_enu_radps=0.5),
        *(flight.now, flight.now + 0.5),
    )
    flight.tick(0.3)
    reference = flight.pilot.reference
    assert reference is not None
    assert reference.pos_enu_m == pytest.approx((1.6, 0.045, 0.0), abs=0.02)
    assert reference.vel_enu_mps == pytest.approx((2.0, 0.3, 0.0))
    assert reference.acc_enu_mps2 == (0.0, 1.0, 0.0)
    assert reference.yaw_rad == pytest.approx(0.45)
    assert flight.pilot._source.advance(flight.now + 9.0).pos_enu_m[0] == pytest.approx(2.0, abs=0.02)


def test_an_acceleration_reaches_the_law() -> None:
    """Dropped on its way it changed nothing that any test saw."""
    level, pushed = Flight().fly(ATTITUDE), Flight().fly(ATTITUDE)
    for flight, acc in ((level, None), (pushed, (2.0, 0.0, 0.0))):
        flight.pilot.follow(Setpoint(place(0.0, 0.0, 10.0), None, acc), flight.now, flight.now + 0.5)
        flight.tick()
    outputs = [flight.pilot._setpoints.output for flight in (level, pushed)]
    assert outputs[0] is not None and outputs[1] is not None
    weight = level.pilot.config.law.hover_thrust / 9.80665
    assert outputs[1].thrust_enu[0] - outputs[0].thrust_enu[0] == pytest.approx(2.0 * weight, rel=1e-3)


@KINDS
def test_what_is_entered_keeps_the_yaw(autopilot: int) -> None:
    flight = Flight(autopilot)
    flight.at(0.0, 0.0, 10.0, heading_cdeg=3000)
    flight.fly(POSITION)
    assert flight.pilot.reference is not None
    assert flight.pilot.reference.yaw_rad == pytest.approx(math.radians(60.0), abs=1e-6)
    _, values = sent(flight.tick(0.2))
    assert values["yaw"] == pytest.approx(math.radians(30.0), abs=1e-6)


# --- what position control sends


@KINDS
def test_a_place_at_rest_is_sent_as_a_place_alone(autopilot: int) -> None:
    flight = Flight(autopilot).fly(POSITION)
    origin_told(flight)
    for vel in (None, (0.0, 0.0, 0.0)):
        wanted = Setpoint(place(1.0, 0.0, 10.0), vel, (1.0, 0.0, 0.0))
        flight.pilot.follow(wanted, flight.now, flight.now + 1.0)
        name, values = sent(flight.tick(0.2))
        assert (name, values["type_mask"]) == ("SET_POSITION_TARGET_GLOBAL_INT", 0b1001_1111_1000)


def led(autopilot: int, *, origin: bool = True) -> tuple[str, dict[str, Any]]:
    """The setpoint 0.1 s after one of a stream, with a round trip of RTT_S."""
    flight = Flight(autopilot)
    flight.pilot.engage(POSITION, Fence(Origin(*HOME)))
    if origin:
        origin_told(flight)
    flight.tick()
    flight.pinged(RTT_S)
    flight.beat(flight.obeying)
    flight.pilot.entered()
    flight.tick(0.2)
    flight.pilot.follow(Setpoint(place(1.0, 0.0, 10.0), (2.0, 0.0, 0.0), (0.0, 1.0, 0.0)), flight.now, flight.now + 0.5)
    return sent(flight.tick(0.1))


def test_px4_is_sent_all_three_ahead_by_the_way_up_half_a_period_and_its_response() -> None:
    name, values = led(PX4)
    t = 0.1 + RTT_S / 2 + 0.1 + PX4_RESPONSE_S
    assert (name, values["type_mask"]) == ("SET_POSITION_TARGET_GLOBAL_INT", 0b1000_0000_0000)
    assert flown_place_m(values) == pytest.approx((1.0 + 2.0 * t, 0.5 * t * t, 0.0), abs=0.03)
    assert (values["vy"], values["vx"], values["vz"]) == pytest.approx((2.0, t, 0.0))
    assert (values["afy"], values["afx"], values["afz"]) == pytest.approx((0.0, 1.0, 0.0))


def test_arducopter_is_sent_all_three_in_its_own_frame_ahead_by_the_way_up() -> None:
    name, values = led(ARDUPILOT)
    t = 0.1 + RTT_S / 2  # it moves the place on itself
    assert (name, values["type_mask"]) == ("SET_POSITION_TARGET_LOCAL_NED", 0b1000_0000_0000)
    assert flown_place_m(values) == pytest.approx((1.0 + 2.0 * t, 0.5 * t * t, 0.0), abs=0.03)
    assert (values["vy"], values["vx"]) == pytest.approx((2.0, t)) and values["afx"] == pytest.approx(1.0)


def test_an_arducopter_whose_origin_is_not_known_is_sent_place_and_velocity() -> None:
    name, values = led(ARDUPILOT, origin=False)
    assert (name, values["type_mask"]) == (
        "SET_POSITION_TARGET_GLOBAL_INT",
        0b1001_1100_0000 & ~0b1000_0000_0000 | 0x800,
    )
    assert "afx" not in values and values["vy"] == pytest.approx(2.0)


def test_what_is_sent_ahead_is_bounded() -> None:
    flight = Flight().fly(POSITION)
    for _ in range(25):
        flight.pinged(4.0)
    flight.pilot.follow(Setpoint(place(0.0, 0.0, 10.0), (1.0, 0.0, 0.0)), flight.now, flight.now + 1.0)
    _, values = sent(flight.tick(0.2))
    assert flown_place_m(values)[0] == pytest.approx(0.2 + 1.0, abs=0.03)


@KINDS
def test_a_velocity_beside_a_place_closes_no_loop_on_the_ground(autopilot: int) -> None:
    """What is sent for the height does not depend on what the vehicle reports of it."""
    answers = []
    for up_m in (10.0, 13.0):
        flight = Flight(autopilot).fly(POSITION)
        flight.at(0.0, 0.0, up_m)
        wanted = Setpoint(place(0.0, 0.0, 13.0), (1.0, 0.0, 0.0), free_xy=True)
        flight.pilot.follow(wanted, flight.now, flight.now + 1.0)
        name, values = sent(flight.tick(0.2))
        assert name == "SET_POSITION_TARGET_GLOBAL_INT" and values["vz"] == 0.0
        answers.append((values["alt"], values["vy"]))
        # what follows a velocity is not sent ahead: when that ends, nothing has to be taken back
        assert flown_place_m(values)[0] == pytest.approx(0.2, abs=0.02)
    assert answers[0] == pytest.approx(answers[1], abs=1e-6)


def test_the_place_a_velocity_led_to_stays_near_a_vehicle_that_does_not_follow() -> None:
    flight = Flight().fly(POSITION)
    for _ in range(60):
        wanted = Setpoint(place(0.0, 0.0, 10.0), (3.0, 0.0, 0.0), free_xy=True)
        assert flight.pilot.follow(wanted, flight.now, flight.now + 1.0) is None
        flight.tick(0.2)
    assert 3.0 < flight.reference_enu_m()[0] < 2.0 + 3.0 * 0.3 + 9.0 / 6.0 + 0.7


# --- yaw rates


@KINDS
@each("control_mode", [VELOCITY, POSITION])
def test_a_yaw_rate_goes_out_clockwise_with_a_yaw_or_alone(autopilot: int, control_mode: ControlMode) -> None:
    flight = Flight(autopilot).fly(control_mode)
    for yaw, mask in ((0.0, 0), (None, 1 << 10)):
        wanted = Setpoint(place(0.0, 0.0, 10.0), (1.0, 0.0, 0.0), None, yaw, yaw_rate_enu_radps=0.5)
        flight.pilot.follow(wanted, flight.now, flight.now + 1.0)
        _, values = sent(flight.tick(0.1))
        assert values["yaw_rate"] == pytest.approx(-0.5)
        assert values["type_mask"] & (1 << 10 | 1 << 11) == mask
        assert ("yaw" in values) == (yaw is not None)


def test_after_a_yaw_rate_alone_it_keeps_the_yaw_it_has_by_then() -> None:
    flight = Flight().fly(POSITION)
    for _ in range(100):
        wanted = Setpoint(place(0.0, 0.0, 10.0), yaw_rate_enu_radps=1.0)
        flight.pilot.follow(wanted, flight.now, flight.now + 0.3)
        flight.tick(0.2)
    reference = flight.pilot.reference  # the vehicle never turned: the yaw does not run away from it
    assert reference is not None and abs(reference.yaw_rad - math.pi / 2) <= math.radians(60.0) + 1e-9
    flight.at(0.0, 0.0, 10.0, heading_cdeg=27000)
    ended = flight.tick(0.4)
    assert "setpoints ended" in texts(ended)
    assert flight.pilot.reference is not None
    assert math.remainder(flight.pilot.reference.yaw_rad - math.pi, math.tau) == pytest.approx(0.0, abs=1e-6)


# --- stopping


@each(("autopilot", "limits"), [(PX4, PX4_BRAKING), (ARDUPILOT, COPTER_BRAKING)])
def test_a_stream_that_ends_ends_where_the_vehicle_comes_to_rest(autopilot: int, limits: BrakingLimits) -> None:
    flight = Flight(autopilot).fly(VELOCITY)
    flight.pinged(RTT_S)
    flight.pinged(RTT_S)
    way_s = flight.pilot.delay.uplink_s
    assert way_s is not None and way_s > 0.04
    flight.pilot.follow(Setpoint(None, (3.0, 0.0, 0.0), free_xy=True, free_z=True), flight.now, flight.now + 0.2)
    moving(flight, 5.0, 3.0)
    ended = flight.tick(0.3, fresh=False)
    assert "setpoints ended" in texts(ended)
    assert flight.reference_enu_m()[0] == pytest.approx(
        5.0 + 3.0 * (0.3 + 2 * way_s) + 9.0 / (2 * limits.xy_mps2), abs=0.05
    )
    assert flight.pilot.reference is not None and not flight.pilot.reference.moves


def test_a_fall_to_position_under_a_velocity_stops_it_once_and_ahead() -> None:
    """Each further setpoint of the stream used to order another stop, farther on while no state came."""
    flight = Flight().fly(VELOCITY)
    velocity = Setpoint(None, (2.0, 0.0, 0.0), free_xy=True, free_z=True)
    flight.pilot.follow(velocity, flight.now, flight.now + 5.0)
    moving(flight, 5.0, 2.0)
    flight.tick(0.1, fresh=False)
    fell = flight.tick(0.45, fresh=False)
    assert flight.pilot.control_mode is POSITION and "velocity setpoints end" in texts(fell)
    stopped = flight.reference_enu_m()
    assert stopped[0] == pytest.approx(5.0 + 2.0 * 0.55 + 4.0 / 6.0, abs=0.1)
    for _ in range(5):
        refusal = flight.pilot.follow(velocity, flight.now, flight.now + 5.0)
        assert refusal is not None and "not flown" in refusal
        assert "velocity setpoints end" not in texts(flight.tick(0.2, fresh=False))
        assert flight.reference_enu_m() == stopped
    assert flight.pilot.follow(Setpoint(place(1.0, 0.0, 10.0)), flight.now, flight.now + 1.0) is None
    flight.pilot.want(VELOCITY)
    assert flight.pilot.follow(velocity, flight.now, flight.now + 5.0) is None


def test_where_it_would_come_to_rest_beyond_the_fence_it_stays_where_it_was() -> None:
    flight = Flight().fly(VELOCITY)
    moving(flight, 49.5, 3.0)
    flight.pilot.stay()
    assert flight.reference_enu_m()[0] == pytest.approx(49.5, abs=0.05)


# --- the fence


@each(("autopilot", "timeout_s", "a"), [(PX4, 1.0, 3.0), (ARDUPILOT, 3.0, 2.5)])
def test_a_velocity_towards_a_wall_counts_for_as_long_as_the_autopilot_goes_on_with_it(
    autopilot: int, timeout_s: float, a: float
) -> None:
    flight = Flight(autopilot).fly(VELOCITY)
    speed = 4.0
    free_m = 50.0 - 2.0 - speed * timeout_s - speed**2 / (2 * a)
    for at_m, vel, ok in (
        (free_m - 0.1, (speed, 0.0, 0.0), True),
        (free_m + 0.1, (speed, 0.0, 0.0), False),
        (free_m + 0.1, (-speed, speed, 0.0), True),
    ):
        with_place = Setpoint(place(at_m, 0.0, 10.0), vel)
        why = flight.pilot.follow(with_place, flight.now, flight.now + 0.5)
        assert (why is None) is ok, why
        if why is not None:
            assert f"{timeout_s:g} s after its last setpoint" in why and "x 48.1" in why
        flight.at(at_m, 0.0, 10.0)
        alone = Setpoint(None, vel, free_xy=True, free_z=True)
        assert (flight.pilot.follow(alone, flight.now, flight.now + 0.5) is None) is ok


def test_a_guid_timeout_that_is_known_is_the_one_that_counts() -> None:
    flight = Flight(ARDUPILOT).fly(VELOCITY)
    told = Setpoint(place(38.0, 0.0, 10.0), (4.0, 0.0, 0.0))
    assert flight.pilot.follow(told, flight.now, flight.now + 0.5) is not None
    say(flight, mav.MAVLink_param_value_message(b"GUID_TIMEOUT", 1.0, 9, 1, 0))
    assert flight.pilot.follow(told, flight.now, flight.now + 0.5) is None


def test_a_velocity_that_was_accepted_is_stopped_before_the_wall() -> None:
    flight = Flight().fly(VELOCITY)
    velocity = Setpoint(None, (4.0, 0.0, 0.0), free_xy=True, free_z=True)
    flight.at(40.0, 0.0, 10.0)
    assert flight.pilot.follow(velocity, flight.now, flight.now + 5.0) is None
    stopped = Tick()
    for step in range(20):
        moving(flight, 40.0 + 0.4 * step, 4.0)
        stopped = flight.tick(0.1, fresh=False)
        if stopped.events:
            break
    assert "out of the fence" in texts(stopped) and not flight.pilot.streaming
    assert flight.reference_enu_m()[0] < 50.0 and flight.tick(0.1).message is not None


# --- ArduCopter's local frame


def test_an_origin_is_used_while_nothing_speaks_against_it() -> None:
    flight = Flight(ARDUPILOT)
    origin = EstimatorOrigin(flight.vehicle)
    here = GeodeticPosition(HOME[0] + 1e-4, HOME[1], HOME[2] + 5.0)
    assert origin.local_enu_m(here) is None
    origin_told(flight)
    assert origin.local_enu_m(here) == pytest.approx((0.0, 1e-4 * METRES_PER_DEG, 5.0), abs=1e-3)
    origin_told(flight)
    assert origin.local_enu_m(here) is not None, "told again"
    origin_told(flight, north_m=3.0)
    assert origin.local_enu_m(here) is None and "moved by 3.0 m" in str(origin.distrusted)
    origin_told(flight)
    assert origin.local_enu_m(here) is None, "not in this flight"
    origin.begin()
    assert origin.local_enu_m(here) is not None


def test_an_origin_of_another_site_is_none() -> None:
    flight = Flight(ARDUPILOT)
    origin = EstimatorOrigin(flight.vehicle)
    origin_told(flight, north_m=25_000.0)
    assert origin.local_enu_m(GeodeticPosition(*HOME)) is None and "25 km" in str(origin.distrusted)


@each(("off_m", "trusted"), [(0.3, True), (2.0, False)])
def test_a_local_position_that_contradicts_the_one_on_earth_ends_it(off_m: float, trusted: bool) -> None:
    flight = Flight(ARDUPILOT)
    flight.at(3.0, -4.0, 10.0)
    position = flight.vehicle.telemetry("position")
    assert position is not None
    boot_ms = round(position["time_boot_s"] * 1000) + 100
    origin = EstimatorOrigin(flight.vehicle)
    origin_told(flight)
    say(flight, mav.MAVLink_local_position_ned_message(boot_ms, -4.0, 3.0 + off_m, -10.0, 0, 0, 0))
    assert (origin.local_enu_m(GeodeticPosition(*HOME)) is not None) is trusted


# --- what is refused


@each("rate", [math.nan, math.inf, 7.0])
def test_no_yaw_rate_that_is_none(rate: float) -> None:
    with pytest.raises(RefusedError, match="yaw rate"):
        setpoint.velocity_target((0, 0, 0), None, 0, yaw_rate_enu_radps=rate)
