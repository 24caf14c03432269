"""Missions for several vehicles: what moves, what stays, and that the step of heights is what the monitor asks for."""

from __future__ import annotations

import itertools
import math
from typing import Literal, get_args

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pymavlink.dialects.v20 import ardupilotmega as mav
from pymavlink.mavextra import distance_lat_lon

from skygcs.cli import mission_arrangement
from skygcs.core.geo import EnuFrame, Origin
from skygcs.core.mission.fence import FenceCircle, FencePlan
from skygcs.core.mission.item import MissionItem
from skygcs.core.mission.plan import FLOWN_OTHERWISE, FLOWN_PLACE, MissionPlan, PlannedHome
from skygcs.core.monitor.mission_ways import MissionOf, MissionRun, MissionSpace
from skygcs.core.monitor.ways import Way, too_near
from skygcs.core.separation import Footprint
from skygcs.core.vehicle.formation import (
    ITEMS_A_TURN,
    LEAST_STEP_M,
    MAX_ARRANGED_ITEMS,
    SPACING_M,
    Arrangement,
    ArrangementKind,
    arranging,
    course_deg,
    for_several,
    least_step_m,
)
from support.table import each

HOME = (43.7806, -79.4653)
GROUND_AMSL_M = 180.0
FRAME = EnuFrame(Origin(*HOME, GROUND_AMSL_M))

Place = tuple[float, float]


def place(east_m: float, north_m: float) -> Place:
    lat_deg, lon_deg, _ = FRAME.to_geodetic(east_m, north_m, 0.0)
    return lat_deg, lon_deg


def item(command: int, east_m: float, north_m: float, z: float | None, frame: int = 3) -> MissionItem:
    return MissionItem.from_params(command, frame, (0.0, 0.0, 0.0, None, *place(east_m, north_m), z), True)


def waypoints(*points: tuple[float, float, float]) -> MissionPlan:
    return MissionPlan(tuple(item(16, *point) for point in points))


RETURN = MissionItem.from_params(20, 2, (0.0,) * 7, True)

metres = st.floats(-300.0, 300.0)
heights = st.floats(5.0, 100.0)
points = st.lists(st.tuples(metres, metres, heights), min_size=2, max_size=6)
counts = st.integers(2, 5)


def apart_m(a: MissionItem, b: MissionItem) -> float:
    """By pymavlink's sphere: an oracle that is not ours."""
    (lat_a, lon_a), (lat_b, lon_b) = a.position or (0, 0), b.position or (0, 0)
    return float(distance_lat_lon(lat_a, lon_a, lat_b, lon_b))


@given(points, counts, st.floats(0.5, 20.0))
def test_heights_leave_every_place_and_raise_each_next_vehicle_by_the_step(
    way: list[tuple[float, float, float]], count: int, step_m: float
) -> None:
    plan = MissionPlan((item(22, 0, 0, 10.0), *waypoints(*way).mission, RETURN))
    plans = for_several(plan, Arrangement("heights", step_m), [None] * count, [Footprint()] * count)
    assert plans[0] == plan and len(plans) == count
    for n, own in enumerate(plans):
        assert own.mission[-1] == RETURN
        for before, after in zip(plan.mission[:-1], own.mission[:-1], strict=True):
            assert (after.x, after.y, after.command, after.frame) == (before.x, before.y, before.command, before.frame)
            assert (after.z or 0.0) - (before.z or 0.0) == pytest.approx(n * step_m, abs=1e-4)


@given(
    points.filter(lambda way: math.dist(way[0][:2], way[1][:2]) > 2.0),
    counts,
    st.floats(1.0, 50.0),
    st.sampled_from(["line", "column"]),
    st.none() | st.floats(0.0, 360.0),
)
def test_line_and_column_move_the_whole_path_by_the_spacing_to_its_right_or_behind_it(
    way: list[tuple[float, float, float]],
    count: int,
    spacing_m: float,
    kind: Literal["line", "column"],
    heading_deg: float | None,
) -> None:
    plan = waypoints(*way)
    arrangement = Arrangement(kind, spacing_m=spacing_m, heading_deg=heading_deg)
    plans = for_several(plan, arrangement, [None] * count, [Footprint()] * count)
    course = course_deg(plan.mission) if heading_deg is None else heading_deg
    assert course is not None and plans[0] == plan
    to = math.radians(course + (90.0 if kind == "line" else 180.0))
    for n, own in enumerate(plans):
        for before, after in zip(plan.mission, own.mission, strict=True):
            assert after.z == before.z
            assert apart_m(before, after) == pytest.approx(n * spacing_m, rel=0.006, abs=0.03)
            a, b = (FRAME.from_geodetic(*(i.position or HOME), GROUND_AMSL_M) for i in (before, after))
            assert b[0] - a[0] == pytest.approx(n * spacing_m * math.sin(to), abs=0.05)
            assert b[1] - a[1] == pytest.approx(n * spacing_m * math.cos(to), abs=0.05)


@given(points, st.lists(st.tuples(metres, metres), min_size=2, max_size=5))
def test_the_present_formation_is_kept_all_the_way(
    way: list[tuple[float, float, float]], vehicles: list[tuple[float, float]]
) -> None:
    places = [place(*at) for at in vehicles]
    plans = for_several(waypoints(*way), Arrangement("present"), places, [Footprint()] * len(places))
    assert plans[0] == waypoints(*way)
    for at, own in zip(vehicles, plans, strict=True):
        for first, after in zip(plans[0].mission, own.mission, strict=True):
            a, b = (FRAME.from_geodetic(*(i.position or HOME), GROUND_AMSL_M) for i in (first, after))
            assert b[0] - a[0] == pytest.approx(at[0] - vehicles[0][0], abs=0.06)
            assert b[1] - a[1] == pytest.approx(at[1] - vehicles[0][1], abs=0.06)


def ways_of(plans: tuple[MissionPlan, ...], footprints: list[Footprint]) -> list[Way]:
    """From their first waypoints, in the air."""
    found = []
    for n, (plan, footprint) in enumerate(zip(plans, footprints, strict=True)):
        first = plan.mission[0]
        here = (*(first.position or HOME), GROUND_AMSL_M + (first.z or 0.0))
        home = (*HOME, GROUND_AMSL_M)
        found.append(MissionSpace(MissionOf(n, f"v{n}", footprint, MissionRun(plan.mission), home, FRAME)).way(here))
    return found


@given(
    st.lists(st.tuples(metres, metres), min_size=2, max_size=6),
    heights,
    st.lists(
        st.builds(Footprint, wingspan_m=st.floats(0.3, 3.0), position_error_m=st.floats(0.1, 4.0)),
        min_size=2,
        max_size=4,
    ),
)
def test_a_level_mission_with_the_step_of_the_margins_has_no_overlap_for_the_monitor(
    way: list[tuple[float, float]], up_m: float, footprints: list[Footprint]
) -> None:
    plan = waypoints(*((*at, up_m) for at in way))
    plans = for_several(plan, Arrangement("heights"), [None] * len(footprints), footprints)
    for a, b in itertools.combinations(ways_of(plans, footprints), 2):
        assert not too_near(a, b)
    # and with no step at all each pair of them overlaps
    same = ways_of((plan,) * len(footprints), footprints)
    assert all(too_near(a, b) for a, b in itertools.combinations(same, 2))


@given(st.floats(5.0, 60.0), st.floats(0.0, 30.0), counts)
def test_what_legs_climb_is_in_the_step(low_m: float, climb_m: float, count: int) -> None:
    plan = waypoints((0.0, 0.0, low_m), (40.0, 0.0, low_m + climb_m), (80.0, 0.0, low_m + climb_m))
    footprints = [Footprint()] * count
    plans = for_several(plan, Arrangement("heights"), [None] * count, footprints)
    assert not any(too_near(a, b) for a, b in itertools.combinations(ways_of(plans, footprints), 2))


def test_the_step_is_three_metres_where_the_margins_need_less() -> None:
    small = [Footprint(wingspan_m=0.1, position_error_m=0.1)] * 3
    assert least_step_m(waypoints((0, 0, 10), (9, 0, 10)).mission, small) == LEAST_STEP_M == 3.0
    assert least_step_m(waypoints((0, 0, 10), (9, 0, 10)).mission, [Footprint()] * 2) == 5.5  # 2 x (0.7 + 1.8) + slack


def test_landings_move_and_keep_their_height_and_the_rest_of_the_plan_is_the_same() -> None:
    fence = FencePlan(circles=(FenceCircle(True, HOME, 100.0),))
    roi = MissionItem.from_params(195, 3, (0.0, 0.0, 0.0, 0.0, *place(5, 5), 1.0), True)
    mission = (*waypoints((0, 0, 10), (0, 50, 10)).mission, roi, item(21, 0, 50, 0.0))
    plan = MissionPlan(mission, fence, home=PlannedHome(*HOME, GROUND_AMSL_M))
    raised = for_several(plan, Arrangement("heights", 4.0), [None] * 2, [Footprint()] * 2)[1]
    assert [i.z for i in raised.mission] == [14.0, 14.0, 1.0, 0.0]
    beside = for_several(plan, Arrangement("line"), [None] * 2, [Footprint()] * 2)[1]
    assert (beside.fence, beside.home, beside.mission[2]) == (fence, plan.home, roi)
    assert apart_m(plan.mission[3], beside.mission[3]) == pytest.approx(SPACING_M, abs=0.04)
    assert beside.mission[3].z == 0.0


@each(
    ("plan", "arrangement", "places", "text"),
    [
        (MissionPlan(), Arrangement("heights"), [None, None], "no mission"),
        (waypoints((0, 0, 10), (9, 0, 10)), Arrangement("present"), [HOME, None], "place of each vehicle"),
        (waypoints((0, 0, 10)), Arrangement("line"), [None, None], "give a heading"),
        (MissionPlan((item(16, 0, 0, None),)), Arrangement("heights", 3.0), [None, None], "item 1 has no height"),
        (
            MissionPlan((RETURN, MissionItem(16, 1, x=10, y=10))),
            Arrangement("line", heading_deg=0.0),
            [None, None],
            "item 2 has a place of a local frame",
        ),
        # 415.5 m of "climb" between a height above the sea and one above home
        (
            MissionPlan((item(16, 0, 0, 10.0), item(16, 9, 0, 420.0, frame=0))),
            Arrangement("heights"),
            [None, None],
            "items 1 and 2 are above different references",
        ),
    ],
)
def test_what_cannot_be_arranged_is_refused_in_words(
    plan: MissionPlan, arrangement: Arrangement, places: list[Place | None], text: str
) -> None:
    with pytest.raises(ValueError, match=text):
        for_several(plan, arrangement, places, [Footprint()] * 2)


@each("command", sorted(FLOWN_OTHERWISE))
@each("kind", ["heights", "line"])
def test_what_sets_a_height_and_is_not_moved_is_refused(command: int, kind: Literal["heights", "line"]) -> None:
    plan = MissionPlan((*waypoints((0, 0, 10), (0, 50, 10)).mission, MissionItem(command, 3, z=40.0)))
    with pytest.raises(ValueError, match=r"item 3 .* cannot be moved"):
        for_several(plan, Arrangement(kind), [None] * 2, [Footprint()] * 2)


def test_every_command_that_pymavlink_knows_with_an_altitude_is_moved_or_refused() -> None:
    """Commands of a mission whose seventh number is a height to fly to, by MAVLink's own descriptions."""
    aims = {mav.MAV_CMD_DO_SET_ROI, mav.MAV_CMD_DO_SET_ROI_LOCATION, mav.MAV_CMD_NAV_ROI, mav.MAV_CMD_NAV_RALLY_POINT}
    goes_up = {
        number
        for number, entry in mav.enums["MAV_CMD"].items()
        if number < 300 and number not in aims and "ltitude" in entry.param.get(7, "")
    }
    marks = {mav.MAV_CMD_DO_LAND_START, mav.MAV_CMD_DO_RETURN_PATH_START, mav.MAV_CMD_NAV_LAND, 81}
    assert mav.MAV_CMD_NAV_CONTINUE_AND_CHANGE_ALT in goes_up
    assert goes_up - marks <= FLOWN_PLACE | FLOWN_OTHERWISE, goes_up - marks - FLOWN_PLACE - FLOWN_OTHERWISE


def test_two_references_with_a_given_step_are_raised_each() -> None:
    plan = MissionPlan((item(16, 0, 0, 10.0), item(16, 9, 0, 420.0, frame=0)))
    raised = for_several(plan, Arrangement("heights", 6.0), [None] * 2, [Footprint()] * 2)[1]
    assert [i.z for i in raised.mission] == [16.0, 426.0]


def test_many_long_missions_are_moved_in_small_pieces() -> None:
    """250 missions of 500 items were moved in one stretch of 1.7 s, longer than PX4's COM_OF_LOSS_T."""
    plan = waypoints(*((float(n % 7), 10.0 * n, 20.0) for n in range(500)))
    count, pieces = 4, 0
    work = arranging(plan, Arrangement("line"), [None] * count, [Footprint()] * count)
    while True:
        try:
            next(work)
            pieces += 1
        except StopIteration as end:
            plans = end.value
            break
    assert pieces >= count * 500 / ITEMS_A_TURN
    assert plans == for_several(plan, Arrangement("line"), [None] * count, [Footprint()] * count)


def test_more_items_than_all_may_have_together_are_refused_before_anything_is_made() -> None:
    """A file of 65535 items, which MAVLink can number, for 250 vehicles were 6 GB."""
    count, step = 250, Arrangement("heights", 3.0)
    most = MAX_ARRANGED_ITEMS // count
    just = MissionPlan((RETURN,) * most)
    assert next(arranging(just, step, [None] * count, [Footprint()] * count)) is None
    with pytest.raises(
        ValueError, match=rf"{most + 1} items for each of {count} vehicles .* shorten it to {most} items"
    ):
        next(arranging(MissionPlan((RETURN,) * (most + 1)), step, [None] * count, [Footprint()] * count))


def test_the_shell_offers_each_kind() -> None:
    assert [kind.value for kind in mission_arrangement.ArrangementKind] == list(get_args(ArrangementKind))
