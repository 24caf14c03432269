"""Setpoint messages as pymavlink reads their bytes, what is refused instead of being sent, and their type masks."""

from __future__ import annotations

import itertools
import math
from typing import Any

import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from skygcs.core.control.cascade import Estimate, Memory, Reference, step
from skygcs.core.control.gains import ControlConfig
from skygcs.core.mavlink.frame import encode
from skygcs.core.vehicle import setpoint
from skygcs.core.vehicle.frames import GeodeticPosition
from skygcs.core.vehicle.setpoint import ALL, ATTITUDE_AND_THRUST, NONE, Message, position_target_mask
from skygcs.errors import RefusedError
from support.pymav import PymavPeer
from support.table import each
from support.vehicles import HOME, flight_dialect

LEVEL = (1.0, 0.0, 0.0, 0.0)
coordinates = st.floats(-90, 90), st.floats(-180, 180), st.floats(-500, 9000)
speeds = st.tuples(*[st.floats(-30, 30)] * 3)
anything = st.floats() | st.sampled_from([0.0, -0.0, 1e300, math.nan, math.inf, -math.inf])


def read(message: Message) -> Any:
    """The message as an independent decoder reads it off the wire."""
    name, values = message
    info = flight_dialect().by_name[name]
    raw = encode(info, {**values, "target_system": 7, "target_component": 1}, sysid=255, compid=190, seq=0)
    (decoded,) = PymavPeer(1, 1).mav.parse_buffer(raw)
    assert decoded.get_type() == name and decoded.target_system == 7 and decoded.target_component == 1
    return decoded


def test_an_attitude_target_is_a_quaternion_a_thrust_and_no_rates() -> None:
    half = math.sqrt(0.5)
    m = read(setpoint.attitude_target((half, half, 0.0, 0.0), 0.45, 12_345))
    assert m.type_mask == 0x07
    assert m.q == pytest.approx([half, half, 0, 0], abs=1e-7)
    assert m.thrust == pytest.approx(0.45, abs=1e-7)
    assert (m.body_roll_rate, m.body_pitch_rate, m.body_yaw_rate) == (0, 0, 0)
    assert m.time_boot_ms == 12_345


def test_what_the_law_puts_out_is_an_attitude_target_arducopter_accepts() -> None:
    estimate, reference = Estimate((0, 0, 0), (1, -2, 0.5)), Reference((3, 4, 5), yaw_rad=2.0)
    output, _ = step(ControlConfig(), Memory(), estimate, reference, 0.02, following=True)
    m = read(setpoint.attitude_target(output.attitude_ned_frd, output.collective_thrust, 0))
    assert abs(math.sqrt(sum(c * c for c in m.q)) - 1) < 1e-3
    assert 0.1 <= m.thrust <= 1.0


@given(st.floats(0, math.radians(80)), st.floats(-math.pi, math.pi), st.floats(0, 1))
def test_a_thrust_for_a_vehicle_that_boosts_by_tilt_comes_out_as_it_was_meant(
    tilt: float, about: float, thrust: float
) -> None:
    quaternion = (math.cos(tilt / 2), math.sin(tilt / 2) * math.cos(about), math.sin(tilt / 2) * math.sin(about), 0.0)
    m = read(setpoint.attitude_target(quaternion, thrust, 0, angle_boost=True))
    boosted = m.thrust / max(math.cos(tilt), 0.1)  # AC_AttitudeControl_Multi::get_throttle_boosted
    assert boosted == pytest.approx(thrust, abs=1e-6)


@each(
    ("quaternion", "thrust"),
    [
        ((0.9, 0, 0, 0), 0.5),
        ((0, 0, 0, 0), 0.5),
        ((1, 0, 0), 0.5),
        ((math.nan, 0, 0, 0), 0.5),
        (LEVEL, -0.01),
        (LEVEL, 1.01),
        (LEVEL, math.nan),
    ],
)
def test_no_attitude_that_is_none_and_no_thrust_out_of_range(quaternion: tuple[float, ...], thrust: float) -> None:
    with pytest.raises(RefusedError):
        setpoint.attitude_target(quaternion, thrust, 0)


def test_a_velocity_target_is_ned_and_nothing_but_velocity() -> None:
    m = read(setpoint.velocity_target((1.0, 2.0, 3.0), None, 5))
    assert (m.coordinate_frame, m.type_mask) == (1, 0xDC7)
    assert (m.vx, m.vy, m.vz) == (2, 1, -3)
    m = read(setpoint.velocity_target((1, 2, 3), 0.0, 5, acc_enu_mps2=(0.1, 0.2, 0.3)))
    assert m.type_mask == 0x807
    assert (m.afx, m.afy, m.afz) == pytest.approx((0.2, 0.1, -0.3))
    assert m.yaw == pytest.approx(math.pi / 2), "east"


@each("family", ["px4", "ardupilot"])
def test_a_position_target_is_a_place_above_sea_level(family: Any) -> None:
    m = read(setpoint.position_target(GeodeticPosition(*HOME), math.pi / 2, 5, family))
    assert (m.coordinate_frame, m.type_mask) == (5, 0x9F8)
    assert (m.lat_int, m.lon_int) == (round(HOME[0] * 1e7), round(HOME[1] * 1e7))
    assert m.alt == pytest.approx(HOME[2], abs=1e-4)
    assert m.yaw == pytest.approx(0), "north"
    m = read(setpoint.position_target(GeodeticPosition(*HOME), None, 5, family, vel_enu_mps=(1, 2, 3)))
    assert m.type_mask == 0xDC0
    assert (m.vx, m.vy, m.vz) == (2, 1, -3)


def test_a_local_position_may_bring_velocity_and_acceleration_along() -> None:
    m = read(setpoint.position_target_local((1, 2, 3), None, 5, "px4"))
    assert (m.coordinate_frame, m.type_mask, m.x, m.y, m.z) == (1, 0xDF8, 2, 1, -3)
    m = read(
        setpoint.position_target_local(
            (1, 2, 3), 0.0, 5, "ardupilot", vel_enu_mps=(4, 5, 6), acc_enu_mps2=(0.5, 0.25, 0.125)
        )
    )
    assert m.type_mask == 0x800
    assert (m.vx, m.vy, m.vz, m.afx, m.afy, m.afz) == (5, 4, -6, 0.25, 0.5, -0.125)
    with pytest.raises(RefusedError, match="velocity"):
        setpoint.position_target_local((1, 2, 3), None, 5, "ardupilot", acc_enu_mps2=(0, 0, 1))


@given(st.floats(-50, 50))
def test_yaw_is_the_compass_course_of_the_same_direction(yaw: float) -> None:
    ned = setpoint.yaw_ned_rad(yaw)
    assert -math.pi <= ned < math.pi
    assert math.sin(ned) == pytest.approx(math.cos(yaw), abs=1e-9), "its east part"
    assert math.cos(ned) == pytest.approx(math.sin(yaw), abs=1e-9), "its north part"


@given(*coordinates, st.none() | st.floats(-10, 10), st.integers(0, 1 << 40))
def test_any_place_that_is_one_comes_through_within_a_centimetre(
    lat: float, lon: float, alt: float, yaw: float | None, boot_ms: int
) -> None:
    assume(abs(lat) > 1e-6 and abs(lon) > 1e-6)
    m = read(setpoint.position_target(GeodeticPosition(lat, lon, alt), yaw, boot_ms, "px4"))
    assert abs(m.lat_int / 1e7 - lat) <= 0.51e-7 and abs(m.lon_int / 1e7 - lon) <= 0.51e-7
    assert abs(m.alt - alt) < 1e-3
    assert m.type_mask == (0xDF8 if yaw is None else 0x9F8)
    assert m.time_boot_ms == boot_ms % (1 << 32)


@given(anything, anything, anything, st.none() | anything, st.tuples(anything, anything, anything))
def test_whatever_numbers_come_it_is_a_finite_setpoint_or_a_refusal(
    a: float, b: float, c: float, yaw: float | None, vel: tuple[float, float, float]
) -> None:
    for make in (
        lambda: setpoint.position_target(GeodeticPosition(a, b, c), yaw, 0, "px4", vel_enu_mps=vel),
        lambda: setpoint.velocity_target((a, b, c), yaw, 0, acc_enu_mps2=vel),
        lambda: setpoint.position_target_local((a, b, c), yaw, 0, "px4", vel_enu_mps=vel),
        lambda: setpoint.position_target(
            GeodeticPosition(a, b, c), None, 0, "px4", acc_enu_mps2=vel, yaw_rate_enu_radps=yaw
        ),
        lambda: setpoint.attitude_target((a, b, c, vel[0]), vel[1], 0),
    ):
        try:
            message = make()
        except RefusedError as error:
            assert str(error)
            continue
        m = read(message)
        fields = [getattr(m, f) for f in m.get_fieldnames() if f != "q"] + list(getattr(m, "q", []))
        assert all(math.isfinite(f) for f in fields)
        if message[0] == "SET_POSITION_TARGET_GLOBAL_INT":
            assert m.lat_int != 0 and m.lon_int != 0


@each(
    ("lat", "lon", "alt"),
    [(0.0, 8.5, 500.0), (47.0, 0.0, 500.0), (1.8e-9, 8.5, 500.0), (47.0, 8.5, 1e6), (91.0, 8.5, 0.0)],
)
def test_places_nobody_can_mean_are_refused(lat: float, lon: float, alt: float) -> None:
    with pytest.raises(RefusedError):
        setpoint.position_target(GeodeticPosition(lat, lon, alt), None, 0, "ardupilot")


def test_an_autopilot_nobody_knows_is_sent_no_position() -> None:
    with pytest.raises(RefusedError, match="PX4 and ArduPilot"):
        setpoint.position_target(GeodeticPosition(*HOME), None, 0, "generic")


# --- type masks -------------------------------------------------------------------------------------------------------

AXES = list(itertools.product((False, True), repeat=3))


@each(
    ("given", "mask"),
    [
        ({"pos": ALL, "yaw": True}, 0x9F8),
        ({"pos": ALL}, 0xDF8),
        ({"vel": ALL}, 0xDC7),
        ({"acc": ALL}, 0xC3F),
        ({"pos": ALL, "vel": ALL, "acc": ALL, "yaw": True, "yaw_rate": True}, 0),
        ({"pos": (False, False, True), "vel": (True, True, False)}, 0b1101_1110_0011),
    ],
)
def test_a_mask_ignores_what_is_not_given(given: dict[str, object], mask: int) -> None:
    assert position_target_mask(**given) == mask  # type: ignore[arg-type]


def every_mask() -> dict[int, tuple[object, ...]]:
    made = {}
    for pos, vel, acc, yaw, rate in itertools.product(AXES, AXES, AXES, (False, True), (False, True)):
        if any((*pos, *vel, *acc)):
            made[position_target_mask(pos=pos, vel=vel, acc=acc, yaw=yaw, yaw_rate=rate)] = (pos, vel, acc, yaw, rate)
    return made


def test_the_masks_of_the_papers_script_mean_what_was_not_given() -> None:
    """0x4F8, "position": one digit short, yaw ignored and yaw rate flown. 0x5C0, "velocity": position 0, 0, 0 flown."""
    made = every_mask()
    _, _, _, yaw, rate = made[0x4F8]
    assert not yaw and rate, "only who gives a yaw rate gets it"
    pos, *_ = made[0x5C0]
    assert pos == ALL, "only who gives a position gets it"


def test_no_mask_turns_an_acceleration_into_a_force_or_sets_a_bit_beyond() -> None:
    assert all(mask & 0x200 == 0 and mask < 0x1000 for mask in every_mask())


def test_a_target_that_gives_nothing_is_none() -> None:
    with pytest.raises(ValueError, match="at least one"):
        position_target_mask(pos=NONE, yaw=True)


def test_an_attitude_ignores_all_three_rates_and_neither_attitude_nor_thrust() -> None:
    assert ATTITUDE_AND_THRUST == 0x07
