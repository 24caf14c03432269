"""Signing in with a real browser: the address works once, the cookie stays, and no error is in the console."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest
from playwright.sync_api import Browser, Page, expect

from skygcs.web.sign_in import Role
from support.browser import until
from support.page_steps import fits
from support.process import ROOT
from support.web_station import WebStation


def test_the_printed_address_opens_the_page_once(
    station: WebStation, open_page: Callable[..., Page], shot: Callable[[Page, str], Path]
) -> None:
    page = open_page(station)
    assert page.url == f"{station.base}/"
    assert "skygcs" in page.title().lower()
    page.reload()
    assert page.locator("script[src='/assets/app.js']").count() == 1
    cookie = page.context.cookies()[0]
    assert cookie["httpOnly"] and cookie["sameSite"] == "Strict"
    address = station.address()
    page.goto(address)
    assert page.url == f"{station.base}/"
    shot(page, "signed-in")
    page.context.clear_cookies()
    answer = page.goto(address)
    assert answer is not None and answer.status == 403
    assert "skygcs web link" in page.content()


@pytest.mark.parametrize("theme", ["dark", "light"])
@pytest.mark.parametrize("width", [1600, 390])
def test_an_address_is_pasted_into_the_page(
    station: WebStation, browser: Browser, shot: Callable[[Page, str], Path], width: int, theme: str
) -> None:
    context = browser.new_context(viewport={"width": width, "height": 844}, color_scheme=theme)  # type: ignore[arg-type]
    try:
        page = context.new_page()
        refused: list[str] = []
        page.on("console", lambda m: refused.append(m.text) if "Content Security" in m.text else None)
        page.goto(station.base + "/")
        field = page.get_by_label("Address of the page")
        expect(field).to_be_focused()
        assert fits(page)
        shot(page, f"sign-in-{width}-{theme}")
        field.fill("http://192.168.1.7:8080/?token=used-up")
        field.press("Enter")
        expect(page.get_by_role("alert")).to_contain_text("not good any more")
        shot(page, f"sign-in-refused-{width}-{theme}")
        scripts = (ROOT / "src/skygcs/web/page/node_modules/axe-core/axe.min.js").read_text()
        page.evaluate(scripts)
        assert page.evaluate("async () => (await axe.run()).violations.map(({id}) => id)") == []
        role: Role = "view"
        field.fill(f"  {station.address(role)} ")
        page.get_by_role("button", name="Sign in").click()
        until(page, "skygcs?.store.state.hello?.role === 'view'")
        assert page.url == f"{station.base}/"
        assert refused == []
    finally:
        context.close()
