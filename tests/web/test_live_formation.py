"""A live formation in the browser: started, moved, turned and stopped, and what is said without [formation]."""

from __future__ import annotations

import re

import pytest
from playwright.sync_api import Page, expect

from support.browser import until
from support.page_steps import click_view, fits, hold, select, side


def live(page: Page, **places: bool) -> None:
    side(page, "Plans", **places)
    page.get_by_role("tab", name="Live", exact=True).click()


def test_a_formation_is_started_moved_turned_and_stopped(make_station, open_page, shot) -> None:
    station = make_station(more="[formation]\n[defaults.control]\nfence = { x_m = [-200, 200], y_m = [-200, 200] }\n")
    page = open_page(station)
    until(page, "skygcs.store.state.names.length === 3")
    until(page, "[...skygcs.store.state.vehicles.values()].every(v => v.position?.lat_deg != null)")
    assert all(o["ok"] for o in station.call("vehicles.takeoff", targets="all", height_m=10)["outcomes"].values())
    until(page, "[...skygcs.store.state.vehicles.values()].every(v => v.position?.alt_rel_m > 9)")
    live(page)
    card = page.get_by_role("region", name="Live formation")
    expect(card).to_contain_text("No formation flies.")
    expect(card).to_contain_text("Select the vehicles that are to follow.")
    select(page, "v1", "v2", "v3")
    hold(page, card.get_by_role("button", name=re.compile("Fly v1, v2 and v3 as a formation")))
    expect(card).to_contain_text("settled")
    page.get_by_role("button", name="Fit").click()
    before = card.get_by_label("To x").input_value()
    click_view(page, (0.7, 0.3))
    expect(card.get_by_label("To x")).not_to_have_value(before)
    card.get_by_label("To x").fill("15")
    card.get_by_label("y", exact=True).fill("12")
    hold(page, card.get_by_role("button", name=re.compile("there:")))
    card.get_by_label("Looks to").fill("90")
    hold(page, card.get_by_role("button", name=re.compile("Turn the formation")))
    expect(card).to_contain_text(re.compile("flying"))
    expect(card).to_contain_text("settled")
    status = station.call("formation.status")
    assert status["heading_deg"] == 90.0 and status["middle_enu_m"][:2] == pytest.approx([15.0, 12.0], abs=0.1)
    shot(page, "formation-live")
    # a leader that is a vehicle
    card.get_by_role("button", name=re.compile("^Stop: all")).click()
    expect(card).to_contain_text("stopped")
    select(page, "v1", "v2")
    card.get_by_label("Leader").select_option("v3")
    hold(page, card.get_by_role("button", name=re.compile("Fly v1 and v2 as a formation")))
    expect(card).to_contain_text("behind v3")
    card.get_by_role("button", name=re.compile("^Stop: all")).click()
    expect(card).to_contain_text("stopped")
    assert not page.errors


def test_without_the_table_it_says_what_to_do(station, open_page) -> None:
    page = open_page(station)
    live(page)
    expect(page.locator(".planpanel")).to_contain_text("add a table [formation] to the fleet file")


def test_it_fits_a_phone(make_station, open_page) -> None:
    page = open_page(make_station(more="[formation]\n"), width=390, height=800, touch=True)
    select(page, "v1", "v2")
    live(page, phone=True)
    expect(page.get_by_role("button", name=re.compile("Fly v1 and v2 as a formation"))).to_be_visible()
    assert fits(page)
