"""Several vehicles sent to one place keep their distances."""

from __future__ import annotations

import math

from hypothesis import given
from hypothesis import strategies as st

from skygcs.core.geo import distance_m
from skygcs.core.vehicle.formation import moved, offsets_en_m, too_close

near = st.tuples(st.floats(43.780, 43.781), st.floats(-79.466, -79.465))


def test_nobody_has_no_offsets() -> None:
    assert offsets_en_m({}) == {}


def test_a_single_vehicle_goes_to_the_very_point() -> None:
    [(east_m, north_m)] = offsets_en_m({1: (43.78, -79.46)}).values()
    assert math.hypot(east_m, north_m) < 1e-6


@given(st.lists(near, min_size=2, max_size=9))
def test_distances_between_vehicles_are_kept_and_their_middle_is_the_point(places: list[tuple[float, float]]) -> None:
    named = dict(enumerate(places))
    offsets = offsets_en_m(named)
    assert abs(sum(e for e, _ in offsets.values())) < 1e-6
    assert abs(sum(n for _, n in offsets.values())) < 1e-6
    goal = (43.80, -79.40)
    new = {key: moved(*goal, offset) for key, offset in offsets.items()}
    for a in named:
        for b in named:
            before = distance_m(*named[a], *named[b])
            after = distance_m(*new[a], *new[b])
            assert abs(before - after) < 0.05 + 0.001 * before


def test_too_close_is_less_than_three_metres_both_across_and_in_height() -> None:
    a, two_m_east, four_m_east = (43.78, -79.46, 100.0), (43.78, -79.459975, 101.0), (43.78, -79.45995, 100.0)
    assert too_close({"a": a, "c": four_m_east}) is None
    assert too_close({"a": a, "b": (*two_m_east[:2], 103.1)}) is None
    found = too_close({"c": (43.79, -79.46, 100.0), "a": a, "b": two_m_east})
    assert found is not None
    assert found[:2] == ("a", "b")
    assert 1.9 < found[2] < 2.1
