"""axe-core, the rules of Deque, on each screen of the page: wide and on a phone, dark and light, with trouble on it."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import pytest
from playwright.sync_api import Page, expect

from support.axe import AXE, findings
from support.browser import until
from support.page_steps import IN_TROUBLE, select
from support.web_station import WebStation

OpenPage = Callable[..., Page]

PANES = ("View", "Table", "Orders", "Vehicle", "Missions", "Plans")


def screens(page: Page, *, phone: bool) -> Iterator[str]:
    """Open each screen of the page in turn."""
    if phone:
        for pane in PANES:
            page.get_by_role("navigation", name="Panes").get_by_role("button", name=pane, exact=True).click()
            yield pane
    else:
        for tab in PANES[2:]:
            page.get_by_role("tablist", name="Panels").get_by_role("tab", name=tab, exact=True).click()
            yield tab
        for tab in ("State", "Control", "Parameters", "Preflight", "Messages", "History"):
            page.get_by_role("tablist", name="Panels").get_by_role("tab", name="Vehicle", exact=True).click()
            if (inner := page.locator(".sidebody").get_by_role("tab", name=tab)).count():
                inner.click()
                yield f"Vehicle, {tab}"
    for name in ("Preflight", "Radio", "Events"):
        page.get_by_role("navigation", name="Pages").get_by_role("button", name=name).click()
        yield name


@pytest.mark.parametrize("theme", ["dark", "light"])
@pytest.mark.parametrize(("width", "height"), [(1600, 900), (390, 844), (844, 390)])
def test_axe_finds_nothing(station: WebStation, open_page: OpenPage, theme: str, width: int, height: int) -> None:
    phone = width < 1000
    page = open_page(station, width=width, height=height, theme=theme, touch=phone)
    until(page, "skygcs.store.state.vehicles.get('v1')?.position?.enu_m != null")
    page.evaluate(IN_TROUBLE)
    select(page, "v1")
    page.evaluate(AXE.read_text())
    found = {}
    for screen in screens(page, phone=phone):
        expect(page.get_by_text("Loading …")).to_have_count(0)
        page.wait_for_timeout(400)  # what is asked of the daemon has come
        if problems := findings(page):
            found[screen] = problems
    assert found == {}
