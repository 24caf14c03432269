"""RTCM 3: its checksum, frames in any stream of bytes, and GPS_RTCM_DATA that receivers put together again."""

from __future__ import annotations

import itertools
from io import BytesIO

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pyrtcm import ERR_IGNORE, RTCMReader, calc_crc24q

from skygcs.core.radio_link import corrections
from skygcs.core.radio_link.corrections import (
    CHECKED_PER_BYTE,
    CHECKED_SAVED,
    MAX_FRAME_BYTES,
    MAX_MESSAGE_BYTES,
    RtcmContent,
    RtcmDeframer,
    content_of,
    crc24q,
    fragments_of,
)
from support.rtcm import GLONASS_BIASES_1230, STANDARD_1005, bitwise_crc24q, rtcm_frame
from support.table import each

MESSAGES = st.lists(
    st.builds(
        rtcm_frame,
        st.sampled_from([1005, 1077, 1127, 1230, 4072]),
        station=st.integers(0, 4095),
        epoch=st.integers(0, 2**30 - 1),
        body_bytes=st.integers(0, 1023),
        fill=st.sampled_from([0x00, 0x5A, 0xD3]),
    ),
    max_size=8,
)


def test_the_checksum_is_that_of_published_examples() -> None:
    assert crc24q(b"123456789") == 0xCDE703  # the check value of CRC-24Q
    for frame in (STANDARD_1005, GLONASS_BIASES_1230):
        assert crc24q(frame[:-3]) == int.from_bytes(frame[-3:], "big")
        assert crc24q(frame) == 0


@given(st.binary(max_size=200))
def test_the_checksum_is_the_remainder_of_the_division(data: bytes) -> None:
    assert crc24q(data) == bitwise_crc24q(data)


def test_frames_are_told_by_type_station_and_epoch() -> None:
    assert content_of(STANDARD_1005) == RtcmContent(1005, 1005 << 12 | 2003, None)
    assert content_of(rtcm_frame(1077, station=7, epoch=123456789)) == RtcmContent(1077, 1077 << 12 | 7, 123456789)
    assert content_of(rtcm_frame(1077, body_bytes=6)).epoch is None
    assert content_of(b"\xd3\x00\x00\x47\xea\x4b") == RtcmContent(0, 0, None)


def read_by_pyrtcm(stream: bytes) -> list[bytes]:
    """The sound frames that pyrtcm finds; it reads a blocking stream to its end."""
    reader = RTCMReader(BytesIO(stream), quitonerror=ERR_IGNORE, parsed=False)
    return [raw for raw, _ in reader if calc_crc24q(raw) == 0]


@given(MESSAGES, st.lists(st.binary(max_size=40), max_size=8), st.integers(0, 7), st.integers(1, 500))
def test_the_frames_are_those_that_pyrtcm_finds(messages, noise, damaged, cut) -> None:
    """Between noise without preambles, behind which pyrtcm loses what follows a false start."""
    messages = [m for m in messages if len(m) > 6]  # pyrtcm passes over the empty ones, which are fillers
    noise = [n.translate(bytes.maketrans(b"\xd3$\xb5", b"\xd2%\xb6")) for n in noise]
    if damaged < len(messages) and len(messages[damaged]) > 12:
        broken = bytearray(messages[damaged])
        broken[8] ^= 0x10
        messages[damaged] = bytes(broken)
    stream = b"".join(itertools.chain.from_iterable(itertools.zip_longest(noise, messages, fillvalue=b"")))
    if stream.count(b"\xd3") != len(messages):
        return  # a preamble inside a frame
    deframer = RtcmDeframer()
    found = [frame for at in range(0, len(stream), cut) for frame in deframer.feed(stream[at : at + cut])]
    assert found == read_by_pyrtcm(stream)


def test_types_are_those_that_pyrtcm_reads() -> None:
    for frame in (STANDARD_1005, GLONASS_BIASES_1230):
        assert str(content_of(frame).type) == RTCMReader.parse(frame).identity


@given(MESSAGES, st.lists(st.binary(max_size=40), max_size=8))
def test_noise_costs_no_frame_and_every_byte_is_accounted_for(messages: list[bytes], noise: list[bytes]) -> None:
    noise = [n.replace(b"\xd3", b"\xd2") for n in noise]
    parts = [b"".join(pair) for pair in zip(noise + [b""] * len(messages), messages, strict=False)]
    deframer = RtcmDeframer()
    assert [frame for part in parts for frame in deframer.feed(part)] == messages
    assert deframer.skipped_bytes == sum(map(len, parts)) - sum(map(len, messages))


def test_a_false_start_costs_no_frame_that_follows() -> None:
    deframer = RtcmDeframer()
    false = b"\xd3\x00\x28"  # claims 40 bytes, which the next frames fill
    assert deframer.feed(false + STANDARD_1005 + GLONASS_BIASES_1230 + STANDARD_1005) == [
        STANDARD_1005,
        GLONASS_BIASES_1230,
        STANDARD_1005,
    ]
    assert (deframer.bad_crc, deframer.skipped_bytes) == (1, 3)


def test_a_damaged_frame_is_counted_and_left_out() -> None:
    deframer = RtcmDeframer()
    damaged = bytearray(GLONASS_BIASES_1230)
    damaged[10] ^= 0x10
    assert deframer.feed(bytes(damaged) + STANDARD_1005) == [STANDARD_1005]
    assert deframer.bad_crc >= 1
    assert deframer.skipped_bytes == len(damaged)


@given(st.lists(st.binary(max_size=3000), max_size=6))
def test_less_than_a_frame_is_held_whatever_comes(chunks: list[bytes]) -> None:
    deframer = RtcmDeframer()
    for chunk in [*chunks, b"\xd3" * 1100, b"\xd3\x03\xff" * 400]:
        deframer.feed(chunk)
        assert deframer.held_bytes < MAX_FRAME_BYTES


def test_a_stream_of_false_starts_costs_no_more_than_a_sound_one(monkeypatch: pytest.MonkeyPatch) -> None:
    checked: list[int] = []
    monkeypatch.setattr(corrections, "crc24q", lambda frame: checked.append(len(frame)) or crc24q(frame))
    for false in (b"\xd3\x03", b"\xd3\x03\xff", b"\xd3\x00"):
        deframer = RtcmDeframer()
        checked.clear()
        stream = false * 30_000
        for at in range(0, len(stream), 4096):
            deframer.feed(stream[at : at + 4096])
        assert sum(checked) <= CHECKED_PER_BYTE * len(stream) + CHECKED_SAVED
        deframer.feed(bytes(MAX_FRAME_BYTES))
        assert deframer.feed(STANDARD_1005) == [STANDARD_1005]  # it finds what comes after that


def reassembled(values: list[dict[str, int | bytes]]) -> bytes | None:
    """As ArduPilot does: the last fragment is a short one, or the fourth."""
    data: dict[int, bytes] = {}
    count = None
    for value in values:
        flags, length, field = value["flags"], value["len"], value["data"]
        assert isinstance(flags, int) and isinstance(length, int) and isinstance(field, bytes)
        assert len(field) == 180
        if not flags & 1:
            return field[:length]
        number = flags >> 1 & 3
        data[number] = field[:length]
        if length < 180:
            count = number + 1
        elif len(data) == 4:
            count = 4
    return b"".join(data[n] for n in range(count)) if count is not None and len(data) == count else None


@given(st.integers(1, MAX_MESSAGE_BYTES), st.integers(0, 100))
def test_receivers_put_fragments_together_again(size: int, sequence: int) -> None:
    message = bytes(n % 251 for n in range(size))
    values = list(fragments_of(message, sequence))
    assert reassembled(values) == message
    assert {int(v["flags"]) >> 3 for v in values} == {sequence % 32}
    assert [int(v["flags"]) >> 1 & 3 for v in values] == list(range(len(values)))


@each("size, fragments", [(180, 1), (181, 2), (360, 3), (540, 4), (720, 4)])
def test_a_message_of_full_fragments_ends_with_an_empty_one(size: int, fragments: int) -> None:
    assert len(list(fragments_of(bytes(size), 0))) == fragments


@each("size", [0, 721])
def test_what_does_not_fit_is_refused(size: int) -> None:
    with pytest.raises(ValueError, match=r"takes 1 to 720"):
        fragments_of(bytes(size), 0)
