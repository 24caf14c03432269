"""What each firmware takes in a mission: the tables against the names in its sources, conversion, and the check."""

from __future__ import annotations

import json
from dataclasses import replace
from typing import Any

from hypothesis import given
from hypothesis import strategies as st
from pymavlink.dialects.v20 import all as every_dialect

from skygcs.config.dialects import load_dialect
from skygcs.core.mavlink.mav_cmd import NAV_RALLY_POINT
from skygcs.core.mission import firmware_items
from skygcs.core.mission.firmware_items import (
    Family,
    convert,
    for_firmware,
    grouped,
    px4_order,
    refusals,
    same_item,
    same_start,
)
from skygcs.core.mission.formats import read_plan
from skygcs.core.mission.item import FENCE_COMMANDS, UNSET_INT, MissionItem, MissionType
from skygcs.core.mission.plan import MissionPlan, PlannedHome, check_plan, errors, to_wire
from skygcs.core.protocols import mission_upload
from skygcs.sim import copter_lists, px4_lists
from support.table import each

DIALECT = load_dialect(["ardupilotmega", "px4-extras"])
NAMES = DIALECT.enums["MAV_CMD"]
NUMBERS = {entry.name: number for number, entry in every_dialect.enums["MAV_CMD"].items()}
LAT, LON = 47.3977, 8.5456

PX4_GLOBAL = """NAV_WAYPOINT NAV_LOITER_UNLIM NAV_LOITER_TIME NAV_LAND NAV_TAKEOFF NAV_LOITER_TO_ALT NAV_ROI DO_SET_ROI
    DO_SET_ROI_LOCATION NAV_VTOL_TAKEOFF NAV_VTOL_LAND CONDITION_GATE"""
PX4_MISSION = """DO_JUMP NAV_ROI DO_SET_ROI DO_WINCH DO_GRIPPER DO_CHANGE_SPEED DO_SET_HOME DO_LAND_START
    DO_TRIGGER_CONTROL DO_DIGICAM_CONTROL DO_MOUNT_CONFIGURE DO_MOUNT_CONTROL DO_GIMBAL_MANAGER_PITCHYAW
    SET_CAMERA_FOCUS DO_GIMBAL_MANAGER_CONFIGURE IMAGE_START_CAPTURE IMAGE_STOP_CAPTURE VIDEO_START_CAPTURE
    VIDEO_STOP_CAPTURE DO_CONTROL_VIDEO DO_SET_CAM_TRIGG_DIST OBLIQUE_SURVEY DO_SET_CAM_TRIGG_INTERVAL SET_CAMERA_MODE
    SET_CAMERA_SOURCE DO_VTOL_TRANSITION NAV_DELAY NAV_RETURN_TO_LAUNCH DO_SET_ROI_WPNEXT_OFFSET DO_SET_ROI_NONE
    CONDITION_DELAY CONDITION_DISTANCE DO_SET_ACTUATOR"""
"""The cases of parse_mavlink_mission_item, PX4 v1.16.1."""

PX4_BEFORE_TAKEOFF = """NAV_DELAY DO_JUMP DO_CHANGE_SPEED DO_SET_HOME DO_LAND_START DO_TRIGGER_CONTROL
    DO_DIGICAM_CONTROL IMAGE_START_CAPTURE IMAGE_STOP_CAPTURE VIDEO_START_CAPTURE VIDEO_STOP_CAPTURE DO_CONTROL_VIDEO
    DO_MOUNT_CONFIGURE DO_MOUNT_CONTROL DO_GIMBAL_MANAGER_PITCHYAW DO_GIMBAL_MANAGER_CONFIGURE DO_SET_ROI
    DO_SET_ROI_LOCATION DO_SET_ROI_WPNEXT_OFFSET DO_SET_ROI_NONE DO_SET_CAM_TRIGG_DIST OBLIQUE_SURVEY
    DO_SET_CAM_TRIGG_INTERVAL SET_CAMERA_MODE SET_CAMERA_SOURCE SET_CAMERA_FOCUS DO_VTOL_TRANSITION NAV_ROI"""
"""FeasibilityChecker::checkTakeoff of the same, as far as they can be uploaded; NAV_ROI becomes DO_SET_ROI there."""

ARDUPILOT = """NAV_WAYPOINT NAV_LOITER_UNLIM NAV_LOITER_TURNS NAV_LOITER_TIME NAV_RETURN_TO_LAUNCH NAV_LAND NAV_TAKEOFF
    NAV_CONTINUE_AND_CHANGE_ALT NAV_LOITER_TO_ALT NAV_SPLINE_WAYPOINT NAV_GUIDED_ENABLE NAV_DELAY CONDITION_DELAY
    CONDITION_DISTANCE CONDITION_YAW DO_JUMP DO_JUMP_TAG JUMP_TAG DO_CHANGE_SPEED DO_SET_HOME DO_SET_RELAY
    DO_REPEAT_RELAY DO_SET_SERVO DO_REPEAT_SERVO DO_RETURN_PATH_START DO_LAND_START DO_GO_AROUND DO_SET_ROI_LOCATION
    DO_SET_ROI_NONE DO_SET_ROI DO_DIGICAM_CONFIGURE DO_DIGICAM_CONTROL DO_MOUNT_CONTROL DO_SET_CAM_TRIGG_DIST
    DO_FENCE_ENABLE DO_AUX_FUNCTION DO_PARACHUTE DO_INVERTED_FLIGHT DO_GRIPPER DO_GUIDED_LIMITS DO_AUTOTUNE_ENABLE
    NAV_ALTITUDE_WAIT NAV_VTOL_TAKEOFF NAV_VTOL_LAND DO_VTOL_TRANSITION DO_SET_REVERSE DO_ENGINE_CONTROL
    NAV_PAYLOAD_PLACE NAV_SET_YAW_SPEED DO_WINCH DO_SET_RESUME_REPEAT_DIST DO_SPRAYER DO_SEND_SCRIPT_MESSAGE
    NAV_SCRIPT_TIME NAV_ATTITUDE_TIME DO_PAUSE_CONTINUE DO_GIMBAL_MANAGER_PITCHYAW IMAGE_START_CAPTURE
    IMAGE_STOP_CAPTURE SET_CAMERA_ZOOM SET_CAMERA_FOCUS SET_CAMERA_SOURCE VIDEO_START_CAPTURE VIDEO_STOP_CAPTURE"""
"""The cases of AP_Mission::mavlink_int_to_mission_cmd, 4.6.3."""

ARDUPILOT_LOCATION = """NAV_WAYPOINT NAV_LOITER_UNLIM NAV_LOITER_TURNS NAV_LOITER_TIME NAV_LAND NAV_TAKEOFF
    NAV_CONTINUE_AND_CHANGE_ALT NAV_LOITER_TO_ALT NAV_SPLINE_WAYPOINT NAV_GUIDED_ENABLE DO_SET_HOME
    DO_RETURN_PATH_START DO_LAND_START DO_GO_AROUND DO_SET_ROI_LOCATION DO_SET_ROI NAV_VTOL_TAKEOFF NAV_VTOL_LAND
    NAV_PAYLOAD_PLACE"""
"""AP_Mission::stored_in_location of the same, without fences and rally points."""

COPTER_SKIPS = """NAV_CONTINUE_AND_CHANGE_ALT DO_GO_AROUND DO_INVERTED_FLIGHT DO_AUTOTUNE_ENABLE NAV_ALTITUDE_WAIT
    DO_VTOL_TRANSITION DO_SET_REVERSE DO_ENGINE_CONTROL NAV_SET_YAW_SPEED DO_PAUSE_CONTINUE"""
"""Of ARDUPILOT what neither AP_Mission::start_command nor ModeAuto::start_command knows."""


@each(
    ("table", "names"),
    [
        (firmware_items.PX4_PLACED, PX4_GLOBAL),
        (firmware_items.PX4_PLACELESS, PX4_MISSION),
        (firmware_items.PX4_NO_PLACE_YET, PX4_BEFORE_TAKEOFF),
        (firmware_items.ARDUPILOT_TAKEN, ARDUPILOT),
        (firmware_items.ARDUPILOT_PLACED, ARDUPILOT_LOCATION),
        (firmware_items.COPTER_SKIPS, COPTER_SKIPS),
    ],
)
def test_the_tables_are_those_of_the_sources(table: frozenset[int], names: str) -> None:
    assert table == {NUMBERS[f"MAV_CMD_{name}"] for name in names.split()}


def item(command: int, *params: float | None, frame: int = 3) -> MissionItem:
    """The seven numbers as a file has them; those not given are 0."""
    return MissionItem.from_params(command, frame, (*params, *[0.0] * (7 - len(params))), True)


TAKEOFF = item(22, 0, 0, 0, None, LAT, LON, 20)
WAYPOINT = item(16, 0, 0, 0, None, LAT, LON + 0.0005, 20)


@each(
    ("family", "given", "becomes", "said"),
    [
        ("px4", item(20, 0, 0, 0, 0, LAT, LON, 20), item(20, frame=2), "the position of NAV_RETURN_TO_LAUNCH"),
        ("px4", item(20), item(20, frame=2), None),
        ("px4", item(20, 0, 0, 0, 0, 5, 7, 0, frame=2), item(20, frame=2), "the position of NAV_RETURN_TO_LAUNCH"),
        ("px4", item(178, 1, 5, -1), item(178, 1, 5, -1, frame=2), None),
        ("px4", item(1000, 1, 2, 3, 4, 16, 0, 1), item(1000, 1, 2, 3, 4, 16, 0, 1, frame=2), None),
        ("px4", item(187, 1, 0, 0, 0, 0.5), item(187, 1, 0, 0, 0, 0.5), None),
        ("px4", item(16, 1, 2, 3, 4, LAT, LON, 9), item(16, 1, 2, 0, 4, LAT, LON, 9), "param3 of NAV_WAYPOINT"),
        ("px4", item(22, 15, 0, 0, 4, LAT, LON, 9), item(22, 15, 0, 0, 4, LAT, LON, 9), None),
        ("px4", item(201, 3, 0, 0, 0, LAT, LON, 5), item(195, 0, 0, 0, 0, LAT, LON, 5), "becomes DO_SET_ROI_LOCATION"),
        ("px4", item(530, 0, 0), item(530, frame=2), None),
        ("ardupilot", item(530, 0, 0, frame=2), None, "SET_CAMERA_MODE, which an ArduPilot does not take"),
        ("ardupilot", item(195, 1, 0, 0, 0, LAT, LON, 5), item(201, 3, 0, 0, 0, LAT, LON, 5), "becomes DO_SET_ROI"),
        ("ardupilot", item(197, frame=2), item(201, frame=0), "becomes DO_SET_ROI without a position"),
        ("ardupilot", item(21, 0, 0, 0, None, None, None, None), item(21, 0, 0, 0, None, 0, 0, 0), None),
        ("ardupilot", item(20, 0, 0, 0, 0, LAT, LON, 20), item(20, 0, 0, 0, 0, LAT, LON, 20), None),
    ],
)
def test_conversion(family: Family, given: MissionItem, becomes: MissionItem | None, said: str | None) -> None:
    converted, texts = convert(given, family, NAMES)
    assert converted == becomes
    assert len(texts) == (said is not None) and all(str(said) in text for text in texts)


@each(
    ("family", "given", "said"),
    [
        ("px4", item(18, 2, 0, 5, 0, LAT, LON, 20), "PX4 takes no NAV_LOITER_TURNS in a mission"),
        ("px4", item(115, 90), "PX4 takes no CONDITION_YAW"),
        ("px4", item(531, 1, 1), "PX4 takes no SET_CAMERA_ZOOM"),
        ("px4", item(16, 0, 0, 0, 0, LAT, LON, 9, frame=10), "PX4 takes no item in frame 10"),
        ("px4", item(21, 0, 0, 0, 0, 1, 1, 0, frame=1), "PX4 takes no item in frame 1"),
        ("px4", item(22, 0, 0, 0, 0, 47, 8, 50, frame=2), "PX4 takes NAV_TAKEOFF with a position only"),
        ("px4", item(22, 0, 0, 0, None, 0, 0, 20), "has no position (0, 0): a PX4 flies there"),
        ("px4", item(21, 0, 0, 0, None, None, None, 0), "has no position"),
        ("px4", item(179, 0, 0, 0, 0, LAT, LON, 400, frame=0), "with param1 = 1 (its position then) only"),
        ("px4", item(187, 1, 0, 0, 0, 0.5), "with whole numbers in param5 and param6 only"),
        ("px4", item(201, 1, 0, 0, 0, LAT, LON, 5), "with param1 0 or 3 only"),
        ("px4", item(112, 5), "and then rejects the mission: use NAV_DELAY"),
        ("px4", item(400, 0, frame=2), "from 1.17 on only"),
        ("ardupilot", item(214, 5), "ArduPilot takes no DO_SET_CAM_TRIGG_INTERVAL"),
        ("ardupilot", item(196, frame=2), "ArduPilot takes no DO_SET_ROI_WPNEXT_OFFSET"),
        ("ardupilot", item(17, 0, 0, 0, 0, 1, 1, 5, frame=1), "in frames 0 (AMSL)"),
        ("ardupilot", item(22, 0, 0, 0, 0, 47, 8, 50, frame=2), "in frame 2 as AMSL"),
        ("ardupilot", item(201, 3, 0, 0, 0, None, None, 5), "without a position"),
        ("ardupilot", item(31, 0, 0, 0, 0, LAT, LON, None), "whose altitude is not set"),
        ("ardupilot", item(21, 0, 0, 0, 0, LAT, LON, 90000), "no altitude of 90000 m"),
    ],
)
def test_what_cannot_be_converted_is_an_error_of_the_check(family: Family, given: MissionItem, said: str) -> None:
    plan = MissionPlan((TAKEOFF, given), home=PlannedHome(LAT, LON, 480.0))
    told = [str(f) for f in errors(check_plan(plan, DIALECT, family=family))]
    assert any(text.startswith("mission item 2: ") and said in text for text in told), told


@each(
    ("family", "given", "said"),
    [
        ("px4", item(3000, 4), "unless the vehicle is a VTOL"),
        ("px4", item(201, 0, 0, 0, 0, LAT, LON, 5), "reads param1 = 0 of DO_SET_ROI as: no region of interest"),
        ("ardupilot", item(223, 1), "an ArduCopter takes DO_ENGINE_CONTROL and skips it"),
    ],
)
def test_what_is_taken_and_does_nothing_is_a_warning(family: Family, given: MissionItem, said: str) -> None:
    findings = check_plan(MissionPlan((TAKEOFF, given)), DIALECT, family=family)
    assert not errors(findings) and any(said in str(f) for f in findings)


def test_a_px4_takes_off_before_all_other_places() -> None:
    speed, back = item(178, 1, 5, frame=2), item(20, frame=2)
    assert list(px4_order((speed, TAKEOFF, WAYPOINT, back))) == []
    assert [n for n, _ in px4_order((WAYPOINT, TAKEOFF))] == [2]
    assert [n for n, _ in px4_order((TAKEOFF, back, TAKEOFF))] == [3]
    findings = check_plan(MissionPlan((WAYPOINT, TAKEOFF)), DIALECT, family="px4")
    assert any("take-off must come before" in str(f) for f in errors(findings))
    assert not errors(check_plan(MissionPlan((WAYPOINT, TAKEOFF)), DIALECT, family="ardupilot"))


def survey(*before: dict[str, Any]) -> bytes:
    """A survey as QGroundControl stores it, with the camera mode that it sets."""
    place = {"type": "SimpleItem", "autoContinue": True}
    items = [
        {**place, "command": 530, "frame": 2, "params": [0, 2, None, None, None, None, None]},
        {**place, "command": 16, "frame": 3, "params": [0, 0, 0, None, LAT, LON, 50]},
        {**place, "command": 206, "frame": 2, "params": [25, 0, 1, 0, 0, 0, 0]},
        {**place, "command": 16, "frame": 3, "params": [0, 0, 0, None, LAT, LON + 0.001, 50]},
        {**place, "command": 206, "frame": 2, "params": [0, 0, 1, 0, 0, 0, 0]},
    ]
    complex_item = {
        "type": "ComplexItem",
        "complexItemType": "survey",
        "version": 5,
        "TransectStyleComplexItem": {"version": 1, "Items": items},
    }
    takeoff = {**place, "command": 22, "frame": 3, "params": [0, 0, 0, None, LAT, LON, 50]}
    mission = {"version": 2, "items": [takeoff, *before, complex_item], "plannedHomePosition": [LAT, LON, 480]}
    return json.dumps({"fileType": "Plan", "version": 1, "mission": mission}).encode()


def test_a_survey_goes_to_an_ardupilot_without_its_camera_mode() -> None:
    plan = read_plan(survey(), "survey.plan").plan
    made = for_firmware(plan.mission, "ardupilot", NAMES)
    assert [i.command for i in made.items] == [22, 16, 206, 16, 206]
    assert [(c.item, c.text.split(",")[0]) for c in made.changes] == [(2, "SET_CAMERA_MODE")]
    assert not errors(check_plan(plan, DIALECT, family="ardupilot"))
    assert for_firmware(plan.mission, "px4", NAMES).changes == ()
    assert not errors(check_plan(plan, DIALECT, family="px4"))
    assert for_firmware(plan.mission, None, NAMES).items == plan.mission


@given(dropped=st.lists(st.booleans(), min_size=1, max_size=8), jumps=st.data())
def test_jumps_name_the_same_item_after_some_were_left_out(dropped: list[bool], jumps: st.DataObject) -> None:
    """Every item that stays has an altitude of its own, by which the target is known again."""
    items = [item(530, frame=2) if gone else item(16, 0, 0, 0, 0, LAT, LON, n) for n, gone in enumerate(dropped, 1)]
    target = jumps.draw(st.integers(1, len(items)))
    mission = (*items, item(177, target, 2, frame=2))
    made = for_firmware(mission, "ardupilot", NAMES).items
    found = made[int(made[-1].params[0] or 0) - 1]
    expected = next(i for i in mission[target - 1 :] if i.command != 530)
    assert found.command == expected.command and (found.z == expected.z)


def test_changes_of_a_kind_are_one_line() -> None:
    many = tuple(item(20, 0, 0, 0, 0, LAT, LON, 20) for _ in range(12))
    (line,) = grouped(for_firmware(many, "px4", NAMES).changes)
    assert line.startswith("items 1, 2, 3, 4, 5, 6, 7, 8 and 4 more: the position of NAV_RETURN_TO_LAUNCH")
    assert grouped(for_firmware(many[:2], "px4", NAMES).changes)[0].startswith("items 1 and 2: ")
    assert grouped(()) == []


def test_events_by_which_a_px4_rejects_a_mission() -> None:
    """The ids are those that a PX4 1.16.1 sent for such missions."""
    assert mission_upload.rejection(33440290) == "the take-off is not the first item with a position"
    assert mission_upload.rejection(25552931) == "a command that it does not fly"
    assert mission_upload.rejection(1) is None and mission_upload.rejection(0) is None
    ids = [mission_upload.event_id(name) for name in mission_upload.REASONS]
    assert len(set(ids)) == len(ids) and all(1 << 24 <= number < 1 << 25 for number in ids)


COMMANDS = sorted(set(NAMES) - FENCE_COMMANDS - {NAV_RALLY_POINT})
VALUES = st.none() | st.sampled_from([0.0, 1.0, 2.0, 3.0, -1.0, 0.5, 250.0])
ITEMS = st.builds(
    MissionItem,
    st.sampled_from(COMMANDS) | st.sampled_from(sorted(firmware_items.PX4_PLACELESS | firmware_items.ARDUPILOT_TAKEN)),
    st.sampled_from([0, 1, 2, 3, 10]),
    st.tuples(VALUES, VALUES, VALUES, VALUES),
    st.sampled_from([0, 1, round(LAT * 1e7), UNSET_INT]),
    st.sampled_from([0, 1, round(LON * 1e7), UNSET_INT]),
    VALUES,
)


@given(given_item=ITEMS)
def test_what_the_check_lets_pass_is_taken_and_what_is_refused_it_has_said(given_item: MissionItem) -> None:
    """Against the simulated firmwares, which have their own tables and look at an item on their own."""
    for family in ("px4", "ardupilot"):
        made = for_firmware((given_item,), family, NAMES).items  # type: ignore[arg-type]
        if not made:
            continue
        plan = MissionPlan((given_item,))
        said = any(f.item == 1 for f in errors(check_plan(plan, DIALECT, family=family)))  # type: ignore[arg-type]
        if family == "px4":
            (sent,) = to_wire(made, None)
            taken = px4_lists.refusal_of(MissionType.MISSION, sent) == 0
        else:
            sent = to_wire(made, MissionItem(16, 0))[1]
            taken = copter_lists.refusal_of(MissionType.MISSION, sent, 2) == 0
        assert taken or said, (family, sent)


@given(given_item=ITEMS)
def test_conversion_is_done_once_and_for_all(given_item: MissionItem) -> None:
    families: tuple[Family, ...] = ("px4", "ardupilot")
    for family in families:
        made, _ = convert(given_item, family, NAMES)
        if made is not None:
            assert convert(made, family, NAMES) == (made, [])
            list(refusals(made, family, NAMES))
            list(refusals(replace(made, params=(None,) * 4), family, NAMES))


HOLD = item(16, 2.5, 30, 0, -90, LAT, LON, 20)
CIRCLE = MissionItem(5003, 0, (50.0, 0.0, 0.0, 0.0), 1, 2)


@each(
    ("family", "sent", "kept"),
    [
        # mavlink_int_to_mission_cmd and back, ArduPilot 4.6.3
        ("ardupilot", HOLD, item(16, 2, 0, 0, 0, LAT, LON, 20)),
        ("ardupilot", HOLD, item(16, 2, 0, 0, 0, LAT, LON, 20.01)),
        ("ardupilot", item(16, 0, 30, 5, 0, LAT, LON, 20), item(16, 0, 30, 5, 0, LAT, LON, 20)),  # ArduPlane
        ("ardupilot", item(17, 0, 0, -20.5, None, LAT, LON, 20), item(17, 0, 0, -20, 0, LAT, LON, 20)),
        ("ardupilot", item(18, 0.5, 0, -307, 1, LAT, LON, 20), item(18, 0.5, 0, -300, 1, LAT, LON, 20)),
        ("ardupilot", item(18, 2.5, 0, 80.5, 0, LAT, LON, 20), item(18, 2, 0, 80, 0, LAT, LON, 20)),
        ("ardupilot", item(19, 7, 0, 0, None, LAT, LON, 20), item(19, 7, 0, 1, 0, LAT, LON, 20)),
        ("ardupilot", item(21, 0, 1, 0, None, LAT, LON), item(21, 0, 0, 0, 1, LAT, LON)),
        ("ardupilot", item(22, 15.5, 0, 0, 90, LAT, LON, 20), item(22, 15, 0, 0, 0, LAT, LON, 20)),
        ("ardupilot", item(178, 1, 3.5, -1, 1, frame=2), item(178, 1, 3.5, -1, 0, frame=0)),
        ("ardupilot", item(20, 0, 0, 0, 0, LAT, LON, 20), item(20, frame=0)),
        ("ardupilot", item(205, -90, 0, 0, 0, 0, 0, 3, frame=2), item(205, -90, 0, 0, 0, 0, 0, 2, frame=0)),
        ("ardupilot", item(189, 0, 0, 0, 0, frame=2), item(189, frame=0)),
        ("ardupilot", item(5000, 0, 0, 0, 0, LAT, LON, 30), item(5000, 0, 0, 0, 0, LAT, LON, 0, frame=0)),
        ("ardupilot", item(5100, 0, 0, 0, 0, LAT, LON, 15.7), item(5100, 0, 0, 0, 0, LAT, LON, 15)),
        ("ardupilot", item(16, 0, 30.5, 300, 0, LAT, LON, 20), item(16, 0, 30, 255, 0, LAT, LON, 20)),  # ArduPlane
        ("ardupilot", item(94, 1.2, 0, 0, 0, LAT, LON, 20), item(94, 1.1999999, 0, 0, 0, LAT, LON, 20)),
        ("ardupilot", item(42702, 1, 10, 0.1, 0.3, frame=2), item(42702, 1, 10, 0.09998, 0.30005, frame=2)),
        ("ardupilot", item(183, 9, 1500, 7, 0, frame=2), item(183, 9, 1500, 0, 0, frame=0)),
        # parse_mavlink_mission_item and format_mavlink_mission_item, PX4 v1.16.1
        ("px4", item(5000, 0, 0, 0, 0, LAT, LON, 30), item(5000, 0, 0, 0, 0, LAT, LON, 30, frame=0)),
        ("px4", item(80, 0, 0, 0, 0, LAT, LON, 20), item(201, 0, 0, 0, 0, LAT, LON, 20)),
        ("px4", item(177, 3, -1, frame=2), item(177, 3, 65535, frame=2)),
        ("px4", HOLD, item(16, 2.5, 30, 0, 270.00001, LAT, LON, 20, frame=6)),
        ("px4", item(16, 0, 0, 7, None, LAT, LON, 20), item(16, 0, 0, 0, None, LAT, LON, 20)),
        ("px4", item(19, 7, 5, 30, None, LAT, LON, 20), item(19, 7, 1, 30, 0, LAT, LON, 20)),
        ("px4", item(22, 15, 0, 0, 0, LAT, LON, 20), item(22, 0, 0, 0, 359.99999, LAT, LON, 20)),
        ("px4", item(31, 1, -40, 0, 1, LAT, LON, 20), item(31, 1, -40, 0, 1, LAT, LON, 20)),
        ("px4", item(195, 0, 0, 0, 0, LAT, LON, 20), item(195, 0, 0, 0, 0, LAT, LON, 20)),
        ("px4", item(178, 1, 3.5, -1, 0, frame=2), item(178, 1, 3.5, -1, 0, frame=2)),
        ("px4", CIRCLE, replace(CIRCLE, frame=5, autocontinue=False)),
    ],
)
def test_an_item_that_a_firmware_has_taken_is_known_again(family: Family, sent: MissionItem, kept: MissionItem) -> None:
    assert same_item(sent, kept, family) and same_item(sent, sent, family) and same_item(sent, sent, None)
    assert same_start((sent, sent), (kept, replace(kept, command=0), kept), family) == 1


@each(
    ("families", "sent", "kept"),
    [
        ("px4 ardupilot", CIRCLE, replace(CIRCLE, params=(500.0, 0.0, 0.0, 0.0))),
        ("px4 ardupilot", replace(CIRCLE, command=5001, params=(4.0, 0.0, 0.0, 0.0)), replace(CIRCLE, command=5001)),
        ("px4 ardupilot", item(16, 0, 0, 0, None, LAT, LON, 20), item(16, 0, 0, 0, None, LAT, LON, 20, frame=0)),
        ("px4 ardupilot", item(16, 0, 0, 0, None, LAT, LON, 20), item(16, 5, 0, 0, None, LAT, LON, 20)),
        ("px4 ardupilot", item(16, 5, 0, 0, None, LAT, LON, 20), item(16, 0, 0, 0, None, LAT, LON, 20)),
        ("px4 ardupilot", item(178, 1, 15, -1, frame=2), item(178, 1, 3, -1, frame=2)),
        ("px4 ardupilot", item(178, 1, 3.5, -1, frame=2), item(178, 1, 3, -1, frame=2)),
        ("px4 ardupilot", item(5100, 0, 0, 0, 0, LAT, LON, 20), item(5100, 0, 0, 0, 0, LAT, LON, 20, frame=0)),
        ("px4", item(16, 0, 0, 0, None, LAT, LON, 20), item(16, 0, 0, 0, 0, LAT, LON, 20)),
        ("px4", item(16, 0, 0, 0, 90, LAT, LON, 20), item(16, 0, 0, 0, 91, LAT, LON, 20)),
        ("px4 ardupilot", item(5100, 0, 0, 0, 0, LAT, LON, 16), item(5100, 0, 0, 0, 0, LAT, LON, 15)),
        ("px4", WAYPOINT, replace(WAYPOINT, autocontinue=False)),
        ("ardupilot", item(1000, 1, 2, 3, 4, 16, 0, 1, frame=2), item(1000, 1, 2, 3, 4, 16, 0, 2, frame=2)),
    ],
)
def test_another_item_is_not_taken_for_the_one_that_was_sent(families, sent, kept) -> None:
    for family in ("px4", "ardupilot"):
        assert family not in families.split() or not same_item(sent, kept, family)
