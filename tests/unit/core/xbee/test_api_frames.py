"""API frames against Digi's own library, in any split, among noise and damage."""

from __future__ import annotations

import random

import pytest
from digi.xbee.models.address import XBee16BitAddress, XBee64BitAddress
from digi.xbee.models.mode import OperatingMode
from digi.xbee.packets.common import ATCommPacket, ReceivePacket, RemoteATCommandPacket, TransmitPacket
from digi.xbee.packets.factory import build_frame
from hypothesis import given
from hypothesis import strategies as st

from skygcs.core.xbee import api_frames as api
from skygcs.core.xbee.api_frames import ApiParser
from support.table import each

NODE = 0x0013A20041A7B2C3


def digi_address(address: int) -> XBee64BitAddress:
    return XBee64BitAddress(bytearray(address.to_bytes(8, "big")))


@pytest.mark.parametrize("escaped", [False, True])
@given(payload=st.binary(max_size=256), frame_id=st.integers(1, 255), address=st.integers(0, 2**64 - 1))
def test_requests_are_digis_bytes(escaped: bool, payload: bytes, frame_id: int, address: int) -> None:
    far = digi_address(address)
    theirs = TransmitPacket(frame_id, far, XBee16BitAddress.UNKNOWN_ADDRESS, 0, 0, bytearray(payload) or None)
    assert api.encode(api.transmit_request(frame_id, address, payload), escaped=escaped) == bytes(
        theirs.output(escaped=escaped)
    )
    value = payload[:8]
    local = ATCommPacket(frame_id, "NP", bytearray(value) or None)
    assert api.encode(api.at_command(frame_id, "NP", value), escaped=escaped) == bytes(local.output(escaped=escaped))
    remote = RemoteATCommandPacket(frame_id, far, XBee16BitAddress.UNKNOWN_ADDRESS, 2, "ID", bytearray(value) or None)
    ours = api.encode(api.remote_at_command(frame_id, address, "ID", value), escaped=escaped)
    assert ours == bytes(remote.output(escaped=escaped))


@pytest.mark.parametrize("escaped", [False, True])
@given(payload=st.binary(max_size=256), address=st.integers(0, 2**64 - 1))
def test_received_packets_are_read_as_digi_writes_them(escaped: bool, payload: bytes, address: int) -> None:
    packet = ReceivePacket(digi_address(address), XBee16BitAddress.UNKNOWN_ADDRESS, 0x02, bytearray(payload) or None)
    raw = bytes(packet.output(escaped=escaped))
    assert ApiParser(api.decode, escaped=escaped).feed(raw) == [api.ReceivePacket(address, True, payload)]
    theirs = build_frame(packet.output(escaped=False), operating_mode=OperatingMode.API_MODE)
    assert bytes(theirs.rf_data or b"") == payload


@pytest.mark.parametrize("escaped", [False, True])
@given(
    payloads=st.lists(st.binary(max_size=80), max_size=6),
    cuts=st.lists(st.integers(1, 40), max_size=20),
    noise=st.binary(max_size=30).map(lambda data: data.replace(b"\x7e", b"")),
)
def test_the_split_changes_nothing(escaped: bool, payloads: list[bytes], cuts: list[int], noise: bytes) -> None:
    frames = [_received(payload, escaped=escaped) for payload in payloads]
    stream = noise + b"".join(frames)
    parser = ApiParser(api.decode, escaped=escaped)
    got, at = [], 0
    for cut in cuts:
        got += parser.feed(stream[at : at + cut])
        at += cut
    got += parser.feed(stream[at:])
    assert got == [api.ReceivePacket(NODE, False, payload) for payload in payloads]
    assert parser.stats.skipped_bytes == len(noise) and not parser.pending


@each("escaped", [False, True])
def test_a_thousand_mutated_frames_raise_nothing_and_hide_nothing(escaped: bool) -> None:
    rng = random.Random(7)
    parser = ApiParser(api.decode, escaped=escaped)
    damaged_read = 0
    for n in range(1000):
        raw = bytearray(_received(rng.randbytes(rng.randrange(60)), escaped=escaped))
        for _ in range(rng.randrange(1, 4)):
            match rng.randrange(3):
                case 0:
                    raw[rng.randrange(len(raw))] ^= 1 << rng.randrange(8)
                case 1:
                    del raw[rng.randrange(len(raw))]
                case 2:
                    raw.insert(rng.randrange(len(raw) + 1), rng.randrange(256))
        frames = parser.feed(bytes(raw)) + parser.give_up()
        damaged_read += len(frames)
        good = _received(n.to_bytes(4, "big"), escaped=escaped)
        assert parser.feed(good) + parser.give_up() == [api.ReceivePacket(NODE, False, n.to_bytes(4, "big"))]
    assert damaged_read < 60, "a checksum of one byte lets one damaged frame of 256 through, and changed start bytes"


def test_frames_inside_a_false_start_are_found_after_a_silence() -> None:
    parser = ApiParser(api.decode, escaped=False)
    good = _received(b"abc", escaped=False)
    assert parser.feed(b"\x7e\x01\x00" + good) == []
    assert parser.give_up() == [api.ReceivePacket(NODE, False, b"abc")]
    assert parser.stats.skipped_bytes == 3


def test_a_length_that_no_module_sends_is_no_frame() -> None:
    parser = ApiParser(api.decode, escaped=False)
    good = _received(b"abc", escaped=False)
    assert parser.feed(b"\x7e\xff\xff" + good) == [api.ReceivePacket(NODE, False, b"abc")]
    assert parser.feed(b"\x7e\0\0" + good) == [api.ReceivePacket(NODE, False, b"abc")]


@given(data=st.binary(min_size=1, max_size=40))
def test_data_of_any_kind_and_length_is_some_frame(data: bytes) -> None:
    frame = api.decode(data)
    assert type(frame) is not api.OtherFrame or frame.frame_type == data[0]


def _received(payload: bytes, *, escaped: bool) -> bytes:
    data = bytes([api.FrameType.RECEIVE_PACKET]) + NODE.to_bytes(8, "big") + b"\xff\xfe\x01" + payload
    return api.encode(data, escaped=escaped)
