from __future__ import annotations

import math
from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from skygcs.config.dialects import load_dialect
from skygcs.core.geo import Origin, geodetic_from_enu
from skygcs.core.mission.fence import (
    MOST_DISTANCES,
    NEAR_STEP_M,
    Corner,
    FenceArea,
    FenceCircle,
    FencePlan,
    FencePolygon,
)
from skygcs.core.mission.formats import read_plan
from skygcs.core.mission.item import MissionItem
from skygcs.core.mission.plan import CheckLimits, Family, MissionPlan, PlannedHome, check_plan, errors
from skygcs.errors import PlanFileError
from support.public_data import public_folder
from support.table import each

DIALECT = load_dialect(["ardupilotmega", "px4-extras"])
HOME = PlannedHome(43.78, -79.46, 180.0)
TAKEOFF = MissionItem.from_params(22, 3, (0.0, 0.0, 0.0, None, 43.78, -79.46, 10.0), True)
"""The right first item of every mission here."""


def at(east_m: float, north_m: float) -> Corner:
    lat, lon, _ = geodetic_from_enu(east_m, north_m, 0.0, Origin(HOME.lat_deg, HOME.lon_deg, 0.0))
    return lat, lon


def waypoint(east_m: float, north_m: float, z: float | None = 20.0, frame: int = 3) -> MissionItem:
    return MissionItem.from_params(16, frame, (0.0, 0.0, 0.0, None, *at(east_m, north_m), z), True)


def square(half_m: float, inclusion: bool, east_m: float = 0.0, north_m: float = 0.0) -> FencePolygon:
    signs = ((-1, -1), (1, -1), (1, 1), (-1, 1))
    return FencePolygon(inclusion, tuple(at(east_m + half_m * sx, north_m + half_m * sy) for sx, sy in signs))


def found(
    *items: MissionItem,
    fence: FencePlan | None = None,
    limits: CheckLimits | None = None,
    family: Family | None = None,
    home: PlannedHome | None = HOME,
    vehicle: Corner | None = None,
    rally: tuple[MissionItem, ...] = (),
) -> list[str]:
    plan = MissionPlan(items, fence or FencePlan(), rally, home)
    findings = check_plan(plan, DIALECT, limits or CheckLimits(), family=family, vehicle=vehicle)
    return [("ERROR " if finding.error else "warning ") + str(finding) for finding in findings]


@each(
    ("item", "said"),
    [
        (waypoint(10, 0, None), "ERROR mission item 2: the altitude is not set (NaN)"),
        (waypoint(10, 0, 600.0), "ERROR mission item 2: the altitude is 600 m above home, over the limit of 500 m"),
        (waypoint(10, 0, 900.0, 0), "ERROR mission item 2: the altitude is 720 m above home, over the limit of 500 m"),
        (waypoint(10, 0, 600.0, 10), "ERROR mission item 2: the altitude is 600 m above the terrain, over"),
        (waypoint(10, 0, -3.0), "warning mission item 2: the altitude is 3 m below home"),
        (waypoint(10, 0, 0.0), "warning mission item 2: the altitude is 0 m above home: on the ground"),
        (replace(TAKEOFF, z=0.0), "ERROR mission item 2: a take-off to 0 m"),
        (waypoint(3000, 0), "ERROR mission item 2: is 2,992 m from home, over the limit of 1,000 m"),
        (MissionItem(9999), "ERROR mission item 2: command 9999 is unknown to the dialect"),
        (MissionItem(5001), "ERROR mission item 2: MAV_CMD_NAV_FENCE_POLYGON_VERTEX_INCLUSION belongs in a fence list"),
        (MissionItem(5100), "ERROR mission item 2: MAV_CMD_NAV_RALLY_POINT belongs in a rally list"),
        (MissionItem(177, 2, (7.0, 1.0, 0.0, 0.0)), "ERROR mission item 2: jumps to item 7; the mission has 1 to 2"),
        (MissionItem(177, 2, (0.0, 1.0, 0.0, 0.0)), "ERROR mission item 2: jumps to item 0; the mission has 1 to 2"),
        (MissionItem(177, 2, (None, 1.0, 0.0, 0.0)), "ERROR mission item 2: jumps to item nothing"),
        (MissionItem(177, 2, (2.0, 1.0, 0.0, 0.0)), "ERROR mission item 2: jumps to itself"),
        (MissionItem(177, 2, (1.0, -2.0, 0.0, 0.0)), "ERROR mission item 2: repeats -2 times"),
        (MissionItem(601, 2, (5.0, 1.0, 0.0, 0.0)), "ERROR mission item 2: jumps to tag 5, which no item has"),
        (MissionItem(16, 3, x=950000000, y=10, z=20.0), "ERROR mission item 2: 95.0, 1e-06 is not a position on earth"),
        (MissionItem(16, 2, z=20.0), "ERROR mission item 2: is a waypoint in frame MISSION"),
        (MissionItem(16, 3, z=20.0), "warning mission item 2: is at 0, 0: for an ArduPilot"),
    ],
)
def test_each_fault_is_told_with_its_item(item: MissionItem, said: str) -> None:
    told = found(TAKEOFF, item)
    assert any(line.startswith(said) for line in told), told


def test_a_good_mission_has_no_findings() -> None:
    land = MissionItem.from_params(21, 3, (0.0, 0.0, 0.0, None, *at(0, 20), 0.0), True)
    jump, tag = MissionItem(177, 2, (2.0, -1.0, 0.0, 0.0)), MissionItem(600, 2, (5.0, 0.0, 0.0, 0.0))
    to_tag = MissionItem(601, 2, (5.0, 1.0, 0.0, 0.0))
    fence = FencePlan((square(100, True), square(5, False, 50, 50)), (FenceCircle(True, at(0, 0), 200.0),))
    assert found(TAKEOFF, waypoint(20, 0), tag, jump, to_tag, waypoint(20, 20), land, fence=fence) == []


def test_a_place_that_is_not_given_is_an_error_for_a_px4_and_right_for_an_ardupilot() -> None:
    nowhere = MissionItem(16, 3, z=20.0)
    assert found(TAKEOFF, nowhere, family="px4") == ["ERROR mission item 2: has no position (0, 0)"]
    assert found(TAKEOFF, nowhere, family="ardupilot") == []


def test_distance_is_measured_from_the_vehicle_else_home_else_the_first_place() -> None:
    far = waypoint(3000, 0)
    assert found(TAKEOFF, far, vehicle=at(3000, 10)) == ["ERROR mission item 1: is 2,992 m from the vehicle, "
                                                         "over the limit of 1,000 m"]  # fmt: skip
    assert "from home" in found(TAKEOFF, far)[0]
    assert "from the first position of the mission" in found(TAKEOFF, far, home=None)[0]
    assert found(TAKEOFF, far, limits=CheckLimits(max_distance_m=4000.0)) == []


def test_a_mission_without_a_take_off_is_worth_a_warning() -> None:
    told = found(MissionItem(2000, 2), waypoint(10, 0))
    assert len(told) == 1 and told[0].startswith("warning mission item 2: the mission does not begin with a take-off")


def test_too_many_items_count_the_home_that_an_ardupilot_keeps() -> None:
    limits = CheckLimits(max_items=2)
    assert found(TAKEOFF, waypoint(1, 0), limits=limits, family="px4") == []
    told = found(TAKEOFF, waypoint(1, 0), limits=limits, family="ardupilot")
    assert told == ["ERROR mission: 3 items are too many: the vehicle holds 2"]


@each(
    ("fence", "said"),
    [
        (FencePlan((FencePolygon(True, (at(0, 0), at(9, 0))),)), "polygon 1 (items 1 to 2): is not closed: it has 2"),
        (FencePlan((FencePolygon(True, ()),)), "is not closed: it has 0 different corners"),
        (FencePlan((FencePolygon(True, (at(0, 0), at(9, 0), at(0, 0))),)), "is not closed: it has 2 different corners"),
        (FencePlan((FencePolygon(True, (at(0, 0), at(50, 50), at(100, 100.001))),)), "its corners lie in one line"),
        (
            FencePlan((FencePolygon(True, (at(-9, -9), at(9, 9), at(9, -9), at(-9, 9))),)),
            "crosses itself: the edges from corner 1 and from corner 3 meet",
        ),
        (FencePlan((square(50, True),), (FenceCircle(False, at(0, 0), 0.0),)), "circle 1 (item 5): a radius of 0 m"),
        (FencePlan(circles=(FenceCircle(True, at(0, 0), 1e9),)), "circle 1 (item 1): a radius of 1e+09 m"),
        (FencePlan((FencePolygon(True, tuple(at(n, n * n) for n in range(1001))),)), "1001 corners are more than 1000"),
    ],
)
def test_a_fence_that_is_none_is_an_error_with_its_items(fence: FencePlan, said: str) -> None:
    told = found(fence=fence)
    assert len(told) == 1, told
    assert told[0].startswith("ERROR fence: ") and said in told[0]


def test_a_repeated_corner_is_only_a_warning() -> None:
    closed = square(50, True)
    told = found(fence=FencePlan((replace(closed, corners=(*closed.corners, closed.corners[0])),)))
    assert told == ["warning fence: polygon 1 (items 1 to 5): the last corner repeats the first one; "
                    "a polygon is closed automatically"]  # fmt: skip


def test_an_item_against_the_fence_is_an_error_and_a_way_through_it_a_warning() -> None:
    fence = FencePlan((square(100, True),), (FenceCircle(False, at(50, 0), 10.0),))
    for east_m, told in (
        (120, "ERROR mission item 2: is outside the inclusion polygon 1"),
        (55, "ERROR mission item 2: is inside the exclusion circle 1"),
        (80, "warning mission item 2: the path to it leads through the exclusion circle 1"),
    ):
        assert found(TAKEOFF, waypoint(east_m, 0), fence=fence)[0] == told
    assert found(TAKEOFF, waypoint(0, 80), fence=fence) == []


def test_a_rally_point_and_home_are_held_against_the_fence_too() -> None:
    fence = FencePlan((square(20, True, 100, 0),))
    rally = MissionItem.from_params(5100, 3, (0.0, 0.0, 0.0, 0.0, *at(0, 200), None), True)
    assert found(fence=fence, rally=(rally,)) == [
        "ERROR rally item 1: is outside the inclusion polygon 1",
        "warning fence: home is outside the inclusion polygon 1",
        "ERROR rally item 1: the altitude is not set (NaN)",
    ]


def test_one_of_several_inclusions_is_enough_for_a_px4_and_an_ardupilot_wants_all() -> None:
    fence = FencePlan((square(60, True), square(60, True, 100, 0)))
    there = waypoint(100, 0)
    assert found(TAKEOFF, there, fence=fence, family="px4") == []
    told = found(TAKEOFF, there, fence=fence, family="ardupilot")
    assert "ERROR mission item 2: is outside the inclusion polygon 1" in told


def test_a_way_that_leaves_a_concave_fence_is_seen() -> None:
    horseshoe = [(-50, -50), (50, -50), (50, 50), (30, 50), (30, -30), (-30, -30), (-30, 50), (-50, 50)]
    fence = FencePlan((FencePolygon(True, tuple(at(e, n) for e, n in horseshoe)),))
    away = replace(TAKEOFF, x=waypoint(-40, 40).x, y=waypoint(-40, 40).y)
    told = found(away, waypoint(40, 40), fence=fence, home=None)
    assert told == ["warning mission item 2: the path to it leaves the inclusion polygon 1"]


@given(st.floats(-150, 150), st.floats(-150, 150))
def test_inside_a_square_is_what_coordinates_say(east_m: float, north_m: float) -> None:
    area = FenceArea(FencePlan((square(100, True),)), any_inclusion=False)
    if (
        min(abs(abs(east_m) - 100), abs(abs(north_m) - 100)) > 0.5
    ):  # a sphere's and an ellipsoid's metre differ by 0.5 %
        inside = abs(east_m) < 100 and abs(north_m) < 100
        assert (area.conflict(at(east_m, north_m)) is None) is inside


def test_room_is_the_distance_to_the_border_of_whatever_is_nearest() -> None:
    fence = FencePlan((square(100, True), square(10, False)), (FenceCircle(True, at(0, 0), 120.0),))
    area = FenceArea(fence, any_inclusion=False)
    for (east_m, north_m), room_m, shape in (
        ((60, 0), 40.0, "the inclusion polygon 1"),
        ((25, 0), 15.0, "the exclusion polygon 2"),
        ((0, 5), -5.0, "the exclusion polygon 2"),
        ((98, 98), 120.0 - math.hypot(98, 98), "the inclusion circle 1"),
        ((0, -130), -30.0, "the inclusion polygon 1"),
    ):
        found_m, found = area.room_m(at(east_m, north_m))
        assert (found_m, found) == (pytest.approx(room_m, abs=0.01 * abs(room_m) + 0.3), shape), (east_m, north_m)


places = st.tuples(st.floats(-90, 90), st.floats(-90, 90))


@given(st.lists(places, min_size=1, max_size=6), st.floats(0.0, 20.0))
def test_no_narrow_place_of_a_way_is_missed_and_a_wide_one_passes(way, room_m) -> None:
    """Against a search at every 5 cm."""
    thin = FencePolygon(False, (at(-2, 20), at(-1.9, 20), at(-1.9, 80), at(-2, 80)))
    area = FenceArea(FencePlan((square(100, True), thin)), any_inclusion=False)
    least_m = math.inf
    for (ax, ay), (bx, by) in zip(way, way[1:] or way, strict=False):
        steps = max(1, math.ceil(math.dist((ax, ay), (bx, by)) / 0.05))
        for k in range(steps + 1):
            least_m = min(least_m, area.room_m(at(ax + (bx - ax) * k / steps, ay + (by - ay) * k / steps))[0])
    found = area.narrowest([at(*place) for place in way], room_m)
    if least_m < room_m:
        assert found is not None
    if found is not None:
        assert least_m <= room_m + NEAR_STEP_M / 2 + 0.01 and abs(found[0] - least_m) <= NEAR_STEP_M


def test_a_long_way_along_a_large_fence_is_bounded_work(monkeypatch: pytest.MonkeyPatch) -> None:
    corners = tuple(at(math.sin(k / 500 * math.pi) * 50, math.cos(k / 500 * math.pi) * 50) for k in range(1000))
    area = FenceArea(FencePlan((FencePolygon(True, corners),)), any_inclusion=False)
    looks = []
    inner = area._room_m
    monkeypatch.setattr(area, "_room_m", lambda point: looks.append(point) or inner(point))
    way = [at(math.sin(k) * 30, math.cos(k) * 30) for k in range(300)]
    area.narrowest(way, 0.0)
    assert len(looks) <= MOST_DISTANCES / 1000 + 2


def test_a_fence_across_the_date_line_is_whole() -> None:
    corners = ((10.0, 179.99), (10.0, -179.99), (10.02, -179.99), (10.02, 179.99))
    area = FenceArea(FencePlan((FencePolygon(True, corners),)), any_inclusion=False)
    assert area.conflict((10.01, 180.0)) is None
    assert area.conflict((10.01, -179.98)) is not None


def test_no_public_plan_has_an_error() -> None:
    for path in public_folder("missions"):
        try:
            plan = read_plan(path.read_bytes(), path.name).plan
        except PlanFileError:
            continue
        assert errors(check_plan(plan, DIALECT)) == (), path.name
