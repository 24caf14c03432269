"""A command line imports and makes its own command, no other; help and completion know all of them."""

from __future__ import annotations

import argparse
import asyncio
import gc
import importlib
import json
import os
import re
import signal
import socket
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import typer
import typer.main
from typer.testing import CliRunner

from skygcs.cli.main import COMMANDS, app, command_name
from skygcs.cli.process import run_loop, serve_until_signal
from skygcs.cli.serve import main as serve
from skygcs.cli.serve import new_parser
from skygcs.cli.topics import OF_SKYGCS, TOPICS, all_topics, extension_commands
from skygcs.errors import LinkError
from support.daemons import made_daemon
from support.table import each

NAMES = [*(name for _, names in COMMANDS for name in names), *extension_commands()]
MODULES = {f"skygcs.cli.{module}": [n for m, names in COMMANDS for n in names if m == module] for module, _ in COMMANDS}
for name, (_, module) in extension_commands().items():
    MODULES.setdefault(module, []).append(name)


@each("module", MODULES)
def test_each_module_adds_the_commands_listed_for_it(module: str) -> None:
    made = typer.Typer()
    importlib.import_module(module).add_to(made)
    added = [command_name(c) for c in made.registered_commands] + [g.name for g in made.registered_groups]
    assert sorted(map(str, added)) == sorted(MODULES[module])


def test_each_command_has_help_and_one_topic() -> None:
    in_topics = [name for _, commands in all_topics().values() for name in commands]
    assert sorted(in_topics) == sorted(NAMES)
    commands = typer.main.get_group(app).commands
    assert [name for name in NAMES if commands[name].name != name or not commands[name].help] == []


def test_help_fits_on_one_screen_and_lists_all() -> None:
    lines = CliRunner().invoke(app, ["--help"]).output.splitlines()
    assert len(lines) <= 24 and max(map(len, lines)) <= 80
    words = set(" ".join(lines).split())
    assert [name for name in NAMES if name not in words] == []


def test_help_shows_a_topic_a_command_or_all() -> None:
    def shown(*line: str) -> str:
        return CliRunner().invoke(app, list(line), prog_name="skygcs-cli").output

    assert shown("help") == shown("--help") == shown("-h")
    for topic, (_, commands) in all_topics().items():
        page = shown("help", topic).splitlines()
        assert [c for c in commands if not any(line.startswith(f"  {c} ") for line in page)] == []
    assert shown("help", "takeoff") == shown("takeoff", "--help")
    assert set(TOPICS).isdisjoint(NAMES)


def commands_of(command: Any, *path: str) -> Iterator[tuple[tuple[str, ...], Any]]:
    """A command and all below it, each with the words that name it."""
    yield path, command
    for name, inner in getattr(command, "commands", {}).items():
        yield from commands_of(inner, *path, name)


def test_a_help_page_breaks_its_lines_at_the_terminal_and_marks_an_argument_once() -> None:
    every = list(commands_of(typer.main.get_group(app)))
    assert len(every) > 150
    broken = [path for path, c in every if any("\n" in part for part in (c.help or "").split("\n\n"))]
    assert broken == []
    marked = [
        (path, p.metavar) for path, c in every for p in c.params if re.fullmatch(r"\[[^]]*\]|\[.*\]\]", p.metavar or "")
    ]
    assert marked == []
    endless = [path for path, c in every for p in c.params if p.default == sys.maxsize and p.show_default]
    assert endless == []


def test_every_option_of_skygcs_says_what_it_does() -> None:
    def silent(parser: argparse.ArgumentParser) -> Iterator[tuple[str, str]]:
        for action in parser._actions:
            if isinstance(action, argparse._SubParsersAction):
                for inner in action.choices.values():
                    yield from silent(inner)
            elif action.option_strings and not action.help:
                yield parser.prog, action.option_strings[-1]

    assert list(silent(new_parser())) == []


@each(
    "line, text",
    [
        ("stop all kil", "'kil' is not one of 'hold', 'land', 'kill'"),
        ("link plan 300", "should be less than or equal to 254"),
        ("takeoff all ten", "cli: HEIGHT: 'ten' is not a number; usage: skygcs-cli takeoff [OPTIONS] TARGETS [HEIGHT]"),
        ("takeoff a b 10", "cli: HEIGHT: 'b' is not a number; several targets are one word: a,b"),
        ("arm", "cli: missing argument 'TARGETS'; usage: skygcs-cli arm [OPTIONS] TARGETS"),
        ("stat", "cli: no such command 'stat'; did you mean 'status'"),
        ("frobnicate", "cli: no such command 'frobnicate'; skygcs-cli help lists them"),
        ("radio restore /dev/ttyUSB0 none.toml", "skygcs-cli: none.toml: No such file or directory"),
    ],
)
def test_a_value_that_is_none_is_named_without_words_of_the_parser(line: str, text: str) -> None:
    shown = " ".join(CliRunner().invoke(app, line.split(), env={"COLUMNS": "200"}).output.split())
    assert text in shown and not any(word in shown for word in ("Value error", "Input", "Errno", "╭"))


def test_the_two_programs_point_to_each_other(capsys: pytest.CaptureFixture[str]) -> None:
    here = CliRunner().invoke(app, ["run", "fleet.toml"])
    assert here.exit_code == 2 and "that is: skygcs run" in here.output
    for typed, said in (
        ("status", "skygcs-cli status"),
        ("rnu", "did you mean 'run'?"),
        ("frobnicate", "skygcs --help"),
    ):
        with pytest.raises(SystemExit) as ended:
            serve([typed])
        assert ended.value.code == 2 and said in capsys.readouterr().err
    with pytest.raises(SystemExit):
        serve(["--help"])
    offered = re.search(r"\{(.+?)\}|commands:(.+)", capsys.readouterr().out, re.DOTALL)
    assert offered is not None
    assert [name for name in OF_SKYGCS if name not in offered[0]] == []


def test_several_targets_with_blanks_get_a_proposal() -> None:
    error = CliRunner().invoke(app, ["land", "d01", "d02", "d03", "--json"])
    assert error.exit_code == 2 and "several targets are one word: d01,d02,d03" in json.loads(error.stderr)["error"]


@each("line", ["land x", "land d01 d02", "goto a b", "nonsense", "param set 1"])
def test_errors_are_json_where_json_is_asked_for(line: str, tmp_path: Path) -> None:
    result = CliRunner().invoke(app, ["--socket", str(tmp_path / "no"), *line.split(), "--json"])
    assert result.exit_code in (2, 3) and result.stdout == ""
    assert list(json.loads(result.stderr)) == ["error"]


def test_help_shows_square_brackets_as_they_are_written() -> None:
    def text(*line: str) -> str:
        return " ".join(CliRunner().invoke(app, [*line, "--help"], env={"COLUMNS": "200"}).output.split())

    assert "with [federation] those of all sites" in text("status")
    assert "[default: unchanged]" in text("origin", "set")
    look = CliRunner().invoke(app, ["help", "look"]).output
    assert "with [federation]" in " ".join(look.split()) and "\\" not in look


HEAVY = ("numpy", "matplotlib", "pydantic", "serial", "pymavlink", "pyarrow", "uvloop", "skygcs.config.models")


@pytest.mark.system
@each(
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


def test_an_output_that_takes_nothing_is_one_line_and_a_failure() -> None:
    with open("/dev/full", "w") as full:
        line = [sys.executable, "-m", "skygcs", "completion", "bash"]
        done = subprocess.run(line, stdout=full, stderr=subprocess.PIPE, text=True, timeout=120)
    assert (done.returncode, done.stderr) == (1, "skygcs: [Errno 28] No space left on device\n")


# -- What a service manager and a shell see of a skygcs process.


@each(
    ("error", "raised"),
    [(LinkError("the port is taken"), LinkError), (ZeroDivisionError(), BaseExceptionGroup)],
)
def test_an_error_of_ours_comes_out_of_a_task_group_as_itself_and_a_bug_does_not(
    error: Exception, raised: type[BaseException]
) -> None:
    async def fails() -> int:
        async with asyncio.TaskGroup() as group:
            group.create_task(_raise(error))
        return 0

    with pytest.raises(raised, match="the port is taken" if isinstance(error, LinkError) else None):
        run_loop(fails())


async def _raise(error: Exception) -> None:
    raise error


async def test_the_service_manager_hears_when_it_is_up_fed_and_stopping(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    manager = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
    manager.bind(str(tmp_path / "notify"))
    manager.setblocking(False)
    monkeypatch.setenv("NOTIFY_SOCKET", str(tmp_path / "notify"))
    monkeypatch.setenv("WATCHDOG_USEC", "40000")
    daemon = made_daemon(tmp_path)
    serving = asyncio.create_task(serve_until_signal(daemon, endings=[signal.SIGHUP]))
    loop = asyncio.get_running_loop()
    said: list[bytes] = []
    while b"READY=1" not in said or said.count(b"WATCHDOG=1") < 3:
        said.append(await asyncio.wait_for(loop.sock_recv(manager, 64), 10))
    os.kill(os.getpid(), signal.SIGHUP)
    await serving
    while said[-1] != b"STOPPING=1":
        said.append(await asyncio.wait_for(loop.sock_recv(manager, 64), 10))
    manager.close()


async def test_what_is_there_when_it_is_up_is_not_looked_at_by_the_collector_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    frozen: list[bool] = []
    daemon = made_daemon(tmp_path)
    monkeypatch.setattr(gc, "freeze", lambda: frozen.append(daemon.ready.is_set()))
    await serve_until_signal(daemon, on_ready=daemon.stop)
    assert frozen == [True]
