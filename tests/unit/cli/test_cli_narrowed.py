"""Only the command of the line is made, and no line fares otherwise for it."""

from __future__ import annotations

import pytest
import typer.main

from skygcs.cli.main import COMPLETION_VARIABLE, _name_of, app, command_of, narrowed

NAMES = [_name_of(c) or "" for c in app.registered_commands] + [str(g.name) for g in app.registered_groups]


@pytest.mark.parametrize("name", NAMES)
def test_a_line_gets_its_command_and_no_other(name: str) -> None:
    made = typer.main.get_group(narrowed(app, ["--socket", "/s", name, "--json", "x"]))
    assert list(made.commands) == [name]
    assert [p.name for p in made.params] == [p.name for p in typer.main.get_group(app).params]


@pytest.mark.parametrize("line", [[], ["--help"], ["-h", "status"], ["stat"], ["--socket"], ["--version"], ["--", "x"]])
def test_help_and_unknown_names_get_all(line: list[str]) -> None:
    assert narrowed(app, line) is app


def test_completion_gets_all(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(COMPLETION_VARIABLE, "complete_bash")
    assert narrowed(app, ["status"]) is app


@pytest.mark.parametrize(
    ("line", "name"),
    [
        (["--socket", "status", "arm"], "arm"),
        (["--socket=/s", "arm", "--help"], "arm"),
        (["--json", "status"], "status"),
        (["arm", "--socket", "/s"], "arm"),
        (["--token-file"], None),
        (["--nonsense", "arm"], None),
    ],
)
def test_the_command_of_a_line(line: list[str], name: str | None) -> None:
    assert command_of(line) == name
