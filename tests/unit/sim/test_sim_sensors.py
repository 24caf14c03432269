"""Noise and latency: what a vehicle believes and tells differs from the truth by what was asked for, and no more."""

from __future__ import annotations

from math import hypot, radians

import pytest

from skygcs.core.radio_link.corrections import fragments_of
from skygcs.sim.conditions import Conditions, conditions_of, wind_enu
from skygcs.sim.kinematics import Limits, Setpoint
from skygcs.sim.px4 import Px4Vehicle
from skygcs.sim.quad import IDEAL, Quad
from skygcs.sim.rng import Rng
from skygcs.sim.rtk import BASE_S, CONVERGENCE_S, OBSERVATIONS_S, RtkReceiver
from skygcs.sim.sensors import Sensors
from skygcs.sim.vehicle_group import make_vehicles
from support.rtcm import STANDARD_1005, rtcm_frame
from support.sim_pilot import FIELD, Pilot, px4, sim_dialect
from support.table import each

DT = 0.02
LIMITS = Limits(speed_mps=5.0, accel_mps2=2.5, climb_mps=2.0, descent_mps=1.0)


def vehicle(seed: int = 1, **words: float) -> Px4Vehicle:
    conditions = conditions_of(**words)  # type: ignore[arg-type]  # all numbers here
    return Px4Vehicle(sim_dialect(), 1, FIELD, rng=Rng(seed), conditions=conditions)


def test_without_noise_and_latency_belief_and_telemetry_are_the_truth_itself() -> None:
    v = px4()
    assert v.estimated is v.motion and v.reported is v.motion


def test_position_noise_has_the_size_asked_for_and_wanders_slowly() -> None:
    quad = Quad()
    sensors = Sensors(quad, Conditions(gps_noise_m=0.5), DT, seed=3)
    east, steps = [], []
    for _ in range(200_000):
        before = sensors.error_enu_m[0]
        sensors.step()
        steps.append(abs(sensors.error_enu_m[0] - before))
        east.append(sensors.estimated.east_m)
    assert (sum(e * e for e in east) / len(east)) ** 0.5 == pytest.approx(0.5, rel=0.3)
    assert max(steps) < 0.1, "an estimator's error does not jump"
    assert quad.pos_enu_m == (0.0, 0.0, 0.0)


def test_told_is_as_old_as_the_latency() -> None:
    quad = Quad(IDEAL)
    quad.place(0.0, 0.0, 10.0)
    quad.vel_e_mps = 2.0
    sensors = Sensors(quad, Conditions(sensor_latency_s=0.2), DT, seed=1)
    for _ in range(100):
        quad.step(DT, Setpoint((None, None, 10.0), (2.0, 0.0, None)), LIMITS)
        sensors.step()
    assert sensors.estimated is quad
    assert quad.east_m - sensors.reported.east_m == pytest.approx(2.0 * 0.2, abs=1e-6)


def test_the_vehicle_flies_by_what_it_believes() -> None:
    v = vehicle(gps_noise_m=1.0)
    pilot = Pilot(v)
    pilot.get_ready()
    pilot.command(400, 1)
    pilot.command(22, 0, 0, 0, float("nan"), float("nan"), float("nan"), 195.0)
    pilot.run(90)
    goal = v.estimated.pos_enu_m
    pilot.run(60)
    assert hypot(*(a - b for a, b in zip(v.estimated.pos_enu_m, goal, strict=True))) < 1.5
    off = hypot(*(a - b for a, b in zip(v.motion.pos_enu_m, v.estimated.pos_enu_m, strict=True)))
    assert off == pytest.approx(hypot(*v.sensors.error_enu_m))
    assert off > 0.01
    told = pilot.last("GLOBAL_POSITION_INT")
    assert told.alt / 1000 == pytest.approx(180.0 + v.estimated.up_m, abs=1.0)


def test_attitude_noise_is_told_and_not_flown() -> None:
    v = vehicle(attitude_noise_deg=1.0)
    pilot = Pilot(v)
    pilot.hovering()
    rolls = []
    for _ in range(200):
        pilot.run(0.1)
        rolls.append(v.reported.roll_rad)
        assert abs(v.motion.roll_rad) < 1e-3
    assert 0.3 * radians(1.0) < (sum(r * r for r in rolls) / len(rolls)) ** 0.5 < 2.0 * radians(1.0)


def test_the_same_seed_gives_the_same_flight_to_the_byte_and_another_seed_another() -> None:
    def flight(seed: int) -> list[bytes]:
        words = conditions_of(
            wind_mps=4.0, gust_mps=0.5, gps_noise_m=0.05, attitude_noise_deg=0.3, sensor_latency_s=0.1
        )
        fleet = make_vehicles(sim_dialect(), px4=1, ardupilot=1, first_sysid=1, home=FIELD, seed=seed, conditions=words)
        pilot = Pilot(*fleet)
        pilot.hovering()
        return pilot.raw

    assert flight(5) == flight(5)
    assert flight(5) != flight(6)


@each(("from_deg", "east", "north"), [(270, 5, 0), (0, 0, -5), (90, -5, 0), (180, 0, 5)])
def test_wind_is_named_by_where_it_comes_from(from_deg: float, east: float, north: float) -> None:
    assert wind_enu(5.0, from_deg) == pytest.approx((east, north, 0.0), abs=1e-9)


def test_the_words_of_a_fleet_file_become_conditions() -> None:
    assert conditions_of() == Conditions()
    ideal = conditions_of(airframe="ideal", attitude_lag_s=0.2).airframe
    assert (ideal.attitude_lag_s, ideal.thrust_lag_s, ideal.battery_sag) == (0.2, 0.0, False)


@each(
    ("word", "value"),
    [
        ("wind_mps", 31.0),
        ("wind_mps", float("nan")),
        ("gust_mps", -1.0),
        ("gps_noise_m", 11.0),
        ("attitude_noise_deg", 90.0),
        ("sensor_latency_s", 3.0),
        ("attitude_lag_s", -0.1),
    ],
)
def test_numbers_out_of_range_are_refused(word: str, value: float) -> None:
    with pytest.raises(ValueError, match=r"is not in 0\.\.|a speed of 0"):
        conditions_of(**{word: value})  # type: ignore[arg-type]


def test_names_that_are_none_are_refused() -> None:
    with pytest.raises(ValueError, match="f450, ideal, sih"):
        conditions_of(airframe="x8")
    with pytest.raises(ValueError, match="soft"):
        conditions_of(dynamics="soft")


# -- A simulated vehicle's fix tells whether corrections reach it whole.


FIX_3D, FLOAT, FIXED = 3, 5, 6


def tell(receiver: RtkReceiver, message: bytes, now: float, sequence: int = 0, *, lost: int | None = None) -> None:
    for number, values in enumerate(fragments_of(message, sequence)):
        if number != lost:
            receiver.on_message(values, now)


@each("whole_messages", [True, False])
def test_the_base_and_its_observations_make_a_float_and_then_a_fixed_solution(whole_messages: bool) -> None:
    receiver = RtkReceiver(whole_messages=whole_messages)
    fixes = []
    for second in range(int(CONVERGENCE_S) + 3):
        now = float(second)
        tell(receiver, rtcm_frame(1077, epoch=second, body_bytes=500), now, second)
        if second == 1:
            tell(receiver, STANDARD_1005, now, 31)
        fixes.append(receiver.fix_type(now))
    assert fixes == [FIX_3D] + [FLOAT] * int(CONVERGENCE_S) + [FIXED] * 2
    assert receiver.types == {1005: 1, 1077: int(CONVERGENCE_S) + 3}


def test_a_solution_ends_without_observations_and_begins_anew_with_them() -> None:
    receiver = RtkReceiver(whole_messages=True)
    for now in (0.0, CONVERGENCE_S):
        tell(receiver, STANDARD_1005, now)
        tell(receiver, rtcm_frame(1077), now)
    end = CONVERGENCE_S + OBSERVATIONS_S
    assert [receiver.fix_type(now) for now in (CONVERGENCE_S, end, end + 0.1)] == [FIXED, FIXED, FIX_3D]
    tell(receiver, rtcm_frame(1087), end + 1)
    assert receiver.fix_type(end + 1) == FLOAT


def test_observations_alone_are_of_no_use() -> None:
    receiver = RtkReceiver(whole_messages=True)
    tell(receiver, STANDARD_1005, 0.0)
    fixes = []
    for second in range(int(BASE_S) + 2):
        tell(receiver, rtcm_frame(1077), float(second))
        fixes.append(receiver.fix_type(float(second)))
    assert fixes[-2:] == [FIXED, FIX_3D]


@each("whole_messages", [True, False])
@each("lost", [0, 1, 2])
def test_a_message_without_one_of_its_fragments_does_not_count(whole_messages: bool, lost: int) -> None:
    receiver = RtkReceiver(whole_messages=whole_messages)
    tell(receiver, rtcm_frame(1077, body_bytes=500), 0.0, 1, lost=lost)
    tell(receiver, rtcm_frame(1087, body_bytes=700), 0.0, 2)
    tell(receiver, rtcm_frame(1097, body_bytes=700), 0.0, 3)
    assert 1077 not in receiver.types
    assert receiver.types[1097] == 1
