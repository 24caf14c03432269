"""docs/explanation/safety.md: each promise has what enforces it, tests that exist, and what it does not cover."""

from __future__ import annotations

import ast
import re
from functools import cache
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
PAGE = ROOT / "docs" / "explanation" / "safety.md"
SPAN = re.compile(r"`([^`]+)`")


def rows() -> list[tuple[str, str, str, str]]:
    """The promises of the list: promise, what enforces it, what proves it, what is not covered."""
    text = re.sub(r"\n  ", " ", PAGE.read_text(encoding="utf-8"))
    found = re.findall(r"^- (\*\*.+?) \*Not covered:\* (.+?)\. Code: (.+?)\. Tests: (.+)\.$", text, re.MULTILINE)
    assert len(found) == len(re.findall(r"^- \*\*", text, re.MULTILINE))
    return [(promise, code, tests, rest) for promise, rest, code, tests in found]


@cache
def functions_of(path: Path) -> frozenset[str]:
    """Names of the functions of a test file, those in classes included."""
    nodes = ast.walk(ast.parse(path.read_text(encoding="utf-8")))
    return frozenset(n.name for n in nodes if isinstance(n, ast.FunctionDef | ast.AsyncFunctionDef))


def test_there_are_promises_in_bold() -> None:
    assert len(rows()) >= 20
    assert [row[0] for row in rows() if row[0].count("**") != 2] == []


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
