"""Tables of a test: all rows in one test, where each case would cost more to set up than to run."""

from __future__ import annotations

import functools
import inspect
from collections.abc import Callable, Iterable, Sequence
from typing import Any

import pytest

from support.public_data import Present


def each(names: str | Sequence[str], rows: Iterable[Any]) -> Callable[[Callable[..., None]], Callable[..., None]]:
    """Decorate a test that needs nothing anew for each row: it runs for all of them and names those that fail.

    ``names`` are parameters of the test, ``rows`` their values, as those of ``pytest.mark.parametrize``. Several tables
    give every combination. Fixtures are made once for all rows, so a test with ``tmp_path`` or in virtual time is
    parametrised instead.
    """
    keys = [name.strip() for name in names.split(",") if name.strip()] if isinstance(names, str) else list(names)
    table = [(row,) if len(keys) == 1 else tuple(row) for row in rows]
    if not table and isinstance(rows, Present):
        return pytest.mark.skip(reason="no public data")
    assert table, "a table without rows tests nothing"

    def decorate(test: Callable[..., None]) -> Callable[..., None]:
        @functools.wraps(test)
        def run(*given: Any, **fixtures: Any) -> None:
            failures: list[tuple[tuple[Any, ...], Exception]] = []
            for row in table:
                try:
                    test(*given, **fixtures, **dict(zip(keys, row, strict=True)))
                except Exception as failure:
                    failures.append((row, failure))
            if failures:
                row, first = failures[0]
                others = "".join(f"\n  {row!r}" for row, _ in failures[1:10])
                first.add_note(f"{len(failures)} of {len(table)} rows fail, first with {row!r}{others}")
                raise first

        signature = inspect.signature(test)
        kept = [parameter for name, parameter in signature.parameters.items() if name not in keys]
        assert len(kept) == len(signature.parameters) - len(keys), f"{test.__name__} has no {keys}"
        run.__signature__ = signature.replace(parameters=kept)  # type: ignore[attr-defined]
        return run

    return decorate
