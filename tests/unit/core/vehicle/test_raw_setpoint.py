"""Raw setpoints: what they mean in the fleet's frame, their limits, and what forbids them to fly on."""

from __future__ import annotations

import math
from types import SimpleNamespace
from typing import Any, cast

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pymavlink.quaternion import QuaternionBase

from skygcs.core.geo import Origin
from skygcs.core.vehicle import setpoint
from skygcs.core.vehicle.raw_setpoint import RawLimits, RawSetpoint, RawSource, raw_from_world, up_part
from skygcs.core.vehicle.vehicle import Vehicle
from skygcs.errors import ConfigError, RefusedError
from support.table import each

NORTH_UP = Origin(47.4, 8.5, 400.0, x_heading_deg=90.0)
"""x is east."""

ANGLE = st.floats(-80, 80)


@given(ANGLE, ANGLE, st.floats(-180, 180), st.floats(0, 359))
def test_angles_are_those_of_the_autopilot(roll: float, pitch: float, yaw: float, heading: float) -> None:
    """Against pymavlink's conversion of Euler angles, which are FRD in NED: yaw clockwise from north."""
    origin = Origin(47.4, 8.5, 400.0, x_heading_deg=heading)
    raw = raw_from_world(origin, roll_deg=roll, pitch_deg=pitch, yaw_deg=yaw, thrust=0.5)
    compass = math.radians(heading - yaw)
    expected = QuaternionBase([math.radians(roll), math.radians(pitch), compass]).q
    assert raw.attitude_ned_frd is not None
    dot = abs(sum(a * b for a, b in zip(raw.attitude_ned_frd, expected, strict=True)))
    assert dot == pytest.approx(1.0, abs=1e-9)
    cosine = math.cos(math.radians(roll)) * math.cos(math.radians(pitch))
    assert up_part(raw.attitude_ned_frd) == pytest.approx(cosine, abs=1e-9)


def test_a_quaternion_is_the_attitude_of_its_angles() -> None:
    half = math.radians(20) / 2
    by_quaternion = raw_from_world(NORTH_UP, attitude=[math.cos(half), math.sin(half), 0.0, 0.0], thrust=0.4)
    by_angles = raw_from_world(NORTH_UP, roll_deg=20.0, pitch_deg=0.0, yaw_deg=0.0, thrust=0.4)
    assert by_quaternion.attitude_ned_frd == pytest.approx(by_angles.attitude_ned_frd)


@each(
    "wrong",
    [
        {},
        {"attitude": [1.0, 0.0, 0.0, 0.0]},
        {"attitude": [1.1, 0.0, 0.0, 0.0], "thrust": 0.5},
        {"attitude": [math.nan, 0.0, 0.0, 0.0], "thrust": 0.5},
        {"attitude": [1.0, 0.0, 0.0, 0.0], "thrust": math.nan},
        {"attitude": [1.0, 0.0, 0.0, 0.0], "thrust": 0.5, "yaw_deg": 1.0},
        {"roll_deg": 1.0, "pitch_deg": 1.0, "thrust": 0.5},
        {"roll_deg": math.inf, "pitch_deg": 1.0, "yaw_deg": 0.0, "thrust": 0.5},
        {"body_rates_deg_s": [1.0, 2.0], "thrust": 0.5},
        {"body_rates_deg_s": [1.0, 2.0, math.inf], "thrust": 0.5},
        {"body_rates_deg_s": [1.0, 2.0, 3.0]},
        {"body_rates_deg_s": [1.0, 2.0, 3.0], "thrust": 0.5, "yaw_deg": 3.0},
        {"acc_enu_mps2": [1.0, 2.0, math.nan]},
        {"acc_enu_mps2": [1.0, 2.0, 3.0], "thrust": 0.5},
        {"acc_enu_mps2": [1.0, 2.0, 3.0], "body_rates_deg_s": [1.0, 2.0, 3.0], "thrust": 0.5},
    ],
)
def test_what_cannot_be_meant_is_refused(wrong: dict[str, Any]) -> None:
    with pytest.raises(RefusedError):
        raw_from_world(NORTH_UP, **wrong)


def test_what_is_exactly_at_a_limit_is_flown() -> None:
    limits = RawLimits()
    for given_ in (
        {"roll_deg": 35.0, "pitch_deg": 0.0, "yaw_deg": 77.0, "thrust": 0.9},
        {"body_rates_deg_s": [180.0, -180.0, 180.0], "thrust": 0.1},
        {"acc_enu_mps2": [3.0, 4.0, 0.0]},
    ):
        assert raw_from_world(NORTH_UP, **given_).refusal(limits) is None  # type: ignore[arg-type]


@each(
    "wrong",
    [{"tilt_max_deg": 0.0}, {"thrust_min": 0.5, "thrust_max": 0.5}, {"acc_max_mps2": math.nan}, {"rate_max_deg_s": -1}],
)
def test_impossible_limits_are_an_error(wrong: dict[str, float]) -> None:
    with pytest.raises(ConfigError):
        RawLimits(**wrong)


def test_messages_give_nothing_but_what_was_asked_for() -> None:
    name, values = setpoint.body_rate_target((0.1, 0.2, 0.3), 0.5, 7, boost_cosine=0.05)
    assert name == "SET_ATTITUDE_TARGET" and values["type_mask"] == 128
    assert values["thrust"] == pytest.approx(0.05), "ArduCopter divides by no less than 0.1"
    name, values = setpoint.acceleration_target((1.0, 2.0, 3.0), None, 7)
    assert values["type_mask"] == 0b1100_0011_1111
    assert (values["afx"], values["afy"], values["afz"]) == (2.0, 1.0, -3.0)
    for wrong in ((math.nan, 0.0, 0.0), (36.0, 0.0, 0.0)):
        with pytest.raises(RefusedError):
            setpoint.body_rate_target(wrong, 0.5, 7)
    with pytest.raises(RefusedError):
        setpoint.body_rate_target((0.0, 0.0, 0.0), 1.1, 7)


class Telemetry:
    """A vehicle that reports an attitude."""

    def __init__(self, roll_deg: float, at: float) -> None:
        attitude = {"roll_deg": roll_deg, "pitch_deg": 0.0, "yaw_deg": 0.0}
        self.message_cache = SimpleNamespace(telemetry=lambda name: (attitude, at))


def source(vehicle: Telemetry, raw: RawSetpoint, until: float = 10.0) -> RawSource:
    made = RawSource(cast(Vehicle, vehicle))
    made.follow(raw, until)
    return made


LEVEL = raw_from_world(NORTH_UP, roll_deg=0.0, pitch_deg=0.0, yaw_deg=0.0, thrust=0.5)
RATES = raw_from_world(NORTH_UP, body_rates_deg_s=[1.0, 0.0, 0.0], thrust=0.5)


def test_a_tilt_beyond_limit_and_slack_ends_it() -> None:
    for raw in (LEVEL, RATES):
        assert source(Telemetry(44.0, 1.0), raw).tilt_refusal(RawLimits(), 1.1) is None
        why = source(Telemetry(46.0, 1.0), raw).tilt_refusal(RawLimits(), 1.1)
        assert why is not None and "46°" in why and "45°" in why


def test_body_rates_need_a_fresh_attitude_and_an_attitude_does_not() -> None:
    assert source(Telemetry(0.0, 1.0), LEVEL).tilt_refusal(RawLimits(), 2.0) is None
    why = source(Telemetry(0.0, 1.0), RATES).tilt_refusal(RawLimits(), 2.0)
    assert why is not None and "none has come for 0.5 s" in why


def test_a_deadline_ends_the_setpoint_once() -> None:
    flying = source(Telemetry(0.0, 0.0), LEVEL, until=1.0)
    assert not flying.expire(1.0) and flying.setpoint is LEVEL
    assert flying.expire(1.001) and flying.setpoint is None
    assert not flying.expire(2.0)
