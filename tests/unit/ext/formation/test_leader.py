"""The leader moves by ramps, and the places about it move as they say."""

from __future__ import annotations

import itertools
import math

import pytest

from skygcs.ext.formation.leader import Fly, GoTo, Leader, Stay
from skygcs.ext.formation.separation_filter import MotionBounds, Moving

BOUNDS = MotionBounds(speed_mps=4.0, climb_mps=1.0, acc_xy_mps2=1.5, acc_z_mps2=0.8)
OFFSETS = {"a": (6.0, 0.0, 0.0), "b": (0.0, 9.0, 2.0), "c": (-4.0, -3.0, 0.0)}
DT_S = 0.1


def leader() -> Leader:
    return Leader(Moving((0.0, 0.0, 10.0)), 0.0, BOUNDS, OFFSETS)


def test_it_goes_to_a_place_and_stays() -> None:
    lead = leader()
    lead.demand = GoTo((30.0, 10.0, 14.0), 10.0)
    speeds = []
    for step in range(400):
        lead.step(DT_S, step * DT_S)
        speeds.append(math.hypot(*lead.moving.vel_enu_mps[:2]))
    assert isinstance(lead.demand, Stay) and lead.rests
    assert math.dist(lead.moving.pos_enu_m, (30.0, 10.0, 14.0)) < 0.1
    assert max(speeds) <= 3.0 + 1e-9  # three quarters of the members'


def test_a_velocity_ends_by_itself() -> None:
    lead = leader()
    lead.demand = Fly((0.0, 2.0, 0.0), 5.0)
    for step in range(150):
        lead.step(DT_S, step * DT_S)
        if step == 40:
            assert lead.moving.vel_enu_mps[1] == pytest.approx(2.0, abs=0.05)
    assert lead.rests and 8.0 < lead.moving.pos_enu_m[1] < 16.0


def test_turns_and_scales_end_where_they_should_the_shorter_way_round() -> None:
    lead = leader()
    lead.wanted_yaw_rad, lead.wanted_scale = math.radians(-150.0), 1.6
    assert not lead.rests
    turned = 0.0
    for step in range(600):
        before = lead.yaw_rad
        lead.step(DT_S, step * DT_S)
        turned += math.remainder(lead.yaw_rad - before, math.tau)
    assert lead.rests
    assert turned == pytest.approx(math.radians(-150.0), abs=0.02)
    assert lead.scale == pytest.approx(1.6, abs=0.01)


def test_places_move_with_the_velocity_that_they_say_and_no_faster_than_a_member_flies() -> None:
    lead = leader()
    lead.demand = GoTo((40.0, 0.0, 12.0), 2.0)
    lead.wanted_yaw_rad, lead.wanted_scale = math.radians(120.0), 1.4
    before = lead.places()
    for step in range(200):
        lead.step(DT_S, step * DT_S)
        after = lead.places()
        for name, moving in after.items():
            speed = [(q - p) / DT_S for p, q in zip(before[name].pos_enu_m, moving.pos_enu_m, strict=True)]
            said = [(u + v) / 2 for u, v in zip(before[name].vel_enu_mps, moving.vel_enu_mps, strict=True)]
            assert speed == pytest.approx(said, abs=0.12)
            assert math.hypot(*speed[:2]) < BOUNDS.speed_mps * 1.3
        before = after


def test_a_leader_that_is_a_vehicle_is_where_that_is() -> None:
    lead = leader()
    lead.follow(Moving((5.0, 5.0, 20.0), (20.0, 0.0, 0.0)), DT_S)
    assert lead.moving.pos_enu_m == (5.0, 5.0, 20.0)
    assert math.hypot(*lead.moving.vel_enu_mps) == pytest.approx(3.0)


def test_places_keep_their_distances_when_turned() -> None:
    lead = leader()
    a = lead.places_at((0.0, 0.0, 10.0), 0.0, 1.0)
    b = lead.places_at((9.0, 9.0, 30.0), 2.0, 2.0)
    for one, other in itertools.combinations(OFFSETS, 2):
        assert math.dist(b[one], b[other]) == pytest.approx(2.0 * math.dist(a[one], a[other]))
