"""The HTTP address that Prometheus scrapes: GET /metrics and nothing else, with bounds on all that a client can cause.

This module is light: its caller imports the collector and prometheus-client, beside the loop.
"""

from __future__ import annotations

import asyncio
import hmac
import importlib.util
import ipaddress
import socket
from collections.abc import Callable
from typing import Protocol

import structlog

from skygcs.config.allow_list import allow_list
from skygcs.config.metrics import MetricsConfig
from skygcs.descriptors import is_of_the_last
from skygcs.errors import LinkError, explain_address_error

MAX_CONNECTIONS = 8
"""Scrapers at one time; the oldest that has not sent its request gives way to a further one, else the oldest."""

MAX_REQUEST_BYTES = 8192
"""Request line and headers; Prometheus sends some 300 bytes."""

REQUEST_S = 5.0
"""Seconds for a client to send its request ..."""

ANSWER_S = 10.0
"""... and to take the answer: Prometheus gives up after 10 s as well (scrape_timeout)."""

FRESH_S = 1.0
"""An answer serves all requests of this time: more scrapers, or faster ones, cost nothing."""

CONTENT_TYPE = "text/plain; version=0.0.4; charset=utf-8"

_log = structlog.get_logger(__name__)


class Renders(Protocol):
    """Collector of the numbers."""

    async def render(self) -> bytes:
        """All of them as text, in short turns of the loop."""
        ...


class MetricsEndpoint:
    """One process'. `claim`, then `start`, then `close`. ``table`` of the fleet file has its settings."""

    def __init__(
        self, config: MetricsConfig, token: str | None, now: Callable[[], float], table: str = "metrics"
    ) -> None:
        self.address: tuple[str, int] | None = None
        """Where it listens; known after `claim`."""
        self._table = f"[{table}]"
        self._config = config
        self._token = None if token is None else token.encode()
        self._now = now
        self._listener: socket.socket | None = None
        self._server: asyncio.Server | None = None
        self._collector: Renders | None = None
        self._clients: dict[asyncio.Task[None], asyncio.StreamWriter] = {}
        self._asked: set[asyncio.Task[None]] = set()
        """Clients whose request has come."""
        self._rendering = asyncio.Lock()
        self._answer = b""
        self._answered_at = float("-inf")

    def claim(self) -> None:
        """Bind the address before anything else begins. Raises LinkError if it is taken, or prometheus-client is not
        installed."""
        if importlib.util.find_spec("prometheus_client") is None:
            raise LinkError(f"{self._table} needs prometheus-client: pip install 'skygcs[metrics]'")
        host, port = self._config.host, self._config.port
        listener = socket.socket(socket.AF_INET6 if ":" in host else socket.AF_INET, socket.SOCK_STREAM)
        try:
            listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            listener.bind((host, port))
            listener.setblocking(False)
        except OSError as error:
            listener.close()
            raise LinkError(
                f"{self._table}: cannot listen on {host}:{port}: {explain_address_error(error, host, port)}"
            ) from None
        self._listener = listener
        self.address = listener.getsockname()[:2]

    async def start(self, collector: Renders) -> None:
        """Listen. Raises LinkError if another process has begun to listen there."""
        assert self._listener is not None
        self._collector = collector
        try:
            self._server = await asyncio.start_server(self._accept, sock=self._listener, limit=MAX_REQUEST_BYTES)
        except OSError as error:
            raise LinkError(f"{self._table}: cannot listen on {self.address}: {error.strerror or error}") from None
        self._listener = None  # the server's now
        _log.info("metrics listening", address=self.address)

    async def close(self) -> None:
        """Stop listening and close all connections. Idempotent."""
        if self._listener is not None:
            self._listener.close()
            self._listener = None
        server, self._server = self._server, None
        if server is not None:
            server.close()
        clients = list(self._clients)
        for client in clients:
            client.cancel()
        await asyncio.gather(*clients, return_exceptions=True)

    # -- one connection

    def _accept(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        descriptor = writer.get_extra_info("socket").fileno()
        if self._server is None or is_of_the_last(descriptor):
            writer.transport.abort()
            return
        if len(self._clients) >= MAX_CONNECTIONS:
            oldest = next((client for client in self._clients if client not in self._asked), next(iter(self._clients)))
            oldest.cancel()
            self._forget(oldest)
        task = asyncio.get_running_loop().create_task(self._serve(reader, writer), name="metrics client")
        self._clients[task] = writer
        task.add_done_callback(self._forget)

    def _forget(self, client: asyncio.Task[None]) -> None:
        """Close the connection of a client that is served, or is not to be: one that was not begun closes nothing."""
        self._asked.discard(client)
        if (writer := self._clients.pop(client, None)) is not None:
            writer.transport.abort()

    async def _serve(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        """One request, one answer; a client that is slow or breaks off loses its connection."""
        try:
            try:
                async with asyncio.timeout(REQUEST_S):
                    request = await reader.readuntil(b"\r\n\r\n")
            except asyncio.LimitOverrunError:
                response = _response("431 Request Header Fields Too Large", b"the request is too long\n")
            else:
                if (task := asyncio.current_task()) in self._clients:
                    self._asked.add(task)
                response = await self._respond(request)
            async with asyncio.timeout(ANSWER_S):
                writer.write(response)
                await writer.drain()
                writer.close()
                await writer.wait_closed()
        except (TimeoutError, OSError, asyncio.IncompleteReadError):
            pass  # the client's loss; it may come again

    async def _respond(self, request: bytes) -> bytes:
        line, _, headers = request.partition(b"\r\n")
        words = line.split(b" ")
        if len(words) != 3 or not words[2].startswith(b"HTTP/1."):
            return _response("400 Bad Request", b"not a request of HTTP/1\n")
        refusal = self._host_refusal(headers)
        if refusal is not None:
            return _response("421 Misdirected Request", f"{refusal}\n".encode())
        method, path = words[0], words[1].partition(b"?")[0]
        if self._token is not None and not hmac.compare_digest(_bearer(headers), self._token):
            return _response("401 Unauthorized", b"a token is needed\n", ("WWW-Authenticate: Bearer",))
        if method not in (b"GET", b"HEAD"):
            return _response("405 Method Not Allowed", b"only GET\n", ("Allow: GET, HEAD",))
        if path != b"/metrics":
            return _response("404 Not Found", b"the metrics are at /metrics\n")
        response = _response("200 OK", await self._rendered(), content_type=CONTENT_TYPE)
        return response.partition(b"\r\n\r\n")[0] + b"\r\n\r\n" if method == b"HEAD" else response

    def _host_refusal(self, headers: bytes) -> str | None:
        """Why a request with this Host or Origin gets nothing: a page of another site, or a name that it had lead here
        (DNS rebinding), could read the numbers otherwise. Where every name leads here, only the token decides."""
        assert self.address is not None
        config = self._config
        if ipaddress.ip_address(config.host).is_unspecified and not config.names:
            return None
        allowed = allow_list(config.host, self.address[1], config.names, tls=False)
        host, origin = _header(headers, b"host"), _header(headers, b"origin")
        return allowed.refusal(host or None, origin or None, websocket=False)

    async def _rendered(self) -> bytes:
        """The numbers, at most FRESH_S old; one collection at a time."""
        async with self._rendering:
            if self._now() - self._answered_at >= FRESH_S:
                assert self._collector is not None
                self._answer = await self._collector.render()
                self._answered_at = self._now()
            return self._answer


def _bearer(headers: bytes) -> bytes:
    """The token of the Authorization header, or b""."""
    scheme, _, token = _header(headers, b"authorization").encode("latin-1").partition(b" ")
    return token.strip() if scheme.lower() == b"bearer" else b""


def _header(headers: bytes, wanted: bytes) -> str:
    """The value of the first header of this name, or ""."""
    for line in headers.split(b"\r\n"):
        name, _, value = line.partition(b":")
        if name.strip().lower() == wanted:
            return value.strip().decode("latin-1")
    return ""


def _response(
    status: str, body: bytes, headers: tuple[str, ...] = (), *, content_type: str = "text/plain; charset=utf-8"
) -> bytes:
    head = (
        f"HTTP/1.1 {status}",
        f"Content-Type: {content_type}",
        f"Content-Length: {len(body)}",
        "Connection: close",
        "X-Content-Type-Options: nosniff",
        *headers,
    )
    return "\r\n".join(head).encode() + b"\r\n\r\n" + body
