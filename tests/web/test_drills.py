"""Faults of simulated vehicles in the browser: begun, seen on every page, and ended."""

from __future__ import annotations

import re

import pytest
from playwright.sync_api import expect

from support.axe import AXE, findings
from support.page_steps import fits, select, side


@pytest.fixture(scope="module")
def drilled(make_station):
    return make_station(more="[drills]")


@pytest.mark.parametrize(("width", "height"), [(1600, 900), (390, 844)])
@pytest.mark.parametrize("theme", ["dark", "light"])
def test_a_fault_is_begun_shown_on_every_page_and_ended(drilled, open_page, shot, width, height, theme) -> None:
    phone = width < 500
    page = open_page(drilled, width=width, height=height, theme=theme)
    select(page, "v2")
    side(page, "Vehicle", phone=phone)
    page.get_by_role("tab", name="Drill").click()
    faults = page.get_by_role("region", name="Faults")
    faults.get_by_role("button", name="Begin GPS lost").click()
    bar = page.get_by_role("region", name="Drill", exact=True)
    expect(bar).to_contain_text(re.compile(r"v2 GPS lost \d+ s"))
    faults.get_by_label("Battery low value").fill("15")
    faults.get_by_role("button", name="Begin battery low").click()
    expect(bar).to_contain_text("battery low, 15 %")
    fits(page)
    page.evaluate(AXE.read_text())
    assert findings(page) == []
    shot(page, f"drill-{width}-{theme}")
    assert {one["fault"] for one in drilled.call("drills.status")["active"]} == {"gps", "battery"}
    page.get_by_role("navigation", name="Pages").get_by_role("button", name="Events").click()
    expect(bar).to_contain_text("v2 GPS lost")
    bar.get_by_role("button", name="End GPS lost of v2").click()
    expect(bar).not_to_contain_text("GPS lost")
    bar.get_by_role("button", name=re.compile("End battery low")).click()
    expect(bar).to_have_count(0)
    assert drilled.call("drills.status")["active"] == []
    assert not page.errors


def test_a_viewer_sees_faults_and_cannot_end_them(drilled, open_page) -> None:
    page = open_page(drilled, role="view")
    drilled.call("drills.begin", targets="v1", fault="deaf")
    bar = page.get_by_role("region", name="Drill", exact=True)
    expect(bar).to_contain_text("v1 deaf")
    expect(bar.get_by_role("button")).to_have_count(0)
    drilled.call("drills.end", targets="all")
    expect(bar).to_have_count(0)


def test_without_the_table_there_is_no_tab(station, open_page) -> None:
    page = open_page(station)
    select(page, "v1")
    side(page, "Vehicle")
    expect(page.get_by_role("tab", name="Radio")).to_be_visible()
    expect(page.get_by_role("tab", name="Drill")).to_have_count(0)
