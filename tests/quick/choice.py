"""Which test files a change touches, within a budget of CPU time. Pure: the files are given as texts."""

from __future__ import annotations

import ast
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import PurePosixPath

BUDGET_CPU_S = 60.0
"""`make quick` on two cores: 45 s of wall time, of which 15 s go to start-up and to what cannot be divided."""

UNKNOWN_CPU_S = 1.0
"""Assumed for a file that was never measured on this machine; the median of the suite is below it."""

PAGES = ("docs/", "mkdocs.yml", "README.md", "CONTRIBUTING.md", "CHANGELOG.md", "Makefile", "configs/")
PAGE_TESTS = "tests/unit/test_docs_"
"""Pages are held by the tests whose names begin like this."""


@dataclass(frozen=True, slots=True)
class Choice:
    """Test files to run, the most telling first, and those that no longer fitted into the budget."""

    run: tuple[str, ...]
    left_out: tuple[str, ...]


def choose(changed: Iterable[str], tests: Mapping[str, str], cpu_s: Mapping[str, float]) -> Choice:
    """The tests of a change: changed ones, those of the same name as a changed module, those that import one.

    ``changed``: paths from the repository's root; ``tests``: path and source of each test file; ``cpu_s``: what each
    cost when it was last measured. A changed test file always runs; the others while the budget lasts, the cheap first.
    """
    paths = set(changed)
    modules = {name for path in paths if (name := module_name(path)) is not None}
    pages = any(path.startswith(PAGES) for path in paths)

    # What is nearest to the change comes first
    first = sorted(paths & tests.keys())
    mirrors = {path for path in tests if any(mirrors_module(path, module) for module in modules)}
    if pages:
        mirrors |= {path for path in tests if path.startswith(PAGE_TESTS)}
    importers = {path for path, source in tests.items() if modules & imported_modules(source)}

    def by_cost(found: set[str]) -> list[str]:
        return sorted(found, key=lambda path: (cpu_s.get(path, UNKNOWN_CPU_S), path))

    wanted = dict.fromkeys([*first, *by_cost(mirrors), *by_cost(importers)])

    # As many as fit
    run, left_out, spent_s = [], [], 0.0
    for path in wanted:
        cost_s = cpu_s.get(path, UNKNOWN_CPU_S)
        if path in paths or spent_s + cost_s <= BUDGET_CPU_S:
            run.append(path)
            spent_s += cost_s
        else:
            left_out.append(path)
    return Choice(tuple(run), tuple(left_out))


def module_name(path: str) -> str | None:
    """Dotted name under which tests import a file of src/ or tests/; None for any other file."""
    parts = PurePosixPath(path).parts
    if not path.endswith(".py") or len(parts) < 2 or parts[0] not in ("src", "tests"):
        return None
    dotted = ".".join(parts[1:]).removesuffix(".py")
    return dotted.removesuffix(".__init__")


def mirrors_module(test: str, module: str) -> bool:
    """True for a unit test in the module's room whose name begins with the module's: test_router_ways of router."""
    room, _, name = module.removeprefix("skygcs.").rpartition(".")
    folder = PurePosixPath("tests/unit", *room.split(".")) if room else PurePosixPath("tests/unit")
    path = PurePosixPath(test)
    return path.parent == folder and f"{path.stem}_".startswith((f"test_{name}_", f"test_{folder.name}_{name}_"))


def imported_modules(source: str) -> set[str]:
    """Modules that a file imports by their full name, at the top or in a function."""
    found: set[str] = set()
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module is not None:
            found.add(node.module)
            found |= {f"{node.module}.{alias.name}" for alias in node.names}
    return found
