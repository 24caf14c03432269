"""A phone: 390 px by touch. Table, one vehicle, orders and STOP; targets for a finger; two fingers on the view."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest
from playwright.sync_api import Page, expect

from support.browser import until
from support.web_station import WebStation

Shot = Callable[[Page, str], Path]

LEAST_PX = 44

SMALL = """least => [...document.querySelectorAll('button, select, input, summary, tr.row')]
    .filter(e => e.getClientRects().length && !e.closest('[hidden]'))
    .map(e => [e, (e.closest('label.check') ?? e).getBoundingClientRect()])
    .filter(([, box]) => box.height < least - 0.5 || box.width < least - 0.5)
    .map(([e, box]) => `${e.className || e.tagName} ${e.textContent.slice(0, 20)} ${box.width}x${box.height}`)"""
"""What can be touched and is too small for a finger."""


OVERFLOWING = """[...document.querySelectorAll('body *')]
    .filter(e => e.getClientRects().length && e.clientWidth > 0 && e.scrollWidth > e.clientWidth + 1)
    .filter(e => !['auto', 'scroll', 'hidden'].includes(getComputedStyle(e).overflowX))
    .map(e => `${e.tagName} ${e.className} ${e.textContent.slice(0, 40)}`)"""
"""What runs out of its box, over what is beside it."""


@pytest.fixture
def page(station: WebStation, open_page: Callable[..., Page]) -> Page:
    opened = open_page(station, width=390, height=844, touch=True)
    expect(opened.locator("tr.row[data-heard=true]")).to_have_count(3)
    return opened


def pane(page: Page, name: str) -> None:
    page.locator(".bottom .tab", has_text=name).tap()


def test_table_orders_and_view_fit_and_are_large_enough(page: Page, shot: Shot) -> None:
    for name in ("Table", "View", "Orders"):
        pane(page, name)
        page.wait_for_timeout(300)
        assert page.evaluate("document.documentElement.scrollWidth") <= 390
        assert page.evaluate(SMALL, LEAST_PX) == [], name
        assert page.evaluate(OVERFLOWING) == [], name
        box = page.get_by_role("button", name="Stop all vehicles").bounding_box()
        assert box is not None and box["x"] + box["width"] <= 390 and box["height"] >= LEAST_PX
        shot(page, f"phone-{name.lower()}")
        page.emulate_media(color_scheme="light")
        page.wait_for_timeout(200)
        shot(page, f"phone-{name.lower()}-daylight")
        page.emulate_media(color_scheme="dark")
    assert page.errors == []  # type: ignore[attr-defined]


ALARMS = """for (let i = 0; i < 120; i++) skygcs.store.dispatch({ type: "event", event: {
    time_unix_s: Date.now() / 1000 + i, kind: "failsafe", severity: "alarm", vehicle: "v1",
    text: `${i}`, data: { failsafe: true } } })"""


def test_the_number_of_alarms_is_seen_beside_stop(page: Page, shot: Shot) -> None:
    page.evaluate(ALARMS)
    badge = page.locator(".pages .badge")
    expect(badge).to_have_text("99+")
    room, box = page.locator(".pages").bounding_box(), badge.bounding_box()
    assert room is not None and box is not None and box["x"] + box["width"] <= room["x"] + room["width"]
    shot(page, "phone-alarms")


CLEAR = """() => {
    const { view, store } = skygcs, c = view.camera, canvas = document.querySelector('canvas').getBoundingClientRect();
    const groups = [...document.querySelectorAll('.viewbuttons > .group')].map(g => g.getBoundingClientRect());
    return [...store.state.vehicles.values()].filter(({position}) => {
        const [x, y] = position.enu_m;
        const px = canvas.left + c.widthPx / 2 + (x - c.x) * c.pxPerM;
        const py = canvas.top + c.heightPx / 2 - (y - c.y) * c.pxPerM;
        const out = px < canvas.left + 15 || px > canvas.right - 15 || py > canvas.top + c.heightPx - 15;
        return out || groups.some(b => px > b.left - 15 && px < b.right + 15 && py > b.top - 15 && py < b.bottom + 15);
    }).map(v => v.name);
}"""
"""Vehicles that are not in the view, or beneath its buttons."""


def test_fit_shows_every_vehicle_beside_the_buttons(
    make_station: Callable[..., WebStation], open_page: Callable[..., Page], shot: Shot
) -> None:
    opened = open_page(make_station((30, 20)), width=390, height=844, touch=True)
    until(opened, "skygcs.store.state.names.length === 50")
    until(opened, "[...skygcs.store.state.vehicles.values()].every(v => v.position?.enu_m)")
    pane(opened, "View")
    opened.wait_for_timeout(500)
    assert opened.evaluate(CLEAR) == [], "as it is shown first"
    for _ in range(3):
        opened.get_by_role("button", name="Zoom in").tap()
    assert opened.evaluate(CLEAR) != []
    opened.get_by_role("button", name="Fit").tap()
    opened.wait_for_timeout(300)
    assert opened.evaluate(CLEAR) == []
    shot(opened, "phone-fit-fifty")


def test_no_column_of_the_table_is_cut_off(page: Page) -> None:
    assert page.evaluate("document.querySelector('.tablebox').scrollWidth") <= 390


def test_select_by_touch_hold_an_order_by_touch_and_stop(page: Page, shot: Shot) -> None:
    page.locator("tr.row[data-name=v1]").tap()
    page.locator("tr.row[data-name=v2]").tap()
    pane(page, "Orders")
    expect(page.locator(".targets")).to_contain_text("2 vehicles")
    button = page.locator(".order", has_text="Arm").first.bounding_box()
    assert button is not None
    client = page.context.new_cdp_session(page)
    at = [{"x": button["x"] + button["width"] / 2, "y": button["y"] + button["height"] / 2}]
    client.send("Input.dispatchTouchEvent", {"type": "touchStart", "touchPoints": at})
    expect(page.locator(".holdhint")).to_be_visible()
    shot(page, "phone-order-held")
    page.wait_for_timeout(1_300)
    client.send("Input.dispatchTouchEvent", {"type": "touchEnd", "touchPoints": []})
    expect(page.locator(".toast").first).to_contain_text("Arm")
    page.get_by_role("button", name="Stop all vehicles").tap()
    expect(page.locator(".stopboard")).to_contain_text("STOP")
    until(page, "skygcs.store.state.orders.filter(o => o.method === 'vehicles.stop').length === 1")


def test_two_fingers_zoom_the_view(page: Page) -> None:
    pane(page, "View")
    page.wait_for_timeout(300)
    before = page.evaluate("skygcs.view.camera.pxPerM")
    client = page.context.new_cdp_session(page)

    def touch(kind: str, *xs: float) -> None:
        points = [{"x": x, "y": 400.0, "id": i} for i, x in enumerate(xs)]
        client.send("Input.dispatchTouchEvent", {"type": kind, "touchPoints": points})

    touch("touchStart", 170, 220)
    for step in range(1, 8):
        touch("touchMove", 170 - 10 * step, 220 + 10 * step)
    touch("touchEnd")
    after = page.evaluate("skygcs.view.camera.pxPerM")
    assert after == pytest.approx(before * 190 / 50, rel=0.15)
    assert page.evaluate("window.visualViewport.scale") == 1


def test_the_view_is_fitted_when_it_is_first_opened_though_a_tool_was_taken_before(page: Page) -> None:
    page.evaluate("skygcs.view.setTool({cursor: 'crosshair', hint: 'Click points'})")
    pane(page, "View")
    until(page, "skygcs.view.figures.frames > 3 && skygcs.view.camera.widthPx > 0")
    inside = """() => {
        const { view, store } = skygcs, c = view.camera;
        return [...store.state.vehicles.values()].every(({ position: { enu_m: [x, y] } }) =>
            Math.abs(x - c.x) * c.pxPerM < c.widthPx / 2 && Math.abs(y - c.y) * c.pxPerM < c.heightPx / 2);
    }"""
    until(page, f"({inside})() && skygcs.view.camera.x !== 0")


def test_the_row_of_sub_tabs_shows_the_chosen_one(page: Page) -> None:
    page.evaluate("skygcs.store.dispatch({type: 'select', names: ['v1'], how: 'only'})")
    pane(page, "Vehicle")
    last = page.locator(".subtab").last
    last.evaluate("tab => tab.click()")  # by a screen reader, say: a tap would scroll by itself
    expect(last).to_have_attribute("aria-selected", "true")
    expect(last).to_be_in_viewport(ratio=0.99)
