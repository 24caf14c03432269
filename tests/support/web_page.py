"""A signed-in browser without a browser, and plain requests, for tests of `skygcs web` as a process."""

from __future__ import annotations

import contextlib
import json
import re
import socket
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from typing import Any

import aiohttp

from support.hanging import HANG_S
from support.web_station import WebStation


class WebPage:
    """A signed-in browser without a browser."""

    def __init__(self, session: aiohttp.ClientSession, station: WebStation) -> None:
        self.session = session
        self.station = station
        self.ws: aiohttp.ClientWebSocketResponse | None = None
        self.sockets: list[aiohttp.ClientWebSocketResponse] = []
        self.notices: list[dict[str, Any]] = []
        self._last = 0

    async def open(self) -> None:
        self.ws = await self.connect()

    async def connect(self) -> aiohttp.ClientWebSocketResponse:
        """One more WebSocket, closed with the page."""
        base = self.station.base
        self.sockets.append(await self.session.ws_connect(f"{base}/ws", origin=base, max_msg_size=0))
        return self.sockets[-1]

    async def next(self, within_s: float = 60.0) -> dict[str, Any]:
        assert self.ws is not None
        message = await self.ws.receive(timeout=within_s)
        assert message.type is aiohttp.WSMsgType.TEXT, message
        return dict(json.loads(message.data))

    async def call(self, method: str, /, deadline_s: float | None = None, **params: Any) -> dict[str, Any]:
        assert self.ws is not None
        self._last += 1
        request: dict[str, Any] = {"jsonrpc": "2.0", "id": self._last, "method": method, "params": params}
        if deadline_s is not None:
            request["deadline_s"] = deadline_s
        await self.ws.send_str(json.dumps(request))
        while (answer := await self.next()).get("id") != self._last:
            self.notices.append(answer)
        return answer

    async def order(self, method: str, /, **params: Any) -> dict[str, Any]:
        now_s = (await self.call("web.ping"))["result"]["now_s"]
        return await self.call(method, now_s + 3, **params)

    async def states(self, condition: Any) -> dict[str, Any]:
        """The first batch for which this holds."""
        while True:
            message = self.notices.pop(0) if self.notices else await self.next()
            if message.get("method") == "web.state" and condition(message["params"]):
                return dict(message["params"])


@asynccontextmanager
async def page_of(station: WebStation, role: Any = "command", *, ws: bool = True) -> AsyncIterator[WebPage]:
    async with aiohttp.ClientSession(cookie_jar=aiohttp.CookieJar(unsafe=True)) as session:
        async with session.get(station.address(role), allow_redirects=False) as answer:
            assert answer.status == 303
        page = WebPage(session, station)
        if ws:
            await page.open()
        try:
            yield page
        finally:
            for each in page.sockets:
                sock = each.get_extra_info("socket")
                await each.close()
                if sock is not None:  # megabytes that nobody reads would keep it open beyond the loop
                    with contextlib.suppress(OSError):
                        sock.shutdown(socket.SHUT_RDWR)


def raw(station: WebStation, request: str) -> str:
    """What a plain socket gets for these bytes."""
    with socket.create_connection(("127.0.0.1", station.port), timeout=HANG_S) as sock:
        sock.sendall(request.encode())
        received = b""
        while b"\r\n\r\n" not in received and (data := sock.recv(65536)):
            received += data
    return received.decode(errors="replace")


def status(answer: str) -> int:
    found = re.match(r"HTTP/1.[01] (\d+)", answer)
    assert found is not None, answer
    return int(found[1])
