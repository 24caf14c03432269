"""Orders at the home site: each goes to the daemon once, and the record comes first."""

from __future__ import annotations

import asyncio
import json
from pathlib import Path
from typing import Any

import pytest

from skygcs.disk_writer import DiskWriter
from skygcs.ext.federation.bridge.audit_file import AuditFile
from skygcs.ext.federation.bridge.daemon_orders import Carried
from skygcs.ext.federation.bridge.orders_taken import ANSWER_S, DISK_WAIT_S, FLIGHT_END_WAIT_S, OrdersTaken, names_stop
from skygcs.ext.federation.protocol.order_gate import STOP_LATE_S
from skygcs.ext.federation.protocol.order_messages import STOP, OrderRequest, OutcomeQuestion, vehicle_token
from support.inline_disk import Inline
from support.virtual_asyncio import stuck_threads

pytestmark = pytest.mark.looptime

AHEAD_S = 5000.0
"""Of the site's clock."""


class Daemon:
    """Carries orders out after ``takes_s``, and remembers them with the time left to their deadline."""

    def __init__(self, takes_s: float = 0.0) -> None:
        self.takes_s = takes_s
        self.orders: list[tuple[str, str, float]] = []
        self.fails: BaseException | None = None
        self.file: AuditFile | None = None
        self.recorded: list[int] = []

    async def order(self, vehicle: str, method: str, params: dict[str, Any], deadline: float) -> Carried:
        self.orders.append((vehicle, method, round(deadline - asyncio.get_running_loop().time(), 3)))
        if self.file is not None:
            self.recorded.append(self.file.counters["written"])
        if self.fails is not None:
            raise self.fails
        await asyncio.sleep(self.takes_s)
        return Carried("done", "landing")


class Home:
    """The site north, and what it published."""

    def __init__(self, path: Path, daemon: Daemon) -> None:
        self.loop = asyncio.get_running_loop()
        self.published: list[tuple[str, dict[str, Any]]] = []
        self.held_elsewhere: str | None = None
        self.file = daemon.file = AuditFile(path)
        self.thread = Inline()
        self.disk = DiskWriter(self.loop, lambda event: None, self.loop.time, self.thread)
        self.taken = OrdersTaken(
            "north",
            daemon,
            self.file,
            self.disk,
            lambda subject, data: self.published.append((subject, json.loads(data))),
            lambda _: self.held_elsewhere,
            lambda: self.loop.time() + AHEAD_S,
            self.loop,
        )

    def order(self, number: int, method: str = "vehicles.land", in_s: float = 1.0) -> OrderRequest:
        deadline_s = self.loop.time() + AHEAD_S + in_s
        return OrderRequest(f"{number:032x}", "alpha", method, {}, deadline_s, "mia@south", "operator")

    async def give(self, request: OrderRequest) -> dict[str, Any]:
        subject = f"cmd.north.{vehicle_token(request.vehicle)}"
        answer: dict[str, Any] = json.loads(await self.taken.answer(subject, request.encoded()))
        return answer

    async def ask(self, request: OrderRequest, wait_s: float = 0.0) -> dict[str, Any]:
        question = OutcomeQuestion(request.key, wait_s).encoded()
        answer: dict[str, Any] = json.loads(await self.taken.answer("cmd.north.outcome", question))
        return answer


async def test_an_order_is_recorded_carried_out_once_and_answered(tmp_path: Path) -> None:
    daemon = Daemon()
    home = Home(tmp_path / "orders.jsonl", daemon)
    order = home.order(1)
    assert (await home.give(order))["status"] == "done"
    assert (await home.give(order))["status"] == "done"
    assert daemon.orders == [("alpha", "vehicles.land", 1.0)]
    assert daemon.recorded == [1]  # before it began
    wanted = [("audit.north", "running", "mia@south"), ("audit.north", "done", "mia@south")]
    assert [(s, r["status"], r["by"]) for s, r in home.published] == wanted
    await home.taken.close()


async def test_a_long_order_is_answered_at_once_and_its_outcome_when_it_is_asked_for(tmp_path: Path) -> None:
    home = Home(tmp_path / "orders.jsonl", Daemon(takes_s=3.0))
    order, began = home.order(1), home.loop.time()
    assert (await home.give(order))["status"] == "running"
    assert home.loop.time() - began == pytest.approx(ANSWER_S)
    assert (await home.ask(order, 99.0))["status"] == "running"
    assert home.loop.time() - began < 1.5
    await asyncio.sleep(1.5)
    assert (await home.ask(order, 0.8))["status"] == "done"
    assert home.loop.time() - began == pytest.approx(3.0)
    await home.taken.close()


async def test_a_stop_has_more_time_and_needs_no_lease(tmp_path: Path) -> None:
    daemon = Daemon()
    home = Home(tmp_path / "orders.jsonl", daemon)
    home.held_elsewhere = "alpha is commanded by south"
    assert (await home.give(home.order(1)))["text"] == "alpha is commanded by south"
    assert (await home.give(home.order(2, STOP, in_s=-1.0)))["status"] == "done"
    assert daemon.orders == [("alpha", STOP, STOP_LATE_S - 1.0)]
    await home.taken.close()


async def test_what_ran_when_the_bridge_ended_is_unknown_and_does_not_run_again(tmp_path: Path) -> None:
    daemon = Daemon(takes_s=5.0)
    home = Home(tmp_path / "orders.jsonl", daemon)
    order = home.order(1)
    assert (await home.give(order))["status"] == "running"
    await home.taken.close()
    again = Home(tmp_path / "orders.jsonl", daemon)
    assert (await again.give(order))["status"] == "unknown"
    assert len(daemon.orders) == 1
    await again.taken.close()


async def test_a_stuck_disk_keeps_no_landing_and_the_loop_goes_on(tmp_path: Path) -> None:
    """The file was written on the loop: a disk that did not answer kept the bridge from every order."""
    daemon = Daemon()
    home = Home(tmp_path / "orders.jsonl", daemon)
    home.thread.stuck = True
    with stuck_threads():
        began, landing, arming = home.loop.time(), home.order(1), home.order(2, "vehicles.arm", in_s=5.0)
        assert (await home.give(landing))["status"] == "done"
        assert home.loop.time() - began == pytest.approx(FLIGHT_END_WAIT_S)
        assert (await home.give(arming))["status"] == "running"
        await asyncio.sleep(DISK_WAIT_S)
        refused = await home.ask(arming)
        assert refused["status"] == "refused" and "cannot record" in refused["text"]
        assert [method for _, method, _ in daemon.orders] == ["vehicles.land"]
    home.thread.stuck = False
    assert (await home.give(home.order(3)))["status"] == "done"
    await home.taken.close()
    # all of it is in the file, in its order
    lines = [json.loads(line) for line in home.file.path.read_bytes().splitlines()]
    assert [(line["id"][-1], line["status"]) for line in lines] == [
        *(("1", "running"), ("1", "done"), ("2", "running"), ("2", "refused"), ("3", "running"), ("3", "done"))
    ]


async def test_without_a_record_only_orders_that_end_a_flight_are_carried_out(tmp_path: Path) -> None:
    daemon = Daemon()
    home = Home(tmp_path / "orders.jsonl", daemon)
    (tmp_path / "orders.jsonl").mkdir()
    refused = await home.give(home.order(1, "vehicles.arm"))
    assert refused["status"] == "refused" and "cannot record" in refused["text"]
    assert (await home.give(home.order(2, "vehicles.land")))["status"] == "done"
    assert [method for _, method, _ in daemon.orders] == ["vehicles.land"]
    await home.taken.close()
    # and after a restart nothing but stops, until everything from before is late
    blind = Home(tmp_path / "orders.jsonl", daemon)
    assert (await blind.give(blind.order(3)))["status"] == "refused"
    assert (await blind.give(blind.order(4, STOP)))["status"] == "done"
    await asyncio.sleep(10.0)
    assert (await blind.give(blind.order(5)))["status"] == "done"
    await blind.taken.close()


async def test_nothing_that_comes_raises(tmp_path: Path) -> None:
    daemon = Daemon()
    home = Home(tmp_path / "orders.jsonl", daemon)
    for subject in ("cmd.north.alpha", "cmd.north.outcome", "cmd.north.=ZZ", "cmd.north."):
        for payload in (b"", b"{}", b"\xff" * 5000, b'{"id": 5}'):
            assert json.loads(await home.taken.answer(subject, payload))["status"] == "refused"
    assert daemon.orders == [] and home.taken.counters["malformed"] == 16
    for number, fault in enumerate((KeyError("bug"), asyncio.CancelledError())):
        daemon.fails = fault
        assert (await home.give(home.order(number)))["status"] == "unknown"
        assert (await home.ask(home.order(number)))["status"] == "unknown"
    await home.taken.close()


async def test_a_stop_is_known_before_it_is_decoded(tmp_path: Path) -> None:
    home = Home(tmp_path / "orders.jsonl", Daemon())
    assert names_stop(home.order(1, method=STOP).encoded())
    others = (home.order(1).encoded(), OutcomeQuestion(home.order(1, method=STOP).key).encoded(), b"")
    assert not any(names_stop(payload) for payload in others)
    await home.taken.close()
