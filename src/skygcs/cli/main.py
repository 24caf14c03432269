"""`skygcs-cli`: everything one does with a running daemon, and offline tools.

Exit codes: 0 done, 1 refused or failed, 2 usage, 3 daemon not reachable. Contract: docs/reference/cli.md.
"""

from __future__ import annotations

import copy
import os
import sys
from typing import Annotated, Any

import typer
from typer.core import TyperGroup
from typer.main import get_command_name
from typer.models import CommandInfo

from skygcs import __version__
from skygcs.cli import (
    control_loops,
    emergency,
    fences,
    gains,
    orders,
    origin,
    plot,
    preflight,
    setpoint,
    signing,
    status,
    table,
    track,
    undo,
)
from skygcs.cli.corrections import corrections
from skygcs.cli.link import link
from skygcs.cli.messages import links, messages
from skygcs.cli.missions import missions
from skygcs.cli.params import params
from skygcs.cli.radio import radios
from skygcs.cli.tlog_commands import tlog
from skygcs.rpc.address import SOCKET_VARIABLE, TOKEN_FILE_VARIABLE

GLOBAL_OPTIONS = ("--socket", "--token-file")
COMPLETION_VARIABLE = "_SKYGCS_CLI_COMPLETE"
"""Set by the shell that asks what may follow."""


class _Anywhere(TyperGroup):
    """Takes the global options wherever they stand: after the command is where people type them."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        return super().parse_args(ctx, hoisted(json_last(args)))


def json_last(args: list[str]) -> list[str]:
    """The same arguments with a --json that stands before the command behind it, where it belongs."""
    skipped = 0
    for i, arg in enumerate(args):
        if skipped:
            skipped -= 1
        elif arg in GLOBAL_OPTIONS:
            skipped = 1
        elif arg == "--json":
            rest = args[i + 1 :]
            end = rest.index("--") if "--" in rest else len(rest)
            return [*args[:i], *rest[:end], "--json", *rest[end:]] if rest else args
        elif not arg.startswith("-"):
            break
    return args


def hoisted(args: list[str]) -> list[str]:
    """The same arguments with the global options and their values first; what follows "--" is left alone."""
    first: list[str] = []
    rest: list[str] = []
    left = iter(args)
    for arg in left:
        if arg == "--":
            rest += [arg, *left]
        elif arg in GLOBAL_OPTIONS:
            first += [arg, *(value for _, value in zip(range(1), left, strict=False))]
        elif arg.startswith(tuple(f"{option}=" for option in GLOBAL_OPTIONS)):
            first.append(arg)
        else:
            rest.append(arg)
    return first + rest


app = typer.Typer(
    name="skygcs-cli",
    cls=_Anywhere,
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
    help="Look at and command the vehicles of a running skygcs daemon.",
    epilog="Exit codes: 0 done, 1 refused or failed (any vehicle), 2 usage, 3 daemon not reachable.",
)


def _version(wanted: bool) -> None:
    if wanted:
        typer.echo(f"skygcs {__version__}")
        raise typer.Exit


@app.callback()
def _root(
    socket: Annotated[
        str | None,
        typer.Option(
            "--socket", metavar="PATH", help="The daemon's socket, or tcp://HOST:PORT.", envvar=SOCKET_VARIABLE
        ),
    ] = None,
    token_file: Annotated[
        str | None,
        typer.Option("--token-file", metavar="FILE", help="The token, for tcp://.", envvar=TOKEN_FILE_VARIABLE),
    ] = None,
    version: Annotated[bool, typer.Option("--version", callback=_version, is_eager=True, help="Print it.")] = False,
) -> None:
    # the options are the variables' spelling for one call: everything below looks at these only
    if socket is not None:
        os.environ[SOCKET_VARIABLE] = socket
    if token_file is not None:
        os.environ[TOKEN_FILE_VARIABLE] = token_file


status.add_to(app)
preflight.add_to(app)
orders.add_to(app)
emergency.add_to(app)
app.add_typer(messages, name="message", rich_help_panel="Looking")
app.add_typer(links, name="links", rich_help_panel="Looking")
app.add_typer(origin.app, name="origin", rich_help_panel="Orders")
app.add_typer(tlog, name="tlog", rich_help_panel="Looking")
app.add_typer(missions, name="mission")
fences.add_to(app)
app.add_typer(radios, name="radio")
app.add_typer(link, name="link")
app.add_typer(corrections, name="corrections")
app.add_typer(params, name="param")
gains.add_to(app)
track.add_to(app)
setpoint.add_to(app)
table.add_to(app)
app.add_typer(control_loops.app, name="control", rich_help_panel="Orders")
app.add_typer(signing.app, name="signing", rich_help_panel="Orders")
app.add_typer(undo.app, name="undo", rich_help_panel="Orders")
plot.add_to(app)


def command_of(args: list[str]) -> str | None:
    """The command that a line names; None if it names none, or asks something of the whole program (--help)."""
    left = iter(hoisted(json_last(args)))
    for arg in left:
        if arg in GLOBAL_OPTIONS:
            next(left, None)
        elif not arg.startswith(tuple(f"{option}=" for option in GLOBAL_OPTIONS)):
            return None if arg.startswith("-") else arg
    return None


def narrowed(whole: typer.Typer, args: list[str]) -> typer.Typer:
    """The same program with no other command than the line names: to make all hundred takes a third of a `status`.

    The whole one where others may be needed: for help, completion, or a name that is none.
    """
    name = command_of(args)
    commands = [c for c in whole.registered_commands if _name_of(c) == name]
    groups = [g for g in whole.registered_groups if g.name == name]
    if name is None or COMPLETION_VARIABLE in os.environ or not (commands or groups):
        return whole
    narrow = copy.copy(whole)
    narrow.registered_commands, narrow.registered_groups = commands, groups
    return narrow


def _name_of(command: CommandInfo) -> str | None:
    return command.name or (get_command_name(command.callback.__name__) if command.callback else None)


def main() -> None:
    """Entry point of `skygcs-cli`."""
    narrowed(app, sys.argv[1:])(prog_name="skygcs-cli")
