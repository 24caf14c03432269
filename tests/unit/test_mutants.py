"""Changes of a function, each once, and the list of those that change nothing."""

from __future__ import annotations

import ast
import json
import os
import subprocess
import sys
from fnmatch import fnmatchcase
from pathlib import Path

import pytest

from mutants.__main__ import equivalent, sampled
from mutants.changes import changed_tree, mutants
from mutants.rooms import ROOMS, SRC, UNIT

SOURCE = '''
LIMIT = 5

class Box:
    def take(self, a, b):
        """Not a < b."""
        if a < b and not self.full:
            self.count += 1
        return a * 2
'''


MEASURED = """
def doubled(a):
    b = a * 2
    b = b + 0 * a
    return b

def unused(a):
    return a - 1
"""

ITS_TESTS = """
import gc
import measured

gc.freeze()  # as conftest does with all modules

def test_doubled():
    assert measured.doubled(5) == 10
"""

ONLY_ONCE = """
RUNS = []

def test_once():
    RUNS.append(measured.doubled(5))
    assert len(RUNS) == 1
"""

NOT_KEPT = """
import gc, runpy
from pathlib import Path

def test_doubled():
    assert runpy.run_path(str(Path(__file__).with_name("measured.py")))["doubled"](5) == 10
    gc.collect()
"""

RUN = """
import json, sys
from pathlib import Path
import pytest
from mutants.changes import mutants
from mutants.run import MutantRun, Task

path = Path("measured.py").resolve()
sys.path.insert(0, str(path.parent))
tasks = [Task(path, mutant) for mutant in [None, *mutants(path.read_text())]]
run = MutantRun(tasks)
pytest.main(["-q", "-p", "no:cacheprovider", "--rootdir", ".", "-c", "pytest.ini", "test_measured.py"], plugins=[run])
results = {task.mutant and task.mutant.after: run.results.get(number) for number, task in enumerate(tasks)}
Path("results.json").write_text(json.dumps([list(results.items()), run.errors]))
"""


def measured(folder: Path, tests: str) -> tuple[dict[str | None, str | None], list[str]]:
    """Results, and errors, of the mutants of MEASURED with these tests, in a Python of their own, which forks."""
    for name, text in {"measured.py": MEASURED, "test_measured.py": tests, "pytest.ini": "[pytest]\n"}.items():
        (folder / name).write_text(text)
    env = os.environ | {"PYTHONPATH": str(UNIT.parent)}
    subprocess.run([sys.executable, "-c", RUN], cwd=folder, env=env, check=True, timeout=100.0)
    results, errors = json.loads((folder / "results.json").read_text())
    return dict(results), errors


@pytest.mark.deep  # processes of pytest
def test_killed_is_what_a_test_fails_with_and_nothing_else(tmp_path: Path) -> None:
    """Frozen functions too: while none of them was found, the error in each fork counted as a failed test."""
    results, errors = measured(tmp_path, ITS_TESTS)
    assert errors == []
    assert results == {
        None: "survived",
        "b = a / 2": "killed",
        "b = a * 3": "killed",
        "b = b - 0 * a": "survived",
        "b = b + 0 / a": "survived",
        "b = b + 1 * a": "killed",
        "return None": "not reached",
        "return a + 1": "not reached",
        "return a - 2": "not reached",
    }


@pytest.mark.deep  # processes of pytest
def test_tests_that_fail_a_second_time_and_changes_of_no_function_are_errors(tmp_path: Path) -> None:
    _, errors = measured(tmp_path, ITS_TESTS + ONLY_ONCE)
    assert errors == ["measured.py: as it is: tests fail when they run again"]
    results, errors = measured(tmp_path, NOT_KEPT)
    assert errors[:2] == [
        "measured.py: as it is: no function gets other code",
        "measured.py: doubled: b = a * 2 -> b = a / 2: no function gets other code",
    ]
    assert set(results.values()) == {None, "not reached"}


def test_each_change_of_a_function_is_made_once_and_nothing_else_changes() -> None:
    found = mutants(SOURCE)
    assert [(mutant.line, mutant.after) for mutant in found] == [
        (7, "if not (a < b and (not self.full)):"),
        (7, "if a < b or not self.full:"),
        (7, "if a <= b and (not self.full):"),
        (7, "if a < b and self.full:"),
        (8, "nothing"),
        (8, "self.count -= 1"),
        (8, "self.count += 2"),
        (9, "return None"),
        (9, "return a / 2"),
        (9, "return a * 3"),
    ]
    assert {mutant.function for mutant in found} == {"Box.take"}
    whole = ast.unparse(ast.parse(SOURCE))
    for mutant in found:
        changed = ast.unparse(changed_tree(SOURCE, mutant)).splitlines()
        assert sum(old != new for old, new in zip(whole.splitlines(), changed, strict=True)) == 1


def test_a_sample_is_the_same_whatever_stands_around_it() -> None:
    path = SRC / "core/control/guard.py"
    keys = {mutant.key for mutant in sampled(path, 20)}
    assert len(keys) == 20 and keys <= {mutant.key for mutant in sampled(path, 40)}


def test_rooms_exist_and_what_is_listed_as_equivalent_is_a_mutant_of_today() -> None:
    modules = {name: tests for room in ROOMS.values() for name, tests in room.items()}
    assert [test for tests in modules.values() for test in tests if not (UNIT / test).is_file()] == []
    for name, patterns in equivalent().items():
        keys = [mutant.key for mutant in mutants((SRC / name).read_text())]
        assert [pattern for pattern in patterns if not any(fnmatchcase(key, pattern) for key in keys)] == []
