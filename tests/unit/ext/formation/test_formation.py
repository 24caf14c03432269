"""Flying in formation: who leads, the filter that keeps apart, and the evasion when it cannot."""

from __future__ import annotations

import itertools
import math
import random
from types import SimpleNamespace
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pydantic import ValidationError

from skygcs.config.models import FleetConfig
from skygcs.errors import RefusedError
from skygcs.ext.formation.config import FormationConfig
from skygcs.ext.formation.evasion import Evasion, straight_to
from skygcs.ext.formation.extension import MOST_MEMBERS, Formation
from skygcs.ext.formation.formation_flight import FormationFlight, FormationState
from skygcs.ext.formation.leader import Fly, GoTo, Leader, Stay
from skygcs.ext.formation.separation_filter import (
    LONGEST_STEP_S,
    Member,
    MotionBounds,
    Moving,
    Obstacle,
    SeparationFilter,
    Vector,
)
from support.examples import seeds
from support.formation_encounters import encounter, places
from support.table import each

# -- The states of a formation's flight.


BOUNDS = MotionBounds()
STARTS = {"a": (0.0, 5.0, 10.0), "b": (0.0, -5.0, 10.0)}
FLYING, STOPPING, STOPPED = FormationState


def flight(led_by: str | None = None) -> FormationFlight:
    leader = Leader(Moving((0.0, 0.0, 10.0)), 0.0, BOUNDS, {"a": (0.0, 5.0, 0.0), "b": (0.0, -5.0, 0.0)})
    members = {name: Member(2.0, Moving(start)) for name, start in STARTS.items()}
    return FormationFlight(leader, SeparationFilter(members, BOUNDS, 2.0), {"a": 1.0, "b": 1.0}, led_by)


class Run:
    """Steps, with members that are where their references are."""

    def __init__(self, formation: FormationFlight) -> None:
        self.formation, self.now = formation, 0.0

    def step(self, seconds: float, *, leader: Moving | None = None, **seen: Moving | None) -> dict[str, object]:
        """``seen``: those that are elsewhere; None: not seen."""
        sent: dict[str, object] = {}
        for _ in range(round(seconds / 0.1)):
            self.now += 0.1
            members = {name: member.moving for name, member in self.formation.filter.members.items()}
            members.update(seen)  # type: ignore[arg-type]
            known = {name: moving for name, moving in members.items() if moving is not None}
            sent = dict(self.formation.step(known, leader, [], 0.1, self.now))
        return sent


def test_it_stops_by_braking_and_then_sends_nothing() -> None:
    run = Run(flight())
    run.formation.leader.demand = Fly((1.5, 0.0, 0.0), 100.0)
    assert run.step(5.0).keys() == {"a", "b"}
    run.formation.stop("asked for")
    assert run.formation.state is STOPPING and run.step(0.5).keys() == {"a", "b"}
    run.step(3.0)
    assert run.formation.state is STOPPED and run.step(0.1) == {}
    run.formation.stop("again")
    assert run.formation.reason == "asked for"


def test_one_that_is_off_its_reference_for_a_second_stops_all() -> None:
    run, away = Run(flight()), Moving((0.0, 7.0, 10.0))
    run.step(0.8, a=away)
    run.step(0.2)
    run.step(0.8, a=away)
    assert run.formation.state is FLYING
    run.step(0.5, a=away)
    assert run.formation.state is not FLYING and "a is off: 2.0 m from its reference" in run.formation.reason


def test_one_that_is_not_seen_stops_all() -> None:
    run = Run(flight())
    run.step(1.5, b=None)
    assert "b is off: its position is old" in run.formation.reason


def test_one_that_leaves_is_sent_nothing_more_and_stops_the_others() -> None:
    run = Run(flight())
    run.formation.leave("a", "it was given another order")
    run.formation.leave("a", "twice")
    assert run.step(0.1).keys() == {"b"}
    assert run.formation.reason == "a left: it was given another order"
    assert run.formation.members == ["b"]
    expected = ["it was given another order", None]
    assert [member["left"] for member in run.formation.status(run.now)["members"]] == expected


def test_a_leader_that_is_not_seen_stops_all() -> None:
    run = Run(flight("lead"))
    run.step(0.5, leader=Moving((0.0, 0.0, 10.0)))
    assert run.formation.state is FLYING
    run.step(0.1)
    assert "lead, which leads, is not seen" in run.formation.reason


def test_its_status_has_distances_and_whether_it_is_settled() -> None:
    run = Run(flight())
    run.step(1.0)
    status = run.formation.status(run.now)
    assert status["settled"] and status["rms_m"] == 0.0 and status["least_m"] == pytest.approx(10.0)
    run.formation.leader.wanted_yaw_rad = 1.0
    run.step(0.3)
    assert not run.formation.status(run.now)["settled"]


def test_a_programs_places_hold_until_then_and_then_all_stay() -> None:
    run = Run(flight())
    run.formation.guide({"a": Moving((3.0, 5.0, 10.0), (0.5, 0.0, 0.0))}, until=4.0)
    run.step(3.5)
    assert run.formation.guided and run.formation.status(run.now)["leader"] == "program"
    assert not run.formation.status(run.now)["settled"]
    a = run.formation.filter.members["a"].moving
    assert a.pos_enu_m[0] > 2.0 and a.vel_enu_mps[0] > 0.4
    assert run.formation.filter.members["b"].moving.pos_enu_m == pytest.approx(STARTS["b"])
    run.step(6.0)
    assert not run.formation.guided and run.formation.status(run.now)["settled"]
    assert run.formation.filter.members["a"].moving.pos_enu_m[0] < 7.0


def test_after_a_pause_of_the_loop_the_leader_does_not_run_ahead() -> None:
    formation = flight()
    formation.leader.demand = Fly((1.5, 0.0, 0.0), 100.0)
    seen = {name: member.moving for name, member in formation.filter.members.items()}
    formation.step(seen, None, [], 20.0, 20.0)
    assert formation.leader.moving.pos_enu_m[0] < 0.1
    assert formation.leader.moving.vel_enu_mps[0] <= 1.5


# -- The table [formation], and the vehicles that may be members.


def test_an_empty_table_is_enough_and_bad_values_are_refused() -> None:
    assert FormationConfig().speed_mps == 2.0
    for bad in ({"speed_mps": 0.0}, {"lowest_m": -1.0}, {"speed": 2.0}, {"climb_mps": float("nan")}):
        with pytest.raises(ValidationError):
            FormationConfig.model_validate(bad)


def test_a_daemon_that_keeps_no_vehicles_flies_no_formation() -> None:
    fleet = FleetConfig.model_validate({"daemon": {"keep_vehicles": False}})
    (problem,) = Formation.problems(FormationConfig(), fleet)
    assert "keep_vehicles" in problem.text
    assert Formation.problems(FormationConfig(), FleetConfig()) == []


async def test_more_members_than_a_step_has_time_for_are_refused() -> None:
    many: list[Any] = [SimpleNamespace(name=f"v{n}") for n in range(MOST_MEMBERS + 1)]
    core: Any = SimpleNamespace(fleet=SimpleNamespace(resolve=lambda targets: many))
    formation = Formation(core, FormationConfig())
    wanted: Any = SimpleNamespace(targets="all", leader=None)
    with pytest.raises(RefusedError, match="30 members at most"):
        await formation.begin(wanted)
    assert formation.status() == {"state": "none", "members": []}


# -- The leader moves by ramps, and the places about it move as they say.


LEADER_BOUNDS = MotionBounds(speed_mps=4.0, climb_mps=1.0, acc_xy_mps2=1.5, acc_z_mps2=0.8)
OFFSETS = {"a": (6.0, 0.0, 0.0), "b": (0.0, 9.0, 2.0), "c": (-4.0, -3.0, 0.0)}
DT_S = 0.1


def leader() -> Leader:
    return Leader(Moving((0.0, 0.0, 10.0)), 0.0, LEADER_BOUNDS, OFFSETS)


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
            assert math.hypot(*speed[:2]) < LEADER_BOUNDS.speed_mps * 1.3
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


# -- References get around each other, mostly.


def flown(starts: list[Vector], goals: list[Vector], seconds: float, obstacles: list[Obstacle]) -> SeparationFilter:
    names = [f"v{i}" for i in range(len(starts))]
    members = {name: Member(2.0, Moving(start)) for name, start in zip(names, starts, strict=True)}
    filter_, evasion = SeparationFilter(members, BOUNDS, 2.0), Evasion()
    wanted = {name: Moving(goal) for name, goal in zip(names, goals, strict=True)}
    for step in range(round(seconds / 0.1)):
        filter_.step(evasion.asked(filter_, wanted, obstacles, step * 0.1), obstacles, 0.1)
    return filter_


def off_m(filter_: SeparationFilter, goals: list[Vector]) -> list[float]:
    return [math.dist(m.moving.pos_enu_m, goal) for m, goal in zip(filter_.members.values(), goals, strict=True)]


@each("away", [(20.0, 0.0, 0.0), (0.0, 0.0, 20.0), (8.0, 8.0, 4.0)])
def test_two_change_places(away: Vector) -> None:
    a = (0.0, 0.0, 10.0)
    b = (a[0] + away[0], a[1] + away[1], a[2] + away[2])
    assert max(off_m(flown([a, b], [b, a], 70.0, []), [b, a])) < 0.3


def test_eight_on_a_circle_change_places_with_those_across() -> None:
    circle = [(12.0 * math.cos(k * math.pi / 4), 12.0 * math.sin(k * math.pi / 4), 15.0) for k in range(8)]
    goals = circle[4:] + circle[:4]
    assert max(off_m(flown(circle, goals, 90.0, []), goals)) < 0.3


def test_one_that_stands_in_the_way_gives_way_and_comes_back() -> None:
    starts = [(0.0, 0.0, 10.0), (10.0, 0.0, 10.0)]
    goals = [(20.0, 0.0, 10.0), (10.0, 0.0, 10.0)]
    assert max(off_m(flown(starts, goals, 40.0, []), goals)) < 0.3


def test_four_that_begin_nearer_than_they_should_get_apart_and_arrive() -> None:
    starts = [(3.5 * k, 0.0, 10.0) for k in range(4)]
    goals = [(x, y, 10.0) for x, y in ((0.0, 7.0), (6.0, 3.0), (6.0, -7.0), (12.0, -2.0))]
    assert max(off_m(flown(starts, goals, 60.0, []), goals)) < 0.3


def test_an_obstacle_is_flown_around() -> None:
    goals = [(30.0, 0.0, 10.0)]
    stands = [Obstacle("x", (15.0, 0.0, 10.0), (0.0, 0.0, 0.0), 2.0)]
    assert off_m(flown([(0.0, 0.0, 10.0)], goals, 40.0, stands), goals)[0] < 0.3


def test_a_place_that_is_taken_is_waited_for_nearby() -> None:
    goals = [(15.0, 0.0, 10.0)]
    stands = [Obstacle("x", (15.0, 0.0, 10.0), (0.0, 0.0, 0.0), 2.0)]
    assert 4.0 <= off_m(flown([(0.0, 0.0, 10.0)], goals, 60.0, stands), goals)[0] < 25.0


def test_a_formation_that_moves_as_one_hinders_nobody() -> None:
    starts = [(5.0 * k, 0.0, 10.0) for k in range(5)]
    members = {f"v{k}": Member(2.0, Moving(start)) for k, start in enumerate(starts)}
    filter_, evasion = SeparationFilter(members, BOUNDS, 2.0), Evasion()
    for step in range(100):
        along_m = 1.5 * step * 0.1
        wanted = {
            f"v{k}": Moving((x, y + along_m, z), (0.0, 1.5, 0.0)) for k, (x, y, z) in enumerate(starts)
        }  # fmt: skip
        filter_.step(evasion.asked(filter_, wanted, [], step * 0.1), [], 0.1)
        assert not any(progress.hindered(step * 0.1) for progress in evasion.progress.values())


def test_the_velocity_towards_a_place_lets_it_stop_there() -> None:
    moving = Moving((0.0, 0.0, 10.0))
    for step in range(400):
        velocity = straight_to(moving, Moving((20.0, -10.0, 14.0)), BOUNDS)
        pos = [p + v * 0.1 for p, v in zip(moving.pos_enu_m, velocity, strict=True)]
        moving = Moving((pos[0], pos[1], pos[2]), velocity)
        assert step > 0 or math.hypot(*velocity[:2]) <= BOUNDS.speed_mps + 1e-9
    assert math.dist(moving.pos_enu_m, (20.0, -10.0, 14.0)) < 0.01


@each("seed", seeds(6))
def test_vehicles_in_the_wind_keep_their_footprints_clear(seed: int) -> None:
    outcome = encounter(seed, seconds=25.0, strangers=False)
    assert outcome.references_m >= 0.0
    assert outcome.vehicles_m > 0.5


# -- The filter keeps every distance, whatever is asked of it.


RATIO = 2.0
FILTER_BOUNDS = MotionBounds(speed_mps=3.0, climb_mps=1.5, acc_xy_mps2=2.0, acc_z_mps2=1.0)


def filter_of(*starts: Vector, radius_m: float = 2.0, **more: object) -> SeparationFilter:
    members = {f"v{i}": Member(radius_m, Moving(start)) for i, start in enumerate(starts)}
    return SeparationFilter(members, FILTER_BOUNDS, RATIO, **more)  # type: ignore[arg-type]


def between(before: dict[str, Moving], filter_: SeparationFilter, dt_s: float, share: float) -> dict[str, Vector]:
    """Where all are at a share of a step: the accelerations are constant, and one that stands within it stands."""
    found = {}
    for name, member in filter_.members.items():
        (pos, vel), acc, t_s = before[name], member.acc_enu_mps2, share * dt_s
        if member.taken is None and any(vel):
            t_s = min(t_s, math.hypot(*vel) / math.hypot(*acc))
        point = tuple(p + v * t_s + a * t_s * t_s / 2 for p, v, a in zip(pos, vel, acc, strict=True))
        found[name] = (point[0], point[1], point[2])
    return found


velocities = st.tuples(*(st.floats(-50.0, 50.0) for _ in range(3)))


@settings(max_examples=40)
@given(
    seed=st.integers(0, 10_000),
    count=st.integers(2, 8),
    steps=st.lists(st.tuples(st.floats(0.01, 0.5), velocities), min_size=1, max_size=60),
    near=st.floats(0.3, 1.5),
)
def test_no_pair_comes_nearer_than_is_promised(
    seed: int, count: int, steps: list[tuple[float, Vector]], near: float
) -> None:
    """Also for pairs that begin nearer than they should; looked at within the steps, too."""
    rng = random.Random(seed)
    filter_ = filter_of(*places(rng, count, 15.0, 4.0 * near))
    names = list(filter_.members)
    for dt_s, velocity in steps:
        before = {name: member.moving for name, member in filter_.members.items()}
        kept = {(a, b): filter_.kept_m(a, b) for a, b in itertools.combinations(names, 2)}
        rng.shuffle(names)
        asked = {
            name: [tuple(v * rng.uniform(-1.0, 1.0) for v in velocity), velocity]
            for name in names
            if rng.random() < 0.8
        }
        filter_.step(asked, [], dt_s)  # type: ignore[arg-type]
        for share in (0.25, 0.5, 0.75, 1.0):
            at = between(before, filter_, min(dt_s, LONGEST_STEP_S), share)
            for (a, b), kept_m in kept.items():
                away_m = math.dist(filter_.metric(at[a]), filter_.metric(at[b]))
                assert away_m >= kept_m - 1e-9, (a, b, away_m, kept_m)
        for name, member in filter_.members.items():
            assert member.moving.pos_enu_m == pytest.approx(between(before, filter_, min(dt_s, 0.3), 1.0)[name])
            assert math.hypot(*member.acc_enu_mps2[:2]) <= FILTER_BOUNDS.acc_xy_mps2 + 1e-9
            assert abs(member.acc_enu_mps2[2]) <= FILTER_BOUNDS.acc_z_mps2 + 1e-9
            assert math.hypot(*member.moving.vel_enu_mps[:2]) <= FILTER_BOUNDS.speed_mps * 20


@each("nonsense", [math.nan, math.inf, -math.inf, 1e300])
def test_what_is_no_velocity_is_not_taken(nonsense: float) -> None:
    filter_ = filter_of((0.0, 0.0, 10.0), (9.0, 0.0, 10.0))
    for _ in range(20):
        filter_.step({"v0": [(nonsense, 0.0, 0.0), (0.0, nonsense, nonsense), (0.0, 1.0, 0.0)]}, [], 0.1)
    member = filter_.members["v0"]
    assert all(map(math.isfinite, (*member.moving.pos_enu_m, *member.moving.vel_enu_mps, *member.acc_enu_mps2)))
    assert math.hypot(*member.moving.vel_enu_mps[:2]) <= FILTER_BOUNDS.acc_xy_mps2 * 2.0 + 1e-6
    assert filter_.distance_m("v0", "v1") >= 4.0


def fly(filter_: SeparationFilter, asked: dict[str, list[Vector]], seconds: float) -> None:
    for _ in range(round(seconds / 0.1)):
        filter_.step(asked, [], 0.1)


def test_two_that_are_sent_into_each_other_stand_before_their_distance() -> None:
    filter_ = filter_of((0.0, 0.0, 10.0), (40.0, 0.0, 10.0))
    fly(filter_, {"v0": [(3.0, 0.0, 0.0)], "v1": [(-3.0, 0.0, 0.0)]}, 30.0)
    assert 4.0 <= filter_.distance_m("v0", "v1") < 4.3
    assert all(math.hypot(*member.moving.vel_enu_mps) < 0.1 for member in filter_.members.values())


def test_heights_count_by_the_downwash_ratio() -> None:
    filter_ = filter_of((0.0, 0.0, 10.0), (0.0, 0.0, 40.0))
    fly(filter_, {"v1": [(0.0, 0.0, -1.5)]}, 40.0)
    up_m = filter_.members["v1"].moving.pos_enu_m[2] - 10.0
    assert 8.0 <= up_m < 8.5


def test_two_that_begin_too_near_come_no_nearer_and_keep_what_they_gain() -> None:
    filter_ = filter_of((0.0, 0.0, 10.0), (3.0, 0.0, 10.0))
    fly(filter_, {"v0": [(3.0, 0.0, 0.0)]}, 10.0)
    assert filter_.distance_m("v0", "v1") >= 2.94
    fly(filter_, {"v1": [(1.0, 0.0, 0.0)]}, 6.0)
    fly(filter_, {"v0": [(3.0, 0.0, 0.0)]}, 10.0)
    assert 4.0 <= filter_.distance_m("v0", "v1") < 4.3
    assert filter_.kept_m("v0", "v1") == 4.0


def test_the_first_that_fits_is_taken_and_said() -> None:
    filter_ = filter_of((0.0, 0.0, 10.0), (5.0, 0.0, 10.0))
    for _ in range(30):
        filter_.step({"v0": [(3.0, 0.0, 0.0), (0.0, 1.0, 0.0)]}, [], 0.1)
    assert filter_.members["v0"].taken == 1
    assert filter_.members["v1"].taken is None
    assert filter_.members["v0"].moving.vel_enu_mps[1] > 0.8


def test_where_it_may_not_stand_it_does_not_go() -> None:
    filter_ = filter_of((0.0, 0.0, 10.0), allowed=lambda name, moving, stands: stands[0] <= 12.0)
    fly(filter_, {"v0": [(3.0, 0.0, 0.0)]}, 30.0)
    assert 11.0 < filter_.members["v0"].moving.pos_enu_m[0] <= 12.0


@each("speed_mps", [0.0, 1.0])
def test_around_an_obstacle_that_flies_straight_on_there_is_room(speed_mps: float) -> None:
    filter_ = filter_of((0.0, 0.0, 10.0))
    for step in range(300):
        here = (30.0 - speed_mps * step * 0.1, 0.0, 10.0)
        stranger = Obstacle("x", here, (-speed_mps, 0.0, 0.0), 2.0)
        away = (-3.0, 0.0, 0.0)
        filter_.step({"v0": [(3.0, 0.0, 0.0), away]}, [stranger], 0.1)
        assert math.dist(filter_.members["v0"].moving.pos_enu_m, here) >= 4.0 - 1e-6


def test_the_backup_leads_to_rest_where_braking_leads() -> None:
    filter_ = filter_of((0.0, 0.0, 10.0))
    fly(filter_, {"v0": [(2.0, 1.0, 0.5)]}, 5.0)
    foreseen = filter_.backup("v0", 0.1, 40)
    for point in foreseen[1:]:
        filter_.step({}, [], 0.1)
        assert filter_.members["v0"].moving.pos_enu_m == pytest.approx(point)
    assert filter_.members["v0"].moving.vel_enu_mps == (0.0, 0.0, 0.0)
