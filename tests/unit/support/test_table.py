"""A table runs every row, also after one that fails, and names those that do."""

from __future__ import annotations

import asyncio
import inspect
import os
from pathlib import Path

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


def test_fixtures_are_still_asked_for_and_what_one_row_did_to_them_no_other_sees(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv("SKYGCS_ROW", raising=False)

    @each("number", [1, 2])
    @each("word", ["a", "b"])
    def check(number: int, word: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        assert not list(tmp_path.iterdir()) and "SKYGCS_ROW" not in os.environ
        (tmp_path / "made").touch()
        monkeypatch.setenv("SKYGCS_ROW", word)

    assert list(inspect.signature(check).parameters) == ["tmp_path", "monkeypatch"]
    check(tmp_path=tmp_path, monkeypatch=monkeypatch)
    assert len(list(tmp_path.glob("*/*/made"))) == 4


async def test_async_rows_run_one_after_the_other_and_one_that_raises_nothing_is_named() -> None:
    ran: list[int] = []

    @each("number", [1, 2], ids=["one", "two"])
    async def check(number: int) -> None:
        ran.append(number)
        with pytest.raises(ValueError):
            await asyncio.sleep(0)
            if number == 1:
                raise ValueError

    with pytest.raises(pytest.fail.Exception) as error:
        await check()
    assert ran == [1, 2]
    assert error.value.__notes__ == ["1 of 2 rows fail, first with two"]


def test_an_empty_table_and_a_name_that_is_no_parameter_are_mistakes() -> None:
    with pytest.raises(AssertionError):
        each("number", [])
    with pytest.raises(AssertionError):
        each("nothing", [1])(lambda number: None)
