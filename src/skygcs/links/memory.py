"""A link whose other end is a Python object, over a network that is as bad as configured. For tests."""

from __future__ import annotations

import asyncio
import heapq
import random
from collections.abc import Callable, Hashable
from itertools import count
from typing import Any

from skygcs.config import models
from skygcs.core.radio_link.transmit_queue import Outgoing, Priority
from skygcs.errors import LinkError
from skygcs.links.base import Channel, Link, LinkHost
from skygcs.links.stream import StreamIntake

MAX_IN_FLIGHT = 10_000
"""Packets in flight in one direction; more are dropped and counted."""

MAX_RECEIVED = 100_000
"""Packets `MemoryPeer` keeps; then the older half goes."""

Deliver = Callable[[bytes], None]


class BadNetwork:
    """One direction: what is sent arrives later, twice, out of order, byte by byte, or not at all; the same each run.

    Never from within `transmit`: delivery is always a callback of the loop. Without jitter the order is kept.
    """

    def __init__(self, config: models.MemoryLinkConfig, seed: int, loop: asyncio.AbstractEventLoop) -> None:
        self.sent = 0
        self.lost = 0
        self._config = config
        self._random = random.Random(seed)
        self._loop = loop
        self._flight: list[tuple[float, int, bytes, Deliver]] = []
        self._order = count()
        self._wake: asyncio.TimerHandle | None = None

    def transmit(self, data: bytes, deliver: Deliver) -> None:
        """Send one packet."""
        config, rng = self._config, self._random.random
        self.sent += 1
        for _ in range(2 if rng() < config.duplicate else 1):
            if rng() < config.loss or len(self._flight) >= MAX_IN_FLIGHT:
                self.lost += 1
                continue
            due = self._loop.time() + config.delay_s + config.jitter_s * rng()
            heapq.heappush(self._flight, (due, next(self._order), data, deliver))
        self._plan()

    def clear(self) -> None:
        """Drop the packets in flight."""
        self.lost += len(self._flight)
        self._flight.clear()
        if self._wake is not None:
            self._wake.cancel()
            self._wake = None

    def _plan(self) -> None:
        if self._wake is not None:
            self._wake.cancel()
        self._wake = self._loop.call_at(self._flight[0][0], self._arrive) if self._flight else None

    def _arrive(self) -> None:
        self._wake = None
        now = self._loop.time()
        while self._flight and self._flight[0][0] <= now + 1e-9:
            _, _, data, deliver = heapq.heappop(self._flight)
            if self._config.split:
                for at in range(len(data)):
                    deliver(data[at : at + 1])
            else:
                deliver(data)
        self._plan()


class MemoryPeer:
    """The other end. It outlives the link's openings, as a radio outlives the daemon's.

    ``received`` are the packets as they arrived, ``on_bytes`` is called with each. Set ``absent`` to a text and the
    link cannot be opened for that reason.
    """

    def __init__(self, link: MemoryLink) -> None:
        self.received: list[bytes] = []
        self.on_bytes: Deliver | None = None
        self.absent: str | None = None
        self._link = link

    def send(self, data: bytes) -> None:
        """Towards the link; lost if it is not open when the data arrives."""
        self._link.inward.transmit(data, self._link.arrived)

    def hang_up(self, reason: str = "the peer hung up") -> None:
        """Break the link, as an unplugged device does."""
        self._link.fail(f"memory {self._link.name}: {reason}")

    def arrived(self, data: bytes) -> None:
        """One packet, or one byte of it, came through."""
        if len(self.received) >= MAX_RECEIVED:
            del self.received[: MAX_RECEIVED // 2]
        self.received.append(data)
        if self.on_bytes is not None:
            self.on_bytes(data)


class MemoryChannel(Channel):
    """A stream to the peer; each message is one packet."""

    def __init__(self, link: MemoryLink) -> None:
        super().__init__(link, "memory")
        self.intake = StreamIntake(self)
        self._link: MemoryLink | None = link

    def send(self, outgoing: Outgoing, priority: Priority = Priority.FORWARDED, key: Hashable | None = None) -> bool:
        link = self._link
        if link is None or self.is_kept_back(outgoing):
            self.tx_dropped += 1
            return False
        raw = self.encode(outgoing)
        self.tx_frames += 1
        self.tx_bytes += len(raw)
        link.outward.transmit(raw, link.peer.arrived)
        return True

    def close(self) -> None:
        self._link = None
        self.intake.close()


class MemoryLink(Link):
    """One channel to ``peer``. Works in virtual time: it waits by the loop's timers only."""

    config: models.MemoryLinkConfig

    def __init__(self, config: models.MemoryLinkConfig, host: LinkHost, loop: asyncio.AbstractEventLoop) -> None:
        super().__init__(config, host, loop)
        self.peer = MemoryPeer(self)
        self.inward = BadNetwork(config, config.seed, loop)
        self.outward = BadNetwork(config, config.seed + 1, loop)
        self._channel: MemoryChannel | None = None

    @property
    def channels(self) -> list[Channel]:
        return [self._channel] if self._channel is not None else []

    async def open(self) -> None:
        if self.peer.absent is not None:
            raise LinkError(f"memory {self.name}: {self.peer.absent}")
        self._channel = MemoryChannel(self)
        self.host.attach(self._channel)

    async def close(self) -> None:
        self.inward.clear()
        self.outward.clear()
        channel, self._channel = self._channel, None
        if channel is not None:
            channel.close()
            self.host.detach(channel, self.why_closed)

    def counters(self) -> dict[str, Any]:
        return {"lost_in": self.inward.lost, "lost_out": self.outward.lost}

    def arrived(self, data: bytes) -> None:
        """Bytes from the peer came through."""
        if self._channel is not None:
            self._channel.intake.feed(data)
