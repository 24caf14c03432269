"""A node of ROS that keeps what is published, and whose readers and callers are the test."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from skygcs.core.ros.interfaces import ros2_interfaces
from skygcs.ext.ros.graph import MOST_PENDING


class KeptPublication:
    """A topic; every message is encoded, as it would be for the network."""

    def __init__(self, name: str, type_: str, quality: str) -> None:
        self.name, self.type, self.quality = name, type_, quality
        self.readers = self.dropped = 0
        self.messages: list[dict[str, Any]] = []

    @property
    def sent(self) -> int:
        return len(self.messages)

    @property
    def wanted(self) -> bool:
        return self.readers > 0 or self.quality in ("latched", "newest", "events")

    def write(self, fields: Any) -> None:
        known = ros2_interfaces()
        self.messages.append(known.decode(self.type, known.encode(self.type, fields)))


class KeptSubscriber:
    """A topic that is read: `give` it messages."""

    def __init__(self, name: str, type_: str, on_message: Callable[[dict[str, Any]], None]) -> None:
        self.name, self.type = name, type_
        self.received = self.rejected = 0
        self._on_message = on_message

    def give(self, **fields: Any) -> None:
        known = ros2_interfaces()
        self.received += 1
        self._on_message(known.decode(self.type, known.encode(self.type, fields)))


class KeptService:
    """A service: `call` it."""

    def __init__(self, name: str, type_: str, handler: Callable[[dict[str, Any]], Any], most_pending: int) -> None:
        self.name, self.type, self.most_pending = name, type_, most_pending
        self.pending = 0
        self.calls = self.overflown = self.rejected = 0
        self._handler = handler

    async def call(self, **request: Any) -> dict[str, Any]:
        known = ros2_interfaces()
        read = known.decode(f"{self.type}_Request", known.encode(f"{self.type}_Request", request))
        if self.pending >= self.most_pending:
            self.overflown += 1
            raise TimeoutError(f"{self.name} does not answer")
        self.calls += 1
        self.pending += 1
        try:
            response = await self._handler(read)
        finally:
            self.pending -= 1
        name = f"{self.type}_Response"
        return known.decode(name, known.encode(name, response))


class KeptNode:
    """Everything by its name."""

    def __init__(self) -> None:
        self.publications: dict[str, KeptPublication] = {}
        self.subscribers: dict[str, KeptSubscriber] = {}
        self.services: dict[str, KeptService] = {}

    def publish(self, name: str, type_: str, quality: str) -> KeptPublication:
        return self.publications.setdefault(name, KeptPublication(name, type_, quality))

    def subscribe(self, name: str, type_: str, quality: str, on_message: Any) -> KeptSubscriber:
        return self.subscribers.setdefault(name, KeptSubscriber(name, type_, on_message))

    def serve(self, name: str, type_: str, handler: Any, most_pending: int = MOST_PENDING) -> KeptService:
        return self.services.setdefault(name, KeptService(name, type_, handler, most_pending))

    def count_readers(self) -> None: ...

    async def drained(self, timeout_s: float) -> None: ...

    def close(self) -> None: ...

    def read(self, *names: str) -> None:
        """Readers for these topics."""
        for name in names:
            self.publications[name].readers += 1

    def last(self, name: str) -> dict[str, Any]:
        """The newest message of a topic."""
        return self.publications[name].messages[-1]
