"""Frames against pymavlink, which packs and unpacks independently of ours."""

from __future__ import annotations

import random
from typing import Any

import pytest
from fastcrc import crc16
from pymavlink.dialects.v20 import all as mavlink

from skygcs.config.dialects import load_dialect
from skygcs.core.mavlink.dialect import Dialect, MessageInfo
from skygcs.core.mavlink.frame import check, encode, encode_payload, frame_size, mcrf4xx
from skygcs.core.mavlink.parser import FrameParser
from support.frames import dialect, frame, heartbeat, random_values, unknown_frame

ALL_IDS = sorted(mavlink.mavlink_map)


@pytest.fixture(scope="module")
def everything() -> Dialect:
    return load_dialect("all")


def theirs(info: MessageInfo, values: dict[str, Any], *, version: int, seq: int = 7) -> bytes:
    """The same message packed by pymavlink as 42/24."""
    kind = mavlink.mavlink_map[info.msgid]
    chars = {f.name for f in info.fields if f.type == "char"}
    arguments = [values[n].encode() if n in chars else values[n] for n in kind.fieldnames]
    sender = mavlink.MAVLink(None, srcSystem=42, srcComponent=24)
    sender.seq = seq
    return bytes(kind(*arguments).pack(sender, force_mavlink1=version == 1))


def samples(info: MessageInfo) -> list[dict[str, Any]]:
    rng = random.Random(info.msgid)
    return [random_values(info, rng) for _ in range(4)]


def test_every_message_is_encoded_as_pymavlink_does_but_without_extensions_in_mavlink_1(everything: Dialect) -> None:
    ids = {"sysid": 42, "compid": 24, "seq": 7}
    for msgid in ALL_IDS:
        info = everything.messages[msgid]
        if msgid > 255:
            with pytest.raises(ValueError, match=r"does not fit in MAVLink 1"):
                encode(info, {}, **ids, version=1)
        for values in samples(info):
            assert encode(info, values, **ids) == theirs(info, values, version=2), info.name
            if msgid <= 255:  # MAVLink 1 has no extensions (serialization guide); pymavlink sends them all the same
                ours, other = encode(info, values, **ids, version=1), theirs(info, values, version=1)
                assert ours[6 : 6 + info.min_length] == other[6 : 6 + info.min_length], info.name
                assert ours == other if info.length == info.min_length else len(ours) == info.min_length + 8, info.name


@pytest.mark.parametrize("version", [1, 2])
def test_what_pymavlink_packs_is_parsed_and_unpacks_to_the_same_values(everything: Dialect, version: int) -> None:
    parser = FrameParser(everything)
    for msgid in ALL_IDS:
        info = everything.messages[msgid]
        if version == 1 and msgid > 255:
            continue
        for values in samples(info):
            data = theirs(info, values, version=version)
            (found,) = parser.feed(data)
            assert found.raw == data
            assert (found.sysid, found.compid, found.seq, found.msgid) == (42, 24, 7, msgid)
            assert (found.version, found.name, found.signed) == (version, info.name, False)
            assert found.fields() == values, info.name
            assert found.crc == int.from_bytes(data[-2:], "little")


def test_what_we_encode_is_decoded_by_pymavlink_to_the_same_values(everything: Dialect) -> None:
    for msgid in ALL_IDS:
        info = everything.messages[msgid]
        values = samples(info)[0]
        message = mavlink.MAVLink(None).decode(bytearray(encode(info, values, sysid=9, compid=8, seq=1)))
        assert message.get_type() == info.name
        for name in values.keys() - {"mavlink_version"}:
            assert getattr(message, name) == values[name], (info.name, name)


def test_trailing_zeros_are_trimmed_but_one_byte_stays_and_the_sequence_number_wraps_at_a_byte() -> None:
    empty = encode(dialect().find("HEARTBEAT"), {}, sysid=1, compid=1, seq=256)
    assert (empty[1], len(empty), empty[4]) == (1, 13, 0)
    assert encode(dialect().find("COMMAND_LONG"), {"param1": 1.0}, sysid=1, compid=1, seq=0)[1] == 4
    assert encode_payload(dialect().find(0), bytes(9), sysid=1, compid=1, seq=511)[4] == 255


def test_trimmed_target_is_broadcast_and_untrimmed_one_is_read() -> None:
    both = {"target_system": 7, "target_component": 9}
    named = ("COMMAND_LONG", "PARAM_SET", "SET_ATTITUDE_TARGET", "FILE_TRANSFER_PROTOCOL", "SET_MODE")
    for name, targets, version in (
        ("PARAM_REQUEST_LIST", {"target_system": 2}, 2),
        ("PARAM_REQUEST_LIST", {}, 2),
        ("HEARTBEAT", {}, 2),
        *((name, both, version) for name in named for version in (1, 2)),
    ):
        values = {k: v for k, v in targets.items() if k in {f.name for f in dialect().find(name).fields}}
        (found,) = FrameParser(dialect()).feed(frame(name, values, version=version))
        assert found.target() == (values.get("target_system", 0), values.get("target_component", 0)), name


def test_frame_size_reads_the_header_and_needs_all_of_it() -> None:
    for data in (heartbeat(), heartbeat(version=1), unknown_frame(), unknown_frame(incompat=1) + bytes(13)):
        assert frame_size(data) == len(data)
        assert frame_size(b"xy" + data, 2) == len(data)
        header = 10 if data[0] == 0xFD else 6
        assert [frame_size(data[:n]) for n in range(header)] == [0] * header
    assert frame_size(b"\x00" * 20) == 0


def test_the_checksum_is_that_of_a_compiled_library() -> None:
    source = random.Random(1)
    for size in (*range(40), 280):
        data = source.randbytes(size)
        assert mcrf4xx(data) == mcrf4xx(bytearray(data)) == crc16.mcrf4xx(data)


def test_check_tells_good_from_bad_from_unknown() -> None:
    messages = dialect().messages
    for version in (1, 2):
        good = heartbeat(5, version=version)
        found, verdict = check(good, messages)
        assert verdict == "ok" and found is not None and found.raw == good
        for at in range(1, len(good)):
            damaged = bytearray(good)
            damaged[at] ^= 0x40
            size = frame_size(bytes(damaged))
            assert check(bytes(damaged) + bytes(300), messages)[1] != "ok" or size != len(good), at
    found, verdict = check(unknown_frame(), messages)
    assert verdict == "unknown" and found is not None and found.info is None
    undefined = bytearray(heartbeat())
    undefined[2] = 4
    assert check(bytes(undefined), messages)[1] == "unknown"
