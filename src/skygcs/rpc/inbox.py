"""Where the client keeps what it was told until the caller's ``async for`` comes to it. Bounded."""

from __future__ import annotations

import asyncio
from collections import deque
from typing import Any

from skygcs.errors import RpcError

INBOX = 1000
"""Events or messages waiting for a slow ``async for``; older ones are then dropped and counted."""


class Inbox:
    """What came and was not iterated over yet. Never holds up replies on the same connection."""

    def __init__(self) -> None:
        self._arrived = asyncio.Event()
        self._error: RpcError | None = None

    def put(self, params: dict[str, Any]) -> None:
        self._keep(params)
        self._arrived.set()

    def fail(self, error: RpcError) -> None:
        self._error = error
        self._arrived.set()

    async def get(self) -> dict[str, Any]:
        while not self:
            if self._error is not None:
                raise self._error
            self._arrived.clear()
            await self._arrived.wait()
        return self._take()

    def __bool__(self) -> bool:
        raise NotImplementedError

    def _keep(self, params: dict[str, Any]) -> None:
        raise NotImplementedError

    def _take(self) -> dict[str, Any]:
        raise NotImplementedError


class Latest(Inbox):
    """The newest state of each vehicle; the one that waits longest first."""

    def __init__(self) -> None:
        super().__init__()
        self._by_name: dict[str, dict[str, Any]] = {}

    def __bool__(self) -> bool:
        return bool(self._by_name)

    def _keep(self, params: dict[str, Any]) -> None:
        state = params["state"]
        self._by_name[state["name"]] = state

    def _take(self) -> dict[str, Any]:
        return self._by_name.pop(next(iter(self._by_name)))


class Queue(Inbox):
    """In order; the oldest are dropped and counted, as those that the daemon dropped."""

    def __init__(self, key: str) -> None:
        super().__init__()
        self._key = key
        self._waiting: deque[dict[str, Any]] = deque()

    def __bool__(self) -> bool:
        return bool(self._waiting)

    def _keep(self, params: dict[str, Any]) -> None:
        content = params[self._key]
        dropped = params.get("dropped", 0)
        if dropped:
            content["dropped"] = dropped
        if len(self._waiting) >= INBOX:
            lost = 1 + self._waiting.popleft().get("dropped", 0)
            self._waiting[0]["dropped"] = self._waiting[0].get("dropped", 0) + lost
        self._waiting.append(content)

    def _take(self) -> dict[str, Any]:
        return self._waiting.popleft()
