"""A recording in the browser: the same views, clearly marked, scrubbed and played; no order is possible."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path

import pytest
from playwright.sync_api import Page, expect

from support.browser import until
from support.page_steps import fits, select, side
from support.web_station import WebStation

CAPTURE = Path(__file__).parents[1] / "data" / "sitl-3ardupilot-2px4.tlog"


@pytest.fixture(scope="module")
def station(make_station: Callable[..., WebStation]) -> WebStation:
    return make_station(None, web=("--replay", str(CAPTURE)))


PLACE = "document.querySelector('.replay input[type=range]').valueAsNumber"


def scrub(page: Page, position_s: float) -> None:
    """Drag the bar to a place."""
    page.get_by_label("Place in the recording").evaluate(
        f"bar => {{ bar.value = {position_s}; for (const type of ['input', 'change'])"
        " bar.dispatchEvent(new Event(type, {bubbles: true})); }"
    )


def place_s(page: Page) -> float:
    return float(page.get_by_label("Place in the recording").input_value())


def test_a_recording_is_marked_played_and_scrubbed(station, open_page, shot) -> None:
    page = open_page(station)
    bar = page.get_by_role("group", name="Replay")
    expect(bar).to_contain_text("sitl-3ardupilot-2px4.tlog")
    until(page, "document.querySelector('.replay input[type=range]').max > 5")
    duration = float(page.get_by_label("Place in the recording").get_attribute("max") or 0)
    scrub(page, duration / 2)
    until(page, f"Math.abs({PLACE} - {duration / 2}) < {duration / 8}")
    until(page, "skygcs.store.state.vehicles.size > 0")
    bar.get_by_label("Speed").select_option("5")
    before = place_s(page)
    button = bar.get_by_role("button", name=re.compile("^(Play|Pause)$"))
    if button.inner_text() != "Pause":
        button.click()
    until(
        page,
        f"document.querySelector('.replay input[type=range]').valueAsNumber > {before} + 1 ||"
        " document.querySelector('.replay').textContent.includes('Play again')",
    )
    shot(page, "replay")
    assert not page.errors


def test_no_order_is_possible_in_a_recording(station, open_page) -> None:
    page = open_page(station)
    expect(page.get_by_role("group", name="Replay")).to_contain_text("sitl")
    scrub(page, 5.0)
    until(page, "skygcs.store.state.vehicles.size > 0")
    expect(page.get_by_role("button", name="Stop all vehicles")).to_have_count(0)
    for title in ("Missions", "Plans"):
        expect(page.get_by_role("tab", name=title, exact=True)).to_have_count(0)
    name = page.evaluate("skygcs.store.state.names[0]")
    select(page, name)
    side(page, "Vehicle")
    page.get_by_role("tab", name="Control", exact=True).click()
    expect(page.locator(".vehiclepanel button.hold")).to_have_count(0)
    refused = page.evaluate(
        "skygcs.connection.order('vehicles.arm', {targets: 'all'}).then(() => null, error => error.message)"
    )
    assert refused is not None and "replay" in refused


@pytest.mark.parametrize("theme", ["dark", "light"])
def test_a_recording_fits_a_phone(station, open_page, shot, theme) -> None:
    page = open_page(station, width=390, height=800, theme=theme, touch=True)
    expect(page.get_by_role("group", name="Replay")).to_be_visible()
    scrub(page, 5.0)
    until(page, "skygcs.store.state.vehicles.size > 0")
    assert fits(page)
    shot(page, f"replay-phone-{theme}")
