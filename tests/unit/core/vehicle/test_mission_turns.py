"""The table of missions one after another."""

from __future__ import annotations

import itertools

import pytest

from skygcs.core.mission.item import MissionItem
from skygcs.core.vehicle.mission_orders import Turn, ends_on_ground, next_turn

ON_ITS_WAY = Turn("v1", True, True, True, False, False, False, True)


@pytest.mark.parametrize(
    ("flown", "next_", "why"),
    [
        (ON_ITS_WAY, "wait", ""),
        (ON_ITS_WAY._replace(complete=True), "wait", ""),  # its last item is a return, which it flies
        (ON_ITS_WAY._replace(complete=True, lands=False), "start", "v1 has flown its mission"),
        (ON_ITS_WAY._replace(flying=False), "wait", ""),  # armed on the ground: it is about to take off
        (ON_ITS_WAY._replace(flying=False, armed=False), "start", "v1 has landed"),
        (ON_ITS_WAY._replace(heard=False), "end", "v1 is not heard"),
        (ON_ITS_WAY._replace(failsafe=True), "end", "v1 is in failsafe"),
        (ON_ITS_WAY._replace(ordered=True), "end", "v1 was ordered something else"),
    ],
)
def test_each_row_of_the_table(flown: Turn, next_: str, why: str) -> None:
    assert next_turn(flown) == (next_, why)


def test_nobody_starts_while_the_one_before_is_taken_over_in_trouble_or_in_the_air_with_its_way_before_it() -> None:
    for flags in itertools.product([False, True], repeat=7):
        flown = Turn("v1", *flags)
        if next_turn(flown).next == "start":
            assert flown.heard and not flown.failsafe and not flown.ordered
            assert not flown.flying or (flown.complete and not flown.lands)


def test_a_mission_ends_on_the_ground_by_its_last_item_that_moves() -> None:
    waypoint, home, land, speed = MissionItem(16), MissionItem(20), MissionItem(21), MissionItem(178)
    assert ends_on_ground([waypoint, home]) and ends_on_ground([waypoint, land, speed])
    assert not ends_on_ground([waypoint]) and not ends_on_ground([]) and not ends_on_ground([home, waypoint])
