"""What any site may have written as JSON can be shown and encoded after it is decoded."""

from __future__ import annotations

import json

from hypothesis import given
from hypothesis import strategies as st
from pydantic_core import from_json

from skygcs.ext.federation.protocol.received_json import MAX_INTEGER, MAX_TEXT_CHARS, cleaned, printable

values = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(max_size=8), inner, max_size=4),
)


@given(values)
def test_whatever_came_can_be_shown_and_encoded(value: object) -> None:
    text = json.dumps(cleaned(value), ensure_ascii=False, allow_nan=False)
    assert text.isprintable()
    assert cleaned(cleaned(value)) == cleaned(value)


def test_numbers_that_pydantic_reads_as_infinity_or_without_bounds_are_dropped() -> None:
    found = from_json(b'{"a":1e999,"b":[-1e999,1.5],"c":1' + 400 * b"0" + b',"d":true,"e":7}', allow_inf_nan=False)
    assert cleaned(found) == {"a": None, "b": [None, 1.5], "c": None, "d": True, "e": 7}
    assert cleaned([MAX_INTEGER, MAX_INTEGER + 1, -MAX_INTEGER - 1]) == [MAX_INTEGER, None, None]


def test_texts_are_cut_and_their_control_characters_replaced() -> None:
    assert cleaned({"\x1b[2J": ["a\nb\u202e", "x" * 5000]}) == {"?[2J": ["a?b?", "x" * MAX_TEXT_CHARS]}
    assert printable("Öl", 1) == "Ö"
