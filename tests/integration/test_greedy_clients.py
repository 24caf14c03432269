"""A client with too many orders to the fleet in flight, in a whole daemon: what is refused, and what passes."""

from __future__ import annotations

import asyncio
import json
from collections import Counter
from collections.abc import Coroutine
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from skygcs.rpc import work_gate
from skygcs.rpc.dispatch import Dispatcher
from skygcs.rpc.error_codes import LIMIT_EXCEEDED
from skygcs.rpc.slices import Slices
from skygcs.rpc.work_gate import WorkGate
from support.extension_parts import PLAIN_METHODS
from support.flown import HOLDING, Flown, aloft

FLEET = {"px4": 2, "ardupilot": 2}
SIZE = sum(FLEET.values())


class Desk:
    """The dispatcher of a daemon, without its sockets, and clients."""

    def __init__(self, gcs: Flown) -> None:
        self.gcs = gcs
        gcs.daemon.extensions.demand("preflight")  # as a session does before its first call
        self.gate = WorkGate(gcs.daemon.fleet.resolve_any)
        self.dispatcher: Dispatcher[Any] = Dispatcher(PLAIN_METHODS, gate=self.gate)
        self.most = 0

    def client(self) -> Any:
        slices = Slices(asyncio.get_running_loop())
        return SimpleNamespace(services=self.gcs.daemon, slices=slices, reports=None, client=object())

    def ask(self, client: Any, method: str, **params: Any) -> asyncio.Task[Any]:
        request = {"jsonrpc": "2.0", "id": 1, "method": method, "params": params}

        async def answer() -> Any:
            reply = self.dispatcher.start(client, request)
            return json.loads(await reply if isinstance(reply, Coroutine) else reply or b"")

        return asyncio.create_task(answer())

    async def watch(self) -> None:
        while True:
            self.most = max(self.most, self.gate.bound.items)
            await asyncio.sleep(0.01)


async def test_one_greedy_client_is_bounded_and_keeps_nobody_out(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(work_gate, "MAX_ITEMS_OF_A_CLIENT", 2 * SIZE)
    monkeypatch.setattr(work_gate, "MAX_ITEMS", 3 * SIZE)
    async with aloft(tmp_path, **FLEET) as gcs:
        desk = Desk(gcs)
        watch = asyncio.create_task(desk.watch())
        greedy, other = desk.client(), desk.client()
        gcs.sim("v2").faults.deaf = True  # its orders stay in flight for seconds
        tasks = [desk.ask(greedy, "preflight.run", targets="all") for _ in range(64)]
        await asyncio.sleep(0.1)
        refused = [task.result()["error"] for task in tasks if task.done()]
        assert [error["code"] for error in refused] == [LIMIT_EXCEEDED] * 61
        assert f"waits for {3 * SIZE} orders to single vehicles" in refused[0]["message"]
        assert desk.gate.bound.items == 3 * SIZE
        # another client: its orders, one by one and to all
        assert "result" in await desk.ask(other, "vehicles.request", targets="v1", message="ATTITUDE")
        assert "result" in await desk.ask(other, "preflight.run", targets="all")
        # the greedy one still ends flights
        held = await desk.ask(greedy, "vehicles.hold", targets="v1,v3,v4")
        assert all(outcome["ok"] for outcome in held["result"]["outcomes"].values())
        assert {gcs.sim(name).mode for name in ("v1", "v3", "v4")} <= HOLDING
        answers = await asyncio.gather(*tasks)
        assert Counter("result" in answer for answer in answers) == {True: 3, False: 61}
        watch.cancel()
        assert desk.gate.bound.items == 0 and desk.most <= (3 + 2) * SIZE + 3
        assert "result" in await desk.ask(greedy, "preflight.run", targets="v1")
        assert Counter(told.kind for told in gcs.told)["vehicle_lost"] == 0


async def test_a_flood_of_landings_is_sent_once_and_everyone_gets_the_outcome(tmp_path: Path) -> None:
    async with aloft(tmp_path, **FLEET) as gcs:
        desk = Desk(gcs)
        before = len(gcs.sent)
        tasks = [desk.ask(desk.client(), "vehicles.land", targets="all") for _ in range(20)]
        answers = [await task for task in tasks]
        assert all(answer == answers[0] for answer in answers)
        assert all(outcome["ok"] for outcome in answers[0]["result"]["outcomes"].values())
        assert desk.gate.stats()["vehicle_orders_joined"] == 19 and desk.gate.bound.items == 0
        sent = Counter(sent.sysid for sent in gcs.sent[before:] if sent.name in ("COMMAND_LONG", "COMMAND_INT"))
        assert max(sent.values()) <= 3, sent


@pytest.mark.deep
async def test_a_hold_after_a_goto_is_in_force_however_soon_after_the_last_hold(tmp_path: Path) -> None:
    async with aloft(tmp_path, **FLEET) as gcs:
        desk = Desk(gcs)
        client, other = desk.client(), desk.client()
        gcs.sim("v2").faults.deaf = True  # so that the first hold is not over
        first = desk.ask(client, "vehicles.hold", targets="all")
        await asyncio.sleep(0.2)
        x, y, up = gcs.place("v1")
        assert (await desk.ask(other, "vehicles.goto", targets="v1", enu_m=[x, y - 30.0, up]))["result"]
        second = desk.ask(client, "vehicles.hold", targets="all")
        await asyncio.sleep(5.0)
        assert desk.gate.stats()["vehicle_orders_joined"] == 0 and not first.done()
        at = gcs.place("v1")
        await asyncio.sleep(3.0)
        assert abs(gcs.place("v1")[1] - at[1]) < 1.0, "it flies on to the place of the goto"
        first.cancel()
        second.cancel()
        await asyncio.wait({first, second})
        assert desk.gate.bound.items == 0
