"""`skygcs-cli gate`: what of our own may be sent to which vehicle, as a table; needs no daemon."""

from __future__ import annotations

from typing import Annotated

import typer

from skygcs.cli.connection import run_offline
from skygcs.cli.options import Json
from skygcs.cli.render import print_json, print_lines
from skygcs.config.dialects import load_dialect
from skygcs.core.vehicle.gate_table import Cell, Passing, cells, commands_passing, messages_passing, params_passing


def gate(
    dialect: Annotated[str, typer.Option(help="Whose messages and commands are counted.")] = "ardupilotmega",
    json_output: Json = False,
) -> None:
    """Print what the outgoing gate lets pass: by firmware, class and order what is sent, or why it is refused.

    Example: skygcs-cli gate --dialect lab.xml
    """
    run_offline(lambda: _show(dialect, json_output))


def _show(dialect: str, json_output: bool) -> None:
    loaded = load_dialect(dialect)
    table, messages, commands = list(cells(loaded)), messages_passing(loaded), commands_passing(loaded)
    if json_output:
        print_json(
            {
                "orders": [cell.as_dict() for cell in table],
                "messages": messages.as_dict(),
                "commands": commands.as_dict(),
                "params": dict(params_passing()),
            }
        )
        return
    print_lines(_lines(table, messages, commands))


def _lines(table: list[Cell], messages: Passing, commands: Passing) -> list[str]:
    lines: list[str] = []
    row = ""
    for cell in table:
        title = f"{cell.firmware} {cell.kind}" + (f", {cell.state}" if cell.state else "")
        if title != row:
            lines += ["", title] if row else [title]
            row = title
        lines.append(f"  {cell.order:<16}{', '.join(cell.sends) or cell.refused}")
    lines.append("")
    for what, passing in (("messages", messages), ("commands", commands)):
        counts = ", ".join(f"{count} {level.value}" for level, count in passing.levels.items())
        lines.append(f"raw {what}: {passing.all}, of which {counts}")
    return lines


def add_to(app: typer.Typer) -> None:
    """Add the command."""
    app.command()(gate)
