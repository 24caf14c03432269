"""How a command of `skygcs-cli` reaches the daemon, prints the answer, reports errors and exits.

All commands use `run` or what is built on it: `run_order` for orders to vehicles, `run_show` for what is only shown.
"""

from __future__ import annotations

import asyncio
import contextlib
import contextvars
import itertools
import json
import os
import re
import sys
import threading
from collections.abc import AsyncIterator, Awaitable, Callable, Iterable, Mapping, Sequence
from enum import IntEnum
from typing import Any, NoReturn

import typer

from skygcs.cli.interruption import Unanswered, explain
from skygcs.cli.order_output import JsonForm, OrderOutput
from skygcs.cli.render import PIPE_WIDTH, cut, outcome_lines, print_json, print_lines, say, screen_width, wrapped
from skygcs.config.station_path import station_socket
from skygcs.errors import DaemonUnreachable, RpcError, SkygcsError
from skygcs.rpc.address import TOKEN_FILE_VARIABLE, client_address, client_token, tcp_address
from skygcs.rpc.client import Client, connect
from skygcs.rpc.error_codes import INVALID_PARAMS, METHOD_NOT_FOUND, NOT_AUTHENTICATED
from skygcs.terminal_text import visible

ALL_SITES = "all sites"
EVERY_SITE = "*/all"
_OTHER_SITE = re.compile(r"(?:\*|[a-z][a-z0-9-]{0,15})/.+")
_RANGE = re.compile(r"\d-\d")
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


_UNIT = re.compile(r"_(m|deg|s|mps|mps2|hz|rad|amsl_m|rel_m)$")

_JSON_IS_WANTED: contextvars.ContextVar[bool] = contextvars.ContextVar("json", default=False)


class Exit(IntEnum):
    """Exit codes of `skygcs-cli`."""

    DONE = 0
    FAILED = 1
    USAGE = 2
    UNREACHABLE = 3
    INTERRUPTED = 130


def run(command: Callable[[Client], Awaitable[int | None]], *, station: bool = False) -> NoReturn:
    """Connect, run ``command``, exit with the code it returns (None: 0). Errors become one line and an exit code; after
    Ctrl-C it is said what goes on of the orders that were sent. ``station``: connect to the station socket."""

    async def connected() -> int:
        pending: list[Unanswered] = []
        gcs = client(station=station)
        try:
            async with gcs:
                try:
                    return await command(gcs) or Exit.DONE
                except asyncio.CancelledError:
                    pending = [Unanswered(*request) for request in gcs.unanswered()]
                    raise
        except asyncio.CancelledError:
            await explain(pending, client(station=station))
            raise

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


def run_order(method: str, form: JsonForm, **params: Any) -> NoReturn:
    """Call a method that orders vehicles to do something, print each outcome as it comes, exit 0 if all succeeded."""

    async def command(gcs: Client) -> int:
        return exit_code(await give_order(gcs, method, form, **params))

    run(command, station=names_other_sites(params.get("targets")))


async def give_order(gcs: Client, method: str, form: JsonForm, **params: Any) -> Mapping[str, Mapping[str, Any]]:
    """Call a method that orders vehicles to do something, and print each outcome as it comes. Returns all."""
    label = f"{method.removeprefix('vehicles.')} {params.get('targets', '')}".rstrip()
    output = OrderOutput(form, clear_spinner)
    async with waiting(lambda: f"{label}: {output.awaited}".removesuffix(": ")):
        outcomes = await gcs.order(method, on_vehicles=output.begin, on_outcome=output.take, **params)
    output.end()
    if form is None:
        await _note_absent(gcs, params.get("targets"))
    return outcomes


async def _note_absent(gcs: Client, targets: object) -> None:
    """Name the system ids of a range that no vehicle has, to a person: one of them may be a vehicle that is expected.
    After the outcomes, because no order waits for it."""
    if not isinstance(targets, str) or _RANGE.search(targets) is None:
        return
    from skygcs.core.vehicle.targets import absent_sysids, expression_of  # only a range needs it

    with contextlib.suppress(SkygcsError):
        there = await gcs.call("vehicles.list", targets=targets)
        if absent := absent_sysids(targets, (vehicle["sysid"] for vehicle in there)):
            say(f"skygcs-cli: no vehicle has the system ids {expression_of(absent)}", err=True)


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


def want_json(arguments: Sequence[str]) -> None:
    """Errors of this process are JSON from now on if the command line asks for JSON."""
    options = itertools.takewhile(lambda argument: argument != "--", arguments)
    _JSON_IS_WANTED.set(not {"--json", "--json-lines"}.isdisjoint(options))


def json_is_wanted() -> bool:
    """True if the command line asks for JSON."""
    return _JSON_IS_WANTED.get()


def fail(text: str) -> None:
    """Print one error on stderr: a line, which is wrapped between words on a terminal, or with --json one object."""
    if json_is_wanted():
        say(json.dumps({"error": text}), err=True)
        return
    say(wrapped(f"skygcs-cli: {text}", screen_width(sys.stderr), indent=2), err=True)


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


def _in_commands(error: RpcError) -> str:
    """The text of an error in the words of the command line: parameters without their units, commands for methods."""
    problems = error.data.get("problems") if error.code == INVALID_PARAMS and isinstance(error.data, dict) else None
    text = "; ".join(f"{_argument(p['param'])}{p['problem']}" for p in problems) if problems else str(error)
    for method, command in COMMANDS.items():
        text = text.replace(f"{method} lists", f"{command} lists")
    return text


def _argument(parameter: str) -> str:
    """The name of an argument: `height_m` is typed as a height."""
    return f"{_UNIT.sub('', parameter).replace('_', ' ')}: " if parameter else ""


def _token_advice() -> str:
    token_file = os.environ.get(TOKEN_FILE_VARIABLE)
    if token_file:
        return f"the token in {token_file} is wrong: it is not the one of this daemon"
    return "the daemon requires a token: --token-file FILE"


def clear_spinner() -> None:
    """Remove the spinner's line before another line is printed; it is drawn again below that."""
    if sys.stderr.isatty():
        sys.stderr.write("\r\033[K")
        sys.stderr.flush()


@contextlib.asynccontextmanager
async def waiting(text: str | Callable[[], str]) -> AsyncIterator[None]:
    """Show a spinner with the elapsed time while the body runs; on a terminal only. ``text``: what is waited for, now
    and for ever, or a function that returns it."""
    if not sys.stderr.isatty():
        yield
        return
    spinner = asyncio.create_task(_spin(text), name="spinner")
    try:
        yield
    finally:
        spinner.cancel()
        await asyncio.wait([spinner])


async def _spin(text: str | Callable[[], str]) -> None:
    loop = asyncio.get_running_loop()
    began = loop.time()
    await asyncio.sleep(SPINNER_DELAY_S)
    try:
        for glyph in itertools.cycle(SPINNER):
            said = text if isinstance(text, str) else text()
            line = cut(f"{glyph} {said} {loop.time() - began:.0f} s", (screen_width(sys.stderr) or PIPE_WIDTH) - 1)
            sys.stderr.write(f"\r{visible(line)}\033[K")
            sys.stderr.flush()
            await asyncio.sleep(SPINNER_PERIOD_S)
    finally:
        clear_spinner()


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
        fail(_token_advice() if error.code == NOT_AUTHENTICATED else _in_commands(error))
        return Exit.USAGE if error.code in USAGE_ERRORS else Exit.FAILED
    except SkygcsError as error:
        fail(str(error))
        return Exit.FAILED
    except OSError as error:
        fail(f"{error.filename}: {error.strerror}" if error.filename and error.strerror else str(error))
        return Exit.FAILED
    except (typer.Exit, typer.BadParameter):
        raise
    except Exception as error:
        if os.environ.get(DEBUG_VARIABLE):
            raise
        fail(f"internal error: {type(error).__name__}: {error} (set {DEBUG_VARIABLE}=1 to see where)")
        return Exit.FAILED


async def bytes_of(descriptor: int) -> AsyncIterator[bytes]:
    """Return what arrives at a pipe, a terminal or a file.

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
