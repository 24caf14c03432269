"""The end of the connection to the hub: a cancellation that nats-py loses still ends it."""

from __future__ import annotations

import asyncio
import contextlib
from typing import Any

import pytest

from skygcs.ext.federation.bridge.bus import Bus, BusOptions
from support.table import each


@each("then", ["connected", "failed"])
async def test_a_cancellation_that_is_lost_while_it_connects_ends_it(
    monkeypatch: pytest.MonkeyPatch, then: str
) -> None:
    """asyncio.wait_for of Python 3.11 swallows one that comes together with a result."""
    connecting = asyncio.Event()

    async def connect(*_: Any) -> None:
        connecting.set()
        with contextlib.suppress(asyncio.CancelledError):
            await asyncio.sleep(3600)
        if then == "failed":
            raise OSError("refused")

    monkeypatch.setattr(Bus, "_connect", connect)
    bus = Bus(BusOptions(("nats://127.0.0.1:4222",), "seed"), asyncio.get_running_loop(), lambda _: None)
    task = asyncio.create_task(bus.run())
    await connecting.wait()
    task.cancel()
    done, _ = await asyncio.wait({task}, timeout=10.0)
    task.cancel()
    assert done and task.cancelled()
