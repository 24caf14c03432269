"""A client of a socket of ours: what it sends is bounded, and what it does not read."""

from __future__ import annotations

import json
import os
import socket
from collections import Counter
from collections.abc import Iterator
from typing import Any, cast

import pytest
from structlog.testing import capture_logs

from skygcs.rpc import client_peer
from skygcs.rpc.client_peer import ClientPeer

LIMIT = 40


class Transport:
    """A transport whose other side reads nothing by itself."""

    def __init__(self, sock: socket.socket) -> None:
        self.sock, self.written = sock, bytearray()
        self.high = 0
        self.reading, self.closing, self.aborted = True, False, False

    def set_write_buffer_limits(self, high: int) -> None:
        self.high = high

    def get_extra_info(self, name: str) -> Any:
        return {"socket": self.sock}[name]

    def get_write_buffer_size(self) -> int:
        return len(self.written)

    def write(self, data: bytes) -> None:
        self.written += data

    def is_closing(self) -> bool:
        return self.closing

    def is_reading(self) -> bool:
        return self.reading

    def pause_reading(self) -> None:
        self.reading = False

    def resume_reading(self) -> None:
        self.reading = True

    def abort(self) -> None:
        self.aborted = self.closing = True


class Client(ClientPeer):
    """Takes every line at once, unless it ``waits``."""

    def __init__(self, transport: Transport, name: str = "rpc client") -> None:
        super().__init__(Counter(), name)
        self.lines: list[bytes] = []
        self.waits = False
        self.ends = 0
        self.connection_made(cast(Any, transport))

    @property
    def counters(self) -> Counter[str]:
        return self._counters

    def received(self) -> None:
        while not self.waits and (line := self.next_line(LIMIT)) is not None:
            self.lines.append(line)
        self.pace_reading(wait=self.waits)

    def end(self) -> None:
        self.ends += 1
        self._transport = None


@pytest.fixture
def sockets() -> Iterator[tuple[socket.socket, socket.socket]]:
    ours, theirs = socket.socketpair()
    yield ours, theirs
    ours.close()
    theirs.close()


def test_a_line_beyond_the_limit_is_answered_once_and_skipped(sockets: tuple[socket.socket, socket.socket]) -> None:
    transport = Transport(sockets[0])
    client = Client(transport)
    for _ in range(10):
        client.data_received(b"x" * LIMIT)
        assert len(client._lines) <= LIMIT
    client.data_received(b"\nnext\n")
    assert client.lines == [b"next"] and client.counters["lines_too_long"] == 1
    (error,) = (json.loads(line)["error"] for line in transport.written.splitlines())
    assert error["message"] == f"a line has at most {LIMIT} bytes"


def test_one_that_does_not_read_is_closed_at_the_bound_and_written_to_no_more(
    sockets: tuple[socket.socket, socket.socket], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(client_peer, "MAX_OUTPUT_BYTES", 1000)
    transport = Transport(sockets[0])
    client = Client(transport)
    assert transport.high == client_peer.HIGH_WATER_BYTES
    for _ in range(100):
        client.reply(b"r" * 99)
    assert transport.aborted and client.ends == 1 and client.counters["closed_unread"] == 1
    assert len(transport.written) <= 1100


def test_one_that_does_not_read_gets_no_notification_and_is_not_read_from(
    sockets: tuple[socket.socket, socket.socket],
) -> None:
    transport = Transport(sockets[0])
    client = Client(transport)
    client.writable = False
    client.notify("event", {})
    client.data_received(b"a\n")
    assert (transport.written, transport.reading) == (b"", False)
    client.writable = True
    client.notify("event", {"kind": "mode"})
    client.data_received(b"b\n")
    assert json.loads(transport.written) == {"jsonrpc": "2.0", "method": "event", "params": {"kind": "mode"}}
    assert transport.reading


def test_the_log_names_the_socket_of_one_that_is_closed(
    sockets: tuple[socket.socket, socket.socket], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(client_peer, "MAX_OUTPUT_BYTES", 10)
    client = Client(Transport(sockets[0]), "client of the station")
    with capture_logs() as logs:
        client.reply(b"r" * 99)
    assert [log["event"] for log in logs] == ["client of the station closed: it does not read its replies"]


def test_its_owner_may_put_lines_off(sockets: tuple[socket.socket, socket.socket]) -> None:
    transport = Transport(sockets[0])
    client = Client(transport)
    client.waits = True
    client.data_received(b"a\nb\n")
    assert (client.lines, transport.reading) == ([], False)
    client.waits = False
    client.received()
    assert (client.lines, transport.reading) == ([b"a", b"b"], True)


def test_what_came_last_is_a_line_of_one_that_still_reads_only(sockets: tuple[socket.socket, socket.socket]) -> None:
    client = Client(Transport(sockets[0]))
    client.data_received(b"last")
    sockets[1].shutdown(socket.SHUT_WR)
    assert client.eof_received() and client.lines == [b"last"]
    gone = Client(Transport(sockets[0]))
    gone.data_received(b"last")
    sockets[1].close()
    assert not gone.eof_received() and gone.lines == []


def test_the_kernel_says_who_is_at_the_other_end(sockets: tuple[socket.socket, socket.socket]) -> None:
    client = Client(Transport(sockets[0]))
    assert client.credentials == (os.getpid(), os.getuid(), os.getgid())
    client.end()
    assert client.credentials is None
    with socket.socket(socket.AF_INET) as tcp:
        assert Client(Transport(tcp)).credentials is None
