"""Reports of an order that a station gives its daemon reach the station's client under the client's own id."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator
from pathlib import Path
from typing import Any

import pytest
from pydantic_core import from_json

from skygcs.ext.federation.bridge.relayed_daemon import RelayedDaemon
from skygcs.rpc.server import RpcServer
from support.fake_daemon import FakeDaemon


class Client:
    """What a client of the station gets."""

    def __init__(self) -> None:
        self.lines: list[Any] = []

    def on_daemon_lines(self, lines: bytes) -> None:
        self.lines += [from_json(line) for line in lines.splitlines() if line]

    def on_daemon_full(self, full: bool) -> None:
        return

    def on_daemon_lost(self) -> None:
        return

    def end(self) -> None:
        return


@pytest.fixture
async def relayed(tmp_path: Path) -> AsyncIterator[tuple[RelayedDaemon, Client]]:
    server = RpcServer(FakeDaemon(), tmp_path / "s.sock")
    await server.start()
    client = Client()
    daemon = RelayedDaemon(client, str(tmp_path / "s.sock"), None)
    async with asyncio.timeout(60.0):
        assert await daemon.reach()
        yield daemon, client
    daemon.close()
    await server.close()


async def test_reports_carry_the_clients_id_and_answers_stay_here(relayed: tuple[RelayedDaemon, Client]) -> None:
    daemon, client = relayed
    await daemon.ask("vehicles.land", {"targets": "1-2"}, report_as='odd "id"')
    assert [line["method"] for line in client.lines] == ["order.begun", "order.outcome", "order.outcome"]
    assert {line["params"]["request"] for line in client.lines} == {'odd "id"'}
    await daemon.ask("vehicles.hold", {"targets": "all"}, report_as=None)
    assert len(client.lines) == 3, "not asked for"
