"""The socket: newline-delimited JSON-RPC 2.0 on a Unix socket, on TCP loopback if a token is configured, and where an
extension accepts clients.

Every client is a session of its own with bounds on all it can make the daemon keep or do. Its errors are answered to
it and counted, and do not affect other clients.

This module is light: sessions and methods with their models are imported by `RpcServer.start`, beside the loop, so that
a daemon that is restarted in flight forwards frames meanwhile.
"""

from __future__ import annotations

import asyncio
import contextlib
import importlib
import os
import socket
import sys
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

import structlog

from skygcs.errors import LinkError, explain_address_error
from skygcs.rpc.address import UnixSocket

if TYPE_CHECKING:  # pydantic and its models are heavy: see above
    from skygcs.rpc.context import JsonObject, Services
    from skygcs.rpc.sessions import Sessions

BACKLOG = 100
"""Connections that the system keeps until they are taken; not more than `sessions.MAX_RESERVE`."""

SWITCH_S = 0.0005
"""After so long an import lets the loop have its turn; Python's 5 ms make a control tick of 20 ms late by 10 to 30 ms,
with these it is 3 to 5 (medians on a busy machine)."""

ACCEPT_TURNS = 2
"""Turns of the event loop from accepting a connection to its session: one for the transport, one for
`connection_made`."""

IN_USE = "another skygcs daemon listens on {path}; stop it, or give this one another socket (daemon.socket)"

_log = structlog.get_logger(__name__)


class RpcServer:
    """Serves one daemon. `claim` if wanted, `start` once, `close` once."""

    def __init__(
        self,
        services: Services,
        socket_path: str | os.PathLike[str],
        tcp_port: int | None = None,
        token: str | None = None,
    ) -> None:
        """``token`` is required with ``tcp_port``; port 0 lets the system choose (see `tcp_address`)."""
        if tcp_port is not None and not token:
            raise ValueError("a TCP port needs a token")
        self.socket_path = Path(socket_path)
        self.tcp_address: tuple[str, int] | None = None
        self._services = services
        self._tcp_port = tcp_port
        self._token = token
        self._of_extensions: asyncio.Task[None] | None = None
        """Accepts clients in the ways of extensions."""
        self._hub: Sessions | None = None
        self._servers: list[asyncio.Server] = []
        self._unix = UnixSocket(self.socket_path, IN_USE)
        self._tcp_listener: socket.socket | None = None

    def claim(self) -> None:
        """Reserve the socket's path and the TCP port before anything else begins; `start` listens there.

        Raises LinkError if another daemon has one of them, or it is not available. `close` releases them.
        """
        if self._unix.claimed:
            return
        self._unix.claim()
        try:
            if self._tcp_port is not None:
                self._tcp_listener = _bound_tcp(self._tcp_port)
        except LinkError:
            self._release()
            raise

    async def start(self) -> None:
        """Listen. Raises LinkError if another daemon has the socket, or it cannot be made."""
        self.claim()
        loop = asyncio.get_running_loop()
        try:
            imports = _Imports(loop)
            await imports.beside("skygcs.rpc.methods")
            await imports.beside("skygcs.rpc.sessions")
            from skygcs.rpc.dispatch import Dispatcher, MethodTable
            from skygcs.rpc.methods import METHODS
            from skygcs.rpc.methods_on_demand import MethodsOnDemand
            from skygcs.rpc.sessions import Session, Sessions
            from skygcs.rpc.work_gate import WorkGate

            extensions = self._services.extensions
            methods = MethodTable(METHODS.values())
            methods.add(extensions.methods)
            on_demand = MethodsOnDemand(methods, extensions, imports.call_beside, loop)
            dispatcher = Dispatcher(methods, on_demand, WorkGate(self._services.fleet.resolve_any))
            self._hub = hub = Sessions(self._services, dispatcher, loop)
            listener = self._unix.bind()
            server = await loop.create_unix_server(lambda: Session(hub, None), sock=listener, backlog=BACKLOG)
            self._servers.append(server)
            if self._tcp_listener is not None:
                await self._listen_tcp(self._tcp_listener, lambda: Session(hub, self._token))
            serving = extensions.serve(lambda admits: Session(hub, None, admits))
            self._of_extensions = loop.create_task(serving, name="clients of extensions")
        except BaseException:
            await self.close()
            raise
        _log.info("rpc listening", socket=str(self.socket_path), tcp=self.tcp_address)

    async def close(self) -> None:
        """Stop listening, cancel every order, close all clients, remove the socket. Idempotent."""
        if self._of_extensions is not None:
            self._of_extensions.cancel()
            await asyncio.wait({self._of_extensions})
            self._of_extensions = None
        await self._stop_accepting()
        if self._hub is not None:
            await self._hub.close()
            self._hub = None
        self._unix.remove()
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

    def close_sessions(self, reason: str) -> None:
        """Close all connections of clients with this reason, also those that wait to be accepted; what they have sent
        and is not begun is not done."""
        self._close_waiting()
        self._dismiss_all(reason, ACCEPT_TURNS)

    def _dismiss_all(self, reason: str, turns: int) -> None:
        """Now and for some turns of the loop, in which what it had accepted becomes a session."""
        if self._hub is None:
            return
        for session in tuple(self._hub.sessions):
            session.dismiss(reason)
        if turns:
            asyncio.get_running_loop().call_soon(self._dismiss_all, reason, turns - 1)

    def _close_waiting(self) -> None:
        """Close the connections in the backlogs of the listeners."""
        for listener in (sock for server in self._servers for sock in server.sockets):
            with socket.socket(fileno=os.dup(listener.fileno())) as same:
                same.setblocking(False)
                with contextlib.suppress(OSError):  # BlockingIOError: no more
                    for _ in range(BACKLOG):
                        same.accept()[0].close()

    def stats(self) -> JsonObject:
        """Counters: sessions now and ever, requests, errors, drops."""
        return self._hub.stats() if self._hub is not None else {}

    async def _listen_tcp(self, listener: socket.socket, new_session: Callable[[], asyncio.BaseProtocol]) -> None:
        address = listener.getsockname()
        try:
            server = await asyncio.get_running_loop().create_server(new_session, sock=listener, backlog=BACKLOG)
        except OSError as error:  # two had bound it: the second to listen gets the error
            why = explain_address_error(error, *address)
            raise LinkError(f"cannot listen on 127.0.0.1:{address[1]}: {why}") from None
        self._tcp_listener = None  # the server's now
        self._servers.append(server)
        self.tcp_address = address

    def _release(self) -> None:
        if self._tcp_listener is not None:
            self._tcp_listener.close()
            self._tcp_listener = None
        self._unix.release()


class _Imports:
    """Imports modules in a thread: the loop goes on with what flies."""

    def __init__(self, loop: asyncio.AbstractEventLoop) -> None:
        self._loop = loop
        self._tasks: dict[str, asyncio.Task[None]] = {}
        self._switch_s = sys.getswitchinterval()

    async def beside(self, module: str) -> None:
        """Return when it is imported. All that wait for one module go on in the order in which they came."""
        task = self._tasks.get(module)
        if task is None:
            if module in sys.modules:
                return
            task = self._tasks[module] = self._loop.create_task(self._import(module), name=f"import of {module}")
            task.add_done_callback(lambda done: self._tasks.pop(module))
        await asyncio.shield(task)

    async def call_beside(self, function: Callable[[], object]) -> None:
        """Call a function that reads and imports."""
        sys.setswitchinterval(SWITCH_S)
        try:
            await asyncio.to_thread(function)
        finally:
            sys.setswitchinterval(self._switch_s)

    async def _import(self, module: str) -> None:
        await self.call_beside(lambda: importlib.import_module(module))


def _bound_tcp(port: int) -> socket.socket:
    """A bound socket, to which no client can connect before it listens. Raises LinkError."""
    listener = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
    try:
        listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        listener.bind(("127.0.0.1", port))
        listener.setblocking(False)
    except OSError as error:
        listener.close()
        why = explain_address_error(error, "127.0.0.1", port)
        raise LinkError(f"cannot listen on 127.0.0.1:{port}: {why}") from None
    return listener
