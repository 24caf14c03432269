"""The law in flight: a point mass under a rotating thrust, flown by what would go to the autopilot (NED/FRD, thrust).

The airframe below knows nothing of the law's own frames: it takes the NED/FRD quaternion apart with the formulas of any
flight mechanics book, lags each angle, and pushes along its own up axis.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass, field, replace

import numpy as np
import pytest

from skygcs.core.control import AxisGains, ControlConfig, Estimate, Memory, Output, Reference, step
from support.table import each

GRAVITY_MPS2 = 9.81
SUBSTEPS = 4

Vector = tuple[float, float, float]
SLOW_Z = ControlConfig(z=AxisGains(pos_p_per_s=1.0 / 4, vel_p=0.3 / 4, vel_i=0.02 / 16))
EAST, NORTH, UP = (1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)


@dataclass
class Airframe:
    """Hovers at ``hover_thrust``; ``lag_s`` is the time constant of its attitude (0: ideal)."""

    lag_s: float = 0.0
    hover_thrust: float = 0.45
    push_enu_mps2: Vector = (0.0, 0.0, 0.0)
    pos_ned: list[float] = field(default_factory=lambda: [0.0, 0.0, 0.0])
    vel_ned: list[float] = field(default_factory=lambda: [0.0, 0.0, 0.0])
    roll_rad: float = 0.0
    pitch_rad: float = 0.0
    yaw_ned_rad: float = math.pi / 2

    def estimate(self) -> Estimate:
        (north, east, down), (v_north, v_east, v_down) = self.pos_ned, self.vel_ned
        return Estimate((east, north, -down), (v_east, v_north, -v_down))

    def move(self, attitude_ned_frd: tuple[float, float, float, float], thrust: float, dt_s: float) -> None:
        w, x, y, z = attitude_ned_frd
        roll = math.atan2(2 * (w * x + y * z), 1 - 2 * (x * x + y * y))
        pitch = math.asin(2 * (w * y - z * x))
        yaw = math.atan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))
        reach = 1.0 if self.lag_s == 0 else -math.expm1(-dt_s / self.lag_s)
        self.roll_rad += reach * (roll - self.roll_rad)
        self.pitch_rad += reach * (pitch - self.pitch_rad)
        self.yaw_ned_rad += reach * math.remainder(yaw - self.yaw_ned_rad, math.tau)
        (cr, sr), (cp, sp), (cy, sy) = (
            (math.cos(a), math.sin(a)) for a in (self.roll_rad, self.pitch_rad, self.yaw_ned_rad)
        )
        lift = -thrust * GRAVITY_MPS2 / self.hover_thrust  # body z points down
        push_e, push_n, push_u = self.push_enu_mps2
        acc = (
            lift * (cr * sp * cy + sr * sy) + push_n,
            lift * (cr * sp * sy - sr * cy) + push_e,
            lift * cr * cp + GRAVITY_MPS2 - push_u,
        )
        for i in range(3):
            self.pos_ned[i] += self.vel_ned[i] * dt_s + 0.5 * acc[i] * dt_s * dt_s
            self.vel_ned[i] += acc[i] * dt_s


@dataclass
class Flight:
    """What was flown: positions ENU at each tick, every output, and the memory at the end."""

    track_enu_m: np.ndarray
    outputs: list[Output]
    airframe: Airframe
    memory: Memory


def fly(
    reference: Reference,
    seconds: float,
    *,
    config: ControlConfig | None = None,
    airframe: Airframe | None = None,
    delay_s: float = 0.0,
    following: bool = True,
    mirror_roll: bool = False,
) -> Flight:
    """Steps the law at the configured period; every output takes effect ``delay_s`` later (whole substeps)."""
    config, airframe, memory = config or ControlConfig(), airframe or Airframe(), Memory()
    sub_s = config.period_s / SUBSTEPS
    level, _ = step(config, memory, airframe.estimate(), Reference(), config.period_s, following=False)
    assert level is not None and level.collective_thrust == pytest.approx(config.hover_thrust)
    underway = deque([level] * round(delay_s / sub_s))
    track, outputs = [], []
    for _ in range(round(seconds / config.period_s)):
        estimate = airframe.estimate()
        track.append(estimate.pos_enu_m)
        output, memory = step(config, memory, estimate, reference, config.period_s, following=following)
        assert output is not None
        outputs.append(output)
        for _ in range(SUBSTEPS):
            underway.append(output)
            due = underway.popleft()
            attitude = due.attitude_ned_frd
            if mirror_roll:  # with the nose east: turn the attitude about body x the other way
                attitude = nose_east(due.pitch_frd_rad, -due.roll_frd_rad)
            airframe.move(attitude, due.collective_thrust, sub_s)
    return Flight(np.array(track), outputs, airframe, memory)


def nose_east(pitch_rad: float, roll_rad: float) -> tuple[float, float, float, float]:
    """NED/FRD quaternion of a vehicle with its nose to the east."""
    (cy, sy), (cp, sp), (cr, sr) = ((math.cos(a / 2), math.sin(a / 2)) for a in (math.pi / 2, pitch_rad, roll_rad))
    return (
        cy * cp * cr + sy * sp * sr,
        cy * cp * sr - sy * sp * cr,
        cy * sp * cr + sy * cp * sr,
        sy * cp * cr - cy * sp * sr,
    )


def overshoot(flight: Flight, axis: int, target_m: float) -> float:
    return max(0.0, float(flight.track_enu_m[:, axis].max()) / target_m - 1.0)


def swing_m(flight: Flight, axis: int) -> float:
    """Peak to peak over the last quarter of the flight."""
    return float(np.ptp(flight.track_enu_m[-len(flight.track_enu_m) // 4 :, axis]))


def scaled(direction: Vector, length: float) -> Vector:
    return (direction[0] * length, direction[1] * length, direction[2] * length)


# --- signs -----------------------------------------------------------------------------------------------------------


@each("yaw_deg", [0, 30, 90, 180, -135])
@each("direction", [EAST, NORTH, UP, scaled(EAST, -1), scaled(NORTH, -1), scaled(UP, -1)])
def test_a_step_moves_the_vehicle_towards_it_and_nowhere_else_whatever_its_yaw(direction, yaw_deg):
    yaw_rad = math.radians(yaw_deg)
    airframe = Airframe(lag_s=0.15, yaw_ned_rad=math.pi / 2 - yaw_rad)
    moved = fly(Reference(direction, yaw_rad), 1.5, airframe=airframe).track_enu_m[-1]
    along = float(np.dot(moved, direction))
    assert along > 0.5
    assert np.linalg.norm(moved - along * np.array(direction)) < 0.02


@each("direction", [EAST, NORTH, UP])
def test_a_velocity_reference_moves_the_vehicle_that_way(direction):
    reference = Reference(vel_enu_mps=direction, velocity_only_xy=True, velocity_only_z=True)
    flight = fly(reference, 10.0, airframe=Airframe(lag_s=0.15))
    moved = flight.track_enu_m[-1] - flight.track_enu_m[-51]
    assert moved == pytest.approx(np.array(direction), abs=0.05)


def test_nose_east_going_east_pitches_the_nose_down_going_north_rolls_the_left_side_down_and_up_takes_thrust():
    east, north = fly(Reference(EAST), 0.02).outputs[0], fly(Reference(NORTH), 0.02).outputs[0]
    lean_deg = pytest.approx(-9.586, abs=5e-4)
    assert (math.degrees(east.pitch_frd_rad), east.roll_frd_rad) == (lean_deg, 0.0)
    assert (north.pitch_frd_rad, math.degrees(north.roll_frd_rad)) == (0.0, lean_deg)
    assert fly(Reference(UP), 0.02).outputs[0].collective_thrust > 0.45
    assert fly(Reference(scaled(UP, -1)), 0.02).outputs[0].collective_thrust < 0.45


@each("yaw_deg", [-120, -30, 30, 90, 179])
def test_yaw_is_flown_counter_clockwise_from_east(yaw_deg):
    airframe = fly(Reference(yaw_rad=math.radians(yaw_deg)), 2.0, airframe=Airframe(lag_s=0.15)).airframe
    assert math.degrees(math.remainder(airframe.yaw_ned_rad - math.radians(90 - yaw_deg), math.tau)) == pytest.approx(
        0, abs=0.01
    )
    assert airframe.estimate().pos_enu_m == pytest.approx((0, 0, 0), abs=1e-6)


def test_turning_while_it_flies_does_not_turn_its_way():
    flight = fly(Reference((3.0, 0.0, 0.0), yaw_rad=2.5), 20.0, airframe=Airframe())
    assert abs(flight.track_enu_m[:, 1]).max() < 1e-6


# --- the report's Eq. 16 ---------------------------------------------------------------------------------------------


def test_the_law_holds_y_and_with_the_sign_of_eq_16_it_would_not():
    assert abs(fly(Reference(NORTH), 30.0).track_enu_m[-1, 1] - 1.0) < 0.01
    assert abs(fly(Reference(NORTH), 30.0, mirror_roll=True).track_enu_m[-1, 1] - 1.0) > 50.0


# --- figures ---------------------------------------------------------------------------------------------------------


@each(
    ("lag_s", "following", "percents", "settled_s"),
    [
        # overshoot after a delay of 0, 0.1, 0.2, 0.3 and 0.4 s, and how long after the first of them it takes
        (0.0, True, (8.1, 9.3, 12.0, 20.1, 38.0), (3.7,)),
        (0.0, False, (5.6, 5.9, 6.7, 10.6, 23.4), ()),
        (0.15, True, (11.0, 15.7, 27.5, 65.8, 73.3), (3.4, 4.8)),
    ],
)
def test_a_3_m_step_east_overshoots_and_is_within_5_percent_as_the_documentation_says(
    lag_s, following, percents, settled_s
):
    for n, percent in enumerate(percents):
        seconds, airframe = 40.0 if n < len(settled_s) else 8.0, Airframe(lag_s=lag_s)
        flight = fly(Reference((3.0, 0, 0)), seconds, airframe=airframe, delay_s=0.1 * n, following=following)
        assert 100 * overshoot(flight, 0, 3.0) == pytest.approx(percent, abs=0.1)
        if n < len(settled_s):
            off = abs(flight.track_enu_m[:, 0] / 3.0 - 1.0) > 0.05
            assert (float(np.flatnonzero(off)[-1]) + 1) * 0.02 == pytest.approx(settled_s[n], abs=0.05)


def test_a_z_that_swings_is_a_third_of_the_overshoot_at_three_tenths_of_a_second():
    flight = fly(Reference((3.0, 0, 0)), 8.0, config=SLOW_Z, airframe=Airframe(lag_s=0.15), delay_s=0.3)
    assert 100 * overshoot(flight, 0, 3.0) == pytest.approx(44.1, abs=0.1)


@pytest.mark.parametrize(
    ("lag_s", "stable", "unstable"), [pytest.param(0.0, 0.45, 0.5, marks=pytest.mark.deep), (0.15, 0.3, 0.4)]
)
def test_horizontally_the_loop_bears_a_delay_up_to_its_margin_and_no_more(lag_s, stable, unstable):
    """With z slowed four times: at its own gains it swings from 0.25 s on and takes the thrust from x and y."""

    def swing(delay_s: float) -> float:
        flight = fly(Reference((3.0, 0, 0)), 60.0, config=SLOW_Z, airframe=Airframe(lag_s=lag_s), delay_s=delay_s)
        return swing_m(flight, 0)

    assert swing(stable) < 0.02
    assert swing(unstable) > 2.0


@each(("delay_s", "percent"), [(0.0, 0.0), (0.1, 0.0), (0.15, 0.0), (0.2, 13.5)])
def test_a_1_m_step_up_overshoots_as_the_documentation_says_and_settles(delay_s, percent):
    flight = fly(Reference(UP), 60.0, delay_s=delay_s)
    assert 100 * overshoot(flight, 2, 1.0) == pytest.approx(percent, abs=0.1)
    assert abs(flight.track_enu_m[-1, 2] - 1.0) < 0.03


@each(("rate_hz", "delay_s"), [(50, 0.25), (5, 0.15)])
def test_vertically_too_much_delay_or_too_slow_a_loop_swings_for_ever(rate_hz, delay_s):
    config = ControlConfig(period_s=1 / rate_hz)
    assert swing_m(fly(Reference(UP), 60.0, config=config, delay_s=delay_s), 2) > 0.3


def test_vertically_a_loop_at_5_hz_still_bears_a_tenth_of_a_second():
    """Half a period of 0.2 s (held outputs) and 0.1 s are 0.2 s; the margin is 0.213 s."""
    flight = fly(Reference(UP), 60.0, config=ControlConfig(period_s=0.2), delay_s=0.1)
    assert 100 * overshoot(flight, 2, 1.0) == pytest.approx(0.7, abs=0.1)
    assert swing_m(flight, 2) < 0.001


def test_a_steady_wind_and_a_wrong_hover_thrust_are_integrated_away_and_win_without_the_integral():
    def end_m(following: bool) -> float:
        wind = Airframe(lag_s=0.15, hover_thrust=0.5, push_enu_mps2=(0.8, -0.5, 0.0))
        return float(np.linalg.norm(fly(Reference(), 60.0, airframe=wind, following=following).track_enu_m[-1]))

    assert end_m(True) < 0.05
    assert end_m(False) > 0.4


def test_an_acceleration_reference_is_flown_in_metres_per_second_squared():
    """Velocity gains as small as they may be, so that nearly all of the push is the feed-forward."""
    weak = AxisGains(pos_p_per_s=0.0, vel_p=1e-3, vel_i=0.0)
    config = replace(ControlConfig(), xy=weak, z=weak)
    for axis in range(3):
        acc = [0.0, 0.0, 0.0]
        acc[axis] = 1.0
        flight = fly(Reference(acc_enu_mps2=(acc[0], acc[1], acc[2])), 1.0, config=config)
        assert flight.airframe.estimate().vel_enu_mps == pytest.approx(acc, abs=0.02)
