"""Plans in the browser: certificate, timeline, formation, final positions, and the flight by the daemon."""

from __future__ import annotations

import json
import re

import pytest
from playwright.sync_api import WebSocketRoute, expect

from support.browser import until
from support.page_steps import HeldAnswers, click_view, fits, hold, select, side

CROSSING = "vehicle,t,x,y,z,yaw\nv1,0,-20,0,10,0\nv1,20,20,0,10,0\nv2,0,0,-20,10,0\nv2,20,0,20,10,0\n"


def test_a_plan_whose_vehicles_meet_is_refused_with_pair_and_time(station, open_page, shot) -> None:
    page = open_page(station)
    side(page, "Plans")
    page.locator(".planpanel input[type=file]").set_input_files(
        {"name": "crossing.csv", "mimeType": "text/csv", "buffer": CROSSING.encode()}
    )
    certificate = page.get_by_role("region", name="Certificate")
    expect(certificate).to_contain_text("refused")
    expect(certificate).to_contain_text(re.compile(r"v1 and v2 come within .* at 10\.\d s"))
    certificate.get_by_text("Terms of the margin").click()
    expect(certificate).to_contain_text("half wingspan")
    timeline = page.get_by_role("region", name="Timeline of the plan")
    timeline.get_by_label("Time of the plan").evaluate(
        "bar => { bar.value = 10; bar.dispatchEvent(new Event('input', {bubbles: true})); }"
    )
    expect(timeline).to_contain_text("10.0 of 20.0 s")
    expect(timeline).to_contain_text(re.compile(r"v1 and v2, 0\.\d m"))
    page.get_by_role("button", name="Fit").click()
    shot(page, "plan-refused")
    # what cannot be read leaves what is shown
    large = {"name": "large.csv", "mimeType": "text/csv", "buffer": bytes(2_300_000)}
    page.locator(".planpanel input[type=file]").set_input_files(large)
    expect(page.get_by_role("tabpanel", name="Plans")).to_contain_text("large.csv: 2.3 MB; the page takes 2.2 MB")
    expect(certificate).to_contain_text("refused")
    assert not page.errors


def test_a_late_certificate_is_kept_for_its_panel_and_replaces_no_newer_plan(station, open_page) -> None:
    page = open_page(station)
    held = HeldAnswers(page, "web.plan.check", lambda params: "files" in params)
    page.reload()
    select(page, "v1", "v2", "v3")
    certificate = page.get_by_role("region", name="Certificate")
    crossing = {"name": "crossing.csv", "mimeType": "text/csv", "buffer": CROSSING.encode()}

    def open_crossing() -> None:
        side(page, "Plans")
        page.get_by_role("tab", name="File", exact=True).click()
        page.locator(".planpanel input[type=file]").set_input_files(crossing)
        until(page, "document.querySelector('.planpanel')?.textContent.includes('Certifying')")
        held.wait()

    open_crossing()
    side(page, "Orders")
    side(page, "Plans")
    expect(certificate).to_have_count(0)
    held.release()
    expect(certificate).to_contain_text("crossing")
    open_crossing()
    page.get_by_role("tab", name="Formation", exact=True).click()
    page.get_by_role("button", name="Plan for 3 vehicles").click()
    expect(certificate).to_contain_text("certified")
    held.release()
    page.wait_for_timeout(300)
    expect(certificate).to_contain_text("certified")
    assert not page.errors


@pytest.mark.parametrize("theme", ["dark", "light"])
def test_a_formation_is_planned_and_played(station, open_page, shot, theme) -> None:
    page = open_page(station, theme=theme)
    select(page, "v1", "v2", "v3")
    side(page, "Plans")
    page.get_by_role("tab", name="Formation", exact=True).click()
    page.get_by_label("Height", exact=True).fill("15")
    page.get_by_label("Middle x").fill("10")
    page.get_by_label("y", exact=True).fill("25")
    page.get_by_role("button", name="Plan for 3 vehicles").click()
    certificate = page.get_by_role("region", name="Certificate")
    expect(certificate).to_contain_text("certified")
    timeline = page.get_by_role("region", name="Timeline of the plan")
    timeline.get_by_label("Speed").select_option("10")
    timeline.get_by_role("button", name="Play the picture").click()
    expect(timeline.locator("output")).to_have_text(re.compile(r"^(\d+\.\d) of \1 s$"))
    page.get_by_role("button", name="Fit").click()
    shot(page, f"plan-formation-{theme}")
    assert not page.errors


def test_no_plan_is_made_for_some_of_the_selected_vehicles_while_one_has_no_position(station, open_page) -> None:
    page = open_page(station)
    hidden = {"v2"}

    def without_positions(message: str) -> str:
        found = json.loads(message)
        if found.get("method") == "web.state":
            for vehicle in found["params"]["vehicles"]:
                if vehicle["name"] in hidden:
                    vehicle["position"] = None
        return json.dumps(found)

    def connect(socket: WebSocketRoute) -> None:
        server = socket.connect_to_server()
        server.on_message(lambda message: socket.send(without_positions(message)))

    page.route_web_socket(re.compile(".*"), connect)
    page.reload()
    select(page, "v1", "v2")
    side(page, "Plans")
    page.get_by_role("tab", name="Formation", exact=True).click()
    panel = page.get_by_role("tabpanel", name="Plans")
    until(page, "skygcs.store.state.vehicles.get('v1')?.position?.enu_m")
    expect(panel).to_contain_text("No position yet: v2.")
    button = page.get_by_role("button", name="Plan for 2 vehicles")
    expect(button).to_be_disabled()
    hidden.clear()
    expect(button).to_be_enabled()
    expect(panel).not_to_contain_text("No position yet")
    assert not page.errors


def test_a_number_stays_as_it_is_typed_while_its_panel_is_drawn_again(station, open_page) -> None:
    page = open_page(station)
    select(page, "v1")
    side(page, "Plans")
    page.get_by_role("tab", name="Final positions", exact=True).click()
    height = page.get_by_label("Height of all")
    rows = page.locator(".planpanel table tbody tr")
    expect(rows).to_have_count(1)
    height.fill("")
    page.evaluate("skygcs.store.dispatch({type: 'select', names: ['v1', 'v2'], how: 'only'})")
    expect(rows).to_have_count(2)  # it was drawn again
    expect(height).to_have_value("")
    height.press_sequentially("12")
    expect(page.get_by_label("Height of v2")).to_have_value("12")
    height.fill("0.1")  # below the least
    height.blur()
    expect(height).to_have_value("12")


def test_final_positions_are_dragged_and_the_plan_is_flown(station, open_page, shot) -> None:
    page = open_page(station)
    select(page, "v1", "v2")
    side(page, "Plans")
    page.get_by_role("tab", name="Final positions", exact=True).click()
    page.get_by_label("Height of all").fill("10")
    rows = page.locator(".planpanel table tbody tr")
    expect(rows).to_have_count(2)
    before = rows.first.inner_text()
    # the first goal lies on its vehicle, which the view can say where
    at = page.evaluate(
        """() => { const place = skygcs.store.state.vehicles.get('v1').position.enu_m;
                   const box = document.querySelector('.viewpane canvas').getBoundingClientRect();
                   for (let x = 0; x < box.width; x += 2) for (let y = 0; y < box.height; y += 2) {
                     const p = skygcs.view?.pointerAt(x, y, false);
                     if (p && Math.hypot(p.x - place[0], p.y - place[1]) < p.reachM / 4) return [box.x + x, box.y + y];
                   } return null; }"""
    )
    assert at is not None
    page.mouse.move(*at)
    page.mouse.down()
    page.mouse.move(at[0] - 60, at[1] - 120, steps=6)
    page.mouse.up()
    assert rows.first.inner_text() != before
    page.get_by_role("button", name="Plan for 2 vehicles").click()
    expect(page.get_by_role("region", name="Certificate")).to_contain_text("certified")
    flight = page.get_by_role("region", name="Flight of the plan")
    flight.get_by_role("button", name="Check with the fleet").click()
    # both would return at one height: the report says so and offers others
    expect(flight).to_contain_text("RTL_RETURN_ALT")
    shot(page, "plan-report")
    hold(page, flight.get_by_role("button", name=re.compile("Set the return heights")))
    expect(flight).to_contain_text(re.compile("takeoff|engaging|to starts|flying"))
    expect(flight.get_by_role("button", name="Pause")).to_be_visible()
    # a plan is not landed while its vehicles take off
    expect(flight).to_contain_text(re.compile("planned: (to starts|flying)"))
    expect(flight.locator(".failure")).to_have_count(0)  # what it is doing is no failure
    shot(page, "plan-flown")
    until(page, "skygcs.store.dispatch({type: 'orderDismissed', id: 'ended'}), true")
    flight.get_by_role("button", name="Land", exact=True).click()
    expect(flight).to_contain_text(re.compile("landing|landed"))
    assert not page.errors


@pytest.mark.parametrize("theme", ["dark", "light"])
def test_plans_fit_a_phone(station, open_page, shot, theme) -> None:
    page = open_page(station, width=390, height=800, theme=theme, touch=True)
    select(page, "v1", "v2")
    side(page, "Plans", phone=True)
    page.get_by_role("tab", name="Formation", exact=True).click()
    expect(page.get_by_role("button", name="Plan for 2 vehicles")).to_be_visible()
    assert fits(page)
    shot(page, f"plan-phone-{theme}")


def test_a_click_puts_the_formation(station, open_page) -> None:
    page = open_page(station)
    select(page, "v1", "v2")
    side(page, "Plans")
    page.get_by_role("tab", name="Formation", exact=True).click()
    before = page.get_by_label("Middle x").input_value()
    click_view(page, (0.8, 0.3))
    expect(page.get_by_label("Middle x")).not_to_have_value(before)
    # the vehicles stay selected: a click that places is no click that selects
    assert page.evaluate("[...skygcs.store.state.selection].length") == 2


TABLE = """vehicle,initial_x,initial_y,initial_z,final_x,final_y,final_z
v1,0,0,10,0,20,10
2,5,0,10,15,20,12
nobody,1,1,1,2,2,2
"""


def test_a_table_of_positions_gives_the_goals_of_a_plan(station, open_page, shot) -> None:
    page = open_page(station)
    until(page, "skygcs.store.state.names.length === 3")
    side(page, "Plans")
    page.get_by_role("tab", name="Final positions", exact=True).click()
    chooser = page.locator(".planpanel .dropzone input[type=file]")
    chooser.set_input_files({"name": "places.csv", "mimeType": "text/csv", "buffer": TABLE.encode()})
    button = page.get_by_role("button", name="To the final positions")
    expect(button).to_be_visible()
    button.click()
    expect(page.locator("tr.row[aria-selected=true]")).to_have_count(2)
    expect(page.locator(".planpanel .failure").filter(has_text="nobody")).to_be_visible()
    # by the heights: a flight of the test before may have rows, too
    expect(page.get_by_role("row", name=re.compile("Height of v1"))).to_contain_text("0.0, 20.0")
    expect(page.get_by_role("row", name=re.compile("Height of v2"))).to_contain_text("15.0, 20.0")
    page.get_by_role("button", name="Plan for 2 vehicles").click()
    expect(page.get_by_role("region", name="Certificate")).to_contain_text("certified")
    shot(page, "plan-table")
    chooser.set_input_files({"name": "bad.csv", "mimeType": "text/csv", "buffer": b"a,b\n1,2\n"})
    expect(page.locator(".planpanel .failure").filter(has_text="bad.csv")).to_be_visible()
    assert not page.errors


def test_what_the_daemon_holds_is_drawn_whoever_gave_it(station, open_page, shot) -> None:
    page = open_page(station)
    until(page, "skygcs.store.state.plan?.state !== undefined")
    piece = {"duration_s": 10.0, "x": [0.0, 3.0], "y": [5.0, 0.0, 0.4], "up": [10.0]}
    assert station.call("trajectory.load", target="v1", pieces=[piece], name="curve")["outcomes"]["v1"]["ok"]
    until(page, "skygcs.view.overlays.get('planned paths')?.shapes.some(shape => shape.dashed)")
    page.keyboard.press("f")
    page.wait_for_timeout(300)
    shot(page, "planned-path")
    station.call("trajectory.unload", targets="v1")
    until(page, "!skygcs.view.overlays.has('planned paths')")
    assert not page.errors
