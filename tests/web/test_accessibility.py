"""The real page by keyboard alone and by its contrasts, in both themes: what axe would complain of, without axe."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from playwright.sync_api import Page, expect

from support.page_steps import select, side
from support.web_station import WebStation

OpenPage = Callable[..., Page]
Shot = Callable[[Page, str], Path]

MOST_TABS = 400
"""Presses of Tab: more than any screen has of what can be focused."""

WITHOUT_NAME = """() => [...document.querySelectorAll(
        'button, a, input:not([type=file]), select, textarea, summary, [role=tab]')]
    .filter(e => e.checkVisibility() && !e.hidden)
    .filter(e => {
        const labelled = e.labels && [...e.labels].map(l => l.textContent).join('');
        const name = e.getAttribute('aria-label') || labelled || e.textContent || e.title || e.placeholder || '';
        return name.trim() === '';
    }).map(e => e.outerHTML.slice(0, 120))"""

LOW_CONTRAST = """() => {
    const rgba = text => {
        const found = text.match(/rgba?\\(([^)]+)\\)/);
        if (!found) return [0, 0, 0, 0];
        const [r, g, b, a = 1] = found[1].split(/[ ,/]+/).map(Number);
        return [r, g, b, a];
    };
    const over = (top, below) => top.slice(0, 3).map((c, i) => c * top[3] + below[i] * (1 - top[3]));
    const ground = element => {
        const chain = [];
        for (let e = element; e; e = e.parentElement) chain.unshift(rgba(getComputedStyle(e).backgroundColor));
        return chain.reduce((below, top) => over(top, below), [255, 255, 255]);
    };
    const light = rgb => {
        const [r, g, b] = rgb.map(c => c / 255).map(c => c <= 0.04045 ? c / 12.92 : ((c + 0.055) / 1.055) ** 2.4);
        return 0.2126 * r + 0.7152 * g + 0.0722 * b;
    };
    const found = [];
    const walker = document.createTreeWalker(document.body, NodeFilter.SHOW_TEXT);
    for (let node = walker.nextNode(); node; node = walker.nextNode()) {
        const element = node.parentElement;
        if (node.textContent.trim() === '') continue;
        if (!element.checkVisibility({opacityProperty: true, visibilityProperty: true})) continue;
        if (element.closest(':disabled, option, script, style, [aria-disabled=true]')) continue;
        const style = getComputedStyle(element);
        const below = ground(element);
        const [a, b] = [light(over(rgba(style.color), below)), light(below)].sort((x, y) => y - x);
        const ratio = (a + 0.05) / (b + 0.05);
        const size = parseFloat(style.fontSize);
        const large = size >= 24 || (size >= 18.66 && Number(style.fontWeight) >= 700);
        if (ratio < (large ? 3 : 4.5)) found.push(`${node.textContent.trim().slice(0, 40)}: ${ratio.toFixed(2)}`);
    }
    return [...new Set(found)];
}"""

FOCUSED = """() => {
    const e = document.activeElement;
    if (!e || e === document.body) return null;
    const style = getComputedStyle(e);
    return {
        name: e.getAttribute('aria-label') || e.textContent.trim() || e.getAttribute('placeholder') || e.tagName,
        seen: style.outlineStyle !== 'none' && parseFloat(style.outlineWidth) > 0 || style.boxShadow !== 'none',
        tag: e.tagName,
    };
}"""

SCREENS = ("Orders", "Vehicle", "Missions", "Plans", "Preflight", "Radio", "Events")


def go(page: Page, screen: str) -> None:
    if screen in ("Preflight", "Radio", "Events"):
        page.get_by_role("navigation", name="Pages").get_by_role("button", name=screen).click()
        expect(page.locator(".page .note, .page table, .page li, .page p").first).to_be_visible()
    else:
        side(page, screen)
        expect(page.get_by_role("tab", name=screen, exact=True)).to_have_attribute("aria-selected", "true")
        expect(page.locator(".sidebody").get_by_text("Loading …")).to_have_count(0)


@pytest.mark.parametrize("theme", ["dark", "light"])
def test_texts_have_the_contrast_of_wcag_aa_and_controls_have_names(
    station: WebStation, open_page: OpenPage, theme: str
) -> None:
    page = open_page(station, theme=theme)
    select(page, "v1", "v2")
    found: dict[str, Any] = {}
    for screen in SCREENS:
        go(page, screen)
        page.wait_for_timeout(500)
        problems = page.evaluate(LOW_CONTRAST) + page.evaluate(WITHOUT_NAME)
        if problems:
            found[screen] = problems
    assert found == {}


def test_everything_is_reached_by_the_keyboard_and_the_focus_is_seen(station: WebStation, open_page: OpenPage) -> None:
    page = open_page(station)
    select(page, "v1")
    page.evaluate("document.activeElement.blur()")
    reached: list[dict[str, Any]] = []
    for _ in range(MOST_TABS):
        page.keyboard.press("Tab")
        focused = page.evaluate(FOCUSED)
        if focused is None or (reached and focused["name"] == reached[0]["name"]):
            break
        reached.append(focused)
    names = " | ".join(one["name"] for one in reached)
    for wanted in ("Skip to the fleet", "Radio", "Events", "Stop all vehicles", "Fleet view", "Filter", "Hold", "Arm"):
        assert wanted in names, (wanted, names)
    for wanted in ("Take off", "Return", "Land", "Choose in the view", "Vehicle", "Missions", "Plans", "Emergency"):
        assert wanted in names, (wanted, names)
    assert [one for one in reached if not one["seen"]] == []
