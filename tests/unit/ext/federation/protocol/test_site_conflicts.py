"""Our vehicles against those of other sites: what is predicted, when it is reported, and what is bounded."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from skygcs.core.geo import Origin, geodetic_from_enu
from skygcs.core.monitor.conflict_levels import CLEAR_S, CONFIRM_S, HORIZON_S, NOISE_MPS, WARNING_S
from skygcs.core.separation import Footprint, pair_margin
from skygcs.events import Event
from skygcs.ext.federation.protocol.site_conflicts import (
    MAX_CONFLICTS,
    PAIRS_A_TURN,
    TRACK_SILENT_S,
    SiteConflicts,
    SiteVehicle,
)
from support.table import each

FIELD = Origin(43.78, -79.46, 180.0)
MARGIN_M = pair_margin(Footprint(), Footprint()).total_m

Vector = tuple[float, float, float]


def vehicle(
    name: str, place_m: Vector, velocity_mps: Vector = (0.0, 0.0, 0.0), *, age_s: float = 0.0, flying: bool = True
) -> SiteVehicle:
    """``place_m``: where it was ``age_s`` ago."""
    lat_deg, lon_deg, alt_m = geodetic_from_enu(*place_m, FIELD)
    return SiteVehicle(name, lat_deg, lon_deg, alt_m, velocity_mps, age_s, flying)


def evaluate(watch: SiteConflicts, ours: list[SiteVehicle], others: list[SiteVehicle], now: float) -> list[Event]:
    for _ in watch.evaluate(ours, others, now):
        pass
    events, watch.events = watch.events, []
    return events


def settled(ours: list[SiteVehicle], others: list[SiteVehicle]) -> SiteConflicts:
    """What is confirmed of a picture that stays as it is."""
    watch = SiteConflicts()
    for now in (0.0, CONFIRM_S):
        evaluate(watch, ours, others, now)
    return watch


def head_on(distance_m: float, speed_mps: float = 5.0) -> tuple[SiteVehicle, SiteVehicle]:
    return (
        vehicle("alpha", (0.0, 0.0, 10.0), (speed_mps / 2, 0.0, 0.0)),
        vehicle("south/bravo", (distance_m, 0.0, 10.0), (-speed_mps / 2, 0.0, 0.0)),
    )


def test_two_that_fly_at_each_other_are_reported_once_with_both_names_and_the_age() -> None:
    watch, (ours, other) = SiteConflicts(), head_on(30.0)
    assert evaluate(watch, [ours], [other], 0.0) == []
    assert evaluate(watch, [ours], [other], CONFIRM_S / 2) == []
    (event,) = evaluate(watch, [ours], [other], CONFIRM_S)
    assert (event.kind, event.vehicle) == ("separation", "alpha")
    assert "alpha and south/bravo will come 0.0 m near each other in 6 s" in event.text
    assert event.data["site"] == "south" and event.data["level"] == "warning"
    assert evaluate(watch, [ours], [other], CONFIRM_S + 1) == []
    assert [conflict.describe()["vehicles"] for conflict in watch.conflicts()] == [["alpha", "south/bravo"]]


def test_a_conflict_that_is_far_ahead_is_a_notice_and_rises_at_once() -> None:
    watch, far = SiteConflicts(), head_on((WARNING_S + 1.0) * 4.8 + MARGIN_M)
    evaluate(watch, [far[0]], [far[1]], 0.0)
    (event,) = evaluate(watch, [far[0]], [far[1]], CONFIRM_S)
    assert event.data["level"] == "notice"
    near = head_on(20.0)
    (event,) = evaluate(watch, [near[0]], [near[1]], CONFIRM_S + 0.5)
    assert event.data["level"] == "warning"


def test_it_falls_only_after_it_was_clear_for_a_while() -> None:
    watch, (ours, other) = SiteConflicts(), head_on(30.0)
    evaluate(watch, [ours], [other], 0.0)
    evaluate(watch, [ours], [other], CONFIRM_S)
    away = replace(other, vel_enu_mps=(5.0, 0.0, 0.0))
    at = CONFIRM_S + 1
    assert evaluate(watch, [ours], [away], at) == []
    assert evaluate(watch, [ours], [away], at + CLEAR_S / 2) == []
    (event,) = evaluate(watch, [ours], [away], at + CLEAR_S)
    assert event.text == "alpha and south/bravo are clear of each other"
    assert watch.conflicts() == []


def test_one_prediction_among_many_is_noise() -> None:
    watch, (ours, other) = SiteConflicts(), head_on(30.0)
    away = replace(other, vel_enu_mps=(5.0, 0.0, 0.0))
    for n in range(20):
        assert evaluate(watch, [ours], [other if n % 2 else away], n * 1.0) == []


def test_the_ball_of_old_data_makes_a_notice_of_what_may_be_near() -> None:
    ours = vehicle("alpha", (0.0, 0.0, 10.0))
    other = vehicle("south/bravo", (MARGIN_M + 5.0, 0.0, 10.0))
    assert settled([ours], [other]).conflicts() == []
    (conflict,) = settled([ours], [replace(other, age_s=2.5)]).conflicts()
    assert conflict.describe()["level"] == "notice"
    assert "may come near each other: the position of south/bravo is 2.5 s old" in conflict.text()


def test_a_place_is_carried_on_with_its_velocity_for_its_age() -> None:
    """It was 10 m away two seconds ago and has passed since."""
    ours = vehicle("alpha", (0.0, 0.0, 10.0))
    passed = vehicle("south/bravo", (-10.0, 0.0, 10.0), (10.0, 0.0, 0.0), age_s=2.0)
    watch = settled([ours], [passed])
    assert [conflict.describe()["level"] for conflict in watch.conflicts()] in ([], ["notice"])


@each(
    "other",
    [
        vehicle("south/bravo", (1.0, 0.0, 10.0), age_s=TRACK_SILENT_S + 0.1),
        vehicle("south/bravo", (1.0, 0.0, 10.0), age_s=math.nan),
        vehicle("south/bravo", (1.0, 0.0, 10.0), age_s=-1.0),
        replace(vehicle("south/bravo", (1.0, 0.0, 10.0)), lat_deg=None),
        replace(vehicle("south/bravo", (1.0, 0.0, 10.0)), lat_deg=math.nan),
        replace(vehicle("south/bravo", (1.0, 0.0, 10.0)), lon_deg=181.0),
        replace(vehicle("south/bravo", (1.0, 0.0, 10.0)), alt_amsl_m=math.inf),
        replace(vehicle("south/bravo", (1.0, 0.0, 10.0)), lat_deg=-43.78),
    ],
)
def test_what_is_nowhere_or_anywhere_is_not_watched(other: SiteVehicle) -> None:
    assert settled([vehicle("alpha", (0.0, 0.0, 10.0))], [other]).conflicts() == []


def test_one_that_falls_silent_in_a_conflict_is_said_to_be_unwatched_and_not_clear() -> None:
    watch, (ours, other) = SiteConflicts(), head_on(30.0)
    evaluate(watch, [ours], [other], 0.0)
    evaluate(watch, [ours], [other], CONFIRM_S)
    (event,) = evaluate(watch, [ours], [], CONFIRM_S + 1)
    assert event.text == "alpha and south/bravo are not watched any more: south/bravo cannot be"
    assert watch.conflicts() == []


def test_on_the_ground_it_is_an_obstacle_for_what_flies_and_for_nothing_else() -> None:
    landed = vehicle("south/bravo", (10.0, 0.0, 0.0), flying=False)
    coming = vehicle("alpha", (0.0, 0.0, 0.0), (2.0, 0.0, 0.0))
    assert len(settled([coming], [landed]).conflicts()) == 1
    assert settled([replace(coming, flying=False)], [replace(landed, lat_deg=coming.lat_deg)]).conflicts() == []
    assert len(settled([coming], [replace(landed, age_s=1000.0)]).conflicts()) == 1  # it stays where it was


def test_a_vehicle_that_two_sites_hear_is_no_conflict_with_itself() -> None:
    ours = vehicle("alpha", (0.0, 0.0, 10.0))
    same = vehicle("south/alpha", (0.3, 0.0, 10.0))
    assert len(settled([ours], [same]).conflicts()) == 1  # two of one name, as every site may have
    shared = settled([replace(ours, shared=True)], [replace(same, shared=True)])
    assert shared.conflicts() == []
    assert len(settled([replace(ours, shared=True)], [replace(same, name="south/x", shared=True)]).conflicts()) == 1


def test_pairs_are_bounded_counted_and_the_most_urgent_ones_are_kept() -> None:
    ours = [vehicle(f"v{n}", (n * 0.01, 0.0, 10.0)) for n in range(40)]
    others = [vehicle(f"south/v{n}", (n * 0.01, 0.5, 10.0)) for n in range(40)]
    watch = settled(ours, others)
    assert len(watch.conflicts()) == MAX_CONFLICTS
    assert watch.counters.pairs_dropped == 2 * (1600 - MAX_CONFLICTS)


def test_nobody_waits_for_all_pairs() -> None:
    ours = [vehicle(f"v{n}", (0.0, 0.0, 10.0)) for n in range(50)]
    others = [vehicle(f"south/v{n}", (n * 3.0, 1.0, 10.0), (-5.0, 0.0, 0.0)) for n in range(50)]
    watch = SiteConflicts()
    assert sum(1 for _ in watch.evaluate(ours, others, 0.0)) >= watch.counters.pairs_checked // PAIRS_A_TURN > 0
    far = [vehicle(f"south/v{n}", (n * 3.0 + 5000.0, 0.0, 10.0)) for n in range(50)]
    assert sum(1 for _ in SiteConflicts().evaluate(ours, far, 0.0)) == 100 // PAIRS_A_TURN  # sites apart: their boxes


coordinate = st.floats(-60.0, 60.0)
speed = st.floats(-6.0, 6.0)
moving = st.tuples(st.tuples(coordinate, coordinate, st.floats(0.0, 60.0)), st.tuples(speed, speed, speed))


@given(st.lists(moving, min_size=1, max_size=4), st.lists(moving, min_size=1, max_size=4))
def test_what_is_found_is_what_sampling_the_flights_finds(
    ours: list[tuple[Vector, Vector]], others: list[tuple[Vector, Vector]]
) -> None:
    """Oracle: the distances at a thousand times. Pairs near the limit may be decided either way."""
    watch = settled(
        [vehicle(f"v{n}", *each) for n, each in enumerate(ours)],
        [vehicle(f"south/v{n}", *each) for n, each in enumerate(others)],
    )
    found = {(conflict.ours, conflict.other) for conflict in watch.conflicts()}
    scale = np.array([1.0, 1.0, 1.0 / Footprint().downwash_ratio])
    times = np.linspace(0.0, HORIZON_S, 1001)[:, None]
    for n, (p, u) in enumerate(ours):
        for m, (q, v) in enumerate(others):
            relative = np.array(v) - np.array(u)
            size = float(np.linalg.norm(relative))
            share = max(size - NOISE_MPS, 0.0) / size if size > 0 else 0.0
            away = np.linalg.norm((np.array(q) - np.array(p) + times * relative * share) * scale, axis=1).min()
            pair = (f"v{n}", f"south/v{m}")
            if away < MARGIN_M - 0.1:
                assert pair in found
            elif away > MARGIN_M * 1.1 + 0.1:
                assert pair not in found
