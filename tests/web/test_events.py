"""Events in the browser: severity, filter, acknowledgement, and the sound for what needs a person."""

from __future__ import annotations

import re
import time

import pytest
from playwright.sync_api import Page, expect

from support.browser import until
from support.page_steps import fits

COUNT_TONES = """
  globalThis.tones = 0;
  const begin = OscillatorNode.prototype.start;
  OscillatorNode.prototype.start = function (...rest) { tones += 1; return begin.apply(this, rest); };
"""

ALARM = """text => skygcs.store.dispatch({type: "event", event: {
  time_unix_s: Date.now() / 1000, kind: "failsafe", severity: "alarm",
  vehicle: "v1", sysid: 1, text, data: {failsafe: true}}})"""

GROUPS = """() => {
  const now = Date.now() / 1000;
  const come = (at_s, kind, vehicle, text, data) => skygcs.store.dispatch({ type: "event", event: {
    time_unix_s: now + at_s, kind, vehicle, sysid: 1,
    severity: ["vehicle_lost", "separation"].includes(kind) ? "alarm" : "info", text, data } });
  come(0, "vehicle_lost", "u02", "no heartbeat for 3.1 s", {});
  for (let i = 1; i < 20; i++)
    come(i / 10, "separation", `u${i + 10}`, "ordered to hold for its distance to u02", { order: "hold", with: "u02" });
  for (let i = 1; i < 4; i++) come(3, "mode", `v${i}`, "mode OFFBOARD, was AUTO.LOITER", { mode: "OFFBOARD" });
}"""
"""A loss with what follows from it, and three vehicles that take up the same mode."""


def alarm(page: Page, text: str) -> None:
    """An event as the ground station sends it when a vehicle's failsafe acts."""
    page.evaluate(ALARM, text)


def test_events_are_listed_filtered_and_acknowledged(station, open_page, shot) -> None:
    station.call("vehicles.arm", targets="v3", force=True)
    station.call("vehicles.disarm", targets="v3", force=True)
    page = open_page(station, path="/#events")
    events = page.get_by_role("list", name="Events, the newest first")
    expect(events.locator("li", has_text="disarmed").first).to_be_visible()
    expect(events.locator("li", has_text=re.compile("discovered|heard", re.I)).first).to_be_visible()
    alarm(page, "battery critically low")
    row = events.locator("li", has_text="battery critically low")
    expect(row).to_have_attribute("data-severity", "alarm")
    expect(page.get_by_role("navigation", name="Pages").locator(".badge")).to_have_text("1")
    shot(page, "events-alarm")
    page.get_by_role("button", name=re.compile("^Reports")).click()
    expect(events.locator("li", has_text="disarmed")).to_have_count(0)
    expect(row).to_be_visible()
    page.get_by_label("Search events").fill("critically v1")
    expect(events.locator("li")).to_have_count(1)
    row.get_by_role("button", name="Acknowledge").click()
    expect(row).to_have_attribute("data-open", "false")
    expect(page.get_by_role("navigation", name="Pages").locator(".badge")).to_have_count(0)
    assert not page.errors


def test_an_alarm_sounds_after_a_gesture_until_it_is_acknowledged_or_muted(station, browser) -> None:
    context = browser.new_context()
    try:
        page = context.new_page()
        page.add_init_script(COUNT_TONES)
        page.goto(station.address())
        until(page, "skygcs.store.state.vehicles.size === 3")
        alarm(page, "nobody has touched the page")
        page.wait_for_timeout(500)
        assert page.evaluate("tones") == 0  # browsers allow no sound before a person's gesture
        page.get_by_role("button", name="Events").click()
        page.get_by_role("button", name=re.compile("^Acknowledge all")).click()
        alarm(page, "tones are off until a person wants them")
        page.wait_for_timeout(500)
        assert page.evaluate("tones") == 0
        page.get_by_role("button", name=re.compile("^Acknowledge all")).click()
        page.get_by_role("button", name="Tones off").click()
        alarm(page, "v1 is in failsafe")
        until(page, "tones >= 4")
        page.get_by_role("button", name="Tones on").click()
        heard = page.evaluate("tones")
        alarm(page, "while it is muted")
        time.sleep(4.5)
        assert page.evaluate("tones") == heard
        assert page.get_by_role("button", name="Tones off").is_visible()
    finally:
        context.close()


def test_an_alarm_at_the_moment_in_which_the_list_appears_is_in_it(station, open_page) -> None:
    page = open_page(station)
    until(page, "skygcs.store.state.events.length > 0")
    page.evaluate(f"""() => new MutationObserver((changes, observer) => {{
        if (!document.querySelector(".eventspanel")) return;
        observer.disconnect();
        ({ALARM})("battery critically low");
        setTimeout(() => {{ listed = document.querySelector(".events").textContent.includes("critically"); }}, 200);
    }}).observe(document, {{childList: true, subtree: true}})""")
    page.get_by_role("navigation", name="Pages").get_by_role("button", name="Events").click()
    until(page, "globalThis.listed !== undefined")
    assert page.evaluate("listed")
    assert not page.errors


@pytest.mark.parametrize("theme", ["dark", "light"])
@pytest.mark.parametrize("width", [1600, 390])
def test_events_of_one_cause_are_one_row(station, open_page, shot, width, theme) -> None:
    page = open_page(station, width=width, height=844, theme=theme, touch=width < 500, path="/#events")
    until(page, "skygcs.store.state.events.length > 0")
    page.evaluate(GROUPS)
    rows = page.get_by_role("list", name="Events, the newest first").locator("li")
    lost = rows.filter(has_text="no heartbeat for 3.1 s")
    expect(lost).to_have_attribute("data-severity", "alarm")
    expect(rows.filter(has_text="ordered to hold")).to_have_count(0)
    many = rows.filter(has_text="→ OFFBOARD: v1, v2 and v3")
    expect(many.get_by_role("button", name="3 vehicles")).to_be_visible()
    assert fits(page)
    shot(page, f"events-groups-{width}-{theme}")
    lost.get_by_role("button", name="19 more").click()
    expect(rows.filter(has_text="ordered to hold")).to_have_count(19)
    shot(page, f"events-unfolded-{width}-{theme}")
    lost.get_by_role("button", name="Acknowledge 20").click()
    expect(rows.and_(page.locator("[data-open=true]"))).to_have_count(0)
    many.get_by_role("button", name="3 vehicles").click()
    assert page.evaluate("skygcs.store.state.selection.size") == 3
    assert not page.errors


@pytest.mark.parametrize("theme", ["dark", "light"])
def test_events_fit_a_phone(station, open_page, shot, theme) -> None:
    page = open_page(station, width=390, height=800, theme=theme, touch=True, path="/#events")
    until(page, "skygcs.store.state.vehicles.size === 3 && skygcs.store.state.events.length > 0")
    alarm(page, "battery critically low: return to launch")
    expect(page.locator(".events li", has_text="battery critically low")).to_be_visible()
    assert fits(page)
    shot(page, f"events-phone-{theme}")
