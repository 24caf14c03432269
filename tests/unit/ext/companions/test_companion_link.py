"""The ground's connection to a companion in virtual time: back-off, silence, calls, and the clock."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import AsyncIterator
from typing import Any

import pytest

from skygcs.errors import DaemonUnreachable, LinkError, RpcError
from skygcs.events import Event
from skygcs.ext.companions.companion_link import CONNECT_S, MAX_CALLS, STATE_GROUPS, CompanionLink
from skygcs.links.base import LONGEST_BACK_OFF_S

pytestmark = pytest.mark.looptime

AHEAD_S = 1000.0


class FakeClient:
    """A companion ``AHEAD_S`` ahead, whose answers take ``delay_s``; silent if that is None, gone after `lose`."""

    def __init__(self, delay_s: float | None = 0.01) -> None:
        self.delay_s = delay_s
        self.called: list[str] = []
        self.closed = False
        self._lost = asyncio.Event()
        self._events: asyncio.Queue[dict[str, Any]] = asyncio.Queue()

    async def call(self, method: str, /, **params: Any) -> Any:
        self.called.append(method)
        if self.delay_s is None or self._lost.is_set():
            await self._lost.wait()
            raise DaemonUnreachable("tls://x", "it closed the connection")
        await asyncio.sleep(self.delay_s / 2)
        now = asyncio.get_running_loop().time()
        await asyncio.sleep(self.delay_s / 2)
        if method == "vehicles.arm":
            raise RpcError(-32002, "refused: on the bench")
        return {"version": "9.9", "monotonic_s": now + AHEAD_S, "unix_s": 0.0, **params}

    async def events(self) -> AsyncIterator[dict[str, Any]]:
        while True:
            getting = asyncio.ensure_future(self._events.get())
            lost = asyncio.ensure_future(self._lost.wait())
            try:
                await asyncio.wait({getting, lost}, return_when=asyncio.FIRST_COMPLETED)
                if not getting.done():
                    raise DaemonUnreachable("tls://x", "it closed the connection")
                yield getting.result()
            finally:
                getting.cancel()
                lost.cancel()

    async def telemetry(self, *, rate_hz: float, groups: tuple[str, ...]) -> AsyncIterator[dict[str, Any]]:
        assert groups == STATE_GROUPS
        yield {"name": "alpha", "control": None}
        await self._lost.wait()
        raise DaemonUnreachable("tls://x", "it closed the connection")

    def report(self, item: dict[str, Any]) -> None:
        self._events.put_nowait(item)

    def lose(self) -> None:
        self._lost.set()

    async def close(self) -> None:
        self.closed = True


class Bench:
    """A link to what ``script`` says: a client, or what dialling raises; later a new FakeClient each time."""

    def __init__(self, *script: FakeClient | Exception) -> None:
        self.loop = asyncio.get_running_loop()
        self.script = list(script)
        self.clients: list[FakeClient] = []
        self.dialled_at: list[float] = []
        self.events: list[Event] = []
        self.asleep: list[bool] = []
        """Answers of the watch, the last one first; False afterwards."""
        link = CompanionLink(
            "pi", "alpha", self.dial, self.loop, self.events.append, lambda: bool(self.asleep) and self.asleep.pop()
        )
        self.link = link

    async def dial(self) -> FakeClient:
        self.dialled_at.append(self.loop.time())
        found = self.script.pop(0) if self.script else FakeClient()
        if isinstance(found, Exception):
            raise found
        self.clients.append(found)
        return found

    def changes(self) -> list[str]:
        return [event.data["change"] for event in self.events]


@contextlib.asynccontextmanager
async def running(*script: FakeClient | Exception) -> AsyncIterator[Bench]:
    bench = Bench(*script)
    task = asyncio.create_task(bench.link.run())
    try:
        yield bench
    finally:
        task.cancel()
        await asyncio.gather(task, return_exceptions=True)
    assert all(client.closed for client in bench.clients)


async def test_it_tries_again_with_longer_and_longer_pauses_and_reports_once() -> None:
    refused = [LinkError("no route to it")] * 8
    async with running(*refused) as bench:
        await asyncio.sleep(60.0)
        waits = [round(b - a, 3) for a, b in zip(bench.dialled_at, bench.dialled_at[1:], strict=False)]
        assert waits == [0.5, 1.0, 2.0, 4.0, 5.0, 5.0, 5.0, 5.0]
        assert max(waits) <= LONGEST_BACK_OFF_S
        assert bench.changes() == ["down", "up"]
        assert bench.link.is_up
        assert bench.link.status()["last_error"] == "no route to it"
        assert bench.link.summary() == {
            "link": "up",
            "since_s": round(bench.loop.time() - bench.link.since, 1),
            "error": None,
            "version": "9.9",
        }
        assert bench.link.status()["version"] == "9.9"


async def test_its_own_requests_are_no_persons_input() -> None:
    async with running() as bench:
        await asyncio.sleep(1.0)
        assert bench.clients[0].called[0] == "operator.relay"


async def test_a_connection_that_ends_is_opened_again_and_flapping_backs_off() -> None:
    async with running() as bench:
        for _ in range(6):
            while not bench.link.is_up:  # noqa: ASYNC110 - in virtual time
                await asyncio.sleep(0.1)
            bench.clients[-1].lose()
            await asyncio.sleep(0.1)
            assert not bench.link.is_up
        waits = [b - a for a, b in zip(bench.dialled_at, bench.dialled_at[1:], strict=False)]
        assert waits == sorted(waits)
        assert bench.changes()[:4] == ["up", "down", "up", "down"]


@pytest.mark.parametrize("reports", [False, True])
async def test_a_companion_that_does_not_answer_is_given_up(reports: bool) -> None:
    async with running() as bench:
        await asyncio.sleep(10.0)
        bench.clients[0].delay_s = None
        for _ in range(20 if reports else 13):
            if reports:  # it reads nothing, and writes on
                bench.clients[0].report({"kind": "text"})
            await asyncio.sleep(1.0)
        assert bench.clients[0].closed
        assert bench.link.is_up
        assert len(bench.clients) == 2
        assert "no answer to clock.read" in str(bench.link.last_error)


async def test_dialling_into_the_void_ends_in_time() -> None:
    async with running(FakeClient(None)) as bench:
        await asyncio.sleep(CONNECT_S + 0.2)
        assert bench.clients[0].closed
        assert bench.link.state == "down"
        assert "no answer within" in str(bench.link.last_error)


async def test_calls_answer_or_say_why_not() -> None:
    async with running() as bench:
        with pytest.raises(LinkError, match="companion pi is not connected"):
            await bench.link.call("daemon.info")
        await asyncio.sleep(1.0)
        assert (await bench.link.call("daemon.info"))["version"] == "9.9"
        with pytest.raises(RpcError, match="on the bench"):
            await bench.link.call("vehicles.arm", {"targets": "all"})
        bench.clients[0].delay_s = 3.0
        with pytest.raises(LinkError, match=r"no answer to daemon\.info within 1 s"):
            await bench.link.call("daemon.info", timeout_s=1.0)
        bench.clients[0].delay_s = None
        waiting = asyncio.create_task(bench.link.call("daemon.info", timeout_s=100.0))
        await asyncio.sleep(0.5)
        bench.clients[0].lose()
        with pytest.raises(LinkError, match=r"the connection ended during daemon\.info"):
            await waiting


async def test_too_many_calls_are_refused() -> None:
    async with running() as bench:
        await asyncio.sleep(1.0)
        bench.clients[0].delay_s = 4.0
        calls = [asyncio.create_task(bench.link.call("daemon.info", timeout_s=10.0)) for _ in range(2 * MAX_CALLS)]
        results = await asyncio.gather(*calls, return_exceptions=True)
        refused = [result for result in results if isinstance(result, LinkError)]
        assert MAX_CALLS <= len(refused) <= MAX_CALLS + 1  # the clock may wait, too
        bench.clients[0].delay_s = 0.01
        await bench.link.call("daemon.info")


async def test_events_and_states_reach_their_observers_across_connections() -> None:
    heard: list[dict[str, Any]] = []
    states: list[dict[str, Any]] = []
    ups: list[bool] = []
    async with running() as bench:
        stop = bench.link.on_events(heard.append)
        bench.link.on_states(states.append)
        bench.link.on_up(ups.append)
        await asyncio.sleep(1.0)
        bench.clients[0].report({"text": "one"})
        await asyncio.sleep(0.1)
        bench.clients[0].lose()
        await asyncio.sleep(10.0)
        bench.clients[1].report({"text": "two"})
        await asyncio.sleep(0.1)
        stop()
        bench.clients[1].report({"text": "three"})
        await asyncio.sleep(0.1)
    assert ups == [True, False, True]
    assert [event["text"] for event in heard] == ["one", "two"]
    assert [state["name"] for state in states] == ["alpha", "alpha"]


@pytest.mark.parametrize("first", ["told", "event", "answer"])
async def test_what_waited_through_a_standstill_does_not_count_and_it_is_connected_anew(first: str) -> None:
    async with running() as bench:
        seen: list[dict[str, Any]] = []
        bench.link.on_events(seen.append)
        await asyncio.sleep(0.1)
        assert bench.link.is_up
        (client,) = bench.clients
        if first == "told":
            bench.link.woke("skygcs stood still for 60 s")
        else:
            bench.asleep.append(True)
        client.report({"text": "of before"})
        if first == "answer":
            with pytest.raises(LinkError, match="stood still"):
                await bench.link.call("companion.contact")
        await asyncio.sleep(0.05)
        assert client.closed and seen == [] and not bench.link.is_up
        await asyncio.sleep(5.0)
        assert len(bench.clients) == 2 and bench.link.is_up
        bench.clients[1].report({"text": "new"})
        await asyncio.sleep(0.05)
        assert seen == [{"text": "new"}]


async def test_the_clock_is_compared_while_it_is_connected() -> None:
    async with running(FakeClient(0.04)) as bench:
        assert bench.link.clock() is None
        await asyncio.sleep(30.0)
        clock = bench.link.clock()
        assert clock is not None
        assert clock.offset_s == pytest.approx(AHEAD_S, abs=0.002)
        assert 0.02 <= clock.error_s < 0.03
        assert bench.link.status()["clock"]["age_s"] <= 3.0
