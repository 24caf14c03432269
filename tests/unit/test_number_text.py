"""Numbers as people see them."""

from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from skygcs.number_text import rounded
from support.table import each


@each(
    ("value", "text"),
    [
        (10.9006, "10.9"),
        (5.0, "5"),
        (0.0, "0"),
        (-0.0, "0"),
        (0.0123, "0.012"),
        (99.97, "100"),
        (-3.04, "-3"),
        (1e6, "1000000"),
    ],
)
def test_a_number_is_shown_with_what_is_known_of_it(value: float, text: str) -> None:
    assert rounded(value) == text


@given(st.floats(-1e6, 1e6), st.integers(0, 3))
def test_what_is_shown_is_the_number_but_for_half_a_digit(value: float, decimals: int) -> None:
    assert float(rounded(value, decimals)) == pytest.approx(value, abs=0.51 * 10.0**-decimals)
    assert rounded(math.inf) == "inf"
