"""How a command of `skygcs-cli` reaches the daemon, tells errors and exits: the same for all of them."""

from __future__ import annotations

import asyncio
import contextlib
import itertools
import os
import sys
from collections.abc import AsyncIterator, Awaitable, Callable
from enum import IntEnum
from pathlib import Path
from typing import NoReturn

import typer

from skygcs.cli.render import screen_width, wrapped
from skygcs.errors import DaemonUnreachable, RpcError, SkygcsError
from skygcs.rpc.address import TOKEN_FILE_VARIABLE, client_address, tcp_address
from skygcs.rpc.client import Client, connect

USAGE_ERRORS = (-32601, -32602)
"""JSON-RPC's codes (no such method, wrong parameters) for what is a usage error on this side."""

NOT_AUTHENTICATED = -32004
COMMANDS = {
    "messages.list": "skygcs-cli message list",
    "commands.list": "skygcs-cli call commands.list",
    "rpc.discover": "skygcs-cli discover",
}

SPINNER_DELAY_S = 0.3
"""A quick answer needs no spinner."""

SPINNER_PERIOD_S = 0.1
SPINNER = "⠋⠙⠹⠸⠼⠴⠦⠧⠇⠏"
DEBUG_VARIABLE = "SKYGCS_DEBUG"


class Exit(IntEnum):
    """Exit codes of `skygcs-cli`."""

    DONE = 0
    FAILED = 1
    USAGE = 2
    UNREACHABLE = 3
    INTERRUPTED = 130


def run(command: Callable[[Client], Awaitable[int | None]]) -> NoReturn:
    """Connect, run ``command``, exit with what it returns (None: done). Errors become one line and an exit code."""

    async def connected() -> int:
        async with client() as gcs:
            return await command(gcs) or Exit.DONE

    run_offline(lambda: asyncio.run(connected()))


def run_offline(command: Callable[[], int | None]) -> NoReturn:
    """The same for a command that needs no daemon."""
    raise typer.Exit(_guarded(command))


def fail(text: str) -> None:
    """One line for a person, on stderr; on a terminal wrapped between words."""
    typer.echo(wrapped(f"skygcs-cli: {text}", screen_width(sys.stderr), indent=2), err=True)


def client(socket: str | None = None) -> Client:
    """The daemon that --socket, $SKYGCS_SOCKET or the default names. Raises SkygcsError without a readable token,
    BadParameter for an address that is none."""
    try:
        tcp_address(client_address(socket))
    except ValueError as error:
        raise typer.BadParameter(f"--socket: {error}") from None
    token_file = os.environ.get(TOKEN_FILE_VARIABLE)
    token = None
    if token_file:
        try:
            token = Path(token_file).read_text(encoding="utf-8").strip()
        except (OSError, UnicodeError) as error:
            raise SkygcsError(f"cannot read the token file {token_file}: {error}") from None
    return connect(socket, token=token)


def _in_commands(text: str) -> str:
    """What an error text of the RPC advises, as a command."""
    for method, command in COMMANDS.items():
        text = text.replace(f"{method} lists", f"{command} lists")
    return text


def _token_advice() -> str:
    token_file = os.environ.get(TOKEN_FILE_VARIABLE)
    if token_file:
        return f"the token in {token_file} is wrong: it is not the one of this daemon"
    return "the daemon wants a token: --token-file FILE"


@contextlib.asynccontextmanager
async def waiting(text: str) -> AsyncIterator[None]:
    """A spinner with the elapsed time while the body runs; on a terminal only."""
    if not sys.stderr.isatty():
        yield
        return
    spinner = asyncio.create_task(_spin(text), name="spinner")
    try:
        yield
    finally:
        spinner.cancel()
        await asyncio.wait([spinner])


async def _spin(text: str) -> None:
    loop = asyncio.get_running_loop()
    began = loop.time()
    await asyncio.sleep(SPINNER_DELAY_S)
    try:
        for glyph in itertools.cycle(SPINNER):
            sys.stderr.write(f"\r{glyph} {text} {loop.time() - began:.0f} s")
            sys.stderr.flush()
            await asyncio.sleep(SPINNER_PERIOD_S)
    finally:
        sys.stderr.write("\r\033[K")
        sys.stderr.flush()


def _guarded(command: Callable[[], int | None]) -> int:
    try:
        code = command() or Exit.DONE
        sys.stdout.flush()
        return int(code)
    except KeyboardInterrupt:
        return Exit.INTERRUPTED
    except BrokenPipeError:  # `skygcs-cli … | head`: the reader has what it wanted
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return Exit.DONE
    except DaemonUnreachable as error:
        fail(str(error))
        return Exit.UNREACHABLE
    except RpcError as error:
        fail(_token_advice() if error.code == NOT_AUTHENTICATED else _in_commands(str(error)))
        return Exit.USAGE if error.code in USAGE_ERRORS else Exit.FAILED
    except (SkygcsError, OSError) as error:
        fail(str(error))
        return Exit.FAILED
    except (typer.Exit, typer.BadParameter):
        raise
    except Exception as error:
        if os.environ.get(DEBUG_VARIABLE):
            raise
        fail(f"internal error: {type(error).__name__}: {error} (set {DEBUG_VARIABLE}=1 to see where)")
        return Exit.FAILED
