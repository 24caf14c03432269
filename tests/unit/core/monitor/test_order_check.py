"""Courses compared on all their way: against dense sampling, at the margin, and what bounds the work."""

from __future__ import annotations

import cmath
import itertools
import math
import random
import re
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from skygcs.core.geo import EnuFrame, ecef
from skygcs.core.monitor import order_check
from skygcs.core.monitor.approach import REST, Vector
from skygcs.core.monitor.order_check import (
    NEARER_M,
    Course,
    Mover,
    Other,
    TrajectorySpace,
    bow_m,
    find_conflicts,
    goto_conflict,
    mover_frame,
    of_track,
    on_trajectory,
    setpoint_conflict,
    space_conflict,
    takeoff_conflict,
)
from skygcs.core.monitor.tracks import Place, Sample, Track, soon_mps
from skygcs.core.monitor.ways import Way, along, distance_m, sloped, standing, turning_points
from skygcs.core.separation import Footprint, pair_margin, separation_m
from skygcs.core.trajectory import Piece, Trajectory, TrajectoryClock
from skygcs.core.vehicle.trajectory_flight import LoadedTrajectory, TrajectoryFlight, common_clock
from support.examples import examples, seeds
from support.table import each
from support.watched_fleet import ORIGIN, WatchedVehicle

MARGIN = pair_margin(Footprint(), Footprint())
NEED_M = MARGIN.total_m


def course(key: int, loaded: LoadedTrajectory, clock: TrajectoryClock, **also: float) -> Course:
    def at(after_s: float) -> tuple[float, float, float]:
        return loaded.trajectory.at(clock.foreseen_s(after_s)).pos_enu_m

    speed = loaded.peaks.speed_mps.at_most * clock.speed_factor
    bow = bow_m(loaded, clock.speed_factor, clock.rate_limit_per_s * loaded.peaks.speed_mps.at_most)
    return Course(key, f"v{key}", Footprint(), at, speed, bow, **also)


def curve(rng: random.Random, duration_s: float) -> Trajectory:
    """Of degree 3, within some 20 m."""
    axis = [(rng.uniform(-10, 10), rng.uniform(-2, 2), rng.uniform(-0.2, 0.2), rng.uniform(-0.01, 0.01)) for _ in "xyz"]
    return Trajectory([Piece(duration_s, *axis)])


def conflicts(*courses: Course | Way, end_s: float) -> dict[int, str]:
    found: dict[int, str] = {}
    for _ in find_conflicts(courses[:1], courses[1:], end_s, found):
        pass
    return found


@each("seed", seeds(20))
def test_it_agrees_with_dense_sampling(seed: int) -> None:
    rng = random.Random(seed)
    loaded = [LoadedTrajectory(curve(rng, rng.uniform(5.0, 20.0))) for _ in range(2)]
    clocks = []
    for one in loaded:
        clock = common_clock([one], 1.0, rng.choice((0.5, 1.0, 1.7)))
        clock.start(0.0, rng.uniform(0.0, 5.0))
        clocks.append(clock)
    a, b = (course(n, one, clock) for n, (one, clock) in enumerate(zip(loaded, clocks, strict=True), 1))
    end_s = max(clock.finishes_at_s(0.0) or 0.0 for clock in clocks)
    sampled = [
        separation_m(*(q - p for p, q in zip(a.at(t), b.at(t), strict=True)), MARGIN.downwash_ratio)
        for t in (end_s * k / 5000 for k in range(5001))
    ]
    least_m, found = min(sampled), conflicts(a, b, end_s=end_s)
    if sampled[0] < NEED_M:
        return
    slack_m = a.bow_m + b.bow_m + 0.01
    if least_m < NEED_M:
        said = SAID.fullmatch(found[1])
        assert said is not None and least_m - slack_m - 0.05 <= float(said[1]) <= least_m + 0.05
    elif least_m > NEED_M + slack_m:
        assert not found


def straight(key: int, place: tuple[float, float, float], velocity: tuple[float, float, float] = (0, 0, 0)) -> Course:
    def at(after_s: float) -> tuple[float, float, float]:
        return place[0] + velocity[0] * after_s, place[1] + velocity[1] * after_s, place[2] + velocity[2] * after_s

    return Course(key, f"v{key}", Footprint(), at, math.hypot(*velocity))


@each(("aside_m", "found"), [(NEED_M - 0.001, True), (NEED_M + 0.001, False)])
def test_a_millimetre_decides_far_ahead(aside_m: float, found: bool) -> None:
    a, b = straight(1, (0.0, 0.0, 20.0), (2.0, 0.0, 0.0)), straight(2, (400.0, aside_m, 20.0))
    assert bool(conflicts(a, b, end_s=300.0)) is found


speed = st.sampled_from((0.0, 0.0, -2.0, -0.5, 0.3, 1.0, 3.0))
spot = st.tuples(st.integers(-8, 8), st.integers(-8, 8), st.integers(-6, 6))
SAID = re.compile(
    r"v\d would come (\S+) m near (v\d) \(in the air\) in (\S+) s; they need (\S+) m, heights divided by 2"
)


@settings(max_examples=examples(150))
@given(
    st.lists(
        st.tuples(spot, st.tuples(speed, speed, speed), st.sampled_from((0.0, 1.5)), st.sampled_from((math.inf, 2.6))),
        min_size=2,
        max_size=5,
    ),
    st.integers(1, 5),
    st.sampled_from((0.1, 1.9, 12.0)),
)
def test_straight_courses_are_compared_exactly(fleet: Any, count: int, end_s: float) -> None:
    """The oracle is the least value of a parabola; of two too near already only what comes nearer is found."""
    flown = [
        replace(straight(n, place, velocity), ball_m=ball_m, known_s=known_s)
        for n, (place, velocity, ball_m, known_s) in enumerate(fleet, 1)
    ]
    found: dict[int, str] = {}
    for _ in find_conflicts(flown[:count], flown[count:], end_s, found):
        pass
    for a in flown[:count]:
        near: list[tuple[float, float, float, str]] = []
        for b in (other for other in flown if other is not a):
            begin, then = ([q - p for p, q in zip(a.at(t), b.at(t), strict=True)] for t in (0.0, 1.0))
            begin[2], then[2] = begin[2] / 2.0, then[2] / 2.0
            moves = [q - p for p, q in zip(begin, then, strict=True)]
            closing, square = sum(p * v for p, v in zip(begin, moves, strict=True)), sum(v * v for v in moves)
            at_s = min(max(0.0, -closing / square), end_s, a.known_s, b.known_s) if square > 1e-9 else 0.0
            least_m = math.hypot(*(p + v * at_s for p, v in zip(begin, moves, strict=True)))
            need_m, begun_m = NEED_M + a.ball_m + b.ball_m, math.hypot(*begin)
            assume(min(abs(least_m - need_m), abs(begun_m - need_m), abs(begun_m - NEARER_M - least_m)) > 1e-6)
            if least_m < need_m and (begun_m >= need_m or least_m < begun_m - NEARER_M):
                near.append((least_m, at_s, need_m, b.name))
        assert (a.key in found) is bool(near)
        if near:
            said = SAID.fullmatch(found[a.key])
            assert said is not None
            least_m, at_s, need_m = (float(said[n]) for n in (1, 3, 4))
            assert least_m == pytest.approx(min(near)[0], abs=0.051)
            assert any(
                name == said[2] and at_s == pytest.approx(when, abs=0.051) and need_m == pytest.approx(need, abs=0.051)
                for least, when, need, name in near
                if least < min(near)[0] + 1e-6
            )
    assert found.keys() <= {one.key for one in flown[:count]}


def test_only_what_comes_before_the_end_and_is_known_counts() -> None:
    a, b = straight(1, (0.0, 0.0, 20.0)), straight(2, (10.0, 1.0, 20.0), (-1.0, 0.0, 0.0))
    assert not conflicts(a, b, end_s=7.6) and conflicts(a, b, end_s=7.8)
    b = straight(2, (40.0, 0.0, 20.0), (-2.0, 0.0, 0.0))
    assert "v1 would come 0.0 m near v2 (in the air) in 20.0 s" in conflicts(a, b, end_s=60.0)[1]
    assert not conflicts(a, replace(b, known_s=10.0), end_s=60.0)


def test_what_is_too_much_is_refused_and_not_passed(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(order_check, "MAX_LOOKS", 50)
    a = straight(1, (0.0, 0.0, 20.0), (1.0, 0.0, 0.0))
    assert "too much to be checked" in conflicts(a, straight(2, (0.0, 2.6, 20.0), (1.0, 0.0, 0.0)), end_s=600.0)[1]


def test_it_gives_others_their_turn() -> None:
    a, b = straight(1, (0.0, 0.0, 20.0), (1.0, 0.0, 0.0)), straight(2, (0.0, 2.6, 20.0), (1.0, 0.0, 0.0))
    assert sum(1 for _ in find_conflicts([a], [b], 600.0, {})) == 600.0 / 0.25 / order_check.LOOKS_A_TURN


@each(
    ("aside_m", "ball_m", "found"), [(NEED_M - 0.01, 0.0, True), (NEED_M + 0.01, 0.0, False), (NEED_M + 0.9, 1.0, True)]
)
def test_a_way_counts_all_the_time(aside_m: float, ball_m: float, found: bool) -> None:
    """Across the course, 380 m ahead of it; its own end is so far beside it."""
    across = Way(2, "v2", Footprint(), sloped([(400.0, 60.0, 20.0), (400.0, aside_m, 20.0)]), ball_m, "returns")
    text = conflicts(straight(1, (0.0, 0.0, 20.0), (2.0, 0.0, 0.0)), across, end_s=300.0).get(1, "")
    said = re.search(r"near v2 \(returns\) in (\S+) s", text)
    assert (199.4 <= float(said[1]) <= 200.0) if found and said else not found, text
    assert not conflicts(straight(1, (0.0, 0.0, 20.0), (2.0, 0.0, 0.0)), across, end_s=190.0), "it stops before"
    curved = Course(1, "v1", Footprint(), lambda at_s: (2.0 * at_s, 0.0, 20.0), 2.0, bow_m=0.1)
    assert bool(conflicts(curved, across, end_s=300.0)) is (found or aside_m < NEED_M + 0.1)


@each(("bows_m", "found"), [((0.2, 0.1), True), ((0.1, 0.1), False)])
def test_what_both_bow_out_counts_also_of_slow_ones(bows_m: tuple[float, float], found: bool) -> None:
    a = replace(straight(1, (0.0, 0.0, 20.0), (0.4, 0.0, 0.0)), bow_m=bows_m[0])
    b = replace(straight(2, (40.0, NEED_M + 0.25, 20.0), (-0.4, 0.0, 0.0)), bow_m=bows_m[1])
    assert bool(conflicts(a, b, end_s=300.0)) is found


@each("factor", [0.5, 1.0, 2.0])
@each(
    ("pieces", "acceleration_mps2", "jump_mps", "shortest_s"),
    [
        # to 3 m/s in a second, there from 3 to 2 m/s at once, and to rest in another one
        ([(1.0, (0.0, 0.0, 1.5)), (1.0, (1.5, 2.0, -1.0))], 3.0, 1.0, 1.0),
        ([(4.0, (0.0, 0.0, 0.5)), (0.5, (8.0, 4.0, -4.0))], 8.0, 0.0, 0.5),
        # slow: no more than is flown in half of the time
        ([(2.0, (0.0, 0.1))], math.inf, 0.1, 2.0),
    ],
)
def test_a_trajectory_bows_by_its_acceleration_its_jumps_and_what_brakes_it(
    pieces: list[tuple[float, tuple[float, ...]]],
    acceleration_mps2: float,
    jump_mps: float,
    shortest_s: float,
    factor: float,
) -> None:
    """Three jumps fit into one chord, more where pieces are shorter than it."""
    loaded = LoadedTrajectory(Trajectory([Piece(lasts_s, axis, (0.0,), (20.0,)) for lasts_s, axis in pieces]))
    clock = common_clock([loaded], 1.0, factor)
    vehicle = WatchedVehicle(1).vehicle
    flown = on_trajectory(vehicle, Footprint(), loaded, clock, lambda at_s: (at_s, 0.0, 0.0))
    speed_mps = factor * loaded.peaks.speed_mps.at_most
    brake_mps2 = clock.rate_limit_per_s * loaded.peaks.speed_mps.at_most
    bent_m = 0.25**2 * (acceleration_mps2 * factor**2 + brake_mps2) / 8.0
    jumps_m = 0.25 * jump_mps * factor / 4.0 * (2.0 + 0.25 * factor / shortest_s)
    assert brake_mps2 > 0.0
    assert flown.bow_m == pytest.approx(min(bent_m + jumps_m, 0.125 * speed_mps), rel=0.01)
    assert (flown.key, flown.name, flown.doing) == (vehicle.key, "v1", "on its trajectory")
    assert flown.speed_mps == speed_mps and flown.at(3.0) == (3.0, 0.0, 0.0)


@each(
    ("velocity", "found"),
    [((0.0, -1.0, 0.0), False), ((0.0, 1.0, 0.0), True), ((-0.85, 0.0, 0.0), True), ((0.85, 0.0, 0.0), False)],
)
def test_one_too_near_a_way_may_leave_it(velocity: tuple[float, float, float], found: bool) -> None:
    beside = Way(2, "v2", Footprint(), sloped([(-50.0, 2.0, 20.0), (50.0, 2.0, 20.0)]))
    assert bool(conflicts(straight(1, (0.0, 0.0, 20.0), velocity), beside, end_s=60.0)) is found


@each("axis", [0, 1, 2])
def test_a_way_that_is_not_known_is_everywhere(axis: int) -> None:
    """It counted as one that is left already, so nothing was refused for it."""
    end = [20.0, 0.0, 10.0]
    end[axis] = math.nan
    lost = Way(2, "v2", Footprint(), sloped([(30.0, 300.0, 20.0), (end[0], end[1], end[2])]), doing="on its mission")
    text = conflicts(straight(1, (0.0, 0.0, 20.0), (0.0, -1.0, 0.0)), lost, end_s=60.0)[1]
    assert "v2 (on its mission)" in text and " near " in text
    found = space_conflict(mover(), at(0.0, -40.0, 0.0), [lost])
    assert found == "v1 may come too near v2: the way of v2 (on its mission) is not known"


# --- orders: v1 hovers or flies at the origin of the frame, v2 is the other one --------------------------------------

NOW = 1000.0

FAST = (0.0, 5.0, 0.0)
"""North: it flies on by 5 x 0.5 m and 25 / (2 x 2) m."""

ON_M = 8.75


def mover(velocity: Vector = (0.0, 0.0, 0.0), circle_m: float = 0.0) -> Mover:
    return Mover(257, "v1", Footprint(), WatchedVehicle(1).geodetic_of(0.0, 0.0, 20.0), circle_m, velocity)


def at(*place_m: float) -> Place:
    """Geodetic, of a place in the frame of the mover."""
    return WatchedVehicle(1).geodetic_of(place_m[0], place_m[1], 20.0 + place_m[2])


def other(
    *place_m: float,
    vel: Vector = (0.0, 0.0, 0.0),
    age_s: float = 0.0,
    key: int = 2,
    sent: Place | None = None,
    **also: Any,
) -> Other:
    vehicle = WatchedVehicle(key).vehicle
    track = Track(vehicle, Footprint(), 0, ecef_m=ecef(*at(*place_m)), at=NOW - age_s, reported_mps=vel, parked=False)
    stays_yet = also.pop("stays_yet", False)
    for name, value in also.items():
        setattr(track, name, value)
    return Other(track, sent, stays_yet)


FORGET = "; once you know that it is not there: skygcs-cli forget v2 --force"

NEED = "; they need 2.5 m, heights divided by 2"


@each(
    ("to", "there", "text"),
    [
        # beside the way, beyond its end, above it
        ((40.0, 0.0, 0.0), other(20.0, 2.48, 0.0), "come 2.48 m near v2 (in the air); they need 2.50 m"),
        ((40.0, 0.0, 0.0), other(20.0, 2.55, 0.0), None),
        ((40.0, 0.0, 0.0), other(42.4, 0.0, 0.0), "v1 would come 2.4 m near v2 (in the air)" + NEED),
        ((40.0, 0.0, 0.0), other(42.6, 0.0, 0.0), None),
        ((40.0, 0.0, 0.0), other(-2.6, 0.0, 0.0), None),
        ((40.0, 0.0, 0.0), other(20.0, 0.0, 4.9), "come 2.45 m near v2 (in the air); they need 2.50 m"),
        ((40.0, 0.0, 0.0), other(20.0, 0.0, -5.1), None),
        ((0.0, 0.0, 0.0), other(2.6, 0.0, 0.0), None),
        # what it is
        ((9.0, 0.0, 0.0), other(9.0, 0.0, 0.0, parked=True, age_s=90.0), "v1 would come 0.0 m near v2 (parked)" + NEED),
        ((9.0, 0.0, 0.0), other(9.0, 2.6, 0.0, parked=True, age_s=90.0, vel=(0.0, -1.0, 0.0)), None),
        (
            (9.0, 0.0, 0.0),
            other(9.0, 0.0, 0.0, stays_yet=True),
            "v1 would come 0.0 m near v2 (in the air, and not seen yet to fly where it was sent)" + NEED,
        ),
        ((9.0, 0.0, 0.0), other(9.0, 0.0, 0.0, key=1), None),
        ((9.0, 0.0, 0.0), other(9.0, 0.0, 0.0, sent=at(0.0, 90.0, 0.0)), None),
        # its position is old: 0.5 x 3 m/s² x (3 s - 1 s)²
        (
            (40.0, 0.0, 0.0),
            other(20.0, 8.4, 0.0, age_s=3.0),
            "v1 would come 8.4 m near v2 (in the air), whose position is 3.0 s old; they need 8.5 m, heights divided "
            "by 2",
        ),
        ((40.0, 0.0, 0.0), other(20.0, 8.6, 0.0, age_s=3.0), None),
        ((40.0, 0.0, 0.0), other(20.0, 2.4, 0.0, age_s=1.0), "v1 would come 2.4 m near v2 (in the air)" + NEED),
        # lost: it grows for 10 s
        (
            (40.0, 0.0, 0.0),
            other(20.0, 120.0, 0.0, age_s=99.0, lost=True),
            "v1 would come 120.0 m near v2 (lost in the air), whose position is 99.0 s old; they need 124.0 m, "
            "heights divided by 2" + FORGET,
        ),
        ((40.0, 0.0, 0.0), other(20.0, 125.0, 0.0, age_s=99.0, lost=True), None),
        ((40.0, 0.0, 0.0), other(20.0, 140.0, 0.0, age_s=99.0, lost=True, vel=(0.0, -2.0, 0.0)), "near v2"),
        ((40.0, 0.0, 0.0), other(20.0, 146.0, 0.0, age_s=99.0, lost=True, vel=(0.0, -2.0, 0.0)), None),
        ((40.0, 0.0, 0.0), other(47.0, 0.0, 0.0, age_s=2.0, lost=True, vel=(-2.0, 0.0, 0.0)), "come 3.0 m near v2"),
        ((40.0, 0.0, 0.0), other(20.0, 0.0, 11.0, age_s=2.0, lost=True, vel=(0.0, 0.0, -2.0)), "come 3.5 m near v2"),
        # it flies straight on, for 10 s after this one is there and no longer than that
        ((10.0, 0.0, 0.0), other(10.0, -10.0, 0.0, vel=(0.0, 2.0, 0.0)), "v1 would come 0.0 m near v2 (in the air)"),
        ((10.0, 0.0, 0.0), other(10.0, -30.0, 0.0, vel=(0.0, 2.0, 0.0)), None),
        ((10.0, 0.0, 0.0), other(10.0, -22.0, 0.0, vel=(0.0, 2.0, 0.0)), "near v2"),
        ((10.0, 0.0, 0.0), other(10.0, -4.0, 0.0, vel=(0.0, 0.3, 0.0)), None),  # it hovers
        ((10.0, 0.0, 0.0), other(10.0, -4.0, 0.0, vel=(0.0, 0.5, 0.0)), "near v2"),
        ((10.0, 0.0, 0.0), other(10.0, -4.0, 0.0, vel=(0.0, -0.5, 0.0)), None),
        # fast and old, straight at it: it is 58 m away by now, and 8 m after the horizon
        ((0.5, 0.0, 0.0), other(0.5, -73.0, 0.0, vel=(0.0, 5.0, 0.0), age_s=3.0), "near v2"),
        # what can circle, but is parked or itself, is where it is
        ((40.0, 0.0, 0.0), other(43.0, 0.0, 0.0, parked=True, circle_m=60.0), None),
        ((9.0, 0.0, 0.0), other(9.0, 0.0, 0.0, key=1, circle_m=60.0), None),
        ((0.0, 0.0, 0.0), other(2.0, 0.0, 0.0), None),
        ((40.0, 0.0, 0.0), other(20.0, 3.8, 0.0, age_s=2.0), "come 3.8 m near v2 (in the air); they need 4.0 m"),
        # too near already: not nearer by more than 0.2 m
        ((-9.0, 0.0, 0.0), other(2.0, 0.0, 0.0), None),
        ((0.15, 0.0, 0.0), other(2.0, 0.0, 0.0), None),
        ((0.25, 0.0, 0.0), other(2.0, 0.0, 0.0), "v1 would come 1.8 m near v2"),
    ],
)
def test_a_goto_is_compared_with_each_other(to: Vector, there: Other, text: str | None) -> None:
    found = goto_conflict(mover(), at(*to), [other(0.0, -90.0, 0.0, key=3), there], NOW)
    assert (found is None) if text is None else (found is not None and text in found), found
    if found is not None and to[0] == 40.0:
        both = goto_conflict(mover(), at(*to), [there, other(10.0, 0.0, 0.0, key=4), there], NOW)
        assert both is not None and "0.0 m near v4" in both, "the nearest one is named"


@each(
    ("height_m", "there", "found"),
    [
        (10.0, other(0.0, 2.4, 5.0), True),
        (10.0, other(0.0, 2.6, 5.0), False),
        (10.0, other(0.0, 0.0, 14.9), True),
        (10.0, other(0.0, 0.0, 15.1), False),
        (10.0, other(0.0, 2.0, 0.0, parked=True), True),  # beside it already: it may be carried sideways
        (10.0, other(0.0, -21.0, 9.0, vel=(0.0, 2.0, 0.0)), True),
        (10.0, other(0.0, -21.0, 9.0, vel=(0.0, 1.0, 0.0)), False),
        (2.0, other(8.0, 0.0, 2.0, vel=(-0.5, 0.0, 0.0)), False),
        (20.0, other(7.0, 0.0, 18.0, vel=(-0.5, 0.0, 0.0)), True),  # it climbs with 2 m/s
    ],
)
def test_a_take_off_is_compared_with_each_other(height_m: float, there: Other, found: bool) -> None:
    assert (takeoff_conflict(mover(), height_m, [there], NOW) is not None) is found


@each(
    ("to", "velocity", "there", "found"),
    [
        ((20.0, 0.0, 0.0), (0.0, 0.0, 0.0), other(10.0, 2.4, 0.0), True),
        ((20.0, 0.0, 0.0), (0.0, 0.0, 0.0), other(10.0, 2.6, 0.0), False),
        ((20.0, 0.0, 0.0), (0.0, 0.0, 0.0), other(20.0, 7.0, 0.0, vel=(0.0, -1.0, 0.0)), False),  # it gets there in 4 s
        ((60.0, 0.0, 0.0), (0.0, 0.0, 0.0), other(60.0, 8.0, 0.0, vel=(0.0, -0.5, 0.0)), True),  # in 12 s
        ((0.0, 0.0, 0.0), (0.0, 0.0, 0.0), other(3.0, 0.0, 0.0, vel=(-1.0, 0.0, 0.0)), False),  # it is there
        (None, (2.0, 0.0, 0.0), other(8.4, 0.0, 0.0), True),  # 3 s of it
        (None, (2.0, 0.0, 0.0), other(8.6, 0.0, 0.0), False),
        (None, (-2.0, 0.0, 0.0), other(2.0, 0.0, 0.0), False),  # too near already, and away from it
        ((0.1, 0.0, 0.0), (0.0, 0.0, 0.0), other(2.0, 0.0, 0.0), True),
        ((0.1, 0.0, 0.0), (0.0, 0.0, 0.0), other(2.0, 0.0, 0.0, parked=True), False),  # a gust beside its neighbour
        (None, (0.0, 0.0, 0.0), other(5.0, 0.0, 0.0, vel=(-1.0, 0.0, 0.0)), True),
        (None, (0.0, 0.0, 0.0), other(6.0, 0.0, 0.0, vel=(-1.0, 0.0, 0.0)), False),
        (None, (1.3, 0.0, 0.0), other(4.5, 4.0, 0.0, vel=(0.0, -8.0, 0.0)), False),  # it is past in time
        (None, (1.3, 0.0, 0.0), other(4.5, 4.0, 0.0, vel=(0.0, -8.0, 0.0))._replace(stops_in_s=0.5), True),
    ],
)
def test_a_setpoint_is_compared_with_each_other(to: Vector | None, velocity: Vector, there: Other, found: bool) -> None:
    place = None if to is None else at(*to)
    assert (setpoint_conflict(mover(), place, velocity, [there], NOW) is not None) is found


@each("aside_deg", [60.0, 70.0, 80.0])
def test_a_stream_of_velocities_leads_no_nearer_however_it_turns(aside_deg: float) -> None:
    """Each of them leads that far past the other vehicle, and is followed for 0.1 s unless it is refused."""
    away = 2.3 + 0j
    for _ in range(100):
        velocity = cmath.rect(1.3, cmath.phase(away) + math.radians(aside_deg))
        if (
            setpoint_conflict(
                mover(), None, (velocity.real, velocity.imag, 0.0), [other(away.real, away.imag, 0.0)], NOW
            )
            is None
        ):
            away -= 0.1 * velocity
    assert abs(away) > 2.2


def flown(points: list[Vector], speed_mps: float) -> list[tuple[float, Vector]]:
    """When it is where, through these points."""
    timed = [(0.0, points[0])]
    for p, q in itertools.pairwise(points):
        timed.append((timed[-1][0] + math.dist(p, q) / speed_mps, q))
    return timed


def where(timed: Sequence[tuple[float, Vector]], at_s: float) -> Vector:
    for (s, p), (t, q) in itertools.pairwise(timed):
        if s <= at_s < t:
            part = (at_s - s) / (t - s)
            return p[0] + part * (q[0] - p[0]), p[1] + part * (q[1] - p[1]), p[2] + part * (q[2] - p[2])
    return timed[-1][1]


def outermost(velocity: Vector, to: Vector, part: float = 1.0) -> list[Vector]:
    """Its way by parts along and across its flight: on by this part of what it needs to stop, and then aside."""
    speed_mps = math.hypot(*velocity)
    on_m = part * (speed_mps * 0.5 + speed_mps * speed_mps / 4.0)
    ahead = [v / speed_mps for v in velocity]
    ahead_m = sum(p * u for p, u in zip(to, ahead, strict=True))
    share = min(1.0, on_m / math.hypot(*to)) if any(to) else 0.0
    corner_m = min(on_m + share * ahead_m, max(on_m, ahead_m))
    stops, corner = (
        tuple(along_m * u + aside * (p - ahead_m * u) for p, u in zip(to, ahead, strict=True))
        for along_m, aside in ((on_m, 0.0), (corner_m, share))
    )
    return [(0.0, 0.0, 0.0), stops, corner, to]


@settings(max_examples=examples(300))
@given(
    st.sampled_from(("goto", "takeoff", "setpoint", "stream")),
    spot,
    st.sampled_from((REST, REST, (0.0, 4.0, 0.0), (-3.0, 2.0, 1.0), (2.0, -1.0, -2.0))),
    st.tuples(st.integers(-14, 14), st.integers(-14, 14), st.integers(-6, 6)),
    st.sampled_from((REST, (-1.0, 0.0, 0.0), (1.0, -2.0, 0.0), (0.0, 1.5, -1.0), (-2.0, 0.5, 0.5))),
    st.sampled_from((0.0, 0.5, 1.5, 3.0)),
    st.sampled_from(({}, {"parked": True}, {"lost": True})),
)
def test_orders_are_compared_as_they_would_be_flown(
    order: str, to: Vector, moves: Vector, place: Vector, vel: Vector, age_s: float, also: dict[str, bool]
) -> None:
    """The oracle flies both, in steps of 10 ms."""
    there = other(*place, vel=vel, age_s=age_s, **also)
    age_s = 0.0 if there.track.parked else age_s
    if there.track.parked:
        vel = REST
    begin = tuple(p + v * age_s for p, v in zip(place, vel, strict=True))
    if there.track.lost:
        vel = REST
    need_m = NEED_M + 1.5 * max(0.0, age_s - 1.0) ** 2

    def meets(
        points: list[Vector], speed_mps: float, on_s: float, *, least_s: float = 0.0, strict: bool = False
    ) -> bool:
        timed = flown(points, speed_mps)
        end_s = max(least_s, timed[-1][0] + on_s)
        if any(vel) and on_s:
            end_s = min(end_s, 10.0)
        apart = []
        for n in range(round(end_s / 0.01) + 1):
            mine, at_s = where(timed, 0.01 * n), 0.01 * n
            x, y, z = (b + v * at_s - p for b, v, p in zip(begin, vel, mine, strict=True))
            apart.append(math.hypot(x, y, z / 2.0))
        least_m, begun_m = min(apart), apart[0]
        assume(abs(least_m - need_m) > 0.08 and abs(begun_m - need_m) > 1e-3)
        assume(begun_m > need_m or abs(begun_m - NEARER_M - least_m) > 0.08)
        return least_m < need_m and (strict or begun_m >= need_m or least_m < begun_m - NEARER_M)

    ends = ""
    if order == "goto":
        text = goto_conflict(mover(moves), at(*to), [there], NOW)
        wanted = meets([REST, to], 5.0, 10.0)
        if not wanted and any(moves):
            parts = (1.0,) if math.hypot(*moves) <= 3.0 else (1.0, 0.5)
            found = [meets(outermost(moves, to, part), 5.0, 10.0) for part in parts]
            wanted, ends = any(found), ", before it has turned there"
    elif order == "takeoff":
        height_m = 8.0 + to[2]
        text = takeoff_conflict(mover(), height_m, [there], NOW)
        wanted = meets([REST, (0.0, 0.0, height_m)], 2.0, 10.0, strict=True)
    elif order == "setpoint":
        text, wanted = setpoint_conflict(mover(), at(*to), REST, [there], NOW), meets([REST, to], 5.0, 0.0)
    else:
        text = setpoint_conflict(mover(), None, moves, [there], NOW)
        wanted = meets([REST, tuple(3.0 * v for v in moves)], math.hypot(*moves) or 1.0, 0.0, least_s=3.0)
    assert (text is not None) is wanted, text
    assert text is None or text.endswith(ends + (FORGET if there.track.lost and not ends else "")), text


@each(
    ("moves", "to", "place", "found"),
    [
        # to the east, out of a flight to the north: on by 8.75 m, as far to the east meanwhile, and back to the way
        (mover(FAST), (40.0, 0.0, 0.0), (4.0, ON_M + 2.4, 0.0), True),
        (mover(FAST), (40.0, 0.0, 0.0), (4.0, ON_M + 2.6, 0.0), False),
        (mover(FAST), (40.0, 0.0, 0.0), (-2.4, 6.0, 0.0), True),
        (mover(FAST), (40.0, 0.0, 0.0), (6.0, 4.4, 0.0), True),  # it may turn earlier
        (mover(FAST), (40.0, 0.0, 0.0), (ON_M + 2.3, ON_M, 0.0), True),
        (mover(FAST), (40.0, 0.0, 0.0), (24.4, 4.4, 0.0), True),  # between the corner and the place
        (mover(FAST), (4.0, 0.0, 0.0), (ON_M, ON_M, 0.0), False),  # never beyond the place
        (mover(FAST), (0.0, 0.0, 0.0), (0.0, ON_M + 2.4, 0.0), True),
        (mover((0.0, 0.0, -5.0)), (40.0, 0.0, 0.0), (4.0, 0.0, -ON_M - 4.0), True),
        (mover((0.0, 0.45, 0.0)), (40.0, 0.0, 0.0), (4.0, 2.6, 0.0), False),  # it drifts
        (mover((0.0, 0.55, 0.0)), (40.0, 0.0, 0.0), (0.0, 2.6, 0.0), True),
        (mover(FAST, 50.0), (200.0, 0.0, 0.0), (4.0, ON_M, 0.0), False),  # it cannot stop: its circle counts
        (replace(mover(FAST), brake_mps2=1.0), (40.0, 0.0, 0.0), (4.0, 17.3, 0.0), True),
        # ahead: no farther than it flies on, or than the place is
        (mover(FAST), (0.5, 12.0, 0.0), (0.0, 14.7, 0.0), False),
        (mover(FAST), (0.0, 4.0, 0.0), (0.0, ON_M + 2.4, 0.0), True),
        (mover(FAST), (0.0, 4.0, 0.0), (0.0, ON_M + 2.6, 0.0), False),
        # it was to stop there anyway
        (replace(mover(FAST), stops_in_m=4.0), (0.0, 4.0, 0.0), (0.0, 6.6, 0.0), False),
        (replace(mover(FAST), stops_in_m=4.0), (0.0, 3.0, 0.0), (0.0, 6.4, 0.0), True),
        (mover(), (40.0, 0.0, 0.0), (4.0, 2.6, 0.0), False),
        # beside the last part of its way, above it, and behind it, where it is not nearer later
        (mover(FAST), (40.0, 0.0, 0.0), (20.0, 3.3, 0.0), True),
        (mover((0.0, 0.0, 5.0)), (40.0, 0.0, 0.0), (20.0, 0.0, 5.3), True),
        (mover(FAST), (40.0, 0.0, 0.0), (0.0, -2.0, 0.0), False),
    ],
)
def test_what_moves_turns_beside_its_way(moves: Mover, to: Vector, place: Vector, found: bool) -> None:
    """Both are compared: a vehicle that stands at the place, and a way that ends there."""
    way = Way(2, "v2", Footprint(), standing(place))
    for text in (goto_conflict(moves, at(*to), [other(*place)], NOW), space_conflict(moves, at(*to), [way])):
        assert (text is not None) is found, text
        assert text is None or text.endswith(", before it has turned there"), text


@given(spot, spot, st.sampled_from((0.1, 1.0, 4.0)), st.sampled_from((REST, FAST, (-3.0, 2.0, 1.0), (0.5, 0.0, -2.0))))
def test_what_turns_flies_on_and_then_aside_wherever_it_is(
    here: Vector, way: Vector, scale: float, moves: Vector
) -> None:
    to: Vector = tuple(h + scale * w for h, w in zip(here, way, strict=True))
    points = turning_points(here, moves, mover(moves).turns_m, to)
    wanted = outermost(moves, tuple(scale * w for w in way)) if any(moves) else [REST]
    assert [p - h for point in points for p, h in zip(point, here, strict=True)] == pytest.approx(
        [*itertools.chain(*wanted)], abs=1e-6
    )


@each(
    ("samples", "soon"),
    [
        ([(0.0, (0.0, 0.5, 0.0)), (0.4, (0.0, 1.5, 0.0))], (0.0, 2.75, 0.0)),  # it speeds up by 2.5 m/s²
        ([(0.0, (0.0, 0.0, 0.0)), (0.25, (0.0, 0.4, 0.0))], (0.0, 1.2, 0.0)),
        ([(0.0, (0.0, 0.0, 0.0)), (0.2, (0.0, 4.0, 0.0))], (0.0, 6.5, 0.0)),  # no vehicle does so
        ([(0.0, (0.0, 4.0, 0.0)), (0.4, (0.0, 3.0, 0.0))], (0.0, 3.0, 0.0)),  # it may speed up again
        ([(0.0, (-1.0, 4.0, 0.0)), (0.4, (0.0, 3.0, 0.0))], (1.25, 3.0, 0.0)),  # but it turns
        ([(0.0, (0.0, 1.0, 0.0)), (0.1, (0.0, 2.0, 0.0))], (0.0, 2.0, 0.0)),  # too soon after the other
        ([(0.0, (0.0, 1.0, 0.0)), (0.4, (0.0, 2.0, 0.0)), (0.5, (0.0, 2.0, 0.0))], (0.0, 3.0, 0.0)),
        ([(0.0, (0.0, 1.0, 0.0)), (2.1, (0.0, 2.0, 0.0))], (0.0, 2.0, 0.0)),  # long ago
        ([(0.0, (0.0, 1.0, 0.0))], (0.0, 1.0, 0.0)),
    ],
)
def test_what_speeds_up_flies_on_farther(samples: list[tuple[float, Vector]], soon: Vector) -> None:
    """A goto to one that had just begun its mission led it 2 m past what was checked (random flight 102)."""
    known = [Sample(*sample) for sample in samples]
    assert soon_mps(known, known[-1]) == pytest.approx(soon)


def test_what_is_on_the_straight_way_is_named_as_such_although_it_turns_first() -> None:
    text = goto_conflict(mover(FAST), at(40.0, 0.0, 0.0), [other(30.0, -2.4, 0.0)], NOW)
    assert text is not None and text.endswith("heights divided by 2")


@each(
    ("to", "ends", "strict", "text"),
    [
        (
            (40.0, 0.0, 0.0),
            [(20.0, 2.4, 0.0), (20.0, 50.0, 0.0)],
            False,
            "v1 would come 2.4 m near v2 (returns)" + NEED,
        ),
        ((40.0, 0.0, 0.0), [(20.0, 2.6, 0.0), (20.0, 50.0, 0.0)], False, None),
        ((-40.0, 0.0, 0.0), [(2.0, 0.0, 0.0), (50.0, 0.0, 0.0)], False, None),  # away from it
        ((-40.0, 0.0, 0.0), [(2.0, 0.0, 0.0), (50.0, 0.0, 0.0)], True, "v1 would come 2.0 m near v2"),
        ((0.25, 0.0, 0.0), [(2.0, 0.0, 0.0), (50.0, 0.0, 0.0)], False, "v1 would come 1.8 m near v2"),
        ((0.15, 0.0, 0.0), [(2.0, 0.0, 0.0), (50.0, 0.0, 0.0)], False, None),
        # along it: away from where the other one is, and to there
        ((0.0, -20.0, 0.0), [(0.0, 30.0, 0.0), (0.0, -30.0, 0.0)], False, None),
        ((0.0, 20.0, 0.0), [(0.0, 30.0, 0.0), (0.0, -30.0, 0.0)], False, None),
        ((0.0, 29.0, 0.0), [(0.0, 30.0, 0.0), (0.0, -30.0, 0.0)], False, "v1 would come 0.0 m near v2"),
        ((40.0, 0.0, 40.0), [(20.0, 0.0, 16.0), (20.0, 50.0, 16.0)], False, "near v2"),  # it climbs with its way
        ((40.0, 0.0, 40.0), [(20.0, 0.0, 10.0), (20.0, 50.0, 10.0)], False, None),
    ],
)
def test_the_ways_of_others_count_as_space(to: Vector, ends: list[Vector], strict: bool, text: str | None) -> None:
    near = Way(2, "v2", Footprint(), sloped(ends), 0.0, "returns")
    far = replace(near, name="v3", legs=sloped([(x, y + 0.05, z) for x, y, z in ends]))
    found = space_conflict(mover(), at(*to), [far, near, far] if to[0] == 40.0 else [near], strict=strict)
    assert (found is None) if text is None else (found is not None and text in found), found


@each(
    ("there", "after_s", "place", "known_s", "doing"),
    [
        (other(9.0, 0.0, 0.0, vel=(1.0, 0.0, 0.0), parked=True, age_s=50.0), 9.0, (9.0, 0.0, 0.0), math.inf, "parked"),
        (other(9.0, 0.0, 0.0, vel=(0.3, 0.0, 0.0)), 9.0, (9.0, 0.0, 0.0), math.inf, "in the air"),
        (other(9.0, 0.0, 0.0, vel=(0.5, 0.0, 0.0)), 8.0, (13.0, 0.0, 0.0), 10.0, "in the air"),
        (other(9.0, 0.0, 0.0, vel=(1.0, 2.0, 0.0), age_s=2.0), 3.0, (14.0, 10.0, 0.0), 10.0, "in the air"),
        (other(9.0, 0.0, 0.0, vel=(1.0, 0.0, 0.0), age_s=50.0, lost=True), 9.0, (19.0, 0.0, 0.0), math.inf, "lost in"),
    ],
)
def test_the_course_of_what_is_watched(there: Other, after_s: float, place: Vector, known_s: float, doing: str) -> None:
    found = of_track(there.track, mover_frame(mover()), NOW)
    assert found.at(after_s) == pytest.approx(place, abs=0.01) and found.known_s == known_s
    assert found.doing.startswith(doing) and ("forget v2" in found.doing) is there.track.lost
    assert found.speed_mps == (pytest.approx(math.hypot(*there.track.reported_mps)) if known_s < 99.0 else 0.0)
    age_s = 0.0 if there.track.parked else min(NOW - there.track.at, 10.0)
    assert found.ball_m == pytest.approx(1.5 * max(0.0, age_s - 1.0) ** 2)


@each("seed", range(12))
def test_a_curve_stays_within_its_bow_of_each_chord(seed: int) -> None:
    """Also where its velocity jumps between two pieces, and at its begin and end."""
    rng = random.Random(seed)
    pieces, here = list[Piece](), (0.0, 0.0, 0.0)
    for _ in range(4):
        axes = [(p, rng.uniform(-3, 3), rng.uniform(-2, 2)) for p in here]
        pieces.append(Piece(rng.uniform(0.1, 2.0), *axes))
        here = Trajectory(pieces[-1:]).at(pieces[-1].duration_s).pos_enu_m
    loaded, factor = LoadedTrajectory(Trajectory(pieces)), rng.choice((0.5, 1.0, 2.0))
    bow, lasts_s = bow_m(loaded, factor, 0.0), loaded.trajectory.duration_s / factor

    def place(at_s: float) -> Vector:
        return loaded.trajectory.at(min(max(at_s * factor, 0.0), loaded.trajectory.duration_s)).pos_enu_m

    worst = 0.0
    for n in range(200):
        begin = -0.25 + (lasts_s + 0.25) * n / 200
        a, b = place(begin), place(begin + 0.25)
        for share in (0.25, 0.5, 0.75):
            chord = [p + share * (q - p) for p, q in zip(a, b, strict=True)]
            worst = max(worst, math.dist(place(begin + 0.25 * share), chord))
    assert 0.02 * bow < worst <= bow


@each("most", [order_check.MOST_POINTS, 12, 3])
def test_the_space_of_a_trajectory_holds_all_that_is_left_of_it(most: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """Six times 10 m east in 3 s by a bulge of 3 m; of a long one the points are farther apart in time."""
    x, y = (0.0, 0.0, 10.0 / 3.0, -20.0 / 27.0), (0.0, 0.0, 48.0 / 9.0, -96.0 / 27.0, 48.0 / 81.0)
    loaded = LoadedTrajectory(Trajectory([Piece(3.0, (10.0 * n, *x[1:]), y, (20.0,)) for n in range(6)]))
    clock = common_clock([loaded], 1.0, 1.0)
    frame = EnuFrame(ORIGIN)
    monkeypatch.setattr(order_check, "MOST_POINTS", most)
    space = TrajectorySpace(TrajectoryFlight(loaded, clock, ORIGIN, frame), frame)
    assert space.left(0.0) == [] and space.left_near((REST, REST), 1e9, 0.0) == [], "it has not begun"
    clock.start(0.0, 0.0)
    lasts_s, bow_m = 18.0, {12: 1.5**2 / 8.0 * 12.58, 3: 6.0 / 2.0 * 5.05}.get(most, 0.0)
    way = Way(1, "v1", Footprint(), along([frame.from_ecef(point) for point in space.left(0.0)]))
    worst_m = 0.0
    for n in range(400):
        place = loaded.trajectory.at(lasts_s * n / 400 + 0.0077 * n % 3.0).pos_enu_m
        worst_m = max(worst_m, distance_m(way, replace(way, legs=standing(place))))
    assert worst_m <= space.bow_m + 0.4 and space.bow_m == pytest.approx(bow_m, rel=0.01)
    far = ecef(*frame.to_geodetic(5.0, -9.0, 20.0)), ecef(*frame.to_geodetic(5.0, -7.0, 20.0))
    assert space.left_near(far, 9.0, 0.0) and not space.left_near(far, 1.0, 0.0)
    # what is left, as a whole and near a line
    chance = random.Random(most)
    for now in sorted(chance.uniform(0.0, lasts_s - 0.01) for _ in range(300)):
        left = space.left(now)
        assert math.dist(frame.from_ecef(left[-1]), (60.0, 0.0, 20.0)) < 1e-6
        steps = min(most, 36)
        assert len(left) == steps - int(now * steps / lasts_s) + 1
        x_m, y_m, up_m = (
            p + chance.uniform(-0.5, 0.5) for p in loaded.trajectory.at(chance.uniform(now, 18)).pos_enu_m
        )
        ends = [ecef(*frame.to_geodetic(x_m, y_m + along_m, up_m)) for along_m in (0.0, chance.choice((0.1, -9.0)))]
        need_m = chance.choice((0.1, 0.3, 1.0, 3.0))
        parts = space.left_near((ends[0], ends[1]), need_m, now)
        legs = {leg for part in parts for leg in itertools.pairwise(part)}
        line = [where(list(enumerate(ends)), 0.1 * n) for n in range(11)]
        for leg in set(itertools.pairwise(left)) - legs:
            assert all(math.dist(point, q) >= need_m for point in leg for q in line)
        assert legs <= set(itertools.pairwise(left))
        assert all(2 <= len(part) <= order_check.LEGS_A_PART + 1 for part in parts)
    assert len(space.left(lasts_s - 0.01)) == 2 and space.left(lasts_s) == []
