"""The interface of a ROS node to the bridge, for any ROS; and the topics that all vehicles share."""

from __future__ import annotations

from collections.abc import Awaitable, Callable, Mapping
from typing import Any, Protocol

from skygcs.core.ros.interfaces import Fields
from skygcs.core.ros.shared_topics import SHARED
from skygcs.core.ros.stamps import header
from skygcs.core.ros.topics import Quality

Handler = Callable[[dict[str, Any]], Awaitable[Fields]]
"""The fields of the response to those of a request."""

MOST_PENDING = 16
"""Requests of one service that are carried out at the same time, unless it is made for more; further ones are dropped,
and their clients time out."""


class PublicationPort(Protocol):
    """A topic that is published."""

    name: str
    readers: int
    sent: int
    dropped: int

    @property
    def wanted(self) -> bool:
        """True if anything comes of writing."""
        ...

    def write(self, fields: Fields) -> None:
        """Send one message. Raises InterfaceError."""
        ...


class SubscriberPort(Protocol):
    """A topic that is read."""

    name: str
    received: int
    rejected: int


class ServicePort(Protocol):
    """A service that is answered."""

    name: str
    calls: int
    overflown: int

    @property
    def rejected(self) -> int:
        """Number of malformed requests."""
        ...


class Node(Protocol):
    """A participant of ROS. Names are complete: "/alpha/mavros/state"."""

    @property
    def publications(self) -> Mapping[str, PublicationPort]: ...
    @property
    def subscribers(self) -> Mapping[str, SubscriberPort]: ...
    @property
    def services(self) -> Mapping[str, ServicePort]: ...

    def publish(self, name: str, type_: str, quality: Quality) -> PublicationPort: ...
    def subscribe(
        self, name: str, type_: str, quality: Quality, on_message: Callable[[dict[str, Any]], None]
    ) -> SubscriberPort: ...
    def serve(self, name: str, type_: str, handler: Handler, most_pending: int = MOST_PENDING) -> ServicePort: ...
    def count_readers(self) -> None: ...
    async def drained(self, timeout_s: float) -> None:
        """Wait until requests are answered and their clients have what was sent, at most ``timeout_s``."""

    def close(self) -> None: ...


class SharedTopics:
    """/tf, /tf_static, /rosout and /diagnostics."""

    def __init__(self, node: Node) -> None:
        self.node = node
        self._tf, self._static, self._log, self._diagnostics = (
            node.publish(name, SHARED[name].type, SHARED[name].quality)
            for name in ("/tf", "/tf_static", "/rosout", "/diagnostics")
        )
        self._fixed: dict[str, dict[str, Any]] = {}

    @property
    def transforms_wanted(self) -> bool:
        """True if somebody reads /tf."""
        return self._tf.wanted

    def transform(self, transform: dict[str, Any]) -> None:
        """One transform that changes."""
        if self._tf.wanted:
            self._tf.write({"transforms": [transform]})

    def fix_transforms(self, *transforms: dict[str, Any]) -> None:
        """Some that stay, until they are given again for the same children; each message has all of them."""
        new = {
            child: one
            for one in transforms
            if (before := self._fixed.get(child := one["child_frame_id"])) is None
            or before["transform"] != one["transform"]
        }
        if new:
            self._fixed |= new
            self._static.write({"transforms": list(self._fixed.values())})

    def log(self, entry: dict[str, Any]) -> None:
        """One message of the log."""
        self._log.write(entry)

    def diagnose(self, now_ns: int, status: list[dict[str, Any]]) -> None:
        """Publish the state of all vehicles as one message, if somebody reads it."""
        if self._diagnostics.wanted:
            self._diagnostics.write({"header": header(now_ns), "status": status})
