"""Several vehicles sent to one place keep their distances."""

from __future__ import annotations

import math

from hypothesis import given
from hypothesis import strategies as st

from skygcs.core.geo import distance_m
from skygcs.core.vehicle.formation import moved, offsets_en_m

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
