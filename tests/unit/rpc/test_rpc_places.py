"""Places of clients: who gets one, who gives way, and what still works when all are taken."""

from __future__ import annotations

import asyncio
import contextlib
import socket
from collections.abc import AsyncIterator, Callable, Coroutine
from pathlib import Path
from typing import Any

import pytest

from skygcs.rpc import sessions
from skygcs.rpc.client import connect
from skygcs.rpc.dispatch import Dispatcher
from skygcs.rpc.methods import METHODS
from support.rpc_bench import Bench, Peer, running, under_uvloop
from support.table import each


@pytest.fixture
async def bench(tmp_path: Path) -> AsyncIterator[Bench]:
    async with running(tmp_path) as bench:
        yield bench


async def fill(bench: Bench) -> list[Peer]:
    """Clients that have asked for something once, in all places."""
    peers = [await bench.connect() for _ in range(sessions.MAX_SESSIONS)]
    for peer in peers:
        assert "result" in await peer.call("daemon.info")
    return peers


def grow_idle(bench: Bench, seconds: float = sessions.IDLE_S) -> None:
    """As if nobody had asked for anything for so long."""
    assert bench.server._hub is not None
    for one in bench.server._hub._placed:
        one.used_at -= seconds


def stop(targets: str = "all") -> dict[str, Any]:
    return {"jsonrpc": "2.0", "id": 1, "method": "vehicles.stop", "params": {"targets": targets, "action": "hold"}}


async def test_64_clients_refuse_no_stop(bench: Bench) -> None:
    await fill(bench)
    late = await bench.connect()
    answer = await late.call("vehicles.stop", targets="all", action="hold")
    assert answer["result"]["outcomes"]["alpha"]["ok"]
    assert await late.answer() is None, "one request, then it is closed"
    assert [order for order, _ in bench.daemon.vehicle("alpha").orders] == ["stop"]
    assert bench.server.stats()["connections_restricted"] == 1
    assert bench.server.stats()["restricted"] == 0


async def test_what_ends_a_flight_or_shows_it_is_answered_beyond_the_places(bench: Bench) -> None:
    await fill(bench)
    for method in sorted(Dispatcher(METHODS).always):
        params: dict[str, Any] = {"targets": "all"} if method.startswith("vehicles.") else {}
        params |= {"action": "land"} if method == "vehicles.stop" else {}
        params = {"target": "alpha"} if method == "vehicles.get" else params
        answer = await (await bench.connect()).call(method, **params)
        assert "result" in answer, (method, answer)


async def test_nothing_else_is_answered_beyond_the_places(bench: Bench) -> None:
    await fill(bench)
    for request in (
        {"jsonrpc": "2.0", "id": 7, "method": "vehicles.arm", "params": {"targets": "all"}},
        {"jsonrpc": "2.0", "id": 7, "method": "subscribe", "params": {"topic": "events"}},
        {"jsonrpc": "2.0", "id": 7, "method": "vehicles.goto", "params": {"targets": "all"}},
        {"jsonrpc": "2.0", "id": 7, "method": ["vehicles.stop"]},
        [stop(), stop()],
        7,
    ):
        late = await bench.connect()
        late.send(request, stop())
        answer = await late.answer()
        assert answer["error"]["code"] == -32005, request
        assert "vehicles.stop" in answer["error"]["message"], request
        assert answer["id"] == (7 if isinstance(request, dict) else None), request
        assert await late.answer() is None, request
    assert bench.daemon.vehicle("alpha").orders == []


async def test_a_connection_beyond_the_places_that_asks_for_nothing_is_closed(
    bench: Bench, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sessions, "RESERVE_S", 0.05)
    await fill(bench)
    silent, half = await bench.connect(), await bench.connect()
    half.writer.write(b'{"jsonrpc": "2.0", "id": 1')
    assert await silent.answer() is None
    assert await half.answer() is None


async def test_a_stop_beyond_the_places_is_answered_though_it_takes_longer_than_they_have(
    bench: Bench, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sessions, "RESERVE_S", 0.02)
    await fill(bench)
    bench.daemon.vehicle("alpha").delay_s = 0.3
    assert "result" in await (await bench.connect()).call("vehicles.stop", targets="alpha", action="hold")


async def test_the_session_that_is_idle_for_longest_gives_way_and_is_told(bench: Bench) -> None:
    peers = await fill(bench)
    grow_idle(bench)
    assert "result" in await peers[0].call("daemon.info")
    late = await bench.connect()
    assert "result" in await late.call("vehicles.arm", targets="alpha")
    error = (await peers[1].answer())["error"]
    assert error["code"] == -32005
    assert error["message"].startswith("closed: idle for 1")  # 10 s and more, as busy as the computer is
    assert await peers[1].answer() is None
    assert "result" in await peers[0].call("daemon.info")
    assert bench.server.stats()["closed_idle"] == 1


async def test_whoever_subscribes_or_waits_for_an_outcome_is_not_idle(bench: Bench) -> None:
    peers = await fill(bench)
    bench.daemon.vehicle("alpha").delay_s = 30.0
    for number, peer in enumerate(peers):
        if number % 2:
            assert "result" in await peer.call("subscribe", topic="events")
        else:
            peer.send({"jsonrpc": "2.0", "id": 1, "method": "vehicles.arm", "params": {"targets": "alpha"}})
    await bench.until(lambda: len(bench.daemon.vehicle("alpha").orders) == len(peers) // 2)
    grow_idle(bench, 1000.0)
    late = await bench.connect()
    assert (await late.call("vehicles.arm", targets="bravo"))["error"]["code"] == -32005
    assert bench.server.stats()["sessions"] == sessions.MAX_SESSIONS


async def test_a_subscriber_that_does_not_read_is_idle(bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sessions, "IDLE_S", 0.1)
    peers = await fill(bench)
    for peer in peers:
        assert "result" in await peer.call("subscribe", topic="events")
    deaf = peers[17]
    deaf.writer.transport.pause_reading()
    assert bench.server._hub is not None
    placed = list(bench.server._hub._placed)
    while all(one.writable for one in placed):
        deaf.send(*[{"jsonrpc": "2.0", "id": 1, "method": "messages.list"}] * 20)
        await asyncio.sleep(0.01)
    await asyncio.sleep(0.15)
    assert "result" in await (await bench.connect()).call("vehicles.arm", targets="alpha")
    assert bench.server.stats()["closed_idle"] == 1


async def test_a_place_that_is_free_again_is_given_to_one_that_waits_beyond(bench: Bench) -> None:
    peers = await fill(bench)
    late = await bench.connect()
    await bench.until(lambda: bench.server.stats()["restricted"] == 1)
    await peers[0].close()
    await bench.until(lambda: bench.server.stats()["sessions"] == sessions.MAX_SESSIONS - 1)
    for _ in range(2):
        assert "result" in await late.call("vehicles.arm", targets="alpha")
    assert bench.server.stats()["sessions"] == sessions.MAX_SESSIONS


async def test_full_places_are_reported_once_with_who_holds_them_and_once_when_there_are_free_ones(
    bench: Bench,
) -> None:
    peers = await fill(bench)
    for _ in range(5):
        await (await bench.connect()).call("daemon.info")
    assert [e["data"]["change"] for e in warnings(bench)] == ["full"]
    assert "64 by process" in warnings(bench)[0]["text"]
    for peer in peers[:10]:
        await peer.close()
    await bench.until(lambda: len(warnings(bench)) == 2)
    assert warnings(bench)[-1]["data"]["change"] == "not_full"
    for _ in range(10):
        await (await bench.connect()).call("daemon.info")
    await bench.connect()
    assert len(warnings(bench)) == 2, "not again within a few seconds"


def warnings(bench: Bench) -> list[dict[str, Any]]:
    return [event for event in bench.daemon.event_log.recent if event["kind"] == "warning"]


async def test_1000_connections_beyond_the_places_put_out_no_stop(bench: Bench) -> None:
    await fill(bench)
    path = str(bench.server.socket_path)
    flood: list[socket.socket] = []

    def attempt() -> None:
        sock = socket.socket(socket.AF_UNIX)
        sock.setblocking(False)
        with contextlib.suppress(BlockingIOError):
            sock.connect(path)
        flood.append(sock)

    try:
        for burst in range(10):
            for _ in range(50):
                attempt()
            ordering = asyncio.create_task(emergency(bench))
            await asyncio.sleep(0)
            for _ in range(50):
                attempt()
            assert "result" in await ordering, burst
    finally:
        for sock in flood:
            sock.close()
    assert bench.server.stats()["restricted"] <= sessions.MAX_RESERVE
    assert bench.server.stats()["connections_refused"] > 0
    assert len(bench.daemon.vehicle("alpha").orders) == 10


async def test_with_the_last_descriptors_an_older_connection_gives_way_to_a_stop(
    bench: Bench, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of 256 descriptors a flood of connections had taken all, and a newcomer's stop failed."""
    await fill(bench)
    hub = bench.server._hub
    assert hub is not None
    monkeypatch.setattr(sessions, "is_of_the_last", lambda descriptor: len(hub._reserve) >= 4)
    flood = [await bench.connect() for _ in range(20)]
    for _ in range(5):
        assert "result" in await emergency(bench)
    assert len(flood) == 20 and len(hub._reserve) <= 5
    assert bench.server.stats()["connections_refused"] >= 15


async def test_with_the_last_descriptors_nobody_stays_although_places_are_free(
    bench: Bench, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Their first request gave them a place: the descriptors that are kept for a stop were gone with 24 clients."""
    first = await bench.connect()
    await first.call("daemon.info")
    monkeypatch.setattr(sessions, "is_of_the_last", lambda descriptor: True)
    for _ in range(30):
        refused = await (await bench.connect()).call("commands.list")
        assert "no more file descriptors" in refused["error"]["message"]
    assert "result" in await emergency(bench)
    assert bench.server.stats()["sessions"] == 1
    (reported,) = warnings(bench)
    assert "ulimit -n" in reported["text"] and "1 by process" in reported["text"]


async def test_it_is_reported_that_descriptors_ran_out_while_no_client_had_a_place_and_that_there_are_more(
    bench: Bench, monkeypatch: pytest.MonkeyPatch
) -> None:
    """None is never fewer than a share of none: the report stood for good, and kept away each later one."""
    with monkeypatch.context() as short:
        short.setattr(sessions, "is_of_the_last", lambda descriptor: True)
        for _ in range(3):
            await (await bench.connect()).call("commands.list")
    await (await bench.connect()).call("daemon.info")
    assert [e["data"]["change"] for e in warnings(bench)] == ["full", "not_full"]


async def emergency(bench: Bench) -> dict[str, Any]:
    async with connect(bench.server.socket_path) as gcs:
        return {"result": await gcs.call("vehicles.stop", targets="alpha", action="hold")}


async def test_64_flooding_clients_delay_no_stop(bench: Bench) -> None:
    peers = [await bench.connect() for _ in range(sessions.MAX_SESSIONS)]
    line = b'{"jsonrpc":"2.0","method":"commands.list"}\n' * 200

    async def flood(peer: Peer) -> None:
        with contextlib.suppress(ConnectionError):
            while True:
                peer.writer.write(line)
                await peer.writer.drain()
                await asyncio.sleep(0)

    flooding = [asyncio.create_task(flood(peer)) for peer in peers]
    await bench.until(lambda: bench.server.stats().get("lines", 0) > 1000)
    worked_before = bench.server.stats()["lines"]
    for _ in range(5):
        assert "result" in await emergency(bench)
    assert bench.server._hub is not None
    assert all(one.used_at for one in bench.server._hub._placed)
    worked = bench.server.stats()["lines"] - worked_before
    for task, peer in zip(flooding, peers, strict=True):
        task.cancel()
        peer.writer.transport.abort()  # or all that is underway would be answered before the next test
    await asyncio.gather(*flooding, return_exceptions=True)
    # requests beyond the places have their turn first: not one round of all the others' lines was waited for
    assert worked < 5 * 200 * sessions.MAX_SESSIONS


async def test_no_client_keeps_the_loop_longer_than_a_turn(bench: Bench) -> None:
    """All clients have something to do at once: what else the loop has to do comes between after each turn."""
    peers = [await bench.connect() for _ in range(sessions.MAX_SESSIONS)]
    line = b'{"jsonrpc":"2.0","id":1,"method":"messages.list"}\n'
    turns = 0
    hub = bench.server._hub
    assert hub is not None
    run = hub.turns._run

    def counted() -> None:
        nonlocal turns
        turns += 1
        before = hub.counters["lines"]
        began = hub.loop.time()
        run()
        lines = hub.counters["lines"] - before
        spent = hub.loop.time() - began
        assert lines <= 1 or spent < sessions.TURN_S + 10 * spent / lines, (lines, spent)

    hub.turns._run = counted  # type: ignore[method-assign]
    for peer in peers:
        peer.writer.write(line * 2)
    for peer in peers:
        for _ in range(2):
            assert "result" in await peer.answer()
    assert turns > 10


async def test_an_answer_that_is_never_read_keeps_no_connection_for_ever(
    bench: Bench, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sessions, "LINGER_S", 0.1)
    await fill(bench)
    bench.daemon.event_log.recent.extend(
        {"time_unix_s": 1.0, "kind": "armed", "vehicle": None, "sysid": None, "text": "x" * 1000, "data": {}}
        for _ in range(900)
    )
    bench.daemon.links.update({f"link{n}": {"type": "x" * 1000} for n in range(3000)})
    late = await bench.connect()
    late.writer.transport.pause_reading()
    late.send({"jsonrpc": "2.0", "id": 1, "method": "links.list"})
    hub = bench.server._hub
    assert hub is not None
    await bench.until(lambda: hub._lingering)
    await bench.until(lambda: not hub._lingering)
    late.writer.transport.resume_reading()
    with pytest.raises((ConnectionError, ValueError)):
        while await late.answer() is not None:
            pass


# -- TCP


async def test_tcp_clients_without_token_keep_out_none_that_has_it(
    bench: Bench, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sessions, "MAX_UNAUTHENTICATED", 4)
    silent = [await bench.connect_tcp() for _ in range(8)]
    assert "without a token" in (await silent[0].answer())["error"]["message"]
    assert await silent[0].answer() is None
    late = await bench.connect_tcp()
    assert (await late.call("auth", token="open sesame"))["result"] == {"ok": True}
    assert "result" in await late.call("vehicles.arm", targets="alpha")
    assert bench.server.stats()["unauthenticated"] <= 4


async def test_a_tcp_client_with_the_token_can_stop_though_all_places_are_taken(bench: Bench) -> None:
    await fill(bench)
    late = await bench.connect_tcp()
    assert (await late.call("auth", token="open sesame"))["result"] == {"ok": True}
    assert "result" in await late.call("vehicles.stop", targets="all", action="hold")
    assert await late.answer() is None
    late = await bench.connect_tcp()
    late.send(stop())
    assert (await late.answer())["error"]["code"] == -32004


@pytest.mark.deep  # the same again on the other loop
@each(
    "scenario",
    [
        test_64_clients_refuse_no_stop,
        test_the_session_that_is_idle_for_longest_gives_way_and_is_told,
        test_full_places_are_reported_once_with_who_holds_them_and_once_when_there_are_free_ones,
        test_1000_connections_beyond_the_places_put_out_no_stop,
        test_64_flooding_clients_delay_no_stop,
        test_no_client_keeps_the_loop_longer_than_a_turn,
        test_a_tcp_client_with_the_token_can_stop_though_all_places_are_taken,
    ],
)
def test_the_same_holds_under_uvloop_which_the_daemon_uses(
    tmp_path: Path, scenario: Callable[[Bench], Coroutine[Any, Any, None]]
) -> None:
    under_uvloop(tmp_path, scenario)
