"""Which vehicles leave for home, and who waits for whom: whole returns, flown by a model that may be slow or fast."""

from __future__ import annotations

import itertools
import math
from dataclasses import replace
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from skygcs.core.monitor.departures import (
    ABOVE_M,
    ASIDE_M,
    AT_HOME_M,
    MOVED_M,
    OTHERS_S,
    SILENT_S,
    SINKS_MPS,
    STANDS_MPS,
    STUCK_S,
    UNKNOWN,
    Departures,
    Progress,
    ReturnHeight,
    Returning,
    departing,
    is_placed,
    known_return_height,
    one_at_a_time,
    return_height,
    why_not_held,
)
from skygcs.core.monitor.ways import Leg, Way, along, column, sloped, standing, too_near
from skygcs.core.separation import Footprint, pair_margin, separation_m
from support.examples import examples
from support.watched_fleet import GUIDED, LAND, ORIGIN, RTL, WatchedVehicle

SIZE = Footprint()
MARGIN_M = pair_margin(SIZE, SIZE).total_m
RETURN = ReturnHeight(15.0, 15.0)
STEP_S = 0.5


def departures(*given: Any) -> Departures:
    """`departing` without a break."""
    work = departing(*given)
    while True:
        try:
            next(work)
        except StopIteration as end:
            decided: Departures = end.value
            return decided


def at(
    key: int, here: tuple[float, float, float], home: tuple[float, float], height: ReturnHeight = RETURN
) -> Returning:
    return Returning(key, f"v{key}", SIZE, here, (0.0, 0.0, 0.0), (*home, 0.0), height)


class Air:
    """Vehicles that return as both firmwares do, each with speeds of its own, and those that wait."""

    def __init__(self, vehicles: list[Returning], speeds: list[float]) -> None:
        self.waiting = {one.key: one for one in vehicles}
        self.under_way: dict[int, Returning] = {}
        self.landed: dict[int, Returning] = {}
        self.speeds = {one.key: speed for one, speed in zip(vehicles, speeds, strict=True)}
        self.goals: dict[int, float] = {}
        self.least_m = math.inf
        self.decided = Departures()

    def fly(self, seconds: float) -> None:
        for _ in range(int(seconds / STEP_S)):
            fixed = [replace(one.place(), legs=standing(one.here), ball_m=0.0) for one in self.landed.values()]
            self.decided = departures(list(self.waiting.values()), list(self.under_way.values()), fixed)
            for key in self.decided.leave:
                self.under_way[key] = self.waiting.pop(key)
            self.goals.update(self.decided.climb)
            if not self.waiting and not self.under_way:
                return
            self._step()

    def _step(self) -> None:
        for key, one in list(self.waiting.items()):
            up = min(self.goals.get(key, one.here[2]), one.here[2] + 1.5 * STEP_S)
            self.waiting[key] = replace(one, here=(*one.here[:2], max(up, one.here[2])))
        for key, one in list(self.under_way.items()):
            (x, y, z), (hx, hy, _) = one.here, one.home
            away, step = math.hypot(hx - x, hy - y), self.speeds[key] * STEP_S
            if one.velocity_mps[2] < 0.0 or away < 1e-6:  # lands
                moved = replace(one, here=(hx, hy, max(0.0, z - 0.7 * STEP_S)), velocity_mps=(0.0, 0.0, -0.7))
                if moved.here[2] <= 0.0:
                    del self.under_way[key]
                    self.landed[key] = moved
                    continue
            elif z < one.highest_m - 1e-6 and math.dist(one.here[:2], self._begun(key)) < 1e-6:
                moved = replace(one, here=(x, y, min(one.highest_m, z + 2.0 * STEP_S)))
            else:
                share = min(1.0, step / away)
                moved = replace(one, here=(x + share * (hx - x), y + share * (hy - y), z))
            self.under_way[key] = moved
        flying = [*self.waiting.values(), *self.under_way.values()]
        for a, b in itertools.combinations(flying, 2):
            apart = (p - q for p, q in zip(a.here, b.here, strict=True))
            self.least_m = min(self.least_m, separation_m(*apart, SIZE.downwash_ratio))

    def _begun(self, key: int) -> tuple[float, float]:
        return self.starts[key]

    @property
    def starts(self) -> dict[int, tuple[float, float]]:
        if not hasattr(self, "_starts"):
            self._starts = {k: v.here[:2] for k, v in (self.waiting | self.under_way).items()}
        return self._starts


def flown_home(vehicles: list[Returning], speeds: list[float], seconds: float = 900.0) -> Air:
    air = Air(vehicles, speeds)
    assert air.starts
    air.fly(seconds)
    return air


def test_one_vehicle_and_vehicles_above_their_homes_leave_at_once() -> None:
    assert departures([at(1, (0, 0, 10), (40, 0))], []) == Departures((1,))
    fleet = [at(i, (5.0 * i, 0.0, 10.0), (5.0 * i, 0.0)) for i in range(10)]
    assert departures(fleet, []).leave == tuple(range(10))
    moved = [at(i, (5.0 * i, 30.0, 10.0), (5.0 * i, 0.0), UNKNOWN) for i in range(10)]
    assert departures(moved, []).leave == tuple(range(10)), "side by side"


def test_two_that_have_changed_places_leave_after_one_has_climbed_above_the_others_way() -> None:
    pair = [at(1, (0, 0, 10), (5, 0)), at(2, (5, 0, 10), (0, 0))]
    first = departures(pair, [])
    assert first.leave == () and set(first.waits_for) == {1, 2}
    assert first.climb == {2: pytest.approx(15.0 + 2 * MARGIN_M + 1.0)}
    air = flown_home(pair, [5.0, 5.0])
    assert set(air.landed) == {1, 2} and air.least_m >= MARGIN_M - 1e-6


def test_what_climbs_out_of_anothers_way_goes_on_and_that_one_does_not_climb_too() -> None:
    """Whoever's return height is read later, or is higher by now: they climbed one above the other, in turns."""
    goal_m = departures(pair := [at(1, (0, 0, 10), (5, 0)), at(2, (5, 0, 10), (0, 0))], []).climb[2]
    for up_m, height in ((12.0, ReturnHeight(14.0, 14.0)), (18.0, RETURN)):
        climbs = replace(pair[1], here=(5.0, 0.0, up_m), height=height, goal_m=goal_m)
        assert departures([pair[0], climbs], []).climb == {2: pytest.approx(goal_m)}


def test_an_unknown_return_height_is_any_and_the_ways_are_flown_one_after_the_other() -> None:
    line = [at(i, (20.0 + 5.0 * i, 0.0, 10.0), (5.0 * i, 0.0), UNKNOWN) for i in range(3)]
    found = departures(line, [])
    assert found.leave == (0,) and found.climb == {} and found.waits_for == {1: ("v0",), 2: ("v0", "v1")}


def test_one_that_lands_where_it_is_is_in_the_way_of_what_flies_below_it() -> None:
    below, above = at(1, (0, 40, 10), (0, 0)), at(2, (0, 20, 40), (30, 20))
    assert departures([below], [above]).leave == (1,), "it flies home, from above"
    assert departures([below], [replace(above, lands=True)]).waits_for == {1: ("v2",)}
    aside = replace(above, here=(8.0, 20.0, 40.0), home=(-20.0, 20.0, 0.0), lands=True)
    assert departures([below], [aside]).leave == (1,), "its home is on the other side of the way"


def test_one_home_for_two_keeps_the_second_in_the_air() -> None:
    """It would land on the first."""
    air = flown_home([at(1, (0, 20, 10), (0, 0)), at(2, (20, 0, 10), (0, 0))], [5.0, 5.0], 300.0)
    assert set(air.landed) == {1} and set(air.waiting) == {2} and air.decided.waits_for == {2: ("v1",)}
    assert air.least_m >= MARGIN_M


def test_layers_above_anothers_home_rise_from_the_top() -> None:
    stack = [at(1, (20, 0, 10), (0, 0)), at(2, (0, 0, 10), (20, 0)), at(3, (0, 0, 16), (40, 0))]
    air = flown_home(stack, [5.0, 8.0, 3.0])
    assert set(air.landed) == {1, 2, 3} and air.least_m >= MARGIN_M - 1e-6, air.decided


@settings(max_examples=examples(60), deadline=None)
@given(st.data())
def test_whoever_stands_where_all_come_home_and_none_comes_too_near(data: st.DataObject) -> None:
    """Any permutation of places on a grid, heights, return heights and speeds."""
    count = data.draw(st.integers(2, 6))
    spots = [(5.0 * (i % 3), 5.0 * (i // 3)) for i in range(count)]
    order = data.draw(st.permutations(range(count)))
    shift = data.draw(st.sampled_from([(0.0, 0.0), (30.0, 0.0), (3.0, 11.0)]))
    vehicles = []
    for i in range(count):
        most = data.draw(st.sampled_from([10.0, 15.0, 21.0]))
        height = ReturnHeight(data.draw(st.sampled_from([0.0, most])), most)
        x, y = spots[order[i]]
        z = data.draw(st.sampled_from([5.0, 10.0, 18.0]))
        vehicles.append(at(i, (x + shift[0], y + shift[1], z), spots[i], height))
    air = flown_home(vehicles, [data.draw(st.floats(2.0, 12.0)) for _ in range(count)], 2000.0)
    assert air.least_m >= MARGIN_M - 1e-6
    assert len(air.landed) == count, air.decided


@pytest.mark.parametrize(
    ("home_x", "up_m", "height", "does"),
    [
        (20.0, 10.0, RETURN, "climbs"),  # the way leads through one that holds at 10 m, the home is beyond it
        (20.0, 30.0, RETURN, "leaves"),  # it is above that one already
        (1.0, 10.0, RETURN, "is stuck"),  # its home is below that one
        (20.0, 10.0, UNKNOWN, "waits"),  # nobody knows how high it returns
    ],
)
def test_one_that_stays_is_flown_over_or_waited_for_by_nobody(
    home_x: float, up_m: float, height: ReturnHeight, does: str
) -> None:
    stays = at(9, (0.0, 0.0, 16.0), (0.0, 0.0)).place()
    one = at(1, (-20.0, 0.0, up_m), (home_x, 0.0), height)
    decided = departures([one], [], [stays], {9})
    assert decided.leave == ((1,) if does == "leaves" else ())
    assert decided.stuck == ({1: ("v9",)} if does == "is stuck" else {})
    assert (1 in decided.climb) is (does == "climbs")
    if does == "climbs":
        above = replace(one, here=(*one.here[:2], decided.climb[1]))
        assert departures([above], [], [stays], {9}).leave == (1,)
        below = at(2, (-20.0, 0.0, 14.0), (-40.0, 0.0)).place()
        assert not departures([one], [], [stays, below], {9}).climb, "another one is in the way up"


def sampled_m(place: tuple[float, float, float], a: tuple[float, float, float], b: tuple[float, float, float]) -> float:
    """The least distance of a place to a straight line, by looking at many points of it."""
    points = ([p + (q - p) * n / 2000 for p, q in zip(a, b, strict=True)] for n in range(2001))
    return min(
        separation_m(*(u - v for u, v in zip(place, point, strict=True)), SIZE.downwash_ratio) for point in points
    )


@settings(max_examples=examples(60), deadline=None)
@given(st.data())
def test_one_that_waits_where_somebody_flies_through_climbs_above_that_way(data: st.DataObject) -> None:
    """It waited there until the other one had flown into it."""
    part = st.floats(-6.0, 6.0)
    here = (data.draw(part), data.draw(part), data.draw(st.floats(5.0, 15.0)))
    begin, end = (-40.0, data.draw(part), 10.0), (40.0, data.draw(part), data.draw(st.sampled_from([10.0, 12.0])))
    near_m = sampled_m(here, begin, end)
    through, clear = near_m < MARGIN_M - 0.1, near_m > 3.0 * MARGIN_M  # between: a sloped way is made of steps
    way = Way(9, "v9", SIZE, sloped([begin, end]))
    one = at(1, here, (here[0], here[1] + data.draw(st.sampled_from([-30.0, 30.0]))))
    decided = departures([one], [], [way])
    if through and 1 not in decided.leave:
        goal = (*here[:2], decided.climb[1])
        assert sampled_m(goal, begin, end) >= MARGIN_M
        assert departures([replace(one, goal_m=goal[2], here=goal)], [], [way]).climb == {}, "once"
    if clear:
        assert not decided.climb
    assert not departures([one], [], [replace(way, legs=standing(begin))]).climb, "it does not come"


@pytest.mark.parametrize(
    ("ceiling_m", "above_m", "comes_m", "climbs"),
    [
        (math.inf, None, -40.0, True),
        (12.0, None, -40.0, False),  # its fence is lower
        (math.inf, 4.0, -40.0, False),  # somebody else waits above it
        (math.inf, None, -2.0, False),  # it is there already
    ],
)
def test_one_that_waits_in_a_way_climbs_only_where_that_is_free(
    ceiling_m: float, above_m: float | None, comes_m: float, climbs: bool
) -> None:
    way = Way(9, "v9", SIZE, sloped([(comes_m, 0.0, 10.0), (40.0, 0.0, 10.0)]))
    one = replace(at(1, (0.0, 1.0, 10.0), (0.0, -30.0)), ceiling_m=ceiling_m)
    others = [] if above_m is None else [replace(at(2, (0.0, 1.0, 10.0 + above_m), (0.0, 9.0)).place(), doing="hovers")]
    decided = departures([one], [], [way, *others], {2})
    assert decided.leave == () and (1 in decided.climb) is climbs
    assert bool(decided.fenced) is (ceiling_m == 12.0)
    if above_m is not None:
        waits = at(2, (0.0, 1.0, 10.0 + above_m), (20.0, 0.0))
        assert departures([one, waits], [], [way]).climb == {}, "nor where another one waits"


@pytest.mark.parametrize(
    ("up_m", "end_m", "least_m", "most_m"),
    [
        (10.0, 110.0, 16.0, 40.0),  # the other one climbs to 110 m, but not here
        (110.0, 110.0, 116.0, 120.0),
        (118.0, 118.0, None, None),  # above it is too high
        (10.0, math.nan, None, None),  # nobody knows how high
    ],
)
def test_one_climbs_out_of_a_way_only_above_where_it_leads_through(
    up_m: float, end_m: float, least_m: float | None, most_m: float | None
) -> None:
    """It climbed as high as the whole way leads anywhere, without a bound."""
    way = Way(9, "v9", SIZE, along([(-40.0, 0.0, up_m), (30.0, 0.0, up_m), (200.0, 0.0, end_m)]))
    one = at(1, (-10.0, 1.0, up_m), (-10.0, -30.0))
    decided = departures([one], [], [way])
    assert decided.leave == ()
    if least_m is None or most_m is None:
        assert decided.climb == {}
    else:
        assert least_m <= decided.climb[1] <= most_m


def test_one_that_climbs_takes_the_space_up_to_its_goal() -> None:
    climbs = replace(at(1, (0.0, 0.0, 10.0), (50.0, 0.0)), goal_m=20.0)
    assert climbs.place().heights == (10.0, 20.0)
    assert replace(climbs, goal_m=5.0).place().heights == (10.0, 10.0)


def test_nobody_climbs_out_of_its_own_fence() -> None:
    """The autopilot would act there."""
    pair = [at(1, (0, 0, 10), (5, 0)), at(2, (5, 0, 10), (0, 0))]
    goal_m = 15.0 + 2 * MARGIN_M + 1.0
    low = replace(pair[1], ceiling_m=goal_m - 0.1)
    assert departures([pair[0], low], []).climb == {1: pytest.approx(goal_m)}, "the other one climbs"
    both = departures([replace(one, ceiling_m=goal_m - 0.1) for one in pair], [])
    assert both.climb == {} and both.leave == () and both.fenced == {1, 2}
    rises = ReturnHeight(15.0, 15.0, climb_m=5.0)
    kept = departures([replace(one, ceiling_m=goal_m + 4.9, height=rises) for one in pair], [])
    assert kept.climb == {}, "its return climbs once more"
    stays = at(9, (0.0, 0.0, 16.0), (0.0, 0.0)).place()
    over = departures([replace(at(1, (-20, 0, 10), (20, 0)), ceiling_m=20.0)], [], [stays], {9})
    assert over.stuck == {1: ("v9",)} and over.fenced == {1}


def test_nobody_climbs_above_what_may_be_flown_only_to_let_others_by() -> None:
    """With no fence that is known it climbed as high as others' ways led."""
    for up_m, climbs in ((ASIDE_M - 2.0 * MARGIN_M - 1.1, True), (ASIDE_M - 2.0 * MARGIN_M - 0.9, False)):
        high = ReturnHeight(up_m, up_m)
        pair = departures([at(1, (0, 0, 10), (5, 0), high), at(2, (5, 0, 10), (0, 0), high)], [])
        assert pair.leave == () and bool(pair.climb) is climbs and (pair.fenced == {1, 2}) is not climbs
        stays = at(9, (0.0, 0.0, up_m), (0.0, 0.0)).place()
        over = departures([at(1, (-20, 0, up_m), (20, 0), high)], [], [stays], {9})
        assert bool(over.climb) is climbs and (over.stuck == {1: ("v9",)}) is not climbs


def test_what_is_below_one_keeps_it_from_nothing_but_a_way_down_there() -> None:
    """It stands nearer than they need already, and the return climbs away from it."""
    one, below = at(1, (0.0, 0.0, 4.0), (20.0, 0.0)), replace(at(9, (0, 0, 0), (0, 0)).place(), doing="parked")
    assert departures([one], [], [below]).leave == (1,)
    assert departures([replace(one, home=(1.0, 0.0, 0.0))], [], [below]).waits_for == {1: ("v9",)}
    above = at(9, (0.0, 0.0, 8.0), (0.0, 0.0)).place()
    assert departures([one], [], [above]).waits_for == {1: ("v9",)}


def test_one_that_still_brakes_is_not_given_up() -> None:
    """It needed 25 m more on all sides at 10 m/s, and was stuck a second after its order."""
    one = replace(at(1, (0.0, 40.0, 10.0), (0.0, 0.0)), velocity_mps=(0.0, 10.0, 0.0))
    for x, y, leaves in ((10.0, 0.0, True), (0.0, 60.0, False)):
        decided = departures([one], [], [at(9, (x, y, 10.0), (x, y)).place()], {9})
        assert (decided.leave == (1,)) is leaves and (decided.waits_for == {1: ("v9",)}) is not leaves
        assert decided.stuck == decided.climb == {}


def test_without_any_place_they_leave_one_at_a_time() -> None:
    waiting = {1: "v2", 2: "v1", 3: "v3"}
    assert one_at_a_time(waiting, ["v9"]) == Departures((), waits_for=dict.fromkeys((1, 2, 3), ("v9",)))
    assert one_at_a_time(waiting, []) == Departures((2,), waits_for={1: ("v1",), 3: ("v1",)})


@pytest.mark.parametrize("axis", range(3))
def test_one_whose_place_is_no_number_may_be_anywhere(axis: int) -> None:
    """It counted as far away."""
    here, nowhere = at(1, (0.0, 0.0, 10.0), (0.0, 0.0)), [50.0, 50.0, 10.0]
    nowhere[axis] = math.nan
    other = replace(here, key=2, here=(nowhere[0], nowhere[1], nowhere[2]), home=(50.0, 50.0, 0.0))
    for way in (other.place(), other.way()):
        assert too_near(here.way(), way) and too_near(way, here.way())


@pytest.mark.parametrize(
    ("heights_m", "climb_m", "height"),
    [
        ([15.0], None, ReturnHeight(0.0, 15.0)),
        ([15.0], math.nan, ReturnHeight(0.0, 15.0)),
        ([15.0, 20.0], 3.0, ReturnHeight(0.0, 20.0, 3.0)),
        ([-1.0], -2.0, ReturnHeight(0.0, 0.0)),
        ([0.5], 0.5, ReturnHeight(0.0, 0.5, 0.5)),
        ([15.0, None], 0.0, UNKNOWN),
        ([15.0, math.inf], 0.0, UNKNOWN),
        ([], 0.0, UNKNOWN),
    ],
)
def test_the_return_height_is_the_highest_of_those_that_are_all_known(
    heights_m: list[float | None], climb_m: float | None, height: ReturnHeight
) -> None:
    assert return_height(heights_m, climb_m) == height


def test_a_copters_return_height_and_place_are_known_once_it_has_reported_them() -> None:
    copter = WatchedVehicle(1)
    vehicle = copter.vehicle

    def read(**params: float) -> None:
        for name, value in params.items():
            values = {"param_id": name, "param_value": value, "param_type": 9, "param_count": 9, "param_index": 1}
            copter.send("PARAM_VALUE", 1.0, **values)

    copter.heartbeat(1.0)
    assert known_return_height(vehicle) == UNKNOWN and not is_placed(vehicle, 1.0)
    read(RTL_ALT=2500.0)
    assert known_return_height(vehicle) == UNKNOWN, "how far it climbs at least is not known"
    read(RTL_CLIMB_MIN=150.0)
    assert known_return_height(vehicle) == ReturnHeight(0.0, 25.0, 1.5)
    copter.position(1.0, (0.0, 0.0, 10.0))
    assert not is_placed(vehicle, 1.0), "its home is not known"
    lat, lon, alt = round(ORIGIN.lat_deg * 1e7), round(ORIGIN.lon_deg * 1e7), round(ORIGIN.alt_amsl_m * 1000)
    copter.send("HOME_POSITION", 1.0, latitude=lat, longitude=lon, altitude=alt)
    assert is_placed(vehicle, 1.0)
    vehicle.replayed = True
    assert not is_placed(vehicle, 1.0)
    vehicle.replayed = False
    for mode, why in ((GUIDED, None), (RTL, "it is in RTL"), (LAND, "it is in LAND")):
        copter.heartbeat(2.0, mode=mode)
        assert why_not_held(vehicle) == why
    copter.heartbeat(2.0, status=5)
    assert why_not_held(vehicle) == "its own failsafe acts"
    copter.heartbeat(3.0, armed=False, status=3)
    assert not is_placed(vehicle, 3.0), "on the ground"


def test_one_without_a_place_or_a_home_or_that_circles_is_not_placed() -> None:
    homeless, nowhere, plane = (WatchedVehicle(i) for i in (1, 2, 3))
    for one in (homeless, nowhere, plane):
        one.heartbeat(1.0, kind=1 if one is plane else 2)
    for one in (homeless, plane):
        one.position(1.0, (0.0, 0.0, 10.0))
    for one in (nowhere, plane):
        one.send("HOME_POSITION", 1.0, latitude=437806000, longitude=-794653000, altitude=180000)
    assert not any(is_placed(one.vehicle, 1.0) for one in (homeless, nowhere, plane))
    copter = WatchedVehicle(4)
    copter.heartbeat(1.0, kind=2)
    copter.send("HOME_POSITION", 1.0, latitude=437806000, longitude=-794653000, altitude=180000)
    for lat_deg, placed in ((43.7806, True), (200.0, False)):  # not on earth: no frame for a round of returns
        copter.send(
            "GLOBAL_POSITION_INT", 2.0, lat=round(lat_deg * 1e7), lon=-794653000, alt=190000, relative_alt=10000
        )
        assert is_placed(copter.vehicle, 2.0) is placed


def test_returns_go_on_while_one_of_them_moves_and_not_for_ever_while_others_do() -> None:
    progress = Progress(100.0)
    assert progress.goes_on(99.9 + STUCK_S) and not progress.goes_on(100.0 + STUCK_S)
    progress.note(1, (0.0, 0.0, 10.0), 110.0, ours=True)
    progress.note(1, (MOVED_M, 0.0, 10.0), 120.0, ours=True)
    assert progress.moved_at == 110.0, "it has wandered"
    progress.note(1, (MOVED_M + 0.1, 0.0, 10.0), 130.0, ours=True)
    assert progress.moved_at == 130.0
    progress.note(1, (MOVED_M + 0.2, 0.0, 10.0), 140.0, ours=True)
    assert progress.moved_at == 130.0, "from where it had moved to"
    # one that others fly moves on and on
    for step in range(int(OTHERS_S / 10.0)):
        progress.note(9, (10.0 * step, 0.0, 10.0), 140.0 + 10.0 * step, ours=False)
    assert progress.goes_on(129.9 + OTHERS_S) and not progress.goes_on(130.0 + OTHERS_S)
    # it lands, or is not seen any more: the way is clear
    progress.note(9, None, 440.0, ours=False)
    assert progress.goes_on(440.0) and progress.goes_on(439.9 + STUCK_S)
    progress.note(9, None, 450.0, ours=False)
    assert progress.moved_at == 440.0, "it had landed before"
    progress.note(9, (0.0, 0.0, 10.0), 460.0, ours=False)
    assert progress.moved_at == 460.0 and Progress().goes_on(0.0) is False


def test_the_way_home_of_one_that_waits_returns_or_lands() -> None:
    one = at(1, (30.0, 40.0, 10.0), (0.0, 0.0), ReturnHeight(12.0, 15.0, 7.0))
    assert one.highest_m == 17.0 and replace(one, home=(0.0, 0.0, 5.0)).highest_m == 20.0
    for age_s in (SILENT_S / 2.0, 60.0):
        assert replace(one, age_s=age_s).way().ball_m == pytest.approx(SIZE.ball_m(min(age_s, SILENT_S)))
    legs = (column(one.here, 17.0), Leg((30.0, 40.0), (0.0, 0.0), 12.0, 17.0), column(one.home, 17.0))
    assert one.way().legs == legs
    home = replace(one, velocity_mps=(-3.0, -4.0, 2.0), age_s=SILENT_S).way(under_way=True)
    assert home.legs == legs and home.ball_m == SIZE.ball_m(SILENT_S), "it flies there: it does not brake"
    moves = replace(one, velocity_mps=(-4.0, 3.0, 0.0))
    for brakes in (moves.way(), replace(moves, lands=True).way(under_way=True)):
        x, y = (end - begin for begin, end in zip(brakes.legs[0].begin, brakes.legs[0].end, strict=True))
        assert x < 0.0 < y and x / y == pytest.approx(-4.0 / 3.0), "along its velocity"
    near = replace(one, here=(AT_HOME_M, 0.0, 10.0))
    for sinks_mps, lands in ((SINKS_MPS, False), (SINKS_MPS + 0.01, True), (-1.0, False)):
        way = replace(near, velocity_mps=(0.0, 0.0, -sinks_mps)).way(under_way=True)
        assert (way.legs == (column((0.0, 0.0, 10.0), 0.0),)) is lands
    assert replace(one, age_s=2.0, height=UNKNOWN).as_seen() == replace(one, height=ReturnHeight(0.0, 0.0))
    assert one.as_seen().height == one.height, "which was read"


@pytest.mark.parametrize(
    ("place", "waits", "returns"),
    [
        ((0.0, 2.4, 10.0), True, True),
        ((8.75, 2.4, 10.0), True, True),  # it flies on for so long before it stands
        ((8.75 + 2.6, 0.0, 10.0), False, False),
        ((6.0, 10.0, 10.0), False, True),  # and turns to its home
        ((4.0, 4.0, 10.0), False, True),
        ((-2.6, 10.0, 10.0), False, False),
    ],
)
def test_one_that_moves_brakes_before_it_waits_and_before_it_returns(
    place: tuple[float, float, float], waits: bool, returns: bool
) -> None:
    """It counted where it was."""
    one = replace(at(1, (0.0, 0.0, 10.0), (0.0, 40.0), ReturnHeight(0.0, 15.0)), velocity_mps=(5.0, 0.0, 0.0))
    there = Way(9, "v9", SIZE, standing(place))
    assert too_near(one.place(), there) is waits and too_near(one.way(), there) is returns
    assert too_near(one.way(under_way=True), there) is returns, "it may just have been ordered"


def test_a_decision_gives_way_to_others_after_each_piece_of_work() -> None:
    """In thousands of ways no piece is longer than `AT_A_TURN` comparisons."""
    fleet = [at(i, (5.0 * i, 0.0, 10.0), (5.0 * i, 0.0)) for i in range(10)]
    far = [at(99, (0.0, 1e4, 10.0), (0.0, 1e4)).place()] * 65
    assert sum(1 for _ in departing(fleet, [], far)) == len(fleet) * (1 + 3 + 1)


def test_those_that_climb_above_a_way_keep_above_each_other() -> None:
    parked = [at(9, (60.0, 0.0, 0.0), (60.0, 0.0)).place()]
    one, lower = at(1, (0.0, 0.2, 10.0), (40.0, 0.2)), at(2, (20.0, 0.0, 12.0), (60.0, 0.0))
    above_m = 2.0 * MARGIN_M + ABOVE_M
    for aside_m, higher in ((MARGIN_M - 0.1, True), (MARGIN_M, False)):
        upper = at(3, (20.0, aside_m, 16.0), (60.0, 0.0))
        climbs = departures([one, lower, upper], [], parked).climb
        assert climbs[3] == pytest.approx(15.0 + (2.0 if higher else 1.0) * above_m), climbs


def test_one_that_still_moves_is_not_judged_by_those_that_stay() -> None:
    stays = at(9, (0.0, 0.0, 16.0), (0.0, 0.0)).place()
    for speed_mps, climbs in ((STANDS_MPS, True), (STANDS_MPS + 0.01, False)):
        one = replace(at(1, (-30.0, 0.0, 10.0), (30.0, 0.0)), velocity_mps=(0.0, speed_mps, 0.0))
        assert (departures([one], [], [stays], {9}).climb != {}) is climbs
