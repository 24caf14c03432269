"""The bridge as a client of its daemon: orders over a real socket, connections that are lost, many orders at once."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import AsyncIterator
from pathlib import Path
from typing import Any

import pytest

from skygcs.ext.federation.bridge.daemon_orders import Carried, DaemonOrders
from skygcs.ext.federation.protocol.order_gate import MAX_ENDING, MAX_STOPS
from skygcs.rpc.client import connect
from skygcs.rpc.server import RpcServer
from support.fake_daemon import FakeDaemon
from support.hub import until


@contextlib.asynccontextmanager
async def served(daemon: FakeDaemon, path: Path) -> AsyncIterator[DaemonOrders]:
    """The daemon behind a socket, and the bridge's connection to it."""
    loop = asyncio.get_running_loop()
    server = RpcServer(daemon, path)  # type: ignore[arg-type]
    await server.start()
    orders = DaemonOrders(lambda: connect(path), loop)
    running = loop.create_task(orders.run())
    try:
        await connected(orders)
        yield orders
    finally:
        running.cancel()
        await asyncio.gather(running, return_exceptions=True)
        await server.close()


async def connected(orders: DaemonOrders) -> None:
    await until(lambda: orders.connected, "connected to the daemon")


def soon() -> float:
    return asyncio.get_running_loop().time() + 60.0


async def test_an_order_goes_to_the_one_vehicle_of_that_name(tmp_path: Path) -> None:
    daemon = FakeDaemon(3)
    async with served(daemon, tmp_path / "d.sock") as orders:
        carried = await orders.order("bravo", "vehicles.takeoff", {"height_m": 5.0}, soon())
        assert (carried.status, carried.outcome and carried.outcome["result"]) == ("done", "accepted")
        for name in ("all", "2", "1-3", "red", "nobody", "alpha,bravo"):
            assert (await orders.order(name, "vehicles.land", {}, soon())).status == "refused", name
        late = await orders.order("alpha", "vehicles.land", {}, asyncio.get_running_loop().time() - 1.0)
        assert late.status == "refused" and "deadline" in late.text
        wrong = await orders.order("alpha", "vehicles.takeoff", {"height_m": "high"}, soon())
        assert wrong.status == "refused" and "height_m" in wrong.text
    given = {name: [order for order, _ in daemon.vehicle(name).orders] for name in ("alpha", "bravo", "carol")}
    assert given == {"alpha": [], "bravo": ["takeoff"], "carol": []}


async def test_an_order_on_a_connection_that_is_lost_is_unknown_and_not_given_again(tmp_path: Path) -> None:
    daemon = FakeDaemon(1)
    daemon.vehicle("alpha").delay_s = 30.0
    loop = asyncio.get_running_loop()
    server = RpcServer(daemon, tmp_path / "d.sock")  # type: ignore[arg-type]
    await server.start()
    orders = DaemonOrders(lambda: connect(tmp_path / "d.sock"), loop)
    running = loop.create_task(orders.run())
    await connected(orders)
    order = loop.create_task(orders.order("alpha", "vehicles.arm", {}, soon()))
    await until(lambda: daemon.vehicle("alpha").orders, "the order has come")
    await server.close()
    assert (await order).status == "unknown"
    away = await orders.order("alpha", "vehicles.arm", {}, soon())
    assert away.status == "refused" and "does not answer" in away.text
    daemon.vehicle("alpha").delay_s = 0.0
    again = RpcServer(daemon, tmp_path / "d.sock")  # type: ignore[arg-type]
    await again.start()
    await connected(orders)
    assert (await orders.order("alpha", "vehicles.land", {}, soon())).status == "done"
    running.cancel()
    await asyncio.gather(running, return_exceptions=True)
    await again.close()
    assert [order for order, _ in daemon.vehicle("alpha").orders] == ["arm", "land"]


async def test_one_connection_that_is_lost_ends_no_order_on_the_others(tmp_path: Path) -> None:
    daemon = FakeDaemon(1)
    daemon.vehicle("alpha").delay_s = 1.0
    async with served(daemon, tmp_path / "d.sock") as orders:
        arming = asyncio.create_task(orders.order("alpha", "vehicles.arm", {}, soon()))
        await until(lambda: daemon.vehicle("alpha").orders, "it is being armed")
        await orders._ending[0].client.close()
        assert (await orders.order("alpha", "vehicles.land", {}, soon())).status == "done"
        assert (await arming).status == "done"
    assert daemon.vehicle("alpha").cancelled == 0


class Stopped:
    """A client of a daemon that is stopped once it was connected to: what is sent waits in its socket."""

    def __init__(self) -> None:
        self.sent: list[str] = []
        self.stopped = False
        self.connected = True

    async def open(self) -> None: ...

    async def close(self) -> None: ...

    async def call(self, method: str, /, **params: Any) -> Any:
        self.sent.append(method)
        if self.stopped:
            await asyncio.Event().wait()
        return {"now_s": asyncio.get_running_loop().time()}

    async def relay(self, method: str, params: dict[str, Any], deadline_s: float | None = None) -> bytes:
        self.sent.append(method)
        return await asyncio.Event().wait()  # type: ignore[return-value]


@pytest.mark.looptime
async def test_a_daemon_that_is_stopped_gets_no_order_but_a_stop() -> None:
    loop = asyncio.get_running_loop()
    client = Stopped()
    orders = DaemonOrders(lambda: client, loop, lambda _: True)
    running = loop.create_task(orders.run())
    await asyncio.sleep(1.5)
    client.stopped = True
    began = loop.time()
    carried = await asyncio.gather(*(orders.order("alpha", "vehicles.land", {}, soon()) for _ in range(3)))
    assert carried == [Carried("refused", "the site's daemon does not answer; nothing was sent")] * 3
    assert loop.time() - began < 0.5 and "vehicles.land" not in client.sent
    stop = loop.create_task(orders.order("alpha", "vehicles.stop", {}, soon()))
    await asyncio.sleep(1.0)
    assert "vehicles.stop" in client.sent
    for task in (stop, running):
        task.cancel()
    await asyncio.gather(stop, running, return_exceptions=True)


@pytest.mark.looptime
async def test_stops_find_connections_beside_all_other_orders_that_end_a_flight(tmp_path: Path) -> None:
    daemon = FakeDaemon(1)
    daemon.vehicle("alpha").delay_s = 1.0
    async with served(daemon, tmp_path / "d.sock") as orders:
        methods = MAX_ENDING * ["vehicles.land"] + MAX_STOPS * ["vehicles.stop"]
        carried = await asyncio.gather(*(orders.order("alpha", method, {}, soon()) for method in methods))
        assert {one.status for one in carried} == {"done"}


@pytest.mark.looptime
async def test_a_stop_for_every_vehicle_of_a_full_site_finds_connections(tmp_path: Path) -> None:
    daemon = FakeDaemon(1)
    daemon.vehicle("alpha").delay_s = 0.5
    async with served(daemon, tmp_path / "d.sock") as orders:
        stops = [orders.order("alpha", "vehicles.stop", {"action": "hold"}, soon()) for _ in range(2 * MAX_ENDING + 90)]
        carried = await asyncio.gather(*stops)
        done = [one for one in carried if one.status == "done"]
        assert len(done) >= MAX_ENDING
        assert all(
            one == Carried("refused", "too many orders wait for the daemon") for one in carried if one not in done
        )
        # the same stop at once is carried out once, and all get its outcome (`skygcs.rpc.work_gate`)
        assert all(one.outcome["ok"] for one in done if one.outcome is not None)
        assert 1 <= len(daemon.vehicle("alpha").orders) <= len(done)
