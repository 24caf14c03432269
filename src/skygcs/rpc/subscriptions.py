"""Notifications to clients that subscribed: telemetry, events, messages.

A client that reads slowly never makes the daemon keep more: telemetry is coalesced per vehicle (fewer, fresher
updates), events and messages wait in bounded queues; what they lost is counted and sent with the next one.
"""

from __future__ import annotations

import asyncio
import itertools
import math
from collections import deque
from collections.abc import Callable, Iterable, Mapping
from functools import partial
from typing import Any, Protocol

import structlog

from skygcs.core.mavlink.frame import Frame
from skygcs.core.vehicle.state import VehicleState
from skygcs.errors import TargetError
from skygcs.rpc.context import Services, resolve, state_of
from skygcs.rpc.dispatch import InvalidParams
from skygcs.rpc.json_lines import EVENT_START, MESSAGE_START, PLAN_START, TELEMETRY_START
from skygcs.rpc.messages import find_message
from skygcs.rpc.models import SubscribeParams
from skygcs.rpc.replies import encode
from skygcs.rpc.slices import Slices
from skygcs.runtime.vehicle_actor import VehicleActor

DEFAULT_TELEMETRY_HZ = 2.0

GRID_S = 0.05
"""All telemetry goes out on one grid of 20 Hz, so that every subscriber of a tick shares the encoded state."""

ALWAYS = frozenset({"name", "sysid"})
"""Keys that every update has."""

VEHICLES_PER_WRITE = 16
"""Then the client's buffer is looked at again."""

QUEUED = 256
"""Events or messages waiting per subscription: seconds of a busy fleet; further ones push out the oldest."""

MAX_RATED_SOURCES = 4096
"""Different (sysid, compid, message) of one rate limit; noise cannot grow the table further."""

_log = structlog.get_logger(__name__)


class Sink(Protocol):
    """A client's output, as subscriptions see it."""

    @property
    def writable(self) -> bool:
        """False while the client has not taken what was written before."""
        ...

    def write(self, data: bytes) -> None: ...


class TelemetrySubscription:
    """Some vehicles' states at some rate. ``pending`` is what the client has not been sent of this round."""

    def __init__(self, sink: Sink, number: int, targets: str | list[str], rate_hz: float, names: frozenset[str]):
        self.sink = sink
        self.targets = targets
        self.rate_hz = rate_hz
        self.names = names
        self.tail = b',"subscription":%d}}\n' % number
        self.last_tail = b',"subscription":%d,"last":true}}\n' % number
        self.pending: dict[int, VehicleActor] = {}
        self.vehicles: dict[int, VehicleActor] = {}
        self.known: list[VehicleActor] = []

    def due(self, before: int, tick: int) -> bool:
        """True if an update belongs to the grid ticks (before, tick]. Equal rates are due together."""
        return math.floor(tick * GRID_S * self.rate_hz) != math.floor(before * GRID_S * self.rate_hz)

    def next_due(self, tick: int) -> int:
        period = 1 / (GRID_S * self.rate_hz)
        following = math.ceil((math.floor(tick * GRID_S * self.rate_hz) + 1) * period)
        return max(following, tick + 1)

    def flush(self) -> None:
        """Nothing to do: the feed goes on with what is pending at its next slice."""


class TelemetryFeed:
    """Encodes each vehicle's state once per tick and writes it to the subscriptions that are due and can take it."""

    def __init__(self, services: Services, loop: asyncio.AbstractEventLoop, slices: Slices) -> None:
        self._services = services
        self._loop = loop
        self._slices = slices
        self._subscriptions: dict[TelemetrySubscription, None] = {}
        self._encoded: dict[tuple[int, frozenset[str]], bytes] = {}
        self._encoded_at = -math.inf
        self._timer: asyncio.TimerHandle | None = None
        self._draining = False
        self._drains_by = math.inf
        """When the next slice has to begin."""
        self._tick_done = 0
        self._failed: set[int] = set()

    def add(self, subscription: TelemetrySubscription) -> None:
        """Begins with one update at once. Raises TargetError."""
        self._find_vehicles(subscription, first=True)
        self._subscriptions[subscription] = None
        subscription.pending = dict(subscription.vehicles)
        self._start_drain()
        self._arm()

    def remove(self, subscription: TelemetrySubscription) -> None:
        self._subscriptions.pop(subscription, None)
        if not self._subscriptions:
            self.close()

    def close(self) -> None:
        self._subscriptions.clear()
        self._encoded.clear()
        if self._timer is not None:
            self._timer.cancel()
            self._timer = None

    def resume(self) -> None:
        """A client takes data again."""
        self._start_drain()

    def _arm(self) -> None:
        if self._timer is not None:
            self._timer.cancel()
        now_tick = self._now_tick()
        if self._timer is None:
            self._tick_done = now_tick
        following = min(s.next_due(now_tick) for s in self._subscriptions)
        self._timer = self._loop.call_at(following * GRID_S, self._on_tick)

    def _now_tick(self) -> int:
        """Loops run timers up to their resolution early, uvloop a millisecond: that is the tick meant."""
        return int(self._loop.time() / GRID_S + 0.05)

    def _on_tick(self) -> None:
        tick = self._now_tick()
        for subscription in self._subscriptions:
            if subscription.due(self._tick_done, tick):
                self._find_vehicles(subscription)
                subscription.pending.update(subscription.vehicles)
        self._tick_done = tick
        self._start_drain()
        self._arm()

    def _find_vehicles(self, subscription: TelemetrySubscription, *, first: bool = False) -> None:
        """Vehicles that came since the last time belong to "all", a group or a range as well."""
        there = list(self._services.fleet.vehicles.values())
        if not first and subscription.known == there:  # the very same ones: identity decides, which is quick
            return
        try:
            found = resolve(self._services, subscription.targets)
        except TargetError:
            if first:
                raise
            found = []  # they were forgotten
        subscription.known = there
        subscription.vehicles = {v.sysid << 8 | v.compid: v for v in found}

    def _start_drain(self) -> None:
        if not self._draining and any(s.pending for s in self._subscriptions):
            if self._loop.time() - self._encoded_at > GRID_S / 2:
                self._encoded.clear()
                self._encoded_at = self._loop.time()
            self._draining = True
            self._drains_by = self._slices.begins_by()
            self._loop.call_soon(self._drain)

    def _drain(self) -> None:
        if (wait_s := self._slices.wait_s(self._drains_by)) is not None:
            self._loop.call_later(wait_s, self._drain)
            return
        self._draining = False
        deadline = self._slices.ends_at()
        for subscription in list(self._subscriptions):
            while subscription.pending and subscription.sink.writable:
                self._write_some(subscription, deadline)
                if self._slices.over(deadline):
                    if self._subscriptions.pop(subscription, subscription) is None:
                        self._subscriptions[subscription] = None  # to the end: it is the others' turn
                    self._draining = True
                    pause_s = self._slices.pause_s()
                    self._drains_by = self._slices.begins_by(pause_s)
                    self._loop.call_later(pause_s, self._drain)
                    return

    def _write_some(self, subscription: TelemetrySubscription, deadline: float) -> None:
        """Encode and write until the deadline; one state at least."""
        pieces: list[bytes] = []
        pending = subscription.pending
        for key in list(pending)[:VEHICLES_PER_WRITE]:
            if pieces and self._slices.over(deadline):
                break
            vehicle = pending.pop(key)
            if subscription.vehicles.pop(key, None) is not None:
                subscription.vehicles[key] = (
                    vehicle  # to the end: the next round begins with the one that waited longest
                )
            body = self._encode(key, vehicle, subscription.names)
            if body:
                pieces.append(body)
                pieces.append(subscription.tail if pending else subscription.last_tail)
        if pieces:
            subscription.sink.write(b"".join(pieces))

    def _encode(self, key: int, vehicle: VehicleActor, names: frozenset[str]) -> bytes:
        body = self._encoded.get((key, names))
        if body is None:
            try:
                state = state_of(self._services, vehicle, names | ALWAYS if names else None)
                body = TELEMETRY_START + encode(state)
                self._failed.discard(key)
            except Exception as error:  # one vehicle's fault is not the others'
                body = b""
                if key not in self._failed:
                    self._failed.add(key)
                    _log.error("state cannot be sent", vehicle=vehicle.name, exc_info=error)
            self._encoded[key, names] = body
        return body


class QueuedSubscription:
    """A client's place in a `QueuedStream`, from ``join`` to ``close``."""

    def __init__(self, sink: Sink, number: int, loop: asyncio.AbstractEventLoop) -> None:
        self._sink = sink
        self._loop = loop
        self._tail = b',"subscription":%d' % number
        self._stream: QueuedStream | None = None
        self.next = 0
        """Number of what it gets next."""

    def join(self, stream: QueuedStream) -> None:
        """Get what comes in this stream from now on."""
        self._stream, self.next = stream, stream.end
        stream.members[self] = None

    def close(self) -> None:
        """Get nothing more. Idempotent."""
        stream, self._stream = self._stream, None
        if stream is not None:
            stream.members.pop(self, None)
            if not stream.members:
                stream.on_empty()

    def flush(self) -> None:
        """Write what came since the last time, if the client takes it: the newest QUEUED, with the number of others."""
        stream = self._stream
        if stream is None or self.next == stream.end or not self._sink.writable:
            return
        begin = stream.end - len(stream.queue)
        dropped = max(begin - self.next, 0)
        now = self._loop.time()
        pieces: list[bytes] = []
        for body, then in itertools.islice(stream.queue, max(self.next - begin, 0), None):
            age = b',"age_s":%.3f}' % max(now - then, 0.0) if stream.tells_age else b""
            pieces += (body, age, self._tail, b',"dropped":%d}}\n' % dropped if dropped else b"}}\n")
            dropped = 0
        self.next = stream.end
        self._sink.write(b"".join(pieces))


class QueuedStream:
    """Encoded events or messages, numbered, for all that want the same. One costs the loop no more when many clients
    wait for it, and nothing for those that do not read."""

    tells_age = False
    """True if its bodies lack their last brace, before which their age is put."""

    def __init__(self, loop: asyncio.AbstractEventLoop, on_empty: Callable[[], object]) -> None:
        """``on_empty``: called when the last of its subscriptions has been closed."""
        self.members: dict[QueuedSubscription, None] = {}
        self.queue: deque[tuple[bytes, float]] = deque(maxlen=QUEUED)
        """The newest, with the time of each; the last has the number ``end`` - 1."""
        self.end = 0
        self.on_empty = on_empty
        self._loop = loop
        self._flush_due = False

    def put(self, body: bytes, now: float) -> None:
        """Queue one, for the end of this loop turn: what came in one datagram leaves in one write."""
        self.queue.append((body, now))
        self.end += 1
        if not self._flush_due:
            self._flush_due = True
            self._loop.call_soon(self._flush)

    def _flush(self) -> None:
        self._flush_due = False
        for member in tuple(self.members):
            try:
                member.flush()
            except Exception as error:  # one client's fault is not the others'
                _log.error("what was subscribed to cannot be written", exc_info=error)
        if all(member.next == self.end for member in self.members):
            self.queue.clear()


class EventFeed:
    """Encodes each event once for all."""

    def __init__(self, services: Services, loop: asyncio.AbstractEventLoop) -> None:
        self._loop = loop
        self._services = services
        self._streams: dict[tuple[frozenset[str], str | tuple[str, ...]], QueuedStream] = {}
        """By their kinds (none: all) and targets."""
        self._unsubscribe: Callable[[], object] | None = None

    def add(self, subscription: QueuedSubscription, kinds: frozenset[str], targets: str | list[str]) -> None:
        """Raises TargetError."""
        if targets != "all":
            self._services.fleet.resolve_any(targets)
        wanted = kinds, targets if isinstance(targets, str) else tuple(targets)
        stream = self._streams.get(wanted)
        if stream is None:
            stream = self._streams[wanted] = QueuedStream(self._loop, partial(self._drop, wanted))
        subscription.join(stream)
        if self._unsubscribe is None:
            self._unsubscribe = self._services.event_log.subscribe(self._on_event)

    def _drop(self, wanted: tuple[frozenset[str], str | tuple[str, ...]]) -> None:
        self._streams.pop(wanted, None)
        if not self._streams:
            self.close()

    def close(self) -> None:
        self._streams.clear()
        if self._unsubscribe is not None:
            self._unsubscribe()
            self._unsubscribe = None

    def _on_event(self, event: Mapping[str, Any]) -> None:
        body, now = b"", self._loop.time()
        for (kinds, targets), stream in self._streams.items():
            if (kinds and event.get("kind") not in kinds) or not self._is_of(event, targets):
                continue
            body = body or EVENT_START + encode(dict(event), serialize_unknown=True)
            stream.put(body, now)

    def _is_of(self, event: Mapping[str, Any], targets: str | tuple[str, ...]) -> bool:
        if targets == "all":
            return True
        try:
            wanted = self._services.fleet.resolve_any(targets if isinstance(targets, str) else list(targets))
        except TargetError:
            return False
        component = (event.get("sysid"), (event.get("data") or {}).get("compid"))
        return any(s.name == event.get("vehicle") or (s.sysid, s.compid) == component for s in wanted)


class MessageStream(QueuedStream):
    """Decoded messages of some names and sources, at most ``rate_hz`` of each name and source."""

    tells_age = True

    def __init__(
        self,
        loop: asyncio.AbstractEventLoop,
        on_empty: Callable[[], object],
        rate_hz: float | None,
        encoded: Callable[[Frame], bytes],
    ) -> None:
        super().__init__(loop, on_empty)
        self.unsubscribe: Callable[[], object] = lambda: None
        self._rate_hz = rate_hz
        self._encoded = encoded
        self._last: dict[tuple[int, int, int], float] = {}

    def on_frame(self, frame: Frame, _channel: object, _now: float) -> None:
        """One that is of its names and sources."""
        now = self._loop.time()
        if frame.info is not None and self._passes(frame, now):
            self.put(self._encoded(frame), now)

    def _passes(self, frame: Frame, now: float) -> bool:
        """True if the rate lets this one through (a tenth of a period early is in time: senders jitter)."""
        if self._rate_hz is None:
            return True
        key = (frame.sysid, frame.compid, frame.msgid)
        last = self._last.get(key)
        if last is not None and now - last < 0.9 / self._rate_hz:
            return False
        if last is None and len(self._last) >= MAX_RATED_SOURCES:
            return False
        self._last[key] = now
        return True


class MessageFeed:
    """Decodes and encodes each frame once for all subscriptions."""

    def __init__(self, services: Services, loop: asyncio.AbstractEventLoop) -> None:
        self._services = services
        self._loop = loop
        self._streams: dict[object, MessageStream] = {}
        """By what its subscriptions want; of one with a rate, which begins with its first frame, by itself."""
        self._last: tuple[Frame | None, bytes] = (None, b"")

    def add(
        self,
        subscription: QueuedSubscription,
        names: Iterable[str] | None,
        targets: str | list[str],
        rate_hz: float | None,
    ) -> None:
        """Raises TargetError. ``names`` are the dialect's own spelling."""
        keys = None if targets == "all" else frozenset(self._services.fleet.sources(targets))
        dialect = self._services.dialect
        msgids = None if names is None else frozenset(dialect.by_name[name].msgid for name in names)
        wanted = (msgids, keys) if rate_hz is None else subscription
        stream = self._streams.get(wanted)
        if stream is None:
            stream = MessageStream(self._loop, partial(self._drop, wanted), rate_hz, self._encode)
            self._streams[wanted] = stream
            stream.unsubscribe = self._services.hub.observers.add(msgids, keys, stream.on_frame)
        subscription.join(stream)

    def _drop(self, wanted: object) -> None:
        if (stream := self._streams.pop(wanted, None)) is not None:
            stream.unsubscribe()

    def close(self) -> None:
        for wanted in list(self._streams):
            self._drop(wanted)
        self._last = (None, b"")

    def _encode(self, frame: Frame) -> bytes:
        last, body = self._last
        if last is frame:
            return body
        vehicle, source = self._services.fleet.names_of(frame.sysid, frame.compid)
        message = {
            "vehicle": vehicle,
            "source": source,
            "sysid": frame.sysid,
            "compid": frame.compid,
            "name": frame.name,
            "fields": frame.fields(),
        }
        encoded = encode(message)
        body = MESSAGE_START + encoded[:-1]
        self._last = (frame, body)
        return body


class PlanSubscription:
    """The status of the plan: at once, after each change, and while it is flown ``rate_hz`` times a second.

    Only the newest is sent: a client that reads slowly gets fewer.
    """

    def __init__(
        self, sink: Sink, number: int, rate_hz: float, services: Services, loop: asyncio.AbstractEventLoop
    ) -> None:
        self._sink = sink
        self._tail = b',"subscription":%d}}\n' % number
        self._period_s = 1.0 / rate_hz
        self._plans = services.fleet.plans
        self._loop = loop
        self._due = False
        self._timer: asyncio.TimerHandle | None = None
        self._plans.observers.add(self._changed)
        self._changed()

    def close(self) -> None:
        self._plans.observers.discard(self._changed)
        if self._timer is not None:
            self._timer.cancel()
            self._timer = None

    def _changed(self) -> None:
        """Send it at the end of this turn of the loop: several changes of one turn are one notification."""
        if not self._due:
            self._due = True
            self._loop.call_soon(self.flush)

    def flush(self) -> None:
        """Write the status, if it is due and the client takes it."""
        if not self._due or not self._sink.writable or self._changed not in self._plans.observers:
            return
        self._due = False
        if self._timer is not None:
            self._timer.cancel()
        body = encode(self._plans.status())
        self._sink.write(PLAN_START + body + self._tail)
        self._timer = self._loop.call_later(self._period_s, self._tick)

    def _tick(self) -> None:
        self._timer = None
        if self._plans.moving:
            self._changed()


Subscription = TelemetrySubscription | QueuedSubscription | PlanSubscription


class Feeds:
    """The sources of all subscriptions of all clients."""

    def __init__(self, services: Services, loop: asyncio.AbstractEventLoop, slices: Slices) -> None:
        self._services = services
        self._loop = loop
        self._telemetry = TelemetryFeed(services, loop, slices)
        self._events = EventFeed(services, loop)
        self._messages = MessageFeed(services, loop)

    def add(self, sink: Sink, number: int, params: SubscribeParams) -> Subscription:
        """Begin to write to ``sink``. Raises TargetError and InvalidParams."""
        texts = frozenset(str(name) for name in params.names or ())
        match params.topic:
            case "telemetry":
                _check_groups(texts, self._services.extensions.state_groups)
                rate_hz = params.rate_hz or DEFAULT_TELEMETRY_HZ
                telemetry = TelemetrySubscription(sink, number, params.targets, rate_hz, texts)
                self._telemetry.add(telemetry)
                return telemetry
            case "events":
                events = QueuedSubscription(sink, number, self._loop)
                self._events.add(events, texts, params.targets)
                return events
            case "plan":
                rate_hz = params.rate_hz or DEFAULT_TELEMETRY_HZ
                return PlanSubscription(sink, number, rate_hz, self._services, self._loop)
            case "messages":
                names = None
                if params.names is not None:
                    names = [find_message(self._services.dialect, name, "names").name for name in params.names]
                messages = QueuedSubscription(sink, number, self._loop)
                self._messages.add(messages, names, params.targets, params.rate_hz)
                return messages

    def remove(self, subscription: Subscription) -> None:
        if isinstance(subscription, TelemetrySubscription):
            self._telemetry.remove(subscription)
        else:
            subscription.close()

    def resume(self) -> None:
        """Some client takes data again."""
        self._telemetry.resume()

    def close(self) -> None:
        self._telemetry.close()
        self._events.close()
        self._messages.close()


def _check_groups(names: frozenset[str], of_extensions: Iterable[str]) -> None:
    known = [*VehicleState.__annotations__, *of_extensions]
    unknown = sorted(names.difference(known))
    if unknown:
        names_known = ", ".join(known)
        raise InvalidParams(("names", f"a vehicle's state has no {', '.join(unknown)[:80]}; it has: {names_known}"))
