"""What a method keeps for a client ends with the client."""

from __future__ import annotations

from collections.abc import AsyncIterator
from pathlib import Path

import pytest

from skygcs.rpc.context import ReportingContext
from support.rpc_bench import Bench, running


@pytest.fixture
async def bench(tmp_path: Path) -> AsyncIterator[Bench]:
    async with running(tmp_path) as bench:
        yield bench


def fail() -> None:
    raise RuntimeError("an action's own fault")


async def test_each_action_is_called_once_when_the_client_is_gone(bench: Bench) -> None:
    peer = await bench.connect()
    await peer.call("daemon.info")
    (session,) = bench.server._hub.sessions
    called: list[str] = []
    session.at_end(fail)  # and stops no other
    session.at_end(lambda: called.append("first"))
    take_back = ReportingContext(session, 1).at_end(lambda: called.append("second"))
    session.at_end(lambda: called.append("third"))
    take_back()
    take_back()
    assert called == []
    peer.writer.close()
    await bench.until(lambda: called == ["first", "third"])
    # one that comes too late is called at once
    session.at_end(lambda: called.append("late"))
    await bench.until(lambda: called[2:] == ["late"])
    session.close()
    assert called == ["first", "third", "late"]
