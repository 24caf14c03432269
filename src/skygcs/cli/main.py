"""`skygcs-cli`: commands for a running daemon, and offline tools.

Exit codes: 0 done, 1 refused or failed, 2 usage, 3 daemon not reachable. Contract: docs/reference/cli.md.
"""

from __future__ import annotations

import contextlib
import functools
import importlib
import inspect
import os
import re
from collections.abc import Iterator, Mapping
from typing import Annotated, Any

import typer
from typer.core import TyperGroup
from typer.main import get_command_name, get_group
from typer.models import CommandInfo

from skygcs import __version__
from skygcs.cli.connection import Exit, fail, json_is_wanted, want_json
from skygcs.cli.render import say
from skygcs.cli.topics import all_topics, extension_commands, front_page, of_skygcs, topic_page
from skygcs.rpc.address import SOCKET_VARIABLE, TOKEN_FILE_VARIABLE

UsageError: type[Any] = typer.BadParameter.__mro__[1]
"""The class of errors in what was typed; typer exports only this subclass of it."""

EXAMPLE = re.compile(r"^Example: (.+)$", re.MULTILINE)
"""The line of a command's docstring that a person can type."""

HELP_OPTIONS = ["-h", "--help"]

GLOBAL_OPTIONS = ("--socket", "--token-file")

COMMANDS = (
    ("status", ("status", "components", "watch", "events", "info")),
    ("alarms", ("alarms",)),
    ("preflight", ("preflight",)),
    ("calibrate", ("calibrate",)),
    (
        "orders",
        (
            *("arm", "takeoff", "goto", "hold", "mode", "rtl", "land", "disarm", "stop"),
            *("reboot", "sysid", "forget", "home", "interval", "stream", "command"),
        ),
    ),
    ("monitor", ("monitor",)),
    ("control", ("track", "control")),
    ("setpoint", ("setpoint",)),
    ("messages", ("message",)),
    ("gate", ("gate",)),
    ("links", ("links", "link")),
    ("origin", ("origin",)),
    ("missions", ("mission",)),
    ("fences", ("fence", "undo")),
    ("params", ("param",)),
    ("corrections", ("corrections",)),
    ("signing", ("signing",)),
    ("gains", ("gains",)),
    ("onboard_logs", ("log",)),
    ("docs", ("docs",)),
    ("status", ("call", "discover")),
)
"""Modules, and commands that their ``add_to(app)`` adds, in the order of the help. A module is imported when one of its
commands is called: importing all of them takes longer than `status` does."""

_MODULE_OF = {name: f"skygcs.cli.{module}" for module, names in COMMANDS for name in names}


class _Commands(Mapping[str, Any]):
    """Click's table of commands; each is made when it is looked up."""

    def __getitem__(self, name: str) -> Any:
        return _command(name)

    def __iter__(self) -> Iterator[str]:
        return iter((*_MODULE_OF, *extension_commands()))

    def __len__(self) -> int:
        return len(_MODULE_OF) + len(extension_commands())


@functools.cache
def _command(name: str) -> Any:
    """Import the module of this command and make the command, no other one. Raises KeyError."""
    made = typer.Typer(callback=lambda: None)
    importlib.import_module(_MODULE_OF.get(name) or extension_commands()[name][1]).add_to(made)
    made.registered_commands = [c for c in made.registered_commands if command_name(c) == name]
    made.registered_groups = [g for g in made.registered_groups if g.name == name]
    return finished(get_group(made).commands[name])


def finished(command: Any) -> Any:
    """The same command and those below it, with help as it is meant to be read: square brackets as they are written
    (typer reads [federation] as a style of rich, and shows nothing of it), lines that break where the terminal ends
    (typer keeps those of the docstring), no type for an option that is given or not, arguments without braces, and at
    the end of a group the example of its first command, of which it shows only a line."""
    command.help = _escaped(re.sub(r"(?<!\n)\n(?!\n)", " ", inspect.cleandoc(command.help or "")))
    context = command.context_class(command, help_option_names=HELP_OPTIONS)
    for param in (*command.params, command.get_help_option(context)):
        param.help = _escaped(getattr(param, "help", None))
        if getattr(param, "is_flag", False) and param.metavar is None:
            param.metavar = ""
        if param.param_type_name == "argument":
            param.get_usage_pieces = functools.partial(_argument_in_usage, param)
    inner = [finished(one) for one in getattr(command, "commands", {}).values()]
    if inner:
        command.epilog = _example(inner[0])
    return command


def _argument_in_usage(argument: Any, _context: Any) -> list[str]:
    """Its metavar, in brackets if it may be left out; with dots if it may be repeated and its metavar shows no list."""
    name = argument.metavar or argument.name.upper() + ("" if argument.nargs == 1 else "...")
    return [name if argument.required else f"[{name}]"]


def _example(command: Any) -> str:
    """The example of a command's help; empty if it has none."""
    found = EXAMPLE.search(command.epilog or command.help or "")
    return found[0] if found is not None else ""


def _escaped(text: str | None) -> str | None:
    """Return what rich.markup.escape returns; importing rich for it would take longer than the command."""
    return text and re.sub(r"\[(?=[a-z#/@])", r"\\[", text)


def command_name(command: CommandInfo) -> str | None:
    """The name that typer gives to a command."""
    return command.name or (get_command_name(command.callback.__name__) if command.callback else None)


class _RootGroup(TyperGroup):
    """Finds the commands of `COMMANDS`, and accepts the global options before and after the command."""

    def __init__(self, **attributes: Any) -> None:
        super().__init__(**attributes)
        self.commands: Any = _Commands()

    def list_commands(self, ctx: Any) -> list[str]:
        return list(self.commands)

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        args = hoisted(json_last(args))
        want_json(args)
        if args[:1] == ["help"]:
            args = self._help_arguments(args[1:])
        with usage_errors():
            return super().parse_args(ctx, args)

    def invoke(self, ctx: Any) -> Any:
        with usage_errors():
            return super().invoke(ctx)

    def format_help(self, ctx: Any, formatter: Any) -> None:
        formatter.write(front_page(__version__) + "\n")

    def _help_arguments(self, asked: list[str]) -> list[str]:
        """The arguments that `help` stands for; the page of a topic is printed here."""
        if asked and asked[0] not in self.commands and asked[0] in (topics := all_topics()):
            commands = topics[asked[0]][1]
            short = {name: self.commands[name].get_short_help_str(500).replace("\\[", "[") for name in commands}
            say(topic_page(asked[0], short))
            raise typer.Exit
        return [*asked, "--help"]


@contextlib.contextmanager
def usage_errors() -> Iterator[None]:
    """Errors in what was typed are one line as all others, not typer's page in a frame."""
    try:
        yield
    except UsageError as error:
        if type(error).__name__ == "NoArgsIsHelpError":  # typer prints the help by itself
            raise
        # "Invalid value for 'HEIGHT': 'ten' is not a number" begins with the name
        text = re.sub(r"^Invalid value(?: for '?([^':]+)'?)?: ", r"\1: ", error.format_message()).removeprefix(": ")
        for typed, said in (("Value error, ", ""), ("Input should", "should"), (". Did you mean", "; did you mean")):
            text = text.replace(typed, said)
        text = re.sub(r"^(No|Got|Missing) ", lambda word: word[0].lower(), text.rstrip("."))
        if hint := _targets_hint(error, text) or _program_hint(text):
            text += hint
        elif error.ctx is not None and not (json_is_wanted() or "did you mean" in text):
            usage = re.sub(r"\s+", " ", error.ctx.get_usage().removeprefix("Usage: "))
            text += f"; usage: {usage}" if error.ctx.parent is not None else "; skygcs-cli help lists them"
        fail(text)
        raise typer.Exit(Exit.USAGE) from None


def _targets_hint(error: Any, text: str) -> str:
    """A hint for `land d01 d02` and `takeoff d01 d02 10`, where d02 is no argument: several targets are one word. Empty
    for other errors."""
    left = re.match(r"got unexpected extra arguments?(?:\(s\))? \((.+?)\)|\w+: '([a-z]\S*)' is not a number", text)
    targets = (error.ctx.params.get("targets") if error.ctx is not None else None) or ""
    if left is None or targets in ("", "all"):
        return ""
    return f"; several targets are one word: {','.join([targets, *(left[1] or left[2]).split()])}"


def _program_hint(text: str) -> str:
    """A hint for `skygcs-cli run`: a command of the other program. Empty for other errors."""
    unknown = re.match(r"no such command '(.+?)'", text)
    return f"; that is: skygcs {unknown[1]}" if unknown is not None and of_skygcs(unknown[1]) else ""


def json_last(args: list[str]) -> list[str]:
    """Move a --json or --json-lines before the command to the end of the line, where the command reads it."""
    skipped = 0
    for i, arg in enumerate(args):
        if skipped:
            skipped -= 1
        elif arg in GLOBAL_OPTIONS:
            skipped = 1
        elif arg in ("--json", "--json-lines"):
            rest = args[i + 1 :]
            end = rest.index("--") if "--" in rest else len(rest)
            return [*args[:i], *rest[:end], arg, *rest[end:]] if rest else args
        elif not arg.startswith("-"):
            break
    return args


def hoisted(args: list[str]) -> list[str]:
    """Move the global options and their values to the front; everything after "--" stays where it is."""
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
    cls=_RootGroup,
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": HELP_OPTIONS},
    help="Show and command the vehicles of a running skygcs daemon.",
    epilog="Exit codes: 0 done, 1 refused or failed (any vehicle), 2 usage, 3 daemon not reachable.",
)


def _version(wanted: bool) -> None:
    if wanted:
        say(f"skygcs {__version__}")
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
        typer.Option(
            "--token-file", metavar="FILE", help="File with the token for tcp://.", envvar=TOKEN_FILE_VARIABLE
        ),
    ] = None,
    version: Annotated[
        bool, typer.Option("--version", callback=_version, is_eager=True, help="Print the version and exit.")
    ] = False,
) -> None:
    # commands read the environment variables only: an option sets the variable for this process
    if socket is not None:
        os.environ[SOCKET_VARIABLE] = socket
    if token_file is not None:
        os.environ[TOKEN_FILE_VARIABLE] = token_file


def main() -> None:
    """Entry point of `skygcs-cli`."""
    app(prog_name="skygcs-cli")
