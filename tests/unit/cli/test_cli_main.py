"""A command line imports and makes its own command, no other; help and completion know all of them."""

from __future__ import annotations

import importlib
import subprocess
import sys

import pytest
import typer
import typer.main
from typer.testing import CliRunner

from skygcs.cli.main import COMMANDS, app, command_name

NAMES = [name for _, names in COMMANDS for name in names]
MODULES = {module: [n for m, names in COMMANDS for n in names if m == module] for module, _ in COMMANDS}


@pytest.mark.parametrize("module", MODULES)
def test_each_module_adds_the_commands_listed_for_it(module: str) -> None:
    made = typer.Typer()
    importlib.import_module(f"skygcs.cli.{module}").add_to(made)
    added = [command_name(c) for c in made.registered_commands] + [g.name for g in made.registered_groups]
    assert sorted(map(str, added)) == sorted(MODULES[module])


@pytest.mark.parametrize("name", NAMES)
def test_each_command_has_help_and_belongs_to_a_panel(name: str) -> None:
    command = typer.main.get_group(app).commands[name]
    assert command.name == name and command.help
    assert getattr(command, "rich_help_panel", None) in ("Show", "Orders", "Set up", "Programming")
    result = CliRunner().invoke(app, [name, "--help"])
    assert result.exit_code == 0 and "Usage: skygcs-cli " + name in result.output


def test_help_lists_all_and_a_wrong_name_gets_a_proposal() -> None:
    text = CliRunner().invoke(app, ["--help"], env={"COLUMNS": "200"}).output
    assert [name for name in NAMES if f" {name} " not in text] == []
    wrong = CliRunner().invoke(app, ["stat"])
    assert wrong.exit_code == 2 and "Did you mean" in wrong.output and "'status'" in wrong.output


def test_help_shows_square_brackets_as_they_are_written() -> None:
    def text(*line: str) -> str:
        return " ".join(CliRunner().invoke(app, [*line, "--help"], env={"COLUMNS": "200"}).output.split())

    assert "with [federation] those of all sites" in text() and "with [federation] those" in text("status")
    assert "[default: unchanged]" in text("origin", "set")


HEAVY = ("numpy", "matplotlib", "pydantic", "serial", "pymavlink", "pyarrow", "uvloop", "skygcs.config.models")


@pytest.mark.system
@pytest.mark.parametrize(
    ("line", "module"), [("param cancel --help", "params"), ("--socket /x arm --help", "orders"), ("links -h", "links")]
)
def test_a_line_imports_the_module_of_its_command_only(line: str, module: str) -> None:
    code = (
        "import sys; from skygcs.cli.main import COMMANDS, app\n"
        "app(sys.argv[1:], standalone_mode=False)\n"
        "print([m for m, _ in COMMANDS if f'skygcs.cli.{m}' in sys.modules], file=sys.stderr)\n"
    )
    done = subprocess.run([sys.executable, "-c", code, *line.split()], capture_output=True, text=True, timeout=120)
    assert done.stderr.splitlines()[-1] == f"['{module}']"


@pytest.mark.system
def test_the_help_of_all_commands_imports_nothing_heavy() -> None:
    code = (
        "import sys; from skygcs.cli.main import app\n"
        "app(['--help'], standalone_mode=False)\n"
        "print([m for m in sys.argv[1:] if m in sys.modules], file=sys.stderr)\n"
    )
    done = subprocess.run([sys.executable, "-c", code, *HEAVY], capture_output=True, text=True, timeout=120)
    assert done.stderr.splitlines()[-1] == "[]"
