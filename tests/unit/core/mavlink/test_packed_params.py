"""ArduPilot's packed parameters: what a vehicle holds comes out, and anything else is told."""

from __future__ import annotations

import struct

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from skygcs.core.mavlink.param_encoding import MAX_PACKED_BYTES, Param, ParamType, decode_packed, float32
from skygcs.sim import param_table as sim
from skygcs.sim.copter_files import packed
from support.examples import examples
from support.table import each

TYPED = st.one_of(
    st.tuples(st.just(ParamType.INT8), st.integers(-128, 127)),
    st.tuples(st.just(ParamType.INT16), st.integers(-(1 << 15), (1 << 15) - 1)),
    st.tuples(st.just(ParamType.INT32), st.integers(-(1 << 31), (1 << 31) - 1)),
    st.tuples(st.just(ParamType.REAL32), st.floats(width=32, allow_nan=False).map(float32)),
)
SETS = st.dictionaries(st.from_regex(r"[A-Z][A-Z0-9_]{0,15}", fullmatch=True), TYPED, min_size=1, max_size=60)


def test_names_continue_the_last_one_and_padding_is_skipped() -> None:
    data = struct.pack("<HHH", 0x671B, 3, 9)
    data += b"\x01\x50ABC_ON\xff"  # int8, six characters
    data += b"\0\0\x02\x24MAX\xe8\x03"  # padding; int16, four characters of the last name and three more
    data += b"\x04\x06Z\x00\x00\x80\x3f"  # float, six and one more
    held = decode_packed(data)
    assert held.params == (
        Param("ABC_ON", -1, ParamType.INT8),
        Param("ABC_MAX", 1000, ParamType.INT16),
        Param("ABC_MAZ", 1.0, ParamType.REAL32),
    )
    assert held.total == 9 and held.defaults == {}


def test_default_values_are_told_where_they_are_there() -> None:
    data = struct.pack("<HHH", 0x671C, 2, 2) + b"\x11\x00A\x05\x02" + b"\x02\x00B\x07\x00"
    held = decode_packed(data)
    assert [p.value for p in held.params] == [5, 7] and held.defaults == {"A": 2}


@settings(max_examples=examples(100), deadline=None)
@given(SETS, st.integers(40, 239))
def test_what_a_vehicle_packs_comes_out(values: dict[str, tuple[ParamType, float]], read_bytes: int) -> None:
    held = [Param(name, value, type_) for name, (type_, value) in sorted(values.items())]
    data = packed([sim.Param(p.name, p.value, int(p.type)) for p in held], read_bytes)
    assert decode_packed(data).params == tuple(held) and len(data) <= MAX_PACKED_BYTES


@each(
    ("data", "words"),
    [
        (b"", "0 bytes are not a file"),
        (b"\x1d\x67\x00\x00\x00\x00", "begins with 0x671d"),
        (struct.pack("<HHH", 0x671B, 2, 1), "has 2 of 1"),
        (struct.pack("<HHH", 0x671B, 1, 1), "ends after 0 of 1"),
        (struct.pack("<HHH", 0x671B, 1, 1) + b"\x04\x00A\x00\x00", "ends after 0 of 1"),
        (struct.pack("<HHH", 0x671B, 1, 1) + b"\x07\x00A\x00", "unknown type 7"),
        (struct.pack("<HHH", 0x671B, 1, 1) + b"\x01\x03A\x00", "impossible name"),
        (struct.pack("<HHH", 0x671B, 1, 1) + b"\x01\x00?\x00", "impossible name"),
        (struct.pack("<HHH", 0x671B, 2, 2) + b"\x01\x00A\x00" * 2, "it contains A twice"),
        (struct.pack("<HHH", 0x671B, 1, 1) + b"\x01\x00A\x00\x01", "bytes after its 1"),
    ],
)
def test_what_is_no_such_file_is_told(data: bytes, words: str) -> None:
    with pytest.raises(ValueError, match=words.replace("?", r"\?")):
        decode_packed(data)


@settings(max_examples=examples(300), deadline=None)
@given(st.integers(0, 40), st.binary(max_size=200), st.booleans())
def test_nothing_breaks_it(count: int, rest: bytes, defaults: bool) -> None:
    try:
        held = decode_packed(struct.pack("<HHH", 0x671B + defaults, count, count) + rest)
    except ValueError as error:
        assert str(error)
    else:
        assert len(held.params) == count
