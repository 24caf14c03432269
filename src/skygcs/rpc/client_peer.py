"""A client of a socket of ours, with bounds on what it makes us keep: its lines, and the output that it does not read.

it sends a line beyond the limit          the line is skipped, and answered with an error
it does not read HIGH_WATER_BYTES         it is not ``writable``: its owner reads no further request of it, and
                                          sends it nothing that may be lost
it does not read MAX_OUTPUT_BYTES         it is closed
it sends no more, but reads               what came last is a line; its owner answers it, and closes it then
it has gone                               its owner ends it
"""

from __future__ import annotations

import asyncio
import contextlib
import os
import socket
import struct
from collections import Counter
from typing import Any, NamedTuple, cast

import structlog

from skygcs.rpc.address import still_reads
from skygcs.rpc.error_codes import INVALID_REQUEST
from skygcs.rpc.json_lines import LineBuffer, LineTooLong, notification
from skygcs.rpc.replies import encode, error_reply

HIGH_WATER_BYTES = 256 * 1024
"""Beyond this much unread output a client gets no telemetry, and no further request of its own is read."""

MAX_OUTPUT_BYTES = 8 << 20
"""Beyond this much unread output it is closed. Replies of 1 MB (250 states) still fit several times."""

_log = structlog.get_logger(__name__)


class Credentials(NamedTuple):
    """The process at the other end of a Unix socket, as the kernel knows it."""

    pid: int
    uid: int
    gid: int


class ClientPeer(asyncio.Protocol):
    """One connection. Its owner reads with `next_line` after `received`, and forgets the client in `end`."""

    def __init__(self, counters: Counter[str], name: str = "rpc client") -> None:
        """``counters``: those of its socket: lines_too_long, closed_unread. ``name``: of such a client, in the log."""
        self.writable = True
        self._counters = counters
        self._name = name
        self._transport: asyncio.Transport | None = None
        """None: it was not admitted yet, or has ended."""
        self._lines = LineBuffer()
        self._eof = False
        """True if it sends no more."""

    # -- for its owner

    def received(self) -> None:
        """Something has come, or nothing comes any more."""
        raise NotImplementedError

    def end(self) -> None:
        """Forget everything of this client. Idempotent."""
        raise NotImplementedError

    def too_long(self) -> None:
        """A line was too long, and was answered with an error."""

    def next_line(self, limit_bytes: int) -> bytes | None:
        """The next line within the limit, without its newline; None: none has come."""
        while self._transport is not None:
            try:
                return self._lines.take(limit_bytes)
            except LineTooLong as error:
                self._counters["lines_too_long"] += 1
                self.reply(error_reply(None, INVALID_REQUEST, str(error)))
                self.too_long()
        return None

    def pace_reading(self, *, wait: bool) -> None:
        """Read from it, or ``wait`` until what came is processed."""
        transport = self._transport
        if transport is None or transport.is_closing() or self._eof:
            return
        if wait or not self.writable:
            transport.pause_reading()
        elif not transport.is_reading():
            transport.resume_reading()

    # -- to the client

    def write(self, data: bytes) -> None:
        """Send whole lines; one that has not read MAX_OUTPUT_BYTES is closed."""
        transport = self._transport
        if transport is None or transport.is_closing():
            return
        transport.write(data)
        if transport.get_write_buffer_size() > MAX_OUTPUT_BYTES:
            self._counters["closed_unread"] += 1
            _log.warning(f"{self._name} closed: it does not read its replies", unread_bytes=MAX_OUTPUT_BYTES)
            transport.abort()
            self.end()

    def reply(self, reply: bytes) -> None:
        """Send a reply; nothing for an empty one."""
        if reply:
            self.write(reply + b"\n")

    def notify(self, method: str, params: dict[str, Any]) -> None:
        """Send a notification that may be lost: nothing to a client that does not read."""
        if self.writable:
            self.write(notification(method, encode(params)) + b"\n")

    # -- the other end

    @property
    def socket(self) -> socket.socket | None:
        """The socket of the connection; None: it has ended."""
        found: socket.socket | None = None if self._transport is None else self._transport.get_extra_info("socket")
        return found

    @property
    def credentials(self) -> Credentials | None:
        """Credentials of the process at the other end; None: it is no Unix socket, or the kernel does not say."""
        sock = self.socket
        if sock is None or sock.family != socket.AF_UNIX:
            return None
        # uvloop's socket has no options
        with contextlib.suppress(OSError), socket.socket(fileno=os.dup(sock.fileno())) as peer:
            return Credentials(*struct.unpack("3i", peer.getsockopt(socket.SOL_SOCKET, socket.SO_PEERCRED, 12)))
        return None

    @property
    def peer(self) -> str:
        """The program at the other end for people: its name and process, or its address; empty: not known."""
        found = self.credentials
        if found is None:
            address = None if self._transport is None else self._transport.get_extra_info("peername")
            return f"{address[0]}:{address[1]}" if isinstance(address, tuple) else ""
        if found.pid <= 0:
            return ""  # of another container
        try:
            with open(f"/proc/{found.pid}/comm", "rb") as file:
                name = file.read(64).decode(errors="replace").strip()
        except OSError:  # it has ended, or there is no /proc
            return f"pid {found.pid}"
        return f"{''.join(c if c.isprintable() else '?' for c in name)}, pid {found.pid}"

    # -- asyncio.Protocol

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        self._transport = cast(asyncio.Transport, transport)  # uvloop's is one in all but its class
        self._transport.set_write_buffer_limits(high=HIGH_WATER_BYTES)

    def data_received(self, data: bytes) -> None:
        if self._transport is not None:
            self._lines.feed(data)
            self.received()

    def eof_received(self) -> bool:
        """The client sends no more. One that is still there (`echo … | nc -NU`) gets its answers; what one that is gone
        waits for is cancelled, unless it outlives it."""
        if self._transport is None or not still_reads(self._transport):
            return False
        self._eof = True
        self._lines.end()
        self.received()
        return True

    def connection_lost(self, exc: Exception | None) -> None:
        self.end()
