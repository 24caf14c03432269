"""The station socket: the daemon's JSON-RPC socket with the vehicles of all sites, for CLI, page and programs.

Each client (`station_client`) gets a connection of its own to the daemon (`relayed_daemon`), and its lines go there and
back unchanged, so that the daemon's limits, deadlines and subscriptions mean what they mean there. What concerns other
sites is answered by this process.
"""

from __future__ import annotations

import asyncio
from collections import Counter
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import structlog

from skygcs.ext.federation.bridge.station_client import StationClient
from skygcs.ext.federation.bridge.station_services import StationServices
from skygcs.rpc import error_codes
from skygcs.rpc.address import UnixSocket
from skygcs.rpc.dispatch import Dispatcher, Method
from skygcs.rpc.replies import error_reply

IN_USE = "another process of skygcs federation listens on {path}; stop it, or give this one another --socket"

MAX_CLIENTS = 64
"""Most clients, the same as in the daemon; each is one of the daemon's clients, too. When all places are taken, a new
client replaces the one that has been idle longest, for IDLE_S at least."""

MAX_RESERVE = 32
"""Clients beyond, if none is idle: they may end flights and list vehicles, and are closed after RESERVE_S."""

IDLE_S = 10.0

_log = structlog.get_logger(__name__)


class StationSocket:
    """Listens at ``path``. `start` once, `close` once."""

    full_text = f"all {MAX_CLIENTS} places of the station are taken"

    def __init__(self, path: Path, services: StationServices) -> None:
        self.path = path
        self.services = services
        self.counters: Counter[str] = Counter()
        self.clients: dict[StationClient, None] = {}
        self.methods: dict[str, Method[StationClient]] = {}
        self.dispatcher: Dispatcher[StationClient] = Dispatcher({})
        self.lasting: set[asyncio.Task[Any]] = set()
        """Orders that end a flight: they go on without the client that gave them."""
        self._unix = UnixSocket(path, IN_USE)
        self._server: asyncio.Server | None = None

    async def start(self, methods: Mapping[str, Method[StationClient]]) -> None:
        """Listen. ``methods``: those of federation.*. Raises LinkError."""
        self.methods = dict(methods)
        self.dispatcher = Dispatcher(self.methods)
        self._unix.claim()
        try:
            loop = asyncio.get_running_loop()
            self._server = await loop.create_unix_server(lambda: StationClient(self), sock=self._unix.bind())
        except BaseException:
            await self.close()
            raise
        _log.info("station listening", socket=str(self.path))

    async def close(self) -> None:
        """Stop listening and close all clients. Idempotent."""
        server, self._server = self._server, None
        if server is not None:
            server.close()
        for client in list(self.clients):
            client.end()
        lasting = list(self.lasting)
        for task in lasting:
            task.cancel()
        await asyncio.gather(*lasting, return_exceptions=True)
        self._unix.remove()
        self._unix.release()

    def admit(self, client: StationClient) -> bool:
        """True if a new client has a place; ``restricted`` is set of one beyond the places. One without is answered."""
        self.counters["connections"] += 1
        if len(self.clients) >= MAX_CLIENTS:
            now = asyncio.get_running_loop().time()
            idle = min(self.clients, key=lambda other: other.used_at)
            if now - idle.used_at >= IDLE_S and not idle.busy:
                self.counters["closed_idle"] += 1
                idle.reply(error_reply(None, error_codes.LIMIT_EXCEEDED, f"closed: idle, and {self.full_text}"))
                idle.end()
            elif len(self.clients) >= MAX_CLIENTS + MAX_RESERVE:
                self.counters["connections_refused"] += 1
                client.reply(error_reply(None, error_codes.LIMIT_EXCEEDED, self.full_text))
                return False
            else:
                self.counters["connections_restricted"] += 1
                client.restricted = True
        self.clients[client] = None
        return True

    def stats(self) -> dict[str, int]:
        """JSON-able counters."""
        return {"clients": len(self.clients), **self.counters}
