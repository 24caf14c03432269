"""Settings by name, as different firmwares list them; values that cannot be right; what one radio's do together."""

from __future__ import annotations

import re

import pytest

from skygcs.ext.radio_tools.settings import (
    ANTENNA_MEANINGS,
    ANTENNA_MODES,
    SERIAL_BAUD,
    Firmware,
    Register,
    firmware_of,
    inconsistencies,
    missing_registers,
    parse_registers,
    resolve_name,
    why_not,
)
from support.table import each


def test_every_way_in_which_firmwares_list_a_setting_is_read() -> None:
    lines = ["S3:NETID=25", "S0: FORMAT=26", "S20:ANT_MODE(N)[0..3]=0{Ant1&2,Ant1,}", "R0:TARGET_RSSI_dBm=0",
             "S23:RATE/FREQBAND=2", "", "OK", "S4:TXPOWER=", "S5=1", "noise S6:MAVLINK=1"]  # fmt: skip
    assert parse_registers(lines) == {
        "NETID": Register("S3", "NETID", 25),
        "FORMAT": Register("S0", "FORMAT", 26),
        "ANT_MODE": Register("S20", "ANT_MODE", 0),
        "TARGET_RSSI_DBM": Register("R0", "TARGET_RSSI_DBM", 0),
        "RATE/FREQBAND": Register("S23", "RATE/FREQBAND", 2),
    }


def test_lost_lines_show_as_gaps() -> None:
    assert missing_registers(parse_registers(["S0:A=1", "S3:B=2", "R7:C=1"])) == ["S1", "S2"]
    assert missing_registers({}) == []


@each(
    ("banner", "names", "firmware"),
    [
        ("SiK 2.2 on HM-TRP", ["NETID"], Firmware.SIK),
        ("RFD SiK 3.57 on RFD900x2", ["NETID"], Firmware.SIK),
        ("RFD SiK 3.00MP on RFD900x2", [], Firmware.RFD_MULTIPOINT),
        ("RFD SiK 2.75MP on RFD900xR1.1", ["NODEID"], Firmware.RFD_MULTIPOINT),
        ("MP SiK 2.6 on RFD900P", ["NODEID", "NODECOUNT"], Firmware.SIK_MULTIPOINT),
        ("RFD ASYNC 2.47 on RFD900xR1.1", ["NODEID"], Firmware.ASYNC),
    ],
)
def test_the_firmware_shows_in_banner_and_settings(banner: str, names: list[str], firmware: Firmware) -> None:
    assert firmware_of(banner, names) is firmware


def test_a_setting_is_found_under_either_of_its_names() -> None:
    radio = {"RXFRAME": Register("S6", "RXFRAME", 1), "DUTY_CYCLE": Register("S11", "DUTY_CYCLE", 100)}
    assert resolve_name("mavlink", radio) == "RXFRAME"
    assert resolve_name("duty-cycle", radio) == "DUTY_CYCLE"
    with pytest.raises(KeyError, match="no setting DUTY_CICLE; did you mean DUTY_CYCLE"):
        resolve_name("DUTY_CICLE", radio)


@each(
    ("name", "good", "bad"),
    [
        ("NETID", (0, 25, 65535), (65536,)),
        ("TXPOWER", (0, 30), (31,)),
        ("MAVLINK", (0, 1, 2), (3,)),
        ("DUTY_CYCLE", (1, 100), (0, 101)),
        ("LBT_RSSI", (0, 25, 220), (24, 221)),
        ("MIN_FREQ", (0, 902_000), (902,)),
        ("NODEID", (1, 16), (0, 17, 255)),
        ("NODEDESTINATION", (1, 16, 255, 65535), (0, 17, 300)),
        ("FORMAT", (), (26,)),
        ("SERIAL_SPEED", tuple(SERIAL_BAUD), (57600, 58)),
        ("ANT_MODE", (0, 1, 2, 3), (4, 99)),
        ("GPO1_3STATLED", (0, 99), ()),
    ],
)
def test_values_that_cannot_be_right_are_known(name: str, good: tuple[int, ...], bad: tuple[int, ...]) -> None:
    assert [v for v in good if why_not(name, v, Firmware.RFD_MULTIPOINT)] == []
    for value in bad:
        assert name in (why_not(name, value, Firmware.RFD_MULTIPOINT) or "")


OWN_WORDS = "S20:ANT_MODE(N)[0..3]=0{Ant1&2,Ant1,Ant2,Ant1=TX;2=RX,}"
"""The oracle: the answer to ATI5? of an RFD900x's firmware, as published."""


def test_antenna_modes_mean_what_the_radio_itself_says_of_them() -> None:
    own = OWN_WORDS[OWN_WORDS.index("{") + 1 : -1].rstrip(",").split(",")
    assert len(own) == len(ANTENNA_MEANINGS) == len(ANTENNA_MODES) == 4
    for word, mode in ANTENNA_MODES.items():
        radio, ours = own[mode], ANTENNA_MEANINGS[mode]
        assert re.findall(r"[12]", radio) == (["1", "2"] if word == "both" else re.findall(r"[12]", word))
        assert ("TX" in radio) == ("sends" in ours) and ("&" in radio) == ("both" in ours)


def test_open_sik_counts_nodes_from_zero() -> None:
    assert why_not("NODEID", 0, Firmware.SIK_MULTIPOINT) is None
    assert why_not("NODEDESTINATION", 255, Firmware.SIK_MULTIPOINT) is None
    assert why_not("NODEID", 32768, Firmware.SIK_MULTIPOINT) is not None


@each(
    ("values", "said"),
    [
        ({"AIR_SPEED": 80}, "AIR_SPEED 80 is not one"),
        ({"MIN_FREQ": 928_000, "MAX_FREQ": 915_000}, "not below MAX_FREQ"),
        ({"NODEID": 3, "NODEDESTINATION": 3}, "the node itself"),
        ({"NODEID": 3, "NODECOUNT": 3}, "must be the highest node id and one"),
        ({"RXFRAME": 0}, "no RADIO_STATUS"),
        ({"NODEID": 3, "RTSCTS": 0}, "RTSCTS is off"),
        ({"DUTY_CYCLE": 40}, "silent for the rest"),
    ],
)
def test_settings_that_nobody_wants_together_are_told(values: dict[str, int], said: str) -> None:
    (text,) = inconsistencies(values, Firmware.RFD_MULTIPOINT)
    assert said in text


def test_a_sound_radio_has_nothing_to_tell() -> None:
    values = {"AIR_SPEED": 64, "MAVLINK": 1, "DUTY_CYCLE": 100, "RTSCTS": 0}
    assert inconsistencies(values, Firmware.SIK) == []
