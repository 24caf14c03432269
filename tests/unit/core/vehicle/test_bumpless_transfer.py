"""Both ends of control by attitude: the integral it begins with, and the lean in which an ArduCopter is handed over."""

from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pymavlink.dialects.v20 import ardupilotmega as mav

from skygcs.core.control.cascade import Estimate, Memory, Vector
from skygcs.core.control.gains import GRAVITY_MPS2, ControlConfig
from skygcs.core.vehicle.decoding import Decoder
from skygcs.core.vehicle.reference_source import (
    BRAKING_MPS2,
    FRESH_S,
    THROTTLE_FRESH_S,
    SteadyThrust,
    handover_attitude,
)
from skygcs.core.vehicle.vehicle import Vehicle
from support.table import each
from support.vehicles import ARDUPILOT, PX4, Voice, flight_dialect

DECODER = Decoder(flight_dialect())
LAW = ControlConfig()


class Hovering:
    """A vehicle that reports its lean; ``at`` is the time."""

    def __init__(self, autopilot: int = PX4) -> None:
        self.at = 100.0
        self.vehicle = Vehicle(1, 1, flight_dialect(), name="alpha", decoder=DECODER)
        self.voice = Voice(1)
        self.vehicle.on_frame(self.voice.beat(autopilot, 0, armed=True, status=4), self.at)
        self.observed = SteadyThrust(self.vehicle)

    def hear(self, message: mav.MAVLink_message) -> None:
        self.vehicle.on_frame(self.voice.say(message), self.at)

    def lean(self, roll: float = 0.0, pitch: float = 0.0, yaw: float = 0.0, vel: Vector = (0.0, 0.0, 0.0)) -> None:
        self.hear(mav.MAVLink_attitude_message(0, roll, pitch, yaw, 0, 0, 0))
        self.observed.observe(LAW, Estimate((0.0, 0.0, 10.0), vel), self.at)

    def throttle(self, percent: int) -> None:
        self.hear(mav.MAVLink_vfr_hud_message(0, 0, 0, percent, 0, 0))

    def target(self, thrust: float) -> None:
        self.hear(mav.MAVLink_attitude_target_message(0, 0, [1, 0, 0, 0], 0, 0, 0, thrust))

    def integral(self) -> Vector:
        return self.observed.memory(LAW, self.at).integral_enu


def test_nothing_heard_is_nothing_remembered() -> None:
    assert Hovering().observed.memory(LAW, 100.0) == Memory()


@each(
    ("roll", "pitch", "yaw", "expected"),
    [
        (0.0, -0.1, 0.0, (0.0, 0.45 * math.sin(0.1))),  # nose down, heading north: pushes north
        (0.0, -0.1, math.pi / 2, (0.45 * math.sin(0.1), 0.0)),  # heading east: pushes east
        (0.1, 0.0, 0.0, (0.45 * math.sin(0.1), 0.0)),  # right side down, heading north: pushes east
        (0.1, 0.0, math.pi / 2, (0.0, -0.45 * math.sin(0.1))),
    ],
)
def test_the_lean_is_what_pushes_against_the_wind(
    roll: float, pitch: float, yaw: float, expected: tuple[float, float]
) -> None:
    here = Hovering()
    here.target(0.45)
    here.lean(roll, pitch, yaw)
    assert here.integral()[:2] == pytest.approx(expected, abs=1e-6)
    assert here.integral()[2] == pytest.approx(0.45 * math.cos(0.1) - 0.45, abs=1e-6)


def test_a_throttle_of_whole_percent_is_taken_in_their_middle() -> None:
    here = Hovering()
    here.throttle(38)
    here.lean()
    assert here.integral() == pytest.approx((0.0, 0.0, 0.385 - 0.45))


def test_a_target_counts_before_the_throttle_while_it_is_fresh() -> None:
    here = Hovering()
    here.target(0.40)
    here.throttle(30)
    here.lean()
    assert here.integral()[2] == pytest.approx(-0.05)
    here.at += THROTTLE_FRESH_S + 0.1
    here.throttle(30)
    here.lean()
    assert here.integral()[2] == pytest.approx(0.305 - 0.45)


@each("boosts", [True, False])
def test_arducopters_target_is_the_vertical_part_where_it_boosts(boosts: bool) -> None:
    here = Hovering(ARDUPILOT)
    if not boosts:
        here.hear(mav.MAVLink_param_value_message(b"ATC_ANGLE_BOOST", 0, 2, 1, 0))
    here.target(0.40)
    here.lean(pitch=-0.5)
    assert here.integral()[2] == pytest.approx(0.40 * (1.0 if boosts else math.cos(0.5)) - 0.45, abs=1e-6)


@each("throttle", [None, 0, 3, 120])
def test_without_a_throttle_the_lean_alone_counts(throttle: int | None) -> None:
    here = Hovering()
    if throttle is not None:
        here.throttle(throttle)
    here.lean(pitch=-0.1)
    assert here.integral() == pytest.approx((0.0, 0.45 * math.tan(0.1), 0.0), abs=1e-6)


def test_what_accelerated_it_is_not_wind() -> None:
    """Braking from 3 m/s at 2 m/s² for a second, in still air."""
    here, lean = Hovering(), math.atan(2.0 / GRAVITY_MPS2)
    here.target(0.45 / math.cos(lean))
    for n in range(11):
        here.lean(pitch=lean, vel=(0.0, 3.0 - 0.2 * n, 0.0))
        here.at += 0.1
    assert here.integral() == pytest.approx((0.0, 0.0, 0.0), abs=1e-6)


def test_what_is_old_does_not_count() -> None:
    here = Hovering()
    here.lean(pitch=-0.1)
    here.at += FRESH_S + 0.01
    assert here.integral() == (0.0, 0.0, 0.0)
    here.observed.observe(LAW, Estimate((0.0, 0.0, 10.0), (0.0, 0.0, 0.0)), here.at)
    assert here.integral() == (0.0, 0.0, 0.0), "the same attitude again is no new one"
    here.lean(pitch=-0.2)
    here.observed.forget()
    assert here.integral() == (0.0, 0.0, 0.0)


def test_a_lean_that_is_no_hover_does_not_count() -> None:
    here = Hovering()
    here.lean(pitch=1.2)
    here.lean(roll=3.1)
    here.lean(roll=math.nan)
    assert here.integral() == (0.0, 0.0, 0.0)


number = st.floats(width=32)


@given(
    st.lists(st.tuples(number, number, number, number, st.integers(0, 65535), number, st.floats(-3, 3)), max_size=20)
)
def test_whatever_is_heard_stays_within_the_laws_limits(
    heard: list[tuple[float, float, float, float, int, float, float]],
) -> None:
    here = Hovering()
    for roll, pitch, yaw, thrust, percent, speed, wait in heard:
        here.at += wait
        here.target(thrust)
        here.throttle(percent)
        here.lean(roll, pitch, yaw, (speed, 0.0, -speed))
        east, north, up = here.integral()
        assert math.hypot(east, north) <= LAW.integral_xy_max + 1e-9 and abs(up) <= LAW.thrust_max


# --- handover attitude ------------------------------------------------------------------------------------------------


def acceleration(attitude_ned_frd: tuple[float, float, float, float], thrust: float) -> tuple[float, float, float]:
    """East, north, up, of the thrust along the body's axis and gravity."""
    w, x, y, z = attitude_ned_frd
    north, east, down = 2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y)
    push = GRAVITY_MPS2 * thrust / LAW.hover_thrust
    return -east * push, -north * push, down * push - GRAVITY_MPS2


@each("yaw_rad", [0.0, 1.0, -2.5])
def test_a_fast_one_is_braked_with_what_the_autopilot_brakes_with(yaw_rad: float) -> None:
    east, north, up = acceleration(*handover_attitude(LAW, (0.0, 0.0, 0.0), (3.0, -4.0, 2.0), yaw_rad, 1.0))
    assert (east, north, up) == pytest.approx((-0.6 * BRAKING_MPS2, 0.8 * BRAKING_MPS2, 0.0), abs=1e-9)


def test_a_slow_one_only_to_a_standstill_by_the_time_it_levels() -> None:
    east, north, _ = acceleration(*handover_attitude(LAW, (0.0, 0.0, 0.0), (0.6, 0.0, 0.0), 0.4, 1.0))
    assert (east, north) == pytest.approx((-0.6, 0.0), abs=1e-9)
    east, _, _ = acceleration(*handover_attitude(LAW, (0.0, 0.0, 0.0), (0.6, 0.0, 0.0), 0.4, 3.0))
    assert east == pytest.approx(-0.2)


def test_one_that_stands_keeps_the_lean_against_the_wind_and_its_true_hover_thrust() -> None:
    weight = LAW.hover_thrust / GRAVITY_MPS2
    found = handover_attitude(LAW, (1.2 * weight, -0.5 * weight, 0.3 * weight), (0.0, 0.0, 0.0), 0.0, 1.0)
    assert acceleration(*found) == pytest.approx((1.2, -0.5, 0.3))


finite = st.floats(-100.0, 100.0)


@given(st.tuples(finite, finite, finite), st.tuples(finite, finite, finite), finite, st.floats(0.0, 60.0))
def test_it_is_within_the_law_s_limits_whatever_comes(
    integral: tuple[float, float, float], vel: tuple[float, float, float], yaw: float, timeout_s: float
) -> None:
    attitude, thrust = handover_attitude(LAW, integral, vel, yaw, timeout_s)
    assert math.isclose(sum(part * part for part in attitude), 1.0, abs_tol=1e-9)
    assert 0.0 < thrust <= LAW.thrust_max
    _, x, y, _ = attitude
    assert math.acos(max(-1.0, 1 - 2 * (x * x + y * y))) <= LAW.tilt_max_rad + 1e-9
