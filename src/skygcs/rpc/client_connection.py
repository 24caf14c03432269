"""A connection to a running daemon, over a Unix socket, TCP or TLS: requests find their answers, notifications the
subscription they belong to.

Lines of JSON-RPC both ways. Each request has a number and one answer; what the daemon sends besides carries the number
of its subscription. When the connection ends, everything that waits on it ends with the reason.
"""

from __future__ import annotations

import asyncio
import errno
import functools
import json
import os
import pwd
import re
import socket
from collections.abc import Callable, Mapping
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, NamedTuple, Protocol, Self, cast

from skygcs.errors import DaemonForbidden, DaemonUnreachable, RpcError
from skygcs.rpc.address import tcp_address
from skygcs.rpc.client_inbox import Encoded, Inbox
from skygcs.rpc.error_codes import INVALID_PARAMS, LIMIT_EXCEEDED
from skygcs.rpc.json_lines import (
    ANSWER,
    BEGUN,
    MAX_LINE_BYTES,
    MAX_REPLY_BYTES,
    OUTCOME,
    REPORT,
    TELEMETRY_START,
    LineBuffer,
    notification,
)

if TYPE_CHECKING:  # a client of the Unix socket needs no TLS
    import ssl

_OnAnswer = Callable[[Any, "RpcError | None"], None]

OnReport = Callable[[str, dict[str, Any]], None]
"""Gets the method and the parameters of each report (`skygcs.rpc.json_lines`) of a request that asked for them."""

CONNECT_WITHIN_S = 10.0
CONNECT_AGAIN_S = 0.01
"""A daemon takes connections every few milliseconds, 100 at a time."""

CLOSE_S = 1.0
"""Seconds for TLS to close the connection."""

MAX_UNANSWERED = 4096
"""Most requests without an answer; the daemon works on 64 of a client at a time."""

MAX_UNSENT_BYTES = 8 << 20
"""Most bytes that a daemon has not read: it stands still, or the way to it is cut. What waits longer is not wanted."""

MAX_NUMBER_CHARS = 20
"""Longest text of a subscription's number."""

PROGRESS = "plan.progress"
"""The notification that belongs to no subscription and no request."""

_TLS = "tls://"
_NO_MEMBERS: Mapping[str, Any] = MappingProxyType({})
_RESULT = re.compile(re.escape(ANSWER) + rb'(\d{1,20}),"result":')


class ClientTls(Protocol):
    """TLS with a daemon: how long its steps take, whom it admits, and words for what goes wrong."""

    @property
    def context(self) -> ssl.SSLContext: ...
    @property
    def handshake_s(self) -> float: ...
    @property
    def shutdown_s(self) -> float: ...
    @property
    def closed_early_hint(self) -> str:
        """Return what may be wrong if the other side closes before its first answer."""
        ...

    def is_pinned(self, transport: Any) -> bool:
        """True if the other side of a connection has shown the one certificate that is trusted."""
        ...

    def explain(self, error: OSError) -> str | None:
        """Why a handshake failed and what to do; None if ``error`` is not about TLS."""
        ...


async def open_connection(address: str, tls: ClientTls | None = None) -> ClientConnection:
    """Connect to a path, ``tcp://HOST:PORT`` or, with ``tls``, ``tls://HOST:PORT``. Raises DaemonUnreachable, and
    DaemonForbidden for another user's socket."""
    loop = asyncio.get_running_loop()
    try:
        if tls is not None:
            return await _connected_over_tls(address, tls)
        tcp = tcp_address(address)
        if tcp is not None:
            return (await loop.create_connection(lambda: ClientConnection(address), *tcp))[1]
        sock = await _connected_to(address)
        return (await loop.create_unix_connection(lambda: ClientConnection(address), sock=sock))[1]
    except ValueError as error:
        raise DaemonUnreachable(address, str(error)) from None
    except PermissionError as error:
        user = _owner_of(address)
        if user is not None:
            raise DaemonForbidden(address, user) from None
        raise DaemonUnreachable(address, os.strerror(error.errno or errno.EACCES)) from None
    except OSError as error:
        raise DaemonUnreachable(address, os.strerror(error.errno) if error.errno else str(error)) from None


class _Call(NamedTuple):
    """A request whose answer is due."""

    on_answer: _OnAnswer
    method: str
    params: Mapping[str, Any]


class ClientConnection(asyncio.Protocol):
    """An open connection to the daemon at ``address``; made by `open_connection`."""

    transport: asyncio.Transport

    def __init__(self, address: str, *, closed_early_hint: str = "") -> None:
        self.inboxes: dict[int, Inbox] = {}
        self.on_progress: Callable[[dict[str, Any]], None] | None = None
        """Receiver of the notifications plan.progress."""
        self._address = address
        self._closed_early_hint = closed_early_hint
        self._last_number = 0
        self._calls: dict[int, _Call] = {}
        """By number, requests whose answer is due."""
        self._reports: dict[int, OnReport] = {}
        """By number, those of them that asked for reports."""
        self._encoded: set[int] = set()
        """Requests whose result is not to be read."""
        self._lines = LineBuffer()
        self._heard = False
        self._closed = asyncio.Event()
        self._lost: DaemonUnreachable | None = None
        self._refused: RpcError | None = None

    @property
    def is_open(self) -> bool:
        """True if the connection is open, as far as is known here."""
        return self._lost is None

    def unanswered(self) -> list[tuple[str, Mapping[str, Any]]]:
        """Method and parameters of each request that was sent and has no answer yet, also if it is no longer waited
        for here."""
        return [(call.method, call.params) for call in self._calls.values()]

    async def request(
        self,
        method: str,
        params: dict[str, Any],
        members: Mapping[str, Any] = _NO_MEMBERS,
        *,
        encoded: bool = False,
        on_report: OnReport | None = None,
    ) -> Any:
        """The result of one request, sent with further ``members``. ``encoded``: as the bytes that came, if they came
        as expected, else read. ``on_report``: ask for reports, which come before the result. Raises RpcError,
        DaemonUnreachable, and ValueError for what JSON cannot carry."""
        future: asyncio.Future[Any] = asyncio.get_running_loop().create_future()

        def on_answer(result: Any, error: RpcError | None) -> None:
            if future.done():
                return
            if error is not None:
                future.set_exception(error)
            else:
                future.set_result(result)

        number = self.start(method, params, on_answer, members if on_report is None else {**members, REPORT: True})
        # before anything can have come
        if encoded:
            self._encoded.add(number)
        if on_report is not None:
            self._reports[number] = functools.partial(_report_to, future, on_report)
        try:
            return await future
        finally:
            self._encoded.discard(number)
            self._reports.pop(number, None)

    def start(
        self, method: str, params: dict[str, Any], on_answer: _OnAnswer, members: Mapping[str, Any] = _NO_MEMBERS
    ) -> int:
        """Send a request with further ``members``; ``on_answer(result, error)`` is called once. Returns its number.

        Raises RpcError for a request that is too long for the daemon, and while too much waits; DaemonUnreachable."""
        if self._lost is not None:
            raise self._lost
        if len(self._calls) >= MAX_UNANSWERED or self.transport.get_write_buffer_size() > MAX_UNSENT_BYTES:
            text = f"{method[:40]} is not sent: {self._address} does not answer what was sent before"
            raise RpcError(LIMIT_EXCEEDED, f"{text} ({len(self._calls)} requests); connect anew to send it now")
        number = self._last_number = self._last_number + 1
        request = {"jsonrpc": "2.0", "id": number, "method": method, "params": params, **members}
        line = _encoded(request)
        if len(line) > MAX_LINE_BYTES:  # its refusal names no request, which would wait for its answer for ever
            text = f"{method[:40]}: {len(line)} bytes; the daemon takes {MAX_LINE_BYTES} in one request"
            raise RpcError(INVALID_PARAMS, text)
        self._calls[number] = _Call(on_answer, method, params)
        self.transport.write(line + b"\n")
        return number

    def notify(self, method: str, params: dict[str, Any]) -> None:
        """Send what has no answer, also while too much waits: the end of a subscription, which would go on without.
        Nothing if the connection has ended. Raises ValueError for what JSON lacks."""
        if self._lost is None:
            self.transport.write(notification(method, _encoded(params)) + b"\n")

    async def close(self) -> None:
        """Close; requests and iterations still waiting end with DaemonUnreachable."""
        self.transport.close()
        self._lose("closed here")
        if self._address.startswith(_TLS):  # the other side may not answer the end of TLS
            try:
                async with asyncio.timeout(CLOSE_S):
                    await self._closed.wait()
            except TimeoutError:
                self.transport.abort()

    # -- what asyncio calls

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        transport = cast(asyncio.Transport, transport)  # uvloop's is one in all but its class
        self.transport = transport

    def data_received(self, data: bytes) -> None:
        self._heard = True
        self._lines.feed(data)
        lines = self._lines.take_whole().split(b"\n")
        for line in lines:
            if line and self._lost is None and not self._on_encoded(line) and not self._on_encoded_result(line):
                try:
                    self._on_answer(json.loads(line))
                except (ValueError, TypeError, KeyError, AttributeError, RecursionError) as error:
                    self._give_up(f"what it sent is not an answer of skygcs ({type(error).__name__})")
        if len(self._lines) > MAX_REPLY_BYTES:  # after the whole lines that came before it
            self._give_up(f"it sent more than {MAX_REPLY_BYTES >> 20} MiB without the end of a line")

    def _give_up(self, reason: str) -> None:
        """Close the connection because of what came."""
        self._lines.clear()
        self._lose(reason)
        self.transport.abort()

    def _on_encoded(self, line: bytes) -> bool:
        """True for a state that goes on as it is. Anything written otherwise than here expected is read as JSON."""
        if not line.startswith(TELEMETRY_START):
            return False
        state, _, tail = line.rpartition(b',"subscription":')
        number, comma, last = tail.removesuffix(b"}}").partition(b",")
        inbox = self.inboxes.get(int(number)) if number.isdigit() and len(number) < MAX_NUMBER_CHARS else None
        if not isinstance(inbox, Encoded) or not state.endswith(b"}") or (comma and last != b'"last":true'):
            return False
        inbox.put_encoded(state[len(TELEMETRY_START) :], bool(comma))
        return True

    def _on_encoded_result(self, line: bytes) -> bool:
        """True for a result that goes on as it is; an error, and anything written otherwise, is read as JSON."""
        begin = _RESULT.match(line) if self._encoded else None
        if begin is None or (number := int(begin[1])) not in self._encoded or not line.endswith(b"}"):
            return False
        call = self._calls.pop(number, None)
        if call is not None:
            call.on_answer(line[begin.end() : -1], None)
        return True

    def connection_lost(self, exc: Exception | None) -> None:
        reason = "it closed the connection"
        if self._address.startswith(_TLS) and not self._heard:  # asyncio's server closes without an alert
            reason += f" before its first answer: {self._closed_early_hint}"
        self._lose(reason)
        self._closed.set()

    def _lose(self, reason: str) -> None:
        """End every waiting call and subscription with the reason. Idempotent."""
        if self._lost is None:
            self._lost = DaemonUnreachable(self._address, reason)
        error = self._refused or self._lost
        calls, self._calls = self._calls, {}
        for call in calls.values():
            call.on_answer(None, error)
        for inbox in self.inboxes.values():
            inbox.fail(error)
        self.inboxes.clear()

    def _on_answer(self, answer: dict[str, Any]) -> None:
        if "method" in answer:
            params = answer["params"]
            if answer["method"] in (BEGUN, OUTCOME):
                on_report = self._reports.get(params["request"])
                if on_report is not None:
                    on_report(answer["method"], params)
                return
            if answer["method"] == PROGRESS:
                if self.on_progress is not None:
                    self.on_progress(params)
                return
            inbox = self.inboxes.get(params["subscription"])
            if inbox is not None:
                inbox.put(params)
            return
        error = answer.get("error")
        failure = None if error is None else RpcError(error["code"], error["message"], error.get("data"))
        number = answer.get("id")
        if number is None:
            self._refused = failure  # not about one call: "too many clients", a wrong token; the end follows
            return
        call = self._calls.pop(number, None)
        if call is not None:
            call.on_answer(answer.get("result"), failure)


def _encoded(value: object) -> bytes:
    """The one encoder of what a client sends. Raises ValueError for NaN and Infinity, which JSON lacks."""
    return json.dumps(value, allow_nan=False).encode()


def _report_to(future: asyncio.Future[Any], on_report: OnReport, method: str, params: dict[str, Any]) -> None:
    """Pass a report on; what the caller's function raises ends its request, and not the connection."""
    try:
        on_report(method, params)
    except Exception as error:
        if not future.done():
            future.set_exception(error)


class Subscription:
    """Subscription that `Client.telemetry`, `events`, `messages` and `plan` return: to be iterated over with ``async
    for``.

    Subscribed from the moment it is made until `close`, or until nobody holds it any more. The iteration raises
    RpcError if the daemon refused it, DaemonUnreachable if the daemon goes away.
    """

    def __init__(self, connection: ClientConnection, params: dict[str, Any], inbox: Inbox) -> None:
        self._inbox = inbox
        self._connection = connection
        self._state = state = _SubscriptionState(connection, inbox)
        connection.start("subscribe", params, state.on_answer)

    def __aiter__(self) -> Self:
        return self

    async def __anext__(self) -> dict[str, Any]:
        return await self._inbox.get()

    def close(self) -> None:
        """Unsubscribe. Idempotent."""
        self._state.close()

    def __del__(self) -> None:
        self._state.close()


class _SubscriptionState:
    """Apart from `Subscription`, so that the answer still due does not keep an abandoned one alive."""

    def __init__(self, connection: ClientConnection, inbox: Inbox) -> None:
        self._connection = connection
        self._inbox = inbox
        self._number: int | None = None
        self._closed = False

    def on_answer(self, result: Any, error: RpcError | None) -> None:
        """Called before the next line is read: the first notification may be in the same packet."""
        if error is not None:
            self._inbox.fail(error)
            return
        number: int = result["subscription"]
        if self._closed:
            self._connection.notify("unsubscribe", {"subscription": number})
        else:
            self._number = number
            self._connection.inboxes[number] = self._inbox

    def close(self) -> None:
        self._closed = True
        number, self._number = self._number, None
        if number is not None and self._connection.inboxes.pop(number, None) is not None:
            self._connection.notify("unsubscribe", {"subscription": number})


async def _connected_over_tls(address: str, tls: ClientTls) -> ClientConnection:
    """A connection to the holder of the pinned certificate. Raises DaemonUnreachable, OSError."""
    host, _, port = address.removeprefix(_TLS).rpartition(":")
    try:
        transport, connection = await asyncio.get_running_loop().create_connection(
            lambda: ClientConnection(address, closed_early_hint=tls.closed_early_hint),
            host,
            int(port),
            ssl=tls.context,
            ssl_handshake_timeout=tls.handshake_s,
            ssl_shutdown_timeout=tls.shutdown_s,
        )
    except OSError as error:
        if (reason := tls.explain(error)) is not None:
            raise DaemonUnreachable(address, reason) from None
        raise
    if not tls.is_pinned(transport):
        transport.abort()
        raise DaemonUnreachable(address, "it shows a certificate that the pinned one has issued, not that one itself")
    return connection


async def _connected_to(path: str) -> socket.socket:
    """A Unix socket connected to the daemon's. Its queue of connections may be full for a moment, which
    asyncio mistakes for a connection in progress. Raises OSError."""
    loop = asyncio.get_running_loop()
    deadline = loop.time() + CONNECT_WITHIN_S
    sock = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
    try:
        sock.setblocking(False)
        while True:
            try:
                sock.connect(path)
            except BlockingIOError:
                if loop.time() > deadline:
                    raise
                await asyncio.sleep(CONNECT_AGAIN_S)
            else:
                return sock
    except BaseException:
        sock.close()
        raise


def _owner_of(address: str) -> str | None:
    """The other user that a socket, or the folder that hides it, belongs to; None if it is the caller's own."""
    path = Path(address)
    for place in (path, *path.parents):
        try:
            uid = place.stat().st_uid
        except OSError:
            continue  # hidden by a folder above
        if uid == os.geteuid():
            return None
        try:
            return pwd.getpwuid(uid).pw_name
        except KeyError:
            return f"user {uid}"
    return None
