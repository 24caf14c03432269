"""Every example of the pages is read by what it is for: commands by the command line's own parser, programs by Python.

TOML is read by `skygcs check` in tests/unit/config/test_reference_docs.py; tests/system/test_docs_programs.py and
test_docs_shell.py run what can be run.
"""

from __future__ import annotations

import argparse
import ast
import importlib
import json
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import typer.main

from skygcs.cli.main import EXAMPLE, app, hoisted, json_last
from skygcs.cli.serve import new_parser
from support.shell_examples import PAGES, ROOT, SHELL, blocks, calls, commands, label
from support.table import each

CODE_SPAN = re.compile(r"(?<!`)`([^`\n]+)`(?!`)")
LINK = re.compile(r"(?<!!)\[[^\]]*\]\(([^)\s]+)\)|!\[[^\]]*\]\(([^)\s]+)\)")
ROOT_COMMAND = typer.main.get_command(app)
ARGPARSE = new_parser()


def parse(words: list[str]) -> None:
    """Fails as the program itself would, with its words; runs nothing."""
    program, *args = words
    if program == "skygcs":
        try:
            ARGPARSE.parse_args(args)
        except SystemExit as end:
            assert end.code == 0, f"skygcs refuses: {' '.join(words)}"
        return
    command, rest, parent = ROOT_COMMAND, hoisted(json_last(args)), None
    try:
        while True:
            context = command.make_context(command.name, rest, parent=parent)
            words_left = [*getattr(context, "_protected_args", ()), *context.args]
            if not hasattr(command, "resolve_command") or not words_left:
                return
            _, command, rest = command.resolve_command(context, words_left)
            parent = context
    except Exception as error:  # click's and typer's, of which there are two trees
        raise AssertionError(f"{' '.join(words)}: {type(error).__name__}: {error}") from None


@each("page", PAGES)
def test_every_command_is_one(page: Path) -> None:
    for words in commands(page):
        parse(words)


def help_pages() -> Iterator[tuple[str, str]]:
    """Each command and group of both programs, and the text of its help that may have the example."""

    def of_cli(command: Any, words: str) -> Iterator[tuple[str, str]]:
        yield words, f"{command.help}\n\n{command.epilog or ''}"
        for name, inner in getattr(command, "commands", {}).items():
            yield from of_cli(inner, f"{words} {name}")

    def of_skygcs(parser: argparse.ArgumentParser) -> Iterator[tuple[str, str]]:
        yield parser.prog, parser.epilog or ""
        for action in parser._actions:
            if isinstance(action, argparse._SubParsersAction):
                for inner in action.choices.values():
                    yield from of_skygcs(inner)

    for name, command in ROOT_COMMAND.commands.items():
        yield from of_cli(command, f"skygcs-cli {name}")
    yield from of_skygcs(ARGPARSE)


def test_each_help_page_has_an_example_of_its_command() -> None:
    pages = dict(help_pages())
    assert len(pages) > 150
    for command, text in pages.items():
        found = EXAMPLE.search(text)
        assert found is not None and found[1].startswith(f"{command}"), f"{command}: no line `Example: {command} …`"
        for words in calls(found[1]):
            parse(words)


def test_most_commands_are_found_in_the_pages() -> None:
    """That the test above reads something: the pages show some two hundred calls."""
    assert sum(1 for page in PAGES for _ in commands(page)) > 150


@each(
    "line", ["skygcs-cli takeof all", "skygcs-cli goto alpha --enuu 1,2,3", "skygcs-cli status a b c", "skygcs runn f"]
)
def test_a_wrong_command_is_found(line: str) -> None:
    (words,) = calls(line)
    with pytest.raises(AssertionError, match=re.escape(line)):
        parse(words)


@each("page", PAGES)
def test_commands_named_in_the_text_and_their_options_exist(page: Path) -> None:
    prose = re.sub(r"^```.*?^```", "", page.read_text(encoding="utf-8"), flags=re.M | re.S)
    for span in CODE_SPAN.findall(prose):
        if not span.startswith("skygcs-cli "):
            continue
        command, context, words = ROOT_COMMAND, None, span.replace("\\|", " ").split()[1:]
        while words and hasattr(command, "resolve_command") and re.fullmatch(r"[a-z][a-z-]*", words[0]):
            context = command.make_context(command.name, [], parent=context, resilient_parsing=True)
            inner = command.get_command(context, words[0])
            assert inner is not None, f"no command in `{span}`"
            command, words = inner, words[1:]
        options = {name for param in command.params for name in (*param.opts, *param.secondary_opts)}
        options |= {"--help", "-h", *(name for param in ROOT_COMMAND.params for name in param.opts)}
        unknown = [w for w in words if re.fullmatch(r"--[a-z][a-z-]*", w) and w not in options]
        if not hasattr(command, "resolve_command"):
            assert unknown == [], f"no such option in `{span}`"


@each("page", PAGES)
def test_programs_compile_and_import_what_is_there(page: Path) -> None:
    for program in blocks(page, "python"):
        for node in ast.walk(ast.parse(program, label(page))):
            if isinstance(node, ast.ImportFrom) and node.module and node.module.startswith("skygcs"):
                module = importlib.import_module(node.module)
                assert [alias.name for alias in node.names if not hasattr(module, alias.name)] == []


@each("page", PAGES)
def test_json_is_json(page: Path) -> None:
    for text in blocks(page, "json"):
        for line in text.splitlines():
            json.loads(line)


@each("page", PAGES)
def test_targets_of_make_exist(page: Path) -> None:
    targets = set(re.findall(r"^([\w-]+):", (ROOT / "Makefile").read_text(encoding="utf-8"), re.M))
    text = page.read_text(encoding="utf-8")
    named = re.findall(r"`make ([\w-]+)[^`]*`", text)
    named += [t for block in blocks(page, *SHELL) for t in re.findall(r"^make ([\w-]+)", block, re.M)]
    assert set(named) - targets - {"px4_sitl_default", "px4_fmu-v2_default"} == set()  # PX4's own


def anchors(page: Path) -> set[str]:
    """As GitHub makes them of headings."""
    text = re.sub(r"^```.*?^```", "", page.read_text(encoding="utf-8"), flags=re.M | re.S)
    found = set()
    for heading in re.findall(r"^#+ (.*)$", text, re.M):
        plain = re.sub(r"\[([^\]]*)\]\([^)]*\)", r"\1", heading).lower()
        found.add(re.sub(r"[^\w\- ]", "", plain).strip().replace(" ", "-"))
    return found


@each("page", [*PAGES, ROOT / "CHANGELOG.md"])
def test_every_link_leads_somewhere(page: Path) -> None:
    """`make docs` checks those within docs/ too; this one those of the pages beside it, and without MkDocs."""
    text = re.sub(r"^```.*?^```|`[^`\n]*`", "", page.read_text(encoding="utf-8"), flags=re.M | re.S)
    for link, picture in LINK.findall(text):
        path, _, anchor = (link or picture).partition("#")
        if re.match(r"[a-z]+:", path):
            continue
        target = (page.parent / path).resolve() if path else page
        assert target.exists(), f"{link or picture} in {label(page)}"
        if anchor and target.suffix == ".md":
            assert anchor in anchors(target), f"{link} in {label(page)}"


@each("page", PAGES)
def test_the_site_knows_how_each_block_begins(page: Path) -> None:
    """With other words behind the language it shows the block, and the text up to the next one, as one paragraph."""
    begins = re.findall(r"^ *```(.+)$", page.read_text(encoding="utf-8"), re.M)
    assert [words for words in begins if not re.fullmatch(r'[a-z]+( title="[^"]+")?', words)] == []


TABLE = re.compile(r"(?:^\|(?: |-).*\n)+", re.M)
HEAD_AND_ROWS = re.compile(r"\|.*\n\|[ :|-]+\|\n\|.*")


@each("page", PAGES)
def test_every_table_is_whole(page: Path) -> None:
    """An empty line ends a table: the rows below it are shown as text with bars."""
    text = re.sub(r"^```.*?^```", "", page.read_text(encoding="utf-8"), flags=re.M | re.S)
    assert [table for table in TABLE.findall(f"{text}\n") if not HEAD_AND_ROWS.match(table)] == []


def test_every_page_of_the_site_is_in_its_index() -> None:
    index = ROOT / "docs" / "index.md"
    links = [link.partition("#")[0] for link, _ in LINK.findall(index.read_text(encoding="utf-8"))]
    linked = {(index.parent / link).resolve() for link in links}
    assert [label(page) for page in sorted((ROOT / "docs").rglob("*.md")) if page not in {*linked, index}] == []
