"""Signing in with a real browser: the address works once, the cookie stays, and no error is in the console."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from playwright.sync_api import Page

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
