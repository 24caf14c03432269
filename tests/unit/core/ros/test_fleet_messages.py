"""The fleet as messages and markers: values, unknown values, hostile texts, bounds, each encoded as for the network."""

from __future__ import annotations

import json
import math
from typing import Any

import pytest

from skygcs.core.ros import fleet_markers, fleet_messages
from skygcs.core.ros.fleet_markers import LINE_POINTS, MOST_PATH_POINTS, MOST_TRAILS, TRAIL_POINTS, Trails, Turns
from skygcs.core.ros.interfaces import ros2_interfaces
from support.table import each

NOW_NS = 1_700_000_000 * 10**9 + 5


def sent(type_: str, fields: dict[str, Any]) -> dict[str, Any]:
    known = ros2_interfaces()
    return known.decode(type_, known.encode(type_, fields))


def state(name: str = "alpha", sysid: int = 1, **more: Any) -> dict[str, Any]:
    position = {"lat_deg": 43.78, "lon_deg": -79.46, "alt_amsl_m": 190.0, "alt_rel_m": 10.0, "age_s": 0.25}
    position |= {"enu_m": [1.0, 2.0, 10.0], "vel_world_mps": [0.5, 0.0, -0.5], "yaw_world_deg": 90.0}
    plain = {"name": name, "sysid": sysid, "autopilot": "px4", "connected": True, "armed": True, "failsafe": False}
    plain |= {"mode": "AUTO.LOITER", "landed": "in_air", "position": position}
    plain["battery"] = {"volts": 15.5, "percent": 80}
    return {**plain, "control": {"state": "flying", "control_mode": "position"}, **more}


def test_a_vehicle_has_its_values() -> None:
    fleet = sent("skygcs_msgs/msg/Fleet", fleet_messages.fleet([(state(), "/alpha")], True, True, NOW_NS))
    assert fleet["header"] == {"stamp": {"sec": 1_700_000_000, "nanosec": 5}, "frame_id": "map"}
    assert fleet["daemon_connected"] and fleet["has_origin"]
    (row,) = fleet["vehicles"]
    assert row == {
        **{"name": "alpha", "system_id": 1, "namespace_root": "/alpha", "autopilot": "px4", "connected": True},
        **{"armed": True, "failsafe": False, "mode": "AUTO.LOITER", "landed": "in_air"},
        **{"lat_deg": 43.78, "lon_deg": -79.46, "alt_amsl_m": 190.0, "height_m": 10.0, "position_age_s": 0.25},
        **{"position": {"x": 1.0, "y": 2.0, "z": 10.0}, "velocity": {"x": 0.5, "y": 0.0, "z": -0.5}, "yaw_deg": 90.0},
        **{"battery_volts": 15.5, "battery_percent": 80, "control": "flying", "control_mode": "position"},
    }


def test_what_is_not_known_is_nan_or_empty_and_nothing_is_known_without_the_daemon() -> None:
    bare = {"name": "v7", "sysid": 255}
    for given in (bare, {**bare, "position": {"enu_m": [1, None, 3]}, "battery": None, "control": None}):
        (row,) = sent("skygcs_msgs/msg/Fleet", fleet_messages.fleet([(given, "/v7")], False, True, 0))["vehicles"]
        assert math.isnan(row["lat_deg"]) and math.isnan(row["position"]["y"]) and math.isnan(row["battery_volts"])
        assert (row["mode"], row["control"], row["armed"]) == ("", "off", False)
    lost = fleet_messages.fleet([(state(), "/alpha")], True, False, 0)
    assert not lost["daemon_connected"] and not lost["has_origin"] and not lost["vehicles"][0]["connected"]
    many = fleet_messages.fleet([(state(f"v{n}", n % 256), "/v") for n in range(1000)], True, True, 0)
    assert len(sent("skygcs_msgs/msg/Fleet", many)["vehicles"]) == fleet_messages.MOST_VEHICLES


def test_an_event_is_a_message() -> None:
    given = {"time_unix_s": 1_700_000_000.25, "kind": "mode", "vehicle": "alpha", "text": "mode LAND, was GUIDED"}
    made = sent("skygcs_msgs/msg/Event", fleet_messages.event({**given, "data": {"mode": "LAND"}, "dropped": 3}))
    assert made["stamp"] == {"sec": 1_700_000_000, "nanosec": 250_000_000}
    assert (made["kind"], made["vehicle"], made["text"], made["dropped"]) == ("mode", "alpha", given["text"], 3)
    assert json.loads(made["data"]) == {"mode": "LAND"}


@each(
    "given",
    [
        {},
        {"kind": None, "time_unix_s": None, "data": None},
        {"time_unix_s": 1e30, "dropped": 10**12, "vehicle": None},
        {"time_unix_s": -5, "text": "x" * 100_000, "data": {"much": "x" * 100_000}},
        {"time_unix_s": math.nan, "text": "a\0b", "kind": "\ud800", "data": {"text": "\ud800"}},
    ],
)
def test_any_event_can_be_sent(given: dict[str, Any]) -> None:
    made = sent("skygcs_msgs/msg/Event", fleet_messages.event(given))
    assert len(made["text"]) <= fleet_messages.MOST_TEXT and len(made["data"]) <= fleet_messages.MOST_DATA
    assert "\0" not in made["text"]


def test_a_plan_is_a_message() -> None:
    row = {"vehicle": "alpha", "state": "flying", "error_m": 0.5, "tube_m": 2.0, "pos_enu_m": [0, 0, 5], "left": None}
    status = {"plan": "3", "name": "show", "kind": "phased", "state": "flying", "busy": None, "phase": "cross"}
    status |= {"step": 2, "steps": 4, "speed": 1.0, "waits_for": ["bravo"]}
    status["vehicles"] = [{**row, "goal_enu_m": [9, 8, 7]}]
    made = sent("skygcs_msgs/msg/Plan", fleet_messages.plan(status, NOW_NS))
    assert (made["plan"], made["state"], made["step"], made["steps"], made["busy"]) == ("3", "flying", 2, 4, "")
    (vehicle,) = made["vehicles"]
    assert vehicle["goal"] == {"x": 9.0, "y": 8.0, "z": 7.0} and vehicle["name"] == "alpha" and vehicle["left"] == ""
    none = sent("skygcs_msgs/msg/Plan", fleet_messages.plan({"state": "none", "speed": None, "step": 0}, 0))
    assert none["state"] == "none" and math.isnan(none["speed"]) and none["vehicles"] == []


# -- markers


def array(markers: list[dict[str, Any]], lifetime_s: int = 5) -> list[dict[str, Any]]:
    made: list[dict[str, Any]] = sent("visualization_msgs/msg/MarkerArray", {"markers": markers})["markers"]
    assert all(m["header"]["frame_id"] == "map" and m["lifetime"]["sec"] == lifetime_s for m in made)
    assert len({(marker["ns"], marker["id"]) for marker in made}) == len(made)
    return made


def test_a_vehicle_is_an_arrow_a_name_and_a_trail() -> None:
    trails = Trails()
    for x in range(5):
        trails.add("alpha", [float(x), 0.0, 10.0])
        trails.add("alpha", [x + 0.1, 0.0, 10.0])  # too near to be a point of its own
    arrow, name = array(fleet_markers.vehicle_markers([state()], NOW_NS))
    (trail,) = array(Turns().lines(fleet_markers.trail_lines([state(), state("v", 2)], trails), NOW_NS), 60)
    assert arrow["pose"]["position"] == {"x": 1.0, "y": 2.0, "z": 10.0} and arrow["type"] == 0
    assert arrow["pose"]["orientation"]["z"] == pytest.approx(math.sin(math.pi / 4))
    assert name["text"] == "alpha  10.0 m  AUTO.LOITER" and name["pose"]["orientation"]["w"] == 1.0
    assert [point["x"] for point in trail["points"]] == [0.0, 1.0, 2.0, 3.0, 4.0]
    assert array(fleet_markers.vehicle_markers([state(position=None), {"name": "v", "sysid": 2}], 0)) == []
    for more, color in (({"failsafe": True}, "r"), ({}, "g")):
        row = array(fleet_markers.vehicle_markers([state(**more)], 0))[0]["color"]
        assert max("rgb", key=row.get) == color
    grey = array(fleet_markers.vehicle_markers([state(connected=False)], 0))[0]["color"]
    assert grey["r"] == grey["g"] == grey["b"]


def test_trails_are_bounded_and_begin_anew_after_a_jump() -> None:
    trails = Trails()
    for number in range(10 * TRAIL_POINTS):
        trails.add("alpha", (float(number), 0.0, 0.0))
    assert len(trails.points["alpha"]) == TRAIL_POINTS
    trails.add("alpha", (1e6, 0.0, 0.0))
    assert list(trails.points["alpha"]) == [(1e6, 0.0, 0.0)]
    for number in range(1000):
        trails.add(f"v{number}", (0.0, 0.0, 0.0))
    assert len(trails.points) == MOST_TRAILS and trails.left_out == 1001 - MOST_TRAILS


def test_a_box_of_several_vehicles_is_drawn_once() -> None:
    box = {"x_m": [-50.0, 50.0], "y_m": [-40.0, 40.0], "up_m": [0.0, 20.0]}
    one, other = array(fleet_markers.fence_markers([box, dict(box), {**box, "up_m": [0.0, 30.0]}], NOW_NS))
    assert len(one["points"]) == len(other["points"]) == 24
    edges = list(zip(one["points"][::2], one["points"][1::2], strict=True))
    lengths = [math.dist(tuple(a.values()), tuple(b.values())) for a, b in edges]
    assert sorted(lengths) == [20.0] * 4 + [80.0] * 4 + [100.0] * 4
    assert len({frozenset((tuple(a.values()), tuple(b.values()))) for a, b in edges}) == 12


def test_a_plan_is_its_paths_and_goals() -> None:
    paths = [
        {"vehicle": "alpha", "points_enu_m": [[float(n), 0.0, 5.0] for n in range(100_000)]},
        {"vehicle": "bravo", "points_enu_m": [[0.0, 0.0, None]]},
        {"vehicle": "charlie"},
    ]
    rows = [{"goal_enu_m": None}, {"goal_enu_m": [1.0, 2.0, 3.0]}, {}]
    lines = fleet_markers.path_lines(paths)
    (line,) = array(Turns().lines(lines, NOW_NS), 60)
    assert MOST_PATH_POINTS / 2 < len(line["points"]) <= MOST_PATH_POINTS
    (goal,) = array(fleet_markers.goal_markers({"vehicles": rows}, NOW_NS))
    assert goal["points"] == [{"x": 1.0, "y": 2.0, "z": 3.0}]
    assert array(fleet_markers.goal_markers({}, 0)) == []
    (gone,) = array(fleet_markers.deleted(lines, NOW_NS))
    assert (gone["ns"], gone["id"], gone["action"]) == (line["ns"], line["id"], 2)


def test_lines_have_their_turns_and_a_message_stays_small() -> None:
    """250 vehicles with whole trails and paths: all have been sent before the first is gone from the display."""
    trails = Trails()
    for number in range(250):
        for x in range(TRAIL_POINTS):
            trails.add(f"v{number}", (float(x), 0.0, 0.0))
    path = {"points_enu_m": [[float(n), 0.0, 5.0] for n in range(MOST_PATH_POINTS)]}
    lines = fleet_markers.trail_lines([state(f"v{n}", n) for n in range(250)], trails)
    lines += fleet_markers.path_lines([path] * 250)
    turns, seen, messages = Turns(), set[tuple[str, int]](), 0
    while len(seen) < 500:
        made = turns.lines(lines, NOW_NS)
        assert made and sum(len(marker["points"]) for marker in made) <= LINE_POINTS
        seen |= {(marker["ns"], marker["id"]) for marker in made}
        messages += 1
    assert messages / 2 < fleet_markers.LINE_LIFETIME_S - 10
    assert turns.lines([], NOW_NS) == []
    assert len(turns.lines(lines[:1], NOW_NS)) == 1


def test_vehicles_have_their_turns_within_a_lifetime() -> None:
    states, turns = [state(f"v{n}", n) for n in range(230)], Turns()
    seen = [[one["name"] for one in turns.vehicles(states)] for _ in range(10)]
    assert {len(names) for names in seen} == {fleet_markers.VEHICLES_AT_ONCE}
    for first in range(5):
        assert len({name for names in seen[first : first + 5] for name in names}) == 230
    assert turns.vehicles(states[:7]) == states[:7] and list(turns.vehicles([])) == []
