"""Fixtures of the tests that need a real nats-server."""

from __future__ import annotations

from collections.abc import AsyncIterator
from pathlib import Path

import pytest

from support.hub import Hub
from support.needed import needs


@pytest.fixture(autouse=True)
def _nats_server() -> None:
    needs("test-federation", "nats-server")


@pytest.fixture
async def hub(tmp_path: Path) -> AsyncIterator[Hub]:
    """With the users of `support.hub.USERS`, on loopback without TLS."""
    made = Hub(tmp_path)
    await made.start()
    try:
        yield made
    finally:
        made.process.stop()
