"""An translator's edge: pymavlink reads the same from a frame before and after, but for the ids."""

from __future__ import annotations

import random
from typing import Any

import pytest
from fastcrc.crc16 import mcrf4xx
from hypothesis import given, settings
from hypothesis import strategies as st
from pymavlink.dialects.v20 import ardupilotmega

from skygcs.core.mavlink.dialect import MessageInfo
from skygcs.core.mavlink.frame import INCOMPAT_SIGNED, Frame, encode
from skygcs.core.mavlink.parser import FrameParser
from skygcs.core.mavlink.signing import sign
from skygcs.core.routing.sysid_translation import SysidTranslator, readdressed
from support.examples import examples
from support.frames import dialect, random_values, unknown_frame
from support.table import each

PYMAVLINK = set(ardupilotmega.mavlink_map)
TARGETED = [m for m in dialect().messages.values() if m.target_system_offset >= 0 and m.msgid in PYMAVLINK]
IDS = st.integers(1, 255)


def parsed(raw: bytes) -> Frame:
    (frame,) = FrameParser(dialect()).feed_datagram(raw)
    return frame


def decoded(raw: bytes) -> Any:
    """As pymavlink reads it; it checks the CRC."""
    return ardupilotmega.MAVLink(None).decode(bytearray(raw))


def target_field(info: MessageInfo) -> str:
    return next(f.name for f in info.fields if f.offset == info.target_system_offset)


def make(info: MessageInfo, version: int, seed: int, sysid: int, target: int, seq: int = 77) -> Frame:
    values = random_values(info, random.Random(seed)) | {target_field(info): target}
    return parsed(encode(info, values, sysid=sysid, compid=42, seq=seq, version=version))


def same_but_for_ids(before: bytes, after: bytes, sysid: int, target: int, info: MessageInfo) -> None:
    was, now = decoded(before), decoded(after)
    known, field = was.to_dict(), target_field(info)
    # pymavlink's SERIAL_CONTROL has no target, which stands behind its fields: what it reads stays as it was
    expected = known | {field: target} if field in known else known
    assert parsed(after).fields()[field] == target
    assert repr(now.to_dict()) == repr(expected), "NaN is not a number, and equal all the same here"
    ids = now.get_srcSystem(), now.get_srcComponent(), now.get_seq()
    assert ids == (sysid, was.get_srcComponent(), was.get_seq())
    assert after[0] == before[0], "MAVLink 1 stays MAVLink 1"


@settings(max_examples=examples(800))
@given(st.sampled_from(TARGETED), st.sampled_from([1, 2]), st.integers(0, 1 << 32), IDS, IDS, st.just(0) | IDS)
def test_all_but_the_ids_is_read_as_before(info, version, seed, sysid, real, shown) -> None:
    """A target of 0 becomes the one vehicle; that of a renumbered vehicle its real id."""
    if version == 1 and (info.msgid > 255 or info.target_system_offset >= info.min_length):
        version = 2
    translator = SysidTranslator([real], shown or None)
    said = make(info, version, seed, sysid, shown)
    (meant,) = translator.inward([said])
    assert meant.target()[0] == real
    assert translator.retargeted == (not shown)
    same_but_for_ids(said.raw, meant.raw, translator.translated(sysid), real, info)
    assert not shown or translator.outward(meant) == said.raw, "and turned back it is what it was"


def test_a_target_byte_that_was_trimmed_away_comes_back_and_an_ack_in_mavlink_1_has_none() -> None:
    info = dialect().find("MANUAL_CONTROL")
    said = parsed(encode(info, {"x": 5}, sysid=255, compid=0, seq=1))
    (meant,) = SysidTranslator([7]).inward([said])
    assert (meant.fields()["target"], meant.fields()["x"]) == (7, 5)
    assert (len(said.payload), len(meant.payload)) == (1, info.target_system_offset + 1)
    ack = parsed(encode(dialect().find("COMMAND_ACK"), {"command": 400}, sysid=255, compid=0, seq=1, version=1))
    translator = SysidTranslator([7])
    assert translator.inward([ack]) == [ack] and translator.retargeted == 0


@each("target", [0, 9, 4])
def test_several_vehicles_are_left_as_they_are(target: int) -> None:
    said = make(dialect().find("COMMAND_LONG"), 2, 1, 255, target)
    translator = SysidTranslator([4, 5])
    assert translator.inward([said]) == [said]
    assert translator.outward(said) == said.raw


def test_ids_change_places_so_that_none_stands_for_two() -> None:
    translator = SysidTranslator([5], 1)
    assert [translator.translated(i) for i in (0, 1, 5, 6, 255)] == [0, 5, 1, 6, 255]
    said = make(dialect().find("COMMAND_LONG"), 2, 1, 5, 5)
    (meant,) = translator.inward([said])
    assert (meant.sysid, meant.target()[0]) == (1, 1), "who says 5 there means none of the program's vehicles"


@each("shown", [None, 1])
def test_a_signature_goes_where_a_frame_is_changed_and_nowhere_else(shown: int | None) -> None:
    plain = encode(dialect().find("COMMAND_LONG"), {"target_system": 1, "command": 400}, sysid=255, compid=0, seq=3)
    signed = parsed(sign(plain, dialect().find("COMMAND_LONG").crc_extra_byte, bytes(32), 1, 12345))
    assert signed.signed
    translator = SysidTranslator([1 if shown is None else 9], shown)
    (meant,) = translator.inward([signed])
    assert meant.signed == (shown is None)
    assert translator.unsigned == (shown is not None)
    if shown is not None:
        assert not meant.raw[2] & INCOMPAT_SIGNED
        assert parsed(meant.raw).target()[0] == 9, "and its CRC is right without the flag"


def test_what_nobody_can_read_does_not_pass_a_renumbered_endpoint() -> None:
    parser = FrameParser(dialect())
    parser.feed_datagram(make(dialect().find("COMMAND_LONG"), 2, 1, 5, 1).raw)
    (unknown,) = parser.feed_datagram(unknown_frame(sysid=5, compid=42))
    translator = SysidTranslator([5], 1)
    assert unknown.info is translator.outward(unknown) is None and translator.inward([unknown]) == []
    assert translator.counters()["unknown_kept_out"] == 2
    plain = SysidTranslator([5])
    assert plain.outward(unknown) == unknown.raw and plain.inward([unknown]) == [unknown]


@given(IDS, st.integers(0, 255))
def test_what_has_no_target_changes_its_source_only(sysid: int, seq: int) -> None:
    info = dialect().find("ATTITUDE")
    before = parsed(encode(info, {"yaw": 1.25}, sysid=sysid, compid=1, seq=seq))
    after = readdressed(before, 33, 44)
    now = decoded(after.raw)
    assert (now.get_srcSystem(), now.get_seq(), now.yaw) == (33, seq, 1.25)
    assert len(after.raw) == len(before.raw)
    assert readdressed(before, sysid, 0) is before


def test_a_translator_shows_one_vehicle_under_one_id() -> None:
    with pytest.raises(ValueError, match="exactly one"):
        SysidTranslator([1, 2], 3)
    with pytest.raises(ValueError, match="needs vehicles"):
        SysidTranslator([])
    assert not SysidTranslator([4], 4).renumbers


def test_a_changed_frame_keeps_its_compatibility_flags() -> None:
    """A receiver may ignore those that it does not know; the frame is the same message with them."""
    info = dialect().find("ATTITUDE")
    raw = bytearray(encode(info, {"roll": 0.5}, sysid=5, compid=1, seq=7))
    raw[3] = 0x02
    raw[-2:] = mcrf4xx(bytes(raw[1:-2]) + info.crc_extra_byte).to_bytes(2, "little")
    (said,) = FrameParser(dialect()).feed_datagram(bytes(raw))
    shown = SysidTranslator([5], 1).outward(said)
    assert shown is not None
    assert (shown[3], shown[4], shown[5]) == (0x02, 7, 1)
