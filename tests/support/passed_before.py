"""Plugin of pytest: what a run has passed stands in a file, and the deep run of the same commit leaves that out.

The deep run contains `make test`. In CI both run on one machine and one commit: only what differs is run again, and
that is what searches (Hypothesis, seeds and tables whose length `support.examples` decides) or runs on another loop.
"""

from __future__ import annotations

import ast
from collections.abc import Collection, Iterable
from pathlib import Path

import pytest

SEARCHING = "hypothesis", "support.examples"
"""Modules that decide how much a test runs: in the deep run more than in `make test`."""

TESTS = Path(__file__).parents[1]
"""Where modules of the tests are imported from."""

MORE_CASES = "support.loops"
"""It makes more cases of a test in the deep run, each with another node id."""

OF_ALL = frozenset({"pytestmark", "autouse"})
"""Names that concern every test of a file that has them."""


class PassedBefore:
    """Write the node ids of tests that passed into a file, one a line, when the run has ended without a failure."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._passed: list[str] = []

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        if report.when == "call" and report.passed:
            self._passed.append(report.nodeid)

    def pytest_sessionfinish(self, session: pytest.Session, exitstatus: int) -> None:
        if exitstatus == 0 and not hasattr(session.config, "workerinput"):
            self._path.write_text("".join(f"{nodeid}\n" for nodeid in self._passed))


def left_to_run(items: Iterable[pytest.Item], passed: Collection[str], on_another_loop: Path) -> list[pytest.Item]:
    """The tests of a deep run that have not passed before as they would run now: those with another node id, those
    that search or begin otherwise, and those of a folder that runs on another event loop now."""
    searching: dict[Path, set[str]] = {}
    left = []
    for item in items:
        if item.path not in searching:
            searching[item.path] = searching_names(item.path.read_text())
        names = searching[item.path]
        name = item.nodeid.split("::")[1].partition("[")[0]
        if item.nodeid not in passed or {name, *OF_ALL} & names or item.path.is_relative_to(on_another_loop):
            left.append(item)
    return left


def searching_names(source: str) -> set[str]:
    """Names that a file defines at its top by a name of `SEARCHING`: directly, by another definition of the file, or by
    a fixture. "autouse" is among them if such a fixture is one of all tests."""
    found: set[str] = set()
    uses: dict[str, set[str]] = {}
    for statement in ast.parse(source).body:
        imported = _imported(statement)
        if isinstance(statement, ast.Import | ast.ImportFrom):
            found |= imported
            continue
        used = _used(statement) | imported
        found |= imported
        for name in _defined(statement):
            uses.setdefault(name, set()).update(used)
    while more := {name for name, used in uses.items() if used & found} - found:
        found |= more
        if any("autouse" in uses[name] for name in more):
            found.add("autouse")
    return found


_searching_of: dict[str, set[str]] = {}
"""`searching_names` by module of the tests."""


def searching_of(module: str) -> set[str]:
    """The `searching_names` of a module of the tests, such as flights that begin in the air in `make test` and on the
    ground in the deep run; of any other module none."""
    if module == MORE_CASES:
        return set()
    if module not in _searching_of:
        _searching_of[module] = set()  # while it is read: two may import each other for their types
        path = TESTS.joinpath(*module.split(".")).with_suffix(".py")
        if path.is_file():
            _searching_of[module] = searching_names(path.read_text())
    return _searching_of[module]


def _imported(statement: ast.stmt) -> set[str]:
    """Names that a statement, or one inside it, imports from a module of `SEARCHING`, or from one of the tests that
    defines them with anything of these."""
    names = set()
    for node in ast.walk(statement):
        if isinstance(node, ast.Import):
            names |= {(one.asname or one.name).split(".")[0] for one in node.names if one.name.startswith(SEARCHING)}
        elif isinstance(node, ast.ImportFrom) and f"{node.module}".startswith(SEARCHING):
            names |= {one.asname or one.name for one in node.names}
        elif isinstance(node, ast.ImportFrom):
            known = searching_of(f"{node.module}")
            whole = {one.name for one in node.names if f"{node.module}.{one.name}".startswith(SEARCHING)}
            whole |= {one.name for one in node.names if searching_of(f"{node.module}.{one.name}")}
            names |= {one.asname or one.name for one in node.names if one.name in known | whole}
    return names


def _defined(statement: ast.stmt) -> set[str]:
    if isinstance(statement, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef):
        return {statement.name}
    return {node.id for node in ast.walk(statement) if isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store)}


def _used(statement: ast.stmt) -> set[str]:
    """Names, arguments (a fixture's name), keywords ("autouse") and texts (a fixture's name, too) of a statement."""
    used = set()
    for node in ast.walk(statement):
        if isinstance(node, ast.Name):
            used.add(node.id)
        elif isinstance(node, ast.arg | ast.keyword):
            used.add(f"{node.arg}")
        elif isinstance(node, ast.Constant) and isinstance(node.value, str):
            used.add(node.value)
    return used
