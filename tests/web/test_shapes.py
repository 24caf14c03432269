"""Squares, circles, paths and a place that is kept sent: ordered on the page, flown by simulated vehicles."""

from __future__ import annotations

import math
import re
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from playwright.sync_api import Locator, Page, expect

from support.browser import until
from support.hanging import HANG_S
from support.page_steps import click_view, fits, hold, select
from support.web_station import WebStation

OpenPage = Callable[..., Page]
Shot = Callable[[Page, str], Path]

PLACES = {"v1": [-20.0, 10.0, 8.0], "v2": [0.0, -30.0, 8.0], "v3": [20.0, 10.0, 8.0]}

FLIGHT = "skygcs.store.state.vehicles.get('v1').control?.trajectory"


@pytest.fixture(scope="module")
def flying(make_station: Callable[..., WebStation]) -> WebStation:
    station = make_station((2, 1))
    station.call("vehicles.arm", targets="all", wait_s=60)
    outcomes = station.call("vehicles.takeoff", targets="all", height_m=8, wait_s=60)["outcomes"]
    assert all(outcome["ok"] for outcome in outcomes.values()), outcomes
    for name, goal in PLACES.items():  # nobody stands on the other's way
        assert station.call("vehicles.goto", targets=name, enu_m=goal)["outcomes"][name]["ok"]
    deadline = time.monotonic() + HANG_S
    while any(math.dist(place(station, name), goal) > 1 for name, goal in PLACES.items()):
        assert time.monotonic() < deadline
        time.sleep(0.2)
    return station


def opened(station: WebStation, open_page: OpenPage, **options: Any) -> Page:
    page = open_page(station, **({"height": 1300} | options))
    until(page, "skygcs.store.state.vehicles.size === 3")
    until(page, "[...skygcs.store.state.vehicles.values()].every(v => (v.position?.alt_rel_m ?? 0) > 7)")
    return page


def shapes(page: Page, kind: str) -> Locator:
    details = page.locator("details.shapes")
    if not details.evaluate("details => details.open"):
        details.locator("summary").click()
    details.get_by_label("Shape").select_option(label=kind)
    return details


def off(station: WebStation, names: str) -> None:
    station.call("control.set", targets=names, mode="off")


def place(station: WebStation, name: str) -> tuple[float, float, float]:
    return tuple(station.call("vehicles.get", target=name)["position"]["enu_m"])


def orders(page: Page) -> list[list[str]]:
    """Methods and ends of this page's orders, the oldest first."""
    found: list[list[str]] = page.evaluate("() => skygcs.store.state.orders.map(o => [o.method, o.state])")
    return found[::-1]


def test_two_vehicles_fly_a_square_on_one_clock_are_paused_and_stopped(
    flying: WebStation, open_page: OpenPage, shot: Shot
) -> None:
    page = opened(flying, open_page)
    select(page, "v1", "v3")  # one PX4, one ArduCopter
    details = shapes(page, "Square")
    details.get_by_label("Side, m").fill("12")
    until(page, "skygcs.view.overlays.get('shape')?.shapes.length === 2")  # as it would be flown
    start = place(flying, "v1")
    shot(page, "shape-square-draft")
    hold(page, details.get_by_role("button", name=re.compile("^Fly it")))
    until(page, f"{FLIGHT}?.state === 'running'")
    assert orders(page) == [
        ["control.set", "done"],
        ["trajectory.load", "done"],
        ["trajectory.load", "done"],
        ["trajectory.start", "done"],
    ]
    until(page, "skygcs.view.overlays.get('planned paths')?.shapes.length > 0")
    shot(page, "shape-square-flown")
    until(page, f"{FLIGHT}.trajectory_s > 4")
    details.get_by_role("button", name="Pause", exact=True).click()
    until(page, f"{FLIGHT}?.state === 'paused'")
    until(page, "skygcs.store.state.vehicles.get('v3').control?.trajectory?.state === 'paused'")
    x, y, up = place(flying, "v1")
    assert x - start[0] > 1 and abs(y - start[1]) < 1.5 and abs(up - start[2]) < 1  # along +x first
    hold(page, details.get_by_role("button", name=re.compile("^Resume")))
    until(page, f"{FLIGHT}?.state === 'running'")
    details.get_by_role("button", name="Stop there").click()
    until(page, f"{FLIGHT} == null || {FLIGHT}.state === 'aborted'")
    expect(page.get_by_role("region", name="Setpoints")).to_contain_text(
        "2 of 2"
    )  # still under control, where they are
    page.get_by_role("region", name="Setpoints").get_by_role("button", name="Off").click()
    until(page, "[...skygcs.store.state.vehicles.values()].every(v => (v.control?.state ?? 'off') === 'off')")
    assert page.errors == []  # type: ignore[attr-defined]


def test_a_circle_is_flown_round_to_where_it_began(flying: WebStation, open_page: OpenPage) -> None:
    page = opened(flying, open_page)
    select(page, "v1")
    details = shapes(page, "Circle")
    details.get_by_label("Radius, m").fill("5")
    details.get_by_label("Speed, m/s").fill("2")
    hold(page, details.get_by_role("button", name=re.compile("^Fly it")))
    until(page, f"{FLIGHT}?.state === 'running'")
    start = flying.call("trajectory.status", targets="v1")["trajectories"][0]["start_enu_m"]
    far = 0.0
    while (flight := page.evaluate(FLIGHT)) is not None and flight["state"] == "running":
        x, y, _ = place(flying, "v1")
        far = max(far, math.dist((x, y), start[:2]))
        if flight["trajectory_s"] > 3:
            assert math.dist((x, y), (start[0] + 5, start[1])) == pytest.approx(5, abs=1.5)
        page.wait_for_timeout(100)
    assert far > 8  # the other side
    until(
        page, f"Math.hypot(...skygcs.store.state.vehicles.get('v1').position.enu_m.map((v, k) => v - {start}[k])) < 1"
    )
    off(flying, "v1")


def test_points_of_the_view_are_flown_in_turn(flying: WebStation, open_page: OpenPage) -> None:
    page = opened(flying, open_page)
    select(page, "v2")
    details = shapes(page, "Points on the view")
    expect(details.get_by_role("button", name=re.compile("^Fly it"))).to_be_disabled()
    page.evaluate("skygcs.view.camera = {...skygcs.view.camera, x: 0, y: -30, pxPerM: 8}")
    details.get_by_role("button", name="Click points").click()
    click_view(page, (0.55, 0.3), (0.6, 0.5))
    until(page, "skygcs.view.overlays.get('shape')?.shapes[0].points.length > 8")
    goal = page.evaluate("skygcs.view.overlays.get('shape').shapes[0].points.at(-1)")
    page.keyboard.press("Escape")
    hold(page, details.get_by_role("button", name=re.compile("^Fly it")))
    until(page, "skygcs.store.state.vehicles.get('v2').control?.trajectory?.state === 'running'")
    until(page, f"Math.hypot(...skygcs.store.state.vehicles.get('v2').position.enu_m.map((v, k) => v - {goal}[k])) < 1")
    off(flying, "v2")


def test_points_of_the_view_are_void_in_another_frame(flying: WebStation, open_page: OpenPage) -> None:
    page = opened(flying, open_page)
    select(page, "v2")
    details = shapes(page, "Points on the view")
    details.get_by_role("button", name="Click points").click()
    click_view(page, (0.55, 0.3), (0.6, 0.5))
    expect(details.get_by_role("button", name="Clear 2")).to_be_visible()
    origin = flying.call("origin.get")["origin"]
    kept = {key: origin[key] for key in ("lat_deg", "lon_deg", "alt_amsl_m", "x_heading_deg")}
    try:
        flying.call("origin.set", **(kept | {"x_heading_deg": 60.0}))
        until(page, "skygcs.view.frame?.x_heading_deg === 60")
        expect(details.get_by_role("button", name=re.compile("^Clear"))).to_have_count(0)
        expect(details.get_by_role("button", name=re.compile("^Fly it"))).to_be_disabled()
    finally:
        flying.call("origin.set", **kept)


def test_a_loaded_trajectory_is_flown_from_its_first_point(flying: WebStation, open_page: OpenPage) -> None:
    x, y, up = place(flying, "v1")
    piece = {"duration_s": 6.0, "x": [x - 6, 0, 0, 10 / 6**3 * 6, -15 / 6**4 * 6, 6 / 6**5 * 6], "y": [y], "up": [up]}
    assert flying.call("trajectory.load", target="v1", pieces=[piece], name="line")["outcomes"]["v1"]["ok"]
    page = opened(flying, open_page)
    select(page, "v1")
    details = shapes(page, "Loaded trajectory")
    expect(details).to_contain_text("v1: line")
    hold(page, details.get_by_role("button", name=re.compile("^Fly it")))
    until(
        page,
        "skygcs.store.state.orders.some(o => o.method === 'trajectory.start' && o.state === 'failed')",
    )
    hold(page, details.get_by_role("button", name=re.compile("^To their first points")))
    until(page, f"Math.abs(skygcs.store.state.vehicles.get('v1').position.enu_m[0] - {x - 6}) < 0.7")
    hold(page, details.get_by_role("button", name=re.compile("^Fly it")))
    until(page, f"{FLIGHT}?.state === 'running'")
    off(flying, "v1")
    flying.call("trajectory.unload", targets="v1")


def test_a_place_is_kept_sent_until_off(flying: WebStation, open_page: OpenPage, shot: Shot) -> None:
    page = opened(flying, open_page)
    select(page, "v1")
    x, y, _ = place(flying, "v1")
    goto = page.get_by_role("region", name="Go to")
    goto.get_by_label(re.compile("^x in metres")).fill(f"{x + 4:.1f}")
    goto.get_by_label(re.compile("^y in metres")).fill(f"{y:.1f}")
    goto.get_by_role("checkbox").check()
    hold(page, goto.get_by_role("button", name=re.compile("^Send there")))
    until(page, "skygcs.store.state.orders.filter(o => o.state === 'done').length === 2")
    assert [method for method, _ in orders(page)] == ["control.set", "vehicles.goto"]
    until(page, f"Math.abs(skygcs.store.state.vehicles.get('v1').position.enu_m[0] - {x + 4}) < 0.7")
    # setpoints go on: the autopilot stays in its mode for them, and the page says where it is kept
    control = flying.call("vehicles.get", target="v1")["control"]
    assert control["state"] == "flying" and control["reference"]["pos_enu_m"][0] == pytest.approx(x + 4, abs=0.2)
    section = page.get_by_role("region", name="Setpoints")
    expect(section).to_contain_text(re.compile(r"kept at .* until Off"))
    shot(page, "setpoint-kept")
    section.get_by_role("button", name="Off").click()
    until(page, "(skygcs.store.state.vehicles.get('v1').control?.state ?? 'off') === 'off'")
    expect(section).not_to_contain_text("kept at")


@pytest.mark.parametrize("theme", ["dark", "light"])
@pytest.mark.parametrize(("width", "height"), [(1600, 900), (390, 844), (844, 390)])
def test_the_form_fits(
    flying: WebStation, open_page: OpenPage, shot: Shot, width: int, height: int, theme: str
) -> None:
    page = opened(flying, open_page, width=width, height=height, theme=theme, touch=width < 1000)
    select(page, "v1", "v2")
    if width < 1000:
        page.get_by_role("navigation", name="Panes").get_by_role("button", name="Orders", exact=True).click()
    details = shapes(page, "Circle")
    until(page, "skygcs.view.overlays.get('shape')?.shapes.length === 2")
    details.scroll_into_view_if_needed()
    assert fits(page)
    assert details.evaluate("d => d.scrollWidth <= d.clientWidth")
    shot(page, f"shapes-{width}-{theme}")
