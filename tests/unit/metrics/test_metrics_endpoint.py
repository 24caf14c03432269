"""The HTTP address over real sockets: what a scraper gets, and what a bad client cannot do."""

from __future__ import annotations

import asyncio
import contextlib
import socket
from collections.abc import AsyncIterator

import pytest

from skygcs.config.metrics import MetricsConfig
from skygcs.errors import LinkError
from skygcs.events import Event
from skygcs.ext.metrics.order_results import MAX_ORDER_RESULTS, OrderResults
from skygcs.metrics import endpoint as module
from skygcs.metrics.endpoint import MAX_CONNECTIONS, MetricsEndpoint
from skygcs.runtime.event_log import EventLog


class Collector:
    """Counts collections instead of making them."""

    def __init__(self) -> None:
        self.rendered = 0

    async def render(self) -> bytes:
        await asyncio.sleep(0)
        self.rendered += 1
        return b"skygcs_x %d\n" % self.rendered


class Bench:
    def __init__(self, token: str | None) -> None:
        self.now = 100.0
        self.endpoint = MetricsEndpoint(MetricsConfig(port=0), token, lambda: self.now)
        self.collector = Collector()

    async def connect(self) -> tuple[asyncio.StreamReader, asyncio.StreamWriter]:
        assert self.endpoint.address is not None
        return await asyncio.open_connection(*self.endpoint.address)

    async def ask(self, request: bytes) -> tuple[bytes, bytes]:
        """Head and body of the answer to these bytes."""
        reader, writer = await self.connect()
        assert self.endpoint.address is not None
        writer.write(request.replace(b"Host: x", b"Host: 127.0.0.1:%d" % self.endpoint.address[1]))
        answer = await reader.read()
        writer.close()
        with contextlib.suppress(OSError):
            await writer.wait_closed()
        head, _, body = answer.partition(b"\r\n\r\n")
        return head, body


@contextlib.asynccontextmanager
async def running(token: str | None = None) -> AsyncIterator[Bench]:
    bench = Bench(token)
    bench.endpoint.claim()
    await bench.endpoint.start(bench.collector)
    try:
        yield bench
    finally:
        await bench.endpoint.close()


def get(path: str = "/metrics", *headers: str, method: str = "GET") -> bytes:
    return "\r\n".join((f"{method} {path} HTTP/1.1", "Host: x", *headers, "", "")).encode()


async def test_only_requests_for_its_own_address_are_answered() -> None:
    """A page whose name was made to lead to this machine could read the numbers otherwise."""
    async with running() as bench:
        assert bench.endpoint.address is not None
        port = bench.endpoint.address[1]
        for host, status in (
            (f"127.0.0.1:{port}", b"200"),
            (f"localhost:{port}", b"200"),
            (f"evil.example:{port}", b"421"),
            ("127.0.0.1:1", b"421"),
            (f"127.0.0.1:{port}\r\nOrigin: http://evil.example", b"421"),
        ):
            head, _ = await bench.ask(f"GET /metrics HTTP/1.1\r\nHost: {host}\r\n\r\n".encode())
            assert head.split(b" ")[1] == status, host
        assert (await bench.ask(b"GET /metrics HTTP/1.1\r\n\r\n"))[0].startswith(b"HTTP/1.1 421")


async def test_a_scraper_gets_the_text_format_with_its_length() -> None:
    async with running() as bench:
        head, body = await bench.ask(get())
        assert head.startswith(b"HTTP/1.1 200 OK") and b"text/plain; version=0.0.4" in head
        assert b"Content-Length: 11" in head and body == b"skygcs_x 1\n"
        head, body = await bench.ask(get("/metrics?x=1", method="HEAD"))
        assert b"Content-Length: 11" in head and body == b""


async def test_what_else_is_asked_for_is_refused_with_its_reason() -> None:
    async with running() as bench:
        assert (await bench.ask(get("/")))[0].startswith(b"HTTP/1.1 404")
        assert (await bench.ask(get(method="POST")))[0].startswith(b"HTTP/1.1 405")
        assert (await bench.ask(b"\x00\xff\r\n\r\n"))[0].startswith(b"HTTP/1.1 400")
        assert (await bench.ask(b"GET /metrics\r\n\r\n"))[0].startswith(b"HTTP/1.1 400")
        assert (await bench.ask(b"GET /" + b"a" * 20_000 + b"\r\n\r\n"))[0].startswith(b"HTTP/1.1 431")
        assert bench.collector.rendered == 0


async def test_scrapers_at_the_same_time_and_within_a_second_share_one_collection() -> None:
    async with running() as bench:
        answers = await asyncio.gather(*(bench.ask(get()) for _ in range(MAX_CONNECTIONS)))
        assert {body for _, body in answers} == {b"skygcs_x 1\n"}
        bench.now += 1.0
        assert (await bench.ask(get()))[1] == b"skygcs_x 2\n"


async def test_the_token_is_needed_where_there_is_one() -> None:
    async with running("0123456789abcdef") as bench:
        for wrong in ((), ("Authorization: Bearer 0123456789abcdeX",), ("Authorization: Basic 0123456789abcdef",)):
            head, body = await bench.ask(get("/metrics", *wrong))
            assert head.startswith(b"HTTP/1.1 401") and b"WWW-Authenticate: Bearer" in head and b"skygcs" not in body
        head, _ = await bench.ask(get("/metrics", "authorization:  bearer 0123456789abcdef "))
        assert head.startswith(b"HTTP/1.1 200")


async def test_slow_clients_lose_their_connection_and_take_nobody_s_place_for_long(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(module, "REQUEST_S", 0.05)
    async with running() as bench:
        idle = [await bench.connect() for _ in range(MAX_CONNECTIONS + 3)]
        for _, writer in idle:
            writer.write(b"GET /met")
        for reader, writer in idle:
            with contextlib.suppress(ConnectionError):
                assert await reader.read() == b""
            writer.close()
        assert (await bench.ask(get()))[0].startswith(b"HTTP/1.1 200")


@pytest.mark.parametrize("sent", [b"", b"GET /met"])
async def test_clients_that_never_ask_keep_no_scraper_out(sent: bytes) -> None:
    async with running() as bench:
        idle = [await bench.connect() for _ in range(5 * MAX_CONNECTIONS)]
        for _, writer in idle:
            writer.write(sent)
        assert (await bench.ask(get()))[0].startswith(b"HTTP/1.1 200")
        for _, writer in idle:
            writer.transport.abort()


async def test_a_client_that_breaks_off_costs_nothing() -> None:
    async with running() as bench:
        for data in (b"", b"GET /metrics HTTP/1.1\r\n", get()):
            _, writer = await bench.connect()
            writer.write(data)
            writer.transport.abort()
        assert (await bench.ask(get()))[0].startswith(b"HTTP/1.1 200")


async def test_an_address_that_is_taken_and_a_missing_library_are_one_line(monkeypatch: pytest.MonkeyPatch) -> None:
    with socket.create_server(("127.0.0.1", 0)) as taken:
        config = MetricsConfig(port=taken.getsockname()[1])
        endpoint = MetricsEndpoint(config, None, lambda: 0.0)
        with pytest.raises(
            LinkError, match=r"\[metrics\]: cannot listen on 127.0.0.1:\d+: port \d+ is in use by another program"
        ):
            endpoint.claim()
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    with pytest.raises(LinkError, match=r"pip install 'skygcs\[metrics\]'"):
        Bench(None).endpoint.claim()


def test_orders_are_counted_by_result_and_never_without_bound() -> None:
    events = EventLog(lambda: 100.0)
    results = OrderResults(events)

    def ended(order: str, result: str | None) -> None:
        data = {"order": order} if result is None else {"order": order, "result": result}
        events.publish(Event("command", "a", 1, "…", data))

    ended("arm", "accepted")
    ended("arm", "accepted")
    ended("arm", "refused")
    ended("arm", "in_progress")
    ended("arm", None)
    assert results.counts == {("arm", "accepted"): 2, ("arm", "refused"): 1}
    for number in range(2 * MAX_ORDER_RESULTS):
        ended(f"order{number}", "ok")
    assert len(results.counts) <= MAX_ORDER_RESULTS + 1
    assert results.counts["other", "other"] == MAX_ORDER_RESULTS + 2
