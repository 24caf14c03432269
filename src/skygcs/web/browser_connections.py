"""The connections of browsers, accepted one by one: bounded in number and time, with TLS or without.

    accepted    a place is free, or one without a cookie gave way   -> handshake with TLS, else HTTP
                all places belong to browsers with a cookie         -> closed
    handshake   done                                                -> HTTP
                not within UNKNOWN_S                                -> closed
    HTTP        no cookie UNKNOWN_S after it was accepted           -> closed
    HTTP        a browser has more than MAX_EACH, or those that     -> its or their oldest is closed, a WebSocket last
                may only look have more than MAX_VIEW

A connection has its place from the moment when it was accepted: one that never begins its handshake holds a descriptor,
too. A flood of them keeps nobody out who is signed in.
"""

from __future__ import annotations

import asyncio
import socket
import ssl
from collections.abc import Callable

import structlog
from aiohttp.web_protocol import RequestHandler

from skygcs.core.token_bucket import TokenBucket

MAX_CONNECTIONS = 128
"""A browser opens six and its WebSockets."""

MAX_EACH, MAX_VIEW = 16, 96
"""Connections of one browser, and of all that may only look: with a cookie a request may take as long as it likes, and
onlookers keep nobody out who may order."""

BACKLOG = 128

UNKNOWN_S = 5.0
"""Time for a new connection to show a cookie or a token."""

HANDSHAKES_PER_S, HANDSHAKE_BURST = 50.0, 150.0
"""Bounds of TLS handshakes, each 1 to 2 ms of the process: a flood of them must not hold up a page's STOP. Others wait
in the backlog."""

GOODBYE_S = 1.0
"""Seconds for the other side to close TLS."""

NO_HTTP_QUIET_S = 60.0
"""Between two lines of the log about what came that is no HTTP; those between are counted."""

NO_DESCRIPTORS_S = 0.5
"""Before the next attempt to accept, when the process has no descriptor left."""

_log = structlog.get_logger(__name__)


class _Place:
    """One connection. ``opening`` is its handshake, or done."""

    def __init__(self, handler: RequestHandler, at: float) -> None:
        self.handler = handler
        self.at = at
        self.browser: str | None = None
        """Identity of its browser, once it has sent a valid cookie."""
        self.may_order = False
        self.websocket = False
        self.opening: asyncio.Task[None] | None = None

    @property
    def closed(self) -> bool:
        return self.opening is not None and self.opening.done() and self.handler.transport is None

    def drop(self) -> None:
        """Close it at once, whatever it is at."""
        if self.opening is not None:
            self.opening.cancel()
        transport = self.handler.transport
        self.handler.force_close()
        if transport is not None:
            transport.abort()  # a close waits for the other side's end of TLS


class BrowserConnections:
    """At most ``limit`` of them. `run` accepts until it is cancelled; ``new_handler`` makes what serves HTTP on one."""

    def __init__(self, new_handler: Callable[[], RequestHandler], limit: int = MAX_CONNECTIONS) -> None:
        self.refused = 0
        """Those for which another one was closed, and those that were closed themselves."""
        self.no_http = 0
        """Requests that were no HTTP."""
        self._said_no_http = 0
        self._say_no_http = TokenBucket(1.0 / NO_HTTP_QUIET_S, 1.0, asyncio.get_running_loop().time())
        self._new_handler = new_handler
        self._limit = limit
        self._loop = asyncio.get_running_loop()
        self._places: dict[RequestHandler, _Place] = {}

    async def run(self, listener: socket.socket, tls: ssl.SSLContext | None) -> None:
        """Accept on a socket that listens."""
        handshakes = TokenBucket(HANDSHAKES_PER_S, HANDSHAKE_BURST, self._loop.time())
        try:
            while True:
                if tls is not None and not handshakes.take(self._loop.time()):
                    await asyncio.sleep(1.0 / HANDSHAKES_PER_S)
                    continue
                try:
                    sock, _ = await self._loop.sock_accept(listener)
                except OSError as error:
                    _log.warning("no connection can be accepted", reason=error.strerror)
                    await asyncio.sleep(NO_DESCRIPTORS_S)
                    continue
                place = self.admit(self._new_handler(), self._loop.time())
                if place is None:
                    sock.close()
                else:
                    place.opening = self._loop.create_task(self._open(place, sock, tls), name="connection of a browser")
                await asyncio.sleep(0)  # between two of a flood others have their turn
        finally:
            for place in list(self._places.values()):
                if place.opening is not None:
                    place.opening.cancel()

    async def _open(self, place: _Place, sock: socket.socket, tls: ssl.SSLContext | None) -> None:
        limits = {} if tls is None else {"ssl_handshake_timeout": UNKNOWN_S, "ssl_shutdown_timeout": GOODBYE_S}
        try:
            await self._loop.connect_accepted_socket(lambda: place.handler, sock, ssl=tls, **limits)
        except asyncio.CancelledError:
            sock.close()
            raise
        except (OSError, EOFError) as error:  # ssl.SSLError is an OSError
            sock.close()
            _log.debug("connection not opened", reason=str(error))

    def admit(self, handler: RequestHandler, now: float) -> _Place | None:
        """A place for a new connection; None if all are taken by known ones."""
        self._forget_closed()
        if len(self._places) >= self._limit:
            self.refused += 1
            oldest = next((place for place in self._places.values() if place.browser is None), None)
            if oldest is None:
                return None
            self._drop(oldest)
        place = self._places[handler] = _Place(handler, now)
        return place

    def know(self, handler: RequestHandler, browser: str, *, may_order: bool) -> bool:
        """The connection has sent a valid cookie of this browser; True for the first one."""
        place = self._places.get(handler)
        if place is None or place.browser is not None:
            return False
        place.browser, place.may_order = browser, may_order
        known = [p for p in self._places.values() if p.browser is not None and not p.closed]
        own = [p for p in known if p.browser == browser]
        onlookers = [p for p in known if not p.may_order]
        if len(own) > MAX_EACH:
            self.refused += 1
            self._drop(_least_needed(own))
        elif not may_order and len(onlookers) > MAX_VIEW:
            self.refused += 1
            self._drop(_least_needed(onlookers))
        return True

    def hold_websocket(self, handler: RequestHandler) -> None:
        """The connection becomes a WebSocket: a page, with its STOP. Others give way first."""
        place = self._places.get(handler)
        if place is not None:
            place.websocket = True

    def report_no_http(self, address: str, wrong: str) -> None:
        """Count what came from there and is no HTTP, and log it once in a while."""
        self.no_http += 1
        if self._say_no_http.take(self._loop.time()):
            count, self._said_no_http = self.no_http - self._said_no_http, self.no_http
            _log.warning("what came is no HTTP", address=address, wrong=wrong, count=count)

    def sweep(self, now: float) -> None:
        """Close those that have shown nothing for too long."""
        self._forget_closed()
        for place in [p for p in self._places.values() if p.browser is None and now - p.at > UNKNOWN_S]:
            self._drop(place)

    def _drop(self, place: _Place) -> None:
        self._places.pop(place.handler, None)
        place.drop()

    def _forget_closed(self) -> None:
        for place in [p for p in self._places.values() if p.closed]:
            del self._places[place.handler]


def _least_needed(places: list[_Place]) -> _Place:
    """The oldest that is no WebSocket; of WebSockets alone the oldest. ``places`` are from old to new."""
    return next((place for place in places if not place.websocket), places[0])
