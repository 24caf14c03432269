"""The rigid quadrotor obeys Newton, has every sign right, and flies under the law as the analysis says."""

from __future__ import annotations

from dataclasses import replace
from math import cos, dist, hypot, log, pi, radians, sin, tan

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from skygcs.core.control import Estimate, Memory, Output, Reference, step
from skygcs.core.control.cascade import attitude_from_thrust, ned_frd_from_enu_flu
from skygcs.core.control.gains import AxisGains, ControlConfig
from skygcs.core.geo import quaternion_from_euler
from skygcs.sim import quad as quad_module
from skygcs.sim.body import GRAVITY_MPS2, AttitudeSetpoint, wrap_pi
from skygcs.sim.kinematics import Limits
from skygcs.sim.quad import F450, IDEAL, Airframe, Quad, level
from skygcs.sim.wind import Wind
from support.examples import examples
from support.table import each

LIMITS = Limits(speed_mps=5.0, accel_mps2=2.5, climb_mps=2.0, descent_mps=1.0)
DT = 0.02
HOVER = F450.hover_thrust
LAGS_ONLY = replace(IDEAL, attitude_lag_s=0.15, thrust_lag_s=0.05)


def in_air(frame: Airframe = IDEAL, *, yaw_rad: float = 0.0, wind: Wind | None = None) -> Quad:
    quad = Quad(frame, yaw_rad=yaw_rad, wind=wind)
    quad.place(0.0, 0.0, 20.0)
    return quad


def fly(quad: Quad, seconds: float, roll: float = 0.0, pitch: float = 0.0, yaw: float = 0.0) -> None:
    """Hold this attitude, with the thrust that keeps the height."""
    thrust = HOVER / (cos(roll) * cos(pitch))
    for _ in range(round(seconds / DT)):
        quad.fly(DT, quaternion_from_euler(roll, pitch, yaw), thrust)


def flown(
    frame: Airframe,
    reference: Reference,
    seconds: float,
    *,
    delay_s: float = 0.0,
    wind: Wind | None = None,
    config: ControlConfig | None = None,
    mirror_y: bool = False,
) -> list[tuple[float, float, float]]:
    """The track under the law at 50 Hz, from a hover at (0, 0, 20); the law sees the state ``delay_s`` late."""
    quad, config, memory = in_air(frame, wind=wind), config or ControlConfig(), Memory()
    seen: list[Estimate] = []
    track = []
    late = round(delay_s / DT)
    for _ in range(round(seconds / DT)):
        seen.append(Estimate(quad.pos_enu_m, quad.vel_enu_mps))
        output, memory = step(config, memory, seen[max(0, len(seen) - 1 - late)], reference, DT, following=True)
        assert output is not None
        attitude = mirrored(output, reference.yaw_rad) if mirror_y else output.attitude_ned_frd
        quad.step(DT, AttitudeSetpoint(attitude, output.collective_thrust), LIMITS)
        track.append(quad.pos_enu_m)
    return track


def mirrored(output: Output, yaw_rad: float) -> tuple[float, float, float, float]:
    x, y, z = output.thrust_enu
    return ned_frd_from_enu_flu(attitude_from_thrust((x, -y, z), yaw_rad)[0])


# -- signs


@each("heading", [0.0, 90.0, 200.0])
def test_nose_down_flies_to_where_the_nose_points(heading: float) -> None:
    quad = in_air(yaw_rad=radians(heading))
    fly(quad, 2.0, pitch=-0.1, yaw=radians(heading))
    ahead = quad.north_m * cos(radians(heading)) + quad.east_m * sin(radians(heading))
    assert ahead == pytest.approx(0.5 * GRAVITY_MPS2 * tan(0.1) * 4.0, rel=1e-6)
    assert hypot(quad.east_m, quad.north_m) == pytest.approx(ahead), "and nowhere else"


@each("heading", [0.0, 90.0, 200.0])
def test_right_side_down_flies_to_the_right(heading: float) -> None:
    quad = in_air(yaw_rad=radians(heading))
    fly(quad, 2.0, roll=0.1, yaw=radians(heading))
    right = quad.east_m * cos(radians(heading)) - quad.north_m * sin(radians(heading))
    assert right == pytest.approx(0.5 * GRAVITY_MPS2 * tan(0.1) * 4.0, rel=1e-6)
    assert hypot(quad.east_m, quad.north_m) == pytest.approx(right)


def test_a_turn_to_the_right_makes_the_heading_grow() -> None:
    quad = in_air(F450)
    fly(quad, 0.5, yaw=radians(90))
    assert 10 < quad.heading_deg < 40
    assert quad.yaw_rate_radps > 0
    assert quad.yaw_rate_radps == pytest.approx(F450.yaw_rate_max_radps)


@each(("axis", "yaw"), [(0, 0.0), (1, 0.0), (2, 0.0), (0, 2.0), (1, -2.5), (2, 1.0)])
@each("sign", [1.0, -1.0])
def test_a_step_along_each_axis_reaches_the_reference_and_moves_no_other(axis: int, yaw: float, sign: float) -> None:
    target = [0.0, 0.0, 20.0]
    target[axis] += 3.0 * sign
    track = flown(F450, Reference((target[0], target[1], target[2]), yaw), 25.0)
    assert track[-1] == pytest.approx(target, abs=0.02)
    assert (track[25][axis] - (0.0, 0.0, 20.0)[axis]) * sign > 0.02, "it sets out the right way"
    for other in {0, 1, 2} - {axis}:
        away = max(abs(p[other] - (0.0, 0.0, 20.0)[other]) for p in track)
        assert away < (0.1 if yaw == 0.0 else 0.8), "turning while leaning pushes it aside a little"


@each("yaw_enu", [0.0, pi / 2, -2.0, 3.0])
def test_the_yaw_reference_is_reached(yaw_enu: float) -> None:
    quad, memory = in_air(F450), Memory()
    for _ in range(500):
        estimate = Estimate(quad.pos_enu_m, quad.vel_enu_mps)
        output, memory = step(
            ControlConfig(), memory, estimate, Reference((0.0, 0.0, 20.0), yaw_enu), DT, following=True
        )
        assert output is not None
        quad.step(DT, AttitudeSetpoint(output.attitude_ned_frd, output.collective_thrust), LIMITS)
    assert abs(wrap_pi(pi / 2 - yaw_enu - quad.yaw_rad)) < 1e-3


def test_the_seeds_y_row_taken_literally_runs_away_with_its_unstable_pole() -> None:
    # Eq. 16's y row holds for a plant gain of -g: a roll to the right that pushes left (pole +1.497, analysis.py)
    seeds_plant = ControlConfig(xy=AxisGains(0.95, 0.08 * HOVER, 0.02 * HOVER))
    track = flown(IDEAL, Reference((0.0, 1e-4, 20.0)), 7.0, config=seeds_plant, mirror_y=True)
    early, late = (abs(track[round(t / DT)][1]) for t in (4.0, 5.0))
    assert log(late / early) == pytest.approx(1.497, rel=0.03)
    right_way = flown(IDEAL, Reference((0.0, 1e-4, 20.0)), 7.0, config=seeds_plant)
    assert max(abs(p[1]) for p in right_way) < 2e-4


# -- figures


@each(("delay_s", "percent"), [(0.0, 8.0), (0.2, 12.0), (0.3, 20.0), (0.4, 38.0)])
def test_an_ideal_attitude_overshoots_as_the_analysis_says(delay_s: float, percent: float) -> None:
    track = flown(IDEAL, Reference((3.0, 0.0, 20.0)), 12.0, delay_s=delay_s)
    assert (max(p[0] for p in track) / 3.0 - 1.0) * 100 == pytest.approx(percent, abs=0.5)


def test_the_lags_of_an_airframe_cost_overshoot() -> None:
    ideal, lagging = (max(p[0] for p in flown(f, Reference((3.0, 0.0, 20.0)), 12.0)) for f in (IDEAL, LAGS_ONLY))
    assert ideal < 3.25 < lagging < 3.4


def test_wind_of_five_metres_a_second_leaves_no_steady_error() -> None:
    track = flown(F450, Reference((0.0, 0.0, 20.0)), 60.0, wind=Wind((3.0, -4.0, 0.0)))
    assert max(hypot(x, y) for x, y, _ in track) > 0.3
    assert dist(track[-1], (0.0, 0.0, 20.0)) < 0.01


def test_half_the_sub_step_changes_a_step_response_by_less_than_a_centimetre(monkeypatch: pytest.MonkeyPatch) -> None:
    reference = Reference((3.0, 0.0, 21.0))
    coarse = flown(F450, reference, 10.0)
    monkeypatch.setattr(quad_module, "SUB_STEPS", 2 * quad_module.SUB_STEPS)
    fine = flown(F450, reference, 10.0)
    assert 0.0 < max(dist(a, b) for a, b in zip(coarse, fine, strict=True)) < 0.01


# -- physics


def test_hover_thrust_carries_the_weight_at_the_nominal_voltage_only() -> None:
    quad = in_air(F450)
    fly(quad, 3.0)
    assert quad.up_m == pytest.approx(20.0, abs=1e-6)
    for volts, sign in ((16.5, 1.0), (13.8, -1.0)):
        quad = in_air(F450)
        quad.supply_v = volts
        fly(quad, 2.0)
        assert (quad.up_m - 20.0) * sign > 1.0


def test_the_motors_lag_and_saturate() -> None:
    quad = in_air(F450)
    quad.fly(F450.thrust_lag_s, None, 5.0)
    assert quad.thrust == pytest.approx(1.0 - (1.0 - HOVER) / 2.71828, abs=0.01), "63 % of the way to full thrust"
    quad.fly(2.0, None, -3.0)
    assert quad.thrust == pytest.approx(0.0, abs=1e-6)


def test_the_attitude_follows_within_its_lag_and_not_faster_than_it_can_turn() -> None:
    quad = in_air(F450)
    fly(quad, 0.16, roll=0.1)
    assert quad.roll_rad == pytest.approx(0.1 * (1 - 2.71828 ** (-0.16 / 0.15)), rel=0.01)
    quad = in_air(F450)
    quad.fly(0.02, quaternion_from_euler(1.3, 0.0, 0.0), HOVER)
    assert quad.roll_rate_radps == pytest.approx(F450.tilt_rate_max_radps)
    quad = in_air(IDEAL)
    quad.fly(0.02, quaternion_from_euler(0.4, -0.3, 0.0), HOVER)
    assert (quad.roll_rad, quad.pitch_rad) == pytest.approx((0.4, -0.3)), "without lag it is there at once"


def test_the_tilt_comes_first_and_the_yaw_when_it_can() -> None:
    quad = in_air(replace(IDEAL, yaw_rate_max_radps=1.0))
    for _ in range(50):
        quad.fly(DT, quaternion_from_euler(0.2, -0.1, 3.0), HOVER)
    assert 0.9 < quad.yaw_rad < 1.1, "one radian in a second"
    # the up axis is where the setpoint has it all the time: a_east / a_up as the setpoint's
    w, x, y, z = quad.attitude_ned_frd
    sw, sx, sy, sz = quaternion_from_euler(0.2, -0.1, 3.0)
    assert 2 * (x * z + w * y) == pytest.approx(2 * (sx * sz + sw * sy), abs=1e-9)
    assert 2 * (y * z - w * x) == pytest.approx(2 * (sy * sz - sw * sx), abs=1e-9)


def test_it_is_carried_along_by_the_wind_and_slowed_by_still_air() -> None:
    drifting = in_air(F450, wind=Wind((4.0, 3.0, 0.0)))
    fly(drifting, 60.0)
    assert (drifting.vel_e_mps, drifting.vel_n_mps) == pytest.approx((4.0, 3.0), abs=0.05)
    fast = in_air(F450)
    fly(fast, 60.0, pitch=-radians(35))
    assert 14.0 < fast.groundspeed_mps < 16.0


def test_without_motors_it_falls_to_a_terminal_speed_and_crashes_where_it_hits() -> None:
    quad = Quad(wind=Wind((6.0, 0.0, 0.0), gust_mps=1.0))
    quad.place(0.0, 0.0, 200.0)
    fastest = 0.0
    for _ in range(900):
        quad.step(DT, None, LIMITS)
        fastest = min(fastest, quad.vel_u_mps)
    assert -20.0 < fastest < -17.0
    assert quad.on_ground and quad.up_m == 0.0 and quad.groundspeed_mps == 0.0
    where = quad.pos_enu_m
    for _ in range(500):
        quad.fly(DT, quaternion_from_euler(0.3, 0.2, 1.0), 0.9 * HOVER)
    assert quad.pos_enu_m == where, "it neither slides nor sinks, whatever it leans"
    assert quad.crashed and quad.lean_deg == pytest.approx(90.0)
    quad.step(0.5, AttitudeSetpoint(level(quad.yaw_rad), 0.9), LIMITS)
    assert quad.pos_enu_m == where, "and on its side it stays, whatever its motors do"


def test_set_down_gently_it_lies_level_and_more_than_its_weight_lifts_it_again() -> None:
    quad = Quad()
    quad.place(0.0, 0.0, 0.5)
    for _ in range(100):
        quad.step(DT, None, LIMITS)
    assert quad.on_ground and not quad.crashed and (quad.roll_rad, quad.pitch_rad) == (0.0, 0.0)
    quad.step(0.5, AttitudeSetpoint(level(quad.yaw_rad), 0.7), LIMITS)
    assert quad.up_m > 0.0


def test_gusts_have_the_strength_asked_for_and_the_same_seed_the_same_gusts() -> None:
    winds = [Wind((2.0, 0.0, 0.0), gust_mps=1.5, seed=s) for s in (7, 7, 8)]
    series = [[wind.step(DT) for _ in range(60_000)] for wind in winds]
    assert series[0] == series[1] != series[2]
    east = [e - 2.0 for e, _, _ in series[0]]
    mean = sum(east) / len(east)
    assert abs(mean) < 0.4
    assert (sum((e - mean) ** 2 for e in east) / len(east)) ** 0.5 == pytest.approx(1.5, rel=0.1)


@settings(max_examples=examples(50))
@given(
    attitudes=st.lists(
        st.tuples(st.floats(-pi, pi), st.floats(-1.5, 1.5), st.floats(-pi, pi), st.floats(-1.0, 2.0)), max_size=30
    ),
    lag=st.sampled_from([0.0, 0.15]),
)
def test_no_sequence_of_attitudes_breaks_it(attitudes: list[tuple[float, float, float, float]], lag: float) -> None:
    quad = in_air(replace(F450, attitude_lag_s=lag), wind=Wind((5.0, 0.0, 0.0), 2.0))
    for roll, pitch, yaw, thrust in attitudes:
        for _ in range(10):
            quad.fly(DT, quaternion_from_euler(roll, pitch, yaw), thrust)
            assert quad.up_m >= 0.0
            assert hypot(*quad.attitude_ned_frd) == pytest.approx(1.0)
            assert hypot(*quad.vel_enu_mps) < 60.0
            assert 0.0 <= quad.thrust <= 1.0
