"""Every path and every dotted name of the project that the pages, the docstrings and the comments mention exists."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from functools import cache
from pathlib import Path

from skygcs.cli.topics import EXTENSION_COMMANDS, EXTENSION_PROGRAMS
from skygcs.config.extension_tables import GROUP, ON_DEMAND
from skygcs.web.file_checks import EXTENSION_CHECKS
from support.extension_parts import ALL_METHODS
from support.source_trees import SRC, source_files, tree_of
from support.table import each

ROOT = Path(__file__).resolve().parents[2]
PAGES = sorted([*ROOT.glob("docs/**/*.md"), *ROOT.glob("*.md")])
HISTORY = {"CHANGELOG.md"}
"""Names what was called otherwise then."""

CODE_SPAN = re.compile(r"`([^`\n]+)`")
FENCE = re.compile(r"^```.*?^```", re.M | re.S)
PATH = re.compile(
    r"(?<![\w./*$~-])((?:[\w.-]+/)+[\w.-]+\.(?:py|c|h|toml|md)|(?:src/skygcs|core|sim|tlog|modem|links|runtime|rpc|config|cli)/[\w/]+|\w+\.py)\b"
)
MODULE = re.compile(r"\bskygcs(?:\.[A-Za-z_]\w*)+")
ENTRY_POINTS = (GROUP, ON_DEMAND, EXTENSION_CHECKS, EXTENSION_COMMANDS, EXTENSION_PROGRAMS)
"""Groups of entry points, which look like modules."""
FILES = (".sock", ".service", ".toml")
"""Names of files that look like modules."""
MEMBER = re.compile(r"\b([A-Z][a-z]\w*)\.([a-z_]\w*)\b")


@cache
def classes() -> dict[str, set[str]]:
    """Class name -> names of its members, those of its bases in `src/` included."""
    own: dict[str, tuple[set[str], list[str]]] = {}
    stubs = [ast.parse(path.read_text()) for path in SRC.glob("**/*.pyi")]
    for tree in [*map(tree_of, source_files()), *stubs]:
        for node in tree.body:
            if isinstance(node, ast.ClassDef):
                bases = [base.id for base in node.bases if isinstance(base, ast.Name)]
                members, known_bases = own.get(node.name, (set(), []))
                own[node.name] = (members | _members(node), known_bases + bases)
    return {name: _inherited(name, own) for name in own}


def _members(node: ast.ClassDef) -> set[str]:
    names = set()
    for inner in ast.walk(node):
        if isinstance(inner, ast.FunctionDef | ast.AsyncFunctionDef):
            names.add(inner.name)
        elif isinstance(inner, ast.AnnAssign | ast.Assign):
            targets = inner.targets if isinstance(inner, ast.Assign) else [inner.target]
            for target in targets:
                if isinstance(target, ast.Name):
                    names.add(target.id)
                elif isinstance(target, ast.Attribute):
                    names.add(target.attr)
    return names


def _inherited(name: str, own: dict[str, tuple[set[str], list[str]]]) -> set[str]:
    members, bases = own.get(name, (set(), []))
    return members.union(*(_inherited(base, own) for base in bases if base != name))


@cache
def file_names() -> set[str]:
    return {path.name for folder in ("src", "tests") for path in (ROOT / folder).rglob("*.*")}


def path_exists(text: str, page: Path) -> bool:
    if "/" not in text:  # one of several in a list: `core/routing/router.py`, `filters.py`
        return text in file_names() or (ROOT / text).exists()
    return any((base / text).exists() or (base / text).with_suffix(".py").exists() for base in (ROOT, SRC, page.parent))


@cache
def module_exists(dotted: str) -> bool:
    """A module, or something defined at the top of one, or a member of such a class."""
    parts = dotted.split(".")[1:]
    for length in range(len(parts), -1, -1):
        base = SRC.joinpath(*parts[:length])
        file = base.with_suffix(".py") if length and base.with_suffix(".py").exists() else base / "__init__.py"
        if not file.exists():
            continue
        rest = parts[length:]
        if not rest:
            return True
        return (
            re.search(
                rf"^(?:class|def|async def) {rest[0]}\b|^{rest[0]}\b|import .*\b{rest[0]}\b", file.read_text(), re.M
            )
            is not None
        )
    return False


@each("page", [p for p in PAGES if p.name not in HISTORY])
def test_what_a_page_names_exists(page: Path) -> None:
    text = page.read_text()
    spans = CODE_SPAN.findall(FENCE.sub("", text))
    missing = [p for span in spans for p in PATH.findall(span) if not path_exists(p, page)]
    missing += [
        name
        for name in MODULE.findall(text)
        if name not in ENTRY_POINTS and not name.endswith(FILES) and not module_exists(name)
    ]
    missing += [
        f"{name}.{member}"
        for name, member in MEMBER.findall("\n".join(spans))
        if name in classes() and member not in classes()[name]
    ]
    assert missing == []


@each("page", ["docs/explanation/architecture.md", "CONTRIBUTING.md"])
def test_the_pages_about_the_code_name_only_what_it_has(page: str) -> None:
    """There also drawings count, and a class that `src/` does not have is a mistake."""
    text = (ROOT / page).read_text()
    missing = [f"{c}.{m}" for c, m in MEMBER.findall(text) if c not in classes() or m not in classes()[c]]
    assert missing == []


DOTTED = re.compile(r"(?<![\w./*-])[A-Za-z_]\w*(?:\.[A-Za-z_]\w*)+")
WORD = re.compile(r"([A-Za-z_]\w{3,})(?:\(\))?")
OTHER_FILES = (".sock", ".toml", ".json", ".cpp", ".h", ".py")
"""Files, not modules: paths are checked where pages name them."""


def files() -> list[Path]:
    return sorted(SRC.glob("**/*.py"))


COMMENT_OR_TEXT = re.compile(r'"""(.*?)"""|(?:^|\s)(#[^\n]*`[^\n]*)', re.S)
"""A docstring, those behind attributes included, or a comment with a code span. Tokens and trees would take 10 s."""


def texts(path: Path) -> Iterator[tuple[int, str]]:
    """(line, text) of each comment and docstring that names something."""
    source = path.read_text()
    for match in COMMENT_OR_TEXT.finditer(source):
        text = match[1] or match[2] or ""
        if "`" in text:
            yield source.count("\n", 0, match.start()) + 1, text


@cache
def modules() -> dict[str, list[str]]:
    """Last part of a module's or package's name -> its dotted names."""
    names: dict[str, list[str]] = {}
    for path in files():
        parts = path.relative_to(SRC).with_suffix("").parts
        parts = parts[:-1] if parts[-1] == "__init__" else parts
        if parts:
            names.setdefault(parts[-1], []).append(".".join(parts))
    return names


@cache
def rooms() -> set[str]:
    """Names that begin the dotted name of a module: `core.routing.router` or, within core, `routing.router`."""
    packages = [path.parent for path in SRC.glob("**/__init__.py")]
    return {package.name for package in packages if package.parent in (SRC, SRC / "core")}


@cache
def words() -> set[str]:
    """Every word of `src/` that is not in a code span."""
    found: set[str] = set()
    for path in [*files(), *SRC.glob("**/*.pyi"), *SRC.glob("**/*.c")]:
        found.update(re.findall(r"\w+", CODE_SPAN.sub("", path.read_text())))
    return found


@cache
def exists(dotted: str) -> bool:
    first, second = dotted.split(".")[:2]
    if dotted in ALL_METHODS or dotted in ENTRY_POINTS or dotted.endswith(OTHER_FILES):
        return True
    if first == "skygcs":
        return module_exists(dotted)
    if first in classes():
        return second in classes()[first]
    candidates = [f"skygcs.{dotted}", f"skygcs.core.{dotted}"] if first in rooms() else []
    rest = dotted.partition(".")[2]
    candidates += [f"skygcs.{name}.{rest}" for name in modules().get(first, ())]
    return not candidates or any(map(module_exists, candidates))


@each("path", files())
def test_what_a_docstring_names_exists(path: Path) -> None:
    missing = []
    for line, text in texts(path):
        for span in CODE_SPAN.findall(text):
            missing += [f"{line}: {name}" for name in DOTTED.findall(span) if not exists(name)]
            if (match := WORD.fullmatch(span)) is not None and match[1] not in words():
                missing.append(f"{line}: {span}")
    assert missing == []


def test_comments_and_docstrings_are_read_and_other_strings_are_not(tmp_path: Path) -> None:
    path = tmp_path / "module.py"
    path.write_text('"""Of `a`."""\nX = "`no`"  # of `b`\nY = 1\n"""Of\n`c`."""\n# nothing\n')
    assert list(texts(path)) == [(1, "Of `a`."), (2, "# of `b`"), (4, "Of\n`c`.")]


def test_a_name_that_does_not_exist_is_found() -> None:
    assert not exists("core.vehicle.pilot.OffboardConfig")
    assert not exists("core.pacing")
    assert not exists("Vehicle.no_such_attribute")
    assert exists("core.radio_link.pacing")
    assert exists("Vehicle.on_frame")
    assert exists("rpc.discover")
