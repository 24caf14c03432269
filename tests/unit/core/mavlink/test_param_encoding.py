"""The four bytes of a parameter: exact both ways for both autopilots, and the same on the wire as pymavlink's."""

from __future__ import annotations

import re
import struct
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pymavlink.dialects.v20 import ardupilotmega as mav

from skygcs.core.mavlink.frame import encode
from skygcs.core.mavlink.param_encoding import (
    Encoding,
    Param,
    ParamType,
    bits_message,
    encoding_of,
    float32,
    from_bits,
    is_name,
    short_float,
    to_bits,
    value_reader,
)
from support.table import each
from support.vehicles import Voice, flight_dialect

SOURCES = Path(__file__).parents[4] / "src" / "skygcs"

RANGES = {
    ParamType.UINT8: (0, 255),
    ParamType.INT8: (-128, 127),
    ParamType.UINT16: (0, 65535),
    ParamType.INT16: (-32768, 32767),
    ParamType.UINT32: (0, 2**32 - 1),
    ParamType.INT32: (-(2**31), 2**31 - 1),
}


@given(st.sampled_from(sorted(RANGES)), st.data())
def test_integers_bytewise_are_exact(type_: ParamType, data: st.DataObject) -> None:
    value = data.draw(st.integers(*RANGES[type_]))
    assert from_bits(to_bits(value, type_, Encoding.BYTEWISE), type_, Encoding.BYTEWISE) == value


@given(st.sampled_from(sorted(RANGES)), st.data())
def test_integers_cast_are_exact_or_refused(type_: ParamType, data: st.DataObject) -> None:
    value = data.draw(st.integers(*RANGES[type_]))
    try:
        bits = to_bits(value, type_, Encoding.C_CAST)
    except ValueError:
        assert abs(value) > 1 << 24 and float32(value) != value
    else:
        assert from_bits(bits, type_, Encoding.C_CAST) == value


@given(st.floats(width=32, allow_nan=False, allow_infinity=False), st.sampled_from(Encoding))
def test_floats_are_exact_and_have_a_short_text(value: float, encoding: Encoding) -> None:
    assert from_bits(to_bits(value, ParamType.REAL32, encoding), ParamType.REAL32, encoding) == value
    assert float32(float(short_float(value))) == value


@each("value", [float("nan"), float("inf"), 1e39])
def test_what_is_no_32_bit_number_is_refused(value: float) -> None:
    with pytest.raises(ValueError):
        to_bits(value, ParamType.REAL32, Encoding.C_CAST)


@each("value", [0x7F800001, -1, 0x7FBFFFFF, -8388607, 880957584])
def test_an_integer_that_looks_like_a_nan_survives_the_wire(value: int) -> None:
    """A float variable would turn 0x7F800001 (a signalling NaN) into 0x7FC00001."""
    info = bits_message(flight_dialect().by_name["PARAM_SET"])
    bits = to_bits(value, ParamType.INT32, Encoding.BYTEWISE)
    raw = encode(info, {"param_id": "X", "param_value": bits, "param_type": 6}, sysid=1, compid=1, seq=0)
    assert struct.unpack_from("<i", raw, 10)[0] == value
    read = value_reader(flight_dialect())
    payload = struct.pack("<iHH16sB", value, 3, 1, b"X", 6)
    decoded = read(payload, Encoding.BYTEWISE)
    assert decoded is not None and decoded.param.value == value


@given(st.floats(width=32, allow_nan=False), st.from_regex(r"[A-Z][A-Z0-9_]{0,15}", fullmatch=True))
def test_pymavlinks_param_value_is_read(value: float, name: str) -> None:
    frame = Voice().say(mav.MAVLink_param_value_message(name.encode(), value, 9, 1300, 65535))
    decoded = value_reader(flight_dialect())(frame.payload, Encoding.C_CAST)
    assert decoded is not None
    assert (decoded.param.name, decoded.param.value, decoded.count, decoded.index) == (name, value, 1300, None)


@each(("name", "kind"), [(b"", 9), (b"\xff\xfe", 9), (b"A B", 9), (b"1ABC", 9), (b"X", 0), (b"X", 11)])
def test_a_name_or_a_type_that_is_none_is_not_read(name: bytes, kind: int) -> None:
    assert value_reader(flight_dialect())(struct.pack("<IHH16sB", 0, 3, 1, name, kind), Encoding.C_CAST) is None
    assert is_name(name.decode("latin-1")) is (name == b"X")


@each(
    ("autopilot", "capabilities", "expected"),
    [
        *((12, None, Encoding.BYTEWISE), (3, None, Encoding.C_CAST), (3, 2, Encoding.C_CAST)),
        *((3, 1 << 17, Encoding.C_CAST), (0, 1 << 4, Encoding.BYTEWISE), (12, 1 << 17, Encoding.C_CAST)),
    ],
)
def test_the_capability_decides_and_else_the_autopilot(autopilot, capabilities, expected) -> None:
    assert encoding_of(autopilot, capabilities) is expected


@each("bits", [0x7FC00000, 0x7F800000, 0xFF800000])
@each("type_", [ParamType.REAL32, ParamType.INT32, ParamType.UINT8])
def test_what_is_no_number_is_none_to_reckon_with(bits: int, type_: ParamType) -> None:
    assert Param("P", from_bits(bits, type_, Encoding.C_CAST), type_).number is None


def test_nothing_is_decided_by_a_parameter_that_may_be_no_number() -> None:
    """`Param.number` is the one way from what a vehicle says to a number that code reckons with."""
    reckons = re.compile(r"\b(?:int|float|round|abs|ReturnHeight)\([^()]*\bparam\.value\b")
    found = [
        f"{path.name}: {match.group()}"
        for path in sorted(SOURCES.rglob("*.py"))
        if path.parent.name != "sim"  # the vehicle's own side
        for match in reckons.finditer(path.read_text(encoding="utf-8"))
    ]
    assert not found, found
