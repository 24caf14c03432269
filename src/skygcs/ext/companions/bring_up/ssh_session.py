"""One SSH connection to a companion: commands, files, and errors as lines for a person.

asyncssh is imported when a connection is made. `Session` is all that the rest of the package uses of it.
"""

from __future__ import annotations

import asyncio
import contextlib
import os
import shlex
from collections.abc import AsyncIterator, Callable
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

from skygcs.errors import CompanionError, SkygcsError
from skygcs.ext.companions.bring_up.host_keys import HostKeys, refusal
from skygcs.ext.companions.bring_up.inventory import Companion

if TYPE_CHECKING:
    from asyncssh import SSHClientConnection, SSHClientProcess, SSHKey, SSHReader

CONNECT_TIMEOUT_S = 10.0
"""A Raspberry Pi under load takes 2 s for key exchange and login; a switched-off one never answers."""

KEEPALIVE_S = 5.0
KEEPALIVES_LOST = 3
"""A companion out of reach for 15 s ends its connection."""

MAX_OUTPUT_BYTES = 1 << 20
"""Most bytes of each stream of a command. What comes after it is read and dropped."""

MAX_LINE_CHARS = 4096
READ_BYTES = 65536
UPLOAD_BYTES = 1 << 20
"""Written at a time: asyncssh sends it as 64 requests without waiting for each answer."""


@dataclass(frozen=True, slots=True)
class Ran:
    """The result of a command. ``status`` is None if a signal ended it."""

    status: int | None
    stdout: str
    stderr: str

    @property
    def ok(self) -> bool:
        return self.status == 0

    @property
    def why(self) -> str:
        """The last line that it printed, on stderr if there is one."""
        lines = [line.strip() for line in (self.stderr or self.stdout).splitlines() if line.strip()]
        ended = "was ended by a signal" if self.status is None else f"exit code {self.status}"
        return lines[-1][:300] if lines else ended


class Session(Protocol):
    """A companion that is connected. All methods raise CompanionError if the connection breaks."""

    async def run(self, command: str, *, stdin: str | None = None) -> Ran:
        """Run a command of the shell; each of its outputs is kept up to MAX_OUTPUT_BYTES."""
        ...

    async def follow(self, command: str, on_line: Callable[[str, str], None]) -> int | None:
        """Run a command whose lines are given away as they come, with "out" or "err"; its exit code, None if a signal
        ended it. Long lines are cut, control characters replaced."""
        ...

    async def upload(self, local: Path, remote: str, *, offset: int, on_bytes: Callable[[int], None]) -> None:
        """Write a file there, from this offset on; ``on_bytes`` gets the number written so far. Raises OSError if the
        local file cannot be read."""
        ...

    async def write(self, remote: str, data: bytes, *, mode: int = 0o644) -> None:
        """Write a file there, whole or not at all."""
        ...

    async def read(self, remote: str, *, most_bytes: int) -> bytes:
        """A file there. Raises CompanionError if it is missing or larger."""
        ...


@contextlib.asynccontextmanager
async def connected(companion: Companion, host_keys: HostKeys, identity: Path | None = None) -> AsyncIterator[Session]:
    """Connect while the body runs. ``identity``: the private key to log in with, besides agent and usual keys.

    Raises CompanionError: not reached, host key refused, login refused.
    """
    import asyncssh

    connection = await _connect(companion, host_keys, identity)
    try:
        yield _AsyncsshSession(connection, companion)
    except asyncssh.Error as error:
        raise CompanionError("ssh", f"{companion.place}: {_text(error)}") from None
    finally:
        connection.abort()
        with contextlib.suppress(asyncssh.Error, OSError):
            await connection.wait_closed()


async def presented_key(companion: Companion) -> SSHKey:
    """The key that the host shows now, without logging in. Raises CompanionError."""
    import asyncssh

    try:
        async with asyncio.timeout(CONNECT_TIMEOUT_S):
            key = await asyncssh.get_server_host_key(_host(companion), companion.port)
    except (OSError, TimeoutError, asyncssh.Error) as error:
        raise _unreachable(companion, error) from None
    if key is None:
        raise CompanionError("reach", f"{companion.place} shows no host key")
    return key


def require_asyncssh() -> None:
    """Raises SkygcsError if the library is not installed."""
    if find_spec("asyncssh") is None:
        raise SkygcsError("companions need the package asyncssh: pip install 'skygcs[companions]'")


async def _connect(companion: Companion, host_keys: HostKeys, identity: Path | None) -> SSHClientConnection:
    import asyncssh

    address = ""

    # the key that the companion presents is kept for the refusal: nobody is asked to accept it
    class Client(asyncssh.SSHClient):
        presented: SSHKey | None = None

        def validate_host_public_key(self, host: str, addr: str, port: int, key: SSHKey) -> bool:
            self.presented = key  # called only for a key that is not known
            return False

    client = Client()

    def trusted(host: str, addr: str, port: int | None) -> tuple[Any, Any, Any]:
        nonlocal address
        address = addr
        known = host_keys.known(host, addr, companion.port)
        return known.keys, known.authorities, known.revoked

    # one attempt, with a deadline; each failure by what a person can do about it
    options: dict[str, Any] = {"username": companion.user} if companion.user else {}
    if identity is not None:
        options["client_keys"] = [str(identity)]
    try:
        async with asyncio.timeout(CONNECT_TIMEOUT_S):
            connection, _ = await asyncssh.create_connection(
                lambda: client,
                _host(companion),
                companion.port,
                known_hosts=trusted,
                preferred_auth="publickey",
                keepalive_interval=KEEPALIVE_S,
                keepalive_count_max=KEEPALIVES_LOST,
                **options,
            )
    except (asyncssh.HostKeyNotVerifiable, asyncssh.KeyExchangeFailed) as error:
        known = host_keys.known(_host(companion), address, companion.port)
        if isinstance(error, asyncssh.KeyExchangeFailed) and known.source is None:
            raise _unreachable(companion, error) from None
        presented = client.presented or await presented_key(companion)
        raise refusal(known, presented, companion.name, companion.place) from None
    except asyncssh.PermissionDenied:
        copy = f"ssh-copy-id -p {companion.port} {companion.user + '@' if companion.user else ''}{companion.host}"
        raise CompanionError("log in", f"{companion.place} accepts none of your SSH keys", copy) from None
    except asyncssh.KeyImportError as error:
        raise CompanionError("log in", f"{identity}: {_text(error)}", "give a private key without passphrase") from None
    except (OSError, TimeoutError, asyncssh.Error) as error:
        raise _unreachable(companion, error) from None
    return connection


def _host(companion: Companion) -> str:
    if companion.host is None:
        raise CompanionError("reach", f"[companions.{companion.name}] has no host", "add it to the fleet file")
    return companion.host


def _unreachable(companion: Companion, error: Exception) -> CompanionError:
    match error:
        case TimeoutError():
            reason = f"no answer within {CONNECT_TIMEOUT_S:g} s"
        case ConnectionRefusedError():
            reason = "connection refused"
        case OSError():
            reason = error.strerror or str(error)
        case _:
            reason = _text(error)
    where = f"{companion.host} port {companion.port}"
    return CompanionError("reach", f"{where}: {reason}", "is it on, in reach, and is its SSH server running?")


def _text(error: Exception) -> str:
    return " ".join(str(error).split())[:300] or type(error).__name__


class _AsyncsshSession:
    """`Session` over an open connection."""

    def __init__(self, connection: SSHClientConnection, companion: Companion) -> None:
        self._connection = connection
        self._place = companion.place

    async def run(self, command: str, *, stdin: str | None = None) -> Ran:
        async with self._process(command) as process:
            if stdin is not None:
                process.stdin.write(stdin.encode())
            process.stdin.write_eof()
            out, err = await asyncio.gather(_kept(process.stdout), _kept(process.stderr))
            await process.wait_closed()
            return Ran(_status(process), out.decode("utf-8", "replace"), err.decode("utf-8", "replace"))

    async def follow(self, command: str, on_line: Callable[[str, str], None]) -> int | None:
        async def read(kind: str, reader: SSHReader[bytes]) -> None:
            async for line in _lines_of(reader):
                on_line(kind, line)

        async with self._process(command) as process:
            process.stdin.write_eof()
            await asyncio.gather(read("out", process.stdout), read("err", process.stderr))
            await process.wait_closed()
            return _status(process)

    async def upload(self, local: Path, remote: str, *, offset: int, on_bytes: Callable[[int], None]) -> None:
        with local.open("rb") as file:
            file.seek(offset)
            async with self._sftp() as sftp, sftp.open(remote, "r+b" if offset else "wb") as there:
                at = offset
                while data := await asyncio.to_thread(file.read, UPLOAD_BYTES):
                    await there.write(data, at)
                    at += len(data)
                    on_bytes(at)

    async def write(self, remote: str, data: bytes, *, mode: int = 0o644) -> None:
        draft = f"{remote}.part"
        async with self._sftp() as sftp:
            async with sftp.open(draft, "wb") as there:
                await there.write(data)
            await sftp.chmod(draft, mode)
            await sftp.posix_rename(draft, remote)

    async def read(self, remote: str, *, most_bytes: int) -> bytes:
        async with self._sftp() as sftp, sftp.open(remote, "rb") as there:
            data = await there.read(most_bytes + 1)
        if len(data) > most_bytes:
            raise CompanionError("read", f"{remote} is larger than {most_bytes} bytes")
        return bytes(data)

    @contextlib.asynccontextmanager
    async def _process(self, command: str) -> AsyncIterator[SSHClientProcess[bytes]]:
        import asyncssh

        try:
            process = await self._connection.create_process(command, encoding=None)
        except (asyncssh.Error, OSError) as error:
            raise CompanionError("ssh", f"{self._place}: {_text(error)}") from None
        try:
            yield process
        except (asyncssh.Error, OSError) as error:
            raise CompanionError("ssh", f"{self._place}: {_text(error)}") from None
        finally:
            if process.exit_status is None and process.exit_signal is None:
                with contextlib.suppress(OSError, asyncssh.Error):
                    process.terminate()
            process.close()

    @contextlib.asynccontextmanager
    async def _sftp(self) -> AsyncIterator[Any]:
        import asyncssh

        try:
            async with self._connection.start_sftp_client() as sftp:
                yield sftp
        except asyncssh.SFTPNoSuchFile:
            raise CompanionError("files", f"{self._place}: no such file or folder there") from None
        except asyncssh.SFTPError as error:
            raise CompanionError("files", f"{self._place}: {_text(error)}", "a full disk looks like this") from None
        except asyncssh.Error as error:
            raise CompanionError("ssh", f"{self._place}: {_text(error)}") from None


def _status(process: SSHClientProcess[bytes]) -> int | None:
    return process.exit_status if process.exit_signal is None else None


async def _kept(reader: SSHReader[bytes]) -> bytes:
    """All of it up to the bound; the rest is read and dropped, as a command that cannot write would never end."""
    kept = bytearray()
    while data := await reader.read(READ_BYTES):
        kept += data[: max(0, MAX_OUTPUT_BYTES - len(kept))]
    return bytes(kept)


async def _lines_of(reader: SSHReader[bytes]) -> AsyncIterator[str]:
    """Its lines; what is longer than MAX_LINE_CHARS is cut there."""
    left = b""
    while data := await reader.read(READ_BYTES):
        *whole, left = (left + data).split(b"\n")
        for line in whole:
            yield printable(line.decode("utf-8", "replace")[:MAX_LINE_CHARS])
        left = left[: 4 * MAX_LINE_CHARS]
    if left:
        yield printable(left.decode("utf-8", "replace")[:MAX_LINE_CHARS])


def printable(text: str) -> str:
    """Without control characters, which would move the cursor of the terminal that shows it."""
    return "".join(c if c.isprintable() or c == "\t" else "·" for c in text.rstrip("\r"))


def quoted(*words: str | os.PathLike[str]) -> str:
    """Words as one command of the shell."""
    return shlex.join(os.fspath(word) for word in words)
