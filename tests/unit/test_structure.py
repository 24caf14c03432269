"""Rules of the house that neither ruff nor import-linter knows, held for all of `src/`."""

from __future__ import annotations

import ast
from collections import defaultdict
from collections.abc import Iterator
from functools import cache
from graphlib import CycleError, TopologicalSorter
from pathlib import Path

SRC = Path(__file__).resolve().parents[2] / "src"
MAX_FUNCTION_LINES = 60
"""A function fits a screen."""


@cache
def modules() -> dict[str, ast.Module]:
    """Dotted module name -> its syntax tree."""
    found = {}
    for path in sorted(SRC.glob("skygcs/**/*.py")):
        parts = path.relative_to(SRC).with_suffix("").parts
        found[".".join(parts[:-1] if parts[-1] == "__init__" else parts)] = ast.parse(path.read_text())
    return found


def imported(module: str) -> Iterator[str]:
    """The modules of skygcs that this one imports, wherever in the file: lazily and for type checking too."""
    for node in ast.walk(modules()[module]):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names if alias.name in modules())
        elif isinstance(node, ast.ImportFrom) and node.module in modules():
            for alias in node.names:
                inner = f"{node.module}.{alias.name}"
                yield inner if inner in modules() else node.module


def test_a_function_fits_a_screen() -> None:
    long = [
        f"{module}.{node.name}: {lines} lines"
        for module, tree in modules().items()
        for node in ast.walk(tree)
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef)
        and (lines := (node.end_lineno or node.lineno) - node.lineno + 1) > MAX_FUNCTION_LINES
    ]
    assert long == []


def test_no_module_imports_itself_through_others() -> None:
    graph = {module: set(imported(module)) - {module} for module in modules()}
    try:
        TopologicalSorter(graph).prepare()
    except CycleError as error:
        raise AssertionError(" -> ".join(error.args[1])) from None


def test_no_module_name_stands_twice_in_a_layer() -> None:
    names: dict[tuple[str, str], list[str]] = defaultdict(list)
    packages = {module.rpartition(".")[0] for module in modules()}
    for module in modules():
        parts = module.split(".")
        if len(parts) > 2 and module not in packages:
            names[parts[1], parts[-1]].append(module)
    assert [twice for twice in names.values() if len(twice) > 1] == []
