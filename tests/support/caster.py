"""NTRIP casters to test with: sound ones of both revisions, and such as nobody wants to meet."""

from __future__ import annotations

import asyncio
import contextlib
import ssl
from collections.abc import Awaitable, Callable, Sequence
from typing import Self

Conduct = Callable[["Client"], Awaitable[None]]
"""How a caster treats one client after its request; the connection ends when it returns."""


class Client:
    """One connection of a client. ``request``: its head; ``lines``: what it sent after that."""

    def __init__(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        self.request = b""
        self.lines: list[bytes] = []
        self.at = asyncio.get_running_loop().time()
        self._reader, self._writer = reader, writer

    async def send(self, data: bytes, *, piece: int = 0) -> None:
        """Send it, in pieces of so many bytes; 0: as one."""
        for at in range(0, len(data), piece or max(len(data), 1)):
            self._writer.write(data[at : at + (piece or len(data))])
            await self._writer.drain()
            if piece:
                await asyncio.sleep(0)

    async def read(self) -> None:
        """Its request, up to the empty line."""
        with contextlib.suppress(asyncio.IncompleteReadError, ConnectionError):
            self.request = await self._reader.readuntil(b"\r\n\r\n")

    async def collect(self) -> None:
        """Lines after the request."""
        with contextlib.suppress(ConnectionError):
            while line := await self._reader.readline():
                self.lines.append(line)


class Caster:
    """Listens on the loopback. The first client gets the first conduct, the last conduct is for all that follow."""

    def __init__(self, *conducts: Conduct, tls: ssl.SSLContext | None = None) -> None:
        self.clients: list[Client] = []
        self.port = 0
        self._conducts = list(conducts)
        self._tls = tls
        self._server: asyncio.Server | None = None
        self._tasks: set[asyncio.Task[None]] = set()

    async def __aenter__(self) -> Self:
        self._server = await asyncio.start_server(self._serve, "127.0.0.1", 0, ssl=self._tls)
        self.port = self._server.sockets[0].getsockname()[1]
        return self

    async def __aexit__(self, *_: object) -> None:
        assert self._server is not None
        self._server.close()
        for task in self._tasks:
            task.cancel()
        await asyncio.gather(*self._tasks, return_exceptions=True)

    async def _serve(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        task = asyncio.current_task()
        assert task is not None
        self._tasks.add(task)
        client = Client(reader, writer)
        self.clients.append(client)
        conduct = self._conducts.pop(0) if len(self._conducts) > 1 else self._conducts[0]
        collecting: asyncio.Task[None] | None = None
        try:
            await client.read()
            collecting = asyncio.create_task(client.collect())
            await conduct(client)
        except ConnectionError:
            pass
        finally:
            if collecting is not None:
                collecting.cancel()
            writer.transport.abort()
            self._tasks.discard(task)


ICY = b"ICY 200 OK\r\n\r\n"
HTTP = b"HTTP/1.1 200 OK\r\nNtrip-Version: Ntrip/2.0\r\nContent-Type: gnss/data\r\nConnection: close\r\n"
TABLE = (
    b"CAS;caster.example;2101;Example;ops;0;DEU;50;8\r\n"
    b"STR;MOUNT1;Town;RTCM 3.2;1005(10),1077(1);2;GPS;NET;DEU;50;8;0;0;x;none;B;N;1000;\r\n"
    b"STR;VRS;Land;RTCM 3.2;1005(10),1077(1);2;GPS;NET;DEU;50;8;1;1;x;none;B;N;1000;\r\n"
    b"ENDSOURCETABLE\r\n"
)


def chunked(data: bytes, size: int = 500) -> bytes:
    """The data as chunks of so many bytes, without the last, empty one."""
    pieces = [data[at : at + size] for at in range(0, len(data), size)]
    return b"".join(b"%X\r\n%s\r\n" % (len(piece), piece) for piece in pieces)


def says(answer: bytes, *, then_s: float = 0.0) -> Conduct:
    """Answers so, and closes the connection after a while."""

    async def conduct(client: Client) -> None:
        await client.send(answer)
        await asyncio.sleep(then_s)

    return conduct


def streams(epochs: Sequence[bytes], *, revision: int = 1, piece: int = 0, then_s: float = 0.0) -> Conduct:
    """Sends one of these each second, then nothing for ``then_s``."""

    async def conduct(client: Client) -> None:
        await client.send(ICY if revision == 1 else HTTP + b"Transfer-Encoding: chunked\r\n\r\n", piece=piece)
        for epoch in epochs:
            await client.send(epoch if revision == 1 else chunked(epoch), piece=piece)
            await asyncio.sleep(1.0)
        await asyncio.sleep(then_s)

    return conduct


def never_stops(begin: bytes, piece: bytes) -> Conduct:
    """Sends the beginning, and the piece as often as it is taken: a head, a line, a table without an end."""

    async def conduct(client: Client) -> None:
        await client.send(begin)
        while True:
            await client.send(piece)
            await asyncio.sleep(0.01)

    return conduct
