"""`skygcs-cli monitor`, and conflicts in `status`."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

from skygcs.cli.status import armed_word
from support.controlled import Commanded

CONFLICT = {
    "vehicles": ["alpha", "bravo"],
    "level": "warning",
    "distance_m": 14.2,
    "closest_m": 0.42,
    "closest_in_s": 6.1,
    "enters_in_s": 5.4,
    "margin_m": 2.6,
    "wingspans_m": 0.7,
    "position_errors_m": 1.8,
    "balls_m": 0.1,
}


@pytest.fixture
def fleet(tmp_path: Path) -> Iterator[Commanded]:
    with Commanded(tmp_path) as running:
        yield running


def test_conflicts_are_shown_with_each_term_and_what_is_not_watched_with_the_reason(fleet: Commanded) -> None:
    answer = fleet.daemon.fleet.monitor.answer
    answer["conflicts"] = [CONFLICT]
    answer["unwatched"] = [{"vehicle": "carol", "reason": "it reports no position", "flying": True}]
    answer["counters"]["warnings"] = 1
    text = fleet.run("monitor")
    assert "advisory: 3 vehicles watched, 2 flying, 1 parked" in text
    assert "warning      alpha and bravo: 14.2 m now, 0.4 m in 6 s; margin 2.6 m = wingspans 0.7" in text
    assert "position errors 1.8 + age 0.1" in text
    assert "carol: flies and it reports no position" in text
    assert "0 notices, 1 warning, 0 actions" in text
    assert fleet.json("monitor")["conflicts"] == [CONFLICT]


def test_a_pair_that_is_clear_again_has_no_figures_yet(fleet: Commanded) -> None:
    fleet.daemon.fleet.monitor.answer["conflicts"] = [{"vehicles": ["alpha", "bravo"], "level": "notice"}]
    assert "notice       alpha and bravo: clear at present" in fleet.run("monitor")


def test_off_says_so(fleet: Commanded) -> None:
    fleet.daemon.fleet.monitor.answer["mode"] = "off"
    assert "nothing is watched and orders are not checked" in fleet.run("monitor")


def test_status_names_the_other_vehicle(fleet: Commanded) -> None:
    fleet.daemon.fleet.monitor.conflicts = {1 << 8 | 1: {"level": "action", "with": "bravo"}}
    assert "NEAR BRAVO" in fleet.run("status")
    assert armed_word({"armed": True, "separation": {"level": "notice", "with": "bravo"}}) == "ARMED near bravo"
    assert armed_word({"armed": True, "separation": None}) == "ARMED"
