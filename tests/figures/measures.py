"""Size and shape of the code, from its text alone: code lines, equal lines, and the files that modules import."""

from __future__ import annotations

import ast
import io
import tokenize
from collections import defaultdict
from collections.abc import Iterator
from itertools import combinations
from pathlib import Path

from support.source_trees import SRC, source_files, tree_of

ROOT = Path(__file__).resolve().parents[2]
PAGE = SRC / "web" / "page" / "src"
EQUAL_LINES = 8
"""Shorter runs of equal lines are imports and signatures."""

_NO_CODE = (tokenize.COMMENT, tokenize.NL, tokenize.NEWLINE, tokenize.INDENT, tokenize.DEDENT, tokenize.ENDMARKER)


def code_line_numbers(text: str) -> list[int]:
    """Numbers of the lines with code: without blank lines, comments and docstrings."""
    documented = set()
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant) and isinstance(node.value.value, str):
            documented.update(range(node.lineno, (node.end_lineno or node.lineno) + 1))
    numbers = set()
    for token in tokenize.generate_tokens(io.StringIO(text).readline):
        if token.type not in _NO_CODE:
            numbers.update(range(token.start[0], token.end[0] + 1))
    return sorted(numbers - documented)


def code_lines() -> dict[str, tuple[int, int]]:
    """(code lines, files) by room: the folder below skygcs, below ext one for each extension."""
    rooms: dict[str, tuple[int, int]] = {}
    for path in source_files():
        parts = path.relative_to(SRC).parts
        room = (
            "." if len(parts) == 1 else "/".join(parts[: min(len(parts) - 1, 2 if parts[0] in ("core", "ext") else 1)])
        )
        lines, files = rooms.get(room, (0, 0))
        rooms[room] = lines + len(code_line_numbers(path.read_text())), files + 1
    return rooms


def page_lines() -> int:
    """Lines of the page's sources with something in them, without the types that are printed from the registry."""
    return sum(
        sum(1 for line in path.read_text().splitlines() if line.strip())
        for path in PAGE.rglob("*.ts*")
        if not path.name.endswith((".test.ts", ".test.tsx", "rpc_types.ts"))
    )


def equal_runs() -> list[tuple[str, str]]:
    """Pairs of places in src whose next `EQUAL_LINES` lines of code are equal, each run once, by its first lines."""
    places: dict[tuple[str, ...], list[tuple[Path, int]]] = defaultdict(list)
    numbers: dict[Path, list[int]] = {}
    for path in source_files():
        text = path.read_text()
        lines = text.splitlines()
        kept = [n for n in code_line_numbers(text) if not lines[n - 1].lstrip().startswith(("import ", "from "))]
        numbers[path] = kept
        stripped = [lines[n - 1].strip() for n in kept]
        for i in range(len(kept) - EQUAL_LINES + 1):
            places[tuple(stripped[i : i + EQUAL_LINES])].append((path, i))
    pairs = {pair for found in places.values() for pair in combinations(found, 2)}
    starts = [((a, i), (b, j)) for (a, i), (b, j) in sorted(pairs) if ((a, i - 1), (b, j - 1)) not in pairs]
    return [tuple(f"{path.relative_to(ROOT)}:{numbers[path][i]}" for path, i in pair) for pair in starts]  # type: ignore[misc]


def imports_of(module: Path, *, in_functions: bool) -> Iterator[str]:
    """The modules that a file imports when it is imported; with those that its functions import, or that it names in
    texts, to import them later."""
    stack: list[ast.AST] = [tree_of(module)]
    while stack:
        node = stack.pop()
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom) and node.module is not None:
            yield node.module
            yield from (f"{node.module}.{alias.name}" for alias in node.names)
        elif isinstance(node, ast.Constant) and in_functions and str(node.value).startswith("skygcs."):
            yield str(node.value)
        elif isinstance(node, ast.If) and "TYPE_CHECKING" in ast.unparse(node.test):
            stack += node.orelse
        elif in_functions or not isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.Lambda):
            stack += ast.iter_child_nodes(node)


CHOOSE = ("skygcs.runtime.linktable", "skygcs.runtime.radios")
"""Their functions import the kinds of links that a fleet file has, and what radios need; a plain one has `PLAIN_LINK`
alone."""
PLAIN_LINK = "skygcs.links.udp"


def reached_from(name: str, *, in_functions: bool) -> set[str]:
    """The modules of skygcs that a daemon imports, beginning with this one: when it starts, or with all that its
    functions may import later. Of the kinds of links only `PLAIN_LINK`."""
    modules = {}
    for path in source_files():
        parts = ("skygcs", *path.relative_to(SRC).with_suffix("").parts)
        modules[".".join(parts[:-1] if parts[-1] == "__init__" else parts)] = path
    reached: set[str] = set()
    left = [name, PLAIN_LINK]
    while left:
        if (module := left.pop()) in modules and module not in reached:
            reached.add(module)
            left += imports_of(modules[module], in_functions=in_functions and module not in CHOOSE)
            left.append(module.rpartition(".")[0])
    return reached
