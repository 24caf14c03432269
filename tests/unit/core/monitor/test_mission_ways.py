"""The space of missions: the legs of loops, and the circles of loiters."""

from __future__ import annotations

import math
import random

import pytest

from skygcs.core.geo import EnuFrame, Origin, ecef
from skygcs.core.mavlink.vehicle_class import ReturnEnd
from skygcs.core.mission.item import MissionItem
from skygcs.core.monitor.departures import UNKNOWN, ReturnHeight, Returning
from skygcs.core.monitor.mission_ways import MissionOf, MissionRun, MissionSpace, landing_distance_m, mission_box
from skygcs.core.monitor.ways import Way, standing, too_near
from skygcs.core.separation import Footprint, pair_margin
from support.examples import seeds
from support.table import each

HOME = (43.7806, -79.4653, 180.0)
FRAME = EnuFrame(Origin(*HOME))
SMALL = Footprint()

Point = tuple[float, float]


def item(
    command: int, at: Point, up_m: float = 20.0, radius_at: int | None = None, radius_m: float = 0.0
) -> MissionItem:
    lat_deg, lon_deg, _ = FRAME.to_geodetic(*at, 0.0)
    params = [radius_m if n == radius_at else 0.0 for n in range(4)]
    return MissionItem.from_params(command, 3, (*params, lat_deg, lon_deg, up_m), True)


def jump(target: int, command: int = 177) -> MissionItem:
    return MissionItem(command, 2, (float(target), 3.0, 0.0, 0.0))


TAG = MissionItem(600, 2, (7.0, 0.0, 0.0, 0.0))


def way(items: list[MissionItem], first: int = 1, at: Point = (0.0, 0.0), up_m: float = 20.0) -> Way:
    lat_deg, lon_deg, _ = FRAME.to_geodetic(*at, 0.0)
    here = (lat_deg, lon_deg, HOME[2] + up_m)
    return MissionSpace(MissionOf(1, "v1", SMALL, MissionRun(items, first), HOME, FRAME)).way(here)


def meets(one: Way, at: Point, up_m: float = 20.0) -> bool:
    return too_near(one, Way(2, "v2", SMALL, standing((*at, up_m))))


SQUARE: list[Point] = [(0.0, 50.0), (80.0, 50.0), (80.0, 0.0)]
ON_THE_LEG_BACK = (40.0, 25.0)


@each(
    "mission",
    [
        [*(item(16, at) for at in SQUARE), jump(1)],
        [TAG, *(item(16, at) for at in SQUARE), jump(7, 601)],
        [item(178, (0.0, 0.0)), *(item(16, at) for at in SQUARE), jump(1)],  # to an action before the first place
    ],
)
def test_the_leg_of_a_jump_back_to_its_target_is_in_the_space(mission: list[MissionItem]) -> None:
    assert meets(way(mission), ON_THE_LEG_BACK)
    assert not meets(way(mission[:-1]), ON_THE_LEG_BACK)
    # it is flown from any item on, and leads to those before
    assert meets(way(mission, len(mission) - 1, at=(80.0, 25.0)), ON_THE_LEG_BACK)
    assert meets(way(mission, len(mission) - 1, at=(80.0, 25.0)), (40.0, 50.0))


def test_a_jump_forward_skips_and_does_not_skip() -> None:
    mission = [item(16, (0.0, 50.0)), jump(4), item(16, (80.0, 50.0)), item(16, (80.0, 0.0))]
    assert meets(way(mission), (40.0, 25.0)) and meets(way(mission), (40.0, 50.0))


@each(
    ("at", "up_m", "place", "place_up_m", "found"),
    [
        # take-off to 3 m, then 40 m north at 3 m and up: PX4 flew from its 20 m straight down to the second item
        ((0.0, 0.0), 20.0, (0.0, 10.0), 16.0, True),
        ((0.0, 0.0), 20.0, (0.0, 10.0), 27.0, False),
        ((0.0, 0.0), 0.0, (0.0, 10.0), 3.0, True),
        ((0.0, 0.0), 0.0, (0.0, 10.0), 16.0, False),
        # ordered beside the place of its take-off: over that, or past it
        ((30.0, 0.0), 20.0, (0.0, 10.0), 16.0, True),
        ((30.0, 0.0), 20.0, (15.0, 20.0), 11.0, True),
        ((30.0, 0.0), 0.0, (15.0, 20.0), 3.0, True),
        ((30.0, 0.0), 0.0, (15.0, 0.0), 3.0, True),
        ((30.0, 0.0), 20.0, (15.0, 0.0), 3.0, False),
        ((1.0, 0.0), 0.0, (0.0, 40.0), 3.0, True),
    ],
)
def test_a_take_off_in_flight_keeps_the_height_and_may_leave_out_its_place(
    at: Point, up_m: float, place: Point, place_up_m: float, found: bool
) -> None:
    mission = [item(22, (0.0, 0.0), 3.0), item(16, (0.0, 40.0), 3.0), item(16, (0.0, 40.0), 9.0)]
    assert meets(way(mission, at=at, up_m=up_m), place, place_up_m) is found


def test_a_row_of_take_offs_doubles_nothing() -> None:
    """Each of 40 may be flown at its place or left out: the way has legs for all, not for all their combinations."""
    row = [item(22, (20.0 * n, 0.0), 3.0) for n in range(1, 41)]
    assert len(way(row, at=(0.0, 0.0), up_m=20.0).legs) < 10_000


def test_a_take_off_after_a_landing_begins_on_the_ground() -> None:
    again = [item(16, (0.0, 50.0)), item(21, (0.0, 50.0), 0.0), item(22, (0.0, 50.0), 3.0), item(16, (40.0, 50.0), 3.0)]
    assert meets(way(again), (20.0, 50.0), 3.0) and not meets(way(again), (20.0, 50.0), 14.0)


def test_jumps_that_lead_to_each_other_or_nowhere_end() -> None:
    loops = [item(16, (0.0, 50.0)), jump(3), jump(2), jump(99), jump(8, 601), item(16, (50.0, 50.0))]
    assert meets(way(loops), (25.0, 50.0))


@each(("command", "radius_at"), [(17, 2), (18, 2), (19, 2), (31, 1)])
def test_the_circle_of_every_loiter_is_as_wide_as_its_own_parameter(command: int, radius_at: int) -> None:
    """MAVLink: NAV_LOITER_TO_ALT has its radius in parameter 2, the others in 3; the sign is the direction."""
    for sign in (1.0, -1.0):
        circling = way([item(command, (0.0, 100.0), radius_at=radius_at, radius_m=sign * 60.0)])
        assert math.isclose(circling.ball_m, 60.0)
        assert meets(circling, (60.0, 100.0)) and not meets(circling, (70.0, 100.0))


HOME_ITEM = MissionItem.from_params(20, 2, (0.0,) * 7, True)


def returning(height: ReturnHeight, end: ReturnEnd = ReturnEnd.LANDS) -> Way:
    """A mission at 10 m, 100 m to the north, and home."""
    run = MissionRun([item(16, (0.0, 100.0), 10.0), HOME_ITEM], 1, height, end)
    of = MissionOf(1, "v1", SMALL, run, HOME, FRAME, 60.0 * (end is ReturnEnd.CIRCLES))
    return MissionSpace(of).way((*HOME[:2], HOME[2] + 10.0))


def test_a_return_climbs_to_its_height_flies_level_and_comes_down() -> None:
    """Both came home at 30 m, whatever the heights of their missions, and passed 0.8 m apart."""
    one = returning(ReturnHeight(0.0, 30.0))
    for at in ((0.0, 100.0), (0.0, 50.0), (0.0, 0.0)):
        for up_m in (10.0, 20.0, 30.0):
            assert meets(one, at, up_m), (at, up_m)
        assert not meets(one, at, 40.0)
    assert meets(one, (0.0, 0.0), 1.0)
    assert meets(returning(UNKNOWN), (0.0, 50.0), 400.0), "any height, where it is not known"


def test_its_return_is_the_one_that_departures_plans() -> None:
    height = ReturnHeight(5.0, 30.0, 2.0)
    at, base = FRAME.from_geodetic(*place_of((0.0, 100.0), 10.0)), FRAME.from_geodetic(*HOME)
    wanted = Returning(1, "v1", SMALL, at, (0.0, 0.0, 0.0), base, height).way().legs
    for leg, theirs in zip(returning(height).legs[-len(wanted) :], wanted, strict=True):
        assert [*leg.begin, *leg.end, *leg[2:]] == pytest.approx([*theirs.begin, *theirs.end, *theirs[2:]], abs=0.02)


def test_a_plane_circles_at_home_and_a_rover_stays_on_the_ground() -> None:
    circling = returning(ReturnHeight(0.0, 30.0), ReturnEnd.CIRCLES)
    assert meets(circling, (60.0, 0.0), 30.0) and circling.legs[-1].end == pytest.approx((0.0, 0.0), abs=0.02)
    for end in (ReturnEnd.STANDS, ReturnEnd.STANDS_DISARMED):
        assert not meets(returning(UNKNOWN, end), (0.0, 50.0), 30.0)


@each("end", [ReturnEnd.HOLDS, ReturnEnd.LANDS_ON_ROTORS, ReturnEnd.LANDS_AS_PLANE, ReturnEnd.NOT_KNOWN])
def test_one_that_sinks_or_lands_at_home_or_may_flies_home_and_comes_down_there(end: ReturnEnd) -> None:
    landing = returning(ReturnHeight(0.0, 30.0), end)
    for at, up_m in (((0.0, 50.0), 10.0), ((0.0, 50.0), 30.0), ((0.0, 0.0), 30.0), ((0.0, 0.0), 1.0)):
        assert meets(landing, at, up_m), (at, up_m)
    assert not meets(landing, (0.0, 50.0), 45.0)
    assert landing.legs[-1].begin == pytest.approx((0.0, 0.0), abs=0.02)


def place_of(at: Point, up_m: float) -> tuple[float, float, float]:
    lat_deg, lon_deg, _ = FRAME.to_geodetic(*at, 0.0)
    return lat_deg, lon_deg, HOME[2] + up_m


def test_a_landing_is_compared_with_what_stands_but_for_one_where_the_vehicle_stood_itself() -> None:
    elsewhere = [item(22, (0.0, 0.0)), item(16, (0.0, 50.0)), item(21, (30.0, 50.0), 0.0)]
    at_home = [item(22, (0.0, 0.0)), item(16, (0.0, 50.0)), item(21, (0.0, 0.0), 0.0)]
    assert landing_distance_m(way(elsewhere, up_m=0.0), (30.0, 52.0), (0.0, 0.0)) == pytest.approx(2.0, abs=0.01)
    assert landing_distance_m(way(at_home, up_m=0.0), (2.0, 0.0), (0.0, 0.0)) == math.inf
    # gone on with in flight: home is where it began, and not where it is now
    assert landing_distance_m(way(at_home, first=2, at=(0.0, 30.0)), (2.0, 0.0), (0.0, 0.0)) == math.inf
    assert landing_distance_m(way(elsewhere[:2], up_m=0.0), (0.0, 50.0), (0.0, 0.0)) == math.inf, "it does not land"


@each("seed", seeds(60))
def test_what_a_box_of_a_mission_leaves_out_its_way_keeps_clear_of(seed: int) -> None:
    """The oracle: places on the line, against the whole way."""
    rng = random.Random(seed)

    def place(most_m: float) -> tuple[float, float, float]:
        return rng.uniform(-most_m, most_m), rng.uniform(-most_m, most_m), rng.uniform(0.0, 40.0)

    items = [item(rng.choice([16, 17, 22]), place(60.0)[:2], rng.uniform(0.0, 60.0), 2, 9.0) for _ in range(4)]
    items += rng.choice([[], [jump(1)], [MissionItem(20, 2)], [item(21, place(60.0)[:2])]])
    height, here = ReturnHeight(0.0, 30.0, 2.0), place(60.0)
    line = [(x + rng.choice([0.0, 150.0]), y, up) for x, y, up in (place(90.0), place(90.0))]
    ends = tuple(ecef(*FRAME.to_geodetic(*at)) for at in line)
    need_m = 2.0 * pair_margin(SMALL, SMALL).total_m
    apart = mission_box(items, HOME).is_apart((ends[0], ends[1]), ecef(*FRAME.to_geodetic(*here)), need_m, height)
    run = MissionRun(items, rng.choice([1, 3]), height)
    whole = MissionSpace(MissionOf(1, "v1", SMALL, run, HOME, FRAME)).way(FRAME.to_geodetic(*here))
    points = [[p + (q - p) * n / 60 for p, q in zip(*line, strict=True)] for n in range(61)]
    near = any(meets(whole, (x, y), up) for x, y, up in points)
    assert not (apart and near)


def test_a_box_leaves_out_what_is_far_away_and_keeps_what_may_return_at_any_height() -> None:
    items, far = [item(16, at) for at in SQUARE], ecef(*FRAME.to_geodetic(900.0, 0.0, 20.0))
    here = ecef(*FRAME.to_geodetic(0.0, 0.0, 20.0))
    assert mission_box(items, HOME).is_apart((far, far), here, 5.0, UNKNOWN)
    assert not mission_box(items, HOME).is_apart((far, far), far, 5.0, UNKNOWN), "from there it comes"
    assert not mission_box([*items, MissionItem(20, 2)], HOME).is_apart((far, far), here, 5.0, UNKNOWN)
