"""QGroundControl's .plan as the path of one vehicle; what no path is, is refused with its item."""

from __future__ import annotations

import json
import math
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from skygcs.core.geo import Origin, geodetic_from_enu
from skygcs.core.plan.mission_path import read_mission_path
from skygcs.core.plan.plan_files import NamedFile, read_together
from skygcs.core.trajectory import MotionLimits, motion_peaks
from skygcs.errors import PlanFileError
from support.public_data import present, public_file
from support.table import each

HOME = Origin(47.397742, 8.545594, 488.0)
LIMITS = MotionLimits(speed_mps=5.0)
TAKEOFF, WAYPOINT, LAND, RTL, SPEED = 22, 16, 21, 20, 178


def item(
    command: int, x: float = 0.0, y: float = 0.0, z: float = 10.0, *params: float, frame: int = 3
) -> dict[str, Any]:
    """At x, y metres from HOME; ``params`` are the first four."""
    lat, lon, _ = geodetic_from_enu(x, y, 0.0, HOME)
    first = [*params, *(0.0,) * (4 - len(params))]
    return {
        "type": "SimpleItem",
        "command": command,
        "frame": frame,
        "params": [*first, lat, lon, z],
        "autoContinue": True,
    }


def speed(mps: float, kind: float = 1.0) -> dict[str, Any]:
    return {"type": "SimpleItem", "command": SPEED, "frame": 2, "params": [kind, mps, -1, 0, 0, 0, 0]}


def rtl() -> dict[str, Any]:
    return {"type": "SimpleItem", "command": RTL, "frame": 2, "params": [0, 0, 0, 0, 0, 0, 0]}


def plan_file(*items: dict[str, Any], home: Any = (HOME.lat_deg, HOME.lon_deg, HOME.alt_amsl_m), **more: Any) -> bytes:
    mission = {"version": 2, "items": list(items), "plannedHomePosition": None if home is None else list(home)}
    return json.dumps({"fileType": "Plan", "version": 1, "mission": mission, **more}).encode()


def read(*items: dict[str, Any]) -> Any:
    return read_mission_path("a.plan", plan_file(*items), LIMITS)


def near(place: Any, other: Any, within_m: float = 0.02) -> bool:
    return math.dist(place, other) <= within_m


def test_a_mission_is_the_path_between_take_off_and_landing() -> None:
    found = read(
        item(TAKEOFF, z=10.0), item(WAYPOINT, 30, 0, 10, 4.0), item(WAYPOINT, 30, 40, 20), item(LAND, 0, 40, 0)
    )
    path = found.trajectory
    assert found.origin == HOME
    assert near(path.start_enu_m, (0, 0, 10)) and near(path.end_enu_m, (0, 40, 20))
    assert motion_peaks(path).speed_mps.at_most <= 5.0 * (1 + 1e-6)
    standing = [piece for piece in path.pieces if piece.duration_s == 4.0 and len(piece.east) == 1]
    assert len(standing) == 1 and near((standing[0].east[0], standing[0].north[0], standing[0].up[0]), (30, 0, 10))


def test_a_return_leads_level_to_above_home_and_heights_above_sea_level_are_taken() -> None:
    found = read(item(TAKEOFF), item(WAYPOINT, 30, 0, 500.0, frame=0), rtl()).trajectory
    assert near(found.end_enu_m, (0, 0, 12))


def test_a_take_off_without_a_place_is_above_home() -> None:
    takeoff = item(TAKEOFF) | {"params": [0, 0, 0, None, 0, 0, 15]}
    assert near(read(takeoff, item(WAYPOINT, 5, 5, 15)).trajectory.start_enu_m, (0, 0, 15))


def test_speed_changes_hold_for_the_legs_that_follow_within_the_limits() -> None:
    slow = read(speed(2.0), item(TAKEOFF), item(WAYPOINT, 100, 0, 10)).trajectory
    assert motion_peaks(slow).speed_mps.at_least == pytest.approx(2.0, rel=1e-3)
    later = read(item(TAKEOFF), item(WAYPOINT, 100, 0, 10), speed(2.0), item(WAYPOINT, 100, 100, 10))
    first, last = (p for p in later.trajectory.pieces if len(p.east) == 2 or len(p.north) == 2)
    assert math.hypot(first.east[1], first.north[1]) == pytest.approx(5.0, rel=1e-3)
    assert math.hypot(last.east[1], last.north[1]) == pytest.approx(2.0, rel=1e-3)
    fast = read(speed(12.0), item(TAKEOFF), item(WAYPOINT, 100, 0, 10))
    assert motion_peaks(fast.trajectory).speed_mps.at_most <= 5.0 * (1 + 1e-6)
    assert "item 1: speed of 12 m/s, flown at the limit, 5" in fast.notes
    back = read(speed(2.0), speed(-2.0), item(TAKEOFF), item(WAYPOINT, 100, 0, 10)).trajectory
    assert motion_peaks(back).speed_mps.at_least == pytest.approx(5.0, rel=1e-3)
    climb = read(item(TAKEOFF), speed(0.5, 2), item(WAYPOINT, 0, 0, 40)).trajectory
    assert motion_peaks(climb).climb_mps.at_least == pytest.approx(0.5, rel=1e-3)


@each(
    ("items", "words"),
    [
        ([item(TAKEOFF), item(2000)], "item 2: IMAGE_START_CAPTURE is not a part of a path.*fly it as a mission"),
        ([item(TAKEOFF), item(177)], "item 2: DO_JUMP"),
        ([item(TAKEOFF), item(9999)], "item 2: command 9999"),
        ([item(TAKEOFF), item(WAYPOINT, 5), item(TAKEOFF)], "item 3: is a take-off in the middle"),
        ([item(TAKEOFF), item(LAND), item(WAYPOINT, 9)], "item 3: comes after item 2, which ends the path"),
        ([rtl()], "item 1: comes before any take-off"),
        ([item(TAKEOFF), item(WAYPOINT, frame=10)], "item 2: its height is in frame 10"),
        ([item(TAKEOFF), item(WAYPOINT) | {"params": [0, 0, 0, 0, None, None, 5]}], "item 2: has no position"),
        ([item(TAKEOFF), item(WAYPOINT) | {"params": [0, 0, 0, 0, 47.0, 8.0, None]}], "item 2: has no height"),
        ([item(TAKEOFF), item(WAYPOINT) | {"params": [0, 0, 0, 0, 10.0, 8.0, 5]}], "item 2: y from the origin"),
        ([item(TAKEOFF), item(WAYPOINT) | {"params": [0, 0, 0, 0, 97.0, 8.0, 5]}], "item 2: latitude"),
        ([item(TAKEOFF), item(WAYPOINT, 5, 5, 5, 9000.0)], "item 2: param1"),
        ([item(TAKEOFF), speed(0.0)], "item 2: a speed of 0.0"),
        ([item(TAKEOFF), speed(3.0, 7)], "item 2: a speed of 3.0 of type 7"),
        ([speed(3.0)], "no take-off and no waypoint"),
        ([], "holds no mission"),
    ],
)
def test_what_is_no_path_is_refused_with_its_item(items: list[dict[str, Any]], words: str) -> None:
    with pytest.raises(PlanFileError, match=words):
        read(*items)


def test_a_plan_needs_its_home() -> None:
    with pytest.raises(PlanFileError, match="plannedHomePosition: heights are above it"):
        read_mission_path("a.plan", plan_file(item(TAKEOFF), home=None), LIMITS)


def test_a_key_that_is_there_twice_is_refused() -> None:
    text = plan_file(item(TAKEOFF)).decode().replace('"fileType"', '"version": 1, "fileType"', 1)
    with pytest.raises(PlanFileError, match="'version' is there twice"):
        read_mission_path("a.plan", text.encode(), LIMITS)


def test_files_are_vehicles_about_the_home_of_the_first() -> None:
    one = plan_file(item(TAKEOFF, 0, 0, 10), item(WAYPOINT, 20, 0, 10))
    lat, lon, _ = geodetic_from_enu(0.0, 50.0, 0.0, HOME)
    other = plan_file(item(TAKEOFF, 0, 50, 10), item(WAYPOINT, 20, 50, 10), home=(lat, lon, 490.0))
    found = read_together([NamedFile("x/one.plan", one), NamedFile("x/one.plan", other, "two")], LIMITS)
    paths = found.plan.trajectories  # type: ignore[union-attr]
    assert list(paths) == ["one", "two"] and found.origin == HOME
    assert near(paths["two"].start_enu_m, (0, 50, 12))  # its home is 2 m higher
    assert any("take-off and landing are no part of the path" in note for note in found.notes)
    with pytest.raises(PlanFileError, match="vehicle one is in two files; NAME=FILE"):
        read_together([NamedFile("x/one.plan", one), NamedFile("y/one.plan", other)], LIMITS)
    with pytest.raises(PlanFileError, match="cannot be read as the path of alpha"):
        read_together([NamedFile("show.skyc", b"", "alpha")], LIMITS)


def test_a_fence_and_rally_points_that_are_not_read_are_named() -> None:
    fence = {"version": 2, "circles": [], "polygons": [{"version": 1, "polygon": [[47, 8], [47, 9], [48, 8]]}]}
    rally = {"version": 2, "points": [[47.0, 8.0, 10.0]]}
    notes = read_mission_path("a.plan", plan_file(item(TAKEOFF), geoFence=fence, rallyPoints=rally), LIMITS).notes
    assert any("geofence is not read" in note for note in notes) and "its rally points are not read" in notes


HEIGHTS_M = {"px4-MC_mission_box.plan": 10.0, "px4-geofence_avoid.plan": 20.0}


@each("name", present("missions", HEIGHTS_M))
def test_missions_of_px4_are_read(name: str) -> None:
    found = read_mission_path(name, public_file(f"missions/{name}").read_bytes(), LIMITS)
    assert near(found.trajectory.end_enu_m, (0, 0, HEIGHTS_M[name]), 0.4)  # they return to, or land near, their home


@given(
    st.recursive(
        st.none() | st.booleans() | st.floats() | st.integers(-(10**20), 10**20) | st.text(max_size=5),
        lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(max_size=4), inner, max_size=3),
        max_leaves=8,
    ),
    st.sampled_from(["params", "command", "frame", "type", "items", "plannedHomePosition", "mission"]),
)
def test_nothing_but_a_plan_file_error_leaves_it(value: Any, key: str) -> None:
    content = json.loads(plan_file(item(TAKEOFF), item(WAYPOINT, 5)))
    if key == "mission":
        content[key] = value
    elif key in content["mission"]:
        content["mission"][key] = value
    else:
        content["mission"]["items"][1][key] = value
    try:
        read_mission_path("a.plan", json.dumps(content).encode(), LIMITS)
    except PlanFileError as error:
        assert str(error).startswith("a.plan")


@each("text", ["", "[", "[" * 100_000, '{"version": ' + "9" * 5000 + "}", "null", '"Plan"'])
def test_text_that_is_no_plan_is_refused(text: str) -> None:
    with pytest.raises(PlanFileError):
        read_mission_path("a.plan", text.encode(), LIMITS)
