"""The examples of the pages, by language; of shell examples the calls of our own programs."""

from __future__ import annotations

import re
import shlex
import textwrap
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
PAGES = [*sorted(ROOT.glob("docs/**/*.md")), ROOT / "README.md", ROOT / "CONTRIBUTING.md"]
BLOCK = re.compile(r"^( *)```([\w ]*)\n(.*?)^\1```$", re.M | re.S)
"""Its indent, within a list; its language; its text."""
SHELL = ("", "sh", "bash")
MANUAL = re.compile(r" {3,}[a-z]")
"""Within a line of plain text: a synopsis with an explanation behind it."""


def label(page: Path) -> str:
    return str(page.relative_to(ROOT))


def blocks(page: Path, *languages: str) -> Iterator[str]:
    found = BLOCK.findall(page.read_text(encoding="utf-8"))
    return (textwrap.dedent(text) for _, language, text in found if language in languages)


def commands(page: Path) -> Iterator[list[str]]:
    """The words of each call of skygcs and skygcs-cli in the page's shell examples."""
    for text in blocks(page, *SHELL):
        for line in text.replace("\\\n", " ").splitlines():
            line = line.strip().removeprefix("$ ")
            if not re.search(r"(^|[|&;] *|sudo )skygcs(-cli)? ", line):
                continue
            if "|FILE" in line or "FILE…" in line or (MANUAL.search(line) and "#" not in line):
                line = MANUAL.split(line)[0].replace("[", "").replace("]", "")  # a synopsis
            yield from calls(line)


def calls(line: str) -> Iterator[list[str]]:
    """The words of each of our programs in one line of shell."""
    lexer = shlex.shlex(line, posix=True, punctuation_chars="|&;<>")
    lexer.whitespace_split = True
    words: list[str] = []
    skip = False
    for word in [*lexer, ";"]:
        if word in (">", ">>", "<"):
            skip = True
        elif skip:
            skip = False
        elif set(word) <= set("|&;"):
            words = words[1:] if words[:1] == ["sudo"] else words
            if words[:1] in (["skygcs"], ["skygcs-cli"]):
                yield words
            words = []
        else:
            words.append(word)
