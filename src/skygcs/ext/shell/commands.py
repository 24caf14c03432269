"""`skygcs-cli shell`: the console of a PX4, typed by a person, read from a pipe, or one command."""

from __future__ import annotations

import asyncio
import contextlib
import functools
import io
import sys
from collections.abc import Iterable, Iterator
from typing import Annotated, Any, TextIO

import typer

from skygcs.cli.connection import Exit, client, fail, run_offline
from skygcs.cli.options import OneVehicle
from skygcs.cli.parsing import finite, within
from skygcs.errors import RpcError
from skygcs.ext.shell.history import history_file, read_history, write_history
from skygcs.ext.shell.shell_text import ShellOutputText
from skygcs.rpc.client import Client
from skygcs.terminal_text import visible

POLL_S = 20.0
"""One request for output; there is always one while a line is being executed."""

FIRST_PROMPT_S = 10.0
"""A shell that has not shown its prompt by then does not answer: PX4 without one, or a link that loses much."""

MAX_LINE_CHARS = 4096
"""Most of one line of a pipe; the daemon refuses lines that are longer than the shell's."""

INTERRUPT = "\x03"


def shell(
    vehicle: OneVehicle,
    command: Annotated[
        str | None, typer.Argument(metavar="COMMAND", help="One line for its shell; default: typed, or from a pipe.")
    ] = None,
    force: Annotated[
        bool, typer.Option("--force", help="Although it is not known to be disarmed, or others may execute it, too.")
    ] = False,
    wait: Annotated[
        float,
        typer.Option("--wait", metavar="S", help="For the end of COMMAND, or of a line of a pipe.", parser=finite),
    ] = 30.0,
) -> None:
    """Type at the console of a PX4 (NuttShell), over MAVLink. Only while it is disarmed.

    Ctrl-C interrupts a command, a second one no longer waits for it; Ctrl-D ends. Lines are kept for the arrow keys.

    Example: skygcs-cli shell alpha 'ver all'
    """
    within("--wait", wait, 0.1, 3600.0)
    if command is not None and "\n" in command:
        raise typer.BadParameter("COMMAND is one line; give several through a pipe")

    def run() -> int:
        with asyncio.Runner() as runner:
            gcs = client()
            runner.run(gcs.open())
            console = Console(runner, gcs)
            try:
                return console.run(vehicle, command, force=force, wait_s=wait)
            finally:
                console.close()

    run_offline(run)


class ShellEndedError(RpcError):
    """The daemon has ended the session."""


class Console:
    """One session, for a person or a program at this end. Waiting for a line of input and waiting for the daemon take
    turns in one thread: what the shell puts out meanwhile is kept by the daemon."""

    def __init__(self, runner: asyncio.Runner, gcs: Client) -> None:
        self._runner = runner
        self._gcs = gcs
        self._session: str | None = None
        self._text = ShellOutputText()
        self._reading: asyncio.Task[dict[str, Any]] | None = None
        """A request for output that was interrupted and still waits."""

    def run(self, vehicle: str, command: str | None, *, force: bool, wait_s: float) -> int:
        """Open the shell and do what was asked for; the exit code. Raises RpcError and DaemonUnreachable."""
        name = self._runner.run(self._open(vehicle, force=force))
        typed = command is None and self._is_typed()
        answers = self._runner.run(self._until_ready(FIRST_PROMPT_S, show=typed))
        if not answers:
            fail(f"{name}: its shell has shown no prompt within {FIRST_PROMPT_S:g} s")
            return Exit.FAILED
        if typed:
            return self._typed(name)
        return self._executed(name, _lines_of(sys.stdin) if command is None else [command], wait_s)

    def close(self) -> None:
        """End the session and the connection, unless the daemon is gone."""
        with contextlib.suppress(RpcError):
            self._runner.run(self._close())

    async def _open(self, vehicle: str, *, force: bool) -> str:
        opened = await self._gcs.call("shell.open", vehicle=vehicle, force=force)
        self._session = opened["session"]
        if opened["note"]:
            fail(opened["note"])
        return visible(str(opened["vehicle"]))

    async def _close(self) -> None:
        try:
            if self._session is not None:
                await self._gcs.call("shell.close", session=self._session)
        finally:
            await self._gcs.close()

    @staticmethod
    def _is_typed() -> bool:
        """True if a person types, and no pipe or file."""
        return sys.stdin.isatty()

    def _executed(self, name: str, lines: Iterable[str], wait_s: float) -> int:
        """Lines of the command line or of a pipe, one after the other."""
        for line in lines:
            if not self._runner.run(self._execute(line, wait_s)):
                self._print(self._text.end())
                fail(f"{name}: no prompt within {wait_s:g} s after {visible(line)!r} (--wait)")
                return Exit.FAILED
        return Exit.DONE

    def _typed(self, name: str) -> int:
        """Lines of a person, until Ctrl-D."""
        with _line_editor():
            while True:
                prompt = self._text.prompt
                try:
                    line = input(f"{name} {prompt}" if prompt else "")
                except EOFError:
                    self._print("\n")
                    return Exit.DONE
                except KeyboardInterrupt:
                    self._print("\n")
                    continue
                try:
                    self._exchange(line)
                except RpcError as error:
                    if self._gone(error):
                        raise
                    fail(str(error))

    def _exchange(self, line: str) -> None:
        """Execute a line and show its output; a first Ctrl-C goes to the vehicle, a second one stops waiting."""
        for step in (functools.partial(self._execute, line, None), self._interrupt):
            try:
                self._runner.run(step())
                return
            except KeyboardInterrupt:
                self._print("^C\n")

    def _gone(self, error: RpcError) -> bool:
        """True if nothing more can be typed."""
        return isinstance(error, ShellEndedError) or not self._gcs.connected

    async def _execute(self, line: str, wait_s: float | None) -> bool:
        """True if the prompt came in time."""
        await self._gcs.call("shell.write", session=self._session, text=f"{line}\n")
        self._text.begin()
        return await self._until_ready(wait_s, show=True)

    async def _interrupt(self) -> bool:
        await self._gcs.call("shell.write", session=self._session, text=INTERRUPT)
        return await self._until_ready(None, show=True)

    async def _until_ready(self, seconds: float | None, *, show: bool) -> bool:
        """Show output until the prompt comes; True if it came in time. Raises ShellEndedError, RpcError for a line that
        was taken and then not sent."""
        loop = asyncio.get_running_loop()
        ends_at = None if seconds is None else loop.time() + seconds
        while True:
            left_s = POLL_S if ends_at is None else min(POLL_S, ends_at - loop.time())
            if left_s <= 0:
                return False
            if self._reading is None:
                call = self._gcs.call("shell.read", session=self._session, wait_s=left_s)
                self._reading = asyncio.ensure_future(call)
            answer = await asyncio.shield(self._reading)
            self._reading = None
            if answer["dropped_bytes"]:
                fail(f"{answer['dropped_bytes']} bytes of output are missing: it came faster than it was read")
            shown = self._text.feed(answer["text"])
            if show:
                self._print(shown)
            if answer["end"] is not None:
                self._session = None
                raise ShellEndedError(0, f"the shell has ended: {answer['refused'] or answer['end']}")
            if answer["refused"]:
                raise RpcError(0, answer["refused"])
            if answer["ready"]:
                return True

    def _print(self, text: str) -> None:
        sys.stdout.write(text)
        sys.stdout.flush()


@contextlib.contextmanager
def _line_editor() -> Iterator[None]:
    """Arrow keys and the lines of earlier sessions, if this Python has readline."""
    try:
        import readline
    except ImportError:
        yield
        return
    path = history_file()
    for line in read_history(path) if path is not None else ():
        readline.add_history(line)
    try:
        yield
    finally:
        if path is not None:
            there = (readline.get_history_item(n + 1) for n in range(readline.get_current_history_length()))
            write_history(path, [line for line in there if line is not None])


def _lines_of(pipe: TextIO) -> Iterator[str]:
    """Lines of a pipe. One that is too long comes in parts, which the daemon refuses; so it does other characters."""
    if isinstance(pipe, io.TextIOWrapper):
        pipe.reconfigure(errors="replace")
    while line := pipe.readline(MAX_LINE_CHARS):
        yield line.removesuffix("\n").removesuffix("\r")


def add_to(app: typer.Typer) -> None:
    """Add the command to the program."""
    app.command()(shell)
