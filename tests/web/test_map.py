"""The fleet view's map and its room: offline tiles, the bar above the table, leader lines, a phone on its side."""

from __future__ import annotations

import math
import re
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from playwright.sync_api import Page, expect

from support.browser import until
from support.map_files import tile_at, tiles_about, write_mbtiles, write_pmtiles
from support.page_steps import IN_TROUBLE, VIEW_PEN, fits
from support.web_station import WebStation

OpenPage = Callable[..., Page]
Shot = Callable[[Page, str], Path]

ORIGIN = (43.7806, -79.4653)

PIXEL = (
    f"([lat, lon]) => {{ const pen = {VIEW_PEN};"
    + """
    const { view } = skygcs, c = view.camera, canvas = document.querySelector('.viewpane canvas');
    const RAD = Math.PI / 180, f = view.frame;
    // metres along the frame's axes, near enough for a tile of 40 m
    const north = (lat - f.lat_deg) * f.metresPerLatDeg, east = (lon - f.lon_deg) * f.metresPerLonDeg;
    const turn = (90 - f.x_heading_deg) * RAD;
    const x = east * Math.cos(turn) + north * Math.sin(turn), y = -east * Math.sin(turn) + north * Math.cos(turn);
    const ratio = canvas.width / canvas.getBoundingClientRect().width;
    const px = (c.widthPx / 2 + (x - c.x) * c.pxPerM) * ratio, py = (c.heightPx / 2 - (y - c.y) * c.pxPerM) * ratio;
    const { data } = pen.getImageData(px - 3, py - 3, 6, 6);
    const mean = k => Array.from({length: 36}, (_, i) => data[4 * i + k]).reduce((a, b) => a + b) / 36;
    return [mean(0), mean(1), mean(2)];
}"""
)
"""Colour of the canvas at a place on Earth."""

LOOK_AT = """zoom => {
    const { view } = skygcs;
    view.zoom(1);  // as by a hand: the view is not fitted to a vehicle that is drawn later
    view.camera = {...view.camera, x: 0, y: 0, pxPerM: zoom};
    view.redraw();
}"""


def centre(zoom: int, x: int, y: int) -> tuple[float, float]:
    """Latitude and longitude of a tile's middle."""
    lon_deg = ((x + 0.5) / 2**zoom - 0.5) * 360
    lat_deg = math.degrees(math.asin(math.tanh((0.5 - (y + 0.5) / 2**zoom) * math.tau)))
    return lat_deg, lon_deg


@pytest.fixture(scope="module")
def tile_files(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    folder = tmp_path_factory.mktemp("tiles")
    tiles = tiles_about(*ORIGIN, range(15, 20), 4)
    words = "© <a href='https://example.org'>Field</a> survey"
    return {
        "mbtiles": write_mbtiles(folder / "field.mbtiles", tiles, attribution=words),
        "pmtiles": write_pmtiles(folder / "field.pmtiles", tiles, attribution=words),
    }


def ready(page: Page, count: int = 3) -> None:
    until(page, f"[...skygcs.store.state.vehicles.values()].filter(v => v.position?.enu_m).length >= {count}")
    until(page, "skygcs.view.figures.frames > 3")


@pytest.mark.parametrize("kind", ["mbtiles", "pmtiles"])
def test_tiles_lie_where_they_belong_also_in_a_turned_frame(
    make_station: Callable[..., WebStation], open_page: OpenPage, shot: Shot, tile_files: dict[str, Path], kind: str
) -> None:
    station = make_station(web=("--tiles", str(tile_files[kind])))
    page = open_page(station)
    ready(page)
    for heading in (90.0, 37.0):
        station.call("origin.set", lat_deg=ORIGIN[0], lon_deg=ORIGIN[1], alt_amsl_m=180.0, x_heading_deg=heading)
        until(page, f"skygcs.view.frame?.x_heading_deg === {heading}")
        page.evaluate(LOOK_AT, 2.0)
        own = tile_at(*ORIGIN, 18)
        until(page, "[...skygcs.view.map.kept.values()].filter(k => k.picture).length > 12")
        page.wait_for_timeout(300)
        assert page.evaluate("skygcs.view.map.wanted[0].zoom") == 18
        for dx, dy, what in ((0, 0, "red"), (1, 0, "other"), (0, 1, "other"), (-1, 1, "same"), (-1, 0, "other")):
            red, green, blue = page.evaluate(PIXEL, list(centre(18, own[1] + dx, own[2] + dy)))
            is_red = red > 1.5 * green and red > 1.5 * blue
            assert is_red == (what == "red"), (heading, dx, dy, red, green, blue)
            if what != "red":
                even = (own[1] + dx + own[2] + dy) % 2 == 0
                assert (red > green) == even, (heading, dx, dy, red, green, blue)  # sand is redder than grass
        shot(page, f"map-{kind}-{heading:g}")
    # what it costs: bounded, and no request leaves the file's zooms
    for zoom in (0.3, 30.0, 300.0, 8.0):
        page.evaluate(LOOK_AT, zoom)
        page.wait_for_timeout(400)
        assert 15 <= page.evaluate("skygcs.view.map.wanted[0]?.zoom ?? 15") <= 19
    assert 0 < page.evaluate("skygcs.view.map.kept.keptPx") <= 24_000_000
    assert page.evaluate("skygcs.view.figures.faults") == 0
    page.get_by_role("button", name="Map", exact=True).click()
    until(page, "!skygcs.view.options.map")
    red, green, blue = page.evaluate(PIXEL, list(centre(19, *tile_at(*ORIGIN, 19)[1:])))
    assert abs(red - green) < 20, "the map is off"
    page.get_by_role("button", name="Map", exact=True).click()
    assert page.errors == []  # type: ignore[attr-defined]


@pytest.mark.parametrize("theme", ["dark", "light"])
@pytest.mark.parametrize(("width", "height"), [(1600, 900), (390, 844), (844, 390)])
def test_the_map_is_looked_at(
    make_station: Callable[..., WebStation],
    open_page: OpenPage,
    shot: Shot,
    tile_files: dict[str, Path],
    width: int,
    height: int,
    theme: str,
) -> None:
    page = open_page(
        make_station((6, 4), web=("--tiles", str(tile_files["mbtiles"]))),
        width=width,
        height=height,
        theme=theme,
        touch=width < 1000,
    )
    if width < 1000:  # a pane that is not shown draws nothing
        page.get_by_role("navigation", name="Panes").get_by_role("button", name="View", exact=True).click()
    ready(page, 10)
    page.wait_for_timeout(800)
    page.evaluate(IN_TROUBLE)
    page.get_by_role("button", name="Fit").click()
    page.wait_for_timeout(800)
    assert fits(page)
    shot(page, f"map-{width}-{theme}")


def test_tiles_need_a_cookie_and_nothing_else_is_served(
    make_station: Callable[..., WebStation], open_page: OpenPage, tile_files: dict[str, Path]
) -> None:
    page = open_page(make_station(None, web=("--tiles", str(tile_files["mbtiles"]))))
    until(page, "skygcs.store.state.hello?.tiles != null")
    base = page.evaluate("skygcs.store.state.hello.tiles.url")
    zoom, x, y = tile_at(*ORIGIN, 18)
    answers = {}
    for path in (
        f"{base}/{zoom}/{x}/{y}",
        f"{base}/{zoom}/0/0",
        f"{base}/3/99/0",
        f"{base}/../map",
        f"{base}/{zoom}/{x}/../../../etc/passwd",
        f"{base}/{zoom}/{x}/-1",
        f"{base}/{zoom}/{x}/{10**12}",
    ):
        answers[path.removeprefix(base)] = page.evaluate("path => fetch(path).then(a => a.status)", path)
    assert list(answers.values()) == [200, 204, 204, 404, 404, 404, 404], answers
    stranger = page.context.browser.new_context()  # type: ignore[union-attr]
    assert stranger.request.get(page.url.split("/?")[0].rstrip("/") + f"{base}/{zoom}/{x}/{y}").status == 403
    stranger.close()


def test_a_page_that_the_daemon_starts_says_why_it_has_no_map(
    make_station: Callable[..., WebStation], open_page: OpenPage, tmp_path: Path
) -> None:
    bad = tmp_path / "field.mbtiles"
    bad.write_bytes(b"no tiles")
    station = make_station()
    assert station.web_process is not None
    station.stop_web()
    station._web = ("--tiles", str(bad))
    with pytest.raises(AssertionError, match=re.escape(f"web.tiles {bad}: is neither MBTiles nor PMTiles")):
        station.start_web()  # a person sees it at once
    assert "Traceback" not in station.logs()
    shutil.copy(bad, station.folder / "field.mbtiles")
    text = station.fleet_file.read_text()
    station.stop_daemon()
    station.web_process = None  # it has ended
    port = station.port + 1
    station.fleet_file.write_text(f'{text}\n[web]\nport = {port}\ntiles = "field.mbtiles"\n')
    station.port = port
    station.start_daemon()
    station._wait("web page", lambda: station.address("command"))
    page = open_page(station)
    ready(page)
    page.get_by_role("button", name="No map").click()
    expect(page.locator(".viewbuttons [role=status]")).to_have_text(
        f"web.tiles {station.folder / 'field.mbtiles'}: is neither MBTiles nor PMTiles"
    )


# -- the bar between view and table


def share(page: Page) -> float:
    found: float = page.evaluate(
        "() => 100 * document.querySelector('.tablepane').clientHeight / document.querySelector('.fleet').clientHeight"
    )
    return found


def test_the_bar_is_dragged_moved_by_keys_and_kept(station: WebStation, open_page: OpenPage, shot: Shot) -> None:
    page = open_page(station)
    ready(page)
    bar = page.get_by_role("separator", name="Height of the table")
    rows = share(page)
    assert rows < 45
    until(page, f"document.querySelector('.splitter').getAttribute('aria-valuenow') == {round(rows)}")
    box = bar.bounding_box()
    assert box is not None
    page.mouse.move(box["x"] + 300, box["y"] + 3)
    page.mouse.down()
    page.mouse.move(box["x"] + 300, 300, steps=4)
    page.mouse.up()
    dragged = share(page)
    assert dragged == pytest.approx(100 * (900 - 300) / (900 - 52), abs=2)
    expect(bar).to_have_attribute("aria-valuenow", str(round(dragged)))
    shot(page, "splitter-dragged")
    bar.focus()
    page.keyboard.press("ArrowDown")
    until(page, f"document.querySelector('.splitter').getAttribute('aria-valuenow') < {round(dragged)}")
    assert share(page) == pytest.approx(dragged - 4, abs=1)
    page.keyboard.press("Home")
    expect(bar).to_have_attribute("aria-valuenow", "10")
    page.keyboard.press("End")
    expect(bar).to_have_attribute("aria-valuenow", "80")
    page.reload()
    ready(page)
    assert share(page) == pytest.approx(80, abs=1)  # kept by this browser
    camera = page.evaluate("skygcs.view.camera.heightPx")
    bar.dblclick()
    until(page, f"skygcs.view.camera.heightPx > {camera} + 100")
    assert share(page) == pytest.approx(rows, abs=1)
    page.reload()
    ready(page)
    assert share(page) == pytest.approx(rows, abs=1)
    assert page.errors == []  # type: ignore[attr-defined]


def test_the_bar_is_dragged_by_a_finger(station: WebStation, open_page: OpenPage) -> None:
    page = open_page(station, width=1024, height=768, touch=True)
    ready(page)
    box = page.get_by_role("separator").bounding_box()
    assert box is not None and box["height"] >= 15
    client = page.context.new_cdp_session(page)

    def touch(kind: str, *ys: float) -> None:
        points = [{"x": 200.0, "y": y} for y in ys]
        client.send("Input.dispatchTouchEvent", {"type": kind, "touchPoints": points})

    # a finger beside it reaches it, too
    touch("touchStart", box["y"] - 8)
    for y in (500.0, 400.0, 350.0):
        touch("touchMove", y)
    touch("touchEnd")
    until(page, "document.querySelector('.splitter').dataset.dragged === 'false'")
    assert share(page) == pytest.approx(100 * (768 - 350) / (768 - 52), abs=3)


# -- labels, and a phone on its side


def test_a_crowd_has_names_with_lines_to_them(
    make_station: Callable[..., WebStation], open_page: OpenPage, shot: Shot
) -> None:
    page = open_page(make_station((10, 6)))
    ready(page, 16)
    page.evaluate(
        "skygcs.view.camera = {...skygcs.view.camera, pxPerM: 4}; skygcs.view.moved = true; skygcs.view.redraw()"
    )
    until(  # one that is heard late on a busy machine is in trouble for that moment, and says more
        page,
        "skygcs.view.placements.size >= 14 && [...skygcs.view.placements.values()].every(p => !p.full)"
        " && [...skygcs.view.placements.values()].filter(p => p.led).length >= 4",
    )
    shot(page, "labels-crowd")
    page.evaluate("skygcs.store.dispatch({type: 'select', names: ['v6'], how: 'only'})")
    until(page, "skygcs.view.placements.get('v6')?.full")  # one that a person chose says more
    page.evaluate("skygcs.view.camera = {...skygcs.view.camera, pxPerM: 40}; skygcs.view.redraw()")
    until(page, "[...skygcs.view.placements.values()].every(p => p.full && !p.led)")
    assert page.evaluate("skygcs.view.figures.faults") == 0


SMALL = """least => [...document.querySelectorAll('button, select, input, summary, tr.row')]
    .filter(e => e.getClientRects().length && !e.closest('[hidden]'))
    .map(e => [e, (e.closest('label.check') ?? e).getBoundingClientRect()])
    .filter(([, box]) => box.height < least - 0.5 || box.width < least - 0.5)
    .map(([e, box]) => `${e.className || e.tagName} ${e.textContent.slice(0, 20)} ${box.width}x${box.height}`)"""


@pytest.mark.parametrize("theme", ["dark", "light"])
def test_a_phone_on_its_side_has_the_view_beside_one_pane(
    station: WebStation, open_page: OpenPage, shot: Shot, theme: str
) -> None:
    page = open_page(station, width=844, height=390, touch=True, theme=theme)
    ready(page)
    panes = page.get_by_role("navigation", name="Panes")
    for pane, inside in (("Table", ".tablepane"), ("Orders", ".sidepane"), ("Vehicle", ".sidepane"), ("View", None)):
        panes.get_by_role("button", name=pane, exact=True).tap()
        page.wait_for_timeout(300)
        boxes: dict[str, Any] = page.evaluate(
            """() => Object.fromEntries(['.viewpane', '.tablepane', '.sidepane', '.bottom', '.stop'].map(s => {
                const { left, right, top, bottom, width, height } = document.querySelector(s).getBoundingClientRect();
                return [s, { left, right, top, bottom, width, height }];
            }))"""
        )
        view = boxes[".viewpane"]
        assert view["height"] >= 240 and view["width"] >= (840 if inside is None else 380), (pane, view)
        if inside is not None:
            assert boxes[inside]["left"] >= view["right"] - 1 and boxes[inside]["width"] >= 300, (pane, boxes[inside])
            assert boxes[inside]["bottom"] <= boxes[".bottom"]["top"] + 1
        assert boxes[".bottom"]["bottom"] <= 391 and boxes[".stop"]["right"] <= 844
        assert fits(page)
        assert page.evaluate(SMALL, 44) == [], pane
        shot(page, f"landscape-{pane.lower()}-{theme}")
    page.evaluate(IN_TROUBLE)
    expect(page.locator(".pill").first).to_be_visible()
    panes.get_by_role("button", name="Orders", exact=True).tap()
    page.evaluate("skygcs.store.dispatch({type: 'select', names: ['v1', 'v2'], how: 'only'})")
    assert fits(page)
    shot(page, f"landscape-trouble-{theme}")
    # an order is given beside the view that shows what it does
    page.get_by_role("button", name="Stop all vehicles").tap()
    expect(page.locator(".stopboard")).to_contain_text("STOP")
    assert fits(page)
    shot(page, f"landscape-stop-{theme}")
    assert page.errors == []  # type: ignore[attr-defined]
