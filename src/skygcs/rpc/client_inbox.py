"""The inbox of a subscription for a reader that is slower than the daemon: the newest of each vehicle, the newest
only, or a bounded queue."""

from __future__ import annotations

import asyncio
import json
import re
from collections import deque
from typing import Any

from skygcs.errors import RpcError

MAX_WAITING = 1000
"""Events or messages waiting for a slow ``async for``; older ones are then dropped and counted."""

_STATE_NAME = re.compile(rb'\{"name":("(?:[^"\\]|\\.)*")')


class Inbox:
    """Items that came and were not iterated over yet. Never holds up replies on the same connection."""

    def __init__(self) -> None:
        self._arrived = asyncio.Event()
        self._error: RpcError | None = None

    def put(self, params: dict[str, Any]) -> None:
        """The parameters of one notification."""
        self._keep(params)
        self._arrived.set()

    def fail(self, error: RpcError) -> None:
        """Nothing more comes: after what is here the reader gets the error."""
        self._error = error
        self._arrived.set()

    async def get(self) -> dict[str, Any]:
        """The next item. Raises the error of `fail`."""
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


class Encoded(Inbox):
    """The newest state of each vehicle as the daemon encoded it: nothing is read but the name."""

    def __init__(self) -> None:
        super().__init__()
        self._by_name: dict[str, bytes] = {}
        self._complete = False

    def __bool__(self) -> bool:
        return bool(self._by_name)

    def put_encoded(self, state: bytes, last: bool) -> None:
        """One state. ``last``: it is the last of its round."""
        begin = _STATE_NAME.match(state)
        name = json.loads(state)["name"] if begin is None else json.loads(begin[1])
        self._by_name[name] = state
        self._complete = last
        self._arrived.set()

    def _keep(self, params: dict[str, Any]) -> None:
        self.put_encoded(json.dumps(params["state"]).encode(), bool(params.get("last")))

    def _take(self) -> dict[str, Any]:
        states, self._by_name = self._by_name, {}
        return {"states": states, "complete": self._complete}


class Newest(Inbox):
    """The newest only."""

    def __init__(self, key: str) -> None:
        super().__init__()
        self._key = key
        self._content: dict[str, Any] | None = None

    def __bool__(self) -> bool:
        return self._content is not None

    def _keep(self, params: dict[str, Any]) -> None:
        self._content = params[self._key]

    def _take(self) -> dict[str, Any]:
        content, self._content = self._content, None
        assert content is not None  # `get` waits for one
        return content


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
        if len(self._waiting) >= MAX_WAITING:
            lost = 1 + self._waiting.popleft().get("dropped", 0)
            self._waiting[0]["dropped"] = self._waiting[0].get("dropped", 0) + lost
        self._waiting.append(content)

    def _take(self) -> dict[str, Any]:
        return self._waiting.popleft()
