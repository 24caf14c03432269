"""How a command of `skygcs-cli` reaches the daemon, prints the answer, reports errors and exits.

All commands use `run` or what is built on it: `run_order` for orders to vehicles, `run_show` for what is only shown.
"""

from __future__ import annotations

import asyncio
import contextlib
import itertools
import os
import re
import sys
import threading
from collections.abc import AsyncIterator, Awaitable, Callable, Iterable, Mapping
from enum import IntEnum
from typing import Any, NoReturn

import typer

from skygcs.cli.render import outcome_lines, print_json, print_lines, screen_width, wrapped
from skygcs.config.station_path import station_socket
from skygcs.errors import DaemonUnreachable, RpcError, SkygcsError
from skygcs.rpc.address import TOKEN_FILE_VARIABLE, client_address, client_token, tcp_address
from skygcs.rpc.client import Client, connect
from skygcs.rpc.error_codes import INVALID_PARAMS, METHOD_NOT_FOUND, NOT_AUTHENTICATED

ALL_SITES = "all sites"
EVERY_SITE = "*/all"
_OTHER_SITE = re.compile(r"(?:\*|[a-z][a-z0-9-]{0,15})/.+")
_COMPONENT = re.compile(r".*/\d{1,3}")

USAGE_ERRORS = (METHOD_NOT_FOUND, INVALID_PARAMS)
"""JSON-RPC codes of usage errors: unknown method, wrong parameters."""

COMMANDS = {
    "messages.list": "skygcs-cli message list",
    "commands.list": "skygcs-cli call commands.list",
    "rpc.discover": "skygcs-cli discover",
}
"""The command for each RPC method that an error text of the daemon recommends."""

SPINNER_DELAY_S = 0.3
"""A quick answer needs no spinner."""

SPINNER_PERIOD_S = 0.1
SPINNER = "⠋⠙⠹⠸⠼⠴⠦⠧⠇⠏"
DEBUG_VARIABLE = "SKYGCS_DEBUG"
READ_BYTES = 65536


class Exit(IntEnum):
    """Exit codes of `skygcs-cli`."""

    DONE = 0
    FAILED = 1
    USAGE = 2
    UNREACHABLE = 3
    INTERRUPTED = 130


def run(command: Callable[[Client], Awaitable[int | None]], *, station: bool = False) -> NoReturn:
    """Connect, run ``command``, exit with the code it returns (None: 0). Errors become one line and an exit code.
    ``station``: connect to the station socket."""

    async def connected() -> int:
        async with client(station=station) as gcs:
            return await command(gcs) or Exit.DONE

    run_offline(lambda: asyncio.run(connected()))


def run_on_sites(targets: str, command: Callable[[Client, str], Awaitable[int | None]]) -> NoReturn:
    """`run` for what shows vehicles: ``command`` gets the targets to show. "all" means every site where a bridge runs;
    one that does not answer is named, and own vehicles are shown."""

    address = client_address()
    named = names_other_sites(targets)
    there = address == station_socket(address) or os.path.exists(station_socket(address))

    async def connected() -> int:
        async with contextlib.AsyncExitStack() as stack:
            if named:
                return await command(await stack.enter_async_context(client(station=True)), targets) or Exit.DONE
            if targets == "all" and there:
                try:
                    station = await stack.enter_async_context(client(station=True))
                except DaemonUnreachable as error:
                    fail(f"other sites are not shown: {error.address}: {error.reason}")
                else:
                    return await command(station, EVERY_SITE) or Exit.DONE
            return await command(await stack.enter_async_context(client()), targets) or Exit.DONE

    run_offline(lambda: asyncio.run(connected()))


def run_offline(command: Callable[[], int | None]) -> NoReturn:
    """`run` for a command that needs no daemon."""
    raise typer.Exit(_guarded(command))


def run_order(method: str, json_output: bool, **params: Any) -> NoReturn:
    """Call a method that orders vehicles to do something, print their outcomes, exit 0 if all succeeded."""

    async def command(gcs: Client) -> int:
        async with waiting(f"{method} {params.get('targets', '')}".rstrip()):
            answer = await gcs.call(method, **params)
        return print_outcomes(answer["outcomes"], json_output)

    run(command, station=names_other_sites(params.get("targets")))


def run_show(method: str, json_output: bool, lines: Callable[[Any], Iterable[str]], **params: Any) -> NoReturn:
    """Call a method and print its answer, as JSON or as ``lines(answer)``."""

    async def command(gcs: Client) -> None:
        show(await gcs.call(method, **params), json_output, lines)

    run(command)


def show(answer: Any, json_output: bool, lines: Callable[[Any], Iterable[str]]) -> None:
    """Print ``answer`` as JSON or as ``lines(answer)``."""
    if json_output:
        print_json(answer)
    else:
        print_lines(lines(answer))


def print_outcomes(outcomes: Mapping[str, Mapping[str, Any]], json_output: bool) -> Exit:
    """Print the outcome of an order for each vehicle; returns the exit code."""
    show({"outcomes": outcomes}, json_output, lambda _: outcome_lines(outcomes, screen_width(sys.stdout)))
    return exit_code(outcomes)


def exit_code(outcomes: Mapping[str, Mapping[str, Any]]) -> Exit:
    return Exit.DONE if all(outcome["ok"] for outcome in outcomes.values()) else Exit.FAILED


def fail(text: str) -> None:
    """Print one line on stderr; on a terminal it is wrapped between words."""
    typer.echo(wrapped(f"skygcs-cli: {text}", screen_width(sys.stderr), indent=2), err=True)


def client(socket: str | None = None, *, station: bool = False) -> Client:
    """The daemon at ``socket``, else $SKYGCS_SOCKET (set by --socket), else at the default socket. ``station``: the
    station socket beside it.

    Raises SkygcsError if the token file cannot be read, or there is no station socket; BadParameter if the address is
    not valid.
    """
    try:
        tcp = tcp_address(client_address(socket))
    except ValueError as error:
        raise typer.BadParameter(f"--socket: {error}") from None
    if station and tcp is None:
        socket = station_socket(client_address(socket))
        if not os.path.exists(socket):
            raise DaemonUnreachable(socket, "other sites are reached through a fleet file with [federation]")
    return connect(socket, token=client_token())


def names_other_sites(targets: object) -> bool:
    """True if a target is a vehicle of another site: south/alpha, south/all, */all. alpha/191 is one at a station that
    has a socket, which knows whether alpha is a site, and else a component."""
    parts = [part.strip() for part in str(targets).split(",")]
    named = [part for part in parts if part == ALL_SITES or _OTHER_SITE.fullmatch(part) is not None]
    if all(_COMPONENT.fullmatch(part) is not None for part in named):
        return bool(named) and os.path.exists(station_socket(client_address()))
    return True


def _in_commands(text: str) -> str:
    """Replace the RPC methods that an error text recommends by commands."""
    for method, command in COMMANDS.items():
        text = text.replace(f"{method} lists", f"{command} lists")
    return text


def _token_advice() -> str:
    token_file = os.environ.get(TOKEN_FILE_VARIABLE)
    if token_file:
        return f"the token in {token_file} is wrong: it is not the one of this daemon"
    return "the daemon requires a token: --token-file FILE"


@contextlib.asynccontextmanager
async def waiting(text: str) -> AsyncIterator[None]:
    """Show a spinner with the elapsed time while the body runs; on a terminal only."""
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
    """Run ``command`` and turn every error into one line and an exit code."""
    try:
        code = command() or Exit.DONE
        sys.stdout.flush()
        return int(code)
    except KeyboardInterrupt:
        return Exit.INTERRUPTED
    except BrokenPipeError:  # `skygcs-cli … | head`: the reader has read enough
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


async def bytes_of(descriptor: int) -> AsyncIterator[bytes]:
    """What arrives at a pipe, a terminal or a file.

    A thread reads it and ends with the process: an event loop cannot watch a file, and a read that waits for a silent
    program cannot be cancelled.
    """
    loop = asyncio.get_running_loop()
    taken = threading.Semaphore(1)
    queue: asyncio.Queue[bytes | OSError] = asyncio.Queue()

    def read() -> None:
        data: bytes | OSError = b"-"
        while data and not isinstance(data, OSError):
            taken.acquire()
            try:
                data = os.read(descriptor, READ_BYTES)
            except OSError as error:
                data = error
            try:
                loop.call_soon_threadsafe(queue.put_nowait, data)
            except RuntimeError:  # the loop is closed: the data is no longer needed
                return

    threading.Thread(target=read, name="stdin", daemon=True).start()
    while data := await queue.get():
        if isinstance(data, OSError):
            raise data
        yield data
        taken.release()
