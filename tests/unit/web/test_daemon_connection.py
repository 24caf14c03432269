"""The web process as a client of a daemon that is not there, does not answer, or comes later."""

from __future__ import annotations

import asyncio
import json
import math
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import pytest
from structlog.testing import capture_logs

from skygcs.errors import RpcError
from skygcs.rpc.error_codes import INVALID_PARAMS
from skygcs.web import daemon_connection
from skygcs.web.daemon_connection import DaemonConnection
from skygcs.web.state_batches import LatestStates
from support.hosts import until
from support.table import each


class Pages:
    """One page that wants states, and what it is sent."""

    def __init__(self) -> None:
        self.wanted = asyncio.Event()
        self.woken = asyncio.Event()
        self.rounds = 0

    def on_states(self) -> None:
        self.rounds += 1

    def on_event(self, event: dict[str, Any]) -> None: ...
    def on_daemon(self) -> None: ...
    def notify(self, method: str, params: Any, *, keep: bool = False) -> None: ...

    def wake_all(self) -> None:
        self.woken.set()

    def rate_hz(self) -> float | None:
        return 10.0


class Daemon:
    """Takes connections. It answers while ``answers`` is set; ``requests`` are those that it has read. No vehicle."""

    def __init__(self) -> None:
        self.answers = asyncio.Event()
        self.requests: list[dict[str, Any]] = []
        self.writers: list[asyncio.StreamWriter] = []
        self.ahead_s = 0.0
        self.telemetry: list[tuple[asyncio.StreamWriter, int]] = []
        self.more: dict[str, Any] = {}
        """Further keys of every answer."""

    async def serve(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        self.writers.append(writer)
        while line := await reader.readline():
            await self.answers.wait()
            request = json.loads(line)
            self.requests.append(request)
            if "id" not in request:
                continue
            if request["params"].get("topic") == "telemetry":
                self.telemetry.append((writer, request["id"]))
            now_s = asyncio.get_running_loop().time() + self.ahead_s
            answer = {"jsonrpc": "2.0", "id": request["id"], "result": {"subscription": request["id"], "now_s": now_s}}
            answer["result"] |= self.more
            writer.write(json.dumps(answer).encode() + b"\n")

    def send(self, *names: str, last: bool) -> None:
        """States of these vehicles, the last of a round or not."""
        writer, number = self.telemetry[-1]
        for name in names:
            params = {"state": {"name": name}, "subscription": number} | (
                {"last": True} if last and name == names[-1] else {}
            )
            line = json.dumps({"jsonrpc": "2.0", "method": "telemetry", "params": params}, separators=(",", ":"))
            writer.write(line.encode() + b"\n")

    def asked(self, method: str) -> list[dict[str, Any]]:
        return [request for request in self.requests if request["method"] == method]


@asynccontextmanager
async def serving(path: Path, *, answers: bool = True) -> AsyncIterator[Daemon]:
    daemon = Daemon()
    if answers:
        daemon.answers.set()
    server = await asyncio.start_unix_server(daemon.serve, path)
    try:
        yield daemon
    finally:
        server.close()
        for writer in daemon.writers:
            writer.close()


@asynccontextmanager
async def connecting(path: Path, states: LatestStates | None = None) -> AsyncIterator[tuple[DaemonConnection, Pages]]:
    pages = Pages()
    connection = DaemonConnection(str(path), None, LatestStates() if states is None else states)
    task = asyncio.create_task(connection.run(pages))
    try:
        yield connection, pages
        assert not task.done()
    finally:
        connection.stopping = True
        task.cancel()
        await asyncio.gather(task, return_exceptions=True)


async def test_a_daemon_that_hangs_is_tried_again_until_it_answers(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(daemon_connection, "SLOW_AFTER_S", 0.02)
    monkeypatch.setattr(daemon_connection, "LOST_AFTER_S", 0.05)
    path, states = tmp_path / "gcs.sock", LatestStates()
    async with connecting(path, states) as (connection, _):
        async with serving(path, answers=False):
            await until(lambda: connection.reconnects >= 2)
            assert not connection.connected and not connection.slow
            await until(lambda: "has not answered for" in connection.text)
        monkeypatch.setattr(daemon_connection, "LOST_AFTER_S", 30.0)
        async with serving(path):
            await until(lambda: connection.connected)
        await until(lambda: not connection.connected)
        assert not states.complete


async def test_a_daemon_that_is_not_there_yet_is_logged_once(tmp_path: Path) -> None:
    path = tmp_path / "gcs.sock"
    with capture_logs() as logged:
        async with connecting(path) as (connection, _):
            await until(lambda: connection.reconnects >= 2)
            async with serving(path):
                await until(lambda: connection.connected)
    assert [line["event"] for line in logged] == ["no daemon yet", "daemon connected"]
    assert str(path) in logged[0]["reason"]


async def test_a_daemon_that_stands_still_is_slow_and_goes_on_with_the_same_connections(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(daemon_connection, "ALIVE_EVERY_S", 0.02)
    monkeypatch.setattr(daemon_connection, "SLOW_AFTER_S", 0.05)
    path = tmp_path / "gcs.sock"
    async with serving(path) as daemon, connecting(path) as (connection, _):
        await until(lambda: connection.connected)
        daemon.answers.clear()
        await until(lambda: connection.slow)
        assert connection.connected and "does not answer" in connection.text
        monkeypatch.setattr(daemon_connection, "SLOW_AFTER_S", 30.0)  # a busy machine must not make it slow again
        order = asyncio.create_task(connection.call("vehicles.hold", {"targets": "all"}, 12.5))
        daemon.answers.set()
        await until(lambda: not connection.slow)
        await order
        assert connection.connected and connection.text == "connected"
        assert connection.reconnects == 0 and len(daemon.writers) == 4
        [asked] = daemon.asked("vehicles.hold")
        assert asked["deadline_s"] == 12.5


async def test_a_daemon_that_stands_still_for_long_is_connected_to_anew_when_it_goes_on(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(daemon_connection, "ALIVE_EVERY_S", 0.02)
    monkeypatch.setattr(daemon_connection, "SLOW_AFTER_S", 0.02)
    path = tmp_path / "gcs.sock"
    async with serving(path) as daemon, connecting(path) as (connection, _):
        await until(lambda: connection.connected)
        monkeypatch.setattr(daemon_connection, "LOST_AFTER_S", 0.05)
        daemon.answers.clear()
        await until(lambda: connection.reconnects >= 2)
        assert not connection.connected
        monkeypatch.setattr(daemon_connection, "SLOW_AFTER_S", 10.0)
        monkeypatch.setattr(daemon_connection, "LOST_AFTER_S", 30.0)
        daemon.answers.set()
        await until(lambda: connection.connected)


@each("turns", range(5))
async def test_an_answer_that_comes_with_the_loss_does_not_keep_the_lost_connection(tmp_path: Path, turns: int) -> None:
    """asyncio.wait_for would: it returns the answer, and the cancellation is forgotten."""
    connection = DaemonConnection(str(tmp_path / "gcs.sock"), None, LatestStates())
    answer: asyncio.Future[int] = asyncio.get_running_loop().create_future()

    async def asked() -> int:
        return await answer

    async def keep_alive() -> None:
        await connection._answered(asked(), "reads", Pages())
        await asyncio.Event().wait()

    keeping = asyncio.create_task(keep_alive())
    await until_waiting()
    answer.set_result(1)
    for _ in range(turns):
        await asyncio.sleep(0)
    keeping.cancel()
    await until_waiting()
    assert keeping.cancelled()


async def until_waiting() -> None:
    """More turns of the loop than any chain of callbacks here."""
    for _ in range(20):
        await asyncio.sleep(0)


async def test_deadlines_are_given_in_the_daemons_clock(tmp_path: Path) -> None:
    path = tmp_path / "gcs.sock"
    async with serving(path) as daemon:
        daemon.ahead_s = 5000.0
        async with connecting(path) as (connection, _):
            await until(lambda: connection.connected)
            await connection.call("vehicles.hold", {"targets": "all"}, 100.0)
            await connection.call("vehicles.list", {})
        [order], [listed] = daemon.asked("vehicles.hold"), daemon.asked("vehicles.list")
        # the answers' way, on a busy machine too, is far below the difference
        assert abs(order["deadline_s"] - 5100.0) < 1000.0
        assert "deadline_s" not in listed


async def test_a_round_that_takes_long_removes_no_vehicle(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(daemon_connection, "GONE_AFTER_S", 0.0)
    path, states = tmp_path / "gcs.sock", LatestStates()
    async with serving(path) as daemon, connecting(path, states) as (_, pages):
        await until(lambda: daemon.telemetry)
        daemon.send("a", "b", "c", last=True)
        await until(lambda: len(states) == 3)
        rounds = pages.rounds
        daemon.send("a", last=False)
        await until(lambda: pages.rounds > rounds)
        assert len(states) == 3
        daemon.send("b", "c", last=True)
        await until(lambda: pages.rounds > rounds + 1)
        assert len(states) == 3
        for whole in (2, 3):  # b was forgotten; it is in none of two whole rounds
            daemon.send("a", "c", last=True)
            await until(lambda whole=whole: pages.rounds > rounds + whole)  # type: ignore[misc]
        assert len(states) == 2
        assert states.since(0)[1] == ["b"]


async def test_a_daemon_without_a_vehicle_is_an_empty_fleet_after_a_while(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(daemon_connection, "GONE_AFTER_S", 0.05)
    monkeypatch.setattr(daemon_connection, "RATE_EVERY_S", 0.02)
    path, states = tmp_path / "gcs.sock", LatestStates()
    async with serving(path), connecting(path, states) as (_, pages):
        async with asyncio.timeout(60):
            await pages.woken.wait()
        assert states.complete and len(states) == 0


async def test_where_there_is_a_bridge_all_sites_are_shown_and_without_it_ours_go_on(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The daemon's socket first, then the bridge's beside it, which ends again."""
    monkeypatch.setattr(daemon_connection, "LOOK_EVERY_S", 0.02)
    path = tmp_path / "gcs.sock"
    async with serving(path) as daemon, connecting(path) as (connection, _):
        daemon.more = {"federation": {"running": True}}
        await until(lambda: connection.connected)
        assert connection.note == daemon_connection.NO_BRIDGE and connection.site is None
        await until(lambda: [r["params"]["targets"] for r in daemon.asked("subscribe") if "targets" in r["params"]])
        assert {r["params"]["targets"] for r in daemon.asked("subscribe") if "targets" in r["params"]} == {"all"}
        async with serving(tmp_path / "gcs.sock.federation") as bridge:
            bridge.more = {"site": "north"}
            await until(lambda: connection.connected and connection.site == "north")
            assert connection.note is None
            await until(lambda: len(bridge.asked("subscribe")) >= 3)
            asked = {r["params"]["targets"] for r in bridge.asked("subscribe") if "targets" in r["params"]}
            assert asked == {"*/all"}
            await connection.call("vehicles.stop", {"targets": "all"})
            assert len(bridge.asked("vehicles.stop")) == 1
        await until(lambda: connection.connected and connection.note == daemon_connection.NO_BRIDGE)
        await connection.call("vehicles.stop", {"targets": "all"})
        assert len(daemon.asked("vehicles.stop")) == 1


async def test_a_bridge_that_reaches_no_daemon_is_not_in_the_way_of_one_that_is_there(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(daemon_connection, "LOOK_EVERY_S", 0.02)
    path = tmp_path / "gcs.sock"
    async with serving(tmp_path / "gcs.sock.federation") as bridge, connecting(path) as (connection, _):
        bridge.more = {"site": "north", "daemon": None}
        await until(lambda: connection.connected)
        assert connection.note == daemon_connection.NO_OWN_DAEMON
        async with serving(path) as daemon:
            daemon.more = {"federation": {"running": True}}
            await until(lambda: connection.connected and connection.note == daemon_connection.NO_BRIDGE)
            await connection.call("vehicles.hold", {"targets": "all"})
            assert len(daemon.asked("vehicles.hold")) == 1


async def test_what_cannot_be_carried_on_is_refused_and_nothing_waits_for_it(tmp_path: Path) -> None:
    path = tmp_path / "gcs.sock"
    async with serving(path) as daemon, connecting(path) as (connection, _):
        await until(lambda: connection.connected)
        for params, text in (
            ({"height_m": math.inf}, "JSON"),  # 1e999 in a message
            ({"plan": "x" * (1 << 20)}, "the daemon takes"),
        ):
            for method in ("vehicles.takeoff", "vehicles.stop", "vehicles.list"):
                with pytest.raises(RpcError, match=text) as refused:
                    await connection.call(method, params, 100.0)
                assert refused.value.code == INVALID_PARAMS
        assert connection._waiting == 0 and connection.connected
        assert not daemon.asked("vehicles.takeoff")


async def test_events_of_an_earlier_daemon_get_a_severity() -> None:
    event = {"time_unix_s": 1.0, "kind": "failsafe", "vehicle": "alpha", "sysid": 1, "text": "low", "data": {}}
    shown: list[dict[str, Any]] = []

    async def events() -> AsyncIterator[dict[str, Any]]:
        yield event

    async def relay(*_: Any) -> bytes:
        return json.dumps([event, {**event, "severity": "warning"}]).encode()

    connection = DaemonConnection("nowhere", None, LatestStates())
    connection.connected, connection._clients = True, cast(Any, {"reads": SimpleNamespace(relay=relay)})
    await connection._feed_events(cast(Any, events()), cast(Any, SimpleNamespace(on_event=shown.append)))
    recent = json.loads(await connection.call("events.recent", {}))
    assert [one["severity"] for one in [*shown, *recent]] == ["alarm", "alarm", "warning"]
