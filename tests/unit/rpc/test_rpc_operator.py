"""Which requests count for operator_timeout_s: all of a client's, unless it relays for somebody who may have left."""

from __future__ import annotations

from collections.abc import AsyncIterator
from pathlib import Path

import pytest

from support.rpc_bench import Bench, running


@pytest.fixture
async def bench(tmp_path: Path) -> AsyncIterator[Bench]:
    async with running(tmp_path) as bench:
        yield bench


async def test_each_request_of_a_plain_client_counts(bench: Bench) -> None:
    peer = await bench.connect()
    await peer.call("vehicles.list")
    await peer.call("no.such.method")
    assert bench.daemon.requests_seen == 2


async def test_of_a_client_that_relays_only_a_persons_activity_counts(bench: Bench) -> None:
    relay, plain = await bench.connect(), await bench.connect()
    assert (await relay.call("operator.relay"))["result"] == {"ok": True}
    for method in ("vehicles.list", "daemon.info", "no.such.method", "operator.relay"):
        await relay.call(method)
    await relay.call("subscribe", topic="telemetry", rate_hz=20.0)
    await relay.call("vehicles.arm", targets="all")
    assert bench.daemon.requests_seen == 0
    await relay.call("operator.active")
    assert bench.daemon.requests_seen == 1
    await plain.call("vehicles.list")
    assert bench.daemon.requests_seen == 2


async def test_a_person_is_counted_once_by_a_plain_client_and_by_name(bench: Bench) -> None:
    peer = await bench.connect()
    await peer.call("operator.active")
    assert bench.daemon.requests_seen >= 1
