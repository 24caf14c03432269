"""The STOP board in a real browser: a chip for each vehicle as answers come, problems first, until it is dismissed."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest
from playwright.sync_api import Page, WebSocket, expect

from support.browser import until
from support.page_steps import fits
from support.web_station import WebStation

OpenPage = Callable[..., Page]
Shot = Callable[[Page, str], Path]

TEN = [f"u{n:02d}" for n in range(1, 11)]

UNDER_WAY = """names => {
    const order = { id: 900, label: "STOP all", method: "vehicles.stop", targets: names };
    const begun = { startedMs: performance.now() - 3000, endedMs: null, state: "pending", outcomes: {}, error: null };
    skygcs.store.dispatch({ type: "orderBegun", order: { ...order, ...begun } });
    const holding = { ok: true, result: "accepted", message: "holding" };
    const denied = { ok: false, result: "denied", message: "denied: requires position" };
    const outcomes = Object.fromEntries(names.slice(0, 9).map((name, n) => [name, n < 7 ? holding : denied]));
    skygcs.store.dispatch({ type: "orderReported", id: 900, vehicles: names, outcomes });
}"""
"""A STOP of ten: seven hold, two have refused, and one has not answered for 3 s."""


@pytest.mark.parametrize("theme", ["dark", "light"])
@pytest.mark.parametrize(("width", "height"), [(1600, 900), (390, 780)])
def test_a_stop_of_ten_shows_what_is_wrong_first(
    station: WebStation, open_page: OpenPage, shot: Shot, theme: str, width: int, height: int
) -> None:
    page = open_page(station, width=width, height=height, theme=theme)
    page.evaluate(UNDER_WAY, TEN)
    board = page.locator(".stopboard")
    expect(board).to_have_attribute("data-state", "bad")
    expect(board.get_by_role("alert")).to_contain_text("2 did not stop, 1 not answered yet, 7 stopped")
    assert [text.split()[1] for text in board.locator(".stopchip").all_inner_texts()] == [*TEN[7:], *TEN[:7]]
    expect(board.locator(".stopchip").first).to_contain_text("denied: requires position")
    assert fits(page)
    shot(page, f"stop-board-{width}-{theme}")
    page.get_by_role("button", name="Dismiss the STOP board").click()
    expect(board).to_have_count(0)


def test_a_stop_shows_each_vehicle_and_a_second_press_takes_its_place(station: WebStation, open_page: OpenPage) -> None:
    page = open_page(station)
    expect(page.locator("tr.row[data-heard=true]")).to_have_count(3)
    for _ in range(2):
        page.keyboard.press("Shift+S")
        expect(page.locator(".stopboard .stopchip")).to_have_count(3)
    until(page, "skygcs.store.state.orders.filter(o => o.method === 'vehicles.stop' && !o.dismissed).length === 1")
    until(page, "skygcs.store.state.orders[0].endedMs !== null")
    expect(page.locator(".stopboard")).to_be_visible()


def test_the_daemons_alarms_are_listed_and_acknowledged_from_the_page(
    station: WebStation, open_page: OpenPage, shot: Shot
) -> None:
    page = open_page(station, path="/#events")
    sent: list[str] = []
    heard: list[str] = []

    def listen(socket: WebSocket) -> None:
        socket.on("framesent", lambda text: sent.append(str(text)))
        socket.on("framereceived", lambda text: heard.append(str(text)))

    page.on("websocket", listen)
    with page.expect_event("websocket") as connected:
        page.reload()
    until(page, "skygcs.store.state.vehicles.size === 3")
    if not any('{"alarms":' in text for text in heard):  # the daemon's own list, which would replace this one
        connected.value.wait_for_event("framereceived", lambda text: '{"alarms":' in str(text))
    alarm = {"number": 7, "kind": "lost", "vehicle": "v2", "other": None, "severity": "alarm", "text": "no heartbeat"}
    more = {"raised_unix_s": 1.7e9, "active": True, "count": 1, "consequences": {"separation": 12}}
    shown = {**alarm, **more, "acknowledged_by": None, "acknowledged_unix_s": None}
    page.evaluate("alarms => skygcs.store.dispatch({ type: 'alarms', alarms })", [shown])
    expect(page.locator(".alarms li")).to_contain_text("12 more followed from it")
    shot(page, "alarms")
    page.get_by_role("button", name="Acknowledge: v2 lost").click()
    page.wait_for_timeout(300)
    (request,) = [text for text in sent if "alarms.acknowledge" in text]
    assert '"numbers":[7]' in request
    expect(page.locator(".alarms [role=alert]")).to_have_count(0)  # the daemon takes it, and has no such alarm
