"""The connection to the daemon of one client of the station socket.

The client's lines are passed to the daemon unchanged, and the daemon's lines to the client. The station inserts
requests of its own; their answers have an id that no client can guess, and are not passed to the client.
"""

from __future__ import annotations

import asyncio
import secrets
from collections.abc import Callable, Mapping
from typing import Any, Protocol, cast

from skygcs.errors import RpcError
from skygcs.rpc import error_codes
from skygcs.rpc.address import tcp_address
from skygcs.rpc.json_lines import ANSWER, BEGUN, MAX_REPLY_BYTES, OUTCOME, REPORT, LineBuffer, notification_start
from skygcs.rpc.replies import encode, parse

REACH_WITHIN_S = 2.0
"""A daemon that accepts no connection within this time counts as away."""

HIGH_WATER_BYTES = 256 * 1024
"""While the daemon has more than this to read, the client is not read."""

OnAnswer = Callable[[bytes | RpcError], bytes]
"""Called with the result of a request of the station; its own result is sent to the client in place of the answer."""

_REPORTS = tuple(notification_start(name, "request") for name in (BEGUN, OUTCOME))
"""How the daemon's lines begin that report a request."""


class RelayedClient(Protocol):
    """The part of a client that its connection to the daemon uses."""

    def on_daemon_lines(self, lines: bytes) -> None:
        """Whole lines for the client."""
        ...

    def on_daemon_full(self, full: bool) -> None:
        """True: the daemon does not read fast enough; False: it reads again."""
        ...

    def on_daemon_lost(self) -> None:
        """The connection has ended; open requests have ended with errors."""
        ...

    def end(self) -> None: ...


class RelayedDaemon(asyncio.Protocol):
    """`reach` once; `close` is idempotent. ``address``: a path or tcp://HOST:PORT; None: the station has no daemon."""

    def __init__(self, client: RelayedClient, address: str | None, token: str | None) -> None:
        self.full = False
        """True while the daemon does not read fast enough."""
        self._client = client
        self._address = address
        self._token = token
        self._transport: asyncio.Transport | None = None
        self._lines = LineBuffer()
        self._prefix = f'"{secrets.token_hex(8)}-'.encode()
        """Beginning of the ids of the station's own requests."""
        self._asked: dict[bytes, OnAnswer] = {}
        self._reported: dict[bytes, bytes] = {}
        """By the id of a request of the station, the id under which the client gets its reports."""
        self._last_id = 0

    @property
    def connected(self) -> bool:
        return self._transport is not None

    @property
    def absent(self) -> str:
        """Why there is no connection, for people."""
        where = "has no daemon" if self._address is None else f"reaches no daemon at {self._address}"
        return f"this station {where}: it shows and orders vehicles of other sites only (south/alpha, */all)"

    async def reach(self) -> bool:
        """Connect. False if the station has a daemon that does not answer."""
        if self._address is None:
            return True
        try:
            async with asyncio.timeout(REACH_WITHIN_S):
                await self._connect(self._address)
        except (OSError, TimeoutError, RpcError):
            self.close()
            return False
        return True

    async def _connect(self, address: str) -> None:
        """Raises OSError, and RpcError for a wrong token."""
        loop = asyncio.get_running_loop()
        tcp = tcp_address(address)
        if tcp is None:
            await loop.create_unix_connection(lambda: self, address)
        else:
            await loop.create_connection(lambda: self, *tcp)
        if tcp is not None and self._token is not None:
            await self.ask("auth", {"token": self._token})

    def close(self) -> None:
        """Close the connection, if there is one."""
        transport, self._transport = self._transport, None
        if transport is not None:
            transport.close()

    # -- to the daemon

    def write(self, line: bytes) -> bool:
        """Send a line of the client, without its newline; False without a connection."""
        if self._transport is None:
            return False
        self._transport.write(line + b"\n")
        return True

    def write_eof(self) -> None:
        """The client sends no more."""
        if self._transport is not None:
            self._transport.write_eof()

    async def ask(self, method: str, params: Mapping[str, Any], *, report_as: object = None, **members: Any) -> bytes:
        """Send a request of the station and return its result, as the daemon wrote it. ``members``: further members of
        the request. ``report_as``: the client gets its reports (`skygcs.rpc.json_lines`) with this id; None: it asks
        for none. Raises RpcError."""
        future: asyncio.Future[bytes] = asyncio.get_running_loop().create_future()

        def on_answer(result: bytes | RpcError) -> bytes:
            if not future.done():
                if isinstance(result, RpcError):
                    future.set_exception(result)
                else:
                    future.set_result(result)
            return b""

        if report_as is not None:
            members[REPORT] = True
        key = self.start_asking(method, params, members, on_answer)
        if report_as is None:
            return await future
        self._reported[key] = encode(report_as)
        try:
            return await future
        finally:
            del self._reported[key]

    def start_asking(
        self, method: str, params: Mapping[str, Any], members: Mapping[str, Any], on_answer: OnAnswer
    ) -> bytes:
        """Send a request of the station; returns its id as JSON. Raises RpcError without a connection."""
        if self._transport is None:
            raise RpcError(error_codes.NO_DAEMON, self.absent)
        self._last_id += 1
        key = self._prefix + f'{self._last_id}"'.encode()
        self._asked[key] = on_answer
        request = {"jsonrpc": "2.0", "id": key[1:-1].decode(), "method": method, "params": params, **members}
        self._transport.write(encode(request) + b"\n")
        return key

    def pause_answers(self) -> None:
        """Stop reading from the daemon, because the client does not read."""
        if self._transport is not None:
            self._transport.pause_reading()

    def resume_answers(self) -> None:
        if self._transport is not None:
            self._transport.resume_reading()

    # -- asyncio.Protocol: from the daemon

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        self._transport = cast(asyncio.Transport, transport)  # uvloop's is one in all but its class
        self._transport.set_write_buffer_limits(high=HIGH_WATER_BYTES)

    def data_received(self, data: bytes) -> None:
        self._lines.feed(data)
        if lines := self._lines.take_whole():
            self._pass_on(lines)
        if len(self._lines) > MAX_REPLY_BYTES:
            self._client.end()

    def connection_lost(self, exc: Exception | None) -> None:
        self._transport = None
        asked, self._asked = self._asked, {}
        for on_answer in asked.values():
            self._client.on_daemon_lines(
                on_answer(RpcError(error_codes.NO_DAEMON, f"the daemon at {self._address} has gone"))
            )
        self._client.on_daemon_lost()

    def pause_writing(self) -> None:
        self.full = True
        self._client.on_daemon_full(True)

    def resume_writing(self) -> None:
        self.full = False
        self._client.on_daemon_full(False)

    def _pass_on(self, lines: bytes) -> None:
        if self._asked and self._prefix in lines:
            lines = b"".join(self._for_client(line) for line in lines.splitlines(keepends=True))
        self._client.on_daemon_lines(lines)

    def _for_client(self, line: bytes) -> bytes:
        """The line for the client: reports of a request of the station carry the client's id."""
        begin = next((begin for begin in _REPORTS if line.startswith(begin + self._prefix)), None)
        if begin is None:
            return self._without_our_answer(line)
        end = line.index(b'"', len(begin) + 1) + 1
        client_id = self._reported.get(line[len(begin) : end])
        return b"" if client_id is None else begin + client_id + line[end:]

    def _without_our_answer(self, line: bytes) -> bytes:
        """The line for the client: an answer to a request of the station is replaced by the result of its callback."""
        if not line.startswith(ANSWER + self._prefix):
            return line
        key = line[len(ANSWER) : line.index(b'"', len(ANSWER) + 1) + 1]
        on_answer = self._asked.pop(key, None)
        if on_answer is None:
            return b""
        head = ANSWER + key + b',"result":'
        if line.startswith(head):
            return on_answer(line.rstrip()[len(head) : -1])
        error = parse(line).get("error") or {}
        code = error.get("code", error_codes.INTERNAL_ERROR)
        return on_answer(RpcError(code, str(error.get("message")), error.get("data")))
