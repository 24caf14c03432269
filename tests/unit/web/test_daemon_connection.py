"""The web process as a client of a daemon that is not there, does not answer, or comes later."""

from __future__ import annotations

import asyncio
import json
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any

import pytest

from skygcs.web import daemon_connection
from skygcs.web.daemon_connection import DaemonConnection
from skygcs.web.state_batches import LatestStates


class Pages:
    """One page that wants states, and what it is sent."""

    def __init__(self) -> None:
        self.wanted = asyncio.Event()
        self.woken = asyncio.Event()

    def on_states(self) -> None: ...
    def on_event(self, event: dict[str, Any]) -> None: ...
    def on_daemon(self) -> None: ...
    def notify(self, method: str, params: Any, *, keep: bool = False) -> None: ...

    def wake_all(self) -> None:
        self.woken.set()

    def rate_hz(self) -> float | None:
        return 10.0


@asynccontextmanager
async def daemon(path: Path, *, answers: bool) -> AsyncIterator[None]:
    """Takes connections; without ``answers`` as one that hangs. It has no vehicle."""
    writers = []

    async def serve(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        writers.append(writer)
        while line := await reader.readline():
            if answers:
                answer = {"jsonrpc": "2.0", "id": json.loads(line)["id"], "result": {"subscription": 1}}
                writer.write(json.dumps(answer).encode() + b"\n")

    server = await asyncio.start_unix_server(serve, path)
    try:
        yield
    finally:
        server.close()
        for writer in writers:
            writer.close()


async def until(condition: Any) -> None:
    for _ in range(6000):
        if condition():
            return
        await asyncio.sleep(0.01)
    raise AssertionError("it never happened")


async def test_a_daemon_that_hangs_is_tried_again_until_it_answers(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(daemon_connection, "ALIVE_WITHIN_S", 0.05)
    path = tmp_path / "gcs.sock"
    states = LatestStates()
    connection = DaemonConnection(str(path), None, states)
    task = asyncio.create_task(connection.run(Pages()))
    try:
        async with daemon(path, answers=False):
            await until(lambda: connection.reconnects >= 2)
            assert not connection.connected and "has not answered for" in connection.text
            assert not task.done()
        monkeypatch.setattr(daemon_connection, "ALIVE_WITHIN_S", 30.0)
        async with daemon(path, answers=True):
            await until(lambda: connection.connected)
        await until(lambda: not connection.connected)
        assert not states.complete
    finally:
        connection.stopping = True
        task.cancel()
        await asyncio.gather(task, return_exceptions=True)


async def test_a_daemon_without_a_vehicle_is_an_empty_fleet_after_a_while(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(daemon_connection, "GONE_AFTER_S", 0.05)
    monkeypatch.setattr(daemon_connection, "RATE_EVERY_S", 0.02)
    path, states, pages = tmp_path / "gcs.sock", LatestStates(), Pages()
    connection = DaemonConnection(str(path), None, states)
    async with daemon(path, answers=True):
        task = asyncio.create_task(connection.run(pages))
        try:
            async with asyncio.timeout(60):
                await pages.woken.wait()
            assert states.complete and len(states) == 0
        finally:
            connection.stopping = True
            task.cancel()
            await asyncio.gather(task, return_exceptions=True)
