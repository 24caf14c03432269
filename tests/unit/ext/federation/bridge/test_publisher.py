"""What a site sends: one batch per round of its daemon, and none that looks newer than it is."""

from __future__ import annotations

import asyncio
import json
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from types import SimpleNamespace
from typing import Any

import pytest

from skygcs.errors import DaemonUnreachable, RpcError
from skygcs.ext.federation.bridge.bus import Message
from skygcs.ext.federation.bridge.publisher import MAX_FULL_AT_ONCE, Publisher
from skygcs.ext.federation.protocol.own_states import OwnStates
from skygcs.ext.federation.protocol.state_batch import StateBatch, decode_batch

pytestmark = pytest.mark.looptime

PERIOD_S = 0.1


class FakeBus:
    """Keeps what is published; a test calls what is served."""

    def __init__(self) -> None:
        self.published: list[tuple[float, str, bytes]] = []
        self.served: dict[str, Callable[[Message], Any]] = {}
        self.takes = True

    async def publish(self, subject: str, data: bytes) -> bool:
        if self.takes:
            self.published.append((asyncio.get_running_loop().time(), subject, data))
        return self.takes

    async def serve(self, subject: str, on_request: Callable[[Message], Any]) -> Any:
        self.served[subject] = on_request

        async def close() -> None:
            del self.served[subject]

        return SimpleNamespace(close=close)

    async def ask(self, pattern: str, subject: str, data: bytes = b"") -> dict[str, Any]:
        answer: dict[str, Any] = json.loads(await self.served[pattern](Message(subject, data)))
        return answer

    def batches(self, series: str = "fast") -> list[tuple[float, StateBatch]]:
        return [(at, decode_batch(data)) for at, subject, data in self.published if subject == f"state.north.{series}"]


class FakeClient:
    """A daemon's connection: a test puts rounds of states into ``rounds``."""

    def __init__(self) -> None:
        self.rounds: asyncio.Queue[dict[str, Any] | None] = asyncio.Queue()
        self.event_queue: asyncio.Queue[dict[str, Any]] = asyncio.Queue()
        self.asked: list[str] = []
        self.answers = asyncio.Event()
        self.answers.set()

    async def encoded_telemetry(self, targets: str, *, rate_hz: float, groups: Any) -> AsyncIterator[dict[str, Any]]:
        while (update := await self.rounds.get()) is not None:
            yield update
        raise DaemonUnreachable("d.sock", "it closed the connection")

    async def events(self) -> AsyncIterator[dict[str, Any]]:
        while True:
            yield await self.event_queue.get()

    async def call(self, method: str, **params: Any) -> Any:
        self.asked.append(method)
        await self.answers.wait()
        return {}

    def give(self, *names: str, age_s: float = 0.0) -> None:
        """A whole round."""
        states = {
            name: json.dumps(
                {"name": name, "sysid": i, "compid": 1, "connected": True, "last_heartbeat_age_s": age_s}
            ).encode()
            for i, name in enumerate(names, 1)
        }
        self.rounds.put_nowait({"states": states, "complete": True})


class FakeLink:
    def __init__(self, client: FakeClient | None) -> None:
        self.client = client
        self.whole: Any = {"name": "alpha"}
        self._observers: list[Callable[[], None]] = []

    def on_change(self, observer: Callable[[], None]) -> None:
        self._observers.append(observer)

    def change(self, client: FakeClient | None) -> None:
        self.client = client
        for observer in self._observers:
            observer()

    async def run(self) -> None:
        await asyncio.Event().wait()

    async def call(self, method: str, **params: Any) -> Any:
        assert method == "origin.get"
        return {"origin": {"lat_deg": 48.0, "lon_deg": 11.0, "alt_amsl_m": 500.0, "x_heading_deg": 90.0}}

    async def relay(self, method: str, params: dict[str, Any]) -> bytes:
        if isinstance(self.whole, Exception):
            raise self.whole
        if self.whole is None:
            await asyncio.Event().wait()
        return json.dumps({**self.whole, "asked": params["target"]}).encode()


class Rig:
    def __init__(self, share: tuple[str, ...]) -> None:
        loop = asyncio.get_running_loop()
        self.bus, self.client = FakeBus(), FakeClient()
        self.link = FakeLink(self.client)
        clock: Any = SimpleNamespace(now_s=loop.time, site_s=lambda: 1e9 + loop.time())
        bus: Any = self.bus
        link: Any = self.link
        self.publisher = Publisher(bus, link, clock, OwnStates("north", "r1", PERIOD_S, share), 1 / PERIOD_S)

    async def rounds(self, seconds: float, *names: str) -> None:
        """The daemon sends rounds for so long."""
        for _ in range(round(seconds / PERIOD_S)):
            self.client.give(*names)
            await asyncio.sleep(PERIOD_S)


@asynccontextmanager
async def rig(*share: str) -> AsyncIterator[Rig]:
    made = Rig(share or ("all",))
    task = asyncio.create_task(made.publisher.run())
    await asyncio.sleep(0.01)
    try:
        yield made
    finally:
        task.cancel()
        await asyncio.gather(task, return_exceptions=True)
        assert made.bus.served == {}


async def test_each_round_is_one_batch_at_once_and_every_fifth_is_a_slow_one_too() -> None:
    async with rig() as made:
        await made.rounds(3.0, "alpha", "bravo")
        fast, slow = made.bus.batches(), made.bus.batches("slow")
        assert 29 <= len(fast) <= 31 and 6 <= len(slow) <= 7
        assert [batch.seq for _, batch in fast] == list(range(1, len(fast) + 1))
        at, last = fast[-1]
        assert [row.name for row in last.vehicles] == ["alpha", "bravo"] and last.daemon
        assert last.sent_s == pytest.approx(1e9 + at, abs=1e-3)
        assert last.vehicles[0].age_s is not None and last.vehicles[0].age_s < 0.01
        assert last.origin is not None and last.origin.lat_deg == 48.0


async def test_it_ends_although_its_daemon_is_lost_in_the_turn_in_which_it_is_cancelled() -> None:
    made = Rig(("all",))
    task = asyncio.create_task(made.publisher.run())
    await made.rounds(0.5, "alpha")
    made.client.rounds.put_nowait(None)
    for _ in range(4):  # the task of the rounds fails; its group is told in the next turn
        await asyncio.sleep(0)
        if made.client.rounds.empty():
            break
    task.cancel()
    done, _ = await asyncio.wait({task}, timeout=30)
    assert done and task.cancelled()


async def test_a_daemon_that_stands_still_or_goes_has_states_that_grow_old() -> None:
    async with rig() as made:
        await made.rounds(0.5, "alpha")
        await asyncio.sleep(5.0)
        at, batch = made.bus.batches()[-1]
        assert batch.daemon and batch.vehicles[0].age_s == pytest.approx(at - 0.41, abs=0.05)
        made.client.rounds.put_nowait(None)
        made.link.change(None)
        await asyncio.sleep(10.0)
        _, batch = made.bus.batches()[-1]
        assert not batch.daemon and not batch.vehicles[0].heard
        made.client = FakeClient()
        made.link.change(made.client)
        await made.rounds(0.3, "bravo")
        _, batch = made.bus.batches()[-1]
        assert batch.daemon and [row.name for row in batch.vehicles] == ["bravo"]


async def test_what_lay_in_the_socket_while_this_process_stood_still_is_as_old_as_that() -> None:
    """A process that was stopped finds states of before: they have no time of their own."""
    async with rig() as made:
        await made.rounds(1.0, "alpha")
        made.client.answers.clear()
        await asyncio.sleep(60.0)  # as SIGSTOP; then what was in the socket is read
        made.client.give("alpha")
        made.client.give("alpha")
        await asyncio.sleep(0.05)
        _, batch = made.bus.batches()[-1]
        assert batch.vehicles[0].age_s is not None and batch.vehicles[0].age_s >= 60.0
        assert made.client.asked == ["daemon.info"]
        made.client.answers.set()  # the daemon's answer comes after all that it had written before
        await asyncio.sleep(0.01)
        await made.rounds(0.3, "alpha")
        _, batch = made.bus.batches()[-1]
        assert batch.vehicles[0].age_s < 0.01  # type: ignore[operator]


async def test_a_hub_that_takes_nothing_costs_only_batches_that_are_counted() -> None:
    async with rig() as made:
        made.bus.takes = False
        await made.rounds(1.0, "alpha")
        assert made.bus.published == [] and made.publisher.status()["batches_dropped"] >= 10
        made.bus.takes = True
        await made.rounds(0.2, "alpha")
        assert made.bus.batches()[0][1].seq > 10


async def test_events_of_shared_vehicles_and_of_the_site_go_out_in_order() -> None:
    async with rig("alpha") as made:
        await made.rounds(0.2, "alpha", "bravo")
        for vehicle in ("alpha", "bravo", None):
            made.client.event_queue.put_nowait({"kind": "armed", "vehicle": vehicle, "text": "x"})
        await asyncio.sleep(0.01)
        events = [json.loads(data) for _, subject, data in made.bus.published if subject == "event.north"]
        assert [(e["seq"], e["event"]["vehicle"]) for e in events] == [(1, "alpha"), (2, None)]


async def test_pings_are_answered_with_the_clock_of_the_batches() -> None:
    async with rig() as made:
        now = asyncio.get_running_loop().time()
        answer = await made.bus.ask("here.north", "here.north", b'{"t0_s": 12.5}')
        assert answer == {"t0_s": 12.5, "site_s": pytest.approx(1e9 + now, abs=1e-3), "run": "r1"}
        for bad in (b"", b"[1]", b'{"t0_s": "x"}', b'{"t0_s": NaN}', b"\xff"):
            assert "error" in await made.bus.ask("here.north", "here.north", bad)
        assert made.publisher.status()["pings_bad"] == 5


async def test_a_whole_state_is_given_of_shared_vehicles_and_to_few_at_a_time() -> None:
    async with rig("alpha") as made:
        await made.rounds(0.2, "alpha", "bravo")
        pattern = "state.north.full.*"
        answer = await made.bus.ask(pattern, "state.north.full.alpha")
        assert answer["state"] == {"name": "alpha", "asked": "alpha"} and answer["sent_s"] > 1e9
        assert "shares no vehicle 'bravo'" in (await made.bus.ask(pattern, "state.north.full.bravo"))["error"]
        assert "is not a vehicle's name" in (await made.bus.ask(pattern, "state.north.full.=zz"))["error"]
        made.link.whole = RpcError(-32001, "no vehicle 'alpha'")
        assert (await made.bus.ask(pattern, "state.north.full.alpha"))["error"] == "no vehicle 'alpha'"
        made.link.whole = None  # it does not answer
        asked = [made.bus.ask(pattern, "state.north.full.alpha") for _ in range(MAX_FULL_AT_ONCE + 2)]
        errors = [answer["error"] for answer in await asyncio.gather(*asked)]
        assert sum("does not answer" in error for error in errors) == MAX_FULL_AT_ONCE
        assert made.publisher.status()["full_refused"] == 2
