"""RTCM and UBX in one stream: against pyubx2's reader, in any pieces, and with anything between."""

from __future__ import annotations

from io import BytesIO

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pyubx2 import ERR_IGNORE, NMEA_PROTOCOL, RTCM3_PROTOCOL, UBX_PROTOCOL, UBXReader

from skygcs.core.radio_link.corrections import CHECKED_PER_BYTE, CHECKED_SAVED, MAX_FRAME_BYTES, crc24q
from skygcs.ext.corrections import receiver_stream, ubx
from skygcs.ext.corrections.receiver_stream import ReceiverStream
from skygcs.ext.corrections.ubx import MAX_CONTENT_BYTES, UbxMessage, checksum, packed
from support.base_receiver import NMEA, ack, nav_svin
from support.rtcm import GLONASS_BIASES_1230, STANDARD_1005, rtcm_frame
from support.table import each

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
