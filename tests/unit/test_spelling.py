"""Numbers and names as people see them."""

from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from skygcs.spelling import enumerated, is_number, listed, near_names, rounded
from support.table import each


def test_an_integer_beyond_every_float_is_no_number() -> None:
    assert [value for value in (7, -0.5, 10**300) if not is_number(value)] == []
    assert [value for value in (10**400, -(10**400), math.nan, math.inf, True, "7", None) if is_number(value)] == []


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


@pytest.mark.parametrize(
    ("names", "text"),
    [
        ([], ""),
        (["a"], "a"),
        (["a", "b"], "a and b"),
        (["a", "b", "c"], "a, b and c"),
        (iter(range(4)), "0, 1, 2 and 1 more"),
        (["a"] * 9, "a, a, a and 6 more"),
    ],
)
def test_a_list_of_names_is_a_part_of_a_sentence(names, text):
    assert enumerated(names, 3) == text


def test_a_list_of_sentences_names_how_many_are_left_out():
    assert listed(["a", "b"], 2) == "a; b"
    assert listed(["a", "b", "c", "d"], 2) == "a; b; and 2 more"


@each(
    ("word", "near"),
    [
        ("ALPHA", ["alpha"]),
        ("alpah", ["alpha"]),
        ("atitude", ["ATTITUDE", "ALTITUDE"]),
        ("Bravo1", ["Bravo"]),
        ("zz", []),
    ],
)
def test_a_name_in_another_case_is_near(word: str, near: list[str]) -> None:
    assert near_names(word, iter(["alpha", "Bravo", "ATTITUDE", "ALTITUDE"])) == near


@each(("word", "near"), [("alpah", ["alpha", "Alpha"]), ("ALPAH", ["Alpha", "alpha"]), ("Alpah", ["Alpha", "alpha"])])
def test_of_two_names_that_differ_in_case_that_in_the_same_case_is_nearer(word: str, near: list[str]) -> None:
    """A vehicle may be called alpha beside another one that is called Alpha."""
    assert near_names(word, ["Alpha", "alpha", "bravo"]) == near
    assert near_names(word, ["Alpha", "alpha", "bravo"], n=1) == near[:1]
