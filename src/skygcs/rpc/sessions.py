"""What all sessions of a server share: their places, their turns, and the orders that no session's end may end.

a place is free (MAX_SESSIONS)        whoever comes gets it
else                                  the session that was idle for longest, IDLE_S at least, is closed for it
else                                  it is let in beyond the places (MAX_RESERVE), for one request that ends a flight
                                      or shows what flies (`session.EMERGENCY_METHODS`), to be asked within RESERVE_S
those too are all there               the one that came first and has asked for nothing yet goes
TCP, before the token is there        takes no place; the one that came first goes when MAX_UNAUTHENTICATED wait
"""

from __future__ import annotations

import asyncio
from collections import Counter, deque
from collections.abc import Coroutine
from typing import TYPE_CHECKING, Any

import structlog

from skygcs.events import Event
from skygcs.rpc.context import Context
from skygcs.rpc.dispatch import Dispatcher
from skygcs.rpc.ports import Daemon, JsonObject
from skygcs.rpc.subscriptions import Feeds

if TYPE_CHECKING:
    from skygcs.rpc.session import Session

_log = structlog.get_logger(__name__)

MAX_SESSIONS = 64
"""A fleet has a few dashboards and scripts; each open socket costs a file descriptor of the usual 1024."""

MAX_RESERVE = 128
"""Connections beyond. More than the system hands over at one wake-up (a backlog of 100), so that a flood of connections
does not put one out before what it sent with its connection was read."""

RESERVE_S = 2.0
"""In which a connection beyond the places has to say what it wants; skygcs-cli does so at once."""

MAX_UNAUTHENTICATED = 128
"""As MAX_RESERVE: whoever has no token neither uses up the places of those who have, nor keeps them out."""

IDLE_S = 10.0
"""A session that has asked for nothing for so long, and subscribed to nothing, gives way. A dashboard asks once a
second or subscribes."""

AMPLE_SHARE = 0.9
"""Places that may be taken at most before it is said that there are free ones again."""

TURN_S = 0.002
"""All clients' requests together are worked on this long, then it is everybody else's turn (routing, too)."""

LINGER_S = 5.0
MAX_LINGERING = 64
"""Connections that were closed and whose last answer has not been read: none of them longer, and no more of them."""

EVENT_QUIET_S = 10.0
"""Places that fill and empty more often than this are reported once in this time."""

MAX_WITHOUT_CLIENT = 256
"""Landings and the like that go on after their clients have gone; beyond that they end with the client. One client
that connects, orders and leaves in a loop must not make the daemon keep more and more."""


class Turns:
    """Sessions with lines to work on: one line of each in turn, those beyond the places first, TURN_S at a time."""

    def __init__(self, loop: asyncio.AbstractEventLoop) -> None:
        self._loop = loop
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
            self._due = True
            self._loop.call_soon(self._run)

    def _run(self) -> None:
        self._due = False
        deadline = self._loop.time() + TURN_S
        waiting = self._waiting
        while waiting:
            session = waiting.popleft()
            more = False
            try:
                more = session.work()
            except Exception as error:  # a fault of ours ends with the client whose line met it
                _log.error("rpc session failed", exc_info=error)
                session.close()
            if more:
                waiting.append(session)
            else:
                self._queued.discard(session)
            if self._loop.time() > deadline:
                break
        if waiting:
            for session in waiting:
                session.hold_back()
            self._due = True
            self._loop.call_soon(self._run)


class Sessions:
    """What all sessions share."""

    def __init__(self, daemon: Daemon, dispatcher: Dispatcher[Context], loop: asyncio.AbstractEventLoop) -> None:
        self.daemon = daemon
        self.dispatcher = dispatcher
        self.loop = loop
        self.feeds = Feeds(daemon, loop)
        self.turns = Turns(loop)
        self.counters: Counter[str] = Counter()
        self.lasting: set[asyncio.Task[bytes]] = set()
        """Orders that end a flight: they belong to no session, so that no session's end ends them."""
        # in the order in which they came
        self._placed: dict[Session, None] = {}
        self._reserve: dict[Session, None] = {}
        self._unauthenticated: dict[Session, None] = {}
        self._lingering: deque[asyncio.Transport] = deque()
        self._full = False
        self._reported_at = float("-inf")

    # -- places

    @property
    def sessions(self) -> list[Session]:
        """All that are open."""
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
        elif len(self._placed) < MAX_SESSIONS or self._close_idle():
            self._placed[session] = None
        else:
            self._let_in_beyond(session)

    def promote(self, session: Session) -> bool:
        """Whether a connection beyond the places has one now."""
        if len(self._placed) >= MAX_SESSIONS and not self._close_idle():
            return False
        del self._reserve[session]
        self._placed[session] = None
        session.restricted = False
        session.keep()
        return True

    def remove(self, session: Session) -> None:
        """The session has ended. Idempotent."""
        for group in (self._placed, self._reserve, self._unauthenticated):
            group.pop(session, None)
        if self._full and len(self._placed) <= AMPLE_SHARE * MAX_SESSIONS:
            self._full = False
            text = "clients: there are free places again"
            self.daemon.on_event(Event("warning", None, None, text, {"change": "not_full"}))

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
        """For a client that came when all places were taken."""
        return f"all {MAX_SESSIONS} places are taken"

    def _close_idle(self) -> bool:
        """Whether a place was made free by closing the session that was idle for longest."""
        now = self.loop.time()
        idle = max(self._placed, key=lambda session: session.idle_s(now), default=None)
        if idle is None or idle.idle_s(now) < IDLE_S:
            return False
        reason = f"closed: idle for {idle.idle_s(now):.0f} s, and all {MAX_SESSIONS} places were taken"
        self._dismiss(idle, "closed_idle", reason)
        return True

    def _let_in_beyond(self, session: Session) -> None:
        now = self.loop.time()
        if not self._full and now - self._reported_at >= EVENT_QUIET_S:
            self._full = True
            self._reported_at = now
            text = (
                f"clients: all {MAX_SESSIONS} places are taken, {self._holders()}; further ones may stop, hold, land, "
                "return and disarm vehicles and read their state, nothing else; close some"
            )
            self.daemon.on_event(Event("warning", None, None, text, {"change": "full", "places": MAX_SESSIONS}))
        self.counters["connections_restricted"] += 1
        if len(self._reserve) >= MAX_RESERVE:
            silent = next((other for other in self._reserve if not other.busy), None)
            if silent is None:
                self._reserve[session] = None
                self._dismiss(session, "connections_refused", f"too many clients ({self._number()})")
                return
            self._dismiss(silent, "connections_refused", f"too many clients ({self._number()})")
        self._reserve[session] = None
        session.restricted = True
        session.close_after(RESERVE_S)

    def _dismiss(self, session: Session, counter: str, reason: str) -> None:
        self.counters[counter] += 1
        session.dismiss(reason)

    def _holders(self) -> str:
        """The processes that hold most places."""
        pids = Counter(pid for session in self._placed if (pid := session.peer_pid()) is not None)
        held = ", ".join(f"{number} by process {pid}" for pid, number in pids.most_common(3))
        return held or "by TCP clients"

    def _number(self) -> int:
        return len(self._placed) + len(self._reserve) + len(self._unauthenticated)

    # -- orders that outlive their clients

    def outlive(self, work: Coroutine[Any, Any, bytes]) -> Coroutine[Any, Any, bytes]:
        """Begin ``work`` at once, whoever goes away; awaiting what is returned gives its reply."""
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
        }

    async def close(self) -> None:
        """End every session, and what outlives them; wait for all of it."""
        sessions = self.sessions
        tasks: list[asyncio.Task[Any]] = [task for session in sessions for task in session.tasks]
        tasks += self.lasting
        for session in sessions:
            session.close()
        for task in list(self.lasting):
            task.cancel()
        self.feeds.close()
        await asyncio.gather(*tasks, return_exceptions=True)
