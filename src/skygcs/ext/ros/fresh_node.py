"""A node that hands on only what the gate lets pass (`late_gate`).

    a message     is dropped and counted; a command is logged besides
    a request     is answered with the empty response, whose success, acceptance or status is that of a failure, logged

No message says reliably when it was sent: setpoints of most programs have no stamp. A request of ROS 2 has that of its
computer's clock (`dds.MOST_UNDER_WAY_S`): by it one of a computer whose clock is behind is late however fast it came,
and one of a computer whose clock is ahead never is.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from skygcs.core.ros.interfaces import Fields
from skygcs.core.ros.topics import Quality
from skygcs.ext.ros.ending_orders import VEHICLE_COMMAND
from skygcs.ext.ros.graph import MOST_PENDING, Handler, Node, PublicationPort, ServicePort, SubscriberPort
from skygcs.ext.ros.late_gate import LateGate


class FreshNode:
    """``node``, whose messages and requests pass through the gate. ``log(name, text)`` takes refusals for people."""

    def __init__(self, node: Node, gate: LateGate, log: Callable[[str, str], None]) -> None:
        self.stale = 0
        """Messages and requests that were dropped."""
        self._node = node
        self._gate = gate
        self._log = log

    @property
    def publications(self) -> Mapping[str, PublicationPort]:
        return self._node.publications

    @property
    def subscribers(self) -> Mapping[str, SubscriberPort]:
        return self._node.subscribers

    @property
    def services(self) -> Mapping[str, ServicePort]:
        return self._node.services

    def publish(self, name: str, type_: str, quality: Quality) -> PublicationPort:
        """Pass on to the node."""
        return self._node.publish(name, type_, quality)

    def subscribe(
        self, name: str, type_: str, quality: Quality, on_message: Callable[[dict[str, Any]], None]
    ) -> SubscriberPort:
        """Call ``on_message(fields)`` for each message from now on that is not late."""

        def on_fresh(fields: dict[str, Any]) -> None:
            if (refusal := self._gate.refusal(name, fields)) is None:
                on_message(fields)
                return
            self.stale += 1
            if VEHICLE_COMMAND in name:
                self._log(name, refusal)

        return self._node.subscribe(name, type_, quality, on_fresh)

    def serve(self, name: str, type_: str, handler: Handler, most_pending: int = MOST_PENDING) -> ServicePort:
        """Answer requests of this service that are not late by ``handler``."""

        async def answer(request: dict[str, Any]) -> Fields:
            if (refusal := self._gate.refusal(name, request)) is None:
                return await handler(request)
            self.stale += 1
            self._log(name, refusal)
            return {}

        return self._node.serve(name, type_, answer, most_pending)

    def count_readers(self) -> None:
        """Pass on to the node."""
        self._node.count_readers()

    async def drained(self, timeout_s: float) -> None:
        """Pass on to the node."""
        await self._node.drained(timeout_s)

    def close(self) -> None:
        """Pass on to the node."""
        self._node.close()
