"""The panel of one vehicle, the radio page: against a real daemon with simulated vehicles behind an emulated radio."""

from __future__ import annotations

import re
from collections.abc import Callable

import pytest
from playwright.sync_api import Locator, Page, expect

from support.page_steps import fits, hold, select, side
from support.web_station import WebStation

RADIO = """[links.radio]
type = "simulated"
role = "radio"
px4 = 2
ardupilot = 1
first_sysid = 1
dynamics = "kinematic"
radio = { air_kbps = 64 }
"""


@pytest.fixture(scope="module")
def station(make_station: Callable[..., WebStation]) -> WebStation:
    return make_station((2, 1), links=RADIO)


def vehicle_panel(page: Page, name: str, tab: str) -> Locator:
    """Select the vehicle and open a part of its panel."""
    select(page, name)
    side(page, "Vehicle")
    page.get_by_role("tablist", name="Parts of the vehicle").get_by_role("tab", name=tab, exact=True).click()
    return page.locator(".vehiclepanel")


def names(station: WebStation) -> list[str]:
    return [state["name"] for state in station.call("vehicles.list")]


def test_every_group_of_the_state_is_there_with_its_age(station, open_page, shot) -> None:
    name = names(station)[0]
    page = open_page(station)
    panel = vehicle_panel(page, name, "State")
    expect(panel.get_by_role("heading", name=name, exact=True)).to_be_visible()
    expect(panel.locator("summary", has_text=re.compile("battery"))).to_contain_text(re.compile(r"\d s"))
    expect(panel).to_contain_text("voltage")
    shot(page, "vehicle-state")
    assert not page.errors


def test_messages_have_rates_and_one_of_them_its_fields(station, open_page, shot) -> None:
    page = open_page(station)
    panel = vehicle_panel(page, names(station)[0], "Messages")
    panel.get_by_label("Search messages").fill("attitude")
    panel.get_by_role("button", name="ATTITUDE", exact=True).click()
    expect(panel.locator("section.card")).to_contain_text("rollspeed")
    shot(page, "vehicle-messages")
    assert not page.errors


def test_preflight_names_what_is_wrong_and_sets_only_what_was_chosen(station, open_page, shot) -> None:
    page = open_page(station)
    panel = vehicle_panel(page, names(station)[0], "Preflight")
    panel.get_by_role("button", name="Examine").click()
    expect(panel.locator(".findings li").first).to_be_visible(timeout=60_000)
    shot(page, "vehicle-preflight")
    assert not page.errors


def test_parameters_are_searched_edited_set_and_compared_with_a_file(station, open_page, shot, tmp_path) -> None:
    name = names(station)[0]
    page = open_page(station)
    panel = vehicle_panel(page, name, "Parameters")
    panel.get_by_role("button", name="Read all").click()
    # a list is on its way: the rest of the page works
    page.get_by_role("tab", name="Messages", exact=True).click()
    expect(panel.get_by_role("button", name="ATTITUDE", exact=True)).to_be_visible()
    page.get_by_role("tab", name="Parameters", exact=True).click()
    expect(panel.get_by_role("button", name="Read again")).to_be_enabled(timeout=90_000)
    panel.get_by_label("Search parameters").fill("MPC_XY_*")
    rows = panel.locator("table.params tbody tr")
    expect(rows.first).to_contain_text("MPC_XY_")
    field = rows.first.locator("input")
    parameter = rows.first.locator("code").inner_text()
    before = float(field.input_value())
    field.fill("abc")
    field.press("Enter")
    expect(rows.first).to_contain_text("is not a number")
    field.fill(str(before + 0.5))
    field.press("Enter")
    waiting = panel.get_by_role("region", name="Changes that wait")
    expect(waiting).to_contain_text(parameter)
    shot(page, "vehicle-params")
    hold(page, waiting.get_by_role("button", name=re.compile("hold down")))
    expect(waiting).to_have_count(0)
    answer = station.call("params.get", targets=name, names=[parameter])["outcomes"][name][parameter]
    assert answer["value"] == pytest.approx(before + 0.5)
    # a file that differs in it
    file = tmp_path / "wanted.param"
    file.write_text(f"{parameter},{before}\nNO_SUCH_PARAM,1\n")
    panel.locator("input[type=file]").set_input_files(file)
    difference = panel.get_by_role("region", name="Compared with wanted.param")
    expect(difference).to_contain_text("1 of 2 differ")
    expect(difference).to_contain_text("NO_SUCH_PARAM")
    shot(page, "vehicle-params-diff")
    difference.get_by_role("button", name="Take over 1 value").click()
    expect(waiting).to_contain_text(parameter)
    waiting.get_by_role("button", name="Discard").click()
    assert not page.errors


def test_control_shows_who_flies_it_the_error_and_the_gains(station, open_page, shot) -> None:
    name = names(station)[1]
    station.call("vehicles.takeoff", targets=name, height_m=8.0, wait_s=30.0)
    try:
        page = open_page(station)
        panel = vehicle_panel(page, name, "Control")
        expect(panel).to_contain_text("Its autopilot flies it")
        hold(page, panel.get_by_role("button", name=re.compile("by position setpoints")))
        expect(panel).to_contain_text("Setpoints: flying")
        expect(panel.get_by_role("region", name="Gains")).to_contain_text("speed P")
        expect(panel.locator(".plot canvas")).to_be_visible()
        page.wait_for_timeout(3000)
        shot(page, "vehicle-control")
        panel.get_by_role("button", name="Off", exact=True).click()
        expect(panel).to_contain_text("Its autopilot flies it")
        assert not page.errors
    finally:
        station.call("vehicles.land", targets=name)


def test_histories_are_drawn_from_the_pages_first_second(station, open_page, shot) -> None:
    page = open_page(station)
    page.wait_for_timeout(7000)
    panel = vehicle_panel(page, names(station)[1], "History")
    expect(panel.locator(".plot canvas")).to_have_count(7)
    assert drawn_pixels(panel.locator(".plot canvas").last) > 20  # satellites: never 0
    shot(page, "vehicle-history")
    assert not page.errors


def drawn_pixels(canvas: Locator) -> int:
    """Pixels of a coloured curve: neither the grid nor letters."""
    return int(
        canvas.evaluate(
            """canvas => {
              const context = canvas.getContext("2d"), {width, height} = canvas;
              const data = context.getImageData(60, 0, width - 60, height - 30).data;
              let count = 0;
              for (let i = 0; i < data.length; i += 4)
                if (data[i + 3] > 150 && Math.abs(data[i] - data[i + 2]) > 60) count++;
              return count;
            }"""
        )
    )


def test_corrections_have_a_card_while_some_come(station, open_page, shot) -> None:
    page = open_page(station, path="/#radio")
    expect(page.locator(".radiopanel table").first).to_be_visible()
    card = page.get_by_role("region", name="Corrections")
    expect(card).to_have_count(0)
    station.call("corrections.send", data="AAAA", source="a base")
    expect(card).to_contain_text("a base, nothing came yet")
    expect(card).to_contain_text("Vehicles: 0 fixed, 0 float, 3 neither")
    shot(page, "corrections")
    assert not page.errors


@pytest.mark.parametrize("width", [1600, 390])
@pytest.mark.parametrize("theme", ["dark", "light"])
def test_the_radio_page_shows_airtime_classes_and_reports(station, open_page, shot, width, theme) -> None:
    page = open_page(station, width=width, theme=theme, path="/#radio")
    radio = page.get_by_role("region", name="Radio radio")
    expect(radio).to_contain_text("B/s")
    expect(radio.get_by_role("table").filter(has_text="Sent up, by class")).to_contain_text("heartbeat")
    for name in names(station):
        expect(radio.get_by_role("table").filter(has_text="a timeslot carries")).to_contain_text(name)
    page.wait_for_timeout(4000)
    expect(radio.locator(".plot canvas").first).to_be_visible()
    shot(page, f"radio-{theme}-{width}")
    assert not page.errors


@pytest.mark.parametrize("theme", ["dark", "light"])
def test_one_vehicle_fits_a_phone(station, open_page, shot, theme) -> None:
    page = open_page(station, width=390, height=800, theme=theme, touch=True)
    select(page, names(station)[0])
    side(page, "Vehicle", phone=True)
    expect(page.locator(".vehiclepanel h2")).to_be_visible()
    expect(page.locator(".vehiclepanel")).to_contain_text("voltage")
    assert fits(page)
    shot(page, f"vehicle-phone-{theme}")
    page.get_by_role("tab", name="History", exact=True).click()
    expect(page.locator(".vehiclepanel .plot canvas").first).to_be_visible()
    assert fits(page)
    shot(page, f"vehicle-phone-history-{theme}")
    assert not page.errors
