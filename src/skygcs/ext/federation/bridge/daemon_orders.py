"""The home site's bridge as a client of its daemon: passes the orders of other stations on, each at most once.

    orders    one connection, for orders that begin or continue a flight
    ending    connections for orders that end a flight, so that these never wait behind others; more are opened when
              they are needed

These connections do not count as the presence of an operator for operator_timeout_s (operator.relay); each order that
is carried out does, since a person gave it (operator.active). A lost connection is made again; an order is never sent
again.
"""

from __future__ import annotations

import asyncio
import contextlib
import math
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Protocol

import structlog
from pydantic_core import from_json

from skygcs.back_off import BackOff
from skygcs.errors import DaemonUnreachable, RpcError
from skygcs.ext.federation.protocol.order_gate import MAX_ENDING, MAX_RUNNING, MAX_STOPS
from skygcs.ext.federation.protocol.order_messages import ENDS_FLIGHT, STOP, Json, Status, status_of
from skygcs.rpc.daemon_clock import DaemonClock
from skygcs.rpc.error_codes import INTERNAL_ERROR

ALIVE_EVERY_S = 1.0
"""Period of daemon.info, which shows that the daemon answers and compares the clocks."""

FIRST_PAUSE_S, LONGEST_PAUSE_S = 0.1, 1.0
"""Pauses between attempts to connect, doubling: orders are possible again within 2 s of the daemon's return."""

ANSWERED_S = 0.2
"""A daemon that has answered within this time is not asked again: orders to many vehicles come together."""

ANSWERS_WITHIN_S = 0.3
"""A daemon that does not answer by then is stopped or overloaded: the order is refused, and it is certain that nothing
was sent. An emergency stop is sent all the same."""

IN_FLIGHT = MAX_RUNNING
"""Requests in progress on one connection; the daemon takes 64."""

_log = structlog.get_logger(__name__)


class DaemonClient(Protocol):
    """The part of `skygcs.rpc.client.Client` that is used here."""

    @property
    def connected(self) -> bool: ...
    async def open(self) -> None: ...
    async def close(self) -> None: ...
    async def call(self, method: str, /, **params: Any) -> Any: ...
    async def relay(self, method: str, params: dict[str, Any], deadline_s: float | None = None) -> bytes: ...


@dataclass(frozen=True, slots=True)
class Carried:
    """The result of an order at the daemon."""

    status: Status
    text: str
    outcome: Json | None = None


@dataclass(slots=True)
class _Connection:
    client: DaemonClient
    in_flight: int = 0


class DaemonOrders:
    """The connections to the daemon. Run `run` in a task; call `order` for each order. ``connect``: returns a new
    client that is not open yet."""

    def __init__(
        self,
        connect: Callable[[], DaemonClient],
        loop: asyncio.AbstractEventLoop,
        is_vehicle: Callable[[str], bool] = lambda _: False,
    ) -> None:
        """``is_vehicle``: returns True for the name of a known vehicle; about other names the daemon is asked."""
        self.connected = False
        self.text = "not connected to the daemon yet"
        self.counters: Counter[str] = Counter()
        self._connect = connect
        self._loop = loop
        self._is_vehicle = is_vehicle
        self._answered_at = -math.inf
        self._asking: asyncio.Task[None] | None = None
        self._clock = DaemonClock()
        self._orders: list[_Connection] = []
        self._ending: list[_Connection] = []
        self._opening = asyncio.Lock()

    async def run(self) -> None:
        """Stay connected until it is cancelled."""
        back_off = BackOff(FIRST_PAUSE_S, LONGEST_PAUSE_S)
        try:
            while True:
                try:
                    self._clock = DaemonClock()
                    self._orders = [await self._opened()]
                    self._ending = [await self._opened()]
                    await self._sample(self._orders[0])
                    self._answered_at = self._loop.time()
                    self._change("connected", connected=True)
                    back_off.reset()
                    while self.connected:
                        await asyncio.sleep(ALIVE_EVERY_S)
                        await self._sample(self._orders[0])
                        await self._keep_ending()
                except RpcError as error:
                    self._change(str(error))
                finally:
                    await self._close()
                await asyncio.sleep(back_off.after())
        finally:
            self._change("not connected to the daemon any more")

    async def order(self, vehicle: str, method: str, params: Json, deadline: float) -> Carried:
        """Give one order to one vehicle and return its result. ``deadline``: by this process's loop. Does not raise for
        an error of the daemon.

        After a cancellation the daemon may still carry the order out.
        """
        ends_flight = method in ENDS_FLIGHT
        connection: _Connection | None = None
        sent = False
        try:
            # wait for a place on a connection
            connection = await self._free(ends_flight)
            if connection is None:
                return Carried("refused", "too many orders wait for the daemon")
            connection.in_flight += 1
            try:
                # check the daemon, for whose answer a stop does not wait, and the vehicle
                if method == STOP:
                    self._begin_asking()
                elif not await self._answers():
                    return Carried("refused", "the site's daemon does not answer; nothing was sent")
                if (problem := await self._problem(connection.client, vehicle)) is not None:
                    return Carried("refused", problem)
                if not connection.client.connected:
                    raise DaemonUnreachable("", "it has closed the connection")
                # send, and wait for the answer
                sent = True
                ahead_s = self._clock.ahead_s or 0.0
                answer = await connection.client.relay(method, {**params, "targets": [vehicle]}, deadline + ahead_s)
            finally:
                connection.in_flight -= 1
        except DaemonUnreachable as error:
            # an order that was sent may have been carried out
            self._lost(error.reason, connection)
            if sent:
                return Carried("unknown", f"the daemon went away while it was carried out ({error.reason})")
            return Carried("refused", f"the site's daemon does not answer ({error.reason}); nothing was sent")
        except RpcError as error:
            status: Status = "failed" if error.code == INTERNAL_ERROR else "refused"
            return Carried(status, str(error))
        return _carried(answer, vehicle)

    # -- private

    async def _free(self, ends_flight: bool) -> _Connection | None:
        """A connection for one more request; None if all are in use. Raises DaemonUnreachable."""
        if not self.connected:
            raise DaemonUnreachable("", self.text)
        async with self._opening:
            self._ending = [connection for connection in self._ending if connection.client.connected]
            pool = self._ending if ends_flight else self._orders
            least = min(pool, key=lambda connection: connection.in_flight, default=None)
            if least is not None and least.in_flight < IN_FLIGHT:
                return least
            if not ends_flight or len(pool) * IN_FLIGHT >= MAX_ENDING + MAX_STOPS:  # the gate bounds each
                return None
            pool.append(await self._opened())
            return pool[-1]

    async def _answers(self) -> bool:
        """True if the daemon answers now; in the socket of a stopped daemon an order would wait. The request counts as
        the presence of an operator. Raises DaemonUnreachable."""
        asking = self._begin_asking()
        if asking is None:
            return True
        done, _ = await asyncio.wait({asking}, timeout=ANSWERS_WITHIN_S)
        if asking.cancelled():
            raise DaemonUnreachable("", self.text)
        if done:
            asking.result()
        return bool(done)

    def _begin_asking(self) -> asyncio.Task[None] | None:
        """The task of the request operator.active; None if the daemon has answered within ANSWERED_S."""
        if self._loop.time() - self._answered_at <= ANSWERED_S:
            return None
        if self._asking is None or self._asking.done():
            self._asking = self._loop.create_task(self._ask(), name="does the daemon answer")
            self._asking.add_done_callback(lambda task: task.cancelled() or task.exception())
        return self._asking

    async def _ask(self) -> None:
        if not self._orders:
            raise DaemonUnreachable("", self.text)
        await self._orders[0].client.call("operator.active")
        self._answered_at = self._loop.time()

    async def _problem(self, client: DaemonClient, vehicle: str) -> str | None:
        """Why ``vehicle`` is not the name of a vehicle of the daemon, None if it is. A number, a group and "all" are
        not names."""
        if self._is_vehicle(vehicle):
            return None
        try:
            state = await client.call("vehicles.get", target=vehicle)
        except DaemonUnreachable:
            raise
        except RpcError as error:
            return str(error)
        return None if state.get("name") == vehicle else f"{vehicle!r} is not the name of a vehicle here"

    async def _opened(self) -> _Connection:
        """A new open connection. Raises DaemonUnreachable, RpcError."""
        client = self._connect()
        await client.open()
        try:
            await client.call("operator.relay")
        except BaseException:
            await client.close()
            raise
        return _Connection(client)

    async def _sample(self, connection: _Connection) -> None:
        sent_at = self._loop.time()
        info = await connection.client.call("daemon.info")
        self._clock.sample(sent_at, info.get("now_s"), self._loop.time())

    async def _close(self) -> None:
        if self._asking is not None:
            self._asking.cancel()
        connections = [*self._orders, *self._ending]
        self._orders, self._ending = [], []
        for connection in connections:
            with contextlib.suppress(RpcError, OSError):
                await connection.client.close()

    async def _keep_ending(self) -> None:
        """Use each connection for ending orders: the daemon closes idle ones when all its places are taken."""
        for connection in list(self._ending):
            try:
                await connection.client.call("daemon.info")
            except DaemonUnreachable as error:
                self._lost(error.reason, connection)

    def _lost(self, reason: str, connection: _Connection | None) -> None:
        """An order found its connection closed. A connection for ending orders is dropped while the first connection is
        open; else all connections are made again."""
        self.counters["lost"] += 1
        if connection in self._ending and self._orders and self._orders[0].client.connected:
            self._ending.remove(connection)
        else:
            self._change(reason)

    def _change(self, text: str, *, connected: bool = False) -> None:
        if connected != self.connected:
            _log.info("daemon connected for orders" if connected else "daemon lost for orders", reason=text)
        self.connected, self.text = connected, text


def _carried(answer: bytes, vehicle: str) -> Carried:
    """The outcome of one vehicle in the daemon's answer."""
    try:
        outcome = from_json(answer)["outcomes"][vehicle]
        return Carried(status_of(outcome), str(outcome["message"]), outcome)
    except (ValueError, KeyError, TypeError):
        return Carried("unknown", "the daemon's answer cannot be read; look at the vehicle")
