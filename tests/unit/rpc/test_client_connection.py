"""How a connection is opened, and what it makes of lines that come."""

from __future__ import annotations

import asyncio
import contextlib
import json
import math
import os
import pwd
import socket
from collections.abc import AsyncIterator
from pathlib import Path
from typing import Any
from unittest.mock import Mock

import pytest

from skygcs.errors import DaemonForbidden, DaemonUnreachable, RpcError
from skygcs.rpc import client_connection
from skygcs.rpc.client_connection import ClientConnection, _Call, open_connection
from skygcs.rpc.client_inbox import Encoded
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
            assert connection.transport.get_write_buffer_size() < 1_300_000
            connection.notify("unsubscribe", {"subscription": 1})
            connection.transport.abort()
            await connection.close()
    server.close()
