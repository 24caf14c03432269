"""One mission for several vehicles in the browser: arranged, drawn, refused where it overlaps, and flown in turns."""

from __future__ import annotations

import re
import time
from collections.abc import Callable
from typing import Any

import pytest
from playwright.sync_api import Page, expect

from support.page_steps import drop, fits, hold, select, side

NORTH = """QGC WPL 110
0\t1\t0\t16\t0\t0\t0\t0\t43.7806\t-79.4653\t180\t1
1\t0\t3\t22\t0\t0\t0\t0\t43.7806\t-79.4653\t10\t1
2\t0\t3\t16\t0\t0\t0\t0\t43.7808\t-79.4653\t10\t1
3\t0\t3\t16\t0\t0\t0\t0\t43.7810\t-79.4653\t10\t1
4\t0\t3\t20\t0\t0\t0\t0\t0\t0\t0\t1
"""


def opened(page: Page, *names: str, phone: bool = False) -> None:
    select(page, *names)
    side(page, "Missions", phone=phone)
    drop(page, "north.waypoints", NORTH)
    expect(page.get_by_role("region", name="Check of north.waypoints")).to_contain_text("can be flown")


def until_true(condition: Callable[[], bool]) -> None:
    deadline = time.monotonic() + 120.0
    while not condition():
        assert time.monotonic() < deadline
        time.sleep(0.2)


def heights(station: Any, name: str) -> list[float]:
    answer = station.call("missions.download", target=name)
    return [item["params"][6] for item in answer["mission"][:-1]]


def test_an_overlap_is_refused_and_uploaded_when_it_is_held(station, open_page) -> None:
    page = open_page(station)
    opened(page, "v1", "v2")
    several = page.get_by_role("group", name="For 2 vehicles")
    several.get_by_label("Missions").select_option(label="each next one higher")
    several.get_by_label("Step").fill("3")
    check = page.get_by_role("region", name="Check of north.waypoints")
    check.get_by_role("button", name="Upload to v1 and v2").click()
    orders = page.get_by_role("log", name="Orders")
    expect(orders).to_contain_text("would come")
    expect(orders).to_contain_text("they need 2.5 m")
    hold(page, check.get_by_role("button", name=re.compile("in spite of what was refused")))
    expect(orders).to_contain_text("items taken")
    assert heights(station, "v1") == [10.0, 10.0, 10.0] and heights(station, "v2") == [13.0, 13.0, 13.0]
    assert not page.errors


@pytest.mark.parametrize("theme", ["dark", "light"])
@pytest.mark.parametrize(("width", "height"), [(1600, 900), (390, 844)])
def test_the_paths_of_a_formation_are_drawn_and_uploaded(station, open_page, shot, width, height, theme) -> None:
    page = open_page(station, width=width, height=height, theme=theme)
    phone = width < 500
    opened(page, "v1", "v2", "v3", phone=phone)
    several = page.get_by_role("group", name="For 3 vehicles")
    several.get_by_label("Missions").select_option(label="side by side")
    several.get_by_label("Spacing").fill("6")
    check = page.get_by_role("region", name="Check of north.waypoints")
    expect(check).to_contain_text("can be flown")
    several.scroll_into_view_if_needed()
    shot(page, f"mission-several-{width}-{theme}")
    fits(page)
    check.get_by_role("button", name="Upload to v1, v2 and v3").click()
    until_true(lambda: station.call("missions.status", targets="v3")[0]["counts"]["mission"] == 4)
    first, third = (station.call("missions.download", target=name)["mission"] for name in ("v1", "v3"))
    assert third[1]["params"][5] > first[1]["params"][5] and third[1]["params"][4] == pytest.approx(
        first[1]["params"][4], abs=2e-7
    ), "to the right of its course, which is north"
    assert not page.errors


def test_one_after_another_shows_whose_turn_it_is_and_can_be_ended(station, open_page, shot) -> None:
    page = open_page(station)
    opened(page, "v1", "v2")
    page.get_by_role("region", name="Check of north.waypoints").get_by_role(
        "button", name="Upload to v1 and v2"
    ).click()
    expect(page.get_by_role("log", name="Orders")).to_contain_text("items taken")
    board = page.get_by_role("region", name="On board")
    hold(page, board.get_by_role("button", name=re.compile("one after another: arms")))
    expect(board.get_by_role("row", name=re.compile("v1"))).to_contain_text("turn 1 of 2")
    expect(board.get_by_role("row", name=re.compile("v2"))).to_contain_text("waits, turn 2 of 2")
    shot(page, "mission-turns-1600-dark")
    board.get_by_role("button", name="End the turns").click()
    expect(board.get_by_role("row", name=re.compile("v2"))).not_to_contain_text("turn")
    expect(board.get_by_role("button", name="End the turns")).to_have_count(0)
    station.call("vehicles.land", targets="v1")
    assert not any(state["armed"] for state in station.call("vehicles.list") if state["name"] == "v2")
    assert not page.errors
