"""The web process as a client of the daemon: four connections, and one subscription that feeds every page.

    feed      telemetry and events: nothing is asked on it, so a long answer never delays a state
    reads     requests that change nothing; a parameter list may take its time there
    orders    orders
    ending    orders that end a flight (`roles.ENDS_FLIGHT`), with nothing in front of them

None of them counts for operator_timeout_s by itself (operator.relay): `operator_active` says when a person was there.
They are connected all or not at all; a lost one ends the others, and all are made anew after a pause.

    connecting   all four answer                                   -> connected
                 an error, or no answer for LOST_AFTER_S           -> connecting, after a pause
    connected    one has not answered for SLOW_AFTER_S             -> slow
    slow         all have answered                                 -> connected
    connected,   one was closed, or has not answered for
    slow         LOST_AFTER_S                                      -> connecting, after a pause

Orders are passed on to a slow daemon: each has a deadline, after which the daemon refuses it.

With [federation] the station socket stands beside the daemon's, and carries the vehicles of all sites:

    the station socket   and its daemon   connected to        changes when
    ------------------   --------------   -----------------   ---------------------------------------------------------
    is there             is there         the station's       one of the two goes
    is not there         is there         the daemon's        the station socket is there
    is there             is not there     the station's       the daemon's socket is there

A bridge that has ended takes nothing from our own vehicles: they are ordered and stopped by the daemon's socket.
"""

from __future__ import annotations

import asyncio
import contextlib
import socket
from collections.abc import Coroutine
from typing import Any, Protocol

import structlog
from pydantic_core import from_json, to_json

from skygcs.back_off import BackOff
from skygcs.config.station_path import station_socket
from skygcs.core.alarms import with_severity
from skygcs.errors import DaemonUnreachable, RpcError
from skygcs.rpc.address import default_socket_path
from skygcs.rpc.client import Client, connect
from skygcs.rpc.client_connection import OnReport, Subscription
from skygcs.rpc.daemon_clock import DaemonClock
from skygcs.rpc.error_codes import INVALID_PARAMS, LIMIT_EXCEEDED, NO_DAEMON
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
    "companion",
    "gps",
    "position",
    "attitude",
    "battery",
    "home",
    "vfr",
    "mission",
    "links",
)
"""Keys of a state that fleet view and table show, besides name and sysid. The rest of a state is read for the one
vehicle shown."""

FEED_RATES_HZ = (0.5, 1.0, 2.0, 5.0, 10.0, 20.0)
"""The daemon's rate is the smallest of these that no page's rate exceeds."""

PLAN_RATE_HZ = 2.0
"""Rate of a plan that is flown; its changes come at once."""

RATE_EVERY_S = 1.0
"""The rate changes so often at most, however often pages ask."""

FIRST_PAUSE_S, LONGEST_PAUSE_S = 0.2, 3.0
"""Between attempts to connect, doubling."""

ALIVE_EVERY_S = 5.0
"""Each connection is used so often: an idle one would lose its place when all are taken."""

SLOW_AFTER_S, LOST_AFTER_S = 10.0, 60.0
"""Without an answer for so long a daemon is shown as slow, and its connections are made anew. In between they stay: a
daemon that was stopped, or shares a processor with twenty programs, goes on with them at once, and to be connected to
four times and send the whole fleet is more work for it than to answer. What never answers is a tunnel that is cut."""

STOOD_STILL_S = 0.1
"""After a time limit, for what came while this process itself stood still: a loop runs its timers first, and reads
then."""

GONE_AFTER_S = 3.0
"""A vehicle of which no state came for so long, and none in the newest whole round, is one that the daemon has
forgotten. The slowest rate has a round every two seconds."""

NOT_YET = "not connected yet"

LOOK_EVERY_S = 2.0
"""Seconds between two attempts to find the missing one of station socket and daemon's socket."""

NO_BRIDGE = "The bridge to other sites does not answer: vehicles of other sites are not shown"
NO_OWN_DAEMON = "This station's daemon does not answer: only vehicles of other sites are shown"

ORDERS_WAITING = 60
"""Orders without an outcome on one connection; the daemon takes 64."""

_log = structlog.get_logger(__name__)


class Pages(Protocol):
    """Pages that are fed; `skygcs.web.page_clients.PageClients`."""

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
        self.slow = False
        self.text = NOT_YET
        self.loop = asyncio.get_running_loop()
        self.since = self.loop.time()
        self.info: dict[str, Any] = {}
        self.note: str | None = None
        """Text for people about the missing part of the station, although it is connected."""
        self.site: str | None = None
        """The name of this station's site, where there are others."""
        self._station_path = station_socket(str(default_socket_path()) if "://" in address else address)
        self._by_station = False
        self._missing: str | None = None
        """The socket to look for."""
        self.reconnects = 0
        self.stopping = False
        """Set before `run` is cancelled."""
        self._token = token
        self._states = states
        self._clients: dict[str, Client] = {}
        self._clock = DaemonClock()
        self._silent: set[str] = set()
        """Connections on which an answer is due for SLOW_AFTER_S."""
        self._waiting = 0
        self._operator_due = False

    # -- requests of pages

    async def call(
        self,
        method: str,
        params: dict[str, Any],
        deadline_s: float | None = None,
        on_report: OnReport | None = None,
    ) -> bytes:
        """The daemon's answer, encoded. Raises RpcError; DaemonUnreachable at once while it is not connected.

        ``deadline_s``: of this process' clock; a daemon that reads the request later refuses it. ``on_report``: gets
        the reports of an order.
        """
        kind = access(method)
        client = self._clients.get({"read": "reads", "ends flight": "ending"}.get(kind, "orders"))
        if client is None or not self.connected:
            raise DaemonUnreachable(self.address, self.text)
        ahead_s = self._clock.ahead_s
        due_s = None if deadline_s is None or ahead_s is None else deadline_s + ahead_s
        counted = int(kind == "order")
        if counted and self._waiting >= ORDERS_WAITING:
            text = f"{ORDERS_WAITING} orders wait for their outcome; this one was not carried out"
            raise RpcError(LIMIT_EXCEEDED, text)
        self._waiting += counted
        try:
            answer = await client.relay(method, params, due_s, on_report)
        except ValueError as error:  # 1e999 is read as infinite, which JSON cannot carry on
            raise RpcError(INVALID_PARAMS, f"{method}: {error}") from None
        finally:
            self._waiting -= counted
        return to_json([with_severity(event) for event in from_json(answer)]) if method == "events.recent" else answer

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
        back_off = BackOff(FIRST_PAUSE_S, LONGEST_PAUSE_S)
        while True:
            try:
                async with contextlib.AsyncExitStack() as stack:
                    await self._answered(self._connect(stack), "connecting", pages)
                    back_off.reset()
                    self._states.reset()
                    self._change("connected", pages, connected=True)
                    await self._serve(pages)
            except* RpcError as group:
                error = _first(group)
                self._clients = {}
                self._states.reset()
                self._change(str(error), pages)
            finally:
                self._clients = {}
            if self.stopping:  # cancelled at the moment of the loss: a task group prefers its tasks' errors
                return
            self.reconnects += 1
            await asyncio.sleep(back_off.after())

    async def _connect(self, stack: contextlib.AsyncExitStack) -> None:
        """To the station socket, or the daemon's (see the table). Raises RpcError, in a group."""
        self.note = self.site = self._missing = None
        self._by_station = _listens(self._station_path)
        if self._by_station:
            await self._connect_to(self._station_path, None, stack)
            sites = await self._clients["reads"].call("federation.sites")
            self.site = sites.get("site")
            if "daemon" not in self.info or self.info["daemon"] is not None:
                return
            if "://" in self.address or not _listens(self.address):
                self.note, self._missing = None if self.site is None else NO_OWN_DAEMON, self.address
                return
            self._by_station = False
        await self._connect_to(self.address, self._token, stack)
        if self.info.get("federation") is not None:
            self.note, self._missing, self.site = NO_BRIDGE, self._station_path, None

    async def _connect_to(self, address: str, token: str | None, stack: contextlib.AsyncExitStack) -> None:
        """All at once: one after another a slow daemon would take four times as long."""
        clock = DaemonClock()

        async def one() -> Client:
            client = await stack.enter_async_context(connect(address, token=token))
            await client.call("operator.relay")
            self.info = await self._ask_info(client, clock)
            return client

        async with asyncio.TaskGroup() as group:
            tasks = {
                name: group.create_task(one(), name=f"connect {name}") for name in ("feed", "reads", "orders", "ending")
            }
        self._clock = clock
        self._clients = {name: task.result() for name, task in tasks.items()}

    async def _ask_info(self, client: Client, clock: DaemonClock) -> dict[str, Any]:
        sent_at = self.loop.time()
        info: dict[str, Any] = await client.call("daemon.info")
        clock.sample(sent_at, info.get("now_s"), self.loop.time())
        return info

    async def _answered(self, asked: Coroutine[Any, Any, Any], name: str, pages: Pages) -> None:
        """Wait for an answer on the connection of this name. Raises what ``asked`` raises, and RpcError after
        LOST_AFTER_S.

        Not asyncio.wait_for: in Python 3.11 it returns an answer that comes together with a cancellation, and the
        cancelled task goes on (CPython issue 86296). The group of tasks that a loss ends would then never end.
        """
        task = self.loop.create_task(asked, name=f"answer {name}")
        try:
            if not await _done_within(task, SLOW_AFTER_S):
                self._silent.add(name)
                self._show_slow(pages)
                if not await _done_within(task, LOST_AFTER_S - SLOW_AFTER_S):
                    text = f"the daemon at {self.address} has not answered for {LOST_AFTER_S:g} s"
                    raise RpcError(NO_DAEMON, text)  # the text of DaemonUnreachable would say to start one
            task.result()
        finally:
            self._silent.discard(name)
            task.cancel()
            await asyncio.gather(task, return_exceptions=True)
        self._show_slow(pages)

    def _show_slow(self, pages: Pages) -> None:
        if self._silent:
            text = f"the daemon at {self.address} does not answer"
            self._change(text, pages, connected=self.connected, slow=self.connected)
        elif self.connected:
            self._change("connected", pages, connected=True)

    async def _serve(self, pages: Pages) -> None:
        feed = self._clients["feed"]
        async with asyncio.TaskGroup() as group:
            group.create_task(self._feed_states(feed, pages), name="states")
            group.create_task(self._feed_events(feed.events(self._everybody), pages), name="events")
            group.create_task(self._feed_plan(feed.plan(rate_hz=PLAN_RATE_HZ), pages), name="plan")
            group.create_task(self._look(), name="look for the other socket")
            for name, client in self._clients.items():
                group.create_task(self._keep_alive(name, client, pages), name=f"keep alive {name}")

    @property
    def _everybody(self) -> str:
        """The targets that are all vehicles."""
        return "*/all" if self._by_station else "all"

    async def _look(self) -> None:
        """Raises RpcError once the socket that was missing is there: all is connected to anew."""
        while True:
            await asyncio.sleep(LOOK_EVERY_S)
            if self._missing is not None and "://" not in self._missing and _listens(self._missing):
                raise RpcError(NO_DAEMON, f"{self._missing} is there now")

    async def _feed_states(self, feed: Client, pages: Pages) -> None:
        """One subscription at the rate that the pages want; none while no page is there."""
        while True:
            rate_hz = feed_rate_hz(pages.rate_hz())
            if rate_hz is None:
                self._states.reset()
                pages.wanted.clear()
                await pages.wanted.wait()
                continue
            subscription = feed.encoded_telemetry(self._everybody, rate_hz=rate_hz, groups=STATE_KEYS)
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
        round_began = self.loop.time()
        async for update in subscription:
            now = self.loop.time()
            for name, state in update["states"].items():
                states.put(name, state, now)
            if update["complete"]:
                states.complete_round()
                states.remove_older(min(round_began, now - GONE_AFTER_S))
                round_began = now
            pages.on_states()

    async def _feed_events(self, events: Subscription, pages: Pages) -> None:
        async for event in events:
            if event.get("kind") == "vehicle_forgotten" and event.get("vehicle"):
                self._states.remove(event["vehicle"])
                pages.on_states()
            pages.on_event(with_severity(event))

    async def _feed_plan(self, plans: Subscription, pages: Pages) -> None:
        async for plan in plans:
            pages.notify("web.plan", plan, keep=True)

    async def _keep_alive(self, name: str, client: Client, pages: Pages) -> None:
        while True:
            await asyncio.sleep(ALIVE_EVERY_S)
            await self._answered(self._ask_info(client, self._clock), name, pages)

    def _change(self, text: str, pages: Pages, *, connected: bool = False, slow: bool = False) -> None:
        before, first = (self.connected, self.slow), self.text == NOT_YET
        if (connected, slow, text) == (*before, self.text):
            return
        self.connected, self.slow, self.text = connected, slow, text
        self.since = self.loop.time() - (SLOW_AFTER_S if slow else 0.0)
        if connected:
            _log.info("daemon is slow" if slow else "daemon connected", reason=text)
        elif before[0] or first:
            _log.info("daemon lost" if before[0] else "no daemon yet", reason=text)
        pages.on_daemon()


async def _done_within(task: asyncio.Task[Any], seconds: float) -> bool:
    await asyncio.wait({task}, timeout=seconds)
    if not task.done():
        await asyncio.wait({task}, timeout=STOOD_STILL_S)
    return task.done()


def _listens(path: str) -> bool:
    """True if a process takes connections at this path, or would if it were less busy."""
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM | socket.SOCK_NONBLOCK) as probe:
        try:
            probe.connect(path)
        except BlockingIOError:
            return True
        except OSError:
            return False
    return True


def feed_rate_hz(wanted_hz: float | None) -> float | None:
    """The rate of the one subscription for pages that want up to ``wanted_hz``."""
    if wanted_hz is None:
        return None
    return next((rate for rate in FEED_RATES_HZ if rate >= wanted_hz), FEED_RATES_HZ[-1])


def _first(group: BaseException) -> BaseException:
    while isinstance(group, BaseExceptionGroup):
        group = group.exceptions[0]
    return group
