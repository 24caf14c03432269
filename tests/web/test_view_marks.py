"""What the fleet view draws besides vehicles: start and goal places, vehicles that come too close, heights.

By pixels of the canvas, at the places where the camera puts them.
"""

from __future__ import annotations

import pytest
from playwright.sync_api import Page, expect

from support.browser import until
from support.page_steps import VIEW, VIEW_PEN, fits

COUNT = (
    f"const pen = {VIEW_PEN};"
    + """
const canvas = document.querySelector('canvas');
const ratio = canvas.width / canvas.getBoundingClientRect().width, c = skygcs.view.camera;
const ink = (name) => {
  const one = document.createElement('canvas').getContext('2d');
  one.fillStyle = getComputedStyle(canvas).getPropertyValue('--' + name).trim();
  one.fillRect(0, 0, 1, 1);
  return one.getImageData(0, 0, 1, 1).data;
};
const count = (xPx, yPx, reachPx, name) => {
  const wanted = ink(name), side = Math.max(Math.round(2 * reachPx * ratio), 1);
  const { data } = pen.getImageData((xPx - reachPx) * ratio, (yPx - reachPx) * ratio, side, side);
  let found = 0;
  for (let i = 0; i < data.length; i += 4)
    found += Math.abs(data[i] - wanted[0]) + Math.abs(data[i + 1] - wanted[1]) + Math.abs(data[i + 2] - wanted[2]) < 30;
  return found;
};
const screen = (x, y) => [c.widthPx / 2 + (x - c.x) * c.pxPerM, c.heightPx / 2 - (y - c.y) * c.pxPerM];
const placeOf = (name) => skygcs.store.state.vehicles.get(name).position.enu_m;
"""
)
"""count(x, y, reach, colour's name): pixels of nearly this colour about a point of the canvas. screen(x, y): where a
place of the fleet's frame is."""


def on_canvas(body: str) -> str:
    """A JavaScript expression with the functions of COUNT."""
    return f"(() => {{ {COUNT} return {body}; }})()"


@pytest.fixture
def page(station, open_page) -> Page:
    opened = open_page(station)
    expect(opened.locator("tr.row")).to_have_count(3)
    until(opened, "[...skygcs.store.state.vehicles.values()].every(v => v.position?.enu_m)")
    until(opened, "skygcs.view.figures.frames > 3")
    return opened


def fly_to(station, page: Page, name: str, east_m: float, north_m: float, up_m: float) -> None:
    """There and hovering, as the page knows it."""
    answer = station.call("vehicles.goto", targets=name, enu_m=[east_m, north_m, up_m], force=True)
    assert answer["outcomes"][name]["ok"], answer
    place = f"skygcs.store.state.vehicles.get('{name}').position"
    until(page, f"Math.hypot({place}.enu_m[0] - {east_m}, {place}.enu_m[1] - {north_m}) < 1.5")
    until(page, f"Math.hypot(...{place}.vel_enu_mps) < 0.3")


def test_start_and_goal_places_of_a_planned_path_are_drawn(station, page: Page, shot) -> None:
    start, goal = "screen(-25, 5)", "screen(30, 45)"
    piece = {"duration_s": 10.0, "x": [-25.0, 5.5], "y": [5.0, 4.0], "up": [10.0]}
    assert station.call("trajectory.load", target="v1", pieces=[piece], name="line")["outcomes"]["v1"]["ok"]
    until(page, "skygcs.view.overlays.has('planned paths')")
    page.get_by_role("button", name="Fit").click()
    # a square of 10 pixels and a circle of 12 about a dot, each of lines 2 pixels wide
    until(page, on_canvas(f"count(...{start}, 8, 'vehicle-1') > 20"))
    until(page, on_canvas(f"count(...{goal}, 8, 'ink-goal') > 20"))
    until(page, on_canvas(f"count(...{goal}, 1.5, 'ink-goal') > 0"))
    shot(page, "view-start-and-goal")
    station.call("trajectory.unload", targets="v1")
    until(page, on_canvas(f"count(...{start}, 8, 'vehicle-1') === 0 && count(...{goal}, 8, 'ink-goal') === 0"))
    assert page.errors == []  # type: ignore[attr-defined]


def test_vehicles_that_come_too_close_and_their_heights_are_drawn(station, page: Page, shot) -> None:
    outcomes = station.call("vehicles.takeoff", targets="v1,v2", height_m=8, wait_s=60)["outcomes"]
    assert all(outcome["ok"] for outcome in outcomes.values()), outcomes
    until(page, "['v1', 'v2'].every(n => skygcs.store.state.vehicles.get(n).position.alt_rel_m > 7)")
    fly_to(station, page, "v1", 0.0, 20.0, 8.0)
    fly_to(station, page, "v2", 1.5, 20.0, 8.0)  # they stay so: what is drawn does not depend on when it is looked at
    until(page, "skygcs.store.state.vehicles.get('v1').separation?.with === 'v2'")
    until(page, "skygcs.store.state.vehicles.get('v1').separation.closest_in_s !== undefined")
    page.evaluate("skygcs.view.camera = {...skygcs.view.camera, x: 0, y: 20, pxPerM: 20}; skygcs.view.redraw()")
    middle = "screen((placeOf('v1')[0] + placeOf('v2')[0]) / 2, (placeOf('v1')[1] + placeOf('v2')[1]) / 2)"
    reach = "Math.max((skygcs.store.state.vehicles.get('v1').separation.margin_m ?? 0) / 2 * c.pxPerM, 9) + 4"
    level = "(skygcs.store.state.vehicles.get('v1').separation.level === 'notice' ? 'warning' : 'danger')"
    until(page, on_canvas(f"count(...{middle}, {reach}, {level}) > 40"))
    shot(page, "view-too-close")
    # the strip below: a dot of 9 pixels straight below each vehicle, at its height
    up = "c.heightPx + 102 - placeOf(name)[2] * 94 / skygcs.view.sideTopM"
    colour = "`vehicle-${skygcs.store.state.names.indexOf(name) + 1}`"
    dot = f"(name => count(screen(...placeOf(name))[0], {up}, 6, {colour}))"
    until(page, on_canvas(f"{dot}('v1') > 20 && {dot}('v2') > 20"))
    page.get_by_role("button", name="Fit").click()
    until(page, on_canvas(f"{dot}('v3') > 20"))  # it is on the ground
    until(page, on_canvas("placeOf('v1')[2] > 5 && skygcs.view.sideTopM < 25"))
    assert page.evaluate("skygcs.view.figures.faults") == 0
    fly_to(station, page, "v2", 25.0, 20.0, 8.0)
    until(page, "skygcs.store.state.vehicles.get('v1').separation === null")
    page.evaluate("skygcs.view.camera = {...skygcs.view.camera, x: 0, y: 20, pxPerM: 20}; skygcs.view.redraw()")
    until(page, on_canvas("count(...screen(0.75, 20), 20, 'danger') + count(...screen(0.75, 20), 20, 'warning') < 5"))


@pytest.mark.parametrize("theme", ["dark", "light"])
@pytest.mark.parametrize("width", [1600, 390])
def test_arrows_point_to_vehicles_off_the_screen(station, open_page, shot, width: int, theme: str) -> None:
    piece = {"duration_s": 10.0, "x": [-25.0, 5.5], "y": [5.0, 4.0], "up": [60.0]}
    for name in ("v1", "v2"):
        shifted = {**piece, "y": [5.0 + 12.0 * (name == "v2"), 4.0]}
        assert station.call("trajectory.load", target=name, pieces=[shifted], name="high")["outcomes"][name]["ok"]
    page = open_page(station, width=width, height=844, theme=theme, touch=width < 500)
    if width < 500:
        page.get_by_role("navigation", name="Panes").get_by_role("button", name="View", exact=True).click()
    until(page, "[...skygcs.store.state.vehicles.values()].every(v => v.position?.enu_m)")
    until(page, "skygcs.view.overlays.has('planned paths') && skygcs.view.figures.frames > 3")
    page.get_by_role("button", name="Fit").click()
    until(page, "skygcs.view.sideTopM > 60")  # the strip has room for the plan, not for the vehicles alone
    until(
        page,
        on_canvas("count(...screen(2.5, 25), 14, 'vehicle-1') > 4 && count(...screen(2.5, 37), 14, 'vehicle-2') > 4"),
    )
    assert page.evaluate("skygcs.view.arrows.length") == 0
    shot(page, f"view-plan-{width}-{theme}")
    page.evaluate("skygcs.view.pan(0, 0); skygcs.view.camera = {...skygcs.view.camera, x: 4000, y: 2500}")
    until(page, "skygcs.view.arrows.length > 0")
    arrow = "skygcs.view.arrows[0]"
    until(page, f"{arrow}.names.length === 3")
    until(page, on_canvas(f"count({arrow}.xPx, {arrow}.yPx, 9, 'vehicle-1') > 40"))
    assert fits(page)
    shot(page, f"view-arrows-{width}-{theme}")
    box = page.locator(VIEW).bounding_box()
    assert box is not None
    x, y = page.evaluate(f"[{arrow}.xPx, {arrow}.yPx]")
    page.mouse.click(box["x"] + x, box["y"] + y)
    until(page, on_canvas("Math.hypot(c.x - placeOf('v1')[0], c.y - placeOf('v1')[1]) < 3"))
    assert page.evaluate("skygcs.view.figures.faults") == 0
    station.call("trajectory.unload", targets="v1,v2")
