"""Runs a coroutine in virtual time, outside of pytest, without logs."""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Coroutine
from typing import Any, TypeVar

import structlog

import skygcs.rpc.methods
import skygcs.rpc.sessions  # noqa: F401 - a daemon imports them in a thread, which virtual time would not wait for
from support.virtual_asyncio import VirtualAsyncio

T = TypeVar("T")


def in_virtual_time(work: Coroutine[Any, Any, T]) -> T:
    """On a loop whose clock jumps to the next thing to do."""
    structlog.configure(wrapper_class=structlog.make_filtering_bound_logger(logging.ERROR))
    loop = VirtualAsyncio()
    asyncio.set_event_loop(loop)
    try:
        return loop.run_until_complete(work)
    finally:
        asyncio.set_event_loop(None)
        loop.close()
