"""Rules of the house that neither ruff nor import-linter knows, held for all of `src/`."""

from __future__ import annotations

import ast
from collections import defaultdict
from collections.abc import Iterator
from functools import cache
from graphlib import CycleError, TopologicalSorter

from figures.measures import reached_from
from support.source_trees import SRC, source_files, tree_of

MAX_FUNCTION_LINES = 60
"""A function fits a screen."""

MOST_FILES_OF_A_DAEMON = 210
"""Files that a daemon may import whose fleet file has no extension's table; 190 are wanted. It is only ever lowered."""

NO_BEGINNING = {"Of", "As", "For", "What", "Whether", "Who"}
"""A docstring is a sentence or a name, not the end of one that the reader has to begin."""


@cache
def modules() -> dict[str, ast.Module]:
    """Dotted module name -> its syntax tree."""
    found = {}
    for path in source_files():
        parts = path.relative_to(SRC.parent).with_suffix("").parts
        found[".".join(parts[:-1] if parts[-1] == "__init__" else parts)] = tree_of(path)
    return found


@cache
def nodes() -> dict[str, list[ast.AST]]:
    """Dotted module name -> the nodes of its tree that any rule looks at: to walk them all takes a second."""
    kinds = (ast.Import, ast.ImportFrom, ast.FunctionDef, ast.AsyncFunctionDef, ast.Expr)
    return {name: [node for node in ast.walk(tree) if isinstance(node, kinds)] for name, tree in modules().items()}


def imported(module: str) -> Iterator[str]:
    """The modules of skygcs that this one imports, wherever in the file: lazily and for type checking too."""
    for node in nodes()[module]:
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names if alias.name in modules())
        elif isinstance(node, ast.ImportFrom) and node.module in modules():
            for alias in node.names:
                inner = f"{node.module}.{alias.name}"
                yield inner if inner in modules() else node.module


def test_a_function_fits_a_screen() -> None:
    long = [
        f"{module}.{node.name}: {lines} lines"
        for module, found in nodes().items()
        for node in found
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef)
        and (lines := (node.end_lineno or node.lineno) - node.lineno + 1) > MAX_FUNCTION_LINES
    ]
    assert long == []


def test_no_docstring_is_half_a_sentence() -> None:
    assert [
        f"{module}: {node.value.value.splitlines()[0]}"
        for module, found in nodes().items()
        for node in found
        if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant) and isinstance(node.value.value, str)
        if node.value.value.split(maxsplit=1)[0].rstrip(":,") in NO_BEGINNING
    ] == []


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
            layer = ".".join(parts[1:3]) if parts[1] == "ext" else parts[1]
            names[layer, parts[-1]].append(module)
    assert [twice for twice in names.values() if len(twice) > 1] == []


def test_a_daemon_without_extensions_imports_few_files() -> None:
    reached = reached_from("skygcs.daemon", in_functions=True)
    assert [module for module in reached if module.startswith("skygcs.ext.")] == []
    assert len(reached) <= MOST_FILES_OF_A_DAEMON, "what only some fleets use belongs into an extension"
