"""Events and messages for subscribers: in order, encoded once, waiting in bounded queues for those who read slowly."""

from __future__ import annotations

import asyncio
from collections import deque
from collections.abc import Callable, Iterable, Mapping
from typing import Any

from pydantic_core import to_json

from skygcs.core.mavlink.frame import Frame
from skygcs.errors import TargetError
from skygcs.rpc.ports import Daemon, Sink

QUEUED = 256
"""Events or messages waiting per subscription: seconds of a busy fleet; further ones push out the oldest."""

MAX_RATED_SOURCES = 4096
"""Different (sysid, compid, message) one rate limit keeps apart; noise cannot grow the table further."""


class QueuedSubscription:
    """Encoded events or messages in order, at most QUEUED waiting; what was pushed out is told with the next one."""

    def __init__(self, sink: Sink, number: int, loop: asyncio.AbstractEventLoop) -> None:
        self._sink = sink
        self._loop = loop
        self._tail = b',"subscription":%d' % number
        self._queue: deque[tuple[bytes, float]] = deque()
        self._dropped = 0
        self._flush_due = False

    def offer(self, body: bytes, now: float) -> None:
        """Queue one, for the end of this loop turn: what came in one datagram leaves in one write."""
        if len(self._queue) >= QUEUED:
            self._queue.popleft()
            self._dropped += 1
        self._queue.append((body, now))
        if not self._flush_due:
            self._flush_due = True
            self._loop.call_soon(self.flush)

    def flush(self) -> None:
        """Write what waits, if the client takes it."""
        self._flush_due = False
        if not self._queue or not self._sink.writable:
            return
        pieces: list[bytes] = []
        for body, then in self._queue:
            pieces += (body, self._closing(then))
        self._queue.clear()
        self._sink.write(b"".join(pieces))

    def _closing(self, then: float) -> bytes:
        if not self._dropped:
            return self._tail + b"}}\n"
        dropped, self._dropped = self._dropped, 0
        return b'%b,"dropped":%d}}\n' % (self._tail, dropped)


class EventSubscription(QueuedSubscription):
    """Events of some kinds and vehicles."""

    def __init__(
        self,
        sink: Sink,
        number: int,
        loop: asyncio.AbstractEventLoop,
        daemon: Daemon,
        targets: str | list[str],
        kinds: frozenset[str],
    ) -> None:
        super().__init__(sink, number, loop)
        self._daemon = daemon
        self._targets = targets
        self._kinds = kinds
        if targets != "all":
            daemon.fleet.resolve_any(targets)

    def wants(self, event: Mapping[str, Any]) -> bool:
        if self._kinds and event.get("kind") not in self._kinds:
            return False
        if self._targets == "all":
            return True
        try:
            wanted = self._daemon.fleet.resolve_any(self._targets)
        except TargetError:
            return False
        component = (event.get("sysid"), (event.get("data") or {}).get("compid"))
        return any(s.name == event.get("vehicle") or (s.sysid, s.compid) == component for s in wanted)


class EventFeed:
    """Encodes each event once for all."""

    def __init__(self, daemon: Daemon, loop: asyncio.AbstractEventLoop) -> None:
        self._loop = loop
        self._daemon = daemon
        self._subscriptions: set[EventSubscription] = set()
        self._unsubscribe: Callable[[], object] | None = None

    def add(self, subscription: EventSubscription) -> None:
        self._subscriptions.add(subscription)
        if self._unsubscribe is None:
            self._unsubscribe = self._daemon.subscribe_events(self._on_event)

    def remove(self, subscription: EventSubscription) -> None:
        self._subscriptions.discard(subscription)
        if not self._subscriptions:
            self.close()

    def close(self) -> None:
        self._subscriptions.clear()
        if self._unsubscribe is not None:
            self._unsubscribe()
            self._unsubscribe = None

    def _on_event(self, event: Mapping[str, Any]) -> None:
        body = b""
        for subscription in self._subscriptions:
            if not subscription.wants(event):
                continue
            if not body:
                encoded = to_json(dict(event), inf_nan_mode="null", serialize_unknown=True)
                body = b'{"jsonrpc":"2.0","method":"event","params":{"event":' + encoded
            subscription.offer(body, self._loop.time())


class MessageSubscription(QueuedSubscription):
    """Decoded messages of some names and vehicles, at most ``rate_hz`` of each name and source."""

    def __init__(self, sink: Sink, number: int, loop: asyncio.AbstractEventLoop, rate_hz: float | None) -> None:
        super().__init__(sink, number, loop)
        self.rate_hz = rate_hz
        self._last: dict[tuple[int, int, int], float] = {}

    def passes(self, frame: Frame, now: float) -> bool:
        """Whether the rate lets this one through (a tenth of a period early is in time: senders jitter)."""
        if self.rate_hz is None:
            return True
        key = (frame.sysid, frame.compid, frame.msgid)
        last = self._last.get(key)
        if last is not None and now - last < 0.9 / self.rate_hz:
            return False
        if last is None and len(self._last) >= MAX_RATED_SOURCES:
            return False
        self._last[key] = now
        return True

    def _closing(self, then: float) -> bytes:
        age = max(self._loop.time() - then, 0.0)
        return b',"age_s":%.3f}%b' % (age, super()._closing(then))


class MessageFeed:
    """Decodes and encodes each frame once, however many want it."""

    def __init__(self, daemon: Daemon, loop: asyncio.AbstractEventLoop) -> None:
        self._daemon = daemon
        self._loop = loop
        self._unsubscribes: dict[MessageSubscription, Callable[[], object]] = {}
        self._last: tuple[Frame | None, bytes] = (None, b"")

    def add(self, subscription: MessageSubscription, names: Iterable[str] | None, targets: str | list[str]) -> None:
        """Raises TargetError. ``names`` are the dialect's own spelling."""
        keys: set[int] | None = None
        if targets != "all":
            keys = self._daemon.fleet.sources(targets)

        def on_frame(frame: Frame, _channel: object, _now: float) -> None:
            now = self._loop.time()
            if frame.info is not None and subscription.passes(frame, now):
                subscription.offer(self._encode(frame), now)

        wanted = set(names) if names is not None else None
        self._unsubscribes[subscription] = self._daemon.subscribe_messages(wanted, keys, on_frame)

    def remove(self, subscription: MessageSubscription) -> None:
        unsubscribe = self._unsubscribes.pop(subscription, None)
        if unsubscribe is not None:
            unsubscribe()

    def close(self) -> None:
        for subscription in list(self._unsubscribes):
            self.remove(subscription)
        self._last = (None, b"")

    def _encode(self, frame: Frame) -> bytes:
        last, body = self._last
        if last is frame:
            return body
        vehicle, source = self._daemon.fleet.names_of(frame.sysid, frame.compid)
        message = {
            "vehicle": vehicle,
            "source": source,
            "sysid": frame.sysid,
            "compid": frame.compid,
            "name": frame.name,
            "fields": frame.fields(),
        }
        encoded = to_json(message, inf_nan_mode="null")
        body = b'{"jsonrpc":"2.0","method":"message","params":{"message":' + encoded[:-1]
        self._last = (frame, body)
        return body
