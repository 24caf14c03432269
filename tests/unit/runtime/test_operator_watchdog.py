"""Who counts as somebody, when the count begins, and what is done about silence: once."""

from __future__ import annotations

import asyncio
from typing import Any, cast

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mav

from skygcs.core.control.deadman import DeadMan, DeadManAction
from skygcs.events import Event
from skygcs.runtime.fleet import Fleet
from skygcs.runtime.fleet_orders import Order
from skygcs.runtime.operator_watchdog import OperatorWatchdog
from support.vehicles import Voice

pytestmark = pytest.mark.looptime


class Actor:
    def __init__(self, name: str) -> None:
        self.name = name


class FakeFleet:
    """What the operator watchdog asks of a fleet: who is flown, and an order for them."""

    def __init__(self) -> None:
        self.names: list[str] = []
        self.given: list[tuple[float, list[str], str]] = []
        self.fails: Exception | None = None
        self.lasts_s = 0.0

    def flown(self) -> list[Actor]:
        return [Actor(name) for name in self.names]

    @property
    def orders(self) -> FakeFleet:
        return self

    async def command_all(self, names: list[str], order: Order, *, by_person: bool) -> dict[str, Any]:
        assert not by_person, "a pilot who takes one meanwhile keeps it"
        self.given.append((asyncio.get_running_loop().time(), names, order.__name__))
        await asyncio.sleep(self.lasts_s)
        if self.fails is not None:
            raise self.fails
        return {}


class Watch:
    def __init__(self, timeout_s: float | None = 10.0, action: DeadManAction = "hold") -> None:
        self.loop = asyncio.get_running_loop()
        self.fleet = FakeFleet()
        self.events: list[Event] = []
        dead_man = DeadMan(timeout_s, action)
        self.man = OperatorWatchdog(dead_man, cast(Fleet, self.fleet), self.loop, self.events.append)

    async def wait(self, seconds: int) -> None:
        """With a tick a second."""
        for _ in range(seconds):
            await asyncio.sleep(1)
            self.man.tick(self.loop.time())
        await asyncio.sleep(0.01)

    def orders(self) -> list[tuple[list[str], str]]:
        return [(names, order) for _, names, order in self.fleet.given]


async def test_silence_over_what_is_flown_is_acted_upon_once_and_told() -> None:
    watch = Watch(action="land")
    watch.fleet.names = ["bravo", "alpha"]
    await watch.wait(9)
    assert watch.orders() == []
    await watch.wait(30)
    assert watch.orders() == [(["alpha", "bravo"], "land")]
    (event,) = watch.events
    assert event.kind == "warning" and event.text.endswith(": land for alpha, bravo")
    assert event.data == {"action": "land", "vehicles": ["alpha", "bravo"]}


async def test_a_client_or_a_ground_station_is_somebody_a_vehicle_is_nobody() -> None:
    watch = Watch()
    watch.fleet.names = ["alpha"]
    station = Voice(255, 190).say(mav.MAVLink_heartbeat_message(6, 8, 0, 0, 4, 3))
    for i in range(8):
        await watch.wait(5)
        if i % 2:
            watch.man.on_client()
        else:
            watch.man.on_heartbeat(station, watch.loop.time())
    assert watch.orders() == []
    for _ in range(12):
        watch.man.on_heartbeat(Voice(1).beat(), watch.loop.time())
        await watch.wait(1)
    assert len(watch.orders()) == 1
    assert "last: a client of the socket" in watch.events[0].text


async def test_the_last_sign_of_life_is_named() -> None:
    watch = Watch()
    watch.fleet.names = ["alpha"]
    watch.man.on_heartbeat(Voice(254, 190).say(mav.MAVLink_heartbeat_message(6, 8, 0, 0, 4, 3)), watch.loop.time())
    await watch.wait(1)  # that control began counts anew
    await watch.wait(12)
    assert "ground station 254/190" in watch.events[0].text


async def test_over_a_fleet_that_skygcs_does_not_fly_silence_means_nothing() -> None:
    watch = Watch()
    watch.man.on_client()
    await watch.wait(60)
    assert watch.orders() == []
    watch.fleet.names = ["alpha"]  # flown now: it counts from here
    await watch.wait(9)
    assert watch.orders() == []
    await watch.wait(3)
    assert len(watch.orders()) == 1


async def test_each_vehicle_that_begins_is_given_the_whole_time() -> None:
    watch = Watch()
    watch.fleet.names = ["alpha"]
    await watch.wait(8)
    watch.fleet.names = ["alpha", "bravo"]
    await watch.wait(8)
    assert watch.orders() == []
    await watch.wait(4)
    assert watch.orders() == [(["alpha", "bravo"], "hold")]


async def test_off_unless_configured() -> None:
    watch = Watch(None)
    assert not watch.man.watching
    watch.fleet.names = ["alpha"]
    await watch.wait(100)
    assert watch.orders() == [] and watch.events == []


async def test_an_order_that_fails_inside_is_told() -> None:
    watch = Watch()
    watch.fleet.names, watch.fleet.fails = ["alpha"], RuntimeError("a bug")
    await watch.wait(12)
    assert [event.kind for event in watch.events] == ["warning", "fault"]
    assert "dead-man hold failed inside skygcs: RuntimeError('a bug')" in watch.events[1].text


async def test_closing_ends_what_is_under_way() -> None:
    watch = Watch()
    watch.fleet.names, watch.fleet.lasts_s = ["alpha"], 100.0
    await watch.wait(12)
    watch.man.close()
    await asyncio.sleep(0)
    await asyncio.sleep(0)
    assert len(asyncio.all_tasks()) == 1 and len(watch.events) == 1
