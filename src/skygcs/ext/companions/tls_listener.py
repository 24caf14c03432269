"""The companion's door for orders: JSON-RPC over mutual TLS, with bounds on what strangers can make it do.

    a connection                    becomes
    ----------------------------    ------------------------------------------------------------------
    beyond the limits of its        closed before the handshake, counted (a handshake costs the loop 1 ms,
    address, or of all others than  control must not wait for a flood of them)
    the one the ground had last
    without the pinned certificate  closed by TLS, counted
    silent during the handshake     closed after HANDSHAKE_S
    the ground's                    a session as on the Unix socket, with the same limits

Without its files the port stays closed; they are looked for again every RETRY_S, and read again when they change. Once
read, they count until others can be read: a file that is half written, or a disk that fails, cuts no ground from a
vehicle in the air, but raises an alarm. Another pinned certificate counts at once, and so does the removal of it.
"""

from __future__ import annotations

import asyncio
import contextlib
import socket
from collections import Counter, OrderedDict
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import structlog

from skygcs.cancellation import ended
from skygcs.core.token_bucket import TokenBucket
from skygcs.descriptors import is_of_the_last
from skygcs.errors import LinkError, SkygcsError, explain_address_error
from skygcs.events import Event
from skygcs.ext.companions.tls import HANDSHAKE_S, PIN_LOOK_S, SHUTDOWN_S, Identity, PinnedTls
from skygcs.links.peers import format_address, resolve

if TYPE_CHECKING:
    from skygcs.rpc.context import NewSession

RETRY_S = 5.0
BACKLOG = 32

MAX_HANDSHAKES = 32
MAX_HANDSHAKES_PER_ADDRESS = 4
"""At the same time. The ground needs one; another program of its computer may try, too."""

HANDSHAKES_PER_S = 20.0
HANDSHAKES_PER_S_PER_ADDRESS = 2.0
"""The ground tries twice a second at most. 20 handshakes are 2 % of the loop's time on a desktop, a fifth on a small
board."""

BURST = 8.0
MAX_ADDRESSES = 256
"""Addresses whose rate is remembered; the one that was silent for longest is forgotten."""

USER_TIMEOUT_MS = 10_000
"""TCP_USER_TIMEOUT: a ground that is out of reach for so long has lost its session, and connects again."""

_log = structlog.get_logger(__name__)


class HandshakeLimits:
    """How many handshakes begin and go on, in all and for each address. Time comes in as ``now``."""

    def __init__(self, now: float) -> None:
        self._all = TokenBucket(HANDSHAKES_PER_S, HANDSHAKES_PER_S, now)
        self._rates: OrderedDict[str, TokenBucket] = OrderedDict()
        self._open: Counter[str] = Counter()
        self.known: str | None = None
        """The address from which the pinned certificate was shown last: those of others do not keep it out."""

    def begin(self, host: str, now: float) -> bool:
        """True if a handshake with this address may begin; `end` must follow if so."""
        known = host == self.known
        if self._open[host] >= MAX_HANDSHAKES_PER_ADDRESS or not (known or self._open.total() < MAX_HANDSHAKES):
            return False
        rate = self._rates.pop(host, None) or TokenBucket(HANDSHAKES_PER_S_PER_ADDRESS, BURST, now)
        self._rates[host] = rate
        if len(self._rates) > MAX_ADDRESSES:
            self._rates.popitem(last=False)
        if not rate.take(now) or not (known or self._all.take(now)):
            return False
        self._open[host] += 1
        return True

    def end(self, host: str) -> None:
        """Count a handshake that has ended, well or not."""
        self._open[host] -= 1
        if self._open[host] <= 0:
            del self._open[host]


class TlsListener:
    """Listens on ``host`` and ``port`` with the files of ``identity``. `run` is its task, until it is cancelled."""

    def __init__(self, host: str, port: int, identity: Identity, on_event: Callable[[Event], None]) -> None:
        self.address: tuple[str, int] | None = None
        """Where it listens; None while it does not."""
        self.problem: str | None = None
        """Why it does not listen."""
        self.counters: Counter[str] = Counter()
        self._host = host
        self._port = port
        self._identity = identity
        self._on_event = on_event
        self._tls: PinnedTls | None = None
        self._kept: str | None = None
        """Why the files cannot be used as they are now, and those read before count."""
        self._read_at: object = None
        self._limits = HandshakeLimits(asyncio.get_running_loop().time())
        self._handshakes: set[asyncio.Task[None]] = set()
        self._open: list[Any] = []
        """The transports of connections that were admitted."""

    def status(self) -> dict[str, Any]:
        """JSON-able."""
        return {
            "listen": None if self.address is None else format_address(self.address),
            "problem": self.problem or self._kept,
            "pinned": None if self._tls is None else self._tls.pinned_fingerprint,
            **{
                name: self.counters[name]
                for name in ("accepted", "refused_by_limit", "handshakes_failed", "wrong_certificate", "unpinned")
            },
        }

    async def run(self, new_session: NewSession) -> None:
        """Until cancelled; what is missing or in the way is reported once, and looked for again."""
        while True:
            try:
                self._refresh()
                listener = await self._listening()
            except SkygcsError as error:
                self._report(str(error))
                await asyncio.sleep(RETRY_S)
                continue
            self._report(None)
            looking = asyncio.get_running_loop().create_task(self._watch_pin(), name="pins of the ground")
            try:
                await self._accept(listener, new_session)
            except OSError as error:  # the network interface has gone
                self._report(explain_address_error(error, self._host, self._port))
            finally:
                self.address = None
                listener.close()
                await ended(looking)
                await self._end_handshakes()
            await asyncio.sleep(RETRY_S)

    def _refresh(self) -> PinnedTls:
        """The context of the files as they are now, or of the last ones that could be used. Raises LinkError if none
        could, or if the certificate that they pinned has been replaced or removed."""
        read_at, kept = self._identity.changed(), None
        if self._tls is None or read_at != self._read_at:
            try:
                self._tls, self._read_at = PinnedTls(self._identity, server=True), read_at
            except LinkError as error:
                if self._tls is None or self._tls.is_revoked(self._identity):
                    self._tls = None
                    raise
                kept = str(error)
        self._report_kept(kept)
        return self._tls

    async def _listening(self) -> socket.socket:
        """Bound and listening. Raises LinkError."""
        family, address = (await resolve(asyncio.get_running_loop(), self._host, self._port, socket.SOCK_STREAM))[0]
        listener = socket.socket(family, socket.SOCK_STREAM)
        try:
            listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            listener.bind(address)
            listener.listen(BACKLOG)
            listener.setblocking(False)
        except OSError as error:
            listener.close()
            raise LinkError(f"companion.rpc_listen: {explain_address_error(error, self._host, self._port)}") from None
        self.address = listener.getsockname()[:2]
        return listener

    async def _accept(self, listener: socket.socket, new_session: NewSession) -> None:
        loop, limits = asyncio.get_running_loop(), self._limits
        while True:
            sock, address = await loop.sock_accept(listener)
            host = str(address[0])
            if is_of_the_last(sock.fileno()) or not limits.begin(host, loop.time()):
                self.counters["refused_by_limit"] += 1
                sock.close()
                await asyncio.sleep(0)  # others get their turn between two of a flood
                continue
            task = loop.create_task(self._handshake(sock, host, new_session), name="tls handshake")
            self._handshakes.add(task)

            def over(task: asyncio.Task[None], host: str = host) -> None:
                self._handshakes.discard(task)
                limits.end(host)

            task.add_done_callback(over)

    async def _handshake(self, sock: socket.socket, host: str, new_session: NewSession) -> None:
        """From connection to session. Never raises."""
        try:
            tls = self._refresh()
            sock.setblocking(False)
            with contextlib.suppress(OSError):
                sock.setsockopt(socket.IPPROTO_TCP, socket.TCP_USER_TIMEOUT, USER_TIMEOUT_MS)
            await asyncio.get_running_loop().connect_accepted_socket(
                lambda: new_session(lambda transport: self._admits(tls, host, transport)),
                sock,
                ssl=tls.context,
                ssl_handshake_timeout=HANDSHAKE_S,
                ssl_shutdown_timeout=SHUTDOWN_S,
            )
        except asyncio.CancelledError:
            sock.close()
            raise
        except SkygcsError as error:  # the pinned certificate was removed, or replaced beside files that cannot be used
            sock.close()
            self.counters["handshakes_failed"] += 1
            self._report(str(error))
        except (OSError, EOFError) as error:  # ssl.SSLError is an OSError
            sock.close()
            self.counters["handshakes_failed"] += 1
            _log.debug("tls handshake failed", reason=str(error))

    def _admits(self, tls: PinnedTls, host: str, transport: Any) -> bool:
        """The last word after a handshake."""
        if tls.is_pinned(transport):
            self.counters["accepted"] += 1
            self._limits.known = host
            self._open = [other for other in self._open if not other.is_closing()]
            self._open.append(transport)
            self._report(None)
            return True
        self.counters["wrong_certificate"] += 1
        return False

    async def _watch_pin(self) -> None:
        """Close the connections of a ground whose certificate was replaced or removed. They are compared at each
        look: a handshake may have read the new files before it, or begun with the old ones."""
        while True:
            await asyncio.sleep(PIN_LOOK_S)
            try:
                tls: PinnedTls | None = self._refresh()
            except SkygcsError as error:
                tls = None
                self._report(str(error))
            for transport in self._open:
                if not transport.is_closing() and (tls is None or not tls.is_pinned(transport)):
                    self.counters["unpinned"] += 1
                    transport.abort()

    async def _end_handshakes(self) -> None:
        tasks = list(self._handshakes)
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)

    def _report_kept(self, problem: str | None) -> None:
        """An alarm while the files cannot be used and the last good ones count, with its end."""
        before, self._kept = self._kept, problem
        if (problem is None) == (before is None):
            return
        what = "of the companion's identity and the ground's certificate"
        if problem is None:
            text, change = f"the files {what} can be used again", "keys_read"
        else:
            text, change = f"{problem}; the last files {what} count until then, but not after a restart", "keys_kept"
        self._on_event(Event("companion", None, None, text, {"change": change}))

    def _report(self, problem: str | None) -> None:
        if problem == self.problem:
            return
        self.problem = problem
        if problem is not None:
            text = f"orders from the ground are not accepted: {problem}"
            self._on_event(Event("companion", None, None, text, {"change": "rpc_closed", "reason": problem}))
        elif self.address is not None:
            text = f"orders from the ground are accepted at {format_address(self.address)}"
            self._on_event(Event("companion", None, None, text, {"change": "rpc_open"}))
