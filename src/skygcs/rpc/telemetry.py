"""Telemetry for many subscribers: each vehicle's state is encoded once per tick, and coalesced for slow readers."""

from __future__ import annotations

import asyncio
import math

import structlog
from pydantic_core import to_json

from skygcs.errors import TargetError
from skygcs.rpc.ports import Daemon, Sink, Vehicle, resolve, state_of

GRID_S = 0.05
"""All telemetry goes out on one grid of 20 Hz, so that every subscriber of a tick shares the encoded state."""

SLICE_S = 0.002
"""Telemetry gives way to everything else in the loop after this long: routing must not wait for 250 snapshots."""

VEHICLES_PER_WRITE = 16
"""Then the client's buffer is looked at again."""

_log = structlog.get_logger(__name__)


class TelemetrySubscription:
    """Some vehicles' states at some rate. ``pending`` is what the client has not been sent of this round."""

    def __init__(self, sink: Sink, number: int, targets: str | list[str], rate_hz: float, names: frozenset[str]):
        self.sink = sink
        self.targets = targets
        self.rate_hz = rate_hz
        self.names = names
        self.tail = b',"subscription":%d}}\n' % number
        self.pending: dict[int, Vehicle] = {}
        self.vehicles: dict[int, Vehicle] = {}
        self.known: list[Vehicle] = []

    def due(self, before: int, tick: int) -> bool:
        """Whether an update belongs to the grid ticks (before, tick]. Equal rates are due together."""
        return math.floor(tick * GRID_S * self.rate_hz) != math.floor(before * GRID_S * self.rate_hz)

    def next_due(self, tick: int) -> int:
        period = 1 / (GRID_S * self.rate_hz)
        following = math.ceil((math.floor(tick * GRID_S * self.rate_hz) + 1) * period)
        return max(following, tick + 1)

    def flush(self) -> None:
        """Nothing to do: the feed goes on with what is pending at its next slice."""


class TelemetryFeed:
    """Encodes each vehicle's state once per tick and hands it to whoever is due and able to take it."""

    def __init__(self, daemon: Daemon, loop: asyncio.AbstractEventLoop) -> None:
        self._daemon = daemon
        self._loop = loop
        self._subscriptions: dict[TelemetrySubscription, None] = {}
        self._encoded: dict[tuple[int, frozenset[str]], bytes] = {}
        self._encoded_at = -math.inf
        self._timer: asyncio.TimerHandle | None = None
        self._draining = False
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
        there = list(self._daemon.fleet.vehicles.values())
        if not first and subscription.known == there:  # the very same ones: identity decides, which is quick
            return
        try:
            found = resolve(self._daemon, subscription.targets)
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
            self._loop.call_soon(self._drain)

    def _drain(self) -> None:
        self._draining = False
        deadline = self._loop.time() + SLICE_S
        for subscription in list(self._subscriptions):
            while subscription.pending and subscription.sink.writable:
                self._write_some(subscription)
                if self._loop.time() > deadline:
                    if self._subscriptions.pop(subscription, subscription) is None:
                        self._subscriptions[subscription] = None  # to the end: it is the others' turn
                    self._draining = True
                    self._loop.call_soon(self._drain)
                    return

    def _write_some(self, subscription: TelemetrySubscription) -> None:
        pieces: list[bytes] = []
        pending = subscription.pending
        for key in list(pending)[:VEHICLES_PER_WRITE]:
            vehicle = pending.pop(key)
            if subscription.vehicles.pop(key, None) is not None:
                subscription.vehicles[key] = vehicle  # to the end: next round begins with who waited longest
            body = self._encode(key, vehicle, subscription.names)
            if body:
                pieces.append(body)
                pieces.append(subscription.tail)
        if pieces:
            subscription.sink.write(b"".join(pieces))

    def _encode(self, key: int, vehicle: Vehicle, names: frozenset[str]) -> bytes:
        body = self._encoded.get((key, names))
        if body is None:
            try:
                state = state_of(self._daemon, vehicle)
                if names:
                    state = {k: v for k, v in state.items() if k in names or k in ("name", "sysid")}
                body = b'{"jsonrpc":"2.0","method":"telemetry","params":{"state":' + to_json(state, inf_nan_mode="null")
                self._failed.discard(key)
            except Exception as error:  # one vehicle's fault is not the others'
                body = b""
                if key not in self._failed:
                    self._failed.add(key)
                    _log.error("state cannot be sent", vehicle=vehicle.name, exc_info=error)
            self._encoded[key, names] = body
        return body
