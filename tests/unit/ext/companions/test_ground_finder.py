"""mDNS between a ground and a companion: restarts, changed addresses and networks that come up later. In virtual time,
with a network in memory in place of zeroconf's."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import AsyncIterator, Callable
from types import SimpleNamespace
from typing import Any

import pytest

from skygcs.errors import LinkError
from skygcs.events import Event
from skygcs.ext.companions import ground_finder
from skygcs.ext.companions.companion_table import CompanionConfig
from skygcs.ext.companions.ground_finder import AGAIN_S, SERVICE, GroundAnnouncement, GroundFinder

pytestmark = pytest.mark.looptime

NAME = "base"


class Network:
    """What is announced, and who looks for it. ``up``: mDNS can be opened."""

    def __init__(self) -> None:
        self.up = True
        self.announced: dict[str, Any] = {}
        self.browsers: list[Callable[..., None]] = []
        self.opened = self.closed = 0

    def open(self, interfaces: Any) -> Any:
        if not self.up:
            raise LinkError("mDNS cannot be used: Network is unreachable")
        self.opened += 1
        own: list[str] = []
        watching: list[Callable[..., None]] = []

        async def register(info: Any, allow_name_change: bool) -> Any:
            own.append(info.name)
            self.announced[info.name] = info
            self.tell(info.name, "Added")
            return asyncio.sleep(0)

        async def unregister_all() -> None:
            for name in own:
                self.announced.pop(name, None)
                self.tell(name, "Removed")
            own.clear()

        async def close() -> None:
            self.closed += 1
            for browser in watching:
                self.browsers.remove(browser)

        return SimpleNamespace(
            zeroconf=SimpleNamespace(network=self, watching=watching),
            async_register_service=register,
            async_unregister_all_services=unregister_all,
            async_close=close,
        )

    def tell(self, name: str, change: str) -> None:
        for browser in list(self.browsers):
            browser(self.zeroconf, SERVICE, name, SimpleNamespace(name=change))

    @property
    def zeroconf(self) -> Any:
        return SimpleNamespace(network=self)

    def die(self) -> None:
        """The ground is killed: nothing is withdrawn, but mDNS forgets it after its time to live."""
        for name in list(self.announced):
            del self.announced[name]


def browser(zeroconf: Any, service: str, handlers: list[Callable[..., None]]) -> None:
    network = zeroconf.network
    network.browsers += handlers
    zeroconf.watching.extend(handlers)
    for name in list(network.announced):
        handlers[0](zeroconf, service, name, SimpleNamespace(name="Added"))


class Info:
    """Both sides' AsyncServiceInfo."""

    def __init__(self, service: str, name: str, **announced: Any) -> None:
        self.name = name
        self.port = announced.get("port")
        self.hosts = announced.get("parsed_addresses", [])
        self.properties: dict[bytes, bytes] = {}

    async def async_request(self, zeroconf: Any, within_ms: int) -> bool:
        found = zeroconf.network.announced.get(self.name)
        if found is None:
            await asyncio.sleep(within_ms / 1000)
            return False
        self.port, self.hosts = found.port, found.hosts
        return True

    def parsed_scoped_addresses(self) -> list[str]:
        return list(self.hosts)


class Links:
    """The link table of either side."""

    def __init__(self, loop: asyncio.AbstractEventLoop) -> None:
        self.configs: dict[str, Any] = {}
        self.opened: list[str] = []
        self.heard_at: float | None = None
        self._loop = loop

    def __contains__(self, name: str) -> bool:
        return name in self.configs

    async def add(self, name: str, table: dict[str, Any]) -> None:
        self.configs[name] = table
        self.opened.append(f"{table['host']}:{table['port']}")
        self.heard_at = None

    async def remove(self, name: str) -> None:
        del self.configs[name]

    def link_channels(self, name: str) -> list[Any]:
        return [] if self.heard_at is None else [SimpleNamespace(last_rx_at=self.heard_at, rx_frames=1)]


class Pair:
    def __init__(self, network: Network, addresses: list[str]) -> None:
        loop = asyncio.get_running_loop()
        self.network = network
        self.addresses = addresses
        """Of the ground's computer."""
        self.events: list[Event] = []
        self.ground_links, self.links = Links(loop), Links(loop)
        self.ground_links.configs["wifi"] = SimpleNamespace(type="udp_server", host="0.0.0.0", port=14650)
        self.finder = GroundFinder(
            CompanionConfig(vehicle="alpha"),
            self.links,  # type: ignore[arg-type]
            loop,
            self.events.append,
        )
        self.announcement = self.new_announcement()

    def new_announcement(self) -> GroundAnnouncement:
        return GroundAnnouncement("wifi", (), self.ground_links, self.events.append, name=NAME)  # type: ignore[arg-type]

    async def hear(self, seconds: float) -> None:
        """The companion hears the ground while it sends to an address that the ground has."""
        end = asyncio.get_running_loop().time() + seconds
        while asyncio.get_running_loop().time() < end:
            opened = self.links.opened[-1].partition(":")[0] if self.links.opened else None
            if opened in self.addresses and self.network.announced:
                self.links.heard_at = asyncio.get_running_loop().time()
            await asyncio.sleep(0.5)


@contextlib.asynccontextmanager
async def running(*coroutines: Any) -> AsyncIterator[list[asyncio.Task[None]]]:
    tasks = [asyncio.create_task(each) for each in coroutines]
    try:
        yield tasks
        assert not any(task.done() for task in tasks), [task.exception() for task in tasks if task.done()]
    finally:
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)


@pytest.fixture
async def pair(monkeypatch: pytest.MonkeyPatch) -> Pair:
    made = Pair(Network(), ["10.0.0.1"])
    monkeypatch.setattr(ground_finder, "open_zeroconf", made.network.open)
    monkeypatch.setattr(ground_finder, "own_addresses", lambda: tuple(made.addresses))
    monkeypatch.setattr("zeroconf.asyncio.AsyncServiceBrowser", browser)
    monkeypatch.setattr("zeroconf.asyncio.AsyncServiceInfo", Info)
    return made


async def test_a_ground_whose_address_changes_is_announced_anew_and_followed(pair: Pair) -> None:
    async with running(pair.announcement.run(), pair.finder.run()):
        await pair.hear(10)
        assert pair.announcement.announced == f"{NAME} at 10.0.0.1 port 14650"
        assert pair.links.opened == ["10.0.0.1:14650"]
        await pair.hear(300)
        assert pair.links.opened == ["10.0.0.1:14650"], "one that is heard stays"
        assert pair.network.opened == 2, "and mDNS is not begun anew"
        pair.addresses[:] = ["10.0.9.7"]  # another lease of DHCP
        await pair.hear(2 * AGAIN_S)
        assert pair.announcement.announced == f"{NAME} at 10.0.9.7 port 14650"
        assert pair.links.opened[-1] == "10.0.9.7:14650"
        found = [e.text for e in pair.events if e.data and e.data.get("change") == "ground"]
        assert found[-1] == f"ground station {NAME} found at udp:10.0.9.7:14650"
    assert pair.network.announced == {}, "it is withdrawn at the end"
    assert pair.network.opened == pair.network.closed


async def test_a_ground_that_is_killed_and_started_again_elsewhere_is_found(pair: Pair) -> None:
    async with running(pair.finder.run()):
        first = asyncio.create_task(pair.announcement.run())
        await pair.hear(10)
        pair.network.die()
        first.cancel()
        await asyncio.gather(first, return_exceptions=True)
        await pair.hear(120)
        assert pair.links.opened == ["10.0.0.1:14650"], "the only one stays although it is silent"
        pair.addresses[:] = ["10.0.0.2"]
        async with running(pair.new_announcement().run()):
            await pair.hear(20)
            assert pair.links.opened[-1] == "10.0.0.2:14650"


async def test_while_nobody_is_heard_mdns_is_begun_anew_and_each_one_is_closed(pair: Pair) -> None:
    async with running(pair.finder.run()):
        await asyncio.sleep(10 * AGAIN_S)
        assert 8 <= pair.network.opened <= 11 and pair.network.opened - pair.network.closed == 1
        assert len(pair.network.browsers) == 1


async def test_a_network_that_comes_up_later_is_used_and_the_reason_is_told_once(pair: Pair) -> None:
    pair.network.up = False
    async with running(pair.announcement.run(), pair.finder.run()):
        await asyncio.sleep(5 * AGAIN_S)
        told = [e.text for e in pair.events]
        assert len(told) == 2 and all("Network is unreachable" in text for text in told), told
        assert pair.finder.problem and pair.announcement.problem
        pair.network.up = True
        await pair.hear(2 * AGAIN_S)
        assert pair.finder.problem is None and pair.announcement.problem is None
        assert pair.links.opened == ["10.0.0.1:14650"]


async def test_without_an_address_nothing_is_announced_until_there_is_one(pair: Pair) -> None:
    pair.addresses.clear()
    async with running(pair.announcement.run()):
        await asyncio.sleep(2 * AGAIN_S)
        assert pair.announcement.announced is None and "is the network up?" in str(pair.announcement.problem)
        pair.addresses.append("10.0.0.5")
        await asyncio.sleep(AGAIN_S + 1)
        assert pair.announcement.announced == f"{NAME} at 10.0.0.5 port 14650"
