"""A plain install brings what the program imports itself, and an extra what its commands import."""

from __future__ import annotations

import ast
import functools
import re
import sys
import tomllib
from pathlib import Path

from support.source_trees import source_files, tree_of

ROOT = Path(__file__).resolve().parents[2]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
TOOLS = {"test", "docs", "dev"}
"""Extras of this repository's own tools, which nothing in src/ imports."""

WITH = {"pydantic": {"pydantic_core"}}
"""Modules of a package's other half, which it requires in the one version that fits."""

MODULES = {"pyserial": "serial", "foxglove-sdk": "foxglove", "nats-py": "nats"}
"""Packages whose module has another name, apart from - and _."""


def modules(requirements: list[str]) -> set[str]:
    names = [re.split(r"[^A-Za-z0-9_-]", line)[0] for line in requirements]
    return {MODULES.get(name, name.replace("-", "_")) for name in names}


@functools.cache
def imported() -> dict[str, set[str]]:
    """Each module from elsewhere, with the files that import it, at the top or when they need it; types alone too."""
    found: dict[str, set[str]] = {}
    for path in source_files():
        for node in ast.walk(tree_of(path)):
            if isinstance(node, ast.Import):
                names = [alias.name for alias in node.names]
            elif isinstance(node, ast.ImportFrom) and node.level == 0:
                names = [node.module or ""]
            else:
                continue
            for name in {name.partition(".")[0] for name in names} - sys.stdlib_module_names - {"skygcs"}:
                found.setdefault(name, set()).add(str(path.relative_to(ROOT)))
    return found


def test_what_a_plain_install_brings_is_imported_by_the_program_itself() -> None:
    assert modules(PROJECT["dependencies"]) - imported().keys() == set()


def test_what_an_extra_brings_is_imported_and_is_no_part_of_a_plain_install() -> None:
    plain = modules(PROJECT["dependencies"])
    for name, requirements in PROJECT["optional-dependencies"].items():
        if name not in TOOLS:
            assert modules(requirements) & plain == set(), name
            assert modules(requirements) <= imported().keys(), name


def test_nothing_is_imported_that_comes_only_by_way_of_another_package() -> None:
    extras = [line for name, lines in PROJECT["optional-dependencies"].items() if name not in TOOLS for line in lines]
    known = modules(PROJECT["dependencies"]) | modules(extras)
    known |= {module for name, more in WITH.items() if name in known for module in more}
    assert {name: files for name, files in imported().items() if name not in known} == {}
