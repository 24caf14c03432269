"""Every path and every dotted name of the project that the documents mention exists."""

from __future__ import annotations

import ast
import re
from functools import cache
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
SRC = ROOT / "src" / "skygcs"
PAGES = sorted([*ROOT.glob("docs/**/*.md"), *ROOT.glob("*.md")])
HISTORY = {"CHANGELOG.md"}
"""Names what was called otherwise then."""

CODE_SPAN = re.compile(r"`([^`\n]+)`")
FENCE = re.compile(r"^```.*?^```", re.M | re.S)
PATH = re.compile(
    r"(?<![\w./*$~-])((?:[\w.-]+/)+[\w.-]+\.(?:py|c|h|toml|md)|(?:src/skygcs|core|sim|tlog|modem|links|runtime|rpc|config|cli)/[\w/]+|\w+\.py)\b"
)
MODULE = re.compile(r"\bskygcs(?:\.[A-Za-z_]\w*)+")
FILES = (".sock", ".service", ".toml")
"""Names of files that look like modules."""
MEMBER = re.compile(r"\b([A-Z][a-z]\w*)\.([a-z_]\w*)\b")


@cache
def classes() -> dict[str, set[str]]:
    """Class name -> names of its members, those of its bases in `src/` included."""
    own: dict[str, tuple[set[str], list[str]]] = {}
    for path in [*SRC.glob("**/*.py"), *SRC.glob("**/*.pyi")]:
        for node in ast.walk(ast.parse(path.read_text())):
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


def path_exists(text: str, page: Path) -> bool:
    if "/" not in text:  # one of several in a list: `core/routing/router.py`, `filters.py`
        return any(ROOT.glob(f"src/**/{text}")) or any(ROOT.glob(f"tests/**/{text}")) or (ROOT / text).exists()
    return any((base / text).exists() or (base / text).with_suffix(".py").exists() for base in (ROOT, SRC, page.parent))


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


@pytest.mark.parametrize("page", [p for p in PAGES if p.name not in HISTORY], ids=lambda p: str(p.relative_to(ROOT)))
def test_what_a_page_names_exists(page: Path) -> None:
    text = page.read_text()
    spans = CODE_SPAN.findall(FENCE.sub("", text))
    missing = [p for span in spans for p in PATH.findall(span) if not path_exists(p, page)]
    missing += [name for name in MODULE.findall(text) if not name.endswith(FILES) and not module_exists(name)]
    missing += [
        f"{name}.{member}"
        for name, member in MEMBER.findall("\n".join(spans))
        if name in classes() and member not in classes()[name]
    ]
    assert missing == []


@pytest.mark.parametrize("page", ["docs/explanation/architecture.md", "CONTRIBUTING.md"])
def test_the_pages_about_the_code_name_only_what_it_has(page: str) -> None:
    """There also drawings count, and a class that `src/` does not have is a mistake."""
    text = (ROOT / page).read_text()
    missing = [f"{c}.{m}" for c, m in MEMBER.findall(text) if c not in classes() or m not in classes()[c]]
    assert missing == []
