"""The connection of a browser, read in pieces: no page takes the loop from the others, whatever its frames are.

One read of a socket returns up to 256 KiB, which is 40,000 empty pings. aiohttp handles all of it in one turn, and
answers pings and joins fragments before any limit of ours applies. So the data is given to aiohttp in pieces, one a
turn, and the pause before the next piece depends on the CPU time of this one. A frame of six bytes costs as much as a
large one; a long message costs little.

Connections of browsers that are not signed in share one lane, those that may only look another one: a hundred of them
together take no more of the loop than one does. Who may order has a lane for each connection.

aiohttp's own holds (`_reading_paused`, `_buffer_paused`) are private, as are the arguments that its server gives a
connection. So pyproject.toml permits only the minor version of it that this was tried with.
"""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable
from typing import Any

from aiohttp.http_exceptions import HttpProcessingError
from aiohttp.web import BaseRequest, StreamResponse
from aiohttp.web_protocol import RequestHandler
from aiohttp.web_server import Server

from skygcs.core.token_bucket import TokenBucket

PIECE_BYTES = 4096
"""Some 700 empty frames, which take 2 ms to parse and 5 ms to answer."""

MOST_WAITING_BYTES = 1 << 20
"""Four reads of a socket. aiohttp may resume reading by itself; a browser does not send so much meanwhile."""

LAST_COST_S, LAST_SHARE = 0.025, 0.05
"""Cost of what waits at the end of its connection, given at once: several megabytes of text, 8,000 pings; and the share
of the loop for the ends of a lane's connections. Without one the first piece is given: a browser's last order."""

PAUSE_SHARE = 9.0
"""Pause by cost: one lane takes at most a third of the loop, with its answers."""

LONGEST_PAUSE_S = 0.25
"""A page's stop comes over the same connection, and waits no longer for what one message cost."""

SHORTEST_PAUSE_S = 0.001
"""Shorter ones add up until they are so long: asyncio's own loop makes any timer longer than this."""


def pause_after_s(cost_s: float) -> float:
    """Time for which no more of a page is read after what took ``cost_s`` of the loop.

    ``cost_s`` is CPU time of the thread: time of other processes, or while the machine stood still, is not counted.
    """
    return min(LONGEST_PAUSE_S, PAUSE_SHARE * cost_s)


class Lane:
    """Connections that share one part of the loop. ``busy``: how many have something to be taken, each of which waits
    for its turn behind the others."""

    def __init__(self, now: float) -> None:
        self.busy = 0
        self.ends = TokenBucket(LAST_SHARE, LAST_COST_S, now)
        """Seconds of what waits at the end of a connection."""

    def pause_after_s(self, cost_s: float) -> float:
        """`pause_after_s` of one of them."""
        return pause_after_s(cost_s) * max(1, self.busy)


class PacedHandler(RequestHandler):
    """aiohttp's protocol of one connection, in a ``lane`` until it joins another one. ``clock``: CPU time of this
    thread. ``on_no_http`` is called with the address and what is wrong when something else than HTTP comes."""

    def __init__(
        self,
        server: Server,
        lane: Lane,
        clock: Callable[[], float] = time.thread_time,
        on_no_http: Callable[[str, str], None] = lambda address, wrong: None,
    ) -> None:
        loop = asyncio.get_running_loop()
        super().__init__(server, loop=loop, **server._kwargs)
        self.lane = lane
        self._on_no_http = on_no_http
        self._busy = False
        """True if it counts as busy in its lane."""
        self._turns = loop
        self._clock = clock
        self._waits = bytearray()
        """Bytes that have come and are not given to aiohttp yet; no more are read meanwhile."""
        self._owed_s = 0.0
        """Pauses that were too short to be made yet."""
        self._next: asyncio.Handle | None = None

    def join(self, lane: Lane) -> None:
        """It is known now from which browser it comes."""
        self.lane.busy -= self._busy
        self.lane = lane
        self.lane.busy += self._busy

    def handle_error(
        self,
        request: BaseRequest,
        status: int = 500,
        exc: BaseException | None = None,
        message: str | None = None,
    ) -> StreamResponse:
        """Answer what cannot be served, and report what is no HTTP."""
        if isinstance(exc, HttpProcessingError):
            # by its class alone: aiohttp's text quotes the bytes that came, an address with its token among them
            self._on_no_http(str(request.remote), type(exc).__name__)
        return super().handle_error(request, status, exc, message)

    def log_exception(self, *what: Any, **how: Any) -> None:
        """Log a fault of ours with its traceback; malformed requests of clients are only counted."""
        if not isinstance(how.get("exc_info"), HttpProcessingError):
            super().log_exception(*what, **how)

    def data_received(self, data: bytes) -> None:
        """Take what has come. aiohttp calls it without data, to go on with what it holds."""
        if not data:
            super().data_received(data)
            return
        self._waits += data
        if len(self._waits) > MOST_WAITING_BYTES:
            self._abort()
        elif self._next is None:
            self._go_on()
        else:
            self._hold()
        self._count()

    def resume_reading(self, *how: Any, **more: Any) -> None:
        """aiohttp's reader takes more: first what waits here."""
        super().resume_reading(*how, **more)
        self._what_waits_first()

    def _resume_reading_for_buffer(self) -> None:
        """The same of its queue of requests, and of what came before a WebSocket had its reader."""
        super()._resume_reading_for_buffer()
        self._what_waits_first()

    def connection_lost(self, exc: BaseException | None) -> None:
        """Give what waits, within a bound, and end: over TLS a browser's end comes together with its last order."""
        if self._next is not None:
            self._next.cancel()
            self._next = None
        began, ends, now = self._clock(), self.lane.ends, self._turns.time()
        most_s = ends.saved(now)
        try:
            while self._waits:
                self._give_piece()
                if self._clock() - began >= most_s:
                    break
        finally:
            ends.spend(min(self._clock() - began, LAST_COST_S), now)
            self._waits.clear()
            self._count()
            super().connection_lost(exc)

    def _go_on(self) -> None:
        """Give a piece; read again once nothing waits."""
        self._next = None
        self._take_turn()
        self._count()

    def _take_turn(self) -> None:
        if self._is_held():
            self._hold()  # aiohttp will resume
        elif self._waits:
            began = self._clock()
            self._give_piece()
            self._owed_s += self.lane.pause_after_s(self._clock() - began)
            if self._waits:
                self._hold()
            if self._owed_s < SHORTEST_PAUSE_S:
                self._next = self._turns.call_soon(self._go_on)
            else:
                self._next = self._turns.call_later(self._owed_s, self._go_on)
                self._owed_s = 0.0
        elif self.transport is not None and not self.transport.is_closing():
            self.transport.resume_reading()

    def _give_piece(self) -> None:
        """Give the next piece. An exception of aiohttp ends the connection: in a timer the loop would only log it."""
        piece = bytes(self._waits[:PIECE_BYTES])
        del self._waits[:PIECE_BYTES]
        try:
            super().data_received(piece)
        except Exception:
            self._abort()
            raise

    def _count(self) -> None:
        busy = bool(self._waits) or self._next is not None
        self.lane.busy += busy - self._busy
        self._busy = busy

    def _is_held(self) -> bool:
        return self._reading_paused or self._buffer_paused

    def _what_waits_first(self) -> None:
        """After aiohttp has resumed the transport."""
        if self._waits or self._next is not None:
            self._hold()
        if self._waits and self._next is None:
            self._next = self._turns.call_soon(self._go_on)
        self._count()

    def _hold(self) -> None:
        if self.transport is not None and not self.transport.is_closing():
            self.transport.pause_reading()

    def _abort(self) -> None:
        self._waits.clear()
        self._count()
        if self.transport is not None:
            self.transport.abort()
