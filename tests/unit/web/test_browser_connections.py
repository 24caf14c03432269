"""The places of browsers' connections."""

from __future__ import annotations

import asyncio
import contextlib
import socket
import ssl
from collections.abc import AsyncIterator
from typing import Any, cast

import pytest

from skygcs.web import browser_connections
from skygcs.web.browser_connections import MAX_CONNECTIONS, MAX_EACH, MAX_VIEW, UNKNOWN_S, BrowserConnections


class Handler(asyncio.Protocol):
    """As aiohttp's, of which only this is used."""

    def __init__(self) -> None:
        self.transport: Any = None
        self.closed = False

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        self.transport = transport

    def connection_lost(self, exc: Exception | None) -> None:
        self.force_close()

    def force_close(self) -> None:
        self.closed = True
        if self.transport is not None:
            self.transport.close()
            self.transport = None


class Serving:
    """Two places, and a listener on loopback."""

    def __init__(self) -> None:
        self.handlers: list[Handler] = []
        self.connections = BrowserConnections(cast(Any, self.new_handler), limit=2)
        self.listener = socket.create_server(("127.0.0.1", 0))
        self.listener.setblocking(False)
        self.peers: list[socket.socket] = []

    def new_handler(self) -> Handler:
        self.handlers.append(Handler())
        return self.handlers[-1]

    async def connect(self) -> Handler:
        """The handler of a new connection that got a place."""
        number = len(self.handlers)
        self.peers.append(socket.create_connection(self.listener.getsockname()))
        async with asyncio.timeout(20):
            while len(self.handlers) == number or self.handlers[number].transport is None:  # noqa: ASYNC110
                await asyncio.sleep(0.001)
        return self.handlers[number]

    async def connect_in_vain(self) -> None:
        """A new connection, and its end."""
        peer = socket.create_connection(self.listener.getsockname())
        self.peers.append(peer)
        assert await asyncio.to_thread(peer.recv, 1) == b""

    def know(self, handler: Handler, browser: str = "one", *, may_order: bool = True) -> None:
        self.connections.know(cast(Any, handler), browser, may_order=may_order)


@pytest.fixture
async def serving() -> AsyncIterator[Serving]:
    serving = Serving()
    task = asyncio.create_task(serving.connections.run(serving.listener, None))
    yield serving
    task.cancel()
    with contextlib.suppress(asyncio.CancelledError):
        await task
    for handler in serving.handlers:
        handler.force_close()
    for sock in (serving.listener, *serving.peers):
        sock.close()


async def test_one_without_a_cookie_gives_way_the_oldest_first_and_a_known_one_never(serving: Serving) -> None:
    known, unknown = await serving.connect(), await serving.connect()
    serving.know(known)
    newer = await serving.connect()
    assert (known.closed, unknown.closed, newer.closed) == (False, True, False)
    serving.know(newer)
    await serving.connect_in_vain()
    assert (known.closed, newer.closed, serving.connections.refused) == (False, False, 2)


async def test_a_browser_that_opens_more_than_its_share_loses_its_own_oldest(serving: Serving) -> None:
    serving.connections = BrowserConnections(cast(Any, serving.new_handler), limit=MAX_EACH + 2)
    other, *own = [Handler() for _ in range(MAX_EACH + 2)]
    for handler in (other, *own):
        assert serving.connections.admit(cast(Any, handler), 0.0) is not None
    serving.know(other, "other")
    for handler in own:
        serving.know(handler, "greedy")
        serving.know(handler, "greedy")  # each request shows the cookie
    assert [handler.closed for handler in own] == [True] + [False] * MAX_EACH
    assert not other.closed and serving.connections.refused == 1


@pytest.mark.parametrize("may_order", [True, False])
async def test_a_websocket_stays_while_requests_of_the_same_side_can_give_way(
    serving: Serving, may_order: bool
) -> None:
    """It is the oldest connection of its page, and carries its STOP."""
    most = MAX_EACH if may_order else MAX_VIEW
    connections = serving.connections = BrowserConnections(cast(Any, serving.new_handler))
    websocket, *requests = [Handler() for _ in range(most + 3)]
    for number, handler in enumerate((websocket, *requests)):
        connections.admit(cast(Any, handler), 0.0)
        serving.know(handler, "one" if may_order else f"browser {number // 2}", may_order=may_order)
        if handler is websocket:
            connections.hold_websocket(cast(Any, handler))
    assert not websocket.closed
    assert [handler.closed for handler in requests] == [True] * 3 + [False] * (most - 1)


async def test_of_websockets_alone_the_oldest_gives_way(serving: Serving) -> None:
    connections = serving.connections = BrowserConnections(cast(Any, serving.new_handler), limit=MAX_EACH + 2)
    handlers = [Handler() for _ in range(MAX_EACH + 1)]
    for handler in handlers:
        connections.admit(cast(Any, handler), 0.0)
        connections.hold_websocket(cast(Any, handler))
        serving.know(handler)
    assert [handler.closed for handler in handlers] == [True] + [False] * MAX_EACH


async def test_onlookers_leave_room_for_those_who_may_order(serving: Serving) -> None:
    connections = serving.connections = BrowserConnections(cast(Any, serving.new_handler))
    onlookers = [Handler() for _ in range(MAX_CONNECTIONS)]
    for number, handler in enumerate(onlookers):
        connections.admit(cast(Any, handler), 0.0)
        serving.know(handler, f"browser {number // 2}", may_order=False)
    assert sum(not handler.closed for handler in onlookers) == MAX_VIEW
    assert connections.admit(cast(Any, Handler()), 0.0) is not None


async def test_one_that_has_ended_leaves_its_place(serving: Serving) -> None:
    for handler in [await serving.connect(), await serving.connect()]:
        serving.know(handler)
        handler.force_close()
    await asyncio.sleep(0.01)
    assert not (await serving.connect()).closed
    assert serving.connections.refused == 0


async def test_one_that_shows_no_cookie_is_closed_in_time(serving: Serving) -> None:
    known, unknown = await serving.connect(), await serving.connect()
    serving.know(known)
    now = asyncio.get_running_loop().time()
    serving.connections.sweep(now + UNKNOWN_S - 1.0)
    assert not unknown.closed
    serving.connections.sweep(now + UNKNOWN_S + 0.1)
    assert unknown.closed and not known.closed


async def test_handshakes_begin_at_a_pace_however_many_come(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(browser_connections, "HANDSHAKES_PER_S", 1e-3)
    monkeypatch.setattr(browser_connections, "HANDSHAKE_BURST", 3.0)
    serving = Serving()
    tls = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    task = asyncio.create_task(serving.connections.run(serving.listener, tls))
    serving.peers += [socket.create_connection(serving.listener.getsockname()) for _ in range(20)]
    for _ in range(200):
        await asyncio.sleep(0.001)
    assert len(serving.handlers) == 3
    task.cancel()
    await asyncio.gather(task, return_exceptions=True)
    for sock in (serving.listener, *serving.peers):
        sock.close()
