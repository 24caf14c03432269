"""Message tables: pins of wire sizes, and every message equal to pymavlink's own."""

from __future__ import annotations

import functools
import itertools
import json
import math
from random import Random
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pymavlink.dialects.v20 import all as mavlink

from skygcs.config.dialects import load_dialect
from skygcs.core.mavlink.dialect import ABSENT, Dialect, MessageInfo
from skygcs.core.mavlink.frame import encode
from skygcs.core.mavlink.parser import FrameParser
from support.frames import dialect, offline, random_values
from support.table import each


def test_seed_message_is_148_in_lower_case_and_has_52_bytes() -> None:
    table = load_dialect("utias")
    info = table.find(228)
    assert (info.name, info.crc_extra, info.length, info.min_length) == ("utias", 148, 52, 52)
    fields = [(f.name, f.array_length, f.offset) for f in info.fields]
    assert fields == [("quat", 4, 0), ("pos", 3, 16), ("vel", 3, 28), ("gps", 3, 40)]
    assert table.find("UTIAS") is info


@each(
    ("msgid", "crc_extra", "length"),
    [(8, 117, 36), (290, 251, 46), (291, 10, 57), (380, 232, 20), (397, 182, 108), (410, 160, 53), (411, 106, 3)],
)
def test_messages_px4_sends_beyond_pymavlinks(msgid: int, crc_extra: int, length: int) -> None:
    for table in (dialect(), offline(), load_dialect("utias")):
        info = table.messages[msgid]
        assert (info.crc_extra, info.length) == (crc_extra, length)


def test_every_message_equals_pymavlinks() -> None:
    table = load_dialect("all")
    assert table.messages.keys() == mavlink.mavlink_map.keys()
    for msgid, kind in mavlink.mavlink_map.items():
        info = table.messages[msgid]
        assert (info.name, info.crc_extra, info.length) == (kind.msgname, kind.crc_extra, kind.unpacker.size), msgid
        assert [(f.name, f.type) for f in info.fields] == list(zip(kind.fieldnames, kind.fieldtypes, strict=True))
        by_name = {f.name: f for f in info.fields}
        assert [by_name[n].array_length for n in kind.ordered_fieldnames] == list(kind.array_lengths)


def test_targets_are_where_pymavlink_puts_them_and_manual_control_has_one() -> None:
    table = load_dialect("all")
    parser = FrameParser(table)
    for info in table.messages.values():
        names = {f.name for f in info.fields}
        system = "target" if info.name == "MANUAL_CONTROL" else "target_system"
        values = {n: v for n, v in ((system, 0xA5), ("target_component", 0x5A)) if n in names}
        if not values:
            assert (info.target_system_offset, info.target_component_offset) == (ABSENT, ABSENT), info.name
            continue
        (found,) = parser.feed(encode(info, values, sysid=1, compid=1, seq=0))
        if system in values:
            assert found.target() == (0xA5, values.get("target_component", 0)), info.name
    assert table.find("MANUAL_CONTROL").target_system_offset == 10


def test_table_survives_json() -> None:
    table = dialect()
    again = Dialect.from_table(json.loads(json.dumps(table.to_table())))
    assert again.to_table() == table.to_table()
    assert again.enums == table.enums
    assert again.enums["MAV_TYPE"][2] == "MAV_TYPE_QUADROTOR"


def test_find_takes_names_of_any_case_and_ids() -> None:
    table = dialect()
    for what in ("HEARTBEAT", "heartbeat", 0, "0"):
        assert table.find(what).msgid == 0
    with pytest.raises(KeyError, match="no message 'NOPE'"):
        table.find("NOPE")
    assert table.enum_value("MAV_CMD", "MAV_CMD_COMPONENT_ARM_DISARM") == 400
    with pytest.raises(KeyError):
        table.enum_value("MAV_CMD", "NOPE")


# -- packing


@each(
    ("name", "values", "complaint"),
    [
        ("HEARTBEAT", {"typ": 1}, r"HEARTBEAT has no field 'typ'; it has: .*type"),
        ("HEARTBEAT", {"type": 256}, r"HEARTBEAT.type \(uint8_t\)"),
        ("HEARTBEAT", {"type": "two"}, r"HEARTBEAT.type"),
        ("HEARTBEAT", {"type": None}, r"HEARTBEAT.type"),
        ("HEARTBEAT", {"type": 1.5}, r"HEARTBEAT.type"),
        ("STATUSTEXT", {"text": "x" * 51}, r"STATUSTEXT.text .*51 bytes do not fit in 50"),
        ("GPS_RTCM_DATA", {"data": [0] * 181}, r"181 values do not fit in 180"),
        ("GPS_RTCM_DATA", {"data": 5}, r"GPS_RTCM_DATA.data"),
        ("ATTITUDE", {"roll": 1e300}, r"ATTITUDE.roll"),
        ("SET_ATTITUDE_TARGET", {"q": [1.0] * 5}, r"SET_ATTITUDE_TARGET.q \(float\): 5 values do not fit in 4"),
        ("SET_ATTITUDE_TARGET", {"q": 1.0}, r"SET_ATTITUDE_TARGET.q \(float\)"),
    ],
)
def test_a_value_that_does_not_fit_is_one_clear_error(name: str, values: dict[str, Any], complaint: str) -> None:
    with pytest.raises(ValueError, match=complaint):
        dialect().find(name).pack(values)


def test_texts_have_any_letters_nan_survives_and_a_reader_of_a_field_that_is_not_there_fails_when_made() -> None:
    info = dialect().find("STATUSTEXT")
    assert info.unpack(info.pack({"text": "höhe"}))["text"] == "höhe"
    info = dialect().find("COMMAND_LONG")
    assert math.isnan(info.unpack(info.pack({"param4": math.nan}))["param4"]), "it means: not given"
    with pytest.raises(KeyError):
        dialect().find("HEARTBEAT").reader("type", "nope")


@functools.cache
def load_all() -> Dialect:
    return load_dialect("all")


MSGIDS = st.deferred(lambda: st.sampled_from(sorted(load_all().messages)))


@given(MSGIDS, st.binary(max_size=255))
def test_any_payload_unpacks_to_every_field(msgid: int, payload: bytes) -> None:
    info = load_all().messages[msgid]
    assert info.unpack(payload).keys() == {f.name for f in info.fields}


@given(MSGIDS, st.binary(max_size=255), st.data())
def test_a_reader_of_some_fields_agrees_with_unpacking_all(msgid: int, payload: bytes, data: st.DataObject) -> None:
    info: MessageInfo = load_all().messages[msgid]
    scalars = [f.name for f in info.fields if not f.array_length and f.type != "char"]
    if not scalars:
        return
    names = data.draw(st.lists(st.sampled_from(scalars), unique=True, min_size=1))
    values = info.unpack(payload)
    assert repr(info.reader(*names)(payload)) == repr(tuple(values[n] for n in names))


@given(MSGIDS, st.randoms(use_true_random=False), st.booleans())
def test_what_is_packed_is_unpacked_again_and_a_field_left_out_is_zero(msgid: int, rng: Random, short: bool) -> None:
    info = load_all().messages[msgid]
    values = random_values(info, rng)
    if short:  # shorter arrays are filled up, left-out fields are zero
        values = {k: v[:-1] if isinstance(v, list) and v else v for k, v in list(values.items())[::2]}
    told = info.unpack(info.pack(values))
    for field in info.fields:
        value = values.get(field.name)
        got = told[field.name]
        if isinstance(got, list):
            value = [*(value or []), *[0] * field.array_length][: field.array_length]
        elif field.type == "char":
            got, value = got.rstrip("\0"), value or ""
        assert got == (0 if value is None else value), field.name


def test_more_sets_of_fields_than_have_a_packer_are_packed_all_the_same() -> None:
    info = load_dialect("minimal").find("HEARTBEAT")
    names = [f.name for f in info.fields]
    for chosen in itertools.permutations(names, 3):
        values = {name: 7 + at for at, name in enumerate(chosen)}
        assert info.unpack(info.pack(values)) == {**dict.fromkeys(names, 0), **values}
