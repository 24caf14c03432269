"""A hub in memory, with the faults of a network: messages to and from it are cut, delayed, doubled and reordered.

It does what nats-server does for request and reply: a request without a subscriber is answered so at once, what goes
to a client whose connection is open waits while the network is cut, and is lost with the connection.
"""

from __future__ import annotations

import asyncio
import fnmatch
import random
from collections.abc import Awaitable, Callable
from dataclasses import dataclass

from skygcs.errors import HubAway, NobodyThere, ReplyLost

OnRequest = Callable[[str, bytes], Awaitable[bytes]]
RECONNECT_S = 0.1


@dataclass
class Faults:
    """Of a connection's messages, each way. ``reorder``: one is overtaken by those of the next two seconds."""

    delay_s: float = 0.002
    double: float = 0.0
    reorder: float = 0.0


class MemoryHub:
    """Clients are made by `MemoryBus`."""

    def __init__(self, seed: int) -> None:
        self.rng = random.Random(seed)
        self.running = True
        self.clients: list[MemoryBus] = []

    def stop(self) -> None:
        self.running = False
        for client in self.clients:
            client.reset()

    def start(self) -> None:
        self.running = True

    def on_request(self, sender: MemoryBus, number: int, subject: str, payload: bytes) -> None:
        found = [c for c in self.clients if c.connected and c.pattern and fnmatch.fnmatchcase(subject, c.pattern)]
        if not found:
            sender.to_client(lambda: sender.on_reply(number, None))
        for client in found:
            client.to_client(lambda c=client: c.on_request(subject, payload, sender, number))  # type: ignore[misc]

    def on_reply(self, sender: MemoryBus, number: int, payload: bytes) -> None:
        if sender.connected:
            sender.to_client(lambda: sender.on_reply(number, payload))


class MemoryBus:
    """One client of the hub, with the interface that the parts of the bridge use."""

    def __init__(self, hub: MemoryHub, loop: asyncio.AbstractEventLoop) -> None:
        self.hub = hub
        self.faults = Faults()
        self.connected = True
        self.pattern = ""
        self.published: list[tuple[str, bytes]] = []
        self._loop = loop
        self._on_request: OnRequest | None = None
        self._answering: set[asyncio.Task[None]] = set()
        self._requests: dict[int, asyncio.Future[bytes | None]] = {}
        self._numbers = 0
        self._connection = 0
        self._cut_until = 0.0
        self._free_at = {True: 0.0, False: 0.0}
        hub.clients.append(self)

    # -- what the bridge uses

    async def request(self, subject: str, data: bytes, timeout_s: float) -> bytes:
        if not self.connected:
            raise HubAway(subject, "no connection to the hub")
        self._numbers += 1
        number = self._numbers
        future = self._requests[number] = self._loop.create_future()
        self.to_hub(lambda: self.hub.on_request(self, number, subject, data))
        try:
            async with asyncio.timeout(timeout_s):
                answer = await future
        except TimeoutError:
            raise ReplyLost(subject, "no answer in time") from None
        finally:
            self._requests.pop(number, None)
        if answer is None:
            raise NobodyThere(subject, "nobody takes messages of this subject now")
        return answer

    def publish(self, subject: str, payload: bytes) -> None:
        if self.connected:
            self.published.append((subject, payload))

    def serve(self, pattern: str, on_request: OnRequest) -> None:
        self.pattern, self._on_request = pattern, on_request

    # -- the network

    def cut(self, seconds: float) -> None:
        """Nothing passes for so long; what is sent meanwhile arrives afterwards, if the connection lasts."""
        self._cut_until = max(self._cut_until, self._loop.time() + seconds)

    def reset(self) -> None:
        """The connection is lost with everything on its way. It is made again after a while."""
        self._connection += 1
        self._cut_until = 0.0
        if self.connected:
            self.connected = False
            self._loop.call_later(RECONNECT_S, self._reconnect)

    def close(self) -> None:
        self._connection += 1
        self.connected = False
        self.hub.clients.remove(self)
        for task in self._answering:
            task.cancel()

    def _reconnect(self) -> None:
        if self not in self.hub.clients:
            return
        if self.hub.running and self._loop.time() >= self._cut_until:
            self.connected = True
        else:
            self._loop.call_later(RECONNECT_S, self._reconnect)

    def to_hub(self, arrive: Callable[[], None]) -> None:
        self._send(arrive, up=True)

    def to_client(self, arrive: Callable[[], None]) -> None:
        self._send(arrive, up=False)

    def _send(self, arrive: Callable[[], None], *, up: bool) -> None:
        rng, connection = self.hub.rng, self._connection
        for _ in range(2 if rng.random() < self.faults.double else 1):
            late_s = rng.random() * 2.0 if rng.random() < self.faults.reorder else 0.0
            now = self._loop.time()
            at = max(now, self._cut_until) + self.faults.delay_s * rng.random()
            if not late_s:
                at = self._free_at[up] = max(at, self._free_at[up])  # in order, as TCP's
            self._loop.call_at(at + late_s, self._arrive, connection, arrive)

    def _arrive(self, connection: int, arrive: Callable[[], None]) -> None:
        if connection != self._connection:
            return  # lost with its connection
        if self._loop.time() < self._cut_until:  # it was on its way when the cut began
            self._loop.call_at(self._cut_until, self._arrive, connection, arrive)
            return
        arrive()

    # -- what arrives

    def on_request(self, subject: str, payload: bytes, sender: MemoryBus, number: int) -> None:
        task = self._loop.create_task(self._answer(subject, payload, sender, number), name="answer")
        self._answering.add(task)
        task.add_done_callback(self._answering.discard)

    async def _answer(self, subject: str, payload: bytes, sender: MemoryBus, number: int) -> None:
        assert self._on_request is not None
        answer = await self._on_request(subject, payload)
        if self.connected:
            self.to_hub(lambda: self.hub.on_reply(sender, number, answer))

    def on_reply(self, number: int, payload: bytes | None) -> None:
        future = self._requests.get(number)
        if future is not None and not future.done():
            future.set_result(payload)
