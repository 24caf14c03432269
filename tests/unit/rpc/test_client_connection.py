"""How a connection is opened, and what it makes of lines that come."""

from __future__ import annotations

import asyncio
import contextlib
import json
import math
import os
import pwd
import socket
from collections import Counter
from collections.abc import AsyncIterator, Iterator
from pathlib import Path
from typing import Any, cast
from unittest.mock import Mock

import pytest
from structlog.testing import capture_logs

from skygcs.errors import DaemonForbidden, DaemonUnreachable, RpcError
from skygcs.rpc import client_connection, client_peer
from skygcs.rpc.client_connection import ClientConnection, _Call, open_connection
from skygcs.rpc.client_inbox import MAX_WAITING, Encoded, Inbox, Latest, Newest, Queue
from skygcs.rpc.client_peer import ClientPeer
from skygcs.rpc.json_lines import MAX_LINE_BYTES
from skygcs.rpc.server import RpcServer
from support.fake_daemon import FakeDaemon
from support.table import each


async def test_a_request_that_the_daemon_would_not_read_is_refused_here_and_waits_for_nothing(tmp_path: Path) -> None:
    """The daemon skips a line that is too long, and its refusal names no request."""
    server = RpcServer(FakeDaemon(), tmp_path / "s.sock")
    await server.start()
    connection = await open_connection(str(server.socket_path))
    empty = len(json.dumps({"jsonrpc": "2.0", "id": 1, "method": "vehicles.get", "params": {"target": ""}}))
    with pytest.raises(RpcError, match=f"{MAX_LINE_BYTES + 1} bytes; the daemon takes"):
        await connection.request("vehicles.get", {"target": "x" * (MAX_LINE_BYTES + 1 - empty)})
    with pytest.raises(RpcError, match="the targets have more than"):  # one byte less is read
        await connection.request("vehicles.get", {"target": "x" * (MAX_LINE_BYTES - empty)}, encoded=True)
    assert not connection._calls
    assert not connection._encoded
    await connection.close()
    assert not connection.is_open
    await server.close()


@each("line", [b'{"jsonrpc": "2.0", "id": 1, "result": [1, 2]}', b'{"id":1,"result":[1,2],"jsonrpc":"2.0"}'])
def test_a_result_that_is_written_otherwise_is_read_as_json(line: bytes) -> None:
    connection = ClientConnection("a socket")
    connection._encoded.add(1)
    answers: list[Any] = []
    connection._calls[1] = _Call(lambda result, error: answers.append(result), "params.list", {})
    connection.data_received(line + b"\n")
    assert answers == [[1, 2]]


@each(
    "line",
    [
        b'{"jsonrpc":"2.0","method":"telemetry","params":{"state":{"sysid":1,"name":"a"},"subscription":7}}',
        b'{"jsonrpc":"2.0","method":"telemetry","params":{"state":{"name":"a"},"last":true,"subscription":7}}',
        b'{"jsonrpc":"2.0","method":"telemetry","params":{"state":{"name":"a"},"subscription":7,"more":1}}',
        b'{"jsonrpc": "2.0", "method": "telemetry", "params": {"state": {"name": "a"}, "subscription": 7}}',
    ],
)
def test_a_state_that_is_written_otherwise_is_read_as_json(line: bytes) -> None:
    connection = ClientConnection("a socket")
    inbox = connection.inboxes[7] = Encoded()
    connection.data_received(line + b"\n")
    state = json.loads(inbox._take()["states"]["a"])
    assert state["name"] == "a"


@each("address", ["/nonexistent/s.sock", "tcp://127.0.0.1:1", "tcp://nonsense"])
async def test_nobody_there_is_said_with_the_address(address: str) -> None:
    with pytest.raises(DaemonUnreachable, match="skygcs run") as error:
        await open_connection(address)
    assert error.value.address == address


async def test_a_socket_of_another_user_is_not_a_missing_daemon(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    socket = tmp_path / "other.sock"
    socket.touch()

    async def denied(*_: object, **__: object) -> None:
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr("skygcs.rpc.client_connection._connected_to", denied)
    owner = pwd.getpwuid(os.geteuid()).pw_name
    monkeypatch.setattr(os, "geteuid", lambda: os.getuid() + 1)
    with pytest.raises(DaemonForbidden) as caught:
        await open_connection(str(socket))
    assert f"{socket} belongs to {owner}" in str(caught.value) and "sudo -u" in str(caught.value)
    assert "no skygcs daemon" not in str(caught.value)


async def test_a_forbidden_socket_of_ones_own_is_said_with_the_systems_reason(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    async def denied(*_: object, **__: object) -> None:
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr("skygcs.rpc.client_connection._connected_to", denied)
    with pytest.raises(DaemonUnreachable, match="Permission denied"):
        await open_connection(str(tmp_path / "own.sock"))


class Liar(asyncio.Protocol):
    """Sends this to everything that comes, ``times`` over."""

    def __init__(self, sent: bytes, times: int) -> None:
        self._sent = sent
        self._times = times

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        self._transport = transport

    def data_received(self, data: bytes) -> None:
        assert isinstance(self._transport, asyncio.Transport)
        for _ in range(self._times):
            self._transport.write(self._sent)


@contextlib.asynccontextmanager
async def lied_to(path: Path, sent: bytes, times: int = 1) -> AsyncIterator[ClientConnection]:
    server = await asyncio.get_running_loop().create_unix_server(lambda: Liar(sent, times), path)
    connection = await open_connection(str(path))
    yield connection
    await connection.close()
    server.close()
    await server.wait_closed()


@each(
    "sent", [b"\xff\xfe\n", b"[]\n", b"17\n", b'{"method":"event"}\n', b'{"id":1,"error":3}\n', b"[" * 100_000 + b"\n"]
)
async def test_what_is_no_answer_ends_the_connection_and_nothing_else(sent: bytes, tmp_path: Path) -> None:
    async with lied_to(tmp_path / "s", sent) as connection:
        with pytest.raises(DaemonUnreachable, match="not an answer of skygcs"):
            await connection.request("daemon.info", {})


def test_the_whole_lines_before_one_without_end_are_read(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(client_connection, "MAX_REPLY_BYTES", 100)
    connection = ClientConnection("a socket")
    connection.transport = Mock(get_write_buffer_size=Mock(return_value=0))
    answers: list[Any] = []
    for number in (1, 2, 3):
        connection._calls[number] = _Call(lambda result, error: answers.append(result or error), "daemon.info", {})
    line = b'{"jsonrpc":"2.0","id":%d,"result":"%d"}\n'
    connection.data_received(line % (1, 1) + line % (2, 2) + b"x" * 101)
    assert answers[:2] == ["1", "2"] and isinstance(answers[2], DaemonUnreachable)
    assert not connection.is_open and len(connection._lines) == 0


def test_what_json_cannot_carry_is_not_sent() -> None:
    connection = ClientConnection("a socket")
    connection.transport = Mock(get_write_buffer_size=Mock(return_value=0))
    for send in (lambda p: connection.notify("x", p), lambda p: connection.start("x", p, lambda result, error: None)):
        with pytest.raises(ValueError, match="JSON"):
            send({"height_m": math.nan})
    connection.transport.write.assert_not_called()
    assert not connection._calls


async def test_a_line_without_end_is_not_kept(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(client_connection, "MAX_REPLY_BYTES", 100_000)
    async with lied_to(tmp_path / "s", b"x" * 10_000, 1000) as connection:
        with pytest.raises(DaemonUnreachable, match="without the end of a line"):
            await connection.request("daemon.info", {})


async def test_a_daemon_that_answers_or_reads_nothing_makes_its_client_keep_no_more(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    server = socket.socket(socket.AF_UNIX)
    server.bind(str(tmp_path / "s.sock"))
    server.listen()
    for bound, most in ("MAX_UNANSWERED", 7), ("MAX_UNSENT_BYTES", 1 << 20):
        with monkeypatch.context() as patch:
            patch.setattr(client_connection, bound, most)
            connection = await open_connection(str(tmp_path / "s.sock"))
            with pytest.raises(RpcError, match=r"vehicles.get is not sent: .* connect anew"):
                for _ in range(40):
                    connection.start("vehicles.get", {"target": "x" * 100_000}, Mock())
            assert (len(connection._calls) == 7) is (bound == "MAX_UNANSWERED")
            assert (unsent := connection.transport.get_write_buffer_size()) < 1_300_000
            connection.notify("unsubscribe", {"subscription": 1})  # else the daemon sends on when it reads again
            assert connection.transport.get_write_buffer_size() > unsent
            connection.transport.abort()
            await connection.close()
    server.close()


# -- What each kind of inbox keeps for a slow reader.


def state(name: str, alt_m: int) -> dict[str, Any]:
    return {"state": {"name": name, "alt_m": alt_m}}


async def taken(inbox: Inbox) -> list[dict[str, Any]]:
    """All that is there now."""
    return [await inbox.get() for _ in iter(lambda: bool(inbox), False)]


async def test_of_states_the_newest_of_each_vehicle_is_kept_and_who_waits_longest_comes_first() -> None:
    inbox = Latest()
    for update in (state("a", 1), state("b", 1), state("a", 2)):
        inbox.put(update)
    assert await taken(inbox) == [{"name": "a", "alt_m": 2}, {"name": "b", "alt_m": 1}]


async def test_encoded_states_come_together_with_the_newest_of_each_vehicle() -> None:
    inbox = Encoded()
    inbox.put_encoded(b'{"name":"a","alt_m":1}', False)
    inbox.put_encoded(b'{"alt_m":2,"name":"a"}', False)
    inbox.put(state("b", 3) | {"last": True})
    (update,) = await taken(inbox)
    assert update["complete"]
    assert {name: json.loads(text)["alt_m"] for name, text in update["states"].items()} == {"a": 2, "b": 3}


async def test_of_plans_only_the_newest_is_kept() -> None:
    inbox = Newest("plan")
    inbox.put({"plan": {"state": "ready"}})
    inbox.put({"plan": {"state": "flying"}})
    assert await taken(inbox) == [{"state": "flying"}]


async def test_a_queue_drops_the_oldest_and_counts_them_with_those_that_the_daemon_dropped() -> None:
    inbox = Queue("event")
    inbox.put({"event": {"n": 0}, "dropped": 5})
    for n in range(1, MAX_WAITING + 2):
        inbox.put({"event": {"n": n}})
    events = await taken(inbox)
    assert len(events) == MAX_WAITING
    assert events[0] == {"n": 2, "dropped": 7}
    assert events[1] == {"n": 3}


async def test_what_came_before_the_end_is_still_read_and_then_the_error_comes() -> None:
    inbox = Queue("event")
    waiting = asyncio.ensure_future(inbox.get())
    await asyncio.sleep(0)
    inbox.put({"event": {"n": 1}})
    inbox.put({"event": {"n": 2}})
    inbox.fail(RpcError(-1, "gone"))
    assert await waiting == {"n": 1}
    assert await inbox.get() == {"n": 2}
    with pytest.raises(RpcError, match="gone"):
        await inbox.get()


# -- A client of a socket of ours: what it sends is bounded, and what it does not read.


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
