"""Fixtures of the tests that need a real nats-server."""

from __future__ import annotations

import sys
from collections.abc import AsyncIterator, Iterator
from pathlib import Path

import pytest
import structlog

from support.hub import Hub
from support.needed import needs


@pytest.fixture(autouse=True)
def _nats_server() -> None:
    needs("test-federation", "nats-server")


@pytest.fixture(autouse=True)
def _logs_beside_what_commands_print() -> Iterator[None]:
    """A command of the CLI runs in a thread with a standard output of its own, and the bridges of a test go on: what
    they log is bound to the output of the test."""
    structlog.configure(logger_factory=structlog.PrintLoggerFactory(sys.stdout))
    yield
    structlog.reset_defaults()


@pytest.fixture
async def hub(tmp_path: Path) -> AsyncIterator[Hub]:
    """With the users of `support.hub.USERS`, on loopback without TLS."""
    made = Hub(tmp_path)
    await made.start()
    try:
        yield made
    finally:
        made.process.stop()
