"""Sessions of the socket's clients: their number, their turns, and orders that outlive a client.

a place is free (MAX_SESSIONS)        a new connection gets it
else                                  the session that was idle for longest, IDLE_S at least, is closed for it
else                                  it is let in beyond the places (MAX_RESERVE), for one request that ends a flight
                                      or shows what flies (`Method.always`), to be asked within RESERVE_S
those are taken, too                  the oldest that has not asked for anything yet is closed
TCP, before authentication            takes no place; the oldest is closed when MAX_UNAUTHENTICATED wait
"""

from __future__ import annotations

import asyncio
import functools
import hmac
import socket
from collections import Counter, deque
from collections.abc import Callable, Coroutine, Mapping
from dataclasses import dataclass, field
from typing import Any

import structlog

from skygcs.core.vehicle.order_ledger import ClientIdentity
from skygcs.descriptors import is_of_the_last
from skygcs.events import Event
from skygcs.rpc import client_peer, dispatch, error_codes
from skygcs.rpc.client_peer import ClientPeer
from skygcs.rpc.context import RELAY, Context, JsonObject, ReportingContext, Services
from skygcs.rpc.dispatch import Dispatcher, Encoded, InvalidParams, LimitExceeded, Method
from skygcs.rpc.json_lines import MAX_LINE_BYTES, REPORT, OrderReports, id_of, wants_reports
from skygcs.rpc.models import SubscribeParams
from skygcs.rpc.replies import error_reply, key_twice, parse_request, unread
from skygcs.rpc.slices import Slices
from skygcs.rpc.subscriptions import Feeds, Subscription

MAX_SESSIONS = 64
"""A fleet has a few dashboards and scripts; each open socket costs a file descriptor of the usual 1024."""

MAX_RESERVE = 128
"""Connections beyond. More than the system hands over at one wake-up (a backlog of 100), so that a flood of connections
does not put one out before what it sent with its connection was read."""

RESERVE_S = 2.0
"""Time for the one request of a connection beyond the places; skygcs-cli sends it at once."""

MAX_UNAUTHENTICATED = 128
"""Most clients without the token, the same as MAX_RESERVE: they neither use up the places of others nor keep them
out."""

IDLE_S = 10.0
"""A session without requests for so long, and without subscriptions, may be closed for another. A dashboard asks once a
second or subscribes."""

AMPLE_SHARE = 0.9
"""Share of the places below which an event reports that there are free ones again."""

TURN_S = 0.002
"""All clients' requests together may use the loop this long before routing and everything else get their turn."""

ANSWERED_S = 0.2
"""At the daemon's end: a request that waits for more than orders that have ended has no answer."""

LINGER_S = 5.0

MAX_LINGERING = 64
"""Longest time and largest number of closed connections whose last answer has not been read."""

EVENT_QUIET_S = 10.0
"""At most one report of full places in this time."""

MAX_WITHOUT_CLIENT = 256
"""Orders that end a flight and go on without their client; further ones end with their client. A client that connects,
orders and leaves in a loop must not grow the daemon's memory."""

MAX_LINE_BEFORE_AUTH_BYTES = 4096

AUTH_TIMEOUT_S = 5.0
"""A TCP client that has not sent its token by then is closed."""

MAX_BATCH = 128

MAX_IN_FLIGHT = 64
"""Requests that one client waits for at the same time. Their orders to single vehicles have a bound of their own
(`rpc.work_gate`)."""

MAX_SUBSCRIPTIONS = 32

_log = structlog.get_logger(__name__)


class Session(ClientPeer):
    """A connection. ``token`` is None where the socket's mode is the protection, or TLS; there ``admits`` has the last
    word on a new connection's transport."""

    def __init__(
        self, hub: Sessions, token: str | None, admits: Callable[[asyncio.Transport], bool] | None = None
    ) -> None:
        super().__init__(hub.counters)
        self.services = hub.services
        self.slices = hub.slices
        self.reports: OrderReports | None = None
        """None: only a request that asks for them has a context with reports (`ReportingContext`)."""
        self.tasks: set[asyncio.Task[bytes]] = set()
        self.authenticated = token is None
        self.restricted = False
        """True if it came when all places were taken: one request, of those that are `always` answered."""
        self.used_at = hub.loop.time()
        """When its last whole line came."""
        self._hub = hub
        self._token = token
        self._admits = admits
        self._answered = False
        self._unread_since = 0.0
        self._in_flight = 0
        self._batch: _Batch | None = None
        """The batch of which requests have not begun; no later line is read before they have."""
        self._relays_operator = False
        self._subscriptions: dict[int, Subscription] = {}
        self._next_subscription = 1
        self._at_end: dict[object, Callable[[], None]] = {}
        self._identity, self._number = ClientIdentity(self._described_peer), 0
        self._deadline: asyncio.TimerHandle | None = None

    # -- asyncio.Protocol and ClientPeer

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        hub = self._hub
        super().connection_made(transport)
        assert self._transport is not None
        if self._admits is not None and not self._admits(self._transport):
            self._transport.abort()
            self._transport = None
            return
        hub.counters["connections"] += 1
        self._number = hub.counters["connections"]
        hub.admit(self)
        if not self.authenticated:
            self.close_after(AUTH_TIMEOUT_S)

    def received(self) -> None:
        self._hub.turns.add(self)

    def too_long(self) -> None:
        if not self.authenticated:
            self._hang_up()

    def pause_writing(self) -> None:
        self.writable = False
        self._unread_since = self._hub.loop.time()

    def resume_writing(self) -> None:
        self.writable = True
        for subscription in list(self._subscriptions.values()):
            subscription.flush()
        self._hub.feeds.resume()
        self._hub.turns.add(self)

    # -- the session as methods see it (Context) and as subscriptions see it (Sink)

    @property
    def client(self) -> ClientIdentity:
        return self._identity

    def _described_peer(self) -> str:
        return f"client {self._number} ({self.peer})" if self.peer else f"client {self._number}"

    def subscribe(self, params: SubscribeParams) -> int:
        if len(self._subscriptions) >= MAX_SUBSCRIPTIONS:
            raise LimitExceeded(f"at most {MAX_SUBSCRIPTIONS} subscriptions per client; unsubscribe some")
        number = self._next_subscription
        self._subscriptions[number] = self._hub.feeds.add(self, number, params)
        self._next_subscription += 1
        return number

    def unsubscribe(self, number: int) -> None:
        subscription = self._subscriptions.pop(number, None)
        if subscription is None:
            have = ", ".join(map(str, self._subscriptions)) or "none"
            raise InvalidParams(("subscription", f"this client has no subscription {number}; it has: {have}"))
        self._hub.feeds.remove(subscription)

    async def described(self, describe: Callable[[tuple[Method[Context], ...]], Encoded]) -> Encoded:
        return await self._hub.dispatcher.described(describe)

    def relay_operator(self) -> None:
        """Its requests come from a program on behalf of a person who may have left: they do not count as input."""
        self._relays_operator = True

    def at_end(self, action: Callable[[], None]) -> Callable[[], None]:
        key = object()
        if self._transport is None:  # it left while its request was being answered
            self._hub.loop.call_soon(action)
        else:
            self._at_end[key] = action

        def take_back() -> None:
            self._at_end.pop(key, None)

        return take_back

    def close(self) -> None:
        """Close; what was written still goes out, unless the client does not read."""
        if self._transport is not None:
            if self.writable:
                self._hub.close_in_time(self._transport)
            else:
                self._transport.abort()
        self.end()

    # -- its place (Sessions)

    @property
    def busy(self) -> bool:
        """True if it waits for the outcome of a request."""
        return bool(self.tasks) or self._batch is not None

    def idle_s(self, now: float) -> float:
        """How long it has sent no request, or not read what it subscribed to; 0 while it does."""
        if self.busy:
            return 0.0
        if self._subscriptions:
            return now - self._unread_since if not self.writable else 0.0
        return now - self.used_at

    def close_after(self, seconds: float) -> None:
        """Close it after this time, unless `keep` is called or a request of it is being answered."""
        if self._deadline is not None:
            self._deadline.cancel()
        self._deadline = self._hub.loop.call_later(seconds, self._on_deadline)

    def keep(self) -> None:
        """Cancel `close_after`."""
        if self._deadline is not None:
            self._deadline.cancel()

    def dismiss(self, reason: str) -> None:
        """Close it with an error that gives the reason."""
        if self.writable:
            self.reply(error_reply(None, error_codes.LIMIT_EXCEEDED, reason))
        self.close()

    @property
    def is_local(self) -> bool:
        """True if it came by the Unix socket."""
        return self.socket is not None and self.socket.family == socket.AF_UNIX

    @property
    def is_of_the_last(self) -> bool:
        """True if it has one of the last descriptors."""
        return self.socket is not None and is_of_the_last(self.socket.fileno())

    def _on_deadline(self) -> None:
        if not self.busy:
            self.close()

    # -- lines

    def work(self) -> bool:
        """Process one complete line, or one request of a batch; True if there may be another one."""
        if self._hub.services.fleet.sleep.check():  # all are closed: lines of before a standstill are not carried out
            return False
        if self._batch is not None:
            self._go_on_with(self._batch)
            return self._transport is not None
        limit_bytes = MAX_LINE_BYTES if self.authenticated else MAX_LINE_BEFORE_AUTH_BYTES
        if not self.writable or self._answered or (line := self.next_line(limit_bytes)) is None:
            self.pace_reading(wait=self._answered)
            self._close_if_idle()
            return False
        self.used_at = self._hub.loop.time()
        reply = self._answer_to(line)
        if isinstance(reply, bytes):
            self.reply(reply)
        elif reply is not None:
            self._answer_later(self._hub.loop.create_task(reply, name="rpc request"), self.reply)
        return self._transport is not None

    def hold_back(self) -> None:
        """Stop reading until the received lines are processed."""
        self.pace_reading(wait=True)

    def _answer_to(self, line: bytes) -> dispatch.Reply:
        """Parse a line and begin what it asks for; None where it is answered already, or not at all."""
        self._hub.counters["lines"] += 1
        try:
            request = parse_request(line)
        except ValueError as error:
            self._hub.counters["parse_errors"] += 1
            self.reply(error_reply(None, *unread(error)))
            if not self.authenticated:
                self._hang_up()
            return None
        twice = functools.cache(functools.partial(key_twice, line))  # once for a batch
        if not self.authenticated:
            self._authenticate(request)
        elif not self._refused_for_now(request):
            return self._on_batch(request, twice) if type(request) is list else self._start(request, twice)
        return None

    def _refused_for_now(self, request: object) -> bool:
        """True if this is not answered since all places are taken. A connection beyond them has one request."""
        if not self.restricted or self._hub.promote(self):
            return False
        self._answered = True
        method = request.get("method") if isinstance(request, dict) else None
        if isinstance(method, str) and method in self._hub.dispatcher.always:
            return False
        self._hub.counters["requests_refused"] += 1
        answered = ", ".join(sorted(self._hub.dispatcher.always))
        text = f"too many clients: {self._hub.why_restricted()}; one request for {answered}"
        self.reply(error_reply(id_of(request), error_codes.LIMIT_EXCEEDED, f"{text} is answered all the same"))
        return True

    def _start(self, request: object, twice: Callable[[], str | None]) -> dispatch.Reply:
        """Begin one request, unless the client already waits for too many."""
        if self._in_flight >= MAX_IN_FLIGHT:
            text = f"{MAX_IN_FLIGHT} requests of this client are not finished yet"
            return error_reply(id_of(request), error_codes.LIMIT_EXCEEDED, text)
        if not self._relays_operator and not _is_relay(request):
            self._hub.services.operator_watchdog.on_client()
        context: Context = self
        if isinstance(request, dict) and REPORT in request and (asked := wants_reports(request)) is not None:
            context = ReportingContext(self, asked)
        reply = self._hub.dispatcher.start(context, request, twice, self._admission)
        if isinstance(reply, Coroutine):
            self._in_flight += 1
            self.slices.order_came()
            if self._hub.dispatcher.outlives_client(request):
                return self._hub.outlive(reply)
        return reply

    def _admission(self, request: Mapping[str, Any]) -> bytes | None:
        """The refusal of a request that came too late, or comes while the daemon shuts down; None: carry it out."""
        if self._hub.services.stopping and request["method"] not in self._hub.dispatcher.while_stopping:
            text = "skygcs is shutting down: it takes no further orders but those that end a flight"
            return error_reply(request.get("id"), error_codes.REFUSED, text)
        if "deadline_s" not in request:
            return None
        refusal = dispatch.deadline_refusal(request, self._hub.services.now())
        if refusal is not None:
            self._hub.counters["requests_late"] += 1
        return refusal

    def _on_batch(self, requests: list[Any], twice: Callable[[], str | None]) -> bytes | None:
        if not requests:
            return error_reply(None, error_codes.INVALID_REQUEST, "a batch is not empty")
        if len(requests) > MAX_BATCH:
            text = f"a batch has at most {MAX_BATCH} requests, this one {len(requests)}"
            return error_reply(None, error_codes.LIMIT_EXCEEDED, text)
        self._batch = _Batch(deque(requests), twice)
        return None

    def _go_on_with(self, batch: _Batch) -> None:
        """Begin the next request of a batch."""
        request, most = batch.requests.popleft(), client_peer.MAX_OUTPUT_BYTES // 2
        method = request.get("method") if isinstance(request, dict) else None
        if batch.size > most and method in batch.large:
            reply: dispatch.Reply = b"" if "id" in request else None
        else:
            reply = self._start(request, batch.twice)
        if isinstance(reply, Coroutine):
            batch.waits += 1
            task = self._hub.loop.create_task(reply, name="rpc request")
            self._answer_later(task, functools.partial(self._on_reply_of, batch, len(batch.replies)))
            reply = None
        elif reply is not None:
            batch.size += len(reply)
            if len(reply) > most // MAX_BATCH and isinstance(method, str):
                batch.large.add(method)
            if batch.size > most:
                text = f"the replies of this batch exceed {most} bytes"
                reply = error_reply(id_of(request), error_codes.LIMIT_EXCEEDED, text)
        batch.replies.append(reply or b"")
        if not batch.requests:
            self._batch = None
        self._answer(batch)

    def _on_reply_of(self, batch: _Batch, place: int, reply: bytes) -> None:
        batch.waits -= 1
        batch.replies[place] = reply
        self._answer(batch)

    def _answer(self, batch: _Batch) -> None:
        """Answer a batch once all its requests are; with nothing if all of them were notifications."""
        if not batch.requests and not batch.waits and (wanted := [reply for reply in batch.replies if reply]):
            self.reply(b"[" + b",".join(wanted) + b"]")

    def _answer_later(self, task: asyncio.Task[bytes], on_reply: Callable[[bytes], None]) -> None:
        """Answer when the task of a request is done, which ends with the client at the latest.

        What a task of the hub does (`Sessions.outlive`) is only waited for here.
        """

        def on_done(task: asyncio.Task[bytes]) -> None:
            self.tasks.discard(task)
            self._in_flight -= 1
            if (work := task.get_coro()) is not None:
                work.close()  # that of a task that was cancelled before it began
            if task.cancelled():
                pass
            elif (error := task.exception()) is not None:
                _log.error("rpc request failed", exc_info=error)
            else:
                on_reply(task.result())
            self._close_if_idle()

        self.tasks.add(task)
        task.add_done_callback(on_done)

    # -- TCP

    def _authenticate(self, request: object) -> None:
        """The first request, and the only one a client without the token gets: auth {"token": …}."""
        request_id = request.get("id") if isinstance(request, dict) else None
        token = None
        if isinstance(request, dict) and request.get("method") == "auth" and isinstance(request.get("params"), dict):
            token = request["params"].get("token")
        given = token.encode() if isinstance(token, str) else b""
        assert self._token is not None
        if not isinstance(request_id, str | int | None) or not hmac.compare_digest(given, self._token.encode()):
            self._hub.counters["auth_failures"] += 1
            text = "the token is wrong" if given else 'a token is required; the first request is: auth {"token": "…"}'
            self.reply(error_reply(None, error_codes.NOT_AUTHENTICATED, text))
            self._hang_up()
            return
        self.authenticated = True
        self.keep()
        self.reply(dispatch.result_reply(request_id, "auth", {"ok": True}))
        self._hub.admit(self)

    def _hang_up(self) -> None:
        """Close after what was written has gone out."""
        if self._transport is not None:
            self._hub.close_in_time(self._transport)
        self.end()

    # -- the end

    def _close_if_idle(self) -> None:
        """After the client's end of file, or its one request: close once nothing is left to send."""
        if self._transport is None or self.tasks or self._batch is not None:
            return
        if self._answered or (self._eof and not (self._subscriptions or self._lines)):
            self._hang_up()

    def end(self) -> None:
        """Forget everything of this client. Its waiting calls are cancelled, except those that outlive it."""
        self._transport = None
        self.writable = False
        self._identity.leave()
        self._hub.remove(self)
        self.keep()
        subscriptions, self._subscriptions = self._subscriptions, {}
        for subscription in subscriptions.values():
            self._hub.feeds.remove(subscription)
        actions, self._at_end = self._at_end, {}
        for action in actions.values():
            try:
                action()
            except Exception as error:
                _log.error("an action at a client's end failed", exc_info=error)
        for task in self.tasks:
            task.cancel()
        self._batch = None
        self._lines.clear()


def _is_relay(request: object) -> bool:
    """True for operator.relay, which is the first request of its connection and does not count as input either."""
    return isinstance(request, dict) and request.get("method") == RELAY


@dataclass(slots=True)
class _Batch:
    """A batch that is worked on: one request of it in a turn, as of the lines. ``large``: methods that read much, so
    no orders: where their replies do not fit, they are not worked out any more."""

    requests: deque[Any]
    """Those that have not begun."""
    twice: Callable[[], str | None]
    replies: list[bytes] = field(default_factory=list)
    waits: int = 0
    """Requests that have begun, and are not answered."""
    size: int = 0
    large: set[str] = field(default_factory=set)


class Turns:
    """Sessions with lines to process: one line, or one request of a batch, of each in turn, those beyond the places
    first, TURN_S at a time, and half of the time at most while control ticks are due (`Slices.rest_s`); a session
    whose line took long leaves its turns to the others for a while (`Slices.own_rest_s`)."""

    def __init__(self, loop: asyncio.AbstractEventLoop, slices: Slices) -> None:
        self._loop = loop
        self._slices = slices
        self._rests_until = 0.0
        self._waiting: deque[Session] = deque()
        self._queued: set[Session] = set()
        self._due = False

    def add(self, session: Session) -> None:
        """Something has come on this session, or it takes replies again."""
        if session not in self._queued:
            self._queued.add(session)
            if session.restricted:
                self._waiting.appendleft(session)
            else:
                self._waiting.append(session)
        if not self._due:
            self._run_later()

    def _run_later(self) -> None:
        self._due = True
        rest_s = self._rests_until - self._slices.now()
        if rest_s > 0.0:
            self._loop.call_later(rest_s, self._run)
        else:
            self._loop.call_soon(self._run)

    def _run(self) -> None:
        self._due = False
        began = now = self._slices.now()
        waiting = self._waiting
        while waiting:
            session = waiting.popleft()
            more = False
            try:
                more = session.work()
            except Exception as error:  # an internal fault ends only the session whose line caused it
                _log.error("rpc session failed", exc_info=error)
                session.close()
            before, now = now, self._slices.now()
            if not more:
                self._queued.discard(session)
            elif rest_s := self._slices.own_rest_s(now - before):
                session.hold_back()
                self._loop.call_later(rest_s, self._go_on_with, session)
            else:
                waiting.append(session)
            if now - began > TURN_S:
                break
        self._rests_until = now + self._slices.rest_s(now - began)
        if waiting:
            for session in waiting:
                session.hold_back()
            self._run_later()

    def _go_on_with(self, session: Session) -> None:
        self._queued.discard(session)
        self.add(session)


class Sessions:
    """State that all sessions share."""

    def __init__(self, services: Services, dispatcher: Dispatcher[Context], loop: asyncio.AbstractEventLoop) -> None:
        self.services = services
        self.dispatcher = dispatcher
        self.loop = loop
        self.slices = Slices(loop, services.fleet.next_control_tick)
        self.feeds = Feeds(services, loop, self.slices)
        self.turns = Turns(loop, self.slices)
        self.counters: Counter[str] = Counter()
        self.lasting: set[asyncio.Task[bytes]] = set()
        """Orders that end a flight: they belong to no session, so that no session's end ends them."""
        # in the order in which they came
        self._placed: dict[Session, None] = {}
        self._reserve: dict[Session, None] = {}
        self._unauthenticated: dict[Session, None] = {}
        self._lingering: deque[asyncio.Transport] = deque()
        self._full_at: int | None = None
        """How many had a place when it was reported that there are no more; None: there are."""
        self._reported_at = float("-inf")

    # -- places

    @property
    def sessions(self) -> list[Session]:
        """All open sessions."""
        return [*self._placed, *self._reserve, *self._unauthenticated]

    def admit(self, session: Session) -> None:
        """Give a new connection its place, or one that has shown its token."""
        self._unauthenticated.pop(session, None)
        if not session.authenticated:
            if len(self._unauthenticated) >= MAX_UNAUTHENTICATED:
                self._dismiss(
                    next(iter(self._unauthenticated)), "connections_refused", "too many clients without a token"
                )
            self._unauthenticated[session] = None
        elif session.is_of_the_last and not session.is_local:
            self._reserve[session] = None
            self._dismiss(session, "connections_refused", "no descriptors are left for clients of other computers")
        elif self._has_place_for(session):
            self._placed[session] = None
            self._look_for_free()
        else:
            self._let_in_beyond(session)

    def promote(self, session: Session) -> bool:
        """True if a connection beyond the places has one now."""
        if not self._has_place_for(session):
            return False
        del self._reserve[session]
        self._placed[session] = None
        session.restricted = False
        session.keep()
        return True

    def remove(self, session: Session) -> None:
        """Forget a session that has ended. Idempotent."""
        for group in (self._placed, self._reserve, self._unauthenticated):
            group.pop(session, None)
        self._look_for_free()

    def close_in_time(self, transport: asyncio.Transport) -> None:
        """Close it once what was written is read, or after LINGER_S."""
        transport.close()
        if transport.get_write_buffer_size():
            self._lingering.append(transport)
            self.loop.call_later(LINGER_S, self._end_lingering, transport)
            if len(self._lingering) > MAX_LINGERING:
                self._end_lingering(self._lingering[0])

    def _end_lingering(self, transport: asyncio.Transport) -> None:
        if transport in self._lingering:
            self._lingering.remove(transport)
            transport.abort()

    def why_restricted(self) -> str:
        """Reason for a client that came when there was no place for it."""
        if len(self._placed) >= MAX_SESSIONS:
            return f"all {MAX_SESSIONS} places are taken"
        return f"the process has no more file descriptors for clients (ulimit -n), with {len(self._placed)} connected"

    def _look_for_free(self) -> None:
        """Report once that there are places again: several clients have left, or, where descriptors had run out, more
        have a place than then. One client fewer does not count: it may have been closed for a newer one."""
        full_at, placed = self._full_at, len(self._placed)
        if full_at is not None and not AMPLE_SHARE * full_at - 1 <= placed <= full_at:
            self._full_at = None
            text = "clients: sessions are free again"
            self.services.event_log.publish(Event("warning", None, None, text, {"change": "not_full"}))

    def _has_place_for(self, session: Session) -> bool:
        """True if it may stay beside the others, of whom the one that was idle for longest may be closed for it."""
        return (len(self._placed) < MAX_SESSIONS and not session.is_of_the_last) or self._close_idle()

    def _close_idle(self) -> bool:
        """True if a place was made free by closing the session that was idle for longest."""
        now = self.loop.time()
        idle = max(self._placed, key=lambda session: session.idle_s(now), default=None)
        if idle is None or idle.idle_s(now) < IDLE_S:
            return False
        reason = f"closed: idle for {idle.idle_s(now):.0f} s, and {self.why_restricted()}"
        self._dismiss(idle, "closed_idle", reason)
        return True

    def _let_in_beyond(self, session: Session) -> None:
        now = self.loop.time()
        if self._full_at is None and now - self._reported_at >= EVENT_QUIET_S:
            self._full_at = len(self._placed)
            self._reported_at = now
            text = (
                f"clients: {self.why_restricted()}{self._holders()}; further ones may only stop, hold, land, return "
                "and disarm vehicles and read their state; close some"
            )
            data = {"change": "full", "places": MAX_SESSIONS}
            self.services.event_log.publish(Event("warning", None, None, text, data))
        self.counters["connections_restricted"] += 1
        if len(self._reserve) >= MAX_RESERVE or session.is_of_the_last:
            silent = next((other for other in self._reserve if not other.busy), None)
            if silent is None and len(self._reserve) < MAX_RESERVE:
                pass
            elif silent is None:
                self._reserve[session] = None
                self._dismiss(session, "connections_refused", f"too many clients ({self._number()})")
                return
            else:
                self._dismiss(silent, "connections_refused", f"too many clients ({self._number()})")
        self._reserve[session] = None
        session.restricted = True
        session.close_after(RESERVE_S)

    def _dismiss(self, session: Session, counter: str, reason: str) -> None:
        self.counters[counter] += 1
        session.dismiss(reason)

    def _holders(self) -> str:
        """The processes that hold most places, as the end of a clause."""
        pids = Counter(found.pid for session in self._placed if (found := session.credentials) is not None)
        held = [f"{number} by process {pid}" for pid, number in pids.most_common(3)]
        return "".join(f", {part}" for part in held or (["by TCP clients"] if self._placed else []))

    def _number(self) -> int:
        return len(self._placed) + len(self._reserve) + len(self._unauthenticated)

    # -- orders that outlive their clients

    def outlive(self, work: Coroutine[Any, Any, bytes]) -> Coroutine[Any, Any, bytes]:
        """Begin ``work`` at once, independent of the client; awaiting the returned coroutine gives its reply."""
        if len(self.lasting) >= MAX_WITHOUT_CLIENT:
            return work
        task = self.loop.create_task(work, name="rpc order")
        self.lasting.add(task)
        task.add_done_callback(self.lasting.discard)

        async def reply() -> bytes:
            return await asyncio.shield(task)

        return reply()

    def stats(self) -> JsonObject:
        """JSON-able counters."""
        return {
            "sessions": len(self._placed),
            "restricted": len(self._reserve),
            "unauthenticated": len(self._unauthenticated),
            **self.counters,
            **self.dispatcher.gate.stats(),
        }

    async def close(self) -> None:
        """End every session, and what outlives them; wait for all of it. Orders that the daemon's end has ended are
        answered before."""
        sessions = self.sessions
        tasks: list[asyncio.Task[Any]] = [task for session in sessions for task in session.tasks]
        if tasks:
            await asyncio.wait(tasks, timeout=ANSWERED_S)
        tasks += self.lasting
        for session in sessions:
            session.close()
        for task in list(self.lasting):
            task.cancel()
        self.feeds.close()
        await asyncio.gather(*tasks, return_exceptions=True)
