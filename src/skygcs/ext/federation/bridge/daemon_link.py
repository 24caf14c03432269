"""A connection to the station's daemon that is made anew whenever it is lost. Each part of the bridge has its own.

    away        the daemon answers                      -> connected; the observers are called
    connected   it is closed, or has not answered a
                question of ASK_EVERY_S for DAEMON_SILENT_S     -> away; the observers are called
    away        PAUSE_S                                 -> the next attempt

Its requests do not count as the presence of an operator for operator_timeout_s (operator.relay).
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from typing import Any

from skygcs.errors import DaemonUnreachable, RpcError
from skygcs.rpc.client import Client, connect

PAUSE_S = 0.5
ASK_EVERY_S = 5.0
"""Period of daemon.info: the daemon closes idle connections when all its places are taken."""

DAEMON_SILENT_S = 15.0
"""A connection without an answer for this time is given up; a daemon stopped for a few seconds is waited for."""


class DaemonLink:
    """Run `run` in a task. ``client`` is None while there is no daemon."""

    def __init__(self, address: str, token: str | None, name: str) -> None:
        self.address = address
        self.name = name
        self.client: Client | None = None
        self.text = "not connected yet"
        self.info: dict[str, Any] = {}
        """The result of daemon.info at the beginning of the connection."""
        self.connections = 0
        self._token = token
        self._observers: list[Callable[[], None]] = []

    def on_change(self, observer: Callable[[], None]) -> None:
        """Call ``observer`` after each change between connected and away."""
        self._observers.append(observer)

    async def call(self, method: str, **params: Any) -> Any:
        """The result of a request. Raises RpcError, and DaemonUnreachable at once while the daemon is away."""
        return await self._connected().call(method, **params)

    async def relay(self, method: str, params: dict[str, Any], deadline_s: float | None = None) -> bytes:
        """The result as the daemon encoded it. The daemon refuses the request after ``deadline_s`` of its clock."""
        return await self._connected().relay(method, params, deadline_s)

    def _connected(self) -> Client:
        if self.client is None:
            raise DaemonUnreachable(self.address, self.text)
        return self.client

    async def run(self) -> None:
        """Keep the connection until it is cancelled."""
        while True:
            client = connect(self.address, token=self._token)
            try:
                async with client:
                    await client.call("operator.relay")
                    self.info = await client.call("daemon.info")
                    self.connections += 1
                    self._change(client, "connected")
                    while True:
                        await asyncio.sleep(ASK_EVERY_S)
                        async with asyncio.timeout(DAEMON_SILENT_S):
                            await client.call("daemon.info")
            except TimeoutError:
                self._change(None, f"the daemon at {self.address} has not answered for {DAEMON_SILENT_S:g} s")
            except RpcError as error:
                self._change(None, str(error))
            finally:
                self._change(None, self.text)
            await asyncio.sleep(PAUSE_S)

    def _change(self, client: Client | None, text: str) -> None:
        was = self.client is not None
        self.client, self.text = client, text
        if was != (client is not None):
            for observer in self._observers:
                observer()
