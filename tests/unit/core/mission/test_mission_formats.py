from __future__ import annotations

import json
import math
from dataclasses import replace
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from skygcs.core.geo import distance_m
from skygcs.core.mission.fence import FenceCircle, FencePlan, FencePolygon, fence_from_items, fence_items
from skygcs.core.mission.formats import MAX_FILE_BYTES, Imported, format_of, read_plan, write_plan
from skygcs.core.mission.item import UNSET_INT, MissionItem, MissionType
from skygcs.core.mission.plan import MissionPlan, PlannedHome, PlanSettings, from_wire, to_wire
from skygcs.errors import PlanFileError
from support.public_data import present, public_file, public_folder
from support.table import each

# what the data's own README counts, home lines taken off: (mission, polygons, circles, has home)
PUBLIC = {
    "mavsdk-mission_planner_sample.txt": (4, 0, 0, False),
    "mavsdk-qgroundcontrol_sample.plan": (6, 0, 0, True),
    "mavsdk-qgroundcontrol_sample_with_structured_scan.plan": (1 + 18, 0, 0, True),
    "mavsdk-qgroundcontrol_sample_with_survey.plan": (1 + 12, 0, 0, True),
    "mavsdk-qgroundcontrol_sample_without_mission.plan": (0, 0, 0, False),
    "eagle-SampleMission.waypoints": (3, 0, 0, True),
    "eagle-MTownTestMission.waypoints": (6, 0, 0, True),
    "eagle-MTownTestFence.waypoints": (0, 1, 2, True),
    "px4-MC_mission_box.plan": (6, 0, 0, True),
    "qgc-MissionPlanner.waypoints": (5, 0, 0, True),
    "qgc-OldFileFormat.mission": (6, 0, 0, True),
    "ap-copter_mission.txt": (12, 0, 0, True),
    "ap-mission_pyramids.plan": (10, 0, 0, True),
    "px4-geofence_avoid.plan": (5, 2, 1, True),
}
MADE = {
    "made-mission-planner.txt": (4, 0, 0, False),
    "made-sample.plan": (6, 0, 0, True),
    "made-structure-scan.plan": (1 + 18, 0, 0, True),
    "made-survey.plan": (1 + 12, 0, 0, True),
    "made-without-mission.plan": (0, 0, 0, False),
    "made-sample.waypoints": (3, 0, 0, True),
    "made-fence.waypoints": (0, 1, 2, True),
    "made-spaces.waypoints": (5, 0, 0, True),
    "made-old.mission": (6, 0, 0, True),
    "made-oldest.mission": (6, 0, 0, True),
    "made-copter-mission.txt": (6, 0, 0, True),
    "made-fenced.plan": (5, 2, 1, True),
}
"""As made in support.made_files, in the forms of the public ones."""

COUNTS = MADE | PUBLIC
WRONG_VERSIONS = {
    "made-wrong-mission-version.plan": "mission: version 7",
    "made-wrong-overall-version.plan": "version 42",
    "mavsdk-qgroundcontrol_sample_wrong_mission_version.plan": "mission: version 7",
    "mavsdk-qgroundcontrol_sample_wrong_overall_version.plan": "version 42",
}


def public(name: str) -> Imported:
    return read_plan(public_file(f"missions/{name}").read_bytes(), name)


def wpl(*rows: str, version: str = "110") -> bytes:
    return "\n".join([f"QGC WPL {version}", *rows]).encode()


HOME_ROW = "0 1 0 16 0 0 0 0 43.78 -79.46 180 1"


def item_entry(number: int, **changes: Any) -> dict[str, Any]:
    params = [0, 0, 0, None, 43.78, -79.46, 20]
    return {"type": "SimpleItem", "doJumpId": number, "command": 16, "frame": 3, "params": params, **changes}


def plan_file(*items: dict[str, Any], **sections: Any) -> bytes:
    mission = {"version": 2, "items": list(items), "plannedHomePosition": [43.78, -79.46, 180]}
    return json.dumps({"fileType": "Plan", "version": 1, "mission": mission, **sections}).encode()


def refusal(content: bytes, name: str = "a.plan") -> str:
    with pytest.raises(PlanFileError) as caught:
        read_plan(content, name)
    return str(caught.value)


@each("name", present("missions", COUNTS))
def test_a_file_imports_with_the_counts_that_were_counted_independently(name: str) -> None:
    plan = public(name).plan
    counts = (len(plan.mission), len(plan.fence.polygons), len(plan.fence.circles), plan.home is not None)
    assert counts == COUNTS[name]


@each("name", present("missions", WRONG_VERSIONS))
def test_only_the_files_of_a_wrong_version_are_refused(name: str) -> None:
    assert WRONG_VERSIONS[name] in refusal(public_file(f"missions/{name}").read_bytes(), name)


def test_every_public_file_is_in_this_test() -> None:
    assert {path.name for path in public_folder("missions")} <= COUNTS.keys() | WRONG_VERSIONS.keys()


@each("name", present("missions", COUNTS))
def test_import_export_import_is_identical(name: str) -> None:
    plan = public(name).plan
    assert read_plan(write_plan(plan, "out.plan").encode(), "out.plan").plan == plan
    for kind in plan.holds():
        text = write_plan(plan, "out.waypoints", only=kind)
        again = read_plan(text.encode(), "out.waypoints").plan
        assert again.items(kind) == plan.items(kind)
        assert again.home == plan.home
        assert write_plan(again, "out.waypoints") == text


@each("name", present("missions", ["made-survey.plan", "mavsdk-qgroundcontrol_sample_with_survey.plan"]))
def test_the_surveys_items_are_those_stored_in_the_file(name: str) -> None:
    stored = json.loads(public_file(f"missions/{name}").read_text())
    inner = stored["mission"]["items"][1]["TransectStyleComplexItem"]["Items"]
    imported = public(name)
    assert [item.command for item in imported.plan.mission[1:]] == [entry["command"] for entry in inner]
    assert imported.plan.mission[1].seven[4:] == pytest.approx(inner[0]["params"][4:], abs=1e-7)
    assert "12 stored items" in imported.notes[0]


@each(
    "name", present("missions", ["made-structure-scan.plan", "mavsdk-qgroundcontrol_sample_with_structured_scan.plan"])
)
def test_the_structure_scan_flies_round_the_outline_at_its_distance(name: str) -> None:
    plan = public(name).plan
    assert [item.command for item in plan.mission] == [530, 16, 196, *([16, 206, 16, 16, 16, 16, 206] * 2), 197, 16]
    heights = [item.z for item in plan.mission if item.command == 16]
    assert heights == [50.0, *[87.5] * 5, *[62.5] * 5, 50.0]  # layers of 25 m from 100 m down
    stored = json.loads(public_file(f"missions/{name}").read_text())
    outline = stored["mission"]["items"][1]["polygon"]
    corner = plan.mission[1].position
    assert corner is not None
    # a corner moved outwards along both its edges by 50 m is farther than that from it and less than twice as far
    assert 50.0 < min(distance_m(*corner, *known) for known in outline) < 100.0


@each("name", present("missions", ["made-fenced.plan", "px4-geofence_avoid.plan"]))
def test_all_items_of_a_fence_are_read_and_their_counts_are_theirs(name: str) -> None:
    plan = public(name).plan
    assert [(p.inclusion, len(p.corners)) for p in plan.fence.polygons] == [(False, 4), (True, 4)]
    items = plan.items(MissionType.FENCE)
    assert [(item.command, item.params[0]) for item in items[:8]] == [(5002, 4.0)] * 4 + [(5001, 4.0)] * 4
    assert fence_from_items(items) == plan.fence


@each(
    ("content", "said"),
    [
        (b"", "the file is empty"),
        (b"hello", "is neither a QGroundControl plan"),
        (b"\xff\xfe", "line 1: is not UTF-8"),
        (b'{"a": 1,\n "b": }', "line 2: not JSON"),
        (b"{}", "has no items"),
        (b"[" * 3, "is neither"),
        (b'{"a":' * 100_000, "nested too deeply"),
        (wpl(HOME_ROW, version="120"), "line 1: version 120"),
        (wpl(HOME_ROW, "1 0 3 16 0 0 0 0 43.78 -79.46"), "line 3: 10 columns, not 12"),
        (wpl(HOME_ROW, "2 0 3 16 0 0 0 0 43.78 -79.46 10 1"), "line 3: item 1 is missing"),
        (wpl(HOME_ROW, "0 0 3 16 0 0 0 0 43.78 -79.46 10 1"), "line 3: item 0 is repeated"),
        (wpl(HOME_ROW, "1 0 3 16 x 0 0 0 43.78 -79.46 10 1"), "line 3: could not convert"),
        (wpl(HOME_ROW, "1 0 3 16 inf 0 0 0 43.78 -79.46 10 1"), "line 3: param1 = inf is infinite"),
        (wpl(HOME_ROW, "1 0 3 16 0 0 0 0 1e300 -79.46 10 1"), "line 3: "),
        (wpl(HOME_ROW, "1 0 3 16.5 0 0 0 0 43.78 -79.46 10 1"), "line 3: 16.5 is not a whole number"),
        (wpl(HOME_ROW, "1 0 3 70000 0 0 0 0 43.78 -79.46 10 1"), "line 3: command 70000"),
        (wpl(HOME_ROW, "1 0 3 5001 3 0 0 0 43.78 -79.46 10 1"), "fence item 1: the fence is not closed"),
        (wpl(HOME_ROW, "1 0 3 5003 9 0 0 0 43.78 -79.46 10 1", "2 0 3 16 0 0 0 0 1 1 1 1"), "line 4: command 16"),
        (
            plan_file(item_entry(1), item_entry(3), item_entry(4, command=177, params=[1, 1, 0, 0, 0, 0, 0])),
            "item 2: is missing: the next one in the file is number 3, and a DO_JUMP names a number",
        ),
        (b'{"version": "3.0", "items": []}', "version 3.0 is not supported, only 1 or 2 is"),
        (b'{"version": "one", "items": []}', 'version "one" is not supported'),
        (plan_file(item_entry(1, params=[0] * 6)), "item 1: params: must hold 7 numbers, not 6"),
        (plan_file(item_entry(1, params=None)), "item 1: params: must be a list, not null"),
        (plan_file(item_entry(1, params=[0, "x", 0, 0, 0, 0, 0])), 'item 1: param2: must be a number, not "x"'),
        (plan_file(item_entry(1, params=[0, 10**400, 0, 0, 0, 0, 0])), "item 1: param2: is not a finite number"),
        (plan_file(item_entry(1, command=None)), "item 1: command"),
        (plan_file(item_entry(1, type="Odd")), 'item 1: type "Odd"'),
        (plan_file({"type": "ComplexItem", "complexItemType": "survey"}), 'item 1: "survey" holds no items'),
        (plan_file(geoFence={"version": 3}), "geoFence: version 3"),
        (plan_file(geoFence={"version": 2, "polygons": [{"polygon": [[91, 0]]}]}), "fence polygon 1: latitude 91"),
        (plan_file(geoFence={"version": 2, "circles": [{"circle": {"center": [1, 2]}}]}), "fence circle 1: radius"),
        (plan_file(rallyPoints={"version": 2, "points": [[1, 2]]}), "rally point 1: must hold 3 numbers"),
        (
            plan_file(item_entry(1), item_entry(1, command=177, params=[1, 1, 0, 0, 0, 0, 0])),
            "the items' numbers (doJumpId) are out of order",
        ),
    ],
)
def test_what_is_no_plan_is_refused_with_the_place_and_the_reason(content: bytes, said: str) -> None:
    assert said in refusal(content)
    assert refusal(content).startswith("a.plan: ")


def test_a_file_larger_than_any_plan_is_not_parsed() -> None:
    assert "MiB" in refusal(b"{" + b" " * MAX_FILE_BYTES)


@given(st.binary(max_size=200) | st.binary(max_size=200).map(lambda tail: b"QGC WPL 110\n" + tail))
def test_any_bytes_are_a_plan_or_a_plan_file_error(content: bytes) -> None:
    try:
        read_plan(content, "x")
    except PlanFileError as error:
        assert str(error).startswith("x: ")


json_values = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=3),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.sampled_from(["polygon", "version"]), inner),
    max_leaves=8,
)


ITEM_KEYS = ["type", "command", "frame", "params", "doJumpId", "coordinate", "complexItemType", "Items"]
json_items = st.dictionaries(
    st.sampled_from(ITEM_KEYS), json_values | st.sampled_from(["ComplexItem", "StructureScan"])
)
PARTS = dict.fromkeys(("polygons", "circles", "points", "plannedHomePosition"), json_values)
PARTS["items"] = st.lists(json_items, max_size=3)
json_sections = json_values | st.fixed_dictionaries({"version": st.just(2)}, optional=PARTS)
SECTIONS = ["mission", "geoFence", "rallyPoints", "items", "complexItems", "plannedHomePosition"]


@given(st.dictionaries(st.sampled_from(SECTIONS), json_sections), st.booleans())
def test_any_json_is_a_plan_or_a_plan_file_error(sections: dict[str, Any], whole: bool) -> None:
    root = {"version": 1, **sections, **({"fileType": "Plan"} if whole else {})}
    try:
        read_plan(json.dumps(root).encode(), "x")
    except PlanFileError as error:
        assert str(error).startswith("x: ")


float32s = st.floats(width=32, allow_nan=False, allow_infinity=False) | st.none()
int32s = st.integers(-(2**31), 2**31 - 1)
items = st.builds(
    MissionItem,
    command=st.integers(0, 4999) | st.integers(5101, 65535),
    frame=st.integers(0, 20),
    params=st.tuples(float32s, float32s, float32s, float32s),
    **{"x": int32s, "y": int32s, "z": float32s, "autocontinue": st.booleans()},
)
corners = st.tuples(st.floats(-90, 90), st.floats(-180, 180))
fences = st.builds(
    FencePlan,
    st.lists(st.builds(FencePolygon, st.booleans(), st.lists(corners, min_size=1, max_size=5).map(tuple))).map(tuple),
    st.lists(st.builds(FenceCircle, st.booleans(), corners, st.floats(0.125, 1e5, width=32))).map(tuple),
)
homes = st.builds(PlannedHome, st.floats(1, 90), st.floats(-180, 180), st.floats(-500, 9000))
own_settings = st.builds(PlanSettings, st.integers(0, 20), st.integers(0, 40))
missions = st.lists(items, max_size=6).map(tuple)
plans = st.builds(MissionPlan, mission=missions, fence=fences, home=homes | st.none(), settings=own_settings)


@given(plans)
def test_any_plan_survives_both_formats(plan: MissionPlan) -> None:
    assert read_plan(write_plan(plan, "a.plan").encode(), "a.plan").plan == plan
    for kind in plan.holds():
        again = read_plan(write_plan(plan, "a.txt", only=kind).encode(), "a.txt").plan
        assert again.items(kind) == plan.items(kind)
        assert again.home == plan.home


@given(fences, items)
def test_a_fence_survives_its_items_and_an_item_its_message_fields(fence: FencePlan, item: MissionItem) -> None:
    assert fence_from_items(fence_items(fence)) == fence
    assert MissionItem.from_fields(item.values()) == item


def test_not_set_is_nan_on_the_wire_and_null_in_a_plan() -> None:
    item = MissionItem.from_params(16, 3, (0.0, None, math.nan, None, None, None, None), True)
    values = item.values()
    assert all(math.isnan(values[name]) for name in ("param2", "param3", "z"))
    assert (values["x"], values["y"]) == (UNSET_INT, UNSET_INT)
    assert item.seven == (0.0, *[None] * 6) and item.position is None
    assert [MissionItem(16, frame).frame for frame in (5, 6, 11, 2)] == [0, 3, 10, 2], "a frame has two names"


def test_a_jump_names_the_item_in_the_plan_and_the_sequence_number_on_the_wire() -> None:
    jump = MissionItem(177, 2, (2.0, -1.0, 0.0, 0.0))
    plan = read_plan(wpl(HOME_ROW, "1 0 3 16 0 0 0 0 1 2 10 1", "2 0 2 177 2 -1 0 0 0 0 0 1"), "a.txt").plan
    assert plan.mission[1] == jump
    assert to_wire(plan.mission, None)[1].params[0] == 1.0
    assert from_wire(to_wire(plan.mission, None), first_is_home=False) == plan.mission
    assert plan.home is not None
    sent = to_wire(plan.mission, plan.home.item())
    assert sent[2] == jump and sent[0].position == (43.78, -79.46)
    assert from_wire(sent, first_is_home=True) == plan.mission


def test_a_file_that_begins_with_an_item_numbers_its_jumps_from_zero() -> None:
    plan = read_plan(wpl("0 1 3 22 0 0 0 0 0 0 10 1", "1 0 2 177 0 1 0 0 0 0 0 1"), "a.txt").plan
    assert plan.home is None
    assert [item.command for item in plan.mission] == [22, 177]
    assert plan.mission[1].params[0] == 1.0


@pytest.mark.parametrize(
    ("rows", "noted"),
    [
        (("0 1 3 16 0 0 0 0 43.78 -79.46 343 1", "1 0 3 16 0 0 0 0 43.79 -79.46 50 1"), True),
        (("0 1 3 22 0 0 0 0 0 0 10 1", "1 0 3 16 0 0 0 0 43.79 -79.46 50 1"), False),
        ((HOME_ROW, "1 0 3 16 0 0 0 0 43.79 -79.46 50 1"), False),
        (("0 1 0 16 0 0 0 0 0 0 0 1", "1 0 3 16 0 0 0 0 43.79 -79.46 50 1"), False),
        (("0 1 3 5001 3 0 0 0 1 1 0 1", "1 0 3 5001 3 0 0 0 1 2 0 1", "2 0 3 5001 3 0 0 0 2 2 0 1"), False),
    ],
)
def test_a_first_waypoint_that_other_programs_take_for_home_is_noted(rows: tuple[str, ...], noted: bool) -> None:
    imported = read_plan(wpl(*rows), "a.txt")
    assert any("line 2 is flown to" in note for note in imported.notes) == noted
    assert len(imported.notes) == noted


def test_a_first_waypoint_that_looks_like_home_stays_an_item() -> None:
    plan = MissionPlan(mission=(MissionItem.from_params(16, 0, (0.0, 0.0, 0.0, 0.0, 1.0, 2.0, 300.0), True),))
    assert read_plan(write_plan(plan, "a.txt").encode(), "a.txt").plan == plan


def test_numbers_that_are_no_sequence_are_counted_again_where_no_jump_uses_them() -> None:
    gap = "item 2 has the number (doJumpId) 3, as if one were missing before it"
    for numbers, said in (((1, 1), "renumbered"), ((1, 3, 4), gap)):
        imported = read_plan(plan_file(*map(item_entry, numbers)), "a.plan")
        assert len(imported.plan.mission) == len(numbers)
        (note,) = imported.notes
        assert said in note


def old_mission(**changes: Any) -> bytes:
    """A .mission of QGroundControl 3.0: its version is text, it has no file type, home is an item."""
    place = {"autoContinue": True, "command": 16, "frame": 0, "id": 0, "type": "missionItem"}
    place |= {f"param{n}": 0 for n in range(1, 5)}
    items = [
        {**place, "command": 22, "frame": 3, "id": 1, "coordinate": [47.1, 8.2, 20]},
        {**place, "frame": 3, "id": 2, "coordinate": [47.2, 8.3, 25]},
        {**place, "command": 177, "frame": 2, "id": 3, "param1": 1, "param2": 4, "coordinate": [0, 0, 0]},
    ]
    root = {
        "MAV_AUTOPILOT": 12,
        "complexItems": [],
        "groundStation": "QGroundControl",
        "items": items,
        "version": "1.0",
    }
    return json.dumps({**root, "plannedHomePosition": {**place, "coordinate": [47.0, 8.0, 480]}, **changes}).encode()


@each("version", ["1.0", "1", 1, 1.0])
def test_qgroundcontrols_first_mission_format(version: Any) -> None:
    plan = read_plan(old_mission(version=version), "old.mission").plan
    assert [item.command for item in plan.mission] == [22, 16, 177]
    assert plan.mission[1].position == (47.2, 8.3) and plan.mission[1].z == 25
    assert plan.mission[2].params[:2] == (1.0, 4.0)
    assert plan.home == PlannedHome(47.0, 8.0, 480.0) and plan.settings.firmware_type == 12


@each(("version", "noted"), [(5, False), (2, False), (7, True), ("5", True), (None, True)])
def test_a_survey_of_an_unknown_version_is_noted_and_read(version: Any, noted: bool) -> None:
    stored = {"TransectStyleComplexItem": {"Items": [item_entry(2), item_entry(3)], "version": 1}}
    survey = {"type": "ComplexItem", "complexItemType": "survey", "version": version, **stored}
    imported = read_plan(plan_file(item_entry(1), survey), "a.plan")
    assert len(imported.plan.mission) == 3
    assert any("survey of the unknown version" in note for note in imported.notes) == noted


def test_comments_of_a_wpl_file_are_no_items() -> None:
    rows = ("# home", HOME_ROW, "", "  # 1 0 3 16 0 0 0 0 1 2 3 1", "1 0 3 5100 0 0 0 0 1.5 2.5 30 1")
    plain = (row for row in rows if row and "#" not in row)
    assert read_plan(wpl(*rows), "a.txt").plan == read_plan(wpl(*plain), "a.txt").plan


def test_rally_points_are_read_from_both_formats_and_above_sea_level_have_no_place_in_a_plan() -> None:
    imported = read_plan(plan_file(rallyPoints={"version": 2, "points": [[1.5, 2.5, 30]]}), "a.plan").plan
    from_text = read_plan(wpl(HOME_ROW, "1 0 3 5100 0 0 0 0 1.5 2.5 30 1"), "a.txt").plan
    assert imported.rally == from_text.rally and from_text.mission == ()
    amsl = read_plan(wpl(HOME_ROW, "1 0 0 5100 0 0 0 0 1.5 2.5 230 1"), "a.txt").plan
    with pytest.raises(PlanFileError, match="rally point 1 is in frame 0"):
        write_plan(amsl, "a.plan")


def test_a_wpl_file_holds_one_list() -> None:
    plan = public("px4-geofence_avoid.plan").plan
    with pytest.raises(PlanFileError, match="mission and fence, and a WPL file one of them: choose with --only"):
        write_plan(plan, "a.waypoints")


def test_the_name_says_the_format() -> None:
    formats = {"a.PLAN": "plan", "b.waypoints": "wpl", "c.txt": "wpl", "d.mission": "wpl"}
    assert {name: format_of(name) for name in formats} == formats
    with pytest.raises(PlanFileError, match=r"a\.kml: must end in"):
        format_of("a.kml")


def test_each_autopilot_gets_the_items_as_it_takes_them() -> None:
    """An ArduPilot refuses LOITER_TIME without a yaw and keeps no frame of a speed; a PX4 refuses one in frame 3."""
    loiter = MissionItem.from_params(19, 3, (5.0, None, None, None, 47.0, 8.0, 10.0), True)
    speed = MissionItem.from_params(178, 3, (1.0, 4.0, -1.0, 0.0, 0.0, 0.0, 0.0), True)
    home = PlannedHome(47.0, 8.0, 400.0).item()
    assert to_wire((loiter, speed), home)[1].params == (5.0, 0.0, 0.0, 0.0)
    told = (home, loiter, replace(speed, frame=0))
    assert [item.frame for item in from_wire(told, first_is_home=True)] == [3, 2]
    assert [item.frame for item in to_wire((loiter, speed), None)] == [3, 2]
    assert to_wire((loiter, speed), None)[0] == loiter, "a PX4 knows what is not set"
