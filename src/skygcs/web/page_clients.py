"""The pages connected by WebSocket: their requests, and what they are sent. Knows nothing of HTTP.

A page has one sending task. What waits for it is bounded: replies by the requests that may wait (`request_limits`),
events by EVENTS_WAITING (the oldest go, and are counted), states by one number (`state_batches`). A page that does not
read for STUCK_S is closed; nothing else changes because of it.
"""

from __future__ import annotations

import asyncio
import contextlib
import functools
from collections import deque
from collections.abc import Awaitable, Callable, Coroutine, Mapping
from typing import Any, Protocol

import structlog

from skygcs.errors import DaemonUnreachable, RpcError, SkygcsError
from skygcs.rpc.client_connection import OnReport
from skygcs.rpc.error_codes import (
    AWAY,
    INTERNAL_ERROR,
    INVALID_PARAMS,
    INVALID_REQUEST,
    LIMIT_EXCEEDED,
    METHOD_NOT_FOUND,
    NOT_PERMITTED,
    REFUSED,
    TOO_LATE,
)
from skygcs.rpc.json_lines import EVENT_START, REPORT, notification
from skygcs.rpc.replies import encode, error_reply, parse_request, reply_of, unread
from skygcs.web.fleet_digest import View
from skygcs.web.request_limits import MAX_ID, MAX_ID_CHARS, PageLimits, deadline_problem
from skygcs.web.roles import ENDS_FLIGHT, NOT_PASSED_ON, READ, access, may
from skygcs.web.sign_in import Role
from skygcs.web.state_batches import LatestStates, PageStates

EVENTS_WAITING = 256
"""Events that may wait, the same as the daemon's own bound for a subscription."""

REPORTS_WAITING = 1024
"""Replies and reports of orders that wait for a page: an order to the largest fleet that has them comes to 300."""

LOOKING = 32
"""Requests in flight of all pages that may only look; further ones wait. The daemon takes 64 on the connection that
these pages share with those that may order, and refuses more."""

LEAST_RATE_HZ, MAX_RATE_HZ, DEFAULT_RATE_HZ = 0.2, 20.0, 10.0

MANY_VEHICLES, MANY_RATE_HZ = 100, 5.0
"""Number of vehicles above which states come at most at this rate. A page carries each on with its velocity in between,
so that nobody sees a difference. 200 states ten times a second take a third of a core of the daemon and the page, which
draw and fly."""

VERY_MANY_VEHICLES, VERY_MANY_RATE_HZ = 400, 2.0
"""The same for very many vehicles: most of them are dots."""

STUCK_S = 30.0
"""A page that takes nothing for so long is closed; one that wakes up connects again and gets everything anew."""

OPERATOR_EVERY_S = 0.5
"""A person's input is reported to the daemon so often at most."""

MAX_ECHO_CHARS = 80

ONLY_LOOKS = "this page may only look; skygcs web link prints an address that may more"

_log = structlog.get_logger(__name__)

Request = dict[str, Any]
OwnMethod = Callable[["PageClient", dict[str, Any]], Awaitable[Any]]
"""A method that the web process answers. Raises SkygcsError."""


SHOWN_TABLES = ("drills", "recordings")
"""Tables of the daemon's fleet file without which the page has no room for what they bring."""


class Socket(Protocol):
    """A WebSocket, as a page's tasks see it."""

    async def send_frame(self, data: bytes) -> None:
        """Send one text frame; returns when it may be followed by another. Raises ConnectionError."""
        ...

    def abort(self) -> None: ...


class Source(Protocol):
    """Where states and answers come from: a daemon or a recording."""

    connected: bool
    slow: bool
    """Connected, and it has not answered for a while."""
    takes_orders: bool
    text: str
    since: float
    note: str | None
    """Text about the missing part, although it is connected."""
    site: str | None
    """The name of the own site, where there are others."""
    info: dict[str, Any]
    """The daemon's answer to daemon.info."""

    async def call(
        self,
        method: str,
        params: dict[str, Any],
        deadline_s: float | None = None,
        on_report: OnReport | None = None,
    ) -> bytes:
        """Its answer, encoded. ``on_report``: gets the reports of an order (`skygcs.rpc.json_lines`). Raises
        RpcError."""
        ...

    def operator_active(self) -> None: ...


class PageClients:
    """All pages. ``source`` answers what ``own`` does not."""

    def __init__(self, states: LatestStates, source: Source, own: Mapping[str, OwnMethod]) -> None:
        self.loop = asyncio.get_running_loop()
        self.states = states
        self.source = source
        self.own = own
        self.clients: dict[PageClient, None] = {}
        self.orders: set[asyncio.Task[None]] = set()
        """Orders in progress: they go on to their outcome when their page leaves."""
        self.looking = asyncio.Semaphore(LOOKING)
        self.counters = {"closed_stuck": 0, "closed_flooding": 0, "events_dropped": 0, "late_orders": 0}
        self.wanted = asyncio.Event()
        """Set when a page has subscribed."""
        self._kept: dict[str, bytes] = {}
        """The newest of notices that a page needs which comes later; forgotten with the daemon."""
        self._round: asyncio.TimerHandle | None = None
        self._operator_at = float("-inf")

    # -- fed by the daemon's connection or by a recording

    def on_states(self) -> None:
        """A state has come: pages get it when the round is complete."""
        due = self.states.round_complete_at()
        if due is not None and due <= self.loop.time():
            if self._round is not None:
                self._round.cancel()
            self._on_round()
        elif self._round is None:
            self._arm_round()

    def on_event(self, event: dict[str, Any]) -> None:
        body = EVENT_START + _encode(event)
        for client in tuple(self.clients):
            client.offer_event(body)

    def on_daemon(self) -> None:
        """The connection to the daemon has come or gone, or the daemon is slow."""
        if not self.source.connected:
            self._kept.clear()
        self.notify("web.daemon", self.daemon_status())
        self.wake_all()

    def notify(self, method: str, params: Any, *, keep: bool = False) -> None:
        """Send something to all pages; of one method only the newest waits. ``keep``: also to pages that come later."""
        body = notification(method, _encode(params))
        if keep:
            self._kept[method] = body
        for client in tuple(self.clients):
            client.offer_notice(method, body)

    def offer_kept(self, client: PageClient) -> None:
        """Offer what a page that has come now has missed."""
        for method, body in self._kept.items():
            client.offer_notice(method, body)

    def wake_all(self) -> None:
        for client in tuple(self.clients):
            client.wake()

    def daemon_status(self) -> dict[str, Any]:
        source = self.source
        since_s = round(source.since, 3)
        status = {"connected": source.connected, "slow": source.slow, "text": source.text, "since_s": since_s}
        extras = {table: source.info.get(table) is not None for table in SHOWN_TABLES}
        return status | {"note": source.note, "site": source.site} | extras

    def rate_hz(self) -> float | None:
        """The highest rate that a page wants, of a large fleet less; None: no page wants states."""
        wanted_hz = max((client.page_states.rate_hz for client in self.clients if client.page_states), default=None)
        if wanted_hz is None or len(self.states) <= MANY_VEHICLES:
            return wanted_hz
        return min(wanted_hz, MANY_RATE_HZ if len(self.states) <= VERY_MANY_VEHICLES else VERY_MANY_RATE_HZ)

    def ending_beside(self, client: PageClient) -> int:
        """Requests that end a flight and wait, of the other pages of this page's browser."""
        return sum(c.ending_waiting for c in self.clients if c.identity == client.identity and c is not client)

    def operator_active(self, client: PageClient) -> None:
        now = self.loop.time()
        if client.role == "command" and now - self._operator_at >= OPERATOR_EVERY_S:
            self._operator_at = now
            self.source.operator_active()

    def _arm_round(self) -> None:
        due = self.states.round_complete_at()
        self._round = None if due is None else self.loop.call_at(due, self._on_round)

    def _on_round(self) -> None:
        self._round = None
        due = self.states.round_complete_at()
        if due is None:
            return  # it was forgotten: the daemon is gone
        if due > self.loop.time() + 0.0005:
            self._arm_round()
            return
        self.states.end_round()
        self.wake_all()

    def close_pages(self) -> None:
        """Close every page; their orders in progress go on."""
        for client in list(self.clients):
            client.close()

    async def close(self) -> None:
        """End every page's tasks. Orders in progress are no longer waited for; what was sent stays sent."""
        self.close_pages()
        for task in list(self.orders):
            task.cancel()
        if self._round is not None:
            self._round.cancel()
        await asyncio.gather(*self.orders, return_exceptions=True)


class PageClient:
    """One WebSocket. `on_message` for each text frame; `send` runs as its task until the socket ends."""

    def __init__(self, pages: PageClients, socket: Socket, role: Role, identity: str) -> None:
        self.pages = pages
        self.role = role
        self.identity = identity
        self.page_states: PageStates | None = None
        self._socket = socket
        self._loop = pages.loop
        self._limits = PageLimits(self._loop.time())
        self._wake = asyncio.Event()
        self._replies: deque[tuple[bytes, bool | None]] = deque()
        """With each whether its request ends a flight; None: a refusal. A request waits until its reply is sent."""
        self._notices: dict[str, bytes] = {}
        self._events: deque[bytes] = deque()
        self._dropped = 0
        self._reads: set[asyncio.Task[None]] = set()
        self._due: asyncio.TimerHandle | None = None
        self._sending_since: float | None = None
        self._closed = False

    # -- what it is sent

    def subscribe(self, rate_hz: float) -> int:
        if self.page_states is None:
            self.page_states = PageStates(self.pages.states, rate_hz)
        else:
            self.page_states.again(rate_hz)
        self.pages.wanted.set()
        self.pages.offer_kept(self)
        self.wake()
        return self.page_states.seq

    def show(self, view: View) -> None:
        """Set what it shows in full, of a large fleet."""
        if self.page_states is None:
            raise RpcError(REFUSED, "web.view: subscribe first")
        self.page_states.show(view)
        self.wake()

    def offer_event(self, body: bytes) -> None:
        if self.page_states is None:
            return
        if len(self._events) >= EVENTS_WAITING:
            self._events.popleft()
            self._dropped += 1
            self.pages.counters["events_dropped"] += 1
        self._events.append(body)
        self.wake()

    def offer_notice(self, method: str, body: bytes) -> None:
        self._notices[method] = body
        self.wake()

    def wake(self) -> None:
        """There may be something to send. A page that has not taken the last for STUCK_S is closed."""
        self._wake.set()
        if self._sending_since is not None and self._loop.time() - self._sending_since > STUCK_S and not self._closed:
            self.pages.counters["closed_stuck"] += 1
            _log.info("page closed: it takes nothing", seconds=STUCK_S)
            self.close()

    async def send(self) -> None:
        """Send what waits, until the socket ends."""
        while not self._closed:
            data = self._next()
            if data is None:
                self._wake.clear()
                await self._wake.wait()
                continue
            self._sending_since = self._loop.time()
            await self._socket.send_frame(data)
            self._sending_since = None

    def _next(self) -> bytes | None:
        """Replies first, then news of the connection, events, states."""
        if self._replies:
            reply, ends_flight = self._replies.popleft()
            if ends_flight is not None:
                self._limits.end(ends_flight=ends_flight)
            return reply
        if self._notices:
            return self._notices.pop(next(iter(self._notices)))
        if self._events:
            body = self._events.popleft()
            dropped, self._dropped = self._dropped, 0
            return body + (b',"dropped":%d}}' % dropped if dropped else b"}}")
        return self._next_states()

    def _next_states(self) -> bytes | None:
        states = self.page_states
        if states is None or (due := states.due_at()) is None:
            return None
        now = self._loop.time()
        if due > now:
            if self._due is None:
                self._due = self._loop.call_at(due, self._on_due)
            return None
        store, batch = self.pages.states, states.batch(now)
        levels = b""
        if batch.brief is not None:
            levels = b'"brief":[%b],"left_out":%d,' % (b",".join(batch.brief), batch.left_out)
            if batch.sites is not None:
                levels += b'"sites":%b,' % _encode(batch.sites)
        return (
            b'{"jsonrpc":"2.0","method":"web.state","params":{"seq":%d,"full":%b,"now_s":%.4f,"heard_s":%.4f,"began_s":%.4f,"vehicles":['
            % (states.seq, b"true" if batch.full else b"false", now, store.heard_at, store.began_at)
            + b",".join(batch.states)
            + b'],%b"gone":%b}}' % (levels, _encode(batch.gone))
        )

    def _on_due(self) -> None:
        self._due = None
        self.wake()

    # -- what it asks

    def on_message(self, text: str | bytes) -> None:
        """One frame. Never raises for what is in it. Nothing comes of it once the page is closed: of a browser that was
        signed out, orders may wait to be read."""
        if self._closed:
            return
        # parse; a malformed message is refused
        received_at = self._loop.time()
        try:
            request = parse_request(text.encode() if isinstance(text, str) else text)
        except ValueError as error:
            self._refuse(None, *unread(error))
            return
        if not isinstance(request, dict) or not isinstance(request.get("method"), str):
            self._refuse(None, INVALID_REQUEST, "a message is one JSON-RPC request")
            return
        # the page's sign that its operator is there has no answer
        method, request_id = request["method"], request.get("id")
        if method == "operator.active":
            self.pages.operator_active(self)
            return
        # check the request's form
        if not _is_id(request_id):
            text = f"a request needs an id: a number, or a string of at most {MAX_ID_CHARS} characters"
            self._refuse(None, INVALID_REQUEST, text)
            return
        params = request.get("params", {})
        if not isinstance(params, dict):
            self._refuse(request_id, INVALID_PARAMS, "params must be an object")
            return
        # check the role and the limits
        refusal = self._refusal(method, request, received_at)
        if refusal is not None:
            self._refuse(request_id, *refusal)
            return
        ends_flight = method in ENDS_FLIGHT
        exceeded = self._limits.begin(received_at, ends_flight=ends_flight, others=self.pages.ending_beside(self))
        if exceeded is not None:
            self._refuse(request_id, LIMIT_EXCEEDED, exceeded)
            return
        # pass it on
        self._start(self._answer(request, params, ends_flight), order=self._is_order(method))

    @property
    def closed(self) -> bool:
        """True after `close`."""
        return self._closed

    @property
    def ending_waiting(self) -> int:
        return self._limits.ending_waiting

    def pause_s(self, size: int) -> float:
        """After `on_message`: how long to read no further message from it."""
        return self._limits.pause_s(size, self._loop.time())

    def _is_order(self, method: str) -> bool:
        return method not in self.pages.own and access(method) in ("order", "ends flight")

    def _refusal(self, method: str, request: Request, now: float) -> tuple[int, str] | None:
        """Why it is not carried out, as (code, text)."""
        name = method[:MAX_ECHO_CHARS]
        if method in self.pages.own:
            if self.role != "command" and method in OWN_COMMANDS:
                return NOT_PERMITTED, f"{name}: {ONLY_LOOKS}"
            return None
        if method.startswith(("web.", "replay.")):
            return METHOD_NOT_FOUND, f"no method {name}"
        if access(method) == "refused":
            if method not in NOT_PASSED_ON:
                return METHOD_NOT_FOUND, f"no method {name}"
            return REFUSED, f"{name} is not for pages"
        if not may(self.role, method):
            return NOT_PERMITTED, f"{name}: {ONLY_LOOKS}"
        if method not in READ and not self.pages.source.takes_orders:
            return REFUSED, f"{name}: this is a replay; nothing can be ordered"
        if method not in READ and (problem := deadline_problem(request.get("deadline_s"), now)) is not None:
            self.pages.counters["late_orders"] += 1
            return TOO_LATE, f"{name}: {problem}"
        if not self.pages.source.connected:
            return AWAY, f"{name}: {self.pages.source.text}"
        return None

    def _refuse(self, request_id: object, code: int, text: str) -> None:
        self._limits.refused += 1
        if self._limits.exceeded:
            self.pages.counters["closed_flooding"] += 1
            _log.warning("page closed: too many requests were refused")
            self.close()
            return
        if len(self._replies) < EVENTS_WAITING:  # further refusals are not worth the memory
            self._reply(error_reply(request_id, code, text), None)

    def _start(self, answer: Coroutine[Any, Any, None], *, order: bool) -> None:
        group = self.pages.orders if order else self._reads
        task = self._loop.create_task(answer, name="page order" if order else "page request")
        group.add(task)
        task.add_done_callback(group.discard)

    async def _answer(self, request: Request, params: dict[str, Any], ends_flight: bool) -> None:
        method, request_id = request["method"], request["id"]
        try:
            own = self.pages.own.get(method)
            if own is not None:
                result = _encode(await own(self, params))
            else:
                order = self._is_order(method)
                deadline_s = request["deadline_s"] if order else None
                asked = order and request.get(REPORT) is True
                on_report = functools.partial(self._report, request_id) if asked else None
                async with self.pages.looking if self.role == "view" else contextlib.nullcontext():
                    result = await self.pages.source.call(method, params, deadline_s, on_report)
            reply = reply_of(request_id, result)
        except DaemonUnreachable as error:
            reply = error_reply(request_id, AWAY, str(error))
        except RpcError as error:
            reply = error_reply(request_id, error.code, error.message, error.data)
        except SkygcsError as error:
            reply = error_reply(request_id, INVALID_PARAMS, str(error))
        except Exception as error:
            _log.error("page request failed", method=method, exc_info=error)
            reply = error_reply(
                request_id, INTERNAL_ERROR, f"{method[:MAX_ECHO_CHARS]} failed inside skygcs web; see its log"
            )
        self._reply(reply, ends_flight)

    def _report(self, request_id: object, method: str, params: dict[str, Any]) -> None:
        """Pass on what has come of an order of this page, with the page's own id of it. One that reads too slowly gets
        it with the reply."""
        if len(self._replies) < REPORTS_WAITING:
            self._reply(notification(method, _encode({**params, "request": request_id})), None)

    def _reply(self, reply: bytes, ends_flight: bool | None) -> None:
        if not self._closed:
            self._replies.append((reply, ends_flight))
            self.wake()

    def close(self) -> None:
        """Forget the page: what it reads is cancelled, its orders go on. Idempotent."""
        if self._closed:
            return
        self._closed = True
        self.pages.clients.pop(self, None)
        for task in list(self._reads):
            task.cancel()
        if self._due is not None:
            self._due.cancel()
        self._replies.clear()
        self._events.clear()
        self._notices.clear()
        self._wake.set()
        self._socket.abort()


OWN_COMMANDS = frozenset({"replay.play", "replay.pause", "replay.seek", "replay.speed"})
"""Methods of the web process that the role view may not call."""


def _is_id(value: object) -> bool:
    match value:
        case bool():
            return False
        case str():
            return len(value) <= MAX_ID_CHARS
        case int():
            return -MAX_ID < value < MAX_ID
        case _:
            return isinstance(value, float)


def _encode(value: object) -> bytes:
    return encode(value, serialize_unknown=True)
