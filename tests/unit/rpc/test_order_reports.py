"""Each vehicle's outcome while the order is still under way: the notifications, and the client's ways to read them."""

from __future__ import annotations

import asyncio
import inspect
import json
import re
from collections.abc import AsyncIterator
from pathlib import Path
from typing import Any

import pytest

from skygcs.errors import RpcError
from skygcs.rpc.client import Client, connect
from skygcs.rpc.server import RpcServer
from support.extension_parts import PLAIN_METHODS
from support.fake_daemon import FakeDaemon, FakeOutcome
from support.hosts import until

REFUSED = FakeOutcome(False, "denied", "denied: requires position")


@pytest.fixture
async def daemon(tmp_path: Path) -> AsyncIterator[FakeDaemon]:
    """alpha accepts at once, carol refuses at once, bravo never answers."""
    daemon = FakeDaemon()
    daemon.vehicle("bravo").delay_s = 3600.0
    daemon.vehicle("carol").outcome = REFUSED
    server = RpcServer(daemon, tmp_path / "s.sock")
    await server.start()
    async with asyncio.timeout(60.0):
        yield daemon
    await server.close()


@pytest.fixture
async def gcs(daemon: FakeDaemon, tmp_path: Path) -> AsyncIterator[Client]:
    async with connect(tmp_path / "s.sock") as gcs:
        yield gcs


async def lines_of(path: Path, *requests: dict[str, Any], count: int) -> list[Any]:
    """The first ``count`` lines that a client of the socket gets for its requests."""
    reader, writer = await asyncio.open_unix_connection(path)
    writer.write(b"".join(json.dumps({"jsonrpc": "2.0", **request}).encode() + b"\n" for request in requests))
    lines = [json.loads(await reader.readline()) for _ in range(count)]
    writer.close()
    return lines


async def test_a_request_that_asks_gets_each_outcome_before_its_reply_and_others_get_nothing_new(
    daemon: FakeDaemon, tmp_path: Path
) -> None:
    order = {"method": "vehicles.takeoff", "params": {"targets": "all"}}
    first = await lines_of(tmp_path / "s.sock", {"id": "a", "report": True, **order}, count=3)
    assert [line["method"] for line in first] == ["order.begun", "order.outcome", "order.outcome"]
    assert first[0]["params"] == {"request": "a", "vehicles": ["alpha", "bravo", "carol"]}
    wanted = {"alpha": "accepted", "carol": "denied: requires position"}
    assert {line["params"]["vehicle"]: line["params"]["outcome"]["message"] for line in first[1:]} == wanted
    assert all(line["params"]["request"] == "a" for line in first)
    # of these none has reports: not asked for, asked for in no known way, or without an id
    daemon.vehicle("bravo").delay_s = 0.0
    silent = [{"id": 1}, {"id": 2, "report": False}, {"id": 3, "report": 1}, {"id": 4, "report": {}}, {"report": True}]
    asked = [{**order, **one} for one in silent]
    lines = await lines_of(tmp_path / "s.sock", *asked, {"id": 5, "method": "origin.get"}, count=5)
    assert sorted(line.get("id", 0) for line in lines) == [1, 2, 3, 4, 5], lines
    # a read has nothing to report, and an id that is none gets its error
    odd = await lines_of(
        tmp_path / "s.sock",
        {"id": 6, "report": True, "method": "origin.get"},
        {"id": [], "report": True, **order},
        count=2,
    )
    assert "result" in odd[0] and odd[1]["error"]["code"] == -32600


AT_ONCE = {
    *("trajectory.start", "trajectory.pause", "trajectory.resume", "trajectory.speed", "trajectory.abort"),
    *("trajectory.load", "trajectory.unload"),  # all on one clock or none, decided in one turn
    *("vehicles.forget", "control.setpoint"),  # answered at once
    *("vehicles.renumber", "undo.run"),  # of one vehicle
}
"""No outcome of theirs is there before another."""


def test_every_method_with_an_outcome_for_each_vehicle_reports_them_as_they_come() -> None:
    """Those of signing came at the end."""
    by_vehicle = {name: method for name, method in PLAIN_METHODS.items() if "outcomes" in fields_of(method.result)}
    silent = {name for name, method in by_vehicle.items() if not reports(method.handler)}
    assert silent == AT_ONCE and len(by_vehicle) > 30


def fields_of(result: Any) -> frozenset[str]:
    return frozenset(getattr(result, "model_fields", ()))


def reports(handler: Any) -> bool:
    """Whether it hands its client's reports on, itself or by one of the functions that do."""
    words = set(re.findall(r"\w+", inspect.getsource(inspect.unwrap(handler))))
    return bool(words & {"reports", "command", "_each"})


async def test_outcomes_are_iterated_over_as_they_come(daemon: FakeDaemon, gcs: Client) -> None:
    outcomes = gcs.outcomes("vehicles.stop", targets="all")
    came = [await anext(outcomes), await anext(outcomes)]
    assert {vehicle: outcome["ok"] for vehicle, outcome in came} == {"alpha": True, "carol": False}
    await outcomes.aclose()  # type: ignore[attr-defined]
    # every one, and then the end
    daemon.vehicle("bravo").delay_s = 0.0
    assert {vehicle async for vehicle, _ in gcs.outcomes("vehicles.land", targets="all")} == {"alpha", "bravo", "carol"}
    with pytest.raises(RpcError, match="nobody"):
        await anext(gcs.outcomes("vehicles.land", targets="nobody"))


async def test_an_order_calls_back_and_returns_all(daemon: FakeDaemon, gcs: Client) -> None:
    begun: list[list[str]] = []
    came: list[str] = []
    daemon.vehicle("bravo").delay_s = 0.05
    outcomes = await gcs.order(
        "vehicles.arm", on_vehicles=begun.append, on_outcome=lambda vehicle, _: came.append(vehicle), targets="all"
    )
    assert begun == [["alpha", "bravo", "carol"]]
    assert sorted(came) == sorted(outcomes) and came[-1] == "bravo"
    # what a caller's function raises ends its order, and not the connection

    def fail(vehicle: str, outcome: dict[str, Any]) -> None:
        raise LookupError(vehicle)

    with pytest.raises(LookupError):
        await gcs.order("vehicles.arm", on_outcome=fail, targets="alpha")
    assert await gcs.vehicles("alpha")
    assert gcs.unanswered() == []


async def test_what_was_sent_and_not_answered_is_known_after_the_wait_ended(daemon: FakeDaemon, gcs: Client) -> None:
    waiting = asyncio.create_task(gcs.takeoff("all", 5.0))
    await until(lambda: daemon.vehicle("bravo").orders)
    waiting.cancel()
    await asyncio.gather(waiting, return_exceptions=True)
    ((method, params),) = gcs.unanswered()
    assert method == "vehicles.takeoff" and params["targets"] == "all"
