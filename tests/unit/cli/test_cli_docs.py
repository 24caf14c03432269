"""`skygcs-cli docs`: the pages, by name, by text, and one clear line for what is not there."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from typer.testing import CliRunner, Result

from skygcs.cli import docs
from skygcs.cli.main import app
from support.shell_examples import ROOT
from support.table import each

PAGES = sorted(path.relative_to(ROOT / "docs").with_suffix("").as_posix() for path in (ROOT / "docs").rglob("*.md"))


def run(*words: str) -> Result:
    return CliRunner().invoke(app, ["docs", *words])


def test_every_page_is_listed_with_its_title() -> None:
    listed = json.loads(run("--json").output)
    assert sorted(entry["page"] for entry in listed) == PAGES
    assert [entry for entry in listed if not entry["title"]] == []
    lines = run().output.splitlines()
    assert f"{'howto/xbee':{max(map(len, PAGES)) + 2}}" in "\n".join(lines)


@each("name", ["howto/radio", "radio", "radio.md", "howto/radio.md", "docs/howto/radio.md", "Radio", "howto/radio#top"])
def test_a_page_is_shown_as_it_is_written(name: str) -> None:
    done = run(name)
    assert done.exit_code == 0
    assert done.output == (ROOT / "docs" / "howto" / "radio.md").read_text(encoding="utf-8")


@each(
    "name, text",
    [
        ("raido", "no page 'raido'; did you mean radio?"),
        ("qqqqqqq", "no page 'qqqqqqq'; skygcs-cli docs lists all of them"),
        ("federation", "federation is the name of 2 pages: howto/federation, explanation/federation"),
        ("../README", "no page '../README'"),
        ("/etc/passwd", "no page '/etc/passwd'"),
        ("\x1b[2J", "no page '\\x1b[2J'"),
        ("", "no page ''"),
    ],
)
def test_a_name_that_is_none_is_one_line(name: str, text: str) -> None:
    done = run(name)
    assert done.exit_code == 1 and done.stderr.startswith(f"skygcs-cli: {text}"), done.stderr
    assert len(done.stderr.splitlines()) <= 2


def test_a_text_is_found_in_all_pages_with_its_line() -> None:
    found = json.loads(run("--find", "netid", "--json").output)
    assert {entry["page"] for entry in found} >= {"howto/radio", "howto/links-that-fit"}
    for entry in found:
        line = (ROOT / "docs" / f"{entry['page']}.md").read_text(encoding="utf-8").splitlines()[entry["line"] - 1]
        assert "NETID" in line.upper() and entry["text"] == line.strip()
    assert run("--find", "no such words at all").exit_code == 1
    assert run("radio", "--find", "x").exit_code == 2


def test_an_installation_without_pages_says_so(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(docs, "docs_dir", lambda: tmp_path)
    done = run()
    assert done.exit_code == 1 and "has no pages; reinstall skygcs" in done.stderr
