"""The web process as a client of the daemon: four connections, and one subscription that feeds every page.

    feed      telemetry and events: nothing is asked on it, so a long answer never delays a state
    reads     requests that change nothing; a parameter list may take its time there
    orders    orders
    ending    orders that end a flight (`roles.ENDS_FLIGHT`), with nothing in front of them

None of them counts for operator_timeout_s by itself (operator.relay): `operator_active` says when a person was there.
They are connected all or not at all; a lost one ends the others, and all are made anew after a pause.
"""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import Awaitable
from typing import Any, Protocol

import structlog

from skygcs.errors import DaemonUnreachable, RpcError
from skygcs.rpc.client import Client, Subscription, connect
from skygcs.web.roles import access
from skygcs.web.state_batches import LatestStates

STATE_KEYS = (
    "compid",
    "autopilot",
    "type",
    "firmware",
    "groups",
    "connected",
    "duplicate_sysid",
    "replayed",
    "last_heartbeat_age_s",
    "uptime_s",
    "armed",
    "mode",
    "system_status",
    "landed",
    "failsafe",
    "control",
    "uplink",
    "separation",
    "gps",
    "position",
    "attitude",
    "battery",
    "home",
    "vfr",
    "mission",
    "links",
)
"""What fleet view and table show, besides name and sysid. The rest of a state is read for the one vehicle shown."""

FEED_RATES_HZ = (0.5, 1.0, 2.0, 5.0, 10.0, 20.0)
"""The daemon's rate is the smallest of these that no page's rate exceeds."""

PLAN_RATE_HZ = 2.0
"""Of a plan that is flown; its changes come at once."""

RATE_EVERY_S = 1.0
"""The rate changes so often at most, however often pages ask."""

FIRST_PAUSE_S, LONGEST_PAUSE_S = 0.2, 3.0
"""Between attempts to connect, doubling."""

ALIVE_EVERY_S, ALIVE_WITHIN_S = 5.0, 10.0
"""Each connection is used so often: an idle one would lose its place when all are taken; and a daemon that does not
answer within this time has hung."""

GONE_AFTER_S = 3.0
"""A vehicle of which no state came for so long, while others came, is one that the daemon has forgotten. The slowest
rate has a round every two seconds."""

NOT_ANSWERING = -32000
"""The code of DaemonUnreachable, whose text would say to start one."""

ORDERS_WAITING = 60
"""Orders without an outcome on one connection; the daemon takes 64."""

_log = structlog.get_logger(__name__)


class Pages(Protocol):
    """Who is fed; `skygcs.web.page_clients.PageClients`."""

    def on_states(self) -> None: ...
    def on_event(self, event: dict[str, Any]) -> None: ...
    def on_daemon(self) -> None: ...
    def notify(self, method: str, params: Any, *, keep: bool = False) -> None: ...
    def wake_all(self) -> None: ...
    @property
    def wanted(self) -> asyncio.Event:
        """Set when a page has subscribed."""
        ...

    def rate_hz(self) -> float | None:
        """The highest rate that a page wants; None: no page wants states."""
        ...


class DaemonConnection:
    """Run `run` in a task. ``connected`` and ``text`` say how it stands, since ``since``."""

    def __init__(self, address: str, token: str | None, states: LatestStates) -> None:
        self.address = address
        self.takes_orders = True
        self.connected = False
        self.text = "not connected yet"
        self.loop = asyncio.get_running_loop()
        self.since = self.loop.time()
        self.info: dict[str, Any] = {}
        self.reconnects = 0
        self.stopping = False
        """Set before `run` is cancelled."""
        self._token = token
        self._states = states
        self._clients: dict[str, Client] = {}
        self._waiting = 0
        self._operator_due = False

    # -- requests of pages

    async def call(self, method: str, params: dict[str, Any]) -> Any:
        """The daemon's answer. Raises RpcError; DaemonUnreachable at once while it is not connected."""
        kind = access(method)
        client = self._clients.get({"read": "reads", "ends flight": "ending"}.get(kind, "orders"))
        if client is None or not self.connected:
            raise DaemonUnreachable(self.address, self.text)
        if kind == "order":
            if self._waiting >= ORDERS_WAITING:
                raise RpcError(-32005, f"{ORDERS_WAITING} orders wait for their outcome; this one was not carried out")
            self._waiting += 1
            try:
                return await client.call(method, **params)
            finally:
                self._waiting -= 1
        return await client.call(method, **params)

    def operator_active(self) -> None:
        """A person used a page that may give orders."""
        client = self._clients.get("ending")
        if client is None or self._operator_due:
            return
        self._operator_due = True

        async def report() -> None:
            try:
                await client.call("operator.active")
            except RpcError as error:
                _log.warning("operator's input not reported", error=str(error))
            finally:
                self._operator_due = False

        task = self.loop.create_task(report(), name="operator active")
        self._reporting = task

    # -- life

    async def run(self, pages: Pages) -> None:
        """Connect, feed the pages until the connection is lost, and again; until it is cancelled."""
        pause_s = FIRST_PAUSE_S
        while True:
            try:
                async with contextlib.AsyncExitStack() as stack:
                    await self._connect(stack)
                    pause_s = FIRST_PAUSE_S
                    self._states.reset()
                    self._change(True, "connected", pages)
                    await self._serve(pages)
            except* RpcError as group:
                error = _first(group)
                self._clients = {}
                self._states.reset()
                self._change(False, str(error), pages)
            finally:
                self._clients = {}
            if self.stopping:  # cancelled at the moment of the loss: a task group prefers its tasks' errors
                return
            self.reconnects += 1
            await asyncio.sleep(pause_s)
            pause_s = min(2 * pause_s, LONGEST_PAUSE_S)

    async def _connect(self, stack: contextlib.AsyncExitStack) -> None:
        clients = {}
        for name in ("feed", "reads", "orders", "ending"):
            client = await stack.enter_async_context(connect(self.address, token=self._token))
            await self._in_time(client.call("operator.relay"))
            clients[name] = client
        self.info = await self._in_time(clients["reads"].call("daemon.info"))
        self._clients = clients

    async def _in_time(self, answer: Awaitable[Any]) -> Any:
        """The answer. Raises RpcError where a daemon takes connections and does not answer."""
        try:
            return await asyncio.wait_for(answer, ALIVE_WITHIN_S)
        except TimeoutError:
            text = f"the daemon at {self.address} has not answered for {ALIVE_WITHIN_S:g} s"
            raise RpcError(NOT_ANSWERING, text) from None

    async def _serve(self, pages: Pages) -> None:
        feed = self._clients["feed"]
        async with asyncio.TaskGroup() as group:
            group.create_task(self._feed_states(feed, pages), name="states")
            group.create_task(self._feed_events(feed.events(), pages), name="events")
            group.create_task(self._feed_plan(feed.plan(rate_hz=PLAN_RATE_HZ), pages), name="plan")
            for name, client in self._clients.items():
                group.create_task(self._keep_alive(client), name=f"keep alive {name}")

    async def _feed_states(self, feed: Client, pages: Pages) -> None:
        """One subscription at the rate that the pages want; none while no page is there."""
        while True:
            rate_hz = feed_rate_hz(pages.rate_hz())
            if rate_hz is None:
                self._states.reset()
                pages.wanted.clear()
                await pages.wanted.wait()
                continue
            subscription = feed.encoded_telemetry("all", rate_hz=rate_hz, groups=STATE_KEYS)
            began_at = self.loop.time()
            reading = self.loop.create_task(self._read_states(subscription, pages), name="telemetry")
            try:
                while feed_rate_hz(pages.rate_hz()) == rate_hz and not reading.done():
                    await asyncio.wait({reading}, timeout=RATE_EVERY_S)
                    if not self._states.complete and self.loop.time() - began_at > GONE_AFTER_S:
                        self._states.settle()  # this daemon has no vehicle
                        pages.wake_all()
                if reading.done():
                    reading.result()
            finally:
                reading.cancel()
                subscription.close()

    async def _read_states(self, subscription: Subscription, pages: Pages) -> None:
        states = self._states
        checked_at = self.loop.time()
        async for update in subscription:
            now = self.loop.time()
            for name, state in update["states"].items():
                states.put(name, state, now)
            if update["complete"]:
                states.complete_round()
            pages.on_states()
            if now - checked_at > GONE_AFTER_S:
                states.remove_older(min(checked_at, now - GONE_AFTER_S))
                checked_at = now

    async def _feed_events(self, events: Subscription, pages: Pages) -> None:
        async for event in events:
            if event.get("kind") == "vehicle_forgotten" and event.get("vehicle"):
                self._states.remove(event["vehicle"])
                pages.on_states()
            pages.on_event(event)

    async def _feed_plan(self, plans: Subscription, pages: Pages) -> None:
        async for plan in plans:
            pages.notify("web.plan", plan, keep=True)

    async def _keep_alive(self, client: Client) -> None:
        while True:
            await asyncio.sleep(ALIVE_EVERY_S)
            await self._in_time(client.call("daemon.info"))

    def _change(self, connected: bool, text: str, pages: Pages) -> None:
        if (connected, text) == (self.connected, self.text):
            return
        was = self.connected
        self.connected, self.text, self.since = connected, text, self.loop.time()
        if connected or was:
            _log.info("daemon connected" if connected else "daemon lost", reason=text)
        pages.on_daemon()


def feed_rate_hz(wanted_hz: float | None) -> float | None:
    """The rate of the one subscription for pages that want up to ``wanted_hz``."""
    if wanted_hz is None:
        return None
    return next((rate for rate in FEED_RATES_HZ if rate >= wanted_hz), FEED_RATES_HZ[-1])


def _first(group: BaseException) -> BaseException:
    while isinstance(group, BaseExceptionGroup):
        group = group.exceptions[0]
    return group
