"""The supervisor: what it tells, how long it waits, and that nothing ends it."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager

import pytest

from skygcs.config import models
from skygcs.errors import LinkError
from skygcs.events import Event
from skygcs.links.base import Channel, Link, LinkSupervisor
from skygcs.runtime.linktable import make_link
from support.hosts import RecordingHost

pytestmark = pytest.mark.looptime


class ScriptedLink(Link):
    """Opens as ``script`` says: None, or what open raises. When the script is used up it opens."""

    def __init__(self, *script: Exception | None) -> None:
        super().__init__(models.MemoryLinkConfig(name="radio"), RecordingHost(), asyncio.get_running_loop())
        self.script = list(script)
        self.opened_at: list[float] = []
        self.closed = 0
        self.close_error: Exception | None = None

    async def open(self) -> None:
        self.opened_at.append(self.loop.time())
        error = self.script.pop(0) if self.script else None
        if error is not None:
            raise error

    async def close(self) -> None:
        self.closed += 1
        if self.close_error is not None:
            raise self.close_error

    @property
    def channels(self) -> list[Channel]:
        return []


@asynccontextmanager
async def supervised(link: Link, events: list[Event]) -> AsyncIterator[LinkSupervisor]:
    supervisor = LinkSupervisor(link, events.append)
    task = asyncio.ensure_future(supervisor.run())
    await asyncio.sleep(0)
    yield supervisor
    task.cancel()
    with pytest.raises(asyncio.CancelledError):
        await task


async def test_a_link_that_opens_is_up_until_it_fails_and_is_opened_again() -> None:
    link = ScriptedLink()
    events: list[Event] = []
    async with supervised(link, events) as supervisor:
        await asyncio.sleep(10)
        assert (supervisor.state, supervisor.opened, supervisor.last_error) == ("up", 1, None)
        link.fail("unplugged")
        await asyncio.sleep(0.1)
        assert (supervisor.state, supervisor.last_error) == ("down", "unplugged")
        await asyncio.sleep(0.5)
        assert (supervisor.state, supervisor.opened) == ("up", 2)
    assert [(event.kind, event.text) for event in events] == [
        ("link_up", "link radio is up"),
        ("link_down", "link radio is down: unplugged"),
        ("link_up", "link radio is up again after 0.5 s"),
    ]
    assert events[1].data == {"link": "radio", "reason": "unplugged"}
    assert link.closed >= 2


async def test_back_off_doubles_to_five_seconds_and_only_the_first_failure_is_told() -> None:
    link = ScriptedLink(*[LinkError(f"missing, try {n}") for n in range(7)])
    events: list[Event] = []
    begin = asyncio.get_running_loop().time()
    async with supervised(link, events) as supervisor:
        await asyncio.sleep(10)
        assert supervisor.state == "down" and supervisor.failures == 5
        assert supervisor.since == begin, "down since the first failure, not since the last try"
        assert supervisor.last_error == "missing, try 4"
        await asyncio.sleep(20)
        assert supervisor.state == "up"
    waits = [b - a for a, b in zip(link.opened_at, link.opened_at[1:], strict=False)]
    assert waits == pytest.approx([0.5, 1.0, 2.0, 4.0, 5.0, 5.0, 5.0])
    assert [event.kind for event in events] == ["link_down", "link_up"]
    assert events[0].text == "link radio is down: missing, try 0"
    assert events[1].data == {"link": "radio", "down_s": 22.5, "failures": 7}


async def test_a_link_that_fails_soon_after_opening_backs_off_ever_longer_and_recovers_when_stable() -> None:
    link = ScriptedLink()
    events: list[Event] = []
    async with supervised(link, events):
        for _ in range(4):
            await asyncio.sleep(0)
            link.fail("at once")
            await asyncio.sleep(5.001)
        waits = [b - a for a, b in zip(link.opened_at, link.opened_at[1:], strict=False)]
        assert waits[0] < 1 and waits == sorted(waits)
        await asyncio.sleep(30)
        before = asyncio.get_running_loop().time()
        link.fail("once more")
        await asyncio.sleep(1)
        assert link.opened_at[-1] - before == pytest.approx(0.5)


async def test_an_unexpected_exception_is_a_failure_told_with_its_type() -> None:
    link = ScriptedLink(ZeroDivisionError("a bug"))
    link.close_error = RuntimeError("another")
    events: list[Event] = []
    async with supervised(link, events) as supervisor:
        await asyncio.sleep(1)
        assert supervisor.state == "up"
        assert events[0].text == "link radio is down: memory radio: unexpected ZeroDivisionError: a bug"
        assert events[1].kind == "link_up"
        link.close_error = None


async def test_a_finished_link_stays_down() -> None:
    link = ScriptedLink()
    events: list[Event] = []
    supervisor = LinkSupervisor(link, events.append)
    task = asyncio.ensure_future(supervisor.run())
    await asyncio.sleep(1)
    link.finished = True
    link.fail("finished: the end of the file")
    await asyncio.sleep(100)
    assert task.done() and task.exception() is None
    assert supervisor.state == "finished" and len(link.opened_at) == 1 and link.closed
    assert events[-1].text == "link radio: finished: the end of the file"
    assert events[-1].data["finished"] is True


async def test_cancelled_at_any_moment_it_closes_the_link() -> None:
    for moment_s in (0.0, 0.25, 0.6):
        link = ScriptedLink(LinkError("not yet"))
        events: list[Event] = []
        async with supervised(link, events):
            await asyncio.sleep(moment_s)
            closed = link.closed
        assert link.closed > closed


@pytest.mark.parametrize(
    ("config", "kind"),
    [
        (models.SerialLinkConfig(device="/dev/ttyUSB0"), "SerialLink"),
        (models.UdpServerLinkConfig(port=14550), "UdpServerLink"),
        (models.UdpClientLinkConfig(host="127.0.0.1", port=14550), "UdpClientLink"),
        (models.UdpBroadcastLinkConfig(port=14550), "UdpBroadcastLink"),
        (models.TcpServerLinkConfig(port=5760), "TcpServerLink"),
        (models.TcpClientLinkConfig(host="127.0.0.1", port=5760), "TcpClientLink"),
        (models.ReplayLinkConfig(file="flight.tlog"), "ReplayLink"),
        (models.MemoryLinkConfig(), "MemoryLink"),
    ],
)
async def test_the_factory_makes_the_link_of_each_configuration(config: models.LinkConfig, kind: str) -> None:
    link = make_link(config, RecordingHost(), asyncio.get_running_loop())
    assert type(link).__name__ == kind and link.config is config
    assert link.channels == []
    await link.close()
