"""Missions and fences in the browser: files and drawings, their checks, the upload, and the flight."""

from __future__ import annotations

import json
import re

import pytest
from playwright.sync_api import WebSocketRoute, expect

from support.browser import until
from support.page_steps import VIEW, HeldAnswers, click_view, drop, fits, hold, select, side

WPL = """QGC WPL 110
0\t1\t0\t16\t0\t0\t0\t0\t43.7806\t-79.4653\t180\t1
1\t0\t3\t22\t0\t0\t0\t0\t43.7806\t-79.4653\t10\t1
2\t0\t3\t16\t0\t0\t0\t0\t43.78085\t-79.4650\t12\t1
3\t0\t3\t16\t0\t0\t0\t0\t43.7809\t-79.4655\t12\t1
4\t0\t3\t20\t0\t0\t0\t0\t0\t0\t0\t1
"""
TOO_HIGH = WPL.replace("-79.4655\t12", "-79.4655\t900")


def test_a_dropped_mission_is_checked_drawn_uploaded_and_flown(station, open_page, shot) -> None:
    page = open_page(station)
    select(page, "v1", "v2")
    side(page, "Missions")
    drop(page, "survey.waypoints", WPL)
    check = page.get_by_role("region", name="Check of survey.waypoints")
    expect(check).to_contain_text("can be flown")
    expect(check).to_contain_text("4 mission items")
    page.get_by_role("button", name="Fit").click()
    check.get_by_role("button", name="Upload to v1 and v2").click()
    board = page.get_by_role("region", name="On board")
    expect(board.get_by_role("row", name=re.compile("v1"))).to_contain_text("4")
    for name in ("v1", "v2"):
        status = station.call("missions.status", targets=name)[0]
        assert status["counts"]["mission"] == 4
    shot(page, "mission-uploaded")
    # one of them flies it
    select(page, "v1")
    hold(page, board.get_by_role("button", name=re.compile("Start the mission of v1: arms")))
    # a PX4 reports the item, not the state of its mission
    item = board.get_by_role("row", name=re.compile("v1")).locator("td").nth(2)
    expect(item).to_have_text(re.compile("^[234]$"))
    shot(page, "mission-flown")
    board.get_by_role("button", name="Pause", exact=True).click()
    expect(page.get_by_role("log", name="Orders")).to_contain_text("Pause mission")
    station.call("vehicles.land", targets="v1")
    assert not page.errors


def test_a_refused_mission_names_the_item_and_is_not_uploaded(station, open_page, shot) -> None:
    page = open_page(station)
    select(page, "v2")
    side(page, "Missions")
    drop(page, "high.waypoints", TOO_HIGH)
    check = page.get_by_role("region", name="Check of high.waypoints")
    expect(check).to_contain_text("refused")
    expect(check).to_contain_text("mission item 3")
    expect(check.get_by_role("button", name="Upload to v2")).to_be_disabled()
    shot(page, "mission-refused")
    drop(page, "not-a-plan.plan", '{"fileType": "Song"}')
    expect(page.locator(".missionpanel .failure").first).to_contain_text("not-a-plan.plan")


def test_a_check_that_ends_after_its_tab_was_left_offers_no_upload(station, open_page) -> None:
    page = open_page(station)
    held = HeldAnswers(page, "web.mission.check")
    page.reload()
    select(page, "v1")
    side(page, "Missions")
    drop(page, "survey.waypoints", WPL)
    held.wait()
    page.get_by_role("tab", name="Waypoints", exact=True).click()
    held.release()
    page.wait_for_timeout(300)
    expect(page.get_by_role("region", name="Check of survey.waypoints")).to_have_count(0)
    page.get_by_role("tab", name="File", exact=True).click()
    held.wait()
    held.release()
    expect(page.get_by_role("region", name="Check of survey.waypoints")).to_contain_text("can be flown")
    assert not page.errors


def test_waypoints_are_drawn_moved_and_uploaded(station, open_page, shot) -> None:
    page = open_page(station)
    select(page, "v2")
    side(page, "Missions")
    page.get_by_role("tab", name="Waypoints", exact=True).click()
    # the view is fitted anew with each further vehicle that has a place: a point would be elsewhere on the screen then
    until(page, "skygcs.view.scene.bodies.length === 3")
    page.wait_for_timeout(500)
    page.get_by_role("button", name="Fit").click()
    click_view(page, (0.3, 0.35), (0.6, 0.35), (0.6, 0.6))
    expect(page.get_by_role("list", name="Points").locator("li")).to_have_count(3)
    check = page.get_by_role("region", name="Check of drawn.plan")
    expect(check).to_contain_text("5 mission items")
    points = page.evaluate("[...document.querySelectorAll('.points li .link')].map(e => e.textContent)")
    box = page.locator(VIEW).bounding_box()
    page.mouse.move(box["x"] + 0.6 * box["width"], box["y"] + 0.6 * box["height"])
    page.mouse.down()
    page.mouse.move(box["x"] + 0.5 * box["width"], box["y"] + 0.7 * box["height"], steps=5)
    page.mouse.up()
    moved = page.evaluate("[...document.querySelectorAll('.points li .link')].map(e => e.textContent)")
    assert moved[:2] == points[:2] and moved[2] != points[2]
    shot(page, "mission-drawn")
    check.get_by_role("button", name="Upload to v2").click()
    expect(page.get_by_role("log", name="Orders")).to_contain_text("5 mission items taken")
    page.keyboard.press("Escape")
    page.get_by_role("button", name="Draw on").click()
    assert not page.errors


def test_drawn_waypoints_keep_their_places_on_earth_in_another_frame(station, open_page, shot) -> None:
    page = open_page(station)
    select(page, "v2")
    side(page, "Missions")
    page.get_by_role("tab", name="Waypoints", exact=True).click()
    page.get_by_role("button", name="Fit").click()
    click_view(page, (0.35, 0.35), (0.6, 0.55))
    expect(page.get_by_role("region", name="Check of drawn.plan")).to_contain_text("can be flown")
    drawn = "skygcs.view.overlays.get('mission').shapes[0].points"
    clicked = page.evaluate(f"{drawn}.map(([x, y]) => Object.values(skygcs.view.geodeticOf(x, y)))")
    before = page.evaluate(drawn)
    origin = station.call("origin.get")["origin"]
    kept = {key: origin[key] for key in ("lat_deg", "lon_deg", "alt_amsl_m", "x_heading_deg")}
    try:
        station.call("origin.set", **(kept | {"lat_deg": kept["lat_deg"] + 2e-4, "x_heading_deg": 60.0}))
        until(page, "skygcs.view.frame?.x_heading_deg === 60")
        expect(page.locator(".missionpanel > .note[role=status]")).to_contain_text("kept its places on earth")
        assert all(abs(a - b) > 1 for a, b in zip(before[0][:2], page.evaluate(drawn)[0][:2], strict=True))
        shot(page, "mission-other-frame")
        page.get_by_role("button", name="Upload to v2").click()
        expect(page.get_by_role("log", name="Orders")).to_contain_text("mission items taken")
        plan = json.loads(station.call("missions.download", target="v2")["plan"])
        flown = [item["params"][4:6] for item in plan["mission"]["items"] if item["command"] == 16]
        assert flown == [pytest.approx(place, abs=2e-7) for place in clicked]  # two centimetres
        page.get_by_role("button", name="Clear the drawing").click()
        expect(page.locator(".missionpanel > .note[role=status]")).to_have_count(0)
    finally:
        station.call("origin.set", **kept)
    assert not page.errors


def test_nothing_is_drawn_or_uploaded_in_another_frame_while_the_new_origin_is_refused(station, open_page) -> None:
    """The positions are metres of the new frame at once; the page knows where they are when origin.get is answered."""
    page = open_page(station)
    refused: list[int] = []
    refusing = False

    def between(socket: WebSocketRoute) -> None:
        server = socket.connect_to_server()

        def to_server(message: str | bytes) -> None:
            request = json.loads(message)
            if refusing and request.get("method") == "origin.get":
                refused.append(request["id"])
                error = {"code": -32003, "message": "too many requests"}
                socket.send(json.dumps({"jsonrpc": "2.0", "id": request["id"], "error": error}))
            else:
                server.send(message)

        socket.on_message(to_server)

    page.route_web_socket(re.compile("/ws$"), between)
    page.reload()
    select(page, "v2")
    side(page, "Missions")
    page.get_by_role("tab", name="Waypoints", exact=True).click()
    page.get_by_role("button", name="Fit").click()
    click_view(page, (0.35, 0.35), (0.6, 0.55))
    check = page.get_by_role("region", name="Check of drawn.plan")
    expect(check).to_contain_text("can be flown")
    drawn = "skygcs.view.overlays.get('mission').shapes[0].points"
    places = page.evaluate(f"{drawn}.map(([x, y]) => Object.values(skygcs.view.geodeticOf(x, y)))")
    note = page.locator(".missionpanel > .note[role=status]")
    origin = station.call("origin.get")["origin"]
    kept = {key: origin[key] for key in ("lat_deg", "lon_deg", "alt_amsl_m", "x_heading_deg")}
    refusing = True
    try:
        station.call("origin.set", **(kept | {"lat_deg": kept["lat_deg"] + 1e-3}))
        expect(note).to_contain_text("no place can be chosen, drawn or uploaded")
        expect(check).to_have_count(0)
        click_view(page, (0.5, 0.5))
        expect(page.get_by_role("list", name="Points")).to_have_count(0)
        assert page.evaluate("skygcs.view.geodeticOf(1, 2)") is None
        refusing = False
        expect(note).to_contain_text("kept its places on earth")
        expect(check).to_contain_text("can be flown")
        carried = page.evaluate(f"{drawn}.map(([x, y]) => Object.values(skygcs.view.geodeticOf(x, y)))")
        assert carried == [pytest.approx(place, abs=1e-8) for place in places]  # a millimetre
        assert 1 <= len(refused) <= 60
        page.get_by_role("button", name="Clear the drawing").click()
    finally:
        station.call("origin.set", **kept)


@pytest.mark.parametrize("theme", ["dark", "light"])
def test_a_drawn_fence_is_checked_and_uploaded(station, open_page, shot, theme) -> None:
    page = open_page(station, theme=theme)
    select(page, "v3")
    side(page, "Missions")
    page.get_by_role("tab", name="Fence", exact=True).click()
    click_view(page, (0.1, 0.15), (0.9, 0.15), (0.9, 0.6))
    check = page.get_by_role("region", name="Check of drawn.plan")
    expect(check).to_contain_text("1 fence polygon")
    # another corner: until it is checked, what was found of three corners cannot be uploaded
    click_view(page, (0.1, 0.6))
    expect(page.get_by_role("list", name="Points").locator("li")).to_have_count(4)
    expect(check).to_contain_text("can be flown")
    shot(page, f"fence-drawn-{theme}")
    check.get_by_role("button", name="Upload to v3").click()
    expect(page.get_by_role("region", name="On board").get_by_role("row", name=re.compile("v3"))).to_contain_text(
        re.compile(r"4$"), timeout=60_000
    )
    assert not page.errors


@pytest.mark.parametrize("theme", ["dark", "light"])
def test_missions_fit_a_phone(station, open_page, shot, theme) -> None:
    page = open_page(station, width=390, height=800, theme=theme, touch=True)
    select(page, "v1")
    side(page, "Missions", phone=True)
    drop(page, "survey.waypoints", WPL)
    expect(page.get_by_role("region", name="Check of survey.waypoints")).to_contain_text("can be flown")
    assert fits(page)
    shot(page, f"mission-phone-{theme}")


def test_the_fence_about_home_is_set_and_read_by_a_form(station, open_page, shot) -> None:
    page = open_page(station)
    select(page, "v1", "v3")
    side(page, "Missions")
    page.get_by_role("tab", name="About home", exact=True).click()
    button = page.get_by_role("button", name=re.compile("Set the fence of"))
    expect(button).to_be_disabled()
    page.get_by_label("Radius", exact=True).fill("80")
    page.get_by_label("Height", exact=True).fill("40")
    page.get_by_label("Outside of it").select_option("return")
    expect(button).to_have_accessible_name(
        re.compile("Set the fence of v1 and v3: radius 80 m, height 40 m, then return: hold down for a second$")
    )
    hold(page, button)
    fences = page.get_by_role("table", name="Fences about home")
    for name in ("v1", "v3"):
        expect(fences.get_by_role("row", name=re.compile(name))).to_contain_text("80 m")
    shot(page, "fence-about-home")
    found = station.call("fence.status", targets="v1,v3")["outcomes"]
    assert {(one["fence"]["radius_m"], one["fence"]["height_m"], one["fence"]["action"]) for one in found.values()} == {
        (80.0, 40.0, "return")
    }
    page.get_by_role("button", name="Read from the vehicles").click()
    expect(fences.get_by_role("row", name=re.compile("v3"))).to_contain_text("return")
    assert not page.errors
    station.call("fence.set", targets="v1,v3", action="none")
