"""Browser tests: a real daemon with simulated vehicles, a real `skygcs web`, the system's Chromium.

station        a running WebStation of two PX4 and one ArduCopter, for all tests of a module
make_station   others: make_station(vehicles=(px4, ardupilot), daemon="", more="", web=("--replay", FILE))
open_page      open_page(station, width=1600, height=900, role="command", theme="dark") -> a page that is signed in
shot           shot(page, "fleet-view") keeps build/web-screens/fleet-view.png
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, Literal

import pytest
from playwright.sync_api import Browser, Page, sync_playwright

from skygcs.web.sign_in import Role
from support.browser import until
from support.process import ROOT
from support.web_station import WebStation, chromium, chromium_options

SCREENS = ROOT / "build" / "web-screens"
WAIT_MS = 30_000
"""For what the page shows soon; a busy machine takes longer."""

CHEAP = ["--in-process-gpu"]
"""A page draws without a graphics card anyway: without a process for it a page costs a fifth less to open."""

Theme = Literal["light", "dark"]


def pytest_sessionstart() -> None:
    """Say what is missing before the workers start, of which each would say it."""
    if chromium() is None:
        pytest.exit("make test-web needs Chromium: install the package chromium of this system", returncode=2)
    if not (ROOT / "src/skygcs/web/static/index.html").exists():
        pytest.exit("make test-web needs the built page: make web", returncode=2)


@pytest.fixture(scope="session")
def browser() -> Iterator[Browser]:
    with sync_playwright() as playwright:
        running = playwright.chromium.launch(executable_path=chromium(), args=[*chromium_options(), *CHEAP])
        yield running
        running.close()


@pytest.fixture(scope="module")
def make_station(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Callable[..., WebStation]]:
    stations: list[WebStation] = []

    def make(vehicles: tuple[int, int] | None = (2, 1), **options: Any) -> WebStation:
        stations.append(WebStation(tmp_path_factory.mktemp("station"), vehicles, **options))
        return stations[-1].start()

    yield make
    for station in stations:
        station.close()


@pytest.fixture(scope="module")
def station(make_station: Callable[..., WebStation]) -> WebStation:
    return make_station()


@pytest.fixture
def open_page(browser: Browser) -> Iterator[Callable[..., Page]]:
    contexts = []
    elsewhere: list[str] = []

    def open_one(
        station: WebStation,
        *,
        width: int = 1600,
        height: int = 900,
        role: Role = "command",
        theme: Theme = "dark",
        touch: bool = False,
        path: str = "/",
    ) -> Page:
        context = browser.new_context(
            viewport={"width": width, "height": height}, color_scheme=theme, has_touch=touch, is_mobile=touch
        )
        context.set_default_timeout(WAIT_MS)
        contexts.append(context)
        page = context.new_page()
        page.errors = []  # type: ignore[attr-defined]  # what the page's console and scripts complained about
        page.on("pageerror", lambda error: page.errors.append(str(error)))  # type: ignore[attr-defined]
        page.on("console", lambda m: page.errors.append(m.text) if m.type == "error" else None)  # type: ignore[attr-defined]
        page.on("request", lambda request: elsewhere.extend([request.url] if leaves(request.url, station) else []))
        page.goto(station.address(role))
        if path != "/":
            page.goto(station.base + path)
        until(page, "Boolean(skygcs)")
        return page

    yield open_one
    for context in contexts:
        context.close()
    assert elsewhere == []  # nothing that a page asks for leaves the host


def leaves(url: str, station: WebStation) -> bool:
    return not url.startswith((station.base + "/", "data:", "blob:"))


@pytest.fixture
def shot() -> Callable[[Page, str], Path]:
    SCREENS.mkdir(parents=True, exist_ok=True)

    def take(page: Page, name: str) -> Path:
        path = SCREENS / f"{name}.png"
        page.screenshot(path=path)
        return path

    return take
