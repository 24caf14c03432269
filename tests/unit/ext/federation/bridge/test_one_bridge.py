"""The parts that claim a site's name, over a hub in memory that can be cut in two, in virtual time."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import AsyncIterator, Callable
from typing import Any

import pytest

from skygcs.events import Event
from skygcs.ext.federation.bridge.bus import Message, OnMessage
from skygcs.ext.federation.bridge.one_bridge import OneBridge
from skygcs.ext.federation.protocol.bridge_election import TAKE_OVER_S, BridgeElection, BridgeState

pytestmark = pytest.mark.looptime

ACTIVE, STANDBY = BridgeState.ACTIVE, BridgeState.STANDBY


class Net:
    def __init__(self) -> None:
        self.sides: list[SideBus] = []


class SideBus:
    """One station's connection. ``side``: of a network that may be cut; None: no hub there."""

    def __init__(self, net: Net, side: int | None = 0) -> None:
        self.net = net
        self.side = side
        self.readers: dict[str, OnMessage] = {}
        self.observers: list[Callable[[], None]] = []
        net.sides.append(self)

    @property
    def connected(self) -> bool:
        return self.side is not None

    def move(self, side: int | None) -> None:
        self.side = side
        for observer in self.observers:
            observer()

    async def publish(self, subject: str, data: bytes) -> bool:
        loop = asyncio.get_running_loop()
        for bus in self.net.sides:
            if self.side is not None and bus.side == self.side and (reader := bus.readers.get(subject)) is not None:
                loop.call_later(0.01, reader, Message(subject, data))
        return self.connected

    async def subscribe(self, subject: str, on_message: OnMessage) -> Any:
        self.readers[subject] = on_message
        bus = self

        class Subscribed:
            async def close(self) -> None:
                del bus.readers[subject]

        return Subscribed()

    def on_change(self, observer: Callable[[], None]) -> None:
        self.observers.append(observer)


class Bridge:
    def __init__(self, net: Net, run: str, side: int | None = 0, pid: int = 1) -> None:
        loop = asyncio.get_running_loop()
        self.events: list[Event] = []
        self.states: list[BridgeState] = []
        self.bus = SideBus(net, side)
        election = BridgeElection(run, f"host-{run}", pid)
        clock = loop.time
        self.one = OneBridge(self.bus, "south", election, clock, self.events.append, clock)  # type: ignore[arg-type]
        self.one.on_change = lambda: self.states.append(self.one.state)

    @contextlib.asynccontextmanager
    async def running(self) -> AsyncIterator[OneBridge]:
        task = asyncio.create_task(self.one.run())
        try:
            yield self.one
        finally:
            task.cancel()
            await asyncio.gather(task, return_exceptions=True)


async def test_alone_it_acts_within_a_second_and_says_nothing() -> None:
    bridge = Bridge(Net(), "a")
    async with bridge.running() as one:
        await asyncio.sleep(1.0)
        assert one.state is ACTIVE and bridge.states == [BridgeState.ASKING, ACTIVE]
        await asyncio.sleep(60.0)
        assert bridge.events == [] and one.status() == {"state": "active", "other": None}


async def test_the_second_one_stands_by_and_takes_over_after_the_first_has_ended() -> None:
    net = Net()
    first, second = Bridge(net, "b", pid=11), Bridge(net, "a", pid=22)
    async with second.running() as two:
        second.bus.move(None)
        async with first.running() as one:
            await asyncio.sleep(1.0)
            second.bus.move(0)
            await asyncio.sleep(60.0)
            assert (one.state, two.state) == (ACTIVE, STANDBY)
            assert two.status()["other"] == {"state": "active", "host": "host-b", "pid": 11}
            assert one.status()["other"] == {"state": "standby", "host": "host-a", "pid": 22}
            leader = "another bridge of south (host host-b, process 11) leads and this one stands by: ask there"
            assert (one.why_standby(), two.why_standby()) == (None, leader)
            (event,) = second.events
            assert event.kind == "warning" and "host-b, process 11" in event.text and "end one of the two" in event.text
            (event,) = first.events
            assert "host-a, process 22" in event.text and "stands by: end it" in event.text
        await asyncio.sleep(TAKE_OVER_S - 1.5)
        assert two.state is STANDBY  # a bridge that was killed has time to come back
        assert two.why_standby() == "another bridge of south leads and this one stands by: ask there"
        await asyncio.sleep(4.0)
        assert two.state is ACTIVE and "the other bridge is gone" in second.events[-1].text


async def test_after_both_sides_of_a_cut_network_acted_one_goes_on_within_a_claim() -> None:
    net = Net()
    first, second = Bridge(net, "b"), Bridge(net, "a")
    async with first.running() as one:
        await asyncio.sleep(1.0)
        async with second.running() as two:
            await asyncio.sleep(1.0)
            second.bus.move(1)
            await asyncio.sleep(TAKE_OVER_S + 3.0)
            assert (one.state, two.state) == (ACTIVE, ACTIVE)
            second.bus.move(0)
            await asyncio.sleep(0.05)  # it claims at once where it comes
            assert (one.state, two.state) == (ACTIVE, STANDBY)
            assert first.states == [BridgeState.ASKING, ACTIVE]


async def test_what_is_no_claim_is_counted() -> None:
    net = Net()
    bridge = Bridge(net, "a")
    async with bridge.running() as one:
        await asyncio.sleep(1.0)
        await SideBus(net).publish("bridge.south", b"{")
        await asyncio.sleep(1.0)
        assert one.state is ACTIVE and one.status()["claims_bad"] == 1
