"""What one run has passed is left out by the deep run after it, but for what searches or runs on another loop."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import pytest

from support.passed_before import PassedBefore, left_to_run

FILES = {
    "plain": "def test_a(): ...",
    "searching": "from hypothesis import given",
    "seeded": "from support.examples import seeds",
    "runtime/loop": "def test_b(): ...",
}


def items(folder: Path) -> list[pytest.Item]:
    made = []
    for name, text in FILES.items():
        path = folder / f"{name}.py"
        path.parent.mkdir(exist_ok=True)
        path.write_text(text)
        made += [SimpleNamespace(path=path, nodeid=f"{name}.py::test_{case}") for case in ("quick", "deep")]
    return cast("list[pytest.Item]", made)


def test_only_what_passed_and_would_run_alike_is_left_out(tmp_path: Path) -> None:
    passed = {f"{name}.py::test_quick" for name in FILES}
    left = {item.nodeid for item in left_to_run(items(tmp_path), passed, tmp_path / "runtime")}
    assert left == {f"{name}.py::test_{case}" for name in FILES for case in ("quick", "deep")} - {
        "plain.py::test_quick"
    }


@pytest.mark.parametrize(("exit_status", "noted"), [(0, "a\n"), (1, None)])
def test_a_run_with_a_failure_notes_nothing(tmp_path: Path, exit_status: int, noted: str | None) -> None:
    plugin = PassedBefore(tmp_path / "passed")
    for nodeid, when, passed in (("a", "setup", True), ("a", "call", True), ("b", "call", False)):
        plugin.pytest_runtest_logreport(cast(Any, SimpleNamespace(nodeid=nodeid, when=when, passed=passed)))
    plugin.pytest_sessionfinish(cast(Any, SimpleNamespace(config=SimpleNamespace())), exit_status)
    file = tmp_path / "passed"
    assert (file.read_text() if file.exists() else None) == noted
