"""Orders between two sites while everything fails by a seeded schedule, and the model that they are checked against.

The bridge's parts are the real ones; the daemon behind them is a model that counts how often each order is carried
out. Every order has a mark of its own, so that two executions of one order cannot be taken for two orders.

    what the station showed     executions at the home site
    -----------------------     ------------------------------------------------------------
    done, failed                exactly 1
    refused, late               0, also later
    unknown                     0 or 1; 0 from when on `outcome` said "never came". Asked after the healing, it says:
        done, failed            1
        refused, late, never came   0, also later
    It is not carried out later than it was shown as unknown; a stop, STOP_LATE_S later.
        unknown                 0 or 1, only if the home site's bridge or daemon was restarted while it ran
"""

from __future__ import annotations

import asyncio
import json
import random
from collections import Counter
from collections.abc import Awaitable, Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from skygcs.errors import DaemonUnreachable, RpcError
from skygcs.ext.federation.bridge.audit_file import AuditFile
from skygcs.ext.federation.bridge.daemon_orders import DaemonOrders
from skygcs.ext.federation.bridge.orders_sent import OrdersSent, RemoteVehicle
from skygcs.ext.federation.bridge.orders_taken import OrdersTaken
from skygcs.ext.federation.protocol.order_gate import STOP_LATE_S
from skygcs.ext.federation.protocol.order_messages import STOP
from support.inline_disk import inline_disk

VEHICLES = tuple(f"v{number}" for number in range(1, 9))
LENGTH_S = 12.0
ORDERS = 25
HEALED_S = 5.0
WITHIN_S = 1.0
"""A remote order that fails does so by then."""


class ModelDaemon:
    """Carries orders out and counts them by their mark; can be restarted."""

    def __init__(self, rng: random.Random, loop: asyncio.AbstractEventLoop) -> None:
        self.executions: Counter[str] = Counter()
        self.executed_at: dict[str, float] = {}
        self.up = True
        self.restarts: list[float] = []
        self.loop = loop
        self.rng = rng
        self.stalled_until = 0.0
        """A daemon that is stopped: what came meanwhile is read then."""
        self._clients: set[ModelClient] = set()

    def client(self) -> ModelClient:
        made = ModelClient(self)
        self._clients.add(made)
        return made

    def stop(self) -> None:
        self.up = False
        self.restarts.append(self.loop.time())
        for client in self._clients:
            client.lost.set()
        self._clients.clear()

    def start(self) -> None:
        self.up = True


class ModelClient:
    """A connection to the model daemon, as `federation.daemon_orders.DaemonClient` describes it."""

    def __init__(self, daemon: ModelDaemon) -> None:
        self.daemon = daemon
        self.lost = asyncio.Event()

    @property
    def connected(self) -> bool:
        return not self.lost.is_set()

    async def open(self) -> None:
        await asyncio.sleep(0.001)
        if not self.daemon.up:
            raise DaemonUnreachable("model", "connection refused")

    async def close(self) -> None:
        self.lost.set()

    async def call(self, method: str, /, **params: Any) -> Any:
        await self._read()
        if method == "vehicles.get":
            if params["target"] not in VEHICLES:
                raise RpcError(-32001, f"no vehicle {params['target']!r}")
            return {"name": params["target"]}
        return {"now_s": self.daemon.loop.time()} if method == "daemon.info" else {"ok": True}

    async def relay(self, method: str, params: dict[str, Any], deadline_s: float | None = None) -> bytes:
        await self._read()
        assert deadline_s is not None
        if self.daemon.loop.time() > deadline_s:
            raise RpcError(-32002, "read after its deadline; it was not carried out")
        self.daemon.executions[mark_of(params)] += 1
        self.daemon.executed_at[mark_of(params)] = self.daemon.loop.time()
        await self._unless_lost(self.daemon.rng.choice((0.01, 0.1, 0.5, 3.0)))
        ok = self.daemon.rng.random() < 0.8
        outcome = {"ok": ok, "result": "accepted" if ok else "denied", "message": "model", "attempts": 1}
        outcome |= {"elapsed_s": 0.1, "status_texts": []}
        return json.dumps({"outcomes": {params["targets"][0]: outcome}}).encode()

    async def _read(self) -> None:
        """Until the daemon reads what has come. Raises DaemonUnreachable."""
        await self._unless_lost(0.001)
        while (left_s := self.daemon.stalled_until - self.daemon.loop.time()) > 0.0:
            await self._unless_lost(max(left_s, 0.001))

    async def _unless_lost(self, seconds: float) -> None:
        try:
            async with asyncio.timeout(seconds):
                await self.lost.wait()
        except TimeoutError:
            return
        raise DaemonUnreachable("model", "it closed the connection")


def mark_of(params: dict[str, Any]) -> str:
    return str(params.get("confirm") or params["height_m"])


class HomeBridge:
    """The home site's bridge: the real parts on a bus that the test gives, restarted with a new one."""

    def __init__(self, site: str, daemon: ModelDaemon, folder: Path, clock: Callable[[], float]) -> None:
        self.site = site
        self.starts = 0
        self.restarts: list[float] = []
        self.taken: OrdersTaken | None = None
        self._daemon = daemon
        self._path = folder / f"{site}.jsonl"
        self._clock = clock
        self._loop = asyncio.get_running_loop()
        self._connection: asyncio.Task[None] | None = None

    def start(self, publish: Callable[[str, bytes], None]) -> OrdersTaken:
        self.starts += 1
        orders = DaemonOrders(self._daemon.client, self._loop)
        self._connection = self._loop.create_task(orders.run(), name="daemon orders")
        file = AuditFile(self._path)
        self.taken = OrdersTaken(
            self.site, orders, file, inline_disk(self._loop), publish, lambda _: None, self._clock, self._loop
        )
        return self.taken

    async def stop(self) -> None:
        """Every second time as if it were killed: nothing more is written."""
        self.restarts.append(self._loop.time())
        taken, self.taken = self.taken, None
        assert taken is not None and self._connection is not None
        if self.starts % 2:
            taken._file.append = lambda _: None  # type: ignore[method-assign]
        self._connection.cancel()
        await asyncio.gather(taken.close(), self._connection, return_exceptions=True)

    def records(self) -> list[dict[str, Any]]:
        return [json.loads(line) for line in self._path.read_bytes().splitlines()] if self._path.exists() else []


@dataclass
class Given:
    """An order and what was shown of it."""

    mark: str
    method: str
    began: float
    ended: float = 0.0
    ran: bool = False
    """Whether the site's first answer was that it is being carried out."""
    outcome: dict[str, Any] = field(default_factory=dict)
    early: dict[str, Any] | None = None
    """What `outcome` said at once, while the network still failed."""
    settled: dict[str, Any] | None = None
    """What it said after the healing."""

    @property
    def shown(self) -> str:
        return str(self.outcome["result"])


async def give(sent: OrdersSent, site: str, rng: random.Random, mark: str) -> Given:
    """One random order with its own mark."""
    loop = asyncio.get_running_loop()
    vehicle = RemoteVehicle(site, rng.choice(VEHICLES))
    method, params = rng.choice(
        (
            ("vehicles.takeoff", {"height_m": mark}),
            ("vehicles.goto", {"lat_deg": 1.0, "lon_deg": 2.0, "height_m": mark}),
            ("vehicles.stop", {"action": "hold", "confirm": mark}),
        )
    )
    given = Given(mark, method, loop.time())
    outcomes = await sent.order(method, params, [vehicle], "mia")
    given.outcome, given.ended = outcomes[str(vehicle)], loop.time()
    if given.shown == "unknown" and rng.random() < 0.5:
        given.early = await sent.outcome(given.outcome["id"])
    return given


async def run_schedule(
    sent: OrdersSent,
    site: str,
    rng: random.Random,
    fault: Callable[[float], Awaitable[None]],
    heal: Callable[[], Awaitable[None]],
) -> list[Given]:
    """Give orders for LENGTH_S while ``fault(now)`` is called again and again; then heal, and settle."""
    loop = asyncio.get_running_loop()
    began = loop.time()
    followed: set[str] = set()
    follow = sent._followed

    async def noted(order: Any) -> Any:
        followed.add(order.request.key)
        return await follow(order)

    sent._followed = noted  # type: ignore[method-assign]

    async def faults() -> None:
        while loop.time() < began + LENGTH_S:
            await asyncio.sleep(rng.uniform(0.1, 1.2))
            await fault(loop.time())

    async def one(number: int, after_s: float) -> Given:
        await asyncio.sleep(after_s)
        return await give(sent, site, rng, f"m{number}")

    failing = loop.create_task(faults(), name="faults")
    orders = [one(number, rng.uniform(0.0, LENGTH_S)) for number in range(ORDERS)]
    given = list(await asyncio.gather(*orders))
    await failing
    await heal()
    await asyncio.sleep(HEALED_S)
    for order in given:
        order.ran = order.outcome["id"].rpartition("/")[2] in followed
        if order.shown == "unknown":
            order.settled = await _settled(sent, order)
    return given


async def _settled(sent: OrdersSent, order: Given) -> dict[str, Any]:
    """What `outcome` says; an order that waited in a daemon that was stopped may still be carried out."""
    answer: dict[str, Any] = {}
    for _ in range(20):
        answer = await sent.outcome(order.outcome["id"])
        if answer["status"] != "running":
            break
        await asyncio.sleep(1.0)
    return answer


def count(given: list[Given], daemon: ModelDaemon, happened: Counter[str]) -> None:
    """Orders as shown and settled, and executions."""
    happened.update(f"shown: {order.shown}" for order in given)
    happened.update(f"settled: {order.settled['status']}" for order in given if order.settled is not None)
    happened["executions"] += daemon.executions.total()


def verdicts(given: list[Given], daemon: ModelDaemon, home: HomeBridge, *, time_slack_s: float = 0.0) -> list[str]:
    """What contradicts the model; call it again later: what was not carried out never is."""
    wrong = []
    restarts = [*daemon.restarts, *home.restarts]
    for order in given:
        count, shown, settled = daemon.executions[order.mark], order.shown, order.settled
        what = f"{order.mark}: {shown} {order.outcome['message']!r}, {count} executions"
        if count > 1:
            wrong.append(f"{what}: twice")
        if shown in ("accepted", "denied") and count != 1:
            wrong.append(what)
        if shown == "refused" and count != 0:
            wrong.append(what)
        failed_s = order.ended - order.began
        if shown in ("refused", "unknown") and not order.ran and failed_s > WITHIN_S + time_slack_s:
            wrong.append(f"{what}: after {failed_s:.2f} s")
        late_s = daemon.executed_at.get(order.mark, 0.0) - max(order.ended, order.began + WITHIN_S)
        if (
            shown == "unknown"
            and not order.ran
            and late_s > time_slack_s + (STOP_LATE_S if order.method == STOP else 0.0)
        ):
            wrong.append(f"{what}: {late_s:.2f} s after it was shown")
        if order.early is not None and order.early["answered"] and order.early["status"] == "never came" and count:
            wrong.append(f"{what}: although it never came")
        if settled is None:
            continue
        status = settled["status"]
        what = f"{what}, settled {status} {settled['text']!r}"
        if not settled["answered"]:
            wrong.append(f"{what}: the site did not answer after the healing")
        elif count != {"done": 1, "failed": 1, "refused": 0, "late": 0, "never came": 0}.get(status, count):
            wrong.append(what)
        elif status == "unknown" and not any(at >= order.began for at in restarts):
            wrong.append(f"{what}: without a restart")
        elif status == "running":
            wrong.append(what)
    recorded = {mark_of(record["params"]) for record in home.records() if record["status"] == "running"}
    wrong += [f"{mark}: carried out without a record" for mark in daemon.executions if mark not in recorded]
    return wrong
