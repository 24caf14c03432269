"""What a person writes for a module's settings, and how they are shown."""

from __future__ import annotations

import pytest

from skygcs.core.xbee.registers import (
    MEANING,
    SHOWN,
    order_of_writing,
    parse_setting,
    problems,
    same_value,
    show_setting,
)
from support.table import each


@each(
    ("name", "text", "value", "shown"),
    [
        ("BD", "115200", b"\x07", "115200"),
        ("BD", "7", b"\x07", "115200"),
        ("ID", "0x1234", b"\x12\x34", "0x1234"),
        ("ID", "0", b"\0", "0x0"),
        ("AP", "2", b"\x02", "2"),
        ("NI", "alpha 1", b"alpha 1", "alpha 1"),
        ("CM", "0xFFFFFFFFFFFFFFFF", b"\xff" * 8, "0xFFFFFFFFFFFFFFFF"),
    ],
)
def test_settings_are_read_and_shown(name: str, text: str, value: bytes, shown: str) -> None:
    assert parse_setting(name, text) == value
    assert show_setting(name, value) == shown


@each(
    ("name", "text", "why"),
    [
        ("NP", "72", "can only be read"),
        ("IDX", "1", "two letters"),
        ("ID", "x", "is not a number"),
        ("ID", "-1", "is not 0"),
        ("BD", "12345", "no rate"),
        ("NI", "a" * 21, "1 to 20"),
        ("NI", "ä", "ASCII"),
        ("KY", "12", "32 or 64"),
    ],
)
def test_wrong_settings_are_named(name: str, text: str, why: str) -> None:
    with pytest.raises(ValueError, match=why):
        parse_setting(name, text)


def test_padding_is_no_difference() -> None:
    assert same_value("ID", b"\0\x12", b"\x12") and not same_value("NI", b"\0a", b"a")


def test_what_may_end_the_conversation_is_written_last() -> None:
    assert order_of_writing(["AP", "ID", "NI", "BD", "TO"]) == ["NI", "TO", "ID", "BD", "AP"]


def test_a_ground_module_that_does_not_fit_is_reported() -> None:
    assert len(problems({"AP": b"\0", "D7": b"\0", "EE": b"\0"})) == 3
    assert problems({"AP": b"\2", "D7": b"\1", "EE": b"\1"}) == []


def test_every_shown_setting_has_its_meaning() -> None:
    assert set(SHOWN) == set(MEANING)
