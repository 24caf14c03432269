"""The socket: newline-delimited JSON-RPC 2.0 on a Unix socket, on TCP loopback if a token is configured, and on a
companion over mutual TLS (`tls_listener`).

Every client is a session of its own with bounds on all it can make the daemon keep or do. Its errors are answered to
it and counted, and do not affect other clients.

This module is light: sessions and methods with their models are imported by `RpcServer.start`, beside the loop, so that
a daemon that is restarted in flight forwards frames meanwhile.
"""

from __future__ import annotations

import asyncio
import contextlib
import fcntl
import importlib
import os
import socket
import stat
import sys
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

import structlog

from skygcs.errors import LinkError

if TYPE_CHECKING:  # pydantic and its models are heavy: see above
    from skygcs.rpc.context import JsonObject, Services
    from skygcs.rpc.sessions import Sessions
    from skygcs.rpc.tls_listener import TlsListener

MAX_SUN_PATH_BYTES = 107
"""Linux's sockaddr_un holds 108 bytes with the closing NUL."""

BACKLOG = 100
"""Connections that the system keeps until they are taken; not more than `sessions.MAX_RESERVE`."""

ACCEPT_TURNS = 2
"""Turns of the event loop from accepting a connection to its session: one for the transport, one for
`connection_made`."""

_log = structlog.get_logger(__name__)


class RpcServer:
    """Serves one daemon. `claim` if wanted, `start` once, `close` once."""

    def __init__(
        self,
        services: Services,
        socket_path: str | os.PathLike[str],
        tcp_port: int | None = None,
        token: str | None = None,
        tls: TlsListener | None = None,
    ) -> None:
        """``token`` is required with ``tcp_port``; port 0 lets the system choose (see `tcp_address`)."""
        if tcp_port is not None and not token:
            raise ValueError("a TCP port needs a token")
        self.socket_path = Path(socket_path)
        self.tcp_address: tuple[str, int] | None = None
        self._services = services
        self._tcp_port = tcp_port
        self._token = token
        self._tls = tls
        self._tls_task: asyncio.Task[None] | None = None
        self._hub: Sessions | None = None
        self._servers: list[asyncio.Server] = []
        self._socket_inode: tuple[int, int] | None = None
        self._lock_fd = -1
        self._tcp_listener: socket.socket | None = None

    def claim(self) -> None:
        """Reserve the socket's path and the TCP port before anything else begins; `start` listens there.

        Raises LinkError if another daemon has one of them, or it is not available. `close` releases them.
        """
        if self._lock_fd >= 0:
            return
        path = os.fspath(self.socket_path)
        if len(os.fsencode(path)) > MAX_SUN_PATH_BYTES:
            raise LinkError(f"{path}: a socket's path has at most {MAX_SUN_PATH_BYTES} bytes")
        try:
            self._make_directory()
            self._take_lock(path)
            self._remove_stale(path)
            if self._tcp_port is not None:
                self._tcp_listener = _bound_tcp(self._tcp_port)
        except OSError as error:
            self._release()
            raise LinkError(f"cannot make the socket {path}: {error.strerror or error}") from None
        except LinkError:
            self._release()
            raise

    async def start(self) -> None:
        """Listen. Raises LinkError if another daemon has the socket, or it cannot be made."""
        self.claim()
        loop = asyncio.get_running_loop()
        try:
            await _import_beside("skygcs.rpc.methods")
            await _import_beside("skygcs.rpc.sessions")
            from skygcs.rpc.dispatch import Dispatcher
            from skygcs.rpc.methods import METHODS
            from skygcs.rpc.sessions import Session, Sessions

            self._hub = hub = Sessions(self._services, Dispatcher(METHODS), loop)
            listener = self._bind()
            server = await loop.create_unix_server(lambda: Session(hub, None), sock=listener, backlog=BACKLOG)
            self._servers.append(server)
            if self._tcp_listener is not None:
                await self._listen_tcp(self._tcp_listener, lambda: Session(hub, self._token))
            if self._tls is not None:
                accepting = self._tls.run(lambda admits: Session(hub, None, admits))
                self._tls_task = loop.create_task(accepting, name="orders over tls")
        except BaseException:
            await self.close()
            raise
        _log.info("rpc listening", socket=str(self.socket_path), tcp=self.tcp_address)

    async def close(self) -> None:
        """Stop listening, cancel every order, close all clients, remove the socket. Idempotent."""
        if self._tls_task is not None:
            self._tls_task.cancel()
            await asyncio.wait({self._tls_task})
            self._tls_task = None
        await self._stop_accepting()
        if self._hub is not None:
            await self._hub.close()
            self._hub = None
        self._remove_socket()
        self._release()

    async def _stop_accepting(self) -> None:
        """Stop listening. A connection that is accepted in this moment becomes a session, which is closed with the
        others: asyncio leaves its socket open if the server closes between (CPython 3.11, `Server._attach`)."""
        servers, self._servers = self._servers, []
        for server in servers:
            for listener in server.sockets:
                asyncio.get_running_loop().remove_reader(listener.fileno())  # uvloop has none there and needs none
        for _ in range(ACCEPT_TURNS if servers else 0):
            await asyncio.sleep(0)
        for server in servers:
            server.close()
        await asyncio.sleep(0)

    def stats(self) -> JsonObject:
        """Counters: sessions now and ever, requests, errors, drops."""
        return self._hub.stats() if self._hub is not None else {}

    async def _listen_tcp(self, listener: socket.socket, new_session: Callable[[], asyncio.BaseProtocol]) -> None:
        address = listener.getsockname()
        try:
            server = await asyncio.get_running_loop().create_server(new_session, sock=listener, backlog=BACKLOG)
        except OSError as error:  # two had bound it: the second to listen gets the error
            raise LinkError(f"cannot listen on 127.0.0.1:{address[1]}: {error.strerror or error}") from None
        self._tcp_listener = None  # the server's now
        self._servers.append(server)
        self.tcp_address = address

    def _bind(self) -> socket.socket:
        """A bound Unix socket of mode 0600. No client can connect before it listens, which it does only after this."""
        path = os.fspath(self.socket_path)
        try:
            listener = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
            try:
                listener.bind(path)
                os.chmod(path, 0o600)
                status = os.lstat(path)
                self._socket_inode = (status.st_dev, status.st_ino)
                listener.setblocking(False)
            except OSError:
                listener.close()
                raise
        except OSError as error:
            raise LinkError(f"cannot make the socket {path}: {error.strerror or error}") from None
        return listener

    def _make_directory(self) -> None:
        """The directory, private if it is made here; in /tmp it must not belong to another user."""
        folder = self.socket_path.parent
        with contextlib.suppress(FileExistsError):
            folder.mkdir(mode=0o700, parents=True)
        if folder.name == f"skygcs-{os.getuid()}":
            status = folder.lstat()
            if status.st_uid != os.getuid() or not stat.S_ISDIR(status.st_mode) or status.st_mode & 0o022:
                raise LinkError(f"{folder} belongs to another user, or others can write to it; choose another socket")

    def _take_lock(self, path: str) -> None:
        """The system holds the lock as long as this process lives: two daemons never share a socket."""
        self._lock_fd = os.open(f"{path}.lock", os.O_RDWR | os.O_CREAT | os.O_CLOEXEC | os.O_NOFOLLOW, 0o600)
        try:
            fcntl.flock(self._lock_fd, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise LinkError(_in_use(path)) from None

    def _release(self) -> None:
        if self._tcp_listener is not None:
            self._tcp_listener.close()
            self._tcp_listener = None
        if self._lock_fd >= 0:
            os.close(self._lock_fd)
            self._lock_fd = -1

    def _remove_stale(self, path: str) -> None:
        """Remove the socket of a daemon that has ended. Raises LinkError for one that answers and for another file."""
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
        raise LinkError(_in_use(path))

    def _remove_socket(self) -> None:
        """Only our own: a path that was replaced meanwhile is left alone."""
        if self._socket_inode is None:
            return
        with contextlib.suppress(OSError):
            status = os.lstat(self.socket_path)
            if (status.st_dev, status.st_ino) == self._socket_inode:
                os.unlink(self.socket_path)
        self._socket_inode = None


async def _import_beside(module: str) -> None:
    """Import it in a thread: the loop goes on with what flies."""
    if module not in sys.modules:
        await asyncio.to_thread(importlib.import_module, module)


def _bound_tcp(port: int) -> socket.socket:
    """A bound socket, to which no client can connect before it listens. Raises LinkError."""
    listener = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
    try:
        listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        listener.bind(("127.0.0.1", port))
        listener.setblocking(False)
    except OSError as error:
        listener.close()
        raise LinkError(f"cannot listen on 127.0.0.1:{port}: {error.strerror or error}") from None
    return listener


def _in_use(path: str) -> str:
    return f"another skygcs daemon listens on {path}; stop it, or give this one another socket (daemon.socket)"
