"""The syntax trees of `src`: each file is parsed once for all tests of one process."""

from __future__ import annotations

import ast
import gc
from collections.abc import Mapping
from functools import cache
from pathlib import Path

SRC = Path(__file__).resolve().parents[2] / "src" / "skygcs"


@cache
def source_files() -> tuple[Path, ...]:
    """Every Python file of skygcs, in the order of their paths; not those of packages of the page."""
    return tuple(sorted(path for path in SRC.rglob("*.py") if "node_modules" not in path.parts))


def tree_of(path: Path) -> ast.Module:
    """The syntax tree of a file of `source_files`, which nobody changes."""
    return _trees()[path]


@cache
def _trees() -> Mapping[Path, ast.Module]:
    gc.disable()
    trees = {path: ast.parse(path.read_text(encoding="utf-8")) for path in source_files()}
    gc.enable()
    gc.freeze()  # a million nodes, which no later collection needs to look at
    return trees
