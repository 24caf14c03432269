"""What holds for every test."""

from __future__ import annotations

import asyncio


def pytest_sessionstart() -> None:
    """No implicit event loop: looptime's plugin asks for the current loop before every test, which on Python 3.11
    makes one that nobody closes, and its warning then fails whatever test happens to run next."""
    asyncio.set_event_loop(None)
