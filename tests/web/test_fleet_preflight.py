"""Preflight of the whole fleet in a real browser: checks by vehicles, red first, and the way to what mends it."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from playwright.sync_api import Page, expect

from support.browser import until
from support.page_steps import fits, select
from support.web_station import WebStation

OpenPage = Callable[..., Page]
Shot = Callable[[Page, str], Path]


@pytest.fixture(scope="module")
def examined(make_station: Callable[..., WebStation]) -> WebStation:
    return make_station((2, 1))


@pytest.mark.parametrize(("width", "theme"), [(1600, "dark"), (1600, "light"), (390, "dark"), (390, "light")])
def test_the_fleet_is_examined_and_what_is_red_stands_first(
    examined: WebStation, open_page: OpenPage, shot: Shot, width: int, theme: str
) -> None:
    page = open_page(examined, width=width, height=900, theme=theme, touch=width < 500, path="/#preflight")
    until(page, "skygcs.store.state.vehicles.size === 3")
    page.get_by_role("button", name="Examine all").click()
    matrix = page.get_by_role("region", name="Checks by vehicles")
    expect(matrix.locator("thead button")).to_have_count(3)
    expect(page.get_by_role("button", name="Examine all")).to_be_enabled(timeout=120_000)
    answer = examined.call("preflight.status", targets="all")
    verdicts = {
        (row["check"], name): row["verdict"] for name, status in answer.items() for row in status["report"]["findings"]
    }
    applies = {check for (check, _), verdict in verdicts.items() if verdict != "skipped"}
    for (check, name), verdict in verdicts.items():
        if check not in applies:
            continue
        expect(matrix.get_by_role("button", name=f"{verdict}, {check} of {name}").first).to_be_visible()
    failed = {check for (check, _), verdict in verdicts.items() if verdict == "fail"}
    rows = matrix.locator("tbody th").all_text_contents()
    assert set(rows[: len(failed)]) == failed, "red first"
    assert set(rows) == applies
    ready = sum(status["report"]["ok"] for status in answer.values())
    expect(page.locator(".fleetpreflight")).to_contain_text(f"{ready} of 3 are ready.")
    matrix.locator("td button").first.click()
    detail = page.get_by_role("region", name="Preflight of")
    expect(detail.locator(".findings li").first).to_be_visible()
    assert fits(page)
    shot(page, f"fleet-preflight-{width}-{theme}")


def test_the_head_of_a_vehicle_shows_and_hides_its_findings(examined: WebStation, open_page: OpenPage) -> None:
    page = open_page(examined, path="/#preflight")
    until(page, "skygcs.store.state.vehicles.size === 3")
    page.get_by_role("button", name="Examine all").click()
    matrix = page.get_by_role("region", name="Checks by vehicles")
    expect(matrix.locator("thead button")).to_have_count(3)
    head = matrix.locator("thead button").first
    head.click()
    detail = page.get_by_role("region", name="Preflight of")
    expect(detail.get_by_role("heading", name=head.inner_text())).to_be_visible()
    expect(detail.get_by_role("button", name="Examine", exact=True)).to_be_visible()
    head.click()
    expect(detail).to_have_count(0)


def test_only_those_that_are_selected_are_examined(examined: WebStation, open_page: OpenPage) -> None:
    page = open_page(examined, path="/#preflight")
    select(page, "v2")
    page.get_by_role("button", name="Examine v2").click()
    answer = until_examined(examined, "v2")
    assert answer["v2"]["report"] is not None


def until_examined(station: WebStation, name: str) -> dict[str, Any]:
    """preflight.status, once this vehicle was examined in the last seconds."""
    deadline = time.monotonic() + 120
    while time.monotonic() < deadline:
        answer: dict[str, Any] = station.call("preflight.status", targets="all")
        ages = {vehicle: status["age_s"] for vehicle, status in answer.items()}
        if ages[name] is not None and all(age is None or age > ages[name] for v, age in ages.items() if v != name):
            return answer
        time.sleep(0.2)
    raise AssertionError("it was not examined, or others were")
