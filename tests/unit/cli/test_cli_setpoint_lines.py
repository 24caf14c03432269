"""Setpoints as lines of text: JSON, CSV with and without a header, and what is neither."""

from __future__ import annotations

import json
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from skygcs.cli.setpoint import LARGEST_LINE, LineError, LineReader, SplitLines
from support.table import each

numbers = st.floats(-1e6, 1e6)
vectors = st.tuples(numbers, numbers, numbers).map(list)


def read(*lines: str) -> list[tuple[str | None, dict[str, Any]]]:
    reader = LineReader()
    return [found for line in lines if (found := reader.read(line)) is not None]


@given(pos=vectors, vel=vectors, yaw=numbers, vehicle=st.none() | st.sampled_from(["alpha", "3"]))
def test_json_and_csv_say_the_same(pos: list[float], vel: list[float], yaw: float, vehicle: str | None) -> None:
    wanted = [(vehicle, {"pos_enu_m": pos, "vel_enu_mps": vel, "yaw_deg": yaw})]
    given = {"pos": pos, "vel": vel, "yaw_deg": yaw} | ({} if vehicle is None else {"vehicle": vehicle})
    assert read(json.dumps(given)) == wanted
    row = ",".join([vehicle or "", *(repr(x) for x in (*pos, *vel, yaw))])
    assert read("vehicle, x, y, z, vx, vy, vz, yaw_deg", row) == wanted


def test_without_a_header_a_row_is_a_position_and_perhaps_a_yaw() -> None:
    assert read("1,2,-3", "4, 5, 6, 90") == [
        (None, {"pos_enu_m": [1.0, 2.0, -3.0]}),
        (None, {"pos_enu_m": [4.0, 5.0, 6.0], "yaw_deg": 90.0}),
    ]


def test_an_axis_may_have_a_velocity_instead_of_a_position() -> None:
    level = {"pos_enu_m": [None, None, 5.0], "vel_enu_mps": [1.0, 0.0, None]}
    assert read('{"pos": [null, null, 5], "vel": [1, 0, null]}') == [(None, level)]
    assert read("z,vx,vy", "5,1,0") == [(None, level)]
    assert read('{"vel": [1, 0, 0]}') == [(None, {"vel_enu_mps": [1.0, 0.0, 0.0]})]


def test_nothing_and_remarks_are_passed_over_and_a_system_id_is_a_name() -> None:
    assert read("", "# a remark", '{"pos": [1, 2, 3], "vehicle": 7}') == [("7", {"pos_enu_m": [1.0, 2.0, 3.0]})]


@each(
    ("lines", "reason"),
    [
        (["bad"], "neither JSON nor a row"),
        (["1,2"], "neither JSON nor a row"),
        (["1,2,x"], "z: 'x' is not a number"),
        (["1,2,nan"], "z: 'nan' is not a finite number"),
        (["x,y,z", "1,2"], "2 cells; the header has 3"),
        (["x,y,w"], "no column 'w'"),
        (["x,y,z,x"], "twice"),
        (["x,y,z", "1,,3"], "x without y"),
        (["x,y,z", ",,"], "neither a position nor a velocity"),
        (["{"], "not JSON"),
        (["{" + "[" * 900], "not JSON"),
        (['{"pos": [1, 2, 1e999]}'], "not JSON"),
        (['{"pos": [1, 2]}'], "three numbers"),
        (['{"pos": [1, 2, "3"]}'], "three numbers"),
        (['{"pos": [1, 2, true]}'], "three numbers"),
        (['{"pos": [1, 2, %s]}' % ("9" * 400)], "three numbers"),
        (['{"position": [1, 2, 3]}'], "no key 'position'"),
        (['{"pos": [1, 2, null]}'], "z has neither"),
        (['{"pos": [1, 2, 3], "acc": [1, null, 2]}'], "all three axes"),
        (['{"pos": [1, 2, 3], "yaw_deg": "n"}'], "yaw_deg"),
        (['{"pos": [1, 2, 3], "vehicle": [1]}'], "vehicle"),
        (['{"yaw_deg": 3}'], "neither a position nor a velocity"),
    ],
)
def test_a_wrong_line_has_a_reason(lines: list[str], reason: str) -> None:
    with pytest.raises(LineError, match=reason):
        read(*lines)


@given(st.text(max_size=80))
def test_any_text_is_a_setpoint_or_a_line_error(text: str) -> None:
    try:
        read("1,2,3", text)
    except LineError as error:
        assert str(error)


@given(st.binary(max_size=4000), st.lists(st.integers(1, 700), min_size=1, max_size=9))
def test_lines_do_not_depend_on_how_the_bytes_come(data: bytes, sizes: list[int]) -> None:
    whole, parts = SplitLines(), SplitLines()
    wanted = [*whole.feed(data), *whole.end()]
    found = []
    at = 0
    for i in range(len(data) + 1):
        if at >= len(data):
            break
        size = sizes[i % len(sizes)]
        found += parts.feed(data[at : at + size])
        at += size
    assert [*found, *parts.end()] == wanted


def test_a_line_without_end_keeps_no_memory_and_the_next_one_is_read() -> None:
    lines = SplitLines()
    for _ in range(1000):
        assert list(lines.feed(b"x" * 1000)) == []
    assert len(lines._rest) <= LARGEST_LINE
    assert list(lines.feed(b"x\n1,2,3\n")) == [(1, None), (2, "1,2,3")]
    assert list(lines.feed(b"4,5,6")) == [] and list(lines.end()) == [(3, "4,5,6")]


RAW = [
    ('{"att": [5, -3, 90], "thrust": 0.5}', "roll_deg,pitch_deg,yaw_deg,thrust", "5,-3,90,0.5"),
    ('{"att": [1, 0, 0, 0], "thrust": 0.5}', "qw,qx,qy,qz,thrust", "1,0,0,0,0.5"),
    ('{"rates": [10, 0, -5], "thrust": 0.5}', "roll_rate,pitch_rate,yaw_rate,thrust", "10,0,-5,0.5"),
    ('{"acc": [0.5, 0, -1]}', "ax,ay,az", "0.5,0,-1"),
    ('{"acc": [0.5, 0, -1], "yaw_deg": 7}', "ax,ay,az,yaw_deg", "0.5,0,-1,7"),
]
RAW_PARAMS: list[dict[str, Any]] = [
    {"roll_deg": 5.0, "pitch_deg": -3.0, "yaw_deg": 90.0, "thrust": 0.5},
    {"attitude": [1.0, 0.0, 0.0, 0.0], "thrust": 0.5},
    {"body_rates_deg_s": [10.0, 0.0, -5.0], "thrust": 0.5},
    {"acc_enu_mps2": [0.5, 0.0, -1.0]},
    {"acc_enu_mps2": [0.5, 0.0, -1.0], "yaw_deg": 7.0},
]


@each(("lines", "expected"), list(zip(RAW, RAW_PARAMS, strict=True)))
def test_json_and_csv_of_an_own_controller_say_the_same(lines: tuple[str, str, str], expected: dict[str, Any]) -> None:
    as_json, header, row = lines
    assert read(as_json) == [(None, expected)]
    assert read(header, row) == [(None, expected)]


@each(
    ("lines", "reason"),
    [
        (['{"att": [5, -3, 90]}'], "need a thrust"),
        (['{"thrust": 0.5}'], "one of them"),
        (['{"att": [5, 90], "thrust": 0.5}'], "a list of 3 or 4 numbers"),
        (['{"att": [5, null, 90], "thrust": 0.5}'], "a list of 3 or 4 numbers"),
        (['{"att": [5, 0, 90], "thrust": true}'], "thrust: must be a number"),
        (['{"att": [5, 0, 90], "thrust": %s}' % ("9" * 400)], "thrust: must be a number"),
        (['{"att": [5, 0, %s], "thrust": 0.5}' % ("9" * 400)], "a list of 3 or 4 numbers"),
        (['{"att": [5, 0, 90], "yaw_deg": 3, "thrust": 0.5}'], "att has the yaw"),
        (['{"rates": [5, 0, 90], "acc": [0, 0, 0], "thrust": 0.5}'], "one of them"),
        (['{"acc": [0, 0, 0], "thrust": 0.5}'], "no thrust beside"),
        (['{"acc": [0, null, 0]}'], "all three axes"),
        (['{"att": [5, 0, 90], "thrust": 0.5, "pos": [1, 2, 3]}'], "exclude position"),
        (["roll_deg,pitch_deg,thrust", "1,2,0.5"], "needs roll, pitch and yaw"),
        (["roll_rate,yaw_rate,thrust", "1,2,0.5"], "give all of them or none"),
    ],
)
def test_what_is_no_raw_setpoint_is_reported(lines: list[str], reason: str) -> None:
    with pytest.raises(LineError, match=reason):
        read(*lines)
