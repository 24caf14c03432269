"""The protocol of a base receiver: its stream, UBX, and the dialogue that sets it up."""

from __future__ import annotations

from io import BytesIO
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pyubx2 import (
    ERR_IGNORE,
    GET,
    NMEA_PROTOCOL,
    RTCM3_PROTOCOL,
    UBX_CONFIG_DATABASE,
    UBX_PROTOCOL,
    UBXMessage,
    UBXReader,
    calc_checksum,
)

from skygcs.core.radio_link.corrections import CHECKED_PER_BYTE, CHECKED_SAVED, MAX_FRAME_BYTES, crc24q
from skygcs.errors import LinkError
from skygcs.ext.corrections import receiver_stream, ubx
from skygcs.ext.corrections.config import CorrectionsConfig
from skygcs.ext.corrections.receiver_setup import ANSWER_S, LOOK_S, SURVEY_SILENT_S, TRIES, ReceiverSetup
from skygcs.ext.corrections.receiver_stream import ReceiverStream
from skygcs.ext.corrections.ubx import MAX_CONTENT_BYTES, UbxMessage, checksum, packed
from support.base_receiver import NMEA, ack, nav_svin, settings_in
from support.rtcm import GLONASS_BIASES_1230, STANDARD_1005, rtcm_frame
from support.table import each

# -- RTCM and UBX in one stream: against pyubx2's reader, in any pieces, and with anything between.


UBX = st.one_of(
    st.builds(nav_svin, st.integers(0, 10**6), st.floats(0, 1000), valid=st.booleans()),
    st.builds(lambda accepted: ack(accepted=accepted), st.booleans()),
)
RTCM = st.one_of(
    st.just(STANDARD_1005),
    st.just(GLONASS_BIASES_1230),
    st.builds(
        rtcm_frame, st.sampled_from([1077, 1127]), body_bytes=st.integers(7, 700), fill=st.sampled_from([0, 0xD3, 0xB5])
    ),
)
ITEMS = st.lists(st.one_of(UBX, RTCM, st.just(NMEA)), max_size=10)


def read(data: bytes, size: int) -> tuple[list[bytes], ReceiverStream]:
    """The messages as they stood in the stream."""
    stream = ReceiverStream()
    found = []
    for at in range(0, len(data), size):
        for message in stream.feed(data[at : at + size]):
            found.append(packed(message.kind, message.content) if isinstance(message, UbxMessage) else message)
        assert stream.held_bytes < MAX_FRAME_BYTES + MAX_CONTENT_BYTES
    return found, stream


@given(items=ITEMS, size=st.integers(1, 100))
def test_what_pyubx2_reads_is_read_in_any_pieces(items: list[bytes], size: int) -> None:
    data = b"".join(items)
    reader = UBXReader(
        BytesIO(data), protfilter=UBX_PROTOCOL | RTCM3_PROTOCOL | NMEA_PROTOCOL, quitonerror=ERR_IGNORE, parsing=False
    )
    theirs = [raw for raw, _ in reader if raw[:1] != b"$"]
    ours, stream = read(data, size)
    assert ours == theirs == [item for item in items if item != NMEA]
    assert stream.skipped_bytes == items.count(NMEA) * len(NMEA)
    assert (stream.damaged, stream.held_bytes) == (0, 0)


@given(items=ITEMS, noise=st.lists(st.binary(max_size=60), min_size=1, max_size=10), size=st.integers(1, 100))
def test_after_noise_what_follows_is_found(items: list[bytes], noise: list[bytes], size: int) -> None:
    data = b"".join(part for pair in zip(items, noise * len(items), strict=False) for part in pair)
    found, _ = read(data + bytes(MAX_FRAME_BYTES), size)
    wanted = [item for item in items if item != NMEA]
    assert [item for item in found if item in wanted] == wanted or len(found) >= len(wanted)


def test_a_message_within_a_false_start_is_found() -> None:
    false_rtcm, false_ubx = b"\xd3\x03\xff", b"\xb5\x62\x01\x3b\xff\x03"
    for begin in (false_rtcm, false_ubx):
        found, stream = read(begin + STANDARD_1005 + ack() + bytes(1100), 64)
        assert found == [STANDARD_1005, ack()]
        assert stream.damaged == 1


def test_a_message_that_is_longer_than_any_of_ours_holds_nothing_up() -> None:
    stream = ReceiverStream()
    assert list(stream.feed(b"\xb5\x62\x01\x3b\xff\xff" + STANDARD_1005)) == [STANDARD_1005]
    assert stream.held_bytes == 0


def test_damage_is_counted() -> None:
    broken = bytearray(STANDARD_1005 + ack() + GLONASS_BIASES_1230)
    broken[10] ^= 1
    broken[len(STANDARD_1005) + 7] ^= 1
    found, stream = read(bytes(broken) + bytes(600), 5)  # the content of 1005 looks like the begin of 520 bytes
    assert found == [GLONASS_BIASES_1230]
    assert (stream.damaged, stream.rtcm, stream.ubx) == (3, 1, 0)
    assert stream.skipped_bytes == len(STANDARD_1005) + len(ack()) + 600


@each("false", [b"\xd3\x03", b"\xd3\x03\xff", b"\xd3\x00", b"\xb5\x62\x01\x3b\xff\x03"])
def test_a_stream_of_false_starts_costs_no_more_than_a_sound_one(false: bytes, monkeypatch: pytest.MonkeyPatch) -> None:
    checked: list[int] = []
    monkeypatch.setattr(receiver_stream, "crc24q", lambda raw: checked.append(len(raw)) or crc24q(raw))
    monkeypatch.setattr(ubx, "checksum", lambda raw: checked.append(len(raw)) or checksum(raw))
    stream, data = ReceiverStream(), false * 30_000
    for at in range(0, len(data), 4096):
        assert list(stream.feed(data[at : at + 4096])) == []
    assert sum(checked) <= CHECKED_PER_BYTE * len(data) + CHECKED_SAVED
    stream.feed(bytes(MAX_FRAME_BYTES + MAX_CONTENT_BYTES))
    assert list(stream.feed(STANDARD_1005)) == [STANDARD_1005]


@given(st.binary(max_size=5000))
def test_garbage_is_never_kept(data: bytes) -> None:
    for size in (1, 4096):
        _, stream = read(data, size)
        assert stream.held_bytes <= MAX_FRAME_BYTES + MAX_CONTENT_BYTES


# -- UBX against pyubx2: what we send is what it reads, and what it makes is what we read.


def ubx_messages(data: bytes) -> list[ubx.UbxMessage]:
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
    (message,) = ubx_messages(raw.serialize())
    assert ubx.survey_of(message) == ubx.SurveyIn(duration, accuracy / 1e4, 7, valid, active)
    assert ubx.answered(message) is None


def test_answers_are_read() -> None:
    yes, no, other = ubx_messages(
        ack() + ack(accepted=False) + UBXMessage("ACK", "ACK-ACK", GET, clsID=6, msgID=1).serialize()
    )
    assert (ubx.answered(yes), ubx.answered(no), ubx.answered(other)) == (True, False, None)
    assert ubx.survey_of(yes) is None


@each("content", [b"", b"\0" * 39, b"\0" * 41, b"\1" + b"\0" * 39])
def test_a_nav_svin_of_another_form_is_none(content: bytes) -> None:
    assert ubx.survey_of(ubx.UbxMessage(ubx.NAV_SVIN, content)) is None
    assert ubx.answered(ubx.UbxMessage(ubx.ACK_ACK, content)) is None


# -- The dialogue that makes a receiver a base: each row of its table.


def setup(**keys: Any) -> ReceiverSetup:
    return ReceiverSetup(CorrectionsConfig.model_validate({"serial": "/dev/ttyACM0", **keys}), "usb")


def tell(dialogue: ReceiverSetup, raw: bytes, now: float) -> list[dict[str, Any]]:
    """Settings that it sends then."""
    (message,) = ReceiverStream().feed(raw)
    assert isinstance(message, UbxMessage)
    return settings_in(dialogue.on_message(message, now))


def test_a_survey_is_begun_and_followed() -> None:
    dialogue = setup(survey_s=120, survey_accuracy_m=1.5)
    (outputs,) = settings_in(dialogue.begin(0.0))
    assert outputs["CFG_MSGOUT_RTCM_3X_TYPE1074_USB"] == 1
    assert tell(dialogue, nav_svin(0, 100.0), 0.1) == []
    assert tell(dialogue, ack(), 0.2) == []
    assert dialogue.state == "look"
    (survey,) = tell(dialogue, nav_svin(0, 100.0, active=False), 1.0)
    assert survey == {"CFG_TMODE_MODE": 1, "CFG_TMODE_SVIN_MIN_DUR": 120, "CFG_TMODE_SVIN_ACC_LIMIT": 15000}
    assert tell(dialogue, ack(), 1.1) == []
    assert (dialogue.state, dialogue.is_placed) == ("running", False)
    assert tell(dialogue, nav_svin(60, 3.0), 61.0) == []
    assert dialogue.survey is not None and dialogue.survey.duration_s == 60
    tell(dialogue, nav_svin(121, 1.4, valid=True, active=False), 122.0)
    assert dialogue.is_placed


@each(
    ("found", "kept"),
    [
        (nav_svin(600, 1.4, valid=True, active=False), True),
        (nav_svin(600, 1.6, valid=True, active=False), False),
        (nav_svin(100, 1.4, valid=True, active=False), False),
        (nav_svin(600, 1.4), False),
    ],
)
def test_a_survey_that_is_good_enough_is_kept(found: bytes, kept: bool) -> None:
    dialogue = setup(survey_s=120, survey_accuracy_m=1.5)
    dialogue.begin(0.0)
    tell(dialogue, ack(), 0.1)
    sent = tell(dialogue, found, 1.0)
    assert (sent == [], dialogue.is_placed) == (kept, kept)


def test_a_receiver_that_says_nothing_of_its_survey_is_asked_for_one() -> None:
    dialogue = setup()
    dialogue.begin(0.0)
    tell(dialogue, ack(), 1.0)
    assert dialogue.tick(1.0 + LOOK_S - 0.1) == b""
    assert settings_in(dialogue.tick(1.0 + LOOK_S))[0]["CFG_TMODE_MODE"] == 1


def test_a_known_position_is_set_without_a_survey() -> None:
    dialogue = setup(position=[43.78, -79.46, 150.25], position_accuracy_m=0.02)
    dialogue.begin(0.0)
    (place,) = tell(dialogue, ack(), 0.1)
    assert (place["CFG_TMODE_MODE"], place["CFG_TMODE_HEIGHT"]) == (2, 15025)
    tell(dialogue, ack(), 0.2)
    assert dialogue.is_placed and not dialogue.surveys
    with pytest.raises(LinkError, match="no survey"):
        dialogue.restart(1.0)


def test_a_survey_can_be_begun_anew() -> None:
    dialogue = setup(survey_s=120)
    dialogue.begin(0.0)
    with pytest.raises(LinkError, match="being set up"):
        dialogue.restart(0.1)
    tell(dialogue, ack(), 0.1)
    tell(dialogue, nav_svin(600, 1.0, valid=True), 1.0)
    assert settings_in(dialogue.restart(2.0)) == [{"CFG_TMODE_MODE": 0}]
    assert not dialogue.is_placed
    assert tell(dialogue, ack(), 2.1)[0]["CFG_TMODE_MODE"] == 1
    tell(dialogue, ack(), 2.2)
    assert (dialogue.state, dialogue.survey) == ("running", None)


def test_a_lost_request_is_repeated_and_a_silent_receiver_named() -> None:
    dialogue = setup()
    first = dialogue.begin(0.0)
    assert dialogue.tick(ANSWER_S - 0.1) == b""
    for number in range(1, TRIES):
        assert dialogue.tick(number * ANSWER_S) == first
    with pytest.raises(LinkError, match="does not answer"):
        dialogue.tick(TRIES * ANSWER_S)


def test_a_receiver_that_is_no_base_is_named() -> None:
    dialogue = setup()
    dialogue.begin(0.0)
    with pytest.raises(LinkError, match="refuses to put out RTCM"):
        tell(dialogue, ack(accepted=False), 0.1)
    dialogue = setup(position=[1.0, 2.0, 3.0])
    dialogue.begin(0.0)
    tell(dialogue, ack(), 0.1)
    with pytest.raises(LinkError, match="refuses to be a base"):
        tell(dialogue, ack(accepted=False), 0.1)


def test_a_receiver_that_forgot_its_settings_is_noticed() -> None:
    dialogue = setup()
    dialogue.begin(0.0)
    tell(dialogue, ack(), 0.1)
    tell(dialogue, nav_svin(600, 1.0, valid=True), 1.0)
    assert dialogue.tick(1.0 + SURVEY_SILENT_S - 0.1) == b""
    with pytest.raises(LinkError, match="restarted"):
        dialogue.tick(1.0 + SURVEY_SILENT_S)
