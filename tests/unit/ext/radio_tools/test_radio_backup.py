"""A radio's settings as a file, and back."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from skygcs.errors import ConfigError
from skygcs.ext.radio_tools.change import Visit, look
from skygcs.ext.radio_tools.settings import (
    Difference,
    Firmware,
    RadioState,
    Register,
    differences,
    from_toml,
    restorable,
    to_toml,
)
from skygcs.sim.at_modem import AtRadio, Kind
from support.at_bench import Cable
from support.table import each


@each("kind", list(Kind))
def test_a_backup_holds_the_radio(kind: Kind) -> None:
    state = Cable(AtRadio(kind)).run(look(Visit(), (57600,), None))
    again = from_toml(to_toml(state, "Read from /dev/ttyUSB0.\nin the field"), "backup.toml")
    assert again.values == state.values
    assert (again.banner, again.firmware, again.board, again.unique_id) == (
        state.banner,
        state.firmware,
        state.board,
        state.unique_id,
    )
    assert "FORMAT" not in restorable(again)


@given(st.text(max_size=60), st.text(max_size=20))
def test_whatever_a_radio_tells_the_file_can_be_read(banner: str, board: str) -> None:
    state = RadioState(banner, Firmware.SIK, {"NETID": Register("S3", "NETID", 25)}, board)
    assert from_toml(to_toml(state), "x").values == {"NETID": 25}


@each(
    ("text", "said"),
    [
        ("a = ", "Invalid value"),
        ("version = 2\n[radio]\nbanner = 'x'\nfirmware = 'SiK'\n[registers]\nNETID = 1", "version: must be 1"),
        ("version = 1\n[registers]\nNETID = 1", "radio: must be a table"),
        ("version = 1\n[radio]\nbanner = 'x'\nfirmware = 'TCP'\n[registers]\nNETID = 1", "radio.firmware: must be"),
        ("version = 1\n[radio]\nbanner = 'x'\nfirmware = 'SiK'", "registers: must be a table"),
        ("version = 1\n[radio]\nbanner = 'x'\nfirmware = 'SiK'\n[registers]\nNETID = true", "registers.NETID"),
        ("#" * 70000, "this is no backup"),
    ],
)
def test_a_file_that_is_no_backup_says_what_is_wrong(text: str, said: str) -> None:
    with pytest.raises(ConfigError, match=said):
        from_toml(text, "backup.toml")


def test_differences_name_both_values_and_what_only_one_has() -> None:
    assert differences({"A": 1, "B": 2, "C": 3}, {"B": 2, "C": 4, "D": 5}) == [
        Difference("A", 1, None),
        Difference("C", 3, 4),
        Difference("D", None, 5),
    ]
