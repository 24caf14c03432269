"""Parameter files: read, refused with line and reason, written again the same."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from skygcs.core.mavlink.param_encoding import Param, ParamType, float32
from skygcs.core.params.param_file import Entry, ParamFile, of_vehicle, parse, write
from skygcs.errors import ConfigError
from support.public_data import present, public_file, public_folder
from support.table import each

QGC = """# Onboard parameters for Vehicle 4
#
# Stack: PX4 Pro
# Vehicle: Multi-Rotor
# Version: 1.16.0
#
# Vehicle-Id Component-Id Name Value Type
4\t1\tMPC_THR_HOVER\t0.500000000000000000\t9
4\t1\tNAV_RCL_ACT\t2\t6
"""


def test_reads_qgroundcontrols() -> None:
    file = parse(QGC, "a.params")
    assert file.kind == "qgc" and file.sysids == {4}
    assert file.about == {"Stack": "PX4 Pro", "Vehicle": "Multi-Rotor", "Version": "1.16.0"}
    assert [(e.name, e.value, e.type, e.compid) for e in file.entries] == [
        ("MPC_THR_HOVER", 0.5, ParamType.REAL32, 1),
        ("NAV_RCL_ACT", 2, ParamType.INT32, 1),
    ]
    assert write(file) == QGC


@each(
    ("line", "value", "comment"),
    [
        ("WPNAV_SPEED,500", 500, ""),
        ("WPNAV_SPEED 500.000000", 500.0, ""),
        ("WPNAV_SPEED\t-5.5e-3", -0.0055, ""),
        ("WPNAV_SPEED , 0x1F  # why", 31, "# why"),
        ("WPNAV_SPEED = .5", 0.5, ""),
        ("WPNAV_SPEED 500 @READONLY", 500, "@READONLY"),
    ],
)
def test_reads_every_way_in_which_the_others_write(line: str, value: float, comment: str) -> None:
    (entry,) = parse(f"\ufeff# mine\r\n{line}\r\n", "a.param").entries
    assert (entry.name, entry.value, type(entry.value), entry.comment) == ("WPNAV_SPEED", value, type(value), comment)


@each(
    ("text", "told"),
    [
        ("", "has no parameters"),
        ("# only this", "has no parameters"),
        ("A,1\nWPNAV_SPEED", "line 2: 'WPNAV_SPEED' is not of the form"),
        ("WPNAV_SPEED,fast", "line 1: 'fast' is not a number"),
        ("WPNAV_SPEED,nan", "line 1: 'nan' is not a number"),
        ("WPNAV_SPEED,1_000", "line 1: '1_000' is not a number"),
        ("WPNAV_SPEED,1e39", "line 1: '1e39' is too large"),
        ("THIS_NAME_IS_TOO_LONG,1", "at most 16"),
        ("A,1 and more", "line 1: 'and more' follows the value"),
        ("A,1\n\nA,2", "line 3: A is 2 here and 1 in line 1"),
        ("A" + " " * 400_000 + "#x", "line 1: 'A    "),  # took minutes
        ("@INCLUDE other.parm", "line 1: @INCLUDE is for files on board"),
        ("1\t1\tA\t1\t6\n1\t1\tB\t1", "line 2: has 4 columns"),
        ("1\t1\tA\t1\t77", "line 1: A: type '77'"),
        ("1\t1\tA\t300\t1", "line 1: A: 300 is not within 0 to 255"),
        ("999\t1\tA\t3\t6", "line 1: vehicle '999'"),
    ],
)
def test_what_is_wrong_is_told_with_its_line(text: str, told: str) -> None:
    with pytest.raises(ConfigError) as caught:
        parse(text, "a.param")
    assert told in str(caught.value) and str(caught.value).startswith("a.param: ")


def test_problems_are_told_at_once_but_not_without_end() -> None:
    with pytest.raises(ConfigError) as caught:
        parse("nothing of this is a parameter\n" * 500, "poem.txt")
    assert len(caught.value.problems) == 21


def test_the_same_line_twice_is_one_parameter() -> None:
    assert len(parse("A,1\nA,1.0\n", "a.param").entries) == 1


def test_comments_keep_their_places() -> None:
    text = "# head\nA,1  # one\n\n# for b\nB,2.5\n# end\n"
    assert write(parse(text, "a.param")) == text


FILES = public_folder("params")


@each("path", FILES)
def test_files_survive_a_round_trip(path: object) -> None:
    text = path.read_text()  # type: ignore[attr-defined]
    first = parse(text, str(path))
    assert len(first.entries) == sum(bool(line.strip()) and line[0] != "#" for line in text.splitlines())
    second = parse(write(first), "again")
    assert second == first
    assert write(second) == write(first)


names = st.from_regex(r"[A-Z][A-Z0-9_]{0,15}", fullmatch=True)
floats = st.floats(width=32, allow_nan=False, allow_infinity=False)
params = st.one_of(
    st.builds(Param, names, floats, st.just(ParamType.REAL32)),
    st.builds(Param, names, st.integers(-(2**31), 2**31 - 1), st.just(ParamType.INT32)),
    st.builds(Param, names, st.integers(-128, 127), st.just(ParamType.INT8)),
)


@given(st.lists(params, min_size=1, max_size=20, unique_by=lambda p: p.name), st.sampled_from(["qgc", "plain"]))
def test_what_a_vehicle_holds_comes_back_from_a_file(held: list[Param], kind: str) -> None:
    file = of_vehicle(held, kind, sysid=7, compid=1, about={"Stack": "PX4 Pro"})  # type: ignore[arg-type]
    again = parse(write(file), "x")
    assert again.sysids == {7} and again.about["Stack"] == "PX4 Pro"
    values = {e.name: (float32(e.value) if isinstance(e.value, float) else e.value) for e in again.entries}
    assert values == {p.name: p.value for p in held}
    if kind == "qgc":
        assert {e.name: e.type for e in again.entries} == {p.name: p.type for p in held}


@given(st.text(max_size=200))
def test_no_text_does_anything_but_be_read_or_refused(text: str) -> None:
    try:
        file = parse(text, "x")
    except ConfigError:
        return
    assert parse(write(file), "again").entries == file.entries


def test_a_value_that_is_no_number_is_left_out() -> None:
    file = of_vehicle([Param("A", float("nan")), Param("B", 1.0)], "plain", sysid=1, compid=1, about={})
    assert [e.name for e in file.entries] == ["B"]


def test_other_components_entries_are_told_apart() -> None:
    file = ParamFile("qgc", (Entry("A", 1, ParamType.INT32, 1, 1), Entry("CAM", 1, ParamType.INT32, 1, 100)))
    assert [e.name for e in file.of_component(1)] == ["A"]


@each(
    ("text", "rounding"),
    [
        ("A                0.123457\nB                4\nC                0.000100\n", "6 decimals"),
        ("A 0.123457\nB 0.5\n", "exact"),
        ("A,0.1234568\nB,0.5\nC,1E-05\n", "7 digits"),
        ("A,0.12345679\nB,0.1234568\n", "exact"),
        ("A,0.4\nB,7\n", "exact"),
        ("A,4\nB,0x10\n", "exact"),
        ("# Onboard parameters for Vehicle 1\nA,0.1234568\n", "exact"),  # our own has the digits that it needs
        ("1\t1\tA\t0.500000000000000000\t9\n1\t1\tB\t4\t6\n", "18 decimals"),
        ("1\t1\tA\t0.5\t9\n", "exact"),
    ],
)
def test_who_rounds_shows_in_the_digits(text: str, rounding: str) -> None:
    file = parse(text, "a")
    assert file.rounding == rounding
    assert any(entry.slack for entry in file.entries) == (rounding != "exact")


ROUNDING = {
    "made-px4.params": "18 decimals",
    "made-px4-mavproxy.parm": "6 decimals",
    "made-copter-mavproxy.parm": "6 decimals",
    "made-copter-seven-digits.param": "7 digits",
    "made-copter-comments.param": "exact",
    "apcopter-4.5-eagle-mavproxy.parm": "6 decimals",
    "px4-mavproxy.parm": "6 decimals",
    "apcopter-x500v2-comments.param": "7 digits",
    "apcopter-methodic-11_battery.param": "exact",
    "px4-amovlab-f410-v1.15.4.params": "18 decimals",
}


@each("name", present("params", ROUNDING))
def test_who_rounds_in_files(name: str) -> None:
    assert parse(public_file(f"params/{name}").read_text(encoding="utf-8"), name).rounding == ROUNDING[name]
