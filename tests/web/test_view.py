"""The fleet view in a real browser: what is drawn where, pan, zoom, fit, follow, selection, and when it rests."""

from __future__ import annotations

import struct
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from playwright.sync_api import Page, expect

from support.browser import until
from support.page_steps import VIEW, VIEW_PEN
from support.web_station import WebStation

OpenPage = Callable[..., Page]
Shot = Callable[[Page, str], Path]

SCREEN_OF = """name => {
    const { view, store } = skygcs, [x, y] = store.state.vehicles.get(name).position.enu_m, c = view.camera;
    const box = document.querySelector('canvas').getBoundingClientRect();
    return [box.left + c.widthPx / 2 + (x - c.x) * c.pxPerM, box.top + c.heightPx / 2 - (y - c.y) * c.pxPerM];
}"""
"""Where a vehicle is on the screen, by the camera's definition."""


@pytest.fixture
def page(station: WebStation, open_page: OpenPage) -> Page:
    opened = open_page(station)
    expect(opened.locator("tr.row")).to_have_count(3)
    until(
        opened,
        "[...skygcs.store.state.vehicles.values()].every(v => v.position?.enu_m) && skygcs.view.figures.frames > 3",
    )
    opened.wait_for_timeout(500)  # the table has its height then, and the view its own
    return opened


def canvas_colour(page: Page, x: float, y: float) -> tuple[int, ...]:
    """The colour of one pixel of the fleet view; ``x``, ``y``: its place on the screen."""
    return tuple(
        page.evaluate(
            f"""([x, y]) => {{
                const canvas = document.querySelector('canvas'), box = canvas.getBoundingClientRect();
                const k = canvas.width / box.width;
                return [...{VIEW_PEN}.getImageData((x - box.left) * k, (y - box.top) * k, 1, 1).data];
            }}""",
            [x, y],
        )
    )


def test_vehicles_are_drawn_at_their_places_and_selected_by_a_click(page: Page, shot: Shot) -> None:
    for name in ("v1", "v2", "v3"):
        x, y = page.evaluate(SCREEN_OF, name)
        colours = {canvas_colour(page, x + dx, y + dy) for dx in range(-6, 7, 2) for dy in range(-6, 7, 2)}
        assert len(colours) > 2, name
    x, y = page.evaluate(SCREEN_OF, "v2")
    page.mouse.click(x, y)
    expect(page.locator("tr.row[aria-selected=true]")).to_have_attribute("data-name", "v2")
    page.locator("tr.row[data-name=v3]").click()
    until(page, "[...skygcs.store.state.selection].join() === 'v3'")
    shot(page, "view-selected")
    page.mouse.click(x, y - 120)  # where nothing is
    expect(page.locator("tr.row[aria-selected=true]")).to_have_count(0)
    assert page.errors == []  # type: ignore[attr-defined]


def test_pan_zoom_fit_and_follow_by_mouse_and_keyboard(page: Page) -> None:
    camera = "(({x, y, pxPerM}) => ({x, y, pxPerM}))(skygcs.view.camera)"
    before = page.evaluate(camera)
    page.mouse.move(500, 200)
    place = page.evaluate("skygcs.view.pointerAt(500, 200 - document.querySelector('canvas').offsetTop, false).x")
    page.mouse.wheel(0, -200)
    until(page, f"skygcs.view.camera.pxPerM > {before['pxPerM']}")
    after = page.evaluate("skygcs.view.pointerAt(500, 200 - document.querySelector('canvas').offsetTop, false).x")
    assert after == pytest.approx(place)
    zoomed = page.evaluate(camera)
    page.mouse.down()
    page.mouse.move(600, 260, steps=4)
    page.mouse.up()
    assert page.evaluate(camera)["x"] == pytest.approx(zoomed["x"] - 100 / zoomed["pxPerM"])
    page.keyboard.press("f")
    assert page.evaluate(camera) == pytest.approx(before)
    page.locator(VIEW).focus()
    page.keyboard.press("ArrowLeft")
    assert page.evaluate(camera)["x"] < before["x"]
    page.locator("tr.row[data-name=v1]").click()
    page.keyboard.press("c")
    expect(page.get_by_role("button", name="Follow")).to_have_attribute("aria-pressed", "true")
    until(page, "Math.abs(skygcs.view.camera.x - skygcs.store.state.vehicles.get('v1').position.enu_m[0]) < 0.5")


def test_the_view_stays_while_a_person_draws_on_it(page: Page) -> None:
    """What is drawn makes the panel higher and the canvas smaller; the view was fitted anew with each point."""
    place = "(({x, y, pxPerM}) => [x, y, pxPerM])(skygcs.view.camera)"
    page.evaluate("skygcs.view.setTool({cursor: 'crosshair', hint: 'Click points'})")
    before, height = page.evaluate(place), page.evaluate("skygcs.view.camera.heightPx")
    far = "{kind: 'path', ink: 'draft', points: [[0, 0, 0], [900, 900, 0]]}"
    page.evaluate(f"skygcs.view.setOverlay('drawn', {{shapes: [{far}], fit: true}})")
    page.set_viewport_size({"width": 1600, "height": 700})
    until(page, f"skygcs.view.camera.heightPx !== {height}")
    frames = page.evaluate("skygcs.view.figures.frames")
    until(page, f"skygcs.view.figures.frames > {frames + 1}")
    assert page.evaluate(place) == before
    page.keyboard.press("Escape")
    page.set_viewport_size({"width": 1600, "height": 900})
    until(page, f"skygcs.view.camera.heightPx === {height}")
    assert page.evaluate(place) == before
    page.keyboard.press("f")
    until(page, f"skygcs.view.camera.pxPerM < {before[2]}")


def test_a_shape_is_drawn_with_the_next_frame_though_what_lies_beneath_is_kept(page: Page) -> None:
    page.wait_for_timeout(700)  # nothing is due on it
    x, y = page.evaluate(SCREEN_OF, "v1")
    before = canvas_colour(page, x + 60, y + 60)
    page.evaluate(
        """async () => {
            const { view, store } = skygcs, [x, y] = store.state.vehicles.get('v1').position.enu_m;
            const by = 60 / view.camera.pxPerM, points = [[x + by, y - by, 0], [x + 2 * by, y - by, 0]];
            view.setOverlay('line', {shapes: [{kind: 'path', ink: 'danger', widthPx: 9, points}]});
            await new Promise(done => requestAnimationFrame(() => requestAnimationFrame(done)));
        }"""
    )
    drawn = canvas_colour(page, x + 62, y + 60)
    assert drawn[0] > 1.5 * drawn[2], (before, drawn)
    page.evaluate("skygcs.view.setOverlay('line', null)")
    until(page, f"skygcs.view.figures.frames > {page.evaluate('skygcs.view.figures.frames') + 1}")
    assert canvas_colour(page, x + 62, y + 60) != drawn


def test_a_rectangle_selects_with_shift_and_escape_selects_nothing(page: Page) -> None:
    box = page.locator(VIEW).bounding_box()
    assert box is not None
    page.keyboard.down("Shift")
    page.mouse.move(box["x"] + 5, box["y"] + 60)
    page.mouse.down()
    page.mouse.move(box["x"] + box["width"] - 5, box["y"] + box["height"] - 130, steps=5)
    page.mouse.up()
    page.keyboard.up("Shift")
    expect(page.locator("tr.row[aria-selected=true]")).to_have_count(3)
    page.keyboard.press("Escape")
    expect(page.locator("tr.row[aria-selected=true]")).to_have_count(0)


def test_layers_are_switched_and_remembered(page: Page) -> None:
    heights = page.get_by_role("button", name="Heights")
    plan = page.evaluate("skygcs.view.camera.heightPx")
    heights.click()
    expect(heights).to_have_attribute("aria-pressed", "false")
    assert page.evaluate("skygcs.view.camera.heightPx") == plan + 120
    page.reload()
    expect(page.get_by_role("button", name="Heights")).to_have_attribute("aria-pressed", "false")


def test_two_canvases_and_no_element_for_each_vehicle(page: Page) -> None:
    assert page.locator("canvas").count() == 2
    assert page.locator(".viewpane *").count() < 40


def test_flown_paths_are_drawn_and_bounded(station: WebStation, page: Page, shot: Shot) -> None:
    taken_off = station.call("vehicles.takeoff", targets="v1", height_m=8, wait_s=60)
    assert taken_off["outcomes"]["v1"]["ok"], taken_off
    until(page, "skygcs.store.state.vehicles.get('v1').position.alt_rel_m > 7")
    assert station.call("vehicles.goto", targets="v1", enu_m=[15, 25, 8])["outcomes"]["v1"]["ok"]
    until(page, "skygcs.store.trails.byName.get('v1')?.length > 20")
    page.keyboard.press("f")
    page.wait_for_timeout(600)
    shot(page, "view-trail")
    assert page.evaluate("skygcs.view.figures.faults") == 0
    station.call("vehicles.rtl", targets="v1")


def png(width: int, height: int, colour: tuple[int, int, int]) -> bytes:
    """One colour, as a picture."""

    def chunk(kind: bytes, data: bytes) -> bytes:
        body = kind + data
        return struct.pack(">I", len(data)) + body + struct.pack(">I", zlib.crc32(body))

    row = b"\0" + bytes(colour) * width
    header = struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0)
    return (
        b"\x89PNG\r\n\x1a\n"
        + chunk(b"IHDR", header)
        + chunk(b"IDAT", zlib.compress(row * height))
        + chunk(b"IEND", b"")
    )


def test_a_map_that_two_points_pin_lies_beneath(
    make_station: Callable[..., WebStation], open_page: OpenPage, tmp_path: Path, shot: Shot
) -> None:
    picture = tmp_path / "field.png"
    picture.write_bytes(png(400, 400, (40, 90, 40)))
    pins = ("--map-point", "0,0,43.7815,-79.4665", "--map-point", "400,400,43.7797,-79.4641")
    station = make_station((1, 0), web=("--map", str(picture), *pins))
    page = open_page(station)
    until(page, "skygcs.view.figures.frames > 3")
    page.wait_for_timeout(500)
    colours: dict[Any, int] = {}
    for x in range(300, 700, 7):
        colour = canvas_colour(page, x, 350)
        colours[colour] = colours.get(colour, 0) + 1
    commonest = max(colours, key=lambda c: colours[c])
    assert commonest[1] > commonest[0] + 20 and commonest[1] > commonest[2] + 20, colours
    shot(page, "view-map")
    page.get_by_role("button", name="Map").click()
    page.wait_for_timeout(300)
    assert canvas_colour(page, 303, 353)[1] < 60


def test_nothing_is_drawn_while_nothing_changes(
    make_station: Callable[..., WebStation], open_page: OpenPage, shot: Shot
) -> None:
    """Without a daemon no state comes; the page says so, ages go on, and the canvas rests."""
    station = make_station((1, 0))
    page = open_page(station)
    expect(page.locator("tr.row[data-heard=true]")).to_have_count(1)
    station.stop_daemon()
    expect(page.locator(".banner.danger")).to_contain_text("No daemon")
    expect(page.locator("tr.row[data-heard=false]")).to_have_count(1)
    until(page, "skygcs.view.scene.bodies.every(body => !body.heard)")  # on the canvas, too, and then it rests
    page.wait_for_timeout(1500)
    before = page.evaluate("skygcs.view.figures.frames")
    page.wait_for_timeout(2000)
    assert page.evaluate("skygcs.view.figures.frames") - before <= 4
    shot(page, "view-no-daemon")


def test_a_selection_by_a_key_is_answered_before_the_canvas_is_drawn(page: Page) -> None:
    """Orders and table have it at once, the canvas with the next frame of the screen."""
    drawn, selected, marked = page.evaluate(
        """async () => {
            const { view, store } = skygcs, before = view.figures.frames;
            dispatchEvent(new KeyboardEvent('keydown', {key: 'a', ctrlKey: true, bubbles: true, cancelable: true}));
            const drawn = view.figures.frames - before, selected = store.state.selection.size;
            await new Promise(done => requestAnimationFrame(() => requestAnimationFrame(done)));
            return [drawn, selected, view.scene.bodies.filter(body => body.selected).length];
        }"""
    )
    assert (drawn, selected, marked) == (0, 3, 3)


def test_no_frame_of_the_screen_is_drawn_twice_when_a_state_comes_after_a_hand_has_moved_the_view(page: Page) -> None:
    counts = page.evaluate(
        """async () => {
            const { view, store } = skygcs, counts = new Map();
            let frames = view.figures.frames;
            Object.defineProperty(view.figures, 'frames', {
                get: () => frames,
                set: value => {
                    const at = document.timeline.currentTime;
                    counts.set(at, (counts.get(at) ?? 0) + value - frames);
                    frames = value;
                },
            });
            for (let i = 0; i < 30; i++) {
                await new Promise(done => setTimeout(done, 20));
                view.zoom(i % 2 ? 1.1 : 1 / 1.1);
                store.dispatch({type: 'search', search: ''});
            }
            await new Promise(done => requestAnimationFrame(() => requestAnimationFrame(done)));
            return [...counts.values()];
        }"""
    )
    assert len(counts) >= 10
    assert max(counts) == 1


@pytest.mark.parametrize(
    "missing",
    [
        "delete globalThis.OffscreenCanvas",
        "OffscreenCanvas.prototype.getContext = () => null",
    ],
)
def test_a_browser_whose_offscreen_canvas_draws_nothing_shows_vehicles_and_labels(page: Page, missing: str) -> None:
    page.add_init_script(missing)
    page.reload()
    expect(page.locator("tr.row")).to_have_count(3)
    until(page, "globalThis.skygcs?.view.scene.bodies.length === 3 && skygcs.view.placements.size === 3")
    page.wait_for_timeout(500)
    assert page.evaluate("skygcs.view.figures.faults") == 0
    pictures = page.evaluate(
        "[skygcs.view.labels, skygcs.view.sprites].flatMap(one => [...(one.sprites ?? one.sheets).values()])"
        ".map(({ picture }) => picture.constructor.name)"
    )
    assert len(pictures) > 3
    assert set(pictures) == {"HTMLCanvasElement"}
    for name in ("v1", "v2", "v3"):
        x, y = page.evaluate(SCREEN_OF, name)
        colours = {canvas_colour(page, x + dx, y + dy) for dx in range(-6, 7, 2) for dy in range(-6, 7, 2)}
        assert len(colours) > 2, name
        box, (dx, dy) = (
            page.locator(VIEW).bounding_box(),
            page.evaluate("name => [skygcs.view.placements.get(name).dx, skygcs.view.placements.get(name).dy]", name),
        )
        assert box is not None
        label = {canvas_colour(page, x + dx + i, y + dy + 8) for i in range(1, 20)}
        assert len(label) > 2, name
    assert not page.errors  # type: ignore[attr-defined]
