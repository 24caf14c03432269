"""Names in texts for people."""

from __future__ import annotations

import pytest

from skygcs.number_text import enumerated, listed


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
