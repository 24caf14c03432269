"""Where daemon and clients meet: the addresses when nobody says otherwise, and a Unix socket's place among the files:
only its user's, only one process', and gone when that ends. Imported by both sides; imports next to nothing."""

from __future__ import annotations

import contextlib
import fcntl
import os
import select
import socket
import stat
from pathlib import Path
from typing import TYPE_CHECKING

from skygcs.errors import LinkError, SkygcsError

if TYPE_CHECKING:  # see above
    import asyncio

SOCKET_VARIABLE = "SKYGCS_SOCKET"
TOKEN_FILE_VARIABLE = "SKYGCS_TOKEN_FILE"


MAX_SUN_PATH_BYTES = 107
"""Linux's sockaddr_un holds 108 bytes with the closing NUL."""

MAX_TOKEN_CHARS = 4096
"""A device such as /dev/zero has no end."""


def default_socket_path() -> Path:
    """$XDG_RUNTIME_DIR/skygcs.sock, else /tmp/skygcs-UID/skygcs.sock: private to the user either way."""
    runtime = os.environ.get("XDG_RUNTIME_DIR")
    if runtime:
        return Path(runtime) / "skygcs.sock"
    return Path(f"/tmp/skygcs-{os.getuid()}") / "skygcs.sock"


def tcp_address(address: str) -> tuple[str, int] | None:
    """Host and port of ``tcp://HOST:PORT``, None for a path. Raises ValueError for what is neither."""
    scheme, there_is, rest = address.partition("://")
    if not there_is:
        return None
    host, _, port = rest.rpartition(":")
    if scheme != "tcp" or not host or not (port.isascii() and port.isdigit() and 0 < int(port) < 65536):
        raise ValueError(f"{address} is neither a path nor of the form tcp://HOST:PORT")
    return host.removeprefix("[").removesuffix("]"), int(port)


def client_address(address: str | os.PathLike[str] | None = None) -> str:
    """Return what a client connects to: the argument, else $SKYGCS_SOCKET, else the default path.

    A path, or ``tcp://HOST:PORT`` (a daemon with ``tcp_port``, usually through an SSH tunnel).
    """
    return os.fspath(address) if address else os.environ.get(SOCKET_VARIABLE) or str(default_socket_path())


def client_token() -> str | None:
    """The token for a daemon on TCP, from the file that $SKYGCS_TOKEN_FILE names; None where it names none.

    Raises SkygcsError if the file cannot be read.
    """
    token_file = os.environ.get(TOKEN_FILE_VARIABLE)
    if not token_file:
        return None
    try:
        with open(token_file, encoding="utf-8") as file:
            return file.read(MAX_TOKEN_CHARS).strip()
    except (OSError, UnicodeError) as error:
        raise SkygcsError(f"cannot read the token file {token_file}: {error}") from None


def still_reads(transport: asyncio.Transport) -> bool:
    """After an end of file: whether the other side has only shut down its sending.

    On a Unix socket poll shows it (POLLHUP: both directions are shut); on TCP nothing does, so it counts as gone.
    """
    peer = transport.get_extra_info("socket")
    if peer is None or peer.family != socket.AF_UNIX:
        return False
    poll = select.poll()
    poll.register(peer.fileno(), 0)
    return not poll.poll(0)


class UnixSocket:
    """`claim`, then `bind`; at the end `remove`, then `release`. ``in_use``: the error's text for a path that another
    process has, with {path}."""

    def __init__(self, path: Path, in_use: str) -> None:
        self._path = path
        self._in_use = in_use
        self._inode: tuple[int, int] | None = None
        self._lock_fd = -1

    @property
    def claimed(self) -> bool:
        return self._lock_fd >= 0

    def claim(self) -> None:
        """Reserve the path. Raises LinkError if another process has it, or it is not available."""
        path = os.fspath(self._path)
        if len(os.fsencode(path)) > MAX_SUN_PATH_BYTES:
            raise LinkError(f"{path}: a socket's path has at most {MAX_SUN_PATH_BYTES} bytes")
        try:
            self._make_directory()
            self._take_lock(path)
            self._remove_stale(path)
        except OSError as error:
            self.release()
            raise LinkError(f"cannot make the socket {path}: {error.strerror or error}") from None
        except LinkError:
            self.release()
            raise

    def bind(self) -> socket.socket:
        """A bound Unix socket of mode 0600. No client can connect before it listens, which it does only after this.

        Raises LinkError."""
        path = os.fspath(self._path)
        try:
            listener = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
            try:
                listener.bind(path)
                os.chmod(path, 0o600)
                status = os.lstat(path)
                self._inode = (status.st_dev, status.st_ino)
                listener.setblocking(False)
            except OSError:
                listener.close()
                raise
        except OSError as error:
            raise LinkError(f"cannot make the socket {path}: {error.strerror or error}") from None
        return listener

    def remove(self) -> None:
        """Remove the socket; only our own: a path that was replaced meanwhile is left alone. Idempotent."""
        if self._inode is None:
            return
        with contextlib.suppress(OSError):
            status = os.lstat(self._path)
            if (status.st_dev, status.st_ino) == self._inode:
                os.unlink(self._path)
        self._inode = None

    def release(self) -> None:
        """Let others claim the path. Idempotent."""
        if self._lock_fd >= 0:
            os.close(self._lock_fd)
            self._lock_fd = -1

    def _make_directory(self) -> None:
        """The directory, private if it is made here; in /tmp it must not belong to another user."""
        folder = self._path.parent
        with contextlib.suppress(FileExistsError):
            folder.mkdir(mode=0o700, parents=True)
        if folder.name == f"skygcs-{os.getuid()}":
            status = folder.lstat()
            if status.st_uid != os.getuid() or not stat.S_ISDIR(status.st_mode) or status.st_mode & 0o022:
                raise LinkError(f"{folder} belongs to another user, or others can write to it; choose another socket")

    def _take_lock(self, path: str) -> None:
        """The system holds the lock as long as this process lives: two of them never share a socket."""
        self._lock_fd = os.open(f"{path}.lock", os.O_RDWR | os.O_CREAT | os.O_CLOEXEC | os.O_NOFOLLOW, 0o600)
        try:
            fcntl.flock(self._lock_fd, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise LinkError(self._in_use.format(path=path)) from None

    def _remove_stale(self, path: str) -> None:
        """Remove the socket of a process that has ended. Raises LinkError for one that answers and for another file."""
        try:
            mode = os.lstat(path).st_mode
        except FileNotFoundError:
            return
        if not stat.S_ISSOCK(mode):
            raise LinkError(f"{path} exists and is not a socket; remove it or choose another socket")
        with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as probe:
            probe.setblocking(False)
            try:
                probe.connect(path)
            except (ConnectionRefusedError, FileNotFoundError):
                with contextlib.suppress(FileNotFoundError):
                    os.unlink(path)
                return
            except BlockingIOError:  # alive, with a full backlog
                pass
        raise LinkError(self._in_use.format(path=path))
