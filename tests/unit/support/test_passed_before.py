"""What one run has passed is left out by the deep run after it, but for what searches or runs on another loop."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import pytest

from support.passed_before import PassedBefore, left_to_run, searching_names
from support.table import each

FILES = {
    "plain": "def test_quick(): ...",
    "beside": "from hypothesis import given\n@given(x=1)\ndef test_other(x): ...\ndef test_quick(): ...",
    "searching": "from hypothesis import given\n@given(x=1)\ndef test_quick(x): ...",
    "seeded": "from support.examples import seeds\ndef test_quick():\n    for seed in seeds(20): ...",
    "runtime/loop": "def test_quick(): ...",
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
        "plain.py::test_quick",
        "beside.py::test_quick",
    }


@each(
    ("text", "searching"),
    [
        ("ROWS = thinned(TABLE, 5)\n@each('row', ROWS)\ndef test_a(row): ...\ndef test_b(): ...", {"test_a"}),
        ("def helper():\n    return seeds(5)\ndef test_a():\n    helper()\ndef test_b(): ...", {"test_a"}),
        ("@pytest.fixture\ndef rows():\n    return seeds(5)\ndef test_a(rows): ...\ndef test_b(): ...", {"test_a"}),
        ("from support.flown import Flown, aloft\ndef test_a(): aloft()\ndef test_b(): Flown()", {"test_a"}),
        ("from support.dry_runs import judge, OVER\ndef test_a(): judge()\ndef test_b(): OVER", {"test_a"}),
        ("from support import flown, table\ndef test_a(): flown.aloft()\ndef test_b(): table.each()", {"test_a"}),
        ("class Kept:\n    of = seeds(3)\nclass TestKept(Kept):\n    def test_a(self): ...", {"TestKept"}),
        ("def rows():\n    return seeds(5)\n@pytest.mark.usefixtures('rows')\ndef test_a(): ...", {"test_a"}),
        ("@pytest.fixture(autouse=True)\ndef rows():\n    return seeds(5)\ndef test_a(): ...", {"autouse"}),
        ("pytestmark = each('seed', seeds(5))\ndef test_a(seed): ...", {"pytestmark"}),
        ("def test_a():\n    from hypothesis import find\n    find(1)\ndef test_b(): ...", {"test_a"}),
        ("@pytest.fixture(autouse=True)\ndef rows(): ...\ndef test_a(): ...\nSEEDS = seeds(5)", set()),
    ],
)
def test_what_searches_is_known_by_all_that_it_uses(text: str, searching: set[str]) -> None:
    names = searching_names("from support.examples import seeds, thinned\n" + text)
    assert {name for name in names if name.startswith(("test_", "Test", "autouse", "pytestmark"))} == searching


@each(("exit_status", "noted"), [(0, "a\n"), (1, None)])
def test_a_run_with_a_failure_notes_nothing(tmp_path: Path, exit_status: int, noted: str | None) -> None:
    plugin = PassedBefore(tmp_path / "passed")
    for nodeid, when, passed in (("a", "setup", True), ("a", "call", True), ("b", "call", False)):
        plugin.pytest_runtest_logreport(cast(Any, SimpleNamespace(nodeid=nodeid, when=when, passed=passed)))
    plugin.pytest_sessionfinish(cast(Any, SimpleNamespace(config=SimpleNamespace())), exit_status)
    file = tmp_path / "passed"
    assert (file.read_text() if file.exists() else None) == noted
