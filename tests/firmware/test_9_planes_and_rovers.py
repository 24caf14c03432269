"""Planes and a rover of real firmware, under a real daemon: what moves them, what holds them, what they refuse."""

from __future__ import annotations

import math
import time
from typing import Any

import pytest

from support.firmware_field import HOME, Field

PLANES = ("px4_plane", "ardupilot_plane")

TAKEOFF_M = 50.0
"""TKOFF_ALT of ArduPlane, to which alone it takes off."""

AWAY_M = 350.0


def away_m(field: Field, east_m: float, north_m: float) -> float:
    east, north, _ = field.enu(field.one)
    return math.hypot(east - east_m, north - north_m)


def param(field: Field, name: str) -> float:
    answers = field.daemon.call("params.get", targets=field.one, names=[name])["outcomes"][field.one]
    return float(answers[name]["value"])


def refusal(field: Field, method: str, **params: Any) -> str:
    """Why an order is refused, for which the vehicle got nothing."""
    outcome = field.daemon.call(method, targets=field.one, **params)["outcomes"][field.one]
    assert not outcome["ok"], outcome
    return str(outcome["message"])


def circle(field: Field, east_m: float, north_m: float, seconds: float) -> list[float]:
    """Distances from a place, two a second."""
    found: list[float] = []
    for _ in range(round(2 * seconds)):
        time.sleep(0.5)
        found.append(away_m(field, east_m, north_m))
    return found


LAP_S = 36.0
"""Longer than one circle of either plane: 80 m at 15 m/s, 93 m at 22 m/s."""


def lap(field: Field) -> tuple[tuple[float, float], float, float]:
    """The middle (east, north) of the circle that is flown, and its least and most radius, m. The middle is that of the
    box about it: where the plane was when it took the order is not known to a second, which are 22 m."""
    points = []
    for _ in range(round(4 * LAP_S)):
        time.sleep(0.25)
        points.append(field.enu(field.one)[:2])
    middle = tuple((min(axis) + max(axis)) / 2 for axis in zip(*points, strict=True))
    radii = [math.dist(point, middle) for point in points]
    return (middle[0], middle[1]), min(radii), max(radii)


@pytest.mark.only(*PLANES)
def test_a_plane_takes_off_goes_circles_holds_and_returns(field: Field, figures: dict[str, Any]) -> None:
    name, px4 = field.one, field.px4
    radius_m = {"px4_plane": 80.0, "ardupilot_plane": None}[field.firmware]
    if radius_m is None:
        radius_m = abs(param(field, "WP_LOITER_RAD"))
    height_m = TAKEOFF_M if px4 else param(field, "TKOFF_ALT")
    if not px4:
        field.wait(lambda: "not to 23 m" in refusal(field, "vehicles.takeoff", height_m=23), 30, "its height is known")
    assert "only copters hover at setpoints" in refusal(field, "control.set", mode="position", force=True)
    field.order("vehicles.takeoff", name, height_m=height_m, wait_s=120.0)
    figures["takeoff s"] = field.wait(lambda: field.truth(name).alt_rel_m > height_m - 5, 120, "it is up")
    assert "would fall" in refusal(field, "vehicles.disarm")
    # goto, and the circle at its end
    field.wait(lambda: field.truth(name).mode in ("LOITER", "TAKEOFF"), 60, "its take-off has ended")
    to = [0.0, AWAY_M, height_m + 20]
    field.order("vehicles.goto", name, enu_m=to)
    assert field.truth(name).mode == ("LOITER" if px4 else "GUIDED")
    figures["goto s"] = field.wait(lambda: away_m(field, 0, AWAY_M) < radius_m + 15, 120, "it circles there")
    time.sleep(25)
    ring = circle(field, 0, AWAY_M, 30)
    figures["radius"], figures["ring m"] = radius_m, (round(min(ring), 1), round(max(ring), 1))
    assert all(abs(value - radius_m) < 25 for value in ring), ring
    assert abs(field.truth(name).alt_rel_m - to[2]) < 10
    # hold: a circle about where it was, which the answer says
    before, began = field.enu(name)[:2], time.monotonic()
    outcome = field.order("vehicles.hold", name)[name]
    flown_m = field.truth(name).speed_mps * (time.monotonic() - began)
    assert f"circling in {'AUTO.' if px4 else ''}LOITER, {radius_m:g} m" in outcome["message"]
    time.sleep(30)
    middle, least_m, most_m = lap(field)
    figures["hold m"] = (round(least_m, 1), round(most_m, 1))
    figures["hold beside m"] = round(math.dist(middle, before), 1)
    assert radius_m - 25 < least_m and most_m < radius_m + 25 and field.truth(name).mode == "LOITER"
    assert math.dist(middle, before) < flown_m + 25
    # home
    field.order("vehicles.rtl", name)
    assert field.truth(name).mode == "RTL"
    figures["rtl s"] = field.wait(lambda: away_m(field, 0, 0) < radius_m + 20, 120, "it is back")


@pytest.mark.only("ardupilot_plane")
def test_an_arduplane_lands_by_a_mission_and_by_nothing_else(field: Field, figures: dict[str, Any]) -> None:
    name = field.one
    assert field.truth(name).armed and field.truth(name).alt_rel_m > 20
    outcome = field.daemon.call("vehicles.land", targets=name)["outcomes"][name]
    assert not outcome["ok"] and "landing sequence" in outcome["message"], outcome  # in its own words

    def item(command: int, north_m: float = 0.0, up_m: float = 0.0) -> str:
        lat = HOME[0] + north_m / 111_132.0 if north_m else 0.0
        return f"0\t3\t{command}\t0\t0\t0\t0\t{lat:.7f}\t{HOME[1] if north_m else 0.0:.7f}\t{up_m}\t1"

    home = f"0\t1\t0\t16\t0\t0\t0\t0\t{HOME[0]}\t{HOME[1]}\t{HOME[2]}\t1"
    items = [item(22, up_m=40), item(16, 500, 60), item(189), item(16, -800, 50), item(16, -500, 30), item(21, -50, 0)]
    lines = ["QGC WPL 110", home, *(f"{seq}\t{line}" for seq, line in enumerate(items, 1))]
    field.order("missions.upload", name, plan="\n".join(lines), force=True)
    field.order("vehicles.land", name)
    assert field.truth(name).mode == "AUTO"
    figures["landing s"] = field.wait(lambda: not field.truth(name).armed, 300, "it has landed and disarmed")
    figures["beside m"] = round(away_m(field, 0, -50), 1)


@pytest.mark.only("px4_plane")
def test_a_px4_plane_lands_ahead_of_where_it_is(field: Field, figures: dict[str, Any]) -> None:
    name = field.one
    field.order("vehicles.land", name)
    assert field.truth(name).mode == "LAND"
    figures["landing s"] = field.wait(lambda: not field.truth(name).armed, 300, "it has landed and disarmed")


@pytest.mark.only("rover")
def test_a_rover_goes_holds_where_it_stops_and_returns(field: Field, figures: dict[str, Any]) -> None:
    name = field.one
    assert "does not take off; goto or mission start moves it" in refusal(field, "vehicles.takeoff", height_m=5)
    assert "arm it first" in refusal(field, "vehicles.goto", enu_m=[20, 30, 0])
    field.order("vehicles.arm", name, wait_s=120.0)
    field.order("vehicles.goto", name, enu_m=[20, 60, 0])
    assert field.truth(name).mode == "GUIDED"
    field.wait(lambda: field.truth(name).speed_mps > 1.0, 30, "it drives")
    assert field.state(name)["landed"] == "on_ground"
    assert "only copters hover at setpoints" in refusal(field, "control.set", mode="position", force=True)
    field.order("vehicles.hold", name)
    assert field.truth(name).mode == "HOLD"
    figures["stop s"] = field.wait(lambda: field.truth(name).speed_mps < 0.1, 20, "it stands")
    stands = field.enu(name)
    time.sleep(5)
    assert math.dist(field.enu(name)[:2], stands[:2]) < 1.0
    field.order("vehicles.goto", name, enu_m=[20, 60, 0])
    figures["goto s"] = field.wait(
        lambda: away_m(field, 20, 60) < 4 and field.truth(name).speed_mps < 0.2, 90, "it is there and stands"
    )
    assert "does not land; hold or stop it" in refusal(field, "vehicles.land")
    field.order("vehicles.rtl", name)
    assert field.truth(name).mode == "RTL"
    figures["rtl s"] = field.wait(lambda: away_m(field, 0, 0) < 5, 120, "it is back")
    field.order("vehicles.disarm", name)
    field.wait(lambda: not field.truth(name).armed, 10, "it is disarmed")


@pytest.mark.only("px4_vtol", "quadplane")
def test_a_vtol_rises_on_its_rotors_holds_and_lands(field: Field, figures: dict[str, Any]) -> None:
    name, px4 = field.one, field.px4
    assert "only copters hover at setpoints" in refusal(field, "control.set", mode="position", force=True)
    field.order("vehicles.takeoff", name, height_m=20, wait_s=120.0)
    assert px4 or field.truth(name).mode == "GUIDED"
    figures["takeoff s"] = field.wait(lambda: field.truth(name).alt_rel_m > 18, 60, "it is up")
    assert away_m(field, 0, 0) < 8
    field.wait(lambda: field.truth(name).speed_mps < 0.5, 30, "it stands in the air")
    if not px4:  # on its rotors GUIDED would fly it on as a plane
        assert "Q_GUIDED_MODE" in refusal(field, "vehicles.goto", enu_m=[0, 30, 20])
        field.order("params.set", name, params={"Q_GUIDED_MODE": 1}, force=True)
        field.order("vehicles.goto", name, enu_m=[0, 60, 20])
        field.wait(lambda: field.truth(name).speed_mps > 2, 30, "it flies on its rotors")
        assert field.order("vehicles.hold", name)[name]["message"] == "holding in GUIDED"
        field.wait(lambda: field.truth(name).speed_mps < 0.5, 30, "it stands again")
        field.holds(
            lambda: field.truth(name).alt_rel_m > 15 and away_m(field, 0, 60) > 10, 10, "it holds without sticks"
        )
        field.order("params.set", name, params={"Q_GUIDED_MODE": 0}, force=True)
    else:
        field.order("vehicles.goto", name, enu_m=[0, 30, 20])
        figures["goto s"] = field.wait(lambda: away_m(field, 0, 30) < 3, 60, "it is there")
    message = field.order("vehicles.hold", name)[name]["message"]
    assert message.startswith("holding in AUTO.LOITER" if px4 else ("holding in QLOITER", "stopped; QLOITER")), message
    field.order("vehicles.land", name)
    assert field.truth(name).mode == ("LAND" if px4 else "QLAND")
    figures["landing s"] = field.wait(lambda: not field.truth(name).armed, 120, "it has landed and disarmed")


@pytest.mark.only("quadplane")
def test_a_quadplane_returns_as_its_parameters_say(field: Field, figures: dict[str, Any]) -> None:
    """Q_RTL_MODE 0 circles above its home, 1 lands there on its rotors (ModeRTL::switch_QRTL)."""
    name = field.one
    report = field.daemon.call("preflight.run", targets=name)["vehicles"][name]
    (found,) = [finding["text"] for finding in report["findings"] if finding["check"] == "return"]
    assert "it circles above its home (Q_RTL_MODE 0, RTL_AUTOLAND 0)" in found, found
    field.order("vehicles.takeoff", name, height_m=30, wait_s=120.0)
    field.wait(lambda: field.truth(name).alt_rel_m > 27, 60, "it is up")
    field.order("vehicles.goto", name, enu_m=[0, AWAY_M, 60], force=True)  # in GUIDED it flies on as a plane
    field.wait(lambda: field.truth(name).speed_mps > 15 and away_m(field, 0, 0) > 200, 90, "it is on its wing")
    message = field.order("vehicles.rtl", name)[name]["message"]
    assert message == "returning to launch; it circles above its home", message
    for value in (0, 1):
        field.order("params.set", name, params={"Q_RTL_MODE": value}, force=True)
        field.wait(lambda: field.truth(name).speed_mps > 10, 10, "it flies on")
    message = field.order("vehicles.rtl", name)[name]["message"]
    assert message.endswith("it flies home as a plane, and lands there on its rotors"), message
    field.wait(lambda: field.truth(name).mode == "QRTL", 120, "it changes to its rotors near its home")
    figures["return s"] = field.wait(lambda: not field.truth(name).armed, 180, "it has landed and disarmed")
    figures["beside m"] = round(away_m(field, 0, 0), 1)
    assert away_m(field, 0, 0) < 10
    field.order("params.set", name, params={"Q_RTL_MODE": 0}, force=True)


@pytest.mark.only("rover")
def test_a_rover_drives_a_mission_from_disarmed(field: Field, figures: dict[str, Any]) -> None:
    name = field.one

    def item(seq: int, east_m: float, north_m: float) -> str:
        lat, lon = HOME[0] + north_m / 111_132.0, HOME[1] + east_m / 111_319.5 / math.cos(math.radians(HOME[0]))
        return f"{seq}\t0\t3\t16\t0\t0\t0\t0\t{lat:.7f}\t{lon:.7f}\t0\t1"

    places = [(15, 15), (15, 40), (0, 40)]
    lines = ["QGC WPL 110", item(0, 0, 0), *(item(seq, *place) for seq, place in enumerate(places, 1))]
    field.order("missions.upload", name, plan="\n".join(lines), force=True)
    field.order("missions.start", name)
    assert field.truth(name).mode == "AUTO" and field.truth(name).armed
    began = time.monotonic()
    for east_m, north_m in places:
        field.wait(lambda e=east_m, n=north_m: away_m(field, e, n) < 6, 90, "it is at its next place")  # type: ignore[misc]
    field.wait(lambda: field.truth(name).speed_mps < 0.2, 30, "it stands at its end")
    figures["mission s"] = round(time.monotonic() - began, 1)
    field.order("vehicles.disarm", name)
