"""The pages behind the WebSocket: what they may ask, what they are sent, what they cannot do to the process."""

from __future__ import annotations

import asyncio
import json
from typing import Any

import pytest

from skygcs.errors import DaemonUnreachable, RpcError
from skygcs.rpc.client_connection import OnReport
from skygcs.web.page_clients import (
    EVENTS_WAITING,
    LOOKING,
    MANY_RATE_HZ,
    MANY_VEHICLES,
    REPORTS_WAITING,
    STUCK_S,
    PageClient,
    PageClients,
)
from skygcs.web.request_limits import MAX_ENDING_WAITING, MAX_REFUSED, MAX_WAITING
from skygcs.web.sign_in import Role
from skygcs.web.state_batches import LatestStates

pytestmark = pytest.mark.looptime


class FakeSource:
    """A daemon that records what it is asked; ``held`` keeps answers back."""

    def __init__(self) -> None:
        self.connected = self.takes_orders = True
        self.slow = False
        self.text = "connected"
        self.since = 0.0
        self.note = self.site = None
        self.info: dict[str, Any] = {}
        self.calls: list[tuple[str, dict[str, Any]]] = []
        self.deadlines: list[float | None] = []
        self.reports: list[OnReport | None] = []
        self.active = 0
        self.held: asyncio.Event | None = None

    async def call(
        self, method: str, params: dict[str, Any], deadline_s: float | None = None, on_report: OnReport | None = None
    ) -> bytes:
        self.calls.append((method, params))
        self.deadlines.append(deadline_s)
        self.reports.append(on_report)
        if self.held is not None:
            await self.held.wait()
        if method == "vehicles.get":
            raise RpcError(-32001, "no such vehicle", {"x": 1})
        if method == "links.list":
            raise DaemonUnreachable("sock", "gone")
        if method == "router.stats":
            raise KeyError("a fault")
        return json.dumps({"called": method}).encode()

    def operator_active(self) -> None:
        self.active += 1


class FakeSocket:
    """``reads`` False: a page that takes nothing."""

    def __init__(self) -> None:
        self.sent: list[dict[str, Any]] = []
        self.reads = asyncio.Event()
        self.reads.set()
        self.aborted = False

    async def send_frame(self, data: bytes) -> None:
        await self.reads.wait()
        self.sent.append(json.loads(data))

    def abort(self) -> None:
        self.aborted = True
        self.reads.set()


class Bench:
    def __init__(self) -> None:
        self.states = LatestStates()
        self.source = FakeSource()
        self.pages = PageClients(self.states, self.source, {"web.ping": self._ping, "replay.seek": self._ping})
        self.tasks: list[asyncio.Task[None]] = []

    async def _ping(self, _: PageClient, __: dict[str, Any]) -> Any:
        return {"now_s": 1.0}

    def page(
        self, role: Role = "command", *, rate_hz: float | None = None, browser: str = "browser"
    ) -> tuple[PageClient, FakeSocket]:
        socket = FakeSocket()
        page = PageClient(self.pages, socket, role, browser)
        self.pages.clients[page] = None
        self.tasks.append(asyncio.create_task(page.send()))
        if rate_hz is not None:
            page.subscribe(rate_hz)
        return page, socket

    async def close(self) -> None:
        await self.pages.close()
        await asyncio.gather(*self.tasks)


@pytest.fixture
async def bench() -> Any:
    bench = Bench()
    yield bench
    await bench.close()


def request(method: str, request_id: object = 1, **more: Any) -> str:
    return json.dumps({"jsonrpc": "2.0", "id": request_id, "method": method, **more})


def soon() -> float:
    return asyncio.get_running_loop().time() + 3


async def test_a_request_is_passed_on_and_answered(bench: Bench) -> None:
    page, socket = bench.page("view")
    page.on_message(request("vehicles.list", "a", params={"targets": "all"}))
    await asyncio.sleep(0.01)
    assert bench.source.calls == [("vehicles.list", {"targets": "all"})]
    assert socket.sent == [{"jsonrpc": "2.0", "id": "a", "result": {"called": "vehicles.list"}}]


async def test_an_order_is_passed_on_with_its_deadline_and_a_question_without(bench: Bench) -> None:
    page, _ = bench.page()
    deadline_s = soon()
    page.on_message(request("vehicles.arm", deadline_s=deadline_s))
    page.on_message(request("vehicles.land", 2, deadline_s=deadline_s))
    page.on_message(request("vehicles.list", 3, deadline_s="of no use"))
    await asyncio.sleep(0.01)
    assert bench.source.deadlines == [deadline_s, deadline_s, None]


async def test_reports_of_an_order_reach_its_page_with_the_pages_own_id(bench: Bench) -> None:
    page, socket = bench.page()
    _, other = bench.page()
    bench.source.held = asyncio.Event()
    page.on_message(request("vehicles.stop", "s", deadline_s=soon(), report=True))
    page.on_message(request("vehicles.stop", 2, deadline_s=soon()))
    page.on_message(request("vehicles.list", 3, report=True))
    await asyncio.sleep(0.01)
    report, *others = bench.source.reports
    assert report is not None and others == [None, None]
    report("order.begun", {"request": 77, "vehicles": ["a", "b"]})
    report("order.outcome", {"request": 77, "vehicle": "a", "outcome": {"ok": True}})
    await asyncio.sleep(0.01)
    wanted = [("order.begun", "s"), ("order.outcome", "s")]
    assert [(sent["method"], sent["params"]["request"]) for sent in socket.sent] == wanted
    # a page that takes nothing gets the rest with the reply
    socket.reads.clear()
    for n in range(3000):
        report("order.outcome", {"request": 77, "vehicle": str(n), "outcome": {"ok": True}})
    assert len(page._replies) <= REPORTS_WAITING
    socket.reads.set()
    bench.source.held.set()
    await asyncio.sleep(0.05)
    assert {sent.get("id") for sent in socket.sent} >= {"s", 2, 3} and other.sent == []


async def test_a_slow_daemon_is_shown_and_orders_go_on(bench: Bench) -> None:
    page, socket = bench.page()
    bench.pages.notify("web.plan", {"state": "flying"}, keep=True)
    bench.source.slow = True
    bench.pages.on_daemon()
    page.on_message(request("vehicles.hold", deadline_s=soon()))
    await asyncio.sleep(0.01)
    shown = next(sent["params"] for sent in socket.sent if sent.get("method") == "web.daemon")
    assert shown["connected"] and shown["slow"]
    assert bench.source.calls == [("vehicles.hold", {})]
    _, late = bench.page()
    bench.pages.offer_kept(next(client for client in bench.pages.clients if client is not page))
    await asyncio.sleep(0.01)
    assert [sent["method"] for sent in late.sent] == ["web.plan"]


@pytest.mark.parametrize(
    ("method", "code"), [("vehicles.get", -32001), ("links.list", -32010), ("router.stats", -32603)]
)
async def test_an_error_is_answered_with_its_code(bench: Bench, method: str, code: int) -> None:
    page, socket = bench.page()
    page.on_message(request(method))
    await asyncio.sleep(0.01)
    assert socket.sent[0]["error"]["code"] == code


@pytest.mark.parametrize(
    ("text", "code"),
    [
        ("", -32700),
        ("{", -32700),
        ("NaN", -32700),
        ('{"id":1,"method":"vehicles.goto","params":{"lat_deg":1e999}}', -32700),
        ("\ud800", -32700),
        ("[" * 10_000, -32700),
        ("[" * 100_000, -32005),
        ("[]", -32600),
        ("3", -32600),
        ('{"id":1}', -32600),
        ('{"id":1,"method":3}', -32600),
        ('{"method":"vehicles.list"}', -32600),
        ('{"id":true,"method":"vehicles.list"}', -32600),
        ('{"id":[],"method":"vehicles.list"}', -32600),
        ('{"id":"' + "x" * 65 + '","method":"vehicles.list"}', -32600),
        ('{"id":' + "9" * 400 + ',"method":"vehicles.list"}', -32600),
        ('{"id":1,"method":"vehicles.arm","deadline_s":' + "9" * 400 + "}", -32012),
        ('{"id":1,"method":"vehicles.list","params":[1]}', -32602),
        ('{"id":1,"method":"no.such"}', -32601),
        ('{"id":1,"method":"web.no"}', -32601),
        ('{"id":1,"method":"subscribe"}', -32002),
        ('{"id":1,"method":"operator.relay"}', -32002),
        ('{"id":1,"method":"corrections.send"}', -32002),
    ],
)
async def test_what_is_no_request_is_refused(bench: Bench, text: str, code: int) -> None:
    page, socket = bench.page()
    page.on_message(text)
    await asyncio.sleep(0.01)
    assert socket.sent[0]["error"]["code"] == code
    assert bench.source.calls == []


async def test_the_role_view_orders_nothing(bench: Bench) -> None:
    page, socket = bench.page("view")
    for number, method in enumerate(("vehicles.arm", "vehicles.stop", "params.set", "messages.send", "replay.seek")):
        page.on_message(request(method, number, deadline_s=soon()))
    page.on_message('{"method":"operator.active"}')
    await asyncio.sleep(0.01)
    assert [answer["error"]["code"] for answer in socket.sent] == [-32011] * 5
    assert bench.source.calls == [] and bench.source.active == 0


async def test_an_order_needs_a_deadline_and_is_not_carried_out_after_it(bench: Bench) -> None:
    page, socket = bench.page()
    await asyncio.sleep(100)
    page.on_message(request("vehicles.arm"))
    page.on_message(request("vehicles.stop", deadline_s=soon() - 3.1))
    page.on_message(request("vehicles.arm", deadline_s=soon() + 3600))
    page.on_message(request("vehicles.arm", params={"targets": "1"}, deadline_s=soon()))
    await asyncio.sleep(0.01)
    assert [answer.get("error", {}).get("code") for answer in socket.sent] == [-32012, -32012, -32012, None]
    assert bench.source.calls == [("vehicles.arm", {"targets": "1"})]


async def test_while_the_daemon_is_gone_an_order_is_refused_at_once_and_never_sent_later(bench: Bench) -> None:
    bench.source.connected = False
    page, socket = bench.page()
    page.on_message(request("vehicles.land", deadline_s=soon()))
    await asyncio.sleep(0.01)
    assert socket.sent[0]["error"]["code"] == -32010
    bench.source.connected = True
    bench.pages.on_daemon()
    await asyncio.sleep(60)
    assert bench.source.calls == []


async def test_an_order_goes_on_when_its_page_leaves_and_a_question_does_not(bench: Bench) -> None:
    bench.source.held = asyncio.Event()
    page, _ = bench.page()
    page.on_message(request("vehicles.takeoff", 1, deadline_s=soon()))
    page.on_message(request("vehicles.list", 2))
    await asyncio.sleep(0.01)
    page.close()
    await asyncio.sleep(0.01)
    names = [task.get_name() for task in asyncio.all_tasks() if task.get_name().startswith("page ")]
    assert names == ["page order"]
    bench.source.held.set()
    await asyncio.sleep(0.01)
    assert not bench.pages.orders


async def test_only_a_persons_input_counts_and_not_too_often(bench: Bench) -> None:
    page, _ = bench.page(rate_hz=10)
    page.on_message(request("vehicles.list"))
    page.on_message(request("vehicles.arm", deadline_s=soon()))
    page.on_message(request("web.ping", 3))
    await asyncio.sleep(10)
    assert bench.source.active == 0
    for _ in range(100):
        page.on_message('{"jsonrpc":"2.0","method":"operator.active"}')
    assert bench.source.active == 1
    await asyncio.sleep(1)
    page.on_message('{"jsonrpc":"2.0","method":"operator.active"}')
    assert bench.source.active == 2


async def test_waiting_requests_are_bounded_and_stop_has_its_own_allowance(bench: Bench) -> None:
    bench.source.held = asyncio.Event()
    page, socket = bench.page()
    for number in range(40):
        page.on_message(request("vehicles.list", number))
    await asyncio.sleep(0.01)
    assert len(bench.source.calls) == MAX_WAITING
    assert {answer["error"]["code"] for answer in socket.sent} == {-32005}
    for number in range(MAX_ENDING_WAITING + 1):
        page.on_message(request("vehicles.stop", f"stop {number}", deadline_s=soon()))
    await asyncio.sleep(0.01)
    assert [method for method, _ in bench.source.calls].count("vehicles.stop") == MAX_ENDING_WAITING


async def test_the_pages_of_one_browser_leave_places_for_the_stop_of_another(bench: Bench) -> None:
    bench.source.held = asyncio.Event()
    pages = [bench.page() for _ in range(4)]
    for number in range(MAX_ENDING_WAITING):
        for page, _ in pages:
            page.on_message(request("vehicles.stop", number, deadline_s=soon()))
    other, other_socket = bench.page(browser="another")
    other.on_message(request("vehicles.stop", deadline_s=soon()))
    await asyncio.sleep(0.01)
    assert len(bench.source.calls) == MAX_ENDING_WAITING + 1
    assert other_socket.sent == []
    bench.source.held.set()
    await asyncio.sleep(0.01)
    assert "result" in other_socket.sent[0]
    page, socket = pages[-1]
    page.on_message(request("vehicles.stop", "again", deadline_s=soon()))
    await asyncio.sleep(0.01)
    assert "result" in socket.sent[-1]


async def test_pages_that_only_look_leave_room_for_questions_of_those_that_order(bench: Bench) -> None:
    bench.source.held = asyncio.Event()
    for browser in range(4):
        page, _ = bench.page("view", browser=f"viewer {browser}")
        for n in range(MAX_WAITING):
            page.on_message(json.dumps({"id": n, "method": "undo.list", "params": {}}))
    await asyncio.sleep(0.1)
    assert len(bench.source.calls) == LOOKING
    operator, _ = bench.page()
    operator.on_message(json.dumps({"id": 1, "method": "events.recent", "params": {}}))
    await asyncio.sleep(0.1)
    assert bench.source.calls[LOOKING:] == [("events.recent", {})]
    page.close()  # what waited of it is given up, the others get their turn
    bench.source.held.set()
    await asyncio.sleep(0.1)
    assert len(bench.source.calls) == 3 * MAX_WAITING + 1


async def test_replies_that_are_not_read_count_as_waiting(bench: Bench) -> None:
    page, socket = bench.page()
    socket.reads.clear()
    for number in range(1000):
        page.on_message(request("vehicles.list", number))
        await asyncio.sleep(0.05)
    assert len(bench.source.calls) <= MAX_WAITING + 1


async def test_a_flooding_page_is_closed(bench: Bench) -> None:
    page, socket = bench.page()
    other, other_socket = bench.page()
    for _ in range(MAX_REFUSED + 1):
        page.on_message("x")
    await asyncio.sleep(0.01)
    assert socket.aborted and page not in bench.pages.clients
    assert not other_socket.aborted and other in bench.pages.clients
    assert len(socket.sent) <= EVENTS_WAITING


async def test_a_page_that_takes_nothing_costs_bounded_memory_and_is_closed(bench: Bench) -> None:
    stuck, stuck_socket = bench.page(rate_hz=10)
    _, socket = bench.page(rate_hz=10)
    await asyncio.sleep(0.1)
    stuck_socket.reads.clear()
    for number in range(200):
        for name in ("a", "b"):
            bench.states.put(name, b'{"name":"%b"}' % name.encode(), asyncio.get_running_loop().time())
        bench.pages.on_states()
        for _ in range(5):
            bench.pages.on_event({"kind": "mode", "n": number})
        bench.pages.notify("web.daemon", {"n": number})
        await asyncio.sleep(0.1)
    assert len(stuck._events) == EVENTS_WAITING and len(stuck._notices) == 1 and not stuck._replies
    assert stuck in bench.pages.clients
    await asyncio.sleep(STUCK_S)
    bench.pages.wake_all()
    assert stuck_socket.aborted and stuck not in bench.pages.clients
    batches = [m["params"]["seq"] for m in socket.sent if m["method"] == "web.state"]
    assert len(batches) > 150 and batches == list(range(1, len(batches) + 1))


async def test_a_page_that_reads_again_gets_the_newest_state_and_how_many_events_it_missed(bench: Bench) -> None:
    page, socket = bench.page(rate_hz=10)
    await asyncio.sleep(0.1)
    socket.reads.clear()
    for number in range(300):
        bench.states.put("a", b'{"name":"a","n":%d}' % number, asyncio.get_running_loop().time())
        bench.pages.on_states()
        bench.pages.on_event({"n": number})
        await asyncio.sleep(0.05)
    socket.sent.clear()
    socket.reads.set()
    await asyncio.sleep(0.5)
    events = [m["params"] for m in socket.sent if m["method"] == "event"]
    assert sum(params.get("dropped", 0) for params in events) + len(events) >= 299
    states = [v["n"] for m in socket.sent if m["method"] == "web.state" for v in m["params"]["vehicles"]]
    assert states[-1] == 299 and len(states) <= 2
    assert page in bench.pages.clients


async def test_states_of_a_large_fleet_come_less_often(bench: Bench) -> None:
    bench.page(rate_hz=10)
    for number in range(MANY_VEHICLES):
        bench.states.put(f"v{number}", b"{}", 0.0)
    assert bench.pages.rate_hz() == 10
    bench.states.put("one more", b"{}", 0.0)
    assert bench.pages.rate_hz() == MANY_RATE_HZ
    bench.page(rate_hz=20)
    assert bench.pages.rate_hz() == MANY_RATE_HZ
    bench.states.reset()
    assert bench.pages.rate_hz() == 20


async def test_pages_of_different_rates(bench: Bench) -> None:
    _, slow = bench.page(rate_hz=1)
    _, quick = bench.page(rate_hz=20)
    for number in range(100):
        bench.states.put("a", b'{"n":%d}' % number, asyncio.get_running_loop().time())
        bench.pages.on_states()
        await asyncio.sleep(0.05)
    assert bench.pages.rate_hz() == 20
    count = [sum(m["method"] == "web.state" for m in socket.sent) for socket in (slow, quick)]
    assert 5 <= count[0] <= 12 and count[1] >= 95


async def test_of_a_daemon_that_is_away_no_fleet_is_sent(bench: Bench) -> None:
    """An empty one would be shown as a fleet without vehicles."""
    _, socket = bench.page(rate_hz=10)
    bench.states.put("a", b'{"name":"a"}', asyncio.get_running_loop().time())
    bench.pages.on_states()
    bench.states.reset()  # lost before the round was sent
    bench.source.connected = False
    bench.pages.on_daemon()
    await asyncio.sleep(5.0)
    assert [m["method"] for m in socket.sent] == ["web.daemon"]
    bench.source.connected = True
    bench.pages.on_daemon()
    bench.states.put("a", b'{"name":"a"}', asyncio.get_running_loop().time())
    bench.pages.on_states()
    await asyncio.sleep(0.2)
    assert [m["method"] for m in socket.sent] == ["web.daemon", "web.daemon", "web.state"]
    assert socket.sent[-1]["params"]["full"] is True


async def test_a_page_that_comes_later_gets_the_newest_plan_until_the_daemon_is_gone(bench: Bench) -> None:
    for state in ("loaded", "flying"):
        bench.pages.notify("web.plan", {"state": state}, keep=True)
    bench.pages.notify("web.other", {})
    _, socket = bench.page(rate_hz=10)
    await asyncio.sleep(0.1)
    assert [(m["method"], m["params"]) for m in socket.sent] == [("web.plan", {"state": "flying"})]
    bench.source.connected = False
    bench.pages.on_daemon()
    _, later = bench.page(rate_hz=10)
    await asyncio.sleep(0.1)
    assert later.sent == []


async def test_nothing_comes_of_what_waits_on_a_page_that_was_closed(bench: Bench) -> None:
    """A browser that is signed out may have thousands of unread messages, and an order among them."""
    page, _ = bench.page()
    bench.pages.close_pages()
    page.on_message(request("vehicles.arm", targets="all", deadline_s=bench.pages.loop.time() + 3.0))
    page.on_message('{"jsonrpc":"2.0","method":"operator.active"}')
    page.on_message("no JSON")
    await asyncio.sleep(1.0)
    assert page.closed and bench.source.calls == [] and bench.source.active == 0
