"""The connection to the hub: made again without end, with bounded queues, and exact about which requests were sent.

    away         a server of the list answers and accepts the key     -> connected; every subscription is made anew
    connected    it is closed, or has not answered for SILENT_AFTER_S -> away; open requests end with ReplyLost
    away         FIRST_PAUSE_S, doubling to LONGEST_PAUSE_S           -> the next server of the list

Each connection is a new client of nats-py. The reconnecting of nats-py is not used, because it keeps messages that are
published while the hub is away and sends them later, but an order must never arrive late. Nothing is kept here: a
message that cannot be sent now is refused (`request`) or dropped and counted (`publish`).

A hub that does not use TLS although its address begins with tls:// gets no signature: an attacker on the way could use
the signature to act as this station at the real hub.
"""

from __future__ import annotations

import asyncio
import contextlib
import itertools
import logging
import os
import random
import re
import ssl
from collections.abc import Awaitable, Callable, Iterator
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import nats.errors
import nats.js.errors
from nats.aio.client import Client as NatsClient

from skygcs.back_off import BackOff
from skygcs.cancellation import end_if_cancelled
from skygcs.errors import BusError, HubAway, NobodyThere, NotPermitted, ReplyLost
from skygcs.events import Event
from skygcs.ext.federation.bridge.hub_config import INBOX, MAX_PAYLOAD_BYTES, ORDERS, STOPS
from skygcs.ext.federation.config import server_address
from skygcs.ext.federation.protocol.fair_share import FairShare
from skygcs.ext.federation.server_program import version_warning

if TYPE_CHECKING:
    from nats.aio.msg import Msg
    from nats.aio.subscription import Subscription as NatsSubscription
    from nats.js.client import JetStreamContext
    from nats.js.kv import KeyValue
    from nats.js.object_store import ObjectStore

CONNECT_WITHIN_S = 2.0
"""Time limit of a connection: TCP, TLS and the key's signature, between continents and on a busy computer."""

FIRST_PAUSE_S, LONGEST_PAUSE_S = 0.1, 0.5
"""Pauses between attempts to connect, doubling; up to a quarter is left off at random so that stations do not all
connect at once. A hub that is back is found within LONGEST_PAUSE_S, a restored network within two seconds."""

PING_EVERY_S = 0.5
"""Period of the pings to the hub."""

SILENT_AFTER_S = 2.0
"""A connection without an answer for this time is given up. TCP would need minutes, and its growing pauses would delay
the use of a network that is restored. Less than the TTL of a lease."""

STOOD_STILL_S = 0.1
"""Further wait after that limit, for an answer that arrived while this process was stopped: after a stop the loop runs
its timers before it reads its sockets."""

WRITTEN_EVERY_S = 0.001
"""Pause while nats-py writes: it has no signal for the end of that."""

MAX_DENIED = 32
"""Denied subjects that are reported for one connection; all are counted."""

MAX_REASONS = 32
"""Reasons that are reported for one time without a connection."""

CLOSE_WITHIN_S = 0.5
"""Time limit for closing a connection in order."""

MAX_PENDING_BYTES = 4 << 20
"""Bytes that the hub has not taken yet. Beyond, messages are dropped or refused: states would be outdated by then."""

MAX_WAITING_MESSAGES = 1000
"""Messages of one subscription that wait to be handled; further ones are dropped and counted."""

MAX_REQUESTS = 2048
"""Requests in progress: an emergency stop for a thousand vehicles, and the questions for their outcomes."""

SHARE_FACTOR = 4.0
"""How many times the free places the requests of one station may have: four of five if it is alone."""

MAX_ANSWERING = 80
"""Default number of requests that one `serve` answers at the same time, 64 of one station."""

SIGNED = (ORDERS, STOPS)
"""Subjects that end with the public key of the station that sends."""

_DENIED = re.compile(r'permissions violation for (publish|subscription) to "([^"]{1,256})"', re.IGNORECASE)

OnMessage = Callable[["Message"], None]
OnRequest = Callable[["Message"], Awaitable[bytes | None]]


@dataclass(frozen=True, slots=True)
class Message:
    """A received message. ``sender``: for an order, the public key of the station that sent it. The key is the last
    token of the subject on the hub, which permits each station its own key only; "" for other messages."""

    subject: str
    data: bytes
    sender: str = ""


@dataclass(slots=True)
class BusCounters:
    """Counts since the process began."""

    connections: int = 0
    sent: int = 0
    received: int = 0
    not_sent: int = 0
    """Messages dropped because the hub was away or took nothing."""
    dropped: int = 0
    """Received messages dropped because they came faster than they were handled."""
    too_long: int = 0
    """Received messages dropped because of their length."""
    denied: int = 0
    """Errors of the hub: it does not permit the subject to this station."""
    busy: int = 0
    """Requests not answered because the limit of `Bus.serve` was reached."""
    bad_reply_to: int = 0
    """Requests not answered because their reply subject is no inbox."""
    faults: int = 0
    """Messages whose handler raised an error."""


class Subscription:
    """A subscription to one subject, kept over all connections until `close`."""

    def __init__(self, bus: Bus, subject: str, on_message: Callable[[Msg], None]) -> None:
        self.subject = subject
        self._bus = bus
        self._on_message = on_message
        self._client: NatsClient | None = None
        self._made: NatsSubscription | None = None

    async def attach(self, client: NatsClient) -> None:
        """Subscribe on this connection. Idempotent."""
        if self._client is client:
            return
        self._client = client

        async def on_message(message: Msg) -> None:
            self._on_message(message)

        self._made = await client.subscribe(
            self.subject,
            cb=on_message,
            pending_msgs_limit=MAX_WAITING_MESSAGES,
            pending_bytes_limit=8 * MAX_PAYLOAD_BYTES,
        )

    async def close(self) -> None:
        """End the subscription: no further messages. Idempotent."""
        self._bus.forget(self)
        made, self._made = self._made, None
        if made is not None and self._client is not None and self._client.is_connected:
            with contextlib.suppress(nats.errors.Error):
                await made.unsubscribe()


def _is_no_eof_notice(record: logging.LogRecord) -> bool:
    """False for asyncio's notice at the end of each TLS connection whose reader is a stream, as that of nats-py is."""
    return "eof_received() has no effect" not in record.getMessage()


class _Client(NatsClient):
    """A client of nats-py that, if ``needs_tls``, signs nothing on a connection without TLS.

    nats-py itself begins TLS only if the hub's first line requires it, even for an address with tls://.
    """

    needs_tls = False
    checked = False
    failure: Exception | None = None
    """Why the server could not be reached: the error that `connect` raises does not contain it."""

    def _connect_command(self) -> bytes:
        if self.needs_tls and not self._server_info.get("tls_required"):
            raise nats.errors.SecureConnWantedError
        self.checked = True
        return bytes(super()._connect_command())


@dataclass(frozen=True, slots=True)
class BusOptions:
    """The hub's addresses and this station's identity there."""

    servers: tuple[str, ...]
    seed: str = field(repr=False)
    """Secret seed of the station's key."""
    public_key: str = ""
    tls: ssl.SSLContext | None = None
    name: str = "skygcs"
    """Name of the connection in the hub's monitoring."""


class Bus:
    """The connection to the hub. Run `run` in a task. ``connected`` and ``text`` are its state since ``since`` (the
    loop's clock)."""

    def __init__(self, options: BusOptions, loop: asyncio.AbstractEventLoop, report: Callable[[Event], None]) -> None:
        self.options = options
        self.counters = BusCounters()
        # status of the connection
        self.connected = False
        self.text = "not connected yet"
        self.since = loop.time()
        self.server = ""
        """Address of the present or last connection."""
        self.server_info: dict[str, Any] = {}
        """The hub's information about itself: server_id, version, …"""
        self.round_trip_s: float | None = None
        # the client and its subscriptions
        self._loop = loop
        self._report = report
        self._client: _Client | None = None
        self._lost: asyncio.Future[str] | None = None
        self._subscriptions: list[Subscription] = []
        self._requests: dict[str, set[asyncio.Future[None]]] = {}
        """Requests in progress, by subject in lower case, as nats-py returns the server's errors. The future is set
        when the hub denies the subject."""
        self._open_requests = 0
        # tasks in progress
        self._answering: set[asyncio.Task[None]] = set()
        self._pings: set[asyncio.Task[float]] = set()
        self._observers: list[Callable[[], None]] = []
        # problems that were reported already
        self._reasons: set[str] = set()
        """Reasons for having no connection that were reported since the last connection."""
        self._why = ""
        self._denied: set[str] = set()
        """Subjects that were reported as denied on this connection."""
        self._version = ""
        """Last warning about the server's version."""

    # -- sending

    async def publish(self, subject: str, data: bytes) -> bool:
        """Send a message now; False if it was dropped (and counted) because the hub is away or takes too little. Never
        waits. Raises BusError for a message that is longer than the hub accepts."""
        client = self._client
        if len(data) > self._longest(client):
            raise BusError(subject, f"{len(data)} bytes are more than the {self._longest(client)} that the hub takes")
        if client is None or not self.connected or client.pending_data_size > MAX_PENDING_BYTES:
            self.counters.not_sent += 1
            return False
        try:
            await client.publish(subject, data)
        except nats.errors.Error:
            self.counters.not_sent += 1
            return False
        self.counters.sent += 1
        return True

    async def request(self, subject: str, data: bytes, timeout_s: float) -> bytes:
        """Send a request and return the answer. Raises HubAway, NobodyThere and NotPermitted if the request was
        certainly not delivered, and ReplyLost if that is unknown."""
        client, lost = self._client, self._lost
        if client is None or lost is None or not self.connected:
            raise HubAway(subject, f"not sent: {self.text}")
        if len(data) > self._longest(client):
            raise BusError(subject, f"{len(data)} bytes are more than the {self._longest(client)} that the hub takes")
        if self._open_requests >= MAX_REQUESTS or client.pending_data_size > MAX_PENDING_BYTES:
            raise HubAway(subject, "not sent: too many requests wait for the hub")
        to = f"{subject}.{self.options.public_key}" if subject.startswith(SIGNED) else subject
        denied: asyncio.Future[None] = self._loop.create_future()
        self._requests.setdefault(to.lower(), set()).add(denied)
        self._open_requests += 1
        asked = self._loop.create_task(client.request(to, data, timeout=timeout_s), name=f"request {subject}")
        try:
            self.counters.sent += 1
            waited: set[asyncio.Future[Any]] = {asked, denied, lost}
            await asyncio.wait(waited, return_when=asyncio.FIRST_COMPLETED)
            return self._answer(subject, asked, denied, lost, timeout_s)
        finally:
            self._open_requests -= 1
            others = self._requests[to.lower()]
            others.discard(denied)
            if not others:
                del self._requests[to.lower()]
            asked.cancel()
            await asyncio.gather(asked, return_exceptions=True)

    def _answer(
        self,
        subject: str,
        asked: asyncio.Task[Msg],
        denied: asyncio.Future[None],
        lost: asyncio.Future[str],
        timeout_s: float,
    ) -> bytes:
        if asked.done():
            try:
                data = bytes(asked.result().data)
            except nats.errors.NoRespondersError:
                raise NobodyThere(subject, "nobody takes messages of this subject now") from None
            except nats.errors.TimeoutError:
                raise ReplyLost(subject, f"no answer within {timeout_s:g} s") from None
            except (nats.errors.ConnectionClosedError, nats.errors.OutboundBufferLimitError) as error:
                raise HubAway(subject, f"not sent: {error}") from None
            except (nats.errors.Error, OSError) as error:
                raise ReplyLost(subject, str(error)) from None
            self.counters.received += 1
            return data
        if denied.done():
            raise NotPermitted(subject, "the hub does not permit this station to send it")
        raise ReplyLost(subject, f"the connection was lost before an answer came ({lost.result()})")

    def _longest(self, client: _Client | None) -> int:
        return MAX_PAYLOAD_BYTES if client is None else min(client.max_payload, MAX_PAYLOAD_BYTES)

    # -- receiving

    async def subscribe(self, subject: str, on_message: OnMessage) -> Subscription:
        """Call ``on_message`` for each message of the subject, over all connections, until the subscription is closed.
        It must not block; an error that it raises is counted and reported here."""

        def received(message: Msg) -> None:
            if self._takes(message):
                self._guarded(subject, lambda: on_message(_read(message)))

        return await self._subscribed(subject, received)

    async def serve(
        self,
        subject: str,
        on_request: OnRequest,
        *,
        at_once: int = MAX_ANSWERING,
        reserved: int = 0,
        is_urgent: Callable[[bytes], bool] = lambda _: False,
    ) -> Subscription:
        """Like `subscribe`, for requests: the result of ``on_request`` is the answer; None: no answer, since another
        station answers. At most ``at_once`` run at the same time, and ``reserved`` more whose payload ``is_urgent``,
        shared among the stations that send them; further requests are counted and not answered."""
        usual, urgent = FairShare(at_once, SHARE_FACTOR), FairShare(reserved)

        def received(message: Msg) -> None:
            if not self._takes(message):
                return
            if not message.reply.startswith(INBOX):  # this station would publish where the sender may not
                self.counters.bad_reply_to += 1
                return
            sender = _read(message).sender
            places = usual
            if not usual.has_room(sender):
                if not urgent.has_room(sender) or not is_urgent(message.data):
                    self.counters.busy += 1
                    return
                places = urgent
            places.take(sender)
            task = self._loop.create_task(self._respond(message, on_request), name=f"answer {subject}")
            self._answering.add(task)
            task.add_done_callback(self._answering.discard)
            task.add_done_callback(lambda _: places.give_back(sender))

        return await self._subscribed(subject, received)

    async def _respond(self, message: Msg, on_request: OnRequest) -> None:
        try:
            answer = await on_request(_read(message))
        except Exception as error:
            self._fault(message.subject, error)
            return
        if answer is None:
            return
        with contextlib.suppress(BusError):  # too long: the sender of the request gets no answer
            await self.publish(message.reply, answer)

    async def _subscribed(self, subject: str, received: Callable[[Msg], None]) -> Subscription:
        made = Subscription(self, f"{subject}.*" if subject.startswith(SIGNED) else subject, received)
        self._subscriptions.append(made)
        if self._client is not None:
            with contextlib.suppress(nats.errors.Error):  # the connection ends: made on the next one
                await made.attach(self._client)
                await self._settled(self._client)
        return made

    def forget(self, subscription: Subscription) -> None:
        """Remove a subscription; called by `Subscription.close` only."""
        with contextlib.suppress(ValueError):
            self._subscriptions.remove(subscription)

    def _takes(self, message: Msg) -> bool:
        self.counters.received += 1
        if len(message.data) > MAX_PAYLOAD_BYTES:
            self.counters.too_long += 1
            return False
        return True

    def _guarded(self, subject: str, action: Callable[[], None]) -> None:
        try:
            action()
        except Exception as error:
            self._fault(subject, error)

    def _fault(self, subject: str, error: Exception) -> None:
        self.counters.faults += 1
        if self.counters.faults == 1 or self.counters.faults % 1000 == 0:
            text = f"federation: a message of {subject} was not handled: {type(error).__name__}: {error}"
            self._report(Event("fault", None, None, text, {"subject": subject, "faults": self.counters.faults}))

    # -- stores of the hub

    async def key_value(self, bucket: str) -> KeyValue:
        """The hub's key-value store of this name, for the present connection only. Its calls raise errors of nats-py,
        which `store_errors` translates. Raises HubAway, and BusError if the hub has no such store."""
        with store_errors(bucket):
            return await self.jetstream().key_value(bucket)

    async def object_store(self, bucket: str) -> ObjectStore:
        """Like `key_value`, for the store of files."""
        with store_errors(bucket):
            return await self.jetstream().object_store(bucket)

    def jetstream(self) -> JetStreamContext:
        """The JetStream context of the present connection. Raises HubAway."""
        if self._client is None or not self.connected:
            raise HubAway("", f"not sent: {self.text}")
        return self._client.jetstream(timeout=STORE_WITHIN_S)

    # -- life

    def on_change(self, observer: Callable[[], None]) -> None:
        """Call ``observer`` after each change of ``connected``."""
        self._observers.append(observer)

    async def run(self) -> None:
        """Keep the station connected until it is cancelled."""
        back_off = BackOff(FIRST_PAUSE_S, LONGEST_PAUSE_S)
        logging.getLogger("nats").setLevel(logging.CRITICAL)  # it logs a traceback for each message of a broken hub
        logging.getLogger("asyncio").addFilter(_is_no_eof_notice)
        try:
            for server in itertools.cycle(self.options.servers):
                if await self._connection(server):
                    back_off.reset()
                end_if_cancelled()
                await asyncio.sleep(back_off.after() * random.uniform(0.75, 1.0))
        finally:
            for task in self._answering:
                task.cancel()

    async def _connection(self, server: str) -> bool:
        """Make one connection and return when it is lost. False if none was made."""
        client = _Client()
        lost: asyncio.Future[str] = self._loop.create_future()
        was, orderly = False, True
        reason = "closed"
        try:
            await self._connect(client, server, lost)
            end_if_cancelled()  # nats-py uses `wait_for`
            self._client, self._lost, self._why = client, lost, ""
            for subscription in list(self._subscriptions):
                await subscription.attach(client)
            await self._settled(client)
            was = True
            self.server, self.server_info = server, dict(client._server_info)
            self.counters.connections += 1
            self._denied.clear()
            self._change(True, f"connected to {server}")
            self._warn_of_version()
            await self._watch(client, lost)
            reason, orderly = lost.result(), False
        except Exception as error:  # nats-py raises errors of any class if the server is no hub
            reason, orderly = _reason(error, client), False
        finally:
            self._client = self._lost = self.round_trip_s = None
            if not lost.done():
                lost.set_result(reason)
            self._change(False, f"the hub at {server}: {reason}")
            for ping in list(self._pings):
                ping.cancel()
            await _dispose(client, orderly=orderly)
        return was

    async def _connect(self, client: _Client, server: str, lost: asyncio.Future[str]) -> None:
        async def on_closed() -> None:
            if not lost.done():
                lost.set_result(self._why or "closed by the hub")

        async def on_error(error: Exception) -> None:
            client.failure = error
            self._on_error(error)

        client.needs_tls = server_address(server).tls
        async with asyncio.timeout(CONNECT_WITHIN_S):
            await client.connect(
                servers=[server],
                error_cb=on_error,
                closed_cb=on_closed,
                name=self.options.name,
                allow_reconnect=False,
                connect_timeout=CONNECT_WITHIN_S,  # type: ignore[arg-type]  # seconds, as it is passed to asyncio
                reconnect_time_wait=0,
                max_reconnect_attempts=1,
                ping_interval=3600,  # pinged here, by SILENT_AFTER_S
                tls=self.options.tls if client.needs_tls else None,
                nkeys_seed_str=self.options.seed,
                inbox_prefix=INBOX + self.options.public_key,
                pending_size=2 * MAX_PENDING_BYTES,
                flush_timeout=CLOSE_WITHIN_S,
            )
        if not client.checked:
            raise nats.errors.SecureConnFailedError

    def _ping(self, client: _Client) -> asyncio.Task[float]:
        """A task that ends with the answer to a ping. It is cancelled only with the connection: nats-py stops reading
        at the answer to a cancelled ping."""
        ping: asyncio.Task[float] = self._loop.create_task(client.rtt(timeout=3600), name="ping the hub")
        self._pings.add(ping)
        ping.add_done_callback(self._pinged)
        return ping

    def _pinged(self, ping: asyncio.Task[float]) -> None:
        self._pings.discard(ping)
        if not ping.cancelled():
            ping.exception()  # mark it as retrieved: `_watch` reports the lost connection

    async def _settled(self, client: _Client) -> None:
        """Return when the hub has processed everything sent until now, such as a new subscription."""
        lost = self._lost
        while lost is not None and client.pending_data_size and not lost.done():  # noqa: ASYNC110 - it signals nothing
            await asyncio.sleep(WRITTEN_EVERY_S)  # nats-py sends a ping past what waits to be written
        if lost is not None and not lost.done():
            waited: set[asyncio.Future[Any]] = {self._ping(client), lost}
            await asyncio.wait(waited, timeout=SILENT_AFTER_S, return_when=asyncio.FIRST_COMPLETED)

    async def _watch(self, client: _Client, lost: asyncio.Future[str]) -> None:
        """Return when the connection is lost."""
        while not lost.done():
            began = self._loop.time()
            ping = self._ping(client)
            waited: set[asyncio.Future[Any]] = {ping, lost}
            for timeout_s in (SILENT_AFTER_S, STOOD_STILL_S):
                await asyncio.wait(waited, timeout=timeout_s, return_when=asyncio.FIRST_COMPLETED)
            if not ping.done() and not lost.done():
                lost.set_result(f"has not answered for {SILENT_AFTER_S:g} s")
            elif ping.done() and not lost.done():
                self.round_trip_s = ping.result()
            await asyncio.wait({lost}, timeout=max(0.0, began + PING_EVERY_S - self._loop.time()))

    def _on_error(self, error: Exception) -> None:
        """Handle an error that nats-py reports through its callback."""
        if isinstance(error, nats.errors.SlowConsumerError):
            self.counters.dropped += 1
            return
        denied = _DENIED.search(str(error))
        if denied is None:
            self._why = str(error).removeprefix("nats: ")
            return
        verb, subject = denied.group(1).lower(), denied.group(2).lower()
        self.counters.denied += 1
        for waiting in self._requests.get(subject, ()):
            if not waiting.done():
                waiting.set_result(None)
        if subject not in self._denied and len(self._denied) < MAX_DENIED:
            self._denied.add(subject)
            what = "send" if verb == "publish" else "read"
            text = f"the hub does not permit this station to {what} {subject}: see its inventory"
            self._report(Event("federation", None, None, text, {"change": "denied", "subject": subject}))

    def _change(self, connected: bool, text: str) -> None:
        """Report every connection, and each reason for having none once, not at each attempt."""
        was, first = self.connected, not self._reasons and not self.connected
        self.connected, self.text = connected, text
        if connected:
            self._reasons.clear()
        elif text in self._reasons or len(self._reasons) >= MAX_REASONS:
            return
        else:
            self._reasons.add(text)
        if connected == was and not first:
            self._report(Event("federation", None, None, f"federation: {text}", {"change": "away"}))
            return
        down_s = self._loop.time() - self.since
        self.since = self._loop.time()
        more = f" after {down_s:.1f} s" if connected and not first else ""
        data = {"change": "connected" if connected else "away", "server": self.server}
        self._report(Event("federation", None, None, f"federation: {text}{more}", data))
        for observer in self._observers:
            self._guarded("", observer)

    def _warn_of_version(self) -> None:
        warning = version_warning(str(self.server_info.get("version")))
        if warning is not None and warning != self._version:
            self._version = warning
            self._report(Event("warning", None, None, f"the hub at {self.server}: {warning}", {"change": "version"}))

    def status(self) -> dict[str, Any]:
        """JSON-able."""
        return {
            "connected": self.connected,
            "text": self.text,
            "since_s": round(self._loop.time() - self.since, 3),
            "server": self.server or None,
            "server_id": self.server_info.get("server_id"),
            "server_version": self.server_info.get("version"),
            "round_trip_s": self.round_trip_s,
            "subscriptions": len(self._subscriptions),
            "requests": self._open_requests,
            **{name: getattr(self.counters, name) for name in BusCounters.__slots__},
        }


STORE_WITHIN_S = 1.0
"""Time limit of the hub's answer about a key or a part of a file."""


@contextlib.contextmanager
def store_errors(what: str) -> Iterator[None]:
    """Raise errors of nats-py's stores in the body as BusError, except nats.js.errors.KeyNotFoundError and
    KeyWrongLastSequenceError, which are regular answers. ``what``: name of the store, for texts."""
    try:
        yield
    except (nats.js.errors.KeyNotFoundError, nats.js.errors.KeyWrongLastSequenceError):
        raise
    except (nats.js.errors.BucketNotFoundError, nats.js.errors.NotFoundError):
        text = f"the hub has no store {what}: make it there with `skygcs federation stores`"
        raise BusError("", text) from None
    except (nats.js.errors.ServiceUnavailableError, nats.js.errors.NoStreamResponseError):
        raise NobodyThere(what, "the hub keeps no such store, or permits it to others only") from None
    except nats.errors.TimeoutError:
        text = f"no answer of the hub within {STORE_WITHIN_S:g} s: it is busy, or does not permit this to this key"
        raise ReplyLost(what, text) from None
    except (nats.errors.ConnectionClosedError, nats.errors.OutboundBufferLimitError) as error:
        raise HubAway(what, f"not sent: {error}") from None
    except nats.errors.Error as error:
        raise BusError(what, str(error).removeprefix("nats: ")) from None


def _read(message: Msg) -> Message:
    if not message.subject.startswith(SIGNED):
        return Message(message.subject, message.data)
    subject, _, sender = message.subject.rpartition(".")
    return Message(subject, message.data, sender)


def _reason(error: Exception, client: _Client) -> str:
    """Why there is no connection, and what to do about it."""
    cause = client.failure if isinstance(error, nats.errors.NoServersError) and client.failure else error
    text = str(cause).removeprefix("nats: ").strip("'")
    match cause:
        case nats.errors.SecureConnWantedError():
            return "does not speak TLS, which its address asks for: it is not the hub, or runs without its certificate"
        case nats.errors.SecureConnFailedError():
            return (
                "nats-py does not check TLS as this program expects: another version is installed than it was made for"
            )
        case ssl.SSLCertVerificationError():
            return f"its certificate is not trusted ({cause.verify_message}): see federation.ca"
        case ssl.SSLError():
            return f"TLS failed ({cause.reason or cause}): see federation.ca, cert and key"
        case TimeoutError():
            return f"no connection within {CONNECT_WITHIN_S:g} s"
        case OSError():
            known = cause.errno is not None and cause.errno > 0  # names that are not found have numbers of their own
            said = (os.strerror(cause.errno or 0) if known else cause.strerror or text).lower()
            greeted = client.needs_tls and bool(client._server_info)
            return f"TLS failed ({said}): see federation.ca, cert and key" if greeted else said
        case nats.errors.Error():
            pass
        case _:
            return f"is not a hub, or is a broken one ({type(cause).__name__}: {text})"
    if "authorization violation" in text.lower():
        return "does not accept this station's key: its public key must be in the hub's inventory"
    return text or type(cause).__name__


async def _dispose(client: NatsClient, *, orderly: bool) -> None:
    """Close a connection in any state, also one that was never made. Unless ``orderly``, data that are not written yet
    are discarded: a restored network would deliver them late."""
    writer = getattr(client._transport, "_io_writer", None)
    if not orderly and writer is not None:
        client._pending, client._pending_data_size = [], 0
        writer.transport.abort()
    with contextlib.suppress(Exception):
        async with asyncio.timeout(CLOSE_WITHIN_S):
            await client.close()
