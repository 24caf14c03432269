"""The RPC server over real sockets before a fake daemon, and clients that can misbehave."""

from __future__ import annotations

import asyncio
import contextlib
import json
import os
from collections.abc import AsyncIterator, Callable, Coroutine
from pathlib import Path
from typing import Any

import uvloop

from skygcs.rpc.server import RpcServer
from support.fake_daemon import FakeDaemon

TIMEOUT_S = 60.0
"""Of every read: far more than any answer takes."""


class Peer:
    """A client that can also say what no client should."""

    def __init__(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        self.reader, self.writer = reader, writer

    def send(self, *lines: object) -> None:
        for line in lines:
            raw = line if isinstance(line, bytes) else json.dumps(line).encode()
            self.writer.write(raw + b"\n")

    async def answer(self) -> Any:
        """The next line; None at the end."""
        line = await asyncio.wait_for(self.reader.readline(), TIMEOUT_S)
        return json.loads(line) if line else None

    async def call(self, method: str, **params: Any) -> Any:
        self.send({"jsonrpc": "2.0", "id": "c", "method": method, "params": params})
        while True:
            answer = await self.answer()
            if answer is None or answer.get("id") == "c":
                return answer

    async def close(self) -> None:
        self.writer.close()
        with contextlib.suppress(ConnectionError):
            await self.writer.wait_closed()


class Bench:
    """A server and its clients."""

    def __init__(self, daemon: FakeDaemon, server: RpcServer) -> None:
        self.daemon, self.server = daemon, server
        self.peers: list[Peer] = []

    async def connect(self) -> Peer:
        path = os.fspath(self.server.socket_path)
        peer = Peer(*await asyncio.open_unix_connection(path, limit=64 << 20))
        self.peers.append(peer)
        return peer

    async def connect_tcp(self) -> Peer:
        assert self.server.tcp_address is not None
        peer = Peer(*await asyncio.open_connection(*self.server.tcp_address))
        self.peers.append(peer)
        return peer

    async def until(self, condition: Any) -> None:
        async with asyncio.timeout(TIMEOUT_S):
            while not condition():  # noqa: ASYNC110 - nothing announces what happens inside the server
                await asyncio.sleep(0.005)


@contextlib.asynccontextmanager
async def running(folder: Path) -> AsyncIterator[Bench]:
    daemon = FakeDaemon()
    server = RpcServer(daemon, folder / "run" / "s.sock", tcp_port=0, token="open sesame")
    await server.start()
    bench = Bench(daemon, server)
    try:
        yield bench
    finally:
        for peer in bench.peers:
            await peer.close()
        await server.close()


def under_uvloop(folder: Path, scenario: Callable[[Bench], Coroutine[Any, Any, None]]) -> None:
    """Run a scenario on the loop that the daemon runs on."""

    async def run() -> None:
        async with running(folder) as bench:
            await scenario(bench)

    with asyncio.Runner(loop_factory=uvloop.new_event_loop) as runner:
        runner.run(run())
