"""The monitor on vehicles made of frames: what counts, levels, confirmation, hysteresis, holds, and hostile input."""

from __future__ import annotations

import math
import random
from collections.abc import Sequence

import pytest

from skygcs.core.geo import EnuFrame, ecef
from skygcs.core.monitor.conflict_levels import CLEAR_S, Level, Pair
from skygcs.core.monitor.monitor import CONFLICTS_A_TURN, MAX_CONFLICTS, NEAR_LOST_M, REHOLD_S, Monitor
from skygcs.core.monitor.tracks import TRACK_SILENT_S, is_flying
from support.examples import seeds
from support.table import each
from support.watched_fleet import (
    ACTIVE,
    CRITICAL,
    GUIDED,
    IN_AIR,
    LAND,
    LOITER,
    ON_GROUND,
    ORIGIN,
    RTL,
    STANDBY,
    STEP_S,
    Watched,
    WatchedVehicle,
    Where,
    flying,
    standing,
)

# --- levels -----------------------------------------------------------------------------------------------------------


def test_head_on_rises_from_notice_to_action_and_falls_once_they_have_passed() -> None:
    pair = Watched(WatchedVehicle(1), WatchedVehicle(2))
    pair.run(30.0, flying((-25.0, 0.0, 20.0), (2.0, 0.0, 0.0)), flying((25.0, 0.3, 20.0), (-2.0, 0.0, 0.0)))
    assert pair.levels() in (["notice", "warning", "action", "none"], ["warning", "action", "none"])
    lost_s = (50.0 - 2.5) / 4.0
    assert lost_s - pair.first("warning") >= 5.0
    assert pair.monitor.pairs == {}


def test_flights_that_keep_their_distance_are_not_reported() -> None:
    pair = Watched(WatchedVehicle(1), WatchedVehicle(2))
    pair.run(40.0, flying((-25.0, 0.0, 20.0), (2.0, 0.0, 0.0)), flying((25.0, 3.2, 20.0), (-2.0, 0.0, 0.0)))
    assert pair.events == []


@each(("above_m", "reported"), [(5.4, False), (4.5, True)])
def test_downwash_counts_twice(above_m: float, reported: bool) -> None:
    pair = Watched(WatchedVehicle(1), WatchedVehicle(2))
    pair.run(6.0, standing(0.0, 0.0, 20.0), standing(0.0, 0.0, 20.0 + above_m))
    assert bool(pair.events) is reported


def test_a_graze_needs_two_seconds_and_a_deep_conflict_half_of_one() -> None:
    graze = Watched(WatchedVehicle(1), WatchedVehicle(2))
    graze.run(6.0, standing(0.0, 0.0, 20.0), standing(2.2, 0.0, 20.0))
    assert graze.first("warning") == pytest.approx(2.0)
    deep = Watched(WatchedVehicle(1), WatchedVehicle(2))
    deep.run(3.0, standing(0.0, 0.0, 20.0), flying((8.0, 0.0, 20.0), (-2.0, 0.0, 0.0)))
    assert deep.first("action") == pytest.approx(0.5)


def test_gusts_beside_each_other_are_not_reported() -> None:
    def gusty(x: float, phase: float) -> Where:
        def motion(at: float) -> tuple[Sequence[float], Sequence[float]]:
            angle = 2.0 * at + phase
            return (x + 0.12 * math.sin(angle), 0.0, 20.0), (0.24 * math.cos(angle), 0.0, 0.0)

        return motion

    pair = Watched(WatchedVehicle(1), WatchedVehicle(2))
    pair.run(120.0, gusty(0.0, 0.0), gusty(3.0, math.pi))
    assert pair.events == []


def test_a_turn_that_is_reported_at_two_times_is_no_conflict() -> None:
    """Both start together; the position of the second comes half a second later."""

    def starting(x: float) -> Where:
        def motion(at: float) -> tuple[Sequence[float], Sequence[float]]:
            speed = min(max(at - 5.0, 0.0) * 1.5, 6.0)
            gone = 0.75 * min(max(at - 5.0, 0.0), 4.0) ** 2 + 6.0 * max(at - 9.0, 0.0)
            return (x + gone, 0.0, 20.0), (speed, 0.0, 0.0)

        return motion

    ahead, behind = starting(3.4), starting(0.0)
    pair = Watched(WatchedVehicle(1), WatchedVehicle(2))
    for step in range(80):
        pair.run(STEP_S, ahead if step % 2 == 0 else None, behind if step % 2 == 1 else None)
    assert [level for level in pair.levels() if level != "notice"] == []


def test_a_level_falls_after_three_clear_seconds_only() -> None:
    pair = Watched(WatchedVehicle(1), WatchedVehicle(2))
    here, near, far = standing(0.0, 0.0, 20.0), standing(2.0, 0.0, 20.0), standing(4.0, 0.0, 20.0)
    pair.run(4.0, here, near)
    for _ in range(6):
        pair.run(1.0, here, far)
        pair.run(1.0, here, near)
    assert pair.levels() == ["warning"]
    cleared_at = pair.now - pair.begun
    pair.run(6.0, here, far)
    assert pair.first("none") == pytest.approx(cleared_at + CLEAR_S, abs=0.5)


def test_within_a_tenth_above_the_margin_a_level_stays() -> None:
    pair = Watched(WatchedVehicle(1), WatchedVehicle(2))
    pair.run(4.0, standing(0.0, 0.0, 20.0), standing(2.4, 0.0, 20.0))
    pair.run(20.0, standing(0.0, 0.0, 20.0), standing(2.65, 0.0, 20.0))
    assert pair.levels() == ["warning"]
    pair.run(6.0, standing(0.0, 0.0, 20.0), standing(2.9, 0.0, 20.0))
    assert pair.levels() == ["warning", "none"]


def test_two_that_are_sent_to_one_place_are_reported_before_the_first_has_arrived() -> None:
    first, second = WatchedVehicle(1), WatchedVehicle(2)
    pair = Watched(first, second)
    first.destination = second.destination = first.geodetic_of(0.0, 0.0, 20.0)
    # straight on they would miss each other by 4 m
    pair.run(6.0, flying((-16.0, 0.0, 20.0), (2.0, 0.0, 0.0)), flying((0.0, -22.0, 20.0), (0.0, 2.0, 0.0)))
    assert "warning" in pair.levels()
    alone = Watched(WatchedVehicle(1), WatchedVehicle(2))
    alone.run(6.0, flying((-16.0, 0.0, 20.0), (2.0, 0.0, 0.0)), flying((0.0, -22.0, 20.0), (0.0, 2.0, 0.0)))
    assert alone.levels() == []


def test_who_is_sent_to_a_place_before_another_is_no_more_than_a_notice() -> None:
    sent = WatchedVehicle(1)
    pair = Watched(sent, WatchedVehicle(2))
    sent.destination = sent.geodetic_of(-3.0, 0.0, 20.0)
    pair.run(7.0, flying((-20.0, 0.0, 20.0), (2.0, 0.0, 0.0)), standing(0.0, 0.0, 20.0))
    assert set(pair.levels()) <= {"notice"}
    sent.destination = sent.geodetic_of(30.0, 0.0, 20.0)
    pair.run(2.0, flying((-20.0, 0.0, 20.0), (2.0, 0.0, 0.0)), standing(0.0, 0.0, 20.0))
    assert pair.levels()[-1] in ("warning", "action")


def test_who_follows_a_trajectory_is_expected_along_it_while_it_is_on_it() -> None:
    """It flies at another one and turns away 6 m before."""

    def place(at: float) -> tuple[float, float, float]:
        return (-20.0 + 2.0 * min(at, 7.0), 2.0 * max(0.0, at - 7.0), 20.0)

    def motion(at: float) -> tuple[Sequence[float], Sequence[float]]:
        return place(at), (2.0, 0.0, 0.0) if at < 7.0 else (0.0, 2.0, 0.0)

    def fly(off_m: float) -> list[str]:
        planned = WatchedVehicle(1)
        pair = Watched(planned, WatchedVehicle(2))
        for step in range(48):
            at = step * STEP_S
            points = [place(at + 0.5 * i) for i in range(21)]
            planned.trajectory = [planned.geodetic_of(x, y - off_m, z) for x, y, z in points]
            pair.run(STEP_S, motion, standing(0.0, 0.0, 20.0))
        return pair.levels()

    assert fly(0.0) == []
    assert "warning" in fly(8.0), "it does not follow that one"


# --- silence ----------------------------------------------------------------------------------------------------------


def test_silence_widens_what_stands_still_to_a_notice_and_ends_with_not_watched() -> None:
    pair = Watched(WatchedVehicle(1), WatchedVehicle(2, "bravo"))
    here, there = standing(0.0, 0.0, 20.0), standing(12.0, 0.0, 20.0)
    pair.run(3.0, here, there)
    pair.run(16.0, here, None)
    assert pair.levels() == ["notice", "none"]
    # a ball of 1.5 m/s² times the square of the age reaches 9.5 m after 2.5 s; two more confirm it
    assert pair.first("notice") == pytest.approx(2.75 + math.sqrt(9.5 / 1.5) + 2.0, abs=0.5)
    (lost,) = [event for _, event in pair.events if event.data.get("watched") is False]
    assert "bravo" in lost.text and f"{TRACK_SILENT_S:g} s" in lost.text
    assert pair.monitor.tracks.unwatched[2 << 8 | 1][2]
    pair.run(2.0, here, there)
    assert pair.events[-1][1].data == {"watched": True}


def test_what_approaches_a_silent_vehicle_is_warned_of_earlier() -> None:
    def warned(silent: bool) -> float:
        pair = Watched(WatchedVehicle(1), WatchedVehicle(2))
        to, other = flying((-40.0, 0.0, 20.0), (2.0, 0.0, 0.0)), standing(0.0, 0.0, 20.0)
        pair.run(10.0, to, other)
        pair.run(10.0, to, None if silent else other)
        return pair.first("action")

    assert warned(True) <= warned(False) - 2.0


# --- what counts ------------------------------------------------------------------------------------------------------


def test_parked_vehicles_are_no_pair_but_an_obstacle_to_what_lands_on_them() -> None:
    fleet = Watched(WatchedVehicle(1), WatchedVehicle(2), WatchedVehicle(3))
    fleet.armed = {1: False, 2: False}
    down = flying((0.5, 0.0, 20.0), (0.0, 0.0, -1.0))
    fleet.run(10.0, standing(0.0, 0.0, 0.0), standing(1.0, 0.0, 0.0), standing(50.0, 0.0, 20.0))
    assert fleet.events == [] and len(fleet.monitor.tracks.tracks) == 3
    fleet.begun = fleet.now
    fleet.run(14.0, standing(0.0, 0.0, 0.0), standing(1.0, 0.0, 0.0), down)
    assert {tuple(sorted(event.data["vehicles"])) for _, event in fleet.events} == {("v1", "v3"), ("v2", "v3")}


def test_a_parked_vehicle_that_was_switched_off_stays_an_obstacle() -> None:
    fleet = Watched(WatchedVehicle(1), WatchedVehicle(2))
    fleet.armed = {1: False}
    fleet.run(2.0, standing(0.0, 0.0, 0.0), standing(0.5, 0.0, 30.0))
    fleet.run(60.0, None, standing(0.5, 0.0, 30.0))
    assert fleet.events == []
    fleet.begun = fleet.now
    fleet.run(20.0, None, flying((0.5, 0.0, 30.0), (0.0, 0.0, -1.5)))
    assert "action" in fleet.levels()


def test_an_armed_vehicle_on_the_ground_is_parked_and_one_that_shows_flight_is_not() -> None:
    fleet = Watched(WatchedVehicle(1), WatchedVehicle(2))
    fleet.status = {1: STANDBY, 2: STANDBY}
    fleet.run(4.0, standing(0.0, 0.0, 0.0), standing(1.0, 0.0, 0.0))
    assert fleet.events == [] and all(track.parked for track in fleet.monitor.tracks.tracks.values())
    fleet.armed = {1: False, 2: True}
    fleet.run(4.0, standing(0.0, 0.0, 20.0), standing(1.0, 0.0, 20.0))  # disarmed, and 20 m above its home
    assert fleet.levels() == ["warning"]


@each(
    ("landed_state", "speed_mps", "parked"),
    [(ON_GROUND, 0.0, True), (ON_GROUND, 4.0, False), (IN_AIR, 0.0, False), (0, 0.0, False), (None, 0.0, False)],
)
def test_a_disarmed_vehicle_high_above_its_home_is_parked_only_where_it_reports_the_ground(
    landed_state: int | None, speed_mps: float, parked: bool
) -> None:
    """On a roof or a hill; an old report says nothing."""
    shown = WatchedVehicle(1)
    beat = {"type": 2, "autopilot": 3, "base_mode": 1, "custom_mode": GUIDED, "system_status": STANDBY}
    shown.send("HEARTBEAT", 0.0, **beat, mavlink_version=3)
    at, state = (96.0, ON_GROUND) if landed_state is None else (100.0, landed_state)
    shown.send("EXTENDED_SYS_STATE", at, vtol_state=0, landed_state=state)
    shown.send("HEARTBEAT", 100.0, **beat, mavlink_version=3)
    shown.position(100.0, (0.0, 0.0, 20.0), (speed_mps, 0.0, 0.0))
    assert is_flying(shown.vehicle, 100.0) is not parked


def test_vehicles_that_cannot_be_watched_are_listed_with_the_reason() -> None:
    nowhere, recorded, twice = WatchedVehicle(1), WatchedVehicle(2), WatchedVehicle(3)
    recorded.vehicle.replayed = True
    twice.vehicle.ids.beside = True
    fleet = Watched(nowhere, recorded, twice)
    for _ in range(20):
        for vehicle in fleet.fleet:
            vehicle.heartbeat(fleet.now)
        fleet.look()
        fleet.now += STEP_S
    reasons = {name: why for name, why, _ in fleet.monitor.tracks.unwatched.values()}
    assert "no position" in reasons["v1"] and "recording" in reasons["v2"] and "one link" in reasons["v3"]
    told = [event.vehicle for _, event in fleet.events]
    assert sorted(told) == ["v1", "v3"], "once each; a recording is not news"


@pytest.mark.parametrize(
    "place",
    [(95.0, 10.0, 100.0), (43.0, 200.0, 100.0), (43.0, 10.0, 2e5), (0.0, 0.0, 0.0)],
    ids=["latitude", "longitude", "height", "none"],
)
@pytest.mark.parametrize("lands", [False, True])
def test_one_that_reports_places_not_on_earth_counts_where_it_was_seen_last(
    place: tuple[float, float, float], lands: bool
) -> None:
    """It counted as nowhere: others were sent to where it had been seen a moment ago."""
    bad, good = WatchedVehicle(1), WatchedVehicle(2)
    fleet = Watched(bad, good)
    begun = fleet.now

    def look(until_s: float) -> None:
        while fleet.now < begun + until_s:
            for one in (bad, good):
                one.heartbeat(fleet.now, status=STANDBY if lands and one is bad else ACTIVE)
            good.position(fleet.now, (40.0, 0.0, 10.0))
            if fleet.now < begun + 2.0:
                bad.position(fleet.now, (0.0, 0.0, 0.0 if lands else 10.0))
            else:
                bad.geodetic(fleet.now, *place, (0.0, 0.0, 0.0), 0.0 if lands else 10.0)
            fleet.look()
            fleet.now += STEP_S

    tracks = fleet.monitor.tracks
    look(8.0)
    assert set(tracks.tracks) == {bad.vehicle.key, good.vehicle.key}
    look(30.0)
    kept = tracks.tracks if lands else tracks.lost
    seen = ecef(*bad.geodetic_of(0.0, 0.0, 0.0 if lands else 10.0))
    assert kept[bad.vehicle.key].ecef_m == pytest.approx(seen, abs=0.1)
    if not lands:
        (_, why, flying) = tracks.unwatched[bad.vehicle.key]
        assert flying and "position" in why and "anywhere" in why


@pytest.mark.parametrize(("lat_deg", "lon_deg"), [(90.0, 10.0), (-90.0, 0.0), (10.0, 180.0), (43.0, 179.99995)])
def test_a_pole_and_the_date_line_are_places_like_others(lat_deg: float, lon_deg: float) -> None:
    """Two vehicles 6 m apart over one of them: by a sphere, as the oracle."""
    step_deg = math.degrees(6.0 / 6_371_000.0)
    across = lon_deg if abs(lat_deg) == 90.0 else lon_deg + step_deg / math.cos(math.radians(lat_deg))
    other = (lat_deg - math.copysign(step_deg, lat_deg) if abs(lat_deg) == 90.0 else lat_deg, across)
    a, b = WatchedVehicle(1), WatchedVehicle(2)
    fleet = Watched(a, b)
    for _ in range(8):
        for one, place in ((a, (lat_deg, lon_deg)), (b, (other[0], (other[1] + 180.0) % 360.0 - 180.0))):
            one.heartbeat(fleet.now)
            one.geodetic(fleet.now, *place, 100.0, (0.0, 0.0, 0.0))
        fleet.look()
        fleet.now += STEP_S
    first, second = fleet.monitor.tracks.tracks.values()
    assert math.dist(first.place_m, second.place_m) == pytest.approx(6.0, rel=0.02)


# --- holds ------------------------------------------------------------------------------------------------------------


def crossing(**names: str) -> tuple[Watched, Where, Where]:
    fleet = Watched(WatchedVehicle(1, names.get("a")), WatchedVehicle(2, names.get("b")), acting=True)
    return (fleet, flying((-24.0, 0.0, 20.0), (2.0, 0.0, 0.0)), flying((0.0, -24.0, 20.0), (0.0, 2.0, 0.0)))


def test_the_later_name_holds_and_only_once() -> None:
    fleet, a, b = crossing(a="alpha", b="bravo")
    fleet.run(30.0, a, b)  # it flies on all the same: somebody ordered it on
    held = [hold.name for _, hold in fleet.holds]
    assert held[0] == "bravo" and held.count("bravo") == 1 and held.count("alpha") <= 1


@each(("first", "second"), [(5, 0), (0, 5)])
def test_priority_goes_before_the_name(first: int, second: int) -> None:
    fleet, a, b = crossing(a="alpha", b="bravo")
    fleet.fleet[0].priority, fleet.fleet[1].priority = first, second
    fleet.run(9.5, a, b)
    assert [hold.name for _, hold in fleet.holds] == ["bravo" if first > second else "alpha"]


@each(("mode", "status"), [(LOITER, ACTIVE), (RTL, ACTIVE), (LAND, ACTIVE), (0, ACTIVE), (GUIDED, CRITICAL)])
def test_who_is_flown_by_a_pilot_comes_home_or_is_in_failsafe_never_holds(mode: int, status: int) -> None:
    fleet, a, b = crossing()
    fleet.modes, fleet.status = {2: mode}, {2: status}
    fleet.run(9.5, a, b)
    assert [hold.name for _, hold in fleet.holds] == ["v1"]
    fleet.modes, fleet.status = {1: mode, 2: mode}, {1: status, 2: status}
    both, a, b = crossing()
    both.modes, both.status = fleet.modes, fleet.status
    both.run(20.0, a, b)
    assert both.holds == [] and "action" in both.levels()


def test_a_silent_vehicle_never_holds_and_the_other_does() -> None:
    fleet, a, b = crossing()
    fleet.run(2.0, a, b)
    fleet.run(7.0, a, None)
    assert [hold.name for _, hold in fleet.holds] == ["v1"]


def test_a_hold_that_does_not_help_is_not_ordered() -> None:
    fleet = Watched(WatchedVehicle(1), WatchedVehicle(2), acting=True)
    fleet.modes = {1: LOITER}
    fleet.run(14.0, flying((-24.0, 0.0, 20.0), (2.0, 0.0, 0.0)), standing(0.0, 0.0, 20.0))
    assert fleet.holds == [] and "action" in fleet.levels()


def test_the_one_behind_holds_although_it_has_the_right_of_way() -> None:
    fleet = Watched(WatchedVehicle(1), WatchedVehicle(2), acting=True)
    fleet.run(25.0, flying((-14.0, 0.0, 20.0), (2.0, 0.0, 0.0)), flying((0.0, 0.0, 20.0), (1.0, 0.0, 0.0)))
    assert fleet.holds[0][1].name == "v1"


def test_an_operator_who_orders_on_is_not_fought_for_a_minute_and_watched_again_after_it() -> None:
    fleet, a, b = crossing()
    fleet.run(9.0, a, b)
    assert [hold.name for _, hold in fleet.holds] == ["v2"]
    held = len(fleet.holds)
    apart = standing(0.0, -10.0, 20.0), standing(200.0, 0.0, 20.0)
    fleet.run(5.0, *apart)
    fleet.begun = fleet.now
    fleet.run(8.75, a, b)  # ordered on into the same
    assert [hold.name for _, hold in fleet.holds[held:]] != ["v2"]
    fleet.run(REHOLD_S + 5.0, *apart)
    fleet.begun, held = fleet.now, len(fleet.holds)
    fleet.run(9.5, a, b)
    assert [hold.name for _, hold in fleet.holds[held:]] == ["v2"]


def test_advisory_orders_nothing() -> None:
    fleet, a, b = crossing()
    fleet.monitor.acting = False
    fleet.run(15.0, a, b)
    assert fleet.holds == [] and "action" in fleet.levels()


# --- hostile ----------------------------------------------------------------------------------------------------------


def test_a_forged_position_of_another_place_reports_nothing_and_tilts_no_frame() -> None:
    forged = WatchedVehicle(3)
    fleet = Watched(WatchedVehicle(1), WatchedVehicle(2), forged)
    for lat_deg, lon_deg, alt_m in ((-80.0, 10.0, 5.0), (89.9, 180.0, -1e6), (214.0, -214.0, 0.0), (0.0, 0.0, 2e6)):
        for _ in range(20):
            forged.heartbeat(fleet.now)
            forged.geodetic(fleet.now, lat_deg, lon_deg, alt_m, (300.0, -300.0, 300.0))
            fleet.run(STEP_S, standing(0.0, 0.0, 20.0), standing(4.0, 0.0, 20.0))
        assert fleet.levels() == []
        frame = fleet.monitor.tracks.frame
        assert frame is not None and abs(frame.origin.lat_deg - ORIGIN.lat_deg) < 0.01


def test_many_at_one_place_are_bounded_and_a_real_conflict_among_them_is_found() -> None:
    fleet = Watched(*(WatchedVehicle(i + 1) for i in range(50)))
    crowd = [standing(500.0 + 0.01 * i, 0.0, 20.0) for i in range(48)]
    pair = [flying((-20.0, 0.0, 20.0), (2.0, 0.0, 0.0)), flying((20.0, 0.0, 20.0), (-2.0, 0.0, 0.0))]
    fleet.run(5.0, *crowd, *pair)
    assert len(fleet.monitor.pairs) <= 50 * MAX_CONFLICTS
    assert fleet.monitor.counters.pairs_dropped > 0
    assert any(set(event.data["vehicles"]) == {"v49", "v50"} for _, event in fleet.events)


def test_no_turn_of_an_evaluation_grows_with_the_conflicts(monkeypatch: pytest.MonkeyPatch) -> None:
    crowd = [WatchedVehicle(i + 1) for i in range(60)]
    fleet = Watched(*crowd)
    places = [standing(0.01 * i, 0.0, 20.0) for i in range(60)]
    done: list[int] = []
    advance, report = Pair.advance, Monitor._report
    monkeypatch.setattr(Pair, "advance", lambda *args: done.append(1) or advance(*args))
    monkeypatch.setattr(Monitor, "_report", lambda *args: done.append(1) or report(*args))
    fleet.run(2.25, *places)  # from now on every conflict is confirmed and reported in one evaluation
    done.clear()
    most = 0
    for _ in fleet.monitor.evaluate([v.member for v in crowd], fleet.now + 1.0):
        most, _ = max(most, len(done)), done.clear()
    assert len(fleet.monitor.pairs) > 200
    assert 0 < max(most, len(done)) <= 2 * CONFLICTS_A_TURN


def test_a_pair_that_gives_way_to_more_urgent_ones_is_not_called_clear() -> None:
    a, b, crowd = WatchedVehicle(1), WatchedVehicle(2), [WatchedVehicle(10 + i) for i in range(20)]
    fleet = Watched(a, b, *crowd)
    apart = [standing(300.0 + 20.0 * i, 0.0, 20.0) for i in range(20)]
    fleet.run(4.0, standing(0.0, 0.0, 20.0), standing(2.2, 0.0, 20.0), *apart)
    assert fleet.levels() == ["warning"]
    among = [standing(0.3 + 0.08 * i, 0.1, 20.0) for i in range(20)]
    fleet.events.clear()
    fleet.run(1.0, standing(0.0, 0.0, 20.0), standing(2.2, 0.0, 20.0), *among)
    about = [event.text for _, event in fleet.events if event.data["vehicles"] == ["v1", "v2"]]
    assert about == ["v1 and v2 are in conflict still, each of them more urgently with 8 others"]
    assert (1 << 8 | 1, 2 << 8 | 1) not in fleet.monitor.pairs
    fleet.events.clear()
    fleet.run(4.0, standing(0.0, 0.0, 20.0), standing(2.2, 0.0, 20.0), *among)
    assert not [event for _, event in fleet.events if "clear" in event.text]


def test_a_vehicle_that_is_forgotten_or_renamed_takes_its_pairs_with_it() -> None:
    fleet = Watched(WatchedVehicle(1), WatchedVehicle(2))
    near = standing(0.0, 0.0, 20.0), standing(1.0, 0.0, 20.0)
    fleet.run(4.0, *near)
    assert fleet.levels() == ["warning"]
    fleet.fleet[1] = WatchedVehicle(2, "new")  # another vehicle with the same id
    fleet.run(4.0, *near)
    assert fleet.levels() == ["warning", "none", "warning"]
    del fleet.fleet[1]
    fleet.run(1.0, near[0])
    assert fleet.monitor.pairs == {} and fleet.levels()[-1] == "none"
    assert fleet.monitor.of(1 << 8 | 1) is None


def test_places_are_in_the_frame_that_is_there_at_each_turn_of_a_refresh() -> None:
    """Orders that were checked between two turns compared places of one frame with goals of another."""
    world, fleet = EnuFrame(ORIGIN), Watched(*(WatchedVehicle(n) for n in (1, 2, 3)))
    fleet.run(1.0, *(standing(x, 0.0, 20.0) for x in (0.0, 5.0, 10.0)))
    seen = {1: {0.0, 1000.0}, 2: {5.0, 1050.0}, 3: {10.0, 970.0}}
    for vehicle, x in zip(fleet.fleet, (1000.0, 1050.0, 970.0), strict=True):
        vehicle.position(fleet.now, (x, 0.0, 20.0), (0.0, 0.0, 0.0))
    tracks = fleet.monitor.tracks
    for _ in tracks.refresh([v.member for v in fleet.fleet], fleet.now):
        assert tracks.frame is not None
        for track in tracks.tracks.values():
            east_m = world.from_geodetic(*tracks.frame.to_geodetic(*track.place_m))[0]
            assert any(abs(east_m - x) < 1.0 for x in seen[track.vehicle.sysid]), (track.name, east_m)


def test_time_that_goes_back_or_stands_still_breaks_nothing() -> None:
    fleet = Watched(WatchedVehicle(1), WatchedVehicle(2))
    fleet.run(4.0, standing(0.0, 0.0, 20.0), standing(1.0, 0.0, 20.0))
    fleet.now -= 30.0
    fleet.run(4.0, standing(0.0, 0.0, 20.0), standing(1.0, 0.0, 20.0))
    for _ in range(10):
        fleet.look()
    assert fleet.monitor.of(1 << 8 | 1) is not None


def test_the_worst_conflict_of_a_vehicle_is_in_its_state() -> None:
    fleet = Watched(WatchedVehicle(1), WatchedVehicle(2), WatchedVehicle(3))
    fleet.run(6.0, standing(0.0, 0.0, 20.0), standing(2.3, 0.0, 20.0), flying((-24.0, 0.0, 20.0), (3.0, 0.0, 0.0)))
    state = fleet.monitor.of(1 << 8 | 1)
    assert state is not None and state["with"] == "v3" and state["level"] == "action"
    assert fleet.monitor.conflicts()[0].level is Level.ACTION
    fleet.monitor.pairs.clear()
    assert fleet.monitor.of(1 << 8 | 1) == state, "looked up, not looked for among all pairs: 88 ms for 250 vehicles"


# --- events in the wrong order ----------------------------------------------------------------------------------------


def head_on(*, acting: bool = True) -> Watched:
    return Watched(WatchedVehicle(1), WatchedVehicle(2), acting=acting)


def test_changes_and_holds_are_counted_and_one_that_flies_where_another_was_lost_is_warned_of_once() -> None:
    fleet = head_on()
    fleet.run(9.0, WEST, EAST)
    counters, levels = fleet.monitor.counters, fleet.levels()
    counted = [counters.notices, counters.warnings, counters.actions, counters.holds]
    assert counted == [*(levels.count(level) for level in ("notice", "warning", "action")), len(fleet.holds)]
    assert counters.actions and counters.holds
    lost = Watched(WatchedVehicle(1), WatchedVehicle(2))
    beside = standing(2.5 + NEAR_LOST_M / 2.0, 0.0, 20.0)
    lost.run(2.0, standing(0.0, 0.0, 20.0), standing(60.0, 0.0, 20.0))
    lost.run(TRACK_SILENT_S + 5.0, None, beside)
    assert [e.text.split(" m from ")[1] for _, e in lost.events if "lost" in e.data] == ["where v1 was lost in the air"]


WEST = flying((-20.0, 0.0, 20.0), (2.0, 0.0, 0.0))
EAST = flying((20.0, 0.0, 20.0), (-2.0, 0.0, 0.0))
SOUTH = flying((0.0, 20.0, 20.0), (0.0, -2.0, 0.0))


def test_one_that_vanishes_in_mid_conflict_is_warned_of_until_it_may_be_anywhere() -> None:
    fleet = head_on()
    fleet.run(3.0, WEST, EAST)
    fleet.run(5.0, WEST, None)
    assert "action" in fleet.levels()
    assert not [at for at, hold in fleet.holds if hold.name == "v2" and at > 5.0], "silent for 2 s"
    fleet.run(TRACK_SILENT_S, standing(0.0, 0.0, 20.0), None)
    assert fleet.monitor.pairs == {} and fleet.levels()[-1] == "none"
    assert any(event.data.get("watched") is False for _, event in fleet.events)
    fleet.run(4.0, standing(0.0, 0.0, 20.0), standing(1.0, 0.0, 20.0))
    assert fleet.levels()[-1] in ("warning", "action"), "it came back, too near"


def test_a_new_system_id_in_mid_conflict_begins_a_conflict_of_its_own() -> None:
    fleet = head_on(acting=False)
    fleet.run(4.0, WEST, EAST)
    fleet.fleet[1] = WatchedVehicle(77, "v2")
    fleet.run(3.0, WEST, EAST)
    assert set(fleet.monitor.pairs) == {(1 << 8 | 1, 77 << 8 | 1)}
    told = [(event.data["vehicles"], event.data["level"]) for _, event in fleet.events]
    assert (["v1", "v2"], "none") in told and told[-1][1] in ("warning", "action")


def test_a_pilot_who_takes_over_in_an_action_is_left_alone_and_the_other_holds() -> None:
    fleet = head_on()
    fleet.run(2.25, WEST, SOUTH)
    fleet.modes[2] = LOITER
    fleet.run(6.0, WEST, SOUTH)
    assert [hold.name for _, hold in fleet.holds] == ["v1"]


def test_a_hold_that_failed_is_ordered_again_and_one_that_was_taken_back_is_not() -> None:
    for again in (True, False):
        fleet = head_on()
        fleet.modes[1] = LOITER  # its pilot flies the other
        fleet.run(6.5, WEST, SOUTH)
        ((_, hold),) = fleet.holds
        assert hold.name == "v2"
        if again:
            fleet.monitor.hold_failed(hold, fleet.now)
        fleet.run(2.0, WEST, SOUTH)
        assert [h.name for _, h in fleet.holds] == (["v2", "v2"] if again else ["v2"])


def test_two_conflicts_of_one_vehicle_order_one_hold_of_it_for_each_at_most() -> None:
    fleet = Watched(*(WatchedVehicle(i) for i in (1, 2, 3)), acting=True)
    west = flying((-20.0, 4.0, 20.0), (2.0, -0.4, 0.0))
    fleet.run(12.0, west, flying((-20.0, -4.0, 20.0), (2.0, 0.4, 0.0)), EAST)
    holds = [(hold.name, hold.other) for _, hold in fleet.holds]
    assert holds and len(holds) == len(set(holds)), holds


@each("seed", seeds(8))
def test_positions_that_jump_or_lie_end_no_watch_and_grow_nothing(seed: int) -> None:
    rng = random.Random(seed)
    fleet = Watched(*(WatchedVehicle(i + 1) for i in range(6)), acting=True)
    extremes = (0, 1, -1, 2**31 - 1, -(2**31), 900_000_000, -900_000_001, 1_800_000_000)
    for _ in range(80):
        for vehicle in fleet.fleet[:4]:
            vehicle.heartbeat(fleet.now, armed=rng.random() < 0.9, mode=rng.choice((GUIDED, LOITER, RTL, LAND)))
            values = {key: rng.choice(extremes) for key in ("lat", "lon", "alt", "relative_alt")}
            speeds = {key: rng.randint(-32768, 32767) for key in ("vx", "vy", "vz")}
            if rng.random() < 0.5:
                here = [rng.uniform(-9.0, 9.0) for _ in "xy"]
                vehicle.position(fleet.now, (*here, 20.0), [rng.uniform(-300.0, 300.0) for _ in "xyz"])
            else:
                vehicle.send("GLOBAL_POSITION_INT", fleet.now, time_boot_ms=0, **values, **speeds, hdg=0)
        fleet.run(STEP_S, *[None] * 4, standing(0.0, 50.0, 20.0), standing(1.0, 50.0, 20.0))
    assert (5 << 8 | 1, 6 << 8 | 1) in fleet.monitor.pairs, "the honest pair is watched all the while"
    assert len(fleet.monitor.pairs) <= 15 and len(fleet.monitor._held) <= 15
    for event in (event for _, event in fleet.events):
        assert all(value == value for value in event.data.values())  # no NaN


def test_all_system_ids_at_once_are_watched() -> None:
    fleet = Watched(*(WatchedVehicle(i) for i in range(1, 256)))
    places = [standing(10.0 * (i % 16), 10.0 * (i // 16), 20.0) for i in range(253)]
    fleet.run(2.5, *places, standing(-50.0, 0.0, 20.0), standing(-51.0, 0.0, 20.0))
    assert len(fleet.monitor.tracks.tracks) == 255
    assert [pair.level for pair in fleet.monitor.conflicts()] == [Level.WARNING]


def test_two_holds_that_cross_are_one_hold_of_each_and_both_stand_apart() -> None:
    """Three conflicts at one place: the orders of one pair are on their way while the next evaluations see all of them
    still flying, and order holds for the other pairs."""
    fleet = Watched(*(WatchedVehicle(i, name) for i, name in enumerate(("alpha", "bravo", "charlie"), 1)), acting=True)
    a = flying((-20.0, 0.0, 20.0), (2.0, 0.0, 0.0))
    b = flying((0.0, -20.0, 20.0), (0.0, 2.0, 0.0))
    c = flying((20.0, 0.0, 20.0), (-2.0, 0.0, 0.0))
    while not fleet.holds:
        fleet.run(STEP_S, a, b, c)
        assert fleet.now - fleet.begun < 10.0
    fleet.run(1.0, a, b, c)  # a busy radio: none of the holds has arrived
    ordered = [hold.name for _, hold in fleet.holds]
    assert {"bravo", "charlie"} <= set(ordered), ordered  # alpha meets charlie head-on: there both have to hold
    pairs = [(hold.name, hold.pair) for _, hold in fleet.holds]
    assert len(pairs) == len(set(pairs)), "a hold is ordered once for a pair"
    at = fleet.now - fleet.begun

    def stands(motion: Where) -> Where:
        place, _ = motion(at)
        return standing(*place)

    fleet.run(8.0, stands(a), stands(b), stands(c))
    assert fleet.monitor.pairs == {} or all(pair.level <= Level.NOTICE for pair in fleet.monitor.pairs.values())
    assert [hold.name for _, hold in fleet.holds] == ordered, "who stands is not held again"


def test_the_pair_that_holds_each_for_the_other_is_released_by_nobody_twice() -> None:
    """Head-on: the lower one's hold does not suffice, so both hold; a hold that fails is repeated for that one only."""
    fleet = Watched(WatchedVehicle(1), WatchedVehicle(2), acting=True)
    west, east = flying((-16.0, 0.0, 20.0), (4.0, 0.0, 0.0)), flying((16.0, 0.0, 20.0), (-4.0, 0.0, 0.0))
    while not fleet.holds:
        fleet.run(STEP_S, west, east)
        assert fleet.now - fleet.begun < 10.0
    assert sorted(hold.name for _, hold in fleet.holds) == ["v1", "v2"]
    failed = next(hold for _, hold in fleet.holds if hold.name == "v2")
    fleet.monitor.hold_failed(failed, fleet.now)
    fleet.run(1.5, west, east)
    assert [hold.name for _, hold in fleet.holds].count("v1") == 1
