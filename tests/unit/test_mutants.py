"""Changes of a function, each once, and the list of those that change nothing."""

from __future__ import annotations

import ast
from fnmatch import fnmatchcase

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
