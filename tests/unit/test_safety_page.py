"""docs/explanation/safety.md: each promise has what enforces it, tests that exist, and what it does not cover."""

from __future__ import annotations

import ast
import re
from functools import cache
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
PAGE = ROOT / "docs" / "explanation" / "safety.md"
SPAN = re.compile(r"`([^`]+)`")


def rows() -> list[list[str]]:
    """The cells of the table of promises."""
    lines = [line for line in PAGE.read_text(encoding="utf-8").splitlines() if line.startswith("| ")]
    return [[cell.strip() for cell in line.strip("|").split(" | ")] for line in lines[1:]]


@cache
def functions_of(path: Path) -> frozenset[str]:
    """Names of the functions of a test file, those in classes included."""
    nodes = ast.walk(ast.parse(path.read_text(encoding="utf-8")))
    return frozenset(n.name for n in nodes if isinstance(n, ast.FunctionDef | ast.AsyncFunctionDef))


def test_each_promise_has_its_four_cells() -> None:
    assert len(rows()) >= 20
    for row in rows():
        assert len(row) == 4 and all(row), row
        assert row[0].startswith("**") and row[0].count("**") == 2, row[0]


def test_what_enforces_a_promise_exists() -> None:
    for promise, enforced, _, _ in rows():
        named = SPAN.findall(enforced)
        assert named, promise
        assert [name for name in named if not (ROOT / "src" / "skygcs" / name).is_file()] == [], promise


def test_the_tests_that_prove_it_exist() -> None:
    for promise, _, proven, _ in rows():
        named = [name for name in SPAN.findall(proven) if name.startswith("tests/")]
        assert named, promise
        for name in named:
            file, _, function = name.partition("::")
            assert (ROOT / file).is_file(), (promise, name)
            if function:
                assert function in functions_of(ROOT / file), (promise, name)
            else:
                assert any(test.startswith("test_") for test in functions_of(ROOT / file)), (promise, name)
