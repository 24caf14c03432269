"""One client of the socket: lines in, replies and notifications out, and the bounds that keep it harmless."""

from __future__ import annotations

import asyncio
import contextlib
import hmac
import os
import select
import socket
import struct
from collections.abc import Coroutine
from typing import Any, cast

import structlog

from skygcs.rpc import dispatch
from skygcs.rpc import models as m
from skygcs.rpc.dispatch import InvalidParams, LimitExceeded, error_reply, parse
from skygcs.rpc.sessions import Sessions
from skygcs.rpc.subscriptions import Subscription

MAX_LINE_BYTES = 1 << 20
"""A request is a few hundred bytes, a full batch of the largest messages some 100 kB."""

MAX_LINE_BEFORE_AUTH_BYTES = 4096
AUTH_TIMEOUT_S = 5.0
"""A TCP client that does not say its token by then is closed."""

MAX_BATCH = 128
MAX_IN_FLIGHT = 64
"""Orders that one client waits for at the same time; one order to 250 vehicles is one of them."""

MAX_SUBSCRIPTIONS = 32
HIGH_WATER_BYTES = 256 * 1024
"""Beyond this much unread output a client gets no telemetry, and no further request of its own is read."""

MAX_OUTPUT_BYTES = 8 << 20
"""Beyond this much unread output it is closed. Replies of 1 MB (250 states) still fit several times."""

EMERGENCY_METHODS = frozenset(
    {
        "vehicles.stop",
        "vehicles.hold",
        "vehicles.land",
        "vehicles.rtl",
        "vehicles.disarm",
        "vehicles.list",
        "vehicles.get",
        "links.list",
        "daemon.info",
    }
)
"""What a connection may ask for that came when all places were taken: to end a flight, and to see what flies."""

WHILE_STOPPING = frozenset(
    {
        *("vehicles.stop", "vehicles.hold", "vehicles.land", "vehicles.rtl", "vehicles.disarm", "control.setpoint"),
        *("daemon.info", "vehicles.list", "vehicles.get", "messages.latest", "links.list", "events.recent"),
        *("undo.list", "recorder.status", "subscribe", "unsubscribe"),
    }
)
"""What is answered while the daemon ends, which takes 5 s at most: what ends a flight, and looking at how it ends."""

_log = structlog.get_logger(__name__)


class Session(asyncio.Protocol):
    """A connection. ``token`` is None where the socket's mode is the protection."""

    def __init__(self, hub: Sessions, token: str | None) -> None:
        self.daemon = hub.daemon
        self.tasks: set[asyncio.Task[None]] = set()
        self.authenticated = token is None
        self.restricted = False
        """Whether it came when all places were taken: one request, of EMERGENCY_METHODS, is answered."""
        self.used_at = hub.loop.time()
        """When its last whole line came."""
        self.writable = True
        self._hub = hub
        self._token = token
        self._transport: asyncio.Transport | None = None
        self._buffer = bytearray()
        self._scanned = 0
        self._skipping = False
        self._answered = False
        self._unread_since = 0.0
        self._in_flight = 0
        self._subscriptions: dict[int, Subscription] = {}
        self._next_subscription = 1
        self._deadline: asyncio.TimerHandle | None = None
        self._eof = False

    # -- asyncio.Protocol

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        transport = cast(asyncio.Transport, transport)  # uvloop's is one in all but its class
        hub = self._hub
        self._transport = transport
        transport.set_write_buffer_limits(high=HIGH_WATER_BYTES)
        hub.counters["connections"] += 1
        hub.admit(self)
        if not self.authenticated:
            self.close_after(AUTH_TIMEOUT_S)

    def connection_lost(self, exc: Exception | None) -> None:
        self._end()

    def data_received(self, data: bytes) -> None:
        if self._transport is None:
            return
        self._buffer += data
        self._hub.turns.add(self)

    def eof_received(self) -> bool:
        """The client sends no more. One that is still there (`echo … | nc -NU`) gets its answers, then it is closed;
        what one that is gone waits for is cancelled, unless it outlives it."""
        if self._transport is None or not self._peer_still_reads():
            return False
        self._eof = True
        if self._buffer and not self._buffer.endswith(b"\n"):
            self._buffer += b"\n"
        self._hub.turns.add(self)
        return True

    def pause_writing(self) -> None:
        self.writable = False
        self._unread_since = self._hub.loop.time()

    def resume_writing(self) -> None:
        self.writable = True
        for subscription in list(self._subscriptions.values()):
            subscription.flush()
        self._hub.feeds.resume()
        self._hub.turns.add(self)

    # -- the session as methods see it (Context) and as subscriptions see it (Sink)

    def write(self, data: bytes) -> None:
        transport = self._transport
        if transport is None:
            return
        transport.write(data)
        if transport.get_write_buffer_size() > MAX_OUTPUT_BYTES:
            self._hub.counters["closed_unread"] += 1
            _log.warning("rpc client closed: it does not read its replies", unread_bytes=MAX_OUTPUT_BYTES)
            transport.abort()
            self._end()

    def subscribe(self, params: m.SubscribeParams) -> int:
        if len(self._subscriptions) >= MAX_SUBSCRIPTIONS:
            raise LimitExceeded(f"at most {MAX_SUBSCRIPTIONS} subscriptions per client; unsubscribe some")
        number = self._next_subscription
        self._subscriptions[number] = self._hub.feeds.add(self, number, params)
        self._next_subscription += 1
        return number

    def unsubscribe(self, number: int) -> None:
        subscription = self._subscriptions.pop(number, None)
        if subscription is None:
            have = ", ".join(map(str, self._subscriptions)) or "none"
            raise InvalidParams(("subscription", f"this client has no subscription {number}; it has: {have}"))
        self._hub.feeds.remove(subscription)

    def close(self) -> None:
        """Close; what was written still goes out, unless the client does not read."""
        if self._transport is not None:
            if self.writable:
                self._hub.close_in_time(self._transport)
            else:
                self._transport.abort()
        self._end()

    # -- its place (Sessions)

    @property
    def busy(self) -> bool:
        """Whether it waits for the outcome of what it asked for."""
        return bool(self.tasks)

    def idle_s(self, now: float) -> float:
        """For how long it has wanted nothing, nor taken what it subscribed to; 0 if it does."""
        if self.tasks:
            return 0.0
        if self._subscriptions:
            return now - self._unread_since if not self.writable else 0.0
        return now - self.used_at

    def close_after(self, seconds: float) -> None:
        """Close it then, unless a later call says otherwise or a request of it is answered first."""
        if self._deadline is not None:
            self._deadline.cancel()
        self._deadline = self._hub.loop.call_later(seconds, self._on_deadline)

    def keep(self) -> None:
        """Close it no more at a certain time."""
        if self._deadline is not None:
            self._deadline.cancel()

    def dismiss(self, reason: str) -> None:
        """Close it with an error that says why."""
        if self.writable:
            self._reply(error_reply(None, dispatch.LIMIT_EXCEEDED, reason))
        self.close()

    def peer_pid(self) -> int | None:
        """The process at the other end of a Unix socket."""
        sock = self._transport.get_extra_info("socket") if self._transport is not None else None
        if sock is None or sock.family != socket.AF_UNIX:
            return None
        with (
            contextlib.suppress(OSError),
            socket.socket(fileno=os.dup(sock.fileno())) as peer,
        ):  # uvloop's has no options
            credentials = peer.getsockopt(socket.SOL_SOCKET, socket.SO_PEERCRED, struct.calcsize("3i"))
            return int(struct.unpack("3i", credentials)[0])
        return None

    def _on_deadline(self) -> None:
        if not self.tasks:
            self.close()

    # -- lines

    def work(self) -> bool:
        """Work on one line that has come whole; whether there may be another one."""
        if not self.writable or self._answered or (line := self._next_line()) is None:
            self._pace_reading(more=False)
            self._close_if_idle()
            return False
        self.used_at = self._hub.loop.time()
        self._on_line(line)
        return self._transport is not None

    def hold_back(self) -> None:
        """Read no more of it before what has come is worked on."""
        self._pace_reading(more=True)

    def _pace_reading(self, *, more: bool) -> None:
        transport = self._transport
        if transport is None or transport.is_closing() or self._eof:
            return
        if more or not self.writable or self._answered:
            transport.pause_reading()
        elif not transport.is_reading():
            transport.resume_reading()

    def _next_line(self) -> bytes | None:
        """The next line within the length limit; longer ones are answered with an error and skipped."""
        limit = MAX_LINE_BYTES if self.authenticated else MAX_LINE_BEFORE_AUTH_BYTES
        buffer = self._buffer
        while self._transport is not None:
            end = buffer.find(b"\n", self._scanned)
            length = end if end >= 0 else len(buffer)
            if length > limit and not self._skipping:
                self._skipping = True
                self._hub.counters["lines_too_long"] += 1
                self._reply(error_reply(None, dispatch.INVALID_REQUEST, f"a line has at most {limit} bytes"))
                if not self.authenticated:
                    self._hang_up()
                    return None
            if end < 0:
                if self._skipping:
                    buffer.clear()
                self._scanned = len(buffer)
                return None
            line = bytes(buffer[:end])
            del buffer[: end + 1]
            self._scanned = 0
            if self._skipping:
                self._skipping = False
            elif line.strip():
                return line
        return None

    def _on_line(self, line: bytes) -> None:
        self._hub.counters["lines"] += 1
        try:
            request = parse(line)
        except ValueError as error:
            self._hub.counters["parse_errors"] += 1
            self._reply(error_reply(None, dispatch.PARSE_ERROR, f"not JSON: {error}"))
            if not self.authenticated:
                self._hang_up()
            return
        if not self.authenticated:
            self._authenticate(request)
        elif self._refused_for_now(request):
            pass
        elif type(request) is list:
            self._on_batch(request)
        else:
            reply = self._start(request)
            if isinstance(reply, bytes):
                self._reply(reply)
            elif reply is not None:
                self._run([reply], batch=False)

    def _refused_for_now(self, request: object) -> bool:
        """Whether this is not answered since all places are taken. A connection beyond them has one request."""
        if not self.restricted or self._hub.promote(self):
            return False
        self._answered = True
        method = request.get("method") if isinstance(request, dict) else None
        if isinstance(method, str) and method in EMERGENCY_METHODS:
            return False
        self._hub.counters["requests_refused"] += 1
        request_id = request.get("id") if isinstance(request, dict) else None
        if isinstance(request_id, bool) or not isinstance(request_id, str | int | float | None):
            request_id = None
        text = f"too many clients: {self._hub.why_restricted()}; one request for {', '.join(sorted(EMERGENCY_METHODS))}"
        self._reply(error_reply(request_id, dispatch.LIMIT_EXCEEDED, f"{text} is answered all the same"))
        return True

    def _start(self, request: object) -> dispatch.Reply:
        """Begin one request, unless the client already waits for too many."""
        if self._in_flight >= MAX_IN_FLIGHT:
            request_id = request.get("id") if isinstance(request, dict) else None
            text = f"{MAX_IN_FLIGHT} requests of this client are not finished yet"
            return error_reply(request_id, dispatch.LIMIT_EXCEEDED, text)
        self._hub.daemon.client_alive()
        if self._hub.daemon.stopping and isinstance(request, dict):
            method, request_id = request.get("method"), request.get("id")
            if isinstance(method, str) and method not in WHILE_STOPPING and isinstance(request_id, str | int | None):
                text = "skygcs is shutting down: it takes no further orders but those that end a flight"
                return error_reply(request_id, dispatch.REFUSED, text) if "id" in request else None
        reply = self._hub.dispatcher.start(self, request)
        if isinstance(reply, Coroutine):
            self._in_flight += 1
            if self._hub.dispatcher.outlives_client(request):
                return self._hub.outlive(reply)
        return reply

    def _on_batch(self, requests: list[Any]) -> None:
        if not requests:
            return self._reply(error_reply(None, dispatch.INVALID_REQUEST, "a batch is not empty"))
        if len(requests) > MAX_BATCH:
            text = f"a batch has at most {MAX_BATCH} requests, this one {len(requests)}"
            return self._reply(error_reply(None, dispatch.LIMIT_EXCEEDED, text))
        replies: list[dispatch.Reply] = []
        size = 0
        for request in requests:
            reply = self._start(request)
            if isinstance(reply, bytes):
                size += len(reply)
                if size > MAX_OUTPUT_BYTES // 2:
                    request_id = request.get("id") if isinstance(request, dict) else None
                    text = f"the replies of this batch exceed {MAX_OUTPUT_BYTES // 2} bytes"
                    reply = error_reply(request_id, dispatch.LIMIT_EXCEEDED, text)
            replies.append(reply)
        if any(isinstance(reply, Coroutine) for reply in replies):
            self._run(replies, batch=True)
        else:
            self._reply(_joined([r for r in replies if isinstance(r, bytes)]))

    def _run(self, replies: list[dispatch.Reply], *, batch: bool) -> None:
        """Finish what takes time in a task of its own, which ends with the client at the latest.

        What a task of the hub does (`Sessions.outlive`) is only waited for here.
        """
        coroutines = [reply for reply in replies if isinstance(reply, Coroutine)]

        async def finish() -> None:
            if not batch:
                self._reply(await coroutines[0])
                return
            late = iter(await asyncio.gather(*coroutines))
            self._reply(_joined([next(late) if isinstance(r, Coroutine) else r or b"" for r in replies]))

        def on_done(task: asyncio.Task[None]) -> None:
            self.tasks.discard(task)
            self._in_flight -= len(coroutines)
            for coroutine in coroutines:
                coroutine.close()  # those of a task that was cancelled before it began
            if not task.cancelled() and (error := task.exception()) is not None:
                _log.error("rpc request failed", exc_info=error)
            self._close_if_idle()

        task = self._hub.loop.create_task(finish(), name="rpc request")
        self.tasks.add(task)
        task.add_done_callback(on_done)

    def _reply(self, reply: bytes) -> None:
        if reply:
            self.write(reply + b"\n")

    # -- TCP

    def _authenticate(self, request: object) -> None:
        """The first request, and the only one a client without the token gets: auth {"token": …}."""
        request_id = request.get("id") if isinstance(request, dict) else None
        token = None
        if isinstance(request, dict) and request.get("method") == "auth" and isinstance(request.get("params"), dict):
            token = request["params"].get("token")
        given = token.encode() if isinstance(token, str) else b""
        assert self._token is not None
        if not isinstance(request_id, str | int | None) or not hmac.compare_digest(given, self._token.encode()):
            self._hub.counters["auth_failures"] += 1
            text = "the token is wrong" if given else 'a token is wanted; the first request is: auth {"token": "…"}'
            self._reply(error_reply(None, dispatch.NOT_AUTHENTICATED, text))
            self._hang_up()
            return
        self.authenticated = True
        self.keep()
        self._reply(dispatch.result_reply(request_id, "auth", {"ok": True}))
        self._hub.admit(self)

    def _hang_up(self) -> None:
        """Close after what was written has gone out."""
        if self._transport is not None:
            self._hub.close_in_time(self._transport)
        self._end()

    # -- the end

    def _peer_still_reads(self) -> bool:
        """After an end of file: whether the client has only shut down its sending side.

        On a Unix socket poll tells (POLLHUP: both directions are shut); on TCP nothing does, so it counts as gone.
        """
        peer = self._transport.get_extra_info("socket") if self._transport is not None else None
        if peer is None or peer.family != socket.AF_UNIX:
            return False
        poll = select.poll()
        poll.register(peer.fileno(), 0)
        return not poll.poll(0)

    def _close_if_idle(self) -> None:
        """After the client's end of file, or its one request: close once nothing is left to answer or to tell."""
        if self._transport is None or self.tasks:
            return
        if self._answered or (self._eof and not (self._subscriptions or self._buffer)):
            self._hang_up()

    def _end(self) -> None:
        """Forget everything of this client. Its waiting calls are cancelled, except those that outlive it."""
        self._transport = None
        self.writable = False
        self._hub.remove(self)
        self.keep()
        subscriptions, self._subscriptions = self._subscriptions, {}
        for subscription in subscriptions.values():
            self._hub.feeds.remove(subscription)
        for task in self.tasks:
            task.cancel()
        self._buffer.clear()
        self._scanned = 0


def _joined(replies: list[bytes]) -> bytes:
    """A batch's reply; empty if all of it were notifications."""
    wanted = [reply for reply in replies if reply]
    return b"[" + b",".join(wanted) + b"]" if wanted else b""
