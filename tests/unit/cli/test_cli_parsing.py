"""What people type as values."""

from __future__ import annotations

from typing import Any

import pytest
import typer
from hypothesis import given
from hypothesis import strategies as st

from skygcs.cli.main import hoisted
from skygcs.cli.parsing import name_or_id, parse_link, parse_number, parse_pairs, parse_unset_number, parse_value
from support.table import each


@each(
    ("text", "value"),
    [
        ("1", 1),
        ("-7", -7),
        ("0x1F", 31),
        ("1.5", 1.5),
        ("-1e-3", -0.001),
        ("true", True),
        ("False", False),
        ("nan", None),
        ("null", None),
        ("inf", None),
        ("1,2,-3.5", [1, 2, -3.5]),
        ("[1, 2]", [1, 2]),
        ("1,nan", [1, None]),
        ("[1, NaN, 1e999]", [1, None, None]),
        ('{"a": 1}', {"a": 1}),
        ('"123"', "123"),
        ("hello", "hello"),
        ("hello, world", "hello, world"),
        ("MAV_TYPE_GCS", "MAV_TYPE_GCS"),
        ("[broken", "[broken"),
        ("", ""),
        ("0xzz", "0xzz"),
        ("10.0.0.5", "10.0.0.5"),
        ("/dev/ttyUSB0", "/dev/ttyUSB0"),
    ],
)
def test_values_are_what_they_look_like(text: str, value: Any) -> None:
    parsed = parse_value(text)
    assert parsed == value and type(parsed) is type(value)


@given(st.text(max_size=40))
def test_any_text_is_some_value(text: str) -> None:
    parse_value(text)


@given(st.integers() | st.floats(allow_nan=False, allow_infinity=False))
def test_numbers_keep_their_value(number: float) -> None:
    assert parse_value(repr(number)) == number


def test_pairs_make_a_table_and_dots_nest_it() -> None:
    wanted = {"type": "udp_server", "port": 1, "rate_out": {"messages": {"ATTITUDE": 2.5}}, "note": "a=b"}
    assert parse_pairs(["type=udp_server", "port=1", "rate_out.messages.ATTITUDE=2.5", "note=a=b"]) == wanted


@each("pairs", [["x"], ["=1"], ["a=1", "a=2"], ["a=1", "a.b=2"]])
def test_wrong_pairs_are_usage_errors(pairs: list[str]) -> None:
    with pytest.raises(typer.BadParameter):
        parse_pairs(pairs)


def test_filters_and_vehicles_of_a_link_are_lists_of_one_as_well() -> None:
    pairs = ["port=14561", "vehicles=kite", "translated_sysid=1", "allow_src_sys_in=5"]
    assert parse_link(pairs) == {"port": 14561, "vehicles": ["kite"], "translated_sysid": 1, "allow_src_sys_in": [5]}
    assert parse_link(["vehicles=kite,6"]) == {"vehicles": ["kite", 6]}


def test_numbers_are_finite_or_named_in_the_error() -> None:
    assert parse_number("-79.2", "LON") == -79.2
    for text in ("x", "nan", "inf", ""):
        with pytest.raises(typer.BadParameter, match="LON"):
            parse_number(text, "LON")
    assert parse_unset_number("-", "P1") is None and parse_unset_number("nan", "P1") is None
    assert name_or_id("33") == 33 and name_or_id("ATTITUDE") == "ATTITUDE"


@each(
    ("given_args", "expected"),
    [
        (["status", "--socket", "/s"], ["--socket", "/s", "status"]),
        (["status", "--socket=/s", "all"], ["--socket=/s", "status", "all"]),
        (["--socket", "/s", "status"], ["--socket", "/s", "status"]),
        (["call", "x", "--", "--socket", "/s"], ["call", "x", "--", "--socket", "/s"]),
        (["status", "--socket"], ["--socket", "status"]),
        (["goto", "1", "-5", "-3"], ["goto", "1", "-5", "-3"]),
    ],
)
def test_global_options_may_stand_anywhere(given_args: list[str], expected: list[str]) -> None:
    assert hoisted(given_args) == expected
