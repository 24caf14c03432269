"""Sets of parameters compared, and the plan of applying a file."""

from __future__ import annotations

import math

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from skygcs.core.mavlink.param_encoding import Param, ParamType, equal, float32, short_float
from skygcs.core.params.compare import diff, plan
from skygcs.core.params.names import other_name, sort_of
from skygcs.core.params.param_file import Entry, parse
from support.table import each

I32, F32 = ParamType.INT32, ParamType.REAL32


@each(
    ("old", "new"),
    [
        *(("SYSID_THISMAV", "MAV_SYSID"), ("SYSID_MYGCS", "MAV_GCS_SYSID")),
        *(("SR0_EXTRA1", "MAV1_EXTRA1"), ("SR3_EXT_STAT", "MAV4_EXT_STAT")),
    ],
)
def test_both_generations_of_names_are_one(old: str, new: str) -> None:
    assert other_name(old) == new and other_name(new) == old
    assert diff([Entry(old, 1)], [Entry(new, 1.0)]) == []
    (found,) = diff([Entry(old, 1)], [Entry(new, 2)])
    assert (found.name, found.other, found.first, found.second) == (old, new, 1, 2)
    assert other_name("MAV_0_RATE") is other_name("MAV_SYS_ID") is None, "PX4's instances are no generations"


@each(
    ("sort", "names"),
    [
        ("calibration", "COMPASS_OFS_X COMPASS_OFS2_Z COMPASS_DEV_ID INS_ACCOFFS_X INS_ACC2SCAL_Y INS_GYR3OFFS_Z"),
        ("calibration", "INS_ACC_ID INS4_ACC_ID AHRS_TRIM_X CAL_ACC0_XOFF RC3_MIN"),
        ("settings", "INS_GYR_CAL INS_GYRO_FILTER INS_HNTCH_FREQ RC_MAP_ROLL WPNAV_SPEED COMPASS_USE"),
        ("statistics", "STAT_RUNTIME BARO1_GND_PRESS GND_ABS_PRESS2 SYS_NUM_RESETS CMD_TOTAL _HASH_CHECK"),
        ("identity", "MAV_SYS_ID"),
    ],
)
def test_names_tell_what_belongs_to_one_vehicle(sort: str, names: str) -> None:
    assert {name: sort_of(name) for name in names.split()} == dict.fromkeys(names.split(), sort)


def test_values_are_compared_as_vehicles_hold_them() -> None:
    assert equal(float32(0.1), 0.1)
    assert not equal(0.5, 0.48) and not equal(0.1, 0.15) and not equal(float32(0.45), 0.4)
    assert not equal(0.1, math.nextafter(float32(0.1), 1) + 2e-8)
    assert equal(0.000120, 0.00012034, 0.5e-6)
    assert not equal(0.000120, 0.00012054, 0.5e-6)
    assert not equal(16777216, 16777217)
    assert equal(16777217, 16777216.0), "a vehicle that is sent floats holds no other"
    assert equal(3, 3.0) and not equal(3, 3.1)
    assert not equal(1e39, 1.0) and not equal(10**400, 1.0), "no 32-bit float, and no traceback"


def written_by(writer: str, values: list[float]) -> str:
    """A file of these values P0, P1, … as this program writes it. The last two show how it rounds."""
    values = [*values, float32(0.1234567), float32(1.5)]
    lines = {
        "MAVProxy": [f"{f'P{n}':<16} {v:f}" for n, v in enumerate(values)],
        "Mission Planner": [f"P{n},{format(v, '.7g')}" for n, v in enumerate(values)],
        "QGroundControl": [f"1\t1\tP{n}\t{v:.18f}\t9" for n, v in enumerate(values)],
        "by hand": [f"P{n},{short_float(v)}" for n, v in enumerate([*values, float32(0.12345679)])],
    }
    return "\n".join(lines[writer]) + "\n"


WRITERS = ("MAVProxy", "Mission Planner", "QGroundControl", "by hand")
FLOATS = st.floats(-1e7, 1e7, width=32) | st.floats(-1, 1, width=32)


@pytest.mark.parametrize("writer", WRITERS)
@given(first=FLOATS, second=FLOATS)
@example(first=float32(0.4), second=float32(0.45))
@example(first=float32(0.1), second=float32(0.10000001))
@example(first=float32(8388607.5), second=float32(8388607.0))
@example(first=float32(1e-7), second=float32(2e-7))
def test_a_file_hides_what_its_writer_rounds_and_nothing_else(writer: str, first: float, second: float) -> None:
    text = written_by(writer, [first])
    (entry, *_), other = parse(text, "a").entries, parse(written_by(writer, [second]), "b").entries[0]
    holds = Param("P0", second, F32)
    same_text = text.splitlines()[0] == written_by(writer, [second]).splitlines()[0]
    differs = bool(diff([entry], [Entry("P0", second)]))
    assert not differs or not same_text, "a vehicle that would give the same file differs from it"
    grain = {"MAVProxy": 1e-6, "Mission Planner": 1.001e-6 * max(abs(first), abs(second)), "QGroundControl": 1e-18}
    if abs(first - second) > grain.get(writer, 0.0):
        assert differs, "more than any rounding"
        assert diff([entry], [other]), "two files of the same writer"
        made = plan(parse(text, "a"), {"P0": holds}, sysid=1, compid=1, stack="px4")
        assert [c.name for c in made.changes] == ["P0"]


@pytest.mark.parametrize("writer", WRITERS)
@given(values=st.lists(FLOATS, min_size=1, max_size=5))
def test_a_vehicles_own_file_differs_in_nothing(writer: str, values: list[float]) -> None:
    held = [Entry(f"P{n}", value) for n, value in enumerate(values)]
    file = parse(written_by(writer, values), "a")
    assert diff(file.entries[: len(values)], held) == []


@each("writer", WRITERS)
def test_files_of_different_writers_agree_on_one_vehicle(writer: str) -> None:
    values = [float32(v) for v in (0.1, 1 / 3, 2e-5, 123456.789, -0.0087654321, 4.0)]
    for other in WRITERS:
        mine, theirs = (parse(written_by(w, values), w).entries[: len(values)] for w in (writer, other))
        assert diff(mine, theirs) == [], (writer, other)


def test_differences_tell_each_side() -> None:
    found = diff([Entry("A", 1), Entry("B", 2)], [Entry("B", 3), Entry("C", 4)])
    assert [(d.name, d.kind) for d in found] == [("A", "only_first"), ("B", "changed"), ("C", "only_second")]


HELD = {
    p.name: p
    for p in (
        Param("FENCE_ENABLE", 0, ParamType.INT8),
        Param("WPNAV_SPEED", 500.0, F32),
        Param("SYSID_THISMAV", 3, ParamType.INT16),
        Param("COMPASS_OFS_X", 1.0, F32),
        Param("STAT_BOOTCNT", 9, ParamType.INT16),
        Param("FRAME_CLASS", 1, ParamType.INT8),
        Param("RTL_ALT", 1500, I32),
    )
}


def apply(text: str, **more: object) -> object:
    options = {"sysid": 3, "compid": 1, "stack": "ardupilot"} | more
    return plan(parse(text, "a.param"), HELD, **options)  # type: ignore[arg-type]


def test_a_plan_sets_what_differs_switches_first_and_the_system_id_last() -> None:
    text = "MAV_SYSID,7\nRTL_ALT,1500\nWPNAV_SPEED,600\nFENCE_ENABLE,1\nCOMPASS_OFS_X,5\nSTAT_BOOTCNT,1\nNEW_ONE,1\n"
    made = apply(text, include=("settings", "identity"))
    assert [(c.name, c.before, c.value) for c in made.changes] == [  # type: ignore[attr-defined]
        ("FENCE_ENABLE", 0, 1),
        ("WPNAV_SPEED", 500.0, 600.0),
        ("SYSID_THISMAV", 3, 7),
    ]
    assert made.same == 1 and made.unknown == ("NEW_ONE",)  # type: ignore[attr-defined]
    assert made.skipped == (("COMPASS_OFS_X", "calibration"), ("STAT_BOOTCNT", "statistics"))  # type: ignore[attr-defined]


def test_what_is_of_one_vehicle_alone_is_left_and_a_value_its_type_cannot_hold_is_a_problem_with_its_line() -> None:
    assert apply("SYSID_THISMAV,7\nCOMPASS_OFS_X,5\n").changes == ()  # type: ignore[attr-defined]
    made = apply("RTL_ALT,1500\nFENCE_ENABLE,0.5\n")
    assert made.problems == ("line 2: FENCE_ENABLE: 0.5 is not whole; the parameter is INT8",)  # type: ignore[attr-defined]


@each(
    ("text", "warning"),
    [
        ("# Onboard parameters for Vehicle 5\nRTL_ALT,1", "the file is of vehicle 5; this is vehicle 3"),
        ("9\t1\tRTL_ALT\t1\t6", "the file is of vehicle 9; this is vehicle 3"),
        ("# Stack: PX4 Pro\nRTL_ALT,1", "the file is of PX4 Pro; this vehicle runs ardupilot"),
        ("FRAME_CLASS,2", "FRAME_CLASS is 2 in the file and 1 here: another airframe"),
        ("MPC_THR_HOVER,1\nRTL_ALT,1", "the vehicle has none of 1 of the file's 2 parameters"),
    ],
)
def test_a_file_of_another_vehicle_is_recognised(text: str, warning: str) -> None:
    warnings = apply(text).warnings  # type: ignore[attr-defined]
    assert any(w.startswith(warning) for w in warnings), warnings


def test_its_own_file_gives_no_warning() -> None:
    assert apply("# Onboard parameters for Vehicle 3\nRTL_ALT,1\n").warnings == ()  # type: ignore[attr-defined]
