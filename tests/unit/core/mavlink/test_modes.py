from __future__ import annotations

import pytest
from pymavlink import mavutil
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from skygcs.core.mavlink import modes
from support.table import each
from support.vehicles import flight_dialect

PX4_MODES = """AUTO.PRECLAND AUTO.FOLLOW_TARGET AUTO.RTGS AUTO.LAND AUTO.RTL AUTO.MISSION RATTITUDE AUTO.LOITER
    STABILIZED AUTO.TAKEOFF OFFBOARD POSCTL ALTCTL AUTO.READY ACRO MANUAL"""


def test_every_px4_mode_goes_to_a_number_and_back() -> None:
    names = modes.mode_names(modes.AUTOPILOT_PX4, 2)
    assert len(names) == len(set(names)) >= 25
    for name in {*names, *PX4_MODES.split()}:
        assert modes.px4_mode_name(modes.px4_custom_mode(name)) == name


def test_px4_numbers_are_those_seen_on_the_wire() -> None:
    seen = {50593792: "AUTO.LOITER", 33816576: "AUTO.TAKEOFF", 100925440: "AUTO.LAND", 393216: "OFFBOARD"}
    assert {number: modes.px4_mode_name(number) for number in seen} == seen


def test_px4_modes_agree_with_pymavlinks_table() -> None:
    ours = {"LOITER": "AUTO.LOITER", "MISSION": "AUTO.MISSION", "RTL": "AUTO.RTL", "LAND": "AUTO.LAND"}
    ours |= {"TAKEOFF": "AUTO.TAKEOFF", "FOLLOWME": "AUTO.FOLLOW_TARGET", "RTGS": "AUTO.RTGS"}
    for name, (_, main, sub) in mavutil.px4_map.items():
        assert modes.px4_custom_mode(ours.get(name, name)) == main << 16 | sub << 24, name
        assert modes.px4_custom_mode(name) == main << 16 | sub << 24, name


def test_arducopter_modes_agree_with_pymavlinks_table_and_the_dialects_enum() -> None:
    for number, name in mavutil.mode_mapping_acm.items():
        assert modes.ardupilot_mode_name(2, number) == name
        assert modes.copter_mode_number(name) == number
    for number, entry in flight_dialect().enums["COPTER_MODE"].items():
        assert modes.ardupilot_mode_name(2, number) == entry.removeprefix("COPTER_MODE_")


def test_every_type_has_the_table_that_pymavlink_has_for_it_and_no_other_types_get_a_copters() -> None:
    """Wings, and the multirotor without a number of motors, are ours alone."""
    ours_alone = {*range(22, 26), 16, 17, 28, 43, 47}
    for kind in mavlink.enums["MAV_TYPE"]:
        theirs = mavutil.mode_mapping_bynumber(kind)
        if theirs is not None:
            assert {n: modes.ardupilot_mode_name(kind, n) for n in theirs} == theirs, kind
        elif kind not in ours_alone:
            assert modes.mode_names(modes.AUTOPILOT_ARDUPILOT, kind) == (), kind
            assert modes.ardupilot_mode_name(kind, 4) == "UNKNOWN(4)"


@each(("kind", "enum"), [(1, "PLANE_MODE"), (10, "ROVER_MODE"), (12, "SUB_MODE"), (5, "TRACKER_MODE")])
def test_every_mode_of_other_ardupilot_vehicles_has_a_name_of_its_own(kind: int, enum: str) -> None:
    numbers = flight_dialect().enums[enum]
    names = [modes.ardupilot_mode_name(kind, number) for number in numbers]
    assert len(set(names)) == len(numbers)
    assert not [n for n in names if n.startswith("UNKNOWN")]
    for number, name in zip(numbers, names, strict=True):
        assert modes.mode_number(modes.AUTOPILOT_ARDUPILOT, kind, name) == number


@each("written", ["auto.loiter", "AUTO_LOITER", "Auto-Loiter", "autoloiter", "hold", "LOITER"])
def test_names_are_found_however_they_are_written(written: str) -> None:
    assert modes.px4_custom_mode(written) == 50593792


def test_the_same_number_has_another_name_on_a_plane_and_unknown_numbers_show_themselves() -> None:
    names = [modes.mode_name(modes.AUTOPILOT_ARDUPILOT, kind, 1, 4) for kind in (2, 1, 10)]
    assert names == ["GUIDED", "ACRO", "HOLD"]
    assert modes.px4_mode_name(99 << 16) == "UNKNOWN(99.0)"
    assert modes.px4_mode_name(4 << 16 | 77 << 24) == "UNKNOWN(4.77)"
    assert modes.ardupilot_mode_name(2, 12) == "UNKNOWN(12)"


def test_an_unknown_name_is_refused_with_near_ones() -> None:
    with pytest.raises(KeyError, match=r"no mode 'AUTO.LOTIER'.*AUTO\.LOITER"):
        modes.px4_custom_mode("AUTO.LOTIER")
    with pytest.raises(KeyError, match="STABILIZE, ACRO"):
        modes.copter_mode_number("xyzzy")
    with pytest.raises(KeyError):
        modes.px4_custom_mode("AUTO")


def test_a_generic_autopilot_is_named_by_its_flags_and_takes_no_mode_names() -> None:
    assert modes.mode_name(0, 2, 0x04, 7) == "AUTO"
    assert modes.mode_name(0, 2, 0x40, 7) == "MANUAL"
    with pytest.raises(KeyError):
        modes.mode_number(0, 2, "AUTO")
