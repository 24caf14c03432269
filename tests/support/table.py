"""Tables of a test: all rows in one test, where each case would cost more to set up than to run."""

from __future__ import annotations

import functools
import inspect
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

from support.public_data import Present

FAILURES = (Exception, pytest.fail.Exception)
"""The second is what `pytest.raises` raises where nothing was raised."""


def each(
    names: str | Sequence[str], rows: Iterable[Any], *, ids: Iterable[str] | None = None
) -> Callable[[Callable[..., Any]], Callable[..., Any]]:
    """Decorate a test that runs for every row of a table, and names the rows that fail.

    ``names`` are parameters of the test, ``rows`` their values, as those of ``pytest.mark.parametrize``; ``ids`` name
    rows whose values say little. Several tables give every combination. An async test runs its rows one after the
    other on one loop. Fixtures are made once for all rows, but ``tmp_path`` is another empty folder for each, what
    ``monkeypatch`` changed is undone after it, and ``capsys`` and ``caplog`` are empty before it. A test in virtual
    time that looks at the clock is parametrised instead.
    """
    keys = [name.strip() for name in names.split(",") if name.strip()] if isinstance(names, str) else list(names)
    values = [(row,) if len(keys) == 1 else tuple(row) for row in rows]
    if not values and isinstance(rows, Present):
        return pytest.mark.skip(reason="no public data")
    assert values, "a table without rows tests nothing"
    names_of_rows = [None] * len(values) if ids is None else list(ids)
    table = list(zip(names_of_rows, values, strict=True))

    def decorate(test: Callable[..., Any]) -> Callable[..., Any]:
        @functools.wraps(test)
        def run(*given: Any, **fixtures: Any) -> None:
            failures: list[tuple[str, BaseException]] = []
            for name, row in table:
                with _anew(fixtures) as own:
                    try:
                        test(*given, **own, **dict(zip(keys, row, strict=True)))
                    except FAILURES as failure:
                        failures.append((name or _shown(row), failure))
            _raise_first(failures, len(table))

        @functools.wraps(test)
        async def run_async(*given: Any, **fixtures: Any) -> None:
            failures: list[tuple[str, BaseException]] = []
            for name, row in table:
                with _anew(fixtures) as own:
                    try:
                        await test(*given, **own, **dict(zip(keys, row, strict=True)))
                    except FAILURES as failure:
                        failures.append((name or _shown(row), failure))
            _raise_first(failures, len(table))

        signature = inspect.signature(test)
        kept = [parameter for name, parameter in signature.parameters.items() if name not in keys]
        assert len(kept) == len(signature.parameters) - len(keys), f"{test.__name__} has no {keys}"
        decorated = run_async if inspect.iscoroutinefunction(test) else run
        decorated.__signature__ = signature.replace(parameters=kept)  # type: ignore[attr-defined]
        return decorated

    return decorate


def _shown(row: tuple[Any, ...]) -> str:
    try:
        return repr(row)
    except ValueError as error:  # Python prints no integer of thousands of digits
        return f"a row that has no text ({error})"


@contextmanager
def _anew(fixtures: dict[str, Any]) -> Iterator[dict[str, Any]]:
    """The fixtures of one row: those that pytest would make anew for each case are."""
    own = dict(fixtures)
    if isinstance(own.get("tmp_path"), Path):
        own["tmp_path"] /= f"row-{sum(1 for _ in own['tmp_path'].iterdir())}"
        own["tmp_path"].mkdir()
    if "capsys" in own:
        own["capsys"].readouterr()
    if "caplog" in own:
        own["caplog"].clear()
    if "monkeypatch" not in own:
        yield own
        return
    with own["monkeypatch"].context() as own["monkeypatch"]:
        yield own


def _raise_first(failures: Sequence[tuple[str, BaseException]], rows: int) -> None:
    if failures:
        name, first = failures[0]
        others = "".join(f"\n  {name}" for name, _ in failures[1:10])
        first.add_note(f"{len(failures)} of {rows} rows fail, first with {name}{others}")
        raise first
