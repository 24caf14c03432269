"""The methods of vehicles' shells. `METHODS` is their part of the table."""

from __future__ import annotations

from typing import Any, Protocol

from pydantic import Field

from skygcs.ext.shell.shell_input import MAX_WAITING_BYTES
from skygcs.ext.shell.shell_output import MAX_OUTPUT_BYTES
from skygcs.rpc import error_codes
from skygcs.rpc.context import Context, JsonObject
from skygcs.rpc.dispatch import Method
from skygcs.rpc.models import MethodParams, NoParams, Result, Target

LONGEST_READ_S = 60.0


class ShellOpenParams(MethodParams):
    vehicle: Target
    force: bool = Field(
        False, description="Although it is not known to be disarmed, or others on its link may execute the lines."
    )


class SessionParams(MethodParams):
    session: str = Field(min_length=1, max_length=64, description="As shell.open has answered.")


class ShellWriteParams(SessionParams):
    text: str = Field(
        min_length=1,
        max_length=MAX_WAITING_BYTES,
        description="Printable ASCII; a line ends with \\n and has 120 characters at most. \\x03 alone: Ctrl-C.",
    )


class ShellReadParams(SessionParams):
    wait_s: float = Field(
        0.0, ge=0.0, le=LONGEST_READ_S, description="Longest wait for output, or for the session's end."
    )


class ShellOpened(Result):
    session: str = Field(description="The key of the session: it is the right to write and read.")
    vehicle: str
    note: str = Field(description="Other vehicles that hear the lines; empty: none.")


class ShellWritten(Result):
    waiting_bytes: int = Field(description="Of all that was written and not sent: the shell has not read the rest yet.")


class ShellText(Result):
    text: str = Field(description="As it came, with control characters.")
    dropped_bytes: int = Field(description=f"Lost before this text: it is kept up to {MAX_OUTPUT_BYTES >> 10} KiB.")
    refused: str = Field(description="Why text that had waited was not sent; empty: it was, or waits.")
    ready: bool = Field(description="The shell shows its prompt, and nothing waits for it.")
    end: str | None = Field(description="Why the session has ended; null: it goes on.")


class ShellClosed(Result):
    closed: bool


class OpenShell(Result):
    vehicle: str
    forced: bool
    open_s: float
    waiting_bytes: int
    received_bytes: int
    dropped_bytes: int


class ShellStatus(Result):
    sessions: list[OpenShell]
    ignored_frames: int = Field(description="SERIAL_CONTROL of shells that nobody has open, or that is for others.")
    bad_frames: int = Field(description="With more bytes than the message holds.")


class ShellKeeper(Protocol):
    """The extension, as its methods see it."""

    def open(self, context: Context, target: str | int, *, force: bool) -> JsonObject: ...
    def write(self, session: str, text: str) -> JsonObject: ...
    async def read(self, session: str, wait_s: float) -> JsonObject: ...
    def close_session(self, session: str) -> JsonObject: ...
    def status(self) -> JsonObject: ...


def _keeper(context: Context) -> ShellKeeper:
    keeper: ShellKeeper = context.services.extensions["shell"]
    return keeper


def shell_open(context: Context, params: ShellOpenParams) -> JsonObject:
    """Open the console of a PX4: a new shell, whose prompt comes with shell.read.

    It ends with its client. Refused without force for a vehicle that is not known to be disarmed.
    """
    return _keeper(context).open(context, params.vehicle, force=params.force)


def shell_write(context: Context, params: ShellWriteParams) -> JsonObject:
    """Send text to the shell. A line waits until the one before has been executed.

    Without force refused while the vehicle is not known to be disarmed.
    """
    return _keeper(context).write(params.session, params.text)


async def shell_read(context: Context, params: ShellReadParams) -> JsonObject:
    """Return the output since the last read. A second read ends one that waits."""
    return await _keeper(context).read(params.session, params.wait_s)


def shell_close(context: Context, params: SessionParams) -> JsonObject:
    """End the session, and the shell."""
    return _keeper(context).close_session(params.session)


def shell_status(context: Context, params: NoParams) -> JsonObject:
    """The shells that are open, and counters."""
    return _keeper(context).status()


_REFUSED = (error_codes.REFUSED,)

METHODS: tuple[Method[Any], ...] = (
    Method("shell.open", ShellOpenParams, shell_open, ShellOpened, (error_codes.TARGET_ERROR, error_codes.REFUSED)),
    Method("shell.write", ShellWriteParams, shell_write, ShellWritten, _REFUSED),
    Method("shell.read", ShellReadParams, shell_read, ShellText, _REFUSED, reach="nothing"),
    Method("shell.close", SessionParams, shell_close, ShellClosed, _REFUSED),
    Method("shell.status", NoParams, shell_status, ShellStatus),
)
