"""Orders in a real browser: held for a second, by name, in the daemon's words; STOP, keys, roles, lost connections."""

from __future__ import annotations

import json
import signal
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from playwright.sync_api import Locator, Page, expect

from support.browser import until
from support.hanging import HANG_S
from support.page_steps import VIEW, VIEW_PEN, hold, until_acted
from support.web_station import WebStation

OpenPage = Callable[..., Page]
Shot = Callable[[Page, str], Path]

HOLD_MS = 1_000

ASKED_ALONE = ("trajectory.paths",)
"""What a page reads by itself every two seconds."""


@pytest.fixture
def page(station: WebStation, open_page: OpenPage) -> Page:
    """A page that keeps what it sends, as ``page.sent``."""
    opened = open_page(station)
    keep_sent(opened)
    opened.reload()
    expect(opened.locator("tr.row[data-heard=true]")).to_have_count(3)
    return opened


def keep_sent(page: Page) -> None:
    page.sent = []  # type: ignore[attr-defined]
    page.on(
        "websocket",
        lambda ws: ws.on("framesent", lambda text: page.sent.append(json.loads(text))),  # type: ignore[attr-defined]
    )


def sent(page: Page, method: str) -> list[dict[str, Any]]:
    return [message for message in page.sent if message.get("method") == method]  # type: ignore[attr-defined]


def select(page: Page, *names: str) -> None:
    page.keyboard.press("Escape")
    for name in names:
        page.locator(f"tr.row[data-name={name}]").click(modifiers=["Control"])
    expect(page.locator("tr.row[aria-selected=true]")).to_have_count(len(names))


def order(page: Page, text: str) -> Locator:
    return page.locator(".order", has_text=text).first


def the_one_sent(page: Page, method: str) -> dict[str, Any]:
    """A message that the page sends now."""
    deadline = time.monotonic() + HANG_S
    while not sent(page, method):
        assert time.monotonic() < deadline, f"never sent: {method}"
        page.wait_for_timeout(50)
    [message] = sent(page, method)
    return message


def press_shortly(page: Page, button: Locator) -> None:
    button.hover()
    page.mouse.down()
    page.mouse.up()


def test_an_order_is_sent_after_a_second_and_not_before(station: WebStation, page: Page, shot: Shot) -> None:
    select(page, "v1", "v2")
    press_shortly(page, order(page, "Arm"))
    page.wait_for_timeout(HOLD_MS)
    assert sent(page, "vehicles.arm") == []
    order(page, "Arm").hover()
    with until_acted(page, order(page, "Arm")):
        page.mouse.down()
        expect(page.locator(".holdhint")).to_have_text("Arm v1 and v2: keep holding")
        shot(page, "order-held")
    page.mouse.up()
    message = the_one_sent(page, "vehicles.arm")
    assert message["params"]["targets"] == ["v1", "v2"]
    assert isinstance(message["deadline_s"], float)
    expect(page.locator(".toast").first).to_contain_text("v1")
    station.call("vehicles.disarm", targets="all")


def test_take_off_go_to_by_a_click_hold_and_return_with_the_daemons_words(
    station: WebStation, page: Page, shot: Shot
) -> None:
    select(page, "v1")
    page.get_by_label("Height of the take-off in metres").fill("7")
    station.call("vehicles.arm", targets="v1", wait_s=60)
    hold(page, order(page, "Take off"))
    toast = page.locator(".toast").first
    expect(toast).to_have_attribute("data-state", "done")
    expect(toast).to_contain_text("taking off to 7 m")
    until(page, "skygcs.store.state.vehicles.get('v1').position.alt_rel_m > 6")
    page.keyboard.press("g")
    expect(page.locator(".toolhint")).to_be_visible()
    box = page.locator(VIEW).bounding_box()
    assert box is not None
    page.mouse.click(box["x"] + 500, box["y"] + 150)
    x, y = (float(page.get_by_label(f"{axis} in metres from the origin").input_value()) for axis in "xy")
    there = page.evaluate("(({x, y}) => [x, y])(skygcs.view.pointerAt(500, 150, false))")
    assert [x, y] == pytest.approx(there, abs=0.06), "the fields have the place that was clicked"
    page.wait_for_timeout(200)
    assert marks(page, 500, 150) > 20, "and it is marked"
    assert marks(page, 700, 250) == 0
    shot(page, "order-go-to")
    hold(page, order(page, "Send there"))
    message = the_one_sent(page, "vehicles.goto")
    assert set(message["params"]) == {"targets", "lat_deg", "lon_deg", "height_m"}
    until(page, f"(([x, y]) => Math.hypot(x - {x}, y - {y}) < 2)(skygcs.store.state.vehicles.get('v1').position.enu_m)")
    page.keyboard.down("r")  # a Mac sends no keyup of it while Cmd is down
    page.keyboard.down("Meta")
    page.wait_for_timeout(1_500)
    assert sent(page, "vehicles.rtl") == []
    page.keyboard.up("r")
    page.keyboard.up("Meta")
    page.keyboard.press("h")
    expect(page.locator(".toast").first).to_contain_text("Hold")
    assert len(sent(page, "vehicles.hold")) == 1
    with until_acted(page, order(page, "Return")):
        page.keyboard.down("r")
    page.keyboard.up("r")
    the_one_sent(page, "vehicles.rtl")


MARKED = (
    f"([x, y]) => {{ const pen = {VIEW_PEN};"
    + """
    const canvas = document.querySelector('canvas'), k = canvas.width / canvas.getBoundingClientRect().width;
    const probe = document.body.appendChild(document.createElement('i'));
    probe.style.color = 'var(--accent)';
    const [r, g, b] = getComputedStyle(probe).color.match(/[0-9]+/g).map(Number);
    probe.remove();
    const { data } = pen.getImageData((x - 9) * k, (y - 9) * k, 18 * k, 18 * k);
    let found = 0;
    for (let i = 0; i < data.length; i += 4) found += Math.hypot(data[i] - r, data[i + 1] - g, data[i + 2] - b) < 40;
    return found;
}"""
)
"""Pixels of a draft's colour about a point of the canvas."""


def marks(page: Page, x: float, y: float) -> int:
    return int(page.evaluate(MARKED, [x, y]))


def test_a_refusal_is_shown_in_the_daemons_words_and_stays(page: Page) -> None:
    select(page, "v3")
    page.get_by_label("x in metres from the origin").fill("5")
    page.get_by_label("y in metres from the origin").fill("5")
    hold(page, order(page, "Send there"))
    toast = page.locator(".toast[data-state=failed]").first
    expect(toast).to_contain_text("v3")
    page.wait_for_timeout(7_000)
    expect(toast).to_be_visible()
    toast.get_by_role("button", name="Dismiss").click()
    expect(page.locator(".toast[data-state=failed]")).to_have_count(0)


@pytest.mark.parametrize("way", ["press", "shift-s", "f8-in-a-text-field", "enter"])
def test_stop_is_one_action_without_a_selection(page: Page, way: str) -> None:
    page.keyboard.press("Escape")
    stop = page.get_by_role("button", name="Stop all vehicles")
    if way == "press":
        stop.hover()
        page.mouse.down()  # it acts on the press
    elif way == "shift-s":
        page.keyboard.press("Shift+S")
    elif way == "enter":
        stop.focus()
        page.keyboard.press("Enter")
    else:
        page.get_by_role("searchbox").click()
        page.keyboard.press("F8")
    expect(page.locator(".stopboard")).to_contain_text("STOP")
    page.mouse.up()
    page.wait_for_timeout(200)
    [message] = sent(page, "vehicles.stop")
    assert message["params"] == {"targets": "all"}


def test_letters_in_a_text_field_are_no_orders(page: Page) -> None:
    select(page, "v1")
    page.get_by_role("searchbox").click()
    page.keyboard.type("hS")
    page.keyboard.down("a")
    page.wait_for_timeout(HOLD_MS + 300)
    page.keyboard.up("a")
    assert not any(str(m.get("method")).startswith("vehicles.") for m in page.sent)  # type: ignore[attr-defined]


def test_a_script_cannot_press_and_counts_for_no_person(page: Page) -> None:
    select(page, "v1")
    page.wait_for_timeout(1_200)
    before = len(page.sent)  # type: ignore[attr-defined]
    page.evaluate(
        """async () => {
            const button = [...document.querySelectorAll('.order')].find(b => b.textContent.startsWith('Arm'));
            button.dispatchEvent(new PointerEvent('pointerdown', {bubbles: true, button: 0}));
            document.dispatchEvent(new KeyboardEvent('keydown', {key: 'a', bubbles: true}));
            document.dispatchEvent(new KeyboardEvent('keydown', {key: 'F8', bubbles: true}));
            [...document.querySelectorAll('.order')][0].click();
            await new Promise(done => setTimeout(done, 1500));
        }"""
    )
    methods = {message.get("method") for message in page.sent[before:]}  # type: ignore[attr-defined]
    assert methods <= {"web.ping", *ASKED_ALONE}, methods


def test_the_page_alone_sends_no_sign_of_a_person(page: Page) -> None:
    page.wait_for_timeout(1_200)
    before = len(page.sent)  # type: ignore[attr-defined]
    page.wait_for_timeout(6_000)
    methods = {message.get("method") for message in page.sent[before:]}  # type: ignore[attr-defined]
    assert methods <= {"web.ping", "vehicles.get", *ASKED_ALONE}, methods
    page.mouse.click(900, 25)
    page.wait_for_timeout(300)
    assert len(sent(page, "operator.active")) >= 1


def test_a_lost_connection_leaves_the_order_unknown_and_it_is_not_sent_again(
    make_station: Callable[..., WebStation], open_page: OpenPage, shot: Shot
) -> None:
    station = make_station((1, 0), web=())
    page = open_page(station)
    keep_sent(page)
    page.reload()
    expect(page.locator("tr.row[data-heard=true]")).to_have_count(1)
    select(page, "v1")
    # the answer of an arming with so much to wait for comes late: the process ends before
    page.evaluate(
        """() => { window.ordered = skygcs.connection.order('vehicles.arm', {targets: 'v1', wait_s: 60})
            .then(() => 'answered', error => error.message); }"""
    )
    page.wait_for_timeout(100)
    station.stop_web(signal.SIGKILL)
    text = page.evaluate("window.ordered")
    assert text in ("answered", "unknown: connection lost before the answer; look at the vehicles")
    expect(page.locator(".banner.danger")).to_contain_text("Orders are not sent")
    for button in page.locator(".order:visible").all():
        expect(button).to_be_disabled()
    orders = len(sent(page, "vehicles.arm"))
    page.keyboard.press("Shift+S")
    expect(page.get_by_role("region", name="What STOP has come to")).to_contain_text("nothing was sent")
    shot(page, "order-not-connected")
    station.start_web()
    page.wait_for_timeout(6_000)
    assert len(sent(page, "vehicles.arm")) == orders and sent(page, "vehicles.stop") == []


def test_who_may_only_look_has_no_orders(station: WebStation, open_page: OpenPage, shot: Shot) -> None:
    page = open_page(station, role="view")
    expect(page.locator("tr.row[data-heard=true]")).to_have_count(3)
    page.locator("tr.row[data-name=v1]").click()
    expect(page.locator(".order")).to_have_count(0)
    expect(page.get_by_role("button", name="Stop all vehicles")).to_be_disabled()
    expect(page.get_by_text("This address may only look: no orders.")).to_be_visible()
    shot(page, "view-role")


def test_keys_are_listed_and_the_focus_is_seen(page: Page, shot: Shot) -> None:
    page.keyboard.press("?")
    expect(page.get_by_role("dialog")).to_contain_text("STOP")
    shot(page, "keys")
    page.keyboard.press("Escape")
    page.keyboard.press("Tab")
    page.keyboard.press("Tab")
    outline = page.evaluate("getComputedStyle(document.activeElement).outlineStyle")
    assert outline == "solid"


def test_letters_are_orders_only_while_their_buttons_are_seen(page: Page) -> None:
    select(page, "v1")
    page.get_by_role("button", name="Events").click()
    expect(order(page, "Hold")).to_be_hidden()
    page.keyboard.down("a")
    page.wait_for_timeout(HOLD_MS + 400)
    page.keyboard.up("a")
    page.keyboard.press("h")
    page.get_by_role("button", name="Fleet", exact=True).click()
    expect(order(page, "Hold")).to_be_visible()
    page.keyboard.press("?")
    expect(page.get_by_role("dialog", name="Keys")).to_be_visible()
    page.keyboard.press("h")
    page.keyboard.press("Escape")
    expect(page.get_by_role("dialog", name="Keys")).to_be_hidden()
    assert not any(str(m.get("method")) in ("vehicles.arm", "vehicles.hold") for m in page.sent)  # type: ignore[attr-defined]
    page.keyboard.press("h")
    expect(page.locator(".toast").first).to_contain_text("Hold")


def test_a_short_press_on_a_page_that_stood_still_is_no_order(page: Page) -> None:
    """Press and release are both in the queue when the page wakes: the release must count before the timer."""
    select(page, "v1")
    order(page, "Arm").hover()
    page.mouse.down()
    expect(page.locator(".holdhint")).to_be_visible()
    page.evaluate(
        "setTimeout(() => { const end = performance.now() + 2500; while (performance.now() < end); }, 0)",
    )
    page.wait_for_timeout(50)
    page.mouse.up()
    page.wait_for_timeout(1_500)
    assert sent(page, "vehicles.arm") == []


def test_a_hold_begins_anew_when_its_targets_change(page: Page) -> None:
    select(page, "v1")
    order(page, "Arm").hover()
    page.mouse.down()
    expect(page.locator(".holdhint")).to_be_visible()
    page.evaluate("skygcs.store.dispatch({type: 'select', names: ['v1', 'v2'], how: 'only'})")
    page.wait_for_timeout(HOLD_MS + 400)
    page.mouse.up()
    assert sent(page, "vehicles.arm") == []


@pytest.mark.parametrize("before", [[], ["v1"]])
def test_h_before_the_next_frame_is_for_the_vehicle_that_is_selected_now(page: Page, before: list[str]) -> None:
    select(page, *before)
    page.evaluate("window.requestAnimationFrame = (draw) => setTimeout(draw, 3000)")  # a page that is slow to draw
    page.evaluate("skygcs.store.dispatch({type: 'select', names: ['v2'], how: 'only'})")
    page.keyboard.press("h")
    assert the_one_sent(page, "vehicles.hold")["params"]["targets"] == ["v2"]


def test_one_of_five_targets_replaced_while_held_begins_anew_although_the_button_reads_the_same(
    make_station: Callable[..., WebStation], open_page: OpenPage
) -> None:
    page = open_page(make_station((6, 0)))
    keep_sent(page)
    page.reload()
    expect(page.locator("tr.row[data-heard=true]")).to_have_count(6)
    page.evaluate("skygcs.store.dispatch({type: 'select', names: ['v1', 'v2', 'v3', 'v4', 'v5'], how: 'only'})")
    order(page, "Arm").hover()
    page.mouse.down()
    expect(page.locator(".holdhint")).to_be_visible()
    page.evaluate("skygcs.store.dispatch({type: 'select', names: ['v1', 'v2', 'v3', 'v4', 'v6'], how: 'only'})")
    page.wait_for_timeout(HOLD_MS + 400)
    page.mouse.up()
    assert sent(page, "vehicles.arm") == []
