"""The buttons of the lab's Qt station, in a real browser: places taken over, setpoints, modes, the origin."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from playwright.sync_api import Page, expect

from support.browser import until
from support.page_steps import click_view, fits, hold, select
from support.web_station import WebStation

OpenPage = Callable[..., Page]
Shot = Callable[[Page, str], Path]


@pytest.fixture(scope="module")
def mixed(make_station: Callable[..., WebStation]) -> WebStation:
    return make_station((1, 1))


@pytest.fixture
def page(mixed: WebStation, open_page: OpenPage) -> Page:
    opened = open_page(mixed, height=1300)
    until(opened, "skygcs.store.state.vehicles.size === 2")
    until(opened, "[...skygcs.store.state.vehicles.values()].every(v => v.position?.enu_m != null)")
    return opened


def last_order(page: Page, method: str) -> dict[str, Any]:
    """The newest order of this method, when it has ended."""
    until(page, f"skygcs.store.state.orders.some(o => o.method === '{method}' && o.endedMs !== null)")
    order: dict[str, Any] = page.evaluate(f"() => skygcs.store.state.orders.find(o => o.method === '{method}')")
    return order


def test_where_a_vehicle_is_is_taken_over_into_go_to(page: Page, mixed: WebStation) -> None:
    select(page, "v2")
    section = page.get_by_role("region", name="Go to")
    section.get_by_role("button", name="Present place").click()
    x, y, _ = mixed.call("vehicles.get", target="v2")["position"]["enu_m"]
    assert float(section.get_by_label(re.compile("^x in metres")).input_value()) == pytest.approx(x, abs=0.2)
    assert float(section.get_by_label(re.compile("^y in metres")).input_value()) == pytest.approx(y, abs=0.2)
    section.get_by_role("button", name="Present target").click()  # nothing sends it anywhere: the fields stay
    assert float(section.get_by_label(re.compile("^x in metres")).input_value()) == pytest.approx(x, abs=0.2)


def test_a_mixed_fleet_is_ordered_by_what_a_mode_is_for(page: Page) -> None:
    select(page, "v1", "v2")
    section = page.get_by_role("region", name="Mode", exact=True)
    choice = section.get_by_label("Mode")
    titles = choice.locator("optgroup").first.locator("option").all_text_contents()
    assert titles == ["Hold", "Return", "Land", "Follow setpoints"]
    choice.select_option("Land")
    hold(page, section.get_by_role("button", name=re.compile("^Set")))
    order = last_order(page, "vehicles.land")
    assert order["targets"] == ["v1", "v2"]
    assert set(order["outcomes"]) == {"v1", "v2"}


def test_setpoints_are_engaged_and_ended_for_all_that_are_selected(page: Page, mixed: WebStation, shot: Shot) -> None:
    mixed.call("vehicles.arm", targets="all", wait_s=60)
    mixed.call("vehicles.takeoff", targets="all", height_m=5, wait_s=60)
    until(page, "[...skygcs.store.state.vehicles.values()].every(v => (v.position?.alt_rel_m ?? 0) > 4.5)")
    select(page, "v1", "v2")
    section = page.get_by_role("region", name="Setpoints")
    hold(page, section.get_by_role("button", name=re.compile("^Position")))
    until(page, "[...skygcs.store.state.vehicles.values()].every(v => v.control?.state === 'flying')")
    places = page.get_by_role("region", name="Go to")
    select(page, "v1")
    places.get_by_role("button", name="Present target").click()
    target = mixed.call("vehicles.get", target="v1")["control"]["reference"]["pos_enu_m"]
    assert float(places.get_by_label(re.compile("^x in metres")).input_value()) == pytest.approx(target[0], abs=0.2)
    shot(page, "seed-buttons")
    select(page, "v1", "v2")
    section.get_by_role("button", name="Off").click()
    until(page, "[...skygcs.store.state.vehicles.values()].every(v => (v.control?.state ?? 'off') === 'off')")
    mixed.call("vehicles.land", targets="all")


@pytest.mark.parametrize("theme", ["dark", "light"])
def test_the_origin_is_typed_clicked_and_taken_from_a_vehicle(
    mixed: WebStation, open_page: OpenPage, shot: Shot, theme: str
) -> None:
    page = open_page(mixed, height=1300, theme=theme)
    until(page, "[...skygcs.store.state.vehicles.values()].every(v => v.position?.enu_m != null)")
    origin = page.locator("details.origin")
    origin.locator("summary").click()
    before = mixed.call("origin.get")["origin"]
    origin.get_by_label("Latitude").fill(str(before["lat_deg"] + 0.0001))
    origin.get_by_label("Height").fill("181.5")
    hold(page, origin.get_by_role("button", name=re.compile("^Set the origin")))
    last_order(page, "origin.set")
    now = mixed.call("origin.get")["origin"]
    assert now["lat_deg"] == pytest.approx(before["lat_deg"] + 0.0001, abs=1e-6)
    assert now["alt_amsl_m"] == pytest.approx(181.5)
    shot(page, f"origin-{theme}")
    # clicked: only the fields change
    origin.get_by_role("button", name="Choose in the view").click()
    click_view(page, (0.3, 0.3))
    assert float(origin.get_by_label("Latitude").input_value()) != pytest.approx(now["lat_deg"], abs=1e-7)
    assert mixed.call("origin.get")["origin"]["lat_deg"] == pytest.approx(now["lat_deg"], abs=1e-9)
    # a field that is no number: it cannot be set
    origin.get_by_label("Latitude").fill("91")
    expect(origin.get_by_role("button", name=re.compile("^Set the origin"))).to_be_disabled()
    # from a vehicle
    select(page, "v1", "v2")
    expect(origin.get_by_role("button", name=re.compile("^Where one vehicle is"))).to_be_disabled()
    select(page, "v1")
    hold(page, origin.get_by_role("button", name=re.compile("^Where v1 is")))
    last_order(page, "origin.from_vehicle")
    until(page, "Math.hypot(...(skygcs.store.state.vehicles.get('v1').position.enu_m).slice(0, 2)) < 1")
    assert fits(page)
