"""The mission of a vehicle that flies its way of a plan by itself."""

from __future__ import annotations

import math

from skygcs.core.mavlink import mav_cmd
from skygcs.core.mission.item import GLOBAL
from skygcs.core.plan.own_missions import HOLD_S, WITHIN_M, mission_along

PLACES = [(43.78, -79.46, 190.0), (43.7801, -79.46, 190.0), (43.7801, -79.4601, 195.5)]


def test_it_rests_at_every_corner_but_the_one_where_it_stands() -> None:
    items = mission_along(PLACES).mission
    assert [item.position for item in items] == [(43.7801, -79.46), (43.7801, -79.4601)]
    for item, (_, _, alt_amsl_m) in zip(items, PLACES[1:], strict=True):
        assert (item.command, item.frame, item.z) == (mav_cmd.NAV_WAYPOINT, GLOBAL, alt_amsl_m)
        assert item.params[:2] == (HOLD_S, WITHIN_M) and item.autocontinue
        assert math.isnan(item.values()["param4"]), "the firmware turns the nose as it is set up to"


def test_one_that_stays_holds_its_place_by_a_mission_of_one_item() -> None:
    (item,) = mission_along(PLACES[:1]).mission
    assert item.position == PLACES[0][:2] and item.z == PLACES[0][2]
