"""Reading of one page's socket and of one connection: what is paced, and what is given up."""

from __future__ import annotations

import asyncio
import itertools
import re
from collections.abc import AsyncIterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from aiohttp import WSMessage, WSMsgType
from structlog.testing import capture_logs

from skygcs.config.allow_list import allow_list
from skygcs.web import http_server
from skygcs.web.browser_connections import NO_HTTP_QUIET_S
from skygcs.web.http_server import HttpServer, _read, cookie_value
from skygcs.web.paced_handler import Lane, pause_after_s
from skygcs.web.request_limits import READ_AHEAD_S, READ_MESSAGES_PER_S, PageLimits
from skygcs.web.sign_in import SignIn

pytestmark = pytest.mark.looptime

AHEAD = int(READ_AHEAD_S * READ_MESSAGES_PER_S)


class Socket:
    """A WebSocket with messages that have come already."""

    def __init__(self, messages: list[WSMessage]) -> None:
        self.messages, self.pongs = messages, 0

    async def __aiter__(self) -> AsyncIterator[WSMessage]:
        while self.messages:
            yield self.messages.pop(0)

    async def pong(self, _: bytes) -> None:
        self.pongs += 1
        raise ConnectionResetError  # it has left: its other messages are read yet


class Page:
    def __init__(self) -> None:
        self.read: list[str] = []
        self.closed = False
        self._limits = PageLimits(asyncio.get_running_loop().time())

    def on_message(self, text: str) -> None:
        self.read.append(text)
        self.closed = text == "the last"

    def pause_s(self, size: int) -> float:
        return self._limits.pause_s(size, asyncio.get_running_loop().time())


async def read(messages: list[WSMessage], *, left: bool = False) -> tuple[Socket, Page]:
    socket, page = Socket(messages), Page()
    request = SimpleNamespace(transport=None if left else object())
    await _read(socket, request, page)  # type: ignore[arg-type]
    return socket, page


def texts(*data: str) -> list[WSMessage]:
    return [WSMessage(WSMsgType.TEXT, each, "") for each in data]


async def test_a_ping_takes_as_much_of_a_pages_allowance_as_a_message() -> None:
    loop = asyncio.get_running_loop()
    began = loop.time()
    socket, page = await read([WSMessage(WSMsgType.PING, b"", "")] * (AHEAD + 400) + texts("stop"))
    assert socket.pongs == AHEAD + 400 and page.read == ["stop"]
    assert loop.time() - began > 400 / READ_MESSAGES_PER_S - 0.1  # of virtual time


async def test_of_a_page_that_has_left_its_last_orders_are_read_and_a_flood_is_given_up() -> None:
    _, page = await read(texts("goto", "stop"), left=True)
    assert page.read == ["goto", "stop"]
    socket, page = await read(texts(*["{}"] * 20_000), left=True)
    assert len(page.read) < 2 * AHEAD and socket.messages


async def test_nothing_more_of_a_page_that_was_closed_here_is_read() -> None:
    _, page = await read(texts("the last", "arm"))
    assert page.read == ["the last"]


@pytest.mark.parametrize(
    ("header", "value"),
    [("", ""), ("a=1", ""), ("a=1; own=x; b=2", "x"), ("own=of /ws;own=of /", "of /"), ("own", ""), ("own=a=b", "a=b")],
)
def test_the_last_cookie_of_a_name_counts(header: str, value: str) -> None:
    assert cookie_value(header, "own") == value


class Transport(asyncio.Transport):
    def __init__(self) -> None:
        super().__init__()
        self.closed, self.written = False, b""

    def write(self, data: Any) -> None:
        self.written += bytes(data)

    def writelines(self, data: Any) -> None:
        self.write(b"".join(data))

    def is_closing(self) -> bool:
        return self.closed

    def close(self) -> None:
        self.closed = True

    def pause_reading(self) -> None:
        pass

    abort, resume_reading = close, pause_reading


class Server:
    """An `HttpServer` without a listener."""

    def __init__(self, folder: Path) -> None:
        loop = asyncio.get_running_loop()
        self.sign_in = SignIn(lambda: "secret")
        allowed = allow_list("127.0.0.1", 8750, (), tls=False)
        self.http = HttpServer(
            SimpleNamespace(clients={}),  # type: ignore[arg-type]
            self.sign_in,
            allowed,
            clock=loop.time,
            on_sign_in=lambda: None,
            static=folder,
        )

    async def asked(self, lines: str, *, body: bytes = b"") -> tuple[Any, Transport]:
        """The connection of one request, a second later."""
        await self.http._runner.setup()
        handler, transport = self.http._new_handler(), Transport()
        self.http.connections.admit(handler, 0.0)
        handler.connection_made(transport)
        handler.data_received(f"GET / HTTP/1.1\r\nHost: 127.0.0.1:8750\r\n{lines}\r\n".encode() + body)
        await asyncio.sleep(1.0)
        return handler, transport


async def test_a_body_is_not_read_and_ends_its_connection(tmp_path: Path) -> None:
    """aiohttp reads the rest of one for ten seconds by default."""
    server = Server(tmp_path)
    for lines in ("Transfer-Encoding: chunked\r\n", "Content-Length: 99999999\r\n"):
        _, transport = await server.asked(lines, body=b"1\r\nx\r\n" * 100)
        assert re.match(rb"HTTP/1.1 403 ", transport.written) and transport.closed
    _, transport = await server.asked("")
    assert re.match(rb"HTTP/1.1 403 ", transport.written) and not transport.closed


async def test_who_may_order_shares_its_part_of_the_loop_with_nobody(tmp_path: Path) -> None:
    server, lanes = Server(tmp_path), list[Lane]()
    for role in (None, None, "view", "view", "command", "command"):
        cookie = ""
        if role is not None:
            value = server.sign_in.exchange(server.sign_in.issue(role, 0.0), 0.0, lambda: True)  # type: ignore[arg-type]
            cookie = f"Cookie: {server.http.cookie_name}={value}\r\n"
        handler, _ = await server.asked(cookie)
        lanes.append(handler.lane)
    unknown, unknown_2, view, view_2, command, command_2 = lanes
    assert unknown is unknown_2 and view is view_2
    assert len({id(lane) for lane in (unknown, view, command, command_2)}) == 4
    assert {lane.busy for lane in lanes} == {0}


@pytest.mark.parametrize("role", [None, "view", "command"])
async def test_requests_of_who_may_not_order_are_answered_by_what_they_cost(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, role: Any
) -> None:
    """A hundred connections of requests that are refused kept the stop of others for half a second."""
    clock = itertools.count()
    monkeypatch.setattr(http_server.time, "thread_time", lambda: next(clock) * 0.01)
    server, cookie = Server(tmp_path), ""
    if role is not None:
        value = server.sign_in.exchange(server.sign_in.issue(role, 0.0), 0.0, lambda: True)
        cookie = f"Cookie: {server.http.cookie_name}={value}\r\n"
    more = f"GET /map HTTP/1.1\r\nHost: 127.0.0.1:8750\r\n{cookie}\r\n".encode()
    _, transport = await server.asked(cookie, body=more * 30)
    answered = transport.written.count(b"HTTP/1.1 ")
    assert answered == 31 if role == "command" else answered <= 2 + 1.0 / pause_after_s(0.01)


@pytest.mark.parametrize(
    "request_line",
    [
        "GET /?token=secret HTTP/1.1\nX: y",
        "\x16\x03\x01",
        "GET /?token=secret HTTP/9.9",
        "GET /?token=secret\x00 HTTP/1.1",
    ],
)
async def test_what_is_no_http_is_counted_and_its_bytes_stand_in_no_log(
    tmp_path: Path, request_line: str, caplog: pytest.LogCaptureFixture
) -> None:
    """aiohttp logs a traceback that quotes the line, with the token of a page that is still to be opened."""
    server = Server(tmp_path)
    await server.http._runner.setup()
    with capture_logs() as lines:
        for _ in range(50):
            handler, transport = server.http._new_handler(), Transport()
            handler.connection_made(transport)
            handler.data_received(f"{request_line}\r\nHost: 127.0.0.1:8750\r\n\r\n".encode())
            await asyncio.sleep(0.1)
            assert re.match(rb"HTTP/1.0 400 ", transport.written) and transport.closed
        await asyncio.sleep(NO_HTTP_QUIET_S)
        server.http.connections.report_no_http("127.0.0.1", "BadStatusLine")
    assert server.http.connections.no_http == 51
    assert [line["count"] for line in lines] == [1, 50]
    assert not caplog.records and "secret" not in str(lines)


async def test_a_fault_of_ours_is_logged_with_its_place(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    server = Server(tmp_path)
    server.http._assets = None  # type: ignore[assignment]
    value = server.sign_in.exchange(server.sign_in.issue("view", 0.0), 0.0, lambda: True)
    _, transport = await server.asked(f"Cookie: {server.http.cookie_name}={value}\r\n")
    assert re.match(rb"HTTP/1.1 500 ", transport.written)
    assert "AttributeError" in caplog.text and server.http.connections.no_http == 0
