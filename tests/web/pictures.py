"""Make the pictures of README and docs from the real page: a real daemon, twelve simulated vehicles, Chromium.

make pictures        writes docs/images/web-fleet.png, web-daylight.png and web-phone.png
"""

from __future__ import annotations

import math
import sys
import tempfile
import time
from pathlib import Path

from playwright.sync_api import Browser, Page, sync_playwright

from support.browser import until
from support.process import ROOT
from support.web_station import WebStation, chromium, chromium_options

IMAGES = ROOT / "docs" / "images"
OUTER = ("alpha", "bravo", "charlie", "delta", "echo", "foxtrot", "golf", "hotel")
INNER = ("india", "juliett", "kilo", "lima")
STEP_S = 2.5
STEPS = 9

ENTRY = """
[vehicles.{name}]
sysid = {sysid}
group = "{group}"
"""


def fleet() -> str:
    """The fleet file's end: names and groups."""
    named = [(name, "outer") for name in OUTER] + [(name, "inner") for name in INNER]
    return "".join(ENTRY.format(name=name, sysid=i, group=group) for i, (name, group) in enumerate(named, 1))


def step(station: WebStation, number: int) -> None:
    """Send every vehicle on along its ring: the outer one to the left, the inner one to the right."""
    for i, name in enumerate(OUTER):
        angle = 2 * math.pi * (i + number / 2) / len(OUTER)
        send(station, name, 34 * math.cos(angle), 24 * math.sin(angle), 10 + 3 * (i % 3))
    for i, name in enumerate(INNER):
        angle = 2 * math.pi * (i - number / 4) / len(INNER)
        send(station, name, 15 * math.cos(angle), 11 * math.sin(angle), 22 + 2 * (i % 2))


def send(station: WebStation, name: str, x: float, y: float, up: float) -> None:
    station.call("vehicles.goto", targets=name, enu_m=[x, y, up], force=True)


def open_page(browser: Browser, station: WebStation, width: int, height: int, *, touch: bool = False) -> Page:
    context = browser.new_context(
        viewport={"width": width, "height": height},
        color_scheme="dark",
        has_touch=touch,
        is_mobile=touch,
        device_scale_factor=2 if touch else 1,
    )
    page = context.new_page()
    page.goto(station.address())
    until(page, "skygcs.store.state.names.length === 12")
    return page


def take(page: Page, name: str) -> None:
    IMAGES.mkdir(exist_ok=True)
    page.screenshot(path=IMAGES / f"{name}.png")
    print(IMAGES / f"{name}.png")


def fly(station: WebStation, page: Page) -> None:
    """Take all off, and fly them round until their trails are rings."""
    until(page, "[...skygcs.store.state.vehicles.values()].every(v => v.position?.enu_m)")
    station.call("vehicles.takeoff", targets="all", height_m=10, wait_s=50)
    for number in range(STEPS):
        step(station, number)
        page.wait_for_timeout(STEP_S * 1000)
        if number == 1:
            page.evaluate("skygcs.store.trails.clear()")  # without the ways from home to the rings
    page.keyboard.press("f")


def main() -> int:
    path = chromium()
    if path is None:
        print("make pictures needs Chromium: install the package chromium of this system", file=sys.stderr)
        return 1
    station = WebStation(Path(tempfile.mkdtemp(prefix="pictures")), (7, 5), more=fleet()).start()
    try:
        with sync_playwright() as playwright:
            browser = playwright.chromium.launch(executable_path=path, args=chromium_options())
            page = open_page(browser, station, 1600, 900)
            fly(station, page)
            for name in ("bravo", "charlie"):
                page.locator(f"tr.row[data-name={name}]").click(modifiers=["Control"])
            page.mouse.move(800, 500)
            step(station, STEPS)
            time.sleep(STEP_S / 2)
            page.wait_for_timeout(500)
            take(page, "web-fleet")
            page.emulate_media(color_scheme="light")
            page.wait_for_timeout(600)
            take(page, "web-daylight")
            phone = open_page(browser, station, 390, 720, touch=True)
            phone.locator("tr.row[data-name=alpha]").tap()
            phone.locator(".bottom .tab", has_text="Orders").tap()
            phone.wait_for_timeout(800)
            take(phone, "web-phone")
            browser.close()
    finally:
        station.close()
    return 0


if __name__ == "__main__":
    sys.exit(main())
