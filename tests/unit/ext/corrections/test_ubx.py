"""UBX against pyubx2: what we send is what it reads, and what it makes is what we read."""

from __future__ import annotations

from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pyubx2 import GET, UBX_CONFIG_DATABASE, UBXMessage, UBXReader, calc_checksum

from skygcs.ext.corrections import ubx
from skygcs.ext.corrections.receiver_stream import ReceiverStream
from support.base_receiver import ack, nav_svin, settings_in
from support.table import each


def read(data: bytes) -> list[ubx.UbxMessage]:
    return [message for message in ReceiverStream().feed(data) if isinstance(message, ubx.UbxMessage)]


@given(st.binary(max_size=300))
def test_the_checksum_is_pyubx2s(data: bytes) -> None:
    assert ubx.checksum(data) == calc_checksum(data)


@each("port", ["usb", "uart1", "uart2"])
@each("observations", ["msm4", "msm7"])
def test_the_outputs_are_those_of_that_port(port: str, observations: str) -> None:
    (settings,) = settings_in(ubx.valset(ubx.output_settings(port, observations)))
    name = port.upper()
    types = {"msm4": (1074, 1084, 1094, 1124), "msm7": (1077, 1087, 1097, 1127)}
    others = types["msm7" if observations == "msm4" else "msm4"]
    assert settings == {
        f"CFG_{name}OUTPROT_UBX": 1,
        f"CFG_{name}OUTPROT_NMEA": 0,
        f"CFG_{name}OUTPROT_RTCM3X": 1,
        f"CFG_MSGOUT_UBX_NAV_SVIN_{name}": 1,
        f"CFG_MSGOUT_RTCM_3X_TYPE1005_{name}": 10,
        f"CFG_MSGOUT_RTCM_3X_TYPE1230_{name}": 10,
        **{f"CFG_MSGOUT_RTCM_3X_TYPE{t}_{name}": 1 for t in types[observations]},
        **{f"CFG_MSGOUT_RTCM_3X_TYPE{t}_{name}": 0 for t in others},
    }


def test_a_survey_and_its_end() -> None:
    (survey,) = settings_in(ubx.valset(ubx.survey_settings(300, 1.5)))
    assert survey == {"CFG_TMODE_MODE": 1, "CFG_TMODE_SVIN_MIN_DUR": 300, "CFG_TMODE_SVIN_ACC_LIMIT": 15000}
    assert settings_in(ubx.valset(ubx.no_survey_settings())) == [{"CFG_TMODE_MODE": 0}]


@given(lat=st.floats(-90, 90), lon=st.floats(-180, 180), height=st.floats(-1000, 10000), accuracy=st.floats(0.0001, 10))
def test_a_position_is_exact_to_a_tenth_of_a_millimetre(lat: float, lon: float, height: float, accuracy: float) -> None:
    (s,) = settings_in(ubx.valset(ubx.fixed_settings(lat, lon, height, accuracy)))
    assert (s["CFG_TMODE_MODE"], s["CFG_TMODE_POS_TYPE"]) == (2, 1)
    assert s["CFG_TMODE_LAT"] * 1e-7 + s["CFG_TMODE_LAT_HP"] * 1e-9 == pytest.approx(lat, abs=1e-9)
    assert s["CFG_TMODE_LON"] * 1e-7 + s["CFG_TMODE_LON_HP"] * 1e-9 == pytest.approx(lon, abs=1e-9)
    assert s["CFG_TMODE_HEIGHT"] * 0.01 + s["CFG_TMODE_HEIGHT_HP"] * 1e-4 == pytest.approx(height, abs=1e-4)
    assert s["CFG_TMODE_FIXED_POS_ACC"] == pytest.approx(accuracy * 1e4, abs=0.51)
    for name in ("LAT_HP", "LON_HP", "HEIGHT_HP"):
        assert -99 <= s[f"CFG_TMODE_{name}"] <= 99  # of the interface description
    for name in ("LAT", "LON", "HEIGHT"):
        assert s[f"CFG_TMODE_{name}"] * s[f"CFG_TMODE_{name}_HP"] >= 0


def test_the_settings_go_into_the_ram_only() -> None:
    parsed: Any = UBXReader.parse(ubx.valset(ubx.no_survey_settings()), msgmode=1)
    assert (parsed.version, parsed.ram, parsed.bbr, parsed.flash) == (0, 1, 0, 0)


def test_every_key_is_one_of_u_bloxs() -> None:
    known = {value[0]: (name, value[1]) for name, value in UBX_CONFIG_DATABASE.items()}
    for key in ubx.Key:
        name, kind = known[key]
        assert name == f"CFG_{key.name}"
        assert ubx.value_bytes(key) == int(kind[1:])


def test_what_is_no_request_is_an_error_of_ours() -> None:
    with pytest.raises(ValueError, match="CFG-VALSET takes 64"):
        ubx.valset(dict.fromkeys(range(0x20910000, 0x20910041), 1))
    with pytest.raises(ValueError, match="not a key"):
        ubx.valset({0x00000001: 1})


@given(
    duration=st.integers(0, 2**32 - 1), accuracy=st.integers(0, 2**32 - 1), valid=st.booleans(), active=st.booleans()
)
def test_the_progress_of_a_survey_is_read(duration: int, accuracy: int, valid: bool, active: bool) -> None:
    raw = UBXMessage("NAV", "NAV-SVIN", GET, dur=duration, meanAcc=accuracy, obs=7, valid=valid, active=active)
    (message,) = read(raw.serialize())
    assert ubx.survey_of(message) == ubx.SurveyIn(duration, accuracy / 1e4, 7, valid, active)
    assert ubx.answered(message) is None


def test_answers_are_read() -> None:
    yes, no, other = read(ack() + ack(accepted=False) + UBXMessage("ACK", "ACK-ACK", GET, clsID=6, msgID=1).serialize())
    assert (ubx.answered(yes), ubx.answered(no), ubx.answered(other)) == (True, False, None)
    assert ubx.survey_of(yes) is None


@each("content", [b"", b"\0" * 39, b"\0" * 41, b"\1" + b"\0" * 39])
def test_a_nav_svin_of_another_form_is_none(content: bytes) -> None:
    assert ubx.survey_of(ubx.UbxMessage(ubx.NAV_SVIN, content)) is None
    assert ubx.answered(ubx.UbxMessage(ubx.ACK_ACK, content)) is None


def test_progress_as_pyubx2_makes_it() -> None:
    (message,) = read(nav_svin(120, 1.25))
    assert ubx.survey_of(message) == ubx.SurveyIn(120, 1.25, 120, False, True)
