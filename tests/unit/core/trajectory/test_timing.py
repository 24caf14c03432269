from __future__ import annotations

import math
from itertools import pairwise

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from skygcs.core.trajectory import MotionLimits, joints, require_continuous, require_within
from skygcs.core.trajectory.timing import TimedPoint, path_within, straight_lines
from skygcs.errors import TrajectoryError
from support.examples import examples
from support.table import each

Point = tuple[float, float, float]

coordinate = st.floats(-200, 200)
point = st.tuples(coordinate, coordinate, st.floats(0, 100))
limits = st.builds(
    MotionLimits, st.floats(0.5, 15), st.floats(0.2, 10), st.floats(0.2, 100), st.floats(0.5, 5), st.floats(0.5, 5)
)


@settings(max_examples=examples(80))
@given(st.lists(point, min_size=1, max_size=6), limits)
def test_an_untimed_path_is_flown_within_its_limits_and_through_its_points(points, allowed) -> None:
    trajectory = path_within(points, allowed)
    require_continuous(trajectory, 1e-6)
    require_within(trajectory, allowed)
    assert math.dist(trajectory.start_enu_m, points[0]) < 1e-5
    assert math.dist(trajectory.end_enu_m, points[-1]) < 1e-5
    places = [trajectory.at(t).pos_enu_m for t in (*trajectory.begins_s, trajectory.duration_s)]
    for wanted in points:
        assert min(_beside(wanted, *leg) for leg in pairwise(places)) < 1e-3
    assert all(joint.acceleration_mps2 < 1e-6 for joint in joints(trajectory))


def _beside(point: Point, begin: Point, end: Point) -> float:
    """Distance of a point from a line segment."""
    along = [b - a for a, b in zip(begin, end, strict=True)]
    square = sum(x * x for x in along)
    part = sum((p - a) * x for p, a, x in zip(point, begin, along, strict=True)) / square if square else 0.0
    nearest = [a + min(max(part, 0.0), 1.0) * x for a, x in zip(begin, along, strict=True)]
    return math.dist(point, nearest)


def test_the_longest_leg_is_flown_at_the_speed_limit() -> None:
    """100 m at 5 m/s: 20 s and one ramp's worth more."""
    trajectory = path_within([(0.0, 0.0, 10.0), (100.0, 0.0, 10.0)], MotionLimits(5.0, 2.0, 4.0))
    assert trajectory.duration_s == pytest.approx(20.0 + 1.5 * 5.0 / 2.0)
    assert trajectory.at(trajectory.duration_s / 2).vel_enu_mps == pytest.approx((5.0, 0.0, 0.0))


def test_legs_in_one_line_are_one_leg_and_a_corner_is_a_stop() -> None:
    line = path_within([(0.0, 0.0, 5.0), (10.0, 0.0, 5.0), (10.0, 0.0, 5.0), (20.0, 0.0, 5.0)], MotionLimits())
    assert len(line.pieces) <= 3
    corner = path_within([(0.0, 0.0, 5.0), (10.0, 0.0, 5.0), (10.0, 10.0, 5.0)], MotionLimits())
    at_corner = min(
        (math.dist(p.pos_enu_m, (10.0, 0.0, 5.0)), math.hypot(*p.vel_enu_mps))
        for p in (corner.at(t) for t in corner.begins_s)
    )
    assert at_corner == (pytest.approx(0.0, abs=1e-9), pytest.approx(0.0, abs=1e-9))
    back = path_within([(0.0, 0.0, 5.0), (10.0, 0.0, 5.0), (0.0, 0.0, 5.0)], MotionLimits())
    assert back.end_enu_m == pytest.approx((0.0, 0.0, 5.0), abs=1e-9)


def test_yaw_turns_the_shorter_way_along_each_leg() -> None:
    path = [(0.0, 0.0, 5.0), (10.0, 0.0, 5.0), (20.0, 0.0, 5.0)]
    trajectory = path_within(path, MotionLimits(), [math.radians(170), math.radians(-170), math.radians(-170)])
    assert trajectory.at(trajectory.duration_s).yaw_rad == pytest.approx(math.radians(190))
    require_continuous(trajectory)


def test_a_path_that_is_one_place_is_stood_at() -> None:
    trajectory = path_within([(1.0, 2.0, 3.0)] * 3, MotionLimits())
    assert trajectory.at(0.5).pos_enu_m == (1.0, 2.0, 3.0)


def test_timed_points_are_joined_by_straight_lines() -> None:
    trajectory = straight_lines(
        [TimedPoint(1.0, (0.0, 0.0, 5.0)), TimedPoint(3.0, (4.0, 0.0, 5.0)), TimedPoint(5.0, (4.0, 8.0, 5.0))]
    )
    assert trajectory.at(0.5).vel_enu_mps == (0.0, 0.0, 0.0)
    assert trajectory.at(2.0).pos_enu_m == pytest.approx((2.0, 0.0, 5.0))
    assert trajectory.at(4.0).vel_enu_mps == pytest.approx((0.0, 4.0, 0.0))
    jumps = [joint.velocity_mps for joint in joints(trajectory)]
    assert jumps == pytest.approx([0.0, 2.0, math.hypot(2.0, 4.0), 4.0])


@each(
    ("times", "words"),
    [
        ((0.0, 1.0, 1.0), "piece 2: from 1 s to 1 s; times ascend"),
        ((0.0, 2.0, 1.0), "piece 2: from 2 s to 1 s; times ascend"),
        ((0.0, math.nan, 1.0), "piece 1: from 0 s to nan s; times ascend"),
        ((-1.0, 0.0, 1.0), "the first time is -1 s"),
        ((math.nan, 0.0, 1.0), "the first time is nan s"),
    ],
)
def test_times_that_do_not_ascend_are_refused(times: tuple[float, ...], words: str) -> None:
    with pytest.raises(TrajectoryError) as refused:
        straight_lines([TimedPoint(t, (float(i), 0.0, 5.0)) for i, t in enumerate(times)])
    assert str(refused.value).startswith(words)


@each("bad", [math.nan, math.inf])
def test_coordinates_that_are_no_numbers_are_refused(bad: float) -> None:
    for place in ((bad, 0.0, 0.0), (0.0, 0.0, bad)):
        with pytest.raises(TrajectoryError):
            path_within([(0.0, 0.0, 5.0), place], MotionLimits())
        with pytest.raises(TrajectoryError):
            straight_lines([TimedPoint(0.0, (0.0, 0.0, 5.0)), TimedPoint(1.0, place)])
    with pytest.raises(TrajectoryError):
        path_within([(0.0, 0.0, 5.0), (1.0, 0.0, 5.0)], MotionLimits(), [0.0, bad])
    with pytest.raises(TrajectoryError):
        straight_lines([TimedPoint(0.0, (0.0, 0.0, 5.0), 0.0), TimedPoint(1.0, (1.0, 0.0, 5.0), bad)])
