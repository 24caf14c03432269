"""What a pilot sees of its vehicle, read in short, is what the vehicle's sections say at length."""

from __future__ import annotations

import math

from hypothesis import given
from hypothesis import strategies as st
from pymavlink.dialects.v20 import ardupilotmega as mav

from skygcs.core.control.cascade import Estimate
from skygcs.core.control.control_fence import Fence
from skygcs.core.geo import Origin
from skygcs.core.mavlink.frame import Frame
from skygcs.core.vehicle.estimate_view import ATTITUDE_FRESH_S, EstimateView
from skygcs.core.vehicle.vehicle import Vehicle
from support.vehicles import HOME, Voice, flight_dialect

int32, int16 = st.integers(-(2**31), 2**31 - 1), st.integers(-(2**15), 2**15 - 1)
anchored = st.tuples(st.integers(-9000, 9000), st.integers(-9000, 9000), st.integers(-9_000, 40_000))
angles = st.floats(width=32) | st.sampled_from([0.0, 1.0, math.nan, math.inf, -math.inf, 3.4e38, -3.4e38])


def told_position(voice: Voice, lat: int, lon: int, alt: int, velocity: tuple[int, int, int] = (0, 0, 0)) -> Frame:
    return voice.say(mav.MAVLink_global_position_int_message(0, lat, lon, alt, 0, *velocity, 65535))


def seen() -> tuple[EstimateView, Vehicle, Voice]:
    vehicle, voice = Vehicle(1, 1, flight_dialect()), Voice(1)
    vehicle.on_frame(voice.position(), 100.0)
    estimate_view = EstimateView(vehicle)
    estimate_view.set_local_origin(Fence(Origin(*HOME)))
    return estimate_view, vehicle, voice


@given(int32, int32, int32, st.tuples(int16, int16, int16))
def test_the_estimate_is_the_position_section_about_the_anchor(
    lat: int, lon: int, alt: int, velocity: tuple[int, int, int]
) -> None:
    estimate_view, vehicle, voice = seen()
    vehicle.on_frame(told_position(voice, lat, lon, alt, velocity), 101.0)
    section = vehicle.telemetry("position")
    assert section is not None and estimate_view.frame is not None
    expected = None
    if section["lat_deg"] is not None:
        place = (section["lat_deg"], section["lon_deg"], section["alt_amsl_m"])
        east, north, up = section["vel_enu_mps"]
        expected = Estimate(estimate_view.frame.from_geodetic(*place), (east, north, up))
    assert estimate_view.estimate() == expected
    assert estimate_view.age_s(101.5) == (None if expected is None else 0.5)


@given(anchored)
def test_the_breach_is_what_the_fence_says_of_where_it_is(off: tuple[int, int, int]) -> None:
    estimate_view, vehicle, voice = seen()
    lat, lon, alt = round(HOME[0] * 1e7) + off[0], round(HOME[1] * 1e7) + off[1], round(HOME[2] * 1e3) + off[2]
    vehicle.on_frame(told_position(voice, lat, lon, alt), 101.0)
    estimate_view.estimate()
    assert estimate_view.breach() == Fence(Origin(*HOME)).why_not(lat / 1e7, lon / 1e7, alt / 1000)


def test_a_latitude_beyond_the_pole_is_outside_any_fence() -> None:
    """As a point it would be one on the other side, which the fence there holds."""
    vehicle, voice = Vehicle(1, 1, flight_dialect()), Voice(1)
    vehicle.on_frame(told_position(voice, 899_999_000, 10_000_000, 100_000), 100.0)
    estimate_view = EstimateView(vehicle)
    estimate_view.set_local_origin(Fence(Origin(89.9999, 1.0, 100.0)))
    vehicle.on_frame(told_position(voice, 900_001_000, -1_790_000_000, 100_000), 101.0)
    estimate_view.estimate()
    assert "not a position on earth" in str(estimate_view.breach())


@given(
    st.lists(
        st.tuples(st.booleans(), st.tuples(angles, angles, angles, angles), st.floats(0.0, 1.5 * ATTITUDE_FRESH_S)),
        max_size=6,
    )
)
def test_an_attitude_is_finite_where_its_section_is_known_or_it_is_old(
    told: list[tuple[bool, tuple[float, float, float, float], float]],
) -> None:
    estimate_view, vehicle, voice = seen()
    now = 100.0
    assert estimate_view.attitude_is_finite(now)
    for by_angles, parts, pause in told:
        if by_angles:
            vehicle.on_frame(voice.say(mav.MAVLink_attitude_message(0, *parts[:3], 0.0, 0.0, 0.0)), now)
        else:
            vehicle.on_frame(voice.say(mav.MAVLink_attitude_quaternion_message(0, *parts, 0.0, 0.0, 0.0)), now)
        now += pause
        slot = vehicle.slot("ATTITUDE") or vehicle.slot("ATTITUDE_QUATERNION")
        assert slot is not None
        old = now - slot.at > ATTITUDE_FRESH_S
        assert estimate_view.attitude_is_finite(now) is (old or vehicle.telemetry("attitude") is not None)


def test_after_a_reboot_nothing_is_known() -> None:
    estimate_view, vehicle, _ = seen()
    assert estimate_view.estimate() is not None
    vehicle.message_cache.forget_before(200.0, "HEARTBEAT")
    assert estimate_view.estimate() is None and estimate_view.age_s(201.0) is None and estimate_view.breach() is None
