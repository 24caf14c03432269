"""Trouble in a real browser: a pill for each vehicle left of STOP, and the bar of the plan in flight on every page."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path

import pytest
from playwright.sync_api import Page, expect

from support.browser import until
from support.page_steps import IN_TROUBLE, fits
from support.web_station import WebStation

OpenPage = Callable[..., Page]
Shot = Callable[[Page, str], Path]

PLAN = """more => skygcs.store.dispatch({ type: "plan", plan: {
    plan: "1", name: "show", kind: "phased", state: "running", phase: "cross", step: 2, steps: 3, reason: null,
    speed: 1, clock: { trajectory_s: 10, duration_s: 44, finishes_in_s: 34 }, waits_for: [], vehicles: [
        { vehicle: "v1", state: "flying", error_m: 0.2, tube_m: 1, left: null },
        { vehicle: "v2", state: "flying", error_m: 0.61, tube_m: 0.5, left: null }], ...more } })"""


@pytest.fixture(params=["dark", "light"])
def theme(request: pytest.FixtureRequest) -> str:
    return str(request.param)


@pytest.mark.parametrize(("width", "height", "shown"), [(1600, 900, 3), (1280, 800, 3), (390, 844, 1)])
def test_trouble_stands_left_of_stop_worst_first(
    station: WebStation, open_page: OpenPage, shot: Shot, theme: str, width: int, height: int, shown: int
) -> None:
    page = open_page(station, width=width, height=height, theme=theme, touch=width < 500)
    until(page, "skygcs.store.state.vehicles.get('v1')?.position?.enu_m != null")
    expect(page.locator(".troubles")).to_have_count(0)
    page.evaluate(IN_TROUBLE)
    pills = page.locator(".pill[data-severity]:visible")
    expect(pills).to_have_count(shown)
    expect(pills.first).to_have_text(re.compile(r"^! u02 lost at 9\.7 m, \d+ s$"))
    if shown > 1:
        assert [text.split()[1] for text in pills.all_inner_texts()] == ["u02", "u07", "u09"]
    expect(page.locator(".pill.more:visible")).to_have_text(f"+{5 - shown} more")
    stop = page.get_by_role("button", name="Stop all vehicles").bounding_box()
    assert stop is not None and stop["x"] + stop["width"] <= width
    assert fits(page)
    shot(page, f"trouble-{width}-{theme}")


def test_a_pill_selects_its_vehicle_and_shows_it(station: WebStation, open_page: OpenPage) -> None:
    page = open_page(station, path="/#events")
    until(page, "skygcs.store.state.vehicles.get('v1')?.position?.enu_m != null")
    page.evaluate(IN_TROUBLE)
    page.locator(".pill", has_text="u02").click()
    until(page, "[...skygcs.store.state.selection].join() === 'u02' && location.hash === '#fleet'")
    page.locator(".pill.more:visible").click()
    until(page, "skygcs.store.state.selection.size === 5")


@pytest.mark.parametrize(("width", "height"), [(1600, 900), (390, 844)])
def test_rows_in_trouble_stand_first_and_are_marked(
    station: WebStation, open_page: OpenPage, shot: Shot, theme: str, width: int, height: int
) -> None:
    page = open_page(station, width=width, height=height, theme=theme, touch=width < 500)
    until(page, "skygcs.store.state.vehicles.get('v1')?.position?.enu_m != null")
    page.evaluate(IN_TROUBLE)
    rows = page.locator("tr.row")
    expect(rows.first).to_have_attribute("data-name", "u02")
    names = [row.get_attribute("data-name") for row in rows.all()]
    assert names == ["u02", "u07", "u09", "u04", "u11", "v1", "v2", "v3"]
    expect(page.locator("tr.row[data-severity=danger]")).to_have_count(4)
    expect(page.locator("tr.row[data-severity=warning]")).to_have_count(1)
    lost = page.locator("tr.row[data-name=u02]")
    expect(lost.locator("td[data-column=status]")).to_have_class(re.compile("danger"))
    expect(lost.locator("td[data-column=status]")).to_contain_text("lost at 9.7 m")
    expect(lost.locator("td[data-column=height]")).to_have_class(re.compile("lost"))
    expect(page.locator("tr.row[data-name=u07] td[data-column=status]")).to_contain_text("FAILSAFE")
    assert fits(page)
    page.wait_for_timeout(400)  # until the labels of the map are placed
    shot(page, f"severity-{width}-{theme}")
    page.get_by_label("Problems first").uncheck()
    expect(rows.first).to_have_attribute("data-name", "v1")
    page.reload()
    expect(page.get_by_label("Problems first")).not_to_be_checked()


def test_one_that_is_lost_in_the_air_stays_in_the_counts(station: WebStation, open_page: OpenPage) -> None:
    page = open_page(station)
    until(page, "skygcs.store.state.vehicles.get('v1')?.position?.enu_m != null")
    page.evaluate(IN_TROUBLE)
    summary = page.locator(".summary")
    expect(summary).to_contain_text("1 in the air")
    expect(summary).to_contain_text("2 not heard, 1 last in the air")
    body = page.evaluate("() => skygcs.view.scene.bodies.find(({ name }) => name === 'u02')")
    assert body["lostInAir"] and not body["heard"] and body["trouble"]["severity"] == "danger"


@pytest.mark.parametrize(("width", "height"), [(1600, 900), (390, 844)])
def test_the_plan_that_is_flown_is_on_every_page(
    station: WebStation, open_page: OpenPage, shot: Shot, theme: str, width: int, height: int
) -> None:
    page = open_page(station, width=width, height=height, theme=theme, touch=width < 500)
    until(page, "skygcs.store.state.vehicles.size === 3")
    page.evaluate(PLAN, {})
    bar = page.get_by_role("region", name="Plan in flight")
    for tab in ("Events", "Fleet"):
        page.locator(".pages .tab", has_text=tab).click()
        expect(bar).to_contain_text("show running, cross (step 2 of 3), 34 s left")
        expect(bar).to_contain_text("! v2 0.61 m off, 0.50 m allowed")
    assert fits(page)
    shot(page, f"plan-bar-{width}-{theme}")
    bar.get_by_role("button", name="Pause").click()
    until(page, "skygcs.store.state.orders[0]?.method === 'plan.pause'")
    page.evaluate(PLAN, {"state": "stopped", "reason": "v2: left its tube"})
    expect(bar.get_by_role("alert")).to_contain_text("v2: left its tube")
    expect(bar.get_by_role("button", name=re.compile("Resume the plan"))).to_be_visible()
    page.evaluate(PLAN, {"state": "finished"})
    expect(bar).to_have_count(0)


def test_a_press_that_is_too_short_says_what_to_do(station: WebStation, open_page: OpenPage) -> None:
    page = open_page(station)
    until(page, "skygcs.store.state.vehicles.size === 3")
    page.evaluate(PLAN, {"state": "paused"})
    resume = page.get_by_role("region", name="Plan in flight").get_by_role("button", name=re.compile("^Resume"))
    resume.hover()
    page.mouse.down()
    page.mouse.up()
    hint = page.locator(".holdhint")
    expect(hint).to_have_text("Resume the plan of v1 and v2: hold for 1 s")
    expect(hint).to_have_count(0)
    assert page.evaluate("skygcs.store.state.orders.length") == 0
