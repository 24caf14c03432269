"""Steps that browser tests of the panels share."""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

from playwright.sync_api import Locator, Page, WebSocketRoute, expect

from support.browser import until

expect.set_options(timeout=60_000)  # a hang, not a measure: a busy machine takes long

WATCH_HOLD = """button => {
    let holding = false;
    const watch = window.watchedHold = { over: () => !button.isConnected || watch.ended, ended: false, begun: false };
    new MutationObserver(() => {
        watch.ended ||= holding && button.dataset.holding !== "true";
        holding = button.dataset.holding === "true";
        watch.begun ||= holding;
    }).observe(button, { attributes: true, attributeFilter: ["data-holding"] });
}"""
"""Sees that a button which is held down acts: after its second, and a frame that a busy machine draws late."""


DROP = """([name, text]) => {
  const data = new DataTransfer();
  data.items.add(new File([text], name, {type: "text/plain"}));
  const zone = document.querySelector(".dropzone");
  for (const type of ["dragover", "drop"])
    zone.dispatchEvent(new DragEvent(type, {dataTransfer: data, bubbles: true, cancelable: true}));
}"""
"""Drops one file on the place for files of a panel."""

IN_TROUBLE = """() => {
    const { store } = skygcs, { clock, vehicles } = store.state, like = vehicles.get("v1");
    const now_s = clock.now_s + (performance.now() - clock.atMs) / 1000;
    const come = (heard_s, ...made) => store.dispatch({ type: "batch", atMs: performance.now(), batch: {
        seq: 1, full: false, now_s, heard_s, gone: [], vehicles: made.map(more => ({ ...like, ...more })) } });
    const battery = { volts: 20.1, amps: null, percent: 6, remaining_s: null, age_s: 0 };
    const uplink = { heard: false, unanswered: 3, rtt_s: null, age_s: 0 };
    // as heard from the future: they stay heard while the test lasts
    const at = (x, y, more) => ({ ...like.position, enu_m: [x, y, 9.7], alt_rel_m: 9.7, ...more });
    come(now_s + 3600, { name: "u04", sysid: 104, battery, position: at(-12, 6) },
        { name: "u09", sysid: 109, uplink, position: at(-4, 12) },
        { name: "u07", sysid: 107, failsafe: true, position: at(8, 10) });
    come(now_s, { name: "u02", sysid: 102, connected: false, last_heartbeat_age_s: 21, landed: "in_air",
        links: {}, position: at(16, 4) });
    come(now_s, { name: "u11", sysid: 111, connected: false, last_heartbeat_age_s: 40, landed: "on_ground",
        links: {}, position: at(-16, -4, { alt_rel_m: 0 }) });
}"""
"""Five vehicles more: an empty battery, one that is deaf, a failsafe, one lost in the air, one silent on the ground."""


class HeldAnswers:
    """Keeps back the answers of a method whose parameters ``are`` those, from the next load of the page on."""

    def __init__(self, page: Page, method: str, are: Callable[[dict[str, Any]], bool] = lambda params: True) -> None:
        self._page, self._method, self._are = page, method, are
        self._asked: set[int] = set()
        self._answers: list[tuple[WebSocketRoute, str | bytes]] = []
        page.route_web_socket(re.compile("/ws$"), self._between)

    def wait(self) -> None:
        """Until the next answer is here."""
        while not self._answers:
            self._page.wait_for_timeout(20)

    def release(self) -> None:
        """Let them go on to the page."""
        while self._answers:
            socket, answer = self._answers.pop(0)
            socket.send(answer)

    def _between(self, socket: WebSocketRoute) -> None:
        server = socket.connect_to_server()

        def to_server(message: str | bytes) -> None:
            request = json.loads(message)
            if request.get("method") == self._method and self._are(request["params"]):
                self._asked.add(request["id"])
            server.send(message)

        def to_page(message: str | bytes) -> None:
            if json.loads(message).get("id") in self._asked:
                self._answers.append((socket, message))
            else:
                socket.send(message)

        socket.on_message(to_server)
        server.on_message(to_page)


def select(page: Page, *names: str) -> None:
    """Select vehicles, as the table does."""
    until(page, f"{json.dumps(names)}.every(name => skygcs.store.state.vehicles.has(name))")
    page.evaluate("names => skygcs.store.dispatch({type: 'select', names, how: 'only'})", list(names))


def drop(page: Page, name: str, text: str) -> None:
    """Drop a file on the panel."""
    page.wait_for_selector(".dropzone")
    page.evaluate(DROP, [name, text])


def side(page: Page, title: str, *, phone: bool = False) -> None:
    """Open a panel beside the view."""
    if phone:
        page.get_by_role("navigation", name="Panes").get_by_role("button", name=title, exact=True).click()
    else:
        page.get_by_role("tablist", name="Panels").get_by_role("tab", name=title, exact=True).click()


@contextmanager
def until_acted(page: Page, button: Locator) -> Iterator[None]:
    """A button that acts when it was held for its second: it is held in the block, which ends when it has acted."""
    button.evaluate(WATCH_HOLD)
    yield
    until(page, "watchedHold.over()")


def hold(page: Page, button: Locator) -> None:
    """Hold a button down until it has acted."""
    with until_acted(page, button):
        while not _pressed(page, button):  # what had come meanwhile had moved it from under the pointer
            page.mouse.up()
    page.mouse.up()


def _pressed(page: Page, button: Locator) -> bool:
    """Press a watched button; True once it shows that it is held, or has acted."""
    button.hover()
    page.mouse.down()
    for _ in range(40):
        if page.evaluate("watchedHold.begun || watchedHold.over()"):
            return True
        page.wait_for_timeout(50)
    return False


VIEW = ".canvasbox canvas[role=img]"
"""The canvas of the fleet view that has the pointer and the keys: vehicles, above another of what lies beneath them."""

VIEW_PEN = """(() => {
    const both = [...document.querySelectorAll('.canvasbox canvas')], { width, height } = both[0];
    const pen = Object.assign(document.createElement('canvas'), { width, height }).getContext('2d');
    for (const one of both) pen.drawImage(one, 0, 0);
    return pen;
})()"""
"""A JavaScript expression: the pen of a copy of both canvases, as a person sees them."""


def click_view(page: Page, *points: tuple[float, float]) -> None:
    """Click places of the fleet view, given as shares of its width and height."""
    box = page.locator(VIEW).bounding_box()
    assert box is not None
    for x, y in points:
        page.mouse.click(box["x"] + x * box["width"], box["y"] + y * box["height"])
        page.wait_for_timeout(60)


def fits(page: Page) -> bool:
    """True if nothing is wider than the window."""
    return bool(page.evaluate("document.documentElement.scrollWidth <= document.documentElement.clientWidth"))
