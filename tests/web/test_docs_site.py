"""The documentation as a site, opened as files in a browser: complete without a network, no wider than its window."""

from __future__ import annotations

from collections.abc import Iterator

import pytest
from playwright.sync_api import Browser, Page

from support.browser import until
from support.hanging import HANG_S
from support.process import ROOT

SITE = ROOT / "build" / "site"
SCREENS = ROOT / "build" / "web-screens"


@pytest.fixture
def requested() -> list[str]:
    return []


@pytest.fixture
def page(browser: Browser, requested: list[str]) -> Iterator[Page]:
    if not (SITE / "index.html").exists():
        pytest.exit("make test-web needs the built documentation: make docs", returncode=2)
    context = browser.new_context(viewport={"width": 1400, "height": 900})
    page = context.new_page()
    page.on("request", lambda request: requested.append(request.url))
    page.on("pageerror", lambda error: requested.append(f"error: {error}"))
    yield page
    context.close()


def test_no_page_asks_for_anything_from_elsewhere_or_is_wider_than_the_window(page: Page, requested: list[str]) -> None:
    for file in sorted(SITE.glob("**/*.html")):
        page.goto(file.as_uri())
        assert page.evaluate("document.documentElement.scrollWidth <= innerWidth"), file
        broken = page.evaluate("[...document.images].filter(i => i.complete && !i.naturalWidth).map(i => i.src)")
        assert broken == [], file
    assert [url for url in requested if not url.startswith("file://")] == []


def test_the_search_finds_without_a_server(page: Page, requested: list[str]) -> None:
    page.goto((SITE / "index.html").as_uri())
    page.fill("input[name=query]", "duplicate system id")
    until(page, "document.querySelectorAll('.md-search-result__item').length > 0")
    page.locator(".md-search-result__item a").first.click(timeout=HANG_S * 1000)
    page.wait_for_url("**/*.html*")
    assert page.url != (SITE / "index.html").as_uri()
    assert [url for url in requested if not url.startswith("file://")] == []


def test_the_client_page_has_the_calls_that_a_program_needs(page: Page) -> None:
    page.goto((SITE / "reference" / "client.html").as_uri())
    page.screenshot(path=SCREENS / "docs-client.png")
    headings = page.locator("h2, h3").all_inner_texts()
    for name in ("connect", "Client", "takeoff", "land", "telemetry", "Subscription"):
        assert any(text.startswith(name) for text in headings), (name, headings)
