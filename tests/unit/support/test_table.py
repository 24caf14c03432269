"""A table runs every row, also after one that fails, and names those that do."""

from __future__ import annotations

import inspect

import pytest

from support.table import each


def test_every_row_runs_and_those_that_fail_are_named() -> None:
    ran: list[tuple[int, str]] = []

    @each("number", [1, 2, 3])
    @each(("word", "good"), [("a", True), ("b", False)])
    def check(number: int, word: str, good: bool) -> None:
        ran.append((number, word))
        assert good or number != 2

    with pytest.raises(AssertionError) as error:
        check()
    assert ran == [(number, word) for number in (1, 2, 3) for word in "ab"]
    assert error.value.__notes__ == ["1 of 2 rows fail, first with ('b', False)", "1 of 3 rows fail, first with (2,)"]


def test_fixtures_are_still_asked_for() -> None:
    @each("number", [1])
    def check(number: int, tmp_path: str) -> None:
        assert (number, tmp_path) == (1, "here")

    assert list(inspect.signature(check).parameters) == ["tmp_path"]
    check(tmp_path="here")


def test_an_empty_table_and_a_name_that_is_no_parameter_are_mistakes() -> None:
    with pytest.raises(AssertionError):
        each("number", [])
    with pytest.raises(AssertionError):
        each("nothing", [1])(lambda number: None)
