"""Four sites of 250 vehicles on one page: what it shows, what it asks for, and who gets its orders."""

from __future__ import annotations

import json
import os
import signal
import socket
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from playwright.sync_api import Page, expect

from support.browser import until
from support.hanging import HANG_S
from support.process import ROOT, wait_until
from support.web_station import WebStation

OpenPage = Callable[..., Page]
Shot = Callable[[Page, str], Path]


@pytest.fixture(scope="module")
def many(tmp_path_factory: pytest.TempPathFactory) -> Iterator[WebStation]:
    folder = tmp_path_factory.mktemp("sites")
    path = folder / "gcs.sock"
    environment = os.environ | {"PYTHONPATH": str(ROOT / "tests")}
    process = subprocess.Popen([sys.executable, "-m", "support.many_sites", str(path)], env=environment)
    station = WebStation(folder, None)
    try:
        wait_until(lambda: _connects(path), "the socket of the sites")
        yield station.start()
    finally:
        station.close()
        process.send_signal(signal.SIGTERM)
        process.wait(timeout=HANG_S)


def _connects(path: Path) -> bool:
    with socket.socket(socket.AF_UNIX) as probe:
        return probe.connect_ex(str(path)) == 0


def orders(station: WebStation) -> list[dict[str, Any]]:
    path = station.folder / "gcs.orders"
    return [json.loads(line) for line in path.read_text().splitlines()] if path.exists() else []


@pytest.fixture
def page(many: WebStation, open_page: OpenPage) -> Page:
    opened = open_page(many)
    until(opened, "skygcs.store.state.names.length === 1000 && skygcs.store.state.counts !== null")
    return opened


FULL = "[...skygcs.store.state.vehicles.values()].filter((v) => v.brief !== true).map((v) => v.name)"


def test_a_thousand_vehicles_are_four_rows_with_counts_and_dots(page: Page, shot: Shot) -> None:
    expect(page.locator("tr.siterow")).to_have_count(4)
    expect(page.locator("tr.row")).to_have_count(0)
    south = page.locator("tr.siterow[data-site=south]")
    expect(south).to_contain_text("250 heard, 200 armed, 200 in the air, oldest 0.")
    expect(south).to_contain_text("1 problem")
    expect(page.locator(".summary")).to_contain_text("1000 vehicles")
    until(page, f"{FULL}.length <= 1")  # nothing is unfolded, nothing is near: nothing is asked for
    until(page, "skygcs.view.figures.frames > 5 && skygcs.view.figures.faults === 0")
    page.wait_for_timeout(1500)
    shot(page, "sites-folded")
    page.emulate_media(color_scheme="light")
    page.wait_for_timeout(300)
    shot(page, "sites-folded-daylight")
    assert page.errors == []  # type: ignore[attr-defined]


def test_an_unfolded_site_has_its_vehicles_in_full_and_a_folded_one_no_more(page: Page, shot: Shot) -> None:
    page.locator("tr.siterow[data-site=south] button").first.click()
    row = page.locator("tr.row[data-name='south/v1']")
    expect(row.locator("[data-column=mode]")).to_have_text("GUIDED")
    expect(row).to_have_attribute("data-heard", "true")
    until(page, f"{FULL}.filter((name) => name.startsWith('south/')).length === 250")
    shot(page, "sites-unfolded")
    page.locator("tr.siterow[data-site=south] button").first.click()
    expect(page.locator("tr.row")).to_have_count(0)
    until(page, f"{FULL}.length <= 1")


def test_a_filter_finds_vehicles_of_all_sites(page: Page, shot: Shot) -> None:
    page.get_by_role("searchbox").fill("scouts armed px4")
    expect(
        page.get_by_text("No vehicle matches the filter.")
    ).to_be_visible()  # scouts are ArduPilot's, or on the ground
    page.get_by_role("searchbox").fill("v4 failsafe")
    expect(page.locator("tr.row")).to_have_count(4)
    shot(page, "sites-filter")
    page.get_by_role("searchbox").fill("")
    page.locator("tr.siterow[data-site=west] .problems").click()
    expect(page.locator("tr.row")).to_have_count(1)
    expect(page.locator("tr.row[data-name='west/v4']")).to_be_visible()
    page.get_by_role("searchbox").fill("")


def test_near_enough_the_view_has_arrows_and_names_again(page: Page, shot: Shot) -> None:
    page.evaluate("skygcs.view.pan(0, 0)")  # a person moves it: it is not fitted any more
    page.evaluate("skygcs.view.camera = {...skygcs.view.camera, x: 460, y: 60, pxPerM: 6}; skygcs.view.zoom(1)")
    until(page, f"skygcs.store.near.length > 0 && {FULL}.length > 1")
    page.wait_for_timeout(1000)
    shot(page, "sites-near")
    page.evaluate("skygcs.view.fit('all')")


def test_what_is_held_down_names_site_and_vehicle_and_goes_to_them_alone(many: WebStation, page: Page) -> None:
    page.get_by_role("searchbox").fill("south/v9")
    page.locator("tr.row[data-name='south/v9']").click()
    button = page.get_by_role("button", name="Land south/v9: hold down for a second")
    expect(button).to_be_visible()
    page.keyboard.down("l")
    until(page, "skygcs.store.state.orders.some((order) => order.state === 'done')")
    page.keyboard.up("l")
    assert orders(many)[-1] == {"method": "vehicles.land", "targets": ["south/v9"]}
    page.get_by_role("searchbox").fill("")
    page.locator("tr.siterow[data-site=east]").get_by_role("button", name="Select").click()
    expect(page.get_by_role("button", name="Land 250 of east: hold down for a second")).to_be_visible()


def test_stop_reaches_our_vehicles_by_an_order_of_their_own(many: WebStation, page: Page) -> None:
    before = len(orders(many))
    page.get_by_role("button", name="Stop all vehicles").click()
    until(page, "skygcs.store.state.orders.filter((order) => order.state === 'done').length === 2")
    sent = [order["targets"] for order in orders(many)[before:]]
    assert sorted(sent) == ["*/all", "all"]


def test_an_outcome_that_is_not_known_is_asked_for_by_keyboard_until_it_is(
    many: WebStation, page: Page, shot: Shot
) -> None:
    page.get_by_role("searchbox").fill("south/v13")
    page.locator("tr.row[data-name='south/v13']").click()
    page.keyboard.press("h")
    card = page.locator(".toast", has_text="south/v13")
    expect(card.locator(".outcome")).to_contain_text("outcome unknown: no reply came")
    expect(card.get_by_role("img", name="not known")).to_be_visible()
    expect(card).not_to_contain_text("skygcs-cli")
    shot(page, "sites-outcome-unknown")
    ask = card.get_by_role("button", name="Ask for the outcome: Hold, south/v13")
    before = len(orders(many))
    ask.focus()
    page.keyboard.press("Enter")
    expect(card.locator(".outcome")).to_contain_text("still being carried out")
    expect(ask).to_be_focused()
    page.keyboard.press("Enter")
    until(page, "skygcs.store.state.orders[0].state === 'done'")
    expect(ask).to_have_count(0)
    asked = orders(many)[before:]
    assert [order["method"] for order in asked] == 2 * ["federation.outcome"], "nothing is ordered by it"
    assert len({order["id"] for order in asked}) == 1 and asked[0]["id"].startswith("south/")
    assert page.errors == []  # type: ignore[attr-defined]
    page.get_by_role("searchbox").fill("")
