"""Metadata of parameters: the tables that are shipped, what is judged by them, and hostile files."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from hypothesis import given
from hypothesis import strategies as st

import skygcs.core.params
from skygcs.core.params.metadata import (
    MetadataTable,
    ParamMetadata,
    decode,
    encode,
    ftp_path,
    general_file,
    merged,
    of_ardupilot,
    of_px4,
    table,
)
from support.table import each

FOLDER = Path(skygcs.core.params.__file__).parent
PX4, ARDUPILOT = (MetadataTable((FOLDER / f"metadata_{family}.tsv").read_bytes()) for family in ("px4", "ardupilot"))


def one(table: MetadataTable, name: str) -> ParamMetadata | None:
    return table.of([name]).get(name)


def test_the_shipped_tables_know_what_the_firmwares_say() -> None:
    """Facts of PX4's mc_pos_control_params.c and commander_params.c, and of ArduPilot's AC_WPNav.cpp."""
    cruise = one(PX4, "MPC_XY_CRUISE")
    assert cruise is not None and (cruise.unit, cruise.least, cruise.greatest) == ("m/s", 3, 20)
    assert cruise.outside(500) == "500 is outside its range of 3 to 20 m/s" and not cruise.outside(20)
    loss = one(PX4, "NAV_RCL_ACT")
    assert loss is not None and loss.meaning(2) == "Return mode" and loss.outside(0)
    reboot = {name: known.reboot for name in ("MAV_SYS_ID", "MPC_XY_CRUISE") if (known := one(PX4, name)) is not None}
    assert reboot == {"MAV_SYS_ID": True, "MPC_XY_CRUISE": False}
    speed = one(ARDUPILOT, "WPNAV_SPEED")
    assert speed is not None and speed.range_text() == "10 to 2000 cm/s"
    options = one(ARDUPILOT, "MAV_OPTIONS")
    assert options is not None and "MAV_SYSID_GCS" in options.meaning(1)
    for channel in (1, 9, 32):  # one line for all of them
        servo = one(ARDUPILOT, f"SERVO{channel}_FUNCTION")
        assert servo is not None and servo.name == f"SERVO{channel}_FUNCTION" and servo.meaning(33) == "Motor1"
    assert one(PX4, "NO_SUCH") is None and "PX4" in PX4.source and "ArduPilot" in ARDUPILOT.source


def test_many_values_are_judged_in_one_pass_as_one_is() -> None:
    values = {"MPC_XY_CRUISE": 500.0, "MPC_XY_VEL_MAX": 12.0, "PWM_MAIN_MIN3": 7, "NO_SUCH": 1, "RC1_MIN": 99.0}
    one_by_one = {n: why for n, v in values.items() if (known := one(PX4, n)) is not None and (why := known.outside(v))}
    assert PX4.outside(values) == one_by_one and set(one_by_one) == {"MPC_XY_CRUISE", "PWM_MAIN_MIN3", "RC1_MIN"}


@each(
    ("known", "value", "outside", "strange"),
    [
        (ParamMetadata("A", least=0.1, greatest=0.2), 0.1, False, False),  # as a 32-bit float it is above .1
        (ParamMetadata("A", least=0.1, greatest=0.7), 0.699999988079071, False, False),
        (ParamMetadata("A", least=10, values={-1: "off"}), -1, False, False),
        (ParamMetadata("A", least=10, values={-1: "off"}), 9, True, False),
        (ParamMetadata("A", greatest=5), 6, True, False),
        (ParamMetadata("A", least=5, zero_is_off=True), 0, False, False),
        (ParamMetadata("A", least=5, zero_is_off=True), 1, True, False),
        (ParamMetadata("A", values={0.8: "usual", 1.0: "lax"}), 0.800000011920929, False, False),
        (ParamMetadata("A", values={0.8: "usual", 1.0: "lax"}), 0.9, False, False),  # no enumeration
        (ParamMetadata("A", values={0: "off", 1: "on"}), 2, False, True),
        (ParamMetadata("A", bits={0: "first"}), 8, False, False),  # masks are listed incompletely
        (ParamMetadata("A"), 1e30, False, False),
    ],
)
def test_what_is_outside_and_what_has_no_meaning(known, value, outside, strange) -> None:
    assert (bool(known.outside(value)), bool(known.without_meaning(value))) == (outside, strange)


def test_instances_become_one_line_and_those_that_differ_keep_theirs() -> None:
    entries = [ParamMetadata(f"RC{n}_MIN", "us", 800, 2200, description=f"RC channel {n}") for n in range(1, 5)]
    entries[2] = ParamMetadata("RC3_MIN", "us", 900, 2200)
    data = table([*entries, ParamMetadata("ALONE")], "a source")
    assert [line.split("\t")[0] for line in data.decode().splitlines()] == ["# a source", "ALONE", "RC#_MIN", "RC3_MIN"]
    found = MetadataTable(data)
    least = [known.least for n in range(1, 5) if (known := one(found, f"RC{n}_MIN")) is not None]
    assert least == [800, 800, 900, 800]
    assert set(found.outside({f"RC{n}_MIN": 850 for n in range(1, 5)})) == {"RC3_MIN"}


def test_of_several_versions_the_widest_range_holds() -> None:
    old = ParamMetadata("A", "m", 0, 10, values={1: "one"})
    new = ParamMetadata("A", "m", 1, 20, reboot=True, values={1: "uno", 2: "two"}, description="new")
    assert list(merged([new, old])) == [ParamMetadata("A", "m", 0, 20, True, {1: "uno", 2: "two"}, {}, "new")]
    [of_two_units] = merged([new, ParamMetadata("A", "cm", 0, 1000)])
    assert (of_two_units.unit, of_two_units.range_text()) == ("", "")


def test_the_files_of_both_projects_are_read() -> None:
    length = {"name": "A", "type": "Float", "min": 0.5, "max": 2, "units": "m", "shortDesc": "words", "default": 1}
    choice = {"name": "B", "rebootRequired": True, "values": [{"value": 1, "description": "one"}]}
    mask = {"name": "C", "bitmask": [{"index": 3, "description": "third"}]}
    assert list(of_px4({"version": 1, "parameters": [length, choice, mask]})) == [
        ParamMetadata("A", "m", 0.5, 2, description="words"),
        ParamMetadata("B", reboot=True, values={1: "one"}),
        ParamMetadata("C", bits={3: "third"}),
    ]
    given = {"Range": {"low": "-1", "high": ".5"}, "Units": "m", "DisplayName": "words", "Description": "…"}
    simulated = {"SIM_X": {"DisplayName": "of the simulator"}}
    ardupilot = {"json": {"version": 0}, "A_": {"A_B": given}, "SIM_": simulated}
    assert list(of_ardupilot(ardupilot)) == [ParamMetadata("A_B", "m", -1, 0.5, description="words")]


def test_where_a_vehicle_says_its_file_is() -> None:
    """As PX4 1.16 (mftp://etc/extras/…) and as MAVLink's specification write it."""
    assert ftp_path("mftp://etc/extras/parameters.json.xz") == "etc/extras/parameters.json.xz"
    assert ftp_path("mftp://[;comp=1]/a/b.json\x00\x00") == "/a/b.json"
    for elsewhere in ("https://host/file", "mftp://[;comp=100]/camera.json", "mftp://", "", "mftp://a b"):
        assert ftp_path(elsewhere) is None
    entry = {"type": 1, "uri": "https://host/x", "uriFallback": "mftp://etc/x.json.xz", "fileCrc": 7}
    found = general_file({"metadataTypes": [{"type": 4, "uri": "mftp://events"}, entry]})
    assert found is not None and (found.path, found.crc) == ("etc/x.json.xz", 7)


KEYS = [
    *("parameters", "name", "min", "max", "values", "bitmask", "value", "index", "description", "units", "type"),
    *("metadataTypes", "uri", "fileCrc", "Range", "low", "Values", "Bitmask", "A", "1"),
]
JSON: st.SearchStrategy[Any] = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=20),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.sampled_from(KEYS), inner, max_size=6),
    max_leaves=20,
)


@given(JSON, st.floats())
def test_a_hostile_file_makes_a_table_or_none_and_raises_nothing(document: Any, value: float) -> None:
    for read in (of_px4, of_ardupilot):
        for known in read(document):
            again = decode(encode(known))
            assert again is not None
            again.outside(value), again.without_meaning(value), again.meaning(value)
    general_file(document)


@given(st.binary(max_size=200))
def test_a_broken_table_is_passed_over(data: bytes) -> None:
    found = MetadataTable(b"# x\n" + data)
    one(found, "A1"), found.outside({"A1": 3.0}), found.source


@given(st.text(max_size=60), st.floats(), st.floats(), st.dictionaries(st.integers(0, 63), st.text(max_size=9)))
def test_a_line_is_read_as_it_was_written(text: str, least: float, greatest: float, bits: dict[int, str]) -> None:
    line = encode(ParamMetadata("NAME_1", text, least, greatest, True, {}, bits, text))
    assert "\n" not in line and "\r" not in line
    once = decode(line)
    assert once is not None and decode(encode(once)) == once and json.dumps(once.description)
