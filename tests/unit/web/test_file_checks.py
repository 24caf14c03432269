"""Checks of dropped files and drawings: what the page gets, and what hostile requests get."""

import base64
import json
import math

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from skygcs.core.geo import Origin, geodetic_from_enu
from skygcs.core.mission.formats import read_plan as read_mission
from skygcs.core.plan.plan_files import read_plan
from skygcs.core.trajectory import MotionLimits
from skygcs.errors import SkygcsError
from skygcs.web.file_checks import CHECKS, extension_checks, find_check
from support.examples import examples
from support.table import each

ORIGIN = {"lat_deg": 47.4, "lon_deg": 8.5, "alt_amsl_m": 440.0, "x_heading_deg": 90.0}
TURNED = {**ORIGIN, "x_heading_deg": 30.0}


def place(x: float, y: float, origin: dict[str, float] = ORIGIN) -> tuple[float, float]:
    lat, lon, _ = geodetic_from_enu(x, y, 0.0, Origin(**origin))
    return lat, lon


def wpl(*rows: tuple[int, float, float, float]) -> str:
    lines = ["QGC WPL 110", "0\t1\t0\t16\t0\t0\t0\t0\t47.4\t8.5\t440\t1"]
    lines += [f"{n}\t0\t3\t{cmd}\t0\t0\t0\t0\t{lat}\t{lon}\t{alt}\t1" for n, (cmd, lat, lon, alt) in enumerate(rows, 1)]
    return "\n".join(lines) + "\n"


def mission(**keys: object) -> dict:
    return find_check("web.mission.check")(keys)


# --- missions ---------------------------------------------------------------------------------------------------------


@each("origin", [ORIGIN, TURNED])
def test_items_of_a_file_are_placed_in_the_world_of_the_page(origin):
    text = wpl((22, 0, 0, 10), (16, *place(30, -40, origin), 12), (20, 0, 0, 0))

    answer = mission(file={"name": "a.waypoints", "text": text}, origin=origin)

    assert answer["ok"] and answer["format"] == "wpl" and answer["holds"] == ["mission"]
    wanted = ["MAV_CMD_NAV_TAKEOFF", "MAV_CMD_NAV_WAYPOINT", "MAV_CMD_NAV_RETURN_TO_LAUNCH"]
    assert [item["name"] for item in answer["mission"]] == wanted
    assert [item["xy_m"] is None for item in answer["mission"]] == [True, False, True]
    assert answer["mission"][1]["xy_m"] == pytest.approx([30, -40], abs=0.02)
    assert (answer["mission"][1]["height_m"], answer["mission"][1]["height_above"]) == (12, "home")
    assert answer["text"] is None  # the file itself is uploaded


def test_without_an_origin_nothing_is_drawn_but_everything_is_checked():
    answer = mission(file={"name": "a.waypoints", "text": wpl((16, 47.4, 8.5, 900))})

    assert answer["mission"][0]["xy_m"] is None
    assert not answer["ok"] and any("900" in finding["text"] for finding in answer["findings"])


def test_a_waypoint_far_from_the_vehicle_is_an_error_of_its_item():
    text = wpl((22, 0, 0, 10), (16, *place(3000, 0), 12))

    answer = mission(file={"name": "a.txt", "text": text}, origin=ORIGIN, vehicle_xy_m=[0, 0])

    assert [(f["severity"], f["item"]) for f in answer["findings"] if f["item"] == 2] == [("error", 2)]


@each("autopilot", ["px4", "ardupilot"])
@each("end", ["return", "land", "hold"])
def test_a_drawn_mission_becomes_a_plan_that_both_firmwares_accept(autopilot, end):
    drawn = {"waypoints": [[20, 0, 15], [20, 30, 15]], "takeoff_height_m": 10.0, "end": end}

    answer = mission(drawn=drawn, origin=TURNED, vehicle_xy_m=[5.0, 6.0], autopilot=autopilot)

    assert answer["ok"], answer["findings"]
    read = read_mission(answer["text"].encode(), "drawn.plan").plan
    assert len(read.mission) == 4 == answer["counts"]["mission"]
    lat, lon = read.mission[2].position
    assert (lat, lon) == pytest.approx(place(20, 30, TURNED), abs=2e-7)


def test_a_drawing_needs_an_origin():
    with pytest.raises(SkygcsError, match="no origin"):
        mission(drawn={"waypoints": [[1, 2, 3]]})


# --- fences -----------------------------------------------------------------------------------------------------------


def test_a_drawn_fence_is_written_as_a_plan_with_nothing_but_the_fence():
    corners = [[-50, -50], [50, -50], [50, 50], [-50, 50]]
    drawn = {"polygons": [{"corners": corners}], "circles": [{"inclusion": False, "center": [10, 10], "radius_m": 5.0}]}

    answer = find_check("web.fence.check")({"drawn": drawn, "origin": ORIGIN, "autopilot": "px4"})

    plan = read_mission(answer["text"].encode(), "drawn.plan").plan
    assert not plan.mission and len(plan.fence.polygons) == 1 and len(plan.fence.circles) == 1
    for drawn_corner, shown in zip(corners, answer["fence"]["polygons"][0]["xy_m"], strict=True):
        assert shown == pytest.approx(drawn_corner, abs=0.02)
    assert answer["fence"]["circles"][0]["center_xy_m"] == pytest.approx([10, 10], abs=0.02)


def test_a_fence_that_crosses_itself_is_an_error():
    drawn = {"polygons": [{"corners": [[0, 0], [50, 50], [50, 0], [0, 50]]}]}

    answer = find_check("web.fence.check")({"drawn": drawn, "origin": ORIGIN})

    assert not answer["ok"] and answer["errors"] >= 1


def test_of_a_file_without_a_fence_the_check_says_so():
    with pytest.raises(SkygcsError, match="holds no fence"):
        find_check("web.fence.check")({"file": {"name": "a.waypoints", "text": wpl((16, 47.4, 8.5, 10))}})


# --- plans ------------------------------------------------------------------------------------------------------------

CROSSING = "vehicle,t,x,y,z,yaw\n" + "".join(
    f"{name},{t},{x},{y},10,0\n"
    for name, rows in {"alpha": [(0, -20, 0), (20, 20, 0)], "bravo": [(0, 0, -20), (20, 0, 20)]}.items()
    for t, x, y in rows
)


def plan_check(**keys: object) -> dict:
    return find_check("web.plan.check")(keys)


def test_a_plan_whose_vehicles_meet_is_refused_with_the_pair_and_the_time():
    answer = plan_check(files=[{"name": "cross.csv", "text": CROSSING}])

    assert not answer["ok"]
    assert sorted(answer["certificate"]["closest"]["vehicles"]) == ["alpha", "bravo"]
    assert answer["certificate"]["closest"]["t_s"] == pytest.approx(10, abs=0.5)
    assert answer["reasons"] and set(answer["paths"]["vehicles"]) == {"alpha", "bravo"}


def test_a_formation_is_planned_certified_and_written_as_a_plan():
    starts = {f"v{n}": [float(8 * n), 0.0, 0.0] for n in range(6)}
    task = {"starts": starts, "formation": {"shape": "circle", "spacing_m": 8.0, "middle_m": [20.0, 40.0, 15.0]}}

    answer = plan_check(task=task)

    assert answer["ok"] and answer["certificate"]["certified"]
    written = read_plan("made.json", answer["text"].encode(), MotionLimits())
    assert len(answer["goals"]) == 6 and {goal[2] for goal in answer["goals"].values()} == {15.0}
    assert math.dist(*list(answer["goals"].values())[:2]) > 1.0
    assert written.format == "skygcs plan"


def test_goals_that_are_too_near_are_refused_with_a_reason_and_no_text():
    task = {
        "starts": {"a": [0.0, 0.0, 0.0], "b": [20.0, 0.0, 0.0]},
        "goals": {"a": [5.0, 30.0, 10.0], "b": [5.2, 30.0, 10.0]},
    }

    answer = plan_check(task=task)

    assert not answer["ok"] and answer["text"] is None and answer["reasons"]


def test_a_vehicle_that_stands_in_the_way_is_part_of_the_check():
    straight = "vehicle,t,x,y,z,yaw\nalpha,0,0,0,10,0\nalpha,20,60,0,10,0\n"
    files = [{"name": "one.csv", "text": straight}]

    assert plan_check(files=files)["ok"]
    assert not plan_check(files=files, standing={"bravo": [30.0, 0.0, 10.0]})["ok"]
    # where the page saw the plan's own vehicle does not matter
    assert plan_check(files=files, standing={"alpha": [30.0, 0.0, 10.0]})["ok"]


def test_the_paths_of_the_answer_are_those_of_the_plan():
    answer = plan_check(files=[{"name": "cross.csv", "text": CROSSING}])
    plan = read_plan("cross.csv", CROSSING.encode(), MotionLimits()).plan

    for name, pieces in answer["paths"]["vehicles"].items():
        at = 0.0
        for duration, *axes in pieces:
            there = [sum(c * (duration / 2) ** k for k, c in enumerate(axis)) for axis in axes]
            assert there == pytest.approx(plan.trajectories[name].at(at + duration / 2).pos_enu_m, abs=1e-6)
            at += duration


def test_a_long_plan_is_answered_by_samples_of_bounded_size():
    rows = [f"v{v},{t},{v * 30 + math.sin(t)},{t * 0.5},10,0" for v in range(20) for t in range(1500)]
    answer = plan_check(files=[{"name": "long.csv", "text": "vehicle,t,x,y,z,yaw\n" + "\n".join(rows)}])

    assert not answer["paths"]["exact"]
    assert len(json.dumps(answer["paths"])) < 3 << 20
    pieces = answer["paths"]["vehicles"]["v3"]
    assert sum(piece[0] for piece in pieces) == pytest.approx(answer["paths"]["duration_s"])
    middle = pieces[len(pieces) // 2]
    assert middle[1][0] == pytest.approx(90 + math.sin(1499 / 2), abs=0.3)


# --- parameters -------------------------------------------------------------------------------------------------------

HELD = [
    {"name": "MPC_XY_CRUISE", "value": 5.0, "type": "REAL32"},
    {"name": "COM_RC_IN_MODE", "value": 1.0, "type": "INT32"},
    {"name": "MAV_SYS_ID", "value": 1.0, "type": "INT32"},
]


def params_check(text: str, **keys: object) -> dict:
    given = {"file": {"name": "a.params", "text": text}, "params": HELD, "sysid": 1, "autopilot": "px4", **keys}
    return find_check("web.params.check")(given)


def test_a_parameter_file_is_compared_as_the_command_line_compares_it():
    answer = params_check("MPC_XY_CRUISE,7.5\nCOM_RC_IN_MODE,1\nNOT_THERE,2\nMAV_SYS_ID,9\n")

    assert answer["changes"] == [{"name": "MPC_XY_CRUISE", "value": 7.5, "before": 5.0, "sort": "settings"}]
    assert answer["same"] == 1 and answer["unknown"] == ["NOT_THERE"]
    assert answer["skipped"] == [["MAV_SYS_ID", "identity"]]


def test_a_value_that_the_type_cannot_hold_is_a_problem():
    answer = params_check("COM_RC_IN_MODE,1.5\n")

    assert not answer["changes"] and "COM_RC_IN_MODE" in answer["problems"][0]


# --- what a hostile page sends ----------------------------------------------------------------------------------------


@each("method", [*CHECKS, *extension_checks()])
@each(
    "params",
    [
        {},
        {"file": None},
        {"file": 7, "files": 7, "task": 7},
        {"file": {"name": "a", "text": "x", "more": 1}, "files": [{"name": "a", "text": "x", "more": 1}]},
        {"file": {"name": "a.plan", "base64": "!!"}, "files": [{"name": "a.json", "base64": "!!"}]},
        {"file": {"name": "a.plan", "text": "\ud800"}, "files": [{"name": "a.json", "text": "\ud800"}]},
        {"drawn": {"waypoints": [[1e9, 0, 0]]}, "task": {"starts": {"a": [1e9, 0, 0]}, "goals": {}}},
        {"file": {"name": "a.plan", "text": "[" * 100_000}, "files": [{"name": "a.json", "text": "[" * 100_000}]},
        {"file": {"name": "a.plan", "base64": base64.b64encode(b"PK\x03\x04" * 100).decode()}},
        {"files": [{"name": "a.skyc", "base64": base64.b64encode(b"PK\x03\x04" * 100).decode()}]},
    ],
)
def test_nothing_but_a_skygcs_error_leaves_a_check(method, params):
    with pytest.raises(SkygcsError):
        find_check(method)(params)


JSON = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats(allow_nan=False) | st.text(max_size=20),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(max_size=12), inner, max_size=4),
    max_leaves=12,
)
KEYS = ("file", "files", "drawn", "task", "origin", "params", "sysid", "standing", "fence", "limits", "autopilot")


@settings(max_examples=examples(150), deadline=None)
@given(
    st.sampled_from(sorted([*CHECKS, *extension_checks()])), st.dictionaries(st.sampled_from(KEYS), JSON, max_size=4)
)
def test_any_json_is_answered_or_refused(method, params):
    try:
        answer = find_check(method)(params)
    except SkygcsError:
        return
    json.dumps(answer, allow_nan=False)


@settings(max_examples=examples(60), deadline=None)
@given(st.sampled_from(["a.plan", "a.json", "a.csv", "a.skyc", "a.waypoints"]), st.binary(max_size=200))
def test_any_file_is_answered_or_refused(name, content):
    file = {"name": name, "base64": base64.b64encode(content).decode()}
    for method, params in (
        ("web.mission.check", {"file": file, "origin": ORIGIN}),
        ("web.fence.check", {"file": file}),
        ("web.plan.check", {"files": [file], "origin": ORIGIN}),
        ("web.params.check", {"file": file, "params": HELD, "sysid": 1, "autopilot": "px4"}),
    ):
        try:
            answer = find_check(method)(params)
        except SkygcsError:
            continue
        json.dumps(answer, allow_nan=False)


# -- tables of positions


def test_a_table_of_positions_is_read_as_the_command_line_reads_it(tmp_path):
    from skygcs.ext.plans.commands.table import read_table

    columns = "vehicle,initial_x,initial_y,initial_z,final_x,final_y,final_z,final_heading_deg"
    text = f"{columns}\na,0,1,5,10,0,5,90\n7,,,,1,2,3,\n"
    (tmp_path / "t.csv").write_text(text)
    answer = find_check("web.positions.check")({"file": {"name": "t.csv", "text": text}})
    assert answer["vehicles"] == {
        "a": {"initial": [0.0, 1.0, 5.0], "final": [10.0, 0.0, 5.0]},
        "7": {"initial": None, "final": [1.0, 2.0, 3.0]},
    }
    assert answer["headings"] is True
    read = read_table(tmp_path / "t.csv")
    assert {name: list(read[name]["final"].position_m) for name in read} == {
        name: places["final"] for name, places in answer["vehicles"].items()
    }
    toml = "[vehicles.a]\nfinal = [1, 2, 3]\n"
    answer = find_check("web.positions.check")({"file": {"name": "T.TOML", "text": toml}})
    assert answer["vehicles"] == {"a": {"initial": None, "final": [1.0, 2.0, 3.0]}} and answer["headings"] is False


@each("text", ["", "x,y\n1,2\n", "vehicle,final_x\na,nan\n", "vehicle,final_x,final_y,final_z\na,1e9,0,0\n"])
def test_a_bad_table_is_refused_with_its_name(text):
    with pytest.raises(SkygcsError, match=r"t\.csv"):
        find_check("web.positions.check")({"file": {"name": "t.csv", "text": text}})
