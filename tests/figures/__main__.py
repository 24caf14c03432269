"""Figures of the house: size, rooms, equal lines, imports of a plain daemon, the way of an order. `make figures`.

Prints a table and writes build/figures/: figures.json, openrpc.json, and help.txt with the help of every command, so
that two versions can be compared with diff.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
from collections.abc import Iterator
from typing import Any

from typer.main import get_command
from typer.testing import CliRunner

from figures.measures import ROOT, code_lines, equal_runs, page_lines, reached_from
from skygcs.cli.main import app
from skygcs.cli.serve import new_parser
from skygcs.rpc.dispatch import document
from support.extension_parts import ALL_METHODS

OUT = ROOT / "build" / "figures"


def shell_help(*command: str) -> Iterator[str]:
    """The help of a command of skygcs-cli and of all commands below it."""
    done = CliRunner().invoke(app, [*command, "--help"])
    yield f"$ skygcs-cli {' '.join((*command, '--help'))}\n{done.stdout}"
    group = get_command(app)
    for name in command:
        group = group.commands[name]  # type: ignore[attr-defined]
    for name in getattr(group, "commands", ()):
        yield from shell_help(*command, name)


def server_help(parser: argparse.ArgumentParser) -> Iterator[str]:
    """The help of `skygcs`, or of one of its commands, and of all commands below it."""
    yield f"$ {parser.prog} --help\n{parser.format_help()}"
    for action in parser._actions:
        if isinstance(action, argparse._SubParsersAction):
            for inner in action.choices.values():
                yield from server_help(inner)


def daemon_figures() -> dict[str, Any]:
    """What `plain_daemon` prints."""
    line = [sys.executable, "-m", "figures.plain_daemon"]
    found: dict[str, Any] = json.loads(subprocess.run(line, capture_output=True, text=True, check=True).stdout)
    return found


def main() -> None:
    """Measure, print and write."""
    OUT.mkdir(parents=True, exist_ok=True)
    os.environ |= {"COLUMNS": "120", "TERM": "dumb", "NO_COLOR": "1"}
    (OUT / "openrpc.json").write_text(json.dumps(document(tuple(ALL_METHODS.values())), indent=1) + "\n")
    texts = [*server_help(new_parser()), *shell_help()]
    (OUT / "help.txt").write_text("\n".join(texts))
    rooms, runs, daemon = code_lines(), equal_runs(), daemon_figures()
    figures = {
        "code_lines": sum(lines for lines, _ in rooms.values()),
        "files": sum(files for _, files in rooms.values()),
        "core_lines": sum(lines for room, (lines, _) in rooms.items() if not room.startswith("ext")),
        "core_files": sum(files for room, (_, files) in rooms.items() if not room.startswith("ext")),
        "page_lines": page_lines(),
        "equal_runs": len(runs),
        "daemon_imports_at_start": len(reached_from("skygcs.daemon", in_functions=False)),
        "daemon_imports_with_functions": len(reached_from("skygcs.daemon", in_functions=True)),
        "plain_daemon_files": len(daemon["files"]),
        "plain_daemon_files_after_order": len(daemon["files_after_order"]),
        "order_calls": len(daemon["calls"]),
        "order_files": len(daemon["call_files"]),
        "methods": len(ALL_METHODS),
        "help_texts": len(texts),
    }
    everything = {"figures": figures, "rooms": rooms, "equal_runs": runs, "daemon": daemon}
    (OUT / "figures.json").write_text(json.dumps(everything, indent=1) + "\n")
    for name, value in figures.items():
        print(f"{name.replace('_', ' '):36}{value:>8}")
    print()
    for room, (lines, files) in sorted(rooms.items()):
        print(f"{room:36}{lines:>8} lines{files:>6} files")


if __name__ == "__main__":
    main()
