"""The fleet table in a real browser: columns, sorting, filter, groups, selection, and values that are old."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest
from playwright.sync_api import Page, expect

from support.browser import until
from support.web_station import WebStation

OpenPage = Callable[..., Page]
Shot = Callable[[Page, str], Path]

COLUMNS = ["Name", "Id", "Autopilot", "Mode", "Status", "Armed", "Height", "Battery", "GPS", "Link", "Heard", "Loss"]

GROUPS = """
[vehicles.alpha]
sysid = 1
group = "scouts"

[vehicles.bravo]
sysid = 2

[vehicles.charlie]
sysid = 3
group = "scouts"
"""


@pytest.fixture(scope="module")
def fleet(make_station: Callable[..., WebStation]) -> WebStation:
    return make_station((2, 1), more=GROUPS)


@pytest.fixture
def page(fleet: WebStation, open_page: OpenPage) -> Page:
    opened = open_page(fleet)
    expect(opened.locator("tr.row")).to_have_count(3)
    return opened


def names(page: Page) -> list[str]:
    return page.locator("tr.row td[data-column=name]").all_text_contents()


def test_every_column_has_its_value_in_the_units_of_people(page: Page, shot: Shot) -> None:
    headings = [text.strip("▴▾") for text in page.locator("thead th").all_text_contents()]
    assert headings == COLUMNS
    row = page.locator("tr.row[data-name=charlie]")
    expect(row.locator("[data-column=gps]")).to_contain_text("sat")
    expect(row.locator("[data-column=battery]")).to_contain_text("%")
    expect(row.locator("[data-column=autopilot]")).to_contain_text("ArduPilot")
    expect(row.locator("[data-column=height]")).to_contain_text("0.0 m")
    expect(row.locator("[data-column=age]")).to_contain_text(" s")
    shot(page, "table")
    assert page.errors == []  # type: ignore[attr-defined]


def test_companions_have_a_column_where_a_vehicle_has_one(
    make_station: Callable[..., WebStation], open_page: OpenPage, shot: Shot
) -> None:
    computers = '[companions.pi]\nhost = "192.0.2.7"\nvehicle = "alpha"\n'
    page = open_page(make_station((2, 1), more=GROUPS + computers))
    expect(page.locator("th[data-column=companion]")).to_be_visible()
    expect(page.locator("tr.row[data-name=alpha] td[data-column=companion]")).to_have_text("not heard")
    expect(page.locator("tr.row[data-name=bravo] td[data-column=companion]")).to_have_text("–")
    assert page.evaluate("(t => t.scrollWidth - t.clientWidth)(document.querySelector('.tablebox'))") <= 0
    shot(page, "table-companion")


def test_columns_are_chosen_and_the_choice_is_kept(page: Page, shot: Shot) -> None:
    page.get_by_text("Columns", exact=True).click()
    choices = page.get_by_role("group", name="Columns of the table")
    for name in ("x", "Roll pitch yaw", "Target", "Error"):
        choices.get_by_label(name, exact=True).check()
    choices.get_by_label("GPS").uncheck()
    shot(page, "table-columns")
    page.keyboard.press("Escape")
    expect(choices).to_have_count(0)
    wanted = [*(name for name in COLUMNS if name != "GPS"), "x", "Roll pitch yaw", "Target", "Error"]
    page.reload()
    expect(page.locator("tr.row")).to_have_count(3)
    assert [text.strip("▴▾") for text in page.locator("thead th").all_text_contents()] == wanted
    expect(page.locator("tr.row[data-name=alpha] td[data-column=attitude]")).to_contain_text("°")
    page.get_by_text("Columns", exact=True).click()
    page.get_by_role("button", name="As at first").click()
    assert [text.strip("▴▾") for text in page.locator("thead th").all_text_contents()] == COLUMNS


def test_a_click_on_a_heading_sorts_and_a_second_one_turns_it_round(page: Page) -> None:
    page.get_by_role("button", name="Name").click()
    assert names(page) == ["alpha", "bravo", "charlie"]
    page.get_by_role("button", name="Name").click()
    expect(page.locator("th[data-column=name]")).to_have_attribute("aria-sort", "descending")
    assert names(page) == ["charlie", "bravo", "alpha"]


def test_the_filter_is_reached_by_slash_and_takes_several_words(page: Page) -> None:
    page.keyboard.press("/")
    page.keyboard.type("scouts px4")
    expect(page.locator("tr.row")).to_have_count(1)
    assert names(page) == ["alpha"]
    page.get_by_role("searchbox").fill("no such thing")
    expect(page.get_by_text("No vehicle matches the filter.")).to_be_visible()


def test_groups_have_headings_that_select_them(page: Page) -> None:
    page.get_by_label("Group by").select_option("group")
    expect(page.locator("tr.grouprow")).to_have_count(2)
    page.locator("tr.grouprow", has_text="scouts").get_by_role("button").click()
    until(page, "[...skygcs.store.state.selection].sort().join() === 'alpha,charlie'")
    page.get_by_role("button", name="scouts", exact=True).click()  # of the orders' targets
    expect(page.locator("tr.row[aria-selected=true]")).to_have_count(2)


def test_selection_by_keyboard(page: Page) -> None:
    page.locator(".tablebox").focus()
    page.keyboard.press("ArrowDown")
    page.keyboard.press("Shift+ArrowDown")
    expect(page.locator("tr.row[aria-selected=true]")).to_have_count(2)
    page.keyboard.press("Space")
    expect(page.locator("tr.row[aria-selected=true]")).to_have_count(1)
    page.keyboard.press("Control+a")
    expect(page.locator("tr.row[aria-selected=true]")).to_have_count(3)


def test_fifty_vehicles_only_the_rows_that_are_seen_exist(
    make_station: Callable[..., WebStation], open_page: OpenPage, shot: Shot
) -> None:
    page = open_page(make_station((30, 20)))
    until(page, "skygcs.store.state.names.length === 50")
    until(page, "[...skygcs.store.state.vehicles.values()].every(v => v.position?.lat_deg != null)")
    assert page.locator("tr.row").count() < 40
    page.locator(".tablebox").focus()
    page.keyboard.press("End")
    expect(page.locator("tr.row[data-name=v50]")).to_be_visible()
    page.wait_for_timeout(500)
    shot(page, "fifty-vehicles")
    page.emulate_media(color_scheme="light")
    page.wait_for_timeout(300)
    shot(page, "fifty-vehicles-daylight")


def test_what_is_not_heard_is_grey_with_its_age_and_comes_back_anew(
    make_station: Callable[..., WebStation], open_page: OpenPage, shot: Shot
) -> None:
    """The web process dies while vehicles are shown: nothing may stay that looks like a good value."""
    station = make_station((2, 0))
    page = open_page(station)
    expect(page.locator("tr.row[data-heard=true]")).to_have_count(2)
    station.stop_web()
    expect(page.locator(".banner.danger")).to_contain_text("Not connected.")
    expect(page.locator("tr.row[data-heard=false]")).to_have_count(2)
    for column in ("mode", "height", "battery", "gps", "link"):
        expect(page.locator(f"tr.row[data-name=v1] td[data-column={column}]")).to_have_class("num lost") if column in (
            "height",
            "battery",
        ) else expect(page.locator(f"tr.row[data-name=v1] td[data-column={column}]")).to_have_class("lost")
    first = page.locator("tr.row[data-name=v1] td[data-column=age]").text_content()
    page.wait_for_timeout(2500)
    assert page.locator("tr.row[data-name=v1] td[data-column=age]").text_content() != first
    shot(page, "table-not-connected")
    station.start_web()
    page.context.clear_cookies()
    page.goto(station.address())  # a new process knows no old cookie
    expect(page.locator("tr.row[data-heard=true]")).to_have_count(2)
    expect(page.locator(".banner")).to_have_count(0)
